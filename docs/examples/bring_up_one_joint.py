#!/usr/bin/env python3
"""Brings one joint module from power-on to moving, with nothing but python-canopen.

    bring_up_one_joint.py --eds module.eds [--channel vcan0] [--node 4]

The module is a CiA 402 drive, so python-canopen's BaseNode402 walks its states by itself. Whoever leads it sends SYNC and,
with each SYNC, where the joint shall be. Needs: pip install canopen python-can. Explained in docs/clients.md.
"""

import argparse
import math
import sys
import threading
import time

import can
import canopen
from canopen.profiles.p402 import BaseNode402, OperationMode

# The one mode of ours that CiA 402 leaves to the maker: the joint gives way. python-canopen has no name for it.
PASSIVE = "PASSIVE"
OperationMode.CODE2NAME[-1] = PASSIVE
OperationMode.NAME2CODE[PASSIVE] = -1
OperationMode.SUPPORTED[PASSIVE] = 1 << 16  # of 6502h: the first bit that is the maker's

SYNC_PERIOD_S = 0.04  # slow enough for Python on a busy machine; modules take 1 ms to 1 s
MICRO = 1e-6  # position objects count in urad, velocities in urad/s


class Joint:
    """One module, led over the bus."""

    def __init__(self, network, node_id, eds):
        self.network = network
        self.node = BaseNode402(node_id, eds)
        network.add_node(self.node)
        self.target_rad = None  # what is sent at each SYNC; None: nothing is
        self.velocity_rad_s = 0.0

    # -- power-on to OPERATION ENABLED

    def connect(self):
        """Waits for the module's heartbeat, brings it to a known start and sets the period of SYNC."""
        self.node.nmt.wait_for_heartbeat(timeout=5)
        # Boot-up may be faster than nmt.wait_for_bootup(): listen first, then ask for it.
        booted = threading.Event()
        self.network.subscribe(0x700 + self.node.id, lambda _id, data, _at: data == b"\0" and booted.set())
        self.node.nmt.state = "RESET"
        if not booted.wait(5):
            raise TimeoutError("no boot-up within 5 s after the NMT reset")
        self.node.sdo["knot_period_us"].raw = round(SYNC_PERIOD_S * 1e6)
        self.node.setup_402_state_machine()  # reads the PDOs: controlword and mode out, statusword and mode in
        self.node.tpdo[1].add_callback(self._lead)
        self.node.nmt.state = "OPERATIONAL"
        self.network.sync.start(SYNC_PERIOD_S)
        wait_until(lambda: self.node.tpdo[1].is_periodic, "TPDO1 with each SYNC")

    def enable(self, mode):
        """Through READY TO SWITCH ON and SWITCHED ON to OPERATION ENABLED; the brake opens."""
        if self.node.state == "FAULT":
            self.node.reset_from_fault()
        if self.node.state != "OPERATION ENABLED":
            self.node.rpdo_pointers[0x6060].raw = OperationMode.NAME2CODE[mode]
            self.node.state = "OPERATION ENABLED"
        # 6061h shows the mode once the brake is open and the joint under control.
        wait_until(lambda: self.node.op_mode == mode, f"mode {mode}")

    def disable(self):
        """The joint comes to rest, the brake closes, the power stage goes off."""
        self.node.state = "SWITCH ON DISABLED"

    # -- leading

    @property
    def position_rad(self):
        return self.node.tpdo_values[0x6064] * MICRO

    def _lead(self, _):
        """Called with each TPDO1, that is, after each SYNC: the set point for the next one."""
        if self.target_rad is None:
            return
        pdo = self.node.rpdo[2]
        pdo["target_position_urad"].raw = round(self.target_rad / MICRO)
        pdo["velocity_offset_urad_s"].raw = round(self.velocity_rad_s / MICRO)
        pdo.transmit()

    def hold(self):
        """Set points begin where the joint is; it follows them as soon as they do not make it jump."""
        self.target_rad = self.position_rad
        for _ in range(3):  # what is shown until then is from before
            self.node.check_statusword()
        wait_until(lambda: self.node.statusword & 1 << 12, "statusword bit 12: the joint follows the set points")

    def move(self, to_rad, seconds):
        """There along a smooth path: no jump in position, velocity or acceleration."""
        start, begun = self.target_rad, time.monotonic()
        while (u := (time.monotonic() - begun) / seconds) < 1:
            self.target_rad = start + (to_rad - start) * u**3 * (10 - 15 * u + 6 * u * u)
            time.sleep(SYNC_PERIOD_S / 4)
        self.target_rad = to_rad


def wait_until(condition, what, limit_s=5.0):
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {limit_s:g} s for {what}")
        time.sleep(0.005)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--eds", required=True, help="made by the build: generated/can_protocol/module.eds")
    parser.add_argument("--interface", default="socketcan", help="python-can's name of the kind of bus")
    parser.add_argument("--channel", default="vcan0")
    parser.add_argument("--node", type=int, default=4, help="node id of the module, default 4")
    options = parser.parse_args()

    network = canopen.Network(can.Bus(interface=options.interface, channel=options.channel))
    network.connect()
    try:
        joint = Joint(network, options.node, options.eds)
        joint.connect()
        print(f"{joint.node.sdo['device_name'].raw}, serial number {joint.node.sdo[0x1018][4].raw}, "
              f"modes {joint.node.sdo['supported_drive_modes'].raw:X}h")

        joint.enable("HOMING")
        joint.node.sdo["homing_method"].raw = 37  # the joint is where it is: it stands at zero now
        if not joint.node.homing(timeout=10):
            raise RuntimeError("homing failed")
        print(f"homed at {joint.position_rad:+.4f} rad")

        joint.node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
        joint.hold()
        start = joint.position_rad
        joint.move(start + 0.2, seconds=1.0)
        time.sleep(0.3)
        print(f"position: moved by {joint.position_rad - start:+.4f} rad, wanted +0.2000")
        moved = joint.position_rad - start

        joint.node.op_mode = PASSIVE
        print(f"passive: mode display {joint.node.tpdo_values[0x6061]}")
        joint.target_rad = None  # nothing leads a passive joint
        time.sleep(0.1)
        joint.node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
        joint.hold()

        # Torque: first what holds the joint now, then a little less, so that it sinks slowly.
        torque = joint.node.sdo["torque_actual_permille"].raw
        joint.node.sdo["target_torque_permille"].raw = torque
        joint.target_rad = None
        joint.node.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
        time.sleep(0.3)
        print(f"torque: {torque / 10:+.1f} % of rated held, "
              f"{joint.node.sdo['velocity_actual_urad_s'].raw * MICRO:+.3f} rad/s")

        joint.disable()
        print(f"state: {joint.node.state}")
        return 0 if math.isclose(moved, 0.2, abs_tol=0.01) else 1
    finally:
        network.sync.stop()
        network.disconnect()


if __name__ == "__main__":
    sys.exit(main())

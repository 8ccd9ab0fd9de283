#!/usr/bin/env python3
"""Homes one joint on its switch, with nothing but python-canopen.

    home_one_joint.py --eds module.eds [--channel vcan0] [--node 4] [--method 20]

CiA 402 homing methods: 20 and 22 search the home switch in the positive and in the negative direction, and meet its edge
slowly; 19 and 21 leave it again; 17 and 18 leave the negative and the positive limit switch; 1 to 6 are those six, then on
to the encoder's next index pulse; 33 and 34 are that pulse alone; -1 is the search that the module is configured for; 35
and 37 are here. Needs: pip install canopen python-can. Explained in docs/clients.md.
"""

import argparse
import sys

import can
import canopen

from bring_up_one_joint import MICRO, Joint, wait_until


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--eds", required=True, help="made by the build: generated/can_protocol/module.eds")
    parser.add_argument("--interface", default="socketcan", help="python-can's name of the kind of bus")
    parser.add_argument("--channel", default="vcan0")
    parser.add_argument("--node", type=int, default=4, help="node id of the module, default 4")
    parser.add_argument("--method", type=int, default=-1, help="CiA 402 homing method, default -1")
    parser.add_argument("--fast", type=float, default=0.2, help="search the switch with it, rad/s")
    parser.add_argument("--slow", type=float, default=0.02, help="meet its edge and the index with it, rad/s")
    parser.add_argument("--reads", type=float, help="what the joint shall read at the reference, rad (default: as configured)")
    options = parser.parse_args()

    network = canopen.Network(can.Bus(interface=options.interface, channel=options.channel))
    network.connect()
    try:
        joint = Joint(network, options.node, options.eds)
        joint.connect()
        sdo = joint.node.sdo
        sdo["homing_method"].raw = options.method  # a method that the module has not is refused here
        sdo["homing_speeds"]["homing_speed_switch_urad_s"].raw = round(options.fast / MICRO)
        sdo["homing_speeds"]["homing_speed_zero_urad_s"].raw = round(options.slow / MICRO)
        if options.reads is not None:
            where = "homing_index_position_urad" if options.method in (1, 2, 3, 4, 5, 6, 33, 34) else "homing_switch_position_urad"
            sdo["homing_details"][where].raw = round(options.reads / MICRO)
        joint.enable("HOMING")  # what was written comes into force with it
        if not joint.node.homing(timeout=120):
            raise RuntimeError("homing failed")
        wait_until(lambda: joint.node.statusword & 1 << 10, "the joint to come to rest")
        print(f"homed by method {options.method}, at {joint.position_rad:+.4f} rad")
        joint.disable()
        return 0
    finally:
        network.sync.stop()
        network.disconnect()


if __name__ == "__main__":
    sys.exit(main())

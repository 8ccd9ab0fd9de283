#!/usr/bin/env python3
"""Figures of the processes on a real vcan: vcan0 the robot's bus, vcan1 the plant bus.

Usage: bench_vcan.py BUILD_FOLDER [--ticks N] [--trips N] [--only PART]
To be run where vcan0 and vcan1 exist, for example by scripts/with_vcan; scripts/bench does that.

round_trip   a request to one free-running module and its answer: SDO read, and SYNC to the first TPDO
frames       how many frames a second one free-running module takes without losing one
lockstep     simulated milliseconds per second with the plant and the robot's modules
"""

import argparse
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROBOT_BUS, PLANT_BUS = "vcan0", "vcan1"
NODE = 2  # of joint 1
STATUSWORD = struct.pack("<BHB4x", 0x40, 0x6041, 0)


class Bus:
    """Raw classic frames."""

    def __init__(self, ids=None):
        self.socket = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        if ids is not None:
            filters = b"".join(struct.pack("<II", i, 0x7FF) for i in ids)
            self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
        self.socket.settimeout(2.0)
        self.socket.bind((ROBOT_BUS,))

    def send(self, cob_id, data=b""):
        self.socket.send(struct.pack("<IB3x8s", cob_id, len(data), data.ljust(8, b"\0")))

    def receive(self):
        cob_id, length, data = struct.unpack("<IB3x8s", self.socket.recv(16))
        return cob_id, data[:length]


class Programs:
    """Starts programs, keeps what they say, ends what it started."""

    def __init__(self, build):
        self.module = build / "module_fw/targets/linux/mrr_module"
        self.plant = build / "sim_vcan/targets/mrr_plant"
        self.running = []

    def start(self, *command):
        log = tempfile.TemporaryFile(mode="w+")
        process = subprocess.Popen([str(c) for c in command], stderr=log)
        process.log = log
        self.running.append(process)
        return process

    def start_module(self, joint, *more):
        return self.start(self.module, "--robot", "mrr3", "--joint", joint, "--can", ROBOT_BUS, "--verbose", *more)

    def end(self, process):
        """Its standard error."""
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        process.wait(timeout=20)
        self.running.remove(process)
        process.log.seek(0)
        return process.log.read()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self.running:
            process.kill()
            process.wait()


def percentiles(times_s):
    ordered = sorted(times_s)
    return "p50 {:.0f} us, p99 {:.0f} us, max {:.0f} us".format(
        *(1e6 * ordered[min(int(share * len(ordered)), len(ordered) - 1)] for share in (0.5, 0.99, 1.0)))


def wait_for_boot_up(bus):
    while bus.receive()[0] != 0x700 + NODE:
        pass


def round_trip(programs, trips):
    with_boot_up = Bus([0x700 + NODE])
    module = programs.start_module(1)
    wait_for_boot_up(with_boot_up)
    for name, request, answer in (
            ("SDO request to answer", (0x600 + NODE, STATUSWORD), 0x580 + NODE),
            ("SYNC to TPDO1", (0x080, b""), 0x180 + NODE)):
        bus = Bus([answer])
        if answer == 0x180 + NODE:
            bus.send(0x000, bytes([1, NODE]))
            time.sleep(0.05)
        times_s = []
        for trip in range(trips):
            time.sleep(0.0007 * (trip % 3))  # at every phase of the module's millisecond
            began = time.monotonic()
            bus.send(*request)
            bus.receive()
            times_s.append(time.monotonic() - began)
        print(f"round trip, {name}, {trips} times: {percentiles(times_s)}")
    text = programs.end(module)
    print("  " + re.search(r"lateness.*", text).group(0))


def frames(programs):
    """Each rate for two seconds; the last one without a loss is the figure."""
    best, limit = 0, "more was not tried"
    for rate in (1000, 2000, 4000, 8000, 12000, 16000, 20000):
        boot = Bus([0x700 + NODE])
        module = programs.start_module(1)
        wait_for_boot_up(boot)
        bus = Bus([0x7FF])
        sent, began = 0, time.monotonic()
        while (elapsed := time.monotonic() - began) < 2.0:
            for _ in range(int(elapsed * rate) - sent):
                bus.send(0x200 + NODE, b"\x06\x00\x00")
                sent += 1
            time.sleep(0.0005)
        reached = sent / (time.monotonic() - began)
        time.sleep(0.05)
        text = programs.end(module)
        received, lost = (int(x) for x in re.search(r"frames received (\d+).*lost when receiving (\d+)", text).groups())
        print(f"frames to one module: {reached:.0f}/s for 2 s: sent {sent}, received {received}, lost {lost}")
        if received != sent:
            limit = "beyond that it loses frames"
            break
        best = max(best, reached)
        if reached < 0.9 * rate:
            limit = "this sender sends no faster"
            break
    print(f"frames one module takes without loss: {best:.0f}/s; {limit}")


def lockstep(programs, ticks):
    modules = [programs.start_module(joint, "--plant", PLANT_BUS) for joint in (1, 2, 3)]
    plant = programs.start(programs.plant, "--robot", "mrr3", "--plant", PLANT_BUS, "--ticks", ticks, "--verbose")
    plant.wait(timeout=600)
    text = programs.end(plant)
    for module in modules:
        programs.end(module)
    print("lockstep, plant and 3 modules: " + re.search(r"\d+ ticks in .*", text).group(0))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=Path)
    parser.add_argument("--ticks", type=int, default=5000)
    parser.add_argument("--trips", type=int, default=1000)
    parser.add_argument("--only", choices=("round_trip", "frames", "lockstep"))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, Programs(arguments.build) as programs:
        os.environ["MRR_RUNTIME_DIR"] = folder
        if arguments.only in (None, "round_trip"):
            round_trip(programs, arguments.trips)
        if arguments.only in (None, "frames"):
            frames(programs)
        if arguments.only in (None, "lockstep"):
            lockstep(programs, arguments.ticks)
    return 0


if __name__ == "__main__":
    sys.exit(main())

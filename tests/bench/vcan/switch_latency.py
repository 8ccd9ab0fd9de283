#!/usr/bin/env python3
"""From the condition being true to all joints passive, with the programs as processes on vcan0 and vcan1.

Usage: switch_latency.py BUILD_FOLDER [--jobs N] [--realtime]

The supervisor arms each switch 40 ms too late (--test-switch-late): contact comes before it, and the supervisor pulls it.
In each job candump records both buses. The condition is true on the bus with the last feedback frame (TPDO1, TPDO2) that was
there before the supervisor's cycle which sent `now`; a joint is passive in the first tick that its module answers with the passive
law in force (docs/plant_io.md). Bus time: ticks of a millisecond between the two. Wall time: between the kernel's stamps.
"""

import argparse
import json
import re
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

NODES = (2, 3, 4)
NOW, PASSIVE_LAW = 1, 4
LINE = re.compile(r"\((\d+\.\d+)\) (\w+) ([0-9A-F]{3})#(?:#[0-9A-F])?([0-9A-F]*)")


class Rpc:
    def __init__(self, path):
        end = time.monotonic() + 15
        while True:
            try:
                self.socket = socket.socket(socket.AF_UNIX)
                self.socket.connect(str(path))
                break
            except OSError:
                self.socket.close()
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)
        self.lines = self.socket.makefile("rb")

    def call(self, method, **params):
        self.socket.sendall(json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode() + b"\n")
        answer = json.loads(self.lines.readline())
        if "error" in answer:
            sys.exit(f"{method}: {answer['error']['message']}")
        return answer["result"]

    def wait(self, condition, limit_s=60):
        end = time.monotonic() + limit_s
        while not condition(status := self.call("status")):
            if time.monotonic() > end:
                sys.exit(f"waited {limit_s} s; the robot is {status['activity']}")
            time.sleep(0.02)


def frames(log):
    """By the kernel's stamps: candump reads one interface after the other."""
    found = [LINE.match(line).groups() for line in log.read_text().splitlines()]
    for stamp, bus, can_id, data in sorted(found, key=lambda fields: float(fields[0])):
        yield float(stamp), bus, int(can_id, 16), bytes.fromhex(data)


def pulled(log):
    """(ticks, wall seconds) from the feedback to the last joint passive, ticks of it until the order; None: no `now` was needed."""
    tick, feedback, seen, order = None, None, None, None
    wanted, found = set(), {}
    for at, bus, can_id, data in frames(log):
        if bus == "vcan1" and can_id == 0x100:
            tick = struct.unpack_from("<I", data, 12)[0]
            seen = feedback  # what this tick's cycles have to go by
        elif bus == "vcan0" and can_id in {base + node for base in (0x180, 0x280) for node in NODES}:
            feedback = at, tick
        elif bus == "vcan0" and can_id == 0x181 and order is None and data[7] >> 5 == NOW and data[0] & 7 != 7:
            order, cause = tick, seen
            wanted = {joint for joint in range(len(NODES)) if not data[0] >> joint & 1}
        elif bus == "vcan1" and order is not None and can_id - 0x200 in wanted - set(found) and data[8] & PASSIVE_LAW:
            found[can_id - 0x200] = at, struct.unpack_from("<I", data, 4)[0]
            if len(found) == len(wanted):
                return (max(n for _, n in found.values()) - cause[1], max(t for t, _ in found.values()) - cause[0],
                        order - cause[1])
    return None


def median_and_max(values, form):
    return f"p50 {statistics.median_high(values):{form}}, max {max(values):{form}}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=Path)
    parser.add_argument("--jobs", type=int, default=20)
    parser.add_argument("--realtime", action="store_true", help="free-running at 1 kHz instead of in lockstep")
    arguments = parser.parse_args()
    build, pace = arguments.build, "realtime" if arguments.realtime else "lockstep"
    robot = Path(__file__).resolve().parents[3] / "robots" / "mrr3"
    processes = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def start(program, *options):
            processes.append(subprocess.Popen([build / program, "--robot", robot, *options], stdin=subprocess.DEVNULL,
                                              stdout=subprocess.DEVNULL, stderr=open(folder / "log", "ab")))

        try:
            more = () if arguments.realtime else ("--expect-supervisor",)
            start("sim_vcan/targets/mrr_plant", "--plant", "vcan1", f"--{pace}", "--socket", folder / "plant.sock", *more)
            for joint in (1, 2, 3):
                start("module_fw/targets/linux/mrr_module", "--joint", str(joint), "--can", "vcan0", "--plant", "vcan1")
            start("supervisor/daemon/mrr_supervisor", "--can", "vcan0", "--socket", folder / "supervisor.sock", "--ledger",
                  folder / "ledger", "--test-switch-late", "40", *(() if arguments.realtime else ("--plant", "vcan1")))
            supervisor, plant = Rpc(folder / "supervisor.sock"), Rpc(folder / "plant.sock")
            supervisor.wait(lambda s: s["clock"]["running"] and all(j["stage"] == "idle" for j in s["joints"]))
            results = []
            for _ in range(arguments.jobs):
                supervisor.call("disable")
                supervisor.wait(lambda s: s["activity"] == "disabled")
                plant.call("reset")
                time.sleep(0.2)
                # A joint takes the arm that was put back for a broken encoder.
                status = supervisor.call("status")
                for method in ["reset"] * any(j["stage"] == "faulted" for j in status["joints"]) + ["enable"]:
                    number = supervisor.call(method)["command"]
                    supervisor.wait(lambda s, n=number: s["command"]["number"] == n and s["command"]["state"] != "running")
                log = folder / "candump"
                with open(log, "wb") as out:
                    dump = subprocess.Popen(["candump", "-L", "-r", "4000000", "vcan0,080:7FF,181:7FF,180:780,280:780",
                                             "vcan1,100:7FF,200:7FC"], stdout=out)
                    try:
                        time.sleep(0.1)
                        supervisor.call("hammer", swings=1)
                        supervisor.wait(lambda s: s["job"]["state"] == "done")
                    finally:
                        dump.send_signal(signal.SIGINT)
                        dump.wait()
                results.append(pulled(log))
        finally:
            for process in reversed(processes):
                process.terminate()
                process.wait()
    none, results = results.count(None), [r for r in results if r]
    if not results:
        sys.exit(f"in none of {none} jobs was the switch pulled")
    print(f"switch pulled ({pace}), {len(results)} of {len(results) + none} jobs: from the feedback frame to all joints passive")
    print(f"  bus time, ms:  {median_and_max([r[0] for r in results], 'd')}; the order went out after {median_and_max([r[2] for r in results], 'd')}")
    print(f"  wall time, ms: {median_and_max([1e3 * r[1] for r in results], '.2f')}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

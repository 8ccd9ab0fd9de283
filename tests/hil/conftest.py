"""The programs as processes on vcan0 and vcan1. Run through scripts/with_vcan, which scripts/test does:

    scripts/with_vcan -- .venv/bin/python -m pytest tests/hil

No interface, or a program that was not built, is a failure and never a skip.
"""

import os
import pathlib
import signal
import socket
import subprocess
import sys
import time

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).parent))

from wire import Wire  # noqa: E402

ROOT = pathlib.Path(os.environ.get("MRR_SOURCE_DIR", pathlib.Path(__file__).resolve().parents[2]))
BUILD = pathlib.Path(os.environ.get("MRR_BUILD_DIR", ROOT / "build" / "release"))
ROBOT = ROOT / "robots" / "mrr3"


def pytest_configure(config):
    config.addinivalue_line("markers", "slow: takes more than a few seconds; left out by scripts/test --quick")


def pytest_sessionstart():
    missing = {"vcan0", "vcan1"} - {name for _, name in socket.if_nameindex()}
    if missing:
        pytest.exit(f"there is no {' and no '.join(sorted(missing))}: run through scripts/with_vcan", returncode=3)


def program(relative):
    path = BUILD / relative
    assert path.is_file(), f"{path} was not built"
    return path


class Process:
    """A program of ours, its messages kept in a file; stopped in order at the end."""

    def __init__(self, relative, *arguments, log):
        self.name = pathlib.Path(relative).name
        self.log = log
        with open(log, "ab") as out:
            self.popen = subprocess.Popen([program(relative), *map(str, arguments)], stdin=subprocess.DEVNULL, stdout=out,
                                          stderr=out, env={**os.environ, "MRR_STATE_DIR": str(log.parent)})

    def text(self):
        return self.log.read_text(errors="replace")

    def wait_for(self, words, count=1, limit_s=15.0):
        """What a running process has said is in its log only after it was given the time to say it."""
        wait_until(lambda: self.text().count(words) >= count, limit_s, f"{count} x '{words}' from {self.name}", self.text)

    def alive(self):
        return self.popen.poll() is None

    def stop(self, expected=0):
        """SIGTERM; the exit status must be the expected one."""
        if self.alive():
            self.popen.send_signal(signal.SIGTERM)
        try:
            status = self.popen.wait(15)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()
            raise AssertionError(f"{self.name} did not end on SIGTERM\n{self.text()}") from None
        assert status == expected, f"{self.name} ended with {status}\n{self.text()}"


class Robot:
    """Starts programs, and ends them whatever happens."""

    def __init__(self, folder):
        self.folder = folder
        self.processes = []

    def start(self, relative, *arguments):
        log = self.folder / f"{len(self.processes)}_{pathlib.Path(relative).name}.log"
        process = Process(relative, *arguments, log=log)
        self.processes.append(process)
        return process

    def module(self, joint, *arguments, plant=True):
        """The module of a joint (from 1); returns once it has booted."""
        with Wire("vcan0", node=joint + 1) as wire:
            process = self.start("module_fw/targets/linux/mrr_module", "--robot", ROBOT, "--joint", joint, "--can", "vcan0",
                                 *(("--plant", "vcan1") if plant else ()), *arguments)
            if not plant:
                wire.wait_state(0)
        return process

    def plant(self, *arguments):
        """The emulator; returns once it ticks or waits for the modules."""
        process = self.start("sim_vcan/targets/mrr_plant", "--robot", ROBOT, "--plant", "vcan1", "--socket",
                             self.folder / "plant.sock", "--verbose", *arguments)
        wait_until((self.folder / "plant.sock").exists, what="the plant's control socket")
        return process

    def stop(self):
        """Ends all, the last one first; one that did not end as it should is an error after all have ended."""
        errors = []
        for process in reversed(self.processes):
            try:
                process.stop()
            except AssertionError as error:
                errors.append(str(error))
        self.processes = []
        assert not errors, "\n".join(errors)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """One for all tests of a file."""
    robot = Robot(tmp_path_factory.mktemp("robot"))
    yield robot
    robot.stop()


@pytest.fixture
def fresh_robot(tmp_path):
    """One for this test alone."""
    robot = Robot(tmp_path)
    yield robot
    robot.stop()


@pytest.fixture(scope="module")
def bare_module(robot):
    """Joint 1 without hardware: everything that is on the wire, and no motion."""
    return robot.module(1, "--test-faults", plant=False)


@pytest.fixture(scope="module")
def led_module(robot):
    """Joint 3 with the emulator behind it, by the wall clock: what a client on a real bus has."""
    robot.plant("--realtime")
    with Wire("vcan0", node=4) as wire:
        process = robot.module(3, "--test-faults")
        wire.wait_state(0)
    return process


@pytest.fixture
def drive(led_module):
    """A raw client of the led module, in OPERATIONAL and SWITCH ON DISABLED; no SYNC, so mode 8 holds where it is."""
    with Wire("vcan0", node=4) as wire:
        wire.reset()
        wire.switch_on_disabled()
        yield wire
        wire.write(0x6040, 0, 0, "H")
        wire.reset()
    assert led_module.alive(), led_module.text()


@pytest.fixture
def wire(bare_module):
    """A raw client of the bare module, which has been reset, is in PRE-OPERATIONAL and has said what it lacks."""
    with Wire("vcan0", node=2) as wire:
        wire.reset()
        while wire.collect(0.06, 0x082):
            pass
        yield wire
    assert bare_module.alive(), bare_module.text()


def wait_until(condition, limit_s=5.0, what="it", context=lambda: ""):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, f"waited {limit_s} s for {what}\n{context()}"
        time.sleep(0.005)

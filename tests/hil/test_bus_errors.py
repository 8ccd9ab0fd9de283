"""What a CAN controller reports (error frames, as SocketCAN hands them to whoever asks), and interfaces that go down or away:
frames by a raw socket, since a virtual interface has no errors of its own."""

import contextlib
import pathlib
import socket
import struct
import subprocess

import pytest

from conftest import ROBOT, wait_until
from test_supervisor import SUPERVISOR, Rpc, joint
from wire import Wire

ERROR = 0x20000000  # CAN_ERR_FLAG
CONTROLLER, BUS_OFF, RESTARTED, NO_ACKNOWLEDGE, BUS_ERROR = 0x004, 0x040, 0x100, 0x020, 0x080
RX_PASSIVE, TX_PASSIVE, ACTIVE, WARNING, OVERFLOW = 0x10, 0x20, 0x40, 0x04, 0x01
OFF, PASSIVE = 0x8140, 0x8120
FAULT = 0x08


def report(kind, controller=0, count=1, interface="vcan0"):
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        raw.bind((interface,))
        for _ in range(count):
            raw.send(struct.pack("=IB3x8s", ERROR | kind, 8, bytes([0, controller])))


def test_bus_off_of_an_enabled_joint_is_a_latched_fault_and_ends_with_a_reset(drive):
    drive.write(0x6060, 0, 8, "b")
    for word, state in ((6, 0x21), (7, 0x23), (15, 0x27)):
        drive.write(0x6040, 0, word, "H")
        wait_until(lambda s=state: drive.read(0x6041) & 0x6F == s, what=f"{state:02X}")
    count = drive.read(0x2040, 9)
    drive.drain()
    report(BUS_OFF)
    report(RESTARTED)  # perhaps in the same tick
    drive.expect_emergency(OFF)
    assert drive.read(0x2040, 9) == count + 1
    wait_until(lambda: drive.read(0x6041) & 0x4F == FAULT, what="FAULT")
    assert drive.read(0x603F) == OFF
    drive.write(0x6040, 0, 0, "H")
    assert drive.read(0x6041) & 0x4F == FAULT, "latched"
    drive.write(0x6040, 0, 0x80, "H")
    wait_until(lambda: drive.read(0x6041) & 0x4F == 0x40, what="the reset")


def test_error_passive_is_an_emergency_and_taken_back(drive):
    for controller in (RX_PASSIVE, TX_PASSIVE):
        drive.drain()
        report(CONTROLLER, controller)
        emergency = drive.expect_emergency(PASSIVE).data
        assert emergency[2] & 0x11 == 0x11
        assert drive.read(0x1001) & 0x10
        report(CONTROLLER, ACTIVE)
        assert drive.expect_emergency(0).data[2] & 0x10 == 0
    assert drive.read(0x6041) & 0x4F == 0x40, "no fault"


def test_other_reports_and_a_flood_of_them_change_nothing(drive):
    before = drive.read(0x1001), drive.read(0x6041)
    for kind, controller in ((CONTROLLER, WARNING), (CONTROLLER, OVERFLOW), (NO_ACKNOWLEDGE, 0), (BUS_ERROR, 0), (0x1FF & ~BUS_OFF, ACTIVE)):
        report(kind, controller, 500)
    assert (drive.read(0x1001), drive.read(0x6041)) == before


def supervisor(fresh_robot, interface):
    path = fresh_robot.folder / "supervisor.sock"
    process = fresh_robot.start(SUPERVISOR, "--robot", ROBOT, "--can", interface, "--socket", path)
    wait_until(path.exists, what="the supervisor's socket")
    rpc = Rpc(path)
    rpc.wait(lambda s: s["clock"]["cycles"] > 0)
    return process, rpc


def test_the_supervisor_says_that_its_controller_is_bus_off(fresh_robot):
    process, rpc = supervisor(fresh_robot, "vcan1")  # no module is there: a frame would say that the bus is back
    rpc.get("subscribe", events=["bus"])
    report(BUS_OFF, interface="vcan1")
    status = rpc.wait(lambda s: s["bus"]["state"] == "down")
    assert "bus-off" in status["bus"]["problem"] and "restart-ms" in status["bus"]["problem"]
    report(RESTARTED, interface="vcan1")
    rpc.wait(lambda s: s["bus"]["state"] == "up")
    assert [("bus-off" in e["text"], "again" in e["text"]) for e in rpc.events] == [(True, False), (False, True)]
    assert process.alive()


@contextlib.contextmanager
def removed():
    subprocess.run(["ip", "link", "del", "vcan0"], check=True)
    try:
        yield
    finally:
        subprocess.run(["ip", "link", "add", "dev", "vcan0", "type", "vcan"], check=True)
        subprocess.run(["ip", "link", "set", "vcan0", "mtu", "72", "txqueuelen", "4096", "up"], check=True)


def filters():
    """What the kernel lets through to whom on vcan0: (list, identifier, mask) of each receiver."""
    lists = [(path.name, line.split()) for path in pathlib.Path("/proc/net/can").glob("rcvlist_*") for line in path.read_text().splitlines()]
    return sorted((name, words[1], words[2]) for name, words in lists if words and words[0] == "vcan0")


def test_an_adapter_that_is_unplugged_and_back_is_used_again_by_supervisor_and_module(fresh_robot):
    process, rpc = supervisor(fresh_robot, "vcan0")
    module = fresh_robot.module(1, plant=False)
    rpc.wait(lambda s: joint(s, 1)["stage"] != "absent")
    before = filters()
    assert any(name == "rcvlist_fil" for name, _, _ in before), before
    with removed():
        status = rpc.wait(lambda s: s["bus"]["state"] == "down")
        assert "vcan0" in status["bus"]["problem"]
        rpc.wait(lambda s: joint(s, 1)["stage"] == "lost" or joint(s, 1)["stage"] == "absent")
    rpc.wait(lambda s: s["bus"]["state"] == "up" and joint(s, 1)["stage"] not in ("lost", "absent"))
    assert filters() == before
    with Wire("vcan0", node=2) as wire:
        assert wire.read(0x1000) == 0x00020192
    assert process.alive() and module.alive()

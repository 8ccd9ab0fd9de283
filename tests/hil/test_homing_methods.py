"""Homing on a switch and on the encoder's index by a plain CANopen client: docs/examples/home_one_joint.py, as it stands
there, at joint 3 of the emulated robot, whose home switch closes at 2.3 rad on the positive side."""

import re
import subprocess
import sys

import canopen
import pytest
from conftest import BUILD, ROOT

from test_supervisor import Rpc

NODE = 4
EDS = BUILD / "generated" / "can_protocol" / "module.eds"
ATTEMPTS = 3  # by the wall clock, with python-canopen's own short time limits


def home(method, *more):
    """Where the joint says it is afterwards, rad."""
    for _ in range(ATTEMPTS):
        done = subprocess.run([sys.executable, ROOT / "docs/examples/home_one_joint.py", "--eds", EDS, "--node", str(NODE), "--method",
                               str(method), "--fast", "1.0", "--slow", "0.05", *more], capture_output=True, text=True, timeout=150, check=False)
        if done.returncode == 0:
            break
        print(done.stdout, done.stderr)
    assert done.returncode == 0, done.stderr
    return float(re.search(rf"homed by method {method}, at ([+-][0-9.]+) rad", done.stdout).group(1))


@pytest.fixture(scope="module")
def truth(robot, led_module):
    plant = Rpc(robot.folder / "plant.sock", checked=False)
    return lambda: plant.get("truth")["joints"][2]["motor_position_rad"]


@pytest.mark.parametrize("method, reads", [(20, 2.3), (-1, 2.3), (4, 2.35)])
def test_a_method_finds_its_reference(truth, method, reads):
    shown = home(method, "--reads", str(reads))
    # At rest a little beyond the reference: it slows down from 0.05 rad/s.
    assert shown == pytest.approx(reads, abs=0.02)
    # The switch's edge is at 2.3 rad but for its tolerance; the next index pulse within a motor turn (1/101) beyond it.
    zero = truth() - (shown - reads)
    assert 2.3 - 0.005 <= zero <= 2.3 + (0.005 if method != 4 else 0.0625 + 0.005), zero


def test_the_index_is_found_again(truth):
    zeros = []
    for _ in range(2):
        shown = home(4, "--reads", "0")
        zeros.append(truth() - shown)
    # A tick at 0.05 rad/s, and the gear's spring.
    assert zeros[0] == pytest.approx(zeros[1], abs=1e-3)


def test_a_method_that_is_not_there_is_refused(led_module):
    network = canopen.Network()
    network.connect(interface="socketcan", channel="vcan0")
    try:
        node = canopen.RemoteNode(NODE, str(EDS))
        network.add_node(node)
        for method in (0, 7, 23, 36):
            with pytest.raises(canopen.SdoAbortedError) as refused:
                node.sdo["homing_method"].raw = method
            assert refused.value.code == 0x06090030, hex(refused.value.code)
    finally:
        network.disconnect()

"""Stock python-canopen at a module with the emulator behind it, in wall-clock time: from power-on to moving, faults, and
another mapping."""


import subprocess
import sys
import time

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from conftest import BUILD, ROOT, wait_until
from wire import Wire

NODE = 4
EDS = BUILD / "generated" / "can_protocol" / "module.eds"
ATTEMPTS = 3  # these run by the wall clock, with python-canopen's own time limits of 0.2 to 0.8 s


def test_the_example_brings_a_joint_from_power_on_to_moving_and_back(led_module):
    """Homing, position, passive, torque: the script of docs/clients.md, as it stands there."""
    for _ in range(ATTEMPTS):
        done = subprocess.run([sys.executable, ROOT / "docs/examples/bring_up_one_joint.py", "--eds", EDS, "--node", str(NODE)],
                              capture_output=True, text=True, timeout=60, check=False)
        if done.returncode == 0:
            break
        print(done.stdout, done.stderr)
    assert done.returncode == 0, done.stderr
    said = done.stdout
    assert "homed at" in said and "position: moved by +0." in said and "passive: mode display -1" in said
    assert "state: SWITCH ON DISABLED" in said
    assert led_module.alive()


@pytest.fixture
def node(led_module):
    """Operational, with SYNC running; reset before and after."""
    network = canopen.Network()
    network.connect(interface="socketcan", channel="vcan0")
    with Wire("vcan0", node=NODE) as wire:
        wire.reset()
    node = BaseNode402(NODE, str(EDS))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 2.0
    try:
        node.nmt.wait_for_heartbeat(timeout=5)
        node.sdo["knot_period_us"].raw = 40000
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        network.sync.start(0.04)
        wait_until(lambda: node.tpdo[1].is_periodic)
        yield node
    finally:
        network.sync.stop()
        node.nmt.state = "RESET"
        time.sleep(0.2)
        network.disconnect()


def patiently(action, *arguments):
    """python-canopen's own time limits are short: once more, if it gave up."""
    for _ in range(ATTEMPTS - 1):
        try:
            return action(*arguments)
        except RuntimeError:
            time.sleep(0.2)
    return action(*arguments)


def go(node, state):
    patiently(lambda: setattr(node, "state", state))
    assert node.state == state


def test_every_state_is_reached_by_the_clients_own_walk(node):
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "QUICK STOP ACTIVE", "OPERATION ENABLED",
                  "SWITCHED ON", "READY TO SWITCH ON", "SWITCH ON DISABLED", "OPERATION ENABLED", "READY TO SWITCH ON",
                  "OPERATION ENABLED", "SWITCH ON DISABLED"):
        go(node, state)


@pytest.mark.parametrize("mode", ["HOMING", "CYCLIC SYNCHRONOUS POSITION", "CYCLIC SYNCHRONOUS TORQUE"])
def test_the_modes_that_6502_promises(node, mode):
    assert node.is_op_mode_supported(mode)
    go(node, "OPERATION ENABLED")
    node.op_mode = mode
    wait_until(lambda: node.op_mode == mode)
    go(node, "SWITCH ON DISABLED")


@pytest.mark.parametrize("mode", ["PROFILED POSITION", "VELOCITY", "PROFILED VELOCITY", "INTERPOLATED POSITION",
                                  "CYCLIC SYNCHRONOUS VELOCITY"])
def test_a_mode_that_is_not_there_is_neither_promised_nor_taken(node, mode):
    from canopen.profiles.p402 import OperationMode

    assert not node.is_op_mode_supported(mode)
    with pytest.raises(canopen.SdoAbortedError) as abort:
        node.sdo[0x6060].raw = OperationMode.NAME2CODE[mode]
    assert abort.value.code == 0x06090030


@pytest.mark.parametrize("code", [0x2310, 0x3210, 0x4310, 0x8611])
def test_a_fault_is_seen_and_cleared(node, code):
    go(node, "OPERATION ENABLED")
    node.emcy.reset()
    with Wire("vcan0", node=NODE) as wire:
        wire.write(0x2F00, 0, code, "H")
    wait_until(lambda: [e for e in node.emcy.log if e.code == code], what=f"EMCY {code:04X}")
    wait_until(lambda: node.state == "FAULT", what="FAULT")
    assert node.sdo["error_code"].raw == code
    assert node.sdo["error_register"].raw & 1
    assert code in [node.sdo[0x1003][k].raw & 0xFFFF for k in range(1, node.sdo[0x1003][0].raw + 1)]
    # Only the rising edge of bit 7 clears it.
    node.controlword = 0x80
    wait_until(lambda: node.state == "SWITCH ON DISABLED")
    wait_until(lambda: node.emcy.log[-1].code == 0, what="error reset")
    assert node.sdo["error_register"].raw == 0
    go(node, "OPERATION ENABLED")


def test_fault_reset_by_the_client(node):
    go(node, "OPERATION ENABLED")
    with Wire("vcan0", node=NODE) as wire:
        wire.write(0x2F00, 0, 0x2310, "H")
    wait_until(lambda: node.state == "FAULT")
    patiently(node.reset_from_fault)
    wait_until(lambda: node.state == "OPERATION ENABLED")


def test_another_mapping_is_seen(node):
    node.nmt.state = "PRE-OPERATIONAL"
    node.network.sync.stop()
    pdo = node.tpdo[2]
    pdo.read()
    pdo.clear()
    pdo.add_variable("digital_inputs")
    pdo.add_variable("position_actual_urad")
    pdo.trans_type = 1
    pdo.enabled = True
    pdo.save()
    assert [node.sdo[0x1A01][k].raw for k in (1, 2)] == [0x60FD0020, 0x60640020]
    node.nmt.state = "OPERATIONAL"
    seen = []
    pdo.add_callback(lambda p: seen.append((len(p.data), p["position_actual_urad"].raw)))
    node.network.sync.start(0.04)
    wait_until(lambda: len(seen) > 3)
    assert seen[-1][0] == 8
    assert abs(seen[-1][1] - node.sdo["position_actual_urad"].raw) < 5000

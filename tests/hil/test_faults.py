"""Faults of a joint in the whole robot of processes: what the bus says, what the supervisor makes of it, what people are
told, and that it ends with a reset. How each is found and how fast, tests/integration/faults has."""

import json
import os
import subprocess

import pytest

from conftest import BUILD, ROBOT, ROOT, wait_until
from test_supervisor import SUPERVISOR, Rpc, joint
from wire import Wire

NODE = 3  # of joint 2, which carries the arm
SCHEMA = json.loads(subprocess.run(  # Debian's Python has YAML
    ["/usr/bin/python3", "-c", "import json, sys, yaml; json.dump(yaml.safe_load(open(sys.argv[1])), sys.stdout)",
     ROOT / "can_protocol/schema/module.yaml"], capture_output=True, text=True, check=True).stdout)
FAULTS = {fault["name"]: fault for fault in SCHEMA["faults"]}
CODES = {emergency["name"]: emergency["code"] for emergency in SCHEMA["emergencies"]}
LATCHED = ("over_current", "current_mismatch", "over_voltage", "under_voltage", "winding_over_temperature",
           "drive_over_temperature", "encoder_lost", "encoder_jump", "encoder_stuck", "torque_sensor_lost",
           "torque_sensor_range", "over_speed", "following_error", "position_limit", "brake_closed", "power_stage",
           "loop_overrun", "sync_lost", "heartbeat_lost", "bus_off")


@pytest.fixture(scope="module")
def rpc(robot):
    robot.plant("--lockstep")
    for number in (1, 2, 3):
        robot.module(number, "--test-faults")
    path = robot.folder / "supervisor.sock"
    robot.folder.chmod(0o700)
    robot.start(SUPERVISOR, "--robot", ROBOT, "--can", "vcan0", "--plant", "vcan1", "--socket", path)
    wait_until(path.exists, what="the supervisor's socket")
    rpc = Rpc(path)
    rpc.wait(lambda s: s["clock"]["running"])
    rpc.done("enable")
    return rpc


@pytest.mark.parametrize("name", LATCHED)
def test_a_fault_stops_its_joint_is_told_everywhere_and_ends_with_a_reset(rpc, robot, name):
    code = CODES[FAULTS[name]["emergency"]]
    assert FAULTS[name]["reaction"] not in ("report", "derate", "hold")
    plant = Rpc(robot.folder / "plant.sock", checked=False)
    before = plant.get("truth")["joints"]
    with Wire("vcan0", NODE) as wire:
        wire.write(0x2F00, 0, code, "H")
        wire.expect_emergency(code)
    status = rpc.wait(lambda s: s["activity"] == "faulted" and joint(s, 2)["state"] == "fault")
    fault = joint(status, 2)["fault"]
    assert fault["code"] == code and joint(status, 2)["stage"] == "faulted"
    assert all(joint(status, other)["stage"] == "enabled" for other in (1, 3)), "the others hold"
    active = rpc.get("faults")["active"]
    assert [(f["joint"], f["code"]) for f in active] == [("joint_2", code)]
    told = subprocess.run([BUILD / "cli/mrr", "fault", "--json"], capture_output=True, text=True, timeout=30,
                          env={**os.environ, "MRR_RUNTIME_DIR": str(robot.folder)})
    assert any(f["code"] == code for f in json.loads(told.stdout)["active"]), told.stdout + told.stderr
    after = plant.get("truth")["joints"]
    assert not after[1]["power_stage_enabled"] and not after[1]["brake_released"]
    moved = [abs(a["link_position_rad"] - b["link_position_rad"]) for a, b in zip(after, before)]
    assert max(moved) < 5e-3, f"the arm dropped: {moved} rad"
    assert rpc.done("reset")["activity"] == "holding"
    assert rpc.get("faults")["active"] == []

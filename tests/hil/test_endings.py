"""mrr_supervisor told to end in the midst of each thing it does, and started again while the modules run on: brakes first, the joints
where they were, no old motion afterwards."""

import pytest

from conftest import wait_until
from test_supervisor import Rpc, Whole

# What is asked for, and the activity in which SIGTERM comes.
PHASES = {
    "bringing up": ("enable", {}),
    "homing": ("home", {"joint": 3}),
    "moving": ("move", {"positions_rad": {"joint_1": 0.5}, "speed": 0.3}),
    "passive": ("passive", {"joint": 3}),
    "approaching": ("hammer", {"swings": 1}),
    "swinging": ("hammer", {"swings": 1}),
}


@pytest.fixture(scope="module")
def whole(robot):
    return Whole(robot).ticking()


@pytest.mark.slow
@pytest.mark.parametrize("phase", PHASES)
def test_told_to_end_in_the_midst_of_it(whole, phase):
    plant = Rpc(whole.robot.folder / "plant.sock", checked=False)
    whole.rpc.wait(lambda s: all(j["stage"] == "idle" for j in s["joints"]))
    if phase != "bringing up":
        whole.rpc.done("enable")
    method, params = PHASES[phase]
    whole.rpc.get(method, **params)
    whole.rpc.wait(lambda s: s["activity"] == phase)
    whole.supervisor.stop()  # exit status 0
    whole.robot.processes.remove(whole.supervisor)
    assert not whole.socket.exists()
    wait_until(lambda: not any(j["power_stage_enabled"] or j["brake_released"] for j in plant.get("truth")["joints"]),
               what="brakes, and power off")
    rest = [j["link_position_rad"] for j in plant.get("truth")["joints"]]
    whole.start_supervisor()
    whole.ticking()
    status = whole.rpc.wait(lambda s: all(j["stage"] in ("idle", "faulted") for j in s["joints"]))
    assert not any(j["fault"] for j in status["joints"]), [j["fault"] for j in status["joints"]]
    whole.rpc.done("enable")
    enabled = plant.get("truth")["ticks"]
    wait_until(lambda: plant.get("truth")["ticks"] >= enabled + 300, what="300 ticks enabled")
    moved = [abs(now["link_position_rad"] - before) for now, before in zip(plant.get("truth")["joints"], rest)]
    assert max(moved) < 0.01, moved
    whole.rpc.done("disable")

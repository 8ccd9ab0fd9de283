"""The whole robot on the wall clock: emulator, three modules and supervisor each by their own time. On a busy machine any
of them may be late; judged is that all comes to an end that has a name, not when. Attempts are counted and printed."""

import pytest

from conftest import ROBOT, wait_until
from test_supervisor import SUPERVISOR, Rpc, joint

ATTEMPTS = 5


@pytest.fixture
def rpc(fresh_robot):
    fresh_robot.plant("--realtime")
    for number in (1, 2, 3):
        fresh_robot.module(number, "--realtime")
    path = fresh_robot.folder / "supervisor.sock"
    fresh_robot.start(SUPERVISOR, "--robot", ROBOT, "--can", "vcan0", "--socket", path)
    wait_until(path.exists, what="the supervisor's socket")
    rpc = Rpc(path)
    rpc.wait(lambda s: all(j["stage"] in ("idle", "faulted") for j in s["joints"]))
    yield rpc
    clock = rpc.get("status")["clock"]
    print(f"supervisor: {clock['cycles']} cycles made, {clock['missed']} left out, late by {clock['late_us']} us")


def bring_up(rpc):
    """Holding, whatever it takes: faults of being late are acknowledged."""
    for attempt in range(1, ATTEMPTS + 1):
        status = rpc.get("status")
        if status["activity"] == "holding":
            return
        faulted = status["activity"] == "faulted" or any(j["stage"] == "faulted" for j in status["joints"])
        number = rpc.call("reset" if faulted else "enable")
        if "result" in number and not faulted:
            status = rpc.wait(lambda s: s["command"]["state"] != "running")
            if status["command"]["state"] == "failed":
                named(status["command"]["reason"])
        elif "result" in number:
            status = rpc.wait(lambda s: s["command"]["state"] != "running")
            if status["command"]["state"] == "done" and status["activity"] == "disabled":
                continue
        try:
            rpc.wait(lambda s: s["activity"] == "holding", 5)
            print(f"holding at attempt {attempt}")
            return
        except AssertionError:
            print(f"attempt {attempt}: {rpc.get('status')['activity']}, {rpc.get('faults')['active']}")
    raise AssertionError(f"not holding after {ATTEMPTS} attempts")


def named(reason):
    """What being late may lead to."""
    known = ("loop overrun", "knots lost", "sync lost", "heartbeat lost", "fell silent", "silent", "following", "encoder", "torque sensor",
             "late", "lost", "fault", "another command", "not answering", "timed out", "in time", "acknowledge", "approach")
    assert any(word in reason for word in known), reason
    print(f"not done: {reason}")


def test_it_comes_up_and_moves(rpc):
    bring_up(rpc)
    for attempt in range(1, ATTEMPTS + 1):
        target = 0.2 if joint(rpc.get("status"), 1)["position_rad"] < 0.1 else 0.0
        answer = rpc.call("move", positions_rad=[target, None, None], speed=0.4)
        if "error" in answer:
            named(answer["error"]["message"])
            bring_up(rpc)
            continue
        status = rpc.wait(lambda s: s["command"]["state"] != "running")
        if status["command"]["state"] == "done":
            print(f"moved at attempt {attempt}")
            assert joint(status, 1)["position_rad"] == pytest.approx(target, abs=0.02)
            break
        named(status["command"]["reason"])
        bring_up(rpc)
    else:
        raise AssertionError(f"no motion was carried through in {ATTEMPTS} attempts")
    number = rpc.get("disable")["command"]
    status = rpc.wait(lambda s: s["command"]["number"] == number and s["command"]["state"] != "running")
    assert not any(j["state"] == "operation enabled" for j in status["joints"])


def test_it_hammers(rpc, fresh_robot):
    plant = Rpc(fresh_robot.folder / "plant.sock", checked=False)
    for attempt in range(1, ATTEMPTS + 1):
        bring_up(rpc)
        before = plant.get("truth")["nail_height_m"]
        answer = rpc.call("hammer", swings=2)
        if "error" in answer:
            named(answer["error"]["message"])
            continue
        rpc.wait(lambda s: s["job"]["state"] == "done", 60)
        job = rpc.get("job")
        print(f"attempt {attempt}: {job['verdict']}, {job['reason']}; {len(job['swings'])} swings")
        assert job["verdict"] in ("flush", "swings_used_up", "swing_aborted", "joint_fault", "not_ready", "nothing_moves", "nothing_hit",
                                  "plan_refused") and job["reason"]
        if job["verdict"] in ("flush", "swings_used_up"):
            assert plant.get("truth")["nail_height_m"] < before - 1e-3, "no blow reached the nail"
            return
    raise AssertionError(f"no job was carried through in {ATTEMPTS} attempts")

"""The whole robot on the wall clock: emulator, three modules and supervisor each by their own time. On a busy machine any
of them may be late; judged is that all comes to an end that has a name, not when. Attempts are counted and printed. What
no attempt carries through is a failure if nobody was late, and told as an expected one, with the figures, if somebody was."""

import re
import time

import pytest

from conftest import ROBOT, wait_until
from test_supervisor import SUPERVISOR, Rpc, joint

ATTEMPTS = 8
BOUND_MS = 20  # set points are continued for 24 ms, and come every 4 ms


@pytest.fixture
def rpc(fresh_robot):
    fresh_robot.plant("--realtime")
    for number in (1, 2, 3):
        fresh_robot.module(number, "--verbose")
    path = fresh_robot.folder / "supervisor.sock"
    fresh_robot.start(SUPERVISOR, "--robot", ROBOT, "--can", "vcan0", "--socket", path)
    wait_until(path.exists, what="the supervisor's socket")
    rpc = Rpc(path)
    rpc.wait(lambda s: all(j["stage"] in ("idle", "faulted") for j in s["joints"]))
    yield rpc
    clock = rpc.get("status")["clock"]
    print(f"supervisor: {clock['cycles']} cycles made, {clock['missed']} left out, late by {clock['late_us']} us")


def ended(rpc, method):
    """Asks for a command and waits for its end; why it was not done, or nothing."""
    answer = rpc.call(method)
    if "error" in answer:
        return answer["error"]["message"]
    status = rpc.wait(lambda s: s["command"]["number"] == answer["result"]["command"] and s["command"]["state"] != "running")
    return status["command"]["reason"]


def bring_up(rpc):
    """Holding; faults of being late are acknowledged."""
    for attempt in range(1, ATTEMPTS + 1):
        status = rpc.get("status")
        faulted = status["activity"] == "faulted" or any(j["stage"] == "faulted" for j in status["joints"])
        why = (named(ended(rpc, "reset")) if faulted else "") or named(ended(rpc, "enable"))
        if not why:
            print(f"holding at attempt {attempt}")
            return
        time.sleep(0.5)  # a joint that was lost is found and configured again meanwhile
    raise AssertionError(f"not holding after {ATTEMPTS} attempts: {rpc.get('status')}")


def named(reason):
    """What being late may lead to, and nothing else."""
    known = ("loop overrun", "knots lost", "sync lost", "heartbeat", "encoder", "torque sensor", "stopped following", "not done in time",
             "over speed", "following error", "did not acknowledge", "approach was not", "reported a fault or was lost",
             "clear the cause and reset")
    assert not reason or any(word in reason for word in known), reason
    if reason:
        print(f"not done: {reason}")
    return reason


def nothing_carried_through(rpc, robot):
    """A failure, unless supervisor, modules or emulator were later than the bound: then an expected one, with the figures."""
    late_ms = rpc.get("status")["clock"]["late_us"]["max"] / 1e3
    late = [f"supervisor late by {late_ms:.0f} ms"] if late_ms > BOUND_MS else []
    for process in [each for each in robot.processes if each.name in ("mrr_module", "mrr_plant")][::-1]:
        process.stop()
        # Its own words at the end.
        late_ms = int(re.search(r"late.* max (\d+) us", process.text()).group(1)) / 1e3
        if late_ms > BOUND_MS:
            late.append(f"{process.name} late by {late_ms:.0f} ms")
    text = f"none of {ATTEMPTS} attempts was carried through"
    if not late:
        pytest.fail(f"{text}, and nobody was later than {BOUND_MS} ms")
    pytest.xfail(f"{text}; {', '.join(late)}: more than {BOUND_MS} ms")


def test_it_comes_up_and_moves(rpc, fresh_robot):
    bring_up(rpc)
    for attempt in range(1, ATTEMPTS + 1):
        target = 0.2 if joint(rpc.get("status"), 1)["position_rad"] < 0.1 else 0.0
        answer = rpc.call("move", positions_rad=[target, None, None], speed=0.4)  # refused if it was late just before
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
        nothing_carried_through(rpc, fresh_robot)
    number = rpc.get("disable")["command"]
    status = rpc.wait(lambda s: s["command"]["number"] == number and s["command"]["state"] != "running")
    assert not any(j["state"] == "operation enabled" for j in status["joints"])


def test_it_hammers(rpc, fresh_robot):
    plant = Rpc(fresh_robot.folder / "plant.sock", checked=False)
    before = plant.get("truth")["nail_height_m"]
    driven = False
    for attempt in range(1, ATTEMPTS + 1):
        bring_up(rpc)
        answer = rpc.call("hammer", swings=2)
        if "error" in answer:
            named(answer["error"]["message"])
            continue
        rpc.wait(lambda s: s["job"]["state"] == "done", 60)
        job = rpc.get("job")
        print(f"attempt {attempt}: {job['verdict']}, {job['reason']}; {len(job['swings'])} swings")
        assert job["verdict"] in ("flush", "swings_used_up", "swing_aborted", "joint_fault", "not_ready", "nothing_moves", "nothing_hit",
                                  "plan_refused") and job["reason"]
        height = plant.get("truth")["nail_height_m"]
        # An attempt that was broken off may have driven the nail: the next one strikes where it is no more.
        if job["verdict"] in ("flush", "swings_used_up") or (job["verdict"] == "nothing_hit" and driven):
            assert height < before - 1e-3, "no blow reached the nail"
            return
        driven = driven or height < before - 5e-3
    nothing_carried_through(rpc, fresh_robot)

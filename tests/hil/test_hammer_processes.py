"""A hammering job by processes on vcan, beside the same job on one clock.

Both have the same robot, board, seed and plan. They are not the same run: on one clock frames take their time on a
simulated wire and modules tick in phases of their own, in lockstep a frame sent in one millisecond is there in the next
and all tick together; sensor noise falls on other instants. How much that alone is worth, runs on one clock show that
differ in nothing but when the modules boot (--boot-delay): on foam their first blow varies by some 4 % in speed and 15 %
in impulse, and a contact that ends with a light touch is one or two. Same must be: verdict, number of swings (on foam but
for two), who went passive, and the first plan, before anything was learnt. Of the first swing, equal within the sampling must be:
- speed, impulse and torques: within the span of the runs on one clock, and as much again on either side, for torques 1 Nm at
  least. On hardwood joint 3 carries 5.0 Nm in some of these and 7.0 in the others, nothing between;
- lead of the switch: one knot (4 ms), a tick for when the mode is decided and a tick for contact: 6 ms;
- penetration: 10 % or 1 mm; on hardwood duration too, 10 % or 10 ms.
Later swings are planned from what was felt, so each is compared by what it gave of what was predicted for it: 10 %.
"""

import json
import os
import subprocess

import pytest

from conftest import BUILD, ROOT


BOOT_DELAYS_MS = (100, 0, 18, 35, 69, 119)


def on_one_clock(board, boot_delay_ms, out):
    run = subprocess.run([BUILD / "cli/mrr", "hammer", "--board", board, "--seed", "1", "--boot-delay", str(boot_delay_ms),
                          "--no-report", "--out", out], capture_output=True, text=True, timeout=120)
    assert run.returncode in (0, 1), run.stderr
    return run, json.loads((out / "result.json").read_text())


@pytest.fixture(scope="module")
def spans(tmp_path_factory):
    """{board: {key: [value of the first swing, one per boot delay]}} on one clock."""
    folder = tmp_path_factory.mktemp("boot_delays")
    swings = {board: [on_one_clock(board, delay, folder / f"{board}{delay}")[1]["swings"][0] for delay in BOOT_DELAYS_MS]
              for board in ("styrofoam", "hardwood")}
    spans = {board: {key: [swing[key] for swing in each] for key in ("speed_m_s", "impulse_measured_n_s")}
             for board, each in swings.items()}
    for board, each in swings.items():
        spans[board]["torques"] = list(zip(*([joint["peak_torque_nm"] for joint in swing["joints"]] for swing in each)))
    return spans


def is_one_of(value, values, margin=0.0):
    margin = max(margin, max(values) - min(values))
    return min(values) - margin <= value <= max(values) + margin


@pytest.fixture(scope="module")
def jobs(tmp_path_factory):
    """{board: (on one clock, by processes)} as result.json has them, and the folders."""
    folder = tmp_path_factory.mktemp("processes")
    run = folder / "run"
    run.mkdir(mode=0o700)
    environment = {**os.environ, "MRR_RUNTIME_DIR": str(run), "MRR_BUILD_DIR": str(BUILD)}
    results = {}
    for board in ("styrofoam", "hardwood"):
        pair = []
        pair.append(on_one_clock(board, BOOT_DELAYS_MS[0], folder / board / "clock")[0])
        up = subprocess.run([ROOT / "scripts/robot", "up", "--board", board, "--seed", "1"], capture_output=True, text=True, timeout=120,
                            env=environment)
        assert up.returncode == 0, up.stderr
        try:
            pair.append(subprocess.run([BUILD / "cli/mrr", "hammer", "--bus", "vcan0", "--seed", "1", "--no-report", "--out", folder / board / "bus"],
                                       capture_output=True, text=True, timeout=240, env=environment))
            again = subprocess.run([ROOT / "scripts/robot", "up"], capture_output=True, text=True, timeout=60, env=environment)
            assert again.returncode == 1 and "up already" in again.stderr
        finally:
            down = subprocess.run([ROOT / "scripts/robot", "down"], capture_output=True, text=True, timeout=60, env=environment)
        assert down.returncode == 0, down.stderr
        assert not [path.name for path in run.iterdir() if path.suffix in (".pid", ".sock")]
        assert pair[1].returncode == pair[0].returncode, pair[1].stderr + pair[1].stdout
        results[board] = [json.loads((folder / board / where / "result.json").read_text()) for where in ("clock", "bus")]
        results[board].append((pair[0].stdout, pair[1].stdout, folder / board))
    return results


@pytest.fixture(params=["styrofoam", "hardwood"])
def job(jobs, request):
    return jobs[request.param]


def test_the_verdict_and_the_number_of_swings_are_the_same(job):
    clock, bus, _ = job
    assert bus["processes"] == "lockstep" and bus["truth_known"] is True and clock["processes"] is None
    assert bus["board"] == clock["board"]
    for key in ("verdict", "flush", "success", "within_limits", "mode", "robot", "seed"):
        assert bus[key] == clock[key], key
    # On one clock, seed 1, boot delays of 0 to 160 ms by 4: on foam two blows in 35 jobs, three in 3, four in 3. The second
    # made the head flush in all of them; where it was believed to stand 0.5 to 0.9 mm proud it was struck again. On
    # hardwood three blows in all 41.
    assert min(len(bus["swings"]), len(clock["swings"])) > 0
    assert abs(len(bus["swings"]) - len(clock["swings"])) <= (2 if bus["board"] == "styrofoam" else 0)


def test_the_same_joints_go_passive_in_each_swing(job):
    clock, bus, _ = job
    sets = [[[joint["passive"] for joint in swing["joints"]] for swing in each["swings"]] for each in (clock, bus)]
    both = min(len(sets[0]), len(sets[1]))
    assert sets[0][:both] == sets[1][:both]


def test_the_first_swing_is_planned_the_same(job):
    """Nothing was learnt before it: only where the arm stands at rest, by its noisy encoders, may differ."""
    clock, bus, _ = job
    for key in ("speed_m_s", "impulse_predicted_n_s", "effective_mass_kg", "contact_time_s"):
        assert bus["plan"][key] == pytest.approx(clock["plan"][key], rel=0.01), key


def test_the_first_swing_is_equal_to_within_the_sampling(job):
    clock, bus, _ = job
    ours, theirs = bus["swings"][0], clock["swings"][0]
    assert ours["hit"] == theirs["hit"]
    assert ours["penetration_mm"] == pytest.approx(theirs["penetration_mm"], rel=0.10, abs=1)
    for a, b in zip(ours["joints"], theirs["joints"], strict=True):
        if b["switch_lead_ms"] is not None:
            assert a["switch_lead_ms"] == pytest.approx(b["switch_lead_ms"], abs=6), a["name"]


def test_a_contact_on_hardwood_lasts_as_long(jobs):
    clock, bus, _ = jobs["hardwood"]
    assert bus["swings"][0]["contact_ms"] == pytest.approx(clock["swings"][0]["contact_ms"], rel=0.10, abs=10)


@pytest.mark.parametrize("board", ["styrofoam", "hardwood"])
@pytest.mark.parametrize("key", ["speed_m_s", "impulse_measured_n_s"])
def test_the_first_blow_is_one_of_those_on_one_clock(jobs, spans, board, key):
    values = spans[board][key]
    assert max(values) > min(values), "boot delays change nothing: the span says nothing"
    assert is_one_of(jobs[board][1]["swings"][0][key], values), values


@pytest.mark.parametrize("board", ["styrofoam", "hardwood"])
def test_the_first_blow_loads_the_gears_as_one_of_those_on_one_clock(jobs, spans, board):
    for joint, values in zip(jobs[board][1]["swings"][0]["joints"], spans[board]["torques"], strict=True):
        assert is_one_of(joint["peak_torque_nm"], values, 1.0), (joint["name"], joint["peak_torque_nm"], values)


def test_later_swings_give_as_much_of_what_was_predicted_on_hardwood(jobs):
    clock, bus, _ = jobs["hardwood"]
    shares = [[swing["impulse_measured_n_s"] / swing["impulse_predicted_n_s"] for swing in each["swings"]] for each in (clock, bus)]
    both = min(map(len, shares))
    assert shares[0][:both] == pytest.approx(shares[1][:both], rel=0.10)


def test_the_files_are_of_the_same_form(job):
    _, _, (_, text, folder) = job
    heads = [(folder / where / "telemetry.csv").open().readline() for where in ("clock", "bus")]
    assert heads[0] == heads[1]
    lines = [(folder / where / "bus.log").read_text().splitlines() for where in ("clock", "bus")]
    identifiers = [{line.split()[2].split("#")[0] for line in each} for each in lines]
    # The robot was found and configured before the command came: that part of the talk is in the one log only.
    assert identifiers[1] <= identifiers[0] and {"080", "181", "182", "183", "184"} & identifiers[1] >= {"080", "182", "183", "184"}
    times = [float(line[1:line.index(")")]) for line in lines[1]]
    assert times == sorted(times) and times[0] >= 0
    assert "Verdict:" in text and "processes on vcan0 in lockstep" in text and "loaded by the frames recorded" in text
    assert max(len(line) for line in text.splitlines() if not line.startswith("  files")) <= 80

"""mrr plan, predict and map: tables with units in 80 columns, JSON, pictures, and errors that name what is wrong."""

import json
import math
import subprocess

import pytest

MEASURES = ["load_ratio", "effective_mass", "internal_impact", "dynamic_ellipsoid", "generalised_ellipsoid", "impact_geometry"]


@pytest.fixture
def mrr(program):
    def run(*words, status=0):
        done = subprocess.run([program("cli/mrr"), *map(str, words)], capture_output=True, text=True, timeout=120)
        assert done.returncode == status, f"{done.returncode}: {done.stdout[-500:]}{done.stderr}"
        if status == 0:
            assert done.stderr == ""
        return done.stdout if status == 0 else done.stderr

    return run


@pytest.mark.parametrize("robot", ["robots/mrr3", "robots/arm7"])
def test_plan_is_explained_in_eighty_columns_with_units(mrr, robot):
    text = mrr("plan", "--robot", robot)
    assert max(map(len, text.splitlines())) <= 79
    for word in ("rad/s", "N m s", "N s", "m/s", "load/rated, %", "back-swing rad", "swing s", "Selections weighed", "chosen"):
        assert word in text, word
    plan = json.loads(mrr("plan", "--robot", robot, "--json"))["plan"]
    assert plan["poses"][0]["note"] == "chosen"
    assert f"{plan['speed_m_s']:.3f} m/s" in text


def test_plan_obeys_its_options(mrr):
    def plan(*words):
        return json.loads(mrr("plan", "--json", *words))["plan"]

    full = plan()
    assert plan("--speed", "0.5")["speed_m_s"] == pytest.approx(0.5 * full["speed_m_s"])
    assert [j["passive"] for j in plan("--passive", "joint_3")["joints"]] == [False, False, True]
    assert [j["passive"] for j in plan("--mode", "never")["joints"]] == [False] * 3
    assert plan("--penetration", "4", "--nail-mass", "12", "--contact", "90")["speed_m_s"] < full["speed_m_s"]
    heavy = plan("--measure", "effective_mass", "--passive", "joint_2")  # poses are ranked with the set of an instant
    assert heavy["poses"][0]["measure"] == pytest.approx(heavy["effective_mass_kg"])


def test_predict_shows_the_references_home_swing(mrr):
    words = ["predict", "--q", "0,0,0", "--qd", "0,-0.62,0", "--json"]
    free = json.loads(mrr(*words, "--passive", "1,2,3"))
    assert free["models"][0]["impulse_n_s"] == pytest.approx(2.06, abs=0.01)
    assert free["models"][0]["blow_impulse_nm_s"][1] == pytest.approx(0.167, abs=0.002)
    held = json.loads(mrr(*words, "--passive", "1,3", "--held", "joint_2"))
    assert held["models"][0]["blow_impulse_nm_s"][1] == pytest.approx(1.44, abs=0.02)


def test_predict_compares_three_models_on_a_board(mrr):
    text = mrr("predict", "--board", "styrofoam")
    for word in ("instant", "finite time", "resolved", "N m s", "rad/s", "m/s", "kg", "ms"):
        assert word in text, word
    assert max(map(len, text.splitlines())) <= 79
    models = json.loads(mrr("predict", "--board", "styrofoam", "--json"))["models"]
    assert [m["model"] for m in models] == ["instant", "finite time", "resolved"]
    assert all(m["feasible"] and m["impulse_n_s"] > 0.1 for m in models)
    resolved = models[2]
    assert "robots of this description" in text
    assert resolved["impulse_low_n_s"] <= resolved["impulse_n_s"] <= resolved["impulse_high_n_s"]
    assert resolved["impulse_low_n_s"] < resolved["impulse_high_n_s"]
    one = json.loads(mrr("predict", "--board", "styrofoam", "--robots", "1", "--json"))["models"][2]
    assert one["impulse_low_n_s"] == one["impulse_n_s"] == one["impulse_high_n_s"]


@pytest.mark.parametrize("measure", MEASURES)
def test_map_shows_every_measure_with_unit_and_source(mrr, measure):
    text = mrr("map", "--measure", measure, "--columns", 40, "--rows", 14)
    assert measure in text and "Source:" in text and "m along" in text and "N" in text
    assert max(map(len, text.splitlines())) <= 79
    data = json.loads(mrr("map", "--measure", measure, "--columns", 40, "--rows", 14, "--json"))
    values = [v for row in data["values"] for v in row if v is not None]
    assert len(values) > 20 and all(math.isfinite(v) and v >= 0.0 for v in values)
    assert data["unit"] and data["source"]


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_map_draws_a_picture(mrr, tmp_path, suffix):
    picture = tmp_path / f"map.{suffix}"
    mrr("map", "--measure", "effective_mass", "--columns", 40, "--rows", 30, "--picture", picture)
    head = picture.read_bytes()[:200]
    assert head.startswith(b"\x89PNG") if suffix == "png" else b"<?xml" in head


@pytest.mark.parametrize("words, named", [
    (["plan", "--robot", "/nowhere"], ["/nowhere"]),
    (["plan", "--start", "0,0"], ["--start", "3 joints"]),
    (["plan", "--start", "0,x,0"], ["--start", "'x'", "number"]),
    (["plan", "--passive", "elbow"], ["--passive", "elbow", "joint_1"]),
    (["plan", "--penetration", "3"], ["--penetration", "--nail-mass", "kg"]),
    (["plan", "--mode", "maybe"], ["maybe", "planned"]),
    (["plan", "--restitution", "2"], ["--restitution"]),
    (["predict", "--q", "0,0,0"], ["--qd"]),
    (["predict", "--q", "0,0,0", "--qd", "0,1e6,0"], ["qd", "rad/s"]),
    (["predict", "--model", "resolved"], ["--board"]),
    (["predict", "--board", "jelly"], ["jelly"]),
    (["predict", "--board", "styrofoam", "--robots", "99"], ["--robots", "99", "32"]),
    (["map", "--measure", "beauty"], ["beauty", "load_ratio"]),
    (["map", "--picture", "map.gif", "--columns", "4", "--rows", "4"], ["map.gif", ".png"]),
    (["map", "--columns", "1"], ["--columns"]),
])
def test_unusable_input_is_one_sentence_with_status_2(mrr, words, named):
    text = mrr(*words, status=2)
    assert len(text.splitlines()) == 1 and text.startswith("mrr: "), text
    for word in named:
        assert word in text, text

"""What `mrr hammer` leaves behind for programs: result.json and its schema, telemetry.csv, bus.log."""

import collections
import csv
import json
import re
import subprocess

import can
import jsonschema
import pytest

UNITS = {"s", "1", "N", "mm", "m", "rad", "rad/s", "Nm", "A"}


@pytest.fixture(scope="module")
def job(program, tmp_path_factory):
    """(completed process, folder) of one job."""
    folder = tmp_path_factory.mktemp("out")
    done = subprocess.run([program("cli/mrr"), "hammer", "--out", folder, "--json", "--no-report"], capture_output=True,
                          text=True)
    assert done.returncode in (0, 1), done.stderr
    return done, folder


@pytest.fixture(scope="module")
def result(job):
    return json.loads((job[1] / "result.json").read_text())


@pytest.fixture(scope="module")
def validator(source_dir):
    schema = json.loads((source_dir / "docs" / "result.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def objects(value):
    """All JSON objects in `value`."""
    if isinstance(value, dict):
        yield value
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from objects(inner)


def test_stdout_is_one_json_object_and_the_same_as_the_file(job, result):
    assert json.loads(job[0].stdout) == result


def test_exit_status_says_whether_the_job_succeeded(job, result):
    assert job[0].returncode == (0 if result["success"] else 1)


def test_result_satisfies_the_schema(validator, result):
    assert [f"{list(error.path)}: {error.message}" for error in validator.iter_errors(result)] == []


def test_schema_refuses_every_missing_and_every_unknown_key(validator, result):
    for each in list(objects(result)):
        for key in list(each):
            value = each.pop(key)
            assert not validator.is_valid(result) or key == "tables", f"{key} is missing unnoticed"
            each[key] = value
        each["surprise"] = 1
        assert not validator.is_valid(result), f"an unknown key beside {list(each)} goes unnoticed"
        del each["surprise"]
    assert validator.is_valid(result)


def test_every_property_of_both_schemas_is_described(source_dir):
    for name in ("result", "experiment"):
        schema = json.loads((source_dir / "docs" / f"{name}.schema.json").read_text())
        jsonschema.Draft202012Validator.check_schema(schema)
        for each in objects(schema):
            if isinstance(each.get("properties"), dict) and each.get("type") == "object":
                assert each["additionalProperties"] is False
                for key, entry in each["properties"].items():
                    assert entry.get("description") or entry.get("$ref"), f"{name}: {key} has no description"


def test_as_printed_result_satisfies_the_schema(program, validator, tmp_path):
    done = subprocess.run([program("cli/mrr"), "hammer", "--as-printed", "--json", "--no-report", "--out", tmp_path],
                          capture_output=True, text=True)
    printed = json.loads(done.stdout)
    assert printed["formulation"] == "as_printed" and len(printed["tables"]) > 10
    assert [error.message for error in validator.iter_errors(printed)] == []


@pytest.mark.slow
def test_experiment_satisfies_its_schema(program, source_dir, tmp_path):
    done = subprocess.run([program("cli/mrr"), "hammer", "--experiment", "--json", "--out", tmp_path],
                          capture_output=True, text=True)
    experiment = json.loads(done.stdout)
    assert experiment == json.loads((tmp_path / "experiment.json").read_text())
    schema = json.loads((source_dir / "docs" / "experiment.schema.json").read_text())
    assert [error.message for error in jsonschema.Draft202012Validator(schema).iter_errors(experiment)] == []


def test_result_agrees_with_itself(result):
    height = result["geometry"]["nail_height_mm"]
    for swing in result["swings"]:
        drop = height - swing["nail_height_mm"]
        if swing["number"] > 1:  # the first nail stands as high as the emulator's tolerance made it
            assert drop == pytest.approx(swing["penetration_mm"], abs=0.2)
        height = swing["nail_height_mm"]
        if swing["hit"] and swing["effective_mass_kg"] is not None:  # (33), (34): M* = P t / d
            expected = swing["impulse_measured_n_s"] * swing["contact_ms"] / swing["penetration_mm"]
            assert swing["effective_mass_kg"] == pytest.approx(expected, rel=1e-6)
    assert height == pytest.approx(result["nail_height_mm"], abs=0.2)


def header(folder):
    with open(folder / "telemetry.csv", newline="") as file:
        return next(csv.reader(file))


def test_telemetry_names_a_unit_for_every_column(job, result):
    names = header(job[1])
    assert len(set(names)) == len(names)
    for name in names:
        assert (found := re.fullmatch(r"\w+ \[(.+)\]", name)) and found[1] in UNITS, name
    for joint in result["geometry"]["joints"]:
        assert f"{joint['name']}_transmission_torque [Nm]" in names


def test_every_telemetry_column_is_documented_with_its_unit(job, result, source_dir):
    page = (source_dir / "docs" / "telemetry.md").read_text()
    documented = {}
    for line in page.splitlines():
        if found := re.match(r"\| (`.+?`) \| (\S+) \| (truth|robot) \|", line):
            documented.update({name: found[2] for name in re.findall(r"`(\w+)`", found[1])})
    joints = [joint["name"] for joint in result["geometry"]["joints"]]
    seen = {}
    for column in header(job[1]):
        name, unit = re.fullmatch(r"(\w+) \[(.+)\]", column).groups()
        joint = next((j for j in joints if name.startswith(j + "_")), None)
        seen[name.removeprefix(joint + "_") if joint else name] = unit
    assert seen == documented


def test_telemetry_has_a_row_per_millisecond(job):
    with open(job[1] / "telemetry.csv", newline="") as file:
        times = [float(row["time [s]"]) for row in csv.DictReader(file)]
    steps = collections.Counter(round(1e3 * (b - a), 3) for a, b in zip(times, times[1:]))
    assert len(times) > 1000 and set(steps) == {1.0}


def test_bus_log_opens_with_python_can_and_has_sync_at_the_knot_rate(job):
    with can.CanutilsLogReader(job[1] / "bus.log") as reader:
        messages = list(reader)
    times = [message.timestamp for message in messages]
    assert times == sorted(times)
    sync = [message for message in messages if message.arbitration_id == 0x080]
    assert len(sync) > 200 and all(message.dlc == 1 for message in sync)
    gaps = collections.Counter(round(1e3 * (b.timestamp - a.timestamp)) for a, b in zip(sync, sync[1:]))
    assert gaps.most_common(1)[0][0] == 4  # ms: 250 Hz
    counters = [message.data[0] for message in sync]
    assert all(b == a % 240 + 1 for a, b in zip(counters, counters[1:]))

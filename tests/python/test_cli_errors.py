"""What cannot be used is refused by `mrr hammer` in one sentence that names it, with status 2, and nothing is written."""

import re
import shutil
import subprocess

import pytest


@pytest.fixture
def robot(source_dir, tmp_path):
    """robot(file, old, new, all_of_them=False): a copy of the reference arm in which `old` (a pattern) was replaced by `new`."""
    folder = tmp_path / "arm"
    shutil.copytree(source_dir / "robots" / "mrr3", folder)

    def spoil(file, old, new, all_of_them=False):
        text = (folder / file).read_text()
        changed, count = re.subn(old, new, text, count=0 if all_of_them else 1, flags=re.MULTILINE)
        assert count > 0 and changed != text, f"{old} is not in {file}"
        (folder / file).write_text(changed)
        return folder

    return spoil


@pytest.fixture
def refused(program, tmp_path):
    """refused(options...): what stderr says; status 2, an empty stdout, no traceback and no file are checked."""

    def run(*options):
        out = tmp_path / "out"
        done = subprocess.run([program("cli/mrr"), "hammer", "--out", out, *map(str, options)], capture_output=True, text=True,
                              timeout=60)
        assert done.returncode == 2, f"status {done.returncode}: {done.stdout[-300:]}{done.stderr}"
        assert done.stdout == ""
        assert not out.exists(), "something was written"
        return done.stderr

    return run


def assert_one_sentence(text):
    lines = text.splitlines()
    assert len(lines) == 1 and lines[0].startswith("mrr: "), text
    for noise in ("terminate", "exception", "std::", "0x", "nan"):
        assert noise not in text, text


# file, pattern, replacement, what the sentence must name
SPOILS = {
    "broken XML": ("robot.urdf", "</robot>", "", ["robot.urdf", "XML", "line"]),
    "negative mass": ("robot.urdf", r'mass value="[0-9.]+"', 'mass value="-3.5"', ["robot.urdf", "link_1", "mass", "-3.5 kg", "above 0"]),
    "no speed at all": ("robot.urdf", 'velocity="1.5"', 'velocity="0"', ["robot.urdf", "joint_1", "velocity", "rad/s"]),
    "faster than the motor": ("robot.urdf", 'velocity="1.5"', 'velocity="9"',
                              ["robot.yaml", "joint_1", "max_velocity", "2000 rpm", "9 rad/s"]),
    "missing key": ("robot.yaml", r"^ *rated: 47 Nm.*\n", "", ["robot.yaml", "joints.joint_1.transmission.rated", "missing", "Nm"]),
    "wrong unit": ("robot.yaml", "rated: 47 Nm", "rated: 47 kg", ["robot.yaml", "joints.joint_1.transmission.rated", "47 kg", "torque", "Nm"]),
    "no unit": ("robot.yaml", "rated: 47 Nm", "rated: 47", ["robot.yaml", "joints.joint_1.transmission.rated", "47", "Nm"]),
    "not a number": ("robot.yaml", "rated: 47 Nm", "rated: .nan Nm", ["robot.yaml", "joints.joint_1.transmission.rated"]),
    "misspelt key": ("robot.yaml", "knot_rate:", "knot_rat:", ["robot.yaml", "bus", "knot_rat"]),
    "overloaded bus": ("robot.yaml", "knot_rate: 250 Hz", "knot_rate: 500 Hz",
                       ["robot.yaml", "bus.knot_rate", "500 Hz", "85.0 %", "80.0 %", "3 joints"]),
    "speed share out of range": ("robot.yaml", "max_speed_share: 1.0", "max_speed_share: 1.5", ["robot.yaml", "task.max_speed_share", "1.5", "1"]),
}


@pytest.mark.parametrize("name", SPOILS)
def test_unusable_description_is_one_sentence_with_its_place(name, robot, refused):
    file, old, new, named = SPOILS[name]
    said = refused("--robot", robot(file, old, new))
    if name != "not a number":
        assert_one_sentence(said)
    for word in named:
        assert word in said, said


def test_line_named_is_the_line_that_was_spoilt(robot, refused):
    folder = robot("robot.yaml", "rated: 47 Nm", "rated: 47 kg")
    line = next(i for i, text in enumerate((folder / "robot.yaml").read_text().splitlines(), 1) if "47 kg" in text)
    assert f"line {line}:" in refused("--robot", folder)


def test_unreachable_nail_says_where_it_is_and_how_far_out(robot, refused):
    said = refused("--robot", robot("robot.yaml", "nail_position: .*", "nail_position: 3 0 0.46 m"))
    assert_one_sentence(said)
    for word in ("3.0000", "0.5000", "cannot be reached", "mm away"):
        assert word in said, said


def test_blow_that_no_gear_stands_is_refused_with_the_joint_and_the_limit(robot, refused):
    robot("robot.yaml", "rated: 16 Nm", "rated: 0.5 Nm", all_of_them=True)
    said = refused("--robot", robot("robot.yaml", "repeated_peak: 37 Nm", "repeated_peak: 1 Nm", all_of_them=True))
    assert_one_sentence(said)
    for word in ("joint_2", "repeated peak", "N m s", "m/s"):
        assert word in said, said


def test_speed_that_leads_nowhere_is_refused_instead_of_swinging_for_ever(robot, refused):
    said = refused("--robot", robot("robot.yaml", "max_speed_share: 1.0", "max_speed_share: 0.0001"))
    assert_one_sentence(said)
    assert "m/s" in said or "max_speed_share" in said, said


def test_arm_without_a_robot_file_is_named(source_dir, tmp_path, refused):
    folder = tmp_path / "half"
    folder.mkdir()
    shutil.copy(source_dir / "robots" / "mrr3" / "robot.urdf", folder)
    said = refused("--robot", folder)
    assert_one_sentence(said)
    assert "robot.yaml" in said


def test_unknown_robot_says_where_it_was_looked_for(refused):
    said = refused("--robot", "no/such/arm")
    assert_one_sentence(said)
    assert "no/such/arm" in said and "robot.yaml" in said


def test_unknown_board_lists_the_known_ones(refused):
    said = refused("--board", "marble")
    assert_one_sentence(said)
    for word in ("marble", "styrofoam", "hardwood", "YAML"):
        assert word in said, said


def test_spoilt_board_names_file_key_and_unit(source_dir, tmp_path, refused):
    board = tmp_path / "my_board.yaml"
    text = (source_dir / "robots" / "boards" / "styrofoam.yaml").read_text()
    board.write_text(re.sub(r"resistance: [0-9.]+ N", "resistance: 4.1 Nm", text, count=1))
    said = refused("--board", board)
    assert_one_sentence(said)
    for word in ("my_board.yaml", "nail.resistance", "4.1 Nm", "force"):
        assert word in said, said


@pytest.mark.parametrize("options, named", [
    (["--frobnicate"], "--frobnicate"),
    (["--seed", "abc"], "abc"),
    (["--seed", "-1"], "-1"),
    (["--swings", "0"], "--swings"),
    (["--mode", "sometimes"], "sometimes"),
    (["--robot"], "--robot"),
    (["surplus"], "surplus"),
], ids=lambda value: " ".join(value) if isinstance(value, list) else "")
def test_unusable_option_is_named(options, named, refused):
    said = refused(*options)
    assert named in said and "--help" in said
    assert len(said.splitlines()) <= 2, said


@pytest.mark.parametrize("options", [
    ["plan", "--seed", "-1"], ["predict", "--seed", "-1"], ["map", "--seed", "-1"], ["plan", "--contact", "nan"],
    ["predict", "--nail-mass", "nan"], ["plan", "--speed", "nan"], ["map", "--contact", "-nan"], ["hammer", "--boot-delay", "nan"],
    ["move", "2=0rad", "--speed", "nan"], ["log", "--count", "nan"],
], ids=" ".join)
def test_a_number_that_is_none_and_one_that_would_wrap_are_refused_everywhere(options, program):
    done = subprocess.run([program("cli/mrr"), *options], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and done.stdout == "", done.stderr
    assert options[-2] in done.stderr and options[-1] in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr


def test_unknown_mode_lists_the_known_ones(refused):
    said = refused("--mode", "sometimes")
    for word in ("planned", "never", "always"):
        assert word in said
    assert "->" not in said, said


def test_folder_that_cannot_be_made_is_named(program, tmp_path):
    (tmp_path / "file").write_text("in the way")
    done = subprocess.run([program("cli/mrr"), "hammer", "--no-report", "--out", tmp_path / "file" / "out"], capture_output=True,
                          text=True)
    assert done.returncode == 2 and str(tmp_path / "file" / "out") in done.stderr


def test_no_command_and_unknown_commands_are_refused(program):
    for options in ([], ["drill"]):
        done = subprocess.run([program("cli/mrr"), *options], capture_output=True, text=True)
        assert done.returncode == 2 and done.stdout == "" and "--help" in done.stderr

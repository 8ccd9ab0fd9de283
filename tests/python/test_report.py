"""The report of a run: one file that needs nothing else, made of what really is in the run, or a clear sentence why not."""

import html.parser
import json
import os
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import time
import xml.etree.ElementTree

import numpy
import pytest

DEBIAN_PYTHON = "/usr/bin/python3"


def hammer(program, folder, *options):
    done = subprocess.run([program("cli/mrr"), "hammer", "--out", folder, *options], capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    return folder


@pytest.fixture(scope="module")
def run(program, tmp_path_factory):
    """Folder of a run, its report made by `mrr hammer` itself."""
    return hammer(program, tmp_path_factory.mktemp("run") / "out")


@pytest.fixture(scope="module")
def never(program, tmp_path_factory):
    return hammer(program, tmp_path_factory.mktemp("never") / "out", "--mode", "never", "--no-report")


@pytest.fixture
def copy(run, tmp_path):
    """A copy of the run to spoil, without its report."""
    folder = tmp_path / "copy"
    shutil.copytree(run, folder, ignore=shutil.ignore_patterns("report.html", "bus.log"))
    return folder


@pytest.fixture(scope="module")
def report(source_dir):
    def make(*arguments):
        return subprocess.run([DEBIAN_PYTHON, source_dir / "tools" / "report.py", *arguments], capture_output=True,
                              text=True)

    return make


class Page(html.parser.HTMLParser):
    """Tags, attributes and text of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes, self.text = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_data(self, data):
        self.text += data


def page(folder):
    return Page((folder / "report.html").read_text())


def words(folder):
    """The page's text with plain blanks."""
    return page(folder).text.replace("\u00a0", " ")


def test_needs_nothing_from_outside_and_no_script(run):
    text = (run / "report.html").read_text()
    found = page(run)
    assert not {"script", "link", "iframe", "object", "embed", "img", "base"} & set(found.tags)
    for tag, name, value in found.attributes:
        if name in ("src", "href", "xlink:href", "srcset", "data", "poster"):
            assert value.startswith("#"), (tag, name, value)
        assert not name.startswith("on"), (tag, name)
    assert "@import" not in text
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", text))
    without_names = re.sub(r'xmlns(:\w+)?="[^"]*"', "", text)
    assert not re.search(r"https?://|//\w+\.\w+/", without_names)


def test_figures_do_not_share_ids_and_find_what_they_refer_to(run):
    found = page(run)
    ids = [value for _, name, value in found.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    text = (run / "report.html").read_text()
    assert set(re.findall(r"(?:url\(#|xlink:href=\"#)([^)\"]+)", text)) <= set(ids)


def test_every_figure_is_well_formed_and_says_what_it_shows(run):
    text = (run / "report.html").read_text()
    figures = re.findall(r"<svg .*?</svg>", text, flags=re.S)
    assert len(figures) >= 9
    for figure in figures:
        root = xml.etree.ElementTree.fromstring(figure)
        assert root.get("role") == "img" and len(root.get("aria-label")) > 10
    assert text.count("<figcaption>") == len(figures)


def test_follows_light_and_dark_and_fits_a_phone(run):
    text = (run / "report.html").read_text()
    assert "prefers-color-scheme:dark" in text and 'name="viewport"' in text
    figures = "".join(re.findall(r"<svg .*?</svg>", text, flags=re.S))
    assert re.findall(r"(?:fill|stroke): ?#[0-9a-f]{6}", figures) == []  # no colour that a theme could not change


def test_headline_and_tables_say_what_the_result_says(run):
    result = json.loads((run / "result.json").read_text())
    text = words(run)
    assert f"{abs(result['nail_height_mm']):.2f} mm" in text
    assert result["reason"][1:].rstrip(".") in text
    assert result["plan"]["why"][1:].rstrip(".") in text
    for swing in result["swings"]:
        assert f"{swing['nail_height_mm']:.2f}".replace("-", "") in text
        if swing["hit"]:
            assert f"{swing['impulse_measured_n_s']:.2f}" in text
            for joint in swing["joints"]:
                assert f"{joint['peak_torque_nm']:.1f}" in text


def test_drawing_puts_the_face_where_the_emulator_has_it(run, source_dir):
    """The chain in result.json against the plant's own kinematics."""
    sys.path.insert(0, str(source_dir / "tools"))
    from mrr_report import data

    loaded = data.load(run)
    rows = numpy.linspace(0, len(loaded.telemetry) - 1, 50).astype(int)
    for row in rows:
        q = [loaded.telemetry[f"{joint}_link_position"][row] for joint in loaded.joints]
        face = [loaded.telemetry[f"face_{axis}"][row] for axis in "xyz"]
        assert data.ArmPose(loaded.result["geometry"], q).face == pytest.approx(face, abs=1e-6)


def test_comparison_says_by_how_much_passive_joints_are_relieved(run, never, report, tmp_path):
    folder = tmp_path / "both"
    shutil.copytree(run, folder)
    shutil.copy(never / "result.json", folder / "compare.json")
    shutil.copy(never / "telemetry.csv", folder / "compare.csv")
    done = report(folder)
    assert done.returncode == 0, done.stderr
    text = words(folder)
    ours, theirs = (json.loads((folder / name).read_text()) for name in ("result.json", "compare.json"))
    passive = {j["name"] for s in ours["swings"] if s["hit"] for j in s["joints"] if j["passive"]}
    assert passive, "the planned run switches no joint: nothing to compare"
    for name in passive:
        means = []
        for result in (ours, theirs):
            peaks = [j["peak_torque_nm"] for s in result["swings"] if s["hit"] for j in s["joints"] if j["name"] == name]
            means.append(sum(peaks) / len(peaks))
        percent = 100 * (means[0] / means[1] - 1)
        assert (f"{name.replace('_', ' ')[1:]}: mean peak torque {means[0]:.1f} Nm with planned switching, {means[1]:.1f} Nm "
                f"with never passive ({abs(percent):.0f} % {'lower' if percent < 0 else 'higher'})") in text


def test_comparison_may_lie_in_a_folder_of_its_own(run, never, report, copy):
    assert report(copy, "--compare", never).returncode == 0
    assert "with never passive" in words(copy)


def test_experiment_alone_is_a_report_too(report, tmp_path):
    def swing(name, ours, published, within):
        return {"name": name, "past_head_mm": 3.0, "nail_height_mm": 40.0, "hit": True, "within": within,
                "contact_ms": ours, "impulse_n_s": 1.0, "penetration_mm": 20.0, "effective_mass_kg": None,
                "speed_m_s": 0.4, "switch_lead_ms": 9.0,
                "published": {"contact_ms": published, "impulse_n_s": 1.1, "penetration_mm": None,
                              "effective_mass_kg": 7.0}}

    experiment = {"schema_version": 1, "robot": "mrr3", "seed": 1, "reproduced": False,
                  "series": [{"board": "styrofoam", "swings": [swing("1-1", 120.0, 150.0, False)]},
                             {"board": "hardwood", "swings": [swing("1", 80.0, None, True)],
                              "measured_contact_ms": [70.0, 85.0], "measured_impulse_n_s": [1.26, 1.42]}]}
    (tmp_path / "experiment.json").write_text(json.dumps(experiment))
    done = report(tmp_path)
    assert done.returncode == 0, done.stderr
    text = words(tmp_path)
    assert "1 of 2 swings are within the tolerances" in text
    assert "−20 %" in text and "70 to 85 ms" in text


def experiment_of(robot):
    swing = {"name": "1", "past_head_mm": 7.5, "hit": True, "within": True, "contact_ms": 80.0, "impulse_n_s": 1.3,
             "penetration_mm": 0.0, "effective_mass_kg": None,
             "published": {"contact_ms": None, "impulse_n_s": None, "penetration_mm": None, "effective_mass_kg": None}}
    return {"schema_version": 1, "robot": robot, "seed": 1, "reproduced": True,
            "series": [{"board": "hardwood", "swings": [swing], "measured_contact_ms": [70.0, 85.0],
                        "measured_impulse_n_s": [1.26, 1.42]}]}


def test_columns_of_dashes_are_left_out(report, tmp_path):
    (tmp_path / "experiment.json").write_text(json.dumps(experiment_of("mrr3")))
    assert report(tmp_path).returncode == 0
    head = re.findall(r"<thead>.*?</thead>", (tmp_path / "report.html").read_text())[0]
    assert head.count(">sim.<") == 3 and "publ." not in head and "M*" not in head and "within tolerance" in head


@pytest.mark.parametrize("robot, age_s, shown", [("mrr3", 60, True), ("other", 60, False), ("other", -60, True)])
def test_an_old_experiment_of_another_robot_is_left_out(report, copy, robot, age_s, shown):
    path = copy / "experiment.json"
    path.write_text(json.dumps(experiment_of(robot)))
    written = (copy / "result.json").stat().st_mtime - age_s
    os.utime(path, (written, written))
    done = report(copy)
    assert done.returncode == 0, done.stderr
    assert ("experiment, repeated" in words(copy)) == shown
    assert ("experiment.json" in words(copy)) == shown


def several_blows(folder, blows):
    """Makes the run's only hit into several: (passive, penetration in mm, impulse in N s) of each."""
    result = json.loads((folder / "result.json").read_text())
    entry = next(swing for swing in result["swings"] if swing["hit"])
    result["swings"] = []
    for passive, penetration_mm, impulse_n_s in blows:
        swing = json.loads(json.dumps(entry)) | {"penetration_mm": penetration_mm, "impulse_measured_n_s": impulse_n_s}
        for joint in swing["joints"]:
            joint["passive"] &= passive
        result["swings"].append(swing)
    (folder / "result.json").write_text(json.dumps(result))


@pytest.mark.parametrize("blows, chosen", [
    ([(False, 9.0, 9.0), (True, 0.0, 1.0)], 1),
    ([(True, 0.0, 9.0), (True, 3.0, 1.0), (False, 9.0, 9.0)], 1),
    ([(True, 3.0, 1.0), (True, 2.0, 2.0)], 1),
    ([(False, 0.0, 9.0), (False, 2.0, 2.0)], 1),
])
def test_the_blow_shown_is_a_passive_one_then_one_that_drove_then_the_hardest(copy, source_dir, blows, chosen):
    sys.path.insert(0, str(source_dir / "tools"))
    from mrr_report import data

    several_blows(copy, blows)
    run = data.load(copy)
    assert run.hardest() is run.hits[chosen]


def test_says_in_which_swings_a_joint_was_passive(report, copy):
    several_blows(copy, [(True, 3.0, 1.0), (False, 3.0, 1.0)])
    assert report(copy).returncode == 0
    text = words(copy)
    assert "passive in swing 1" in text and "passive at impact" not in text


def test_dotted_lines_are_spoken_of_only_if_there_are_any(report, run, never):
    assert "dotted" in words(run)
    assert report(never).returncode == 0
    assert "dotted" not in words(never)


def heeds_interrupts():
    """Even if the tests were started in the background by a shell that keeps interrupts from them."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.parametrize("after_s", [0.4, 0.8, 1.2])
def test_ctrl_c_is_one_line_and_leaves_nothing(source_dir, copy, after_s):
    """Or it came too late: then the report is there, and nothing is said."""
    before = sorted(copy.iterdir())
    child = subprocess.Popen([DEBIAN_PYTHON, source_dir / "tools" / "report.py", copy], stderr=subprocess.PIPE, text=True,
                             preexec_fn=heeds_interrupts)
    time.sleep(after_s)
    child.send_signal(signal.SIGINT)
    errors = child.communicate()[1]
    if after_s > 0.5 and child.returncode == 0:
        assert not errors and (copy / "report.html").stat().st_size > 10_000
    else:
        assert child.returncode == 130, errors
        assert errors == "report.py: interrupted\n"
    assert [path for path in sorted(copy.iterdir()) if path.name != "report.html"] == before


def test_same_run_same_report(report, copy):
    assert report(copy).returncode == 0
    first = (copy / "report.html").read_bytes()
    assert report(copy).returncode == 0
    assert (copy / "report.html").read_bytes() == first


def test_a_run_that_hit_nothing_is_reported(report, copy):
    result = json.loads((copy / "result.json").read_text())
    for swing in result["swings"]:
        swing.update(hit=False, contact_start_s=None)
    (copy / "result.json").write_text(json.dumps(result))
    done = report(copy)
    assert done.returncode == 0, done.stderr
    assert "nothing hit" in words(copy)


@pytest.mark.parametrize("spoil, sentence", [
    (lambda folder: (folder / "result.json").unlink(), "result.json: cannot be read"),
    (lambda folder: (folder / "result.json").write_text('{"schema_version": 1'), "is not JSON"),
    (lambda folder: (folder / "result.json").write_text('{"schema_version": 2}'), "schema_version is 2"),
    (lambda folder: (folder / "result.json").write_text('{"schema_version": 1}'), "has no"),
    (lambda folder: (folder / "telemetry.csv").unlink(), "telemetry.csv: cannot be read"),
    (lambda folder: (folder / "telemetry.csv").write_text("time [s],swing [1]\n0,x\n"), "is not a table of numbers"),
    (lambda folder: (folder / "telemetry.csv").write_text("time [s],swing [1]\n"), "has no rows"),
    (lambda folder: (folder / "telemetry.csv").write_text("time [s],swing [1]\n0,1\n"), "has no column"),
])
def test_a_spoilt_run_gives_one_sentence_and_no_report(report, copy, spoil, sentence):
    spoil(copy)
    (copy / "report.html").write_text("the one before")
    done = report(copy)
    assert done.returncode != 0
    assert sentence in done.stderr and done.stderr.count("\n") == 1 and "Traceback" not in done.stderr
    assert (copy / "report.html").read_text() == "the one before"
    assert not list(copy.glob("*.partial"))


def test_no_such_folder(report, tmp_path):
    done = report(tmp_path / "nowhere")
    assert done.returncode != 0 and "is not a folder" in done.stderr


def test_picture_is_about_1200_pixels_wide(report, run, tmp_path):
    done = report(run, "--picture", tmp_path / "picture.png")
    assert done.returncode == 0, done.stderr
    data = (tmp_path / "picture.png").read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])
    assert 1100 <= width <= 1300 and 400 <= height <= 700


def test_picture_as_svg_stands_alone(report, run, tmp_path):
    done = report(run, "--picture", tmp_path / "picture.svg")
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "picture.svg").read_text()
    xml.etree.ElementTree.fromstring(text)
    assert "var(--" not in text


def test_picture_of_another_kind_is_refused(report, run, tmp_path):
    done = report(run, "--picture", tmp_path / "picture.gif")
    assert done.returncode != 0 and ".png or .svg" in done.stderr


def test_takes_less_than_eight_seconds_of_processor_time(report, copy):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert report(copy).returncode == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 8.0

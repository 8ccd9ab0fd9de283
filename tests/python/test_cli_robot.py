"""The commands of `mrr` that talk to a supervisor, against one that is not ours: a few lines of Python which speak
JSON-RPC by docs/rpc.md. Whatever it answers is first checked against docs/rpc.schema.json."""

import json
import os
import pty
import re
import signal
import socket
import subprocess
import threading
import time

import jsonschema
import pytest

JOINTS = ("joint_1", "joint_2", "joint_3")


def hello():
    return {
        "interface_version": 1, "software_version": "0.1.0", "pid": 7,
        "robot": {"name": "mrr3", "source": "robots/mrr3", "joints": [
            {"name": name, "node_id": 2 + k, "lower_rad": -1.5, "upper_rad": 1.5, "velocity_rad_s": 1.0, "acceleration_rad_s2": 5.0,
             "absolute_encoder": True, "max_passive_s": 0.5, "max_passive_travel_rad": 0.4} for k, name in enumerate(JOINTS)]},
        "bus": {"interface": "vcan0", "bit_rate": 1e6, "knot_rate_hz": 250.0, "load_computed": 0.42},
        "clock": {"kind": "realtime", "plant_interface": None, "period_us": 1000.0}, "protocol_hash": 1,
    }


def status():
    joints = [{"name": name, "node_id": 2 + k, "stage": "enabled", "problem": None, "problem_detail": 0, "position_rad": 0.5 * k,
               "velocity_rad_s": 0.0, "torque_nm": 1.5 * k, "reference_rad": 0.5 * k, "mode": 8, "statusword": 0x1237,
               "state": "operation enabled", "following": True, "homed": True, "active_limit": None, "fault": None, "winding_c": 31.0,
               "drive_c": None, "bus_v": 48.0, "loop_load": 0.1} for k, name in enumerate(JOINTS)]
    joints[2].update(stage="faulted", problem="reports a fault", mode=0, position_rad=None,
                     fault={"code": 0x8130, "name": "heartbeat lost", "time_s": 12.5}, homed=False)
    return {
        "time_s": 12.75, "activity": "faulted", "ready": False, "joints": joints,
        "bus": {"interface": "vcan0", "state": "up", "problem": None, "load_computed": 0.42, "frames_received": 1000, "frames_sent": 900,
                "transmit_failures": 0},
        "clock": {"kind": "realtime", "running": True, "period_us": 1000.0, "cycles": 12750, "missed": 3,
                  "late_us": {"p50": 60.0, "p99": 120.0, "p999": 300.0, "max": 2000.0},
                  "work_us": {"p50": 10.0, "p99": 20.0, "p999": 30.0, "max": 40.0}, "realtime_scheduling": True, "memory_locked": True},
        "configuration": {"source": "robots/mrr3", "stale": False}, "ledger": ledger(), "command": None, "job": None,
    }


def ledger():
    uses = {"rated": 0.4, "repeated_peak": 0.2, "momentary_peak": 0.1}
    joints = [{"name": f"joint_{number}", "blows": 7, "blows_not_seen": 0, "peaks_over_rated": 3, "momentary_events": events,
               "peaks_over_momentary": 0, "largest_peak_nm": 20.5, "largest_use_square": uses, "largest_use_half_sine": uses,
               "life_share": life} for number, events, life in ((1, 0, 0.0), (2, 1, 2.3e-4), (3, 0, 4e-6))]
    return {"since": "2026-01-31", "joints": joints, "file": "/var/lib/mrr/ledger-mrr3", "problem": None}


class Supervisor:
    """Answers one line after the other; `asked` keeps (method, params)."""

    def __init__(self, path, schema):
        self.schema, self.asked, self.answers, self.after = schema, [], {}, {}
        self.server = socket.socket(socket.AF_UNIX)
        self.server.bind(str(path))
        self.server.listen()
        self.path = path
        self.answers = {"hello": hello, "status": status, "subscribe": lambda: {"events": ["command"]}, "stop": lambda: {"command": 99},
                        "faults": lambda: {"active": [], "history": []}}
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            try:
                client, _ = self.server.accept()
            except OSError:
                return
            threading.Thread(target=self.serve, args=(client,), daemon=True).start()

    def check(self, value, kind):
        """Against the definitions of the schema; result.schema.json is not needed for what is answered here."""
        if kind in self.schema["$defs"]:
            jsonschema.validate(value, {"$defs": self.schema["$defs"], **self.schema["$defs"][kind]})

    def serve(self, client):
        with client, client.makefile("rwb") as lines:
            for line in lines:
                request = json.loads(line)
                method, params = request["method"], request.get("params", {})
                assert request["jsonrpc"] == "2.0" and len(line) < 65536
                self.check(request, "request")
                self.asked.append((method, params))
                answer = self.answers.get(method, lambda: {"command": 5})()
                reply = {"jsonrpc": "2.0", "id": request["id"]}
                if "error" in answer:
                    reply.update(answer)
                else:
                    self.check(answer, f"{method}_result")
                    reply["result"] = answer
                lines.write(json.dumps(reply).encode() + b"\n")
                for event in self.after.get(method, []):
                    self.check(event, "event")
                    lines.write(json.dumps({"jsonrpc": "2.0", "method": "event", "params": event}).encode() + b"\n")
                lines.flush()


@pytest.fixture
def supervisor(tmp_path, source_dir):
    schema = json.loads((source_dir / "docs" / "rpc.schema.json").read_text())
    one = Supervisor(tmp_path / "supervisor.sock", schema)
    yield one
    one.server.close()


@pytest.fixture
def mrr(program, tmp_path):
    def run(*arguments, **options):
        environment = {**os.environ, "MRR_RUNTIME_DIR": str(tmp_path)}
        return subprocess.run([program("cli/mrr"), *arguments], capture_output=True, text=True, timeout=60, env=environment, **options)

    return run


def done(state="done", text="", number=5):
    return {"kind": "command", "time_s": 13.0, "joint": None, "value": number, "text": text, "state": state}


def refused(code, word, message):
    return lambda: {"error": {"code": code, "message": message, "data": {"code": word}}}


def test_status_shows_each_joint_with_units_problems_and_what_to_do(supervisor, mrr):
    shown = mrr("status")
    assert shown.returncode == 0, shown.stderr
    text = shown.stdout
    assert "mrr3 on vcan0, in real time: faulted" in text
    assert re.search(r"joint_2 +enabled +follows +28\.65 +0\.0 +1\.5 +31", text), text
    assert re.search(r"joint_3 +faulted +none +- ", text), "an unknown position is no number"
    assert "first fault 8130h heartbeat lost at 12.500 s" in text and "not homed; mrr home joint_3" in text
    assert ("gears life used in 7 blows since 2026-01-31: joint_1 0 %, joint_2 0.02 % (1 peak above the repeated peak), joint_3 0.0004 %"
            in " ".join(text.split()))
    assert "3 missed" in text and max(map(len, text.splitlines())) <= 79


def test_status_json_is_the_answer_itself(supervisor, mrr):
    assert json.loads(mrr("status", "--json").stdout) == status()


def test_status_watch_repeats_until_interrupted(supervisor, program, tmp_path):
    child = subprocess.Popen([program("cli/mrr"), "status", "--watch", "--period", "0.05", "--json", "--socket", supervisor.path],
                             stdout=subprocess.PIPE, text=True)
    lines = [child.stdout.readline() for _ in range(3)]
    child.send_signal(signal.SIGINT)
    assert child.wait(timeout=10) == 0
    assert all(json.loads(line)["activity"] == "faulted" for line in lines)


@pytest.mark.parametrize("arguments, method, params", [
    (("enable",), "enable", {}),
    (("disable",), "disable", {}),
    (("stop",), "stop", {}),
    (("reset",), "reset", {}),
    (("passive", "joint_2"), "passive", {"joint": "joint_2"}),
    (("active", "2"), "active", {"joint": 2}),
    (("home", "joint_1"), "home", {"joint": "joint_1"}),
])
def test_a_command_is_sent_and_its_end_awaited(supervisor, mrr, arguments, method, params):
    supervisor.answers["stop"] = lambda: {"command": 5}
    supervisor.after[method] = [done(number=4, state="failed"), done()]
    ended = mrr(*arguments)
    assert (ended.returncode, ended.stdout) == (0, f"{method}: done\n"), ended.stderr
    assert (method, params) in supervisor.asked


def test_the_end_is_found_in_status_when_the_event_is_lost(supervisor, mrr):
    supervisor.answers["status"] = lambda: {**status(), "command": {"number": 5, "method": "enable", "state": "done", "reason": ""}}
    assert mrr("enable").returncode == 0


def test_a_command_that_fails_ends_with_1_and_the_reason(supervisor, mrr):
    supervisor.after["home"] = [done("failed", "joint_1 found no switch within 10 s")]
    ended = mrr("home", "1")
    assert ended.returncode == 1 and "joint_1 found no switch within 10 s" in ended.stderr


def test_home_all_goes_from_tip_to_base(supervisor, mrr):
    supervisor.after["home"] = [done()]
    assert mrr("home", "--all").returncode == 0
    assert [params["joint"] for method, params in supervisor.asked if method == "home"] == ["joint_3", "joint_2", "joint_1"]


def test_move_takes_units_only_spelled_out(supervisor, mrr):
    supervisor.answers["move"] = lambda: {"command": 5, "duration_s": 1.0}
    supervisor.after["move"] = [done()]
    assert mrr("move", "joint_2=90deg", "3=-0.5rad", "--speed", "0.5").returncode == 0
    params = next(params for method, params in supervisor.asked if method == "move")
    assert params["positions_rad"] == pytest.approx({"joint_2": 1.5707963267948966, "joint_3": -0.5}) and params["speed"] == 0.5


@pytest.mark.parametrize("target, word", [("2=1", "no unit"), ("2=1grad", "neither deg nor rad"), ("2=nandeg", "finite"),
                                          ("2=xdeg", "finite"), ("=1deg", "JOINT=POSITION"), ("joint_2", "JOINT=POSITION"),
                                          ("2=1e400rad", "finite"), ("9=1deg", "not from 1 to 3"), ("2=0x1deg", "unit")])
def test_a_target_that_is_not_one_moves_nothing(supervisor, mrr, target, word):
    ended = mrr("move", target)
    assert ended.returncode == 2 and word in ended.stderr and ended.stderr.startswith("mrr: "), ended.stderr
    assert not any(method == "move" for method, _ in supervisor.asked)


@pytest.mark.parametrize("code, word, exit_status", [(1, "not_ready", 1), (2, "busy", 1), (3, "outside_limits", 2), (4, "unknown_joint", 2),
                                                     (-32602, "", 2), (-32603, "", 3)])
def test_a_refusal_is_one_line_and_decides_the_exit_status(supervisor, mrr, code, word, exit_status):
    supervisor.answers["passive"] = refused(code, word, "the sentence of the supervisor")
    ended = mrr("passive", "joint_2")
    assert (ended.returncode, ended.stderr) == (exit_status, "mrr: the sentence of the supervisor\n")


def test_ctrl_c_during_a_motion_stops_the_robot(supervisor, program):
    supervisor.answers["move"] = lambda: {"command": 5, "duration_s": 9.0}
    child = subprocess.Popen([program("cli/mrr"), "move", "1=1deg", "--socket", supervisor.path], stderr=subprocess.PIPE, text=True)
    for _ in range(100):
        if any(method == "move" for method, _ in supervisor.asked):
            break
        time.sleep(0.05)
    time.sleep(0.1)
    child.send_signal(signal.SIGINT)
    assert child.wait(timeout=10) == 130 and "the robot was stopped" in child.stderr.read()
    assert supervisor.asked[-1][0] == "stop"


def test_a_motion_that_takes_too_long_is_stopped(supervisor, mrr):
    supervisor.answers["move"] = lambda: {"command": 5, "duration_s": 9.0}
    ended = mrr("move", "1=1deg", "--timeout", "0.5")
    assert ended.returncode == 1 and "not ended within 0.5 s" in ended.stderr and supervisor.asked[-1][0] == "stop"


def test_faults_come_with_cause_time_and_remedy(supervisor, mrr):
    fault = {"joint": "joint_3", "code": 0x8130, "name": "heartbeat lost", "time_s": 12.5, "text": "the supervisor was silent for 100 ms"}
    supervisor.answers["faults"] = lambda: {"active": [fault], "history": [fault]}
    shown = mrr("fault")
    assert shown.returncode == 1, "there is one"
    for words in ("joint_3", "8130h", "12.500 s", "silent for 100 ms", "remedy: "):
        assert words in " ".join(shown.stdout.split()), words
    supervisor.answers["faults"] = lambda: {"active": [], "history": []}
    shown = mrr("fault")
    assert shown.returncode == 1 and "waits for mrr reset" in shown.stdout, "lost and back: no fault, yet faulted"
    supervisor.answers["status"] = lambda: status() | {"activity": "holding"}
    shown = mrr("fault")
    assert (shown.returncode, shown.stdout) == (0, "No faults.\n")


def test_monitor_in_a_pipe_is_a_table_of_samples(supervisor, mrr):
    shown = mrr("monitor", "--count", "3", "--period", "0.01")
    rows = [line.split("\t") for line in shown.stdout.splitlines()]
    assert shown.returncode == 0 and len(rows) == 4 and {len(row) for row in rows} == {2 + 4 * 3}
    assert rows[0][:4] == ["time_s", "activity", "joint_1_mode", "joint_1_position_deg"] and rows[1][0] == "12.750"
    assert "\x1b" not in shown.stdout


@pytest.mark.parametrize("locale", ["C", "C.UTF-8"])
def test_monitor_on_a_terminal_draws_bars_that_fit(supervisor, program, locale):
    ours, theirs = pty.openpty()
    child = subprocess.Popen([program("cli/mrr"), "monitor", "-n", "4", "--period", "0.01", "--socket", supervisor.path],
                             stdout=theirs, env={**os.environ, "LC_ALL": locale})
    os.close(theirs)
    seen = b""
    while True:
        try:
            chunk = os.read(ours, 65536)
        except OSError:
            break
        seen += chunk
    assert child.wait(timeout=10) == 0
    text = seen.decode()
    assert text.count("\x1b[?25l") == text.count("\x1b[?25h") == 1, "the cursor is back"
    plain = re.sub(r"\x1b\[[?0-9]*[A-Za-z]", "", text).replace("\r", "")
    assert "[" in plain and "#" in plain and "joint_3" in plain and max(map(len, plain.splitlines())) <= 80
    assert (max(map(ord, plain)) > 127) == (locale == "C.UTF-8")


def test_log_prints_what_was_asked_for(supervisor, mrr):
    supervisor.answers["log"] = lambda: {"lines": [{"time_s": 1.5, "level": "warning", "text": "joint_3 is lost"}]}
    shown = mrr("log", "-n", "7")
    assert ("log", {"count": 7}) in supervisor.asked and re.search(r"1\.500 s  warning  joint_3 is lost", shown.stdout)


@pytest.mark.parametrize("command", ["status", "enable", "fault", "log", "monitor", "move 1=1deg", "hammer --bus vcan0"])
def test_without_a_supervisor_each_says_who_is_missing_and_where(mrr, command):
    ended = mrr(*command.split())
    assert ended.returncode == 1 and "no mrr_supervisor is running there" in ended.stderr and ended.stderr.count("\n") == 1


# --- help, manual and completion are one tree

def commands(mrr):
    return re.findall(r"^  ([a-z]+) ", mrr("--help").stdout.split("Subcommands:")[1].split("Exit status")[0], flags=re.MULTILINE)


def test_help_fits_80_columns_everywhere(mrr):
    names = commands(mrr)
    assert {"hammer", "status", "enable", "home", "move", "passive", "active", "stop", "fault", "reset", "monitor", "log", "doctor"} <= set(names)
    for name in [None, *names]:
        text = mrr(*([name] if name else []), "--help").stdout
        assert max(map(len, text.splitlines())) <= 80, name


def test_every_option_in_help_is_in_the_manual_and_in_completion(mrr):
    bash = mrr("completion", "bash").stdout
    fish = mrr("completion", "fish").stdout
    zsh = mrr("completion", "zsh").stdout
    for name in commands(mrr):
        options = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", mrr(name, "--help").stdout.split("Options:")[1].split("Exit status")[0]))
        assert "--help" in options
        page = mrr("man", name).stdout.replace("\\-", "-")
        for option in options:
            assert option in page, f"{option} is not in mrr-{name}.1"
            assert option in bash and option in zsh and f"-l {option[2:]}" in fish


def test_manual_pages_are_sound_roff(mrr, tmp_path):
    assert mrr("man", "--folder", tmp_path / "man").returncode == 0
    pages = sorted((tmp_path / "man").iterdir())
    assert {page.name for page in pages} == {"mrr.1", *(f"mrr-{name}.1" for name in commands(mrr))}
    for page in pages:
        shown = subprocess.run(["man", "--warnings", "-E", "UTF-8", "-l", page], capture_output=True, text=True,
                               env={**os.environ, "MANWIDTH": "80", "PAGER": "cat"})
        assert shown.returncode == 0 and shown.stderr == "", f"{page.name}: {shown.stderr}"
        assert "EXIT STATUS" in shown.stdout


def test_bash_completes_commands_options_and_values(mrr):
    script = mrr("completion", "bash").stdout

    def complete(*words):
        words = " ".join(f"'{word}'" for word in ("mrr", *words))
        ask = f"{script}\nCOMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); _mrr; printf '%s\\n' \"${{COMPREPLY[@]}}\""
        out = subprocess.run(["bash", "--norc", "-c", ask], capture_output=True, text=True)
        assert out.returncode == 0 and out.stderr == "", out.stderr
        return out.stdout.split()

    assert complete("ha") == ["hammer"]
    assert set(complete("hammer", "--mode", "")) == {"planned", "never", "always"}
    assert complete("move", "--sp") == ["--speed"]
    assert set(complete("completion", "")) >= {"bash", "zsh", "fish"}


@pytest.mark.parametrize("arguments, word", [(("nonsense",), "no command 'nonsense'"), (("home",), "JOINT or --all"), (("move",), "TARGET"),
                                             (("home", "1", "--all"), "excludes"), (("log", "-n", "0"), "--count"),
                                             (("status", "--period", "1"), "--watch"), (("hammer", "--socket", "x"), "--bus"),
                                             (("hammer", "--experiment", "--board", "hardwood"), "excludes"),
                                             (("hammer", "--experiment", "--mode", "never"), "excludes"),
                                             (("hammer", "--experiment", "--swings", "1"), "excludes"),
                                             (("hammer", "--experiment", "--as-printed"), "excludes"),
                                             (("man", "nonsense"), "no such command"), (("completion", "tcsh"), "tcsh")])
def test_unusable_input_ends_with_2_and_one_line(mrr, arguments, word):
    ended = mrr(*arguments)
    assert ended.returncode == 2 and word in ended.stderr and ended.stderr.count("\n") == 1, ended.stderr
    assert ended.stdout == ""

# ---------------------------------------------------------------------------------------------- calibrate


@pytest.fixture
def robot_folder(tmp_path, source_dir):
    folder = tmp_path / "mrr3"
    folder.mkdir()
    for name in ("robot.urdf", "robot.yaml"):
        (folder / name).write_bytes((source_dir / "robots/mrr3" / name).read_bytes())
    return folder


def fit(**changes):
    direction = {"coulomb_nm": 3.5, "static_nm": 4.2, "stribeck_decay_s2_rad2": 1000.0, "viscous_nm_s_rad": 1.8}
    other = {**direction, "coulomb_nm": 4.5, "static_nm": 5.0}
    return {"positive": direction, "negative": other, "torque_constant_positive_nm_a": 0.1952, "torque_constant_negative_nm_a": 0.2464,
            "residual_nm": 0.08, "points": 60, **changes}


def calibration(what="friction", **changes):
    return {"command": 5, "joint": "joint_3", "what": what, "state": "done", "reason": "", "progress_percent": 100,
            "travel_rad": 0.3 if what == "friction" else None, "speed_rad_s": 1.0 if what == "friction" else None,
            "load_nm": 3.1 if what == "torque-zero" else None, "friction": fit() if what == "friction" else None,
            "torque_offset_nm": 0.31 if what == "torque-zero" else None, "slip_rad": 0.001 if what == "brake" else None, **changes}


@pytest.fixture
def calibrating(supervisor, robot_folder):
    """Answers `calibrate` with what `result` holds."""
    result = {}

    def set_result(*arguments, **changes):
        result.update(calibration(*arguments, **changes))

    supervisor.answers["hello"] = lambda: {**hello(), "robot": {**hello()["robot"], "source": str(robot_folder)}}
    supervisor.answers["calibrate"] = lambda: {"command": 5}
    supervisor.answers["calibration"] = lambda: dict(result)
    supervisor.after["calibrate"] = [done()]
    set_result()
    return set_result


def changed(folder, source_dir):
    """Lines that robot.yaml has and the example has not."""
    before = (source_dir / "robots/mrr3/robot.yaml").read_text().splitlines()
    after = (folder / "robot.yaml").read_text().splitlines()
    return [b.strip() for a, b in zip(before, after) if a != b] if len(before) == len(after) else [b.strip() for b in after if b not in before]


def test_calibrate_shows_the_fit_and_a_diff_and_writes_nothing_unasked(supervisor, mrr, calibrating, robot_folder, source_dir):
    ended = mrr("calibrate", "joint_3", "--travel", "0.2")
    assert ended.returncode == 0, ended.stderr
    assert ("calibrate", {"joint": "joint_3", "what": "friction", "travel_rad": 0.2}) in supervisor.asked
    assert "residual 0.080 Nm rms over 60 points" in ended.stdout and "Nothing was written" in ended.stdout
    assert "-      coulomb: 3.9 Nm                  # [I]" in ended.stdout and "+      coulomb: 4 Nm                    # [I]" in ended.stdout
    assert f"--- {robot_folder}/robot.yaml" in ended.stdout and "@@ -" in ended.stdout and "\x1b" not in ended.stdout
    assert changed(robot_folder, source_dir) == []
    # What patch makes of the diff is what --write writes.
    diff = ended.stdout[ended.stdout.index("---"):ended.stdout.index("Nothing")]
    patched = subprocess.run(["patch", "-s", "-o", "-", str(robot_folder / "robot.yaml")], input=diff, capture_output=True, text=True)
    assert patched.returncode == 0, patched.stdout + patched.stderr
    assert mrr("calibrate", "3", "--write").returncode == 0
    assert (robot_folder / "robot.yaml").read_text() == patched.stdout


def test_calibrate_write_keeps_everything_else_and_says_what_to_do_next(supervisor, mrr, calibrating, robot_folder, source_dir):
    ended = mrr("calibrate", "joint_3", "--write")
    assert ended.returncode == 0 and "restart modules and supervisor, and an emulator" in " ".join(ended.stdout.split()), ended.stderr
    assert changed(robot_folder, source_dir) == [
        "torque_constant_positive: 0.1952 Nm/A", "torque_constant_negative: 0.2464 Nm/A", "coulomb: 4 Nm                    # [I]",
        "stribeck_decay: 1000 s^2/rad^2   # [I]", "viscous: 1.8 Nm s/rad            # [I]"]
    again = mrr("calibrate", "joint_3", "--write")
    assert again.returncode == 0 and "says so already" in again.stdout


def test_calibrate_refuses_to_write_what_would_not_be_a_robot(supervisor, mrr, calibrating, robot_folder, source_dir):
    calibrating(friction=fit(torque_constant_positive_nm_a=0.15))
    ended = mrr("calibrate", "joint_3", "--write")
    assert ended.returncode == 1 and "peak_current" in ended.stderr and "--keep-torque-constants" in ended.stderr
    assert changed(robot_folder, source_dir) == []
    ended = mrr("calibrate", "joint_3", "--write", "--keep-torque-constants")
    assert ended.returncode == 0, ended.stderr
    assert not any("torque_constant" in line for line in changed(robot_folder, source_dir))


def test_a_poor_fit_is_shown_and_not_written(supervisor, mrr, calibrating, robot_folder, source_dir):
    calibrating(state="failed", reason="the fit leaves too much unexplained")
    supervisor.after["calibrate"] = [done("failed", "the fit leaves too much unexplained")]
    ended = mrr("calibrate", "joint_3", "--write")
    assert ended.returncode == 1 and "too much unexplained" in ended.stderr and "residual" in ended.stdout
    assert changed(robot_folder, source_dir) == []


def test_torque_zero_goes_into_a_section_of_its_own(supervisor, mrr, calibrating, robot_folder, source_dir):
    calibrating("torque-zero")
    shown = json.loads(mrr("calibrate", "joint_3", "--what", "torque-zero", "--write", "--json").stdout)
    assert shown["written"] and shown["file"] == str(robot_folder / "robot.yaml") and shown["result"]["torque_offset_nm"] == 0.31
    assert "+    calibration: {torque_offset: 0.310 Nm}" in shown["diff"].splitlines()
    assert changed(robot_folder, source_dir) == ["calibration: {torque_offset: 0.310 Nm}"]


def test_the_brake_test_writes_nothing(supervisor, mrr, calibrating, robot_folder, source_dir):
    calibrating("brake")
    ended = mrr("calibrate", "joint_3", "--what", "brake", "--torque", "20", "--write")
    assert ended.returncode == 0 and "gave way by 1.00 mrad" in ended.stdout
    assert ("calibrate", {"joint": "joint_3", "what": "brake", "torque_nm": 20.0}) in supervisor.asked
    assert changed(robot_folder, source_dir) == []


def test_ctrl_c_stops_a_calibration(supervisor, program, calibrating):
    calibrating(state="running", progress_percent=42)
    supervisor.after["calibrate"] = []
    supervisor.answers["status"] = lambda: {**status(), "command": {"number": 5, "method": "calibrate", "state": "running", "reason": ""}}
    child = subprocess.Popen([program("cli/mrr"), "calibrate", "joint_3", "--socket", supervisor.path], stdout=subprocess.PIPE,
                             stderr=subprocess.PIPE, text=True)
    assert "42 %" in child.stdout.readline()
    child.send_signal(signal.SIGINT)
    assert child.wait(timeout=10) == 130 and "the robot was stopped" in child.stderr.read()
    assert ("stop", {}) in supervisor.asked


ENVELOPES = [b"hello", b"", b"5", b"[]", b"{}", b'{"jsonrpc":"2.0","id":1,"error":"x"}', b'{"jsonrpc":"2.0","id":1,"error":{"code":"x","message":3}}',
             b'{"jsonrpc":"2.0","id":1,"result":null}', b'{"jsonrpc":"2.0","id":1,"result":{}}', b'{"jsonrpc":"2.0","id":1,"result":[]}',
             b'{"jsonrpc":"2.0","id":1,"result":{"interface_version":"one"}}', b'{"jsonrpc":"2.0","id":1,"result":1e999}',
             b'{"jsonrpc":"2.0","id":1,"result":{"interface_version":1}}', b'{"jsonrpc":"2.0","id":1,"result":{"a":"\xff"}}', b"[" * 100000]


@pytest.mark.parametrize("line", ENVELOPES, ids=lambda line: line[:40].decode("latin-1"))
def test_a_strange_answer_is_told_and_is_no_defect(mrr, tmp_path, line):
    """Something else listens there, or another version."""
    server = socket.socket(socket.AF_UNIX)
    server.bind(str(tmp_path / "supervisor.sock"))
    server.listen()

    def answer():
        while True:
            try:
                client, _ = server.accept()
            except OSError:
                return
            with client, client.makefile("rwb") as lines:
                try:
                    for _ in lines:
                        lines.write(line + b"\n")
                        lines.flush()
                except OSError:
                    pass

    threading.Thread(target=answer, daemon=True).start()
    try:
        run = mrr("status")
    finally:
        server.close()
    assert run.returncode == 1 and run.stderr.startswith("mrr: ") and run.stderr.count("\n") == 1, run.stderr


def test_a_supervisor_of_another_interface_version_is_refused_but_for_stop(mrr, supervisor):
    supervisor.answers["hello"] = lambda: {**hello(), "interface_version": 2}
    supervisor.check = lambda *_: None
    for arguments in (("status",), ("enable", "--no-wait"), ("move", "1=0.1rad", "--no-wait")):
        run = mrr(*arguments)
        assert run.returncode == 1 and "interface version 2" in run.stderr, run.stderr
    assert mrr("stop", "--no-wait").returncode == 0


@pytest.mark.parametrize("name, arguments", [
    ("cli/mrr", ("status", "--socket", "")), ("cli/mrr", ("hammer", "--out", "")), ("cli/mrr", ("hammer", "--bus", "")),
    ("supervisor/daemon/mrr_supervisor", ("--robot", "mrr3", "--can", "")), ("supervisor/daemon/mrr_supervisor", ("--robot", "mrr3", "--plant", "")),
    ("module_fw/targets/linux/mrr_module", ("--robot", "mrr3", "--joint", "1", "--can", "")),
    ("module_fw/targets/linux/mrr_module", ("--robot", "mrr3", "--joint", "1", "--plant", "")),
    ("sim_vcan/targets/mrr_plant", ("--robot", "mrr3", "--plant", "vcan1", "--socket", "")),
], ids=lambda value: value if isinstance(value, str) else " ".join(value))
def test_an_option_with_an_empty_value_is_refused_by_name(program, name, arguments):
    run = subprocess.run([program(name), *arguments], capture_output=True, text=True, timeout=30)
    option = arguments[arguments.index("") - 1]
    assert run.returncode == 2 and option in run.stderr and "empty" in run.stderr, run.stderr

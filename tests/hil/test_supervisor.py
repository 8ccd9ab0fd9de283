"""mrr_supervisor as a process on vcan, with three modules and the emulator in lockstep: bring-up, commands, faults, what
happens when somebody is killed, and the RPC socket as strangers and careless clients find it."""

import functools
import json
import os
import signal
import socket
import stat
import subprocess
import time

import jsonschema
import pytest
import referencing
import referencing.jsonschema

from conftest import ROBOT, ROOT, program, wait_until

SUPERVISOR = "supervisor/daemon/mrr_supervisor"


@functools.cache
def schema(name):
    """A validator of one definition in docs/rpc.schema.json."""
    whole = json.loads((ROOT / "docs" / "rpc.schema.json").read_text())
    assert name in whole["$defs"], f"docs/rpc.schema.json has no {name}"
    result = json.loads((ROOT / "docs" / "result.schema.json").read_text())
    others = referencing.Registry().with_resource(
        "result.schema.json", referencing.Resource.from_contents(result, referencing.jsonschema.DRAFT202012))
    return jsonschema.Draft202012Validator({"$ref": f"#/$defs/{name}", "$defs": whole["$defs"]}, registry=others)


CALLED_WRONGLY = -32600, -32601, -32602


class Rpc:
    """A plain JSON-RPC client of its own, so that a mistake of ours at both ends shows. What mrr_supervisor says, and what it
    takes for a request, are held against docs/rpc.schema.json (`checked`)."""

    def __init__(self, path, checked=True):
        self.checked = checked
        end = time.monotonic() + 10
        while True:  # the file is there a moment before somebody listens, or was left by one that was killed
            self.socket = socket.socket(socket.AF_UNIX)
            self.socket.settimeout(10)
            try:
                self.socket.connect(str(path))
                break
            except ConnectionRefusedError:
                self.socket.close()
                assert time.monotonic() < end, f"nobody listens on {path}"
                time.sleep(0.05)
        self.file = self.socket.makefile("rb")
        self.number = 0
        self.events = []

    def send(self, line):
        self.socket.sendall(line + b"\n")

    def answer(self):
        while True:
            message = json.loads(self.file.readline())
            if not isinstance(message, dict) or message.get("method") != "event":
                return message
            if self.checked:
                schema("notification").validate(message)
            self.events.append(message["params"])

    def call(self, method, **params):
        """The whole answer."""
        self.number += 1
        request = {"jsonrpc": "2.0", "id": self.number, "method": method, "params": params}
        self.send(json.dumps(request).encode())
        answer = self.answer()
        if self.checked:
            schema("answer").validate(answer)
            if answer.get("error", {}).get("code") not in CALLED_WRONGLY:
                schema("request").validate(request)
        assert answer["id"] == self.number
        return answer

    def get(self, method, **params):
        answer = self.call(method, **params)
        assert "result" in answer, answer["error"]["message"]
        if self.checked:
            schema(f"{method}_result").validate(answer["result"])
        return answer["result"]

    def refused(self, method, **params):
        """Code and sentence of the error."""
        error = self.call(method, **params)["error"]
        return error["code"], error["message"]

    def wait(self, condition, limit_s=30.0):
        """The first status for which `condition` holds."""
        end = time.monotonic() + limit_s
        while True:
            status = self.get("status")
            if condition(status):
                return status
            assert time.monotonic() < end, f"waited {limit_s} s; {json.dumps(status, indent=1)}"
            time.sleep(0.02)

    def command(self, method, limit_s=120.0, **params):
        """Runs a command to its end; the status then."""
        number = self.get(method, **params)["command"]
        status = self.wait(lambda s: s["command"]["number"] != number or s["command"]["state"] != "running", limit_s)
        assert status["command"]["number"] == number
        return status

    def done(self, method, **params):
        status = self.command(method, **params)
        assert status["command"]["state"] == "done", status["command"]["reason"]
        return status


class Whole:
    """Supervisor, modules and plant of the example robot."""

    def __init__(self, robot, joints=(1, 2, 3), supervisor_robot=ROBOT, ledger=None):
        self.robot = robot
        self.socket = robot.folder / "supervisor.sock"
        self.plant = robot.plant("--lockstep")
        self.modules = {joint: robot.module(joint) for joint in joints}
        self.arguments = ["--robot", supervisor_robot, "--can", "vcan0", "--plant", "vcan1", "--socket", self.socket]
        if ledger:
            self.arguments += ["--ledger", ledger]
        self.start_supervisor()

    def start_supervisor(self):
        self.supervisor = self.robot.start(SUPERVISOR, *self.arguments)
        wait_until(self.socket.exists, what="the supervisor's socket")
        self.rpc = Rpc(self.socket)

    def ticking(self):
        self.rpc.wait(lambda s: s["clock"]["running"])
        return self


@pytest.fixture
def whole(fresh_robot):
    return Whole(fresh_robot).ticking()


def joint(status, number):
    return status["joints"][number - 1]


def test_bring_up_move_passive_and_disable(whole):
    rpc = whole.rpc
    hello = rpc.get("hello")
    assert hello["interface_version"] == 1 and [j["node_id"] for j in hello["robot"]["joints"]] == [2, 3, 4]
    assert rpc.get("status")["activity"] == "disabled"
    assert rpc.refused("move", positions_rad=[0.1, None, None])[0] == 1
    status = rpc.done("enable")
    assert status["ready"] and all(j["stage"] == "enabled" and j["following"] for j in status["joints"])
    assert all(j["state"] == "operation enabled" and j["fault"] is None for j in status["joints"])
    before = joint(status, 1)["position_rad"]
    status = rpc.done("move", positions_rad={"joint_1": before + 0.2}, speed=0.5)
    assert joint(status, 1)["position_rad"] == pytest.approx(before + 0.2, abs=5e-3)
    code, message = rpc.refused("move", positions_rad={"joint_1": 99})
    assert code == 3 and "joint_1" in message and "99" in message
    status = rpc.done("passive", joint=1)
    assert status["activity"] == "passive" and joint(status, 1)["mode"] == -1
    assert rpc.refused("move", positions_rad=[0, 0, 0])[0] == 2
    rpc.wait(lambda s: s["activity"] == "holding")
    assert rpc.refused("active", joint=1)[0] == 6
    assert rpc.refused("passive", joint="elbow")[0] == 4
    status = rpc.done("disable")
    assert status["activity"] == "disabled" and not any(j["state"] == "operation enabled" for j in status["joints"])


def test_a_hammer_job_drives_the_nail_flush_and_is_recorded(whole):
    rpc = whole.rpc
    rpc.get("subscribe", events=["swing", "job"])
    assert rpc.get("hammer", seed=1)["job"] == 1
    assert rpc.refused("hammer")[0] == 2
    status = rpc.wait(lambda s: s["job"]["state"] == "done", 90)
    job = rpc.get("job")
    assert job["verdict"] == "flush", job["reason"]
    assert len(job["swings"]) == status["job"]["swings"] >= 1
    assert all(swing["aborted"] is None for swing in job["swings"])
    assert job["nail_height_mm"] < 0.5
    kinds = [event["kind"] for event in rpc.events]
    assert kinds.count("swing") == len(job["swings"]) and kinds[-1] == "job"
    first = rpc.get("recording", max_rows=2)
    assert first["dropped_rows"] == 0 and first["total_rows"] > 1000 and not first["complete"]
    last = rpc.get("recording", from_row=first["total_rows"] - 1)
    assert last["complete"] and len(last["rows"]) == 1
    steps = last["rows"][0][0] - first["rows"][0][0]
    assert round(steps * 1000) == first["total_rows"] - 1, "a row each millisecond"
    assert status["bus"]["transmit_failures"] == 0 and status["bus"]["state"] == "up"


def test_every_joint_of_the_example_finds_its_switch(whole):
    """From where the robot starts, one after the other and each back to where it was: nothing may be in the way."""
    rpc = whole.rpc
    plant = Rpc(whole.robot.folder / "plant.sock", checked=False)
    status = rpc.done("enable")
    start = [j["position_rad"] for j in status["joints"]]
    for number, (switch, tolerance) in {3: (2.3, 0.02), 2: (2.1, 0.02), 1: (-2.8, 0.02)}.items():
        status = rpc.done("home", joint=number)
        assert joint(status, number)["homed"] and all(j["fault"] is None for j in status["joints"])
        assert joint(status, number)["position_rad"] == pytest.approx(switch, abs=tolerance)
        assert plant.get("truth")["contacts"] == 0, f"joint {number} met something on its way"
        rpc.wait(lambda s: s["activity"] == "holding")
        rpc.done("move", positions_rad=start, speed=0.8)


def test_stop_ends_a_job(whole):
    rpc = whole.rpc
    rpc.get("hammer")
    rpc.wait(lambda s: s["activity"] in ("approaching", "swinging"))
    rpc.done("stop")
    status = rpc.wait(lambda s: s["job"]["state"] == "done")
    assert status["job"]["verdict"] == "swing_aborted" and status["activity"] == "holding"


def test_a_missing_module_is_named_and_the_others_come_up(fresh_robot):
    # The plant goes on without it when it has waited long enough: it is started for two joints only.
    whole = Whole.__new__(Whole)
    whole.robot, whole.socket = fresh_robot, fresh_robot.folder / "supervisor.sock"
    fresh_robot.plant("--lockstep")
    for number in (1, 2, 3):
        process = fresh_robot.module(number)
    supervisor = fresh_robot.start(SUPERVISOR, "--robot", ROBOT, "--can", "vcan0", "--plant", "vcan1", "--socket", whole.socket)
    wait_until(whole.socket.exists, what="the supervisor's socket")
    rpc = Rpc(whole.socket)
    rpc.wait(lambda s: s["clock"]["running"])
    process.popen.kill()
    process.popen.wait()
    fresh_robot.processes.remove(process)
    rpc.wait(lambda s: joint(s, 3)["stage"] in ("lost", "absent"))
    status = rpc.command("enable")
    assert status["command"]["state"] == "failed" and "joint_3" in status["command"]["reason"]
    assert joint(status, 1)["stage"] == joint(status, 2)["stage"] == "enabled"
    assert joint(status, 1)["following"]
    code, message = rpc.refused("move", positions_rad=[0.1, None, None])
    assert code == 1 and "joint_3" in message and "joint_1" not in message
    assert supervisor.alive()


def test_a_killed_module_that_comes_back_is_braked_until_reset(whole):
    rpc = whole.rpc
    rpc.done("enable")
    victim = whole.modules[2]
    victim.popen.kill()
    victim.popen.wait()
    whole.robot.processes.remove(victim)
    status = rpc.wait(lambda s: s["activity"] == "faulted")
    assert joint(status, 2)["stage"] == "lost" and joint(status, 1)["stage"] == "enabled"
    assert "joint_2" in rpc.get("faults")["active"][0]["text"]
    whole.robot.module(2)
    status = rpc.wait(lambda s: joint(s, 2)["stage"] == "idle")
    time.sleep(0.5)
    status = rpc.get("status")
    assert joint(status, 2)["stage"] == "idle" and status["activity"] == "faulted", "enabled without a reset"
    code, message = rpc.refused("enable")
    assert code == 1 and "reset" in message
    position = joint(status, 2)["position_rad"]
    status = rpc.done("reset")
    assert status["activity"] == "holding"
    assert joint(status, 2)["position_rad"] == pytest.approx(position, abs=0.02), "a jump on coming back"


def test_modules_brake_by_themselves_when_the_supervisor_is_killed(whole):
    rpc = whole.rpc
    rpc.done("enable")
    whole.supervisor.popen.kill()
    whole.supervisor.popen.wait()
    whole.robot.processes.remove(whole.supervisor)
    time.sleep(3)  # the plant notices, goes on without it, and the modules' heartbeat watchdogs run out
    whole.robot.start(SUPERVISOR, "--robot", ROBOT, "--can", "vcan0", "--plant", "vcan1", "--socket", whole.socket)
    rpc = Rpc(whole.socket)
    status = rpc.wait(lambda s: s["clock"]["running"] and all(j["stage"] == "faulted" for j in s["joints"]))
    assert not any(j["state"] == "operation enabled" for j in status["joints"])
    rpc.done("reset")
    assert rpc.done("enable")["activity"] == "holding"


def test_sigterm_lets_go_of_the_joints_and_removes_the_socket(whole):
    whole.rpc.done("enable")
    began = time.monotonic()
    whole.supervisor.stop()
    assert time.monotonic() - began < 5
    assert not whole.socket.exists()
    assert "the joints are let go of" in whole.supervisor.text()
    plant = Rpc(whole.robot.folder / "plant.sock", checked=False)
    before = plant.get("truth")["ticks"]
    wait_until(lambda: plant.get("truth")["ticks"] > before, what="the plant to go on without the supervisor")
    whole.plant.wait_for("supervisor leaves in order")
    assert "left out" not in whole.plant.text()


def test_sigterm_does_not_wait_for_a_joint_that_is_gone(whole):
    whole.rpc.done("enable")
    victim = whole.modules.pop(3)
    victim.popen.kill()
    victim.popen.wait()
    whole.robot.processes.remove(victim)
    whole.rpc.wait(lambda s: joint(s, 3)["stage"] == "lost")
    began = time.monotonic()
    whole.supervisor.stop()
    assert time.monotonic() - began < 3


def test_another_configuration_is_refused_by_name(fresh_robot, tmp_path):
    changed = tmp_path / "mrr3"
    changed.mkdir()
    for file in ROBOT.iterdir():
        if file.is_file():
            changed.joinpath(file.name).write_bytes(file.read_bytes())
    text = (changed / "robot.yaml").read_text()
    assert "gear_ratio: 133" in text
    (changed / "robot.yaml").write_text(text.replace("gear_ratio: 133", "gear_ratio: 132", 1))
    whole = Whole(fresh_robot, supervisor_robot=changed).ticking()
    status = whole.rpc.wait(lambda s: joint(s, 1)["stage"] == "refused" and joint(s, 2)["stage"] == "idle")
    assert "configuration" in joint(status, 1)["problem"]
    began_s = whole.rpc.get("status")["time_s"]
    status = whole.rpc.command("enable")
    assert status["command"]["state"] == "failed" and "joint_1" in status["command"]["reason"]
    assert "joint_2" not in status["command"]["reason"] and status["time_s"] - began_s < 2, "it waited for what cannot be"
    assert joint(status, 1)["stage"] == "refused" and joint(status, 2)["stage"] == "enabled"
    whole.rpc.get("hammer")
    status = whole.rpc.wait(lambda s: s["job"]["state"] == "done")
    job = whole.rpc.get("job")
    assert job["verdict"] == "not_ready" and "joint_1" in job["reason"] and "configuration" in job["reason"]
    assert job["ended_s"] - job["began_s"] < 1


def test_the_socket_is_private_and_survives_careless_clients(whole):
    assert stat.S_IMODE(os.stat(whole.socket).st_mode) == 0o600
    rpc = whole.rpc
    for line, code in ((b"{", -32700), (b"\xff\xfe", -32700), (b"[1]", -32600), (b'{"jsonrpc":"2.0","id":1}', -32600),
                       (b'{"jsonrpc":"2.0","id":1,"method":"jump"}', -32601),
                       (b'{"jsonrpc":"2.0","id":1,"method":"home","params":{}}', -32602),
                       (b'{"jsonrpc":"2.0","id":1,"method":"home"}', -32602),
                       (b'{"jsonrpc":"2.0","id":1,"method":"move","params":{"positions_rad":"up"}}', -32602),
                       (b'{"jsonrpc":"2.0","id":1,"method":"hammer","params":{"swings":0}}', -32602),
                       (b'{"jsonrpc":"2.0","id":1,"method":"status","params":{"x":1}}', -32602)):
        rpc.send(line)
        answer = rpc.answer()
        answer = answer[0] if isinstance(answer, list) else answer
        assert answer["error"]["code"] == code, line
        if code != -32700:
            assert not schema("request").is_valid(json.loads(line)) and not schema("batch").is_valid(json.loads(line)), line
    stranger = Rpc(whole.socket)
    try:
        stranger.send(b'{"jsonrpc":"2.0","id":1,"method":"' + b"x" * 70000 + b'"}')
        assert stranger.answer()["error"]["code"] == -32600
    except (OSError, ValueError):
        pass  # closed on us: as good
    assert rpc.get("status")["activity"] == "disabled"


def test_a_second_supervisor_is_refused(whole):
    again = subprocess.run([program(SUPERVISOR), "--robot", ROBOT, "--can", "vcan0", "--plant", "vcan1", "--socket", whole.socket],
                           capture_output=True, text=True, timeout=20)
    assert again.returncode == 2 and str(whole.socket) in again.stderr, again.stderr
    other = whole.robot.folder / "other.sock"
    again = subprocess.run([program(SUPERVISOR), "--robot", ROBOT, "--can", "vcan0", "--plant", "vcan1", "--socket", other],
                           capture_output=True, text=True, timeout=20)
    assert again.returncode == 2 and "another supervisor" in again.stderr, again.stderr
    assert not other.exists()
    assert whole.rpc.get("status")["clock"]["running"]


def test_real_time_without_modules_counts_cycles_and_reports_a_bus_that_goes_down(fresh_robot):
    path = fresh_robot.folder / "supervisor.sock"
    supervisor = fresh_robot.start(SUPERVISOR, "--robot", ROBOT, "--can", "vcan0", "--socket", path)
    wait_until(path.exists, what="the supervisor's socket")
    rpc = Rpc(path)
    first = rpc.wait(lambda s: s["clock"]["cycles"] > 0)
    time.sleep(1)
    second = rpc.get("status")
    made = second["clock"]["cycles"] + second["clock"]["missed"] - first["clock"]["cycles"] - first["clock"]["missed"]
    assert made == pytest.approx((second["time_s"] - first["time_s"]) * 1000, abs=5)
    assert second["clock"]["late_us"]["max"] > 0
    assert all(j["stage"] == "absent" for j in second["joints"])
    try:
        subprocess.run(["ip", "link", "set", "vcan0", "down"], check=True)
        status = rpc.wait(lambda s: s["bus"]["state"] == "down")
        assert "vcan0" in status["bus"]["problem"]
    finally:
        subprocess.run(["ip", "link", "set", "vcan0", "up"], check=True)
    rpc.wait(lambda s: s["bus"]["state"] == "up")
    assert supervisor.alive()
    supervisor.popen.send_signal(signal.SIGINT)
    assert supervisor.popen.wait(10) == 0


def test_what_the_gears_have_borne_is_kept_over_a_restart(fresh_robot):
    path = fresh_robot.folder / "ledger"
    whole = Whole(fresh_robot, ledger=path).ticking()
    ledger = whole.rpc.get("status")["ledger"]
    assert [joint["blows"] for joint in ledger["joints"]] == [0, 0, 0] and ledger["file"] == str(path)
    whole.rpc.done("enable")
    whole.rpc.get("hammer", swings=1)
    whole.rpc.wait(lambda s: s["job"] and s["job"]["state"] == "done")
    ledger = whole.rpc.get("status")["ledger"]
    assert ledger["problem"] is None
    assert all(joint["blows"] == 1 and joint["blows_not_seen"] == 0 and joint["life_share"] > 0 for joint in ledger["joints"][1:])
    assert ledger["joints"][1]["largest_peak_nm"] > 1.0
    assert path.stat().st_mode & 0o777 == 0o600
    whole.supervisor.stop()
    whole.start_supervisor()
    assert whole.ticking().rpc.get("status")["ledger"] == ledger
    whole.supervisor.stop()
    path.write_bytes(path.read_bytes()[:-7])  # torn
    refused = fresh_robot.start(SUPERVISOR, *whole.arguments)
    assert refused.popen.wait(10) == 2
    assert str(path) in refused.text()
    fresh_robot.processes.remove(refused)

"""Clients of the supervisor that do not read, that are interrupted, that ask for what cannot be; and what is recorded,
beside what was on the bus."""

import json
import os
import re
import signal
import subprocess

import cantools
import pytest

from conftest import BUILD, ROBOT, ROOT
from test_bus_tools import GENERATOR, dump, frames_of
from test_supervisor import Rpc, Whole

JOINTS = {"joint_1": 2, "joint_2": 3, "joint_3": 4}


@pytest.fixture
def whole(fresh_robot):
    return Whole(fresh_robot).ticking()


def test_every_refusal_has_its_number_its_name_and_a_sentence(whole):
    numbers = json.loads((ROOT / "docs" / "rpc.schema.json").read_text())["errors"]
    for method, params, name in (("move", {"positions_rad": [0.1, None, None]}, "not_ready"),
                                 ("passive", {"joint": "elbow"}, "unknown_joint"),
                                 ("passive", {"joint": 1}, "not_ready"),
                                 ("job", {"job": 7}, "no_job"),
                                 ("reset", {}, "nothing_to_do")):
        error = whole.rpc.call(method, **params)["error"]
        assert error["data"]["code"] == name and error["code"] == numbers[name], error
        assert re.fullmatch(r"[^\n]{10,}", error["message"]), error
    for method, params, code in (("no_such", {}, -32601), ("move", {}, -32602), ("hammer", {"swings": "two"}, -32602),
                                 ("home", {"joint": []}, -32602)):
        error = whole.rpc.call(method, **params)["error"]
        assert error["code"] == code and set(error) <= {"code", "message", "data"} and error["message"], error


@pytest.mark.slow
def test_a_client_that_does_not_read_loses_events_is_told_how_many_and_holds_up_nobody(whole):
    whole.rpc.get("hammer")
    whole.rpc.wait(lambda s: s["activity"] == "swinging", 90)
    slow = Rpc(whole.socket)
    slow.get("subscribe")
    # Answers to these alone are more than is kept for it.
    slow.send(json.dumps([{"jsonrpc": "2.0", "id": k, "method": "recording", "params": {"max_rows": 2000}}
                          for k in range(1000, 1016)]).encode())
    whole.rpc.wait(lambda s: s["job"]["state"] == "done", 120)  # nobody waits for it
    answers = json.loads(slow.file.readline())
    while isinstance(answers, dict):  # events from before
        answers = json.loads(slow.file.readline())
    assert [answer["id"] for answer in answers] == list(range(1000, 1016))
    whole.rpc.done("disable")
    slow.get("status")
    lost = [event["dropped"] for event in slow.events if event.get("dropped")]
    assert len(lost) == 1 and lost[0] > 3, slow.events


@pytest.mark.slow
def test_ctrl_c_in_mrr_hammer_stops_the_job_and_not_the_robot(whole, tmp_path):
    environment = {**os.environ, "MRR_RUNTIME_DIR": str(whole.robot.folder)}
    whole.robot.folder.chmod(0o700)
    hammer = subprocess.Popen([BUILD / "cli/mrr", "hammer", "--bus", "vcan0", "--no-report", "--out", tmp_path / "out"],
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        whole.rpc.wait(lambda s: s["activity"] == "swinging", 90)
        hammer.send_signal(signal.SIGINT)
        out, error = hammer.communicate(timeout=60)
    finally:
        hammer.kill()
        hammer.wait()
    assert hammer.returncode not in (0, 3), f"{hammer.returncode}\n{out}\n{error}"
    status = whole.rpc.wait(lambda s: s["job"]["state"] == "done" and s["activity"] == "holding", 30)
    assert status["ready"]
    job = whole.rpc.get("job")
    assert job["verdict"] == "swing_aborted" and "stop" in job["reason"], job["reason"]


@pytest.mark.slow
def test_what_is_recorded_is_what_the_bus_carried_decoded_by_the_dbc(whole, tmp_path):
    dbc = tmp_path / "robot.dbc"
    subprocess.run([*GENERATOR, "dbc", dbc, *(word for name, node in JOINTS.items() for word in ("--node", f"{name}={node}"))],
                   check=True)
    database = cantools.database.load_file(dbc)

    def job():
        whole.rpc.get("hammer", swings=1)
        whole.rpc.wait(lambda s: s["job"]["state"] == "done", 120)

    frames = frames_of(dump(tmp_path / "bus.log", job))
    columns, rows = None, []
    while columns is None or page["rows"]:
        page = whole.rpc.get("recording", from_row=len(rows), max_rows=2000)
        columns = page["columns"]
        rows += page["rows"]
    assert len(rows) > 2000
    rated_nm = {joint["name"]: joint["rated_nm"] for joint in whole.rpc.get("job")["swings"][0]["joints"]}

    def changes(values):
        return [value for k, value in enumerate(values) if k == 0 or value != values[k - 1]]

    for name, node in JOINTS.items():
        tpdo1, tpdo2 = (database.get_message_by_name(f"{name}_tpdo{n}") for n in (1, 2))
        said = [tpdo1.decode(data, decode_choices=False) for _, i, data in frames if i == 0x180 + node]
        told = [tpdo2.decode(data, decode_choices=False) for _, i, data in frames if i == 0x280 + node]
        bus = {"position [rad]": [round(s["position_actual_rad"] * 1e6) for s in said],
               "motor_velocity [rad/s]": [round(s["velocity_actual_rad_s"] * 1e6) for s in told],
               "sensed_torque [Nm]": [round(s["torque_actual_ratio"] * 1e3) for s in told],
               "passive [1]": [int(s["modes_of_operation_display"] == -1) for s in said]}
        scale = {"position [rad]": 1e6, "motor_velocity [rad/s]": 1e6, "sensed_torque [Nm]": 1e3 / rated_nm[name], "passive [1]": 1}
        for quantity, on_bus in bus.items():
            index = columns.index(f"{name}_{quantity}")
            recorded = changes([round(row[index] * scale[quantity]) for row in rows])
            on_bus = changes(on_bus)
            # The bus log begins before the job and ends after it.
            starts = [k for k, value in enumerate(on_bus) if value == recorded[0]]
            assert any(on_bus[k : k + len(recorded)] == recorded for k in starts), f"{name}_{quantity}"
            stands = (name, quantity) == ("joint_1", "position [rad]")  # but for noise: the blow needs joints 2 and 3 alone
            assert quantity == "passive [1]" or stands or len(recorded) > 50, f"{name}_{quantity}: nothing much happened"

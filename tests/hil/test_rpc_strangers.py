"""The supervisor's socket under generated lines and crowds, and where it is to be made; every answer held against the schema.
Free-running without modules: nothing can move."""

import json
import os
import random
import signal
import socket
import stat
import subprocess
import time

import pytest

from conftest import ROBOT, program, wait_until
from test_supervisor import SUPERVISOR, Rpc, schema

METHODS = [name for name in json.loads((ROBOT.parents[1] / "docs" / "rpc.schema.json").read_text())["methods"] if name != "shutdown"]
NAMES = ["joint", "positions_rad", "speed", "what", "travel_rad", "torque_nm", "mode", "swings", "seed", "as_printed", "job", "from_swing",
         "from_row", "max_rows", "count", "events", "x", ""]


@pytest.fixture(scope="module")
def path(robot):
    path = robot.folder / "supervisor.sock"
    robot.start(SUPERVISOR, "--robot", ROBOT, "--can", "vcan0", "--socket", path)
    wait_until(path.exists, what="the supervisor's socket")
    return path


def some(r, depth=0):
    """Any JSON value."""
    kind = r.randrange(12 if depth < 4 else 9)
    if kind < 9:
        return [None, True, r.randrange(-3, 5), r.choice([2**31, 2**63, 2**64, -2**63 - 1, 10**40]), r.choice([0.5, -0.0, 1e-320, 1e308]),
                r.choice(["joint_1", "planned", "friction", "status", ""]), "x" * r.randrange(300), "\u0000\x1b\ud83d\ude00é\u2028",
                r.choice([1, 2, 3])][kind]
    if kind == 9:
        return [some(r, depth + 1) for _ in range(r.randrange(5))]
    return {r.choice(NAMES): some(r, depth + 1) for _ in range(r.randrange(4))}


def request(r):
    asked = {"jsonrpc": "2.0", "id": r.randrange(1000), "method": r.choice(METHODS),
             "params": {r.choice(NAMES): some(r) for _ in range(r.randrange(3))}}
    if r.random() < 0.3:
        asked[r.choice(list(asked))] = some(r)
    if r.random() < 0.15:
        del asked[r.choice(list(asked))]
    return asked


def line(r):
    """Requests, batches, other JSON; some of it broken."""
    kind = r.randrange(10)
    value = request(r) if kind < 6 else [request(r) for _ in range(r.randrange(18))] if kind < 8 else some(r)
    text = json.dumps(value).encode()
    breakage = r.randrange(12)
    if breakage == 0:
        at = r.randrange(len(text) + 1)
        text = text[:at] + bytes(r.choice([b"\xff", b"\xc3", b"{", b"]", b"\x00", b'"'])) + text[at:]
    elif breakage == 1:
        text = text[: r.randrange(len(text) + 1)]
    elif breakage == 2:
        text = b"[" * r.randrange(1, 3000) + text
    elif breakage == 3 and text.startswith(b"{") and len(text) > 2:
        text = text[:-1] + b',"id":1,"id":2,"method":"status","params":{}}'  # keys twice
    elif breakage == 4:
        text = text.replace(b"1", b"1e999", 1)
    return text.replace(b"\n", b" ")


def test_generated_lines_are_answered_by_the_schema_and_harm_nobody(path):
    r = random.Random(301)
    witness, fuzzer = Rpc(path), Rpc(path)
    for _ in range(1500):
        sent = line(r)
        fuzzer.send(sent)
        # What comes back until the answer to this, which says that all before is done.
        fuzzer.send(b'{"jsonrpc":"2.0","id":"mark","method":"unsubscribe"}')
        while True:
            message = json.loads(fuzzer.file.readline())
            if isinstance(message, list):
                schema("batch_answer").validate(message)
                continue
            if message.get("method") == "event":
                schema("notification").validate(message)
                continue
            schema("answer").validate(message)
            assert message.get("error", {}).get("code") != -32603, (sent, message)
            if message["id"] == "mark":
                break
    assert witness.get("status")["clock"]["running"]


def test_keys_twice_the_last_one_counts(path):
    rpc = Rpc(path)
    rpc.send(b'{"jsonrpc":"2.0","id":1,"id":7,"method":"jump","method":"hello"}')
    answer = rpc.answer()
    assert answer["id"] == 7 and answer["result"]["interface_version"] == 1


def test_a_hundred_clients(path):
    """Sixteen are served, the others are told; when one goes there is room for another."""
    clients = []
    try:
        served, refused = [], 0
        for _ in range(100):
            client = socket.socket(socket.AF_UNIX)
            client.settimeout(10)
            client.connect(str(path))
            clients.append(client)
            try:
                client.sendall(b'{"jsonrpc":"2.0","id":1,"method":"hello"}\n')
                answer = json.loads(client.makefile("rb").readline())
            except (BrokenPipeError, ConnectionResetError):  # told and closed before we wrote
                refused += 1
                continue
            schema("answer").validate(answer)
            if "result" in answer:
                served.append(client)
            else:
                refused += 1
                assert "too many clients" in answer["error"]["message"]
        assert len(served) == 16 and refused == 84
        served[0].close()
        wait_until(lambda: serves(path), what="room for another client")
    finally:
        for client in clients:
            client.close()
    wait_until(lambda: serves(path), what="room for another client")


def serves(path):
    try:
        return "result" in Rpc(path).call("hello")
    except (OSError, KeyError, ValueError, AssertionError):
        return False


def test_subscribers_that_go_while_events_come(path):
    rpc = Rpc(path)
    for k in range(30):
        leaver = Rpc(path)
        leaver.get("subscribe")
        if k % 2:  # with an unread answer, so that the kernel resets
            leaver.send(b'{"jsonrpc":"2.0","id":9,"method":"status"}')
        rpc.get("enable")  # fails at once, with events
        leaver.file.close()
        leaver.socket.close()
    assert rpc.get("status")["activity"] in ("disabled", "bringing up")


def refusal(path, *more):
    run = subprocess.run([program(SUPERVISOR), "--robot", ROBOT, "--can", "vcan1", "--socket", path, *more], capture_output=True, text=True,
                         timeout=20)
    return run.returncode, run.stderr


def test_a_place_for_the_socket_that_cannot_be(path, tmp_path):
    (tmp_path / "file").write_text("mine")
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    for where, word in ((tmp_path / "file", "not a socket"), (tmp_path / "none" / "s.sock", "cannot be opened"), (shared / "s.sock", "0777"),
                        (tmp_path / ("x" * 120), "bytes"), ("", "--socket"), (path, "already")):
        status, said = refusal(where)
        assert status == 2 and word in said and said.count("\n") == 1, (where, status, said)
    assert (tmp_path / "file").read_text() == "mine"
    assert serves(path)


def test_a_socket_that_a_killed_one_left_is_replaced_and_sighup_ends_in_order(fresh_robot):
    path = fresh_robot.folder / "supervisor.sock"
    first = fresh_robot.start(SUPERVISOR, "--robot", ROBOT, "--can", "vcan1", "--socket", path)
    wait_until(path.exists, what="the socket")
    first.popen.kill()
    first.popen.wait()
    fresh_robot.processes.remove(first)
    assert path.exists()
    time.sleep(0.6)  # its heartbeat is over
    second = fresh_robot.start(SUPERVISOR, "--robot", ROBOT, "--can", "vcan1", "--socket", path)
    assert Rpc(path).get("hello")["pid"] == second.popen.pid
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    second.popen.send_signal(signal.SIGHUP)  # its terminal is closed
    assert second.popen.wait(10) == 0
    assert not path.exists()
    fresh_robot.processes.remove(second)

"""Tools that know nothing of us: candump, cangen, canplayer, tshark's CANopen dissector, cantools with the generated DBC."""

import os
import random
import re
import struct
import subprocess
import time

import cantools
import pytest
from conftest import ROOT, wait_until
from wire import Wire

NODE = 4
LOOP_OVERRUN = 0xFF09
PASSED_S = float(os.environ.get("MRR_CANGEN_SECONDS", "20"))  # of random frames; longer on request
GENERATOR = ["/usr/bin/python3", ROOT / "can_protocol" / "generate.py"]


def dump(path, seconds_of):
    """Records vcan0 with candump while `seconds_of` runs; with room for what comes while it has to wait for its turn."""
    with open(path, "wb") as out:
        process = subprocess.Popen(["candump", "-L", "-r", str(1 << 23), "vcan0"], stdout=out)
        try:
            time.sleep(0.3)
            seconds_of()
            time.sleep(0.2)
        finally:
            process.terminate()
            process.wait(5)
    return path


def frames_of(path):
    """[(seconds, id, data)] of a candump log; remote, extended and FD frames are not expected in it."""
    found = []
    for line in path.read_text().splitlines():
        match = re.fullmatch(r"\((\d+\.\d+)\) vcan0 ([0-9A-F]{3})#([0-9A-F]*)( [RT])?", line)
        assert match, line
        found.append((float(match[1]), int(match[2], 16), bytes.fromhex(match[3])))
    return found


@pytest.fixture(scope="module")
def recording(led_module, tmp_path_factory):
    """A session of every kind of frame: reset, parameters, operation, knots, selection, fault, emergency."""
    samples = []

    def session():
        with Wire("vcan0", node=NODE) as wire:
            wire.reset()
            wire.write(0x2003, 0, 20000, "I")
            wire.upload(0x1008)
            wire.operational()
            for k in range(40):
                wire.send(0x300 + NODE, struct.pack("<ii", -123456 + k, 1000))
                wire.send(0x400 + NODE, struct.pack("<ihH", 2000, -30, k))
                wire.sync()
                answer = wire.expect(0x180 + NODE)
                if k % 10 == 5:
                    samples.append((answer.data, wire.read(0x6064, form="i"), wire.read(0x6041)))
                time.sleep(0.015)
            wire.send(0x200 + NODE, struct.pack("<Hb", 6, 8))
            wire.send(0x181, struct.pack("<IBHB", 0xFFFFFFFF, 0, 0, 0x21))
            wire.write(0x2F00, 0, 0x2310, "H")
            wire.expect_emergency(0x2310)
            wire.send(0x701, [5])
            wire.reset()

    path = dump(tmp_path_factory.mktemp("bus") / "bus.log", session)
    return path, samples


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    path = tmp_path_factory.mktemp("dbc") / "robot.dbc"
    subprocess.run([*GENERATOR, "dbc", path, "--node", f"joint_3={NODE}"], check=True)
    return cantools.database.load_file(path)


def test_candump_sees_the_traffic(recording):
    ids = {i for _, i, _ in frames_of(recording[0])}
    for wanted in (0x000, 0x080, 0x181, *(base + NODE for base in (0x080, 0x180, 0x200, 0x280, 0x300, 0x380, 0x400, 0x580,
                                                                   0x600, 0x700))):
        assert wanted in ids, f"{wanted:03X}"


def test_cantools_decodes_every_frame(recording, database):
    for _, can_id, data in frames_of(recording[0]):
        message = database.get_message_by_frame_id(can_id)
        if can_id == 0x080:
            assert data == b"", "no counter was asked for"
            continue
        assert len(data) == message.length, message.name
        message.decode(data)


def test_values_and_units_agree_with_the_objects(recording, database):
    tpdo1 = database.get_message_by_name("joint_3_tpdo1")
    signal = tpdo1.get_signal_by_name("position_actual_rad")
    assert (signal.unit, signal.scale) == ("rad", 1e-6)
    path, samples = recording
    assert len(samples) == 4
    for data, position_urad, statusword in samples:
        decoded = tpdo1.decode(data)
        assert decoded["position_actual_rad"] == pytest.approx(position_urad * 1e-6, abs=2e-3)
        assert decoded["statusword"] == statusword
    sent = [d for _, i, d in frames_of(path) if i == 0x400 + NODE][0]
    assert database.get_message_by_name("joint_3_rpdo3").decode(sent) == {
        "target_acceleration_rad_s2": pytest.approx(2.0), "torque_offset_ratio": pytest.approx(-0.03), "knot_sequence": 0}
    emergency = [d for _, i, d in frames_of(path) if i == 0x080 + NODE and d[:2] == b"\x10\x23"][0]
    assert str(database.get_message_by_name("joint_3_emergency").decode(emergency)["emergency_code"]) == "over_current"


def pcap_of(frames, path):
    """A capture as tshark reads it: link type 227, SocketCAN."""
    with open(path, "wb") as out:
        out.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227))
        for at, can_id, data in frames:
            packet = struct.pack(">IB3x", can_id, len(data)) + data
            seconds = int(at)
            out.write(struct.pack("<IIII", seconds, round((at - seconds) * 1e6), len(packet), len(packet)) + packet)


def test_tshark_decodes_it_as_canopen_without_a_malformed_frame(recording, tmp_path):
    frames = frames_of(recording[0])
    pcap_of(frames, tmp_path / "bus.pcap")
    done = subprocess.run(["tshark", "-n", "-r", tmp_path / "bus.pcap", "-d", "can.subdissector,canopen", "-T", "fields",
                           "-E", "separator=|", "-e", "_ws.col.Protocol", "-e", "_ws.col.Info", "-e", "_ws.malformed", "-e", "_ws.expert"],
                          capture_output=True, text=True, check=True, env={**os.environ, "HOME": str(tmp_path)})
    rows = [line.split("|") for line in done.stdout.splitlines()]
    assert len(rows) == len(frames)
    assert {row[0] for row in rows} == {"CANopen"}
    assert not [row for row in rows if row[2]], "malformed"
    said = "\n".join(row[1] for row in rows)
    for kind in ("NMT: Start remote node [0x4]", "NMT Error Control: Boot-up [0x4]", "SYNC", "EMCY", "PDO1 (tx)", "PDO2 (rx)",
                 "Default-SDO (rx): Initiate download request", "Default-SDO (tx): Upload segment response"):
        assert kind in said, kind


def test_canplayer_a_recorded_session_at_a_fresh_module_has_the_same_answers(fresh_robot, tmp_path):
    """The module without hardware: every answer depends on the requests alone."""
    def session(wire):
        wire.reset()
        wire.upload(0x1008)
        wire.download(0x2004, 0, b"a name of its own")
        wire.write(0x6085, 0, 4321, "I")
        wire.read(0x6085)
        wire.abort_of(wire.write, 0x6060, 0, 3, "b")
        wire.abort_of(wire.upload, 0x5FFF)
        wire.write(0x1017, 0, 0, "H")
        wire.nmt(1)
        time.sleep(0.05)
        for _ in range(5):
            wire.send(0x202, struct.pack("<Hb", 6, 8))
            wire.sync()
            time.sleep(0.02)
        wire.read(0x6040)
        wire.nmt(0x80)

    def answers(path):
        return [d for _, i, d in frames_of(path) if i == 0x582]

    fresh_robot.module(1, plant=False)
    with Wire("vcan0", node=2) as wire:
        first = dump(tmp_path / "first.log", lambda: session(wire))
    fresh_robot.stop()

    requests = tmp_path / "requests.log"
    requests.write_text("".join(line + "\n" for line in first.read_text().splitlines()
                                if re.search(r"vcan0 (000|080|202|602)#", line)))
    fresh_robot.module(1, plant=False)
    second = dump(tmp_path / "second.log", lambda: subprocess.run(["canplayer", "-I", requests], check=True, timeout=60))
    assert len(answers(first)) > 10
    assert answers(second) == answers(first)
    assert len([1 for _, i, _ in frames_of(second) if i == 0x182]) == len([1 for _, i, _ in frames_of(first) if i == 0x182]) == 5


# ---- random frames ------------------------------------------------------------------------------------------------


def state_of(wire):
    """What random frames must not change."""
    return {"statusword": wire.read(0x6041) & 0x6F, "mode": wire.read(0x6061), "heartbeat": wire.read(0x1017),
            "mapping": wire.upload(0x1A00, 1), "position limits": (wire.upload(0x607D, 1), wire.upload(0x607D, 2))}


def cangen(*options):
    """Random frames for a while; data, length and kind as the options say."""
    process = subprocess.Popen(["cangen", "vcan0", *map(str, options)], stderr=subprocess.PIPE)
    time.sleep(PASSED_S / 4)
    assert process.poll() is None, process.stderr.read()
    process.terminate()
    process.wait(5)


@pytest.mark.slow
def test_random_frames_that_are_not_for_it_change_nothing(led_module):
    """Extended, remote and FD frames of any identifier and length; standard frames with an identifier of nobody."""
    with Wire("vcan0", node=NODE) as wire:
        wire.reset()
        wire.write(0x2003, 0, 20000, "I")
        wire.switch_on_disabled()
        before, position = state_of(wire), wire.read(0x6064, form="i")
        cangen("-g", 1, "-e", "-I", "r", "-L", "r", "-D", "r")
        cangen("-g", 1, "-R", "-I", "r", "-L", "r")
        cangen("-g", 1, "-f", "-I", "r", "-L", "r", "-D", "r")
        cangen("-g", 1, "-I", "5A0", "-L", "r", "-D", "r")
        wire.drain()
        assert state_of(wire) == before
        assert abs(wire.read(0x6064, form="i") - position) < 500
        wire.wait_state(5)
    assert led_module.alive(), led_module.text()


@pytest.mark.slow
def test_random_frames_do_not_move_an_enabled_drive(led_module):
    """Everything but what is a command to it: it goes on holding its position to a milliradian. A machine that stands
    still for a tenth of a second and more is a fault of another name: then it has braked, and is tried again."""
    commands = {0x000, 0x080, 0x181, 0x7E5, 0x701, *(base + NODE for base in (0x200, 0x300, 0x400, 0x600))}
    seed = random.Random(21)
    with Wire("vcan0", node=NODE) as wire:
        wire.hear_standard_only()
        for _ in range(3):
            wire.reset()
            wire.switch_on_disabled()
            wire.write(0x6060, 0, 8, "b")
            for word, state in ((6, 0x21), (7, 0x23), (15, 0x27)):
                wire.write(0x6040, 0, word, "H")
                wait_until(lambda: wire.read(0x6041) & 0x6F == state, what=f"status {state:02X}")  # noqa: B023
            wait_until(lambda: wire.read(0x2030, 1) == 0 and abs(wire.read(0x606C, form="i")) < 1000, what="rest")
            position = wire.read(0x6064, form="i")
            furthest = 0
            noise = subprocess.Popen(["cangen", "vcan0", "-g", "1", "-e", "-f", "-I", "r", "-L", "r", "-D", "r"])
            try:
                end = time.monotonic() + PASSED_S
                while time.monotonic() < end:
                    for _ in range(50):
                        can_id = seed.randrange(0x800)
                        if can_id not in commands:
                            wire.send(can_id, seed.randbytes(seed.randrange(9)), remote=seed.random() < 0.1)
                    time.sleep(0.02)
                    furthest = max(furthest, abs(wire.read(0x6064, form="i") - position))
            finally:
                noise.terminate()
                noise.wait(5)
            assert furthest < 1000, f"moved by {furthest} urad"
            fault = wire.read(0x2030, 1)
            if fault != LOOP_OVERRUN:
                break
        assert wire.read(0x6041) & 0x6F == 0x27, f"no longer enabled: {fault:04X}"
        wire.write(0x6040, 0, 0, "H")
    assert led_module.alive(), led_module.text()


@pytest.mark.slow
def test_any_random_frame_at_all_it_lives_names_what_is_wrong_and_comes_back_after_a_reset(led_module):
    """Legal commands among them: NMT, parameters, knots, selections. The bar is that it lives, answers, and recovers."""
    seed = random.Random(20)
    with Wire("vcan0", node=NODE) as wire:
        wire.reset()
        wire.operational()
        end = time.monotonic() + PASSED_S
        own = [0x000, 0x080, 0x080 + NODE, 0x181, *(base + NODE for base in (0x180, 0x200, 0x300, 0x400, 0x580, 0x600, 0x700)),
               0x701, 0x7E5]
        while time.monotonic() < end:
            for _ in range(20):
                can_id = seed.choice(own) if seed.random() < 0.7 else seed.randrange(0x800)
                wire.send(can_id, seed.randbytes(seed.randrange(9)))
            time.sleep(0.02)
        assert led_module.alive(), led_module.text()
        # Whatever it was told: one NMT reset to all, and it is as after power-on. LSS may have renamed it.
        wire.send(0x7E5, b"\x04\x01" + bytes(6))
        wire.send(0x7E5, bytes([0x11, NODE]) + bytes(6))
        wire.send(0x7E5, bytes(0x8).replace(b"\0", b"\x04", 1))
        wire.drain()
        wire.nmt(0x81, node=0)
        time.sleep(0.2)
        wire.send(0x7E5, b"\x04\x01" + bytes(6))
        wire.send(0x7E5, bytes([0x11, NODE]) + bytes(6))
        wire.drain()
        wire.nmt(0x81, node=0)
        wire.wait_state(0)
        wire.wait_state(0x7F)
        assert wire.read(0x1017) == 100 and wire.upload(0x1A00, 1) == struct.pack("<I", 0x60410010)
        if wire.read(0x6041) & 0x08:
            assert wire.read(0x2030, 1) != 0, "a fault has a name"
        wire.switch_on_disabled()
        wire.write(0x6040, 0, 0x06, "H")
        wait_until(lambda: wire.read(0x6041) & 0x6F == 0x21, what="READY TO SWITCH ON")
        wire.write(0x6040, 0, 0, "H")

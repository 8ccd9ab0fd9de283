"""CiA 301, clause by clause: raw frames at the real module, each answer compared byte by byte.

The module runs without hardware here: everything on the wire is the same, and nothing can move."""

import struct
import time

import pytest
from wire import SILENCE_S, Abort, Wire, check_abort

NODE = 2
HEARTBEAT, EMCY, SDO = 0x700 + NODE, 0x080 + NODE, 0x580 + NODE
TPDO1, TPDO2, TPDO3 = 0x180 + NODE, 0x280 + NODE, 0x380 + NODE
RPDO1, RPDO2, RPDO3 = 0x200 + NODE, 0x300 + NODE, 0x400 + NODE
START, STOP, PRE, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82
OPERATIONAL, STOPPED, PRE_OPERATIONAL = 0x05, 0x04, 0x7F

TOGGLE, TIMEOUT, UNKNOWN_COMMAND = 0x05030000, 0x05040000, 0x05040001
WRITE_ONLY, READ_ONLY, NO_OBJECT = 0x06010001, 0x06010002, 0x06020000
NOT_MAPPABLE, MAPPING_LENGTH, INCOMPATIBLE = 0x06040041, 0x06040042, 0x06040043
LENGTH, TOO_LONG, TOO_SHORT, NO_SUB = 0x06070010, 0x06070012, 0x06070013, 0x06090011
VALUE, HIGH, LOW = 0x06090030, 0x06090031, 0x06090032
CANNOT_STORE, STATE, NO_DATA = 0x08000020, 0x08000022, 0x08000024


# ---- NMT, heartbeat -----------------------------------------------------------------------------------------------


def test_boot_up_comes_first_and_the_node_is_pre_operational(robot, wire):
    wire.drain()
    wire.nmt(RESET_NODE)
    first = wire.expect(*range(0x080, 0x800), where=lambda f: f.id != 0x000)
    assert (first.id, first.data) == (HEARTBEAT, b"\0")
    assert wire.expect(HEARTBEAT).data == bytes([PRE_OPERATIONAL])


@pytest.mark.parametrize("command, state", [(START, OPERATIONAL), (STOP, STOPPED), (PRE, PRE_OPERATIONAL)])
@pytest.mark.parametrize("address", [NODE, 0])
def test_every_state_is_reached_from_every_state(wire, command, state, address):
    for before, shown in ((START, OPERATIONAL), (STOP, STOPPED), (PRE, PRE_OPERATIONAL)):
        wire.nmt(before)
        wire.wait_state(shown)
        wire.nmt(command, address)
        wire.wait_state(state)


@pytest.mark.parametrize("command", [RESET_NODE, RESET_COMMUNICATION])
@pytest.mark.parametrize("before", [START, STOP, PRE])
def test_both_resets_lead_to_boot_up_from_every_state(wire, command, before):
    wire.nmt(before)
    wire.drain()
    wire.nmt(command)
    wire.wait_state(0)
    wire.wait_state(PRE_OPERATIONAL)


def test_nmt_for_others_unknown_short_and_long_ones_are_ignored(wire):
    wire.nmt(START, NODE + 1)
    for command in (0, 3, 4, 5, 0x7F, 0x83, 0xFF):
        wire.nmt(command)
    for data in (b"", bytes([START]), bytes([START, NODE, 0]), bytes([START, NODE, 0, 0, 0, 0, 0, 0])):
        wire.send(0, data)
    wire.send(0, [START, NODE], extended=True)
    wire.send(0, [], remote=True, length=2)
    assert {f.data for f in wire.collect(0.35, HEARTBEAT)} == {bytes([PRE_OPERATIONAL])}


def test_reset_communication_restores_only_communication_objects(wire):
    wire.write(0x1017, 0, 250, "H")
    wire.write(0x6085, 0, 777, "I")
    wire.reset(RESET_COMMUNICATION)
    assert wire.read(0x1017) == 100
    assert wire.read(0x6085) == 777
    wire.reset(RESET_NODE)
    assert wire.read(0x6085) != 777


def test_heartbeat_period_changes_at_once(wire):
    wire.write(0x1017, 0, 2000, "H")
    wire.drain()
    wire.write(0x1017, 0, 20, "H")
    times = [f.at for f in wire.collect(0.6, HEARTBEAT)]
    assert 20 <= len(times) <= 32
    gaps = sorted(b - a for a, b in zip(times, times[1:]))
    assert 0.015 < gaps[len(gaps) // 2] < 0.025


def test_heartbeat_stops_at_0_and_comes_again(wire):
    wire.write(0x1017, 0, 0, "H")
    wire.drain()
    assert not wire.collect(0.5, HEARTBEAT)
    wire.write(0x1017, 0, 50, "H")
    assert wire.expect(HEARTBEAT, within_s=1).data == bytes([PRE_OPERATIONAL])


def test_heartbeat_goes_on_when_stopped(wire):
    wire.nmt(STOP)
    wire.wait_state(STOPPED)
    assert len(wire.collect(0.5, HEARTBEAT)) >= 3


def test_node_guarding_is_not_answered(wire):
    """The module has heartbeat; a request for the error control frame by RTR is not for it."""
    wire.write(0x1017, 0, 0, "H")
    wire.drain()
    wire.send(HEARTBEAT, remote=True, length=1)
    assert not wire.collect(SILENCE_S, HEARTBEAT)


# ---- heartbeat consumer -------------------------------------------------------------------------------------------


def watch(wire, node, timeout_ms, sub=2):
    wire.write(0x1016, sub, node << 16 | timeout_ms, "I")


def test_a_heartbeat_that_stops_is_an_emergency_and_taken_back_when_it_returns(wire):
    watch(wire, 0x30, 100)
    wire.drain()
    assert not wire.collect(0.3, EMCY), "watching starts with the first heartbeat"
    wire.send(0x730, [OPERATIONAL])
    emergency = wire.expect(EMCY)
    assert emergency.data[:2] == bytes([0x30, 0x81]) and emergency.data[3] == 0x30
    assert emergency.data[2] & 0x11 == 0x11
    assert wire.read(0x1001) & 0x11 == 0x11
    wire.send(0x730, [OPERATIONAL])
    assert wire.expect(EMCY).data[:2] == bytes(2)
    assert wire.read(0x1001) & 0x10 == 0


def test_boot_up_of_a_watched_node_does_not_start_watching(wire):
    watch(wire, 0x30, 60)
    wire.send(0x730, [0])
    assert not wire.collect(0.3, EMCY)


def test_a_watched_node_may_be_watched_once_only(wire):
    watch(wire, 0x30, 100, sub=2)
    with pytest.raises(Abort) as abort:
        watch(wire, 0x30, 200, sub=3)
    assert abort.value.code == INCOMPATIBLE
    watch(wire, 0x30, 0, sub=3)  # not watching at all is no second one
    watch(wire, 0x31, 200, sub=3)


@pytest.mark.parametrize("behaviour, state", [(0, PRE_OPERATIONAL), (1, OPERATIONAL), (2, STOPPED)])
def test_error_behaviour(wire, behaviour, state):
    wire.write(0x1029, 1, behaviour, "B")
    watch(wire, 0x30, 60)
    wire.operational()
    wire.send(0x730, [OPERATIONAL])
    time.sleep(0.3)
    wire.drain()
    assert wire.expect(HEARTBEAT).data == bytes([state])


# ---- SDO ----------------------------------------------------------------------------------------------------------


def test_sdo_in_pre_operational_and_operational_only(wire):
    assert wire.read(0x1000) == 0x00020192
    wire.operational()
    assert wire.read(0x1000) == 0x00020192
    wire.nmt(STOP)
    wire.wait_state(STOPPED)
    wire.send(0x600 + NODE, b"\x40\x00\x10\x00\0\0\0\0")
    assert wire.silent()
    wire.nmt(PRE)
    wire.wait_state(PRE_OPERATIONAL)
    assert wire.read(0x1000) == 0x00020192


def test_expedited_upload_of_each_size(wire):
    assert wire.ask(b"\x40\x01\x10\x00")[0] == 0x4F
    assert wire.ask(b"\x40\x41\x60\x00")[0] == 0x4B
    assert wire.ask(b"\x40\x00\x10\x00") == b"\x43\x00\x10\x00\x92\x01\x02\x00"


def test_what_is_longer_is_segmented_with_its_length(wire):
    assert wire.upload(0x1008) == b"MRR joint module"
    assert len(wire.upload(0x2005)) == 8


def test_an_empty_text_and_one_of_every_length(wire):
    for length in (0, 1, 4, 5, 6, 7, 8, 13, 14, 15, 21, 28, 31, 32):
        text = bytes(range(0x41, 0x41 + length))
        wire.download(0x2004, 0, text)
        assert wire.upload(0x2004) == text
    assert wire.abort_of(wire.download, 0x2004, 0, b"x" * 33) == TOO_LONG
    assert wire.upload(0x2004) == bytes(range(0x41, 0x41 + 32))


def test_segmented_download_of_a_number(wire):
    assert wire.ask(b"\x21\x85\x60\x00" + struct.pack("<I", 4)) == b"\x60\x85\x60\x00\0\0\0\0"
    assert wire.ask(b"\x07" + struct.pack("<I", 1234))[0] == 0x20  # 4 of 7 bytes used, last
    assert wire.read(0x6085) == 1234


def test_segmented_download_without_announced_length(wire):
    assert wire.ask(b"\x20\x04\x20\x00")[0] == 0x60
    assert wire.ask(b"\x00abcdefg")[0] == 0x20
    assert wire.ask(b"\x1bhi")[0] == 0x30
    assert wire.upload(0x2004) == b"abcdefghi"


def test_expedited_download_without_length_takes_the_objects_own(wire):
    assert wire.ask(b"\x22\x17\x10\x00\x2c\x01\xff\xff")[0] == 0x60
    assert wire.read(0x1017) == 300


def test_nothing_changes_before_the_last_segment(wire):
    wire.download(0x2004, 0, b"before it")
    wire.ask(b"\x21\x04\x20\x00" + struct.pack("<I", 9))
    wire.ask(b"\x00abcdefg")
    wire.send(0x600 + NODE, b"\x80\x04\x20\x00\0\0\4\5")  # abandoned
    assert wire.silent()
    assert wire.upload(0x2004) == b"before it"


@pytest.mark.parametrize("index, sub, data, code", [
    pytest.param(0x1004, 0, b"\0", NO_OBJECT, id="no object"),
    pytest.param(0x5FFF, 0, b"\0", NO_OBJECT, id="no object of the maker"),
    pytest.param(0x0005, 0, b"\0", NO_OBJECT, id="dummies exist for mapping only"),
    pytest.param(0x1018, 9, b"\0\0\0\0", NO_SUB, id="no sub-index"),
    pytest.param(0x6040, 1, b"\0\0", NO_SUB, id="no sub-index of a variable"),
    pytest.param(0x1018, 1, b"\0\0\0\0", READ_ONLY, id="constant"),
    pytest.param(0x1018, 0, b"\4", READ_ONLY, id="number of entries"),
    pytest.param(0x6041, 0, b"\0\0", READ_ONLY, id="read only"),
    pytest.param(0x6041, 0, b"\0\0\0\0", READ_ONLY, id="access goes before length"),
    pytest.param(0x6040, 0, b"\0", TOO_SHORT, id="too short"),
    pytest.param(0x6040, 0, b"\0\0\0", TOO_LONG, id="too long"),
    pytest.param(0x6040, 0, bytes(9), TOO_LONG, id="too long, segmented"),
    pytest.param(0x6060, 0, b"\x03", VALUE, id="not one of the values"),
    pytest.param(0x6060, 0, b"\x0b", HIGH, id="above"),
    pytest.param(0x6060, 0, b"\x80", LOW, id="below"),
    pytest.param(0x2110, 2, struct.pack("<f", 0.11), HIGH, id="real above"),
    pytest.param(0x2110, 2, struct.pack("<f", -0.01), LOW, id="real below"),
    pytest.param(0x2110, 2, struct.pack("<f", float("nan")), VALUE, id="not a number"),
    pytest.param(0x2110, 2, struct.pack("<f", float("inf")), VALUE, id="infinite"),
])
def test_abort_of_a_download(wire, index, sub, data, code):
    assert wire.abort_of(wire.download, index, sub, data) == code


@pytest.mark.parametrize("index, sub, code", [(0x1004, 0, NO_OBJECT), (0x1018, 5, NO_SUB), (0x1000, 1, NO_SUB),
                                              (0x2F00, 0, WRITE_ONLY), (0x1003, 1, NO_DATA), (0x1003, 9, NO_SUB)])
def test_abort_of_an_upload(wire, index, sub, code):
    if index == 0x1003:
        wire.write(0x1003, 0, 0, "B")
    assert wire.abort_of(wire.upload, index, sub) == code


@pytest.mark.parametrize("command", [0xA0, 0xA1, 0xA3, 0xC0, 0xC2, 0xC6, 0xE0, 0xFF])
def test_block_transfer_and_unknown_commands_are_refused(wire, command):
    answer = wire.ask(bytes([command, 0x08, 0x10, 0x00]))
    with pytest.raises(Abort) as abort:
        check_abort(answer, 0x1008, 0)
    assert abort.value.code == UNKNOWN_COMMAND
    assert wire.upload(0x1008) == b"MRR joint module"


@pytest.mark.parametrize("segment", [0x00, 0x10, 0x60, 0x70])
def test_a_segment_without_a_transfer(wire, segment):
    answer = wire.ask([segment])
    assert answer[0] == 0x80 and struct.unpack("<I", answer[4:])[0] == UNKNOWN_COMMAND


def test_every_command_byte_has_its_answer(wire):
    """All 256, none of them in a transfer: what is reserved in a known command says nothing, unknown ones are refused."""
    for command in range(256):
        wire.drain()
        wire.send(0x600 + NODE, bytes([command, 0x00, 0x10, 0x00]) + bytes(4))
        kind = command >> 5
        if kind == 4:  # the client's abort; the next request would be answered before it
            wire.send(0x600 + NODE, b"\x40\x01\x10\x00\0\0\0\0")
            assert wire.expect(SDO).data[:4] == b"\x4f\x01\x10\x00", f"{command:02X}"
            continue
        answer = wire.expect(SDO).data
        if kind == 2:
            assert answer == b"\x43\x00\x10\x00\x92\x01\x02\x00", f"{command:02X}"
            continue
        assert answer[0] == 0x80 and struct.unpack("<I", answer[4:])[0] == (READ_ONLY if kind == 1 else UNKNOWN_COMMAND), f"{command:02X}"
        assert kind in (0, 3) or answer[1:4] == b"\x00\x10\x00", "the object it is about"


def test_toggle_of_a_download(wire):
    wire.ask(b"\x21\x04\x20\x00" + struct.pack("<I", 14))
    assert wire.ask(b"\x00abcdefg")[0] == 0x20
    answer = wire.ask(b"\x00abcdefg")
    assert answer == b"\x80\x04\x20\x00" + struct.pack("<I", TOGGLE)
    assert wire.ask(b"\x11abcdefg")[0] == 0x80, "the transfer is over"


def test_toggle_of_an_upload(wire):
    assert wire.ask(b"\x40\x08\x10\x00")[0] == 0x41
    assert wire.ask(b"\x70") == b"\x80\x08\x10\x00" + struct.pack("<I", TOGGLE)
    assert wire.ask(b"\x60")[0] == 0x80


@pytest.mark.parametrize("announced, code", [(33, TOO_LONG), (0xFFFFFFFF, TOO_LONG)])
def test_an_announced_length_that_cannot_be(wire, announced, code):
    answer = wire.ask(b"\x21\x04\x20\x00" + struct.pack("<I", announced))
    assert answer == b"\x80\x04\x20\x00" + struct.pack("<I", code)


@pytest.mark.parametrize("announced, code", [(3, TOO_SHORT), (0, TOO_SHORT), (5, TOO_LONG)])
def test_an_announced_length_that_a_number_does_not_have(wire, announced, code):
    answer = wire.ask(b"\x21\x85\x60\x00" + struct.pack("<I", announced))
    assert answer == b"\x80\x85\x60\x00" + struct.pack("<I", code)


@pytest.mark.parametrize("segments, why", [([b"\x00abcdefg", b"\x17xyz"], "more than announced"),
                                           ([b"\x01abcdefg"], "less than announced")])
def test_a_length_other_than_announced(wire, segments, why):
    wire.ask(b"\x21\x04\x20\x00" + struct.pack("<I", 9))
    answers = [wire.ask(segment) for segment in segments]
    assert answers[-1] == b"\x80\x04\x20\x00" + struct.pack("<I", LENGTH), why


def test_more_than_the_object_holds_without_announced_length(wire):
    wire.ask(b"\x20\x04\x20\x00")
    toggle, answer = 0, b"\x20"
    for _ in range(4):
        answer = wire.ask(bytes([toggle]) + b"abcdefg")
        assert answer[0] == 0x20 | toggle
        toggle ^= 0x10
    answer = wire.ask(bytes([toggle]) + b"abcdefg")
    assert answer == b"\x80\x04\x20\x00" + struct.pack("<I", TOO_LONG)


def test_an_abandoned_transfer_times_out_and_a_new_one_begins_at_any_time(wire):
    wire.ask(b"\x40\x08\x10\x00")
    abort = wire.expect(SDO, within_s=2.5)
    assert abort.data == b"\x80\x08\x10\x00" + struct.pack("<I", TIMEOUT)
    wire.ask(b"\x40\x08\x10\x00")
    wire.ask(b"\x60")
    assert wire.read(0x1000) == 0x00020192, "the old one is forgotten"
    assert wire.ask(b"\x70")[0] == 0x80


def test_an_abort_of_the_client_is_not_answered_and_ends_the_transfer(wire):
    wire.ask(b"\x40\x08\x10\x00")
    wire.drain()
    wire.send(0x600 + NODE, b"\x80\x08\x10\x00\0\0\4\5")
    assert wire.silent()
    assert wire.ask(b"\x60") == b"\x80\0\0\0" + struct.pack("<I", UNKNOWN_COMMAND)


@pytest.mark.parametrize("length", range(8))
def test_sdo_shorter_than_8_bytes_is_ignored(wire, length):
    wire.drain()
    wire.send(0x600 + NODE, b"\x40\x00\x10\x00\0\0\0\0"[:length])
    assert wire.silent(0.05)
    assert wire.read(0x1000) == 0x00020192


def test_sdo_of_other_kinds_is_ignored(wire):
    wire.drain()
    request = b"\x40\x00\x10\x00\0\0\0\0"
    wire.send(0x600 + NODE, request, extended=True)
    wire.send(0x600 + NODE, remote=True, length=8)
    wire.send(0x600 + NODE + 1, request)
    wire.send(0x580 + NODE, request)
    wire.send_fd(0x600 + NODE, request)
    wire.send_fd(0x600 + NODE, request + bytes(56))
    assert wire.silent()
    assert wire.read(0x1000) == 0x00020192


# ---- PDO ----------------------------------------------------------------------------------------------------------


def remap(wire, number, objects, *, receive=False, type_=None, inhibit=None, event=None, start=None, cob_id=None):
    """The procedure of CiA 301: not valid, number of objects 0, objects, number, valid."""
    communication, mapping = (0x1400, 0x1600) if receive else (0x1800, 0x1A00)
    communication, mapping = communication + number - 1, mapping + number - 1
    old = wire.read(communication, 1)
    wire.write(communication, 1, old | 0x80000000, "I")
    if type_ is not None:
        wire.write(communication, 2, type_, "B")
    if inhibit is not None:
        wire.write(communication, 3, inhibit, "H")
    if event is not None:
        wire.write(communication, 5, event, "H")
    if start is not None:
        wire.write(communication, 6, start, "B")
    if objects is not None:
        wire.write(mapping, 0, 0, "B")
        for sub, value in enumerate(objects, 1):
            wire.write(mapping, sub, value, "I")
        wire.write(mapping, 0, len(objects), "B")
    wire.write(communication, 1, (old if cob_id is None else cob_id) & 0x7FFFFFFF, "I")


STATUSWORD, MODE, MODE_DISPLAY, NAME = 0x60410010, 0x60600008, 0x60610008, 0x20040000
ACKNOWLEDGED = 0x20100508
CONTROLWORD, POSITION, TARGET, INPUTS = 0x60400010, 0x60640020, 0x607A0020, 0x60FD0020


def test_pdos_in_operational_only(wire):
    wire.drain()
    for command, state in ((PRE, PRE_OPERATIONAL), (STOP, STOPPED)):
        wire.nmt(command)
        wire.wait_state(state)
        for _ in range(3):
            wire.sync()
        assert not wire.collect(0.3, TPDO1, TPDO2, TPDO3)
    wire.operational()
    wire.drain()
    wire.sync()
    assert len(wire.expect(TPDO1).data) == 8
    assert len(wire.expect(TPDO2).data) == 8
    assert len(wire.expect(TPDO3).data) == 8
    wire.nmt(PRE)
    wire.wait_state(PRE_OPERATIONAL)
    wire.send(RPDO1, b"\x06\x00\x08")
    assert wire.read(0x6040) == 0 and wire.read(0x6060) == 0


def test_an_event_driven_rpdo_is_in_force_at_once_a_synchronous_one_at_sync(wire):
    wire.operational()
    wire.send(RPDO1, b"\x06\x00\x08")
    assert wire.read(0x6040) == 6 and wire.read(0x6060) == 8
    wire.send(RPDO2, struct.pack("<ii", 11, 22))
    assert wire.read(0x607A) == 0
    wire.sync()
    assert wire.read(0x607A) == 11 and wire.read(0x60B1) == 22


def test_an_rpdo_that_is_too_short_is_an_emergency_and_has_no_effect(wire):
    wire.operational()
    for length in range(3):
        wire.drain()
        wire.send(RPDO1, b"\x0f\x00\x08"[:length])
        if length == 0:
            emergency = wire.expect(EMCY).data
            assert emergency[:2] + emergency[3:] == bytes([0x10, 0x82, 1, 0, 3, 0, 0])
            assert emergency[2] & 0x11 == 0x11
    assert wire.read(0x6040) == 0 and wire.read(0x6060) == 0
    assert wire.read(0x1003, 1) & 0xFFFF == 0x8210
    wire.drain()
    wire.send(RPDO1, b"\x06\x00\x08")
    assert wire.expect(EMCY).data[:2] == bytes(2), "error reset"
    assert wire.read(0x6040) == 6


def test_an_rpdo_that_is_too_long_is_taken_by_its_first_bytes(wire):
    wire.operational()
    wire.send(RPDO1, b"\x06\x00\x08\xff\xff\xff\xff\xff")
    assert wire.read(0x6040) == 6 and wire.read(0x6060) == 8


def test_an_rpdo_with_a_value_out_of_limits_has_no_effect_at_all(wire):
    rejected = wire.read(0x2040, 2)
    wire.operational()
    wire.send(RPDO1, b"\x06\x00\x03")
    assert wire.read(0x6040) == 0 and wire.read(0x6060) == 0
    assert wire.read(0x2040, 2) == rejected + 1


def test_remote_extended_and_fd_frames_are_no_pdos(wire):
    wire.operational()
    wire.send(RPDO1, b"\x06\x00\x08", extended=True)
    wire.send(RPDO1, remote=True, length=3)
    wire.send_fd(RPDO1, b"\x06\x00\x08")
    assert wire.read(0x6040) == 0


def test_rtr_on_a_tpdo_is_not_answered_and_bit_30_says_so(wire):
    """CiA 301: bit 30 of the COB-ID says that no remote request is allowed; a device without them refuses to clear it."""
    for number in (1, 2, 3):
        cob_id = wire.read(0x1800 + number - 1, 1)
        assert cob_id & 0x40000000
        wire.write(0x1800 + number - 1, 1, cob_id | 0x80000000, "I")
        assert wire.abort_of(wire.write, 0x1800 + number - 1, 1, cob_id & 0x3FFFFFFF, "I") == VALUE
        wire.write(0x1800 + number - 1, 1, cob_id, "I")
    wire.operational()
    wire.drain()
    wire.send(TPDO1, remote=True, length=8)
    assert not [f for f in wire.collect(SILENCE_S, TPDO1) if not f.remote]


def test_the_order_of_remapping_is_enforced(wire):
    cob_id = wire.read(0x1800, 1)
    assert wire.abort_of(wire.write, 0x1A00, 0, 0, "B") == STATE, "the PDO is valid"
    assert wire.abort_of(wire.write, 0x1A00, 1, STATUSWORD, "I") == STATE
    assert wire.abort_of(wire.write, 0x1800, 3, 10, "H") == STATE
    assert wire.abort_of(wire.write, 0x1800, 6, 1, "B") == STATE
    assert wire.abort_of(wire.write, 0x1800, 1, (cob_id & 0x7FFFF800) | 0x1F0, "I") == VALUE, "the id of a valid PDO"
    wire.write(0x1800, 1, cob_id | 0x80000000, "I")
    assert wire.abort_of(wire.write, 0x1A00, 1, STATUSWORD, "I") == STATE, "the number is not 0"
    wire.write(0x1A00, 0, 0, "B")
    wire.write(0x1A00, 1, INPUTS, "I")
    wire.write(0x1A00, 2, STATUSWORD, "I")
    wire.write(0x1A00, 0, 2, "B")
    wire.write(0x1800, 1, cob_id, "I")
    wire.operational()
    wire.drain()
    wire.sync()
    assert len(wire.expect(TPDO1).data) == 6


@pytest.mark.parametrize("entry, code", [
    (0x5FFF0008, NO_OBJECT), (0x10180520, NO_SUB), (0x10170010, NOT_MAPPABLE), (CONTROLWORD, NOT_MAPPABLE),
    (0x60410008, NOT_MAPPABLE), (0x60410011, NOT_MAPPABLE), (0x60410000, NOT_MAPPABLE), (NAME, NOT_MAPPABLE),
])
def test_what_cannot_be_mapped_to_a_tpdo(wire, entry, code):
    wire.write(0x1800, 1, wire.read(0x1800, 1) | 0x80000000, "I")
    wire.write(0x1A00, 0, 0, "B")
    assert wire.abort_of(wire.write, 0x1A00, 1, entry, "I") == code


def test_what_cannot_be_mapped_to_an_rpdo(wire):
    wire.write(0x1400, 1, wire.read(0x1400, 1) | 0x80000000, "I")
    wire.write(0x1600, 0, 0, "B")
    for entry, code in ((STATUSWORD, NOT_MAPPABLE), (0x00010001, NO_OBJECT), (0x00050010, NOT_MAPPABLE), (0x12340010, NO_OBJECT)):
        assert wire.abort_of(wire.write, 0x1600, 1, entry, "I") == code


def test_a_mapping_longer_than_8_bytes_or_of_too_many_objects(wire):
    wire.write(0x1800, 1, wire.read(0x1800, 1) | 0x80000000, "I")
    wire.write(0x1A00, 0, 0, "B")
    for sub in (1, 2, 3):
        wire.write(0x1A00, sub, POSITION, "I")
    assert wire.abort_of(wire.write, 0x1A00, 0, 3, "B") == MAPPING_LENGTH
    wire.write(0x1A00, 0, 2, "B")
    wire.write(0x1A00, 0, 0, "B")
    assert wire.abort_of(wire.write, 0x1A00, 0, 9, "B") == HIGH
    wire.write(0x1A00, 4, 0, "I")
    assert wire.abort_of(wire.write, 0x1A00, 0, 4, "B") == NO_OBJECT, "sub-index 4 maps nothing"


def test_dummies_fill_an_rpdo(wire):
    remap(wire, 1, [0x00050008, 0x00060010, CONTROLWORD, 0x00070020 & 0xFFFF00FF | 0x20][:3], receive=True)
    wire.operational()
    wire.send(RPDO1, b"\xaa\xbb\xcc\x06\x00")
    assert wire.read(0x6040) == 6


def test_a_cob_id_that_cia_301_keeps_is_refused(wire):
    for index in (0x1400, 0x1800):
        flags = 0x40000000 if index == 0x1800 else 0
        wire.write(index, 1, wire.read(index, 1) | 0x80000000, "I")
        for restricted in (0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x6FF, 0x701, 0x7FF):
            assert wire.abort_of(wire.write, index, 1, flags | restricted, "I") == VALUE, f"{restricted:03X}"
        assert wire.abort_of(wire.write, index, 1, flags | 0x20000000 | 0x1F0, "I") == VALUE, "29 bit"
        wire.write(index, 1, flags | 0x1F0, "I")


def test_another_cob_id_is_in_force(wire):
    remap(wire, 1, None, cob_id=0x400001F0)
    remap(wire, 1, None, receive=True, cob_id=0x000001F1)
    wire.operational()
    wire.drain()
    wire.sync()
    assert wire.expect(0x1F0, TPDO1).id == 0x1F0
    wire.send(RPDO1, b"\x06\x00\x08")
    assert wire.read(0x6040) == 0
    wire.send(0x1F1, b"\x06\x00\x08")
    assert wire.read(0x6040) == 6


@pytest.mark.parametrize("type_", [241, 250, 251, 252, 253])
def test_reserved_and_remote_transmission_types_are_refused(wire, type_):
    assert wire.abort_of(wire.write, 0x1800, 2, type_, "B") == VALUE
    assert wire.abort_of(wire.write, 0x1400, 2, type_, "B") == VALUE


@pytest.mark.parametrize("type_", [1, 2, 5, 240])
def test_every_nth_sync(wire, type_):
    wire.write(0x1800, 2, type_, "B")
    wire.operational()
    wire.drain()
    for _ in range(2 * type_):
        wire.sync()
        time.sleep(0.002)  # a SYNC in each control tick at most
    assert len(wire.collect(0.3, TPDO1)) == 2


def test_type_0_is_sent_at_the_sync_after_a_change(wire):
    remap(wire, 1, [ACKNOWLEDGED], type_=0)
    wire.operational()
    wire.drain()
    for _ in range(3):
        wire.sync()
        time.sleep(0.01)
    assert len(wire.collect(0.2, TPDO1)) == 1, "the first, then nothing has changed"
    wire.send(0x181, struct.pack("<IBHB", 0xFFFFFFFF, 0, 0, 0x21))  # a selection, which this module refuses: acknowledged
    wire.drain()
    assert not wire.collect(0.1, TPDO1)
    wire.sync()
    assert wire.expect(TPDO1).data == b"\x40"


def test_type_254_is_sent_by_its_timer_alone(wire):
    remap(wire, 1, [STATUSWORD], type_=254, event=50)
    wire.operational()
    wire.drain()
    wire.sync()
    times = [f.at for f in wire.collect(1.0, TPDO1)]
    gaps = sorted(b - a for a, b in zip(times, times[1:]))
    assert 15 <= len(times) <= 22
    assert 0.045 < gaps[len(gaps) // 2] < 0.055


def test_type_255_is_sent_on_change_and_by_its_timer_with_the_inhibit_time_between(wire):
    # The uptime cannot be mapped; the phase error of SYNC changes with every SYNC that comes.
    remap(wire, 1, [0x20150220], type_=255, event=0, inhibit=500)
    wire.operational()
    time.sleep(0.1)
    wire.drain()
    assert not wire.collect(0.3, TPDO1), "no change, no timer"
    start = time.monotonic()
    while time.monotonic() - start < 1.0:
        wire.sync()
        time.sleep(0.004)
    times = [f.at for f in wire.collect(0.1, TPDO1)]
    gaps = sorted(b - a for a, b in zip(times, times[1:]))
    assert 5 <= len(times) <= 21, "in a second, at 50 ms each"
    assert gaps[len(gaps) // 2] > 0.049  # one that goes out late on this machine is nearer to the next


def test_sync_start_value(wire):
    wire.write(0x1019, 0, 10, "B")
    remap(wire, 1, None, type_=2, start=4)
    wire.operational()
    wire.drain()
    sent = []
    for counter in (*range(1, 11), *range(1, 5)):
        wire.sync(counter)
        if wire.collect(0.02, TPDO1):
            sent.append(counter)
    # "The SYNC message of which the counter value equals the start value is regarded as the first": type 2 is every second.
    assert sent == [5, 7, 9, 1, 3]


def test_rpdo_deadline(wire):
    wire.write(0x1400, 5, 100, "H")
    wire.operational()
    wire.drain()
    assert not wire.collect(0.3, EMCY), "runs from the first one on"
    wire.send(RPDO1, b"\x00\x00\x00")
    emergency = wire.expect(EMCY).data
    assert emergency[:2] == bytes([0x50, 0x82]) and emergency[3] == 1
    wire.send(RPDO1, b"\x00\x00\x00")
    assert wire.expect(EMCY).data[:2] == bytes(2)


def test_a_pdo_that_is_not_valid_is_neither_sent_nor_taken(wire):
    for index in (0x1400, 0x1800):
        wire.write(index, 1, wire.read(index, 1) | 0x80000000, "I")
    wire.operational()
    wire.drain()
    wire.sync()
    assert wire.expect(TPDO2)
    assert not wire.collect(SILENCE_S, TPDO1)
    wire.send(RPDO1, b"\x06\x00\x08")
    assert wire.read(0x6040) == 0


# ---- SYNC ---------------------------------------------------------------------------------------------------------


def test_a_sync_of_unexpected_length_is_an_emergency_and_no_sync(wire):
    wire.operational()
    wire.drain()
    wire.sync(1)
    emergency = wire.expect(EMCY).data
    assert emergency[:2] == bytes([0x40, 0x82]) and emergency[3] == 1
    assert not wire.collect(0.1, TPDO1)
    wire.sync()
    wire.expect(TPDO1)


def test_the_sync_counter_can_be_changed_only_while_no_period_is_announced(wire):
    wire.write(0x1006, 0, 4000, "I")
    assert wire.abort_of(wire.write, 0x1019, 0, 240, "B") == STATE
    wire.write(0x1006, 0, 0, "I")
    wire.write(0x1019, 0, 240, "B")
    assert wire.abort_of(wire.write, 0x1019, 0, 1, "B") == VALUE
    assert wire.abort_of(wire.write, 0x1019, 0, 241, "B") == HIGH


def test_counters_of_sync_out_of_range_are_ignored(wire):
    wire.write(0x1019, 0, 10, "B")
    wire.operational()
    wire.drain()
    for counter in (0, 11, 255):
        wire.sync(counter)
    assert not wire.collect(SILENCE_S, TPDO1)
    wire.sync(10)
    wire.expect(TPDO1)


def test_sync_of_another_cob_id(wire):
    wire.write(0x1005, 0, 0x81, "I")
    wire.operational()
    wire.drain()
    wire.sync()
    assert not wire.collect(SILENCE_S, TPDO1)
    wire.send(0x081)
    wire.expect(TPDO1)
    assert wire.abort_of(wire.write, 0x1005, 0, 0x40000080, "I") == VALUE, "a module never makes SYNC"
    assert wire.abort_of(wire.write, 0x1005, 0, 0x20000080, "I") == VALUE, "29 bit"
    assert wire.abort_of(wire.write, 0x1005, 0, 0x000, "I") == VALUE


def test_remote_extended_and_fd_syncs_are_none(wire):
    wire.operational()
    wire.drain()
    wire.send(0x080, remote=True)
    wire.send(0x080, extended=True)
    wire.send_fd(0x080, b"")
    assert not wire.collect(SILENCE_S, TPDO1)


# ---- EMCY ---------------------------------------------------------------------------------------------------------


def test_emergency_inhibit_time(wire):
    wire.write(0x1015, 0, 2000, "H")
    wire.operational()
    wire.drain()
    wire.sync(1)  # raises 8240h
    wire.sync()  # takes it back
    times = [f.at for f in wire.collect(0.6, EMCY)][:2]
    assert times[1] - times[0] > 0.198


def test_another_cob_id_of_emergencies_and_none_at_all(wire):
    own = wire.read(0x1014)
    assert own == EMCY
    assert wire.abort_of(wire.write, 0x1014, 0, 0x1F0, "I") == VALUE, "valid: its id stands"
    wire.write(0x1014, 0, own | 0x80000000, "I")
    wire.operational()
    wire.drain()
    wire.sync(1)
    assert not wire.collect(SILENCE_S, EMCY)
    wire.write(0x1014, 0, 0x1F0, "I")
    wire.sync()
    assert wire.expect(0x1F0, EMCY).id == 0x1F0
    wire.write(0x1014, 0, 0x800001F0, "I")
    for bad in (0x000, 0x701, 0x20000000 | 0x1F0):
        assert wire.abort_of(wire.write, 0x1014, 0, bad, "I") == VALUE


# ---- store, restore, identity -------------------------------------------------------------------------------------


def test_store_and_restore_want_their_signature_and_this_module_has_no_memory(wire):
    for index, signature in ((0x1010, 0x65766173), (0x1011, 0x64616F6C)):
        assert wire.read(index, 1) == 0, "there is no memory"
        assert wire.abort_of(wire.write, index, 1, 0x12345678, "I") == CANNOT_STORE
        assert wire.abort_of(wire.write, index, 1, signature, "I") == CANNOT_STORE
        assert wire.abort_of(wire.write, index, 2, signature, "I") == NO_SUB


def test_identity_and_texts(wire):
    assert wire.read(0x1018) == 4
    assert [wire.read(0x1018, sub) for sub in (1, 2, 3, 4)] == [0, 1, 1, NODE]
    assert wire.upload(0x1008) and wire.upload(0x1009) and wire.upload(0x100A)


# ---- LSS (CiA 305) ------------------------------------------------------------------------------------------------


def lss(wire, *data):
    wire.drain()
    wire.send(0x7E5, bytes(data).ljust(8, b"\0"))
    answers = wire.collect(0.1, 0x7E4)
    return answers[0].data if answers else None


def test_a_node_id_by_lss(wire):
    for command, part in zip((0x40, 0x41, 0x42), (0, 1, 1)):
        assert lss(wire, command, *struct.pack("<I", part)) is None
    assert lss(wire, 0x43, *struct.pack("<I", NODE))[0] == 0x44
    assert lss(wire, 0x5E)[:2] == bytes([0x5E, NODE])
    assert lss(wire, 0x11, 0)[:2] == bytes([0x11, 1])
    assert lss(wire, 0x11, 0x33)[:2] == bytes([0x11, 0])
    assert lss(wire, 0x17)[:2] == bytes([0x17, 1]), "no memory to store it in"
    wire.nmt(RESET_COMMUNICATION)
    wire.expect(0x733, where=lambda f: f.data == b"\0")
    with Wire("vcan0", node=0x33) as renamed:
        try:
            assert renamed.read(0x1018, 4) == NODE
            assert renamed.read(0x1800, 1) == 0x400001B3
            renamed.operational()
            renamed.sync()
            renamed.expect(0x1B3)
            renamed.nmt(STOP)
            renamed.wait_state(STOPPED)
        finally:
            lss(renamed, 0x04, 1)
            assert lss(renamed, 0x11, NODE)[1] == 0
            renamed.nmt(RESET_NODE)
    wire.wait_state(0)


def test_lss_tells_identity_and_refuses_what_cannot_be(wire):
    lss(wire, 0x04, 1)
    try:
        for command, part in ((0x5A, 0), (0x5B, 1), (0x5C, 1), (0x5D, NODE)):
            assert lss(wire, command) == bytes([command]) + struct.pack("<I", part) + bytes(3)
        for node in (0, 128, 200, 254):
            assert lss(wire, 0x11, node)[:2] == bytes([0x11, 1]), "1 to 127, and 255 for none"
        for table, entry in ((0, 9), (0, 5), (1, 0)):
            assert lss(wire, 0x13, table, entry)[:2] == bytes([0x13, 1])
        assert lss(wire, 0x11, NODE)[:2] == bytes([0x11, 0])
    finally:
        lss(wire, 0x04, 0)
    for command in (0x11, 0x13, 0x17, 0x5A, 0x5E):
        assert lss(wire, command, 9) is None, "not in waiting mode"
    for low, high, found in ((NODE, NODE, True), (0, NODE, True), (NODE + 1, 99, False)):
        for command, part in ((0x46, 0), (0x47, 1), (0x48, 0), (0x49, 9), (0x4A, low)):
            assert lss(wire, command, *struct.pack("<I", part)) is None
        answer = lss(wire, 0x4B, *struct.pack("<I", high))
        assert (answer is not None and answer[0] == 0x4F) == found


def test_fastscan_finds_a_module_without_a_node_id(wire):
    lss(wire, 0x04, 1)
    assert lss(wire, 0x11, 0xFF)[1] == 0
    wire.nmt(RESET_COMMUNICATION)
    try:
        assert not wire.collect(0.4, *range(0x081, 0x7E0)), "it has no id and says nothing"
        assert lss(wire, 0x4C)[0] == 0x50
        assert lss(wire, 0x51, 0, 0, 0, 0, 0x80, 0, 0)[0] == 0x4F
        found = []
        for part in range(4):
            number = 0
            for bit in range(31, -1, -1):
                wire.drain()
                wire.send(0x7E5, b"\x51" + struct.pack("<IBBB", number, bit, part, part))
                if not wire.collect(0.02, 0x7E4):
                    number |= 1 << bit
            assert lss(wire, 0x51, *struct.pack("<I", number), 0, part, (part + 1) % 4)[0] == 0x4F
            found.append(number)
        assert found == [0, 1, 1, NODE]
    finally:
        lss(wire, 0x04, 1)
        lss(wire, 0x11, NODE)
        wire.drain()
        wire.send(0x7E5, b"\x04" + bytes(7))
    wire.wait_state(0)


# ---- malformed ----------------------------------------------------------------------------------------------------


def test_every_kind_and_length_of_frame_at_every_own_identifier(wire):
    """Standard, extended, remote, FD; 0 to 8 bytes of 00 and FF (FD: all sizes). What may have an effect is left out."""
    before = wire.read(0x2040, 1)
    own = [0x000, 0x080, EMCY, 0x181, TPDO1, RPDO1, RPDO2, RPDO3, TPDO2, TPDO3, SDO, 0x600 + NODE, HEARTBEAT, 0x701, 0x7E5]
    for can_id in own:
        for extended in (False, True):
            for length in range(9):
                wire.send(can_id, remote=True, extended=extended, length=length)
                if extended:
                    wire.send(can_id, b"\xff" * length, extended=True)
                    wire.send(can_id, bytes(length), extended=True)
            for length in (0, 1, 2, 3, 7, 8, 12, 16, 20, 24, 32, 48, 64):
                wire.send_fd(can_id, b"\x81" + b"\0" * (length - 1) if length else b"", extended=extended)
        for length in range(8):
            if can_id not in (0x701,):
                wire.send(can_id, b"\xff" * length)
        time.sleep(0.005)
    assert wire.read(0x1000) == 0x00020192
    assert wire.expect(HEARTBEAT).data == bytes([PRE_OPERATIONAL])
    assert wire.read(0x2040, 1) > before, "counted"


def test_a_burst_of_requests_is_answered_in_order(wire):
    wire.drain()
    for _ in range(20):
        wire.send(0x600 + NODE, b"\x40\x00\x10\x00\0\0\0\0")
        wire.send(0x600 + NODE, b"\x40\x18\x10\x04\0\0\0\0")
    answers = [f.data for f in wire.collect(0.5, SDO)]
    assert answers == [b"\x43\x00\x10\x00\x92\x01\x02\x00", b"\x43\x18\x10\x04" + struct.pack("<I", NODE)] * 20

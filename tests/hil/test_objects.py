"""Every object of the EDS, read and written at the real module: type, access, limits; beyond them; what may not be written
or read. python-canopen reads by name, the bare-handed client writes."""

import configparser
import math
import re
import struct

import canopen
import pytest
from conftest import BUILD
from wire import Abort, Wire

NODE = 2
EDS = BUILD / "generated" / "can_protocol" / "module.eds"
READ_ONLY, TOO_LONG, TOO_SHORT, VALUE, HIGH, LOW = 0x06010002, 0x06070012, 0x06070013, 0x06090030, 0x06090031, 0x06090032
FORMS = {0x02: "b", 0x03: "h", 0x04: "i", 0x05: "B", 0x06: "H", 0x07: "I", 0x08: "f", 0x15: "q", 0x1B: "Q"}
VISIBLE_STRING = 0x09

# Objects that are a procedure or have rules beyond a range; test_cia301.py has a test for each of them.
PROCEDURES = {0x1003: "0 clears", 0x1005: "COB-ID", 0x1010: "signature", 0x1011: "signature", 0x1014: "COB-ID",
              0x1016: "node id and time, each node once", 0x1019: "not 1",
              **{i: "COB-ID, type, valid or not" for base, n in ((0x1400, 4), (0x1800, 3)) for i in range(base, base + n)},
              **{i: "mapping" for base, n in ((0x1600, 4), (0x1A00, 3)) for i in range(base, base + n)}}


def entries():
    """(index, sub, section) of every value of the EDS."""
    parser = configparser.RawConfigParser(strict=True)
    parser.optionxform = str
    parser.read(EDS)
    for name in parser.sections():
        if (match := re.fullmatch(r"([0-9A-F]{4})(?:sub([0-9A-F]+))?", name)) and int(parser[name]["ObjectType"], 16) == 7:
            yield int(match[1], 16), int(match[2] or "0", 16), parser[name]


def describe(entry):
    index, sub, section = entry
    return f"{index:04X}_{sub:02X}_{section['ParameterName']}"


ENTRIES = list(entries()) if EDS.is_file() else []


def limits(section):
    """(form, low, high): the range that the EDS gives, else the type's own."""
    form = FORMS[int(section["DataType"], 16)]
    if form == "f":
        return form, float(section["LowLimit"]), float(section["HighLimit"])
    bits = 8 * struct.calcsize("<" + form)
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if form.islower() else (0, (1 << bits) - 1)
    return form, int(section.get("LowLimit", str(low)), 0), int(section.get("HighLimit", str(high)), 0)


def beyond(form, low, high):
    """Values next to the range that the type can hold, with the abort code they must have."""
    if form == "f":
        f32 = lambda x: struct.unpack("<f", struct.pack("<f", x))[0]  # noqa: E731
        above = f32(high) + max(abs(high), 1.0) * 1e-6
        below = f32(low) - max(abs(low), 1.0) * 1e-6
        return [(above, HIGH), (below, LOW), (math.nan, VALUE), (math.inf, VALUE), (-math.inf, VALUE)]
    bits = 8 * struct.calcsize("<" + form)
    floor, ceiling = (-(1 << bits - 1), (1 << bits - 1) - 1) if form.islower() else (0, (1 << bits) - 1)
    found = []
    for value, code in ((high + 1, HIGH), (ceiling, HIGH), (low - 1, LOW), (floor, LOW)):
        if floor <= value <= ceiling and not low <= value <= high:
            found.append((value, code))
    return found


def test_the_eds_was_built():
    assert len(ENTRIES) > 250, f"{EDS} was not built"


def test_every_object_is_read_by_stock_python_canopen_with_the_type_that_the_eds_says(wire):
    network = canopen.Network()
    network.connect(interface="socketcan", channel="vcan0")
    try:
        node = network.add_node(NODE, str(EDS))
        node.sdo.RESPONSE_TIMEOUT = 2.0
        read = 0
        for obj in node.object_dictionary.values():
            if obj.index < 0x1000:
                continue  # dummies exist for mapping only
            for variable in [obj] if isinstance(obj, canopen.objectdictionary.ODVariable) else list(obj.values()):
                if variable.index == 0x1003 and variable.subindex > 0:
                    continue  # what is in the history depends on what has happened
                data = node.sdo.upload(variable.index, variable.subindex)
                if variable.data_type != VISIBLE_STRING:
                    assert 8 * len(data) == len(variable), variable.name
                if variable.access_type == "const" and variable.default not in (None, "") and variable.index not in (0x2001,):
                    assert variable.decode_raw(data) == variable.default, variable.name
                read += 1
        assert read == len(ENTRIES) - 8
    finally:
        network.disconnect()


@pytest.mark.parametrize("entry", [e for e in ENTRIES if e[2]["AccessType"] in ("ro", "const")], ids=describe)
def test_what_is_read_only_is_not_written(wire_once, entry):
    index, sub, section = entry
    size = 1 if int(section["DataType"], 16) == VISIBLE_STRING else struct.calcsize("<" + FORMS[int(section["DataType"], 16)])
    for length in {1, size, 4}:
        assert wire_once.abort_of(wire_once.download, index, sub, bytes(length)) == READ_ONLY


@pytest.mark.parametrize("entry", [e for e in ENTRIES if e[2]["AccessType"] in ("rw", "rww", "rwr")
                                   and e[0] not in PROCEDURES], ids=describe)
def test_what_is_writable_takes_its_whole_range_and_nothing_else(wire_once, entry):
    wire, (index, sub, section) = wire_once, entry
    before = wire.upload(index, sub)
    try:
        if int(section["DataType"], 16) == VISIBLE_STRING:
            for length in (0, 1, 4, 7, 32):
                wire.download(index, sub, b"x" * length)
                assert wire.upload(index, sub) == b"x" * length
            assert wire.abort_of(wire.download, index, sub, b"y" * 33) == TOO_LONG
            assert wire.upload(index, sub) == b"x" * 32
            return
        form, low, high = limits(section)
        size = struct.calcsize("<" + form)
        for value in (low, high):
            wire.write(index, sub, value, form)
            assert wire.upload(index, sub) == struct.pack("<" + form, value)
        for value, code in beyond(form, low, high):
            assert wire.abort_of(wire.write, index, sub, value, form) == code, value
        assert wire.abort_of(wire.download, index, sub, bytes(size + 1)) == TOO_LONG
        if size > 1:
            assert wire.abort_of(wire.download, index, sub, bytes(size - 1)) == TOO_SHORT
        assert wire.upload(index, sub) == struct.pack("<" + form, high), "what was refused changed nothing"
    finally:
        wire.download(index, sub, before)


def test_every_procedure_is_in_the_eds():
    assert set(PROCEDURES) <= {index for index, _, _ in ENTRIES}


def test_an_object_for_tests_is_not_in_the_eds_and_not_readable(wire):
    assert 0x2F00 not in {index for index, _, _ in ENTRIES}
    with pytest.raises(Abort) as abort:
        wire.upload(0x2F00)
    assert abort.value.code == 0x06010001


def test_without_the_option_there_is_no_such_object(bare_module, fresh_robot):
    fresh_robot.module(2, plant=False)
    with Wire("vcan0", node=3) as other:
        for action in (lambda: other.upload(0x2F00), lambda: other.write(0x2F00, 0, 0x1000, "H")):
            assert other.abort_of(action) == 0x06020000


@pytest.fixture(scope="module")
def wire_once(bare_module):
    """Reset once for all of these: each leaves an object as it found it."""
    with Wire("vcan0", node=NODE) as wire:
        wire.reset()
        yield wire
    assert bare_module.alive(), bare_module.text()

"""The EDS against CiA 306, read line by line here and not by the library that clients use: sections, lists, mandatory
objects, types, limits, defaults, mappings. Then python-canopen's own picture of it against the schema."""

import re

import canopen
import pytest

# CiA 301 data type: (bytes, signed); None: no integer.
INTEGERS = {0x02: (1, True), 0x03: (2, True), 0x04: (4, True), 0x05: (1, False), 0x06: (2, False), 0x07: (4, False),
            0x15: (8, True), 0x1B: (8, False)}
REAL32, VISIBLE_STRING = 0x08, 0x09
NODE_ID = 0x25


@pytest.fixture(scope="module")
def path(build_dir):
    return build_dir / "generated" / "can_protocol" / "module.eds"


@pytest.fixture(scope="module")
def sections(path):
    """{section: {key: value}} in upper case; a section or key that comes twice is an error, as is any other line."""
    found, current = {}, None
    for number, line in enumerate(path.read_text(encoding="ascii").splitlines(), 1):
        assert len(line) <= 255, number
        if not line or line.startswith(";"):
            continue
        if header := re.fullmatch(r"\[([^\[\]]+)\]", line):
            name = header[1].upper()
            assert name not in found, f"line {number}: [{name}] comes twice"
            current = found[name] = {}
            continue
        assert current is not None, f"line {number}: before the first section"
        key, equals, value = line.partition("=")
        assert equals and key == key.strip() and value == value.strip(), f"line {number}: {line}"
        assert key.upper() not in current, f"line {number}: {key} comes twice"
        current[key.upper()] = value
    return found


def number(text, signed_bytes=None):
    """A number as CiA 306 writes it: decimal, 0x hexadecimal, or $NODEID+..."""
    add = 0
    if text.upper().startswith("$NODEID+"):
        text, add = text[len("$NODEID+"):], NODE_ID
    assert re.fullmatch(r"-?\d+|0[xX][0-9A-Fa-f]+", text), text
    value = int(text, 16 if text[:2].lower() == "0x" else 10) + add
    if signed_bytes and text[:2].lower() == "0x" and value >= 1 << (8 * signed_bytes - 1):
        value -= 1 << 8 * signed_bytes
    return value


def object_list(sections, title):
    section = sections[title]
    count = number(section["SUPPORTEDOBJECTS"])
    assert set(section) == {"SUPPORTEDOBJECTS"} | {str(i) for i in range(1, count + 1)}, title
    indices = [number(section[str(i)]) for i in range(1, count + 1)]
    assert indices == sorted(set(indices)), title
    return indices


@pytest.fixture(scope="module")
def variables(sections):
    """{(index, sub-index): section} of everything that has a value."""
    found = {}
    for name, section in sections.items():
        if match := re.fullmatch(r"([0-9A-F]{4})(?:SUB([0-9A-F]{1,2}))?", name):
            if number(section["OBJECTTYPE"]) == 7:
                found[int(match[1], 16), int(match[2] or "0", 16)] = section
    return found


def test_file_and_device_are_described(sections):
    info = sections["FILEINFO"]
    assert info["FILENAME"] == "module.eds"
    assert info["EDSVERSION"] == "4.0"
    for key in ("CREATIONTIME", "MODIFICATIONTIME"):
        assert re.fullmatch(r"(0[1-9]|1[0-2]):[0-5]\d(AM|PM)", info[key]), key
    for key in ("CREATIONDATE", "MODIFICATIONDATE"):
        assert re.fullmatch(r"(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])-\d{4}", info[key]), key
    for key in ("FILEVERSION", "FILEREVISION"):
        assert 0 <= number(info[key]) <= 255
    for key in ("DESCRIPTION", "CREATEDBY", "MODIFIEDBY"):
        assert info[key]
    device = sections["DEVICEINFO"]
    for key in ("VENDORNAME", "PRODUCTNAME", "ORDERCODE"):
        assert device[key]
    for key in ("VENDORNUMBER", "PRODUCTNUMBER", "REVISIONNUMBER", "GRANULARITY", "DYNAMICCHANNELSSUPPORTED"):
        number(device[key])
    for rate in (10, 20, 50, 125, 250, 500, 800, 1000):
        assert device[f"BAUDRATE_{rate}"] in "01"
    for key in ("SIMPLEBOOTUPMASTER", "SIMPLEBOOTUPSLAVE", "GROUPMESSAGING", "LSS_SUPPORTED"):
        assert device[key] in "01"
    assert 1 <= number(device["GRANULARITY"]) <= 64
    assert set(sections["DUMMYUSAGE"]) == {f"DUMMY{i:04X}" for i in range(1, 8)}


def test_device_is_the_identity_object(sections, variables):
    device = sections["DEVICEINFO"]
    for key, sub in (("VENDORNUMBER", 1), ("PRODUCTNUMBER", 2), ("REVISIONNUMBER", 3)):
        assert number(device[key]) == number(variables[0x1018, sub]["DEFAULTVALUE"])
    pdos = {key: sum(1 for i, s in variables if s == 0 and i & 0xFE00 == base)
            for key, base in (("NROFRXPDO", 0x1400), ("NROFTXPDO", 0x1800))}
    assert {key: number(device[key]) for key in pdos} == pdos


def test_every_object_is_in_the_one_list_that_it_belongs_to(sections):
    mandatory = object_list(sections, "MANDATORYOBJECTS")
    optional = object_list(sections, "OPTIONALOBJECTS")
    manufacturer = object_list(sections, "MANUFACTUREROBJECTS")
    assert mandatory == [0x1000, 0x1001, 0x1018]
    assert all(0x2000 <= i <= 0x5FFF for i in manufacturer) and manufacturer
    assert all(0x1000 <= i <= 0x1FFF or 0x6000 <= i <= 0x9FFF for i in optional) and optional
    listed = mandatory + optional + manufacturer
    assert len(listed) == len(set(listed))
    assert set(listed) == {int(name, 16) for name in sections if re.fullmatch(r"[0-9A-F]{4}", name)}


def test_objects_that_the_two_profiles_demand_are_there(variables):
    # CiA 301 for a device with SYNC, EMCY, heartbeat and dynamic PDO mapping; CiA 402 for modes 6, 8 and 10.
    for index, sub in ((0x1003, 0), (0x1005, 0), (0x1008, 0), (0x1014, 0), (0x1016, 1), (0x1017, 0), (0x1018, 4),
                       (0x603F, 0), (0x6040, 0), (0x6041, 0), (0x6060, 0), (0x6061, 0), (0x6064, 0), (0x606C, 0),
                       (0x6071, 0), (0x6077, 0), (0x607A, 0), (0x607C, 0), (0x607D, 2), (0x6098, 0), (0x6099, 2),
                       (0x609A, 0), (0x60C2, 2), (0x6502, 0)):
        assert (index, sub) in variables, f"{index:04X}h:{sub:02X}"
    assert number(variables[0x1000, 0]["DEFAULTVALUE"]) & 0xFFFF == 402


def test_records_and_arrays_have_their_sub_indices(sections, variables):
    for name, section in sections.items():
        if not re.fullmatch(r"[0-9A-F]{4}", name):
            continue
        kind, index = number(section["OBJECTTYPE"]), int(name, 16)
        assert kind in (7, 8, 9), name
        assert section["PARAMETERNAME"] and len(section["PARAMETERNAME"]) <= 241
        subs = sorted(s for i, s in variables if i == index)
        if kind == 7:
            assert subs == [0] and "SUBNUMBER" not in section
            continue
        assert number(section["SUBNUMBER"]) == len(subs), name
        assert subs[0] == 0 and len(subs) >= 2
        first = variables[index, 0]
        assert number(first["DATATYPE"]) == 0x05 and first["PARAMETERNAME"]
        if index != 0x1003 and not 0x1600 <= index < 0x1800 and not 0x1A00 <= index < 0x1C00:
            assert first["ACCESSTYPE"] == "const" and number(first["DEFAULTVALUE"]) == subs[-1], name
        if kind == 8:
            assert len({variables[index, s]["DATATYPE"] for s in subs[1:]}) == 1
            assert subs == list(range(len(subs)))


def test_every_value_has_a_type_an_access_and_a_default_within_its_limits(variables):
    for (index, sub), section in variables.items():
        where = f"{index:04X}h:{sub:02X}"
        assert set(section) <= {"PARAMETERNAME", "OBJECTTYPE", "DATATYPE", "LOWLIMIT", "HIGHLIMIT", "ACCESSTYPE",
                                "DEFAULTVALUE", "PDOMAPPING"}, where
        assert section["PARAMETERNAME"], where
        assert section["ACCESSTYPE"] in ("ro", "wo", "rw", "rwr", "rww", "const"), where
        assert section["PDOMAPPING"] in "01", where
        kind, default = number(section["DATATYPE"]), section["DEFAULTVALUE"]
        assert ("LOWLIMIT" in section) == ("HIGHLIMIT" in section), where
        if kind in INTEGERS:
            size, signed = INTEGERS[kind]
            floor, ceiling = (-(1 << 8 * size - 1), (1 << 8 * size - 1) - 1) if signed else (0, (1 << 8 * size) - 1)
            value = number(default, size if signed else None)
            low = number(section["LOWLIMIT"]) if "LOWLIMIT" in section else floor
            high = number(section["HIGHLIMIT"]) if "HIGHLIMIT" in section else ceiling
            assert floor <= low <= value <= high <= ceiling, where
        elif kind == REAL32:
            value = float(default)
            if "LOWLIMIT" in section:
                assert float(section["LOWLIMIT"]) <= value <= float(section["HIGHLIMIT"]), where
            assert section["PDOMAPPING"] == "0", where
        else:
            assert kind == VISIBLE_STRING, where
            assert section["PDOMAPPING"] == "0", where


@pytest.mark.parametrize("base, access", [(0x1600, {"rww", "rw"}), (0x1A00, {"ro", "rwr", "rw"})])
def test_default_mappings_fit_and_name_objects_that_may_be_mapped(variables, base, access):
    indices = sorted({i for i, _ in variables if i & 0xFF00 == base})
    assert indices
    for index in indices:
        count, bits = number(variables[index, 0]["DEFAULTVALUE"]), 0
        for sub in range(1, count + 1):
            mapped = number(variables[index, sub]["DEFAULTVALUE"])
            target = variables[mapped >> 16, mapped >> 8 & 0xFF]
            assert target["PDOMAPPING"] == "1" and target["ACCESSTYPE"] in access
            assert INTEGERS[number(target["DATATYPE"])][0] * 8 == mapped & 0xFF
            bits += mapped & 0xFF
        assert 0 < bits <= 64
        for sub in range(count + 1, 9):
            assert number(variables[index, sub]["DEFAULTVALUE"]) == 0
        assert (index - 0x200, 1) in variables and (index - 0x200, 2) in variables


def test_cob_ids_are_free_of_each_other_and_of_what_cia_301_keeps(variables):
    ids = {}
    for base, subs in ((0x1005, [0]), (0x1014, [0]), (0x1200, [1, 2]), *((i, [1]) for i, s in variables
                                                                         if s == 1 and i & 0xFB00 in (0x1400, 0x1800) and i & 0xFE00 in (0x1400, 0x1800))):
        for sub in subs:
            value = number(variables[base, sub]["DEFAULTVALUE"])
            if not value >> 31:
                ids[base, sub] = value & 0x7FF
    assert len(set(ids.values())) == len(ids)
    for place, value in ids.items():
        assert not (value <= 0x07F or 0x101 <= value <= 0x180 or 0x6E0 <= value <= 0x6FF or value >= 0x701), place
        assert place[0] == 0x1200 or not (0x581 <= value <= 0x5FF or 0x601 <= value <= 0x67F), place


def test_python_canopen_has_the_same_picture(path, variables, build_dir):
    dictionary = canopen.import_od(str(path), node_id=NODE_ID)
    seen = set()
    for obj in (o for o in dictionary.values() if o.index >= 0x1000):  # below: dummies for mapping
        for variable in [obj] if isinstance(obj, canopen.objectdictionary.ODVariable) else list(obj.values()):
            key = variable.index, variable.subindex
            section = variables[key]
            kind = number(section["DATATYPE"])
            assert variable.data_type == kind, key
            assert variable.name.split(".")[-1] == section["PARAMETERNAME"], key
            assert variable.access_type == section["ACCESSTYPE"], key
            assert variable.pdo_mappable == (section["PDOMAPPING"] == "1"), key
            if kind in INTEGERS:
                size, signed = INTEGERS[kind]
                assert variable.default == number(section["DEFAULTVALUE"], size if signed else None), key
                if "LOWLIMIT" in section:
                    assert (variable.min, variable.max) == (number(section["LOWLIMIT"]), number(section["HIGHLIMIT"])), key
                assert len(variable) == 8 * size, key
            elif kind == REAL32:
                assert variable.default == float(section["DEFAULTVALUE"]), key
            else:
                assert variable.default == section["DEFAULTVALUE"], key
            seen.add(key)
    assert seen == set(variables)

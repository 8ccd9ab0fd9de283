"""What the schema generates, as stock tools read it: the EDS by canopen, the DBC by cantools; and the page in docs is up to date."""

import importlib.util
import struct
import subprocess

import canopen
import can
import cantools
import pytest

GENERATOR_PYTHON = "/usr/bin/python3"  # Debian's, which has PyYAML


@pytest.fixture(scope="module")
def generate(source_dir, tmp_path_factory):
    def run(what, *options):
        path = tmp_path_factory.mktemp("generated") / what
        subprocess.run([GENERATOR_PYTHON, source_dir / "can_protocol" / "generate.py", what, path, *options], check=True)
        return path

    return run


@pytest.fixture(scope="module")
def constants(build_dir):
    path = build_dir / "generated" / "can_protocol" / "mrr_objects.py"
    spec = importlib.util.spec_from_file_location("mrr_objects", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def dictionary(build_dir):
    return canopen.import_od(str(build_dir / "generated" / "can_protocol" / "module.eds"), node_id=5)


def entry(dictionary, index, sub):
    found = dictionary[index]
    return found if isinstance(found, canopen.objectdictionary.ODVariable) else found[sub]


def test_the_reference_page_is_what_the_schema_says(generate, source_dir):
    fresh = generate("markdown").read_text()
    assert (source_dir / "docs" / "object_dictionary.md").read_text() == fresh, \
        "run can_protocol/generate.py markdown docs/object_dictionary.md"


def test_the_build_used_this_schema(generate, build_dir):
    for what, name in (("eds", "module.eds"), ("python", "mrr_objects.py")):
        assert (build_dir / "generated" / "can_protocol" / name).read_text() == generate(what).read_text()


def test_eds_has_every_object_with_its_type(dictionary, constants):
    from canopen.objectdictionary import datatypes

    types = {"u8": datatypes.UNSIGNED8, "u16": datatypes.UNSIGNED16, "u32": datatypes.UNSIGNED32,
             "u64": datatypes.UNSIGNED64, "i8": datatypes.INTEGER8, "i16": datatypes.INTEGER16,
             "i32": datatypes.INTEGER32, "f32": datatypes.REAL32, "string": datatypes.VISIBLE_STRING}
    assert len(constants.OBJECTS) > 200
    for name, (index, sub, kind, _, _) in constants.OBJECTS.items():
        if name == "test_fault":
            assert index not in dictionary, "test objects are not for everybody"
            continue
        assert entry(dictionary, index, sub).data_type == types[kind], name


def test_eds_defaults_carry_the_node_id(dictionary):
    assert dictionary[0x1014].default == 0x85
    assert dictionary[0x1400][1].default == 0x205
    assert dictionary[0x1403][1].default == 0x181
    assert dictionary[0x1800][1].default == 0x40000185
    assert dictionary[0x2000].default == dictionary["protocol_hash"].default != 0


def test_eds_maps_only_what_it_describes(dictionary):
    for base in (*range(0x1600, 0x1604), *range(0x1A00, 0x1A03)):
        record = dictionary[base]
        bits = 0
        for k in range(1, record[0].default + 1):
            mapped = record[k].default
            target = entry(dictionary, mapped >> 16, (mapped >> 8) & 0xFF)
            assert target.pdo_mappable
            assert len(target) == mapped & 0xFF
            bits += mapped & 0xFF
        assert 0 < bits <= 64


def test_eds_limits_and_access(dictionary):
    mode = dictionary[0x6060]
    assert (mode.min, mode.max) == (-1, 10)
    assert mode.writable and mode.readable
    assert not dictionary[0x6041].writable


@pytest.fixture(scope="module")
def dbc(generate):
    return cantools.database.load_file(generate("dbc", "--node", "base=2", "--node", "shoulder=3"), database_format="dbc")


def test_dbc_has_every_pdo_of_every_node(dbc, constants):
    for name, (cob_id, has_node_id, content) in constants.PDOS.items():
        for node in ((2, 3) if has_node_id else (0,)):
            message = dbc.get_message_by_frame_id(cob_id + node)
            assert [s.name for s in message.signals] == list(content), name


def test_dbc_decodes_to_si(dbc):
    data = struct.pack("<HbiB", 0x1637, -1, -1234567, 3)
    assert dbc.decode_message(0x183, data) == {
        "statusword": 0x1637, "modes_of_operation_display": -1, "position_actual_urad": pytest.approx(-1.234567),
        "selection_acknowledged": 3}
    assert dbc.get_message_by_frame_id(0x183).get_signal_by_name("position_actual_urad").unit == "rad"
    knot = {"target_position_urad": 0.5, "velocity_offset_urad_s": -2.0}
    assert dbc.encode_message(0x302, knot) == struct.pack("<ii", 500000, -2000000)
    emergency = dbc.decode_message(0x082, struct.pack("<HB5s", 0x8611, 0x21, bytes(5)))
    assert str(emergency["emergency_code"]) == "following_error"
    assert str(dbc.decode_message(0x702, b"\x05")["nmt_state"]) == "operational"


def test_dbc_decodes_every_frame_of_a_run(generate, program, tmp_path):
    nodes = [option for k in (1, 2, 3) for option in ("--node", f"joint_{k}={k + 1}")]
    database = cantools.database.load_file(generate("dbc", *nodes), database_format="dbc")
    subprocess.run([program("cli/mrr"), "hammer", "--out", tmp_path / "out", "--no-report"], check=True, capture_output=True)
    names = set()
    with can.CanutilsLogReader(tmp_path / "out" / "bus.log") as reader:
        for frame in reader:
            message = database.get_message_by_frame_id(frame.arbitration_id)
            assert len(frame.data) == message.length, message.name
            message.decode(frame.data)
            names.add(message.name)
    assert {"supervisor_heartbeat", "joint_1_heartbeat", "joint_1_sdo_answer", "joint_3_tpdo1", "selection"} <= names


@pytest.mark.parametrize("options", [(), ("--node", "base=1"), ("--node", "base=128"), ("--node", "2=2"), ("--node", "base")])
def test_dbc_refuses_nodes_that_cannot_be(source_dir, tmp_path, options):
    done = subprocess.run([GENERATOR_PYTHON, source_dir / "can_protocol" / "generate.py", "dbc", tmp_path / "x", *options],
                          capture_output=True, text=True)
    assert done.returncode != 0 and "error" in done.stderr
    assert not (tmp_path / "x").exists()

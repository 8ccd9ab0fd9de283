"""What the schema generates, as stock tools read it: the EDS by canopen, the DBC by cantools; and the page in docs is up to date."""

import importlib.util
import re
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


def test_the_page_of_faults_is_what_the_schema_says(generate, source_dir):
    assert (source_dir / "docs" / "faults.md").read_text() == generate("faults").read_text(), \
        "run can_protocol/generate.py faults docs/faults.md"


def test_eds_and_constants_name_every_fault(build_dir, constants):
    eds = (build_dir / "generated" / "can_protocol" / "module.eds").read_text()
    assert len(constants.FAULTS) > 30
    for name, (code, reaction, _) in constants.FAULTS.items():
        assert code in constants.EMERGENCIES, name
        assert f"={code:04X}h {name}: {reaction}. " in eds


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
    assert (mode.min, mode.max) == (-5, 10)
    assert mode.writable and mode.readable
    assert not dictionary[0x6041].writable


@pytest.fixture(scope="module")
def dbc(generate):
    return cantools.database.load_file(generate("dbc", "--node", "base=2", "--node", "shoulder=3"), database_format="dbc")


# What the ending of a raw name counts in, and how the SI value is called; written down here a second time on purpose.
RAW_ENDINGS = {"_urad_s": ("_rad_s", 1e-6, "rad/s"), "_mrad_s2": ("_rad_s2", 1e-3, "rad/s^2"), "_urad": ("_rad", 1e-6, "rad"),
               "_us": ("_s", 1e-6, "s"), "_permille": ("_ratio", 1e-3, None), "_percent": ("_ratio", 1e-2, None),
               "_ddegc": ("_degc", 0.1, "degC"), "_degc": ("_degc", 1, "degC"), "_cv": ("_v", 0.01, "V")}


def si_of(raw, constants):
    """(name, factor, unit) that the signal of an object must have."""
    for ending, (si, factor, unit) in RAW_ENDINGS.items():
        if raw.endswith(ending):
            assert constants.OBJECTS[raw][3] == factor, raw
            return raw[:-len(ending)] + si, factor, unit
    return raw, 1, None


def physical(signal):
    return signal.name, signal.scale, signal.unit


def test_dbc_has_every_pdo_of_every_node(dbc, constants):
    for name, (cob_id, has_node_id, content) in constants.PDOS.items():
        for node in ((2, 3) if has_node_id else (0,)):
            message = dbc.get_message_by_frame_id(cob_id + node)
            signals = message.signals
            assert len(signals) == len(content), name
            for signal, raw in zip(signals, content):
                assert physical(signal) == si_of(raw, constants), raw


def test_dbc_decodes_to_si(dbc):
    data = struct.pack("<HbiB", 0x1637, -1, -1234567, 3)
    assert dbc.decode_message(0x183, data) == {
        "statusword": 0x1637, "modes_of_operation_display": -1, "position_actual_rad": pytest.approx(-1.234567),
        "selection_acknowledged": 3}
    assert dbc.get_message_by_frame_id(0x183).get_signal_by_name("position_actual_rad").unit == "rad"
    knot = {"target_position_rad": 0.5, "velocity_offset_rad_s": -2.0}
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


@pytest.fixture(scope="module")
def from_changed_schema(source_dir, tmp_path_factory):
    """from_changed_schema(OLD, NEW, ...): every file of a schema in which one text is another; and of the schema as it is."""
    schema = (source_dir / "can_protocol" / "schema" / "module.yaml").read_text()

    def run(*changes):
        folder = tmp_path_factory.mktemp("changed")
        changed = schema
        for old, new in changes:
            assert changed.count(old) == 1, old
            changed = changed.replace(old, new)
        (folder / "module.yaml").write_text(changed)
        made = {}
        for what in ("cpp", "eds", "dbc", "markdown", "python"):
            options = ["--node", "base=2"] if what == "dbc" else []
            subprocess.run([GENERATOR_PYTHON, source_dir / "can_protocol" / "generate.py", what, folder / what, *options,
                            "--schema", folder / "module.yaml"], check=True)
            if what == "cpp":
                made["dictionary"] = (folder / what / "object_dictionary.h").read_text()
                made["pdo"] = (folder / what / "pdo.h").read_text()
            else:
                made[what] = (folder / what).read_text()
        return made

    return run


def lines_changed(before, after):
    """(lines only before, lines only after)."""
    old, new = before.splitlines(), after.splitlines()
    return [line for line in old if line not in new], [line for line in new if line not in old]


def test_one_change_of_a_limit_reaches_everything_that_has_limits(from_changed_schema):
    before = from_changed_schema()
    after = from_changed_schema(("low: 1000, high: 1000000,", "low: 1000, high: 777000,"))
    assert "1000LL, 777000LL" in after["dictionary"] and "1000LL, 777000LL" not in before["dictionary"]
    assert "HighLimit=777000" in lines_changed(before["eds"], after["eds"])[1]
    (row,) = [line for line in lines_changed(before["markdown"], after["markdown"])[1] if "2003h" in line]
    assert "1000 .. 777000" in row
    # A PDO has no limits; but every side sees by the hash that it is another protocol.
    assert before["pdo"] == after["pdo"] and before["dbc"] == after["dbc"]
    hashes = [re.search(r"PROTOCOL_HASH = (0x\w{8})", made["python"])[1] for made in (before, after)]
    assert hashes[0] != hashes[1]
    assert hashes[1] + "U" in after["dictionary"]
    assert f"DefaultValue=0x{int(hashes[1], 0):X}" in lines_changed(before["eds"], after["eds"])[1]
    assert f"`{hashes[1][2:]}h`" in after["markdown"]


def test_one_change_of_a_name_and_type_reaches_all(from_changed_schema):
    before = from_changed_schema()
    after = from_changed_schema(("name: torque_actual_permille, type: i16", "name: joint_torque_permille, type: i32"),
                                ("map: [velocity_actual_urad_s, torque_actual_permille, error_or_limit]",
                                 "map: [velocity_actual_urad_s, joint_torque_permille]"))
    for what in ("dictionary", "pdo", "eds", "markdown", "python"):
        assert "torque_actual_permille" in before[what] and "torque_actual_permille" not in after[what], what
        assert "joint_torque_permille" in after[what], what
    assert "std::int32_t joint_torque_permille" in after["dictionary"] and "std::int32_t joint_torque_permille" in after["pdo"]
    assert "SG_ torque_actual_ratio : 32|16@1-" in before["dbc"] and "SG_ joint_torque_ratio : 32|32@1-" in after["dbc"]
    assert "'joint_torque_permille': (0x6077, 0, 'i32', 0.001, '1')," in after["python"]
    assert "ParameterName=joint_torque_permille\nObjectType=0x7\nDataType=0x0004" in after["eds"]
    assert "0x60770020U" in after["dictionary"] and "DefaultValue=0x60770020" in after["eds"]


def test_a_text_alone_is_no_other_protocol(from_changed_schema):
    before = from_changed_schema()
    after = from_changed_schema(('doc: "Control word."', 'doc: "The word of control."'))
    assert "The word of control." in after["dictionary"] and "The word of control." in after["markdown"]
    for what in ("eds", "dbc", "python"):
        assert before[what] == after[what], what


@pytest.mark.parametrize("old, new, complaint", [
    ("name: position_demand_urad, type: i32", "name: position_demand_mrad_s2, type: i32", "position_demand_mrad_s2 ends in _mrad_s2"),
    ("name: position_demand_urad, type: i32", "name: position_demand, type: i32", "position_demand counts in 1e-06 rad"),
    ("index: 0x6062,", "index: 0x6064,", "6064h:00) is there twice"),
    ("name: statusword, type: u16", "name: statusword, type: u15", "type u15 is none of"),
    ("map: [controlword, modes_of_operation]", "map: [controlword, uptime_us]", "more than 8 bytes"),
    ("map: [controlword, modes_of_operation]", "map: [statusword]", "statusword is not mappable"),
    ("default: 4, low: 1, high: 255", "default: 0, low: 1, high: 255", "default 0 outside"),
    ("default: 4, low: 1, high: 255", "default: 4, low: 1, high: 256", "outside its type's"),
])
def test_a_schema_that_contradicts_itself_is_refused(source_dir, tmp_path, old, new, complaint):
    text = (source_dir / "can_protocol" / "schema" / "module.yaml").read_text()
    assert text.count(old) == 1
    (tmp_path / "bad.yaml").write_text(text.replace(old, new))
    done = subprocess.run([GENERATOR_PYTHON, source_dir / "can_protocol" / "generate.py", "eds", tmp_path / "x",
                           "--schema", tmp_path / "bad.yaml"], capture_output=True, text=True)
    assert done.returncode != 0
    assert str(tmp_path / "bad.yaml") in done.stderr and complaint in done.stderr
    assert not (tmp_path / "x").exists()

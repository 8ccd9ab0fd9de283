#!/usr/bin/env python3
"""Makes everything that follows from schema/module.yaml.

    generate.py cpp FOLDER            object_dictionary.h, faults.h and pdo.h
    generate.py eds FILE              EDS of a joint module
    generate.py dbc FILE --node NAME=ID ...   DBC of a robot
    generate.py markdown FILE         docs/object_dictionary.md
    generate.py faults FILE           docs/faults.md
    generate.py python FILE           constants for Python programs
"""
import argparse
import hashlib
import json
import pathlib
import sys

import yaml

HERE = pathlib.Path(__file__).resolve().parent
SCHEMA = HERE / "schema" / "module.yaml"

# type: (C++ type, bytes, CiA 301 data type)
TYPES = {
    "u8": ("std::uint8_t", 1, 0x05), "u16": ("std::uint16_t", 2, 0x06), "u32": ("std::uint32_t", 4, 0x07),
    "u64": ("std::uint64_t", 8, 0x1B), "i8": ("std::int8_t", 1, 0x02), "i16": ("std::int16_t", 2, 0x03),
    "i32": ("std::int32_t", 4, 0x04), "i64": ("std::int64_t", 8, 0x15), "f32": ("float", 4, 0x08),
    "string": (None, None, 0x09),
}
ACCESS = {"const": {"read"}, "ro": {"read"}, "rw": {"read", "write"}, "wo": {"write"}}
KEYS = {"index", "sub", "name", "type", "access", "doc", "pdo", "scale", "unit", "default", "low", "high", "allowed",
        "stored", "test_only", "length"}


# Ending of a name: (one count in SI, SI unit, ending of the name once the value is in SI).
UNIT_ENDINGS = {
    "urad": (1e-6, "rad", "rad"), "urad_s": (1e-6, "rad/s", "rad_s"), "mrad_s2": (1e-3, "rad/s^2", "rad_s2"),
    "us": (1e-6, "s", "s"), "ms": (1e-3, "s", "s"), "ns": (1e-9, "s", "s"), "100us": (1e-4, "s", "s"),
    "ma": (1e-3, "A", "a"), "mnm": (1e-3, "N m", "nm"), "cv": (1e-2, "V", "v"), "ddegc": (1e-1, "degC", "degc"),
    "degc": (1, "degC", "degc"), "hz": (1, "Hz", "hz"),
    "permille": (1e-3, "1", "ratio"), "percent": (1e-2, "1", "ratio"), "ppb": (1e-9, "1", "ratio"),
}


FAULT_KEYS = {"name", "emergency", "detect", "threshold", "of", "time_ms", "time", "reaction", "reaction_object", "latched",
              "cleared"}


class SchemaError(Exception):
    pass


class Entry:
    """One sub-index."""

    def __init__(self, index, sub, spec, *, offset=None):
        unknown = set(spec) - KEYS
        if unknown:
            raise SchemaError(f"{index:04X}h:{sub:02X}: unknown keys {sorted(unknown)}")
        self.index, self.sub = index, sub
        self.name = spec["name"]
        self.type = spec["type"]
        self.access = spec["access"]
        if self.type not in TYPES:
            raise SchemaError(f"{self.name}: type {self.type} is none of {list(TYPES)}")
        if self.access not in ACCESS:
            raise SchemaError(f"{self.name}: access {self.access} is none of {list(ACCESS)}")
        self.pdo = spec.get("pdo", "")
        if self.pdo not in ("", "rx", "tx", "both"):
            raise SchemaError(f"{self.name}: pdo {self.pdo} is none of rx, tx, both")
        self.scale, self.unit = spec.get("scale", 1), spec.get("unit", "")
        self.low, self.high, self.allowed = spec.get("low"), spec.get("high"), spec.get("allowed")
        self.stored, self.test_only = spec.get("stored", False), spec.get("test_only", False)
        self.doc = spec.get("doc", "")
        default = spec.get("default", "" if self.type == "string" else 0)
        self.adds_node_id = isinstance(default, str) and default.startswith("$NODEID+")
        self.default = int(default[len("$NODEID+"):], 0) if self.adds_node_id else default
        self.size = spec["length"] if self.type == "string" else TYPES[self.type][1]
        # Where it lives in the C++ struct.
        self.offset = offset or f"offsetof(ObjectDictionary, {self.name})"

    @property
    def id(self):
        return self.name

    @property
    def is_integer(self):
        return self.type not in ("f32", "string")

    def unit_ending(self):
        """The longest ending of the name that is a unit, or None."""
        endings = [e for e in UNIT_ENDINGS if self.name.endswith("_" + e)]
        return max(endings, key=len) if endings else None

    def si_name(self):
        """The name of the value in SI units: position_actual_urad is position_actual_rad there."""
        ending = self.unit_ending()
        return self.name[:-len(ending)] + UNIT_ENDINGS[ending][2] if ending else self.name

    def check_unit(self):
        """Name, scale and unit of an integer say the same."""
        if not self.is_integer:
            return
        ending = self.unit_ending()
        scale, unit = UNIT_ENDINGS[ending][:2] if ending else (1, None)
        if ending and (self.scale, self.unit) != (scale, unit):
            raise SchemaError(f"{self.name} ends in _{ending}, which is {scale:g} {unit}, but has {self.scale:g} {self.unit or '(no unit)'}")
        if not ending and self.scale != 1:
            raise SchemaError(f"{self.name} counts in {self.scale:g} {self.unit}: its name must end in that unit")

    def type_range(self):
        bits = 8 * self.size
        return (0, 2**bits - 1) if self.type[0] == "u" else (-2**(bits - 1), 2**(bits - 1) - 1)

    def limits(self):
        """(low, high, allowed mask) of an integer, (low, high) of a real, or None."""
        if self.low is None and self.high is None and self.allowed is None:
            return None
        if not self.is_integer:
            return (float(self.low), float(self.high))
        floor, ceiling = self.type_range()
        low = floor if self.low is None else self.low
        high = ceiling if self.high is None else self.high
        if not floor <= low <= high <= ceiling:
            raise SchemaError(f"{self.name}: limits {low}..{high} outside its type's {floor}..{ceiling}")
        mask = 2**64 - 1
        if self.allowed is not None:
            if high - low > 63:
                raise SchemaError(f"{self.name}: `allowed` needs a range of at most 64 values")
            mask = sum(1 << (value - low) for value in self.allowed)
        return (low, high, mask)


class Object:
    """One index: its entries, how it is declared in C++, what it is called."""

    def __init__(self, index, name, kind, doc, entries, declaration):
        self.index, self.name, self.kind, self.doc = index, name, kind, doc
        self.entries, self.declaration = entries, declaration


class Schema:
    def __init__(self, path=SCHEMA):
        raw = yaml.safe_load(path.read_text())
        self.device = raw["device"]
        self.objects = []
        for spec in raw["objects"]:
            self.objects.append(self._object(spec))
        self.by_name = {e.name: e for e in self.entries()}
        self.rpdos = [self._pdo(p, "rpdo", 0x1400, 0x1600) for p in raw["rpdos"]]
        self.tpdos = [self._pdo(p, "tpdo", 0x1800, 0x1A00) for p in raw["tpdos"]]
        self.objects.sort(key=lambda o: o.index)
        self.by_name = {e.name: e for e in self.entries()}
        self.emergencies, self.limit_codes = raw["emergencies"], raw["limit_codes"]
        self.reactions, self.faults = raw["reactions"], raw["faults"]
        self._check()
        self.hash = self._hash()
        self.by_name["protocol_hash"].default = self.hash

    def entries(self):
        return [e for o in self.objects for e in o.entries]

    def _object(self, spec):
        index, name, doc = spec["index"], spec["name"], spec.get("doc", "")
        if "record" in spec:
            subs = [Entry(index, i, s) for i, s in enumerate(spec["record"], 1)]
            top = Entry(index, 0, {"name": f"{name}_highest_sub", "type": "u8", "access": "const",
                                   "default": len(subs), "doc": "Highest sub-index."})
            return Object(index, name, "record", doc, [top, *subs], None)
        if "array" in spec:
            n = spec["array"]
            base = {k: v for k, v in spec.items() if k not in ("index", "array", "count", "name", "default")}
            default = spec.get("default", 0)
            defaults = default if isinstance(default, list) else [default] * n
            count = {"access": "const", "default": n, **spec.get("count", {})}
            top = Entry(index, 0, {"name": f"{name}_count", "type": "u8", "doc": "Number of entries.", **count})
            subs = [Entry(index, i + 1, {**base, "name": f"{name}_{i + 1}", "default": defaults[i]},
                          offset=f"offsetof(ObjectDictionary, {name}) + {i * TYPES[base['type']][1]}") for i in range(n)]
            cpp = TYPES[base["type"]][0]
            values = ", ".join(literal(s) for s in subs)
            return Object(index, name, "array", doc, [top, *subs],
                          f"std::array<{cpp}, {n}> {name}{{{{{values}}}}};")
        entry = Entry(index, 0, spec)
        return Object(index, name, "var", doc, [entry], None)

    def _pdo(self, spec, kind, communication, mapping):
        n, receive = spec["number"], kind == "rpdo"
        i = n - 1

        def offset(struct, of_struct, member):
            return (f"offsetof(ObjectDictionary, {kind}_{of_struct}) + {i} * sizeof({struct}) + "
                    f"offsetof({struct}, {member})")

        stored = {"stored": True}
        parameters = [
            (0, "highest_sub", "u8", "const", {"default": 5 if receive else 6}, "Highest sub-index."),
            (1, "cob_id", "u32", "rw", {"default": spec["cob_id"], **stored}, "COB-ID; bit 31: not valid."),
            (2, "transmission_type", "u8", "rw", {"default": spec["type"], **stored},
             "Transmission type."),
        ]
        if not receive:
            parameters.append((3, "inhibit_time_100us", "u16", "rw",
                               {"default": spec.get("inhibit_100us", 0), "scale": 1e-4, "unit": "s", **stored},
                               "Shortest time between two."))
        parameters.append((5, "event_timer_ms", "u16", "rw",
                           {"default": spec.get("event_timer_ms", 0), "scale": 1e-3, "unit": "s", **stored},
                           "Longest time between two; 0: none."))
        if not receive:
            parameters.append((6, "sync_start_value", "u8", "rw", {"default": 0, "high": 240, **stored},
                               "The SYNC with this counter is counted as the first one; 0: any."))
        entries = [Entry(communication + i, sub, {"name": f"{kind}{n}_{name}", "type": t, "access": a, "doc": d, **more},
                         offset=offset("PdoCommunication", "communication", name)) for sub, name, t, a, more, d in parameters]
        self.objects.append(Object(communication + i, f"{kind}{n}_communication", "record", spec["doc"], entries, ""))

        mapped = []
        for name in spec["map"]:
            if name not in self.by_name:
                raise SchemaError(f"{kind}{n}: no object {name}")
            mapped.append(self.by_name[name])
        entries = [Entry(mapping + i, 0, {"name": f"{kind}{n}_mapping_count", "type": "u8", "access": "rw",
                                          "default": len(mapped), "high": 8, "doc": "Number of mapped objects.",
                                          **stored}, offset=offset("PdoMapping", "mapping", "count"))]
        for k in range(8):
            value = 0
            if k < len(mapped):
                value = mapped[k].index << 16 | mapped[k].sub << 8 | 8 * mapped[k].size
            entries.append(Entry(mapping + i, k + 1, {"name": f"{kind}{n}_mapping_{k + 1}", "type": "u32", "access": "rw",
                                                      "default": value, "doc": "Mapped object.", **stored},
                                 offset=offset("PdoMapping", "mapping", "entries") + f" + {4 * k}"))
        self.objects.append(Object(mapping + i, f"{kind}{n}_mapping", "record", spec["doc"], entries, ""))
        return {**spec, "kind": kind, "entries": mapped,
                "name": f"{kind}{n}", "communication": communication + i, "mapping": mapping + i}

    def _check(self):
        seen_index, seen_name = set(), set()
        for entry in self.entries():
            if (entry.index, entry.sub) in seen_index or entry.name in seen_name:
                raise SchemaError(f"{entry.name} ({entry.index:04X}h:{entry.sub:02X}) is there twice")
            seen_index.add((entry.index, entry.sub))
            seen_name.add(entry.name)
            if entry.size > 32:
                raise SchemaError(f"{entry.name}: larger than 32 bytes")
            entry.check_unit()
            limits = entry.limits()
            if limits and entry.type == "u64":
                raise SchemaError(f"{entry.name}: u64 objects can have no limits")
            if limits and not isinstance(entry.default, str) and not limits[0] <= entry.default <= limits[1]:
                raise SchemaError(f"{entry.name}: default {entry.default} outside {limits[:2]}")
        for pdo in self.rpdos + self.tpdos:
            receive = pdo["kind"] == "rpdo"
            if sum(e.size for e in pdo["entries"]) > 8:
                raise SchemaError(f"{pdo['name']}: more than 8 bytes")
            for e in pdo["entries"]:
                if e.pdo not in (("rx", "both") if receive else ("tx", "both")):
                    raise SchemaError(f"{pdo['name']}: {e.name} is not mappable")

        self._check_faults()

    def _check_faults(self):
        codes = {e["name"]: e["code"] for e in self.emergencies}
        reactions = [r["name"] for r in self.reactions]
        names, used = set(), set()
        for fault in self.faults:
            name = fault["name"]
            unknown = set(fault) - FAULT_KEYS
            if unknown:
                raise SchemaError(f"fault {name}: unknown keys {sorted(unknown)}")
            missing = {"emergency", "detect", "reaction", "latched", "cleared"} - set(fault)
            if missing:
                raise SchemaError(f"fault {name}: {sorted(missing)} missing")
            if ("time" in fault) == ("time_ms" in fault):
                raise SchemaError(f"fault {name}: needs either time or time_ms")
            if name in names or fault["emergency"] in used:
                raise SchemaError(f"fault {name}: the name or its emergency is there twice")
            if not codes.get(fault["emergency"]):
                raise SchemaError(f"fault {name}: no emergency {fault['emergency']}")
            if fault["reaction"] not in reactions:
                raise SchemaError(f"fault {name}: reaction {fault['reaction']} is none of {reactions}")
            configured = fault.get("reaction_object", [])
            entries = [self.by_name.get(n) for n in configured]
            if None in entries or (entries and entries[0].default != reactions.index(fault["reaction"])):
                raise SchemaError(f"fault {name}: one of {configured} is no object, or the first one's default is not {fault['reaction']}")
            names.add(name)
            used.add(fault["emergency"])

    def fault_code(self, fault):
        return next(e["code"] for e in self.emergencies if e["name"] == fault["emergency"])

    def _hash(self):
        """Of all that two sides must agree on; not of texts."""
        picture = [[e.index, e.sub, e.name, e.type, e.size, e.access, e.pdo, e.scale, e.unit, e.limits(),
                    None if e.name == "protocol_hash" else e.default, e.adds_node_id] for e in self.entries()]
        picture.append([[e["code"], e["name"]] for e in self.emergencies + self.limit_codes])
        picture.append([[f["name"], f["reaction"], f["latched"]] for f in self.faults])
        return int.from_bytes(hashlib.sha256(json.dumps(picture).encode()).digest()[:4], "little")


# ---- C++ ----

def literal(entry):
    value = entry.default
    if entry.type == "string":
        return f"text<{entry.size}>({json.dumps(value)})"
    if entry.type == "f32":
        return f"{float(value)!r}F"
    if entry.type == "i32" and value == -2**31:
        return "-2147483647 - 1"
    if entry.type[0] == "u":
        return f"0x{value:X}U" if value > 9999 or entry.name.endswith("cob_id") or "_cob_id_" in entry.name else f"{value}U" if entry.size >= 4 else f"{value}"
    return str(value)


def cpp_type(entry):
    return f"std::array<char, {entry.size}>" if entry.type == "string" else TYPES[entry.type][0]


BANNER = "// Made by can_protocol/generate.py from can_protocol/schema/module.yaml: do not edit.\n"


def cpp_object_dictionary(schema):
    out = [BANNER + "// Room: can_protocol. The object dictionary of a joint module: values and what is known of each. Freestanding.",
           "#pragma once", "", "#include <array>", "#include <cstddef>", "#include <cstdint>", "",
           '#include "can_protocol/object.h"', "", "namespace mrr::can {", "",
           f"inline constexpr std::uint32_t kProtocolHash = 0x{schema.hash:08X}U;",
           f"inline constexpr std::size_t kRpdoCount = {len(schema.rpdos)};",
           f"inline constexpr std::size_t kTpdoCount = {len(schema.tpdos)};", "",
           "namespace detail {",
           "/// A text, filled up with NUL.",
           "template <std::size_t N, std::size_t M>",
           "constexpr std::array<char, N> text(const char (&s)[M]) noexcept {",
           "  static_assert(M <= N + 1);",
           "  std::array<char, N> a{};",
           "  for (std::size_t i = 0; i + 1 < M; ++i) a[i] = s[i];",
           "  return a;", "}", "}  // namespace detail", "",
           "/// The values of a joint module's objects. Units: suffix of the name; _urad is 1e-6 rad, _permille of the rated value,",
           "/// _ddegc 0.1 degC, _cv 0.01 V. COB-IDs hold their default without the node id until a Node adds it.",
           "struct ObjectDictionary {"]
    for obj in schema.objects:
        if obj.declaration == "":
            continue
        for entry in obj.entries:
            if obj.declaration and entry.sub:
                continue
            value = literal(entry).replace("text<", "detail::text<")
            note = f"{entry.index:04X}h" + (f":{entry.sub:02X}" if obj.kind != "var" else "")
            unit = f", {entry.scale} {entry.unit}" if entry.scale != 1 else (f", {entry.unit}" if entry.unit else "")
            out.append(f"  {cpp_type(entry)} {entry.name} = {value};  ///< {note} {entry.access}{unit}: {entry.doc}")
        if obj.declaration:
            e = obj.entries[1]
            unit = f", {e.scale} {e.unit}" if e.scale != 1 else (f", {e.unit}" if e.unit else "")
            out.append(f"  {obj.declaration}  ///< {obj.index:04X}h:01.. {e.access}{unit}: {e.doc}")
    for kind, pdos in (("rpdo", schema.rpdos), ("tpdo", schema.tpdos)):
        rows_c, rows_m = [], []
        for p in pdos:
            cob = schema.by_name[f"{p['name']}_cob_id"].default
            rows_c.append(f"{{.cob_id = 0x{cob:X}U, .event_timer_ms = {p.get('event_timer_ms', 0)}, "
                          f".highest_sub = {5 if kind == 'rpdo' else 6}, .transmission_type = {p['type']}}}")
            if p.get("inhibit_100us"):
                raise SchemaError("default inhibit times are not generated yet")
            values = ", ".join(f"0x{e.index << 16 | e.sub << 8 | 8 * e.size:08X}U" for e in p["entries"])
            rows_m.append(f"{{.entries = {{{values}}}, .count = {len(p['entries'])}}}")
        out.append(f"  std::array<PdoCommunication, {len(pdos)}> {kind}_communication{{{{" + ", ".join(rows_c) + "}};")
        out.append(f"  std::array<PdoMapping, {len(pdos)}> {kind}_mapping{{{{" + ", ".join(rows_m) + "}};")
    out += ["};", ""]

    entries = schema.entries()
    normal = [e for e in entries if not e.test_only]
    tests = [e for e in entries if e.test_only]
    out += ["/// Names every entry; the number is its place in kEntries.", "enum class ObjectId : std::uint16_t {"]
    for entry in entries:
        out += (["#ifndef MRR_NO_TEST_OBJECTS", f"  {entry.id},", "#endif"] if entry.test_only else [f"  {entry.id},"])
    out += ["  none = 0xFFFF,", "};", ""]

    integers, reals = [], []
    rows = []
    for entry in entries:
        limits, place = entry.limits(), "kNoLimits"
        if limits:
            table = integers if entry.is_integer else reals
            if limits not in table:
                table.append(limits)
            place = str(table.index(limits))
        flags = [f for f, on in (
            ("kReadable", "read" in ACCESS[entry.access]), ("kWritable", "write" in ACCESS[entry.access]),
            ("kRpdoMappable", entry.pdo in ("rx", "both")), ("kTpdoMappable", entry.pdo in ("tx", "both")),
            ("kStored", entry.stored), ("kTestOnly", entry.test_only), ("kAddsNodeId", entry.adds_node_id)) if on]
        row = (f"    {{0x{entry.index:04X}, 0x{entry.sub:02X}, Type::{entry.type}, {' | '.join(flags)}, {place}, "
               f"{entry.offset}, {entry.size}}},")
        rows += ["#ifndef MRR_NO_TEST_OBJECTS", row, "#endif"] if entry.test_only else [row]
    assert len(integers) < 255 and len(reals) < 255

    def wide(v):
        return "-9223372036854775807LL - 1" if v == -2**63 else f"{v}LL" if v < 2**63 else f"9223372036854775807LL"
    out += [f"inline constexpr std::array<IntegerLimits, {len(integers)}> kIntegerLimits{{{{"]
    out += [f"    {{{wide(lo)}, {wide(hi)}, 0x{mask:X}ULL}}," for lo, hi, mask in integers]
    out += ["}};", f"inline constexpr std::array<RealLimits, {len(reals)}> kRealLimits{{{{"]
    out += [f"    {{{lo!r}F, {hi!r}F}}," for lo, hi in reals]
    out += ["}};", "", "/// Every entry, sorted by index and sub-index.",
            "#ifndef MRR_NO_TEST_OBJECTS", f"inline constexpr std::size_t kEntryCount = {len(entries)};", "#else",
            f"inline constexpr std::size_t kEntryCount = {len(normal)};", "#endif",
            "inline constexpr std::array<Entry, kEntryCount> kEntries{{", *rows, "}};", ""]

    out += ["/// Emergency codes (CiA 301 and 402, FFxxh our own).", "enum class Emergency : std::uint16_t {"]
    out += [f"  {e['name']} = 0x{e['code']:04X},  ///< {e['doc']}" for e in schema.emergencies]
    out += ["};", "", "/// What limits a joint; shares the object error_or_limit with the emergency codes.",
            "enum class LimitCode : std::uint16_t {"]
    out += [f"  {e['name']} = {e['code']},  ///< {e['doc']}" for e in schema.limit_codes]
    out += ["};", "", "/// Plain-text name of an emergency or limit code, \"unknown\" if it is none.",
            "constexpr const char* name_of_code(std::uint16_t code) noexcept {", "  switch (code) {"]
    for e in schema.emergencies + [c for c in schema.limit_codes if c["code"]]:
        out.append(f"    case 0x{e['code']:04X}: return \"{e['name']}\";")
    out += ["    default: return \"unknown\";", "  }", "}", "", "}  // namespace mrr::can"]
    return "\n".join(out) + "\n"


def cpp_faults(schema):
    out = [BANNER + "// Room: can_protocol. The table of faults: code on the wire, threshold, time, reaction of each. Freestanding.",
           "#pragma once", "", "#include <array>", "#include <cstdint>", "", '#include "can_protocol/object_dictionary.h"',
           '#include "common/core/time.h"', "", "namespace mrr::can {", "",
           "/// What a joint does about a fault, from the mildest to the hardest.", "enum class Reaction : std::uint8_t {"]
    out += [f"  {r['name']},  ///< {r['doc']}" for r in schema.reactions]
    out += ["};", "", "/// Everything that is a fault; the number is its place in kFaults.", "enum class Fault : std::uint8_t {"]
    out += [f"  {f['name']},  ///< {f['detect']}" for f in schema.faults]
    out += ["  none,", "};", "", "struct FaultRow {", "  const char* name;", "  Emergency code;",
            "  Reaction reaction;            ///< by default, where an object configures it",
            "  bool latched;                 ///< until a fault reset", "  float threshold;              ///< 0: an object or a setting has it",
            "  Duration time;                ///< 0: at once, or an object or a setting has it", "};", "",
            f"inline constexpr std::size_t kFaultCount = {len(schema.faults)};",
            "inline constexpr std::array<FaultRow, kFaultCount> kFaults{{"]
    for f in schema.faults:
        out.append(f'    {{"{f["name"]}", Emergency::{f["emergency"]}, Reaction::{f["reaction"]}, {str(f["latched"]).lower()}, '
                   f'{float(f.get("threshold", 0))!r}F, milliseconds({f.get("time_ms", 0)})}},')
    out += ["}};", "", "/// Precondition: not none.", "constexpr const FaultRow& row_of(Fault fault) noexcept {",
            "  return kFaults[static_cast<std::size_t>(fault)];", "}", "", "}  // namespace mrr::can"]
    return "\n".join(out) + "\n"


def cpp_pdo(schema):
    out = [BANNER + "// Room: can_protocol. The default PDOs as structs: pack and unpack. Freestanding.",
           "#pragma once", "", "#include <optional>", "", '#include "can_protocol/codec.h"', '#include "can_protocol/frame.h"', "",
           "namespace mrr::can {", ""]
    for pdo in schema.rpdos + schema.tpdos:
        name, kind = pdo["name"], pdo["name"].capitalize()
        cob = schema.by_name[f"{name}_cob_id"]
        base, shared = cob.default & 0x7FF, not cob.adds_node_id
        size = sum(e.size for e in pdo["entries"])
        out += [f"/// {pdo['doc'][0].upper() + pdo['doc'][1:]}; COB-ID {base:03X}h{'' if shared else ' + node id'}, {size} bytes.",
                f"struct {kind} {{"]
        for e in pdo["entries"]:
            out.append(f"  {TYPES[e.type][0]} {e.name} = 0;  ///< {e.doc}")
        out += [f"  friend bool operator==(const {kind}&, const {kind}&) = default;", "};",
                f"inline constexpr std::uint32_t k{kind}CobId = 0x{base:03X};"]
        node, add = ("", "") if shared else ("std::uint8_t node_id, ", " + node_id")
        out += [f"constexpr Frame pack_{name}({node}const {kind}& v) noexcept {{", "  Frame f;",
                f"  f.id = k{kind}CobId{add};", f"  f.length = {size};"]
        at = 0
        for e in pdo["entries"]:
            out.append(f"  put<{TYPES[e.type][0]}>(f.data.data() + {at}, v.{e.name});")
            at += e.size
        out += ["  return f;", "}",
                f"/// Nothing if the frame is not a plain data frame of at least {size} bytes. Does not look at the COB-ID.",
                f"constexpr std::optional<{kind}> unpack_{name}(const Frame& f) noexcept {{",
                f"  if (f.extended || f.remote || f.length < {size}) return std::nullopt;", f"  {kind} v;"]
        at = 0
        for e in pdo["entries"]:
            out.append(f"  v.{e.name} = get<{TYPES[e.type][0]}>(f.data.data() + {at});")
            at += e.size
        out += ["  return v;", "}", ""]
    out.append("}  // namespace mrr::can")
    return "\n".join(out) + "\n"


# ---- EDS (CiA 306) ----

def eds_value(entry):
    if entry.type == "string":
        return entry.default
    if entry.adds_node_id:
        return f"$NODEID+0x{entry.default:X}"
    if entry.type == "f32":
        return repr(float(entry.default))
    return f"0x{entry.default:X}" if entry.default >= 0 else str(entry.default)


def eds_entry(entry, name, section, sub_number=None):
    mappable = entry.pdo != ""
    access = {"const": "const", "ro": "ro", "rw": "rw", "wo": "wo"}[entry.access]
    if access == "rw" and entry.pdo == "rx":
        access = "rww"
    lines = [f"[{section}]", f"ParameterName={name}", "ObjectType=0x7", f"DataType=0x{TYPES[entry.type][2]:04X}"]
    limits = entry.limits()
    if limits:
        lines += [f"LowLimit={limits[0]}", f"HighLimit={limits[1]}"]
    lines += [f"AccessType={access}", f"DefaultValue={eds_value(entry)}", f"PDOMapping={int(mappable)}"]
    return lines + [""]


def eds_comments(schema):
    lines = ["Faults: emergency code, name, reaction, what is detected"]
    lines += [f"{schema.fault_code(f):04X}h {f['name']}: {f['reaction']}. {f['detect']}." for f in schema.faults]
    return [f"Lines={len(lines)}", *[f"Line{i}={line}" for i, line in enumerate(lines, 1)]]


def eds(schema):
    d = schema.device
    rates = [10, 20, 50, 125, 250, 500, 800, 1000]
    out = ["[FileInfo]", "FileName=module.eds", "FileVersion=1", "FileRevision=1", "EDSVersion=4.0",
           "Description=MRR joint module, made by generate.py", "CreationTime=12:00AM", "CreationDate=01-01-2024", "CreatedBy=generate.py",
           "ModificationTime=12:00AM", "ModificationDate=01-01-2024", "ModifiedBy=generate.py", "",
           "[DeviceInfo]", f"VendorName={d['vendor_name']}", f"VendorNumber={d['vendor_number']}",
           f"ProductName={d['product_name']}", f"ProductNumber={d['product_number']}", f"RevisionNumber={d['revision_number']}",
           "OrderCode=0", *[f"BaudRate_{r}={int(r in d['bit_rates_kbit'])}" for r in rates],
           "SimpleBootUpMaster=0", "SimpleBootUpSlave=1", "Granularity=8", "DynamicChannelsSupported=0",
           "CompactPDO=0", "GroupMessaging=0", f"NrOfRXPDO={len(schema.rpdos)}", f"NrOfTXPDO={len(schema.tpdos)}",
           "LSS_Supported=1", "", "[DummyUsage]", "Dummy0001=0",
           *[f"Dummy{n:04X}=1" for n in range(2, 8)], "", "[Comments]", *eds_comments(schema), ""]
    objects = [o for o in schema.objects if not o.entries[0].test_only]
    mandatory = [o for o in objects if o.index in (0x1000, 0x1001, 0x1018)]
    maker = [o for o in objects if 0x2000 <= o.index < 0x6000]
    optional = [o for o in objects if o not in mandatory and o not in maker]
    for title, group in (("MandatoryObjects", mandatory), ("OptionalObjects", optional), ("ManufacturerObjects", maker)):
        out += [f"[{title}]", f"SupportedObjects={len(group)}", *[f"{i}=0x{o.index:04X}" for i, o in enumerate(group, 1)], ""]
        for obj in group:
            if obj.kind == "var":
                out += eds_entry(obj.entries[0], obj.name, f"{obj.index:04X}")
                continue
            out += [f"[{obj.index:04X}]", f"ParameterName={obj.name}", f"ObjectType=0x{8 if obj.kind == 'array' else 9:X}",
                    f"SubNumber={len(obj.entries)}", ""]
            for entry in obj.entries:
                out += eds_entry(entry, entry.name, f"{obj.index:04X}sub{entry.sub:X}")
    return "\n".join(out) + "\n"


# ---- DBC ----

def dbc(schema, nodes):
    """nodes: [(name, id)]. Physical values are SI, and so are the signals' names: position_actual_urad counts 1e-6 rad,
    so its signal is position_actual_rad with factor 1e-6."""
    out = ['VERSION ""', "", "NS_ :", "", "BS_:", "", "BU_: supervisor " + " ".join(n for n, _ in nodes), ""]
    comments, values = [], []

    def message(can_id, name, size, sender, signals):
        out.append(f"BO_ {can_id} {name}: {size} {sender}")
        for sname, start, bits, signed, scale, unit, receiver in signals:
            top = 2**(bits - 1) - 1 if signed else 2**bits - 1
            low = -2**(bits - 1) if signed else 0
            out.append(f' SG_ {sname} : {start}|{bits}@1{"-" if signed else "+"} ({scale:g},0) '
                       f'[{low * scale:.10g}|{top * scale:.10g}] "{unit}" {receiver}')
        out.append("")

    def pdo_signals(pdo, receiver):
        at = 0
        for e in pdo["entries"]:
            yield (e.si_name(), at, 8 * e.size, e.type[0] == "i", e.scale, e.unit if e.unit != "1" else "", receiver)
            at += 8 * e.size

    message(0x000, "nmt", 2, "supervisor", [("nmt_command", 0, 8, False, 1, "", "Vector__XXX"),
                                            ("nmt_node", 8, 8, False, 1, "", "Vector__XXX")])
    message(0x080, "sync", 1, "supervisor", [("sync_counter", 0, 8, False, 1, "", "Vector__XXX")])
    message(0x701, "supervisor_heartbeat", 1, "supervisor", [("nmt_state", 0, 8, False, 1, "", "Vector__XXX")])
    nmt_states = '0 "boot_up" 4 "stopped" 5 "operational" 127 "pre_operational"'
    values.append(f"VAL_ {0x701} nmt_state {nmt_states} ;")
    for pdo in schema.rpdos:
        cob = schema.by_name[f"{pdo['name']}_cob_id"]
        size = sum(e.size for e in pdo["entries"])
        if not cob.adds_node_id:
            message(cob.default & 0x7FF, pdo["doc"].split(",")[0], size, "supervisor", pdo_signals(pdo, "Vector__XXX"))
    for name, node in nodes:
        for pdo in schema.rpdos + schema.tpdos:
            cob = schema.by_name[f"{pdo['name']}_cob_id"]
            if not cob.adds_node_id:
                continue
            can_id = (cob.default & 0x7FF) + node
            receive = pdo["kind"] == "rpdo"
            size = sum(e.size for e in pdo["entries"])
            message(can_id, f"{name}_{pdo['name']}", size, "supervisor" if receive else name,
                    pdo_signals(pdo, name if receive else "supervisor"))
            comments.append(f'CM_ BO_ {can_id} "{pdo["doc"]}";')
        message(0x080 + node, f"{name}_emergency", 8, name,
                [("emergency_code", 0, 16, False, 1, "", "supervisor"), ("emergency_register", 16, 8, False, 1, "", "supervisor"),
                 ("emergency_detail", 24, 40, False, 1, "", "supervisor")])
        message(0x700 + node, f"{name}_heartbeat", 1, name, [("nmt_state", 0, 8, False, 1, "", "supervisor")])
        values.append(f'VAL_ {0x700 + node} nmt_state {nmt_states} ;')
        for can_id, what, sender, receiver in ((0x600 + node, "sdo_request", "supervisor", name),
                                               (0x580 + node, "sdo_answer", name, "supervisor")):
            message(can_id, f"{name}_{what}", 8, sender,
                    [(f"sdo_{part}", at, bits, False, 1, "", receiver) for part, at, bits in
                     (("command", 0, 8), ("index", 8, 16), ("sub_index", 24, 8), ("data", 32, 32))])
            comments.append(f'CM_ BO_ {can_id} "Parameter access; segments of long values use all eight bytes otherwise";')
        table = " ".join(f'{e["code"]} "{e["name"]}"' for e in schema.emergencies)
        values.append(f"VAL_ {0x080 + node} emergency_code {table} ;")
    return "\n".join(out + comments + values) + "\n"


# ---- Markdown ----

def markdown(schema):
    out = ["# Object dictionary", "",
           "Made by `can_protocol/generate.py` from `can_protocol/schema/module.yaml`; do not edit.", "",
           f"Protocol hash: `{schema.hash:08X}h` (object 2000h).", "", "## PDOs", "",
           "| PDO | COB-ID | type | content |", "| --- | --- | --- | --- |"]
    for pdo in schema.rpdos + schema.tpdos:
        cob = schema.by_name[f"{pdo['name']}_cob_id"]
        where = f"{cob.default & 0x7FF:03X}h" + (" + node id" if cob.adds_node_id else "")
        content = ", ".join(f"`{e.name}` {e.type}" for e in pdo["entries"])
        timer = f", every {pdo['event_timer_ms']} ms" if pdo.get("event_timer_ms") else ""
        out.append(f"| {pdo['name'].upper()} | {where} | {pdo['type']}{timer} | {content} |")
    out += ["", "Transmission types: 1-240 at every n-th SYNC; 0 at the SYNC after a change; 254 by event timer alone; "
            "255 on change and by event timer. RPDOs with a type up to 240 take effect at the next SYNC, others at once.", ""]
    for title, low, high in (("Communication (CiA 301)", 0x1000, 0x1FFF), ("Manufacturer", 0x2000, 0x5FFF),
                             ("Drive profile (CiA 402)", 0x6000, 0x9FFF)):
        out += [f"## {title}", "", "| index | name | type | access | PDO | unit | default | range | stored | |",
                "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"]
        for obj in schema.objects:
            if not low <= obj.index <= high:
                continue
            for e in obj.entries:
                place = f"{e.index:04X}h" + (f":{e.sub:02X}" if obj.kind != "var" else "")
                if e.scale != 1:
                    unit = f"{e.scale:g} {e.unit}" if e.unit != "1" else f"{e.scale:g}"
                else:
                    unit = e.unit
                default = f'"{e.default}"' if e.type == "string" else (
                    f"{e.default:08X}h" if e.name == "protocol_hash" else eds_value(e))
                limits = e.limits()
                if e.allowed:
                    bounds = ", ".join(str(v) for v in e.allowed)
                else:
                    bounds = f"{limits[0]:g} .. {limits[1]:g}" if limits else ""
                doc = e.doc + (" Only with `--test-faults`." if e.test_only else "")
                out.append(f"| {place} | {e.name} | {e.type} | {e.access} | {e.pdo} | {unit} | {default} | {bounds} | "
                           f"{'yes' if e.stored else ''} | {doc} |")
        out.append("")
    out += ["## Emergency codes", "", "| code | name | |", "| --- | --- | --- |"]
    out += [f"| {e['code']:04X}h | {e['name']} | {e['doc']} |" for e in schema.emergencies]
    out += ["", "## Limit codes", "", "| code | name | |", "| --- | --- | --- |"]
    out += [f"| {e['code']} | {e['name']} | {e['doc']} |" for e in schema.limit_codes]
    return "\n".join(out) + "\n"


def markdown_faults(schema):
    def place(name):
        entry = schema.by_name.get(name)
        if entry is None:
            return name
        return f"{entry.index:04X}h" + (f":{entry.sub:02X}" if entry.sub else "") + f" {name}"

    def limit(fault):
        return " ".join(([f"{fault['threshold']:g}"] if "threshold" in fault else [])
                        + ([place(fault["of"])] if "of" in fault else []))

    def time(fault):
        if "time" in fault:
            return place(fault["time"])
        return f"{fault['time_ms']} ms" if fault["time_ms"] else "at once"

    def reaction(fault):
        configured = fault.get("reaction_object", [])
        return fault["reaction"] + (f" ({', '.join(place(n) for n in configured)})" if configured else "")

    out = ["# Faults", "", "Made by `can_protocol/generate.py` from `can_protocol/schema/module.yaml`; do not edit.", "",
           "The code is what EMCY, 603Fh and `error_or_limit` (2013h, in TPDO2) say. The first fault is kept in 2030h with its time and a picture of the joint until the faults are reset "
           "(rising edge of controlword bit 7); later ones are counted there.",
           "A limit that holds the joint back without being a fault shows in `active_limit` (2014h) and, while there is no fault, in `error_or_limit`: see the "
           "[limit codes](object_dictionary.md#limit-codes). Several at once: the hardest reaction wins.", "",
           "| fault | code | detected: | threshold | for | reaction | latched | ends by |",
           "| --- | --- | --- | --- | --- | --- | --- | --- |"]
    for f in schema.faults:
        out.append(f"| {f['name']} | {schema.fault_code(f):04X}h | {f['detect']} | {limit(f)} | {time(f)} | {reaction(f)} | "
                   f"{'yes' if f['latched'] else 'no'} | {f['cleared']} |")
    out += ["", "## Reactions", "", "| number | reaction | |", "| --- | --- | --- |"]
    out += [f"| {i} | {r['name']} | {r['doc']} |" for i, r in enumerate(schema.reactions)]
    out += ["", "Every row is provoked on the emulated robot by `tests/integration/faults`: detection time, reaction, and what the bus is told. A row without a scenario fails there."]
    return "\n".join(out) + "\n"


# ---- Python ----

def python(schema):
    out = ['"""Made by can_protocol/generate.py from can_protocol/schema/module.yaml: do not edit."""', "",
           f"PROTOCOL_HASH = 0x{schema.hash:08X}", "",
           "# name: (index, sub-index, type, scale, unit)", "OBJECTS = {"]
    out += [f"    {e.name!r}: (0x{e.index:04X}, {e.sub}, {e.type!r}, {e.scale!r}, {e.unit!r})," for e in schema.entries()]
    out += ["}", "", "# name: (COB-ID, whether the node id is added, names of what it carries)", "PDOS = {"]
    for pdo in schema.rpdos + schema.tpdos:
        cob = schema.by_name[f"{pdo['name']}_cob_id"]
        out.append(f"    {pdo['name']!r}: (0x{cob.default & 0x7FF:03X}, {cob.adds_node_id}, {tuple(e.name for e in pdo['entries'])!r}),")
    out += ["}", "", "EMERGENCIES = {"] + [f"    0x{e['code']:04X}: {e['name']!r}," for e in schema.emergencies] + ["}", ""]
    out += ["# name: (emergency code, reaction, latched)", "FAULTS = {"]
    out += [f"    {f['name']!r}: (0x{schema.fault_code(f):04X}, {f['reaction']!r}, {f['latched']})," for f in schema.faults] + ["}", ""]
    out += ["LIMIT_CODES = {"] + [f"    {e['code']}: {e['name']!r}," for e in schema.limit_codes] + ["}"]
    return "\n".join(out) + "\n"


def write(path, text):
    """Leaves the file alone if nothing changed, so that nothing is rebuilt for nothing."""
    path = pathlib.Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text() != text:
        path.write_text(text)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["cpp", "eds", "dbc", "markdown", "faults", "python"])
    parser.add_argument("output")
    parser.add_argument("--node", action="append", default=[], metavar="NAME=ID")
    parser.add_argument("--schema", type=pathlib.Path, default=SCHEMA, help="instead of schema/module.yaml")
    args = parser.parse_args()
    try:
        schema = Schema(args.schema)
        make(args, parser, schema)
    except SchemaError as error:
        sys.exit(f"{args.schema}: {error}")


def make(args, parser, schema):
    if args.what == "cpp":
        write(pathlib.Path(args.output) / "object_dictionary.h", cpp_object_dictionary(schema))
        write(pathlib.Path(args.output) / "faults.h", cpp_faults(schema))
        write(pathlib.Path(args.output) / "pdo.h", cpp_pdo(schema))
    elif args.what == "dbc":
        nodes = []
        for text in args.node:
            name, equals, number = text.partition("=")
            if not equals or not name.isidentifier() or not number.isdigit() or not 2 <= int(number) <= 127:
                parser.error(f"--node {text}: expected NAME=ID, a plain name and an id from 2 to 127")
            nodes.append((name, int(number)))
        if not nodes:
            parser.error("a DBC needs at least one --node")
        write(args.output, dbc(schema, nodes))
    else:
        write(args.output, {"eds": eds, "markdown": markdown, "faults": markdown_faults, "python": python}[args.what](schema))


if __name__ == "__main__":
    main()

"""bus.log as others see it: python-can and can-utils read back exactly what was written, and the time that a frame takes
on the wire agrees with a second, independent count."""

import dataclasses
import subprocess

import can
import pytest


@dataclasses.dataclass
class Sample:
    microseconds: int
    id: int
    extended: bool
    remote: bool
    fd: bool
    bit_rate_switch: bool
    length: int
    data: bytes
    nominal_bits: int
    data_bits: int


def parse(line):
    time, ident, extended, remote, fd, brs, length, data, nominal, fast = line.split()
    return Sample(int(time), int(ident), extended == "1", remote == "1", fd == "1", brs == "1", int(length),
                  b"" if data == "-" else bytes.fromhex(data), int(nominal), int(fast))


@pytest.fixture(scope="module")
def samples(program):
    tool = program("tests/unit/wire/mrr_sample_bus_log")
    text = subprocess.run([tool, "fields"], check=True, capture_output=True, text=True).stdout
    return [parse(line) for line in text.splitlines()]


@pytest.fixture(scope="module")
def log(program, tmp_path_factory):
    tool = program("tests/unit/wire/mrr_sample_bus_log")
    path = tmp_path_factory.mktemp("log") / "bus.log"
    path.write_bytes(subprocess.run([tool, "log"], check=True, capture_output=True).stdout)
    return path


def test_samples_hold_every_kind_of_frame(samples):
    assert len(samples) == 2000
    for kind in ("extended", "remote", "fd", "bit_rate_switch"):
        assert {getattr(sample, kind) for sample in samples} == {False, True}


def test_python_can_reads_back_what_was_written(log, samples):
    with can.CanutilsLogReader(log) as reader:
        messages = list(reader)
    assert len(messages) == len(samples)
    for message, sample in zip(messages, samples):
        assert message.timestamp == pytest.approx(sample.microseconds * 1e-6, abs=1e-7)
        assert message.arbitration_id == sample.id
        assert message.is_extended_id == sample.extended
        assert message.is_remote_frame == sample.remote
        assert message.is_fd == sample.fd
        assert message.bitrate_switch == sample.bit_rate_switch
        assert message.channel == "vcan0"
        assert bytes(message.data) == sample.data
        assert message.dlc == sample.length


def test_log2asc_converts_the_log(log, samples, tmp_path):
    out = tmp_path / "bus.asc"
    subprocess.run(["log2asc", "-I", log, "-O", out, "vcan0"], check=True, capture_output=True)
    with can.ASCReader(out) as reader:
        messages = list(reader)
    assert [message.arbitration_id for message in messages] == [sample.id for sample in samples]
    for message, sample in zip(messages, samples):
        assert bytes(message.data) == sample.data
        assert (message.is_extended_id, message.is_fd) == (sample.extended, sample.fd)
        if not sample.fd:  # python-can's ASC reader takes an FD frame without data for a remote one
            assert message.is_remote_frame == sample.remote


def crc(bits, polynomial, width, start=0):
    """Long division on a string of bits, written unlike the C++ one on purpose."""
    register = start
    for bit in bits:
        register = (register << 1) ^ (int(bit) << width)
        if register >> width & 1:
            register ^= polynomial | 1 << width
        register &= (1 << width) - 1
    return format(register, f"0{width}b")


def stuff(bits):
    """The bits with a complement after each five equal ones, stuff bits counted among them."""
    out = ""
    for bit in bits:
        out += bit
        if out.endswith(("00000", "11111")) and run_length(out) % 5 == 0:
            out += "1" if bit == "0" else "0"
    return out


def run_length(text):
    return len(text) - len(text.rstrip(text[-1]))


def wire_bits(sample):
    """(bits at the nominal rate, bits at the data rate) by ISO 11898-1:2015, start to end of frame."""
    codes = {12: 9, 16: 10, 20: 11, 24: 12, 32: 13, 48: 14, 64: 15}
    dlc = format(codes.get(sample.length, sample.length), "04b")
    rtr = "1" if sample.remote else "0"
    if sample.extended:
        ident = format(sample.id, "029b")
        head = "0" + ident[:11] + "11" + ident[11:] + rtr
    else:
        head = "0" + format(sample.id, "011b") + rtr + "0"
    data = "".join(format(byte, "08b") for byte in sample.data)
    if not sample.fd:
        body = head + ("00" if sample.extended else "0") + dlc + data
        return len(stuff(body + crc(body, 0x4599, 15))) + 10, 0
    arbitration = head + "10" + ("1" if sample.bit_rate_switch else "0")
    # The fixed stuff bit stands in for a dynamic one that would come right after the data.
    body = arbitration + "0" + dlc + data
    stuffed = stuff(body[:-1])
    stuffed += body[-1]
    slow = len(stuff(arbitration)) + 9
    fixed = 6 + 4 + 17 if len(sample.data) <= 16 else 7 + 4 + 21
    fast = len(stuffed) - len(stuff(arbitration)) + fixed + 1
    return (slow, fast) if sample.bit_rate_switch else (slow + fast, 0)


def test_bits_on_the_wire_agree_with_a_second_count(samples):
    for sample in samples:
        assert wire_bits(sample) == (sample.nominal_bits, sample.data_bits), sample

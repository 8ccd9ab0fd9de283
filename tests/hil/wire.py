"""A client with bare hands: frames as bytes, on a raw CAN socket. What the conformance tests are written with, so that no
library's own idea of CANopen stands between a clause and the module."""

import dataclasses
import socket
import struct
import time

SO_TIMESTAMPNS = 35  # Python's socket does not name it
EXTENDED, REMOTE = 0x80000000, 0x40000000
PATIENCE_S = 3.0  # for an answer; the machine may be busy
SILENCE_S = 0.15  # how long to listen before saying that there is no answer


@dataclasses.dataclass(frozen=True)
class Frame:
    id: int
    data: bytes
    at: float = 0.0  # arrival, kernel's clock, s
    remote: bool = False
    extended: bool = False

    def __str__(self):
        return f"{self.id:03X}#{'R' if self.remote else self.data.hex().upper()}"


class Abort(Exception):
    """An SDO transfer that the server aborted."""

    def __init__(self, code):
        super().__init__(f"{code:08X}")
        self.code = code


class Wire:
    """One CAN interface. `node`: the module that sdo_* and friends speak to."""

    def __init__(self, interface, node=None):
        self.node = node
        self.socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        self.socket.bind((interface,))

    def hear_standard_only(self):
        """Extended frames no longer arrive here."""
        self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, struct.pack("=II", 0, EXTENDED))

    def close(self):
        self.socket.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    # --- frames

    def send(self, can_id, data=b"", *, remote=False, extended=False, length=None):
        data = bytes(data)
        word = can_id | (EXTENDED if extended else 0) | (REMOTE if remote else 0)
        self.socket.send(struct.pack("=IB3x8s", word, len(data) if length is None else length, data))

    def send_fd(self, can_id, data, *, extended=False):
        word = can_id | (EXTENDED if extended else 0)
        self.socket.send(struct.pack("=IBB2x64s", word, len(data), 0, bytes(data)))

    def receive(self, timeout_s):
        """The next frame, or None."""
        self.socket.settimeout(max(timeout_s, 1e-6))
        try:
            raw, ancillary, _, _ = self.socket.recvmsg(72, 128)
        except (TimeoutError, BlockingIOError):
            return None
        at = 0.0
        for level, kind, data in ancillary:
            if level == socket.SOL_SOCKET and len(data) == 16:
                seconds, nanoseconds = struct.unpack("=qq", data)
                at = seconds + nanoseconds * 1e-9
        word, length = struct.unpack_from("=IB", raw)
        return Frame(word & (0x1FFFFFFF if word & EXTENDED else 0x7FF), raw[8:8 + length] if not word & REMOTE else b"", at,
                     bool(word & REMOTE), bool(word & EXTENDED))

    def drain(self):
        """Forgets what has arrived until now; frames may come faster than they are read."""
        now = time.time()  # the kernel's stamps are of this clock
        while (frame := self.receive(0)) and frame.at < now:
            pass

    def collect(self, seconds, *ids):
        """All frames (with these ids) that arrive from now on in a while."""
        end, found = time.monotonic() + seconds, []
        while (left := end - time.monotonic()) > 0:
            frame = self.receive(left)
            if frame and (not ids or frame.id in ids):
                found.append(frame)
        return found

    def expect(self, *ids, within_s=PATIENCE_S, where=lambda frame: True):
        """The next frame with one of these ids; what else comes is passed over."""
        end = time.monotonic() + within_s
        while (left := end - time.monotonic()) > 0:
            frame = self.receive(left)
            if frame and frame.id in ids and where(frame):
                return frame
        raise AssertionError(f"no frame {' or '.join(f'{i:03X}' for i in ids)} within {within_s} s")

    def expect_emergency(self, code, within_s=PATIENCE_S):
        return self.expect(0x080 + self.node, within_s=within_s, where=lambda f: f.data[:2] == code.to_bytes(2, "little"))

    # --- CANopen

    def nmt(self, command, node=None):
        self.send(0x000, [command, self.node if node is None else node])

    def sync(self, counter=None):
        self.send(0x080, [] if counter is None else [counter])

    def wait_state(self, state):
        return self.expect(0x700 + self.node, where=lambda f: f.data == bytes([state]))

    def reset(self, command=0x81):
        """NMT reset, and the boot-up that follows."""
        self.drain()
        self.nmt(command)
        return self.wait_state(0)

    def operational(self):
        self.nmt(1)
        self.wait_state(5)

    def switch_on_disabled(self):
        """OPERATIONAL and in SWITCH ON DISABLED, a fault acknowledged on the way."""
        self.operational()
        self.write(0x6040, 0, 0, "H")
        end = time.monotonic() + PATIENCE_S
        while (word := self.read(0x6041)) & 0x4F != 0x40:
            assert time.monotonic() < end, f"statusword {word:04X}"
            self.write(0x6040, 0, 0x80 if word & 0x0F == 0x08 else 0, "H")
            time.sleep(0.02)
            self.write(0x6040, 0, 0, "H")

    def ask(self, request):
        """One SDO request as 8 bytes, its answer."""
        self.drain()
        self.send(0x600 + self.node, bytes(request).ljust(8, b"\0"))
        answer = self.expect(0x580 + self.node)
        assert len(answer.data) == 8, answer
        return answer.data

    def silent(self, seconds=SILENCE_S):
        """Nothing comes from the SDO server."""
        return not self.collect(seconds, 0x580 + self.node)

    def upload(self, index, sub=0):
        """The object's bytes, expedited or segmented; every bit of the protocol is checked on the way."""
        answer = self.ask(struct.pack("<BHB", 0x40, index, sub))
        check_abort(answer, index, sub)
        assert answer[1:4] == struct.pack("<HB", index, sub)
        if answer[0] & 2:
            assert answer[0] & 0xF1 == 0x41, f"{answer[0]:02X}"
            size = 4 - (answer[0] >> 2 & 3)
            assert answer[4 + size:] == bytes(4 - size)
            return answer[4:4 + size]
        assert answer[0] == 0x41
        announced, data, toggle = struct.unpack("<I", answer[4:])[0], b"", 0
        while True:
            answer = self.ask([0x60 | toggle])
            check_abort(answer, index, sub)
            assert answer[0] & 0xF0 == toggle, f"{answer[0]:02X}"
            size = 7 - (answer[0] >> 1 & 7)
            data += answer[1:1 + size]
            assert answer[1 + size:] == bytes(7 - size)
            toggle ^= 0x10
            if answer[0] & 1:
                assert len(data) == announced
                return data
            assert size == 7

    def download(self, index, sub, data):
        """Expedited up to 4 bytes, else segmented with its length announced."""
        data = bytes(data)
        head = struct.pack("<HB", index, sub)
        if 1 <= len(data) <= 4:
            answer = self.ask(bytes([0x23 | (4 - len(data)) << 2]) + head + data)
            check_abort(answer, index, sub)
            assert answer == b"\x60" + head + bytes(4)
            return
        answer = self.ask(b"\x21" + head + struct.pack("<I", len(data)))
        check_abort(answer, index, sub)
        assert answer == b"\x60" + head + bytes(4)
        toggle = 0
        for at in range(0, max(len(data), 1), 7):
            part = data[at:at + 7]
            last = at + 7 >= len(data)
            answer = self.ask(bytes([toggle | (7 - len(part)) << 1 | last]) + part)
            check_abort(answer, index, sub)
            assert answer == bytes([0x20 | toggle]) + bytes(7)
            toggle ^= 0x10

    def read(self, index, sub=0, form=None):
        """A number: unsigned by its size, or as struct's `form` says."""
        data = self.upload(index, sub)
        if form:
            return struct.unpack("<" + form, data)[0]
        return int.from_bytes(data, "little")

    def write(self, index, sub, value, form):
        self.download(index, sub, struct.pack("<" + form, value))

    def abort_of(self, action, *arguments):
        """The code with which the server aborts; 0: it does not."""
        try:
            action(*arguments)
        except Abort as abort:
            return abort.code
        return 0


def check_abort(answer, index, sub):
    if answer[0] == 0x80:
        assert answer[1:4] == struct.pack("<HB", index, sub), answer.hex()
        raise Abort(struct.unpack("<I", answer[4:])[0])

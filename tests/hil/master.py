"""A small master in lockstep with plant and modules: the supervisor's place on the plant bus, taken by a test. Each tick it
sees what was sent in the tick before, and what it sends is seen in the next one (docs/plant_io.md)."""

import struct

from wire import Wire

SUPERVISOR = 31
TICK, ANSWER, ANNOUNCE = 0x100, 0x200, 0x300
VERSION = 1


class Master:
    """tick() passes one tick of a millisecond; `passive` says which joints had the passive law in force in it."""

    def __init__(self, node_ids):
        self.nodes = node_ids
        self.plant = Wire("vcan1")
        self.robot = Wire("vcan0")
        self.number = None  # of the tick that is going on
        self.answers = {}  # joint: (first payload byte, arrival) in the tick that ended last
        self.latest = {}  # COB-ID: data last seen
        self.arrived = {}  # COB-ID: frames of this tick

    def close(self):
        self.plant.close()
        self.robot.close()

    def join(self):
        """Announces itself until the plant takes it along."""
        while self.number is None:
            self.plant.send_fd(ANNOUNCE + SUPERVISOR, [VERSION] + [0] * 7)
            for frame in self.plant.collect(0.05, TICK):
                if self._asked(frame):
                    self._begin(frame)
                    break

    @staticmethod
    def _asked(frame):
        return struct.unpack_from("<I", frame.data, 8)[0] >> SUPERVISOR & 1

    def _begin(self, frame):
        self.number = struct.unpack_from("<I", frame.data, 12)[0]
        self.arrived = {}
        while received := self.robot.receive(0):
            self.arrived.setdefault(received.id, []).append(received.data)
            self.latest[received.id] = received.data

    def tick(self):
        """Ends this tick and begins the next one."""
        self.plant.send_fd(ANSWER + SUPERVISOR, struct.pack("<BxxxI24x", VERSION, self.number))
        self.answers = {}
        while True:
            frame = self.plant.receive(5)
            assert frame, "the plant is silent"
            joint = frame.id - ANSWER
            if 0 <= joint < SUPERVISOR and struct.unpack_from("<I", frame.data, 4)[0] == self.number:
                self.answers[joint] = frame.data[8], frame.at
            elif frame.id == TICK and self._asked(frame):
                return self._begin(frame)

    @property
    def passive(self):
        """Joints (from 0) whose passive law was in force in the tick that ended last."""
        return {joint for joint, (flags, _) in self.answers.items() if flags & 4}

    def send(self, can_id, form, *values):
        self.robot.send(can_id, struct.pack("<" + form, *values))

    def write(self, node, index, sub, form, value):
        data = struct.pack("<" + form, value)
        self.robot.send(0x600 + node, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0"))
        for _ in range(100):
            self.tick()
            for answer in self.arrived.get(0x580 + node, []):
                assert answer[0] == 0x60, answer.hex()
                return
        raise AssertionError(f"node {node} does not answer")

    def read(self, node, index, sub, form):
        self.robot.send(0x600 + node, struct.pack("<BHB4x", 0x40, index, sub))
        for _ in range(100):
            self.tick()
            for answer in self.arrived.get(0x580 + node, []):
                assert answer[0] & 0xF3 == 0x43, answer.hex()  # at most four bytes, as many as it says
                return struct.unpack_from("<" + form, answer, 4)[0]
        raise AssertionError(f"node {node} does not answer")

    def statusword(self, node):
        return struct.unpack_from("<H", self.latest.get(0x180 + node, b"\0\0"))[0]

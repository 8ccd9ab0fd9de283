"""mrr_module --store FILE: what 1010h stores is there after a restart, a cut file loses the last change and says so, and
the configuration hash tells a module that was changed from the one it was planned with."""

import os

from wire import Wire

SAVE, LOAD = 0x65766173, 0x64616F6C
GOOD, TORN = 3, 5
SLOT = 32768


class Store:
    def __init__(self, robot, path):
        self.robot, self.path = robot, path

    def __enter__(self):
        self.process = self.robot.module(1, "--store", self.path, plant=False)
        self.wire = Wire("vcan0", node=2)
        return self.wire

    def __exit__(self, *_):
        self.wire.close()
        self.process.stop()
        self.robot.processes.remove(self.process)


def store(wire, signature=SAVE):
    version = wire.read(0x2190, 2, "I")
    wire.write(0x1010 if signature == SAVE else 0x1011, 1, signature, "I")
    for _ in range(200):
        if wire.read(0x2190, 2, "I") != version:
            return
    raise AssertionError(f"storing did not end; state {wire.read(0x2190, 1, 'B')}")


def test_what_is_stored_survives_a_restart_and_a_cut_file(fresh_robot, tmp_path):
    path = tmp_path / "joint_1.store"
    with Store(fresh_robot, path) as wire:
        assert wire.read(0x1010, 1, "I") == wire.read(0x1011, 1, "I") == 1, "on command"
        planned = wire.read(0x2001, 0, "I")
        wire.write(0x2120, 2, 50.0, "f")
        store(wire)
        changed = wire.read(0x2001, 0, "I")
        assert changed != planned
    with Store(fresh_robot, path) as wire:
        assert wire.read(0x2120, 2, "f") == 50.0
        assert wire.read(0x2190, 1, "B") == GOOD
        assert wire.read(0x2001, 0, "I") == changed
        wire.write(0x2120, 2, 60.0, "f")
        store(wire)
    with open(path, "r+b") as file:  # the second slot, cut off in the middle
        file.truncate(SLOT + 300)
    with Store(fresh_robot, path) as wire:
        assert wire.read(0x2120, 2, "f") == 50.0
        assert wire.read(0x2190, 1, "B") == TORN
        assert wire.read(0x603F, 0, "H") == 0x5530
        store(wire, LOAD)
    with Store(fresh_robot, path) as wire:
        assert wire.read(0x2001, 0, "I") == planned


def test_a_file_that_cannot_be_used_is_one_sentence_and_status_2(fresh_robot, tmp_path):
    for path in (tmp_path / "no" / "such", os.fspath(tmp_path)):
        process = fresh_robot.start("module_fw/targets/linux/mrr_module", "--robot", "mrr3", "--joint", 1, "--can", "vcan0",
                                    "--store", path)
        assert process.popen.wait(10) == 2
        assert str(path) in process.text()
        fresh_robot.processes.remove(process)

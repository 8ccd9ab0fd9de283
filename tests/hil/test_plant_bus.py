"""The plant bus: lockstep is repeatable, a lost plant is a fault, no plant is no power, everybody leaves in order."""

import contextlib
import os
import signal
import subprocess
import time

import pytest

from conftest import ROBOT, wait_until
from test_supervisor import Rpc
from wire import Wire

MODULE, PLANT = "module_fw/targets/linux/mrr_module", "sim_vcan/targets/mrr_plant"


@pytest.fixture(autouse=True)
def own_runtime_folder(tmp_path, monkeypatch):
    folder = tmp_path / "run"
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("MRR_RUNTIME_DIR", str(folder))


def start_module(robot, joint, *more):
    return robot.start(MODULE, "--robot", ROBOT, "--joint", joint, "--can", "vcan0", "--verbose", *more)


def answers_of_a_run(fresh_robot, folder, seed):
    """What each participant said on the plant bus, as candump has it, by identifier."""
    folder.mkdir()
    log = folder / "plant_bus.log"
    with open(log, "wb") as out:
        dump = subprocess.Popen(["candump", "-r", "20000000", "-L", "vcan1,100:700,200:700"], stdout=out)
    try:
        time.sleep(0.3)
        modules = [start_module(fresh_robot, joint, "--plant", "vcan1") for joint in (1, 2, 3)]
        plant = fresh_robot.start(PLANT, "--robot", ROBOT, "--plant", "vcan1", "--ticks", 500, "--seed", seed)
        assert plant.popen.wait(60) == 0, plant.text()
        for module in modules:
            module.stop()
        time.sleep(0.2)
    finally:
        dump.terminate()
        dump.wait()
    said = {}
    for line in log.read_text().splitlines():
        frame = line.split()[2]
        said.setdefault(frame.split("#")[0], []).append(frame)
    # The last word of each, given after the plant has gone, is not part of the run.
    return {who: frames[:500] for who, frames in said.items()}


def test_lockstep_gives_the_same_run_twice_and_another_with_another_seed(fresh_robot, tmp_path):
    first = answers_of_a_run(fresh_robot, tmp_path / "a", 7)
    assert sorted(first) == ["100", "200", "201", "202"]
    assert all(len(frames) == 500 for frames in first.values())
    assert answers_of_a_run(fresh_robot, tmp_path / "b", 7) == first
    assert answers_of_a_run(fresh_robot, tmp_path / "c", 8) != first


@pytest.mark.parametrize("pace", ["--lockstep", "--realtime"])
def test_a_lost_plant_is_a_fault_and_not_a_frozen_joint(fresh_robot, pace):
    module = start_module(fresh_robot, 1, "--plant", "vcan1")
    plant = fresh_robot.start(PLANT, "--robot", ROBOT, "--plant", "vcan1", pace)
    if pace == "--lockstep":
        for joint in (2, 3):  # it begins with all of them
            start_module(fresh_robot, joint, "--plant", "vcan1")
    with Wire("vcan0", 2) as wire:
        time.sleep(1.5)
        assert wire.read(0x6041) & 0x4F == 0x40  # switch on disabled: healthy
        plant.popen.kill()
        plant.popen.wait()
        fresh_robot.processes.remove(plant)
        time.sleep(4.5)
        assert wire.read(0x6041) & 0x4F == 0x08, "no fault"
        assert wire.read(0x2030, 1) == 0x7305, "the first cause is the encoder"
    module.stop()


def test_what_a_busy_machine_delays_is_made_up_for(fresh_robot):
    plant = fresh_robot.plant("--realtime")
    modules = [start_module(fresh_robot, joint, "--plant", "vcan1") for joint in (1, 2, 3)]
    world = Rpc(fresh_robot.folder / "plant.sock", checked=False)
    wait_until(lambda: all(joint["takes_part"] for joint in world.get("truth")["joints"]))
    time.sleep(1.5)
    before = world.get("truth")
    for process in [*modules, plant]:
        process.popen.send_signal(signal.SIGSTOP)
    time.sleep(0.06)
    for process in [plant, *modules]:
        process.popen.send_signal(signal.SIGCONT)
    time.sleep(1.5)
    after = world.get("truth")
    assert time.monotonic() - after["time_s"] < 0.1, "the world has not caught up"
    with contextlib.ExitStack() as stack:
        for node in (2, 3, 4):
            wire = stack.enter_context(Wire("vcan0", node))
            assert wire.read(0x6041) & 0x4F == 0x40 and wire.read(0x2030, 1) == 0, f"node {node} has seen a fault"
    for module in modules:
        module.stop()
    plant.stop()
    if "stood still" not in plant.text():  # it was delayed by more than is made up for
        assert after["ticks"] - before["ticks"] == round((after["time_s"] - before["time_s"]) * 1000)


def test_without_a_plant_there_is_no_way_to_operation_enabled(fresh_robot):
    module = start_module(fresh_robot, 1)
    with Wire("vcan0", 2) as wire:
        time.sleep(1.5)
        wire.operational()
        for controlword in (0x80, 0x06, 0x07, 0x0F, 0x80, 0x06, 0x07, 0x0F):
            wire.write(0x6040, 0, controlword, "H")
            time.sleep(0.05)
            assert wire.read(0x6041) & 0x6F != 0x27
    assert "no hardware behind it" in module.text()
    module.stop()
    assert "allocations after start: 0" in module.text()


def test_a_module_that_stops_leaves_the_lockstep_in_order(fresh_robot):
    modules = [start_module(fresh_robot, joint, "--plant", "vcan1") for joint in (1, 2, 3)]
    plant = fresh_robot.start(PLANT, "--robot", ROBOT, "--plant", "vcan1", "--lockstep", "--verbose")
    plant.wait_for("lockstep begins")
    modules[1].stop()
    plant.wait_for("leaves in order")
    modules[0].stop()
    modules[2].stop()
    plant.wait_for("leaves in order", 3)
    assert "has not answered" not in plant.text()
    plant.stop()
    for module in modules:
        assert "allocations after start: 0" in module.text(), module.text()


def test_a_module_of_another_robot_is_refused(fresh_robot):
    stranger = fresh_robot.start(MODULE, "--robot", ROBOT.parent / "arm7", "--joint", 1, "--can", "vcan0", "--plant", "vcan1")
    plant = fresh_robot.start(PLANT, "--robot", ROBOT, "--plant", "vcan1")
    plant.wait_for("is configured for another robot than mrr3")
    assert os.path.exists(os.path.join(os.environ["MRR_RUNTIME_DIR"], "plant.sock"))
    plant.stop()
    stranger.stop()

"""CiA 402 by bare hands: each state and transition by control word and status word, faults and their error register, at a
module with the emulator behind it."""

import time

import pytest
from wire import Abort

NODE = 4
DISABLED, READY, ON, ENABLED, QUICK_STOP, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x08
READ_ONLY, VALUE, HIGH, LOW = 0x06010002, 0x06090030, 0x06090031, 0x06090032
STATE, NO_DATA = 0x08000022, 0x08000024
WAITS_FOR_BRAKE = 12  # 2014h


def shows(wire, state, limit_s=3.0):
    """The state of the status word; bit 5 counts where CiA 402 says so."""
    mask = 0x4F if state in (DISABLED, FAULT) else 0x6F
    end = time.monotonic() + limit_s
    while (word := wire.read(0x6041)) & mask != state:
        assert time.monotonic() < end, f"statusword {word:04X}, wanted {state:02X}"
        time.sleep(0.005)


def command(wire, word):
    wire.write(0x6040, 0, word, "H")


def enable(wire, mode=8):
    wire.write(0x6060, 0, mode, "b")
    for word, state in ((6, READY), (7, ON), (15, ENABLED)):
        command(wire, word)
        shows(wire, state)


@pytest.mark.parametrize("path", [
    [(6, READY), (0, DISABLED)],
    [(6, READY), (2, DISABLED)],
    [(6, READY), (7, ON), (6, READY)],
    [(6, READY), (7, ON), (0, DISABLED)],
    [(6, READY), (7, ON), (2, DISABLED)],
    [(6, READY), (7, ON), (15, ENABLED), (7, ON)],
    [(6, READY), (7, ON), (15, ENABLED), (6, READY)],
    [(6, READY), (7, ON), (15, ENABLED), (0, DISABLED)],
    [(6, READY), (7, ON), (15, ENABLED), (2, QUICK_STOP), (15, ENABLED)],
    [(6, READY), (7, ON), (15, ENABLED), (2, QUICK_STOP), (0, DISABLED)],
    [(6, READY), (15, ENABLED)],
], ids=lambda path: "_".join(f"{word:X}" for word, _ in path))
def test_transitions(drive, path):
    drive.write(0x6060, 0, 8, "b")
    for word, state in path:
        command(drive, word)
        shows(drive, state)


@pytest.mark.parametrize("word", [0x07, 0x0F, 0x02, 0x00, 0x80])
def test_switch_on_disabled_is_left_by_shutdown_only(drive, word):
    command(drive, word)
    time.sleep(0.05)
    shows(drive, DISABLED)


@pytest.mark.parametrize("option, stays", [(0, False), (2, False), (6, True)])
def test_quick_stop_option_code(drive, option, stays):
    drive.write(0x605A, 0, option, "h")
    enable(drive)
    command(drive, 2)
    shows(drive, QUICK_STOP if stays else DISABLED)


def test_an_enabled_drive_is_disabled_by_leaving_operational(drive):
    enable(drive)
    drive.nmt(0x80)
    drive.wait_state(0x7F)
    end = time.monotonic() + 3
    while drive.read(0x6041) & 0x6F == ENABLED:
        assert time.monotonic() < end
        time.sleep(0.01)


def provoke(wire, code):
    wire.write(0x2F00, 0, code, "H")


@pytest.mark.parametrize("code, bits", [(0x2310, 0x03), (0x3210, 0x05), (0x4310, 0x09), (0x8611, 0x21)])
def test_emergency_error_register_and_history(drive, code, bits):
    drive.write(0x1003, 0, 0, "B")
    assert drive.read(0x1001) == 0
    drive.drain()
    provoke(drive, code)
    emergency = drive.expect_emergency(code)
    assert len(emergency.data) == 8 and emergency.data[2] == bits
    shows(drive, FAULT)
    assert drive.read(0x1001) == bits
    assert drive.read(0x1003) == 1 and drive.read(0x1003, 1) & 0xFFFF == code
    assert drive.read(0x603F) == code
    drive.drain()
    command(drive, 0x80)
    assert drive.expect_emergency(0).data[2] == 0
    shows(drive, DISABLED)
    assert drive.read(0x1001) == 0
    assert drive.read(0x1003) == 1, "the history stays"


def test_faults_stand_in_the_history_newest_first(drive):
    drive.write(0x1003, 0, 0, "B")
    for code in (0x2310, 0x3210):
        provoke(drive, code)
        shows(drive, FAULT)
        command(drive, 0x80)
        shows(drive, DISABLED)
        command(drive, 0)
    assert [drive.read(0x1003, k) & 0xFFFF for k in (1, 2)] == [0x3210, 0x2310]
    for value in (1, 8, 255):
        assert drive.abort_of(drive.write, 0x1003, 0, value, "B") == VALUE
    assert drive.abort_of(drive.write, 0x1003, 1, 0, "I") == READ_ONLY
    drive.write(0x1003, 0, 0, "B")
    assert drive.read(0x1003) == 0
    with pytest.raises(Abort) as abort:
        drive.read(0x1003, 1)
    assert abort.value.code == NO_DATA


def test_a_fault_is_reset_by_the_rising_edge_alone(drive):
    command(drive, 0x80)  # set already when the fault comes
    provoke(drive, 0x2310)
    shows(drive, FAULT)
    time.sleep(0.1)
    shows(drive, FAULT)
    command(drive, 0x00)
    time.sleep(0.05)
    shows(drive, FAULT)
    command(drive, 0x80)
    shows(drive, DISABLED)


def test_a_fault_of_an_enabled_drive_goes_through_its_reaction_to_fault(drive):
    enable(drive)
    provoke(drive, 0x2310)
    shows(drive, FAULT)
    assert drive.read(0x6041) & 0x08


@pytest.mark.parametrize("mode", [6, 8, 10])
def test_the_mode_in_force_is_shown(drive, mode):
    enable(drive, mode)
    end = time.monotonic() + 3
    while drive.read(0x6061, form="b") != mode:
        assert time.monotonic() < end
        time.sleep(0.01)


def test_supported_modes(drive):
    assert drive.read(0x6502) & 0xFFFF == 1 << 5 | 1 << 7 | 1 << 9
    assert drive.read(0x6502) >> 16 & 1, "passive"


def test_homing_bits(drive):
    """0400h before, none during, 1400h when attained, remembered over a change of mode."""
    enable(drive, 6)
    end = time.monotonic() + 3
    while drive.read(0x2150, 1) == 0 or drive.read(0x2014) == WAITS_FOR_BRAKE:
        assert time.monotonic() < end
    drive.write(0x6098, 0, 37, "b")
    command(drive, 0x1F)
    end = time.monotonic() + 3
    while drive.read(0x6041) & 0x3400 != 0x1400:
        assert time.monotonic() < end
    command(drive, 0x0F)
    for mode in (8, 6):
        drive.write(0x6060, 0, mode, "b")
        time.sleep(0.1)
    assert drive.read(0x6041) & 0x3400 == 0x1400


def by_pdo(wire, *words, mode=8):
    for word in words:
        wire.send(0x200 + NODE, word.to_bytes(2, "little") + bytes([mode]))


def test_control_words_that_come_together_each_have_their_turn(drive):
    by_pdo(drive, 0x06, 0x07, 0x0F)
    shows(drive, ENABLED)
    by_pdo(drive, 0x00, 0x06)
    shows(drive, READY)
    provoke(drive, 0x2310)
    shows(drive, FAULT)
    by_pdo(drive, 0x00, 0x80)
    shows(drive, DISABLED)


def test_starting_the_node_enables_nothing_by_an_old_command(drive):
    enable(drive)
    drive.nmt(0x80)
    drive.wait_state(0x7F)
    shows(drive, ON)
    command(drive, 0x0F)
    drive.operational()
    time.sleep(0.1)
    shows(drive, ON)
    command(drive, 0x0F)
    shows(drive, ENABLED)


def test_reset_node_starts_a_faulted_drive_anew_reset_communication_does_not(drive):
    provoke(drive, 0x2310)
    shows(drive, FAULT)
    drive.reset(0x82)
    shows(drive, FAULT)
    assert drive.read(0x1001) != 0
    drive.reset(0x81)
    shows(drive, DISABLED)
    assert drive.read(0x1001) == 0 and drive.read(0x603F) == 0


def test_only_methods_of_homing_that_there_are(drive):
    """What 60E3h lists is taken, everything else is refused."""
    listed = [drive.read(0x60E3, sub, "b") for sub in range(1, drive.read(0x60E3) + 1)]
    assert listed == sorted(set(listed)) and {-1, 35, 37} <= set(listed) and 0 not in listed
    for method in range(-128, 128):
        code = drive.abort_of(drive.write, 0x6098, 0, method, "b")
        assert code == 0 if method in listed else code in (VALUE, HIGH, LOW), method
    assert drive.read(0x6098, form="b") == listed[-1]


def test_interpolation_time_is_the_knot_period_in_another_form(drive):
    assert (drive.read(0x60C2, 1), drive.read(0x60C2, 2, "b")) == (4, -3)
    drive.write(0x60C2, 1, 10, "B")
    assert drive.read(0x2003) == 10_000
    drive.write(0x60C2, 2, -6, "b")
    assert drive.read(0x2003) == 10_000, "10 us cannot be"
    drive.write(0x2003, 0, 2_000, "I")
    assert (drive.read(0x60C2, 1), drive.read(0x60C2, 2, "b")) == (2, -3)
    enable(drive)
    assert drive.abort_of(drive.write, 0x60C2, 1, 4, "B") == STATE, "not while it is led"


COMMANDS = {"shutdown": 0x06, "switch on": 0x07, "enable operation": 0x0F, "disable voltage": 0x00, "quick stop": 0x02, "fault reset": 0x80}
STATES = (DISABLED, READY, ON, ENABLED, QUICK_STOP, FAULT)
# What each command makes of each state (CiA 402, table of commands); what is not here leaves it. Enable operation from READY goes on
# through SWITCHED ON; bit 7 set is none of the other commands, whatever the bits below say.
MATRIX = {
    "shutdown": {DISABLED: READY, ON: READY, ENABLED: READY},
    "switch on": {READY: ON, ENABLED: ON},
    "enable operation": {READY: ENABLED, ON: ENABLED, QUICK_STOP: ENABLED},
    "disable voltage": {READY: DISABLED, ON: DISABLED, ENABLED: DISABLED, QUICK_STOP: DISABLED},
    "quick stop": {READY: DISABLED, ON: DISABLED, ENABLED: QUICK_STOP},
    "fault reset": {FAULT: DISABLED},
}
WAY = {READY: (6,), ON: (6, 7), ENABLED: (6, 7, 15), QUICK_STOP: (6, 7, 15, 2)}


def bring_to(wire, state):
    word = wire.read(0x6041)
    if word & 0x4F == FAULT:
        command(wire, 0)
        command(wire, 0x80)
    command(wire, 0)
    shows(wire, DISABLED)
    if state == FAULT:
        provoke(wire, 0x2310)
        shows(wire, FAULT)
    for step, shown in zip(WAY.get(state, ()), (READY, ON, ENABLED, QUICK_STOP)):
        command(wire, step)
        shows(wire, shown)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_in_every_state(drive, name):
    drive.write(0x6060, 0, 8, "b")
    for state in STATES:
        bring_to(drive, state)
        # Bits 11 to 15 say nothing about the state.
        command(drive, COMMANDS[name] | (0xF800 if state in (DISABLED, READY) else 0))
        wanted = MATRIX[name].get(state, state)
        shows(drive, wanted)
        time.sleep(0.05)
        shows(drive, wanted, 0.1)
        word = drive.read(0x6041)
        assert word & 0x200, "remote"
        assert not (wanted == FAULT and word & 0x80), "a fault is no warning"

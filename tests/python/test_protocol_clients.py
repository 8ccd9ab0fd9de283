"""Stock python-canopen, unmodified, against a node of ours on a pipe, in wall-clock time."""

import subprocess
import threading
import time

import can
import canopen
import pytest

NODE = 5


class PipeBus(can.BusABC):
    """One node at the other end of a process's stdin and stdout."""

    def __init__(self, program):
        super().__init__(channel="pipe")
        self._process = subprocess.Popen([program, str(NODE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        self._arrived = []
        self._condition = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.channel_info = "pipe"

    def _read(self):
        for line in self._process.stdout:
            ident, length, data = line.split()
            message = can.Message(arbitration_id=int(ident, 16), is_extended_id=False, timestamp=time.time(),
                                  data=b"" if data == "-" else bytes.fromhex(data))
            assert len(message.data) == int(length)
            with self._condition:
                self._arrived.append(message)
                self._condition.notify()

    def send(self, msg, timeout=None):
        self._process.stdin.write(f"{msg.arbitration_id:X} {len(msg.data)} {msg.data.hex() or '-'}\n")
        self._process.stdin.flush()

    def _recv_internal(self, timeout):
        with self._condition:
            if not self._arrived:
                self._condition.wait(timeout)
            return (self._arrived.pop(0) if self._arrived else None), True

    def shutdown(self):
        super().shutdown()
        self._process.stdin.close()
        self._process.wait(5)


@pytest.fixture
def network(program):
    net = canopen.Network(PipeBus(program("tests/unit/can_protocol/mrr_node_on_a_pipe")))
    net.connect()
    yield net
    net.disconnect()


@pytest.fixture
def node(network, build_dir):
    remote = canopen.RemoteNode(NODE, str(build_dir / "generated" / "can_protocol" / "module.eds"))
    network.add_node(remote)
    remote.sdo.RESPONSE_TIMEOUT = 2.0  # what is judged here is what is said, not how loaded the machine is
    remote.nmt.wait_for_heartbeat(timeout=5)
    assert remote.nmt.state == "PRE-OPERATIONAL"
    return remote


def wait_until(condition, timeout=5):
    """canopen's own waits miss what comes faster than they start."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "timed out"
        time.sleep(0.005)


def test_nmt_and_heartbeat(node):
    heard = []
    node.nmt.add_heartbeat_callback(heard.append)
    for state, number in (("OPERATIONAL", 5), ("STOPPED", 4), ("PRE-OPERATIONAL", 0x7F), ("RESET", 0)):
        heard.clear()
        node.nmt.state = state
        wait_until(lambda: number in heard)
    wait_until(lambda: heard[-1] == 0x7F)


def test_every_object_of_the_eds_can_be_read(node):
    read = 0
    for index, found in node.object_dictionary.items():
        if index < 0x1000:
            continue  # canopen's own entries for the dummies of RPDOs
        variables = [found] if isinstance(found, canopen.objectdictionary.ODVariable) else list(found.values())
        for variable in variables:
            if index == 0x1003 and variable.subindex > 0:
                with pytest.raises(canopen.SdoAbortedError) as abort:
                    node.sdo.upload(index, variable.subindex)
                assert abort.value.code == 0x08000024
                continue
            data = node.sdo.upload(index, variable.subindex)
            assert variable.data_type == canopen.objectdictionary.VISIBLE_STRING or 8 * len(data) == len(variable)
            # What is not changed by running is what the EDS says.
            if variable.default is not None and variable.access_type == "const" and isinstance(variable.default, int):
                assert variable.decode_raw(data) == variable.default, variable.name
            read += 1
    assert read > 200


def test_segmented_transfers(node):
    assert node.sdo[0x1008].raw == "MRR joint module"
    node.sdo["module_name"].raw = "the joint that holds the hammer"
    assert node.sdo["module_name"].raw == "the joint that holds the hammer"
    assert node.sdo["uptime_us"].raw == 0


@pytest.mark.parametrize("index, sub, data, code", [
    (0x5FFF, 0, b"\0", 0x06020000), (0x1018, 9, b"\0\0\0\0", 0x06090011), (0x6041, 0, b"\0\0", 0x06010002),
    (0x6040, 0, b"\0", 0x06070013), (0x6040, 0, b"\0" * 4, 0x06070012), (0x6040, 0, b"\0" * 9, 0x06070012),
    (0x6060, 0, b"\x03", 0x06090030), (0x6060, 0, b"\x0b", 0x06090031), (0x1A00, 0, b"\x00", 0x08000022),
])
def test_abort_codes(node, index, sub, data, code):
    with pytest.raises(canopen.SdoAbortedError) as abort:
        node.sdo.download(index, sub, data)
    assert abort.value.code == code


def test_pdos_by_name(node):
    node.tpdo.read()
    node.rpdo.read()
    node.nmt.state = "OPERATIONAL"
    node.rpdo[1]["controlword"].raw = 0x000F
    node.rpdo[1]["modes_of_operation"].raw = -1
    node.rpdo[1].transmit()
    node.rpdo[2]["target_position_urad"].raw = -123456
    node.rpdo[2].transmit()
    assert node.sdo["controlword"].raw == 0x000F
    assert node.sdo["target_position_urad"].raw == 0, "waits for SYNC"
    received = threading.Event()  # wait_for_reception would miss one that is faster than itself
    node.tpdo[1].add_callback(lambda _: received.set())
    node.network.sync.transmit()
    assert received.wait(5)
    assert node.tpdo[1]["modes_of_operation_display"].raw == -1
    assert node.sdo["target_position_urad"].raw == -123456


def test_remapping_by_the_clients_own_procedure(node):
    node.tpdo.read()
    pdo = node.tpdo[1]
    pdo.clear()
    pdo.add_variable("digital_inputs")
    pdo.add_variable("statusword")
    pdo.trans_type = 255
    pdo.inhibit_time = 100
    pdo.event_timer = 50
    pdo.enabled = True
    pdo.save()
    assert node.sdo[0x1A00][0].raw == 2
    assert node.sdo[0x1A00][1].raw == 0x60FD0020
    node.nmt.state = "OPERATIONAL"
    times = []
    pdo.add_callback(lambda received: times.append(received.timestamp))
    wait_until(lambda: len(times) >= 6)
    periods = [b - a for a, b in zip(times, times[1:])]
    assert 0.045 < sorted(periods)[len(periods) // 2] < 0.2
    assert len(pdo.data) == 6


def test_emergencies(node):
    node.rpdo.read()
    node.nmt.state = "OPERATIONAL"
    node.network.send_message(0x300 + NODE, b"\1\2\3")
    wait_until(lambda: node.emcy.log)
    assert [(e.code, e.register) for e in node.emcy.log] == [(0x8210, 0x11)]
    assert node.sdo[0x1003][1].raw & 0xFFFF == 0x8210


def test_store_and_restore(node):
    node.store()
    node.restore()
    with pytest.raises(canopen.SdoAbortedError) as abort:
        node.sdo.download(0x1010, 1, b"evas")
    assert abort.value.code == 0x08000020

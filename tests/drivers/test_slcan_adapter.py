"""The emulated CAN adapter against clients that nobody here wrote: python-can's and dronecan's slcan drivers."""

from __future__ import annotations

import fcntl
import importlib.util
import logging
import os
import re
import select
import struct
import termios
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import dronecan
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can_frames import encode_slcan
from drivers.can_port import open_port, part_in_bus
from drivers.slcan_adapter import SlcanAdapter
from station.profile import CanDevice

SEEDED = settings(deadline=None, derandomize=True)


class Served:
    """An adapter whose commands a thread answers, as the emulator's loop does."""

    def __init__(self, *links: Path) -> None:
        self.adapter = SlcanAdapter(*links)
        self.adapter.plug()
        self._lock = threading.Lock()
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            ready, _, _ = select.select([self._stop_read, *self.adapter.descriptors()], [], [], 0.02)
            if self._stop_read in ready:
                return
            with self._lock:
                for descriptor in ready:
                    if descriptor in self.adapter.descriptors():
                        self.adapter.receive(descriptor)

    def send_frame(self, frame_id: int, data: bytes, is_extended: bool = False) -> None:
        with self._lock:
            self.adapter.send([encode_slcan(frame_id, is_extended, data)])

    def send(self, messages: list[bytes]) -> None:
        with self._lock:
            self.adapter.send(messages)

    def close(self) -> None:
        os.write(self._stop_write, b"x")
        self._thread.join()
        os.close(self._stop_read)
        os.close(self._stop_write)
        self.adapter.close()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    one = Served(tmp_path / "can")
    yield one
    one.close()


def client(path: str) -> can.BusABC:
    return can.Bus(interface="slcan", channel=path, bitrate=1_000_000, sleep_after_open=0.0, timeout=0.02)


FRAMES = [
    (0x000, False, b""),
    (0x123, False, bytes(range(8))),
    (0x7FF, False, b"\xff\x00\x0d"),
    (0x12345678, True, b"\xde\xad\xbe\xef\x00\x01\x02\x03"),
    (0x1FFFFFFF, True, b"\x07"),
    (0x00000001, True, b"\x0d\x07"),
]


class TestPythonCan:
    def test_reads_every_frame_as_sent(self, served: Served) -> None:
        with client(served.adapter.endpoint) as bus:
            assert bus.get_version(2.0) == (10, 13)
            for frame in FRAMES:
                served.send_frame(frame[0], frame[2], frame[1])
            got = [bus.recv(2.0) for _ in FRAMES]
        assert [(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in got if m] == FRAMES

    def test_serial_number(self, served: Served) -> None:
        with client(served.adapter.endpoint) as bus:
            assert bus.get_serial_number(2.0) == "EMUL"

    def test_two_clients_share_the_bus(self, tmp_path: Path) -> None:
        served = Served(tmp_path / "a", tmp_path / "b")
        try:
            with client(str(tmp_path / "a")) as one, client(str(tmp_path / "b")) as other:
                assert one.get_version(2.0) == other.get_version(2.0) == (10, 13)
                for frame in FRAMES:
                    one.send(can.Message(arbitration_id=frame[0], is_extended_id=frame[1], data=frame[2]))
                got = [other.recv(2.0) for _ in FRAMES]
                assert [(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in got if m] == FRAMES
        finally:
            served.close()

    def test_garbage_spoils_no_later_frame(self, served: Served) -> None:
        with client(served.adapter.endpoint) as bus:
            assert bus.get_version(2.0) == (10, 13)
            served.send([b"t12Gxyz8!\r"])
            served.send_frame(0x42, b"ok")
            with pytest.raises(ValueError, match="invalid literal"):
                bus.recv(2.0)
            message = bus.recv(2.0)
        assert message is not None
        assert bytes(message.data) == b"ok"

    def test_the_path_survives_an_unplug(self, tmp_path: Path) -> None:
        path = tmp_path / "can"
        first = Served(path)
        bus = client(str(path))
        assert bus.get_version(2.0) == (10, 13)
        first.close()
        assert not path.is_symlink(), "a dangling link could come to point at a stranger's terminal"
        with pytest.raises((can.CanError, OSError)):
            bus.recv(2.0)
        with pytest.raises(can.CanError):
            bus.shutdown()
        bus.serialPortOrig.close()  # type: ignore[attr-defined]
        second = Served(path)
        try:
            with client(str(path)) as again:
                assert again.get_version(2.0) == (10, 13)
                second.send_frame(0x7, b"back")
                message = again.recv(2.0)
                assert message is not None
                assert bytes(message.data) == b"back"
        finally:
            second.close()


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_dronecan_reads_what_the_adapter_sends(served: Served) -> None:
    """Its driver insists on acknowledgements; angle-of-attack broadcasts come out as dronecan's own messages."""
    logging.getLogger("dronecan").setLevel(logging.CRITICAL)
    node = dronecan.make_node(f"slcan:{served.adapter.endpoint}", node_id=10, bitrate=1_000_000)
    got = []
    try:
        node.add_handler(dronecan.uavcan.equipment.air_data.AngleOfAttack, lambda event: got.append(event.message.aoa))
        # A single-frame broadcast of data type 1025 from node 10 + 1, priority 20: DroneCAN specification, 4.1.
        frame_id = 20 << 24 | 1025 << 8 | 11
        for count in range(5):
            # sensor_id int8, aoa float16, aoa_variance float16 (0.1 rad is 0x2E66), tail: start, end, transfer number
            served.send_frame(frame_id, b"\x00\x66\x2e\x00\x00" + bytes([0xC0 | count]), is_extended=True)
        for _ in range(50):
            node.spin(0.1)
            if len(got) == 5:
                break
    finally:
        node.close()
    assert got == pytest.approx([0.0999756] * 5, abs=1e-6)


class Direct:
    """The adapter without a driver: bytes in and out of its terminal."""

    def __init__(self, path: Path) -> None:
        self.adapter = SlcanAdapter(path)
        self.adapter.plug()
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def ask(self, data: bytes) -> bytes:
        """Send, let the adapter act, wait for one answer per command: the system passes bytes on in its own time."""
        os.write(self.fd, data)
        answer, wanted = b"", data.count(b"\r")
        taken = 0
        while answer.count(b"\r") + answer.count(b"\a") < wanted or taken == 0 < len(data):
            (master,) = self.adapter.descriptors()
            ready, _, _ = select.select([self.fd, master], [], [], 5.0)
            assert ready, f"no answer to {data!r} but {answer!r}"
            if master in ready:
                self.adapter.receive(master)
                taken += 1
            if self.fd in ready:
                answer += self.read()
        return answer

    def read(self) -> bytes:
        try:
            return os.read(self.fd, 65_536)
        except BlockingIOError:
            return b""

    def wait_until_waiting(self, count: int) -> None:
        """Until so many bytes lie ready to be read."""
        waiting = 0
        while waiting < count:
            assert select.select([self.fd], [], [], 5.0)[0]
            waiting = struct.unpack("i", fcntl.ioctl(self.fd, termios.FIONREAD, bytes(4)))[0]

    def close(self) -> None:
        os.close(self.fd)
        self.adapter.close()


@pytest.fixture
def direct(tmp_path: Path) -> Iterator[Direct]:
    one = Direct(tmp_path / "can")
    yield one
    one.close()


@pytest.mark.parametrize(
    ("command", "closed", "opened"),
    [
        (b"\r", b"\r", b"\r"),
        (b"S8\r", b"\r", b"\a"),
        (b"s031C\r", b"\r", b"\a"),
        (b"Sx\r", b"\a", b"\a"),
        (b"C\r", b"\a", b"\r"),
        (b"O\r", b"\r", b"\a"),
        (b"L\r", b"\r", b"\a"),
        (b"V\r", b"V1013\r", b"V1013\r"),
        (b"F\r", b"\a", b"F00\r"),
        (b"Z0\r", b"\r", b"\a"),
        (b"Z1\r", b"\a", b"\a"),
        (b"t1002AABB\r", b"\a", b"z\r"),
        (b"t1002AAB\r", b"\a", b"\a"),
        (b"t1009AABB\r", b"\a", b"\a"),
        (b"T1ABCDEF01FF\r", b"\a", b"Z\r"),
        (b"r1008\r", b"\a", b"z\r"),
        (b"what\r", b"\a", b"\a"),
    ],
)
def test_replies_of_the_manual(direct: Direct, command: bytes, closed: bytes, opened: bytes) -> None:
    assert direct.ask(command) == closed
    direct.ask(b"C\r")
    direct.ask(b"O\r")
    assert direct.ask(command) == opened


def test_a_command_may_come_in_pieces(direct: Direct) -> None:
    assert [direct.ask(bytes([b])) for b in b"V\r"] == [b"", b"V1013\r"]


def test_a_closed_channel_hears_nothing(direct: Direct) -> None:
    direct.adapter.send([encode_slcan(0x1, False, b"\x01")])
    assert direct.ask(b"V\r") == b"V1013\r"


def test_listening_only_cannot_send(direct: Direct) -> None:
    assert direct.ask(b"L\r") == b"\r"
    assert direct.ask(b"t1000\r") == b"\a"


def test_a_reader_far_behind_loses_whole_frames(direct: Direct) -> None:
    direct.ask(b"O\r")
    sent = 4000
    for number in range(sent):
        direct.adapter.send([encode_slcan(number % 2048, False, number.to_bytes(8, "big"))])
    assert direct.adapter.dropped > 0
    received = b""
    while select.select([direct.fd], [], [], 0.2)[0]:
        received += direct.read()
        direct.adapter.send([b""])
    lines = received.split(b"\r")
    assert lines.pop() == b""
    assert len(lines) + direct.adapter.dropped == sent
    numbers = [int(line[5:], 16) for line in lines]
    assert all(len(line) == 21 for line in lines)
    assert numbers == sorted(set(numbers))


def test_a_new_client_does_not_get_the_last_ones_frames(direct: Direct) -> None:
    direct.ask(b"O\r")
    for _ in range(100):
        direct.adapter.send([encode_slcan(0x1, False, bytes(8))])
    direct.wait_until_waiting(100 * len(b"t00180000000000000000\r"))
    # What came before the answers is lost with the old channel.
    os.write(direct.fd, b"C\rS8\rO\r")
    assert select.select(direct.adapter.descriptors(), [], [], 5.0)[0]
    direct.adapter.receive(direct.adapter.descriptors()[0])
    direct.wait_until_waiting(3)
    assert direct.read() == b"\r\r\r"


@SEEDED
@given(blocks=st.lists(st.binary(max_size=60), max_size=8))
def test_any_bytes_from_a_client(tmp_path_factory: pytest.TempPathFactory, blocks: list[bytes]) -> None:
    one = Direct(tmp_path_factory.mktemp("any") / "can")
    try:
        for block in blocks:
            one.ask(block)
        assert one.ask(b"\rV\r").endswith(b"V1013\r")
    finally:
        one.close()


class TestListening:
    """What the station's own port does to a bus, seen by the adapter and by python-can's drivers for others."""

    def test_slcan_is_opened_for_listening_and_gets_the_frames(self, served: Served) -> None:
        port = open_port(can_device(), served.adapter.endpoint, is_emulated=True)
        try:
            (terminal,) = served.adapter._ports.values()
            wait_until(lambda: terminal.is_open)
            assert not terminal._may_send
            served.send_frame(0x123, b"\x01\x02")
            assert port.read(2.0) == b"t12320102\r"
        finally:
            port.close()

    def test_the_rig_may_have_it_take_part(self, served: Served) -> None:
        port = open_port(can_device(listen_only=False), served.adapter.endpoint, is_emulated=True)
        try:
            (terminal,) = served.adapter._ports.values()
            wait_until(lambda: terminal._may_send)
        finally:
            port.close()

    @pytest.mark.parametrize("interface", sorted(can.VALID_INTERFACES))
    def test_every_interface_listens_or_says_that_it_does_not(
        self, interface: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """python-can's own drivers must know each option by name: most swallow unknown ones without a word."""
        opened: dict[str, Any] = {}

        class Bus:
            def __init__(self, **options: Any) -> None:
                opened.update(options)

        monkeypatch.setattr(can, "Bus", Bus)
        open_port(can_device(interface=interface), "loop://")
        module, _ = can.interfaces.BACKENDS[interface]
        spec = importlib.util.find_spec(module)
        assert spec is not None
        assert spec.origin is not None
        folder = Path(spec.origin).parent if spec.origin.endswith("__init__.py") else None
        files = sorted(folder.glob("*.py")) if folder else [Path(spec.origin)]
        source = "".join(f.read_text() for f in files)
        words = part_in_bus(can_device(interface=interface))
        listening = opened.keys() - {"interface", "channel", "ignore_config", "bitrate", "timeout"}
        assert all(re.search(rf"\b{option}\b", source) for option in listening)
        assert bool(listening) == (words == "nothing, not even acknowledgements")
        opened.clear()
        open_port(can_device(interface=interface, listen_only=False), "loop://")
        assert opened.keys() <= {"interface", "channel", "ignore_config", "bitrate", "timeout"}

    def test_what_is_said_of_a_bus(self) -> None:
        assert "listen-only on" in part_in_bus(can_device(interface="socketcan"))
        assert part_in_bus(can_device(interface="gs_usb")).endswith("cannot make gs_usb listen only)")
        assert part_in_bus(can_device(listen_only=False)) == "nothing, but acknowledges frames"
        assert part_in_bus(can_device(interface="virtual")) == "nothing"


def can_device(**options: Any) -> CanDevice:
    signals = {"q": {"field": "q", "unit": "deg/s"}}
    streams = [{"name": "gyro", "message": "GYRO", "rate": "200 Hz", "signals": signals}]
    told = {"link": "can", "name": "can", "channel": "emulated", "dbc": "bench.dbc", "streams": streams, **options}
    return CanDevice.model_validate(told)


def wait_until(holds: Callable[[], bool]) -> None:
    for _ in range(1000):
        if holds():
            return
        threading.Event().wait(0.005)
    raise AssertionError("not within 5 s")

"""Adapters on real ports: pseudo-terminals that are unplugged, busy and corrupt, and CAN interfaces."""

from __future__ import annotations

import math
import os
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from drivers.adapter import Adapter, open_devices
from drivers.serial_boombox import encode_packet
from station.clock import SystemClock
from station.profile import CanDevice, Rig, load_rig
from station.rows import Code, DeviceError, RawBlock
from tests.drivers.adapter_script import GYRO, RIGS, Rowsink, boom

pytestmark = pytest.mark.usefixtures("nothing_left_behind")


class Terminal:
    """A pseudo-terminal behind a link whose path survives an unplug."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.master = -1
        self.plug()

    def plug(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.link.symlink_to(os.ttyname(slave))
        os.set_blocking(self.master, False)
        self._slave = slave

    def let_go(self) -> None:
        """Leave the terminal's far end to the station alone."""
        if self._slave >= 0:
            os.close(self._slave)
            self._slave = -1

    def unplug(self) -> None:
        self.let_go()
        if self.master >= 0:
            self.link.unlink()
            os.close(self.master)
            self.master = -1

    def send(self, data: bytes) -> None:
        assert os.write(self.master, data) == len(data)


@pytest.fixture
def terminal(nothing_left_behind: None, tmp_path: Path) -> Iterator[Terminal]:
    made = Terminal(tmp_path / "port")
    yield made
    made.unplug()


def serial_adapter(link: Path, sink: Rowsink) -> Adapter:
    rig = Rig(name="r", devices=(boom(),))
    (adapter,) = open_devices(rig, {"boom": str(link)}, RIGS, SystemClock(), sink.put)
    return adapter


def can_adapter(link: Path, sink: Rowsink) -> Adapter:
    rig = load_rig("can_only")
    (adapter,) = open_devices(rig, {"can": str(link)}, RIGS, SystemClock(), sink.put)
    return adapter


LINKS = [
    pytest.param(serial_adapter, encode_packet(1, 0, 0, [300]), id="serial"),
    pytest.param(can_adapter, GYRO, id="slcan"),
]
Maker = Callable[[Path, Rowsink], Adapter]


@pytest.mark.parametrize(("make", "message"), LINKS)
def test_an_unplugged_device_is_missed_and_found_again(terminal: Terminal, make: Maker, message: bytes) -> None:
    sink = Rowsink()
    adapter = make(terminal.link, sink)
    adapter.start()
    try:
        assert sink.wait_for_event(Code.CONNECT).detail == str(terminal.link)
        assert adapter.connected
        terminal.let_go()
        for _ in range(2):
            terminal.send(message)
            sink.wait_for_sample()
            terminal.unplug()
            assert sink.wait_for_event(Code.DISCONNECT).source == adapter.device.name
            terminal.plug()
            sink.wait_for_event(Code.RECONNECT)
            terminal.let_go()
        terminal.send(message)
        sink.wait_for_sample()
    finally:
        adapter.stop()
    assert not adapter.connected
    assert len(sink.events(Code.CONNECT)) == 1


@pytest.mark.parametrize(("make", "message"), LINKS)
def test_a_missing_port_is_said_so_and_taken_when_it_comes(tmp_path: Path, make: Maker, message: bytes) -> None:
    sink = Rowsink()
    adapter = make(tmp_path / "port", sink)
    adapter.start()
    late = None
    try:
        detail = sink.wait_for_event(Code.DISCONNECT).detail
        assert str(tmp_path / "port") in detail
        assert "no such" in detail.lower()
        assert not adapter.connected
        late = Terminal(tmp_path / "port")
        sink.wait_for_event(Code.CONNECT)
        late.let_go()
        late.send(message)
        sink.wait_for_sample()
    finally:
        adapter.stop()
        if late is not None:
            late.unplug()


@pytest.mark.parametrize(("make", "message"), LINKS)
def test_a_busy_port_is_said_so(terminal: Terminal, make: Maker, message: bytes) -> None:
    sink = Rowsink()
    with serial.Serial(str(terminal.link), exclusive=True):
        adapter = make(terminal.link, sink)
        adapter.start()
        detail = sink.wait_for_event(Code.DISCONNECT).detail
    adapter.stop()
    assert "busy" in detail
    assert len(detail.splitlines()) <= 3


@pytest.mark.parametrize(
    "corrupt",
    [
        b"t1zz8\r",
        b"\xff\xfe\xfd\r",
        b"t\r",
        b"D123\r",
        b"t100800\r",
        b"T1000000\a",
        b"b1009" + b"A" * 24 + b"\r",
        b"\r\r\a",
    ],
)
def test_a_corrupt_line_does_not_end_the_can_link(terminal: Terminal, corrupt: bytes) -> None:
    """python-can's slcan raises bare ValueError and keeps what is not ASCII in its buffer for ever."""
    sink = Rowsink()
    adapter = can_adapter(terminal.link, sink)
    adapter.start()
    try:
        sink.wait_for_event(Code.CONNECT)
        terminal.let_go()
        terminal.send(GYRO)
        sink.wait_for_sample()
        for _ in range(3):
            terminal.send(corrupt + GYRO)
            sink.wait_for_sample()
        assert adapter.codec.bad == (0 if corrupt == b"\r\r\a" else 3)
    finally:
        adapter.stop()
    assert sink.events(Code.DISCONNECT) == []
    (sample, *_) = sink.samples()
    assert sample.stream == "can.gyro"
    assert sample.values == pytest.approx([math.radians(v) for v in (1.0, -2.0, 0.025)])
    blocks = [row.data for row in sink.rows if isinstance(row, RawBlock)]
    assert GYRO in blocks


def test_frames_of_any_python_can_interface_are_read() -> None:
    import can

    device = load_rig("can_only").devices[0]
    assert isinstance(device, CanDevice)
    rig = Rig(name="r", devices=(device.model_copy(update={"interface": "virtual", "channel": "adapter-test"}),))
    sink = Rowsink()
    (adapter,) = open_devices(rig, {}, RIGS, SystemClock(), sink.put)
    with can.Bus(interface="virtual", channel="adapter-test") as other:
        adapter.start()
        try:
            sink.wait_for_event(Code.CONNECT)
            frame = bytes.fromhex("2800F6070069525F")
            other.send(can.Message(arbitration_id=0x100, data=frame, is_extended_id=False))
            assert sink.wait_for_sample().stream == "can.gyro"
        finally:
            adapter.stop()
    assert sink.events(Code.CRC) == []


def test_an_unknown_can_interface_is_said_so() -> None:
    device = load_rig("can_only").devices[0]
    rig = Rig(name="r", devices=(device.model_copy(update={"interface": "carrier_pigeon", "channel": "loft"}),))
    sink = Rowsink()
    (adapter,) = open_devices(rig, {}, RIGS, SystemClock(), sink.put)
    adapter.start()
    assert "carrier_pigeon" in sink.wait_for_event(Code.DISCONNECT).detail
    adapter.stop()


def test_an_emulated_device_without_its_emulator_is_named() -> None:
    with pytest.raises(DeviceError, match="device can is emulated") as caught:
        open_devices(load_rig("can_only"), {}, RIGS, SystemClock(), Rowsink().put)
    assert len(str(caught.value).splitlines()) <= 3

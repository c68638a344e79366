"""A serial port is found by its path, or by its USB adapter's serial number wherever that has come back."""

from __future__ import annotations

import os
import tty
from collections.abc import Iterator

import pytest
from serial.tools.list_ports_common import ListPortInfo

from drivers import serial_port
from drivers.mavlink_port import open_port as open_mavlink
from drivers.serial_port import open_port, path_of
from station.clock import ManualClock
from station.profile import MavlinkDevice
from station.rows import DeviceError


def adapter(path: str, serial: str | None, location: str | None = "1-1.2:1.0") -> ListPortInfo:
    """As the system's USB tree tells it."""
    there = ListPortInfo(path)
    there.serial_number, there.location = serial, location
    return there


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> list[ListPortInfo]:
    """What is plugged in: to be altered."""
    there: list[ListPortInfo] = []
    monkeypatch.setattr(serial_port.list_ports, "comports", lambda: list(there))
    return there


@pytest.fixture
def terminals() -> Iterator[list[tuple[int, str]]]:
    made = [os.openpty() for _ in range(2)]
    for _, slave in made:
        tty.setraw(slave)
    yield [(master, os.ttyname(slave)) for master, slave in made]
    for pair in made:
        for end in pair:
            os.close(end)


def test_an_adapter_that_comes_back_under_another_path_is_found(
    plugged: list[ListPortInfo], terminals: list[tuple[int, str]]
) -> None:
    for master, path in terminals:
        plugged[:] = [adapter("/dev/ttyACM7", "OTHER"), adapter(path, "A50285BI")]
        port = open_port("usb:A50285BI", 115_200)
        try:
            os.write(master, b"bytes")
            assert port.read(2.0) == b"bytes"
        finally:
            port.close()
        plugged.clear()
        with pytest.raises(DeviceError, match="no such adapter; is it plugged in"):
            open_port("usb:A50285BI", 115_200)


def test_mavlink_takes_the_same_name(plugged: list[ListPortInfo], terminals: list[tuple[int, str]]) -> None:
    master, path = terminals[0]
    plugged.append(adapter(path, "PX4-1"))
    stream = {"name": "a", "message": "ATTITUDE", "rate": "9 Hz", "signals": {"q": {"field": "pitch", "unit": "rad/s"}}}
    told = {"link": "mavlink", "name": "autopilot", "url": "usb:PX4-1", "streams": [stream]}
    device = MavlinkDevice.model_validate(told)
    port = open_mavlink(device, device.url, None, ManualClock())  # type: ignore[arg-type]
    try:
        os.write(master, b"bytes")
        assert port.read(2.0) == b"bytes"
    finally:
        port.close()


def test_of_several_ports_of_an_adapter_the_interface_is_named(plugged: list[ListPortInfo]) -> None:
    plugged += [adapter("/dev/ttyUSB4", "FT4232", "1-1:1.0"), adapter("/dev/ttyUSB5", "FT4232", "1-1:1.1")]
    with pytest.raises(DeviceError, match=r"use one of usb:FT4232:1.0 \(/dev/ttyUSB4\), usb:FT4232:1.1"):
        path_of("usb:FT4232")
    assert path_of("usb:FT4232:1.1") == "/dev/ttyUSB5"


def test_a_path_that_is_gone_is_told_the_better_name(plugged: list[ListPortInfo]) -> None:
    plugged += [adapter("/dev/ttyUSB1", "A50285BI"), adapter("/dev/ttyS0", None, None)]
    with pytest.raises(DeviceError) as error:
        open_port("/dev/no-such-port", 115_200)
    assert str(error.value).splitlines() == [
        "cannot open /dev/no-such-port: no such port; is the device plugged in?",
        'port = "usb:SERIAL" in the rig finds it under another path too',
        "plugged in: usb:A50285BI (/dev/ttyUSB1)",
    ]

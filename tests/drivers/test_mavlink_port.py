"""MAVLink's links: UDP, TCP and serial on this machine, and what is said when they cannot be opened."""

from __future__ import annotations

import os
import socket
import tty
from collections.abc import Iterator
from typing import Any

import pytest

from drivers.mavlink_port import open_port
from station.profile import MavlinkDevice
from station.rows import DeviceError


def device(**options: Any) -> MavlinkDevice:
    signals = {"theta": {"field": "pitch", "unit": "rad"}}
    streams = [{"name": "attitude", "message": "ATTITUDE", "rate": "50 Hz", "signals": signals}]
    return MavlinkDevice.model_validate(
        {"link": "mavlink", "name": "autopilot", "url": "emulated", "streams": streams, **options}
    )


@pytest.fixture
def peer() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        one.settimeout(2.0)
        yield one


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize(
    "form", ["udpin:127.0.0.1:{}", "udp:localhost:{}", "udpin::{}", "udpin:{}", "udpin://127.0.0.1:{}"]
)
def test_listening(peer: socket.socket, form: str) -> None:
    at = free_port()
    port = open_port(device(), form.format(at))
    try:
        port.write(b"to nobody yet")
        assert port.read(0.0) == b""
        peer.sendto(b"one", ("127.0.0.1", at))
        peer.sendto(b"two", ("127.0.0.1", at))
        assert [port.read(2.0), port.read(2.0)] == [b"one", b"two"]
        port.write(b"back")
        assert peer.recv(100) == b"back"
    finally:
        port.close()
        port.close()


def test_listening_is_on_the_loopback_unless_the_rig_names_another_address() -> None:
    at = free_port()
    port = open_port(device(), f"udpin:{at}")
    try:
        with pytest.raises(DeviceError, match="in use"):
            open_port(device(), f"udpin:127.0.0.1:{at}")
        # Were it on every address, this one would be taken too.
        open_port(device(), f"udpin:127.0.0.2:{at}").close()
    finally:
        port.close()


def test_calling(peer: socket.socket) -> None:
    port = open_port(device(timesync=True), f"udpout:127.0.0.1:{peer.getsockname()[1]}")
    try:
        port.write(b"hello")
        data, sender = peer.recvfrom(100)
        assert data == b"hello"
        peer.sendto(b"answer", sender)
        assert port.read(2.0) == b"answer"
    finally:
        port.close()


def test_calling_needs_something_to_say() -> None:
    with pytest.raises(DeviceError, match="allow timesync"):
        open_port(device(), "udpout:127.0.0.1:14550")


def test_a_server_that_hangs_up() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(device(), f"tcp:127.0.0.1:{server.getsockname()[1]}")
        try:
            client, _ = server.accept()
            client.sendall(b"stream")
            assert port.read(2.0) == b"stream"
            assert port.read(0.0) == b""
            port.write(b"request")
            assert client.recv(100) == b"request"
            client.close()
            with pytest.raises(OSError, match="closed the connection"):
                port.read(2.0)
        finally:
            port.close()


def test_no_server() -> None:
    with pytest.raises(DeviceError, match=r"cannot open tcp:127\.0\.0\.1:\d+: Connection refused: nobody listens"):
        open_port(device(), f"tcp:127.0.0.1:{free_port()}")


def test_a_port_that_another_program_has() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with pytest.raises(DeviceError, match="in use: another program listens there; close that or use another port"):
            open_port(device(), f"udpin:127.0.0.1:{other.getsockname()[1]}")


def test_a_serial_port() -> None:
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        port = open_port(device(baud=57_600), os.ttyname(slave))
        try:
            os.write(master, b"bytes")
            assert port.read(2.0) == b"bytes"
        finally:
            port.close()
    finally:
        os.close(slave)
        os.close(master)


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("udpin:127.0.0.1:port", "number from 1 to 65535"),
        ("udpin:127.0.0.1:0", "number from 1 to 65535"),
        ("tcp:localhost:70000", "number from 1 to 65535"),
        ("udpin:", "number from 1 to 65535"),
        ("ftp:127.0.0.1:21", "write one of udpin"),
        ("udpin:no.such.host.invalid:14550", "cannot open"),
        ("/dev/no-such-port", "no such port"),
    ],
)
def test_what_cannot_be_opened_says_why(url: str, says: str) -> None:
    with pytest.raises(DeviceError, match=says) as error:
        open_port(device(), url)
    assert url in str(error.value)
    assert len(str(error.value).splitlines()) <= 3

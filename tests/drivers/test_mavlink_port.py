"""MAVLink's links: UDP, TCP and serial on this machine, and what is said when they cannot be opened."""

from __future__ import annotations

import os
import socket
import tty
from collections.abc import Iterator
from typing import Any

import pytest

from drivers.codec import Port
from drivers.mavlink_port import REOPEN_NS, SILENT_NS, open_port
from station.clock import ManualClock
from station.profile import MavlinkDevice
from station.rows import DeviceError


def device(**options: Any) -> MavlinkDevice:
    signals = {"theta": {"field": "pitch", "unit": "rad"}}
    streams = [{"name": "attitude", "message": "ATTITUDE", "rate": "50 Hz", "signals": signals}]
    return MavlinkDevice.model_validate(
        {"link": "mavlink", "name": "autopilot", "url": "emulated", "streams": streams, **options}
    )


class Gate:
    """Knows the vehicle's heartbeat by one word, and keeps whom it was told of."""

    def __init__(self) -> None:
        self.others: list[str] = []

    def vouches_for(self, datagram: bytes) -> bool:
        return b"heartbeat" in datagram

    def pass_over(self, who: str) -> None:
        self.others.append(who)


def opened(device: MavlinkDevice, url: str, gate: Gate | None = None, clock: ManualClock | None = None) -> Port:
    return open_port(device, url, gate or Gate(), clock or ManualClock())


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
    port = opened(device(), form.format(at))
    try:
        port.write(b"to nobody yet")
        assert port.read(0.0) == b""
        peer.sendto(b"one", ("127.0.0.1", at))
        peer.sendto(b"heartbeat", ("127.0.0.1", at))
        peer.sendto(b"two", ("127.0.0.1", at))
        assert [port.read(2.0), port.read(2.0), port.read(2.0)] == [b"", b"heartbeat", b"two"]
        port.write(b"back")
        assert peer.recv(100) == b"back"
    finally:
        port.close()
        port.close()


def test_listening_is_on_the_loopback_unless_the_rig_names_another_address() -> None:
    at = free_port()
    port = opened(device(), f"udpin:{at}")
    try:
        with pytest.raises(DeviceError, match="in use"):
            opened(device(), f"udpin:127.0.0.1:{at}")
        # Were it on every address, this one would be taken too.
        opened(device(), f"udpin:127.0.0.2:{at}").close()
    finally:
        port.close()


def test_calling(peer: socket.socket) -> None:
    port = opened(device(timesync=True), f"udpout:127.0.0.1:{peer.getsockname()[1]}")
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
        opened(device(), "udpout:127.0.0.1:14550")


def test_a_server_that_hangs_up() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = opened(device(), f"tcp:127.0.0.1:{server.getsockname()[1]}")
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
        opened(device(), f"tcp:127.0.0.1:{free_port()}")


def test_a_port_that_another_program_has() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with pytest.raises(DeviceError, match="in use: another program listens there; close that or use another port"):
            opened(device(), f"udpin:127.0.0.1:{other.getsockname()[1]}")


def test_a_serial_port() -> None:
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        port = opened(device(baud=57_600), os.ttyname(slave))
        try:
            os.write(master, b"bytes")
            assert port.read(2.0) == b"bytes"
        finally:
            port.close()
    finally:
        os.close(slave)
        os.close(master)


def test_the_first_vehicle_keeps_its_link_and_others_are_told(peer: socket.socket) -> None:
    gate, clock, at = Gate(), ManualClock(), free_port()
    port = opened(device(), f"udpin:{at}", gate, clock)
    mine = "{}:{}".format(*peer.getsockname())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        other.settimeout(0.1)
        his = "{}:{}".format(*other.getsockname())
        try:
            other.sendto(b"anything", ("127.0.0.1", at))
            assert port.read(2.0) == b""
            port.write(b"secret")
            with pytest.raises(TimeoutError):
                other.recv(100)
            peer.sendto(b"heartbeat", ("127.0.0.1", at))
            assert port.read(2.0) == b"heartbeat"
            for words in (b"heartbeat", b"anything"):
                other.sendto(words, ("127.0.0.1", at))
                assert port.read(2.0) == b""
            assert gate.others == [f"{his}, as the vehicle is at {mine}"] * 2
            port.write(b"request")
            assert peer.recv(100) == b"request"
            # The vehicle falls silent: only a heartbeat of its gets another address the link.
            clock.advance_s(SILENT_NS * 1e-9 + 0.1)
            other.sendto(b"anything", ("127.0.0.1", at))
            assert port.read(2.0) == b""
            other.sendto(b"heartbeat", ("127.0.0.1", at))
            assert port.read(2.0) == b"heartbeat"
            port.write(b"request")
            assert other.recv(100) == b"request"
            peer.sendto(b"heartbeat", ("127.0.0.1", at))
            assert port.read(2.0) == b""
            assert gate.others[-1] == f"{mine}, as the vehicle is at {his}"
        finally:
            port.close()


def test_who_speaks_and_never_sends_a_heartbeat_is_told(peer: socket.socket) -> None:
    gate, clock, at = Gate(), ManualClock(), free_port()
    port = opened(device(), f"udpin:{at}", gate, clock)
    try:
        for _ in range(2):
            peer.sendto(b"anything", ("127.0.0.1", at))
            assert port.read(2.0) == b""
            assert len(gate.others) == (clock.now_ns() > 0)
            clock.advance_s(SILENT_NS * 1e-9 + 0.1)
        assert gate.others[0].endswith("as no heartbeat of the vehicle comes from there")
    finally:
        port.close()


def test_who_is_called_is_the_only_one_heard(peer: socket.socket) -> None:
    gate = Gate()
    port = opened(device(timesync=True), f"udpout:localhost:{peer.getsockname()[1]}", gate)
    try:
        port.write(b"hello")
        _, at = peer.recvfrom(100)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.sendto(b"heartbeat", at)
            assert port.read(2.0) == b""
        peer.sendto(b"answer", at)
        assert port.read(2.0) == b"answer"
        assert len(gate.others) == 1
    finally:
        port.close()


def test_a_server_that_falls_silent_is_given_up() -> None:
    clock = ManualClock()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = opened(device(), f"tcp:127.0.0.1:{server.getsockname()[1]}", clock=clock)
        try:
            client, _ = server.accept()
            with client:
                clock.advance_s(REOPEN_NS * 1e-9 - 1.0)
                client.sendall(b"stream")
                assert port.read(2.0) == b"stream"
                clock.advance_s(REOPEN_NS * 1e-9 - 1.0)
                assert port.read(0.0) == b""
                clock.advance_s(1.1)
                with pytest.raises(OSError, match="nothing has come for 10 s"):
                    port.read(0.0)
                kept = port._socket.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)  # type: ignore[attr-defined]
                assert kept
        finally:
            port.close()


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
        opened(device(), url)
    assert url in str(error.value)
    assert len(str(error.value).splitlines()) <= 3

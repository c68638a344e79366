"""Whatever is behind the port, the rig's user is told what it looks like: each device against every other protocol.

The senders: pyubx2, pynmeagps, pymavlink and the emulated devices' encoders.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Final

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega
from pyubx2 import GET, UBXMessage

from drivers import ports_there, serial_port
from drivers.adapter import Adapter
from drivers.can_frames import encode_slcan
from drivers.codec import Reading
from drivers.framing import seal_line
from drivers.protocols import protocol_named
from drivers.signatures import LAST_LOOK, SIGNATURES, Unread, recognised
from station.clock import ManualClock
from station.profile import SerialDevice
from station.rows import Code, Event, Level, Rows


def sent(protocol: str, message: str | int, field: str) -> bytes:
    row = protocol_named(protocol)
    return b"".join(row.encode(Reading(message, k * 10**7, k, {field: 10.0 + k})) for k in range(200))


def heartbeats(version: int) -> bytes:
    link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    message = ardupilotmega.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)
    return b"".join(message.pack(link, force_mavlink1=version == 1) for _ in range(200))


rng = np.random.default_rng(0)
WIRES: Final[dict[str, bytes]] = {
    "ubx": sent("ubx", "NAV-PVT", "velN"),
    "vectornav": sent("vectornav", "Attitude", "YawPitchRoll.yaw"),
    "boombox": sent("boombox", 1, "v0"),
    "boombox_ascii": sent("boombox_ascii", 1, "v0"),
    "nmea": sent("nmea", "GGA", "lat"),
    "vectornav_text": seal_line("VNYMR,-000.053,+000.001,-000.019,+0.2541,+0.0040,+0.4300") * 100,
    "mavlink": heartbeats(2),
    "slcan": encode_slcan(0x100, False, bytes(8)) * 300,
    "lines": b"1.25,3.5,-7.0\r\n" * 600,
    "msp": sent("msp", "AOA", "aoa"),
    "msp_other": b"$M<\x00\x6c\x6c" * 200,
}
CODECS: Final = ("boombox", "boombox_ascii", "ubx", "nmea", "vectornav", "lines", "msp")


def box(protocol: str) -> SerialDevice:
    message, fields = next(iter(protocol_named(protocol).fields.items()))
    signals = {"p": {"field": fields[0], "unit": "rad/s"}}
    return SerialDevice.model_validate(
        {
            "name": "box",
            "link": "serial",
            "protocol": protocol,
            "port": "nowhere",
            "streams": [{"name": "s", "message": message, "rate": "50 Hz", "signals": signals}],
        }
    )


def told(protocol: str, *blocks: bytes) -> list[Event]:
    """What an adapter says of its line's bytes, but for unreadable messages."""
    rows: list[Rows] = []
    adapter = Adapter(box(protocol), protocol_named(protocol).codec(), lambda: None, ManualClock(0), rows.append)  # type: ignore[arg-type,return-value]
    for block in blocks:
        adapter.take(block)
    return [row for row in rows if isinstance(row, Event) and row.code in (Code.PROTOCOL, Code.FRESH)]


def test_every_row_has_its_wire_here() -> None:
    assert SIGNATURES.keys() == WIRES.keys()


@pytest.mark.parametrize("name", WIRES)
def test_each_is_recognised_wherever_one_begins_to_listen(name: str) -> None:
    for start in (0, 1, 17, 50):
        assert recognised(WIRES[name][start : start + 1024]) == name


def test_mavlink_of_the_first_version_is_mavlink() -> None:
    assert recognised(heartbeats(1)[5:600]) == "mavlink"


@pytest.mark.parametrize("expected", CODECS)
@pytest.mark.parametrize("name", WIRES)
def test_another_device_than_the_rig_says_is_named_once_and_an_alarm(name: str, expected: str) -> None:
    events = told(expected, *(WIRES[name][i : i + 64] for i in range(0, 8192, 64)))
    if name == expected:
        assert events == []
        return
    (event,) = events
    assert event.level is Level.ALARM
    assert event.detail.startswith(f"this looks like {SIGNATURES[name].words}, the rig says {expected}: ")


def test_it_is_over_when_messages_are_read_after_all() -> None:
    events = told("boombox", WIRES["ubx"][:1024], WIRES["boombox"][:100])
    assert [e.code for e in events] == [Code.PROTOCOL, Code.FRESH]
    assert events[1].detail.startswith("PROTOCOL ")


def test_the_right_protocol_without_the_rigs_messages_is_told() -> None:
    status = UBXMessage("NAV", "NAV-STATUS", GET).serialize() * 600
    (event,) = told("ubx", status)
    assert event.detail == "u-blox UBX is heard, but none of the messages that are read of it"


def test_lines_of_text_are_shown_and_what_is_nothing_known_asks_for_the_speed() -> None:
    (lines,) = told("boombox", b"AOA=1.25 deg\r\n" * 400)
    assert lines.detail == "lines of text that are not boombox: 'AOA=1.25 deg'"
    (noise,) = told("boombox", rng.bytes(8192))
    assert "is the speed right (115200 baud in the rig)?" in noise.detail


@given(st.lists(st.binary(max_size=600), max_size=30))
def test_any_bytes_are_looked_at_a_bounded_number_of_times(blocks: list[bytes]) -> None:
    unread = Unread("boombox", None)
    assert sum(bool(unread.take(block)) for block in blocks) <= 1
    assert sum(len(block) for block in blocks) < LAST_LOOK or not unread.take(bytes(LAST_LOOK))


def test_a_port_without_permission_names_its_group_and_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    def said(mode: int, gid: int) -> str:
        made = SimpleNamespace(st_mode=mode, st_gid=gid)
        monkeypatch.setattr(ports_there, "Path", lambda _: SimpleNamespace(stat=lambda: made, group=lambda: "uucp"))
        with pytest.raises(serial_port.DeviceError) as error:
            serial_port.open_port(str(port), 115_200)
        return str(error.value)

    port = tmp_path / "ttyUSB0"
    port.touch()
    monkeypatch.setattr(serial_port.serial, "Serial", refused)
    assert "no permission: sudo usermod -aG uucp" in said(0o660, 20)
    # As a system without serial devices has them: no group to join, least of all root's.
    for mode, gid in ((0o600, 20), (0o640, 20), (0o660, 0)):
        assert f"no group has it: sudo setfacl -m u:$USER:rw {port}" in said(mode, gid)

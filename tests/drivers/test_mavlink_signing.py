"""Signed MAVLink, against signatures made here by hand."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path

import pytest

from drivers.adapter import what_is_sent
from drivers.codec import TimeReply
from drivers.mavlink import MavlinkCodec, MavlinkEncoder, read_signing_key
from station.rows import ProfileError
from tests.drivers.mavlink_by_hand import (
    ATTITUDE,
    ATTITUDE_FIELDS,
    ATTITUDE_PAYLOAD,
    HEARTBEAT,
    SECOND,
    device,
    packet,
    packet_1,
    readings,
    x25,
)

KEY = bytes(range(32))
NOW_NS = 1_763_700_000_000_000_000
NOW = (NOW_NS - 1_420_070_400_000_000_000) // 10_000


def signed(stamp: int, key: bytes = KEY, seq: int = 0, link: int = 0) -> bytes:
    """ATTITUDE with the signature of the standard: the first 48 bits of SHA-256(key, packet, link, time)."""
    payload = ATTITUDE_PAYLOAD.rstrip(b"\0")
    head = bytes([len(payload), 1, 0, seq, 1, 1, 30, 0, 0])
    crc = x25(head + payload + bytes([39]))
    frame = b"\xfd" + head + payload + struct.pack("<H", crc) + bytes([link]) + stamp.to_bytes(6, "little")
    return frame + hashlib.sha256(key + frame).digest()[:6]


def test_a_signature_by_hand_is_accepted() -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    assert len(readings(codec, signed(NOW))) == 1
    assert (codec.bad, codec.refused) == (0, 0)


def test_the_encoder_signs_as_by_hand() -> None:
    assert MavlinkEncoder(key=KEY, utc_ns=NOW_NS).encode("ATTITUDE", ATTITUDE_FIELDS, 123_456_000_000) == signed(NOW)


@pytest.mark.parametrize(
    "data",
    [
        packet(30, ATTITUDE, ATTITUDE_PAYLOAD),
        packet_1(30, ATTITUDE, ATTITUDE_PAYLOAD),
        signed(NOW, key=bytes(32)),
        signed(NOW)[:-1] + b"\0",
        signed(NOW - 6_100_000),
    ],
    ids=["unsigned", "MAVLink 1", "another key", "wrong signature", "more than a minute old"],
)
def test_packets_without_a_good_signature_are_refused_and_counted(data: bytes) -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    assert codec.feed(data) == []
    assert (codec.bad, codec.refused) == (1, 1)
    assert len(readings(codec, signed(NOW + 1))) == 1


def test_a_packet_played_back_is_refused() -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    readings(codec, signed(NOW) + signed(NOW + 5))
    assert codec.feed(signed(NOW + 5) + signed(NOW + 4)) == []
    assert codec.refused == 2
    codec.reset()
    assert codec.feed(signed(NOW + 5)) == [], "a lost link opens no door"


def test_a_forged_time_does_not_lock_out_the_vehicle() -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    readings(codec, signed(NOW))
    assert codec.feed(signed(2**48 - 1, key=bytes(32))) == []
    assert len(readings(codec, signed(NOW + 1))) == 1


def test_without_a_key_signed_packets_are_read_too() -> None:
    assert len(readings(MavlinkCodec(device()), signed(0))) == 1


def test_a_signed_link_works_both_ways() -> None:
    codec = MavlinkCodec(device(timesync=True), KEY, NOW_NS)
    autopilot = MavlinkEncoder(key=KEY, utc_ns=NOW_NS)
    codec.feed(autopilot.heartbeat())
    assert codec.feed(autopilot.answer(codec.outgoing(9), 8)) == [TimeReply(9, 8)]
    stranger = MavlinkCodec(device(timesync=True))
    stranger.feed(autopilot.heartbeat())
    assert stranger.outgoing(10)
    assert autopilot.answer(stranger.outgoing(10), 8) == b""


def heartbeat(stamp: int, key: bytes = KEY, sender: tuple[int, int] = (1, 1), kind: int = 1) -> bytes:
    """Signed by hand; of an ArduPilot plane unless another `kind` (6: a ground station)."""
    payload = struct.pack("<IBBBBB", 0, kind, 3, 0, 4, 3)
    head = bytes([len(payload), 1, 0, 0, *sender, 0, 0, 0])
    frame = b"\xfd" + head + payload + struct.pack("<H", x25(head + payload + bytes([50])))
    frame += b"\0" + stamp.to_bytes(6, "little")
    return frame + hashlib.sha256(key + frame).digest()[:6]


@pytest.mark.parametrize(
    ("datagram", "refused"),
    [
        (heartbeat(NOW, key=bytes(32)), 1),
        (packet(0, HEARTBEAT, struct.pack("<IBBBBB", 0, 1, 3, 0, 4, 3)), 1),
        (heartbeat(NOW - 7_000_000), 1),
        (signed(NOW), 0),
        (heartbeat(NOW, sender=(2, 1)), 0),
        (heartbeat(NOW, sender=(1, 191)), 0),
        (heartbeat(NOW, kind=6), 0),
        (b"", 0),
    ],
    ids=["another key", "unsigned", "old", "no heartbeat", "system", "component", "ground station", "empty"],
)
def test_the_codec_vouches_for_the_signed_heartbeat_of_the_vehicle_alone(datagram: bytes, refused: int) -> None:
    codec = MavlinkCodec(device(), KEY, NOW_NS)
    assert not codec.vouches_for(datagram)
    assert (codec.bad, codec.refused) == (refused, refused)
    assert codec.vouches_for(heartbeat(NOW))
    assert codec.vouches_for(heartbeat(NOW)), "to vouch takes no note"
    codec.feed(heartbeat(NOW))
    assert not codec.vouches_for(heartbeat(NOW)), "played back"
    assert codec.vouches_for(heartbeat(NOW + 1))


@pytest.mark.parametrize("after_s", [0, 1, 3600])
def test_what_is_sent_is_signed_with_the_time_of_sending(after_s: int) -> None:
    """A vehicle that was switched on an hour into the flight takes nothing that is a minute old."""
    station_ns = 77 * SECOND
    codec = MavlinkCodec(device(timesync=True), KEY, NOW_NS, station_ns)
    codec.feed(heartbeat(NOW))
    stamps = []
    for k in range(3):
        (request,) = packets_signed(codec.outgoing(station_ns + after_s * SECOND + k * SECOND // 4))
        stamps.append(int.from_bytes(request[-12:-6], "little"))
    assert stamps == [NOW + after_s * 100_000 + k * 25_000 for k in range(3)]


def packets_signed(data: bytes) -> list[bytes]:
    return [data[at : at + 25 + data[1]] for at in range(0, len(data), 25 + data[1])]


@pytest.mark.parametrize(
    ("text", "says"),
    [(None, "No such file"), ("00 11", "64 hexadecimal digits"), ("zz" * 32, "64 hexadecimal digits")],
)
def test_a_bad_key_file_is_named(tmp_path: Path, text: str | None, says: str) -> None:
    if text is not None:
        (tmp_path / "link.key").write_text(text)
    with pytest.raises(ProfileError, match=says) as error:
        read_signing_key(device(signing_key_file="link.key"), tmp_path)
    assert str(tmp_path / "link.key") in str(error.value)


def test_the_key_file(tmp_path: Path) -> None:
    (tmp_path / "link.key").write_text(KEY.hex() + "\n")
    assert read_signing_key(device(signing_key_file="link.key"), tmp_path) == KEY
    assert read_signing_key(device(), tmp_path) is None


@pytest.mark.parametrize(
    ("url", "key", "is_told"),
    [
        ("udpin:0.0.0.0:14550", None, True),
        ("udpin:192.168.1.20:14550", None, True),
        ("tcp:autopilot.local:5760", None, True),
        ("udpin:0.0.0.0:14550", "key.hex", False),
        ("udpin:127.0.0.1:14550", None, False),
        ("udpin:[::1]:14550", None, False),
        ("serial:/dev/ttyACM0:57600", None, False),
        ("emulated", None, False),
    ],
)
def test_that_anybody_may_be_the_vehicle_is_told_where_others_reach_an_unsigned_link(
    url: str, key: str | None, is_told: bool
) -> None:
    link = device().model_copy(update={"url": url, "signing_key_file": key})
    codec = MavlinkCodec(link)
    codec.feed(MavlinkEncoder().heartbeat())
    assert codec.speaker.startswith("system 1, component 1")
    for told in (codec.speaker, what_is_sent(link)):
        assert ("signing_key_file in the rig" in told) == is_told

"""MAVLink's frames by hand, from the standard's text."""

from __future__ import annotations

import re
import struct
from typing import Any

from hypothesis import settings

from drivers.codec import Reading
from drivers.mavlink import MavlinkCodec
from station.profile import MavlinkDevice

SECOND = 1_000_000_000
SEEDED = settings(deadline=None, derandomize=True)


def device(**options: Any) -> MavlinkDevice:
    def stream(name: str, message: str, rate: str, **signals: str) -> dict[str, Any]:
        channels = {signal: dict(zip(("field", "unit"), text.split(), strict=True)) for signal, text in signals.items()}
        return {"name": name, "message": message, "rate": rate, "signals": channels}

    return MavlinkDevice.model_validate(
        {
            "link": "mavlink",
            "name": "autopilot",
            "url": "emulated",
            "system_id": 1,
            "streams": [
                stream("attitude", "ATTITUDE", "50 Hz", theta="pitch rad"),
                stream("velocity", "LOCAL_POSITION_NED", "25 Hz", v_down="vz m/s"),
            ],
            **options,
        }
    )


def readings(codec: MavlinkCodec, data: bytes) -> list[Reading]:
    return [r for r in codec.feed(data) if isinstance(r, Reading)]


# The standard, by hand (mavlink.io, "Packet Serialization").


def x25(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit: polynomial 0x1021 reflected, initial value 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x8408 if crc & 1 else 0)
    return crc


def crc_extra(definition: str) -> int:
    """Of "NAME type field type field [length] ...", fields in the order of the wire; a length counts as one byte."""
    words = re.split(r"\[(\d+)\] ", definition + " ")
    crc = x25(b"".join(bytes([int(w)]) if i % 2 else w.encode() for i, w in enumerate(words)))
    return (crc & 0xFF) ^ (crc >> 8)


def packet(number: int, definition: str, payload: bytes, seq: int = 0, sender: tuple[int, int] = (1, 1)) -> bytes:
    payload = payload.rstrip(b"\0") or b"\0"
    head = bytes([len(payload), 0, 0, seq, *sender]) + number.to_bytes(3, "little")
    crc = x25(head + payload + bytes([crc_extra(definition)]))
    return b"\xfd" + head + payload + struct.pack("<H", crc)


def packet_1(number: int, definition: str, payload: bytes, seq: int = 0) -> bytes:
    head = bytes([len(payload), seq, 1, 1, number])
    crc = x25(head + payload + bytes([crc_extra(definition)]))
    return b"\xfe" + head + payload + struct.pack("<H", crc)


def packets(data: bytes) -> list[bytes]:
    """Unsigned MAVLink 2 packets, one after the other."""
    out = []
    while data:
        size = 12 + data[1]
        out.append(data[:size])
        data = data[size:]
    return out


ATTITUDE = (
    "ATTITUDE uint32_t time_boot_ms float roll float pitch float yaw float rollspeed float pitchspeed float yawspeed"
)
ATTITUDE_PAYLOAD = struct.pack("<I6f", 123_456, 0.5, -0.25, 3.0, 0.125, -0.0625, 0.0)
ATTITUDE_FIELDS = {
    "roll": 0.5,
    "pitch": -0.25,
    "yaw": 3.0,
    "rollspeed": 0.125,
    "pitchspeed": -0.0625,
    "yawspeed": 0.0,
}
ATTITUDE_BYTES = bytes.fromhex(
    "fd 18 00 00 07 01 01 1e 00 00 40 e2 01 00 00 00 00 3f 00 00 80 be 00 00 40 40 00 00 00 3e 00 00 80 bd"
)
"""The ATTITUDE packet number 7 up to its checksum, written out: 24 bytes, as the four zeros at the end are left out."""

HEARTBEAT = (
    "HEARTBEAT uint32_t custom_mode uint8_t type uint8_t autopilot uint8_t base_mode uint8_t system_status "
    "uint8_t mavlink_version"
)
GPS_RAW_INT = (
    "GPS_RAW_INT uint64_t time_usec int32_t lat int32_t lon int32_t alt uint16_t eph uint16_t epv uint16_t vel "
    "uint16_t cog uint8_t fix_type uint8_t satellites_visible"
)
AOA_SSA = "AOA_SSA uint64_t time_usec float AOA float SSA"
NAMED = "NAMED_VALUE_FLOAT uint32_t time_boot_ms float value char name [10]"

"""Sound messages of each link, hurt on the way or before they were sealed, and what its codec makes of them.

Most damage on the way is found by a checksum, and what reads the message behind that never sees it. So of half of the
messages the content is hurt and the checksum made to fit: a device that errs, or a stranger, sends such.
"""

from __future__ import annotations

import hashlib
import random
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache, reduce
from operator import xor
from typing import Final, NamedTuple

import dronecan
from cobs import cobs
from dronecan.dsdl.common import crc16_from_bytes
from fastcrc import crc8, crc16
from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.can_dbc import CanCodec
from drivers.can_dronecan import DronecanCodec, DronecanEncoder
from drivers.can_frames import encode_slcan, read_slcan
from drivers.codec import Codec, Reading
from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from drivers.mavlink_messages import TABLE
from drivers.serial_boombox import BoomboxAsciiCodec, BoomboxCodec, encode_line, encode_packet
from drivers.serial_gnss import NmeaCodec, UbxCodec, encode_nav_pvt, encode_sentence
from drivers.serial_lines import LinesCodec
from drivers.serial_msp import MspCodec
from drivers.serial_msp import encode as encode_msp
from drivers.serial_vectornav import VECTORNAV, VectorNavCodec
from station.profile import CanDevice, DronecanDevice, MavlinkDevice, Rig, load_rig, profiles_dir
from tests.reliability.counts import TOGETHER, Flown
from tests.reliability.hurting import mutated

LINKS: Final = (
    "boombox", "boombox_ascii", "ubx", "nmea", "vectornav", "lines", "msp", "can", "dronecan", "mavlink",
    "mavlink signed",
)  # fmt: skip
KEY: Final = bytes(range(32))
PROVEN: Final = 10
"""One of so many resets is followed by a sound message: a codec that lost its way for good is found a little later."""

Resealed = Callable[[bytes, random.Random], bytes]
"""Of a sound message one whose content is hurt, and whose checksum fits that."""


class Link(NamedTuple):
    """A codec and sound messages of its link."""

    codec: Callable[[], Codec]
    sound: Sequence[bytes]
    resealed: Resealed
    opening: bytes = b""
    """What it has to hear before anything else."""


@cache
def rig_of(name: str) -> Rig:
    return load_rig(name)


def can_codec() -> CanCodec:
    device = rig_of("can_only").devices[0]
    assert isinstance(device, CanDevice)
    return CanCodec(device, profiles_dir() / "rigs")


def dronecan_codec() -> DronecanCodec:
    device = rig_of("dronecan").devices[0]
    assert isinstance(device, DronecanDevice)
    return DronecanCodec(device)


def dronecan_transfers() -> list[bytes]:
    """Of all that the rig reads, in turn; most take several frames."""
    node, streams = DronecanEncoder(42), rig_of("dronecan").devices[0].streams
    return [
        node.encode(Reading(s.message, k * 10**7, None, {c.field: 0.1 for c in s.signals.values()}))
        for k in range(4)
        for s in streams
    ]


def mavlink_codec(key: bytes | None = None) -> MavlinkCodec:
    device = rig_of("mavlink_only").devices[0]
    assert isinstance(device, MavlinkDevice)
    return MavlinkCodec(device, key)


def links() -> dict[str, Link]:
    turns = range(20)

    def said(codec: Callable[[], Codec], by: MavlinkEncoder) -> Link:
        beat = by.heartbeat()
        return Link(codec, [by.encode(name, {}, k * 10**9) for k, name in enumerate(TABLE)], _mavlink, beat)

    return {
        "boombox": Link(BoomboxCodec, [encode_packet(k % 3, k, 5000 * k, (k, -k, 77)) for k in turns], _packet),
        "boombox_ascii": Link(
            BoomboxAsciiCodec, [encode_line(k % 3, k, 5000 * k, (k, -k, 77)) for k in turns], _sentence
        ),
        "ubx": Link(UbxCodec, [encode_nav_pvt(k * 10**8, 50.0, 10.0, 1e5, (1e3, k, -k)) for k in turns], _ubx),
        "nmea": Link(NmeaCodec, [
            *(encode_sentence("VTG", 0, v_north=k, v_east=2.0) for k in turns),
            *(encode_sentence("GGA", k * 10**9, lat=47.1, lon=8.2, alt=545.4) for k in turns),
            *(encode_sentence("RMC", k * 10**9, lat=47.1, lon=8.2, spd=22.4, cog=84.4) for k in turns),
        ], _sentence),
        "vectornav": Link(VectorNavCodec, [
            VECTORNAV.encode(Reading("IMU", k * 10**7, None, dict.fromkeys(VECTORNAV.fields["IMU"], 0.1 * k)))
            for k in turns
        ], _vectornav),
        "lines": Link(LinesCodec, [f"aoa {k}.25,{-k}e-3,7\r\n".encode() for k in turns], mutated, b"\n"),
        "msp": Link(MspCodec, [
            encode_msp(Reading("AOA", None, None, {"aoa": 0.1 * k, "sideslip": -0.1 * k})) for k in turns
        ], _msp),
        "can": Link(can_codec, [
            b"t10082800F6070069525F\r",
            *(encode_slcan(m.definition.frame_id, m.frame[1], bytes([k] * m.definition.length))
              for k, m in enumerate(can_codec().messages.values())),
        ], _frame),
        "dronecan": Link(dronecan_codec, dronecan_transfers(), _transfer),
        "mavlink": said(mavlink_codec, MavlinkEncoder()),
        "mavlink signed": said(lambda: mavlink_codec(KEY), MavlinkEncoder(key=KEY)),
    }  # fmt: skip


def _packet(message: bytes, noise: random.Random) -> bytes:
    body = mutated(cobs.decode(message[:-1])[:-2], noise)
    return bytes(cobs.encode(body + crc16.ibm_3740(body).to_bytes(2, "little"))) + b"\0"


def _sentence(message: bytes, noise: random.Random) -> bytes:
    body = mutated(message[1:-5], noise)
    return b"$%s*%02X\r\n" % (body, reduce(xor, body, 0))


def _ubx(message: bytes, noise: random.Random) -> bytes:
    body = bytearray(mutated(message[2:-2], noise))
    body[2:4] = max(0, len(body) - 4).to_bytes(2, "little")
    a = b = 0
    for byte in body:
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    return message[:2] + bytes(body) + bytes((a, b))


def _vectornav(message: bytes, noise: random.Random) -> bytes:
    body = mutated(message[1:-2], noise)
    return message[:1] + body + crc16.xmodem(body).to_bytes(2, "big")


def _msp(message: bytes, noise: random.Random) -> bytes:
    body = bytearray(mutated(message[3:-1], noise))
    body[3:5] = max(0, len(body) - 5).to_bytes(2, "little")
    return message[:3] + bytes(body) + bytes((crc8.dvb_s2(bytes(body)),))


def _frame(message: bytes, noise: random.Random) -> bytes:
    frame = read_slcan(message[:-1])
    assert frame is not None
    number, is_extended, data = frame
    return encode_slcan(number, is_extended, mutated(data or b"\0", noise)[:8])


def _transfer(message: bytes, noise: random.Random) -> bytes:
    """Cut into frames anew, with the checksum of what is in them (DroneCAN's "CAN bus transport layer")."""
    frames = [frame for line in message.split(b"\r") if (frame := read_slcan(line)) is not None]
    number, tail = frames[0][0], frames[0][2][-1] & 0x1F
    content = b"".join(data[:-1] for _, _, data in frames)
    content = mutated(content if len(frames) == 1 else content[2:], noise)
    if len(content) > 7:
        kind = dronecan.DATATYPES[number >> 8 & 0xFFFF, dronecan.dsdl.CompoundType.KIND_MESSAGE]
        content = crc16_from_bytes(content, initial=kind.base_crc).to_bytes(2, "little") + content
    pieces = [content[at : at + 7] for at in range(0, len(content), 7)] or [b""]
    last = len(pieces) - 1
    return b"".join(
        encode_slcan(number, True, piece + bytes((tail | 0x80 * (not n) | 0x40 * (n == last) | 0x20 * (n % 2),)))
        for n, piece in enumerate(pieces)
    )


def _mavlink(message: bytes, noise: random.Random) -> bytes:
    """Of version 2; of one that is signed the signature fits too (mavlink.io, "Packet Serialization")."""
    is_signed = message[2] & 1
    payload = mutated(message[10 : 10 + message[1]], noise)[:255]
    head = bytes((len(payload),)) + message[2:10]
    if noise.random() < 0.1:
        head = (head[:1] + mutated(head[1:], noise) + bytes(9))[:9]
    kind = dialect.mavlink_map.get(int.from_bytes(head[6:9], "little"))
    checked = head + payload + bytes((kind.crc_extra if kind else 0,))
    sealed = message[:1] + head + payload + crc16.mcrf4xx(checked).to_bytes(2, "little")
    if not is_signed:
        return sealed
    sealed += message[-13:-6]
    return sealed + hashlib.sha256(KEY + sealed).digest()[:6]


def fly_link(name: str, link: Link, flown: Flown, seed: int) -> Iterator[None]:
    """One input after another: a message, at times with others around it, hurt, and cut anywhere."""
    noise, codec = random.Random(f"{seed} {name}"), link.codec()
    proof = link.codec()
    numbers(proof, link.opening, flown, "sound")
    whole = [m for m in link.sound if numbers(proof, m, flown, "sound")]
    assert whole, f"{name}: no sound message"
    began = time.process_time()
    for count in range(1, 2**63):
        if "signed" in name:  # what is signed is taken once, and in order
            codec = link.codec()
        numbers(codec, link.opening, flown, "opening")
        found, data = 0, _stream(link, noise)
        size = noise.choice((1, 7, 64, 1000, 1000, 1000))
        for at in range(0, len(data), size):
            found += numbers(codec, data[at : at + size], flown, f"{flown.inputs}")
        codec.reset()
        flown.read += bool(found)
        # A signed message counts once, and a link that has lost sync may first have to hear the vehicle's heartbeat.
        if "signed" not in name and not count % PROVEN:
            if not numbers(codec, link.opening + noise.choice(whole), flown, f"{flown.inputs}"):
                flown.fault(f"{flown.inputs}", "a sound message after a reset is not read")
            codec.reset()
        if not count % TOGETHER:
            flown.longest_s = max(flown.longest_s, time.process_time() - began)
        yield
        if not count % TOGETHER:
            began = time.process_time()


def _stream(link: Link, noise: random.Random) -> bytes:
    """A message or some, one of them hurt."""
    picked = sorted(noise.choices(range(len(link.sound)), k=noise.choice((1, 1, 1, 1, 2, 4))))
    at = noise.randrange(len(picked))
    messages = [link.sound[n] for n in picked]
    messages[at] = (link.resealed if noise.random() < 0.5 else mutated)(messages[at], noise)
    if noise.random() < 0.05:
        messages.append(noise.randbytes(noise.randrange(400)))
    return b"".join(messages)


def numbers(codec: Codec, data: bytes, flown: Flown, seed: str) -> int:
    """How many readings are in it, all of whose fields are numbers."""
    try:
        found = codec.feed(data)
    except Exception as error:
        flown.fault(seed, f"{type(error).__name__}: {error}")
        return 0
    for reading in found:
        if isinstance(reading, Reading) and not all(type(v) in (float, int) for v in reading.fields.values()):
            flown.fault(seed, f"no number: {reading}")
    return len(found)

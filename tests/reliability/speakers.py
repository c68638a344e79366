"""Who else speaks on a MAVLink link: another component, other systems, forgers. What of it got into the signals?"""

from __future__ import annotations

import hashlib
import random
from collections.abc import Callable
from dataclasses import dataclass

from drivers.codec import Reading
from drivers.mavlink import MavlinkCodec, MavlinkEncoder
from station.profile import MavlinkDevice

KEY = bytes(range(32))
UTC_NS = 1_763_700_000_000_000_000
OURS, THEIRS = 0.1, -0.4
"""Pitch that the vehicle says, and that everybody else does."""
TRAILER = 13
"""Bytes of a signature: link, time in six bytes, six of the hash (mavlink.io, "Message Signing")."""


@dataclass(slots=True)
class Told:
    """Attitudes that were sent by the vehicle and by others, those taken of each, and how many of others' messages the
    link counts."""

    sent: int = 0
    others: int = 0
    taken: int = 0
    mixed: int = 0
    counted: int = 0

    def take(self, codec: MavlinkCodec, data: bytes) -> None:
        for reading in codec.feed(data):
            if isinstance(reading, Reading) and reading.message == "ATTITUDE":
                is_ours = abs(reading.fields["pitch"] - OURS) < 1e-6
                self.taken += is_ours
                self.mixed += not is_ours


def device(system_id: int | None = 1) -> MavlinkDevice:
    pitch = {"theta": {"field": "pitch", "unit": "rad"}}
    return MavlinkDevice.model_validate({
        "name": "autopilot", "link": "mavlink", "url": "udpin:127.0.0.1:14550", "system_id": system_id,
        "streams": [{"name": "attitude", "message": "ATTITUDE", "rate": "50 Hz", "signals": pitch}],
    })  # fmt: skip


def foreign(messages: int, seed: int, system_id: int | None) -> Told:
    """A vehicle among others: its own camera, a second vehicle, a ground station, any system and component at all."""
    noise, told = random.Random(seed), Told()
    codec, vehicle = MavlinkCodec(device(system_id)), MavlinkEncoder()
    others = [MavlinkEncoder(component_id=191), MavlinkEncoder(system_id=2), MavlinkEncoder(system_id=255)]
    others += [MavlinkEncoder(system_id=noise.randrange(2, 255), component_id=noise.randrange(256)) for _ in range(20)]
    codec.feed(vehicle.heartbeat())
    for n in range(messages):
        if noise.random() < 0.5:
            told.take(codec, vehicle.encode("ATTITUDE", {"pitch": OURS}, n * 10**6))
            told.sent += 1
        else:
            other = noise.choice(others)
            beat = other.heartbeat() if noise.random() < 0.1 else b""
            told.take(codec, beat + other.encode("ATTITUDE", {"pitch": THEIRS}, n * 10**6))
            told.others += 1 + bool(beat)
    told.counted = sum(codec.foreign.values())
    return told


def forged(messages: int, seed: int) -> Told:
    """A signed link, and packets beside it that the vehicle did not sign."""
    noise, told = random.Random(seed), Told()
    codec, last = MavlinkCodec(device(), KEY, UTC_NS), b""
    vehicle, without = MavlinkEncoder(key=KEY, utc_ns=UTC_NS), MavlinkEncoder()
    wrong = MavlinkEncoder(key=bytes(32), utc_ns=UTC_NS)
    late = MavlinkEncoder(key=KEY, utc_ns=UTC_NS - 61 * 10**9)

    def altered(data: bytes) -> bytes:
        at = len(data) - noise.randrange(1, TRAILER + 1)
        return data[:at] + bytes([data[at] ^ 1 << noise.randrange(8)]) + data[at + 1 :]

    def resigned(data: bytes) -> bytes:
        """A later time put into a sound packet, with a hash that is right but for the key."""
        body = data[:-12] + (int.from_bytes(data[-12:-6], "little") + 10**6).to_bytes(6, "little")
        return body + hashlib.sha256(body).digest()[:6]

    def attitude(by: MavlinkEncoder, n: int) -> bytes:
        return by.encode("ATTITUDE", {"pitch": THEIRS}, n * 10**6)

    tricks: list[Callable[[int], bytes]] = [
        lambda n: attitude(without, n),
        lambda n: attitude(wrong, n),
        lambda n: attitude(late, n),
        lambda n: altered(attitude(vehicle, n)),
        lambda n: resigned(attitude(vehicle, n)),
        lambda _: last,
    ]
    before = 0
    for n in range(messages):
        if not last or noise.random() < 0.5:
            last = vehicle.encode("ATTITUDE", {"pitch": OURS}, n * 10**6)
            told.take(codec, last)
            told.sent += 1
            before = told.taken
        else:
            told.take(codec, noise.choice(tricks)(n))
            told.others += 1
            # One that is played back says what the vehicle said.
            told.mixed, told.taken = told.mixed + told.taken - before, before
    told.counted = codec.refused
    return told

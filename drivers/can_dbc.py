"""CAN: frames named and scaled by a DBC file (cantools), and back for emulated devices.

Three signal names of a DBC mean the same in every message that has them: `stamp` is the device's time in seconds,
wrapping with its width; `counter` counts the frames of that message; `checksum` is CRC-8 SAE J1850 over the other
bytes in order and then the low byte of the frame identifier, and must be one whole byte.

Of the others, from 8 bits on, the most negative count (the highest of an unsigned one) is no reading, as in SAE J1939,
and the next one and the other end are a value beyond what the frame can carry. So is no reading, in any signal, a count
that the DBC has a word for (VAL_, such as "SNA").
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fastcrc import crc8

from drivers.can_frames import FrameCodec
from drivers.codec import Reading
from station.conventions import unit_named
from station.profile import CanDevice, nearest_or_all
from station.rows import ProfileError

# cantools brings python-can, which handles MDF4 files where it finds asammdf: seconds and 100 MiB that no bus needs.
_is_absent = sys.modules.setdefault("asammdf", None) is None  # type: ignore[arg-type]
import cantools  # noqa: E402

if _is_absent:
    del sys.modules["asammdf"]

STAMP: Final = "stamp"
COUNTER: Final = "counter"
CHECKSUM: Final = "checksum"
_HAS_ENDS: Final = 8
"""Bits from which on a signal's end counts are none of its measurements."""


@dataclass(frozen=True, slots=True)
class CanSignal:
    """How a count becomes a value, and which counts are none."""

    scale: float
    offset: float
    sent: tuple[float, float]
    """Least and greatest count that a value is sent as."""
    measured: tuple[float, float]
    """Least and greatest count that are measurements: one that is sent outside is a value beyond them."""
    none: float
    """What is sent where there is no reading."""
    unread: frozenset[float]
    """The counts that are no reading."""

    def value(self, count: float) -> float:
        """NaN for no reading, infinite beyond what the frame can carry."""
        if math.isnan(count) or count in self.unread:
            return math.nan
        low, high = self.measured
        if not low <= count <= high:
            return math.copysign(math.inf, (count - low) * self.scale)
        return count * self.scale + self.offset

    def count(self, value: float, wraps: bool = False) -> float:
        """The nearest to a value, which `wraps` or is held at the ends."""
        if math.isnan(value):
            return self.none
        count = (value - self.offset) / self.scale
        low, high = self.sent
        if math.isinf(high):
            return count
        return round(count) % (high + 1) if wraps else round(min(max(count, low), high))


@dataclass(frozen=True, slots=True)
class CanMessage:
    """One DBC message and where its special signals lie. `definition` is cantools' message."""

    definition: Any
    signals: Mapping[str, CanSignal]
    checksum_byte: int | None
    wrap_ns: int
    seq_wrap: int

    @property
    def frame(self) -> tuple[int, bool]:
        """Identifier and whether it is an extended one."""
        return self.definition.frame_id, self.definition.is_extended_frame


def load_dbc(path: Path) -> dict[str, CanMessage]:
    """The messages of a DBC by name. Raises ProfileError for a file that cannot be read or a misplaced checksum."""
    try:
        database: Any = cantools.database.load_file(path)
        messages = database.messages
    except OSError as error:
        raise ProfileError(f"dbc {path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # cantools' parsers and its checks of overlap share no public base class
        reason = " ".join(str(error).split())
        raise ProfileError(f"dbc {path}: not a usable DBC: {reason:.160}") from error
    return {m.name: _message(path, m) for m in messages}


def _message(path: Path, definition: Any) -> CanMessage:
    signals = {s.name: s for s in definition.signals}
    checksum_byte, wrap_ns, seq_wrap = None, 0, 0
    if (checksum := signals.get(CHECKSUM)) is not None:
        first_bit = checksum.start % 8
        if checksum.length != 8 or first_bit != (0 if checksum.byte_order == "little_endian" else 7):
            raise ProfileError(f"dbc {path}: {definition.name}.{CHECKSUM}: must be one whole byte")
        checksum_byte = checksum.start // 8
    if (stamp := signals.get(STAMP)) is not None:
        wrap_ns = round(2**stamp.length * stamp.scale * 1e9)
    if (counter := signals.get(COUNTER)) is not None:
        seq_wrap = 2**counter.length
    return CanMessage(definition, {n: _signal(s) for n, s in signals.items()}, checksum_byte, wrap_ns, seq_wrap)


def _signal(definition: Any) -> CanSignal:
    scale, offset, bits = float(definition.scale), float(definition.offset), definition.length
    if definition.is_float:
        everything = (-math.inf, math.inf)
        return CanSignal(scale, offset, everything, everything, math.nan, frozenset())
    low = -(2 ** (bits - 1)) if definition.is_signed else 0
    high = low + 2**bits - 1
    is_special = definition.name in (STAMP, COUNTER, CHECKSUM)
    named = frozenset() if is_special else frozenset(map(float, definition.choices or ()))
    if is_special or bits < _HAS_ENDS:
        return CanSignal(scale, offset, (low, high), (low, high), 0, named)
    if definition.is_signed:
        return CanSignal(scale, offset, (low + 1, high), (low + 2, high - 1), low, named | {low})
    return CanSignal(scale, offset, (low, high - 1), (low, high - 2), high, named | {high})


def checksum_of(frame_id: int, data: bytes, checksum_byte: int) -> int:
    """CRC-8 SAE J1850 over all bytes but the checksum's own, then the identifier's low byte."""
    rest = data[:checksum_byte] + data[checksum_byte + 1 :] + bytes((frame_id & 0xFF,))
    return int(crc8.sae_j1850(rest))


class CanCodec(FrameCodec):
    """Frames to readings; those that are not in the DBC belong to other nodes and are passed over.

    Raises ProfileError, with the key, when made for a device whose rig entry does not fit its DBC file, which lies in
    `rig_dir`.
    """

    def __init__(self, device: CanDevice, rig_dir: Path) -> None:
        super().__init__()
        self.messages = load_dbc(rig_dir / device.dbc)
        _check(device, rig_dir / device.dbc, self.messages)
        self._by_frame = {m.frame: m for m in self.messages.values()}

    def read_frame(self, frame_id: int, is_extended: bool, data: bytes) -> Sequence[Reading]:
        reading = self.feed_frame(frame_id, is_extended, data)
        return () if reading is None else (reading,)

    def feed_frame(self, frame_id: int, is_extended: bool, data: bytes) -> Reading | None:
        """One frame; None if it is not in the DBC or is counted bad."""
        message = self._by_frame.get((frame_id, is_extended))
        if message is None:
            return None
        at = message.checksum_byte
        if at is not None and (len(data) <= at or data[at] != checksum_of(frame_id, data, at)):
            self.bad += 1
            return None
        try:
            counts = message.definition.decode(data, decode_choices=False, scaling=False)
            fields = {name: message.signals[name].value(count) for name, count in counts.items()}
        except Exception:  # too short, or a multiplexer value the DBC does not know
            self.bad += 1
            return None
        stamp, counter = fields.get(STAMP), fields.get(COUNTER)
        return Reading(
            message.definition.name,
            round(stamp * 1e9) if stamp is not None and math.isfinite(stamp) else None,
            int(counter) if counter is not None and math.isfinite(counter) else None,
            fields,
            message.wrap_ns,
            message.seq_wrap,
        )


def _check(device: CanDevice, path: Path, messages: Mapping[str, CanMessage]) -> None:
    for stream in device.streams:
        key = f"stream {stream.name}"
        name = str(stream.message)
        if name not in messages:
            raise ProfileError(f"{key}, message: {path} has no message {name}{nearest_or_all(name, messages)}")
        units = {s.name: s.unit or "" for s in messages[name].definition.signals}
        for signal, channel in stream.signals.items():
            if channel.field not in units:
                raise ProfileError(
                    f"{key}, {signal}: message {name} of {path} has no signal {channel.field}"
                    f"{nearest_or_all(channel.field, units)}"
                )
            unit = units[channel.field]
            is_as_it_comes = channel.slope == 1 and channel.zero == 0 and channel.table is None
            if unit and is_as_it_comes and unit_named(unit) not in (None, unit_named(channel.unit)):
                raise ProfileError(
                    f"{key}, {signal}: {name}.{channel.field} of {path} is in {unit}, not {channel.unit}\n"
                    "correct the rig's unit, or give a slope"
                )


def encode_frame(message: CanMessage, values: Mapping[str, float], t_ns: int, seq: int) -> tuple[int, bool, bytes]:
    """Identifier, whether extended, and data of a frame with its stamp, counter and checksum.

    Values are physical; beyond what the signal's width can carry they say so, and not given, or NaN, they are no
    reading (0 in a signal too narrow to say it). `t_ns` and `seq` are taken modulo what the DBC gives them.
    """
    definition = message.definition
    given = dict(values)
    if message.wrap_ns:
        given[STAMP] = t_ns % message.wrap_ns * 1e-9
    if message.seq_wrap:
        given[COUNTER] = seq % message.seq_wrap
    raw = {name: s.count(given.get(name, math.nan), wraps=name == STAMP) for name, s in message.signals.items()}
    data: bytes = definition.encode(raw, scaling=False, strict=False)
    at = message.checksum_byte
    if at is not None:
        data = data[:at] + bytes((checksum_of(definition.frame_id, data, at),)) + data[at + 1 :]
    return (*message.frame, data)

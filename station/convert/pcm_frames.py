"""Minor frames of PCM in Chapter 10 packets (PCM format 1: unpacked, packed, throughput): their words over time."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.convert.ch10_packets import TICK_NS, Packet
from station.convert.tmats import Counts, Fragment, PcmFormat
from station.rows import LogError

Bits = NDArray[np.uint8]
"""One a byte."""

_UNPACKED: Final = 1 << 18
_PACKED: Final = 1 << 19
_THROUGHPUT: Final = 1 << 20
_WIDE: Final = 1 << 21
"""Bits of the channel specific data word (Chapter 11, 11.2.2.1): mode, and alignment to 32 bits."""
_TIME_BYTES: Final = 8
_LONGEST_WORD: Final = 64


class Frames(NamedTuple):
    """Of a channel, in time."""

    t_ns: NDArray[np.int64]
    """Of the first bit."""
    bits: NDArray[np.uint8]
    """(frames, bits)."""
    lost: int
    """Frames without their synchronisation pattern."""


def frames(packets: Sequence[Packet], form: PcmFormat) -> Frames:
    """Raises LogError for what is not read here."""
    times: list[NDArray[np.int64]] = []
    found: list[NDArray[np.uint8]] = []
    lost = 0
    stream: list[tuple[int, Bits]] = []
    swap = 0
    for packet in packets:
        (word,) = struct.unpack_from("<I", packet.body)
        wide = bool(word & _WIDE)
        if word & _THROUGHPUT:
            body = packet.body[4 : 4 + (len(packet.body) - 4) // 4 * 4 if wide else None]
            stream.append((packet.ticks * TICK_NS, _in_order(body, 4 if wide else 2)))
            continue
        if packet.other_times:
            raise LogError(
                "minor frames are stamped with the secondary header's time: only the relative counter is read"
            )
        made = _stamped(packet.body, form, wide, bool(word & _UNPACKED and not word & _PACKED))
        if made is None:
            continue
        t_ns, halves = made
        swap = swap or _byte_order(halves, form, wide)
        bits = _words_out(_swapped(halves, swap), form, wide) if word & _UNPACKED else _swapped(halves, swap)
        bits = bits[:, : form.bits]
        good = _synchronised(bits, form.sync)
        lost += int(np.sum(~good))
        times.append(t_ns[good])
        found.append(bits[good])
    if stream:
        t_ns, bits, missed = _searched(stream, form)
        times.append(t_ns)
        found.append(bits)
        lost += missed
    if not times:
        return Frames(np.zeros(0, dtype=np.int64), np.zeros((0, form.bits), dtype=np.uint8), lost)
    return Frames(np.concatenate(times), np.concatenate(found), lost)


def _stamped(body: bytes, form: PcmFormat, wide: bool, unpacked: bool) -> tuple[NDArray[np.int64], Bits] | None:
    """Times and raw bytes of the frames of a packet: each has 8 bytes of time and a word of status before it."""
    unit = 4 if wide else 2
    head = _TIME_BYTES + unit
    if unpacked:
        length = unit * (-(-len(form.sync) // (8 * unit)) + sum(-(-w // (8 * unit)) for w in form.widths))
    else:
        length = -(-form.bits // (8 * unit)) * unit
    count = (len(body) - 4) // (head + length)
    if not count:
        return None
    rows = np.frombuffer(body, dtype=np.uint8, count=count * (head + length), offset=4).reshape(count, -1)
    stamps = np.zeros((count, 8), dtype=np.uint8)
    stamps[:, :6] = rows[:, :6]
    return stamps.view("<u8")[:, 0].astype(np.int64) * TICK_NS, rows[:, head:]


def _in_order(body: bytes, unit: int) -> Bits:
    """Bits as they were sent: most significant first in little-endian words."""
    whole = np.frombuffer(body, dtype=np.uint8, count=len(body) // unit * unit)
    return np.unpackbits(whole.reshape(-1, unit)[:, ::-1].reshape(-1))


def _swapped(rows: Bits, unit: int) -> Bits:
    """(frames, bits) of rows of bytes, in words of `unit` bytes with the least significant first."""
    return np.unpackbits(rows.reshape(len(rows), -1, unit)[:, :, ::-1].reshape(len(rows), -1), axis=1)


def _byte_order(rows: Bits, form: PcmFormat, wide: bool) -> int:
    """Bytes of a word as the recorder wrote it: 2 or 4 as the standard has it, 1 where it did not swap; that with which
    most frames begin with the pattern."""
    units = (4, 2, 1) if wide else (2, 1)
    return max(units, key=lambda u: (int(np.sum(_synchronised(_swapped(rows, u), form.sync))), u))


def _words_out(bits: Bits, form: PcmFormat, wide: bool) -> Bits:
    """Bits without the padding that stands before each word; a long pattern fills whole words, the rest its last."""
    unit = 32 if wide else 16
    keep: list[NDArray[np.int64]] = []
    at = 0
    for width in (len(form.sync), *form.widths):
        while width > 0:
            piece = min(width, unit)
            keep.append(np.arange(at + unit - piece, at + unit))
            width -= piece
            at += unit
    return bits[:, np.concatenate(keep)]


def _synchronised(bits: Bits, sync: str) -> NDArray[np.bool_]:
    fixed = [i for i, digit in enumerate(sync) if digit != "X"]
    if bits.shape[1] < len(sync):
        return np.zeros(len(bits), dtype=bool)
    wanted = np.array([int(sync[i]) for i in fixed], dtype=np.uint8)
    return np.asarray(np.all(bits[:, fixed] == wanted, axis=1), dtype=bool)


def _searched(stream: Sequence[tuple[int, Bits]], form: PcmFormat) -> tuple[NDArray[np.int64], Bits, int]:
    """Frames in a stream without marks: where the pattern stands, and stands again a frame later or at the end."""
    bits = np.concatenate([b for _, b in stream])
    starts = np.cumsum([0, *(len(b) for _, b in stream)])
    length = form.bits
    places = len(bits) - length + 1
    if places < 1:
        return np.zeros(0, dtype=np.int64), np.zeros((0, length), dtype=np.uint8), 0
    hit = np.ones(len(bits) - len(form.sync) + 1, dtype=bool)
    for i, digit in enumerate(form.sync):
        if digit != "X":
            hit &= bits[i : i + len(hit)] == int(digit)
    again = np.ones(places, dtype=bool)
    beyond = np.arange(places) + length
    inside = beyond < len(hit)
    again[inside] = hit[beyond[inside]]
    begins: list[int] = []
    for at in np.flatnonzero(hit[:places] & again).tolist():
        if not begins or at >= begins[-1] + length:
            begins.append(at)
    first = np.array(begins, dtype=np.int64)
    packet = np.searchsorted(starts, first, side="right") - 1
    base = np.array([t for t, _ in stream], dtype=np.int64)
    t_ns = base[packet] + np.round((first - starts[packet]) * 1e9 / form.rate).astype(np.int64)
    rows = bits[first[:, None] + np.arange(length)] if len(first) else np.zeros((0, length), dtype=np.uint8)
    return t_ns, rows, max(0, len(bits) // length - len(first))


def samples(of: Frames, form: PcmFormat, places: Sequence[Sequence[Fragment]]) -> tuple[NDArray[np.int64], Counts, int]:
    """Times (ns), counts and bits of a measurement. A sample has the time of its last bit. Raises LogError."""
    offsets = np.cumsum([len(form.sync), *form.widths])
    times: list[NDArray[np.int64]] = []
    values: list[Counts] = []
    width = 0
    for place in places:
        for step in range(_samples_a_frame(place, form)):
            columns = np.concatenate([_columns(piece, step, form, offsets) for piece in place])
            if len(columns) > _LONGEST_WORD:
                raise LogError(f"a measurement of {len(columns)} bits, where at most 64 are read")
            rows = _rows(of, form, place)
            weights = np.uint64(1) << np.arange(len(columns) - 1, -1, -1, dtype=np.uint64)
            values.append(np.asarray(of.bits[np.ix_(rows, columns)].astype(np.uint64) @ weights, dtype=np.uint64))
            late = round((int(columns.max()) + 1) * 1e9 / form.rate)
            times.append(of.t_ns[rows] + late)
            width = len(columns)
    t_ns, counts = np.concatenate(times), np.concatenate(values)
    order = np.argsort(t_ns, kind="stable")
    return t_ns[order], counts[order], width


def _samples_a_frame(place: Sequence[Fragment], form: PcmFormat) -> int:
    piece = place[0]
    if piece.word > len(form.widths):
        raise LogError(f"word {piece.word} of a minor frame that has {len(form.widths)} behind its pattern")
    return 1 + ((len(form.widths) - piece.word) // piece.interval if piece.interval else 0)


def _columns(piece: Fragment, step: int, form: PcmFormat, offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    word = piece.word + step * piece.interval
    if word > len(form.widths):
        raise LogError(f"word {word} of a minor frame that has {len(form.widths)} behind its pattern")
    width = form.widths[word - 1]
    mask = piece.mask or "1" * width
    if len(mask) != width:
        raise LogError(f"mask {mask} of {len(mask)} bits on word {word}, which has {width}")
    return np.array([int(offsets[word - 1]) + i for i, digit in enumerate(mask) if digit == "1"], dtype=np.int64)


def _rows(of: Frames, form: PcmFormat, place: Sequence[Fragment]) -> NDArray[np.int64]:
    """The frames that hold it."""
    piece = place[0]
    if form.minor_frames == 1 or form.counter is None:
        return np.arange(len(of.t_ns), dtype=np.int64)
    word, first, width, initial, at_initial, sign = form.counter
    begin = len(form.sync) + sum(form.widths[: word - 1]) + first - 1
    weights = 1 << np.arange(width - 1, -1, -1)
    count = of.bits[:, begin : begin + width].astype(np.int64) @ weights
    frame = (at_initial - 1 + sign * (count - initial)) % form.minor_frames + 1
    wanted = {piece.frame}
    if piece.frames:
        wanted = set(range(piece.frame, form.minor_frames + 1, piece.frames))
    return np.asarray(np.flatnonzero(np.isin(frame, sorted(wanted))), dtype=np.int64)

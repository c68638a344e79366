"""IRIG 106 Chapter 10 recordings (.ch10, .c10): measurements of PCM and analog channels, as the setup record (TMATS)
describes them, become signals.

A measurement is the signal whose name it has, or which `names` gives it. Its unit is TMATS's (C-d\\MN3). Times are the
recorder's relative time counter.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNALS, Unit, unit_named
from station.convert.ch10_packets import ABOUT_ITSELF, ANALOG, KINDS, PCM, TICK_NS, Damage, Packet, packets, setup
from station.convert.pcm_frames import frames, samples
from station.convert.tmats import (
    Channel,
    Conversion,
    Counts,
    Setup,
    as_numbers,
    channels,
    conversions,
    indices,
    locations,
    number,
    pcm_format,
    whole,
)
from station.convert.tracks import Record, Track, in_si
from station.profile import Aircraft, nearest
from station.rows import LogError

_SHOWN: Final = 40
"""Names of measurements in an error."""


class _Raw(NamedTuple):
    """A measurement's counts over time."""

    channel: int
    t_ns: NDArray[np.int64]
    counts: Counts
    bits: int
    form: str
    """Binary format, where the channel says it."""


def read_ch10(path: Path, aircraft: Aircraft, names: Mapping[str, str] | None = None) -> Record:
    """Raises LogError: without a setup record, and where no measurement is a signal, naming those that there are."""
    given = setup(path)
    damage = Damage()
    kept: dict[int, list[Packet]] = {}
    other: dict[str, set[int]] = {}
    for packet in packets(path, damage):
        if packet.kind in (PCM, ANALOG):
            kept.setdefault(packet.channel, []).append(packet)
        elif packet.kind not in ABOUT_ITSELF:
            other.setdefault(KINDS.get(packet.kind, f"type {packet.kind:#04x}"), set()).add(packet.channel)
    try:
        meanings = conversions(given)
        wanted = _wanted(path, given, meanings, names or {})
        found, left = _read(given, kept, meanings, wanted)
    except LogError as error:
        raise LogError(f"{path}: {error}" if not str(error).startswith(str(path)) else str(error)) from None
    left += [f"channels of {kind}: {len(numbers)}, not read" for kind, numbers in sorted(other.items())]
    if not found:
        raise LogError(f"{path}: none of its measurements could be read: " + "; ".join(left))
    notes = {"file": path.name, "program": given.get("G\\PN", "")}
    if left:
        notes["left_out"] = "; ".join(left)
    if damage.packets or damage.bytes:
        notes["lost"] = f"{damage.packets} damaged packets, {damage.bytes} bytes that are in no packet"
    return Record(_tracks(found), aircraft, "ch10", notes)


def _wanted(
    path: Path, given: Setup, meanings: Mapping[str, Conversion | str], names: Mapping[str, str]
) -> dict[str, str]:
    """Measurement by signal. Raises LogError."""
    there = {name.lower(): name for name in (*meanings, *_analog_names(given))}
    told = ", ".join(sorted(there.values())[:_SHOWN]) + (", ..." if len(there) > _SHOWN else "")
    for signal, name in names.items():
        if signal not in SIGNALS:
            raise LogError(f"{path}: unknown signal {signal!r}{nearest(signal, tuple(SIGNALS))}")
        if name.lower() not in there:
            raise LogError(
                f"{path}: no measurement {name!r}{nearest(name, tuple(there.values()))}\nmeasurements: {told}"
            )
    chosen = {s: there[n.lower()] for s, n in names.items()}
    chosen |= {s: there[s] for s in SIGNALS if s in there and s not in chosen}
    if not chosen:
        raise LogError(
            f"{path}: no measurement has a signal's name; say which is which: --signal alpha_vane=NAME ...\n"
            f"measurements: {told or 'none'}"
        )
    return chosen


def _analog_names(given: Setup) -> list[str]:
    return [value for code, value in given.items() if code.startswith("R-") and "\\AMN-" in code]


def _read(
    given: Setup,
    kept: Mapping[int, Sequence[Packet]],
    meanings: Mapping[str, Conversion | str],
    wanted: Mapping[str, str],
) -> tuple[dict[str, tuple[_Raw, NDArray[np.float64]]], list[str]]:
    """Values in SI by signal, and what is left out, why."""
    raw, left = _counts(given, kept, set(wanted.values()))
    found = {}
    for signal, name in wanted.items():
        meaning = meanings.get(name, "nothing says what its counts mean (no C group)")
        made = raw.get(name, "no channel with packets holds it")
        if isinstance(made, str) or isinstance(meaning, str):
            left.append(f"{signal} ({name}): {made if isinstance(made, str) else meaning}")
            continue
        form = meaning.form if meaning.form != "UNS" or not made.form else made.form
        numbers = as_numbers(made.counts, made.bits, form)
        unit = _unit(signal, meaning.unit)
        if isinstance(numbers, str) or isinstance(unit, str):
            left.append(f"{signal} ({name}): {numbers if isinstance(numbers, str) else unit}")
            continue
        found[signal] = made, in_si(meaning.convert(numbers), unit)
    return found, left


def _unit(signal: str, text: str) -> Unit | str:
    unit = unit_named(text) or unit_named(text.lower())
    if unit is None or unit.si != SIGNALS[signal].unit:
        return f"unit {text or 'missing'} (C-d\\MN3), where one of {SIGNALS[signal].unit} is wanted"
    return unit


def _counts(
    given: Setup, kept: Mapping[int, Sequence[Packet]], wanted: set[str]
) -> tuple[dict[str, _Raw | str], list[str]]:
    raw: dict[str, _Raw | str] = {}
    left: list[str] = []
    for channel in channels(given):
        mine = kept.get(channel.number, ())
        if not mine:
            continue
        read = partial(_analog, given) if mine[0].kind == ANALOG else partial(_pcm, given)
        try:
            found, said = read(channel, mine, wanted)
        except LogError as error:
            left.append(f"channel {channel.number}: {error}")
            continue
        raw |= found
        left += said
    return raw, left


def _pcm(
    given: Setup, channel: Channel, mine: Sequence[Packet], wanted: set[str]
) -> tuple[dict[str, _Raw | str], list[str]]:
    places = {name: at for name, at in locations(given, channel.link).items() if name in wanted}
    if not places:
        return {}, []
    form = pcm_format(given, channel.link)
    of = frames(mine, form)
    found: dict[str, _Raw | str] = {}
    for name, at in places.items():
        try:
            found[name] = at if isinstance(at, str) else _Raw(channel.number, *samples(of, form, at), "")
        except LogError as error:
            found[name] = str(error)
    lost = [f"channel {channel.number}: {of.lost} minor frames without their pattern"] if of.lost else []
    return found, lost


def _analog(
    given: Setup, channel: Channel, mine: Sequence[Packet], wanted: set[str]
) -> tuple[dict[str, _Raw | str], list[str]]:
    """Subchannels sampled together: words of 16 bits, packed or padded (Chapter 11, 11.2.5)."""
    x, n = channel.index.split()
    rate = number(given, f"R-{x}\\ASR-{n}")
    times, blocks = [], []
    width = 0
    for packet in mine:
        (word,) = struct.unpack_from("<I", packet.body)
        mode, bits, count = word & 3, word >> 2 & 63 or 64, word >> 16 & 255 or 256
        words = 1 if word >> 28 & 1 else count
        factors = {w >> 24 & 15 for w in struct.unpack_from(f"<{words}I", packet.body)}
        if len(factors) > 1 or bits > 16 or (mode == 0 and bits != 16):  # noqa: PLR2004  words of 16 bits
            raise LogError(f"analog samples of {bits} bits, mode {mode}: only words of 16 bits at one rate are read")
        data = np.frombuffer(packet.body, dtype="<u2", offset=4 * words, count=(len(packet.body) - 4 * words) // 2)
        block = data[: len(data) // count * count].reshape(-1, count)
        block = block >> (16 - bits) if mode == 1 else block & (2**bits - 1)
        step = 2 ** factors.pop() * 1e9 / rate
        times.append(packet.ticks * TICK_NS + np.round(np.arange(len(block)) * step).astype(np.int64))
        blocks.append(block)
        width = bits
    if len({b.shape[1] for b in blocks}) != 1:
        raise LogError("the number of analog subchannels changes")
    table, t_ns = np.concatenate(blocks), np.concatenate(times)
    found: dict[str, _Raw | str] = {}
    for m in indices(given, f"R-{x}\\AMN-{n}-*"):
        name = given[f"R-{x}\\AMN-{n}-{m}"]
        at = whole(given, f"R-{x}\\AMCN-{n}-{m}", int(m), low=1) - 1
        form = given.get(f"R-{x}\\AF-{n}-{m}", "").upper()
        if name in wanted and at < table.shape[1]:
            found[name] = _Raw(channel.number, t_ns, table[:, at].astype(np.uint64), width, form)
    return found, []


def _tracks(found: Mapping[str, tuple[_Raw, NDArray[np.float64]]]) -> list[Track]:
    """Signals of a channel that have the same times are one stream."""
    tracks: list[tuple[int, NDArray[np.int64], dict[str, NDArray[np.float64]]]] = []
    for signal in SIGNALS:
        if signal not in found:
            continue
        raw, values = found[signal]
        later = np.diff(np.maximum.accumulate(raw.t_ns), prepend=-1) > 0
        t_ns, column = raw.t_ns[later], values[later]
        for number_, times, columns in tracks:
            if number_ == raw.channel and np.array_equal(times, t_ns):
                columns[signal] = column
                break
        else:
            tracks.append((raw.channel, t_ns, {signal: column}))
    several = {c for c, _, _ in tracks if sum(c == d for d, _, _ in tracks) > 1}
    return [Track(f"ch{c}.{next(iter(v))}" if c in several else f"ch{c}", t, v) for c, t, v in tracks]

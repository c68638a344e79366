"""What is in a recording, whether all of it is there, and saving what can be read of a broken one."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Literal

from station.conventions import SIGNALS, Stream
from station.log.about import About, LogInfo, counts_of
from station.log.counts import Counts
from station.log.messages import RowWriter
from station.log.reading import absent, metadata, number_of, read_part, readers
from station.log.scan import PartReader
from station.log.writer import write_log
from station.profile import Aircraft
from station.rows import MISSED_SHARE, Code, LogError, Rows

Verdict = Literal["complete", "truncated", "damaged"]
_GONE: Final = "not here: "


@dataclass(slots=True)
class Dropout:
    start_s: float
    length_s: float


@dataclass(slots=True)
class StreamSummary:
    """One stream: samples, their mean rate, intervals longer than 1.5 periods (gaps) and than the stream may be silent
    (dropouts). Intervals are of device time where the device has one."""

    name: str
    device: str
    signals: tuple[str, ...]
    nominal_hz: float
    samples: int = 0
    rate_hz: float = 0.0
    gaps: int = 0
    longest_gap_s: float = 0.0
    dropouts: list[Dropout] = field(default_factory=list)


@dataclass(slots=True)
class EventSummary:
    t_s: float
    source: str
    code: str
    count: int
    detail: str


@dataclass(slots=True)
class Summary:
    """`info LOG`. Times are seconds since the recording's first row."""

    path: str
    verdict: Verdict
    seconds_lost: float | None
    """Known to be missing, within the recording and in a broken last chunk; None where it is not known how much. What a
    killed station had not yet written is not in it: at most 0.15 s, 1.5 s by a power cut."""
    problems: list[str]
    files: int
    bytes: int
    aircraft: str
    card: str | None
    pilot: str
    """The feedback that flew it, in words; empty where none is known."""
    source: str
    imported: bool
    software: str
    utc_start_ns: int
    duration_s: float
    rows: int
    ticks: int
    ticks_missed: int
    frames: int
    methods: list[str]
    streams: list[StreamSummary]
    event_counts: dict[str, int]
    events: list[EventSummary]
    declared: dict[str, str] = field(default_factory=dict)
    """Signals that the rig declares beyond the station's, by name: the SI unit they are recorded in."""
    derived: dict[str, str] = field(default_factory=dict)
    """Signals that it makes of others, by name: expression and unit."""
    degraded: list[str] = field(default_factory=list)
    """What of it is not as it should be, in words; with any, `info` ends with exit code 3."""
    part: int = 0
    """Which file of its flight is named: of a later one only its own rows are told."""
    recovered: str = ""
    """What it was recovered from, and the verdict on that; empty for what was not."""


def summarise(path: Path, info: LogInfo | None = None) -> Summary:
    """Read a whole recording and judge it. Raises LogError only if there is no such file, it is no recording of a
    station, or nothing of its start can be read; `info` says what it is, where its start does not."""
    given, info = info, info or metadata(path)
    out = _empty(path, info)
    total = Counts.of(info.streams)
    gone = absent(path, info)
    lost: list[float | None] = []
    broke, before = False, number_of(path)
    for reader in readers(path, given):
        out.files += 1
        out.bytes += reader.path.stat().st_size
        counts = counts_of(reader) if given is None else None
        if counts is None:
            counts = Counts.of(info.streams)
            for row in read_part(reader):
                counts.add(row)
        number = number_of(reader.path)
        broke |= bool(gone) and number > before + 1
        before = number
        if broke and counts.first_ns is not None:
            # The file before ended early or is not here, and this one says when recording went on.
            lost.append(max(0.0, (counts.first_ns - total.last_ns) * 1e-9))
            broke = False
        broke |= _judge(out, reader, lost)
        total.join(counts)
    _tell(out, total, info)
    if gone:
        out.verdict = "truncated" if out.verdict == "complete" else out.verdict
        out.problems.append(f"{_GONE}{', '.join(gone)}")
        if info.part and total.first_ns is not None:
            lost.append(max(0.0, (total.first_ns - info.station_ns) * 1e-9))
        if total.goes_on:
            lost.append(None)
    known = [x for x in lost if x is not None]
    out.seconds_lost = sum(known) if known or not lost else None
    out.degraded = _shortcomings(out) + [f"{_GONE}{name}" for name in gone]
    return out


def _tell(out: Summary, total: Counts, info: LogInfo) -> None:
    """What was counted, in seconds since the first row."""
    zero = total.first_ns or 0
    devices = {s.name: s for s in info.streams}
    for name, c in total.streams.items():
        stream = StreamSummary(name, devices[name].device, devices[name].signals, c.nominal_hz)
        stream.samples, stream.rate_hz = c.samples, c.rate_hz
        stream.gaps, stream.longest_gap_s = c.gaps, c.longest_gap_s
        stream.dropouts = [Dropout((end - zero) * 1e-9 - length, length) for end, length in c.dropouts]
        out.streams.append(stream)
    out.rows, out.ticks, out.ticks_missed, out.frames = total.rows, total.ticks, total.ticks_missed, total.frames
    out.methods, out.event_counts = total.methods, total.event_counts
    out.events = [EventSummary((e[0] - zero) * 1e-9, e[1], e[2], e[3], e[4]) for e in total.events]
    out.duration_s = (total.last_ns - zero) * 1e-9 if total.first_ns is not None else 0.0
    out.utc_start_ns = info.utc_ns + (zero - info.station_ns)


def _shortcomings(s: Summary) -> list[str]:
    found = [] if s.verdict == "complete" else [f"the recording is {s.verdict}"]
    if s.ticks_missed > MISSED_SHARE * (s.ticks + s.ticks_missed):
        found.append(f"{s.ticks_missed} of {s.ticks + s.ticks_missed} ticks missed")
    lost = s.event_counts.get(Code.DROPPED, 0)
    return [*found, f"{lost} rows lost in flight"] if lost else found


def span_ns(path: Path) -> tuple[int, int] | None:
    """Station time of the first and the last row, as its files say at their ends; None where one does not."""
    total = [counts_of(reader) for reader in readers(path)]
    known = [c for c in total if c is not None and c.first_ns is not None]
    if not known or len(known) < len(total):
        return None
    return min(c.first_ns or 0 for c in known), max(c.last_ns for c in known)


def verdict(path: Path) -> Verdict:
    """The verdict alone, of files and chunks: no row is decoded. Raises LogError as `summarise` does."""
    found: Verdict = "truncated" if absent(path, metadata(path)) else "complete"
    for reader in readers(path):
        if reader.is_sound():
            continue
        reader.check()
        if reader.damage:
            return "damaged"
        found = "truncated" if reader.truncated_at is not None else found
    return found


def _empty(path: Path, info: LogInfo) -> Summary:
    about = info.about
    return Summary(
        path=str(path), verdict="complete", seconds_lost=0.0, problems=[], files=0, bytes=0,
        aircraft=about.aircraft.name,
        card=about.card.name if about.card else None,
        pilot=about.card.pilot.words if about.card and about.card.pilot.flies else "",
        source=about.source, imported=about.imported, software=info.software, utc_start_ns=info.utc_ns,
        duration_s=0.0, rows=0, ticks=0, ticks_missed=0, frames=0,
        methods=[], streams=[], event_counts={}, events=[],
        declared={s.name: s.unit for s in about.further.measured},
        derived={d.signal.name: f"{d.formula.text} [{about.further.units[d.signal.name]}]"
                 for d in about.further.derived},
        part=info.part, recovered=_recovered(about.notes),
    )  # fmt: skip


def _recovered(notes: Mapping[str, str]) -> str:
    whole = notes.get("verdict_of_original", "")
    return f"{notes['recovered_from']}, which is {whole}" if whole and "recovered_from" in notes else ""


def _judge(out: Summary, reader: PartReader, lost: list[float | None]) -> bool:
    """Add one file's verdict to the whole's; True if the file ends early."""
    name = reader.path.name
    for damage in reader.damage:
        out.verdict = "damaged"
        where = f"{name}: byte {damage.offset}" if damage.offset is not None else name
        out.problems.append(f"{where}: {damage.why}")
        lost.append(damage.lost_s)
    if reader.truncated_at is not None:
        out.verdict = "truncated" if out.verdict == "complete" else out.verdict
        left = reader.path.stat().st_size - reader.truncated_at
        out.problems.append(f"{name}: ends early at byte {reader.truncated_at} ({left} bytes of a broken record)")
        lost.append(reader.tail_s if left and reader.tail_s is not None else 0.0 if not left else None)
    return reader.truncated_at is not None


def in_words(summary: Summary) -> str:
    """Its verdict, and what of the flight is in other files."""
    gone = [problem for problem in summary.problems if problem.startswith(_GONE)]
    alone = [f"file {summary.part} of a flight alone"] if summary.part else []
    return ", ".join([summary.verdict, *alone, *gone])


def describe(summary: Summary) -> str:
    """A summary in words, for a terminal."""
    s = summary
    if s.verdict == "complete":
        verdict = "complete"
    elif s.seconds_lost is None:
        verdict = f"{s.verdict}: how much is missing is not known"
    else:
        verdict = f"{s.verdict}: {s.seconds_lost:.2f} s known to be missing"
        if s.verdict == "truncated" and not all(problem.startswith(_GONE) for problem in s.problems):
            verdict += ", and what was not yet written: up to 0.15 s if the station was killed, 1.5 s by a power cut"
    lines = [
        f"{s.path}: {verdict}",
        f"  {s.source} of {s.aircraft}, {s.duration_s:.2f} s, {s.rows} rows, {s.bytes} bytes in {s.files} file(s)"
        f"{f', flown with {s.pilot}' if s.pilot else ''}",
        f"  {s.ticks} ticks ({s.ticks_missed} missed), {s.frames} frames, methods: {', '.join(s.methods) or 'none'}",
    ]
    lines += [f"  recovered from {s.recovered}"] if s.recovered else []
    lines += [f"  file {s.part} of a flight: rows of its other files are not counted here"] if s.part else []
    lines += [f"  ! {problem}" for problem in s.problems]
    for stream in s.streams:
        lines.append(
            f"  {stream.name}: {stream.samples} samples, {stream.rate_hz:.2f} Hz of {stream.nominal_hz:g}, "
            f"{stream.gaps} gaps (longest {stream.longest_gap_s:.3f} s), {len(stream.dropouts)} dropouts"
        )
    if s.declared:
        lines.append("  declared: " + ", ".join(f"{name} [{unit}]" for name, unit in s.declared.items()))
    lines += [f"  derived: {name} = {made}" for name, made in s.derived.items()]
    if s.event_counts:
        lines.append("  events: " + ", ".join(f"{code} {n}" for code, n in sorted(s.event_counts.items())))
    return "\n".join(lines)


def recover(path: Path, out: Path, aircraft: Aircraft | None = None) -> Summary:
    """Write every readable row of a recording, all its files in one, into a new complete file, and read that back.

    Where the recording can no longer say what it is of, it is of `aircraft`, and its streams are told from their rows.
    Returns the summary of the source. Raises LogError, and leaves no `out`, if nothing can be read, `out` exists or
    cannot be written, or what is read back differs.
    """
    given = None
    try:
        info = metadata(path)
    except LogError:
        if aircraft is None or not path.is_file():
            raise
        info = given = _told_by_rows(path, aircraft)
    summary = summarise(path, given)
    if not summary.rows:
        raise LogError(f"{path}: no row of it can be read")
    notes = {**info.about.notes, "recovered_from": path.name, "verdict_of_original": in_words(summary)}
    about = replace(info.about, notes=notes)
    written = write_log(out, about, _rows(path, given), info.station_ns, info.utc_ns)
    try:
        whole = summarise(out).verdict == "complete" and written == summary.rows
        whole = whole and _digest(path, info, given) == _digest(out, info)
    except LogError:
        whole = False
    if not whole:
        out.unlink(missing_ok=True)
        raise LogError(
            f"{out}: does not read back as it was written, and was removed\nthe original is as it was: {path}"
        )
    return summary


def _told_by_rows(path: Path, aircraft: Aircraft) -> LogInfo:
    """What a recording is, by its channels and rows alone."""
    names: dict[str, tuple[str, ...]] = {}
    spans: dict[str, tuple[int, int, int]] = {}
    reader = PartReader(path)
    for channel, time_ns, data in reader.messages():
        if channel.metadata.get("row") == "Sample":
            stream = channel.metadata["key"]
            if stream not in names:
                names[stream] = tuple(n for n in json.loads(data) if n in SIGNALS)
            first, _, count = spans.get(stream, (time_ns, 0, 0))
            spans[stream] = first, time_ns, count + 1
    rates = {s: max(1.0, round((n - 1) * 1e9 / (b - a))) if b > a else 1.0 for s, (a, b, n) in spans.items()}
    streams = tuple(
        Stream(s, signals, rates[s], max(0.2, 10 / rates[s]), s.partition(".")[0])
        for s, signals in names.items()
        if signals
    )
    about = About(aircraft, streams, notes={"aircraft": "named when it was recovered"}, arithmetic={})
    return LogInfo(about, "unknown", "", 0, 0, 0)


def _rows(path: Path, given: LogInfo | None = None) -> Iterator[Rows]:
    for reader in readers(path, given):
        yield from read_part(reader)


def _digest(path: Path, info: LogInfo, given: LogInfo | None = None) -> bytes:
    """Of all rows as they are encoded, so that NaN counts as equal to NaN."""
    writer, digest = RowWriter(info.streams, info.about.further.own), hashlib.blake2b()
    for row in _rows(path, given):
        topic, data = writer.message(row)
        digest.update(f"{topic.name} {row.t_ns} {len(data)}\n".encode())
        digest.update(data)
    return digest.digest()

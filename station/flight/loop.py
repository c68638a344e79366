"""The 50 Hz loop: one function for live, replay and emulation.

Order of rows in a recording, which replay relies on: rows drained by tick k, Tick k, the aligner's events and health,
Frame k, then the estimates made from it and where instruments disagree (events DISAGREE and AGREE; ESTIMATOR, should an
estimator fail). Every stage is logged before the next one runs. Frames are logged as measured; where the profile knows
of instrument errors, estimators get them undone, and where one of those is a delay, estimates are of an earlier frame.

A flight records before what is compiled is ready. Events among its first rows say what is PREPARING: the FRAMES, which
are empty until then, or the ESTIMATORS. A READY event says at which tick each joins, live and in replay alike.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import msgspec

from station.clock import Clock, utc_words
from station.conventions import SIGNAL_INDEX, TICK_NS
from station.flight.alignment import Aligner
from station.flight.bus import Bus
from station.rows import (
    AlphaEstimate,
    Code,
    Event,
    Frame,
    MethodEstimate,
    RawBlock,
    Rows,
    Sample,
    Tick,
    TimeSync,
)

FRAMES: Final = "frames"
ESTIMATORS: Final = "estimators"
"""Sources of the events PREPARING and READY."""
ASLEEP_NS: Final = 100_000_000
"""Both clocks are read one after the other: a tick's time apart on a busy machine, and no suspend."""
MADE_UP: Final = 25
"""Ticks that may be made up for while the estimators are prepared."""
WATCHED: Final = frozenset(
    (Code.DISAGREE, Code.AGREE, Code.CHANGED, Code.UNCHANGED, Code.UNWATCHED, Code.WATCHED, Code.ESTIMATOR)
)
"""Events that are made from frames, and not from what was drained."""
_VANE: Final = SIGNAL_INDEX["alpha_vane"]


class Beat(NamedTuple):
    """One tick and the rows drained for it; `recorded` are the estimates that a recording holds for it."""

    tick: Tick
    rows: Sequence[Rows]
    recorded: Sequence[Rows] = ()


class Estimating(Protocol):
    """What the loop asks of an estimator. `step` never raises."""

    def step(self, frame: Frame) -> tuple[AlphaEstimate, tuple[MethodEstimate, ...]]: ...

    def start_point(self) -> None:
        """Estimate afresh from the next frame on: a test point begins."""
        ...


class Correcting(Protocol):
    """What the loop asks of what undoes instrument errors. `step` never raises."""

    def step(self, frame: Frame) -> tuple[Frame, Frame] | None:
        """A frame as measured and as corrected, this one or an earlier; None while late instruments are waited for."""
        ...


class Watching(Protocol):
    """What the loop asks of who compares instruments and model in flight. Neither raises."""

    def step(self, frame: Frame, alpha: AlphaEstimate) -> Sequence[Event]: ...

    def flagged(self, methods: Sequence[MethodEstimate]) -> Sequence[MethodEstimate]:
        """Estimates, of which those that rest on an instrument that disagrees are none."""
        ...


class Recording(Protocol):
    def append(self, rows: Iterable[Rows]) -> None: ...

    def flush(self) -> None: ...


class Monitoring(Protocol):
    """What the loop asks of who holds the aircraft against its baseline. `step` never raises."""

    def step(self, frame: Frame, alpha: AlphaEstimate, methods: Sequence[MethodEstimate]) -> Sequence[Event]: ...


class Reserve(Protocol):
    """What the loop asks of a further vane. Neither raises."""

    def seen(self, frame: Frame) -> Frame: ...

    def step(self, frame: Frame, alpha: AlphaEstimate) -> Sequence[Event]: ...


@dataclass(frozen=True, slots=True)
class Chain:
    """What is made of a frame, in this order: a vane that is missing replaced, instrument errors undone, estimates,
    warnings. See chain.py."""

    estimator: Estimating
    watch: Watching | None = None
    correct: Correcting | None = None
    monitor: Monitoring | None = None
    vanes: Sequence[Reserve] = ()

    def step(self, frame: Frame) -> tuple[list[Rows], str]:
        """The rows made, and what went wrong: nothing here is to raise, but if it does, the recording goes on."""
        made: list[Rows] = []
        try:
            whole = frame
            for vane in self.vanes:
                whole = vane.seen(whole)
            pair = (whole, whole) if self.correct is None else self.correct.step(whole)
            if pair is None:
                return made, ""
            measured, seen = pair
            alpha, methods = self.estimator.step(seen)
            if self.correct is not None:
                alpha = _with_vane(alpha, measured.values[_VANE])
            made.append(alpha)
            warnings: Sequence[Event] = ()
            if self.watch is not None:
                warnings = self.watch.step(seen, alpha)
                methods = tuple(self.watch.flagged(methods))
            made += (*methods, *warnings)
            for vane in self.vanes:
                made += vane.step(frame, alpha)
            if self.monitor is not None:
                made += self.monitor.step(seen, alpha, methods)
        except Exception as error:
            why = f"{type(error).__name__}: {error}"
            unknown = (math.nan,) * 12
            if not made:
                invalid = (False, f"estimator failed: {why}")
                made.append(AlphaEstimate(frame.t_ns, *unknown, "unknown", *unknown[:3], *invalid))
            return made, why
        return made, ""


def run(
    source: Iterable[Beat],
    aligner: Aligner,
    chain: Callable[[], Chain],
    log: Recording | None = None,
    show: Callable[[Sequence[Rows]], None] | None = None,
    done: Callable[[Beat, Sequence[Rows]], None] | None = None,
) -> None:
    """Align, log, correct, estimate, log and show each beat of `source` until it ends.

    `chain` gives the estimators, asked once, when they join: at the first beat, unless that says that they are being
    prepared. `done` is handed each beat, and the frame and estimates made of it, when all else is through.
    """
    fault = ""
    waiting: set[str] = set()
    joined: Chain | None = None
    for beat in source:
        tick = beat.tick
        if log is not None:
            log.append(beat.rows)
            log.append((tick,))
        for row in beat.rows:
            if type(row) is RawBlock:  # for the log alone
                continue
            if isinstance(row, Event):
                if row.code is Code.PREPARING:
                    waiting.add(row.source)
                    if row.source == FRAMES:
                        aligner.hold()
                elif row.code is Code.READY:
                    waiting.discard(row.source)
                    if row.source == FRAMES:
                        aligner.begin()
                elif row.code is Code.POINT_START and joined is not None:
                    joined.estimator.start_point()
            aligner.accept(row)
        frame, events, health = aligner.frame(tick.k, tick.t_ns, tick.frame_t_ns)
        aligned: list[Rows] = [*events]
        if health is not None:
            aligned.append(health)
        aligned.append(frame)
        if log is not None:
            log.append(aligned)
        estimates: list[Rows] = []
        if not waiting:
            joined = joined or chain()
            estimates, why = joined.step(frame)
            if why and why != fault:
                estimates.append(Event(frame.t_ns, "estimator", Code.ESTIMATOR, 1, why))
            fault = why
        if log is not None:
            log.append(estimates)
            log.flush()
        if show is not None:
            show([*beat.rows, tick, *aligned, *estimates])
        if done is not None:
            done(beat, [frame, *estimates])


def _with_vane(alpha: AlphaEstimate, vane: float) -> AlphaEstimate:
    """An angle of attack of a corrected vane, told from the one measured."""
    if not math.isfinite(alpha.vane - vane):
        return alpha
    return msgspec.structs.replace(alpha, vane=vane, instrument=alpha.vane - vane)


def beats(
    bus: Bus,
    clock: Clock,
    lag_s: float,
    stop: threading.Event,
    duration_s: float | None,
    preparing: Callable[[], bool] = lambda: False,
    asleep_ns: Callable[[], int] = lambda: 0,
) -> Iterator[Beat]:
    """Ticks on an absolute schedule until `stop` or `duration_s`.

    A tick that comes a whole period late is given up: an OVERRUN event, and on to the next slot, never a burst. While
    the estimators are `preparing`, which takes the interpreter away for moments, ticks cost little and are made up for.
    While the machine was suspended, `asleep_ns` in all, station time stood still: an event says for how long, and what
    UTC is now.
    """
    slept_ns = asleep_ns()
    lag_ns = round(lag_s * 1e9)
    start_ns = clock.now_ns() + TICK_NS
    last = None if duration_s is None else round(duration_s * 1e9) // TICK_NS
    k = 0
    while not stop.is_set() and (last is None or k < last):
        due_ns = start_ns + k * TICK_NS
        clock.sleep_until_ns(due_ns)
        missed = (clock.now_ns() - due_ns) // TICK_NS
        if missed > (MADE_UP if preparing() else 0):
            bus.put(Event(clock.now_ns(), "loop", Code.OVERRUN, missed, "the machine was busy; slots skipped"))
            k += missed
            due_ns += missed * TICK_NS
        if (now_asleep_ns := asleep_ns()) - slept_ns > ASLEEP_NS:
            words = f"the machine slept for {(now_asleep_ns - slept_ns) * 1e-9:.1f} s of which nothing is recorded"
            bus.put(Event(clock.now_ns(), "loop", Code.SUSPEND, 1, f"{words}; it is {utc_words()}"))
            slept_ns = now_asleep_ns
        yield Beat(Tick(due_ns, k, due_ns - lag_ns), bus.drain())
        k += 1


def recorded_beats(rows: Iterable[Rows]) -> Iterator[Beat]:
    """The beats of a recording, in file order. Rows after the last tick (a crash) are left out."""
    drained: list[Rows] = []
    estimates: list[Rows] = []
    tick: Tick | None = None
    aligning = False
    pending: list[Rows] = []
    for row in rows:
        if isinstance(row, Tick):
            if tick is not None:
                yield Beat(tick, pending, estimates)
            tick, pending, drained, estimates = row, drained, [], []
            aligning = True
        elif isinstance(row, Frame):
            estimates.append(row)
            aligning = False
        elif isinstance(row, (AlphaEstimate, MethodEstimate)) or (isinstance(row, Event) and _is_made(row)):
            estimates.append(row)
        elif isinstance(row, (Sample, TimeSync, Event, RawBlock)) and not aligning:
            drained.append(row)
    if tick is not None:
        yield Beat(tick, pending, estimates)


def _is_made(event: Event) -> bool:
    """Whether an event was made from a frame, and not drained."""
    return event.code in WATCHED and event.source != ESTIMATORS


def paced(source: Iterable[Beat], clock: Clock, speed: float) -> Iterator[Beat]:
    """Beats at `speed` times real time."""
    first_ns: int | None = None
    start_ns = clock.now_ns()
    for beat in source:
        if first_ns is None:
            first_ns = beat.tick.t_ns
        clock.sleep_until_ns(start_ns + round((beat.tick.t_ns - first_ns) / speed))
        yield beat

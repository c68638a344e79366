"""A card's steps, flown one by one: condition, countdown, input, verdict; the crew says what comes next.

`update` runs in the 50 Hz loop, `press` in the screen's thread; what is shown is replaced whole, never edited.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, LATERAL, SIGNAL_INDEX, TICK_HZ, from_si
from station.flight.board import Board
from station.flight.limits import LimitWatch
from station.flight.point_marks import Points
from station.flight.verdict import Option, Verdict, judge, known
from station.model.airframe_error import relative_errors
from station.profile import AIR, Aircraft, Card, Order, Step
from station.rows import AlphaEstimate, Code, Event, Frame, Row
from station.simulation.input_table import InputTable, input_table

Array = NDArray[np.float64]

COUNTDOWN_S: Final = 5.0
"""Time to get ready in, and for an emulated pilot's order to arrive."""
SETTLE_S: Final = 3.0
"""After the input: the response dies down, and the estimators have seen it."""
STEADY_S: Final = 2.0
"""Without keys: in the condition for so long before the countdown."""
SHOWN_S: Final = 4.0
"""Without keys: a verdict stands so long."""
LEAST_MOTION: Final = 0.5
"""Of the drawn input's rms, that must be flown."""
MOST_LOST: Final = 0.1
"""Of a steady step's time, that may be flown out of tolerance: the errors of what is told by the rest are 5 % larger,
which is not worth another run."""


class Phase(StrEnum):
    READY = "ready"
    COUNTDOWN = "countdown"
    FLYING = "flying"
    SETTLING = "settling"
    VERDICT = "verdict"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Check:
    """One thing of a step's condition."""

    words: str
    good: bool
    name: str = ""
    """Of what is to be held; "" of what is not the crew's to hold."""


@dataclass(frozen=True, slots=True)
class Shown:
    """What there is to see of the guide, at one time."""

    phase: Phase
    number: int
    """Of the step, from 1."""
    run: int
    """How often the step has been flown; the one under way counts."""
    since_s: float = 0.0
    """Since the input begins; negative in the countdown."""
    checks: tuple[Check, ...] = ()
    verdict: Verdict | None = None
    results: tuple[tuple[str, str], ...] = ()
    """Steps that are over: name, and how they ended."""


class Guide:
    """Leads through the card's steps. `ask` has an emulated aircraft fly inputs, `start` in station time (s)."""

    def __init__(
        self,
        card: Card,
        aircraft: Aircraft,
        board: Board,
        points: Points,
        put: Callable[[Event], None],
        ask: Callable[[Sequence[Order]], None] = lambda _: None,
        options: Sequence[Mapping[str, Option]] = (),
        *,
        auto: bool = False,
    ) -> None:
        """`options`: of each step, a better input by derivative; `auto`: nobody presses keys."""
        self.steps = card.steps
        self.tables: tuple[InputTable, ...] = tuple(table_of(s) for s in card.steps)
        self.shown = Shown(Phase.READY if card.steps else Phase.DONE, 1, 0)
        self.flown: dict[str, Array] = {}
        """What each surface has done about its trim, by the ticks of the step's table; NaN to come."""
        self._watch = LimitWatch(card.limits, board.limits)
        self._aircraft, self._board, self._points, self._put, self._ask = aircraft, board, points, put, ask
        self._options, self._auto = tuple(options), auto
        self._alpha: AlphaEstimate | None = None
        self._pressed = ""
        self._start_ns = self._steady_ns = self._told_ns = 0
        self._goes_places, self._led = card.goes_places, 0
        self._trim: dict[str, float] = {}
        self._faults: list[str] = []
        self._worst_air = 0
        self._heard: set[str] = set()
        """Signals of a condition that have been there in this flight."""
        self._strayed: Counter[str] = Counter()
        """Ticks of a steady step out of tolerance, by what was, and of all together by ""."""
        self._mass_recorded = self._has_point = False
        self._warm_up_ns, self._settled_ns = round(card.warm_up * 1e9), 0

    @property
    def step(self) -> Step:
        """The one under way, or the last."""
        return self.steps[min(self.shown.number, len(self.steps)) - 1]

    @property
    def table(self) -> InputTable:
        """What it draws."""
        return self.tables[min(self.shown.number, len(self.steps)) - 1]

    @property
    def is_over(self) -> bool:
        """Whether every step has been left, and the end been told."""
        return self.shown.phase is Phase.DONE and bool(self.steps) and self.shown.since_s > SHOWN_S

    def press(self, key: str) -> None:
        """n next, r repeat, s skip, a abort; heeded at the next tick."""
        self._pressed = key

    def update(self, rows: Iterable[Row]) -> None:
        """Digest the rows of a tick."""
        for row in rows:
            if isinstance(row, AlphaEstimate):
                self._alpha = row
                self._settled_ns = self._settled_ns or row.t_ns + self._warm_up_ns
            elif isinstance(row, Frame):
                for event in self._watch.step(row, self._alpha):
                    self._put(event)
                    if event.code is Code.LIMIT and self.shown.phase in (Phase.FLYING, Phase.SETTLING):
                        self._faults.append(f"{event.source} {event.detail}")
                if self.steps:
                    self._advance(row)

    def _advance(self, frame: Frame) -> None:
        key, self._pressed = self._pressed, ""
        now, shown = frame.t_ns, self.shown
        self._mass_recorded = math.isfinite(frame.values[SIGNAL_INDEX["mass"]])
        since_s = (now - self._start_ns) * 1e-9
        checks = tuple(self._checks(frame))
        if any(not c.good for c in checks):
            self._steady_ns = now
        self.shown = shown = replace(shown, checks=checks, since_s=since_s)
        match shown.phase:
            case Phase.READY:
                self._lead(now)
                if key == "n" or (self._auto and now - self._steady_ns > STEADY_S * 1e9):
                    self._count_down(now)
            case Phase.COUNTDOWN:
                self._await_the_input(frame, since_s)
            case Phase.FLYING | Phase.SETTLING:
                self._follow(frame, since_s)
            case Phase.VERDICT:
                self._go_on(key, now)
        self._obey(key)

    def _lead(self, now: int) -> None:
        """Have an emulated aircraft fly to where the step is flown."""
        if self._goes_places and self._settled_ns and now >= self._settled_ns and self._led != self.shown.number:
            self._led = self.shown.number
            leg = self.step.leg(now * 1e-9)
            self._ask([leg] if leg is not None else [])

    def _await_the_input(self, frame: Frame, since_s: float) -> None:
        if since_s < 0:
            self._trim = {n: _smoothed(self._trim.get(n), _signal(frame, n)) for n in self.table.surfaces}
        else:
            self._faults += [f"{c.words} when it began" for c in self.shown.checks if not c.good]
            self.shown = replace(self.shown, phase=Phase.FLYING)
            self._follow(frame, since_s)

    def _follow(self, frame: Frame, since_s: float) -> None:
        self._take(frame, round(since_s * TICK_HZ))
        ended = since_s - float(self.table.t_s[-1])
        if self.step.steady is not None and ended <= 0:
            strayed = [c.name for c in self.shown.checks if c.name and not c.good]
            self._strayed.update([*strayed, ""] if strayed else [])
        if ended > SETTLE_S:
            self._judge(frame.t_ns)
        elif ended > 0:
            self.shown = replace(self.shown, phase=Phase.SETTLING)

    def _go_on(self, key: str, now: int) -> None:
        kind = "" if self.shown.verdict is None else self.shown.verdict.kind
        if self._auto and now - self._told_ns > SHOWN_S * 1e9:
            key = "r" if kind == "repeat" else "n"
        if key == "n":
            self._leave(kind)
        elif key == "r":
            self._count_down(now)

    def _obey(self, key: str) -> None:
        """Keys that do the same whenever they are pressed."""
        if key == "s" and self.shown.phase is not Phase.DONE:
            self._ask(())
            self._leave("skipped")
        elif key == "a" and self.shown.phase in (Phase.COUNTDOWN, Phase.FLYING, Phase.SETTLING):
            self._ask(())
            self._say(Code.STEP, f"{self.step.name}: run {self.shown.run} aborted")
            self.shown = replace(self.shown, phase=Phase.READY, run=self.shown.run - 1)

    def _count_down(self, now: int) -> None:
        shown, step = self.shown, self.step
        if not self._has_point:  # an aborted run's goes on
            more = f"; {step.condition.configuration}" if step.condition.configuration else ""
            self._points.begin(f"{step.name}{more}")
            self._has_point = True
        self._start_ns = now + round(COUNTDOWN_S * 1e9)
        begins, first = self._start_ns * 1e-9, min((m.start for m in step.inputs), default=0.0)
        self._ask([m.model_copy(update={"start": begins + m.start - first}) for m in step.inputs])
        self.flown = {name: np.full(len(x), math.nan) for name, x in self.table.surfaces.items()}
        self._trim, self._faults, self._worst_air = {}, [], 0
        self._strayed.clear()
        self._say(Code.STEP, f"{step.name}: run {shown.run + 1} begins in {COUNTDOWN_S:g} s")
        self.shown = replace(shown, phase=Phase.COUNTDOWN, run=shown.run + 1, since_s=-COUNTDOWN_S, verdict=None)

    def _take(self, frame: Frame, tick: int) -> None:
        """What is flown, and in which air."""
        if self._alpha is not None and self._alpha.turbulence in AIR:
            self._worst_air = max(self._worst_air, AIR.index(self._alpha.turbulence))
        if 0 <= tick < len(self.table.t_s):
            for name, values in self.flown.items():
                values[tick] = _signal(frame, name) - self._trim.get(name, math.nan)

    def _judge(self, now: int) -> None:
        step, shown, board = self.step, self.shown, self._board
        wanted = step.condition.air
        if wanted is not None and self._worst_air > AIR.index(wanted):
            self._faults.append(f"the air was {AIR[self._worst_air]}, {wanted} is wanted")
        self._faults += [words for words in map(self._unlike, self.flown) if words]
        if step.steady is not None and self._strayed[""] > MOST_LOST * step.steady * TICK_HZ:
            what = " and ".join(n for n, _ in self._strayed.most_common() if n)
            self._faults.append(f"{what} out of tolerance for {self._strayed[''] / TICK_HZ:.0f} of {step.steady:g} s")
        names = tuple(step.accept)
        method = {n: board.lateral_method if n in LATERAL else board.recommended for n in names}
        found = {n: board.parameter(method[n], n) for n in names}
        shares = relative_errors(self._aircraft, names)[int(self._mass_recorded)].tolist() if names else []
        floors = {n: 2 * share for n, share in zip(names, shares, strict=True)}
        options = self._options[shown.number - 1] if self._options else {}
        verdict = judge(step, shown.run, known(step, found, floors), self._faults, options)
        self._told_ns = now
        self._say(Code.VERDICT, f"{step.name}, run {shown.run}: {verdict.words}")
        self.shown = replace(shown, phase=Phase.VERDICT, verdict=verdict)

    def _unlike(self, surface: str) -> str:
        """Where a surface was not moved as drawn."""
        drawn, flown = self.table.surfaces[surface], self.flown[surface]
        seen = np.isfinite(flown)
        if seen.mean() < LEAST_MOTION:
            return f"the {surface} was not recorded"
        share = float(np.std(flown[seen])) / max(float(np.std(drawn)), 1e-9)
        return f"the {surface} moved {share:.0%} of what is drawn" if share < LEAST_MOTION else ""

    def _leave(self, how: str) -> None:
        self._points.end()
        self._has_point = False
        shown = self.shown
        results = (*shown.results, (self.step.name, how))
        self._say(Code.STEP, f"{self.step.name}: {how}")
        last = shown.number == len(self.steps)
        if not last:
            self.flown = {}
        self.shown = Shown(Phase.DONE if last else Phase.READY, shown.number + (not last), 0, results=results)
        if last:
            self._start_ns = self._board.clock.now_ns()
            enough = sum(how == "enough" for _, how in results)
            self._say(Code.STEP, f"the card is flown: {enough} of {len(results)} steps enough")

    def _checks(self, frame: Frame) -> Iterable[Check]:
        """The step's condition as it is now."""
        c = self.step.condition
        if not self._settled_ns:
            yield Check("estimators not ready", good=False)
        elif frame.t_ns < self._settled_ns:
            yield Check(f"estimators settle for {(self._settled_ns - frame.t_ns) * 1e-9:.0f} s", good=False)
        before = self.shown.phase in (Phase.READY, Phase.COUNTDOWN, Phase.VERDICT)
        if c.speed is not None:
            yield self._check(frame, "speed", "airspeed", c.speed, c.speed_tolerance, "kt")
        if c.altitude is not None:
            yield self._check(frame, "altitude", "altitude", c.altitude, c.altitude_tolerance, "ft")
        if c.heading is not None:
            yield self._check(frame, "heading", "psi", c.heading, c.heading_tolerance, "deg")
        if before or self.step.steady is not None:
            yield self._check(frame, "bank", "phi", c.bank, c.bank_tolerance, "deg")
        if before:
            rate = _signal(frame, "q") - (_turning(frame) if c.bank else 0.0)
            beyond = " beyond the turn's" if c.bank else ""
            words = f"pitch rate {from_si(rate, 'deg/s'):+.1f} deg/s{beyond}"
            good = self._never_heard("q", rate) or abs(rate) <= c.pitch_rate_tolerance
            yield Check(words if math.isfinite(rate) else "pitch rate unknown", good)
        if c.air is not None:
            air = self._alpha.turbulence if self._alpha is not None else "unknown"
            yield Check(f"air {air} (at most {c.air})", air not in AIR or AIR.index(air) <= AIR.index(c.air))

    def _check(self, frame: Frame, name: str, signal: str, wanted: float, tolerance: float, unit: str) -> Check:
        value = _signal(frame, signal)
        if signal == "psi":
            value = wanted + math.remainder(value - wanted, 2 * math.pi)
        shown = from_si(value, unit)
        digits = 0 if unit in ("ft", "kt") else 1
        words = f"{name} {shown:.{digits}f} {unit} ({from_si(wanted, unit):.0f}±{from_si(tolerance, unit):.0f})"
        good = self._never_heard(signal, value) or abs(value - wanted) <= tolerance
        return Check(words if math.isfinite(value) else f"{name} unknown", good, name)

    def _never_heard(self, signal: str, value: float) -> bool:
        """What the rig does not tell is not held against the crew; what falls silent for a while is."""
        if math.isfinite(value):
            self._heard.add(signal)
        return signal not in self._heard

    def _say(self, code: Code, words: str) -> None:
        self._put(Event(self._board.clock.now_ns(), "card", code, 1, words))

    def snapshot(self) -> dict[str, Any]:
        """For JSON lines."""
        shown = self.shown
        verdict = shown.verdict
        return {
            "name": self.step.name,
            "number": shown.number,
            "of": len(self.steps),
            "phase": shown.phase.value,
            "run": shown.run,
            "since_s": round(shown.since_s, 3),
            "out_of_tolerance": [c.words for c in shown.checks if not c.good],
            "verdict": None if verdict is None else {"kind": verdict.kind, "words": verdict.words},
            "results": [{"name": name, "ended": how} for name, how in shown.results],
        }


def table_of(step: Step) -> InputTable:
    """What the step draws; nothing moves in a steady one, for as long as it lasts."""
    if step.steady is None:
        return input_table(step.inputs, TICK_HZ)
    return InputTable(np.arange(math.ceil(step.steady * TICK_HZ) + 1) / TICK_HZ, {}, ())


def _signal(frame: Frame, name: str) -> float:
    return frame.values[SIGNAL_INDEX[name]]


def _turning(frame: Frame) -> float:
    """Pitch rate of a level turn in this bank at this airspeed, rad/s."""
    bank, speed = _signal(frame, "phi"), _signal(frame, "airspeed")
    return G0 * math.tan(bank) * math.sin(bank) / speed if speed > 0 else math.nan


def _smoothed(old: float | None, new: float) -> float:
    """Over half a second."""
    if old is None or not math.isfinite(old):
        return new
    return old + (new - old) * 2.0 / TICK_HZ if math.isfinite(new) else old

"""Warnings in flight: which instruments disagree, by how much, and how surely; and where the profile's model does.

A disagreement is told when it is beyond what a test flight can bear by four standard deviations, twice in a row, and
taken back when it is gone. The model is judged only while the instruments agree. While a lateral instrument disagrees,
lateral derivatives are none: their vane and gyros are in every regressor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import msgspec

from station.conventions import G0, LATERAL, TICK_HZ, from_si, to_si
from station.model import consistency as c
from station.model import lateral_consistency as lc
from station.model.consistency import Means, Window
from station.model.gain_and_delay import RECENT, STEP_S
from station.model.lateral_consistency import LateralWindow
from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.turbulence import BOUND, TURBULENCE_LENGTH, gust_sigma
from station.profile import Aircraft
from station.rows import AlphaEstimate, Code, Event, Frame, MethodEstimate, ParamEstimate, Status

SURE: Final = 4.0
"""Standard deviations beyond the tolerance."""
TWICE: Final = 2
FAR: Final = 2.5
"""A gain beyond it, or below its reciprocal, is no calibration."""
CHANGED: Final = 0.25
"""Share by which a value must move to be told again."""


class Value(NamedTuple):
    """A disagreement as judged: SI and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True, slots=True)
class Check:
    """One way in which two things can disagree."""

    id: str
    """Of the catalogue of effects where it is there."""
    unit: str
    tolerance: float
    """In `unit`: below it nothing is told."""
    more: str
    less: str
    """Sentences for a positive and a negative value; {size} is its size in `unit`, {sd2} two standard deviations."""

    def sentence(self, v: Value) -> str:
        """With value and 95 % bound."""
        size, sd2 = from_si(abs(v.value), self.unit), from_si(2 * v.sd, self.unit)
        places = min(max(0, -math.floor(math.log10(max(sd2, 0.1 * self.tolerance)))), 3)
        sd2 = max(sd2, 10.0**-places)
        told = (self.more if v.value > 0 else self.less).format(size=f"{size:.{places}f}", sd2=f"{sd2:.{places}f}")
        gain = 1 + v.value
        if self.unit != "%" or 1 / FAR < gain < FAR:
            return told
        return f"{told}: is a {'sign' if gain < -1 / FAR else 'unit'} wrong?"


def _both(id_: str, unit: str, tolerance: float, words: str, more: str, less: str) -> Check:
    return Check(id_, unit, tolerance, words.replace("{way}", more), words.replace("{way}", less))


CHECKS: Final = {
    check.id: check
    for check in (
        _both("alpha_vane.bias", "deg", 0.5, "α vane {size} deg {way} against inertial α (±{sd2})", "high", "low"),
        _both("alpha_vane.scale", "%", 8, "α vane shows {size} % {way} than inertial α moves (±{sd2})", "more", "less"),
        _both("alpha_vane.delay", "ms", 10, "α vane {size} ms {way} against inertial α (±{sd2})", "late", "early"),
        _both("q.bias", "deg/s", 0.3, "q {size} deg/s {way} against the change of theta (±{sd2})", "high", "low"),
        _both("q.scale", "%", 4, "q shows {size} % {way} than theta turns (±{sd2})", "more", "less"),
        _both("q.delay", "ms", 10, "q {size} ms {way} against theta (±{sd2})", "late", "early"),
        _both("accelerometer.bias", "g", 0.02, "az {size} g {way} against the change of v_down (±{sd2})", "high",
              "low"),
        _both("accelerometer.scale", "%", 5, "az shows {size} % {way} than v_down changes (±{sd2})", "more", "less"),
        _both("velocity.delay", "ms", 20, "v_down {size} ms {way} against the accelerations (±{sd2})", "late", "early"),
        _both("ax.bias", "g", 0.02, "ax {size} g {way} against the change of ground speed (±{sd2}): ax or theta",
              "high", "low"),
        _both("theta.bias", "deg", 0.5, "theta {size} deg {way} against vane and accelerations (±{sd2})",
              "high", "low"),
        _both("airspeed.bias", "m/s", 2, "airspeed {size} m/s {way} against dynamic pressure (±{sd2})", "high", "low"),
        _both("p.bias", "deg/s", 0.3, "p {size} deg/s {way} against the change of phi (±{sd2})", "high", "low"),
        _both("p.scale", "%", 4, "p shows {size} % {way} than phi turns (±{sd2})", "more", "less"),
        _both("p.delay", "ms", 10, "p {size} ms {way} against phi (±{sd2})", "late", "early"),
        _both("r.bias", "deg/s", 0.3, "r {size} deg/s {way} against the change of psi (±{sd2})", "high", "low"),
        _both("r.scale", "%", 4, "r shows {size} % {way} than psi turns (±{sd2})", "more", "less"),
        _both("r.delay", "ms", 10, "r {size} ms {way} against psi (±{sd2})", "late", "early"),
        _both("beta_vane.scale", "%", 8, "β vane shows {size} % {way} than inertial β moves (±{sd2})", "more", "less"),
        _both("beta_vane.delay", "ms", 20, "β vane {size} ms {way} against inertial β (±{sd2})", "late", "early"),
        _both("model.alpha", "deg", 0.5, "α {size} deg {way} by the profile's lift and moment (±{sd2})", "high", "low"),
        _both("model.lift", "%", 20, "lift {size} % {way} than the profile's model says (±{sd2})", "more", "less"),
        _both("model.moment", "%", 30, "pitching moment {size} % {way} than the profile's model says (±{sd2})", "more",
              "less"),
        _both("model.lift_0", "1", 0.1, "lift {size} in CL {way} than the profile's model says (±{sd2})", "more",
              "less"),
        _both("model.moment_0", "1", 0.03,
              "trim {size} in Cm nose {way} by the model (±{sd2}): elevator, CG or Cm_0",
              "up", "down"),
    )
}  # fmt: skip


class _Pair(NamedTuple):
    """Two channels and their instrument, what gain and delay are called, and the level that must hold still."""

    y: int
    x: int
    z: int
    gain: str
    delay: str
    level: str


_PAIRS: Final = (
    _Pair(c.VANE, c.FLOW, c.FLOW_Z, "alpha_vane.scale", "alpha_vane.delay", "alpha_vane.bias"),
    _Pair(c.THETA, c.TURNED, c.TURNED, "q.scale", "q.delay", "q.bias"),
    _Pair(c.SINK, c.FALLEN, c.FALLEN, "accelerometer.scale", "velocity.delay", "accelerometer.bias"),
    _Pair(c.LIFT, c.LIFT_MODEL, c.LIFT_Z, "model.lift", "", "model.lift_0"),
    _Pair(c.MOMENT, c.MOMENT_MODEL, c.MOMENT_Z, "model.moment", "", "model.moment_0"),
)
_LATERAL_PAIRS: Final = (
    _Pair(lc.ROLL, lc.ROLLED, lc.ROLLED, "p.scale", "p.delay", "p.bias"),
    _Pair(lc.HEADING, lc.YAWED, lc.YAWED, "r.scale", "r.delay", "r.bias"),
    _Pair(lc.VANE, lc.SLIP, lc.SLIP_Z, "beta_vane.scale", "beta_vane.delay", ""),
)
_OF_X: Final = frozenset(("q.scale", "accelerometer.scale", "p.scale", "r.scale"))
"""Gains that are told of x, against y."""
_EARLY: Final = frozenset(("q.delay", "p.delay", "r.delay"))
"""An angle behind its integral rate is a rate that is early."""
_RATES: Final = frozenset(("p.bias", "p.scale", "p.delay", "r.bias", "r.scale", "r.delay"))
_OF_LATERAL: Final = _RATES | {"beta_vane.scale", "beta_vane.delay"}
_INERTIAL: Final = frozenset(
    ("q.bias", "q.scale", "q.delay", "accelerometer.bias", "accelerometer.scale", "velocity.delay")
)
"""Where these stand, the inertial angle of attack is no measure of the vane."""
_LEVELS: Final = (
    ("alpha_vane.bias", c.VANE, c.FLOW, False),
    ("q.bias", c.TURNED, c.THETA, True),
    ("accelerometer.bias", c.FALLEN, c.SINK, True),
    ("ax.bias", c.PUSHED, c.GAINED, True),
    ("airspeed.bias", c.SPEED, c.PITOT, False),
    ("model.lift_0", c.LIFT, c.LIFT_MODEL, False),
    ("model.moment_0", c.MOMENT_MODEL, c.MOMENT, False),
)
_LATERAL_LEVELS: Final = (("p.bias", lc.ROLLED, lc.ROLL, True), ("r.bias", lc.YAWED, lc.HEADING, True))
_STEPS: Final = frozenset(name for name, _, _, moving in (*_LEVELS, *_LATERAL_LEVELS) if moving)
_GAIN_SD: Final = 0.3
_DELAY_SD: Final = 0.05
"""Less sure than that, a gain or delay is not looked at."""


@dataclass(slots=True)
class _Told:
    """What is known of one check: how often in a row it was beyond or within, and the value last told."""

    beyond: int = 0
    within: int = 0
    told: Value | None = None


class Disagreement:
    """Watches frames and angles of attack; `step` gives the warnings as events. Deterministic; never raises."""

    def __init__(
        self,
        aircraft: Aircraft,
        imu_position: tuple[float, float, float],
        noise: dict[str, float] | None = None,
        sideslip: Callable[[], float] = lambda: math.nan,
    ) -> None:
        """`imu_position`: m from the CG. `noise`: of the vane, rad, by signal's name. `sideslip`: the inertial one at
        the CG as of the frame stepped, rad; without it no vane of sideslip is judged."""
        self._window = Window(aircraft, imu_position, 1.0 / TICK_HZ)
        self._lateral = LateralWindow(aircraft, 1.0 / TICK_HZ)
        self._sideslip = sideslip
        self._noise = (noise or {}).get("alpha_vane", 0.0) or DEFAULT_NOISE["alpha_vane"]
        self._checks = {name: _Told() for name in CHECKS}
        self._ticks = 0
        self._copy = (aircraft, imu_position)

    def warm_up(self) -> None:
        """Compile the kernels: no tick of a flight has to."""
        twin = Window(*self._copy, 1.0 / TICK_HZ)
        nan = (math.nan,) * 64
        alpha = AlphaEstimate(0, *(0.0,) * 12, "calm", 0.0, 0.0, 0.0, True, "")
        twin.add(Frame(0, 0, nan, nan, (3,) * 64), alpha)
        twin.compare(c.VANE, c.FLOW, c.FLOW_Z)
        twin.level(c.VANE, c.FLOW, False, RECENT)
        LateralWindow(self._copy[0], 1.0 / TICK_HZ).add(Frame(0, 0, nan, nan, (3,) * 64), 0.0)

    def step(self, frame: Frame, alpha: AlphaEstimate) -> tuple[Event, ...]:
        """Take a tick's frame and angle of attack; once a second one pair is judged, and what it shows told."""
        self._window.add(frame, alpha)
        self._lateral.add(frame, self._sideslip())
        self._ticks += 1
        second, rest = divmod(self._ticks, TICK_HZ)
        if rest == 0:
            turn = second % (len(_PAIRS) + 1)
            judged = self._levels(alpha) if turn == len(_PAIRS) else self._pair(self._window, _PAIRS[turn])
        elif rest == TICK_HZ // 2:
            # Between the others: a tick compares one pair.
            turn = second % (len(_LATERAL_PAIRS) + 1)
            judged = self._rates() if turn == len(_LATERAL_PAIRS) else self._pair(self._lateral, _LATERAL_PAIRS[turn])
        else:
            return ()
        events = []
        for name, value in judged.items():
            event = self._tell(frame.t_ns, name, value)
            if event is not None:
                events.append(event)
        return tuple(events)

    def flagged(self, methods: Sequence[MethodEstimate]) -> Sequence[MethodEstimate]:
        """Estimates, of which the lateral ones are none while a lateral instrument disagrees."""
        told = [CHECKS[n].sentence(v) for n in CHECKS if n in _OF_LATERAL and (v := self._checks[n].told) is not None]
        if not told:
            return methods
        why = "; ".join(told)

        def judged(p: ParamEstimate) -> ParamEstimate:
            if p.name not in LATERAL or p.status is not Status.ESTIMATED:
                return p
            return ParamEstimate(p.name, p.value, p.sd, Status.INVALID, why)

        return [msgspec.structs.replace(m, parameters=tuple(judged(p) for p in m.parameters)) for m in methods]

    def _pair(self, window: Means, pair: _Pair) -> dict[str, Value | None]:
        names = [pair.gain, pair.delay] if pair.delay else [pair.gain]
        if self._is_blocked(pair.gain):
            return dict.fromkeys(names)
        gain, gain_sd, delay, delay_sd = window.compare(pair.y, pair.x, pair.z)
        # No step makes a gain so far out as a wrong unit or sign.
        if 1 / FAR < gain < FAR and self._has_stepped(window, pair):
            return dict.fromkeys(names)
        if pair.gain in _OF_X and gain > 0:
            gain, gain_sd = 1 / gain, gain_sd / gain**2
        sure = gain_sd < _GAIN_SD * max(1.0, abs(gain))
        made: dict[str, Value | None] = {pair.gain: Value(gain - 1, gain_sd) if sure else None}
        if pair.delay:
            stated = self._lateral.vane_lag if pair.delay == "beta_vane.delay" else 0.0
            late = -delay if pair.delay in _EARLY else delay - stated
            made[pair.delay] = Value(late, delay_sd) if delay_sd < _DELAY_SD else None
        return made

    @staticmethod
    def _has_stepped(window: Means, pair: _Pair) -> bool:
        """Whether the level between the two moved within what is kept: a step is no gain."""
        if pair.level not in _STEPS:
            return False
        _, y, x, moving = next(row for row in (*_LEVELS, *_LATERAL_LEVELS) if row[0] == pair.level)
        recent, _ = window.level(y, x, moving, RECENT)
        whole, _ = window.level(y, x, moving, c.KEEP)
        check = CHECKS[pair.level]
        return abs(recent - whole) > to_si(check.tolerance, check.unit)

    def _is_blocked(self, name: str) -> bool:
        """Whether something stands that `name` rests on."""
        if name.startswith("model"):
            rest = (n for n in self._checks if not n.startswith("model") and n not in _OF_LATERAL)
            return not self._window.has_model or self._stands(rest)
        if name.startswith("beta_vane"):
            return self._stands(_RATES | _INERTIAL)
        if name.startswith("q."):
            return self._stands(n for n in _RATES if n.startswith("r."))  # theta' has r sin(phi)
        return name.startswith("alpha_vane") and self._stands(_INERTIAL)

    def _stands(self, names: Iterable[str]) -> bool:
        """Whether one of these disagreements has been told or seen once."""
        return any(self._checks[n].told is not None or self._checks[n].beyond > 0 for n in names)

    def _rates(self) -> dict[str, Value | None]:
        return {row[0]: self._level(self._lateral, row, 0.0) for row in _LATERAL_LEVELS}

    def _level(self, window: Means, row: tuple[str, int, int, bool], gust: float) -> Value | None:
        """Over the last seconds or all that is kept, whichever says more; `gust`: see `_gust`."""
        name, y, x, moving = row
        best: Value | None = None
        for count in (RECENT, c.KEEP):
            mean, sd = window.level(y, x, moving, count)
            if name == "alpha_vane.bias":
                metres = max(self._window.speed, 1.0) * count * STEP_S
                sd = math.hypot(sd, gust * math.sqrt(TURBULENCE_LENGTH / metres))
            value = Value(mean, sd) if math.isfinite(mean + sd) else None
            if value is not None and (best is None or self._beyond(name, value) > self._beyond(name, best)):
                best = value
        return best

    def _levels(self, alpha: AlphaEstimate) -> dict[str, Value | None]:
        gust = self._gust(alpha)
        made = {row[0]: self._level(self._window, row, gust) for row in _LEVELS}
        self._name_theta(made)
        for name in made:
            if self._is_blocked(name):
                made[name] = None
        self._name_alpha(made)
        return made

    def _gust(self, alpha: AlphaEstimate) -> float:
        """Standard deviation of the gusts' incidence, rad; without turbulence known, endless."""
        speed = self._window.speed
        if not (math.isfinite(speed) and math.isfinite(alpha.turbulence_level)):
            return math.inf
        return BOUND * gust_sigma(alpha.turbulence_level, speed, self._noise, 1.0 / TICK_HZ) / max(speed, 1.0)

    def _name_theta(self, made: dict[str, Value | None]) -> None:
        """A vane and an ax that are off as a wrong attitude makes them both: name the attitude."""
        vane, ax = made["alpha_vane.bias"], made["ax.bias"]
        made["theta.bias"] = None
        if vane is None or ax is None or self._beyond("ax.bias", ax) <= 0 or self._beyond("alpha_vane.bias", vane) <= 0:
            return
        by_vane, by_ax = Value(-vane.value, vane.sd), Value(-ax.value / G0, ax.sd / G0)
        if abs(by_vane.value - by_ax.value) < to_si(0.3, "deg") + 3 * math.hypot(by_vane.sd, by_ax.sd):
            made["theta.bias"] = min(by_vane, by_ax, key=lambda v: v.sd)
            made["alpha_vane.bias"] = made["ax.bias"] = Value(0.0, 0.0)

    def _name_alpha(self, made: dict[str, Value | None]) -> None:
        """Lift and trim that are off as a wrong angle of attack makes them both: name that."""
        lift, moment = made["model.lift_0"], made["model.moment_0"]
        made["model.alpha"] = None
        if lift is None or moment is None or self._beyond("model.lift_0", lift) <= 0:
            return
        slope, stability = self._window.slopes
        by_lift, by_moment = Value(-lift.value / slope, lift.sd / slope), moment.value / stability
        if abs(by_lift.value - by_moment) < 0.25 * abs(by_lift.value) + 3 * abs(moment.sd / stability):
            made["model.alpha"] = by_lift
            made["model.lift_0"] = made["model.moment_0"] = Value(0.0, 0.0)

    def _beyond(self, name: str, v: Value) -> float:
        """How far beyond the tolerance a value surely is, in tolerances; below 0 within."""
        tolerance = to_si(CHECKS[name].tolerance, CHECKS[name].unit)
        return (abs(v.value) - SURE * v.sd) / tolerance - 1.0

    def _tell(self, t_ns: int, name: str, value: Value | None) -> Event | None:
        state = self._checks[name]
        if value is None:
            state.beyond = state.within = 0
            return None
        beyond = self._beyond(name, value) > 0
        tolerance = to_si(CHECKS[name].tolerance, CHECKS[name].unit)
        gone = abs(value.value) < tolerance
        state.beyond = state.beyond + 1 if beyond else 0
        state.within = state.within + 1 if gone else 0
        if state.told is not None and state.within >= TWICE:
            state.told = None
            return Event(t_ns, name, Code.AGREE, 1, "agrees again")
        if state.beyond >= TWICE:
            was = state.told
            if was is None or abs(value.value - was.value) > max(CHANGED * abs(was.value), 2 * value.sd):
                state.told = value
                return Event(t_ns, name, Code.DISAGREE, 1, CHECKS[name].sentence(value))
        return None

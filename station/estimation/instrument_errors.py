"""What the profile says that instruments do wrong, undone: the step between the alignment and whatever estimates.

An instrument shows, SI of its signal,

    shown(t) = gain * lagged(true + cubic true^3)(t - latency) + bias

and a surface follows its sensor with backlash. The inverse goes back through that: bias and gain, then the value as it
was shown `latency` later, a lag by the slope about that instant, the nonlinearity, the backlash. What is shown later is
waited for: all signals of a frame come out `ahead` frames late, and belong together. Between samples the cubic through
four neighbours; nothing is interpolated across a gap. The slope is that of a cubic fitted to nine points (Savitzky and
Golay 1964): 17 times a signal's noise per second of lag, and 0.2 % low at 2 Hz.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import ANGLES_THAT_WRAP, BRIDGED_S, MAX_AGE_S, SIGNAL_INDEX, SIGNALS, TICK_HZ, from_si
from station.estimation.bending import COLUMNS, Bending
from station.numerics.angles import wrap
from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.indicial import lagged
from station.numerics.lagrange import uneven_cubic
from station.numerics.named_state import Element, layout
from station.profile import Aircraft, Instrument
from station.rows import Frame, Quality

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

LATEST_S: Final = 0.5
"""A signal that comes later is not waited for: what a pilot is shown would be that old."""
LONGEST_LAG_S: Final = 1.0
"""The noise of one that lags more, undone, would drown it."""
DITHER: Final = 4.0
"""Noise standard deviations by which a backlash is widened and narrowed again, to keep noise from moving through it: of
the sensor as it is, for in flight its noise cannot be left out as a diagnosis does, which makes do with fewer."""

SLOPE: Final = np.array([86.0, -142.0, -193.0, -126.0, 0.0, 126.0, 193.0, 142.0, -86.0]) / 1188.0
"""Slope, per step, at the middle of nine points."""
SLOPE_STEP_S: Final = 0.02
_REACH: Final = SLOPE.size // 2
_SAME_S: Final = 1e-6
_WHOLE: Final = 1e-6
"""Steps: what is closer to a whole number is one."""
_FRESH, _HELD, _MISSING = int(Quality.FRESH), int(Quality.HELD), int(Quality.MISSING)


class Stated(NamedTuple):
    """Errors of one signal's instrument: see the profile's Instrument."""

    latency: float
    lag: float
    gain: float
    bias: float
    cubic: float
    backlash: float
    dither: float
    """By which the backlash is widened, and narrowed again."""
    wraps: bool
    max_age: float
    """s"""


class State:
    """Of one signal, NaN before the first output."""

    at: float
    """Time of the last output, s."""
    advanced: float
    advanced_input: float
    """Output and input of a lag that is put in again, where the instrument leads."""
    loose: float
    tight: float
    """Where the part stands with the backlash and the dither, and with the dither alone."""


class Kept(NamedTuple):
    """The newest samples of each signal: number i of signal j is at [j, i % length]."""

    times: Array
    values: Array
    """(m, length)"""
    seen: Whole
    """(m,): how many there have been."""


class Spans(NamedTuple):
    """s"""

    apart: float
    """Samples closer than this are one."""
    bridge: float
    """Longest gap that is bridged."""
    ahead: float
    """By how much what comes out stands behind what goes in."""


@njit(cache=True)
def straightened(shown: float, cubic: float) -> float:
    """What a sensor that shows x + cubic x^3 has met; beyond where that turns back, the turning point."""
    size = 2.0 / math.sqrt(3.0 * abs(cubic))
    inside = 3.0 * shown / size
    if cubic > 0.0:
        return float(size * math.sinh(math.asinh(inside) / 3.0))
    return float(size * math.sin(math.asin(min(max(inside, -1.0), 1.0)) / 3.0))


@njit(cache=True)
def dragged(at: float, drive: float, backlash: float) -> float:
    """Where a part that was `at` a place is when its drive has moved, with `backlash` in all between them."""
    return float(min(max(at, drive - 0.5 * backlash), drive + 0.5 * backlash))


@njit(cache=True, error_model="numpy")
def _take(stated: Element, kept: Kept, apart: float, t: float, seen: Array) -> None:
    """Keep what is new in a frame at `t`: `seen` (2, m) values and ages. A held value has been kept already."""
    length = kept.times.shape[1]
    for j in range(stated.shape[0]):
        e: Stated = stated[j]
        x, at = seen[0, j], t - seen[1, j]
        if not (math.isfinite(x) and math.isfinite(at)):
            continue
        x = (x - e.bias) / e.gain
        count = kept.seen[j]
        if count > 0:
            last = (count - 1) % length
            if at < kept.times[j, last] + apart:
                continue
            if e.wraps:
                x = kept.values[j, last] + wrap(x - kept.values[j, last])
        kept.times[j, count % length], kept.values[j, count % length] = at, x
        kept.seen[j] += 1


@njit(cache=True, error_model="numpy")
def _then(kept: Kept, j: int, bridge: float, t: float) -> tuple[float, float]:
    """Signal `j` at `t` and how old the value is: 0 where measured or between two that are; NaN before the first."""
    times, values, count = kept.times[j], kept.values[j], kept.seen[j]
    length = times.shape[0]
    oldest = max(0, count - length)
    i = count - 1
    while i >= oldest and times[i % length] > t + _SAME_S:
        i -= 1
    if i < oldest:
        return math.nan, math.nan
    tb, b = times[i % length], values[i % length]
    if t - tb <= _SAME_S:
        return b, 0.0
    if i + 1 == count or times[(i + 1) % length] - tb > bridge:
        return b, t - tb
    tc, c = times[(i + 1) % length], values[(i + 1) % length]
    if i - 1 >= oldest and i + 2 < count:
        ta, a = times[(i - 1) % length], values[(i - 1) % length]
        td, d = times[(i + 2) % length], values[(i + 2) % length]
        if tb - ta <= bridge and td - tc <= bridge:
            return uneven_cubic((ta, tb, tc, td), (a, b, c, d), t), 0.0
    return b + (c - b) * (t - tb) / (tc - tb), 0.0


@njit(cache=True, error_model="numpy")
def _slope(kept: Kept, j: int, bridge: float, at: float) -> float:
    """Of signal `j` about an instant, per s; NaN beside a gap."""
    slope = 0.0
    for k in range(-_REACH, _REACH + 1):
        beside, age = _then(kept, j, bridge, at + k * SLOPE_STEP_S)
        slope += SLOPE[k + _REACH] / SLOPE_STEP_S * beside
        if age != 0.0:
            slope = math.nan
    return slope


@njit(cache=True, error_model="numpy")
def _put_lag(s: State, lag: float, passed: float, bridge: float, x: float) -> float:
    """A value behind a first-order lag; `passed`: since the last one, s."""
    if not passed <= bridge:
        s.advanced = s.advanced_input = x
    elif passed > 0.0:
        s.advanced = lagged(s.advanced, s.advanced_input, x, passed / lag)
        s.advanced_input = x
    return s.advanced


@njit(cache=True, error_model="numpy")
def _widen(s: State, e: Stated, x: float) -> float:
    """The part's place behind its backlash."""
    if math.isnan(s.loose):
        s.loose = s.tight = x
    s.loose = dragged(s.loose, x, e.backlash + e.dither)
    s.tight = dragged(s.tight, x, e.dither)
    return x + (s.loose - s.tight)


@njit(cache=True, error_model="numpy")
def _undo(stated: Element, state: Element, kept: Kept, bridge: float, t: float, out: Array) -> None:
    """The signals as they were at `t`: `out` (3, m) values, ages, quality; edits their `state` (m,)."""
    for j in range(stated.shape[0]):
        e: Stated = stated[j]
        s: State = state[j]
        at = t + e.latency
        x, age = _then(kept, j, bridge, at)
        if not age <= e.max_age:
            out[0, j], out[1, j], out[2, j] = math.nan, math.nan, _MISSING
            continue
        if e.lag > 0.0:
            slope = _slope(kept, j, bridge, at)
            if math.isnan(slope):
                # Beside a gap: the value shown, and that it is not of this instant.
                age = max(age, SLOPE_STEP_S)
            else:
                x += e.lag * slope
        elif e.lag < 0.0:
            x = _put_lag(s, -e.lag, t - s.at, bridge, x)
        if e.cubic != 0.0:
            x = straightened(x, e.cubic)
        if e.backlash > 0.0:
            x = _widen(s, e, x)
        s.at = t
        out[0, j] = wrap(x) if e.wraps else x
        out[1, j] = age
        out[2, j] = _FRESH if age == 0.0 else _HELD


@njit(cache=True)
def _sweep(stated: Element, state: Element, kept: Kept, spans: Spans, t: Array, seen: Array, out: Array) -> None:
    """All frames at `t` (n,): `seen` (n, 2, m) to `out` (n, 3, m)."""
    taken = 0
    for k in range(t.shape[0]):
        while taken < t.shape[0] and t[taken] <= t[k] + spans.ahead:
            _take(stated, kept, spans.apart, t[taken], seen[taken])
            taken += 1
        _undo(stated, state, kept, spans.bridge, t[k], out[k])


@dataclass(frozen=True, slots=True)
class Known:
    """A profile's instrument errors: by signal those that are undone, in words, and what cannot be and why."""

    errors: Mapping[str, Instrument]
    words: tuple[str, ...]
    refused: tuple[str, ...]


def known(aircraft: Aircraft) -> Known:
    """What of a profile's instrument errors can be undone."""
    errors, words, refused = {}, [], []
    for name, stated in aircraft.instruments.items():
        kept = stated
        for key, why in _beyond(name, stated).items():
            refused.append(f"{name} {_said(name, key, getattr(stated, key))}: {why}")
            kept = kept.model_copy(update={key: getattr(_NOTHING, key)})
        if kept != _NOTHING:
            errors[name] = kept
            words.append(f"{name} " + ", ".join(_said(name, k, v) for k, v in kept if v != getattr(_NOTHING, k)))
    boom = aircraft.boom
    if boom is not None and aircraft.bends:
        by = [f"{from_si(boom.flexure, 'deg/g'):+.3g} deg/g"] if boom.flexure else []
        by += [f"{100 * boom.tip_load:+.3g} % of the flow angle per kPa"] if boom.tip_load else []
        mode = f", swinging at {boom.mode_frequency:.3g} Hz" if boom.mode_frequency else ""
        words.append(f"boom bends {' and '.join(by)}{mode}")
    if any(aircraft.imu_offset):
        words.append("imu " + " ".join(f"{x:+.3g}" for x in aircraft.imu_offset) + " m from the rig's place")
    return Known(errors, tuple(words), tuple(refused))


_NOTHING: Final = Instrument()
_SHOWN: Final = {"rad": "deg", "rad/s": "deg/s", "m/s2": "g"}


def _beyond(name: str, e: Instrument) -> dict[str, str]:
    """Keys of an instrument that cannot be undone, and why."""
    found = {}
    if abs(e.latency) > LATEST_S:
        found["latency"] = f"not undone beyond {1e3 * LATEST_S:.0f} ms"
    if abs(e.lag) > LONGEST_LAG_S:
        found["lag"] = f"not undone beyond {LONGEST_LAG_S:g} s: its noise would drown it"
    if name in ANGLES_THAT_WRAP and name != "phi":
        found |= {key: "an angle that wraps is not undone" for key in ("gain", "cubic") if _states(e, key)}
    return found


def _states(e: Instrument, key: str) -> bool:
    return bool(getattr(e, key) != getattr(_NOTHING, key))


def _said(name: str, key: str, value: float) -> str:
    unit = _SHOWN.get(SIGNALS[name].unit, SIGNALS[name].unit)
    if key == "latency":
        return f"{1e3 * abs(value):.0f} ms {'late' if value > 0 else 'early'}"
    if key == "lag":
        return f"lag {1e3 * value:.0f} ms"
    if key == "gain":
        return f"scale {100 * (value - 1):+.3g} %"
    if key == "bias":
        return f"bias {from_si(value, unit):+.3g} {unit}"
    if key == "backlash":
        return f"backlash {from_si(value, unit):.3g} {unit}"
    return f"nonlinearity {value:+.3g}"


class Corrector:
    """The errors of a profile's instruments undone, frame by frame or in a whole table: the same kernels."""

    def __init__(
        self,
        aircraft: Aircraft,
        noise: Mapping[str, float],
        dt: float = 1.0 / TICK_HZ,
        length: int = 128,
        imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """`noise`: standard deviations, SI. `length`: samples kept of each signal, 2.5 s of them live. `imu_position`:
        m from the CG, by the rig; a boom is straightened by `step` alone."""
        errors = known(aircraft).errors
        self.names = tuple(errors)
        self._columns = [SIGNAL_INDEX[name] for name in self.names]
        self._stated = np.zeros(len(errors), layout(Stated))
        steps = 0
        for j, (name, e) in enumerate(errors.items()):
            dither = DITHER * (noise.get(name, 0.0) or DEFAULT_NOISE.get(name, 0.0))
            wraps, max_age = name in ANGLES_THAT_WRAP, MAX_AGE_S[name]
            self._stated[j] = Stated(e.latency, e.lag, e.gain, e.bias, e.cubic, e.backlash, dither, wraps, max_age)
            reach = (e.latency + (_REACH * SLOPE_STEP_S if e.lag > 0 else 0.0)) / dt
            # Between two samples the cubic also takes the one after them.
            steps = max(steps, math.ceil(reach - _WHOLE) + (1 if abs(reach - round(reach)) > _WHOLE else 0))
        self.ahead = steps
        """Frames by which what comes out stands behind what goes in."""
        self.early_s = max(0.0, *(-e.latency for e in errors.values()), 0.0)
        """For so long nothing is known at first of signals that are shown too early; not below 0."""
        self._spans = Spans(0.5 * dt, max(BRIDGED_S, 2.5 * dt), steps * dt + _SAME_S)
        samples = np.zeros((2, len(errors), length))
        self._kept = Kept(samples[0], samples[1], np.zeros(len(errors), dtype=np.int64))
        self._state = np.zeros(len(errors), layout(State))
        for field in self._state.dtype.names or ():
            self._state[field] = math.nan
        self._seen = np.full((2, len(errors)), math.nan)
        self._out = np.empty((3, len(errors)))
        self._waiting: deque[Frame] = deque()
        self._start_ns: int | None = None
        self._bending = Bending(aircraft, imu_position, dt) if aircraft.bends else None
        # Compiled now: no tick of a flight has to.
        self._step(0.0, 0.0)

    def _step(self, newest: float, t: float) -> None:
        _take(self._stated, self._kept, self._spans.apart, newest, self._seen)
        _undo(self._stated, self._state, self._kept, self._spans.bridge, t, self._out)

    def step(self, frame: Frame) -> tuple[Frame, Frame] | None:
        """The frame of `ahead` frames ago, as measured and with the errors undone; None before there is one."""
        if self._start_ns is None:
            self._start_ns = frame.t_ns
        self._waiting.append(frame)
        self._seen[0] = [frame.values[i] for i in self._columns]
        self._seen[1] = [frame.age_s[i] for i in self._columns]
        newest = (frame.t_ns - self._start_ns) * 1e-9
        if len(self._waiting) <= self.ahead:
            _take(self._stated, self._kept, self._spans.apart, newest, self._seen)
            return None
        measured = self._waiting.popleft()
        self._step(newest, (measured.t_ns - self._start_ns) * 1e-9)
        values, ages, quality = list(measured.values), list(measured.age_s), list(measured.quality)
        for i, x, age, mark in zip(self._columns, *self._out.tolist(), strict=True):
            values[i], ages[i], quality[i] = x, age, int(mark)
        if self._bending is not None:
            seen = np.array([values[i] for i in COLUMNS])
            vane = self._bending.step((measured.t_ns - self._start_ns) * 1e-9, seen)
            values[COLUMNS[0]] = vane
            if math.isnan(vane):
                ages[COLUMNS[0]], quality[COLUMNS[0]] = math.nan, _MISSING
        return measured, Frame(measured.t_ns, measured.k, tuple(values), tuple(ages), tuple(quality))

    def sweep(self, t_s: Array, values: Array, ages: Array) -> tuple[Array, Array, NDArray[np.uint8]]:
        """Values, ages and quality (n, m) of a table with `values` and `ages` (n, m) in the order of `names`, NaN where
        missing; for an object of its own with a `length` of n."""
        out = np.empty((len(t_s), 3, len(self.names)))
        seen = np.stack([values, ages], axis=1)
        _sweep(self._stated, self._state, self._kept, self._spans, t_s, seen, out)
        return out[:, 0], out[:, 1], out[:, 2].astype(np.uint8)


def corrector(
    aircraft: Aircraft, noise: Mapping[str, float], imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Corrector | None:
    """What undoes a profile's instrument errors and its boom's bending in flight; None where it states neither."""
    if not known(aircraft).errors and not aircraft.bends:
        return None
    return Corrector(aircraft, noise, imu_position=imu_position)

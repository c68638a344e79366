"""Which values of a frame an estimator may use, for how long a lost one is held, and what follows from the air data.

A value counts if it is there, possible, not suspect, not too old and not frozen. Signals that the derivatives hang on
must be measured at the frame's own time: 20 ms of skew of the vane moves CL_q by 16 %. A lost one is held for 0.2 s so
that filters run on, then the tick is given up.
"""

from __future__ import annotations

import math
import struct
from operator import itemgetter
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import FRESH_AGE_S, MAX_AGE_S, MIN_SPEED, SIGNAL_INDEX, SIGNALS, TICK_HZ
from station.numerics.atmosphere import air_density
from station.numerics.named_state import Element, blank, packed
from station.rows import Frame, Quality

Array = NDArray[np.float64]

INPUTS: Final = (
    *("alpha_vane", "q", "airspeed", "az", "ax", "elevator"),
    *("p", "r", "ay", "beta_vane", "dynamic_pressure", "static_pressure", "air_temperature", "altitude"),
    *("thrust", "mass", "phi", "theta", "psi", "v_north", "v_east", "v_down"),
)
"""Order of the vectors in here. Without the first three there is no angle of attack, without the first six no
derivative; of these all but the airspeed must be of the frame's own time."""

VANE, Q, AIRSPEED, AZ, AX, ELEVATOR, P, R, AY, BETA, QBAR, STATIC, TEMPERATURE, ALTITUDE, THRUST, MASS = range(16)
ATTITUDE: Final = 16
VELOCITY: Final = 19
HELD_SCALARS: Final = 16
"""Inputs before the attitude; attitude and velocity are never held here, inertial.py knows their times."""

FRESH, HELD, PARTLY, LOST, SLOW, FROZEN = 0, 1, 2, 100, 199, 200
"""What `step` returns: all there; vane or q held; another one held or missing; LOST and FROZEN plus an input's
index."""

HOLD_TICKS: Final = 10
FROZEN_TICKS: Final = 13
_SUSPECT: Final = float(Quality.SUSPECT)

_pick: Final[Any] = itemgetter(*(SIGNAL_INDEX[name] for name in INPUTS))
_pack: Final = struct.Struct(f"{3 * len(INPUTS)}d").pack_into


N: Final = len(INPUTS)


class Limits(NamedTuple):
    """What a value must keep to count, (inputs,) each."""

    low: Annotated[Array, N]
    high: Annotated[Array, N]
    age: Annotated[Array, N]
    """s"""
    noise: Annotated[Array, N]
    """Above 0 if a signal that repeats itself for 0.26 s while others move is frozen."""


class State:
    """What `step` edits, (inputs,) each."""

    held: Annotated[Array, N]
    """The last value that counted."""
    lost: Annotated[Array, N]
    same: Annotated[Array, N]
    """For how many ticks there has been none, and the same."""
    u: Annotated[Array, N]
    """What step gives: usable values, lost ones held for 0.2 s, others NaN."""


@njit(cache=True)
def _count_repeats(s: State, raw: Array, age: Array) -> bool:
    """Whether any of the inputs that must be of the frame's own time moves."""
    moving = False
    for i in range(ELEVATOR + 1):
        if i != AIRSPEED and math.isfinite(raw[i]):
            if raw[i] == s.held[i] and age[i] <= FRESH_AGE_S:
                s.same[i] += 1.0
            else:
                s.same[i] = 0.0
                moving = True
    return moving


@njit(cache=True)
def _take(limits: Limits, s: State, i: int, value: float, age: float, quality: float) -> bool:
    """Use or hold an input; whether it counts."""
    if limits.low[i] <= value <= limits.high[i] and quality < _SUSPECT and age <= limits.age[i]:
        s.held[i] = s.u[i] = value
        s.lost[i] = 0.0
        return True
    s.lost[i] += 1.0
    s.u[i] = s.held[i] if i < HELD_SCALARS and s.lost[i] <= HOLD_TICKS else math.nan
    return False


@njit(cache=True)
def step(limits: Element, state: Element, given: Array) -> int:
    """Take the values, ages and quality of a frame, `given` (3, inputs); edits `state` and returns FRESH ... FROZEN +
    index. The first two are of Limits and State, one element each."""
    c: Limits = limits[0]
    s: State = state[0]
    raw, age, quality = given[0], given[1], given[2]
    moving = _count_repeats(s, raw, age)
    for i in range(ELEVATOR + 1, N):
        _take(c, s, i, raw[i], age[i], quality[i])
    code = FRESH
    frozen = -1
    missing = -1
    for i in range(ELEVATOR + 1):
        good = _take(c, s, i, raw[i], age[i], quality[i])
        if i <= AIRSPEED and not math.isfinite(s.u[i]) and missing < 0:
            missing = i
        if i == AIRSPEED:
            continue
        if not good or age[i] > FRESH_AGE_S:
            code = HELD if i < AIRSPEED or code == HELD else PARTLY
        if c.noise[i] > 0.0 and s.same[i] >= FROZEN_TICKS and moving and frozen < 0:
            frozen = i
    if missing >= 0:
        return LOST + missing
    if s.u[AIRSPEED] < MIN_SPEED:
        return SLOW
    return FROZEN + frozen if frozen >= 0 else code


@njit(cache=True)
def dynamic_pressure(u: Array, density: float) -> float:
    """Pa: measured if there is one, else rho V^2/2 by atmosphere.air_density, `density` being the profile's (NaN:
    none); NaN where nothing tells it."""
    if u[QBAR] > 0.0:
        return float(u[QBAR])
    return float(0.5 * air_density(density, u[STATIC], u[TEMPERATURE], u[ALTITUDE]) * u[AIRSPEED] ** 2)


class Conditioner:
    """The state of `step`: `u` (inputs,) and `age` (inputs,) of the newest frame."""

    def __init__(self, noise: dict[str, float]) -> None:
        limits = Limits(
            low=np.array([SIGNALS[name].low for name in INPUTS]),
            high=np.array([SIGNALS[name].high for name in INPUTS]),
            age=np.array([MAX_AGE_S[name] for name in INPUTS]),
            noise=np.array([noise.get(name, 0.0) for name in INPUTS]),
        )
        self._limits, self._state = packed(limits), blank(State)
        self._state["held"] = self._state["u"] = math.nan
        self._state["lost"] = HOLD_TICKS
        self._lost, self.u = self._state["lost"][0], self._state["u"][0]
        self._given = np.full((3, N), math.nan)
        self.age = self._given[1]

    def step(self, frame: Frame) -> int:
        """Take a frame; returns what the kernel `step` says."""
        _pack(self._given.data, 0, *_pick(frame.values), *_pick(frame.age_s), *_pick(frame.quality))
        return int(step(self._limits, self._state, self._given))

    def why(self, code: int) -> str:
        """In words, what a frame's code says against its angle of attack; "" if nothing."""
        if code >= FROZEN:
            return f"{INPUTS[code - FROZEN]} frozen" if code != FROZEN + ELEVATOR else ""
        if code == SLOW:
            return f"airspeed below {MIN_SPEED:g} m/s"
        if code >= LOST:
            return f"{INPUTS[code - LOST]} missing"
        if code == HELD:
            return (
                " and ".join(n for n, age in zip(INPUTS[:AIRSPEED], self.age, strict=False) if not age <= FRESH_AGE_S)
                + " held"
            )
        return ""

    @property
    def has_attitude(self) -> bool:
        return math.isfinite(self.u[ATTITUDE + 1])

    @property
    def has_velocity(self) -> bool:
        return math.isfinite(self.u[VELOCITY]) and math.isfinite(self.u[VELOCITY + 2])

    def degraded(self, is_split: bool) -> str:
        """What a valid angle of attack lacks; "" if nothing. `is_split`: motion and gust are separated in it."""
        if is_split and not self.has_attitude:
            return "no attitude: by the rates alone, inertial and gust parts drift"
        if is_split:
            return "" if self.has_velocity else "no velocity: by air data, slow gusts count as motion"
        lost = next((f"no {INPUTS[i]}" for i in (AX, AZ) if not math.isfinite(self.u[i])), "settling")
        return f"{lost if self.has_attitude else 'no attitude'}: motion and gust not told apart"

    def lacking(self, code: int, density: float) -> str:
        """What the derivatives wait for, if a signal is missing for a second; `density` as for dynamic_pressure."""
        for i in range(ELEVATOR + 1 if code != FRESH else 0):
            if self._lost[i] > TICK_HZ:
                return f"no {INPUTS[i]}"
        if code < LOST and math.isnan(dynamic_pressure(self.u, density)):
            return "no dynamic pressure, nor static pressure and temperature, nor altitude: air density not known"
        return ""

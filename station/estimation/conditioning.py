"""Which values of a frame an estimator may use, for how long a lost one is held, and what follows from the air data.

A value counts if it is there, possible, not suspect, not too old and not frozen. Signals that the derivatives hang on
must be measured at the frame's own time: 20 ms of skew of the vane moves CL_q by 16 %. A lost one is
held for 0.2 s so that filters run on, then the tick is given up.
"""

from __future__ import annotations

import math
import struct
from operator import itemgetter
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import FRESH_AGE_S, MAX_AGE_S, MIN_SPEED, SIGNAL_INDEX, SIGNALS, TICK_HZ
from station.numerics.atmosphere import air_density
from station.rows import Frame

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

_pick: Final[Any] = itemgetter(*(SIGNAL_INDEX[name] for name in INPUTS))
_pack: Final = struct.Struct(f"{3 * len(INPUTS)}d").pack_into


@njit(cache=True)
def step(
    given: Array,
    limit: Array,
    low: Array,
    high: Array,
    held: Array,
    lost: Array,
    same: Array,
    watch: Array,
    u: Array,
) -> int:
    """Fill `u` with usable values, lost ones held for 0.2 s, others NaN; returns FRESH ... FROZEN + index.

    `given` (3, inputs): values, ages and quality of a frame.
    `watch`: noise, above 0 if a signal that repeats itself for 0.26 s while others move is frozen. Edits `held`, `lost`
    and `same` (ticks so far).
    """
    raw, age, quality = given[0], given[1], given[2]
    moving = False
    for i in range(ELEVATOR + 1):
        if i != AIRSPEED and math.isfinite(raw[i]):
            if raw[i] == held[i] and age[i] <= FRESH_AGE_S:
                same[i] += 1.0
            else:
                same[i] = 0.0
                moving = True
    state = FRESH
    frozen = -1
    gone = -1
    for i in range(raw.shape[0]):
        good = low[i] <= raw[i] <= high[i] and quality[i] < 2.0 and age[i] <= limit[i]
        if good:
            held[i] = raw[i]
            lost[i] = 0.0
            u[i] = raw[i]
        else:
            lost[i] += 1.0
            u[i] = held[i] if i < HELD_SCALARS and lost[i] <= HOLD_TICKS else math.nan
        if i <= AIRSPEED and not math.isfinite(u[i]) and gone < 0:
            gone = i
        if i <= ELEVATOR and i != AIRSPEED:
            if not good or age[i] > FRESH_AGE_S:
                state = HELD if i < AIRSPEED or state == HELD else PARTLY
            if watch[i] > 0.0 and same[i] >= FROZEN_TICKS and moving and frozen < 0:
                frozen = i
    if gone >= 0:
        return LOST + gone
    if u[AIRSPEED] < MIN_SPEED:
        return SLOW
    if frozen >= 0:
        return FROZEN + frozen
    return state


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
        n = len(INPUTS)
        self._limit = np.array([MAX_AGE_S[name] for name in INPUTS])
        self._low = np.array([SIGNALS[name].low for name in INPUTS])
        self._high = np.array([SIGNALS[name].high for name in INPUTS])
        self._watch = np.array([noise.get(name, 0.0) for name in INPUTS])
        self._held = np.full(n, math.nan)
        self._lost = np.full(n, float(HOLD_TICKS))
        self._same = np.zeros(n)
        self.u = np.full(n, math.nan)
        self._given = np.full((3, n), math.nan)
        self.age = self._given[1]

    def step(self, frame: Frame) -> int:
        """Take a frame; returns what the kernel `step` says."""
        _pack(self._given.data, 0, *_pick(frame.values), *_pick(frame.age_s), *_pick(frame.quality))
        return int(
            step(
                self._given,
                self._limit,
                self._low,
                self._high,
                self._held,
                self._lost,
                self._same,
                self._watch,
                self.u,
            )
        )

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
        """What a valid angle of attack lacks; "" if nothing. `is_split`: motion and gust are told apart in it."""
        if is_split and not self.has_attitude:
            return "no attitude: by the rates alone, inertial and gust parts drift"
        if is_split:
            return "" if self.has_velocity else "no velocity: by air data, slow gusts count as motion"
        lost = next((f"no {INPUTS[i]}" for i in (AX, AZ) if not math.isfinite(self.u[i])), "settling")
        return f"{lost if self.has_attitude else 'no attitude'}: motion and gust not told apart"

    def lacking(self, code: int, density: float) -> str:
        """What the derivatives wait for, if a signal has been away for a second; `density` as for dynamic_pressure."""
        for i in range(ELEVATOR + 1 if code != FRESH else 0):
            if self._lost[i] > TICK_HZ:
                return f"no {INPUTS[i]}"
        if code < LOST and math.isnan(dynamic_pressure(self.u, density)):
            return "no dynamic pressure, nor static pressure and temperature, nor altitude: air density not known"
        return ""

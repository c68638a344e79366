"""Which values of a frame an estimator may use, for how long a lost one is held, and what follows from the air data.

A value counts if it is there, possible, not suspect, not too old and not frozen. Signals that the derivatives hang on must be
measured at the frame's own time: 20 ms of skew of the vane moves CL_q by 16 % (physics.md 6.5). A lost one is held for
0.2 s so that filters run on, then the tick is given up.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import SIGNAL_INDEX, SIGNALS
from station.profile import Aircraft
from station.rows import Frame

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

INPUTS: Final = (
    *("alpha_vane", "q", "az", "ax", "elevator", "airspeed"),
    *("p", "r", "ay", "beta_vane", "dynamic_pressure", "static_pressure", "air_temperature", "altitude"),
    *("thrust", "mass", "phi", "theta", "psi", "v_north", "v_east", "v_down"),
)
"""Order of the vectors in here. The first six are needed at every tick, the first five at the frame's own time."""

VANE, Q, AZ, AX, ELEVATOR, AIRSPEED, P, R, AY, BETA, QBAR, STATIC, TEMPERATURE, ALTITUDE, THRUST, MASS = range(16)
ATTITUDE: Final = 16
VELOCITY: Final = 19
NEEDED: Final = 6
STRICT: Final = 5

HOLD_TICKS: Final = 10
FROZEN_TICKS: Final = 13
MIN_SPEED: Final = 8.0
"""m/s: below it there are no flow angles."""

FRESH_AGE_S: Final = 0.011
_LIMIT_S: Final = {
    **dict.fromkeys(INPUTS, 0.2),
    **dict.fromkeys(("phi", "theta", "psi", "v_north", "v_east", "v_down"), 1.0),
    **dict.fromkeys(("static_pressure", "air_temperature", "altitude", "thrust", "mass"), 5.0),
}

_COLUMNS: Final = tuple(SIGNAL_INDEX[name] for name in INPUTS)
GAS_CONSTANT: Final = 287.05287
"""Dry air, J/(kg K): ISO 2533."""


@njit(cache=True)
def step(
    raw: Array,
    age: Array,
    quality: Array,
    limit: Array,
    low: Array,
    high: Array,
    strict: int,
    needed: int,
    held: Array,
    lost: Array,
    same: Array,
    watch: Array,
    u: Array,
) -> int:
    """Fill `u` with usable values, lost ones held for a while, others NaN.

    Returns 0 if all needed signals are measured at the frame's own time, 1 if one is held, else 100 + its index if it is
    lost, 200 + index if it is frozen while others move. Edits `held`, `lost` (ticks), `same` (ticks without a change).
    """
    n = raw.shape[0]
    moving = False
    for i in range(strict):
        if math.isfinite(raw[i]):
            if raw[i] == held[i] and age[i] <= 0.011:
                same[i] += 1.0
            else:
                same[i] = 0.0
                moving = True
    state = 0
    frozen = -1
    gone = -1
    for i in range(n):
        good = low[i] <= raw[i] <= high[i] and quality[i] < 2.0 and age[i] <= limit[i]
        if good:
            held[i] = raw[i]
            lost[i] = 0.0
            u[i] = raw[i]
        else:
            lost[i] += 1.0
            u[i] = held[i] if i < 16 and lost[i] <= 10.0 else math.nan
        if i < needed:
            if not math.isfinite(u[i]) and gone < 0:
                gone = i
            if i < strict and (not good or age[i] > 0.011):
                state = 1
            if i < strict and watch[i] > 0.0 and same[i] >= 13.0 and moving and frozen < 0:
                frozen = i
    if gone >= 0:
        return 100 + gone
    if frozen >= 0:
        return 200 + frozen
    return state


class Conditioner:
    """The state of `step`: `u` (inputs,) and `age` (inputs,) of the newest frame."""

    def __init__(self, aircraft: Aircraft, noise: dict[str, float]) -> None:
        n = len(INPUTS)
        self._limit = np.array([_LIMIT_S[name] for name in INPUTS])
        self._low = np.array([SIGNALS[name].low for name in INPUTS])
        self._high = np.array([SIGNALS[name].high for name in INPUTS])
        self._watch = np.array([noise.get(name, 0.0) for name in INPUTS])
        self._held = np.full(n, math.nan)
        self._lost = np.full(n, float(HOLD_TICKS))
        self._same = np.zeros(n)
        self._density = aircraft.air_density
        self._mass = aircraft.inertia.mass
        self.u = np.full(n, math.nan)
        self.age = np.full(n, math.nan)

    def step(self, frame: Frame) -> int:
        """Take a frame; returns what the kernel `step` says."""
        values, ages, quality = frame.values, frame.age_s, frame.quality
        raw = np.array([values[i] for i in _COLUMNS])
        self.age = np.array([ages[i] for i in _COLUMNS])
        return int(
            step(
                raw,
                self.age,
                np.array([quality[i] for i in _COLUMNS], dtype=np.float64),
                self._limit,
                self._low,
                self._high,
                STRICT,
                NEEDED,
                self._held,
                self._lost,
                self._same,
                self._watch,
                self.u,
            )
        )

    def dynamic_pressure(self) -> float:
        """Pa: measured if there is one, else rho V^2/2 with density from static air data, profile or altitude."""
        u = self.u
        measured = float(u[QBAR])
        if measured > 0.0:
            return measured
        if self._density is not None:
            density = self._density
        elif u[STATIC] > 0.0 and u[TEMPERATURE] > 0.0:
            density = float(u[STATIC] / (GAS_CONSTANT * u[TEMPERATURE]))
        else:
            height = float(u[ALTITUDE]) if math.isfinite(u[ALTITUDE]) else 0.0
            # ISO 2533 standard atmosphere below 11 km.
            density = 1.225 * max(1.0 - 2.25577e-5 * height, 0.1) ** 4.25588
        return 0.5 * density * float(u[AIRSPEED]) ** 2

    def mass(self) -> float:
        """kg: as given with the frame, else the profile's."""
        given = float(self.u[MASS])
        return given if given > 0.0 else self._mass

    def why(self, code: int) -> str:
        """In words, why a tick is not used; "" if it is."""
        if code >= 200:
            return f"{INPUTS[code - 200]} frozen"
        if code >= 100:
            return f"{INPUTS[code - 100]} missing"
        if code == 1:
            late = [n for i, n in enumerate(INPUTS[:STRICT]) if not self.age[i] <= FRESH_AGE_S]
            return f"{', '.join(late) or 'a signal'} held"
        return ""

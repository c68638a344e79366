"""Lateral-directional equation error of method II: CY, Cl and Cn on sideslip, rates, aileron and rudder, live.

    CY = CY_beta beta + CY_p p b/2V + CY_r r b/2V + CY_da da + CY_dr dr,   Cl and Cn alike

    beta = vane/H_v - r x/V + p z/V

with H_v the vane's own dynamics and x, z its place. Sideslip has no upwash in the profile; a side gust meets the vane
x/V before the fin, which this does not correct. Per radian, body axes, moments about the CG. The recursive transform
(spectra.py) and least squares with its standard errors (equation_error.py) are those of the longitudinal equations.

Source: Klein and Morelli 2006, equations 3.37 and 5.99-5.101 (coefficients), 10.6 (lever arm), section 11.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import LATERAL, SIGNAL_INDEX, SIGNALS, TICK_NS, to_si
from station.estimation.conditioning import FRESH_AGE_S
from station.estimation.derivatives import COLLINEAR, EXCITED, MIN_PERIODS, MIN_R2, SLACK_S
from station.estimation.equation_error import fit, past_size
from station.estimation.spectra import Transform, central_difference_factor, grid
from station.profile import Aircraft, Card
from station.rows import Frame, ParamEstimate, Quality, Status

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MEASURED: Final = ("beta_vane", "p", "r", "ay", "aileron", "rudder", "q")
"""Signals that must be of the frame's own time."""
EQUATIONS: Final = ("CY", "Cl", "Cn")
SURFACES: Final = ("aileron", "rudder")
NOISE: Final = {"aileron": to_si(0.02, "deg"), "rudder": to_si(0.02, "deg")}
"""Standard deviations where the rig gives none."""
LACKING_S: Final = 1.0
PARAMETERS: Final = 5
SETTLED: Final = 3
"""Consecutive frames with all signals: the angular accelerations are central differences."""

# What a transform holds: vane and rate parts of beta, p b/2V, r b/2V, aileron, rudder, CY, Cl, Cn.
CHANNELS: Final = 9
_DA, _CY = 4, 6

# One row of the history that a tick's coefficients are made from.
_BETA, _P, _R, _AY, _AILERON, _RUDDER, _Q, _V, _QBAR, _MASS, _ROW = range(11)
# constants
_S, _B, _IXX, _IYY, _IZZ, _IXZ, _V0, _XA, _YA, _ZA, _XV, _ZV = range(12)


@njit(cache=True)
def sides(constant: Array, history: Array, dt: float, row: Array, out: Array) -> bool:
    """Left and right sides, one tick ago: the middle of three rows of history.

    `row`: beta_vane, p, r, ay at the IMU, aileron, rudder, q, V, dynamic pressure, mass. `out` (CHANNELS,). Angular
    accelerations are central differences; an inertia that is not known is NaN, and so are then Cl and Cn. Returns False
    while there are fewer than three rows; `history` (3, row) starts as NaN.
    """
    for i in range(_ROW):
        history[0, i] = history[1, i]
        history[1, i] = history[2, i]
        history[2, i] = row[i]
    h = history[1]
    if not (math.isfinite(history[0, _P]) and math.isfinite(h[_P])):
        return False
    pdot = (history[2, _P] - history[0, _P]) / (2.0 * dt)
    rdot = (history[2, _R] - history[0, _R]) / (2.0 * dt)
    p, q, r, v = h[_P], h[_Q], h[_R], h[_V]
    x, y, z = constant[_XA], constant[_YA], constant[_ZA]
    ay = h[_AY] - (rdot * x - pdot * z) - (q * (p * x + q * y + r * z) - (p * p + q * q + r * r) * y)
    force = h[_QBAR] * constant[_S]
    ixx, iyy, izz, ixz = constant[_IXX], constant[_IYY], constant[_IZZ], constant[_IXZ]
    half = constant[_B] / (2.0 * (constant[_V0] if constant[_V0] > 0.0 else v))
    out[0] = h[_BETA]
    out[1] = (p * constant[_ZV] - r * constant[_XV]) / v
    out[2] = p * half
    out[3] = r * half
    out[4] = h[_AILERON]
    out[5] = h[_RUDDER]
    out[6] = h[_MASS] * ay / force
    out[7] = (ixx * pdot - ixz * (p * q + rdot) + (izz - iyy) * q * r) / (force * constant[_B])
    out[8] = (izz * rdot - ixz * (pdot - q * r) + (iyy - ixx) * p * q) / (force * constant[_B])
    return True


@njit(cache=True)
def fit_equations(
    spectrum: Complex,
    vane: Complex,
    derivative: Array,
    ridge: Array,
    independent: float,
    close: bool,
    past: Array,
    out: Array,
    solved: NDArray[np.bool_],
) -> None:
    """All three equations from `spectrum` (CHANNELS, frequencies).

    `vane`: 1/H_v; `derivative`: factor of the moments for their central difference; both (frequencies,). `ridge`,
    `independent`, `close`: see equation_error.fit. Edits `past` (3, past_size); fills `out` (3, 3, PARAMETERS + 1) and
    `solved` (3,).
    """
    lines = spectrum.shape[1]
    x = np.empty((PARAMETERS, lines), dtype=np.complex128)
    z = np.empty(lines, dtype=np.complex128)
    inverse = np.zeros((PARAMETERS, PARAMETERS))
    for f in range(lines):
        x[0, f] = spectrum[0, f] * vane[f] + spectrum[1, f]
        for i in range(1, PARAMETERS):
            x[i, f] = spectrum[i + 1, f]
    for equation in range(3):
        for f in range(lines):
            z[f] = spectrum[_CY + equation, f] * (1.0 if equation == 0 else derivative[f])
        solved[equation] = fit(x, z, ridge, independent, past[equation], close, out[equation], inverse)


class Lateral:
    """Spectra of the flight so far and the fifteen derivatives they give."""

    def __init__(
        self,
        aircraft: Aircraft,
        card: Card,
        imu_position: tuple[float, float, float],
        noise: Mapping[str, float],
        dt: float,
        forgetting_s: float = math.inf,
    ) -> None:
        """`imu_position`: m from the CG, body axes. `noise`: standard deviations of the surfaces, rad."""
        g, i, boom = aircraft.geometry, aircraft.inertia, aircraft.boom
        inertias = [math.nan if inertia is None else inertia for inertia in (i.ixx, i.iyy, i.izz)]
        self._inertia = all(math.isfinite(inertia) for inertia in inertias)
        fixed = aircraft.reference_speed if aircraft.rate_reference == "fixed" else None
        place = (boom.vane_x, boom.vane_z) if boom else (0.0, 0.0)
        self._constant = np.array([g.wing_area, g.span, *inertias, i.ixz, fixed or 0.0, *imu_position, *place])
        self._dt = dt
        self._noise = {**NOISE, **{k: v for k, v in noise.items() if v > 0}}
        self._warm_up_s = card.warm_up
        self._step_hz = card.step
        self._minimum = MIN_PERIODS / card.low
        self._frequencies = frequencies = grid(card.low, card.high, card.step)
        self._derivative = central_difference_factor(frequencies, dt)
        share = frequencies / boom.vane_frequency if boom else 0.0 * frequencies
        self._vane = 1.0 - share**2 + 2j * (boom.vane_damping if boom else 0.0) * share
        self._transform = Transform(CHANNELS, frequencies, dt)
        self._segment = 1.0 / card.step
        self._keep = math.exp(-self._segment / forgetting_s)
        self._known = {name: abs(aircraft.value(name)) for name in LATERAL}
        self._history = np.full((3, _ROW), math.nan)
        self._row = np.zeros(_ROW)
        self._sides = np.zeros(CHANNELS)
        self._ridge = np.zeros(PARAMETERS)
        self._past = np.zeros((3, past_size(PARAMETERS)))
        self._out = np.zeros((3, 3, PARAMETERS + 1))
        self._solved = np.zeros(3, dtype=np.bool_)
        self._closed = np.zeros(3)
        """Of closed segments: samples, and energy of each surface on all lines."""
        self._from_s = 0.0
        self._run = 0
        self._last_ns = 0
        self._away = dict.fromkeys(MEASURED, 0.0)

    def clear(self) -> None:
        """Begin anew; the high-passes stay warm."""
        self._transform.clear()
        self._past[:] = 0.0
        self._closed[:] = 0.0

    def add(self, frame: Frame, speed: float, pressure: float, mass: float, since_start_s: float) -> None:
        """One frame, and what was made of it: true airspeed, dynamic pressure, mass; NaN where unusable."""
        row = self._row
        whole = True
        for i, name in enumerate(MEASURED):
            k, signal = SIGNAL_INDEX[name], SIGNALS[name]
            value = frame.values[k]
            good = signal.low <= value <= signal.high and frame.quality[k] < Quality.SUSPECT
            self._away[name] = 0.0 if good else self._away[name] + self._dt
            whole = whole and good and frame.age_s[k] <= FRESH_AGE_S
            row[i] = value
        row[_V], row[_QBAR], row[_MASS] = speed, pressure, mass
        whole = whole and math.isfinite(speed + pressure + mass)
        follows = abs(frame.t_ns - self._last_ns - TICK_NS) < TICK_NS // 2
        self._last_ns = frame.t_ns
        if not (whole and follows):
            self._history[:] = math.nan
            self._run = 0
        if not whole:
            return
        self._run += 1
        made = sides(self._constant, self._history, self._dt, row, self._sides)
        if not made or self._run < SETTLED:
            return
        if not self._inertia:
            self._sides[7:] = 0.0
        if self._transform.filtered == 0:
            self._from_s = since_start_s
        due = since_start_s >= self._warm_up_s
        self._transform.step(self._sides, due and self._from_s <= since_start_s - self._warm_up_s + SLACK_S)

    def estimate(self) -> tuple[ParamEstimate, ...]:
        """The fifteen derivatives from the spectra now, in the order of conventions.LATERAL."""
        samples = self._closed[0] + self._transform.samples
        status, why = self._blocked(samples)
        moved = self._closed[1:] + [_energy(self._transform.spectrum[_DA + i]) for i in (0, 1)]
        still = []
        for i, surface in enumerate(SURFACES):
            floor = len(self._frequencies) * samples * self._noise[surface] ** 2
            if moved[i] < EXCITED * floor:
                still.append(surface)
            # A surface that has not moved is left out: as a regressor it would be noise alone.
            self._ridge[3 + i] = 1e9 * max(moved[i], floor, 1e-12) if surface in still else 0.0
        if status is Status.ESTIMATED and len(still) == 2:
            status, why = Status.UNESTIMATED, "no aileron or rudder input"
        if samples > 0:
            self._fit()
        found: list[ParamEstimate] = []
        for e, equation in enumerate(EQUATIONS):
            found += self._judge(e, equation, still, status, why)
        return tuple(found)

    def _fit(self) -> None:
        t = self._transform.samples * self._dt
        close = t >= self._segment
        fit_equations(
            self._transform.spectrum,
            self._vane,
            self._derivative,
            self._ridge,
            t * self._step_hz,
            close,
            self._past,
            self._out,
            self._solved,
        )
        if close:
            self._closed[0] += self._transform.samples
            self._closed[1:] += [_energy(self._transform.spectrum[_DA + i]) for i in (0, 1)]
            self._closed *= self._keep
            self._past *= self._keep
            self._transform.clear()

    def _blocked(self, samples: float) -> tuple[Status, str]:
        """Why there are no estimates yet; ESTIMATED if there are."""
        if samples == 0:
            away = [name for name, seconds in self._away.items() if seconds > LACKING_S]
            return Status.UNESTIMATED, f"no {' and '.join(away)}" if away else "warming up"
        if samples * self._dt < self._minimum:
            return Status.UNESTIMATED, f"less than {self._minimum:g} s of data"
        return Status.ESTIMATED, ""

    def _judge(self, e: int, equation: str, still: list[str], status: Status, why: str) -> list[ParamEstimate]:
        names = LATERAL[PARAMETERS * e : PARAMETERS * (e + 1)]
        solved = bool(self._solved[e])
        if equation != "CY" and not self._inertia:
            status, why, solved = Status.INVALID, "the aircraft profile gives no ixx, iyy and izz", False
        elif status is Status.ESTIMATED and not solved:
            status, why = Status.INVALID, "the regressors cannot be told apart"
        if not solved:
            return [ParamEstimate(n, math.nan, math.nan, status, why) for n in names]
        values, errors, inflation = self._out[e].tolist()
        r2 = values[PARAMETERS]
        if status is Status.ESTIMATED and r2 < MIN_R2:
            status, why = Status.INVALID, f"the model explains {max(r2, 0.0):.0%} of the data"
        found = []
        for i, name in enumerate(names):
            value, error, this, reason = values[i], errors[i], status, why
            if status is Status.ESTIMATED:
                if i >= 3 and SURFACES[i - 3] in still:
                    value = error = math.nan
                    this, reason = Status.UNESTIMATED, f"no {SURFACES[i - 3]} input"
                elif inflation[i] > COLLINEAR:
                    this, reason = Status.INVALID, "moves with the other regressors: vary the input"
                elif not 2.0 * error <= max(abs(value), self._known[name]):
                    this, reason = Status.UNESTIMATED, "2 sd exceed the value"
            found.append(ParamEstimate(name, value, error, this, reason))
        return found


def _energy(spectrum: Complex) -> float:
    return float(np.vdot(spectrum, spectrum).real)

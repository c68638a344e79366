"""Lateral-directional equation error, live: CY, Cl and Cn on sideslip, rates, aileron and rudder.

    CY = CY_beta beta + CY_p p b/2V + CY_r r b/2V + CY_da da + CY_dr dr,   Cl and Cn alike

    II:     beta = vane/H_v - r x/V + p z/V
    split:  beta = beta_i + (that - beta_i) e^(-s x/V)

with H_v the vane's own dynamics and x, z its place; sideslip has no upwash in the profile. beta_i is the inertial
sideslip: what is left is the side gust, which reaches the CG x/V after the vane. It reaches the fin later still, which
neither corrects. II may be wrong by as much as it lies off split, and its errors say so. Per radian, body axes, moments
about the CG. The recursive transform (spectra.py) and least squares with its standard errors (equation_error.py) are
those of the longitudinal equations.

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

# What a transform holds: vane and rate parts of beta, inertial beta, p b/2V, r b/2V, aileron, rudder, CY, Cl, Cn.
CHANNELS: Final = 10
_INERTIAL, _RATES, _DA, _CY = 2, 3, 5, 7
METHODS: Final = ("II", "split")
"""In the order of Lateral's spectra."""

# One row of the history that a tick's coefficients are made from.
_BETA, _P, _R, _AY, _AILERON, _RUDDER, _Q, _V, _QBAR, _MASS, _BETA_I, _ROW = range(12)
# constants
_S, _B, _IXX, _IYY, _IZZ, _IXZ, _V0, _XA, _YA, _ZA, _XV, _ZV = range(12)


@njit(cache=True)
def sides(constant: Array, history: Array, dt: float, row: Array, out: Array) -> bool:
    """Left and right sides, one tick ago: the middle of three rows of history.

    `row`: beta_vane, p, r, ay at the IMU, aileron, rudder, q, V, dynamic pressure, mass, inertial sideslip. `out`
    (CHANNELS,). Angular accelerations are central differences; an inertia that is not known is NaN, and so are then Cl
    and Cn. Returns False while there are fewer than three rows; `history` (3, row) starts as NaN.
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
    out[2] = h[_BETA_I]
    out[3] = p * half
    out[4] = r * half
    out[5] = h[_AILERON]
    out[6] = h[_RUDDER]
    out[7] = h[_MASS] * ay / force
    out[8] = (ixx * pdot - ixz * (p * q + rdot) + (izz - iyy) * q * r) / (force * constant[_B])
    out[9] = (izz * rdot - ixz * (pdot - q * r) + (iyy - ixx) * p * q) / (force * constant[_B])
    return True


@njit(cache=True)
def fit_equations(
    spectrum: Complex,
    vane: Complex,
    late: Complex,
    derivative: Array,
    ridge: Array,
    independent: float,
    close: bool,
    past: Array,
    out: Array,
    solved: NDArray[np.bool_],
) -> None:
    """All three equations from `spectrum` (CHANNELS, frequencies).

    `vane`: 1/H_v; `late`: what delays the gust to the CG, 1 for method II; `derivative`: factor of the moments for
    their central difference; all (frequencies,). `ridge`, `independent`, `close`: see equation_error.fit. Edits `past`
    (3, past_size); fills `out` (3, 3, PARAMETERS + 1) and `solved` (3,).
    """
    lines = spectrum.shape[1]
    x = np.empty((PARAMETERS, lines), dtype=np.complex128)
    z = np.empty(lines, dtype=np.complex128)
    inverse = np.zeros((PARAMETERS, PARAMETERS))
    for f in range(lines):
        inertial = spectrum[_INERTIAL, f]
        x[0, f] = inertial + (spectrum[0, f] * vane[f] + spectrum[1, f] - inertial) * late[f]
        for i in range(1, PARAMETERS):
            x[i, f] = spectrum[_RATES - 1 + i, f]
    for equation in range(3):
        for f in range(lines):
            z[f] = spectrum[_CY + equation, f] * (1.0 if equation == 0 else derivative[f])
        solved[equation] = fit(x, z, ridge, independent, past[equation], close, out[equation], inverse)


class Spectra:
    """One method's transform of the flight so far, and its fit."""

    def __init__(self, frequencies: Array, dt: float, step_hz: float, warm_up_s: float, keep: float) -> None:
        """`keep`: what is left of a closed segment's sums when the next one closes."""
        self._transform = Transform(CHANNELS, frequencies, dt)
        self._dt, self._step_hz, self._warm_up_s, self._keep = dt, step_hz, warm_up_s, keep
        self._past = np.zeros((3, past_size(PARAMETERS)))
        self._closed = np.zeros(3)
        """Of closed segments: samples, and energy of each surface on all lines."""
        self._from_s = 0.0
        self._speed_sum = 0.0
        self.out = np.zeros((3, 3, PARAMETERS + 1))
        """By equation, as equation_error.fit gives it."""
        self.solved = np.zeros(3, dtype=np.bool_)

    @property
    def samples(self) -> float:
        """In the estimates."""
        return float(self._closed[0]) + self._transform.samples

    def surfaces(self) -> Array:
        """Energy of aileron and rudder on all lines, (2,)."""
        now = self._transform.spectrum[_DA : _DA + 2]
        return np.asarray(self._closed[1:] + (now.real**2 + now.imag**2).sum(axis=1))

    def clear(self) -> None:
        """Begin anew; the high-pass stays warm."""
        self._transform.clear()
        self._past[:] = 0.0
        self._closed[:] = 0.0
        self._speed_sum = 0.0
        self.solved[:] = False

    def add(self, sample: Array, speed: float, since_start_s: float) -> None:
        """`sample` (CHANNELS,), all finite; true airspeed of it."""
        if self._transform.filtered == 0:
            self._from_s = since_start_s
        due = since_start_s >= self._warm_up_s and self._from_s <= since_start_s - self._warm_up_s + SLACK_S
        self._transform.step(sample, due)
        self._speed_sum += speed if due else 0.0

    def fit(self, vane: Complex, omega: Array, arm: float, derivative: Array, ridge: Array) -> None:
        """Solve the three equations; `arm`: how far (m) the gust has to go from vane to CG, 0 for method II."""
        samples = self._transform.samples
        if samples == 0:
            return
        close = samples * self._dt >= 1.0 / self._step_hz
        late = np.exp(-1j * omega * (arm * samples / self._speed_sum))
        share = samples * self._dt * self._step_hz
        fit_equations(
            self._transform.spectrum, vane, late, derivative, ridge, share, close, self._past, self.out, self.solved
        )
        if close:
            self._closed[1:] = self.surfaces()
            self._closed[0] += samples
            self._closed *= self._keep
            self._past *= self._keep
            self._transform.clear()
            self._speed_sum = 0.0


class Lateral:
    """The fifteen derivatives of METHODS from the flight so far."""

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
        self._arm = place[0]
        self._dt = dt
        self._noise = {**NOISE, **{k: v for k, v in noise.items() if v > 0}}
        self._minimum = MIN_PERIODS / card.low
        frequencies = grid(card.low, card.high, card.step)
        self._omega = 2.0 * np.pi * frequencies
        self._derivative = central_difference_factor(frequencies, dt)
        share = frequencies / boom.vane_frequency if boom else 0.0 * frequencies
        self._vane = 1.0 - share**2 + 2j * (boom.vane_damping if boom else 0.0) * share
        keep = math.exp(-1.0 / card.step / forgetting_s)
        self._spectra = tuple(Spectra(frequencies, dt, card.step, card.warm_up, keep) for _ in METHODS)
        self._known = {name: abs(aircraft.value(name)) for name in LATERAL}
        self._history = np.full((3, _ROW), math.nan)
        self._row = np.zeros(_ROW)
        self._sides = np.zeros(CHANNELS)
        self._ridge = np.zeros(PARAMETERS)
        self._run = 0
        self._last_ns = 0
        self._away = dict.fromkeys(MEASURED, 0.0)

    def clear(self) -> None:
        """Begin anew; the high-passes stay warm."""
        for spectra in self._spectra:
            spectra.clear()

    def add(
        self, frame: Frame, speed: float, pressure: float, mass: float, beta_inertial: float, since_start_s: float
    ) -> None:
        """One frame, and what was made of it: true airspeed, dynamic pressure, mass; NaN where unusable.

        `beta_inertial`: NaN where there is none.
        """
        row = self._row
        whole = True
        for i, name in enumerate(MEASURED):
            k, signal = SIGNAL_INDEX[name], SIGNALS[name]
            value = frame.values[k]
            good = signal.low <= value <= signal.high and frame.quality[k] < Quality.SUSPECT
            self._away[name] = 0.0 if good else self._away[name] + self._dt
            whole = whole and good and frame.age_s[k] <= FRESH_AGE_S
            row[i] = value
        row[_V], row[_QBAR], row[_MASS], row[_BETA_I] = speed, pressure, mass, beta_inertial
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
            self._sides[_CY + 1 :] = 0.0
        steady, split = self._spectra
        if math.isfinite(self._sides[_INERTIAL]):
            split.add(self._sides, speed, since_start_s)
        self._sides[_INERTIAL] = 0.0
        steady.add(self._sides, speed, since_start_s)

    def estimate(self) -> dict[str, tuple[ParamEstimate, ...]]:
        """By method, the fifteen derivatives from the spectra now, in the order of conventions.LATERAL."""
        steady, split = self._spectra
        blocked = [self._blocked(spectra) for spectra in (steady, split)]
        still = [self._solve(steady, 0.0), self._solve(split, self._arm)]
        off = np.abs(steady.out[:, 0] - split.out[:, 0]) * split.solved[:, None]
        return {
            "II": self._judge(steady, blocked[0], still[0], off),
            "split": self._judge(split, blocked[1], still[1], np.zeros_like(off)),
        }

    def _solve(self, spectra: Spectra, arm: float) -> list[str]:
        """Fit, and tell which surfaces have not moved. They are left out: as regressors they would be noise alone."""
        moved = spectra.surfaces()
        still = []
        for i, surface in enumerate(SURFACES):
            floor = len(self._omega) * spectra.samples * self._noise[surface] ** 2
            if moved[i] < EXCITED * floor or moved[i] == 0.0:
                still.append(surface)
            self._ridge[3 + i] = 1e9 * max(moved[i], 1e-9) if surface in still else 0.0
        spectra.fit(self._vane, self._omega, arm, self._derivative, self._ridge)
        return still

    def _blocked(self, spectra: Spectra) -> tuple[Status, str]:
        """Why there are no estimates yet; ESTIMATED if there are."""
        if spectra.samples == 0:
            away = [name for name, seconds in self._away.items() if seconds > LACKING_S]
            if away:
                return Status.UNESTIMATED, f"no {' and '.join(away)}"
            if self._spectra[0].samples * self._dt > SLACK_S:
                return Status.INVALID, "no inertial sideslip: attitude or accelerations are missing"
            return Status.UNESTIMATED, "warming up"
        if spectra.samples * self._dt < self._minimum:
            return Status.UNESTIMATED, f"less than {self._minimum:g} s of data"
        return Status.ESTIMATED, ""

    def _judge(
        self, spectra: Spectra, blocked: tuple[Status, str], still: list[str], model: Array
    ) -> tuple[ParamEstimate, ...]:
        """`model` (3, PARAMETERS + 1): standard deviations by the model's error."""
        status, why = blocked
        if status is Status.ESTIMATED and len(still) == len(SURFACES):
            status, why = Status.UNESTIMATED, "no aileron or rudder input"
        found: list[ParamEstimate] = []
        for e, equation in enumerate(EQUATIONS):
            fitted = spectra.out[e].tolist() if spectra.solved[e] else None
            found += self._judge_equation(e, equation, fitted, model[e].tolist(), still, status, why)
        return tuple(found)

    def _judge_equation(
        self,
        e: int,
        equation: str,
        fitted: list[list[float]] | None,
        model: list[float],
        still: list[str],
        status: Status,
        why: str,
    ) -> list[ParamEstimate]:
        names = LATERAL[PARAMETERS * e : PARAMETERS * (e + 1)]
        if equation != "CY" and not self._inertia:
            status, why, fitted = Status.INVALID, "the aircraft profile gives no ixx, iyy and izz", None
        elif status is Status.ESTIMATED and fitted is None:
            status, why = Status.INVALID, "the regressors cannot be told apart"
        if fitted is None:
            return [ParamEstimate(n, math.nan, math.nan, status, why) for n in names]
        values, errors, inflation = fitted
        r2 = values[PARAMETERS]
        if status is Status.ESTIMATED and r2 < MIN_R2:
            status, why = Status.INVALID, f"the model explains {max(r2, 0.0):.0%} of the data"
        found = []
        for i, name in enumerate(names):
            value, error, this, reason = values[i], math.hypot(errors[i], model[i]), status, why
            if i >= 3 and SURFACES[i - 3] in still:
                value = error = math.nan
                if status is Status.ESTIMATED:
                    this, reason = Status.UNESTIMATED, f"no {SURFACES[i - 3]} input"
            elif status is Status.ESTIMATED:
                if inflation[i] > COLLINEAR:
                    this, reason = Status.INVALID, "moves with the other regressors: vary the input"
                elif not 2.0 * errors[i] <= max(abs(value), self._known[name]):
                    this, reason = Status.UNESTIMATED, "2 sd exceed the value"
            found.append(ParamEstimate(name, value, error, this, reason))
        return found

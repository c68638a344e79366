"""Lateral-directional equation error, live: CY, Cl and Cn on sideslip, rates, aileron and rudder.

    CY = CY_beta beta + CY_p p b/2V + CY_r r b/2V + CY_da da + CY_dr dr,   Cl and Cn alike

    II:     beta = vane/H_v - r x/V + p z/V
    split:  beta = beta_i + (that - beta_i) e^(-s x/V)

with H_v the vane's own dynamics and x, z its place; sideslip has no upwash in the profile. beta_i is the inertial
sideslip: the rest is the side gust, which reaches the CG x/V after the vane. It reaches the fin later still, which
neither corrects. Both are made in the time domain: factors of a transform that ends while the air still moves would err
by what is cut off at its ends, and derivatives from gusts alone by a fifth. II may be wrong by its distance from
split, split by a tenth of that (attitude and mean wind are never quite known), and their errors say so. Per radian,
body axes, moments about the CG. The recursive transform (spectra.py) and least squares with its standard errors
(equation_error.py) are those of the longitudinal equations.

Source: Klein and Morelli 2006, equations 3.37 and 5.99-5.101 (coefficients), 10.6 (lever arm), section 11.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import FRESH_AGE_S, LATERAL, SIGNAL_INDEX, SIGNALS, TICK_NS
from station.estimation.acceptance import EXCITED, MIN_PERIODS, UNSOLVED, of_equation, of_estimate, worded
from station.estimation.derivatives import SLACK_S
from station.estimation.equation_error import Fitted, Sums, fit, no_sums, nothing_fitted
from station.model.airframe_error import relative_errors
from station.model.coefficients import roll_and_yaw_moment, specific_force_at_cg
from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.differentiation import central
from station.numerics.lagrange import cubic
from station.numerics.regression import attenuation
from station.numerics.second_order import inverse_terms
from station.numerics.spectra import Transform, central_difference_factor, grid
from station.profile import Aircraft, Card
from station.rows import Frame, ParamEstimate, Quality, Status

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MEASURED: Final = ("beta_vane", "p", "r", "ay", "aileron", "rudder", "q")
"""Signals that must be of the frame's own time."""
EQUATIONS: Final = ("CY", "Cl", "Cn")
SURFACES: Final = ("aileron", "rudder")
MOTIONS: Final = {"beta": "sideslip", "p": "roll rate", "r": "yaw rate"}
SPOKEN: Final = (*MOTIONS.values(), *SURFACES)
"""The regressors in words."""
REGRESSORS: Final = ("beta_vane", "p", "r", "aileron", "rudder")
ATTENUATED: Final = 0.2
"""Share of noise in what a regressor has beyond the others, above which its derivative is noise's."""
LACKING_S: Final = 1.0
PARAMETERS: Final = 5
GUST_IN_MOTION: Final = 0.1
"""Share of the side gust that split may take for motion, or motion for it."""
SETTLED: Final = 3
"""Consecutive frames with all signals: the angular accelerations are central differences."""

# What a transform holds: beta, p b/2V, r b/2V, aileron, rudder, CY, Cl, Cn.
CHANNELS: Final = PARAMETERS + 3
RING: Final = 128
"""Side gusts kept, ticks."""
METHODS: Final = ("II", "split")
"""In the order of Lateral's spectra."""
# One row of the history that a tick's coefficients are made from.
_BETA, _P, _R, _AY, _AILERON, _RUDDER, _Q, _V, _QBAR, _MASS, _BETA_I, _ROW = range(12)
# constants
_S, _B, _IXX, _IYY, _IZZ, _IXZ, _V0, _XA, _YA, _ZA, _XV, _ZV, _LAG, _BEND = range(14)
"""The last two: the vane's 2 zeta/omega (s) and 1/omega^2 (s^2)."""


@njit(cache=True)
def sides(constant: Array, history: Array, dt: float, row: Array, out: Array) -> bool:
    """Left and right sides, one tick ago: the middle of three rows of history.

    `row`: beta_vane, p, r, ay at the IMU, aileron, rudder, q, V, dynamic pressure, mass, inertial sideslip. `out`
    (CHANNELS,), beta that of the air at the vane. Angular accelerations and the vane's are central differences; an
    inertia that is not known is NaN, and so are then Cl and Cn. Returns False while there are fewer than three rows;
    `history` (3, row) starts as NaN.
    """
    for i in range(_ROW):
        history[0, i] = history[1, i]
        history[1, i] = history[2, i]
        history[2, i] = row[i]
    h = history[1]
    if not (math.isfinite(history[0, _P]) and math.isfinite(h[_P])):
        return False
    pdot = central(history[2, _P], history[0, _P], dt)
    rdot = central(history[2, _R], history[0, _R], dt)
    p, q, r, v = h[_P], h[_Q], h[_R], h[_V]
    place = constant[_XA], constant[_YA], constant[_ZA]
    # What the pitch acceleration does to an accelerometer is in the plane of symmetry: 0 stands for it.
    _, ay, _ = specific_force_at_cg((0.0, h[_AY], 0.0), (p, q, r), (pdot, 0.0, rdot), place)
    force = h[_QBAR] * constant[_S]
    inertia = constant[_IXX], constant[_IYY], constant[_IZZ], constant[_IXZ]
    roll, yaw = roll_and_yaw_moment(inertia, (p, q, r), pdot, rdot)
    half = constant[_B] / (2.0 * (constant[_V0] if constant[_V0] > 0.0 else v))
    turned = central(history[2, _BETA], history[0, _BETA], dt)
    bent = (history[2, _BETA] - 2.0 * h[_BETA] + history[0, _BETA]) / (dt * dt)
    out[0] = h[_BETA] + constant[_LAG] * turned + constant[_BEND] * bent
    out[0] += (p * constant[_ZV] - r * constant[_XV]) / v
    out[1] = p * half
    out[2] = r * half
    out[3] = h[_AILERON]
    out[4] = h[_RUDDER]
    out[5] = h[_MASS] * ay / force
    out[6] = roll / (force * constant[_B])
    out[7] = yaw / (force * constant[_B])
    return True


@njit(cache=True)
def carried(ring: Array, count: int, gust: float, lag: float) -> float:
    """The gust `lag` ticks ago, cubic between ticks; NaN from before the first. `count`: how many came before `gust`,
    which is put into `ring` (RING,)."""
    n = ring.shape[0]
    ring[count % n] = gust
    back = min(max(math.ceil(lag), 2), n - 3)
    if count < back + 1:
        return math.nan
    a, b, c, d = [ring[(count - back + k) % n] for k in (-1, 0, 1, 2)]
    return float(cubic(a, b, c, d, back - lag))


@njit(cache=True)
def fit_equations(
    spectrum: Complex,
    derivative: Array,
    ridge: Array,
    independent: float,
    close: bool,
    past: Sums,
    fitted: Fitted,
    r2: Array,
) -> None:
    """All three equations from `spectrum` (CHANNELS, frequencies).

    `derivative` (frequencies,): factor of the moments for their central difference. `ridge`, `independent`, `close`:
    see equation_error.fit. Edits `past`, fills `fitted` and `r2`, all (3, ...).
    """
    past, fitted = Sums(*past), Fitted(*fitted)
    x = spectrum[:PARAMETERS]
    z = np.empty(spectrum.shape[1], dtype=np.complex128)
    for e in range(3):
        for f in range(len(z)):
            z[f] = spectrum[PARAMETERS + e, f] * (1.0 if e == 0 else derivative[f])
        sums = Sums(past.normal[e], past.scores[e], past.right[e], past.extent[e])
        at = Fitted(fitted.value[e], fitted.error[e], fitted.inflation[e], fitted.inverse[e])
        r2[e] = fit(x, z, ridge, independent, sums, close, at)


class Spectra:
    """One method's transform of the flight so far, and its fit."""

    def __init__(self, frequencies: Array, dt: float, step_hz: float, warm_up_s: float, keep: float) -> None:
        """`keep`: share of the closed segments' sums that is kept when the next one closes."""
        self._transform = Transform(CHANNELS, frequencies, dt)
        self._dt, self._step_hz, self._warm_up_s, self._keep = dt, step_hz, warm_up_s, keep
        self._past = no_sums((len(EQUATIONS),), PARAMETERS)
        self._closed = np.zeros(1 + PARAMETERS)
        """Of closed segments: samples, and energy of each regressor on all lines."""
        self._from_s = 0.0
        self.fitted = nothing_fitted((len(EQUATIONS),), PARAMETERS)
        """By equation."""
        self.r2 = np.full(len(EQUATIONS), math.nan)
        """NaN where there is no solution."""
        self._plain: Any = (tuple(self._past), tuple(self.fitted))

    @property
    def samples(self) -> float:
        """In the estimates."""
        return float(self._closed[0]) + self._transform.samples

    def energy(self) -> Array:
        """Of sideslip, roll and yaw rate, aileron and rudder on all lines, (PARAMETERS,)."""
        now = self._transform.spectrum[:PARAMETERS]
        return np.asarray(self._closed[1:] + (now.real**2 + now.imag**2).sum(axis=1))

    def clear(self) -> None:
        """Begin anew; the high-pass stays warm."""
        self._transform.clear()
        for sums in self._past:
            sums[:] = 0.0
        self._closed[:] = 0.0
        self.r2[:] = math.nan

    def add(self, sample: Array, since_start_s: float) -> None:
        """`sample` (CHANNELS,), all finite."""
        if self._transform.filtered == 0:
            self._from_s = since_start_s
        due = since_start_s >= self._warm_up_s and self._from_s <= since_start_s - self._warm_up_s + SLACK_S
        self._transform.step(sample, due)

    def fit(self, derivative: Array, ridge: Array) -> None:
        """Solve the three equations."""
        if (samples := self._transform.samples) == 0:
            return
        close = samples * self._dt >= 1.0 / self._step_hz
        share = samples * self._dt * self._step_hz
        past, fitted = self._plain
        fit_equations(self._transform.spectrum, derivative, ridge, share, close, past, fitted, self.r2)
        if close:
            self._closed[1:] = self.energy()
            self._closed[0] += samples
            self._closed *= self._keep
            for sums in self._past:
                sums *= self._keep
            self._transform.clear()


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
        """`imu_position`: m from the CG, body axes. `noise`: standard deviations of a frame's signals, SI."""
        g, i, boom = aircraft.geometry, aircraft.inertia, aircraft.boom
        inertias = [math.nan if inertia is None else inertia for inertia in (i.ixx, i.iyy, i.izz)]
        self._inertia = bool(np.isfinite(inertias).all())
        fixed = aircraft.reference_speed if aircraft.rate_reference == "fixed" else None
        place = (boom.vane_x, boom.vane_z) if boom else (0.0, 0.0)
        vane = inverse_terms(boom.vane_frequency, boom.vane_damping) if boom else (0.0, 0.0)
        self._constant = np.array([g.wing_area, g.span, *inertias, i.ixz, fixed or 0.0, *imu_position, *place, *vane])
        self._arm = place[0]
        self._dt = dt
        self._noise = np.array([noise.get(name, 0.0) or DEFAULT_NOISE[name] for name in REGRESSORS])
        self._half = 0.0  # b/2V
        self._minimum = MIN_PERIODS / card.low
        frequencies = grid(card.low, card.high, card.step)
        self._lines = len(frequencies)
        self._derivative = central_difference_factor(frequencies, dt)
        keep = math.exp(-1.0 / card.step / forgetting_s)
        self._spectra = tuple(Spectra(frequencies, dt, card.step, card.warm_up, keep) for _ in METHODS)
        self._known = {name: abs(aircraft.value(name)) for name in LATERAL}
        self._airframe = relative_errors(aircraft, LATERAL).reshape(2, len(EQUATIONS), PARAMETERS)
        self.mass_recorded = False
        self._history = np.full((3, _ROW), math.nan)
        self._row = np.zeros(_ROW)
        self._sides = np.zeros(CHANNELS)
        self._ring = np.zeros(RING)
        self._gusts = 0  # in the ring, one after the other
        self._ridge = np.zeros(PARAMETERS)
        self._run = 0
        self._last_ns = 0
        self._missing_s = dict.fromkeys(MEASURED, 0.0)

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
            self._missing_s[name] = 0.0 if good else self._missing_s[name] + self._dt
            whole = whole and good and frame.age_s[k] <= FRESH_AGE_S
            row[i] = value
        row[_V], row[_QBAR], row[_MASS], row[_BETA_I] = speed, pressure, mass, beta_inertial
        whole = whole and math.isfinite(speed + pressure + mass)
        follows = abs(frame.t_ns - self._last_ns - TICK_NS) < TICK_NS // 2
        self._last_ns = frame.t_ns
        if not (whole and follows):
            self._history[:] = math.nan
            self._run = self._gusts = 0
        if not whole:
            return
        self._run += 1
        self._half = self._constant[_B] / (2.0 * speed)
        made = sides(self._constant, self._history, self._dt, row, self._sides)
        if not made or self._run < SETTLED:
            return
        if not self._inertia:
            self._sides[PARAMETERS + 1 :] = 0.0
        steady, split = self._spectra
        steady.add(self._sides, since_start_s)
        inertial = float(self._history[1, _BETA_I])
        if not math.isfinite(inertial):
            self._gusts = 0
            return
        lag = self._arm / (speed * self._dt)
        gust = carried(self._ring, self._gusts, self._sides[0] - inertial, lag)
        self._gusts += 1
        if math.isfinite(gust):
            self._sides[0] = inertial + gust
            split.add(self._sides, since_start_s)

    def estimate(self) -> dict[str, tuple[ParamEstimate, ...]]:
        """By method, the fifteen derivatives from the spectra now, in the order of conventions.LATERAL."""
        steady, split = self._spectra
        blocked = [self._blocked(spectra) for spectra in (steady, split)]
        made = [self._solve(steady), self._solve(split)]
        apart = np.abs(steady.fitted.value - split.fitted.value) * np.isfinite(split.r2)[:, None]
        return {
            "II": self._judge(steady, blocked[0], *made[0], apart),
            "split": self._judge(split, blocked[1], *made[1], self._from_split(apart, split.energy())),
        }

    @staticmethod
    def _from_split(apart: Array, energy: Array) -> Array:
        """What a side gust wrongly carried does to split, from which II is `apart` (3, PARAMETERS): an error of the
        sideslip, of any phase, goes to sideslip, roll and yaw rate by the square root of their `energy`."""
        wrong = GUST_IN_MOTION * apart
        motions = energy[: len(MOTIONS)]
        wrong[:, : len(MOTIONS)] = wrong[:, :1] * np.sqrt(motions[0] / np.maximum(motions, 1e-30))
        return wrong

    def _solve(self, spectra: Spectra) -> tuple[list[str], Array]:
        """Fit; returns which surfaces have not moved, and the share of noise in each regressor, (PARAMETERS,). Those
        surfaces are left out: as regressors they would be noise alone."""
        moved = spectra.energy()
        unit = np.array([1.0, self._half, self._half, 1.0, 1.0])
        floor = self._lines * spectra.samples * (self._noise * unit) ** 2
        still = []
        for i, surface in enumerate(SURFACES, start=PARAMETERS - len(SURFACES)):
            if moved[i] < EXCITED * floor[i] or moved[i] == 0.0:
                still.append(surface)
            self._ridge[i] = 1e9 * max(moved[i], 1e-9) if surface in still else 0.0
        spectra.fit(self._derivative, self._ridge)
        return still, floor / np.maximum(moved, 1e-30)

    def _blocked(self, spectra: Spectra) -> tuple[Status, str]:
        """Why there are no estimates yet; ESTIMATED if there are."""
        if spectra.samples == 0:
            missing = [name for name, seconds in self._missing_s.items() if seconds > LACKING_S]
            if missing:
                return Status.UNESTIMATED, f"no {' and '.join(missing)}"
            if self._spectra[0].samples * self._dt > SLACK_S:
                return Status.INVALID, "no inertial sideslip: attitude or accelerations are missing"
            return Status.UNESTIMATED, "warming up"
        if spectra.samples * self._dt < self._minimum:
            return Status.UNESTIMATED, f"less than {self._minimum:g} s of data"
        return Status.ESTIMATED, ""

    def _judge(
        self, spectra: Spectra, blocked: tuple[Status, str], still: list[str], noise: Array, model: Array
    ) -> tuple[ParamEstimate, ...]:
        """`noise` (PARAMETERS,): its share in each regressor. `model` (3, PARAMETERS): standard deviations by the
        model's error."""
        if blocked[0] is Status.ESTIMATED and len(still) == len(SURFACES):
            blocked = Status.UNESTIMATED, "no aileron or rudder input"
        found: list[ParamEstimate] = []
        for e, equation in enumerate(EQUATIONS):
            names = LATERAL[PARAMETERS * e : PARAMETERS * (e + 1)]
            r2, refused = float(spectra.r2[e]), blocked
            if equation != "CY" and not self._inertia:
                r2, refused = math.nan, (Status.INVALID, "the aircraft profile gives no ixx, iyy and izz")
            elif math.isnan(r2) and blocked[0] is Status.ESTIMATED:
                refused = worded(UNSOLVED)
            elif blocked[0] is Status.ESTIMATED:
                refused = worded(of_equation(r2))
            if math.isnan(r2):
                found += [ParamEstimate(n, math.nan, math.nan, *refused) for n in names]
                continue
            of, is_estimated = spectra.fitted, refused[0] is Status.ESTIMATED
            doubt = np.hypot(model[e], self._airframe[int(self.mass_recorded), e] * of.value[e])
            share = np.where([n in still for n in SPOKEN], 0.0, noise * of.inflation[e])
            doubt = np.hypot(doubt, attenuation(of.inverse[e], share, of.value[e]))
            columns = [x.tolist() for x in (of.value[e], of.error[e], doubt, noise * of.inflation[e], of.inflation[e])]
            for name, regressor, value, error, wrong, lost, inflation in zip(names, SPOKEN, *columns, strict=True):
                sd, said, is_still = math.hypot(error, wrong), refused, regressor in still
                if is_estimated:
                    code = of_estimate(value, sd, self._known[name], inflation)
                    said = _said(code, regressor, is_still, lost > ATTENUATED)
                if is_still:
                    value = sd = math.nan
                found.append(ParamEstimate(name, value, sd, *said))
        return tuple(found)


@cache
def _said(code: int, regressor: str, is_still: bool, is_attenuated: bool) -> tuple[Status, str]:
    """The verdict on an estimate in words; attenuated: by noise in its regressor."""
    if is_still:
        return Status.UNESTIMATED, f"no {regressor} input"
    if is_attenuated:
        return Status.UNESTIMATED, f"attenuated: over {ATTENUATED:.0%} of {regressor} beyond the others is noise"
    return worded(code)

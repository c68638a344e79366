"""Lateral-directional equation error, live: CY, Cl and Cn on sideslip, rates, aileron and rudder.

    CY = CY_beta beta + CY_p p b/2V + CY_r r b/2V + CY_da da + CY_dr dr,   Cl and Cn alike

    II:          beta = vane/H_v - r x/V + p z/V
    split:       beta = beta_i + (that - beta_i) e^(-s x/V)
    split+gust:  split's, the fin meeting the gust later (side_gust.py), by what the surfaces make of the motion

with H_v the vane's own dynamics and x, z its place; sideslip has no upwash in the profile. beta_i is the inertial
sideslip: the rest is the side gust, which reaches the CG x/V after the vane. Both are made in the time domain: factors
of a transform that ends while the air still moves would err by what is cut off at its ends, and derivatives from gusts
alone by a fifth. The gusts' gradient across the span rolls and yaws the aircraft, and its answer misleads least squares
(input_instruments.py): II and split may be wrong by their distance from split+gust; II also by its distance from
split, and split by a tenth of that (attitude and mean wind are never quite known); split+gust by what another sidewash
than the profile's would make of it. Per radian, body axes, moments about the CG. The recursive transform (spectra.py)
and least squares with its standard errors (equation_error.py) are those of the longitudinal equations.

Source: Klein and Morelli 2006, equations 3.37 and 5.99-5.101 (coefficients), 10.6 (lever arm), section 11.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import FRESH_AGE_S, LATERAL, SIGNAL_INDEX, SIGNALS, TICK_NS
from station.estimation import input_instruments as instruments
from station.estimation.acceptance import EXCITED, MIN_PERIODS, UNSOLVED, of_equation, of_estimate, worded
from station.estimation.derivatives import SLACK_S
from station.estimation.equation_error import Fitted, nothing_fitted
from station.estimation.lateral_spectra import (
    CHANNELS,
    EQUATIONS,
    LATE,
    PARAMETERS,
    SURFACES,
    WASH,
    ByInput,
    Spectra,
)
from station.estimation.side_gust import SideGust
from station.model.airframe_error import relative_errors, roll_and_yaw_errors
from station.model.coefficients import roll_and_yaw_moment, specific_force_at_cg
from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.differentiation import central
from station.numerics.regression import attenuation
from station.numerics.second_order import inverse_terms
from station.numerics.spectra import central_difference_factor, grid
from station.profile import Aircraft, Card
from station.rows import Frame, ParamEstimate, Quality, Status

Array = NDArray[np.float64]

MEASURED: Final = ("beta_vane", "p", "r", "ay", "aileron", "rudder", "q")
"""Signals that must be of the frame's own time."""
MOTIONS: Final = {"beta": "sideslip", "p": "roll rate", "r": "yaw rate"}
SPOKEN: Final = (*MOTIONS.values(), *SURFACES)
"""The regressors in words."""
REGRESSORS: Final = ("beta_vane", "p", "r", "aileron", "rudder")
ATTENUATED: Final = 0.2
"""Share of noise in what a regressor has beyond the others, above which its derivative is noise's."""
LACKING_S: Final = 1.0
GUST_IN_MOTION: Final = 0.1
"""Share of the side gust that split may take for motion, or motion for it."""
SETTLED: Final = 3
"""Consecutive frames with all signals: the angular accelerations are central differences."""

METHODS: Final = ("II", "split", "split+gust")
NO_INERTIA: Final = "the aircraft profile gives no ixx, iyy and izz"
OF_SURFACES: Final = np.array([0.0, 0.0, 0.0, 1.0, 1.0])
MEAN_S: Final = 30.0
"""Over which airspeed, dynamic pressure and attitude are averaged."""
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
        self._dt = dt
        self._noise = np.array([noise.get(name, 0.0) or DEFAULT_NOISE[name] for name in REGRESSORS])
        self._minimum = MIN_PERIODS / card.low
        frequencies = grid(card.low, card.high, card.step)
        self._lines = len(frequencies)
        self._derivative = central_difference_factor(frequencies, dt)
        keep = math.exp(-1.0 / card.step / forgetting_s)
        self._gust = SideGust(aircraft, dt)
        self._sidewash = aircraft.uncertainty.sidewash
        by_input = ByInput(aircraft, frequencies, noise, self._gust.force) if self._inertia else None
        self._spectra = tuple(Spectra(frequencies, dt, card.step, card.warm_up, keep, b) for b in (None, by_input))
        self._state = np.zeros(4)
        """See input_instruments: means so far, of so many ticks."""
        self._averaged = 0
        self._known = {name: abs(aircraft.value(name)) for name in LATERAL}
        self._aircraft = aircraft
        self._shares = relative_errors(aircraft, LATERAL, of_inertia=False).reshape(2, len(EQUATIONS), PARAMETERS)
        self.mass_recorded = False
        self._history = np.full((3, _ROW), math.nan)
        self._row = np.zeros(_ROW)
        self._sides = np.zeros(CHANNELS)
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
            self._run = 0
            self._gust.restart()
        if not whole:
            return
        self._run += 1
        pitch = frame.values[SIGNAL_INDEX["theta"]]
        self._average(speed, pressure, pitch if math.isfinite(pitch) else 0.0)
        made = sides(self._constant, self._history, self._dt, row, self._sides)
        if not made or self._run < SETTLED:
            return
        if not self._inertia:
            self._sides[PARAMETERS + 1 :] = 0.0
        steady, split = self._spectra
        steady.add(self._sides, since_start_s)
        inertial = float(self._history[1, _BETA_I])
        if not math.isfinite(inertial):
            self._gust.restart()
            return
        gust, late, wash = self._gust.step(self._sides[0] - inertial, inertial, self._history[1, _R], speed)
        if math.isfinite(gust + late + wash):
            self._sides[0] = inertial + gust
            self._sides[LATE], self._sides[WASH] = late, wash
            split.add(self._sides, since_start_s)
            self._sides[LATE] = self._sides[WASH] = 0.0

    def _average(self, speed: float, pressure: float, pitch: float) -> None:
        self._averaged += 1
        share = max(self._dt / MEAN_S, 1.0 / self._averaged)
        now = np.array([speed, pressure, self._constant[_B] / (2.0 * speed), pitch])
        self._state += share * (now - self._state)

    def estimate(self) -> dict[str, tuple[ParamEstimate, ...]]:
        """By method, the fifteen derivatives from the spectra now, in the order of conventions.LATERAL."""
        steady, split = self._spectra
        blocked = [self._blocked(spectra) for spectra in (steady, split)]
        made = [self._solve(steady), self._solve(split)]
        apart = np.abs(steady.fitted.value - split.fitted.value) * np.isfinite(split.r2)[:, None]
        shown, r2 = nothing_fitted((len(EQUATIONS),), PARAMETERS), np.full(len(EQUATIONS), math.nan)
        by_sidewash = np.zeros_like(apart)
        if split.by_input:
            shown, r2 = split.by_input.fitted, split.by_input.r2
            by_sidewash = self._sidewash * np.abs(split.by_input.by_sidewash)
        models = apart, self._from_split(apart, split.energy())
        models = tuple(
            np.where(np.isfinite(r2)[:, None], np.sqrt(m**2 + (of.fitted.value - shown.value) ** 2 + shown.error**2), m)
            for m, of in zip(models, self._spectra, strict=True)
        )
        refused = blocked[1]
        if not self._inertia and refused[0] is Status.ESTIMATED:
            refused = Status.INVALID, NO_INERTIA
        still, noise = made[1]
        return {
            "II": self._judge(steady.fitted, steady.r2, blocked[0], *made[0], models[0]),
            "split": self._judge(split.fitted, split.r2, blocked[1], still, noise, models[1]),
            # Noise of the motion is not in its instruments; that of a surface is.
            "split+gust": self._judge(shown, r2, refused, still, noise * OF_SURFACES, by_sidewash, may_leave=True),
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
        unit = np.array([1.0, self._state[instruments.HALF], self._state[instruments.HALF], 1.0, 1.0])
        floor = self._lines * spectra.samples * (self._noise * unit) ** 2
        still = []
        for i, surface in enumerate(SURFACES, start=PARAMETERS - len(SURFACES)):
            if moved[i] < EXCITED * floor[i] or moved[i] == 0.0:
                still.append(surface)
            self._ridge[i] = 1e9 * max(moved[i], 1e-9) if surface in still else 0.0
        spectra.fit(self._derivative, self._ridge, self._state)
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
        self, of: Fitted, r2s: Array, blocked: tuple[Status, str], still: list[str], noise: Array, model: Array, *,
        may_leave: bool = False,
    ) -> tuple[ParamEstimate, ...]:  # fmt: skip
        """`noise` (PARAMETERS,): its share in each regressor. `model` (3, PARAMETERS): standard deviations by the
        model's error. `may_leave`: what else moves the aircraft, gusts across the span, is in no regressor, and the
        standard errors say what it costs: an equation may leave the most of it."""
        if blocked[0] is Status.ESTIMATED and len(still) == len(SURFACES):
            blocked = Status.UNESTIMATED, "no aileron or rudder input"
        found: list[ParamEstimate] = []
        airframe = self._shares[int(self.mass_recorded)] * of.value
        airframe[1:] = np.hypot(airframe[1:], roll_and_yaw_errors(self._aircraft, *of.value[1:]))
        for e, equation in enumerate(EQUATIONS):
            names = LATERAL[PARAMETERS * e : PARAMETERS * (e + 1)]
            r2, refused = float(r2s[e]), blocked
            if equation != "CY" and not self._inertia:
                r2, refused = math.nan, (Status.INVALID, NO_INERTIA)
            elif math.isnan(r2) and blocked[0] is Status.ESTIMATED:
                refused = worded(UNSOLVED)
            elif blocked[0] is Status.ESTIMATED and not may_leave:
                refused = worded(of_equation(r2))
            if math.isnan(r2):
                found += [ParamEstimate(n, math.nan, math.nan, *refused) for n in names]
                continue
            is_estimated = refused[0] is Status.ESTIMATED
            doubt = np.hypot(model[e], airframe[e])
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

"""Method `physical`: derivatives of wing, tail and gust by generalised least squares, live and from whole records.

Signals of physical_signals.py at every tick, through the same warm high-pass and recursive transform as the other
methods; the estimate of physical_fit.py at fixed samples of the transform, so that the same frames give the same bits.
Estimand: the quasi-steady (tabulated) derivatives, the same in calm and turbulent air. A long flight is cut into
segments whose normal equations are added. SI, radians, derivatives per radian with rates normalised as q c/2V.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from station.estimation.acceptance import (
    EXCITED,
    MIN_PERIODS,
    NO_INERTIA,
    STILL,
    UNSOLVED,
    WARMING,
    of_equation,
    of_estimate,
    worded,
)
from station.model import physical_fit, physical_posterior
from station.model.airframe_error import relative_errors
from station.model.physical_columns import CHANNELS, DE, QH, Segment
from station.model.physical_constants import CM_ALPHA, FIRST_NUISANCE, constants, why_not
from station.model.physical_signals import GC, SIGNALS, X
from station.model.quasi_steady import QuasiSteady, products, quasi_steady
from station.numerics.products import settled
from station.numerics.spectra import HIGH_PASS_HZ, HIGH_PASS_ORDER, Transform, central_difference_factor, grid
from station.profile import Aircraft, Card
from station.rows import MethodEstimate, ParamEstimate, Status

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

UPDATE_TICKS: Final = 25
"""Samples of the transform from one estimate to the next: 2 Hz."""
SEGMENT: Final = 1.2
"""Length of a segment, periods of the grid's step."""
MOST: Final = 700.0
"""Of an exponent."""
SLACK_S: Final = 4.0
"""Signals that come this much after the flight's start (inertial blending and unsteady lift settle) still open in
time."""


@dataclass(frozen=True, slots=True)
class Solution:
    """An estimate: physical_constants.DERIVATIVES, then NUISANCES."""

    theta: Array
    """(PARAMETERS,)"""
    stat: Array
    """(PARAMETERS,) standard errors if the profile's constants are right: repeatability."""
    total: Array
    """(PARAMETERS,) standard errors with the constants' own uncertainty, but that of mass and inertia."""
    r2: tuple[float, float]
    """Of CL and Cm over the lines of all segments."""
    gust: float
    """0 calm, 1 turbulent: how far the gust's spectrum stands out of the vane's noise."""
    covariance: Array
    """(PARAMETERS, PARAMETERS), of the whole errors."""
    segment: Segment
    """The newest: its speed, density and lines."""
    preference: float
    """Deviance of the quasi-steady model of split+gust less that of this one; positive: the data prefer this one."""


class Equations:
    """What turns spectra into a Solution; keeps the sums over closed segments."""

    def __init__(self, aircraft: Aircraft, frequencies_hz: Array, dt: float, noise: Mapping[str, float]) -> None:
        """`noise`: standard deviations of the sensors, SI."""
        self._omega = 2.0 * np.pi * frequencies_hz
        self._derivative = central_difference_factor(frequencies_hz, dt)
        self._constants = constants(aircraft, noise)
        body = aircraft.boom.upwash_body if aircraft.boom else 0.0
        self._noise = (noise["alpha_vane"] / (1.0 + body)) ** 2
        self._past = physical_posterior.no_sums()
        self._energies = np.zeros((2, 2))
        """Of the closed segments: of residuals and coefficients, CL and Cm."""
        self._preference = 0.0

    def clear(self) -> None:
        """Forget the closed segments."""
        for sums in (*self._past, self._energies):
            sums[:] = 0.0
        self._preference = 0.0

    def fade(self, keep: float) -> None:
        """Keep this share of the closed segments."""
        for sums in (*self._past, self._energies):
            sums *= keep
        self._preference *= keep

    def solve(
        self,
        spectrum: Complex,
        samples: float,
        share: float,
        speed: float,
        density: float,
        wind_sd: float,
        close: bool = False,
        moved: bool = True,
    ) -> Solution | None:
        """Estimate from the spectra (CHANNELS, frequencies) of `samples` ticks; None where there is no solution.

        `share`: T df, of independent lines; `speed`: mean, m/s; `density`: of the air, kg/m3; `wind_sd`: standard
        error of the mean wind, m/s; `close` adds the segment to those before; `moved`: the elevator did, without which
        a segment does not tell one model from another.
        """
        segment = Segment(
            spectrum,
            self._omega,
            self._derivative,
            independent=share,
            vane_noise=samples * self._noise,
            speed=speed,
            density=density,
            wind_sd=wind_sd / speed,
        )
        found = physical_posterior.nothing_found(len(self._omega))
        if not physical_fit.fit(segment, self._constants, self._past, close, found):
            return None
        energies = self._energies + np.array((found.residual, found.signal))
        residual, signal = energies.tolist()
        r2 = tuple(1.0 - a / b if b > 0.0 else 0.0 for a, b in zip(residual, signal, strict=True))
        gust, deviance, quasi_steady, complexity = found.summary.tolist()
        better = quasi_steady - deviance
        fits_better = self._preference + (better if moved and math.isfinite(better) else 0.0)
        # The constants are the same in all segments: what they cost counts once.
        preference = fits_better - (complexity if math.isfinite(complexity) else 0.0)
        if close:
            self._preference = fits_better
            self._energies = energies
        r2_both, covariance = (r2[0], r2[1]), found.covariance
        return Solution(found.theta, found.statistical, found.total, r2_both, gust, covariance, segment, preference)

    def quasi_steady(self, solution: Solution, measured: Complex) -> QuasiSteady:
        """Quasi-steady derivatives of a solution in a motion of those `products` (frequencies, 4, 4)."""
        return quasi_steady(solution.segment, self._constants, solution.theta, solution.covariance, measured)


def transform(x: Array, frequencies_hz: Array, dt: float, first: int) -> Complex:
    """Spectra (channels, frequencies) of `x` (channels, n) from sample `first` on, all of it through the high-pass.

    The batch counterpart of spectra.Transform.
    """
    sos = butter(HIGH_PASS_ORDER, HIGH_PASS_HZ, "highpass", fs=1.0 / dt, output="sos")
    start = settled(sos)[:, None, :] * x[None, :, 0, None]
    y = sosfilt(sos, x, axis=1, zi=start)[0][:, first:]
    return np.asarray(y @ np.exp(-2j * np.pi * dt * np.outer(np.arange(y.shape[1]), frequencies_hz)))


class Physical:
    """Streaming: samples in, an estimate at every UPDATE_TICKS-th of them."""

    def __init__(
        self,
        aircraft: Aircraft,
        card: Card,
        noise: Mapping[str, float],
        names: tuple[str, ...],
        dt: float,
        forgetting_s: float = math.inf,
    ) -> None:
        """`noise`: standard deviations of alpha_vane and elevator, rad. `names`: of the six derivatives."""
        self.lacking = ""
        """What it waits for, while that is not there."""
        self.banked = ""
        """Why samples are not taken now; "" where they are."""
        self.why_not = why_not(aircraft)
        """Why the method cannot be applied to this aircraft; "" if it can."""
        if not self.why_not and names[0].startswith("CZ"):
            self.why_not = "estimates wind-axes derivatives only"
        self._names = names
        self._dt = dt
        self._noise = noise
        self._warm_up_s = card.warm_up
        self._step_hz = card.step
        self._minimum = MIN_PERIODS / card.low
        self._frequencies = grid(card.low, card.high, card.step)
        self._transform = Transform(CHANNELS, self._frequencies, dt)
        self._segment = round(SEGMENT / card.step / dt)
        self._keep = math.exp(-self._segment * dt / forgetting_s)
        self._equations = None if self.why_not else Equations(aircraft, self._frequencies, dt, noise)
        self._has_inertia = aircraft.inertia.iyy is not None
        self._known = [abs(aircraft.value(n)) for n in names]
        self._airframe = relative_errors(aircraft, names)
        self.mass_recorded = False
        self.rival: Array | None = None
        """The derivatives (6,) of the quasi-steady model, split+gust's, where there are any."""
        self._row = np.zeros(CHANNELS)
        self._from_s = 0.0
        self._speed_sum = 0.0
        self._wind_sd = 0.0
        self._density = math.nan
        self._closed = 0
        self._moved = np.zeros((len(self._frequencies), 4, 4), dtype=np.complex128)
        """`products` of closed segments."""
        self.solution: Solution | None = None
        """The newest."""
        self._judged: tuple[tuple[ParamEstimate, ...], bool, str] | None = None
        """What `estimate` says until the next solution."""

    def clear(self) -> None:
        """Begin anew; the high-passes stay warm."""
        self._transform.clear()
        if self._equations:
            self._equations.clear()
        self._speed_sum = 0.0
        self._moved[:] = 0.0
        self._closed = 0
        self.solution = self._judged = None

    def turn(self, why: str) -> None:
        """From now on samples are not taken, being `banked`; with "" they are again. What was known before stays."""
        if why and self._transform.samples * self._dt >= self._minimum:
            self._renew(close=True)
        elif why:
            self._transform.clear()
            self._speed_sum = 0.0
            self.solution = self.solution if self._closed else None
        self.banked, self._judged = why, None

    @property
    def is_open(self) -> bool:
        """Whether there is a segment under way, through which an error of the mean wind must stay the same."""
        return self._transform.samples > 0.0

    def add(
        self, signals: Array, sides: Array, since_start_s: float, speed: float, density: float, wind_sd: float
    ) -> None:
        """One sample: `signals` (SIGNALS,) and, of the same tick, `sides`: q c/2V, elevator, CL, Cm.

        `speed`: inertial, m/s; `density`: of the air, averaged, kg/m3; `wind_sd`: standard error of the mean wind in
        the speed.
        """
        if self._equations is None:
            return
        self._row[:SIGNALS] = signals
        self._row[SIGNALS:] = sides
        if self._transform.filtered == 0:
            self._from_s = since_start_s
        if self.banked:
            self._transform.step(self._row, False)
            return
        is_open = since_start_s >= self._warm_up_s and self._from_s <= since_start_s - self._warm_up_s + SLACK_S
        self._transform.step(self._row, is_open)
        samples = int(self._transform.samples)
        if samples == 0:
            return
        if samples == 1:
            self._wind_sd = wind_sd
        self._speed_sum += speed
        self._density = density
        close = samples >= self._segment
        if close or not samples % UPDATE_TICKS:
            self._renew(close)

    def _renew(self, close: bool) -> None:
        """A solution of what there is; `close`: the segment under way joins those before."""
        if self._equations is None:
            return
        samples = int(self._transform.samples)
        spectrum = self._transform.spectrum
        share = samples * self._dt * self._step_hz
        mean_speed = self._speed_sum / samples
        moved = self._has_moved(self._motion(), samples)
        self.solution = self._equations.solve(
            spectrum, samples, share, mean_speed, self._density, self._wind_sd, close, moved
        )
        self._judged = None
        if close:
            self._moved = self._keep * (self._moved + self._motion())
            self._closed += samples
            self._equations.fade(self._keep)
            self._transform.clear()
            self._speed_sum = 0.0

    def _motion(self) -> Complex:
        """`products` of the segment under way."""
        return products(self._transform.spectrum[[X, QH, DE, GC]])

    def _has_moved(self, moved: Complex, samples: float) -> bool:
        """Whether the elevator's energy on the lines stands out of its noise."""
        noise = len(self._frequencies) * samples * self._noise["elevator"] ** 2
        return float(moved[:, 2, 2].real.sum()) >= EXCITED * noise

    def quasi_steady(self) -> tuple[ParamEstimate, ...]:
        """The newest solution's quasi-steady derivatives, with their acceptance; () where there is none."""
        if self.solution is None or self._equations is None or self._judged is None:
            return ()
        found = self._equations.quasi_steady(self.solution, self._moved + self._motion())
        judged = self._judged[0]
        errors = self._whole(self.solution, found.value, found.error).tolist()
        made = []
        for i, (name, value, error) in enumerate(zip(self._names, found.value.tolist(), errors, strict=True)):
            status, why = self._status()
            if status is Status.ESTIMATED:
                code = of_equation(self.solution.r2[i >= CM_ALPHA])
                status, why = worded(code or of_estimate(value, error, self._known[i], 0.0))
            if judged[i].status is Status.INVALID:
                status, why = judged[i].status, judged[i].why
            made.append(ParamEstimate(name, value, error, status, why))
        return tuple(made)

    def within_model(self) -> Array:
        """Standard errors (6,) of the newest solution's derivatives with what its constants may be wrong by, but
        without those of mass and inertia and the distance to another model; none where there is no solution."""
        return np.empty(0) if self.solution is None else self.solution.total[:FIRST_NUISANCE]

    def estimate(self, t_ns: int) -> MethodEstimate:
        """The newest solution as rows, with its acceptance."""
        if self._judged is None:
            self._judged = self._judge()
        return MethodEstimate(t_ns, "physical", *self._judged)

    def _whole(self, solution: Solution, values: Array, errors: Array) -> Array:
        """Standard errors (6,) of either definition with those of mass and inertia, and with the distance to the
        quasi-steady model, by the probability that the data give it: an aircraft without unsteady lift would have its
        derivatives, of both definitions."""
        square = errors**2 + (self._airframe[int(self.mass_recorded)] * values) ** 2
        if self.rival is not None:
            square += (self.rival - values) ** 2 / (1.0 + math.exp(min(0.5 * solution.preference, MOST)))
        return np.asarray(np.sqrt(square))

    def _judge(self) -> tuple[tuple[ParamEstimate, ...], bool, str]:
        status, why = self._status()
        solution = self.solution
        if solution is None:
            found = tuple(ParamEstimate(n, math.nan, math.nan, status, why) for n in self._names)
            refused = self.why_not or (why if why == self.banked else "")
            return found, not refused, refused
        values = solution.theta[:FIRST_NUISANCE].tolist()
        errors = self._whole(solution, solution.theta[:FIRST_NUISANCE], solution.total[:FIRST_NUISANCE]).tolist()
        parameters = []
        for i, name in enumerate(self._names):
            if i >= CM_ALPHA and not self._has_inertia:
                parameters.append(ParamEstimate(name, math.nan, math.nan, *worded(NO_INERTIA)))
                continue
            this, reason = status, why
            if status is Status.ESTIMATED:
                # Priors keep the regressors apart.
                code = of_equation(solution.r2[i >= CM_ALPHA])
                this, reason = worded(code or of_estimate(values[i], errors[i], self._known[i], 0.0))
            parameters.append(ParamEstimate(name, values[i], errors[i], this, reason))
        return tuple(parameters), True, ""

    def _status(self) -> tuple[Status, str]:
        """Why there are no estimates yet; ESTIMATED if there are."""
        if self.why_not:
            return Status.INVALID, self.why_not
        samples = self._closed + self._transform.samples
        if samples == 0 and self.banked:
            return Status.INVALID, self.banked
        if samples == 0:
            return (Status.UNESTIMATED, self.lacking) if self.lacking else worded(WARMING)
        if samples * self._dt < self._minimum:
            return Status.UNESTIMATED, f"less than {self._minimum:g} s of data"
        if not self._has_moved(self._moved + self._motion(), samples):
            return worded(STILL)
        if self.solution is None:
            return worded(UNSOLVED)
        return Status.ESTIMATED, ""

"""Transforms of the lateral signals, and the derivatives by them: least squares and, where the gust is split from the
motion, what the surfaces make of it (input_instruments.py). SI, rad."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation import input_instruments as instruments
from station.estimation.derivatives import SLACK_S
from station.estimation.equation_error import Fitted, Sums, fit, no_sums, nothing_fitted
from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.spectra import Transform
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

EQUATIONS: Final = ("CY", "Cl", "Cn")
SURFACES: Final = ("aileron", "rudder")
PARAMETERS: Final = 5
LATE: Final = PARAMETERS + len(EQUATIONS)
WASH: Final = LATE + 1
CHANNELS: Final = WASH + 1
"""What a transform holds: beta, p b/2V, r b/2V, aileron, rudder, CY, Cl, Cn, how much later the fin's beta is, and what
it has of that per unit of sidewash."""
RESPONSE_TICKS: Final = 50
"""Fits after which the response to the surfaces is computed anew."""


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


class ByInput:
    """What aileron and rudder make of the motion, and the derivatives by it."""

    def __init__(self, aircraft: Aircraft, frequencies: Array, noise: Mapping[str, float], force: Array) -> None:
        """`noise`: standard deviations, SI. `force` (3,): what the fin's late sideslip makes of CY, Cl and Cn. The
        aircraft has its inertias."""
        g, i = aircraft.geometry, aircraft.inertia
        self._body = np.array([i.mass, g.wing_area, g.span, i.ixx or math.nan, i.izz or math.nan, i.ixz])
        self._frequencies, self._force = frequencies, force
        self._turn = 2.0 * np.pi * frequencies
        self._sd = {name: noise.get(name, 0.0) or DEFAULT_NOISE[name] for name in ("beta_vane", "p", "r", "ay")}
        lines = len(frequencies)
        self._response = np.zeros((instruments.MOTIONS, len(SURFACES), lines), dtype=np.complex128)
        self._age = 0
        self._y = np.zeros((PARAMETERS, lines), dtype=np.complex128)
        self._z = np.zeros((len(EQUATIONS), lines), dtype=np.complex128)
        self._wash = np.zeros_like(self._z)
        self._past = instruments.no_sums()
        self.fitted = nothing_fitted((len(EQUATIONS),), PARAMETERS)
        """By equation."""
        self.r2 = np.full(len(EQUATIONS), math.nan)
        """NaN where there is no solution."""
        self.by_sidewash = np.zeros((len(EQUATIONS), PARAMETERS))
        """By how much a sidewash larger by 1 would move the derivatives."""
        self._plain: Any = (tuple(self._past), tuple(self.fitted))

    def clear(self) -> None:
        """Begin anew."""
        self.fade(0.0)
        self._age = 0
        self.r2[:] = math.nan

    def fade(self, keep: float) -> None:
        """Keep this share of the closed segments' sums."""
        for sums in self._past:
            sums *= keep

    def fit(
        self, spectrum: Complex, derivative: Array, state: Array, still: Array, theta: Array, samples: float,
        share: float, close: bool,
    ) -> None:  # fmt: skip
        """Solve; `state`: see input_instruments; `theta` (3, PARAMETERS): least squares' estimates; the rest as
        fit_equations and fit_by_input have it."""
        if self._age % RESPONSE_TICKS == 0 or close:
            instruments.respond(self._body, state, theta, self._frequencies, self._response)
        self._age += 1
        x, surfaces = spectrum[:PARAMETERS], spectrum[instruments.MOTIONS : PARAMETERS]
        self._y[: instruments.MOTIONS] = (self._response * surfaces).sum(axis=1)
        self._y[instruments.MOTIONS :] = surfaces
        self._z[0] = spectrum[PARAMETERS]
        self._z[1:] = spectrum[PARAMETERS + 1 : LATE] * derivative
        self._z -= self._force[:, None] * spectrum[LATE]
        np.multiply(self._force[:, None], spectrum[WASH], out=self._wash)
        gust = 1.0 / (1.0 + (4.0 / math.pi * 2.0 * state[instruments.HALF] * self._turn) ** 2)
        about = samples * self._noise(state, theta), gust, still, theta
        spectra = x, self._y, self._z, self._wash
        past, fitted = self._plain
        instruments.fit_by_input(spectra, about, share, close, past, fitted, self.by_sidewash, self.r2)

    def _noise(self, state: Array, theta: Array) -> Array:
        """Energy of a sample's noise in CY, Cl and Cn, (3, frequencies)."""
        body, sd = self._body, self._sd
        force = state[instruments.PRESSURE] * body[instruments.AREA]
        roll, yaw = self._turn * sd["p"], self._turn * sd["r"]
        ixx, izz, ixz = body[instruments.IXX], body[instruments.IZZ], body[instruments.IXZ]
        made = np.empty((len(EQUATIONS), len(self._turn)))
        made[0] = (body[instruments.MASS] * sd["ay"] / force) ** 2
        made[1] = ((ixx * roll) ** 2 + (ixz * yaw) ** 2) / (force * body[instruments.SPAN]) ** 2
        made[2] = ((izz * yaw) ** 2 + (ixz * roll) ** 2) / (force * body[instruments.SPAN]) ** 2
        made += ((theta[:, 0] * sd["beta_vane"]) ** 2)[:, None]
        return made


class Spectra:
    """A transform of the flight so far, and its fit; with `by_input` also that."""

    def __init__(
        self,
        frequencies: Array,
        dt: float,
        step_hz: float,
        warm_up_s: float,
        keep: float,
        by_input: ByInput | None = None,
    ) -> None:
        """`keep`: share of the closed segments' sums that is kept when the next one closes."""
        self.by_input = by_input
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
        if self.by_input:
            self.by_input.clear()

    def add(self, sample: Array, since_start_s: float) -> None:
        """`sample` (CHANNELS,), all finite."""
        if self._transform.filtered == 0:
            self._from_s = since_start_s
        due = since_start_s >= self._warm_up_s and self._from_s <= since_start_s - self._warm_up_s + SLACK_S
        self._transform.step(sample, due)

    def fit(self, derivative: Array, ridge: Array, state: Array) -> None:
        """Solve the three equations; `state`: see input_instruments."""
        if (samples := self._transform.samples) == 0:
            return
        close = samples * self._dt >= 1.0 / self._step_hz
        share = samples * self._dt * self._step_hz
        past, fitted = self._plain
        fit_equations(self._transform.spectrum, derivative, ridge, share, close, past, fitted, self.r2)
        if self.by_input and np.isfinite(self.r2).all():
            spectrum, still = self._transform.spectrum, (ridge > 0.0).astype(np.float64)
            self.by_input.fit(spectrum, derivative, state, still, self.fitted.value, samples, share, close)
        if close:
            self._closed[1:] = self.energy()
            self._closed[0] += samples
            self._closed *= self._keep
            for sums in self._past:
                sums *= self._keep
            if self.by_input:
                self.by_input.fade(self._keep)
            self._transform.clear()

"""Lag, place and upwash of a vane from manoeuvres, with the profile's upwash memory and vane dynamics.

    vane(t) = H [ (1 + k_body + slope dP) (a - q x/V) + k_wing F a ] (t - delay) + e(t)

a is the inertial angle of attack, dP the dynamic pressure less that of the steady parts, H the vane on its spring of
air, F the memory of the wing's upwash, fast part and slow; their constants have the priors of the profile. An aircraft
answers gusts, which are in e, so a and q are no fair regressors: their parts that the elevator made, its input through
the aircraft's slow and fast modes, are the instruments (two-stage least squares), and where nobody moves the elevator
against gusts the estimate is free of bias in any air. e is an autoregressive process, found along. SI, rad.

Sources: Ljung 1999, section 7.6 (instrumental variables); Söderström and Stoica 1983; physics of the upwash as in
station/simulation, written apart from it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfiltfilt

from station.model.vane_calibration import autoregression, whitened
from station.numerics.regression import NotIdentifiable
from station.numerics.second_order import shown
from station.profile import Aircraft, Boom, Indicial

Array = NDArray[np.float64]

BAND_HZ: Final = (0.15, 2.5)
"""Below, attitude and GNSS drift and gusts rule; above, no rigid aircraft follows its elevator."""
KEPT_HZ: Final = 5.0
"""Rate of what is compared: twice the band's end, so that the band fills all that there is of frequencies. An
autoregression flattens no spectrum that ends halfway: noise within the band would be told smaller than it is."""
LEAST_S: Final = 8.0
MARGIN_S: Final = 3.0
"""At either end, for the filters and the delay."""
MODES: Final = (1.0, 2.0, 3.5, 5.5, 9.0)
"""rad/s, of second-order filters with damping 0.7 that the elevator is put through: slow aircraft to fast."""
ROUNDS: Final = 8
NAMES: Final = ("delay", "vane_x", "upwash", "wing", "rate", "spread", "frequency", "damping", "upwash_slope")
"""Delay, s; place, m; steady upwash, and its slope, 1/kPa; the others relative to the profile: the wing's share, the
rate of its memory, by how much its fast part is faster and its slow one slower, frequency and damping of the vane."""
LARGEST_STEP: Final = (0.03, 1.0, 0.1, 0.3, 0.3, 0.3, 0.1, 0.2, 0.05)
DELAY_PRIOR_S: Final = 0.3
UPWASH_PRIOR: Final = 0.5
SLOPE_PRIOR: Final = 0.2
"""1/kPa: ten times what a boom bends by."""
WEAK: Final = 0.15
"""Share of the inertial angle's variance that the elevator must have made."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A manoeuvre: (n,) on a uniform grid, SI, all finite."""

    vane: Array
    alpha: Array
    """Inertial, at the CG."""
    q: Array
    speed: Array
    elevator: Array
    pressure: Array
    """Dynamic pressure less that which the upwash is told at, kPa. Slow inputs change the speed, and with it what a
    boom that bends shows of the mean angle of attack."""
    dt: float


@dataclass(frozen=True, slots=True)
class InMotion:
    """Estimates in the order of NAMES, and their covariance."""

    values: Array
    covariance: Array
    seconds: float
    forced: float
    """Share of the inertial angle's variance that the elevator made."""
    rms: float
    """Of what is left in the band, rad."""
    measured: tuple[Array, ...]
    """Of each stretch, the vane in the band at KEPT_HZ,"""
    expected: tuple[Array, ...]
    """and what the motion makes it show."""

    def value(self, name: str) -> float:
        return float(self.values[NAMES.index(name)])

    def sd(self, name: str) -> float:
        return math.sqrt(float(self.covariance[NAMES.index(name), NAMES.index(name)]))


def vane_in_motion(
    stretches: Sequence[Stretch],
    aircraft: Aircraft,
    place_sd: float,
    upwash: tuple[float, float] | None = None,
    slope: tuple[float, float] | None = None,
) -> InMotion:
    """`place_sd`: of the vane's place by the profile, m; `upwash` and `slope`: what the steady parts of the flight tell
    of them, and their standard deviations. Raises NotIdentifiable without manoeuvres that move the angle of attack by
    the elevator, and for samples too slow."""
    usable = [s for s in stretches if len(s.vane) * s.dt > LEAST_S + 2 * MARGIN_S]
    boom = aircraft.boom
    if boom is None:
        raise NotIdentifiable("the profile has no boom")
    if not usable:
        raise NotIdentifiable("no dynamic input: fly elevator doublets, 3-2-1-1 or multisines")
    if any(s.dt * KEPT_HZ >= 1 for s in usable):
        raise NotIdentifiable(f"recorded at {KEPT_HZ:g} Hz or less: the vane's lag needs faster samples")
    fit = _Fit(usable, aircraft, boom, place_sd, upwash, slope)
    if fit.forced < WEAK:
        raise NotIdentifiable(
            f"the elevator made {fit.forced:.0%} of the angle of attack's motion: fly larger inputs, in calmer air"
        )
    return fit.solve()


@lru_cache(maxsize=16)
def _band(dt: float) -> Array:
    """Second-order sections of BAND_HZ."""
    return np.asarray(butter(2, BAND_HZ, "bandpass", fs=1 / dt, output="sos"))


class _Fit:
    def __init__(
        self,
        stretches: Sequence[Stretch],
        aircraft: Aircraft,
        boom: Boom,
        place_sd: float,
        steady: tuple[float, float] | None,
        slope: tuple[float, float] | None,
    ) -> None:
        self.stretches, self.boom = stretches, boom
        u, known = aircraft.unsteady, aircraft.uncertainty
        self.memory: Indicial | None = u.upwash_motion
        self.chord = u.reference_chord or aircraft.geometry.chord
        upwash, upwash_sd = steady or (boom.upwash_body + boom.upwash_wing, UPWASH_PRIOR)
        bends, bends_sd = slope or (0.0, SLOPE_PRIOR)
        self.start = np.array([0.0, boom.vane_x, upwash, 1.0, 1.0, 1.0, 1.0, 1.0, bends])
        priors = (
            DELAY_PRIOR_S, place_sd, upwash_sd, known.upwash_wing, known.upwash_rate, known.upwash_rate,
            known.vane_frequency, known.vane_damping, bends_sd,
        )  # fmt: skip
        self.precision = np.diag(np.maximum(priors, 1e-4) ** -2.0)
        self.forcing = [self._forced(s) for s in stretches]
        alpha = np.concatenate([self._kept(s, s.alpha) for s in stretches])
        made = np.concatenate([self._kept(s, f.alpha) for s, f in zip(stretches, self.forcing, strict=True)])
        self.forced = 1 - float(np.var(alpha - made) / max(float(np.var(alpha)), 1e-12))

    def _forced(self, s: Stretch) -> Stretch:
        """As flown, but of angle of attack, pitch rate and dynamic pressure their means and what the elevator made."""
        columns = [s.elevator - s.elevator[0]]
        for omega in MODES:
            low = shown(columns[0], omega / (2 * math.pi), 0.7, s.dt)
            columns += [low, np.gradient(low, s.dt)]
        x = np.column_stack(columns)
        kept = np.column_stack([self._kept(s, c) for c in x.T])

        def made(y: Array) -> Array:
            found = np.linalg.lstsq(kept, self._kept(s, y))[0]
            return np.asarray(y.mean() + (x - x.mean(axis=0)) @ found)

        return replace(s, alpha=made(s.alpha), q=made(s.q), pressure=made(s.pressure))

    @staticmethod
    def _kept(s: Stretch, x: Array) -> Array:
        """The band at KEPT_HZ, without the ends."""
        band = sosfiltfilt(_band(s.dt), x - x.mean())
        step, margin = max(1, round(1 / (KEPT_HZ * s.dt))), round(MARGIN_S / s.dt)
        return np.asarray(band[margin : len(x) - margin : step])

    def predicted(self, s: Stretch, x: Array) -> Array:
        """What the vane shows of a motion, in the band."""
        delay, place, upwash, share, rate, spread, frequency, damping, slope = x
        wing = self.boom.upwash_wing * share
        body = 1 + upwash + slope * s.pressure - wing
        late = self._remembered(s.alpha, float(s.speed.mean()), rate, spread, s.dt)
        flow = body * (s.alpha - place * s.q / s.speed) + wing * late
        seen = shown(flow, self.boom.vane_frequency * frequency, max(self.boom.vane_damping * damping, 0.05), s.dt)
        t = np.arange(len(seen)) * s.dt
        return self._kept(s, CubicSpline(t, seen)(np.clip(t - delay, 0.0, t[-1])))

    def _remembered(self, alpha: Array, speed: float, rate: float, spread: float, dt: float) -> Array:
        """The wing's upwash for one of upwash_wing 1."""
        made = alpha.copy()
        if self.memory is None:
            return made
        b = np.array(self.memory.b)
        faster = np.sign(b - b.mean()) if len(b) > 1 else np.zeros(1)
        rates = max(rate, 0.05) * max(spread, 0.05) ** faster * b * speed / self.chord
        for a, falls in zip(self.memory.a, rates.tolist(), strict=True):
            fall = math.exp(-falls * dt)
            late = lfilter([0.5 * (1 - fall), 0.5 * (1 - fall)], [1.0, -fall], alpha - alpha[0]) + alpha[0]
            made += a * (late - alpha)
        return made

    def _slopes(self, s: Stretch, x: Array) -> Array:
        steps = np.array([1e-3, 0.01, 0.01, 0.02, 0.02, 0.02, 0.02, 0.02, 0.01])
        columns = []
        for i, h in enumerate(steps):
            up, down = x.copy(), x.copy()
            up[i], down[i] = x[i] + h, x[i] - h
            columns.append((self.predicted(s, up) - self.predicted(s, down)) / (2 * h))
        return np.column_stack(columns)

    def solve(self) -> InMotion:
        x, whitener = self.start.copy(), np.array([1.0])
        measured = [self._kept(s, s.vane) for s in self.stretches]
        for _ in range(ROUNDS):
            expected = [self.predicted(s, x) for s in self.stretches]
            left = [m - e for m, e in zip(measured, expected, strict=True)]
            whitener = autoregression(np.concatenate(left))
            e = np.concatenate([whitened(r, whitener) for r in left])
            j = np.vstack([whitened(self._slopes(s, x), whitener) for s in self.stretches])
            z = np.vstack([whitened(self._slopes(s, x), whitener) for s in self.forcing])
            variance = float(np.mean(e**2)) * len(e) / max(len(e) - len(x) - len(whitener), 1)
            information = z.T @ j / variance + self.precision
            score = z.T @ e / variance - self.precision @ (x - self.start)
            x = x + np.clip(np.linalg.solve(information, score), -np.array(LARGEST_STEP), LARGEST_STEP)
        inverse = np.linalg.inv(information)
        spread = inverse @ (z.T @ z / variance + self.precision) @ inverse.T
        rms = float(np.sqrt(np.mean(np.concatenate(left) ** 2)))
        seconds = sum(len(s.vane) * s.dt for s in self.stretches)
        return InMotion(x, 0.5 * (spread + spread.T), seconds, self.forced, rms, tuple(measured), tuple(expected))

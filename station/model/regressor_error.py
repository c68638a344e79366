"""What wrong regressors do to the estimates of split+gust: a mean wind known from a minute, the vane's place, delay and
scale as well as the profile knows them, and noise.

Of a regression z = X theta on regressors that are wrong by dX, the estimates are biased by -M^-1 Re(X^H dX theta),
which the residuals do not show. By a share e of the speed

    the mean wind is wrong: the inertial angle of attack has an error of e (alpha_i - pitch); the gust, read from the
    vane
        less the motion, makes up for it, but comes x/V later: d alpha = e (1 - e^{-s x/V}) (alpha_i - pitch)
    the gusts' u has a mean over the record: what it takes from alpha_i is read as a gust, and carried x/V; and gusts
        travel at another speed than the airspeed: d alpha = e (1 - e^{-s x/V}) alpha_i + e s (x/V) g

    a vane behind the CG, or near it and slow, shows gusts when they have passed, t = the vane's lag - x/V too late:
        d alpha = g (1 - e^{s t}), with g as the vane has it; wholly, whatever the wind

and d alike. The first two have the standard error of a mean wind over that time, and are taken as independent. With the
flow at the boom, c = alpha_i - q x/V + g e^{s x/V}, a vane

    whose scale is wrong by e, that is late by t or whose gust arrival offset is wrong by t, makes
        d alpha = e^{-s x/V} (e c, -t s c, t (q - s g e^{s x/V})),

d alike again; the profile's `[uncertainty]` has the three standard deviations. White noise of vane, pitch rate and
elevator, of known size, adds its own energy to M, not to X^H z. SI, rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.numerics.second_order import vane_lag
from station.numerics.spectra import carry
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PITCH, GUST, MOTION_A, MOTION_D, GUST_A, GUST_D, SEEN, SEEN_Q, SCALE, LATE, ARRIVAL_Q, ARRIVAL_G, SINCE, MISSED = range(
    14
)
ROWS: Final = 14
"""Of `weights`: pitch for a unit of q c/2V; g for one of d; errors of alpha and d for one of a motion that is carried
with the gust, and for one of g that travels at another speed; c e^{-s x/V} for a unit of motion and of q c/2V, what
the vane's scale and delay make of it, and its gust arrival offset of q c/2V and g, each by its standard deviation; d
for one of g; errors of alpha and d for one of a gust that is seen too late."""
CAUSES: Final = 6
"""Mean wind, u, the vane's scale, delay and gust arrival offset, and gusts seen too late."""
SUMS: Final = (2 * CAUSES, 4)
"""Over closed segments: errors of alpha and d by each cause, times each of four regressors."""
WIND_CAUSES: Final = 2
"""The first of them, whose size is that of a mean wind."""
MINUTE: Final = 60.0
"""s: mean winds of times so far apart err independently."""


class Lengths(NamedTuple):
    """What `weights` depend on of an aircraft."""

    half_chord: float
    ahead: float
    """How far ahead of the CG the vane meets gusts, m."""
    tail_arm: float
    vane_lag: float
    """s"""


class Deviations(NamedTuple):
    """Standard deviations that `weights` depend on, SI."""

    vane: float
    """Noise behind the body's upwash."""
    q: float
    elevator: float
    scale: float
    """Of the vane's calibration, as the next two; a share."""
    delay: float
    """s"""
    arrival: float
    """Of the gust arrival offset, s."""


class Weights(NamedTuple):
    """What `weights` fills."""

    errors: Complex
    """(ROWS, frequencies)"""
    noise: Array
    """Energy of a sample's noise in the regressors, on all lines, (4, 4)."""


def lengths(aircraft: Aircraft) -> Lengths:
    """As the profile has them."""
    boom = aircraft.boom
    ahead, lag = (boom.gust_x, vane_lag(boom.vane_frequency, boom.vane_damping)) if boom else (0.0, 0.0)
    return Lengths(aircraft.geometry.chord / 2, ahead, aircraft.unsteady.tail_arm, lag)


def deviations(aircraft: Aircraft, noise: Mapping[str, float]) -> Deviations:
    """Of the sensors' `noise`, and of what the profile knows of the vane."""
    body = aircraft.boom.upwash_body if aircraft.boom else 0.0
    known = aircraft.uncertainty
    vane = (known.vane_scale, known.vane_delay, known.vane_x) if aircraft.boom else (0.0, 0.0, 0.0)
    return Deviations(noise["alpha_vane"] / (1.0 + body), noise["q"], noise["elevator"], *vane)


@register_jitable
def no_weights(lines: int) -> Weights:
    """To be filled."""
    return Weights(np.zeros((ROWS, lines), dtype=np.complex128), np.zeros((4, 4)))


@njit(cache=True, error_model="numpy")
def weights(about: Lengths, speed: float, frequencies: Array, sd: Deviations, made: Weights) -> None:
    """At a mean airspeed (m/s) and frequencies (Hz) -> `made`."""
    half, arm = about.half_chord, about.tail_arm
    offset, late = max(about.ahead, 0.0), max(about.vane_lag - about.ahead / speed, 0.0)
    wrong, noise = made
    noise[:] = 0.0
    for i in range(frequencies.shape[0]):
        s = 2j * math.pi * frequencies[i]
        to_tail = np.exp(-s * arm / speed)
        early = np.exp(-s * offset / speed)
        wrong[PITCH, i] = speed / (half * s)
        wrong[GUST, i] = 1.0 / (1.0 - to_tail) if arm > 0.0 else 0.0
        wrong[MOTION_A, i], wrong[MOTION_D, i] = 1.0 - early, -early * (1.0 - to_tail)
        wrong[GUST_A, i] = s * offset / speed
        wrong[GUST_D, i] = wrong[GUST_A, i] * (1.0 - to_tail) - s * arm / speed * to_tail
        wrong[SEEN, i], wrong[SEEN_Q, i], wrong[SINCE, i] = early, -early * offset / half, 1.0 - to_tail
        wrong[SCALE, i], wrong[LATE, i] = sd.scale, -sd.delay * s
        wrong[ARRIVAL_Q, i], wrong[ARRIVAL_G, i] = sd.arrival * early * speed / half, -sd.arrival * s
        wrong[MISSED, i] = 1.0 - np.exp(s * late)
        step = 1.0 - to_tail.real
        noise[0, 0] += sd.vane**2
        noise[0, 3] += sd.vane**2 * step
        noise[3, 3] += 2.0 * sd.vane**2 * step
        noise[1, 1] += (sd.q * half / speed) ** 2
        noise[2, 2] += sd.elevator**2
    noise[3, 0] = noise[0, 3]


@njit(cache=True, error_model="numpy")
def _products(wrong: Complex, x: Complex, sums: Array) -> None:
    """Errors of alpha and d by each cause times each regressor of `x` (4, frequencies) -> `sums` (SUMS)."""
    for f in range(x.shape[1]):
        gust = wrong[GUST, f] * x[3, f]
        motion = x[0, f] - gust
        path = motion - wrong[PITCH, f] * x[1, f]
        seen = wrong[SEEN, f] * motion + wrong[SEEN_Q, f] * x[1, f] + gust
        arrival = wrong[ARRIVAL_Q, f] * x[1, f] + wrong[ARRIVAL_G, f] * gust
        errors = (
            wrong[MOTION_A, f] * path,
            wrong[MOTION_D, f] * path,
            wrong[MOTION_A, f] * motion + wrong[GUST_A, f] * gust,
            wrong[MOTION_D, f] * motion + wrong[GUST_D, f] * gust,
            wrong[SCALE, f] * seen,
            wrong[SCALE, f] * seen * wrong[SINCE, f],
            wrong[LATE, f] * seen,
            wrong[LATE, f] * seen * wrong[SINCE, f],
            arrival,
            arrival * wrong[SINCE, f],
            wrong[MISSED, f] * gust,
            wrong[MISSED, f] * x[3, f],
        )
        for k, error in enumerate(errors):
            for i in range(4):
                sums[k, i] += x[i, f].real * error.real + x[i, f].imag * error.imag


@njit(cache=True, error_model="numpy")
def standard_deviations(
    made: Weights, samples: float, wind: float, x: Complex, theta: Array, inverse: Array, past: Array, close: bool
) -> Array:
    """Of the estimates of both equations, `theta` (2, 4), by wrong regressors, (2, 3).

    `samples`: of all segments; `wind`: standard deviation of the mean wind, share of the speed. `inverse` (4, 4): of
    the normal matrix of `x` (4, frequencies): alpha, q c/2V, elevator, d. `past` (SUMS): sums over closed segments,
    which `close` adds this one to.
    """
    sums, out = np.zeros(SUMS), np.empty((2, 3))
    _products(made.errors, x, sums)
    for k in range(2 * CAUSES):
        carry(past[k], sums[k], close)
    for e in range(2):
        for j in range(3):
            noisy = 0.0
            for i in range(4):
                for k in range(4):
                    noisy += inverse[j, i] * made.noise[i, k] * theta[e, k]
            square = (samples * noisy) ** 2
            for cause in range(CAUSES):
                by = 0.0
                for i in range(4):
                    by += inverse[j, i] * (theta[e, 0] * sums[2 * cause, i] + theta[e, 3] * sums[2 * cause + 1, i])
                square += (by * wind) ** 2 if cause < WIND_CAUSES else by * by
            out[e, j] = math.sqrt(square)
    return out


@njit(cache=True, error_model="numpy")
def wind_share(sd: float, speed: float, seconds: float) -> float:
    """Standard deviation of the mean wind of a record of so many seconds, as a share of the speed, from its standard
    error over a minute, m/s."""
    return sd / speed / math.sqrt(max(seconds / MINUTE, 1.0))

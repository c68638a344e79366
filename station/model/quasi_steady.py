"""Quasi-steady derivatives of a fitted model with unsteady lift and late tail: what equation error with a perfect angle
of attack gives of the same manoeuvre in calm air.

The short period with that lift, driven by the record's own elevator,

    s alpha = q - qbar S/(m V) CL,    s q = qbar S c/Iyy Cm,

has a response of alpha, q, CL and Cm at every line. CL and Cm by least squares on alpha, q c/2V and elevator over the
lines, each with the elevator's energy there, are the quasi-steady derivatives; their errors follow from the model's
covariance. In calm air alpha and q are those measured, which do not depend on the model; the distance to what the
model's own alpha and q give is counted as an error. CL and Cm are physical_columns.py's without gusts. SI, per radian.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.model.physical_columns import (
    CHANNELS,
    DE,
    QH,
    Columns,
    Segment,
    columns,
    design,
    no_columns,
)
from station.model.physical_constants import FIRST_NUISANCE, PARAMETERS, Constants
from station.model.physical_signals import DW, DX, WX, X
from station.numerics.indicial import frequency_response

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

INPUTS: Final = (X, QH, DE)
"""Channels that drive lift and moment in calm air."""
CALM: Final = 0.05
"""Share of gusts in the angle of attack's energy from which the measured motion is no longer taken for the elevator's
doing. Gusts of a share s move a derivative by about s times the distance between the two definitions: a twentieth of it
is less than any error."""
STEP: Final = 1e-3
"""Of a parameter in its standard deviations, for the derivatives by it."""
TINY: Final = 1e-30


class QuasiSteady(NamedTuple):
    """The six derivatives, in the order of physical_constants.DERIVATIVES."""

    value: Array
    """(6,)"""
    error: Array
    """Standard errors, (6,)."""


@njit(cache=True, error_model="numpy")
def _transfers(segment: Segment, con: Constants, theta: Array, made: Complex) -> None:
    """CL and Cm by angle of attack, q c/2V and elevator at every line, `made` (2, 3, frequencies), without gusts."""
    omega = segment.omega
    lines = omega.shape[0]
    spectra, wing, spans, tails, freed, base = no_columns(1, lines)
    slopes = np.empty((2, PARAMETERS), dtype=np.complex128)
    rest = np.empty(2, dtype=np.complex128)
    none = np.zeros(lines)
    for k in range(3):
        f = spectra[0]
        f[:] = 0.0
        for i in range(lines):
            s = 1j * omega[i]
            if k == 0:
                washed = np.exp(-s * (con.tail_arm / segment.speed + con.downwash_delay))
                f[X, i] = 1.0
                f[WX, i] = frequency_response(con.lift_motion, s * con.reference_chord / segment.speed)
                f[DW, i] = washed * f[WX, i]
                f[DX, i] = washed
            else:
                f[INPUTS[k], i] = 1.0
        of = Columns(f, wing[0], spans[0], tails[0], freed[0], base[0], 1)
        columns(segment, con, none, of)
        for i in range(lines):
            design(of, i, 1.0, con, theta, slopes, rest)
            made[0, k, i] = -rest[0]
            made[1, k, i] = -rest[1]


def _of_elevator(segment: Segment, con: Constants, h: Complex, energy: Array) -> Complex:
    """`products` where the short period with the transfers `h` (2, 3, frequencies) follows an elevator of that `energy`
    (frequencies,)."""
    s, v = 1j * segment.omega, segment.speed
    lift = segment.density * v / con.per_az
    """qbar S/(m V)"""
    moment = segment.density * v * v / con.per_qdot
    half = con.half_chord / v
    # [s + L h_a, -1 + L h_q c/2V; -M m_a, s - M m_q c/2V] (alpha, q) = (-L h_de, M m_de), line by line.
    a, b = s + lift * h[0, 0], -1.0 + lift * h[0, 1] * half
    c, d = -moment * h[1, 0], s - moment * h[1, 1] * half
    right = -lift * h[0, 2], moment * h[1, 2]
    determinant = a * d - b * c
    alpha = (d * right[0] - b * right[1]) / determinant
    qhat = (a * right[1] - c * right[0]) / determinant * half
    return np.asarray(products(np.stack([alpha, qhat, np.ones_like(alpha)])) * energy[:, None, None])


def products(motion: Complex) -> Complex:
    """Of spectra of alpha, q c/2V, elevator and gust (channels, frequencies): conj(x_i) x_j on every line,
    (frequencies, channels, channels)."""
    return np.asarray(np.einsum("il,jl->lij", motion.conj(), motion))


def of_elevator(
    con: Constants, derivatives: Array, frequencies_hz: Array, speed: float, density: float, energy: Array
) -> Array:
    """The six quasi-steady derivatives, (6,), of an aircraft with `derivatives` (6,) of its own, in the motion that an
    elevator of that `energy` (frequencies,) makes of it in calm air. `speed` m/s, `density` kg/m3."""
    lines = len(frequencies_hz)
    none, theta = np.zeros((CHANNELS, lines), dtype=np.complex128), np.zeros(PARAMETERS)
    theta[:FIRST_NUISANCE] = derivatives
    omega, ones = 2 * np.pi * frequencies_hz, np.ones(lines)
    segment = Segment(none, omega, ones, independent=1.0, vane_noise=1.0, speed=speed, density=density, wind_sd=0.0)
    h = np.empty((2, 3, lines), dtype=np.complex128)
    _transfers(segment, con, theta, h)
    return _least_squares(h, _of_elevator(segment, con, h, energy))


def _least_squares(h: Complex, moved: Complex) -> Array:
    """The six derivatives, (6,), of the transfers `h` (2, 3, frequencies) in a motion of those products."""
    # CL conj(x_i) = sum over j of h_j conj(x_i) x_j.
    sides = np.einsum("ejl,lij->ie", h, moved).real
    return np.asarray(np.linalg.lstsq(moved.sum(axis=0).real, sides, rcond=None)[0].T.ravel())


def quasi_steady(segment: Segment, con: Constants, theta: Array, covariance: Array, measured: Complex) -> QuasiSteady:
    """Of the model fitted to a flight.

    `segment`: its lines, mean speed and density; `theta` (PARAMETERS,) with its `covariance`; `measured`
    (frequencies, 4, 4): `products` of inertial angle of attack, q c/2V, elevator and the gust at the CG.
    """
    if not con.has_moment:
        return QuasiSteady(np.full(FIRST_NUISANCE, np.nan), np.full(FIRST_NUISANCE, np.nan))
    moved, gust = measured[:, :3, :3], float(measured[:, 3, 3].real.sum())
    energy = moved[:, 2, 2].real
    share = gust / max(gust + float(moved[:, 0, 0].real.sum()), TINY)
    calm = max(1.0 - share / CALM, 0.0)

    def of(theta: Array) -> tuple[Array, Array]:
        """By the model's motion, and how far the one measured moves it in calm air."""
        h = np.empty((2, 3, len(segment.omega)), dtype=np.complex128)
        _transfers(segment, con, theta, h)
        modelled = _least_squares(h, _of_elevator(segment, con, h, energy))
        return modelled, calm * (_least_squares(h, moved) - modelled) if calm else np.zeros(FIRST_NUISANCE)

    modelled, apart = of(theta)
    value = modelled + apart
    slopes = np.zeros((FIRST_NUISANCE, PARAMETERS))
    for j, variance in enumerate(np.diag(covariance).tolist()):
        if variance > 0.0:
            other = theta.copy()
            other[j] += STEP * variance**0.5
            slopes[:, j] = (np.sum(of(other), axis=0) - value) / (STEP * variance**0.5)
    error = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0) + apart**2)
    return QuasiSteady(value, error)

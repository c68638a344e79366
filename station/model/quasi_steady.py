"""Quasi-steady derivatives of a fitted model with unsteady lift and late tail: what equation error with a perfect angle
of attack gives of the same manoeuvre in calm air.

The short period with that lift, driven by the record's own elevator,

    s alpha = q - qbar S/(m V) CL,    s q = qbar S c/Iyy Cm,

has a response of alpha, q, CL and Cm at every line. CL and Cm by least squares on alpha, q c/2V and elevator over the
lines, each with the elevator's energy there, are the quasi-steady derivatives; their errors follow from the model's
covariance. CL and Cm are physical_columns.py's without gusts. SI, per radian.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.model.physical_columns import (
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
STEP: Final = 1e-3
"""Of a parameter in its standard deviations, for the derivatives by it."""


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
    spectra, wing, spans, tails, base = no_columns(1, lines)
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
        of = Columns(f, wing[0], spans[0], tails[0], base[0], 1)
        columns(segment, con, none, of)
        for i in range(lines):
            design(of, i, 1.0, con, theta, slopes, rest)
            made[0, k, i] = -rest[0]
            made[1, k, i] = -rest[1]


def _projected(segment: Segment, con: Constants, theta: Array, energy: Array) -> Array:
    """The six derivatives, (6,), of the model `theta` (PARAMETERS,) on an elevator of that `energy` (frequencies,)."""
    h = np.empty((2, 3, len(segment.omega)), dtype=np.complex128)
    _transfers(segment, con, theta, h)
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
    drive = np.sqrt(energy)
    x = np.stack([alpha, qhat, np.ones_like(alpha)], axis=1)
    y = np.stack([h[e, 0] * alpha + h[e, 1] * qhat + h[e, 2] for e in range(2)], axis=1)
    rows = np.concatenate([(x * drive[:, None]).real, (x * drive[:, None]).imag])
    sides = np.concatenate([(y * drive[:, None]).real, (y * drive[:, None]).imag])
    found: Array = np.linalg.lstsq(rows, sides, rcond=None)[0].T.ravel()
    return found


def quasi_steady(segment: Segment, con: Constants, theta: Array, covariance: Array, energy: Array) -> QuasiSteady:
    """Of the model fitted to a flight.

    `segment`: its lines, mean speed and density; `theta` (PARAMETERS,) with its `covariance`; `energy` (frequencies,):
    of the elevator on every line.
    """
    if not con.has_moment:
        return QuasiSteady(np.full(FIRST_NUISANCE, np.nan), np.full(FIRST_NUISANCE, np.nan))
    value = _projected(segment, con, theta, energy)
    slopes = np.zeros((FIRST_NUISANCE, PARAMETERS))
    for j, variance in enumerate(np.diag(covariance).tolist()):
        if variance > 0.0:
            moved = theta.copy()
            moved[j] += STEP * variance**0.5
            slopes[:, j] = (_projected(segment, con, moved, energy) - value) / (STEP * variance**0.5)
    error = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0))
    return QuasiSteady(value, error)

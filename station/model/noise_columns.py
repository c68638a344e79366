"""Columns of method `physical` (physical_columns.py) of the measured spectra, and of the noise that is in them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.model.physical_columns import CHANNELS, CL, CM, DE, QH, Columns, Segment, columns, no_columns
from station.model.physical_constants import AZ, RATE, SOURCES, THETA, V_DOWN, Constants
from station.model.physical_signals import CORNERS, DK, DW, DX, FREED, GC, GT, KG, LAGGED, WX, X
from station.numerics.indicial import frequency_response

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ATTITUDE_S: Final = 0.5
"""Over which the inertial angle of attack is drawn to the attitude's stream."""
BLEND_HZ: Final = 0.05
"""Below which it is drawn to the velocity's."""
EVERY: Final = 4
"""Lines from one to the next at which the noise of the sensors is evaluated: it is smooth."""


@njit(cache=True, error_model="numpy")
def noise_spectrum(source: int, segment: Segment, con: Constants, every: int, f: Complex) -> None:
    """What a unit of white noise of one of SOURCES puts into every channel, `f` (CHANNELS, frequencies), at every
    so-many-th line.

    The inertial angle of attack has it from attitude (drawn to its stream in 0.5 s), pitch rate, az and velocity (drawn
    below 0.05 Hz), as inertial.py blends them; the gust has what the vane is predicted from it.
    """
    speed, omega = segment.speed, segment.omega
    corner = 2.0 * math.pi * BLEND_HZ
    f[:] = 0.0
    for i in range(every // 2, omega.shape[0], every):
        s = 1j * omega[i]
        x, q = 0.0j, 0.0j
        attitude = 1.0 / (1.0 + ATTITUDE_S * s)
        blend = s * s + 1.4 * corner * s + corner * corner
        if source == THETA:
            x = attitude
        elif source == RATE:
            x = 0.5 * attitude
            q = 1.0 + 0.0j
            f[CM, i] = s * con.per_qdot / (segment.density * speed * speed * segment.derivative[i])
        elif source == AZ:
            x = s / blend / speed
            f[CL, i] = -con.per_az / (segment.density * speed * speed)
        elif source == V_DOWN:
            x = (1.4 * corner * s + corner * corner) / blend / speed
        else:
            f[DE, i] = 1.0
            continue
        _signals(x, q, s, speed, con, f[:, i])


@njit(cache=True, error_model="numpy")
def _signals(x: complex, q: complex, s: complex, speed: float, con: Constants, f: Complex) -> None:
    """Channels `f` (CHANNELS,) of physical_signals and q c/2V at one line, from the inertial angle of attack `x` and
    the pitch rate `q`, with the gust that a vane which stands still would be taken to meet."""
    chords = speed / con.reference_chord
    lead, edge, late = con.lead / speed, con.gust_edge / speed, con.tail_arm / speed
    w_m = frequency_response(con.lift_motion, s / chords)
    met = frequency_response(con.lift_gust, s / chords) * np.exp(s * edge)
    f_m = frequency_response(con.upwash_motion, s / chords)
    f_g = frequency_response(con.upwash_gust, s / chords)
    seen = (1.0 + con.upwash_body) * (x - con.boom / speed * q) + con.upwash_wing * f_m * x
    gust = -seen / (1.0 + con.upwash_body + con.upwash_wing * f_g * np.exp(-s * (lead - edge))) * np.exp(-s * lead)
    washed = np.exp(-s * (late + con.downwash_delay))
    washed_up = con.upwash_wing / (1.0 + con.upwash_body) * f_g * np.exp(-s * (lead - edge))
    f[X], f[WX], f[QH] = x, w_m * x, con.half_chord / speed * q
    f[GC], f[KG], f[GT] = gust, met * gust, gust * np.exp(-s * late)
    f[DW], f[DK], f[DX] = washed * f[WX], washed * f[KG], washed * x
    for k, corner in enumerate(CORNERS):
        lag = 1.0 + s * con.span / (corner * speed)
        wing_lag, wash_lag, tail_lag = LAGGED[k]
        f[wing_lag], f[wash_lag], f[tail_lag] = f[KG] / lag, f[DK] / lag, f[GT] / lag
        freed_wing, freed_wash, freed_tail = FREED[k]
        freed = washed_up * (1.0 - 1.0 / lag)
        f[freed_wing], f[freed_wash], f[freed_tail] = f[KG] * freed, f[DK] * freed, f[GT] * freed


@njit(cache=True, error_model="numpy")
def all_columns(
    segment: Segment, con: Constants, rho: Array
) -> tuple[Complex, Complex, Complex, Complex, Complex, Complex]:
    """Columns of the segment's own spectra, and then of the noise of each of SOURCES."""
    lines = segment.omega.shape[0]
    spectra, wing, spans, tails, freed, base = no_columns(1 + len(SOURCES), lines)
    for i in range(lines):
        for channel in range(CHANNELS):
            spectra[0, channel, i] = segment.spectrum[channel, i]
    for k in range(1 + len(SOURCES)):
        every = EVERY if k > 0 else 1
        if k > 0:
            noise_spectrum(k - 1, segment, con, every, spectra[k])
        columns(segment, con, rho, Columns(spectra[k], wing[k], spans[k], tails[k], freed[k], base[k], every))
    return spectra, wing, spans, tails, freed, base

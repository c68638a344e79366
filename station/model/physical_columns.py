"""Equations of method `physical` in the frequency domain: what wing, tail and gust add to CL and Cm, and what errors of
the profile's constants would.

    CL = CL_alpha A + CL_q qhat + CL_de de + a_h D,        A = Wx + Kg
    Cm = Cm_alpha A + Cm_q qhat + Cm_de de - a_h (l_t/c) D
    D  = x + g_t - e (W x + K g)(t - l_t/V) - (1 - e) A - 2 e (l_t/c) qhat = P - e Q

D is what tail and wing do beyond the quasi-steady derivatives, which stay the tabulated ones. SI, radians.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.model.physical_constants import (
    ARM_LENGTH,
    BOOM,
    CL_ALPHA,
    CL_DE,
    CL_Q,
    CM_ALPHA,
    CM_DE,
    CM_Q,
    FIRST_NUISANCE,
    GAIN,
    GUST_RATE,
    LIFT_AMPLITUDE,
    LIFT_RATE,
    SKEW,
    SPAN,
    SPAN_FAST,
    SPAN_MIDDLE,
    TAIL,
    TAIL_SPAN,
    TAIL_SPAN_SHARE,
    UPWASH_RATE_GUST,
    UPWASH_RATE_MOTION,
    UPWASH_SHARE,
    WASH,
    WASH_DELAY,
    WIND,
    Constants,
    N,
)
from station.model.physical_signals import (
    CORNERS,
    DK,
    DW,
    DX,
    FREED,
    GC,
    GT,
    KG,
    LAGGED,
    SIGNALS,
    WIND_TAIL,
    WIND_WASH,
    WIND_WING,
    WX,
    X,
)
from station.numerics.indicial import Response, frequency_response

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

QH, DE, CL, CM = SIGNALS, SIGNALS + 1, SIGNALS + 2, SIGNALS + 3
"""Channels after those of physical_signals: q c/2V, elevator, CL and Cm."""
CHANNELS: Final = SIGNALS + 4

A, P, Q = range(3)
"""Of Columns: the wing's incidence, and what of the tail's downwash leaves and what it multiplies, D = P - e Q."""
SPANS: Final = (SPAN, SPAN_MIDDLE, SPAN_FAST)
"""Nuisances of the span's lags, slow to fast, as CORNERS (V/b) and LAGGED."""
MET: Final = (BOOM, SKEW, UPWASH_SHARE, UPWASH_RATE_GUST, GAIN, UPWASH_RATE_MOTION, GUST_RATE)
"""Nuisances that feign a gust, or change the wing's response to gusts: their gusts go through the span's lags."""
GUST_HZ: Final = (0.2, 1.2)
"""Where the gust must stand out of the noise for air to count as turbulent."""


class Segment(NamedTuple):
    """The spectra of a stretch of flight, and the air that it was flown through."""

    spectrum: Complex
    """(CHANNELS, frequencies)"""
    omega: Array
    """rad/s, (frequencies,)"""
    derivative: Array
    """Factor of Cm for its central difference, (frequencies,)."""
    independent: float
    """T df: how many independent lines there are to a line of the grid."""
    vane_noise: float
    """Energy of the vane's noise on a line, rad2."""
    speed: float
    """Mean, m/s."""
    density: float
    """Of the air, kg/m3."""
    wind_sd: float
    """Standard deviation of the mean wind, as a share of the speed."""


class Columns(NamedTuple):
    """What the equations are made of, without the derivatives."""

    spectrum: Complex
    """It is made from, (CHANNELS, frequencies)."""
    wing: Complex
    """A, P and Q, (3, frequencies)."""
    spans: Complex
    """What a unit of each of SPANS adds to a gust's lift, relative to it, (SPANS, frequencies)."""
    tails: Complex
    """And what it adds to the gust at the tail, as far as the tail follows the wing, (SPANS, frequencies)."""
    freed: Complex
    """And what it gives A, P and Q by taking it from the upwash at the vane, (SPANS, 3, frequencies)."""
    nuisances: Complex
    """What a unit of each nuisance adds to A, P and Q, (N, 3, frequencies); of the tail's share, which multiplies D,
    nothing."""
    every: int
    """Lines from one to the next that are filled."""


@register_jitable
def no_columns(parts: int, lines: int) -> tuple[Complex, Complex, Complex, Complex, Complex, Complex]:
    """Arrays of so many Columns, to be filled."""
    return (
        np.zeros((parts, CHANNELS, lines), dtype=np.complex128),
        np.zeros((parts, 3, lines), dtype=np.complex128),
        np.zeros((parts, len(SPANS), lines), dtype=np.complex128),
        np.zeros((parts, len(SPANS), lines), dtype=np.complex128),
        np.zeros((parts, len(SPANS), 3, lines), dtype=np.complex128),
        np.zeros((parts, N, 3, lines), dtype=np.complex128),
    )


@njit(cache=True, error_model="numpy")
def _rate_slope(of: Response, s: complex) -> complex:
    """Change of an indicial response with the logarithm of its rates; `s`: per chord travelled."""
    h = 0.0 + 0.0j
    for j in range(of.n):
        b = of.b[j]
        h += of.a[j] * s * b / (s + b) ** 2
    return h


@njit(cache=True, error_model="numpy")
def wiener(f: Complex, omega: Array, noise: float, rho: Array) -> float:
    """Share `rho` (frequencies,) of the gust's spectrum that is not noise, of energy `noise` on a line.

    Returns the share between 0.2 and 1.2 Hz squared: 0 calm, 1 turbulent.
    """
    lines = omega.shape[0]
    total = 0.0
    count = 0
    for i in range(lines):
        hz = omega[i] / (2.0 * math.pi)
        width = min(max(5.0 * hz, 2.0), 6.0)
        energy, weight = 0.0, 0.0
        for j in range(lines):
            w = math.exp(-0.5 * ((i - j) / width) ** 2)
            weight += w
            energy += w * (f[GC, j].real ** 2 + f[GC, j].imag ** 2)
        power = energy / weight
        rho[i] = min(max(1.0 - 1.5 * noise / power, 0.0), 1.0) if power > 0.0 else 0.0
        if GUST_HZ[0] - 1e-9 <= hz <= GUST_HZ[1] + 1e-9:
            total += rho[i]
            count += 1
    share = total / count if count > 0 else 0.0
    return share * share


@njit(cache=True, error_model="numpy")
def _feigned(of: Columns, i: int, s: complex, speed: float, con: Constants, r: float) -> None:
    """Column of each of MET at line i: of the gust at the CG that an error of the constant feigns. `r`: rho there."""
    f, base = of.spectrum, of.nuisances
    chords = speed / con.reference_chord
    share = con.upwash_wing / (1.0 + con.upwash_body)
    x, qh, gc = f[X, i], f[QH, i], r * f[GC, i]
    to_tail = np.exp(-s * (con.tail_arm / speed))
    washed = to_tail * np.exp(-s * con.downwash_delay)
    to_boom = np.exp(-s * (con.lead / speed))
    to_edge = np.exp(s * (con.gust_edge / speed))
    met = frequency_response(con.lift_gust, s / chords) * to_edge
    f_m = frequency_response(con.upwash_motion, s / chords)
    f_g = frequency_response(con.upwash_gust, s / chords)
    # What the vane shows of motion and gust, as far as it counts as gust; q at the boom: r q/V = (2 r/c) qhat. What it
    # shows too much makes a gust of which the wing's upwash is part.
    moved = r * x * to_boom
    pitched = r * con.boom / con.half_chord * qh * to_boom
    washed_up = share * f_g * to_boom * to_edge
    part = 1.0 / (1.0 + washed_up)
    shown = gc + part * (moved - pitched + share * f_m * moved)
    feigned = (
        (BOOM, part * (speed / con.boom * pitched - s * gc)),
        (SKEW, s * shown),
        (GAIN, shown),
        (UPWASH_SHARE, part * (share * (f_m - 1.0) * moved + share * pitched + (washed_up - share) * gc)),
        (UPWASH_RATE_GUST, part * share * _rate_slope(con.upwash_gust, s / chords) * to_boom * to_edge * gc),
        (UPWASH_RATE_MOTION, part * share * _rate_slope(con.upwash_motion, s / chords) * moved),
    )
    for j, g in feigned:
        da = met * g
        base[j, A, i] = da
        base[j, P, i] = to_tail * g - da
        base[j, Q, i] = (washed - 1.0) * da
    lift = (
        (GUST_RATE, _rate_slope(con.lift_gust, s / chords) * to_edge * gc),
        (LIFT_RATE, _rate_slope(con.lift_motion, s / chords) * x),
    )
    for j, da in lift:
        base[j, A, i] = da
        base[j, P, i] = -da
        base[j, Q, i] = (washed - 1.0) * da


@register_jitable
def _other_incidence(column: Complex, i: int, now: complex, late: complex) -> None:
    """Column of a nuisance at line i that adds `now` to the wing's incidence, and to that of l_t/V ago `late`."""
    column[A, i] = now
    column[P, i] = -now
    column[Q, i] = late - now


@njit(cache=True, error_model="numpy")
def columns(segment: Segment, con: Constants, rho: Array, of: Columns) -> None:
    """Fill `of` from its spectrum at every so-many-th line. `rho`: see `wiener`."""
    f, wing, base, speed = of.spectrum, of.wing, of.nuisances, segment.speed
    lc, late = con.arm, con.tail_arm / speed
    base[:] = 0.0
    for i in range(of.every // 2, segment.omega.shape[0], of.every):
        s = 1j * segment.omega[i]
        r = rho[i]
        x, qh = f[X, i], f[QH, i]
        wx, kg, gt = f[WX, i], r * f[KG, i], r * f[GT, i]
        dw, dk, dx = f[DW, i], r * f[DK, i], f[DX, i]
        wing[A, i] = wx + kg
        wing[P, i] = x + gt - wx - kg
        wing[Q, i] = dw + dk - wx - kg + 2.0 * lc * qh
        _feigned(of, i, s, speed, con, r)
        for k, corner in enumerate(CORNERS):
            of.spans[k, i] = 1.0 / (1.0 + s * con.span / (corner * speed)) - 1.0
            # The wing's incidence with another lag, the same of l_t/V ago, and the gust at the tail.
            wing_lag, wash_lag, tail_lag = LAGGED[k]
            of.tails[k, i] = r * f[tail_lag, i] - gt
            _other_incidence(base[SPANS[k]], i, r * f[wing_lag, i] - kg, r * f[wash_lag, i] - dk)
            freed_wing, freed_wash, freed_tail = FREED[k]
            _other_incidence(of.freed[k], i, r * f[freed_wing, i], r * f[freed_wash, i])
            of.freed[k, P, i] += r * f[freed_tail, i]
            for part in range(3):
                base[SPANS[k], part, i] += of.freed[k, part, i]
        _other_incidence(base[LIFT_AMPLITUDE], i, wx - x, dw - dx)
        base[WASH_DELAY, Q, i] = -s * (dw + dk)
        base[ARM_LENGTH, P, i] = -s * late * gt
        base[ARM_LENGTH, Q, i] = -s * late * (dw + dk) + 2.0 * lc * qh
        base[WIND, A, i] = speed * f[WIND_WING, i]
        base[WIND, P, i] = speed * (f[WIND_TAIL, i] - f[WIND_WING, i])
        base[WIND, Q, i] = speed * (f[WIND_WASH, i] - f[WIND_WING, i])


@njit(cache=True, error_model="numpy")
def design(of: Columns, i: int, derivative: float, con: Constants, theta: Array, g: Complex, r: Complex) -> None:
    """At line i and the estimate `theta` (PARAMETERS,): `g` (2, PARAMETERS), slopes of CL and Cm by each parameter,
    and `r` (2,), what the model leaves of both; `derivative`: factor of Cm.

    Products with the tail's share, arm and downwash are exact, and those of the span's lags and the gusts that other
    constants feign, which the wing meets as it meets gusts.
    """
    f, wing, spans, tails, base = of.spectrum, of.wing, of.spans, of.tails, of.nuisances
    nuisance, by = theta[FIRST_NUISANCE:], g[:, FIRST_NUISANCE:]
    a, p, q = wing[A, i], wing[P, i], wing[Q, i]
    for j in range(1, N):
        if j != WASH:
            c = nuisance[j]
            a += c * base[j, A, i]
            p += c * base[j, P, i]
            q += c * base[j, Q, i]
    # What the span's lags make of the gusts that other constants feign.
    lagged, met, washed, late = 0.0j, 0.0j, 0.0j, 0.0j
    for k, j in enumerate(SPANS):
        lagged += nuisance[j] * spans[k, i]
        late += nuisance[j] * tails[k, i]
        met += nuisance[j] * of.freed[k, A, i]
        washed += nuisance[j] * of.freed[k, Q, i]
    for j in MET:
        met += nuisance[j] * base[j, A, i]
        washed += nuisance[j] * base[j, Q, i]
    a += lagged * met
    follows = TAIL_SPAN_SHARE + nuisance[TAIL_SPAN]
    p += follows * late - lagged * met
    q += lagged * washed
    a_h, e = con.tail_share + nuisance[TAIL], con.downwash + nuisance[WASH]
    lc = con.arm * (1.0 + nuisance[ARM_LENGTH])
    d = p - e * q
    qh, de = f[QH, i], f[DE, i]
    g[:] = 0.0
    g[0, CL_ALPHA], g[0, CL_Q], g[0, CL_DE] = a, qh, de
    g[1, CM_ALPHA], g[1, CM_Q], g[1, CM_DE] = a, qh, de
    by[0, TAIL], by[1, TAIL] = d, -lc * d
    for j in range(1, N):
        own, tail = base[j, A, i], base[j, P, i] - e * base[j, Q, i]
        if j == WASH:
            own, tail = 0.0j, -q
        by[0, j] = theta[CL_ALPHA] * own + a_h * tail
        by[1, j] = theta[CM_ALPHA] * own - a_h * lc * tail
    for j in MET:
        own = lagged * base[j, A, i]
        tail = -own - e * lagged * base[j, Q, i]
        by[0, j] += theta[CL_ALPHA] * own + a_h * tail
        by[1, j] += theta[CM_ALPHA] * own - a_h * lc * tail
    for k, j in enumerate(SPANS):
        own = spans[k, i] * met + lagged * of.freed[k, A, i]
        tail = follows * tails[k, i] - own - e * (spans[k, i] * washed + lagged * of.freed[k, Q, i])
        by[0, j] += theta[CL_ALPHA] * own + a_h * tail
        by[1, j] += theta[CM_ALPHA] * own - a_h * lc * tail
    by[0, TAIL_SPAN], by[1, TAIL_SPAN] = a_h * late, -a_h * lc * late
    by[1, ARM_LENGTH] -= a_h * con.arm * d
    r[0] = f[CL, i] - theta[CL_ALPHA] * a - theta[CL_Q] * qh - theta[CL_DE] * de - a_h * d
    r[1] = f[CM, i] * derivative - theta[CM_ALPHA] * a - theta[CM_Q] * qh - theta[CM_DE] * de + a_h * lc * d

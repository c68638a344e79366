"""Equations of method `physical` in the frequency domain: what wing, tail and gust add to CL and Cm, and what errors of
the profile's constants would.

    CL = CL_alpha A + CL_q qhat + CL_de de + a_h D,        A = Wx + Kg
    Cm = Cm_alpha A + Cm_q qhat + Cm_de de - a_h (l_t/c) D
    D  = x + g_t - e (W x + K g)(t - l_t/V) - (1 - e) A - 2 e (l_t/c) qhat

D is what tail and wing do beyond the quasi-steady derivatives, which stay the tabulated ones. SI, radians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.model.physical_signals import (
    DK,
    DKL,
    DKM,
    DKN,
    DW,
    DX,
    GC,
    GT,
    KG,
    KL,
    KM,
    KN,
    SIGNALS,
    SPAN_FAST,
    SPAN_MIDDLE,
    SPAN_SLOW,
    WIND_TAIL,
    WIND_WASH,
    WIND_WING,
    WX,
    X,
)
from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.indicial import Response, frequency_response
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

QH, DE, CL, CM = SIGNALS, SIGNALS + 1, SIGNALS + 2, SIGNALS + 3
CHANNELS: Final = SIGNALS + 4

NUISANCES: Final = (
    *("tail share", "boom length", "vane skew", "span", "span, fast", "lift memory", "upwash share"),
    *("upwash rate, gust", "downwash", "downwash delay", "tail arm", "vane gain", "upwash rate, motion"),
    *("gust memory rate", "lift memory rate", "span, middle", "mean wind"),
)
"""What else may be wrong: the constants of the profile, and the mean wind."""
N: Final = len(NUISANCES)
PARAMETERS: Final = 6 + N
TAIL, WASH, ARM_LENGTH, WIND = 0, 8, 10, N - 1
"""Places among the nuisances that enter in products with others."""
SPANS: Final = (3, 15, 4)
"""Places of the span's lags, slow to fast."""
MET: Final = (1, 2, 6, 7, 11, 12, 13)
"""Places of what feigns a gust, or changes the wing's memory of gusts: goes through the span's lags."""
SOURCES: Final = ("theta", "q", "az", "v_down", "elevator")
"""Sensors whose noise is in the regressors."""

# constants
A_H, E, ARM, _LT, _BOOM, _LE, _CHORD, _HALF, _KF, _KW, CL_ALPHA, CM_ALPHA, HAS_MOMENT = range(13)
_WASH, _LEAD, LEARNT_AT = range(13, 16)
KNOWN_AT: Final = LEARNT_AT + N
_NW, _NK, _NM, _NG = range(KNOWN_AT + N, KNOWN_AT + N + 4)
_TABLES: Final = KNOWN_AT + N + 4
NOISE_AT: Final = _TABLES + 32
_SPAN, _LIFT, _MOMENT, _DENSITY = range(NOISE_AT + len(SOURCES), NOISE_AT + len(SOURCES) + 4)
CONSTANTS: Final = _DENSITY + 1
WING: Final = 3 + len(SPANS)


@register_jitable
def _table(con: Array, at: int, terms: int) -> Response:
    return Response(terms, con[at : at + 4], con[at + 4 : at + 8])


@njit(cache=True, error_model="numpy")
def _slope(con: Array, at: int, terms: int, s: complex) -> complex:
    """Change of an indicial response (8 constants from `at` on) with the logarithm of its rates."""
    h = 0.0 + 0.0j
    for j in range(terms):
        b = con[at + 4 + j]
        h += con[at + j] * s * b / (s + b) ** 2
    return h


@njit(cache=True, error_model="numpy")
def wiener(f: Complex, omega: Array, noise: float, gust_power: Array, rho: Array) -> float:
    """Share `rho` (frequencies,) of the gust's spectrum that is not noise, and `gust_power`, its smoothed energy.

    `noise`: energy of the vane's noise on a line. Returns the share between 0.2 and 1.2 Hz squared: 0 calm, 1
    turbulent.
    """
    lines = omega.shape[0]
    step = omega[1] - omega[0] if lines > 1 else 1.0
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
        gust_power[i] = energy / weight
        rho[i] = min(max(1.0 - 1.5 * noise / gust_power[i], 0.0), 1.0) if gust_power[i] > 0.0 else 0.0
        if 0.2 - 1e-9 <= hz <= 1.2 + 1e-9:
            total += rho[i]
            count += 1
    share = total / count if count > 0 else 0.0
    return share * share if step > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def columns(
    f: Complex, omega: Array, speed: float, con: Array, rho: Array, every: int, wing: Complex, base: Complex
) -> None:
    """What the equations are made of at every so-many-th line, without the derivatives, with D = P - e Q.

    `wing` (WING, frequencies): A, P, Q, and what a unit of each of SPANS adds to a gust's lift, relative to it. `base`
    (N, 3, frequencies): what a unit of each nuisance adds to A, P and Q; of the tail's share, which multiplies D,
    nothing.
    """
    lc = con[ARM]
    late = con[_LT] / speed
    tau = con[_LEAD] / speed
    lead = con[_LE] / speed
    chords = speed / con[_CHORD]
    t = _TABLES
    share = con[_KW] / (1.0 + con[_KF])
    base[:] = 0.0
    for i in range(every // 2, omega.shape[0], every):
        s = 1j * omega[i]
        r = rho[i]
        x, qh = f[X, i], f[QH, i]
        wx, kg, gc, gt = f[WX, i], r * f[KG, i], r * f[GC, i], r * f[GT, i]
        dw, dk, dx = f[DW, i], r * f[DK, i], f[DX, i]
        kl, km, kn = r * f[KL, i], r * f[KM, i], r * f[KN, i]
        dkl, dkm, dkn = r * f[DKL, i], r * f[DKM, i], r * f[DKN, i]
        wing[0, i] = wx + kg
        wing[1, i] = x + gt - wx - kg
        wing[2, i] = dw + dk - wx - kg + 2.0 * lc * qh
        to_tail = np.exp(-s * late)
        washed = to_tail * np.exp(-s * con[_WASH])
        to_boom = np.exp(-s * tau)
        lead_in = np.exp(s * lead)
        met = frequency_response(_table(con, t + 8, int(con[_NK])), s / chords) * lead_in
        f_m = frequency_response(_table(con, t + 16, int(con[_NM])), s / chords)
        f_g = frequency_response(_table(con, t + 24, int(con[_NG])), s / chords)
        # What the vane shows of motion and gust, as far as it counts as gust; q at the boom: r q/V = (2 r/c) qhat. What
        # it shows too much makes a gust of which the wing's upwash is part.
        moved = r * x * to_boom
        pitched = r * con[_BOOM] / con[_HALF] * qh * to_boom
        washed_up = share * f_g * to_boom * lead_in
        part = 1.0 / (1.0 + washed_up)
        shown = gc + part * (moved - pitched + share * f_m * moved)
        # gust incidence at the CG that a constant's error feigns
        feigned = (
            (1, part * (speed / con[_BOOM] * pitched - s * gc)),
            (2, s * shown),
            (11, shown),
            (6, part * (share * (f_m - 1.0) * moved + share * pitched + (washed_up - share) * gc)),
            (7, part * share * _slope(con, t + 24, int(con[_NG]), s / chords) * to_boom * lead_in * gc),
            (12, part * share * _slope(con, t + 16, int(con[_NM]), s / chords) * moved),
        )
        for j, g in feigned:
            da = met * g
            base[j, 0, i] = da
            base[j, 1, i] = to_tail * g - da
            base[j, 2, i] = (washed - 1.0) * da
        for k, corner in enumerate((SPAN_SLOW, SPAN_MIDDLE, SPAN_FAST)):
            wing[3 + k, i] = 1.0 / (1.0 + s * con[_SPAN] / (corner * speed)) - 1.0
        # wing incidence with another memory, and the same of l_t/V ago
        others = ((3, kl - kg, dkl - dk), (15, km - kg, dkm - dk), (4, kn - kg, dkn - dk), (5, wx - x, dw - dx))
        for j, da, late_da in others:
            base[j, 0, i] = da
            base[j, 1, i] = -da
            base[j, 2, i] = late_da - da
        slow = _slope(con, t, int(con[_NW]), s / chords)
        for j, da in ((13, _slope(con, t + 8, int(con[_NK]), s / chords) * lead_in * gc), (14, slow * x)):
            base[j, 0, i] = da
            base[j, 1, i] = -da
            base[j, 2, i] = (washed - 1.0) * da
        base[9, 2, i] = -s * (dw + dk)
        base[ARM_LENGTH, 1, i] = -s * late * gt
        base[ARM_LENGTH, 2, i] = -s * late * (dw + dk) + 2.0 * lc * qh
        base[WIND, 0, i] = speed * f[WIND_WING, i]
        base[WIND, 1, i] = speed * (f[WIND_TAIL, i] - f[WIND_WING, i])
        base[WIND, 2, i] = speed * (f[WIND_WASH, i] - f[WIND_WING, i])


@njit(cache=True, error_model="numpy")
def noise_spectrum(
    source: int, omega: Array, speed: float, con: Array, derivative: Array, every: int, f: Complex
) -> None:
    """What a unit of white noise of one of SOURCES puts into every channel, `f` (CHANNELS, frequencies), at every
    so-many-th line.

    The inertial angle of attack has it from attitude (drawn to its stream in 0.5 s), pitch rate, az and velocity (drawn
    below 0.05 Hz), as inertial.py blends them; the gust has what the vane is predicted from it.
    """
    corner = 2.0 * math.pi * 0.05
    chords = speed / con[_CHORD]
    t = _TABLES
    tau, lead, late = con[_LEAD] / speed, con[_LE] / speed, con[_LT] / speed
    f[:] = 0.0
    for i in range(every // 2, omega.shape[0], every):
        s = 1j * omega[i]
        x, q = 0.0j, 0.0j
        attitude = 1.0 / (1.0 + 0.5 * s)
        blend = s * s + 1.4 * corner * s + corner * corner
        if source == 0:
            x = attitude
        elif source == 1:
            x = 0.5 * attitude
            q = 1.0 + 0.0j
            f[CM, i] = s * con[_MOMENT] / (con[_DENSITY] * speed * speed * derivative[i])
        elif source == 2:
            x = s / blend / speed
            f[CL, i] = -con[_LIFT] / (con[_DENSITY] * speed * speed)
        elif source == 3:
            x = (1.4 * corner * s + corner * corner) / blend / speed
        else:
            f[DE, i] = 1.0
            continue
        w_m = frequency_response(_table(con, t, int(con[_NW])), s / chords)
        met = frequency_response(_table(con, t + 8, int(con[_NK])), s / chords) * np.exp(s * lead)
        f_m = frequency_response(_table(con, t + 16, int(con[_NM])), s / chords)
        f_g = frequency_response(_table(con, t + 24, int(con[_NG])), s / chords)
        seen = (1.0 + con[_KF]) * (x - con[_BOOM] / speed * q) + con[_KW] * f_m * x
        gust = -seen / (1.0 + con[_KF] + con[_KW] * f_g * np.exp(-s * (tau - lead))) * np.exp(-s * tau)
        washed = np.exp(-s * (late + con[_WASH]))
        f[X, i], f[WX, i], f[QH, i] = x, w_m * x, con[_HALF] / speed * q
        f[GC, i], f[KG, i], f[GT, i] = gust, met * gust, gust * np.exp(-s * late)
        f[KL, i] = f[KG, i] / (1.0 + s * con[_SPAN] / (SPAN_SLOW * speed))
        f[KM, i] = f[KG, i] / (1.0 + s * con[_SPAN] / (SPAN_MIDDLE * speed))
        f[KN, i] = f[KG, i] / (1.0 + s * con[_SPAN] / (SPAN_FAST * speed))
        f[DW, i], f[DK, i], f[DX, i] = washed * f[WX, i], washed * f[KG, i], washed * x
        f[DKL, i], f[DKM, i], f[DKN, i] = washed * f[KL, i], washed * f[KM, i], washed * f[KN, i]


@njit(cache=True, error_model="numpy")
def design(
    f: Complex,
    i: int,
    derivative: float,
    wing: Complex,
    base: Complex,
    con: Array,
    theta: Array,
    g: Complex,
    r: Complex,
) -> None:
    """At line i and the estimate `theta` (PARAMETERS,): `g` (2, PARAMETERS), slopes of CL and Cm by each parameter,
    and `r` (2,), what the model leaves of both. Products with the tail's share, arm and downwash are exact, and those
    of the span's lags and the gusts that other constants feign, which the wing meets as it meets gusts.
    """
    a, p, q = wing[0, i], wing[1, i], wing[2, i]
    for j in range(1, N):
        if j != WASH:
            c = theta[6 + j]
            a += c * base[j, 0, i]
            p += c * base[j, 1, i]
            q += c * base[j, 2, i]
    # What the span's lags make of the gusts that other constants feign.
    lagged, met, washed = 0.0j, 0.0j, 0.0j
    for k, j in enumerate(SPANS):
        lagged += theta[6 + j] * wing[3 + k, i]
    for j in MET:
        met += theta[6 + j] * base[j, 0, i]
        washed += theta[6 + j] * base[j, 2, i]
    a += lagged * met
    p -= lagged * met
    q += lagged * washed
    a_h, e, lc = con[A_H] + theta[6 + TAIL], con[E] + theta[6 + WASH], con[ARM] * (1.0 + theta[6 + ARM_LENGTH])
    d = p - e * q
    qh, de = f[QH, i], f[DE, i]
    g[:] = 0.0
    g[0, 0], g[0, 1], g[0, 2] = a, qh, de
    g[1, 3], g[1, 4], g[1, 5] = a, qh, de
    g[0, 6 + TAIL], g[1, 6 + TAIL] = d, -lc * d
    for j in range(1, N):
        own, tail = base[j, 0, i], base[j, 1, i] - e * base[j, 2, i]
        if j == WASH:
            own, tail = 0.0j, -q
        g[0, 6 + j] = theta[0] * own + a_h * tail
        g[1, 6 + j] = theta[3] * own - a_h * lc * tail
    for j in MET:
        own = lagged * base[j, 0, i]
        tail = -own - e * lagged * base[j, 2, i]
        g[0, 6 + j] += theta[0] * own + a_h * tail
        g[1, 6 + j] += theta[3] * own - a_h * lc * tail
    for k, j in enumerate(SPANS):
        own = wing[3 + k, i] * met
        tail = -own - e * wing[3 + k, i] * washed
        g[0, 6 + j] += theta[0] * own + a_h * tail
        g[1, 6 + j] += theta[3] * own - a_h * lc * tail
    g[1, 6 + ARM_LENGTH] -= a_h * con[ARM] * d
    r[0] = f[CL, i] - theta[0] * a - theta[1] * qh - theta[2] * de - a_h * d
    r[1] = f[CM, i] * derivative - theta[3] * a - theta[4] * qh - theta[5] * de + a_h * lc * d


LEARNT: Final = (1.0, 1.0, 1.0, 1.0, 1.0, 0.67, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
"""How much of each nuisance's prior standard deviation turbulence is let move: there the rest, which stands for errors
of another shape than the nuisance's own, is only considered. In calm air everything is learnt. The mean wind's share is
`set_air`'s."""


def constants(aircraft: Aircraft, noise: Mapping[str, float] | None = None) -> Array:
    """The constants of `fit`, (CONSTANTS,); for an aircraft for which `why_not` gives no reason against it.

    `noise`: standard deviations of the sensors, SI.
    """
    con = np.zeros(CONSTANTS)
    g, unsteady, boom = aircraft.geometry, aircraft.unsteady, aircraft.boom
    assert boom is not None
    con[A_H], con[E] = unsteady.tail_lift_slope, unsteady.downwash
    con[ARM], con[_LT] = unsteady.tail_arm / g.chord, unsteady.tail_arm
    con[_BOOM], con[_LE] = boom.vane_x, aircraft.gust_edge
    con[_CHORD], con[_HALF] = unsteady.reference_chord or g.chord, g.chord / 2
    con[_KF], con[_KW] = boom.upwash_body, boom.upwash_wing
    con[_WASH], con[_LEAD] = unsteady.downwash_delay, boom.gust_x
    con[HAS_MOMENT] = float(aircraft.inertia.iyy is not None)
    con[CL_ALPHA], con[CM_ALPHA] = aircraft.value("CL_alpha") or 5.0, aircraft.value("Cm_alpha") or -1.0
    known = aircraft.uncertainty
    con[KNOWN_AT : KNOWN_AT + N] = (
        *(known.tail_lift_slope * unsteady.tail_lift_slope, known.vane_x, known.vane_delay, known.span_lag),
        *(known.span_lag, known.lift_memory, known.upwash_wing, known.upwash_rate),
        *(known.downwash * unsteady.downwash, known.downwash_delay, known.tail_arm, known.vane_scale),
        *(known.upwash_rate, known.lift_rate, known.lift_rate, known.span_lag, 0.0),
    )
    con[LEARNT_AT : LEARNT_AT + N] = LEARNT
    sd = {**DEFAULT_NOISE, **(noise or {})}
    vane = sd["alpha_vane"] / (1.0 + boom.upwash_body)
    con[NOISE_AT : NOISE_AT + len(SOURCES)] = [(sd[name] / vane) ** 2 for name in SOURCES]
    con[_SPAN] = g.span
    con[_LIFT] = 2.0 * aircraft.inertia.mass / g.wing_area
    con[_MOMENT] = 2.0 * (aircraft.inertia.iyy or 0.0) / (g.wing_area * g.chord)
    for k, response in enumerate(
        (unsteady.lift_motion, unsteady.lift_gust, unsteady.upwash_motion, unsteady.upwash_gust)
    ):
        if response is not None:
            count = min(len(response.a), 4)
            con[_NW + k] = count
            con[_TABLES + 8 * k : _TABLES + 8 * k + count] = response.a[:count]
            con[_TABLES + 8 * k + 4 : _TABLES + 8 * k + 4 + count] = response.b[:count]
    return con


@njit(cache=True, error_model="numpy")
def set_air(con: Array, density: float, share: float) -> None:
    """Let the air have this density, kg/m3, and its mean wind be known to this share of the speed (standard deviation).

    The wind stretches the time to the tail, as a wrong tail arm does, which is only considered: what the data show of
    the stretch is the wind's in the ratio of the two prior variances, all of it if the arm is known exactly.
    """
    arm = con[KNOWN_AT + ARM_LENGTH]
    con[_DENSITY] = density
    con[KNOWN_AT + WIND] = share
    con[LEARNT_AT + WIND] = share / math.sqrt(share * share + arm * arm + 1e-18)


def why_not(aircraft: Aircraft) -> str:
    """Why the method cannot be applied to an aircraft; "" if it can."""
    unsteady = aircraft.unsteady
    if not unsteady.memory:
        return "the aircraft profile says quasi-steady: no lift memory"
    missing = [
        name
        for name, there in (
            ("boom", aircraft.boom),
            ("unsteady.tail_lift_slope", unsteady.tail_lift_slope),
            ("unsteady.tail_arm", unsteady.tail_arm),
            ("unsteady.lift_motion", unsteady.lift_motion),
            ("unsteady.lift_gust", unsteady.lift_gust),
        )
        if not there
    ]
    return f"the aircraft profile gives no {', '.join(missing)}" if missing else ""

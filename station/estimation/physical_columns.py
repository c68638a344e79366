"""Equations of method `physical` in the frequency domain: what wing, tail and gust add to CL and Cm, and what errors of
the profile's constants would.

    CL = CL_alpha A + CL_q qhat + CL_de de + a_h D,        A = Wx + Kg
    Cm = Cm_alpha A + Cm_q qhat + Cm_de de - a_h (l_t/c) D
    D  = x + g_t - e (W x + K g)(t - l_t/V) - (1 - e) A - 2 e (l_t/c) qhat

D is what tail and wing do beyond the quasi-steady derivatives, which stay the tabulated ones. SI, radians.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation.physical_signals import DK, DKL, DKM, DW, DX, GC, GT, KG, KL, KM, SIGNALS, WX, X
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

QH, DE, CL, CM = SIGNALS, SIGNALS + 1, SIGNALS + 2, SIGNALS + 3
CHANNELS: Final = SIGNALS + 4

NUISANCES: Final = (
    *("tail share", "boom length", "vane skew", "span", "span, fast", "lift memory", "upwash share"),
    *("upwash rate, gust", "downwash", "downwash delay", "tail arm", "vane gain", "upwash rate, motion"),
    *("gust memory rate", "lift memory rate", "mean wind"),
)
"""What else may be wrong: the constants of the profile, and the mean wind."""
N: Final = len(NUISANCES)
N_LEARNT: Final = 8
"""The first of them are estimated along."""
PARAMETERS: Final = 6 + N_LEARNT

# constants
A_H, _E, ARM, _LT, _BOOM, _LE, _CHORD, _HALF, _KF, _KW, CL_ALPHA, CM_ALPHA, HAS_MOMENT, _WASH, LEARNT_AT = range(15)
KNOWN_AT: Final = LEARNT_AT + N_LEARNT
_NW, _NK, _NM, _NG = range(KNOWN_AT + N, KNOWN_AT + N + 4)
_TABLES: Final = KNOWN_AT + N + 4
CONSTANTS: Final = _TABLES + 32


@njit(cache=True, error_model="numpy")
def _memory(amplitudes: Array, rates: Array, terms: int, s: complex) -> complex:
    """Frequency response of an indicial response; `s`: per chord travelled."""
    h = 1.0 + 0.0j
    for j in range(terms):
        h -= amplitudes[j] * s / (s + rates[j])
    return h


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
def columns(f: Complex, omega: Array, speed: float, con: Array, rho: Array, wing: Complex, base: Complex) -> None:
    """What the equations are made of, without the derivatives.

    `wing` (2, frequencies): A and D. `base` (N, 4, frequencies): of each nuisance dA, dD, and what it adds to CL and
    Cm besides.
    """
    a_h, e, lc = con[A_H], con[_E], con[ARM]
    late = con[_LT] / speed
    tau = con[_BOOM] / speed
    lead = con[_LE] / speed
    chords = speed / con[_CHORD]
    for i in range(omega.shape[0]):
        w = omega[i]
        s = 1j * w
        r = rho[i]
        x, qh = f[X, i], f[QH, i]
        wx, kg, gc, gt = f[WX, i], r * f[KG, i], r * f[GC, i], r * f[GT, i]
        dw, dk, dx = f[DW, i], r * f[DK, i], f[DX, i]
        kl, km, dkl, dkm = r * f[KL, i], r * f[KM, i], r * f[DKL, i], r * f[DKM, i]
        a = wx + kg
        d = x + gt - e * (dw + dk) - (1.0 - e) * a - 2.0 * e * lc * qh
        wing[0, i] = a
        wing[1, i] = d
        to_tail = np.exp(-s * late)
        washed = to_tail * np.exp(-s * con[_WASH])
        to_boom = np.exp(-s * tau)
        t = _TABLES
        met = _memory(con[t + 8 : t + 12], con[t + 12 : t + 16], int(con[_NK]), s / chords) * np.exp(s * lead)
        f_m = _memory(con[t + 16 : t + 20], con[t + 20 : t + 24], int(con[_NM]), s / chords)
        f_g = _memory(con[t + 24 : t + 28], con[t + 28 : t + 32], int(con[_NG]), s / chords)
        # q at the boom as an angle: r q/V = (2 r/c) qhat
        boom_rate = con[_BOOM] / con[_HALF] * qh
        flow = (x - boom_rate) * to_boom
        to_edge = to_boom * np.exp(s * lead)
        share = con[_KW] / (1.0 + con[_KF])
        gain = (1.0 + con[_KF] + con[_KW]) / (1.0 + con[_KF])
        # gust incidence at the CG that a constant's error feigns
        feigned = (
            (1, -s * gc + speed / con[_HALF] * qh * to_boom),
            (2, s * (gain * flow + gc)),
            (11, flow + gc),
            (6, share * ((f_m - 1.0) * x * to_boom + (f_g * to_edge - 1.0) * gc)),
            (7, share * _slope(con, t + 24, int(con[_NG]), s / chords) * to_edge * gc),
            (12, share * _slope(con, t + 16, int(con[_NM]), s / chords) * x * to_boom),
        )
        for j, g in feigned:
            da = met * g
            base[j, 0, i] = da
            base[j, 1, i] = to_tail * g - (1.0 - e) * da - e * washed * da
            base[j, 2, i] = 0.0
            base[j, 3, i] = 0.0
        # wing incidence with another memory, and the same of l_t/V ago
        for j, da, late_da in ((3, kl - kg, dkl - dk), (4, km - kg, dkm - dk), (5, wx - x, dw - dx)):
            base[j, 0, i] = da
            base[j, 1, i] = -(1.0 - e) * da - e * late_da
            base[j, 2, i] = 0.0
            base[j, 3, i] = 0.0
        slow = _slope(con, t, int(con[_NW]), s / chords)
        for j, da in ((13, _slope(con, t + 8, int(con[_NK]), s / chords) * np.exp(s * lead) * gc), (14, slow * x)):
            base[j, 0, i] = da
            base[j, 1, i] = -(1.0 - e) * da - e * washed * da
            base[j, 2, i] = 0.0
            base[j, 3, i] = 0.0
        for j, lift in (
            (0, d),
            (8, a_h * (a - dw - dk - 2.0 * lc * qh)),
            (9, a_h * e * s * (dw + dk)),
        ):
            base[j, 0, i] = 0.0
            base[j, 1, i] = 0.0
            base[j, 2, i] = lift
            base[j, 3, i] = -lc * lift
        further = -s * late * gt + e * s * late * (dw + dk) - 2.0 * e * lc * qh
        base[10, 0, i] = 0.0
        base[10, 1, i] = 0.0
        base[10, 2, i] = a_h * further
        base[10, 3, i] = -a_h * lc * (further + d)
        # A mean wind wrong by a share of the speed is motion by -(theta - x) and a gust that meets boom and tail apart.
        theta = speed / con[_HALF] * qh / s
        w_m = _memory(con[t : t + 4], con[t + 4 : t + 8], int(con[_NW]), s / chords)
        da = w_m * (x - theta) + met * (theta * to_boom - x * np.exp(-s * lead))
        base[N - 1, 0, i] = da
        base[N - 1, 1, i] = theta * (to_boom * to_tail - 1.0) - (1.0 - e) * da - e * washed * da
        base[N - 1, 2, i] = 0.0
        base[N - 1, 3, i] = 0.0


@njit(cache=True, error_model="numpy")
def design(f: Complex, wing: Complex, base: Complex, con: Array, cla: float, cma: float, g: Complex) -> None:
    """`g` (2, 6 + N, frequencies): columns of CL and Cm, the six derivatives and all nuisances."""
    a_h, lc = con[A_H], con[ARM]
    for i in range(g.shape[2]):
        for equation in range(2):
            own, other = 3 * equation, 3 - 3 * equation
            g[equation, own, i] = wing[0, i]
            g[equation, own + 1, i] = f[QH, i]
            g[equation, own + 2, i] = f[DE, i]
            for k in range(3):
                g[equation, other + k, i] = 0.0
        for j in range(N):
            g[0, 6 + j, i] = cla * base[j, 0, i] + a_h * base[j, 1, i] + base[j, 2, i]
            g[1, 6 + j, i] = cma * base[j, 0, i] - a_h * lc * base[j, 1, i] + base[j, 3, i]


KNOWN: Final = (
    *(0.2, 6e-3, 4e-3, 1.0, 1.0, 0.3, 0.3),
    *(0.27, 0.2, 15e-3, 0.09, 0.0115, 0.27),
    *(0.27, 0.27, 0.0),
)
"""Prior standard deviation of each nuisance: delays in s, others relative. The mean wind's comes with the data
(set_wind)."""
LEARNT: Final = (0.2, 6e-3, 4e-3, 1.0, 1.0, 0.2, 0.15, 0.135)
"""How much of it turbulence is let move; the rest is only considered."""


def constants(aircraft: Aircraft) -> Array:
    """The constants of `fit`, (CONSTANTS,); for an aircraft for which `why_not` gives no reason against it."""
    con = np.zeros(CONSTANTS)
    g, unsteady, boom = aircraft.geometry, aircraft.unsteady, aircraft.boom
    assert boom is not None
    con[A_H], con[_E] = unsteady.tail_lift_slope, unsteady.downwash
    con[ARM], con[_LT] = unsteady.tail_arm / g.chord, unsteady.tail_arm
    con[_BOOM], con[_LE] = boom.vane_x, g.chord / 4
    con[_CHORD], con[_HALF] = unsteady.reference_chord or g.chord, g.chord / 2
    con[_KF], con[_KW] = boom.upwash_body, boom.upwash_wing
    con[_WASH] = unsteady.downwash_delay
    con[HAS_MOMENT] = float(aircraft.inertia.iyy is not None)
    con[CL_ALPHA], con[CM_ALPHA] = aircraft.value("CL_alpha") or 5.0, aircraft.value("Cm_alpha") or -1.0
    con[KNOWN_AT : KNOWN_AT + N] = KNOWN
    con[LEARNT_AT : LEARNT_AT + N_LEARNT] = LEARNT
    con[[KNOWN_AT, LEARNT_AT]] *= unsteady.tail_lift_slope
    con[KNOWN_AT + 8] *= unsteady.downwash
    for k, response in enumerate(
        (unsteady.lift_motion, unsteady.lift_gust, unsteady.upwash_motion, unsteady.upwash_gust)
    ):
        if response is not None:
            count = min(len(response.a), 4)
            con[_NW + k] = count
            con[_TABLES + 8 * k : _TABLES + 8 * k + count] = response.a[:count]
            con[_TABLES + 8 * k + 4 : _TABLES + 8 * k + 4 + count] = response.b[:count]
    return con


def set_wind(con: Array, share: float) -> None:
    """Let the mean wind be known to this share of the speed (standard deviation)."""
    con[KNOWN_AT + N - 1] = share


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

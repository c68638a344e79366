"""Generalised least squares of both longitudinal equations on wing, tail and gust, with uncertain constants.

    CL = CL_alpha A + CL_q qhat + CL_de de + a_h D,        A = Wx + Kg
    Cm = Cm_alpha A + Cm_q qhat + Cm_de de - a_h (l_t/c) D
    D  = x + g_t - e (W x + K g)(t - l_t/V) - (1 - e) A - 2 e (l_t/c) qhat

D is what tail and wing do beyond the quasi-steady derivatives, which stay the tabulated ones. The constants that the
profile gives (tail's share, arm and downwash, boom length, memories ...) are known to a prior standard deviation. Some
are estimated along, as far as the gust moves them; the rest of each, and the others, are considered: they widen the
total standard error. Residual spectra are log-quadratic in frequency and re-estimated (feasible GLS). SI, radians.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.estimation.physical_signals import (
    DK,
    DKL,
    DKM,
    DW,
    DX,
    GC,
    GT,
    KG,
    KL,
    KM,
    SIGNALS,
    WX,
    X,
)
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

QH, DE, CL, CM = SIGNALS, SIGNALS + 1, SIGNALS + 2, SIGNALS + 3
CHANNELS: Final = SIGNALS + 4

NUISANCES: Final = (
    *("tail share", "boom length", "vane skew", "span", "span, fast", "lift memory"),
    *("downwash", "downwash delay", "tail arm", "vane gain", "upwash memory", "mean wind"),
)
"""What else may be wrong: the constants of the profile, and the mean wind."""
N: Final = len(NUISANCES)
PARAMETERS: Final = 6 + N

# constants
_AH, _E, _LC, _LT, _BOOM, _LE, _CHORD, _HALF, _KF, _KW, _CLA, _CMA, _MOMENT, _WASH, _LEARNT = range(15)
_KNOWN: Final = _LEARNT + N
_NW, _NK, _NM, _NG = range(_KNOWN + N, _KNOWN + N + 4)
_TABLES: Final = _KNOWN + N + 4
CONSTANTS: Final = _TABLES + 32

PASSES: Final = 4
QUALITY: Final = 7
ORDER: Final = 3.5
"""Residual energy is scaled by n/(n - ORDER): parameters used up by each equation."""


@njit(cache=True, error_model="numpy")
def _invert(m: Array, inverse: Array) -> bool:
    """inverse <- m^-1 by Gauss-Jordan on the scaled matrix, m symmetric positive; False if singular."""
    n = m.shape[0]
    work = np.zeros((n, 2 * n))
    scale = np.empty(n)
    for i in range(n):
        if not (m[i, i] > 0.0 and math.isfinite(m[i, i])):
            return False
        scale[i] = 1.0 / math.sqrt(m[i, i])
    for i in range(n):
        for j in range(n):
            work[i, j] = m[i, j] * scale[i] * scale[j]
        work[i, n + i] = 1.0
    for k in range(n):
        pivot = work[k, k]
        if not pivot > 1e-10:
            return False
        for j in range(2 * n):
            work[k, j] /= pivot
        for i in range(n):
            if i != k:
                f = work[i, k]
                for j in range(2 * n):
                    work[i, j] -= f * work[k, j]
    for i in range(n):
        for j in range(n):
            inverse[i, j] = work[i, n + j] * scale[i] * scale[j]
    return True


@njit(cache=True, error_model="numpy")
def _memory(amplitudes: Array, rates: Array, terms: int, s: complex) -> complex:
    """Frequency response of an indicial response; `s`: per chord travelled."""
    h = 1.0 + 0.0j
    for j in range(terms):
        h -= amplitudes[j] * s / (s + rates[j])
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
    a_h, e, lc = con[_AH], con[_E], con[_LC]
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
        gain = (1.0 + con[_KF] + con[_KW]) / (1.0 + con[_KF])
        # gust incidence at the CG that a constant's error feigns
        feigned = (
            (1, -s * gc + speed / con[_HALF] * qh * to_boom),
            (2, s * (gain * flow + gc)),
            (9, flow + gc),
            (10, con[_KW] / (1.0 + con[_KF]) * ((f_m - 1.0) * x * to_boom - (f_g - 1.0) * gc)),
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
        for j, lift in (
            (0, d),
            (6, a_h * (a - dw - dk - 2.0 * lc * qh)),
            (7, a_h * e * s * (dw + dk)),
        ):
            base[j, 0, i] = 0.0
            base[j, 1, i] = 0.0
            base[j, 2, i] = lift
            base[j, 3, i] = -lc * lift
        further = -s * late * gt + e * s * late * (dw + dk) - 2.0 * e * lc * qh
        base[8, 0, i] = 0.0
        base[8, 1, i] = 0.0
        base[8, 2, i] = a_h * further
        base[8, 3, i] = -a_h * lc * (further + d)
        # A mean wind wrong by a share of the speed is motion by -(theta - x) and a gust that meets boom and tail apart.
        theta = speed / con[_HALF] * qh / s
        w_m = _memory(con[t : t + 4], con[t + 4 : t + 8], int(con[_NW]), s / chords)
        da = w_m * (x - theta) + met * (theta * to_boom - x * np.exp(-s * lead))
        base[11, 0, i] = da
        base[11, 1, i] = theta * (to_boom * to_tail - 1.0) - (1.0 - e) * da - e * washed * da
        base[11, 2, i] = 0.0
        base[11, 3, i] = 0.0


@njit(cache=True, error_model="numpy")
def _residual_spectrum(residual: Complex, omega: Array, smooth: Array) -> None:
    """Log-quadratic spectrum of a residual, by gamma regression from a logarithmic start -> `smooth` (frequencies,)."""
    lines = omega.shape[0]
    z = np.empty((lines, 3))
    power = np.empty(lines)
    zz = np.zeros((3, 3))
    for i in range(lines):
        u = math.log(omega[i] / math.pi)
        z[i, 0], z[i, 1], z[i, 2] = 1.0, u, u * u
        power[i] = residual[i].real ** 2 + residual[i].imag ** 2 + 1e-300
        for a in range(3):
            for b in range(3):
                zz[a, b] += z[i, a] * z[i, b]
    inverse = np.empty((3, 3))
    if not _invert(zz, inverse):
        smooth[:] = power.mean()
        return
    beta = np.zeros(3)
    for k in range(5):
        pull = np.zeros(3)
        for i in range(lines):
            level = beta[0] * z[i, 0] + beta[1] * z[i, 1] + beta[2] * z[i, 2]
            # E ln|r|^2 of a complex normal is 0.577 below the logarithm of its mean.
            off = math.log(power[i]) + 0.5772156649 if k == 0 else power[i] / math.exp(level) - 1.0
            for a in range(3):
                pull[a] += z[i, a] * off
        for a in range(3):
            for b in range(3):
                beta[a] += inverse[a, b] * pull[b]
    for i in range(lines):
        smooth[i] = math.exp(beta[0] + beta[1] * z[i, 1] + beta[2] * z[i, 2])


@njit(cache=True, error_model="numpy")
def _design(f: Complex, wing: Complex, base: Complex, con: Array, cla: float, cma: float, g: Complex) -> None:
    """`g` (2, PARAMETERS, frequencies): columns of CL and Cm, the six derivatives and all nuisances."""
    a_h, lc = con[_AH], con[_LC]
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


@njit(cache=True, error_model="numpy")
def _deviance(residual: Complex, omega: Array, smooth: Array) -> float:
    """-2 log likelihood of a residual whose spectrum is log-quadratic, but for a constant."""
    _residual_spectrum(residual, omega, smooth)
    total = 0.0
    for i in range(omega.shape[0]):
        total += 2.0 * (math.log(smooth[i]) + (residual[i].real ** 2 + residual[i].imag ** 2) / smooth[i])
    return total


@njit(cache=True, error_model="numpy")
def _quasi_steady(f: Complex, rho: Array, z: Complex, omega: Array, smooth: Array) -> float:
    """Deviance of z = c_alpha (x + g_cg) + c_q qhat + c_de de, generalised least squares; what split assumes."""
    lines = omega.shape[0]
    g = np.empty((3, lines), dtype=np.complex128)
    for i in range(lines):
        g[0, i], g[1, i], g[2, i] = f[X, i] + rho[i] * f[GC, i], f[QH, i], f[DE, i]
    residual = z.copy()
    smooth[:] = 1.0
    inverse = np.empty((3, 3))
    for k in range(PASSES):
        m = np.zeros((3, 3))
        rhs = np.zeros(3)
        for i in range(lines):
            for a in range(3):
                rhs[a] += (g[a, i].real * z[i].real + g[a, i].imag * z[i].imag) / smooth[i]
                for b in range(3):
                    m[a, b] += (g[a, i].real * g[b, i].real + g[a, i].imag * g[b, i].imag) / smooth[i]
        if not _invert(m, inverse):
            return math.inf
        theta = inverse @ rhs
        for i in range(lines):
            residual[i] = z[i] - (theta[0] * g[0, i] + theta[1] * g[1, i] + theta[2] * g[2, i])
        if k < PASSES - 1:
            _residual_spectrum(residual, omega, smooth)
    return _deviance(residual, omega, smooth)


@njit(cache=True, error_model="numpy")
def fit(
    f: Complex,
    omega: Array,
    derivative: Array,
    speed: float,
    con: Array,
    noise: float,
    share: float,
    past: Array,
    close: bool,
    theta: Array,
    stat: Array,
    total: Array,
    quality: Array,
    rho: Array,
) -> bool:
    """Estimate from the spectra `f` (CHANNELS, frequencies) and the sums over segments closed before.

    `derivative`: factor of Cm for its central difference; `noise`: energy of the vane's noise on a line; `share`: T df,
    of independent lines. Edits `past` (PARAMETERS, 2 PARAMETERS + 1 + N): normal matrix, score cloud, right side,
    cross terms; `close` adds this segment. Fills `theta` (PARAMETERS,), `stat` and `total` standard errors
    (PARAMETERS,), `quality` (QUALITY,): residual and signal energy of CL and Cm, gust share, and the deviance of both
    equations for this model and for the quasi-steady one on the same angle of attack.
    """
    lines = omega.shape[0]
    n = PARAMETERS
    wing = np.empty((2, lines), dtype=np.complex128)
    base = np.empty((N, 4, lines), dtype=np.complex128)
    g = np.empty((2, PARAMETERS, lines), dtype=np.complex128)
    gust_power = np.empty(lines)
    turbulent = wiener(f, omega, noise, gust_power, rho)
    columns(f, omega, speed, con, rho, wing, base)
    y = np.empty((2, lines), dtype=np.complex128)
    residual = np.empty((2, lines), dtype=np.complex128)
    spectrum = np.ones((2, lines))
    for i in range(lines):
        tail = con[_AH] * wing[1, i]
        y[0, i] = f[CL, i] - tail
        y[1, i] = f[CM, i] * derivative[i] + con[_LC] * tail
        spectrum[1, i] = 0.1
    prior = np.zeros(n)
    equations = 2 if con[_MOMENT] > 0.0 else 1
    if equations == 1:
        prior[3:6] = 1.0
    for j in range(N):
        prior[6 + j] = 1.0 / max(turbulent * con[_LEARNT + j], 1e-4 * con[_KNOWN + j], 1e-9) ** 2
    independent = min(max(share, 1e-3), 1.0)
    m = np.empty((n, n))
    rhs = np.empty(n)
    inverse = np.empty((n, n))
    theta[:] = 0.0
    theta[0], theta[3] = con[_CLA], con[_CMA]
    for k in range(PASSES):
        _design(f, wing, base, con, theta[0], theta[3], g)
        for a in range(n):
            rhs[a] = past[a, 2 * n]
            for b in range(a + 1):
                m[a, b] = past[a, b]
        for q in range(equations):
            for i in range(lines):
                weight = 2.0 * independent / spectrum[q, i]
                for a in range(n):
                    ga = g[q, a, i]
                    re, im = weight * ga.real, weight * ga.imag
                    rhs[a] += re * y[q, i].real + im * y[q, i].imag
                    for b in range(a + 1):
                        m[a, b] += re * g[q, b, i].real + im * g[q, b, i].imag
        for a in range(n):
            for b in range(a):
                m[b, a] = m[a, b]
            m[a, a] += prior[a]
        if not _invert(m, inverse):
            return False
        for a in range(n):
            theta[a] = 0.0
            for b in range(n):
                theta[a] += inverse[a, b] * rhs[b]
        for q in range(equations):
            for i in range(lines):
                left = y[q, i]
                for a in range(n):
                    left -= g[q, a, i] * theta[a]
                residual[q, i] = left
            if k < PASSES - 1:
                _residual_spectrum(residual[q], omega, spectrum[q])
                for i in range(lines):
                    spectrum[q, i] *= lines / (lines - ORDER)

    score = np.zeros((lines, n))
    cross = np.empty((n, N))
    for a in range(n):
        for j in range(N):
            cross[a, j] = past[a, 2 * n + 1 + j]
    for q in range(equations):
        for i in range(lines):
            weight = 2.0 * independent / spectrum[q, i]
            re, im = weight * residual[q, i].real, weight * residual[q, i].imag
            for a in range(n):
                ga = g[q, a, i]
                score[i, a] += ga.real * re + ga.imag * im
                for j in range(N):
                    gj = g[q, 6 + j, i]
                    cross[a, j] += weight * (ga.real * gj.real + ga.imag * gj.imag)
    lags = min(max(math.ceil(2.0 / independent), 2), 12)
    cloud = np.zeros((n, n))
    for lag in range(lags + 1):
        weight = (1.0 if lag == 0 else 2.0 * (1.0 - lag / (lags + 1.0))) * lines / (lines - ORDER)
        for i in range(lines - lag):
            for a in range(n):
                for b in range(n):
                    cloud[a, b] += weight * score[i, a] * score[i + lag, b]
    for a in range(n):
        sandwich = inverse[a, a]
        total_square = 0.0
        for b in range(n):
            for c in range(n):
                spread = cloud[b, c] + past[b, n + c]
                if b == c:
                    spread += prior[b]
                total_square += inverse[a, b] * spread * inverse[c, a]
        stat[a] = math.sqrt(max(sandwich, total_square))
        total_square = stat[a] ** 2
        for j in range(N):
            effect = 0.0
            for b in range(n):
                effect -= inverse[a, b] * cross[b, j]
            left = con[_KNOWN + j] ** 2 - (turbulent * con[_LEARNT + j]) ** 2
            total_square += effect * effect * max(left, 0.0)
        total[a] = math.sqrt(total_square)

    quality[:] = 0.0
    quality[4] = turbulent
    for q in range(equations):
        for i in range(lines):
            z = f[CL, i] if q == 0 else f[CM, i] * derivative[i]
            quality[q] += residual[q, i].real ** 2 + residual[q, i].imag ** 2
            quality[2 + q] += z.real**2 + z.imag**2
            y[q, i] = z
        quality[5] += independent * _deviance(residual[q], omega, spectrum[q])
        quality[6] += independent * _quasi_steady(f, rho, y[q], omega, spectrum[q])
    if close:
        for a in range(n):
            for b in range(n):
                past[a, b] = m[a, b] - (prior[a] if a == b else 0.0)
                past[a, n + b] += cloud[a, b]
            past[a, 2 * n] = rhs[a]
            for j in range(N):
                past[a, 2 * n + 1 + j] = cross[a, j]
    return math.isfinite(theta.sum())


KNOWN: Final = (0.2, 6e-3, 4e-3, 1.0, 1.0, 0.3, 0.2, 15e-3, 0.09, 0.0115, 0.4, 0.0)
"""Prior standard deviation of each nuisance; of the tail's share and downwash relative to their value, delays in s.
The mean wind's comes with the data (set_wind)."""
LEARNT: Final = (0.2, 6e-3, 4e-3, 1.0, 1.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""How much of it turbulence is let move: 0 is only considered."""


def constants(aircraft: Aircraft) -> Array:
    """The constants of `fit`, (CONSTANTS,); for an aircraft for which `why_not` gives no reason against it."""
    con = np.zeros(CONSTANTS)
    g, unsteady, boom = aircraft.geometry, aircraft.unsteady, aircraft.boom
    assert boom is not None
    con[_AH], con[_E] = unsteady.tail_lift_slope, unsteady.downwash
    con[_LC], con[_LT] = unsteady.tail_arm / g.chord, unsteady.tail_arm
    con[_BOOM], con[_LE] = boom.vane_x, g.chord / 4
    con[_CHORD], con[_HALF] = unsteady.reference_chord or g.chord, g.chord / 2
    con[_KF], con[_KW] = boom.upwash_body, boom.upwash_wing
    con[_WASH] = unsteady.downwash_delay
    con[_MOMENT] = float(aircraft.inertia.iyy is not None)
    con[_CLA], con[_CMA] = aircraft.value("CL_alpha") or 5.0, aircraft.value("Cm_alpha") or -1.0
    for at, values in ((_KNOWN, KNOWN), (_LEARNT, LEARNT)):
        con[at : at + N] = values
        con[at] *= unsteady.tail_lift_slope
        con[at + 6] *= unsteady.downwash
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
    con[_KNOWN + N - 1] = share


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

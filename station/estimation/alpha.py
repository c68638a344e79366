"""From the vane to the angle of attack at the CG: zero, steady upwash, rate term, and the split correction.

The vane reads, for a small incidence,

    alpha_v = H_v [(1 + k_f)(alpha_i - q x/V + g(t + x/V)) + k_w (F_m alpha_i + F_g g at the leading edge)] + zero

with alpha_i the inertial angle of attack, g the gust's, k_f the body's upwash (no memory), k_w the wing's (memory F_m
for motion, F_g for gusts) and H_v the vane's own dynamics. The split correction (S2) predicts the part
due to motion, takes what is left as the gust at the boom, and delays only that until it reaches the CG. Causal, no
latency: a vane behind the CG, or near it and slow, shows a gust when it has passed.

Corrections that need no inertial data are kept for methods II (steady), III (total alpha delayed by x/V) and V (that,
and the scale 1/(1 + k_u(f)) in the transform): Martos 2013. SI, radians.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.numerics.delay import delayed
from station.numerics.indicial import respond
from station.numerics.second_order import second_order, vane_lag
from station.profile import Aircraft, Indicial

Array = NDArray[np.float64]

RING: Final = 2048
"""Delay lines, ticks: longer than the 30 s of the mean speed."""
MEAN_S: Final = 30.0
READY_S: Final = 1.0
"""Wing memory and delay lines are full."""

# params
_ZERO, _KF, _KW, _X, _Y, _LE, _VANE_LAG, _TAIL, _CHORD, _VANE, _NM, _NG = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 17, 18
_MA, _MB, _GA, _GB, _GX, PARAMS = 19, 23, 27, 31, 35, 36
# state
_COUNT, _VF, _VSUM, _XIN, _LEIN, _PIN, _VS, _MS, _GS, _SPLIT, _SEEN = 0, 1, 2, 3, 4, 5, 6, 8, 12, 16, 17
STATE: Final = 20
# out
STEADY, SCALED_LATE, RATE_LATE, FAST, SPLIT, GUST, GUST_STEP, BOOM_GUST, RATE, SPEED_MEAN, READY, RESIDUAL = range(12)
BEHIND: Final = 12
"""By how long gusts are seen too late to be told at the CG when they are there, s."""
OUT: Final = 13


@njit(cache=True)
def step(
    par: Array,
    s: Array,
    ring: Array,
    dt: float,
    vane: float,
    p: float,
    q: float,
    speed: float,
    alpha_i: float,
    out: Array,
) -> None:
    """One tick: raw vane, rates, true airspeed, inertial angle of attack (NaN: no split) -> `out` (OUT,).

    Edits `s` (STATE,) and `ring` (RING, 4): scaled vane, rate term, gust at the boom times V, and V.
    """
    n = ring.shape[0]
    count = int(s[_COUNT])
    at = count % n
    ca = 1.0 / (1.0 + par[_KF] + par[_KW])
    if count == 0:
        s[_VF] = speed
        s[_VSUM] = 0.0
    # Airspeed without its sensor's noise for the rate term and the gust, 0.2 s; and its running mean.
    s[_VF] += (1.0 - math.exp(-dt / 0.2)) * (speed - s[_VF])
    v = s[_VF]
    window = min(math.floor(MEAN_S / dt + 0.5), n - 1)
    s[_VSUM] += speed
    if count >= window:
        s[_VSUM] -= ring[(at - window) % n, 3]
    mean = s[_VSUM] / min(count + 1, window)
    ring[at, 3] = speed

    rate = (par[_X] * q - par[_Y] * p) / v
    flow = vane - par[_ZERO]
    steady = ca * flow + rate
    if count == 0:
        for i in range(n):
            ring[i, 0] = ca * flow
            ring[i, 1] = rate
    ring[at, 0] = ca * flow
    ring[at, 1] = rate
    tau = par[_GX] / mean / dt
    out[STEADY] = steady
    out[RATE] = rate
    out[SPEED_MEAN] = mean
    out[SCALED_LATE] = delayed(ring, at, 0, tau)
    out[RATE_LATE] = delayed(ring, at, 1, tau)

    if not math.isfinite(alpha_i):
        s[_COUNT] = count + 1
        s[_SPLIT] = 0.0
        out[FAST] = math.nan
        out[SPLIT] = math.nan
        out[GUST] = math.nan
        out[GUST_STEP] = math.nan
        out[BOOM_GUST] = math.nan
        out[RESIDUAL] = math.nan
        out[BEHIND] = math.nan
        out[READY] = 0.0
        ring[at, 2] = 0.0
        return

    n_m, n_g = int(par[_NM]), int(par[_NG])
    if s[_SPLIT] == 0.0:
        # Start as if the present state had lasted, with no gust.
        s[_XIN] = alpha_i
        for j in range(n_m):
            s[_MS + j] = alpha_i
        for j in range(n_g):
            s[_GS + j] = 0.0
        s[_LEIN] = 0.0
        start = (1.0 + par[_KF]) * (alpha_i - rate) + par[_KW] * alpha_i
        s[_PIN] = s[_SEEN] = s[_SEEN + 1] = start
        s[_SEEN + 2] = 0.0
        s[_VS] = start
        s[_VS + 1] = 0.0
        for i in range(n):
            ring[i, 2] = 0.0
    chords = v * dt / par[_CHORD]
    wing = respond(s, _MS, par[_MA : _MA + 4], par[_MB : _MB + 4], n_m, s[_XIN], alpha_i, chords)
    s[_XIN] = alpha_i
    flown = (1.0 + par[_KF]) * (alpha_i - rate) + par[_KW] * wing
    # Straight lines between ticks lose (omega dt)^2/12 of a sine: its bend, as it goes on, is given back.
    bend = flown - 2.0 * s[_SEEN] + s[_SEEN + 1]
    seen = flown - (2.0 * bend - s[_SEEN + 2]) / 12.0
    s[_SEEN], s[_SEEN + 1], s[_SEEN + 2] = flown, s[_SEEN], bend
    m = par[_VANE : _VANE + 8]
    angle = m[0] * s[_VS] + m[1] * s[_VS + 1] + m[4] * s[_PIN] + m[6] * seen
    swing = m[2] * s[_VS] + m[3] * s[_VS + 1] + m[5] * s[_PIN] + m[7] * seen
    s[_VS], s[_VS + 1], s[_PIN] = angle, swing, seen
    left = flow - angle
    leading_edge = delayed(ring, at - 1, 2, max(par[_LE] / v / dt - 1.0, 0.0)) / v
    memory = respond(s, _GS, par[_GA : _GA + 4], par[_GB : _GB + 4], n_g, s[_LEIN], leading_edge, chords)
    s[_LEIN] = leading_edge
    boom = (left - par[_KW] * memory) / (1.0 + par[_KF])
    # The wind is carried, not the angle: what arrives at the CG meets the speed of that moment.
    ring[at, 2] = boom * v
    late = max(par[_GX] / v - par[_VANE_LAG], 0.0) / dt
    gust = delayed(ring, at, 2, late) / v
    out[FAST] = alpha_i + boom
    out[SPLIT] = alpha_i + gust
    out[GUST] = gust
    out[BEHIND] = max(par[_VANE_LAG] - par[_GX] / v, 0.0)
    out[GUST_STEP] = gust - delayed(ring, at, 2, late + par[_TAIL] / v / dt) / v
    out[BOOM_GUST] = boom
    out[RESIDUAL] = left
    s[_SPLIT] += 1.0
    out[READY] = 1.0 if s[_SPLIT] * dt >= READY_S else 0.0
    s[_COUNT] = count + 1


def parameters(aircraft: Aircraft, dt: float) -> Array:
    """The constants of `step` for an aircraft, (PARAMS,). Without a boom: a vane at the CG that tells the truth."""
    par = np.zeros(PARAMS)
    par[_CHORD] = aircraft.unsteady.reference_chord or aircraft.geometry.chord
    par[_TAIL] = aircraft.unsteady.tail_arm
    boom = aircraft.boom
    frequency, damping = (boom.vane_frequency, boom.vane_damping) if boom else (1000.0, 0.7)
    if boom is not None:
        par[[_ZERO, _KF, _KW, _X, _Y]] = boom.zero, boom.upwash_body, boom.upwash_wing, boom.vane_x, boom.vane_y
        par[_GX] = boom.gust_x
        par[_LE] = max(boom.gust_x - aircraft.gust_edge, 0.0)
    par[_VANE_LAG] = vane_lag(frequency, damping)
    par[_VANE : _VANE + 8] = second_order(frequency, damping, dt)
    # The upwash follows the wing's vorticity: an aircraft whose lift has no memory still has this one.
    for response, amplitude, rate, terms in (
        (aircraft.unsteady.upwash_motion, _MA, _MB, _NM),
        (aircraft.unsteady.upwash_gust, _GA, _GB, _NG),
    ):
        fit = Indicial(a=(0.0,), b=(1.0,)) if response is None else response
        count = min(len(fit.a), 4)
        par[terms] = count
        par[amplitude : amplitude + count] = fit.a[:count]
        par[rate : rate + count] = fit.b[:count]
    return par


class Vane:
    """The state of `step`, and what it last gave (`out`, indexed by STEADY ... RESIDUAL)."""

    def __init__(self, aircraft: Aircraft, dt: float) -> None:
        self.parameters = parameters(aircraft, dt)
        self._dt = dt
        self._state = np.zeros(STATE)
        self._ring = np.zeros((RING, 4))
        self.out = np.full(OUT, math.nan)
        self.arrays = (self.parameters, self._state, self._ring, self.out)
        """As tick.advance takes them."""

    def restart(self) -> None:
        """Begin anew from the next sample."""
        self._state[:] = 0.0
        self._ring[:] = 0.0
        self.out[:] = math.nan

    def step(self, vane: float, p: float, q: float, speed: float, alpha_i: float) -> None:
        """One tick; `alpha_i` NaN where there is no inertial angle of attack."""
        step(self.parameters, self._state, self._ring, self._dt, vane, p, q, speed, alpha_i, self.out)

"""What the lift's memory and the tail's late downwash do to the estimates of split+gust, as the profile has them.

split+gust takes lift and moment for quasi-steady but for the tail that meets the gust late, and leaves out

    v = CL_alpha (W x + K g - x - g) + a_h (x + g_t - e (W x + K g)(t - T) - (1 - e)(W x + K g) - 2 e (l_t/c) q c/2V)

(x the motion's angle of attack, g the gust's, g_t that of T = l_t/V ago; Cm alike, the tail with -a_h l_t/c; the
tail's gust without memory, which d carries, is part of v too). The fit takes M^-1 Re(X^H v) of that for derivatives.
In calm air it does so too, with alpha and q that the elevator makes: that is what one calls the derivatives of a
manoeuvre, and differs from the quasi-steady ones by up to 15 % (Twin Otter, Cm_alpha). In gusts, which move alpha
without q and elevator, less of v passes for derivatives, and the estimates drift towards the quasi-steady ones: by the
difference of the two. SI, rad.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.numerics.regression import invert
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

WX, WD, TX, TD, TQ, ARM, MASS, INERTIA, RELATIVE = range(9)
ROWS: Final = 9
"""Of `weights`: what the wing's part of v has of alpha and d for a unit of CL_alpha, and the tail's of alpha, d and
q c/2V in CL; l_t/c; inertia in heave and pitch, s 2m/(rho S V) and s 4 Iyy/(rho S c^2 V), and 4m/(rho S c)."""
_MET, _CALM, _NORMAL = 0, 4, 7
SUMS: Final = 13
"""Over closed segments, each equation's products of v with four regressors and with three in calm air, and, in the
first row only, the normal matrix of these."""
_CHORD, _LENGTH, _EDGE, _TAIL, _SHARE, _WASH, _LATE, _HEAVY, _PITCHING, _NW, _NK, _WA, _WB, _KA, _KB, KNOWN = (
    *range(11), 11, 15, 19, 23, 27
)  # fmt: skip


def known(aircraft: Aircraft) -> Array:
    """What `weights` depend on, (KNOWN,); zeros for an aircraft without tail, inertia or memory of its lift."""
    u, g = aircraft.unsteady, aircraft.geometry
    made = np.zeros(KNOWN)
    if not (u.memory and u.tail_arm > 0.0 and aircraft.inertia.iyy):
        return made
    made[_CHORD], made[_LENGTH], made[_EDGE] = g.chord, u.reference_chord or g.chord, aircraft.gust_edge
    made[_TAIL], made[_SHARE] = u.tail_arm, u.tail_lift_slope
    made[_WASH], made[_LATE] = u.downwash, u.downwash_delay
    swept = g.wing_area * g.chord
    made[_HEAVY], made[_PITCHING] = 4 * aircraft.inertia.mass / swept, 4 * aircraft.inertia.iyy / (swept * g.chord)
    for response, terms, a, b in ((u.lift_motion, _NW, _WA, _WB), (u.lift_gust, _NK, _KA, _KB)):
        if response is not None:
            count = min(len(response.a), 4)
            made[terms] = count
            made[a : a + count], made[b : b + count] = response.a[:count], response.b[:count]
    return made


@njit(cache=True, error_model="numpy")
def _remembered(k: Array, a: int, b: int, terms: int, s: complex) -> complex:
    """Frequency response of an indicial response; `s`: per chord travelled."""
    h = 1.0 + 0.0j
    for j in range(terms):
        h -= k[a + j] * s / (s + k[b + j])
    return h


@njit(cache=True, error_model="numpy")
def weights(k: Array, speed: float, density: float, frequencies: Array, memory: Complex) -> None:
    """`memory` (ROWS, frequencies) at a mean airspeed (m/s), density of the air (kg/m3) and each frequency (Hz).

    `k`: see `known`.
    """
    if not k[_HEAVY] > 0.0:
        return
    for i in range(frequencies.shape[0]):
        s = 2j * math.pi * frequencies[i] / speed
        to_tail = np.exp(-s * k[_TAIL])
        # g = d/(1 - e^{-s T}), and alpha without it is the motion's.
        since = 1.0 - to_tail
        w = _remembered(k, _WA, _WB, int(k[_NW]), s * k[_LENGTH])
        met = _remembered(k, _KA, _KB, int(k[_NK]), s * k[_LENGTH]) * np.exp(s * k[_EDGE])
        washed = 1.0 - k[_WASH] + k[_WASH] * to_tail * np.exp(-s * speed * k[_LATE])
        motion, gust = 1.0 - washed * w, to_tail - washed * met
        arm = k[_TAIL] / k[_CHORD]
        memory[WX, i], memory[WD, i] = w - 1.0, (met - w) / since
        memory[TX, i], memory[TD, i] = k[_SHARE] * motion, k[_SHARE] * (gust - motion) / since
        memory[TQ, i], memory[ARM, i] = -2.0 * k[_SHARE] * k[_WASH] * arm, arm
        memory[MASS, i] = 0.5 * s * k[_HEAVY] * k[_CHORD] / density
        memory[INERTIA, i] = s * k[_PITCHING] / density
        memory[RELATIVE, i] = k[_HEAVY] / density


@njit(cache=True, error_model="numpy")
def left_out(memory: Complex, x: Complex, theta: Array, inverse: Array, past: Array, close: bool, out: Array) -> None:
    """By how much the estimates `theta` (2, 3) lie off those of the same elevator in calm air: `out` (2, 3).

    There alpha and q are the short period's. `inverse` (4, 4): of the normal matrix of `x` (4, frequencies): alpha,
    q c/2V, elevator, d. `past` (2, SUMS): sums over closed segments; `close` adds this one.
    """
    met, calm, normal = np.zeros((2, 4)), np.zeros((2, 3)), np.zeros((3, 3))
    alone = np.empty(3, dtype=np.complex128)
    for f in range(x.shape[1]):
        de = x[2, f]
        lift, moment = memory[MASS, f] + theta[0, 0], memory[INERTIA, f] - theta[1, 1]
        rate = theta[0, 1] - memory[RELATIVE, f]
        determinant = lift * moment + rate * theta[1, 0]
        alone[0] = -(theta[0, 2] * moment + rate * theta[1, 2]) / determinant * de
        alone[1] = (lift * theta[1, 2] - theta[1, 0] * theta[0, 2]) / determinant * de
        alone[2] = de
        tail = memory[TX, f] * x[0, f] + memory[TD, f] * x[3, f] + memory[TQ, f] * x[1, f]
        calm_tail = memory[TX, f] * alone[0] + memory[TQ, f] * alone[1]
        wing = memory[WX, f] * x[0, f] + memory[WD, f] * x[3, f]
        calm_wing = memory[WX, f] * alone[0]
        for e in range(2):
            share = 1.0 if e == 0 else -memory[ARM, f].real
            v, calm_v = theta[e, 0] * wing + share * tail, theta[e, 0] * calm_wing + share * calm_tail
            for i in range(4):
                met[e, i] += x[i, f].real * v.real + x[i, f].imag * v.imag
            for i in range(3):
                calm[e, i] += alone[i].real * calm_v.real + alone[i].imag * calm_v.imag
        for i in range(3):
            for j in range(i + 1):
                normal[i, j] += alone[i].real * alone[j].real + alone[i].imag * alone[j].imag
    at = _NORMAL
    for i in range(3):
        for j in range(i + 1):
            normal[i, j] += past[0, at]
            normal[j, i] = normal[i, j]
            if close:
                past[0, at] = normal[i, j]
            at += 1
    of_calm = np.empty((3, 3))
    is_known = invert(normal, 3, of_calm)
    for e in range(2):
        for i in range(4):
            met[e, i] += past[e, _MET + i]
            if close:
                past[e, _MET + i] = met[e, i]
        for i in range(3):
            calm[e, i] += past[e, _CALM + i]
            if close:
                past[e, _CALM + i] = calm[e, i]
        for j in range(3):
            out[e, j] = 0.0
            if is_known:
                for i in range(4):
                    out[e, j] += inverse[j, i] * met[e, i]
                for i in range(3):
                    out[e, j] -= of_calm[j, i] * calm[e, i]

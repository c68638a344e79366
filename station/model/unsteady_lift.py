"""What unsteady lift (indicial) and the tail's late downwash do to the estimates of split+gust, as the profile has
them.

split+gust takes lift and moment for quasi-steady but for the tail that meets the gust late, and leaves out

    v = CL_alpha (W x + K g - x - g) + a_h (x + g_t - e (W x + K g)(t - T) - (1 - e)(W x + K g) - 2 e (l_t/c) q c/2V)

(x the motion's angle of attack, g the gust's, g_t that of T = l_t/V ago; Cm alike, the tail with -a_h l_t/c; the
tail's gust without lag, which d carries, is part of v too). The fit takes M^-1 Re(X^H v) of that for derivatives.
In calm air it does so too, with alpha and q that the elevator makes: that is what one calls the derivatives of a
manoeuvre, and differs from the quasi-steady ones by up to 15 % (Twin Otter, Cm_alpha). In gusts, which move alpha
without q and elevator, less of v passes for derivatives, and the estimates drift towards the quasi-steady ones: by the
difference of the two. SI, rad.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.numerics.indicial import Response, frequency_response, response
from station.numerics.regression import invert
from station.numerics.spectra import carry
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

WX, WD, TX, TD, TQ, ARM, MASS, INERTIA, RELATIVE, SIGN = range(10)
ROWS: Final = 10
"""Of `weights`: what the wing's part of v has of alpha and d for a unit of CL_alpha, and the tail's of alpha, d and
q c/2V in CL; l_t/c; inertia in heave and pitch, s 2m/(rho S V) and s 4 Iyy/(rho S c^2 V), 4m/(rho S c), and the
force's sign."""


class Known(NamedTuple):
    """What `weights` depend on of an aircraft."""

    chord: float
    reference_chord: float
    """That indicial responses are by."""
    gust_edge: float
    """m ahead of the CG, where the wing meets a gust."""
    tail_arm: float
    tail_share: float
    downwash: float
    downwash_delay: float
    heave: float
    """4m/(S c), kg/m3; 0: there is nothing to reckon with."""
    pitching: float
    """4 Iyy/(S c^2), kg/m2."""
    sign: float
    """Of the force over the lift: 1 for CL, -1 for CZ."""
    motion: Response
    gust: Response


class Sums(NamedTuple):
    """Over closed segments."""

    met: Array
    """Each equation's products of v with four regressors, (2, 4)."""
    calm: Array
    """And with three in calm air, (2, 3)."""
    normal: Array
    """The normal matrix of these, its lower triangle, (3, 3)."""


@register_jitable
def no_sums() -> Sums:
    """Before the first segment is closed."""
    return Sums(np.zeros((2, 4)), np.zeros((2, 3)), np.zeros((3, 3)))


def known(aircraft: Aircraft, body: bool = False) -> Known:
    """As the profile has it; nothing of an aircraft without tail, inertia or unsteady lift. `body`: the force is CZ."""
    u, g = aircraft.unsteady, aircraft.geometry
    motion, gust = response(u.lift_motion), response(u.lift_gust)
    if not (u.memory and u.tail_arm > 0.0 and aircraft.inertia.iyy):
        return Known(*(0.0,) * 10, motion, gust)
    swept = g.wing_area * g.chord
    return Known(
        chord=g.chord,
        reference_chord=u.reference_chord or g.chord,
        gust_edge=aircraft.gust_edge,
        tail_arm=u.tail_arm,
        tail_share=u.tail_lift_slope,
        downwash=u.downwash,
        downwash_delay=u.downwash_delay,
        heave=4 * aircraft.inertia.mass / swept,
        pitching=4 * aircraft.inertia.iyy / (swept * g.chord),
        sign=-1.0 if body else 1.0,
        motion=motion,
        gust=gust,
    )


@njit(cache=True, error_model="numpy")
def weights(k: Known, speed: float, density: float, frequencies: Array, rows: Complex) -> None:
    """`rows` (ROWS, frequencies) at a mean airspeed (m/s), density of the air (kg/m3) and each frequency (Hz)."""
    if not k.heave > 0.0:
        return
    for i in range(frequencies.shape[0]):
        s = 2j * math.pi * frequencies[i] / speed
        to_tail = np.exp(-s * k.tail_arm)
        # g = d/(1 - e^{-s T}), and alpha without it is the motion's.
        since = 1.0 - to_tail
        w = frequency_response(k.motion, s * k.reference_chord)
        met = frequency_response(k.gust, s * k.reference_chord) * np.exp(s * k.gust_edge)
        washed = 1.0 - k.downwash + k.downwash * to_tail * np.exp(-s * speed * k.downwash_delay)
        motion, gust = 1.0 - washed * w, to_tail - washed * met
        arm = k.tail_arm / k.chord
        rows[WX, i], rows[WD, i] = w - 1.0, (met - w) / since
        rows[TX, i], rows[TD, i] = k.tail_share * motion, k.tail_share * (gust - motion) / since
        rows[TQ, i], rows[ARM, i] = -2.0 * k.tail_share * k.downwash * arm, arm
        rows[MASS, i] = 0.5 * s * k.heave * k.chord / density
        rows[INERTIA, i] = s * k.pitching / density
        rows[RELATIVE, i], rows[SIGN, i] = k.heave / density, k.sign


@njit(cache=True, error_model="numpy")
def _short_period(rows: Complex, f: int, theta: Array, de: complex, alone: Complex) -> None:
    """Alpha, q c/2V and elevator in calm air at line f, made by the elevator `de`, -> `alone` (3,)."""
    sign = rows[SIGN, f]
    lift, moment = rows[MASS, f] + sign * theta[0, 0], rows[INERTIA, f] - theta[1, 1]
    rate = sign * theta[0, 1] - rows[RELATIVE, f]
    by_elevator = sign * theta[0, 2]
    determinant = lift * moment + rate * theta[1, 0]
    alone[0] = -(by_elevator * moment + rate * theta[1, 2]) / determinant * de
    alone[1] = (lift * theta[1, 2] - theta[1, 0] * by_elevator) / determinant * de
    alone[2] = de


@njit(cache=True, error_model="numpy")
def _products(rows: Complex, x: Complex, theta: Array, sums: Sums) -> None:
    """Of v with the regressors `x` (4, frequencies) and with those of calm air, -> `sums`."""
    met, calm, normal = sums
    alone = np.empty(3, dtype=np.complex128)
    for f in range(x.shape[1]):
        _short_period(rows, f, theta, x[2, f], alone)
        tail = rows[TX, f] * x[0, f] + rows[TD, f] * x[3, f] + rows[TQ, f] * x[1, f]
        calm_tail = rows[TX, f] * alone[0] + rows[TQ, f] * alone[1]
        wing = rows[WX, f] * x[0, f] + rows[WD, f] * x[3, f]
        calm_wing = rows[WX, f] * alone[0]
        for e in range(2):
            share = rows[SIGN, f].real if e == 0 else -rows[ARM, f].real
            v, calm_v = theta[e, 0] * wing + share * tail, theta[e, 0] * calm_wing + share * calm_tail
            for i in range(4):
                met[e, i] += x[i, f].real * v.real + x[i, f].imag * v.imag
            for i in range(3):
                calm[e, i] += alone[i].real * calm_v.real + alone[i].imag * calm_v.imag
        for i in range(3):
            for j in range(i + 1):
                normal[i, j] += alone[i].real * alone[j].real + alone[i].imag * alone[j].imag


@njit(cache=True, error_model="numpy")
def drift(rows: Complex, x: Complex, theta: Array, inverse: Array, past: Sums, close: bool) -> Array:
    """By how much the estimates `theta` (2, 3 or more) differ from those of the same elevator in calm air, (2, 3).

    There alpha and q are the short period's. `inverse` (4, 4): of the normal matrix of `x` (4, frequencies): alpha,
    q c/2V, elevator, d. `close` adds this segment to the `past`.
    """
    now, out = no_sums(), np.zeros((2, 3))
    _products(rows, x, theta, now)
    met, calm, normal = now
    for i in range(3):
        carry(past.normal[i], normal[i, : i + 1], close)
        for j in range(i):
            normal[j, i] = normal[i, j]
    of_calm = np.empty((3, 3))
    is_known = invert(normal, 3, of_calm)
    for e in range(2):
        carry(past.met[e], met[e], close)
        carry(past.calm[e], calm[e], close)
        for j in range(3 if is_known else 0):
            for i in range(4):
                out[e, j] += inverse[j, i] * met[e, i]
            for i in range(3):
                out[e, j] -= of_calm[j, i] * calm[e, i]
    return out

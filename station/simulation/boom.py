"""What the vane on the nose boom shows.

    vane = H_v{ (1 + k_f) alpha_boom + k_w (F_m{alpha_i} + F_g{alpha_g at the wing's leading edge}) + bend } + zero

alpha_boom is the flow angle where the vane is: from the motion, with w lowered by q r (a nose-up rate moves the boom
up), and from the gust met there. k_f, the upwash of the body, is quasi-steady; k_w, that of the wing, follows the
vorticity, so it is unsteady (F_m for motion, F_g for a gust met at the leading edge). H_v is the vane's second-order
dynamics.

The boom bends by c_b az under its own weight and by c_t qbar times the flow angle under the load on its tip. Without a
mode it does so at once, az being that at the CG; with one, az is that at the vane, the bending is H_b's, the second
order of the mode, and the tip's own velocity counts too: turn bend - length bend' / V, where a boom turns its vane by
all of the bending and a wing by hardly any. What rolls the aircraft moves a vane that is off the middle. All lags are
advanced exactly for inputs that are straight lines between samples.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.profile import NO_BOOM, Boom
from station.simulation.trigonometry import arctangent


class SecondOrder(NamedTuple):
    """A system wn^2 / (s^2 + 2 zeta wn s + wn^2) at a fixed sampling interval: transition matrix and the weights of the
    last and the new input, which goes straight from one to the other."""

    a11: float
    a12: float
    a21: float
    a22: float
    old1: float
    old2: float
    new1: float
    new2: float


class VaneConstants(NamedTuple):
    """One vane at a fixed sampling interval."""

    there: bool

    x: float
    y: float
    z: float
    gust_x: float
    """Where the vane meets gusts."""
    body: float
    wing: float
    roll: float
    """Upwash of the body, of the wing and of its rolling."""
    sidewash: float
    """What the beta vane shows beyond the flow angle where it is, as a share of it."""
    zero: float
    flexure: float
    """Bending of the boom that turns the vane, rad per m/s2 of specific force down (negative when it is pulled up)."""
    tip_load: float
    """Bending per rad of flow angle and Pa of dynamic pressure."""
    has_mode: bool
    mode: SecondOrder
    mode_stiffness: float
    """Of the mode, wn^2, 1/s2."""
    mode_resistance: float
    """Its damping, 2 zeta wn, 1/s."""
    mode_length: float
    """How far the vane rises per rad of bending, m."""
    mode_turn: float
    """Share of the bending that turns the vane."""
    dynamics: SecondOrder
    dt: float
    """The interval, s."""


@lru_cache(maxsize=64)
def second_order(frequency: float, damping: float, dt: float) -> SecondOrder:
    """The system of that natural frequency (Hz) and damping ratio, sampled every `dt` seconds."""
    from scipy.linalg import expm

    wn = 2 * math.pi * frequency
    m = np.zeros((4, 4))
    m[:2, :2] = dt * np.array([[0.0, 1.0], [-(wn**2), -2 * damping * wn]])
    m[1, 2] = dt * wn**2
    m[2, 3] = 1.0
    e = expm(m)
    a, first, second = e[:2, :2], e[:2, 2], e[:2, 3]
    return SecondOrder(*(float(v) for part in (a.ravel(), first - second, second) for v in part))


def vane_constants(boom: Boom | None, dt: float) -> VaneConstants:
    """The vane, and its boom, sampled every `dt` seconds; without a boom one that is at the CG and, `there`, is not."""
    is_there, boom = boom is not None, boom or NO_BOOM
    frequency = boom.mode_frequency
    wn = 2 * math.pi * (frequency or 1.0)
    return VaneConstants(
        is_there,
        boom.vane_x,
        boom.vane_y,
        boom.vane_z,
        boom.gust_x,
        boom.upwash_body,
        boom.upwash_wing,
        boom.upwash_roll,
        boom.sidewash,
        boom.zero,
        boom.flexure,
        boom.tip_load / 1000.0,
        frequency is not None,
        second_order(frequency or 1.0, boom.mode_damping, dt),
        wn**2,
        2 * boom.mode_damping * wn,
        boom.mode_length,
        boom.mode_turn,
        second_order(boom.vane_frequency, boom.vane_damping, dt),
        dt,
    )


@njit(cache=True, error_model="numpy")
def lag(state: float, old: float, new: float, steps: float) -> float:
    """A first-order lag's output after an interval of `steps` time constants, its input going straight old -> new."""
    decay = math.exp(-steps)
    mean = -math.expm1(-steps) / steps
    out: float = decay * state + (mean - decay) * old + (1.0 - mean) * new
    return out


@njit(cache=True, error_model="numpy")
def upwash_step(table: NDArray[np.float64], state: NDArray[np.float64], old: float, new: float, chords: float) -> float:
    """Advance one indicial response of the upwash by an interval of `chords` chords travelled; its output, rad.

    table (2, n): amplitudes and exponents of the indicial response; state (n), changed in place.
    """
    out: float = new
    for i in range(table.shape[1]):
        state[i] = lag(state[i], old, new, table[1, i] * chords)
        out += table[0, i] * (state[i] - new)
    return out


@njit(cache=True, error_model="numpy")
def second_order_step(c: SecondOrder, state: NDArray[np.float64], new: float) -> float:
    """Advance a system, the vane's or the boom's, by one interval with its input going straight from the last to `new`.

    state (3): output, its rate, last input; changed in place. Returns the output.
    """
    angle, rate, old = state[0], state[1], state[2]
    state[0] = c.a11 * angle + c.a12 * rate + c.old1 * old + c.new1 * new
    state[1] = c.a21 * angle + c.a22 * rate + c.old2 * old + c.new2 * new
    state[2] = new
    return float(state[0])


@njit(cache=True, error_model="numpy", inline="always")
def settle(state: NDArray[np.float64], value: float) -> None:
    """Put a system at rest under a constant input."""
    state[0], state[1], state[2] = value, 0.0, value


@njit(cache=True, error_model="numpy")
def flow_angle(
    v: VaneConstants, u: float, w: float, q: float, ug: float, wg: float, wing: float, p: float = 0.0
) -> float:
    """The angle (rad) that a vane without dynamics would show.

    u, w, q, p: inertial motion at the CG; ug, wg: gust at the vane, m/s; wing: incidence behind the wing's upwash, rad.
    """
    sinking = p * v.y
    angle: float = (1.0 + v.body) * arctangent(w - q * v.x + sinking + wg, u + q * v.z + ug) + v.wing * wing
    return angle + v.roll * sinking / u


@njit(cache=True, error_model="numpy")
def bending(
    v: VaneConstants, state: NDArray[np.float64], begins: bool, az: float, qdot: float, pressure: float, speed: float,
    flow: float,
) -> float:  # fmt: skip
    """What the boom's bending adds to the angle at the vane, rad.

    az: specific force at the CG; pressure: dynamic, Pa; flow: the angle without bending. state (3): bending, its rate,
    last load; changed in place, at rest under the load where the flight `begins`.
    """
    if not v.has_mode:
        return v.mode_turn * (v.flexure * az + v.tip_load * pressure * flow)
    load = v.flexure * (az - qdot * v.x) + v.tip_load * pressure * flow
    if begins:
        settle(state, load)
    bend = second_order_step(v.mode, state, load)
    out: float = v.mode_turn * bend - v.mode_length * state[1] / speed
    return out


@njit(cache=True, error_model="numpy")
def tip_force(v: VaneConstants, state: NDArray[np.float64], az: float, q: float, qdot: float) -> float:
    """Specific force down where the vane is, m/s2: what an accelerometer at the boom's tip feels.

    az: that at the CG; q, qdot: pitching, rad/s and rad/s2; state (3): of the bending, after the step. The tip rises by
    mode_length for a rad of bending, whose own acceleration is that of the mode under its load.
    """
    rigid = az - qdot * v.x - q * q * v.z
    if not v.has_mode:
        return rigid
    bend, rate, load = state[0], state[1], state[2]
    out: float = rigid - v.mode_length * (v.mode_stiffness * (load - bend) - v.mode_resistance * rate)
    return out

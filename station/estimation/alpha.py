"""From the vane to the angle of attack at the CG: bias, steady upwash, rate term, and the split correction.

The vane reads, for a small incidence,

    alpha_v = H_v [(1 + k_f)(alpha_i - q x/V + g(t + x/V)) + k_w (F_m alpha_i + F_g g at the leading edge)] + bias

with alpha_i the inertial angle of attack, g the gust's, k_f the body's upwash (quasi-steady), k_w the wing's (indicial
response F_m to motion, F_g to gusts) and H_v the vane's own dynamics. The split correction (S2) predicts the part
due to motion, takes what is left as the gust at the boom, and delays only that until it reaches the CG. Causal, no
latency: a vane behind the CG, or near it and slow, shows a gust when it has passed.

Corrections that need no inertial data are kept for methods II (steady), III (total alpha delayed by x/V) and V (that,
and the scale 1/(1 + k_u(f)) in the transform): Martos 2013. SI, radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.numerics.indicial import Response, respond, response
from station.numerics.lagrange import delayed
from station.numerics.named_state import Vector
from station.numerics.second_order import follow, second_order, vane_lag
from station.profile import Aircraft, Indicial
from station.profile.aircraft import MOST_TERMS

Array = NDArray[np.float64]

RING: Final = 2048
"""Delay lines, ticks: longer than the 30 s of the mean speed."""
MEAN_S: Final = 30.0
SMOOTH_S: Final = 0.2
"""Over which the airspeed loses its sensor's noise, for the rate term and the gust."""
READY_S: Final = 1.0
"""Unsteady upwash has settled and delay lines are full."""


class Constants(NamedTuple):
    """What `step` goes by. Lengths in m, times in s."""

    dt: float
    bias: float
    """Of the vane, rad."""
    upwash_body: float
    upwash_wing: float
    x: float
    y: float
    """The vane's place from the CG."""
    gust_x: float
    """From the vane to the CG, as gusts travel."""
    edge: float
    """From the vane to the wing's leading edge."""
    tail: float
    """From the CG to the tail."""
    chord: float
    vane_lag: float
    vane: Annotated[Array, 8]
    """Its dynamics: second_order."""
    motion: Response
    gust: Response
    """Of the wing's upwash at the vane."""


@dataclass(slots=True)
class Seen:
    """What `step` gives, rad where nothing else is said; without a split NaN from `fast` on."""

    steady: float
    """With the steady calibration and the rate term."""
    scaled_late: float
    rate_late: float
    """Vane part and rate term of `steady`, x/V ago."""
    rate: float
    """Rate term."""
    speed_mean: float
    """m/s"""
    fast: float
    """Inertial angle of attack and the gust at the boom."""
    split: float
    """Inertial angle of attack and the gust at the CG."""
    gust: float
    """At the CG."""
    gust_step: float
    """From the tail to the CG."""
    boom_gust: float
    upwash: float
    """Of the gust, by the wing, that `boom_gust` was freed of."""
    residual: float
    """What the motion leaves of the vane."""
    behind: float
    """By how long gusts reach the vane after the CG, s."""
    is_ready: bool


class State:
    """What `step` edits."""

    count: int
    """Ticks since the start."""
    split_count: int
    """Ticks since there is an inertial angle of attack."""
    speed: float
    """Smoothed, m/s."""
    speed_sum: float
    """Over MEAN_S."""
    incidence: float
    edge_gust: float
    """Inertial angle of attack and gust at the leading edge at the last tick."""
    motion_lags: Annotated[Array, MOST_TERMS]
    gust_lags: Annotated[Array, MOST_TERMS]
    flown: float
    flown_before: float
    curvature: float
    """What the motion makes at the vane: the last two ticks, and its second difference."""
    vane: Vector
    """Of the vane's dynamics: follow."""
    scaled_ring: Annotated[Array, RING]
    rate_ring: Annotated[Array, RING]
    wind_ring: Annotated[Array, RING]
    speed_ring: Annotated[Array, RING]
    """Vane part and rate term of `steady`, vertical gust at the boom, m/s, and airspeed, m/s."""
    seen: Seen


@njit(cache=True)
def step(c: Constants, s: State, vane: float, p: float, q: float, speed: float, alpha_i: float) -> None:
    """One tick: raw vane, rates, true airspeed, inertial angle of attack (NaN: no split); edits `s`, gives `s.seen`."""
    at = s.count % RING
    _average_speed(c, s, at, speed)
    ca = 1.0 / (1.0 + c.upwash_body + c.upwash_wing)
    rate = (c.x * q - c.y * p) / s.speed
    flow = vane - c.bias
    if s.count == 0:
        for i in range(RING):
            s.scaled_ring[i] = ca * flow
            s.rate_ring[i] = rate
    s.scaled_ring[at] = ca * flow
    s.rate_ring[at] = rate
    seen = s.seen
    tau = c.gust_x / seen.speed_mean / c.dt
    seen.steady = ca * flow + rate
    seen.rate = rate
    seen.scaled_late = delayed(s.scaled_ring, at, tau)
    seen.rate_late = delayed(s.rate_ring, at, tau)
    if math.isfinite(alpha_i):
        _split(c, s, at, flow, rate, alpha_i)
    else:
        s.split_count = 0
        s.wind_ring[at] = 0.0
        _no_split(seen)
    s.count += 1


@njit(cache=True)
def _average_speed(c: Constants, s: State, at: int, speed: float) -> None:
    """The airspeed without its sensor's noise, and its running mean."""
    if s.count == 0:
        s.speed = speed
        s.speed_sum = 0.0
    s.speed += (1.0 - math.exp(-c.dt / SMOOTH_S)) * (speed - s.speed)
    window = min(math.floor(MEAN_S / c.dt + 0.5), RING - 1)
    s.speed_sum += speed
    if s.count >= window:
        s.speed_sum -= s.speed_ring[(at - window) % RING]
    s.seen.speed_mean = s.speed_sum / min(s.count + 1, window)
    s.speed_ring[at] = speed


@njit(cache=True)
def _split(c: Constants, s: State, at: int, flow: float, rate: float, alpha_i: float) -> None:
    """The vane without its bias, `flow`, split in what the motion makes and the gust, which arrives at the CG later."""
    v, dt = s.speed, c.dt
    if s.split_count == 0:
        _begin_split(c, s, rate, alpha_i)
    chords = v * dt / c.chord
    wing = respond(c.motion, s.motion_lags, s.incidence, alpha_i, chords)
    s.incidence = alpha_i
    flown = (1.0 + c.upwash_body) * (alpha_i - rate) + c.upwash_wing * wing
    residual = flow - _shown(c, s, flown)
    leading_edge = delayed(s.wind_ring, at - 1, max(c.edge / v / dt - 1.0, 0.0)) / v
    unsteady = respond(c.gust, s.gust_lags, s.edge_gust, leading_edge, chords)
    s.edge_gust = leading_edge
    upwash = c.upwash_wing * unsteady / (1.0 + c.upwash_body)
    boom = residual / (1.0 + c.upwash_body) - upwash
    # The wind is carried, not the angle: what arrives at the CG meets the speed of that moment.
    s.wind_ring[at] = boom * v
    late = max(c.gust_x / v - c.vane_lag, 0.0) / dt
    gust = delayed(s.wind_ring, at, late) / v
    s.split_count += 1
    seen = s.seen
    seen.fast = alpha_i + boom
    seen.split = alpha_i + gust
    seen.gust = gust
    seen.behind = max(c.vane_lag - c.gust_x / v, 0.0)
    seen.gust_step = gust - delayed(s.wind_ring, at, late + c.tail / v / dt) / v
    seen.boom_gust = boom
    seen.upwash = upwash
    seen.residual = residual
    seen.is_ready = s.split_count * dt >= READY_S


@njit(cache=True)
def _begin_split(c: Constants, s: State, rate: float, alpha_i: float) -> None:
    """As if the present state had lasted, with no gust."""
    s.incidence = alpha_i
    s.edge_gust = 0.0
    for j in range(MOST_TERMS):
        s.motion_lags[j] = alpha_i
        s.gust_lags[j] = 0.0
    start = (1.0 + c.upwash_body) * (alpha_i - rate) + c.upwash_wing * alpha_i
    s.vane[0], s.vane[1], s.vane[2] = start, 0.0, start
    s.flown = s.flown_before = start
    s.curvature = 0.0
    for i in range(RING):
        s.wind_ring[i] = 0.0


@njit(cache=True)
def _shown(c: Constants, s: State, flown: float) -> float:
    """What the vane's dynamics show of an angle."""
    # Straight lines between ticks lose (omega dt)^2/12 of a sine: its curvature, as it goes on, is given back.
    curvature = flown - 2.0 * s.flown + s.flown_before
    new = flown - (2.0 * curvature - s.curvature) / 12.0
    s.flown, s.flown_before, s.curvature = flown, s.flown, curvature
    return follow(c.vane, s.vane, new)


@njit(cache=True)
def _no_split(seen: Seen) -> None:
    seen.fast = seen.split = seen.gust = seen.gust_step = math.nan
    seen.boom_gust = seen.upwash = seen.residual = seen.behind = math.nan
    seen.is_ready = False


@njit(cache=True)
def restart(s: State) -> None:
    """Begin anew from the next sample."""
    s.count = s.split_count = 0
    seen = s.seen
    seen.steady = seen.scaled_late = seen.rate_late = seen.rate = seen.speed_mean = math.nan
    _no_split(seen)


def constants(aircraft: Aircraft, dt: float) -> Constants:
    """What `step` goes by for an aircraft. Without a boom: a vane at the CG that tells the truth."""
    unsteady, boom = aircraft.unsteady, aircraft.boom
    frequency, damping = (boom.vane_frequency, boom.vane_damping) if boom else (1000.0, 0.7)
    # The upwash follows the wing's vorticity: it is unsteady where the aircraft's lift is not.
    steady = Indicial(a=(0.0,), b=(1.0,))
    return Constants(
        dt=dt,
        bias=boom.zero if boom else 0.0,
        upwash_body=boom.upwash_body if boom else 0.0,
        upwash_wing=boom.upwash_wing if boom else 0.0,
        x=boom.vane_x if boom else 0.0,
        y=boom.vane_y if boom else 0.0,
        gust_x=boom.gust_x if boom else 0.0,
        edge=max(boom.gust_x - aircraft.gust_edge, 0.0) if boom else 0.0,
        tail=unsteady.tail_arm,
        chord=unsteady.reference_chord or aircraft.geometry.chord,
        vane_lag=vane_lag(frequency, damping),
        vane=second_order(frequency, damping, dt),
        motion=response(unsteady.upwash_motion or steady),
        gust=response(unsteady.upwash_gust or steady),
    )

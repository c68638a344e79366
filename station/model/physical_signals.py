"""Where the gust is at every tick, at the wing's leading edge, the CG and the tail, and what the wing makes of it.

From the gust at the boom (alpha.py; still seen through the vane) and the inertial angle of attack x,

    g_p = [g_boom(t - t_p) (V_i(t - t_p) + u_p) + (x(t - t_p) - x(t)) u_p]/(V_i(t) + u_p)
    u   = airspeed - inertial speed, met by the wing now and by the tail l_t/V_i later
    p     the leading edge, the CG, the tail; t_p = (x_vane - x_p)/V_i
    Wx  = W{x},   Kg = K{g_le},   and both of l_t/V_i ago: their downwash is at the tail now

The wind is carried, not the angle: the vane turned that vertical gust into an angle over the airspeed at the boom,
whose headwind the airspeed at the CG shows when it arrives; and what arrives meets the speed of that moment. Delays
follow the inertial speed (gusts do not carry themselves past the aircraft), unsteady lift the airspeed. The vane's own
lag is undone with the time that the gust takes from the boom, by a finite impulse response. Where the wing averages
gusts along its span the upwash that its circulation makes at the vane does so too: what was taken from the vane for
upwash, and is none then, is gust, and goes the same way. SI, radians.
"""

from __future__ import annotations

import math
from typing import Annotated, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.numerics.indicial import Response, lagged, respond, response
from station.numerics.lagrange import delayed
from station.numerics.products import fitted
from station.numerics.second_order import second_order_inverse
from station.numerics.turbulence import TURBULENCE_LENGTH
from station.profile import Aircraft
from station.profile.aircraft import MOST_TERMS

Array = NDArray[np.float64]

X, WX, KG, GC, GT, DW, DK, DX, KL, KM, KN, DKL, DKM, DKN, GTL, GTM, GTN, WIND_WING, WIND_TAIL, WIND_WASH = range(20)
KUL, KUM, KUN, GUL, GUM, GUN, DUL, DUM, DUN = range(20, 29)
"""Inertial angle of attack; wing incidence from motion and gust; gust at CG and tail; Wx, Kg and x of l_t/V ago; Kg
after the span's slow, middle and fast lag, and all three of l_t/V ago; the gust at the tail after the same lags. What a
mean wind that is wrong by 1 m/s of tailwind adds to Wx + Kg, to x + the gust at the tail, and to the downwash there,
s/m. Of the gust that was taken for the wing's upwash at the vane and is not, after each of the span's lags: Kg, the
gust at the tail, and Kg of l_t/V ago."""
SIGNALS: Final = 29
LAGGED: Final = ((KL, DKL, GTL), (KM, DKM, GTM), (KN, DKN, GTN))
"""After each of the span's lags: Kg, Kg of l_t/V ago, and the gust at the tail."""
FREED: Final = ((KUL, DUL, GUL), (KUM, DUM, GUM), (KUN, DUN, GUN))
"""The same of what each lag takes from the upwash of gusts at the vane, and so gives to the gust."""

TAPS: Final = 16
_MIDDLE: Final = 7
_ROWS: Final = 16
"""Rows of the table of impulse responses to a tick of delay."""
TABLE: Final = ((_MIDDLE + 1) * _ROWS + 1, TAPS)

RING: Final = 256
SMOOTH_S: Final = 0.2
WIND_S: Final = 60.0
"""Over which the mean wind is averaged."""
LEAST_FREE: Final = 0.2
"""Share of the gusts' mean square that their mean leaves, at least."""
CORNERS: Final = (2.0, 4.0, 9.0)
SPAN_SLOW, SPAN_MIDDLE, SPAN_FAST = CORNERS
"""Corner of the lift's lag behind a gust that varies along the span, V/b. A sum of the three follows a lag of any
corner from the slow one on to 0.3 % of the gust's lift at 2 Hz; of two, it missed those between by 1.6 %."""
LAGS: Final = len(CORNERS)


class Constants(NamedTuple):
    """What `step` goes by. Lengths in m, times in s."""

    dt: float
    boom: float
    """From the vane to the CG, as gusts travel."""
    edge: float
    """From the wing's leading edge to the CG."""
    tail: float
    """From the CG to the tail."""
    wash: float
    """Of the downwash beyond the time to the tail."""
    chord: float
    span: float
    motion: Response
    gust: Response
    """Of the wing's lift."""
    inverse: Annotated[Array, TABLE]
    """vane_inverse"""


class State:
    """What `step` edits."""

    count: int
    """Ticks since the start."""
    speed: float
    headwind: float
    """Smoothed, m/s."""
    headwind_square: float
    """Its mean, m2/s2."""
    incidence: float
    edge_gust: float
    """Inertial angle of attack and gust at the leading edge at the last tick, rad."""
    motion_lags: Annotated[Array, MOST_TERMS]
    gust_lags: Annotated[Array, MOST_TERMS]
    span_slow: float
    span_middle: float
    span_fast: float
    """The wing's incidence from gusts after the span's lags, rad."""
    tail_slow: float
    tail_middle: float
    tail_fast: float
    """The gust at the tail after them, rad."""
    sinking: float
    edge_wind: float
    """What a mean wind wrong by 1 m/s adds to the inertial angle of attack and takes from the gust, last tick, s/m."""
    sinking_lags: Annotated[Array, MOST_TERMS]
    edge_wind_lags: Annotated[Array, MOST_TERMS]
    wing_change: float
    tail_change: float
    wash_change: float
    """Of a tick, in incidence: see _slope."""
    seen_ring: Annotated[Array, RING]
    """Gust at the boom as the vane shows it, rad."""
    headwind_ring: Annotated[Array, RING]
    ground_ring: Annotated[Array, RING]
    """Airspeed less inertial speed, and inertial speed, m/s."""
    alpha_ring: Annotated[Array, RING]
    theta_ring: Annotated[Array, RING]
    wing_ring: Annotated[Array, RING]
    met_ring: Annotated[Array, RING]
    slow_ring: Annotated[Array, RING]
    middle_ring: Annotated[Array, RING]
    fast_ring: Annotated[Array, RING]
    """Wing incidence from motion, from gusts, and from gusts after each of the span's lags, rad."""
    upwash: float
    """Of gusts at the vane, last tick, rad."""
    upwash_lags: Annotated[Array, LAGS]
    """After the span's lags."""
    freed_ring: Annotated[Array, (LAGS, RING)]
    """The upwash less that, rad."""
    freed_edge: Annotated[Array, LAGS]
    freed_lags: Annotated[Array, (LAGS, MOST_TERMS)]
    freed_wing_ring: Annotated[Array, (LAGS, RING)]
    """Of it: at the leading edge at the last tick, in the wing's lift, and that, rad."""
    wind_ring: Annotated[Array, RING]
    """WIND_WING."""
    signals: Annotated[Array, (2, SIGNALS)]
    """What `step` gives: the signals of the tick before and of this one."""


def vane_inverse(frequency_hz: float, damping: float, dt: float, high_hz: float = 2.0) -> Array:
    """Impulse responses (rows, TAPS) of e^{-s d}/H_v for d = 0, 1/_ROWS ... _MIDDLE + 1 ticks, by least squares.

    H_v = wn^2/(s^2 + 2 zeta wn s + wn^2). Exact to 0.1 % up to `high_hz` for delays above 3 ticks; from 2.5 times that
    on held small.
    """
    nyquist = 0.5 / dt
    band = np.linspace(0.0, min(1.5 * high_hz, 0.8 * nyquist), 61)
    above = np.linspace(min(2.5 * high_hz, 0.95 * nyquist), nyquist, 41)
    s = 2j * np.pi * band
    inverse = second_order_inverse(frequency_hz, damping, s)
    taps = np.arange(TAPS) * dt

    def rows(f: Array) -> Array:
        e = np.exp(-2j * np.pi * np.outer(f, taps))
        return np.concatenate((e.real, e.imag))

    matrix = np.concatenate((rows(band), 0.02 * rows(above)))
    wanted = []
    for d in np.arange((_MIDDLE + 1) * _ROWS + 1) / _ROWS * dt:
        e = inverse * np.exp(-s * d)
        wanted.append(np.concatenate((e.real, e.imag, np.zeros(2 * len(above)))))
    return np.ascontiguousarray(fitted(matrix, np.array(wanted).T).T)


@njit(cache=True, error_model="numpy")
def _through(table: Array, ring: Array, at: int, ticks: float) -> float:
    """The value `ticks` ago with the vane's lag undone."""
    ticks = min(max(ticks, 0.0), RING - TAPS - 1.0)
    first = max(math.floor(ticks) - _MIDDLE, 0)
    place = (ticks - first) * _ROWS
    row = min(math.floor(place), table.shape[0] - 2)
    part = place - row
    total = 0.0
    for j in range(TAPS):
        total += ((1.0 - part) * table[row, j] + part * table[row + 1, j]) * ring[(at - first - j) % RING]
    return total


@njit(cache=True, error_model="numpy")
def _met(c: Constants, s: State, at: int, ticks: float, headwind: float) -> float:
    """Gust incidence now where the air is that the vane saw `ticks` ago, and whose headwind gust is `headwind`, m/s."""
    seen = _through(c.inverse, s.seen_ring, at, ticks)
    then = delayed(s.ground_ring, at, ticks) + headwind
    now = s.ground_ring[at] + headwind
    return float((seen * then + (delayed(s.alpha_ring, at, ticks) - s.alpha_ring[at]) * headwind) / now)


@njit(cache=True, error_model="numpy")
def _slope(change: float, before: float) -> float:
    """Slope per tick now, from the change since the tick before and the change before that."""
    return 1.5 * change - 0.5 * before


@njit(cache=True, error_model="numpy")
def watch_wind(c: Constants, s: State, speed: float, inertial_speed: float) -> None:
    """One tick of the means that `wind_sd` goes by; the caller counts it."""
    if s.count == 0:
        s.speed = speed
        s.headwind = 0.0
        s.headwind_square = 0.0
    gain = 1.0 - math.exp(-c.dt / SMOOTH_S)
    s.speed += gain * (speed - s.speed)
    s.headwind += gain * (speed - inertial_speed - s.headwind)
    s.headwind_square += max(c.dt / WIND_S, 1.0 / (s.count + 1.0)) * (s.headwind**2 - s.headwind_square)


@njit(cache=True, error_model="numpy")
def step(
    c: Constants, s: State, boom_gust: float, upwash: float, alpha_i: float, speed: float, inertial_speed: float,
    theta: float,
) -> None:  # fmt: skip
    """One tick; edits `s` and gives `s.signals`.

    `boom_gust`: gust incidence at the boom as the vane shows it, rad; `upwash`: of gusts, by the wing, taken from the
    vane for it; `speed`: true airspeed; `theta`: pitch.
    """
    at = s.count % RING
    slowness = 1.0 / max(inertial_speed, 1.0)
    sinking = (alpha_i - theta) * slowness
    if s.count == 0:
        _begin(s, alpha_i, sinking, inertial_speed, theta)
    before, now = s.signals[0], s.signals[1]
    for i in range(SIGNALS):
        before[i] = now[i]
    watch_wind(c, s, speed, inertial_speed)
    v = s.speed
    carried = max(inertial_speed, 1.0) * c.dt
    headwind = speed - inertial_speed
    s.seen_ring[at] = boom_gust
    s.headwind_ring[at] = headwind
    s.alpha_ring[at] = alpha_i
    s.ground_ring[at] = inertial_speed
    s.theta_ring[at] = theta

    cg, edge, tail = c.boom / carried, max(c.boom - c.edge, 0.0) / carried, c.tail / carried
    wash = tail + c.wash / c.dt
    now[X] = alpha_i
    now[GC] = _met(c, s, at, cg, headwind)
    at_edge = _met(c, s, at, edge, headwind)
    now[GT] = _met(c, s, at, cg + tail, delayed(s.headwind_ring, at, tail))
    spans = v * c.dt / c.span
    s.tail_slow = lagged(s.tail_slow, before[GT], now[GT], SPAN_SLOW * spans)
    s.tail_middle = lagged(s.tail_middle, before[GT], now[GT], SPAN_MIDDLE * spans)
    s.tail_fast = lagged(s.tail_fast, before[GT], now[GT], SPAN_FAST * spans)
    now[GTL], now[GTM], now[GTN] = s.tail_slow, s.tail_middle, s.tail_fast
    chords = v * c.dt / c.chord
    _lift(c, s, at, at_edge, alpha_i, chords)
    now[DW] = delayed(s.wing_ring, at, wash)
    now[DK] = delayed(s.met_ring, at, wash)
    now[DX] = delayed(s.alpha_ring, at, wash)
    now[DKL] = delayed(s.slow_ring, at, wash)
    now[DKM] = delayed(s.middle_ring, at, wash)
    now[DKN] = delayed(s.fast_ring, at, wash)
    _free(c, s, at, upwash, (edge, cg + tail, wash), chords)

    # A mean wind wrong by u: inertial incidence off by (x - theta) u/V_i, which the gust makes up for where the vane
    # saw it, and every delay by -u/V_i of itself.
    edge_wind = (delayed(s.theta_ring, at, edge) - alpha_i) * slowness
    wing_wind = respond(c.motion, s.sinking_lags, s.sinking, sinking, chords)
    wing_wind += respond(c.gust, s.edge_wind_lags, s.edge_wind, edge_wind, chords)
    s.sinking, s.edge_wind = sinking, edge_wind
    tail_wind = (delayed(s.theta_ring, at, cg + tail) - theta) * slowness
    if s.count > 0:
        change = now[KG] - before[KG]
        wing_wind -= slowness * edge * _slope(change, s.wing_change)
        s.wing_change = change
        change = now[GT] - before[GT]
        tail_wind -= slowness * (cg + tail) * _slope(change, s.tail_change)
        s.tail_change = change
    s.wind_ring[at] = wing_wind
    wash_wind = delayed(s.wind_ring, at, wash)
    if s.count > 0:
        change = now[DW] + now[DK] - before[DW] - before[DK]
        wash_wind -= slowness * tail * _slope(change, s.wash_change)
        s.wash_change = change
    now[WIND_WING], now[WIND_TAIL], now[WIND_WASH] = wing_wind, tail_wind, wash_wind
    s.count += 1


@njit(cache=True, error_model="numpy")
def _begin(s: State, alpha_i: float, sinking: float, inertial_speed: float, theta: float) -> None:
    """As if the present state had lasted, with no gust."""
    s.incidence = alpha_i
    s.sinking, s.edge_wind = sinking, -sinking
    s.wing_change = s.tail_change = s.wash_change = 0.0
    s.edge_gust = s.span_slow = s.span_middle = s.span_fast = 0.0
    s.tail_slow = s.tail_middle = s.tail_fast = s.signals[1, GT] = 0.0
    for j in range(MOST_TERMS):
        s.motion_lags[j] = alpha_i
        s.sinking_lags[j] = sinking
        s.gust_lags[j] = 0.0
        s.edge_wind_lags[j] = -sinking
    s.upwash = 0.0
    s.upwash_lags[:] = s.freed_edge[:] = 0.0
    s.freed_ring[:] = s.freed_wing_ring[:] = 0.0
    s.freed_lags[:] = 0.0
    for i in range(RING):
        s.seen_ring[i] = s.headwind_ring[i] = s.met_ring[i] = s.wind_ring[i] = 0.0
        s.slow_ring[i] = s.middle_ring[i] = s.fast_ring[i] = 0.0
        s.alpha_ring[i] = s.wing_ring[i] = alpha_i
        s.ground_ring[i] = inertial_speed
        s.theta_ring[i] = theta


@njit(cache=True, error_model="numpy")
def _lift(c: Constants, s: State, at: int, at_edge: float, alpha_i: float, chords: float) -> None:
    """The wing's incidence from motion and from gusts, and the latter after the span's lags."""
    now = s.signals[1]
    wing = respond(c.motion, s.motion_lags, s.incidence, alpha_i, chords)
    met = respond(c.gust, s.gust_lags, s.edge_gust, at_edge, chords)
    spans = s.speed * c.dt / c.span
    before = s.met_ring[(at - 1) % RING]
    s.span_slow = lagged(s.span_slow, before, met, SPAN_SLOW * spans)
    s.span_middle = lagged(s.span_middle, before, met, SPAN_MIDDLE * spans)
    s.span_fast = lagged(s.span_fast, before, met, SPAN_FAST * spans)
    s.incidence, s.edge_gust = alpha_i, at_edge
    s.wing_ring[at], s.met_ring[at] = wing, met
    s.slow_ring[at], s.middle_ring[at], s.fast_ring[at] = s.span_slow, s.span_middle, s.span_fast
    now[WX], now[KG] = wing, met
    now[KL], now[KM], now[KN] = s.span_slow, s.span_middle, s.span_fast


@njit(cache=True, error_model="numpy")
def _free(c: Constants, s: State, at: int, upwash: float, ticks: tuple[float, float, float], chords: float) -> None:
    """What the vane's gust grows by where the circulation, and so the upwash, averages gusts along the span.

    `ticks`: from the vane to the leading edge and to the tail, and from the wing's lift to its downwash at the tail.
    """
    now = s.signals[1]
    spans = s.speed * c.dt / c.span
    for k in range(LAGS):
        wing, wash, tail = FREED[k]
        s.upwash_lags[k] = lagged(s.upwash_lags[k], s.upwash, upwash, CORNERS[k] * spans)
        s.freed_ring[k, at] = upwash - s.upwash_lags[k]
        at_edge = _through(c.inverse, s.freed_ring[k], at, ticks[0])
        now[wing] = respond(c.gust, s.freed_lags[k], s.freed_edge[k], at_edge, chords)
        s.freed_edge[k] = at_edge
        s.freed_wing_ring[k, at] = now[wing]
        now[tail] = _through(c.inverse, s.freed_ring[k], at, ticks[1])
        now[wash] = delayed(s.freed_wing_ring[k], at, ticks[2])
    s.upwash = upwash


@njit(cache=True, error_model="numpy")
def wind_sd(c: Constants, s: State) -> float:
    """Standard error of the mean wind along the path, m/s: that of the mean of a first-order process."""
    lasting = TURBULENCE_LENGTH / max(s.speed, 1.0)
    seconds = min(s.count * c.dt, 2.0 * WIND_S)
    share = 2.0 / (seconds / lasting + 2.0)
    # The gusts' mean square is about that mean, which takes its share of it.
    return math.sqrt(max(s.headwind_square, 0.0) * share / max(1.0 - share, LEAST_FREE))


@njit(cache=True)
def restart(s: State) -> None:
    """Begin anew from the next sample."""
    s.count = 0
    s.signals[:] = math.nan


def constants(aircraft: Aircraft, dt: float, high_hz: float = 2.0) -> Constants:
    """What `step` goes by, for an aircraft with boom and unsteady constants. `high_hz`: up to where the signals are
    analysed."""
    unsteady, boom = aircraft.unsteady, aircraft.boom
    frequency, damping = (boom.vane_frequency, boom.vane_damping) if boom else (0.4 / dt, 0.7)
    return Constants(
        dt=dt,
        boom=boom.gust_x if boom else 0.0,
        edge=aircraft.gust_edge,
        tail=unsteady.tail_arm,
        wash=unsteady.downwash_delay,
        chord=unsteady.reference_chord or aircraft.geometry.chord,
        span=aircraft.geometry.span,
        motion=response(unsteady.lift_motion),
        gust=response(unsteady.lift_gust),
        inverse=vane_inverse(frequency, damping, dt, high_hz),
    )

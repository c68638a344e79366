"""Where the gust is at every tick, at the wing's leading edge, the CG and the tail, and what the wing makes of it.

From the gust at the boom (alpha.py; still seen through the vane) and the inertial angle of attack x,

    g_p = [g_boom(t - t_p) (V_i(t - t_p) + u_p) + (x(t - t_p) - x(t)) u_p]/(V_i(t) + u_p)
    u   = airspeed - inertial speed, met by the wing now and by the tail l_t/V_i later
    p     the leading edge, the CG, the tail; t_p = (x_vane - x_p)/V_i
    Wx  = W{x},   Kg = K{g_le},   and both of l_t/V_i ago: their downwash is at the tail now

The wind is carried, not the angle: the vane turned that vertical gust into an angle over the airspeed at the boom,
whose headwind the airspeed at the CG shows when it arrives; and what arrives meets the speed of that moment. Delays
follow the inertial speed (gusts do not carry themselves past the aircraft), memories the airspeed. The vane's own lag
is undone with the time that the gust takes from the boom, by a finite impulse response. SI, radians.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import lstsq

from station.numerics.delay import delayed
from station.numerics.indicial import respond
from station.profile import Aircraft

Array = NDArray[np.float64]

X, WX, KG, GC, GT, DW, DK, DX, KL, KM, KN, DKL, DKM, DKN, WIND_WING, WIND_TAIL, WIND_WASH = range(17)
"""Inertial angle of attack; wing incidence from motion and gust; gust at CG and tail; Wx, Kg and x of l_t/V ago; Kg
after the span's slow, middle and fast lag, and all three of l_t/V ago. What a mean wind that is wrong by 1 m/s of
tailwind adds to Wx + Kg, to x + the gust at the tail, and to the downwash there, s/m."""
SIGNALS: Final = 17

TAPS: Final = 16
_MIDDLE: Final = 7
_ROWS: Final = 16
"""Rows of the table of impulse responses to a tick of delay."""

RING: Final = 256
SMOOTH_S: Final = 0.2
WIND_S: Final = 60.0
"""Over which the mean wind is averaged."""
SPAN_SLOW: Final = 2.0
SPAN_MIDDLE: Final = 4.0
SPAN_FAST: Final = 9.0
"""Corner of the lift's lag behind a gust that varies along the span, V/b. A sum of the three follows a lag of any
corner from the slow one on to 0.3 % of the gust's lift at 2 Hz; of two, it missed those between by 1.6 %."""

LENGTH_M: Final = 533.4
"""Of the turbulence (MIL-F-8785C above 2000 ft): how long gusts last that the mean wind is averaged over."""

# ring
_SEEN, _U, _RWX, _RKG, _RX, _RKL, _RKM, _RKN, _VI, _RTHETA, _RWIND, COLUMNS = range(12)
# params
_BOOM, _LE, _TAIL, _CHORD, _SPAN, _NW, _NK, _WASH = range(8)
_WA, _WB, _KA, _KB, PARAMS = 8, 12, 16, 20, 24
# state
COUNT, _VF, _UG, _UU, _XIN, _GIN, _SLOW, _MIDDLE_LAG, _FAST, _WIN, _KIN, _WS, _KS, _WWS, _WKS, _RISE = (
    *range(12),
    *(15, 19, 23, 27),
)
STATE: Final = 30


def vane_inverse(frequency_hz: float, damping: float, dt: float, high_hz: float = 2.0) -> Array:
    """Impulse responses (rows, TAPS) of e^{-s d}/H_v for d = 0, 1/_ROWS ... _MIDDLE + 1 ticks, by least squares.

    H_v = wn^2/(s^2 + 2 zeta wn s + wn^2). Exact to 0.1 % up to `high_hz` for delays above 3 ticks; from 2.5 times that
    on held small.
    """
    nyquist = 0.5 / dt
    band = np.linspace(0.0, min(1.5 * high_hz, 0.8 * nyquist), 61)
    above = np.linspace(min(2.5 * high_hz, 0.95 * nyquist), nyquist, 41)
    omega = 2.0 * math.pi * frequency_hz
    s = 2j * np.pi * band
    inverse = (s * s + 2.0 * damping * omega * s) / omega**2 + 1.0
    taps = np.arange(TAPS) * dt

    def rows(f: Array) -> Array:
        e = np.exp(-2j * np.pi * np.outer(f, taps))
        return np.concatenate((e.real, e.imag))

    matrix = np.concatenate((rows(band), 0.02 * rows(above)))
    wanted = []
    for d in np.arange((_MIDDLE + 1) * _ROWS + 1) / _ROWS * dt:
        e = inverse * np.exp(-s * d)
        wanted.append(np.concatenate((e.real, e.imag, np.zeros(2 * len(above)))))
    return np.ascontiguousarray(lstsq(matrix, np.array(wanted).T)[0].T)


@njit(cache=True, error_model="numpy")
def _through(table: Array, ring: Array, at: int, column: int, ticks: float) -> float:
    """`column` of the ring `ticks` ago with the vane's lag undone."""
    n = ring.shape[0]
    ticks = min(max(ticks, 0.0), n - TAPS - 1.0)
    first = max(math.floor(ticks) - _MIDDLE, 0)
    place = (ticks - first) * _ROWS
    row = min(math.floor(place), table.shape[0] - 2)
    part = place - row
    total = 0.0
    for j in range(TAPS):
        total += ((1.0 - part) * table[row, j] + part * table[row + 1, j]) * ring[(at - first - j) % n, column]
    return total


@njit(cache=True, error_model="numpy")
def _met(table: Array, ring: Array, at: int, ticks: float, headwind: float) -> float:
    """Gust incidence now where the air is that the vane saw `ticks` ago, and whose headwind gust is `headwind`, m/s."""
    n = ring.shape[0]
    seen = _through(table, ring, at, _SEEN, ticks)
    then = delayed(ring, at, _VI, ticks) + headwind
    now = ring[at % n, _VI] + headwind
    return float((seen * then + (delayed(ring, at, _RX, ticks) - ring[at % n, _RX]) * headwind) / now)


@njit(cache=True, error_model="numpy")
def _lag(state: float, before: float, now: float, x: float) -> float:
    """First-order lag, exact for an input that goes straight from `before` to `now` in x time constants."""
    decay = math.exp(-x)
    mean = (1.0 - decay) / x
    return decay * state + (mean - decay) * before + (1.0 - mean) * now


@njit(cache=True, error_model="numpy")
def _rise(s: Array, which: int, since: float) -> float:
    """Slope per tick now, from the change `since` the tick before and the change before that, which `s` keeps."""
    before = s[_RISE + which]
    s[_RISE + which] = since
    return float(1.5 * since - 0.5 * before)


@njit(cache=True, error_model="numpy")
def watch_wind(s: Array, dt: float, speed: float, inertial_speed: float) -> None:
    """One tick of the means that `wind_sd` goes by; the caller counts it in `s[COUNT]`."""
    if s[COUNT] == 0.0:
        s[_VF] = speed
        s[_UG] = 0.0
        s[_UU] = 0.0
    gain = 1.0 - math.exp(-dt / SMOOTH_S)
    s[_VF] += gain * (speed - s[_VF])
    s[_UG] += gain * (speed - inertial_speed - s[_UG])
    s[_UU] += max(dt / WIND_S, 1.0 / (s[COUNT] + 1.0)) * (s[_UG] ** 2 - s[_UU])


@njit(cache=True, error_model="numpy")
def step(
    par: Array,
    table: Array,
    s: Array,
    ring: Array,
    dt: float,
    boom_gust: float,
    alpha_i: float,
    speed: float,
    inertial_speed: float,
    theta: float,
    out: Array,
) -> None:
    """One tick -> `out` (2, SIGNALS): the signals of the tick before and of this one.

    `boom_gust`: gust incidence at the boom as the vane shows it, rad; `speed`: true airspeed; `theta`: pitch. Edits
    `s` (STATE,) and `ring` (RING, COLUMNS).
    """
    n = ring.shape[0]
    count = int(s[COUNT])
    at = count % n
    n_w, n_k = int(par[_NW]), int(par[_NK])
    slowness = 1.0 / max(inertial_speed, 1.0)
    sinking = (alpha_i - theta) * slowness
    if count == 0:
        # As if the present state had lasted, with no gust.
        s[_XIN] = alpha_i
        s[_WIN], s[_KIN] = sinking, -sinking
        for j in range(3):
            s[_RISE + j] = 0.0
        for j in range(n_w):
            s[_WS + j] = alpha_i
            s[_WWS + j] = sinking
        for j in range(n_k):
            s[_KS + j] = 0.0
            s[_WKS + j] = -sinking
        s[_GIN] = s[_SLOW] = s[_MIDDLE_LAG] = s[_FAST] = 0.0
        for i in range(n):
            for c in range(COLUMNS):
                ring[i, c] = alpha_i if c in (_RWX, _RX) else 0.0
            ring[i, _VI] = inertial_speed
            ring[i, _RTHETA] = theta
    for i in range(SIGNALS):
        out[0, i] = out[1, i]
    watch_wind(s, dt, speed, inertial_speed)
    v = s[_VF]
    carried = max(inertial_speed, 1.0) * dt
    headwind = speed - inertial_speed
    ring[at, _SEEN] = boom_gust
    ring[at, _U] = headwind
    ring[at, _RX] = alpha_i
    ring[at, _VI] = inertial_speed
    ring[at, _RTHETA] = theta

    cg, edge = par[_BOOM] / carried, max(par[_BOOM] - par[_LE], 0.0) / carried
    late = par[_TAIL] / carried
    at_cg = _met(table, ring, at, cg, headwind)
    at_edge = _met(table, ring, at, edge, headwind)
    at_tail = _met(table, ring, at, cg + late, delayed(ring, at, _U, late))

    chords = v * dt / par[_CHORD]
    wing = respond(s, _WS, par[_WA : _WA + 4], par[_WB : _WB + 4], n_w, s[_XIN], alpha_i, chords)
    met = respond(s, _KS, par[_KA : _KA + 4], par[_KB : _KB + 4], n_k, s[_GIN], at_edge, chords)
    spans = v * dt / par[_SPAN]
    before = ring[(at - 1) % n, _RKG]
    s[_SLOW] = _lag(s[_SLOW], before, met, SPAN_SLOW * spans)
    s[_MIDDLE_LAG] = _lag(s[_MIDDLE_LAG], before, met, SPAN_MIDDLE * spans)
    s[_FAST] = _lag(s[_FAST], before, met, SPAN_FAST * spans)
    s[_XIN], s[_GIN] = alpha_i, at_edge
    ring[at, _RWX], ring[at, _RKG] = wing, met
    ring[at, _RKL], ring[at, _RKM], ring[at, _RKN] = s[_SLOW], s[_MIDDLE_LAG], s[_FAST]

    out[1, X], out[1, WX], out[1, KG], out[1, GC], out[1, GT] = alpha_i, wing, met, at_cg, at_tail
    by_wind = late
    late += par[_WASH] / dt
    out[1, DW] = delayed(ring, at, _RWX, late)
    out[1, DK] = delayed(ring, at, _RKG, late)
    out[1, DX] = delayed(ring, at, _RX, late)
    out[1, KL], out[1, KM], out[1, KN] = s[_SLOW], s[_MIDDLE_LAG], s[_FAST]
    out[1, DKL] = delayed(ring, at, _RKL, late)
    out[1, DKM] = delayed(ring, at, _RKM, late)
    out[1, DKN] = delayed(ring, at, _RKN, late)

    # A mean wind wrong by u: inertial incidence off by (x - theta) u/V_i, which the gust makes up for where the vane
    # saw it, and every delay by -u/V_i of itself.
    edge_wind = (delayed(ring, at, _RTHETA, edge) - alpha_i) * slowness
    wing_wind = respond(s, _WWS, par[_WA : _WA + 4], par[_WB : _WB + 4], n_w, s[_WIN], sinking, chords)
    wing_wind += respond(s, _WKS, par[_KA : _KA + 4], par[_KB : _KB + 4], n_k, s[_KIN], edge_wind, chords)
    s[_WIN], s[_KIN] = sinking, edge_wind
    tail_wind = (delayed(ring, at, _RTHETA, cg + by_wind) - theta) * slowness
    if count > 0:
        wing_wind -= slowness * edge * _rise(s, 0, out[1, KG] - out[0, KG])
        tail_wind -= slowness * (cg + by_wind) * _rise(s, 1, out[1, GT] - out[0, GT])
    ring[at, _RWIND] = wing_wind
    wash_wind = delayed(ring, at, _RWIND, late)
    if count > 0:
        wash_wind -= slowness * by_wind * _rise(s, 2, out[1, DW] + out[1, DK] - out[0, DW] - out[0, DK])
    out[1, WIND_WING], out[1, WIND_TAIL], out[1, WIND_WASH] = wing_wind, tail_wind, wash_wind
    s[COUNT] = count + 1


def parameters(aircraft: Aircraft) -> Array:
    """The constants of `step`, (PARAMS,); for an aircraft with boom and unsteady constants."""
    par = np.zeros(PARAMS)
    unsteady = aircraft.unsteady
    par[_BOOM] = aircraft.boom.gust_x if aircraft.boom else 0.0
    par[_LE] = aircraft.gust_edge
    par[_TAIL], par[_WASH] = unsteady.tail_arm, unsteady.downwash_delay
    par[_CHORD] = unsteady.reference_chord or aircraft.geometry.chord
    par[_SPAN] = aircraft.geometry.span
    for response, amplitude, rate, terms in (
        (unsteady.lift_motion, _WA, _WB, _NW),
        (unsteady.lift_gust, _KA, _KB, _NK),
    ):
        if response is not None:
            count = min(len(response.a), 4)
            par[terms] = count
            par[amplitude : amplitude + count] = response.a[:count]
            par[rate : rate + count] = response.b[:count]
    return par


@njit(cache=True, error_model="numpy")
def wind_sd(s: Array, dt: float) -> float:
    """Standard error of the mean wind along the path, m/s: that of the mean of a first-order process."""
    lasting = LENGTH_M / max(s[_VF], 1.0)
    seconds = min(s[COUNT] * dt, 2.0 * WIND_S)
    share = 2.0 / (seconds / lasting + 2.0)
    # The gusts' mean square is about that mean, which takes its share of it.
    return math.sqrt(max(s[_UU], 0.0) * share / max(1.0 - share, 0.2))


@njit(cache=True)
def restart(s: Array, out: Array) -> None:
    """Begin anew from the next sample."""
    s[COUNT] = 0.0
    out[:] = math.nan


class Signals:
    """The state of `step`; `out[0]`: the tick before, `out[1]`: the newest."""

    def __init__(self, aircraft: Aircraft, dt: float, high_hz: float = 2.0) -> None:
        """`high_hz`: up to where the signals are analysed."""
        self._parameters = parameters(aircraft)
        boom = aircraft.boom
        frequency, damping = (boom.vane_frequency, boom.vane_damping) if boom else (0.4 / dt, 0.7)
        self._table = vane_inverse(frequency, damping, dt, high_hz)
        self._dt = dt
        self._state = np.zeros(STATE)
        self._ring = np.zeros((RING, COLUMNS))
        self.out = np.full((2, SIGNALS), math.nan)
        self.arrays = (self._parameters, self._table, self._state, self._ring, self.out)
        """As tick.advance takes them."""

    def restart(self) -> None:
        """Begin anew from the next sample."""
        restart(self._state, self.out)

    def wind_sd(self) -> float:
        """Standard error of the mean wind along the path, m/s: that of the mean of a first-order process."""
        return float(wind_sd(self._state, self._dt))

    def step(self, boom_gust: float, alpha_i: float, speed: float, inertial_speed: float, theta: float) -> None:
        """One tick; see the kernel."""
        step(
            self._parameters,
            self._table,
            self._state,
            self._ring,
            self._dt,
            boom_gust,
            alpha_i,
            speed,
            inertial_speed,
            theta,
            self.out,
        )

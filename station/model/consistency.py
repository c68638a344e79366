"""What the instruments say of each other in flight, and of the profile's model: the last two minutes, by the tenth of a
second.

Each tick adds to the means of 0.1 s; once a second one pair of signals is compared over all that is kept:

    y(t) = gain x(t - delay) + error, in differences from one mean to the next

The vane against the inertial flow angle and coefficients against the model are regressed with an instrument: what the
elevator alone would do by the profile. Gusts, which move the aircraft and the vane both, have nothing to do with it, so
that gain and delay are right in turbulence too (a pilot who fights the gusts spoils this a little). Attitude against
pitch rate and velocity against acceleration need no instrument. Standard errors allow for the colour of what is
left. Compiled, of fixed cost, and without clock: the same frames give the same bits.

Source: Klein and Morelli 2006, chapter 10 (kinematic consistency) and section 5.2 (coloured residuals); Soderstrom and
Stoica 1989, chapter 8 (instrumental variables).
"""

from __future__ import annotations

import math
from operator import itemgetter
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import FRESH_AGE_S, G0, SIGNAL_INDEX
from station.numerics.atmosphere import air_density
from station.numerics.lagrange import cubic, cubic_slope
from station.profile import Aircraft
from station.rows import AlphaEstimate, Frame

Array = NDArray[np.float64]

PER_MEAN: Final = 5
STEP_S: Final = 0.1
KEEP: Final = 1200
"""Means kept: 120 s."""
LEAST: Final = 200
"""Means with both signals, before anything is said."""
RECENT: Final = 200
LAGS: Final = 25
BLOCK: Final = 50
DELAYS_S: Final = (-0.3, 0.6)
WEAK: Final = 0.1
"""Correlation with the instrument below which nothing can be told."""
LEAST_GAIN: Final = 0.2
"""Below it there is no delay."""
FARTHEST: Final = 1.0
"""What the elevator alone can do to the angle of attack, rad."""
_ROUNDS: Final = 8

SIGNALS_USED: Final = (
    *("q", "theta", "az", "ax", "v_down", "v_north", "v_east", "elevator", "airspeed", "dynamic_pressure"),
    *("phi", "psi", "r", "ay", "static_pressure", "air_temperature", "mass"),
)
_Q, _THETA, _AZ, _AX, _VD, _VN, _VE, _DE, _V, _QBAR, _PHI, _PSI, _R, _AY, _STATIC, _TEMP, _MASS = range(17)
_OF_ITS_TIME: Final = 8
"""Signals before this one count only where they are measured at the frame's own time."""
_FROM_ALPHA: Final = 17
"""After the signals: the vane with calibration and dynamics undone, the inertial flow angle at its place, alpha."""

# par
_S, _C, _M, _IYY, _CL0, _CLA, _CLQ, _CLD, _CM0, _CMA, _CMQ, _CMD, _IX, _IZ, _ARM, _RHO = range(16)
PARAMETERS: Final = 16
# channels of a mean
VANE, FLOW, FLOW_Z, THETA, TURNED, SINK, FALLEN, GAINED, PUSHED, SPEED, PITOT = range(11)
LIFT, LIFT_MODEL, LIFT_Z, MOMENT, MOMENT_MODEL, MOMENT_Z = range(11, 17)
CHANNELS: Final = 17
# state: sums of the means under way, then
_TICKS, _ROW, _ALPHA_E, _Q_E, _DE_0, _Q_WAS, _VN_WAS, _VE_WAS = range(CHANNELS, CHANNELS + 8)
_I_Q, _I_D, _I_G, _I_F = range(CHANNELS + 8, CHANNELS + 12)
STATE: Final = CHANNELS + 12


@njit(cache=True, error_model="numpy")
def step(par: Array, s: Array, ring: Array, u: Array, age: Array, dt: float) -> bool:
    """One tick of `u` (signals and the vane's three, NaN where missing); edits `s` and `ring`.

    `age`: of the signals that count only at the frame's own time, s. Returns whether a mean was completed.
    """
    for i in range(_OF_ITS_TIME):
        if not age[i] <= FRESH_AGE_S:
            u[i] = math.nan
    q, theta, v, de = u[_Q], u[_THETA], u[_V], u[_DE]
    phi = u[_PHI] if math.isfinite(u[_PHI]) else 0.0
    r = u[_R] if math.isfinite(u[_R]) else 0.0
    ay = u[_AY] if math.isfinite(u[_AY]) else 0.0
    psi = u[_PSI] if math.isfinite(u[_PSI]) else math.atan2(u[_VE], u[_VN])
    qbar = u[_QBAR]
    # Not by altitude: the standard atmosphere's temperature is too coarse to judge a sensor by.
    density = air_density(par[_RHO], u[_STATIC], u[_TEMP], math.nan)
    mass = u[_MASS] if u[_MASS] > 0.0 else par[_M]

    # Attitude and velocity as rates and accelerations have them; a gap leaves them where they were and spoils the mean.
    turn = q * math.cos(phi) - r * math.sin(phi)
    if math.isfinite(turn):
        s[_I_Q] += dt * turn
    cth, sth, cph, sph = math.cos(theta), math.sin(theta), math.cos(phi), math.sin(phi)
    down = -sth * u[_AX] + sph * cth * ay + cph * cth * u[_AZ] + G0
    along = cth * u[_AX] + sph * sth * ay + cph * sth * u[_AZ]
    if math.isfinite(down):
        s[_I_D] += dt * down
    if math.isfinite(along):
        s[_I_F] += dt * along
    # The imu is turned about the CG, whose velocity the stream has.
    arm_down = -sth * (q * par[_IZ]) + cph * cth * (-q * par[_IX])
    north, east = u[_VN] - s[_VN_WAS], u[_VE] - s[_VE_WAS]
    gained = math.cos(psi) * north + math.sin(psi) * east
    if math.isfinite(gained):
        s[_I_G] += gained
    s[_VN_WAS], s[_VE_WAS] = u[_VN], u[_VE]

    # What the elevator alone does by the profile: an instrument, not a prediction.
    if math.isfinite(de) and v > 0.0:
        if not math.isfinite(s[_DE_0]):
            s[_DE_0] = de
        pressure = qbar if qbar > 0.0 else 0.6 * v * v
        moved = de - s[_DE_0]
        # By trapezes, which bear any short period; one that diverges begins anew.
        lift, pitch = 0.5 * dt * pressure * par[_S] / (mass * v), 0.5 * dt * pressure * par[_S] * par[_C] / par[_IYY]
        damping = par[_CMQ] * par[_C] / (2.0 * v)
        a, b = s[_ALPHA_E], s[_Q_E]
        right = a + 0.5 * dt * b - lift * (par[_CLA] * a + 2.0 * par[_CLD] * moved)
        turned = b + pitch * (par[_CMA] * a + damping * b + 2.0 * par[_CMD] * moved)
        free = 1.0 + lift * par[_CLA], 1.0 - pitch * damping
        size = free[0] * free[1] - 0.5 * dt * pitch * par[_CMA]
        s[_ALPHA_E] = (right * free[1] + 0.5 * dt * turned) / size
        s[_Q_E] = (turned * free[0] + pitch * par[_CMA] * right) / size
        if not abs(s[_ALPHA_E]) < FARTHEST:
            s[_ALPHA_E] = s[_Q_E] = 0.0
        bent = par[_CMA] * s[_ALPHA_E] + damping * s[_Q_E] + par[_CMD] * moved
        made_lift = par[_CLA] * s[_ALPHA_E] + par[_CLD] * moved + par[_CLQ] * s[_Q_E] * par[_C] / (2.0 * v)
    else:
        bent, made_lift = math.nan, math.nan

    acceleration = (q - s[_Q_WAS]) / dt
    s[_Q_WAS] = q
    alpha = u[_FROM_ALPHA + 2]
    force = qbar * par[_S]
    lift = -(math.cos(alpha) * (u[_AZ] + acceleration * par[_IX]) - math.sin(alpha) * u[_AX]) * mass / force
    rates = q * par[_C] / (2.0 * v)
    s[VANE] += u[_FROM_ALPHA]
    s[FLOW] += u[_FROM_ALPHA + 1]
    s[FLOW_Z] += s[_ALPHA_E] - par[_ARM] * s[_Q_E] / v if math.isfinite(bent) else math.nan
    s[THETA] += theta
    # Integrals by trapezes: half of the newest step belongs to the next tick.
    s[TURNED] += s[_I_Q] - 0.5 * dt * turn
    s[SINK] += u[_VD] + arm_down
    s[FALLEN] += s[_I_D] - 0.5 * dt * down
    s[GAINED] += s[_I_G] if math.isfinite(gained) else math.nan
    s[PUSHED] += s[_I_F] - 0.5 * dt * along
    s[SPEED] += v
    s[PITOT] += math.sqrt(2.0 * qbar / density) if qbar > 0.0 else math.nan
    s[LIFT] += lift
    s[LIFT_MODEL] += par[_CL0] + par[_CLA] * alpha + par[_CLQ] * rates + par[_CLD] * de
    s[LIFT_Z] += made_lift
    s[MOMENT] += par[_IYY] * acceleration / (force * par[_C])
    s[MOMENT_MODEL] += par[_CM0] + par[_CMA] * alpha + par[_CMQ] * rates + par[_CMD] * de
    s[MOMENT_Z] += bent
    s[_TICKS] += 1.0
    if s[_TICKS] < PER_MEAN:
        return False
    row = int(s[_ROW]) % ring.shape[0]
    for k in range(CHANNELS):
        ring[row, k] = s[k] / PER_MEAN
        s[k] = 0.0
    s[_TICKS] = 0.0
    s[_ROW] += 1.0
    return True


@njit(cache=True, error_model="numpy")
def _later(x: Array, ticks: float, i: int) -> tuple[float, float]:
    """x at place i - ticks by the cubic through four points, and its slope per place; NaN beyond the ends."""
    at = i - ticks
    k = math.floor(at)
    if k < 1 or k + 2 >= x.shape[0]:
        return math.nan, math.nan
    f = at - k
    a, b, c, d = x[k - 1], x[k], x[k + 1], x[k + 2]
    return cubic(a, b, c, d, f), cubic_slope(a, b, c, d, f)


@njit(cache=True, error_model="numpy")
def _differences(y: Array, x: Array, z: Array, ticks: float, columns: Array, good: NDArray[np.bool_]) -> int:
    """Differences from one place to the next without their means: z and its slope, x and its slope (per s of delay),
    all `ticks` ago, and y; (n, 5). Edits `columns` and `good`; returns how many there are."""
    n = y.shape[0]
    was = (math.nan, math.nan, math.nan, math.nan, math.nan)
    used = 0
    mean = np.zeros(5)
    for i in range(n):
        xv, xs = _later(x, ticks, i)
        zv, zs = _later(z, ticks, i)
        now = (zv, -zs / STEP_S, xv, -xs / STEP_S, y[i])
        good[i] = True
        for j in range(5):
            columns[i, j] = now[j] - was[j]
            good[i] = good[i] and math.isfinite(columns[i, j])
        was = now
        if good[i]:
            used += 1
            for j in range(5):
                mean[j] += columns[i, j]
    # By element: numba takes seconds to compile the check of two arrays' shapes.
    for i in range(n):
        for j in range(5):
            columns[i, j] = columns[i, j] - mean[j] / used if good[i] else 0.0
    return used


@njit(cache=True, error_model="numpy")
def compare(y: Array, x: Array, z: Array, guess: float, out: Array) -> None:
    """Gain and delay (s) of `y` on `x`, with instrument `z`, (n,) each in time's order, NaN where missing.

    `guess`: delay to begin at. `out`: gain, its sd, delay, its sd; NaN where they cannot be told.
    """
    n = y.shape[0]
    out[:] = math.nan
    delay, gain = guess, 1.0
    columns = np.zeros((n, 5))
    good = np.zeros(n, dtype=np.bool_)
    e = np.zeros(n)
    a00 = a01 = a10 = a11 = size = 0.0
    used = 0
    settled = False
    for _ in range(_ROUNDS):
        used = _differences(y, x, z, delay / STEP_S, columns, good)
        if used < LEAST:
            return
        a00 = a01 = a10 = a11 = b0 = b1 = own = instrument = 0.0
        for i in range(n):
            w0, w1, dx, slope, dy = columns[i]
            a00 += w0 * dx
            a01 += w0 * slope
            a10 += w1 * dx
            a11 += w1 * slope
            b0 += w0 * dy
            b1 += w1 * dy
            own += dx * dx
            instrument += w0 * w0
        size = a00 * a11 - a01 * a10
        if own == 0.0 or instrument == 0.0 or a00 * a00 < WEAK**2 * own * instrument:
            return
        if abs(size) < 1e-6 * abs(a00 * a11):
            return
        gain = (a11 * b0 - a01 * b1) / size
        shift = (a00 * b1 - a10 * b0) / size
        for i in range(n):
            e[i] = columns[i, 4] - gain * columns[i, 2] - shift * columns[i, 3]
        if settled or abs(gain) <= LEAST_GAIN:
            break
        move = min(max(shift / gain, -STEP_S), STEP_S)
        delay = min(max(delay + move, DELAYS_S[0]), DELAYS_S[1])
        settled = abs(move) < 1e-3
    if abs(gain) > LEAST_GAIN and not settled:
        return
    # Covariance of the errors by their own autocorrelation, then of the instruments' sums with them.
    m00 = m01 = m11 = 0.0
    power = np.zeros(LAGS)
    for lag in range(LAGS):
        total = 0.0
        for i in range(lag, n):
            total += e[i] * e[i - lag]
        power[lag] = total / used * (1.0 - lag / LAGS)
    for i in range(n):
        w0, w1 = columns[i, 0], columns[i, 1]
        if not good[i]:
            continue
        m00 += w0 * w0 * power[0]
        m01 += w0 * w1 * power[0]
        m11 += w1 * w1 * power[0]
        for lag in range(1, min(LAGS, i + 1)):
            c = power[lag]
            m00 += 2.0 * c * w0 * columns[i - lag, 0]
            m01 += c * (w0 * columns[i - lag, 1] + w1 * columns[i - lag, 0])
            m11 += 2.0 * c * w1 * columns[i - lag, 1]
    i00, i01, i10, i11 = a11 / size, -a01 / size, -a10 / size, a00 / size
    var_gain = i00 * i00 * m00 + 2.0 * i00 * i01 * m01 + i01 * i01 * m11
    var_shift = i10 * i10 * m00 + 2.0 * i10 * i11 * m01 + i11 * i11 * m11
    out[0] = gain
    out[1] = math.sqrt(max(var_gain, 0.0))
    if abs(gain) > LEAST_GAIN:
        out[2] = delay
        out[3] = math.sqrt(max(var_shift, 0.0)) / abs(gain)


@njit(cache=True, error_model="numpy")
def level(y: Array, x: Array, moving: bool, out: Array) -> None:
    """Mean of y - x, or of its rate of change per second where `moving`, and its sd from means of 5 s: `out` (2,)."""
    n = y.shape[0]
    out[:] = math.nan
    total = squares = 0.0
    blocks = 0
    for first in range(0, n - BLOCK + 1, BLOCK):
        inside = 0.0
        count = 0
        for i in range(first, first + BLOCK):
            value = y[i] - x[i]
            if moving:
                value = (value - (y[i - 1] - x[i - 1])) / STEP_S if i > 0 else math.nan
            if math.isfinite(value):
                inside += value
                count += 1
        if count >= BLOCK // 2:
            total += inside / count
            squares += (inside / count) ** 2
            blocks += 1
    if blocks >= RECENT // BLOCK:
        mean = total / blocks
        out[0] = mean
        # Blocks side by side are not independent.
        out[1] = 1.5 * math.sqrt(max(squares / blocks - mean * mean, 0.0) / (blocks - 1))


def parameters(aircraft: Aircraft, imu: tuple[float, float, float]) -> tuple[Array, bool]:
    """Constants of `step` (PARAMETERS,), and whether the profile has a model to compare with."""
    names = ("CL_0", "CL_alpha", "CL_q", "CL_de", "Cm_0", "Cm_alpha", "Cm_q", "Cm_de")
    known = not aircraft.kinematics_only and aircraft.inertia.iyy is not None
    known = known and all(aircraft.value(n) for n in ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de"))
    # Without a model: the derivatives of an ordinary aircraft, for the instrument, which need not be right.
    values = [aircraft.value(n) for n in names] if known else [0.0, 5.0, 0.0, 0.0, 0.0, -1.0, -20.0, -1.5]
    iyy = aircraft.inertia.iyy if known else None
    chord, mass = aircraft.geometry.chord, aircraft.inertia.mass
    par = np.zeros(PARAMETERS)
    par[: _IYY + 1] = aircraft.geometry.wing_area, chord, mass, iyy or mass * (1.5 * chord) ** 2
    par[_CL0 : _CMD + 1] = values
    par[_IX], _, par[_IZ] = aircraft.imu_at(imu)
    par[_ARM] = aircraft.boom.vane_x if aircraft.boom else 0.0
    par[_RHO] = aircraft.air_density if aircraft.air_density is not None else math.nan
    return par, known


class Window:
    """The state of `step`: what is kept of the last two minutes."""

    def __init__(self, aircraft: Aircraft, imu: tuple[float, float, float], dt: float) -> None:
        self._par, self.has_model = parameters(aircraft, imu)
        self._dt = dt
        self._state = np.zeros(STATE)
        self._state[[_DE_0, _Q_WAS, _VN_WAS, _VE_WAS]] = math.nan
        self._ring = np.full((KEEP, CHANNELS), math.nan)
        columns = [SIGNAL_INDEX[name] for name in SIGNALS_USED]
        self._pick: Any = itemgetter(*columns)
        self._pick_ages: Any = itemgetter(*columns[:_OF_ITS_TIME])
        self._out = np.zeros(4)
        self._delays: dict[int, float] = {}
        self._nothing = (math.nan,) * 3

    def add(self, frame: Frame, a: AlphaEstimate) -> None:
        """One tick's frame and what was made of its vane."""
        vane = a.vane + a.instrument + a.zero + a.upwash + a.lag
        rest = (vane, a.alpha_inertial - a.rate, a.alpha) if a.valid else self._nothing
        u = np.array(self._pick(frame.values) + rest)
        age = np.array(self._pick_ages(frame.age_s))
        step(self._par, self._state, self._ring, u, age, self._dt)

    @property
    def slopes(self) -> tuple[float, float]:
        """CL_alpha and Cm_alpha of the model."""
        return float(self._par[_CLA]), float(self._par[_CMA])

    @property
    def speed(self) -> float:
        """The newest mean airspeed, m/s."""
        return float(self._ring[(int(self._state[_ROW]) - 1) % KEEP, SPEED])

    def _column(self, channel: int, count: int) -> Array:
        """The newest means of a channel, oldest first."""
        newest = int(self._state[_ROW])
        rows = np.arange(newest - min(count, newest), newest) % KEEP
        return np.ascontiguousarray(self._ring[rows, channel])

    def compare(self, y: int, x: int, z: int) -> tuple[float, float, float, float]:
        """`compare` of three channels: gain, sd, delay, sd."""
        guess = self._delays.get(y, 0.0)
        compare(self._column(y, KEEP), self._column(x, KEEP), self._column(z, KEEP), guess, self._out)
        gain, gain_sd, delay, delay_sd = self._out.tolist()
        self._delays[y] = delay if math.isfinite(delay) else 0.0
        return gain, gain_sd, delay, delay_sd

    def level(self, y: int, x: int, moving: bool, count: int) -> tuple[float, float]:
        """`level` of two channels over the newest `count` means: mean and sd."""
        level(self._column(y, count), self._column(x, count), moving, self._out[:2])
        return float(self._out[0]), float(self._out[1])

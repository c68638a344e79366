"""Turbulence: a frozen Dryden field after MIL-F-8785C, met by every point of the aircraft as it gets there.

One series of (u_g, v_g, w_g) over distance through the air mass. Each point samples it where it is, so the boom meets
a gust before the wing and the tail after it, and the gust's pitching effect needs no term of its own.

One-sided spatial spectra, rad/m, integral over them = sigma^2:
    Phi_u = sigma_u^2 (2 L_u/pi) / (1 + (L_u W)^2)
    Phi_w = sigma_w^2 (L_w/pi) (1 + 3 (L_w W)^2) / (1 + (L_w W)^2)^2        (Phi_v alike)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import to_si
from station.profile import Flight

_FT: Final = to_si(1.0, "ft")
STEP: Final = 0.25
"""Spacing of the field's points, m. Linear interpolation between them loses 0.1 % of the variance at 10 Hz."""
_AWAY: Final = 200_000
"""Points beyond a field, 50 km: more than any aircraft flies between two looks at it, a second or two."""
_BLOCK: Final = 2048
_LOW: Final = 1000.0
"""ft: up to which the low-altitude model holds; twice as high turbulence is isotropic, of scale length _ISOTROPIC."""
_ISOTROPIC: Final = 1750.0
_RAMP: Final = 1.0
"""Turbulence that begins in flight grows to its full strength over this many seconds of flight."""

LEVELS: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "light": (to_si(0.1 * 15, "kt"), to_si(5, "ft/s")),
        "moderate": (to_si(0.1 * 30, "kt"), to_si(10, "ft/s")),
        "severe": (to_si(0.1 * 45, "kt"), to_si(20, "ft/s")),
    }
)
"""Standard deviation of the vertical gust below 1,000 ft and above 2,000 ft, m/s."""


class Dryden(NamedTuple):
    """Scale lengths (m) and standard deviations (m/s) of the field."""

    length_u: float
    length_v: float
    length_w: float
    sigma_u: float
    sigma_v: float
    sigma_w: float


def dryden(height: float, sigma_w: float) -> Dryden:
    """The field at a height (m) above the ground for a vertical gust of standard deviation `sigma_w` (m/s).

    Low-altitude model below 1,000 ft, 1,750 ft isotropic above 2,000 ft, linear between. MIL-F-8785C 3.7.
    """
    h = height / _FT
    if h >= 2 * _LOW:
        length_w = length_u = _ISOTROPIC
        ratio = 1.0
    else:
        low = min(max(h, 10.0), _LOW)
        shape = 0.177 + 0.000823 * low
        length_w, length_u, ratio = low, low / shape**1.2, shape**-0.4
        blend = max(0.0, (h - _LOW) / _LOW)
        length_w += blend * (_ISOTROPIC - length_w)
        length_u += blend * (_ISOTROPIC - length_u)
        ratio += blend * (1.0 - ratio)
    return Dryden(length_u * _FT, length_u * _FT, length_w * _FT, ratio * sigma_w, ratio * sigma_w, sigma_w)


def sigma_at(height: float, level: str) -> float:
    """Standard deviation of the vertical gust, m/s, at a height (m) in light, moderate or severe turbulence.

    A tenth of the wind at 20 ft below 1,000 ft, 5, 10 and 20 ft/s above 2,000 ft, where it is thunderstorms that make
    it severe; linear between. MIL-F-8785C 3.7.2 and 3.7.3.
    """
    low, high = LEVELS[level]
    return low + min(max(height / _FT / _LOW - 1.0, 0.0), 1.0) * (high - low)


def dryden_of(flight: Flight) -> Dryden:
    """The field that a card's flight asks for."""
    sigma = flight.gust_sigma if flight.turbulence is None else sigma_at(flight.altitude, flight.turbulence)
    model, length = dryden(flight.altitude, sigma), flight.gust_length
    return Dryden(length, length, length, sigma, sigma, sigma) if length else model


def _second_order(length: float, step: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition matrix and noise factor over one step of z1' = z2, z2' = -a^2 z1 - 2a z2 + n, a = 1/L, exactly.

    The noise covariance is P - A P A' with the stationary P = diag(1/(4a^3), 1/(4a)); states are scaled by P to keep
    the factor well conditioned, so z here is P^-1/2 z of the equation and its stationary covariance is the unit matrix.
    """
    a = 1.0 / length
    e = math.exp(-a * step)
    raw = e * np.array([[1 + a * step, step], [-(a**2) * step, 1 - a * step]])
    root = np.array([math.sqrt(1 / (4 * a**3)), math.sqrt(1 / (4 * a))])
    transition = raw * root[None, :] / root[:, None]
    covariance = np.eye(2) - transition @ transition.T
    factor = np.zeros((2, 2))
    # The first entry is O(step^3) and loses digits to cancellation; the pivot on the second keeps the factor real.
    factor[1, 1] = math.sqrt(covariance[1, 1])
    factor[0, 1] = covariance[0, 1] / factor[1, 1]
    factor[0, 0] = math.sqrt(max(0.0, covariance[0, 0] - factor[0, 1] ** 2))
    return transition, factor


class FieldConstants(NamedTuple):
    """A field's recursion from point to point, and where it begins."""

    decay: float
    kick: float
    sigmas: tuple[float, float, float]
    transition: NDArray[np.float64]
    """(2, 2, 2), of v and w."""
    factor: NDArray[np.float64]
    start: float
    """Distance at which turbulence begins, m; -inf: it was always there."""
    ramp: float
    """Distance over which it grows to full strength, m."""


class Ramp(NamedTuple):
    """How turbulence begins."""

    start: float
    """Distance at which it does, m; -inf: it was always there."""
    length: float
    """Over which it grows to full strength, m."""

    def strength(self, points: NDArray[np.int64]) -> NDArray[np.float64]:
        """0 to 1, at points of the field by index."""
        grown = np.clip((points * STEP - self.start) / self.length, 0.0, 1.0)
        strength: NDArray[np.float64] = grown * grown * (3.0 - 2.0 * grown)
        return strength


def ramp(speed: float, start_s: float) -> Ramp:
    """Turbulence of stationary strength, or air at rest up to the distance flown by `start_s` at `speed`."""
    return Ramp(speed * start_s if start_s > 0 else -math.inf, speed * _RAMP)


def field_constants(model: Dryden, speed: float, start_s: float) -> FieldConstants:
    """A field that begins as `ramp` has it."""
    begins = ramp(speed, start_s)
    pairs = [_second_order(length, STEP) for length in (model.length_v, model.length_w)]
    return FieldConstants(
        decay=math.exp(-STEP / model.length_u),
        kick=math.sqrt(-math.expm1(-2 * STEP / model.length_u)),
        sigmas=(model.sigma_u, model.sigma_v, model.sigma_w),
        transition=np.array([a for a, _ in pairs]),
        factor=np.array([b for _, b in pairs]),
        start=begins.start,
        ramp=begins.length,
    )


@njit(cache=True, error_model="numpy")
def fill(
    c: FieldConstants, noise: NDArray[np.float64], state: NDArray[np.float64], first: int, out: NDArray[np.float64]
) -> None:
    """The next points of the field, `first` the index of the first of them.

    noise (n, 5): white, unit variance; state (5): u, v1, v2, w1, w2, changed in place; out (n, 3).
    """
    for k in range(noise.shape[0]):
        grown = min(max(((first + k) * STEP - c.start) / c.ramp, 0.0), 1.0)
        strength = grown * grown * (3.0 - 2.0 * grown)
        out[k, 0] = strength * c.sigmas[0] * state[0]
        for j in range(2):
            i = 1 + 2 * j
            # w_g = sigma sqrt(1/a) (a^2 z1 + sqrt(3) a z2); with the scaled states: sigma/2 (z1 + sqrt(3) z2)
            out[k, 1 + j] = strength * c.sigmas[1 + j] * 0.5 * (state[i] + math.sqrt(3.0) * state[i + 1])
            z1 = c.transition[j, 0, 0] * state[i] + c.transition[j, 0, 1] * state[i + 1]
            z2 = c.transition[j, 1, 0] * state[i] + c.transition[j, 1, 1] * state[i + 1]
            state[i] = z1 + c.factor[j, 0, 0] * noise[k, i] + c.factor[j, 0, 1] * noise[k, i + 1]
            state[i + 1] = z2 + c.factor[j, 1, 1] * noise[k, i + 1]
        state[0] = c.decay * state[0] + c.kick * noise[k, 0]


ALONG, SIDEWAYS, UP = range(3)
"""Components of a gust on the way of the CG: u_g, v_g, w_g."""


class Meets(NamedTuple):
    """In which column of a field's values each part of the aircraft meets its gust."""

    u_wing: int = ALONG
    w_wing: int = UP
    u_tail: int = ALONG
    w_tail: int = UP
    u_boom: int = ALONG
    v_boom: int = SIDEWAYS
    w_boom: int = UP
    u_second: int = ALONG
    w_second: int = UP
    roll: int = -1
    """p_g, rad/s: as if the wing rolled right in air at rest; -1: no part of the wing meets another gust,"""
    yaw: int = -1
    """and r_g, as if it yawed right."""


LINE: Final = Meets()
"""Everything meets what is on the way of the CG."""


class Field(NamedTuple):
    """The gusts over a stretch of the way."""

    values: NDArray[np.float64]
    """(n, 3 or more): u_g, v_g, w_g at consecutive points, m/s; then what `meets` says."""
    first: int
    """Index of the first point; a point's distance is its index times STEP."""
    meets: Meets = LINE


@njit(cache=True, error_model="numpy")
def gust_at(field: Field, distance: float, component: int) -> float:
    """A component of the gust at a distance through the air mass, m."""
    position = distance / STEP
    i = math.floor(position)
    part = position - i
    j = min(max(int(i) - field.first, 0), field.values.shape[0] - 2)
    value: float = field.values[j, component] + part * (field.values[j + 1, component] - field.values[j, component])
    return value


class Laid(NamedTuple):
    """What is laid over a field from a point on."""

    first: int
    values: NDArray[np.float64]
    """(n, columns), m/s or rad/s."""

    def add_to(self, block: NDArray[np.float64], first: int) -> None:
        """That part of it which is among the points that begin with index `first`."""
        begin, end = max(first, self.first), min(first + len(block), self.first + len(self.values))
        if begin < end:
            block[begin - first : end - first] += self.values[begin - self.first : end - self.first]


def field_start(behind: float) -> int:
    """Index of the first point of a field that is to begin `behind` m behind the origin."""
    return math.floor(-behind / STEP) - 2


def points_missing(low: float, high: float, end: int) -> int:
    """How many points from index `end` on a field needs to hold the air from distance `low` to `high`; none where
    that distance is NaN or far beyond it: a flight that has run away stays in the air there is."""
    return math.ceil(high / STEP) + 3 - end if low / STEP < end + _AWAY else 0


class GustField:
    """The part of the field around the aircraft, made as the aircraft gets there; memory stays flat.

    The field is the same whatever pieces it is asked for in.
    """

    def __init__(
        self, constants: FieldConstants, behind: float, seed: np.random.SeedSequence, laid: Sequence[Laid] = ()
    ) -> None:
        """`behind`: how far behind the origin the field begins, m."""
        self.now = Field(np.empty((0, 3)), field_start(behind))
        """The part that is kept."""
        self._constants, self._laid = constants, laid
        self._calm = constants.sigmas[2] == 0
        self._rng = np.random.default_rng(seed)
        self._state = self._rng.standard_normal(5)

    def cover(self, low: float, high: float) -> None:
        """Hold the field from distance `low` to `high` at least; `low` never goes back."""
        values, first = self.now.values, self.now.first
        end = first + len(values)
        missing = points_missing(low, high, end)
        if missing <= 0:
            return
        drop = math.floor(low / STEP) - 2 - first
        n = _BLOCK * math.ceil(missing / _BLOCK)
        block = np.zeros((n, 3))
        if not self._calm:
            fill(self._constants, self._rng.standard_normal((n, 5)), self._state, end, block)
        for gust in self._laid:
            gust.add_to(block, end)
        keep = values[max(0, drop) :]
        self.now = Field(np.concatenate((keep, block)), first + len(values) - len(keep))

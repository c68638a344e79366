"""Turbulence as a frozen field over the way flown and the span: wing, tail, fin and boom meet their own part of it.

Of an isotropic field (isotropic.py) along parallel ways, the aircraft needs few sums over them: the mean of u and w
along the wing and along the tail, weighted with the lift that a gust makes there, the gradients of both along the wing,
and what the boom meets. Each is a series over the distance flown, and the cross-spectra of all of them are sums of the
field's: so the series are drawn themselves, jointly, in place of a field of which most would be thrown away.

Weights, by the reverse-flow theorem (Heaslet and Spreiter 1953): a gust at y counts in the lift as the loading at
uniform incidence there, elliptic, and in the rolling moment as that of a wing that rolls, y times the elliptic one:
    w_wing = sum w(y) e(y) / sum e(y)        p_g = sum w(y) y e(y) / sum y^2 e(y)        e = sqrt(1 - (2y/b)^2)
    r_g = - sum u(y) y e(y) / sum y^2 e(y)
so that in a field of constant gradient p_g = dw_g/dy and r_g = -du_g/dy, as MIL-F-8785C has them. A wing whose
quarter chord is swept (`sweep` of the profile's [planform]) meets the gust at y later by |y| tan(sweep) than in its
middle, its elliptic mean no later than a straight one: 4/(3 pi) b/2 tan(sweep) behind its apex. What rolls and yaws
the wing comes through the profile's `lift_gust`, one chord travelled being one chord of the field.

The series are white noise through filters whose transfer matrix is the Cholesky factor of the cross-spectral matrix at
each wavenumber, without phase: convolved block by block (partitioned, overlap-save), so that memory stays flat.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.profile import Aircraft, DiscreteGust
from station.rows import ProfileError
from station.simulation.discrete_gusts import COMPONENTS, shape
from station.simulation.gusts import (
    ALONG,
    SIDEWAYS,
    STEP,
    UP,
    Dryden,
    Field,
    Laid,
    Meets,
    Ramp,
    field_start,
    points_missing,
)
from station.simulation.isotropic import KINDS, CrossSpectra, cross_spectra

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_ACROSS_WING: Final = 24
"""Ways along which the wing's sums are taken, closest at the tips: 2.5 m apart in the middle of 20 m, so that the mean
has its own spectrum up to 20 Hz at 50 m/s, where it is a fiftieth of the gust's."""
_ACROSS_TAIL: Final = 8
_BLOCK: Final = 4096
"""Points made at once: a kilometre."""
_MEMORY: Final = 12.0
"""Length of the filters in scale lengths: their ends are below a five-hundredth of their middle's slope."""
_KNOTS: Final = 160
"""Wavenumbers at which the cross-spectra are computed; between them the factor is smooth over their logarithm."""
_SLACK: Final = 1e-11
"""Of the variance, added to each series by itself: the mean along the tail is almost that along the wing."""

_NOTHING: Final = 1e-6
"""Of a series' own noise: what symmetry leaves of another's is rounding."""

_FADE: Final = 40.0
"""Chords after a discrete gust over which the wing's response to it is followed."""
_HALVES: Final[Mapping[str, Callable[[Array], Array]]] = {
    "both": np.ones_like,
    "right": lambda side: 0.5 * (1.0 + side),
    "left": lambda side: 0.5 * (1.0 - side),
}
"""How much of a gust is met on either side, by the sign of y."""


class Across(NamedTuple):
    """Of an aircraft, what meets another gust than the CG's; m."""

    wing: float
    tail: float
    """Its span; 0: it meets what is on the way of the CG."""
    boom: float
    """How far right of the CG's way the vane is."""
    second: float | None
    """The same of a second vane."""
    sweep: float
    """Tangent of the wing's."""
    chord: float
    """That the times of the gust's response are counted in."""
    amplitudes: tuple[float, ...]
    rates: tuple[float, ...]
    """Of that response, per chord travelled."""


def across(aircraft: Aircraft) -> Across:
    """Raises ProfileError for a profile that does not say where its parts meet the air."""
    unsteady, span = aircraft.unsteady, aircraft.geometry.span
    if not unsteady.memory or unsteady.tail_arm <= 0:
        key = "memory: false" if not unsteady.memory else "tail_arm: missing"
        raise ProfileError(
            f'aircraft {aircraft.name}: unsteady.{key}; flight.field = "plane" needs a tail that meets the air behind '
            'the wing\nwrite memory = true, tail_arm and tail_lift_slope, or fly field = "line"'
        )
    if unsteady.tail_span > span:
        raise ProfileError(f"aircraft {aircraft.name}: unsteady.tail_span: wider than the wing, {span:.1f} m")
    response = unsteady.lift_gust
    return Across(
        span,
        unsteady.tail_span,
        aircraft.boom.vane_y if aircraft.boom else 0.0,
        aircraft.second_vane.vane_y if aircraft.second_vane else None,
        math.tan(aircraft.planform.sweep) if aircraft.planform else 0.0,
        unsteady.reference_chord or aircraft.geometry.chord,
        response.a if response else (),
        response.b if response else (),
    )


class _Series(NamedTuple):
    """A sum over ways."""

    component: int
    places: Array
    """y of the ways, m."""
    weights: Array
    delayed: bool
    """Behind the response of the wing's lift to gusts."""
    behind: Array
    """How much later each is met, m."""


def _point(component: int, place: float = 0.0) -> _Series:
    return _Series(component, np.array([place]), np.ones(1), False, np.zeros(1))


def _loaded(span: float, n: int) -> tuple[Array, Array]:
    """Places and weights of Gauss's quadrature with sqrt(1 - (2y/b)^2) (Chebyshev, second kind), of unit sum."""
    angle = np.arange(1, n + 1) * np.pi / (n + 1)
    weights = np.sin(angle) ** 2
    return 0.5 * span * np.cos(angle), weights / weights.sum()


def _series(parts: Across) -> tuple[tuple[_Series, ...], Meets]:
    y, share = _loaded(parts.wing, _ACROSS_WING)
    arm = y * share / (share @ (y * y))
    later = parts.sweep * (np.abs(y) - share @ np.abs(y))
    made = [_point(ALONG), _point(SIDEWAYS), _point(UP)]
    made += [_Series(ALONG, y, share, False, later), _Series(UP, y, share, False, later)]
    made += [_Series(UP, y, arm, True, later), _Series(ALONG, y, -arm, True, later)]
    meets = Meets(u_wing=3, w_wing=4, roll=5, yaw=6)
    if parts.tail > 0:
        z, loading = _loaded(parts.tail, _ACROSS_TAIL)
        meets = meets._replace(u_tail=len(made), w_tail=len(made) + 1)
        level = np.zeros_like(z)
        made += [_Series(ALONG, z, loading, False, level), _Series(UP, z, loading, False, level)]
    if parts.boom != 0:
        meets = meets._replace(u_boom=len(made), v_boom=len(made) + 1, w_boom=len(made) + 2)
        made += [_point(i, parts.boom) for i in (ALONG, SIDEWAYS, UP)]
    if parts.second:
        meets = meets._replace(u_second=len(made), w_second=len(made) + 1)
        made += [_point(i, parts.second) for i in (ALONG, UP)]
    return tuple(made), meets


def response(parts: Across, kappa: Array) -> Complex:
    """Of the wing's lift to gusts, over wavenumber."""
    steps = 1j * kappa * parts.chord
    out = np.ones_like(steps)
    for a, b in zip(parts.amplitudes, parts.rates, strict=True):
        out -= a * steps / (steps + b)
    return out


def _apart(first: _Series, other: _Series) -> Array:
    """How far the ways of one are from those of the other, to a micrometre, so that equal distances are equal."""
    out: Array = np.abs(other.places[None, :] - first.places[:, None]).ravel().round(6)
    return out


def _entry(first: _Series, other: _Series, model: Dryden, spectra: CrossSpectra, apart: Array, kappa: Array) -> Complex:
    """The cross-spectrum E first*(kappa) other(kappa) over kappa, m3/s2, from those at the distances `apart`."""
    where = np.searchsorted(apart, _apart(first, other))
    weights = (first.weights[:, None] * other.weights[None, :]).ravel()
    later = (other.behind[None, :] - first.behind[:, None]).ravel()
    kinds = {first.component, other.component}
    seen: Any
    if kinds == {UP}:
        seen = spectra.up[:, where] * model.sigma_w**2
    elif UP not in kinds and len(kinds) == 1:
        seen = (spectra.along if ALONG in kinds else spectra.sideways)[:, where] * model.sigma_u**2
    elif UP not in kinds:
        to_the_right = np.sign(other.places[None, :] - first.places[:, None]).ravel()
        seen = 1j * spectra.along_sideways[:, where] * to_the_right * model.sigma_u**2
    else:
        return np.zeros(len(kappa), dtype=np.complex128)
    if later.any():
        seen = seen * np.exp(-1j * kappa[:, None] * later)
    out: Complex = (seen @ weights).astype(np.complex128)
    return out


def matrix(parts: Across, model: Dryden, kind: str, kappa: Array) -> Complex:
    """(k, series, series): the two-sided cross-spectra of the series over wavenumber, m3/s2, before the wing's
    response; entry (i, j) is E series_j*(kappa) series_i(kappa)."""
    series, _ = _series(parts)
    apart = np.unique(np.concatenate([_apart(a, b) for a in series for b in series]))
    by_length = {n: cross_spectra(KINDS[kind], n, kappa, apart) for n in {model.length_u, model.length_w}}
    out = np.zeros((len(kappa), len(series), len(series)), dtype=np.complex128)
    for i, b in enumerate(series):
        for j, a in enumerate(series):
            spectra = by_length[model.length_w if b.component == UP else model.length_u]
            out[:, i, j] = _entry(a, b, model, spectra, apart, kappa)
    return out


class Filters(NamedTuple):
    """What makes the series of white noise, a convolution in pieces of _BLOCK points."""

    pairs: tuple[tuple[int, int], ...]
    """Series and noise."""
    parts: Complex
    """(pair, piece, wavenumber)."""
    series: int
    meets: Meets


@lru_cache(maxsize=8)
def filters(parts: Across, length_u: float, length_w: float, ratio: float, kind: str) -> Filters:
    """Made once for all flights in air of the same scale lengths, for a vertical gust of unit variance; `ratio`: of the
    standard deviation of the horizontal ones to it."""
    from scipy.interpolate import CubicSpline

    model = Dryden(length_u, length_u, length_w, ratio, ratio, 1.0)
    longest = max(model.length_u, model.length_w)
    points = max(2 * _BLOCK, 2 ** math.ceil(math.log2(_MEMORY * longest / STEP)))
    kappa = np.asarray(2.0 * np.pi * np.fft.rfftfreq(points, STEP), dtype=np.float64)
    series, meets = _series(parts)
    knots = np.concatenate(([1e-3 * kappa[1]], np.geomspace(0.3 * kappa[1], kappa[-1], _KNOTS)))
    spectra = matrix(parts, model, kind, knots)
    power = np.sqrt(np.einsum("kii->ki", spectra).real)
    scaled = spectra / power[:, :, None] / power[:, None, :] + _SLACK * np.eye(len(series))
    factor = np.linalg.cholesky(scaled) * power[:, :, None]
    level = np.sqrt(1.0 + (knots * longest) ** 2)
    smooth = CubicSpline(np.log(knots), factor * level[:, None, None])
    at = np.maximum(kappa, knots[0])
    transfer = smooth(np.log(at)) / np.sqrt(1.0 + (at * longest) ** 2)[:, None, None]
    delay = response(parts, kappa)
    for i, one in enumerate(series):
        if one.delayed:
            transfer[:, i] *= delay[:, None]
    share = np.abs(transfer).max(axis=0) / np.einsum("kii->ki", np.abs(transfer)).max(axis=0)[:, None]
    pairs = tuple((i, j) for i in range(len(series)) for j in range(i + 1) if share[i, j] > _NOTHING)
    taps = np.stack([np.fft.irfft(transfer[:, i, j], points) for i, j in pairs]) / math.sqrt(STEP)
    taps = np.roll(taps, points // 2, axis=1).reshape(len(pairs), points // _BLOCK, _BLOCK)
    return Filters(pairs, np.fft.rfft(taps, 2 * _BLOCK), len(series), meets)


def in_a_plane(gusts: Sequence[DiscreteGust], speed: float, parts: Across) -> tuple[Laid, ...]:
    """Discrete gusts for the series of a plane: on all of the span, or half of it."""
    series, _ = _series(parts)
    made = []
    for gust in gusts:
        first, values = shape(gust, speed, _FADE * parts.chord)
        soon = math.ceil(max(float(-one.behind.min()) for one in series) / STEP)
        values = np.concatenate((np.zeros(soon), values))
        points = STEP * np.arange(len(values))
        columns = np.zeros((len(values), len(series)))
        for i, one in enumerate(series):
            if one.component == COMPONENTS[gust.component]:
                met = one.weights * _HALVES[gust.half](np.sign(one.places))
                passing = np.interp(points[:, None] - one.behind, points, values) @ met
                columns[:, i] = _behind_response(parts, passing) if one.delayed else passing
        made.append(Laid(first - soon, columns))
    return tuple(made)


def _behind_response(parts: Across, values: Array) -> Array:
    """A gust, straight between points, behind the response of the wing's lift."""
    from scipy.signal import lfilter

    out = values.copy()
    for a, b in zip(parts.amplitudes, parts.rates, strict=True):
        steps = STEP * b / parts.chord
        decay, mean = math.exp(-steps), -math.expm1(-steps) / steps
        out -= a * (values - lfilter([1.0 - mean, mean - decay], [1.0, -decay], values))
    return out


class PlaneField:
    """As GustField, of air that is a plane: the part around the aircraft, made as it gets there."""

    def __init__(
        self,
        parts: Across,
        model: Dryden,
        kind: str,
        ramp: Ramp,
        behind: float,
        seed: np.random.SeedSequence,
        laid: Sequence[Laid] = (),
    ) -> None:
        """`kind`: of isotropic.KINDS; `behind`: how far behind the origin the field begins, m."""
        sigma = model.sigma_w
        made = filters(parts, model.length_u, model.length_w, model.sigma_u / sigma if sigma else 1.0, kind)
        self.now = Field(np.empty((0, made.series)), field_start(behind), made.meets)
        """The part that is kept."""
        self._made, self._ramp, self._sigma, self._laid = made, ramp, sigma, laid
        self._rng = np.random.default_rng(seed)
        self._last = self._rng.standard_normal((made.series, _BLOCK))
        pieces = made.parts.shape[1]
        self._noise = np.zeros((pieces, made.series, _BLOCK + 1), dtype=complex)
        """Transforms of two blocks of noise each, the newest first."""
        for _ in range(pieces - 1):
            self._listen()

    def cover(self, low: float, high: float) -> None:
        """Hold the field from distance `low` to `high` at least; `low` never goes back."""
        values, first, meets = self.now
        end = first + len(values)
        missing = points_missing(low, high, end)
        if missing <= 0:
            return
        drop = math.floor(low / STEP) - 2 - first
        blocks = [self._block(end + i * _BLOCK) for i in range(math.ceil(missing / _BLOCK))]
        keep = values[max(0, drop) :]
        self.now = Field(np.concatenate((keep, *blocks)), first + len(values) - len(keep), meets)

    def _listen(self) -> None:
        """A block of noise more."""
        noise = self._rng.standard_normal((self._made.series, _BLOCK))
        self._noise = np.roll(self._noise, 1, axis=0)
        self._noise[0] = np.fft.rfft(np.concatenate((self._last, noise), axis=1))
        self._last = noise

    def _block(self, first: int) -> Array:
        """(_BLOCK, series): the points from index `first` on."""
        made = self._turbulence(first) if self._sigma else np.zeros((_BLOCK, self._made.series))
        for gust in self._laid:
            gust.add_to(made, first)
        return made

    def _turbulence(self, first: int) -> Array:
        """Of these points."""
        self._listen()
        sums = np.zeros((self._made.series, _BLOCK + 1), dtype=complex)
        for (i, j), part in zip(self._made.pairs, self._made.parts, strict=True):
            sums[i] += (part * self._noise[:, j]).sum(axis=0)
        made = np.fft.irfft(sums)[:, _BLOCK:]
        strength = self._ramp.strength(first + np.arange(_BLOCK))
        return np.ascontiguousarray((made * (self._sigma * strength)).T)

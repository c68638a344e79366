"""Fits of every live longitudinal method but `physical` from the spectra of two groups of signals, and by how much each
method's model may be wrong."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from station.estimation.equation_error import Fitted, Sums, fit, no_sums, nothing_fitted
from station.model import regressor_error, unsteady_lift

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

KINDS: Final = ("II", "III", "V", "split", "split+gust")
"""The methods in the order in which they are numbered; IV comes after, where its spectra are given."""
II, III, V, SPLIT, SPLIT_GUST, IV = range(6)
GROUPS: Final = 2
STEADY, SPLIT_ALPHA = range(GROUPS)
"""Groups of signals: with the calibrated vane's angle of attack, and with that at the CG split in motion and gust."""
GROUP_OF: Final = (STEADY, STEADY, STEADY, SPLIT_ALPHA, SPLIT_ALPHA, STEADY)
"""Of each method."""

QHAT, ELEVATOR, CL, CM, ALPHA, VANE_LATE, RATE_LATE = range(7)
"""Channels of the steady group: q c/2V, both sides of the equations, alpha of II, and of III its parts from vane and
rate. Those of the split group are the first four, alpha and"""
GUST_STEP: Final = 5
"""d."""
STEADY_CHANNELS: Final = 7
SPLIT_CHANNELS: Final = 6

PARAMETERS: Final = 3
"""Of each equation: slopes by alpha, q c/2V and elevator; split+gust has a fourth, by d."""
PLACES: Final = 4
EQUATIONS: Final = 2
NEXT_ORDER: Final = 0.5
GUST_STANDS_OUT: Final = 2.5
"""Energy of d over the ridge, which the sensors' noise alone makes."""


class Factors(NamedTuple):
    """By line."""

    derivative: Array
    """Of Cm, for its central difference, (frequencies,)."""
    scale: Array
    """Of V's vane part, (frequencies,)."""
    measured: Complex
    """Of the delayed vane and rate parts in IV, (2, frequencies)."""
    tail: Array
    """tan(w l_t/4V), (frequencies,)"""


class Doubt(NamedTuple):
    """What may be wrong with split+gust, at the mean speed."""

    lift: Complex
    """unsteady_lift.weights"""
    regressors: regressor_error.Weights


class Extent(NamedTuple):
    """How much data there are."""

    independent: Array
    """T df of the segment under way, of either group, (2,): see equation_error.fit."""
    close: Flags
    """Whether the segment is to be closed, of either group, (2,)."""
    samples: float
    """Of the split group, with closed segments."""
    ridge: float
    """Of the regressor d: what the vane's noise alone makes of it on all lines."""
    wind: float
    """Standard deviation of the mean wind, as a share of the speed."""


class Past(NamedTuple):
    """Sums over closed segments."""

    fits: Sums
    """Of (kinds, equations)."""
    next_order: Array
    """Of split+gust: regressors times the next order of the gust's lag, (equations, 4)."""
    lift: unsteady_lift.Sums
    regressors: Array
    """regressor_error.SUMS"""


class Found(NamedTuple):
    """What `fit_methods` fills."""

    fitted: Fitted
    """Of (kinds, equations)."""
    model: Array
    """By how much the model may be wrong, in each parameter, (kinds, equations, 3)."""
    r2: Array
    """(kinds, equations)"""
    solved: Flags
    """(kinds, equations)"""


@register_jitable
def nothing_past(kinds: int) -> Past:
    """Before the first segment is closed."""
    lift, regressors = unsteady_lift.no_sums(), np.zeros(regressor_error.SUMS)
    return Past(no_sums((kinds, EQUATIONS), PLACES), np.zeros((EQUATIONS, PLACES)), lift, regressors)


@register_jitable
def nothing_found(kinds: int) -> Found:
    """Zeros, to be filled."""
    return Found(
        nothing_fitted((kinds, EQUATIONS), PLACES),
        np.zeros((kinds, EQUATIONS, PARAMETERS)),
        np.zeros((kinds, EQUATIONS)),
        np.zeros((kinds, EQUATIONS), dtype=np.bool_),
    )


@register_jitable
def no_doubt(lines: int) -> Doubt:
    """Weights to be filled."""
    lift = np.zeros((unsteady_lift.ROWS, lines), dtype=np.complex128)
    return Doubt(lift, regressor_error.no_weights(lines))


@njit(cache=True)
def _regressors(kind: int, group: Complex, factors: Factors, x: Complex) -> None:
    """Of a method, from the spectra of its group, -> `x` (4, frequencies): alpha, q c/2V, elevator, d."""
    for f in range(group.shape[1]):
        if kind == III:
            x[0, f] = group[VANE_LATE, f] + group[RATE_LATE, f]
        elif kind == V:
            x[0, f] = group[VANE_LATE, f] * factors.scale[f] + group[RATE_LATE, f]
        elif kind == IV:
            x[0, f] = group[VANE_LATE, f] * factors.measured[0, f] + group[RATE_LATE, f] * factors.measured[1, f]
        else:
            x[0, f] = group[ALPHA, f]
        x[1, f] = group[QHAT, f]
        x[2, f] = group[ELEVATOR, f]
        if kind == SPLIT_GUST:
            x[3, f] = group[GUST_STEP, f]


@njit(cache=True)
def _next_order(x: Complex, tail: Array, fitted: Fitted, past: Array, close: bool, model: Array) -> None:
    """What the next order of the gust's lag from wing to tail does to an equation of split+gust -> `model` (3,)."""
    model[:] = 0.0
    for i in range(PLACES):
        product = past[i]
        for f in range(x.shape[1]):
            product += (x[i, f].conjugate() * x[3, f] * 1j * tail[f]).real
        if close:
            past[i] = product
        for j in range(PARAMETERS):
            model[j] += fitted.inverse[j, i] * product
    for j in range(PARAMETERS):
        model[j] = NEXT_ORDER * abs(model[j] * fitted.value[3])


@njit(cache=True)
def _doubts(x: Complex, doubt: Doubt, extent: Extent, past: Past, found: Found) -> None:
    """Add to `found.model` of split+gust what wrong regressors and unsteady lift do to it."""
    value, model, close = found.fitted.value[SPLIT_GUST], found.model[SPLIT_GUST], extent.close[SPLIT_ALPHA]
    # The regressors, and so the normal matrix, are the same in both equations.
    inverse, inflation = found.fitted.inverse[SPLIT_GUST, 1], found.fitted.inflation[SPLIT_GUST, 0]
    wrong = regressor_error.standard_deviations(
        doubt.regressors, extent.samples, extent.wind, x, value, inverse, past.regressors, close
    )
    gust, drift = 0.0, wrong
    if doubt.lift[unsteady_lift.RELATIVE, 0].real > 0.0:
        drift = unsteady_lift.drift(doubt.lift, x, value, inverse, past.lift, close)
        # The normal matrix without the ridge, from its inverse.
        d = inflation[3] / inverse[3, 3] - extent.ridge
        gust = max(1.0 - GUST_STANDS_OUT * extent.ridge / d, 0.0) if d > 0.0 else 0.0
    for equation in range(EQUATIONS):
        for j in range(PARAMETERS):
            model[equation, j] = math.hypot(model[equation, j], wrong[equation, j])
            model[equation, j] = math.hypot(model[equation, j], gust * drift[equation, j])


@njit(cache=True)
def _distance(kind: int, equation: int, found: Found) -> None:
    """`found.model` of any method but split+gust: that one's, and how far the method's estimates are from it."""
    value, model = found.fitted.value, found.model
    for i in range(PARAMETERS):
        apart = 0.0
        if found.solved[SPLIT_GUST, equation]:
            apart = value[kind, equation, i] - value[SPLIT_GUST, equation, i]
        model[kind, equation, i] = math.hypot(apart, model[SPLIT_GUST, equation, i])


@njit(cache=True)
def fit_methods(
    steady: Complex, split: Complex, factors: Factors, doubt: Doubt, extent: Extent, past: Past, found: Found
) -> None:
    """Both equations of II, III, V, split and split+gust, and of IV where `found` has a sixth place.

    `steady` and `split`: spectra of both groups, (channels, frequencies). Edits `past`; fills `found`.

    `found.model` is what the structure leaves, in each parameter. The gust meets wing and tail late, and d carries the
    first order of that; split+gust may be wrong by the next, d (1 - e^{-s T/2})/(1 + e^{-s T/2}) with T = l_t/V and a
    coefficient NEXT_ORDER times d's own (from Monte Carlo of both Twin Otters), by what unsteady lift does to it where
    the gust stands out of the noise, and by what wrong regressors do to it. Any other method may be wrong by as much
    as it differs from split+gust, too.
    """
    # From Python come plain tuples: see `plain`.
    factors, doubt, extent = Factors(*factors), Doubt(doubt[0], regressor_error.Weights(*doubt[1])), Extent(*extent)
    past = Past(Sums(*past[0]), past[1], unsteady_lift.Sums(*past[2]), past[3])
    found = Found(Fitted(*found[0]), found[1], found[2], found[3])
    lines = steady.shape[1]
    z = np.empty(lines, dtype=np.complex128)
    x = np.empty((PLACES, lines), dtype=np.complex128)
    ridge = np.zeros(PLACES)
    ridge[3] = extent.ridge
    fits, each = past.fits, found.fitted
    for turn in range(found.solved.shape[0]):
        # split+gust first, which the others' `model` is taken from.
        kind = SPLIT_GUST - turn if turn <= SPLIT_GUST else IV
        side = GROUP_OF[kind]
        group = split if side == SPLIT_ALPHA else steady
        n = PLACES if kind == SPLIT_GUST else PARAMETERS
        _regressors(kind, group, factors, x)
        for equation in range(EQUATIONS):
            for f in range(lines):
                z[f] = group[CL, f] if equation == 0 else group[CM, f] * factors.derivative[f]
            one, at = _sums_of(fits, kind, equation), _fitted_of(each, kind, equation)
            r2 = fit(x[:n], z, ridge[:n], extent.independent[side], one, extent.close[side], at)
            found.solved[kind, equation] = r2 == r2
            found.r2[kind, equation] = r2
            if kind != SPLIT_GUST:
                _distance(kind, equation, found)
            elif r2 == r2:
                past_order, model = past.next_order[equation], found.model[kind, equation]
                _next_order(x, factors.tail, at, past_order, extent.close[side], model)
            else:
                found.model[kind, equation] = 0.0
        if kind == SPLIT_GUST and found.solved[kind, 0] and found.solved[kind, 1]:
            _doubts(x, doubt, extent, past, found)


@register_jitable
def _sums_of(sums: Sums, kind: int, equation: int) -> Sums:
    return Sums(
        sums.normal[kind, equation],
        sums.scores[kind, equation],
        sums.right[kind, equation],
        sums.extent[kind, equation],
    )


@register_jitable
def _fitted_of(fitted: Fitted, kind: int, equation: int) -> Fitted:
    return Fitted(
        fitted.value[kind, equation],
        fitted.error[kind, equation],
        fitted.inflation[kind, equation],
        fitted.inverse[kind, equation],
    )


def plain(named: tuple[Any, ...]) -> Any:
    """The same arrays in tuples without names: numba takes a microsecond to see the type of each named one that comes
    from Python."""
    return tuple(plain(x) if isinstance(x, tuple) else x for x in named)


def fade(past: Past, group: int, keep: float) -> None:
    """Keep this share of the sums over closed segments of a group of signals."""
    kinds = [kind for kind in range(past.fits.normal.shape[0]) if GROUP_OF[kind] == group]
    for sums in past.fits:
        sums[kinds] *= keep
    if group == SPLIT_ALPHA:
        for sums in (past.next_order, *past.lift, past.regressors):
            sums *= keep


def clear(past: Past) -> None:
    """Forget the closed segments."""
    for sums in (*past.fits, past.next_order, *past.lift, past.regressors):
        sums[:] = 0.0

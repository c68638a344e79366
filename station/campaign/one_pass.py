"""Compiled flights: fly, measure, estimate.

Nothing is computed here that the simulation and the estimators do not compute: their kernels are called in the order in
which `simulation.fly` and `estimation.methods.Estimator` call them for frames without gaps, and give the same numbers.
A record's estimation is one compiled call, a flight some: a call costs ten microseconds, a kernel that others call is
compiled again in each. Arrays are copied by loops: numba takes seconds to compile the check of two arrays' shapes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.campaign import physical_pass as physical
from station.conventions import SIGNAL_INDEX, TICK_HZ, TICK_NS
from station.estimation import conditioning as cond
from station.estimation import equation_error as ee
from station.estimation import method_fits, tick
from station.estimation.derivatives import SLACK_S, moved, weights
from station.estimation.method_fits import KINDS, SPLIT_CHANNELS, STEADY_CHANNELS, Extent, Factors
from station.estimation.methods import SETTLE_TICKS
from station.model import physical_posterior, regressor_error, unsteady_lift
from station.numerics import spectra
from station.numerics.named_state import Element
from station.simulation import airframe as ac
from station.simulation.boom import SecondOrder, VaneConstants
from station.simulation.distortion import distort
from station.simulation.gusts import Field, FieldConstants, fill
from station.simulation.longitudinal import DISTANCE
from station.simulation.motion import COLUMNS, EVERY, FLOWN, Flown, Site, advance, at_rest, places
from station.simulation.pilot import Hands, Tremor

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_DT: Final = 1.0 / TICK_HZ
_SIGNALS: Final = len(FLOWN)
_VANE: Final = SIGNAL_INDEX["alpha_vane"]
_TRUE_ALPHA, _TRUE_GUST = places("alpha", "alpha_gust")
_INPUTS: Final = tuple(SIGNAL_INDEX[name] for name in cond.INPUTS)
_KINDS: Final = len(KINDS)
PHYSICAL: Final = _KINDS + 2
SLOTS: Final = PHYSICAL + 1
"""Methods that the pass can fit: the live ones, perfect, raw, and physical."""


class Air(NamedTuple):
    """What is flown."""

    constants: ac.Constants
    tables: ac.Tables
    vanes: tuple[VaneConstants, VaneConstants]
    site: Site
    field: FieldConstants
    plane: Callable[[int, int], Field] | None  # in its place, of seed and points, where gusts vary across the span
    behind: float
    """Where the wake begins, m behind the origin."""
    first: int  # index of the field's first point
    command: Array
    """Elevator at steps and half-steps, rad, beside the feedback of `hands`."""
    hands: Hands
    tremor: tuple[float, float]
    """Standard deviations of what the noise of the feedback's sensors and a human's remnant add, rad."""


class Sensors(NamedTuple):
    """What is measured."""

    ticks: int
    is_perfect: bool
    """alpha_vane is the angle of attack at the CG."""
    distortion: Array
    """distortion_filter's weights; empty: none."""
    distorts_gust: bool
    """Only the gust's part."""
    vane: SecondOrder
    """Its dynamics at 50 Hz, for the distortion."""
    noisy: Indices
    """Signals with noise."""
    noise: Array
    """Standard deviation of each, SI."""
    signal_to_noise: float
    """Above 0: the noise of each noisy signal is its own standard deviation over this."""


class Estimation(NamedTuple):
    """What is estimated, and by what."""

    has_split: bool
    has_benchmarks: bool
    channels: int
    """Of the unsplit methods' transform."""
    filters: Element
    """tick.Constants."""
    sides: Array
    """equation_error.Sides.constant."""
    transform: spectra.Design
    frequencies: Array
    """Of the transform's lines, Hz."""
    derivative: Array
    """What a central difference loses of each line: spectra.central_difference_factor."""
    lengths: tuple[float, float, float]
    unsteady: unsteady_lift.Known
    sears_k: Array
    sears: Array
    """derivatives.lengths and Sears' function over reduced frequency: what weights gain and delay."""
    paths: regressor_error.Lengths
    noisy: regressor_error.Deviations
    vane_noise: float
    """Standard deviation, rad."""
    warm_up: float
    """Seconds before the transforms open."""
    step: float
    """Between the lines, Hz."""
    segment: float
    """Seconds after which the transforms begin anew."""


class Results(NamedTuple):
    """Of each flight (first axis), method (SLOTS) and equation: three parameters each."""

    estimate: Array
    error: Array
    """Statistical standard error."""
    model: Array
    """What the model's structure may be wrong by; 0 where the pass does not know."""
    r2: Array
    solved: NDArray[np.bool_]


@njit(cache=True, error_model="numpy")
def _deviation(x: Array) -> float:
    mean = 0.0
    for value in x:
        mean += value
    mean /= x.shape[0]
    total = 0.0
    for value in x:
        total += (value - mean) ** 2
    return math.sqrt(total / x.shape[0])


@njit(cache=True, error_model="numpy")
def measure(sensors: Sensors, truth: Array, white: Array, shown: Array) -> None:
    """What the sensors show, (ticks, signals), of the truth, (ticks or more, COLUMNS)."""
    n = sensors.ticks
    for k in range(n):
        for i in range(_SIGNALS):
            shown[k, i] = truth[k, i]
        if sensors.is_perfect:
            shown[k, _VANE] = truth[k, _TRUE_ALPHA]
    if sensors.distortion.shape[0] > 0:
        part = truth[:, _TRUE_GUST] if sensors.distorts_gust else truth[:, _TRUE_ALPHA]
        distort(sensors.distortion, sensors.vane, part, shown[:, _VANE])
    for i in range(sensors.noisy.shape[0]):
        column = shown[:, sensors.noisy[i]]
        sd = sensors.noise[i]
        if sensors.signal_to_noise > 0.0:
            sd = _deviation(column) / sensors.signal_to_noise
        for k in range(n):
            column[k] += sd * white[i, k]


@njit(cache=True, error_model="numpy")
def _fit_benchmarks(
    e: Estimation, steady: NDArray[np.complex128], extra: spectra.State, past: ee.Sums, close: bool, results: Results,
    run: int,
) -> None:  # fmt: skip
    """Perfect and raw: least squares on their own regressor."""
    lines = steady.shape[1]
    x = np.empty((3, lines), dtype=np.complex128)
    z = np.empty(lines, dtype=np.complex128)
    fitted, ridge = ee.nothing_fitted((), method_fits.PLACES), np.zeros(3)
    samples = extra.samples[spectra.TRANSFORMED]
    for i in range(2):
        at = _KINDS + i
        for equation in range(2):
            for f in range(lines):
                x[0, f], x[1, f], x[2, f] = extra.spectrum[i, f], steady[0, f], steady[1, f]
                z[f] = steady[2, f] if equation == 0 else steady[3, f] * e.derivative[f]
            one = ee.Sums(
                past.normal[i, equation], past.scores[i, equation], past.right[i, equation], past.extent[i, equation]
            )
            r2 = ee.fit(x, z, ridge, samples * _DT * e.step, one, close, fitted)
            results.solved[run, at, equation] = r2 == r2
            for j in range(3):
                results.estimate[run, at, equation, j] = fitted.value[j]
                results.error[run, at, equation, j] = fitted.error[j]
            results.r2[run, at, equation] = r2


class Memory(NamedTuple):
    """What a flight's methods carry from tick to tick, changed in place."""

    steady: spectra.State
    split: spectra.State
    benchmarks: spectra.State
    """Transforms of either group of signals, and of the regressors of perfect and raw."""
    begun: Array
    """Time of the first sample of the steady and the split group, s, (2,)."""
    closed: Array
    """Samples in closed segments of either group, (2,)."""
    at: Array
    """Mean speed, m/s, and density, kg/m3, which the weights are made for, (2,)."""
    past: method_fits.Past
    past_benchmarks: ee.Sums
    factors: Factors
    doubt: method_fits.Doubt
    found: method_fits.Found


@njit(cache=True, error_model="numpy")
def _begin(e: Estimation) -> Memory:
    """Before the first tick."""
    lines = e.frequencies.shape[0]
    return Memory(
        spectra.begin(e.transform, STEADY_CHANNELS),
        spectra.begin(e.transform, SPLIT_CHANNELS),
        spectra.begin(e.transform, 2),
        np.zeros(2),
        np.zeros(2),
        np.full(2, math.nan),
        method_fits.nothing_past(_KINDS),
        ee.no_sums((2, 2), method_fits.PLACES),
        Factors(e.derivative, np.ones(lines), np.ones((2, lines), dtype=np.complex128), np.zeros(lines)),
        method_fits.no_doubt(lines),
        method_fits.nothing_found(_KINDS),
    )


# Inlined: a call with a NamedTuple counts a reference to each of its arrays, which takes longer than the sample.
@njit(cache=True, error_model="numpy", inline="always")
def _add(e: Estimation, m: Memory, made: Array, t: float, has_split: bool, true_alpha: float, vane: float) -> None:
    """One sample that equation_error.sides made into the transforms, as Derivatives.add; `true_alpha` and `vane`: the
    regressors of perfect and raw, rad."""
    due = t >= e.warm_up
    late = t - e.warm_up + SLACK_S
    if m.steady.samples[spectra.FILTERED] == 0.0:
        m.begun[0] = t
    is_open = due and m.begun[0] <= late
    spectra.step(e.transform, m.steady, made[: e.channels], is_open)
    if e.has_benchmarks:
        spectra.step(e.transform, m.benchmarks, np.array((true_alpha, vane)), is_open)
    if has_split:
        if m.split.samples[spectra.FILTERED] == 0.0:
            m.begun[1] = t
        x = np.empty(SPLIT_CHANNELS)
        for i in range(SPLIT_CHANNELS):
            x[i] = made[i if i < method_fits.ALPHA else STEADY_CHANNELS - method_fits.ALPHA + i]
        spectra.step(e.transform, m.split, x, due and m.begun[1] <= late)


@njit(cache=True, error_model="numpy")
def _fit(e: Estimation, m: Memory, s: tick.State, results: Results, run: int) -> None:
    """What every method makes of the spectra; closes segments that are full."""
    lines = e.frequencies.shape[0]
    samples = m.steady.samples[spectra.TRANSFORMED], m.split.samples[spectra.TRANSFORMED]
    independent, close = np.empty(2), np.empty(2, dtype=np.bool_)
    for i in range(2):
        independent[i] = samples[i] * _DT * e.step
        close[i] = samples[i] * _DT >= e.segment
    weights(e.lengths, m.at[0], e.frequencies, e.sears_k, e.sears, m.factors.scale, m.factors.tail)
    unsteady_lift.weights(e.unsteady, m.at[0], m.at[1], e.frequencies, m.doubt.lift)
    regressor_error.weights(e.paths, m.at[0], e.frequencies, e.noisy, m.doubt.regressors)
    every = samples[1] + m.closed[1]
    ridge = lines * every * e.vane_noise**2
    extent = Extent(
        independent, close, every, ridge, regressor_error.wind_share(s.wind_sd, s.vane.seen.speed_mean, every * _DT)
    )
    method_fits.fit_methods(m.steady.spectrum, m.split.spectrum, m.factors, m.doubt, extent, m.past, m.found)
    if e.has_benchmarks:
        _fit_benchmarks(e, m.steady.spectrum, m.benchmarks, m.past_benchmarks, close[0], results, run)
    if close[0]:
        m.closed[0] += samples[0]
        spectra.clear(m.steady)
        spectra.clear(m.benchmarks)
    if close[1]:
        m.closed[1] += samples[1]
        spectra.clear(m.split)


@njit(cache=True, error_model="numpy")
def _take(shown: Array, k: int, has_split: bool, u: Array) -> None:
    """The inputs `u` of a tick; without a split no attitude and velocity, from which it would follow."""
    for i in range(len(_INPUTS)):
        u[i] = shown[k, _INPUTS[i]] if has_split or i < cond.ATTITUDE else math.nan


@njit(cache=True, error_model="numpy")
def estimate(
    e: Estimation,
    own: physical.Constants | None,
    state: Element,
    shown: Array,
    true_alpha: Array,
    results: Results,
    run: int,
) -> None:
    """Every method's estimates at the end of a record, as the Estimator comes to them tick by tick.

    `own`: for the method physical, where it is wanted; `state`: tick.State at the start; shown (ticks, signals),
    true_alpha (ticks,). Fills `results` of this `run`.
    """
    n = shown.shape[0]
    u, age = np.empty(len(_INPUTS)), np.zeros(len(_INPUTS))
    made, means = np.full(4 + ee.EXTRAS, math.nan), np.zeros(4)
    sides = (e.sides, np.full((3, ee.ROW), math.nan), means, made)
    s: tick.State = state[0]
    m = _begin(e)
    steady, split, closed, at = m.steady.samples, m.split.samples, m.closed, m.at
    split_run = 0
    if own is not None:
        kept = physical.begin(own)
    for k in range(n):
        t = (k * TICK_NS) * 1e-9
        _take(shown, k, e.has_split, u)
        s.inertial.is_held = own is not None and kept.transform.samples[spectra.TRANSFORMED] > 0.0
        done = tick.advance(e.filters, state, sides, t, u, age)
        if done & tick.MADE and k + 1 > SETTLE_TICKS:
            _add(e, m, made, t, split_run > 0, true_alpha[k - 1], shown[k - 1, _VANE])
            if own is not None and split_run > SETTLE_TICKS:
                physical.add(own, kept, s, made, t, means[2], n - 1 - k)
        split_run = split_run + 1 if done & tick.SPLIT else 0
        mean, density = s.vane.seen.speed_mean, means[2]
        if steady[spectra.TRANSFORMED] + closed[0] == 0.0 or not mean > 0.0:
            continue
        if moved(mean, at[0]) or moved(density, at[1]):
            at[0], at[1] = mean, density
        longest = max(steady[spectra.TRANSFORMED], split[spectra.TRANSFORMED]) * _DT
        if k + 1 == n or longest >= e.segment:
            _fit(e, m, s, results, run)
    if own is not None and kept.flown[physical.SOLVED] > 0.0:
        _hand_over_physical(kept.found, results, run)
    _hand_over(m.found, results, run)


@njit(cache=True, error_model="numpy")
def _hand_over_physical(found: physical_posterior.Found, results: Results, run: int) -> None:
    for i in range(6):
        equation, j = i // 3, i % 3
        results.estimate[run, PHYSICAL, equation, j] = found.theta[i]
        results.error[run, PHYSICAL, equation, j] = found.statistical[i]
        more = found.total[i] ** 2 - found.statistical[i] ** 2
        results.model[run, PHYSICAL, equation, j] = math.sqrt(max(more, 0.0))
    for equation in range(2):
        results.solved[run, PHYSICAL, equation] = True
        results.r2[run, PHYSICAL, equation] = 1.0 - found.residual[equation] / found.signal[equation]


@njit(cache=True, error_model="numpy")
def _hand_over(found: method_fits.Found, results: Results, run: int) -> None:
    for kind in range(_KINDS):
        for equation in range(2):
            for i in range(3):
                results.estimate[run, kind, equation, i] = found.fitted.value[kind, equation, i]
                results.error[run, kind, equation, i] = found.fitted.error[kind, equation, i]
                results.model[run, kind, equation, i] = found.model[kind, equation, i]
            results.r2[run, kind, equation] = found.r2[kind, equation]
            results.solved[run, kind, equation] = found.solved[kind, equation]


def fly_and_measure(
    air: Air, sensors: Sensors, seed: int, state: Array, wind: Array, white: Array, shown: Array, true_alpha: Array
) -> float:
    """One flight of a case, and what its sensors show; returns how far it got, m.

    `seed` of the noise that the feedback hears; state (5,), wind (points, 5), white (noisy, ticks): white noise of unit
    variance for field and sensors. Fills shown (ticks, signals) and alpha at the CG, true_alpha (ticks,).
    """
    truth = np.empty((sensors.ticks + sensors.distortion.shape[0] // 2, len(COLUMNS)))
    field = air.plane(seed, len(wind)) if air.plane else Field(np.zeros((len(wind), 3)), air.first)
    if air.plane is None and air.field.sigmas[2] > 0.0:
        fill(air.field, wind, state.copy(), air.first, field.values)
    memory = at_rest(air.constants, air.tables, air.behind, field, air.hands)
    flown = Flown(air.constants, air.tables, *air.vanes, air.site, air.hands)
    steps = air.command.shape[0]
    shakes = Tremor(air.tremor[0], seed, remnant=air.tremor[1]).half_steps(math.ceil(steps / (2 * EVERY)))
    advance(flown, memory, air.command + shakes[:steps], field, EVERY, truth)
    measure(sensors, truth, white, shown)
    true_alpha[:] = truth[: sensors.ticks, _TRUE_ALPHA]
    return float(memory.x[DISTANCE])


def compile_fits(e: Estimation) -> None:
    """Compile the fits alone, with arguments of the kinds that `estimate` has for them: it then finds them done."""
    lines = len(e.frequencies)
    ones, none = np.ones(lines), np.zeros((STEADY_CHANNELS, lines), dtype=np.complex128)
    factors = Factors(ones, ones.copy(), np.ones((2, lines), dtype=np.complex128), ones.copy())
    doubt = method_fits.no_doubt(lines)
    weights(e.lengths, 50.0, e.frequencies, e.sears_k, e.sears, factors.scale, factors.tail)
    unsteady_lift.weights(e.unsteady, 50.0, 1.0, e.frequencies, doubt.lift)
    regressor_error.weights(e.paths, 50.0, e.frequencies, e.noisy, doubt.regressors)
    extent = Extent(np.ones(2), np.zeros(2, dtype=np.bool_), 1.0, 1.0, 0.0)
    past, found = method_fits.nothing_past(_KINDS), method_fits.nothing_found(_KINDS)
    method_fits.fit_methods(none, none, factors, doubt, extent, past, found)

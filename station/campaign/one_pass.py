"""Compiled flights: fly, measure, estimate.

Nothing is computed here that the simulation and the estimators do not compute: their kernels are called in the order in
which `simulation.fly` and `estimation.methods.Estimator` call them for frames without gaps, and give the same numbers.
A record's estimation is one compiled call, a flight some: a call costs ten microseconds, but a kernel that others call
is compiled again in each. Arrays are copied by loops: numba takes seconds to compile the check of two arrays' shapes.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.campaign import physical_pass as physical
from station.conventions import SIGNAL_INDEX, TICK_HZ, TICK_NS
from station.estimation import alpha as cg
from station.estimation import conditioning as cond
from station.estimation import equation_error as ee
from station.estimation import inertial, tick
from station.estimation.derivatives import KINDS, SLACK_S, moved, weights
from station.estimation.methods import SETTLE_TICKS
from station.model import physical_signals as gusts
from station.model import regressor_error
from station.model import unsteady_lift as lift_memory
from station.numerics import spectra
from station.simulation import airframe as ac
from station.simulation.boom import SecondOrder, VaneConstants
from station.simulation.distortion import distort
from station.simulation.gusts import FieldConstants, fill
from station.simulation.motion import COLUMNS, EVERY, Site, Tables, advance, at_rest, places

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_DT: Final = 1.0 / TICK_HZ
_SIGNALS: Final = len(SIGNAL_INDEX)
_VANE: Final = SIGNAL_INDEX["alpha_vane"]
_TRUE_ALPHA, _TRUE_GUST = places("alpha", "alpha_gust")
_INPUTS: Final = tuple(SIGNAL_INDEX[name] for name in cond.INPUTS)
_KINDS: Final = len(KINDS)
PHYSICAL: Final = _KINDS + 2
SLOTS: Final = PHYSICAL + 1
"""Methods that the pass can fit: the live ones, perfect, raw, and physical."""
_WING_BODY: Final = 7
"""Channels of the transform that II, III and V take."""


class Air(NamedTuple):
    """What is flown."""

    constants: ac.Constants
    tables: Tables
    vane: VaneConstants
    site: Site
    field: FieldConstants
    behind: float
    """Where the wake begins, m behind the origin."""
    first: int
    """Index of the field's first point."""
    command: Array
    """Elevator at steps and half-steps, rad."""


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
    alpha: Array
    """alpha.parameters."""
    boom: tuple[float, float, float]
    """Zero, steady calibration, length: see tick.prepare."""
    imu: Array
    """Its place from the CG, m."""
    sides: Array
    """equation_error.Sides.constant."""
    sos: Array
    rest: Array
    """The high-pass and its state at rest: spectra.high_pass."""
    frequencies: Array
    """Of the transform's lines, Hz."""
    turn: NDArray[np.complex128]
    """What each line's phase is multiplied by from one sample to the next."""
    derivative: Array
    """What a central difference loses of each line: spectra.central_difference_factor."""
    lengths: tuple[float, float, float]
    remembered: Array
    """lift_memory.known."""
    sears_k: Array
    sears: Array
    """derivatives.lengths and Sears' function over reduced frequency: what weights gain and delay."""
    paths: tuple[float, float, float, float]
    """regressor_error.lengths."""
    noisy: tuple[float, float, float, float, float, float]
    """regressor_error.deviations."""
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
    e: Estimation, steady: NDArray[np.complex128], extra: NDArray[np.complex128], samples: float, past: Array,
    close: bool, results: Results, run: int,
) -> None:  # fmt: skip
    """Perfect and raw: least squares on their own regressor."""
    lines = steady.shape[1]
    x = np.empty((3, lines), dtype=np.complex128)
    z = np.empty(lines, dtype=np.complex128)
    # A slice, as fit_methods hands on: one kind of array, one compilation.
    out = np.zeros((3, ee.MAX_PARAMETERS + 1))[:, :4]
    inverse = np.zeros((4, 4))
    for i in range(2):
        at = _KINDS + i
        for equation in range(2):
            for f in range(lines):
                x[0, f], x[1, f], x[2, f] = extra[i, f], steady[0, f], steady[1, f]
                z[f] = steady[2, f] if equation == 0 else steady[3, f] * e.derivative[f]
            done = ee.fit(x, z, np.zeros(3), samples * _DT * e.step, past[i, equation], close, out, inverse)
            results.solved[run, at, equation] = done
            for j in range(3):
                results.estimate[run, at, equation, j] = out[0, j]
                results.error[run, at, equation, j] = out[1, j]
            results.r2[run, at, equation] = out[0, 3]


@njit(cache=True, error_model="numpy")
def estimate(
    e: Estimation, own: physical.Constants | None, shown: Array, true_alpha: Array, results: Results, run: int
) -> None:
    """Every method's estimates at the end of a record, as the Estimator comes to them tick by tick.

    `own`: for the method physical, where it is wanted; shown (ticks, signals), true_alpha (ticks,). Fills `results` of
    this `run`.
    """
    n, lines = shown.shape[0], e.frequencies.shape[0]
    inertial_state, inertial_ring = np.zeros(inertial.STATE), np.zeros((inertial.RING, 7))
    inertial_out = np.full(inertial.OUT, math.nan)
    vane_state, vane_ring, vane_out = np.zeros(cg.STATE), np.zeros((cg.RING, 4)), np.full(cg.OUT, math.nan)
    u, motion, air, ages = np.empty(len(_INPUTS)), np.empty(6), np.empty(3), np.zeros(3)
    row, history, means = np.zeros(ee.ROW), np.full((3, ee.ROW), math.nan), np.zeros(4)
    made = np.full(4 + ee.EXTRAS, math.nan)
    sections = e.sos.shape[0]
    channels = (e.channels, 6, 2)
    filters = (np.zeros((_WING_BODY, sections, 2)), np.zeros((6, sections, 2)), np.zeros((2, sections, 2)))
    spectrum = (
        np.zeros((_WING_BODY, lines), dtype=np.complex128),
        np.zeros((6, lines), dtype=np.complex128),
        np.zeros((2, lines), dtype=np.complex128),
    )
    phase = np.ones((3, lines), dtype=np.complex128)
    counts = np.zeros((3, 2))
    split_x, extra_x = np.empty(6), np.empty(2)
    past, extra_past = np.zeros((_KINDS, 2, ee.PAST)), np.zeros((2, 2, ee.PAST))
    closed, independent, close = np.zeros(3), np.zeros(2), np.zeros(2, dtype=np.bool_)
    out, model = np.zeros((_KINDS, 2, 3, ee.MAX_PARAMETERS + 1)), np.zeros((_KINDS, 2, 3))
    solved = np.zeros((_KINDS, 2), dtype=np.bool_)
    scale, tail = np.ones(lines), np.zeros(lines)
    memory = np.zeros((lift_memory.ROWS, lines), dtype=np.complex128)
    wrong = np.zeros((regressor_error.ROWS, lines), dtype=np.complex128)
    doubt = (memory, wrong, np.zeros((4, 4)))
    wind_state = np.zeros(gusts.STATE)
    unmeasured = np.ones((2, lines), dtype=np.complex128)
    zero, calibration, arm = e.boom
    speed, density = math.nan, math.nan
    steady_from, split_from, split_run = 0.0, 0.0, 0
    if own is not None:
        kept = physical.begin(own, sections, lines)
        wind_state = kept.state

    for k in range(n):
        t = (k * TICK_NS) * 1e-9
        for i in range(len(_INPUTS)):
            u[i] = shown[k, _INPUTS[i]]
        tick.prepare(u, zero, calibration, arm, motion, air)
        alpha_i = math.nan
        if e.has_split:
            a, v = cond.ATTITUDE, cond.VELOCITY
            inertial_state[inertial.HOLD] = 1.0 if own is not None and kept.counted[1] > 0.0 else 0.0
            inertial.step(
                inertial_state, inertial_ring, t, _DT, motion, u[a:v], ages, u[v:], ages, air, e.imu, inertial_out
            )
            if inertial_out[8] > 0.0:
                alpha_i = inertial_out[0]
        flow, q = u[cond.VANE], motion[1]
        cg.step(e.alpha, vane_state, vane_ring, _DT, flow, motion[0], q, air[0], alpha_i, vane_out)
        if own is not None:
            gust, ground, theta = vane_out[cg.BOOM_GUST], inertial_out[2], inertial_out[7]
            physical.follow(own, kept, vane_out[cg.READY] > 0.0, gust, alpha_i, air[0], ground, theta)
        elif vane_out[cg.READY] > 0.0:
            gusts.watch_wind(wind_state, _DT, air[0], inertial_out[2])
            wind_state[gusts.COUNT] += 1.0
        else:
            wind_state[gusts.COUNT] = 0.0
        is_split = tick.assemble(u, motion, u[cond.QBAR], u[cond.MASS], vane_out, row)
        has_sample = ee.sides(e.sides, history, means, _DT, row, made)
        if has_sample and k + 1 > SETTLE_TICKS:
            due = t >= e.warm_up
            late = t - e.warm_up + SLACK_S
            if counts[0, 0] == 0.0:
                steady_from = t
            is_open = due and steady_from <= late
            m = channels[0]
            spectra.step(e.sos, e.rest, filters[0][:m], made[:m], spectrum[0][:m], phase[0], e.turn, counts[0], is_open)
            if e.has_benchmarks:
                extra_x[0], extra_x[1] = true_alpha[k - 1], shown[k - 1, _VANE]
                spectra.step(e.sos, e.rest, filters[2], extra_x, spectrum[2], phase[2], e.turn, counts[2], is_open)
            if split_run > 0:
                if counts[1, 0] == 0.0:
                    split_from = t
                for i in range(6):
                    split_x[i] = made[i if i < 4 else 3 + i]
                opens = due and split_from <= late
                spectra.step(e.sos, e.rest, filters[1], split_x, spectrum[1], phase[1], e.turn, counts[1], opens)
            if own is not None and split_run > SETTLE_TICKS:
                filter_, card, left = (e.sos, e.rest), (e.warm_up, e.step), n - 1 - k
                physical.add(
                    own, kept, filter_, e.frequencies, e.turn, e.derivative, card, made, t, inertial_out[2], means[2],
                    left,
                )  # fmt: skip
        split_run = split_run + 1 if is_split else 0

        mean = vane_out[cg.SPEED_MEAN]
        if counts[0, 1] + closed[0] == 0.0 or not mean > 0.0:
            continue
        if moved(mean, speed) or moved(means[2], density):
            speed, density = mean, means[2]
        for i in range(2):
            independent[i] = counts[i, 1] * _DT * e.step
            close[i] = counts[i, 1] * _DT >= e.segment
        if not (k + 1 == n or close[0] or close[1]):
            continue
        weights(e.lengths, speed, e.frequencies, e.sears_k, e.sears, scale, tail)
        lift_memory.weights(e.remembered, speed, density, e.frequencies, memory)
        regressor_error.weights(e.paths, speed, e.frequencies, e.noisy, wrong, doubt[2])
        samples = counts[1, 1] + closed[1]
        ridge = lines * samples * e.vane_noise**2
        wind = regressor_error.wind_share(gusts.wind_sd(wind_state, _DT), mean, samples * _DT)
        ee.fit_methods(
            spectrum[0], spectrum[1], e.derivative, scale, unmeasured, tail, doubt, wind, samples, ridge, independent,
            close, past, out, model, solved,
        )  # fmt: skip
        if e.has_benchmarks:
            _fit_benchmarks(e, spectrum[0], spectrum[2], counts[2, 1], extra_past, close[0], results, run)
        for i in range(3):
            if close[0 if i == 2 else i]:
                closed[i] += counts[i, 1]
                counts[i, 1] = 0.0
                spectrum[i][:] = 0.0
                phase[i, :] = 1.0
    if own is not None and kept.sums[2] > 0.0:
        for i in range(6):
            results.estimate[run, PHYSICAL, i // 3, i % 3] = kept.theta[i]
            results.error[run, PHYSICAL, i // 3, i % 3] = kept.stat[i]
            more = kept.total[i] ** 2 - kept.stat[i] ** 2
            results.model[run, PHYSICAL, i // 3, i % 3] = math.sqrt(max(more, 0.0))
        for equation in range(2):
            results.solved[run, PHYSICAL, equation] = True
            results.r2[run, PHYSICAL, equation] = 1.0 - kept.quality[equation] / kept.quality[2 + equation]
    for kind in range(_KINDS):
        for equation in range(2):
            for i in range(3):
                results.estimate[run, kind, equation, i] = out[kind, equation, 0, i]
                results.error[run, kind, equation, i] = out[kind, equation, 1, i]
                results.model[run, kind, equation, i] = model[kind, equation, i]
            results.r2[run, kind, equation] = out[kind, equation, 0, 4 if kind == 4 else 3]
            results.solved[run, kind, equation] = solved[kind, equation]


def fly_and_measure(
    air: Air, sensors: Sensors, state: Array, wind: Array, white: Array, shown: Array, true_alpha: Array
) -> float:
    """One flight of a case, and what its sensors show; returns how far it got, m.

    state (5,) and wind (points, 5): white noise of unit variance for the field; white (noisy, ticks) for the sensors.
    Fills shown (ticks, signals) and the angle of attack at the CG, true_alpha (ticks,).
    """
    truth = np.empty((sensors.ticks + sensors.distortion.shape[0] // 2, len(COLUMNS)))
    field = np.zeros((wind.shape[0], 3))
    if air.field.sigmas[2] > 0.0:
        fill(air.field, wind, state.copy(), air.first, field)
    memory = at_rest(air.constants, air.tables, air.behind, field, air.first)
    advance(air.constants, air.tables, air.vane, air.site, memory, air.command, field, air.first, EVERY, truth)
    measure(sensors, truth, white, shown)
    true_alpha[:] = truth[: sensors.ticks, _TRUE_ALPHA]
    return float(memory.x[ac.DISTANCE])


def compile_fits(e: Estimation) -> None:
    """Compile the fits alone, with arguments of the kinds that `estimate` has for them: it then finds them done."""
    lines = len(e.frequencies)
    ones, none = np.ones(lines), np.zeros((_WING_BODY, lines), dtype=np.complex128)
    past, out, model = (
        np.zeros((_KINDS, 2, ee.PAST)),
        np.zeros((_KINDS, 2, 3, ee.MAX_PARAMETERS + 1)),
        np.zeros((_KINDS, 2, 3)),
    )
    solved, close, whole = np.zeros((_KINDS, 2), dtype=np.bool_), np.zeros(2, dtype=np.bool_), np.ones(2)
    memory = np.zeros((lift_memory.ROWS, lines), dtype=np.complex128)
    weights(e.lengths, 50.0, e.frequencies, e.sears_k, e.sears, ones.copy(), ones.copy())
    wrong = np.zeros((regressor_error.ROWS, lines), dtype=np.complex128)
    doubt = (memory, wrong, np.zeros((4, 4)))
    lift_memory.weights(e.remembered, 50.0, 1.0, e.frequencies, memory)
    regressor_error.weights(e.paths, 50.0, e.frequencies, e.noisy, wrong, doubt[2])
    ee.fit_methods(none, none, ones, ones, none, ones, doubt, 0.0, 1.0, 1.0, whole, close, past, out, model, solved)

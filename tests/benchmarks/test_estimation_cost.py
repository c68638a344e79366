"""Cost of the estimators; run with --benchmark-enable -s, which prints it. Nothing is asserted about time.

For comparison, in GNU Octave: recursive transform and least squares of 36 lines 25 us a tick, HFB-320 filter 4-6 ms a
sample, Twin Otter output error 10 minutes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from station.estimation import equation_error
from station.estimation.published.kalman import Tuning, extended_kalman
from station.estimation.published.longitudinal_motion import Body
from station.estimation.published.short_period import ShortPeriod
from station.model.coefficients import Airframe, coefficients
from station.numerics import spectra

FREE = ("CD_0", "CD_V", "CD_alpha", "CL_0", "CL_V", "CL_alpha", "Cm_0", "Cm_V", "Cm_alpha", "Cm_q", "Cm_de")
VALUES = (0.12, -0.064, 0.32, -0.09, 0.15, 4.3, 0.11, 0.004, -0.97, -34.0, -1.5)
SAMPLES = 601


TICKS = 1000
LINES = 49


@njit
def one_equation(design, state, x, sums, fitted) -> float:
    """Ticks of one equation: transform of three regressors and the output, then least squares with honest errors."""
    r2 = 0.0
    for k in range(x.shape[0]):
        spectra.step(design, state, x[k], True)
        r2 = equation_error.fit(state.spectrum[:3], state.spectrum[3], np.zeros(3), 1.0, sums, False, fitted)
    return r2


def test_tick_of_one_equation_with_3_regressors_and_49_lines(benchmark: Any) -> None:
    x = np.random.default_rng(3).normal(size=(TICKS, 4))
    transform = spectra.Transform(4, spectra.grid(0.08, 2.0, 0.04), 0.02)
    assert transform.spectrum.shape[1] == LINES
    sums, fitted = equation_error.no_sums((), 4), equation_error.nothing_fitted((), 4)

    def run() -> None:
        assert np.isfinite(one_equation(transform.design, transform.state, x, sums, fitted))

    run()
    benchmark(run)
    if benchmark.stats:
        print(f"\none equation, 3 regressors, 49 lines: {benchmark.stats['mean'] / TICKS * 1e6:.2f} us a tick")


def test_extended_kalman_filter_of_15_states_and_7_outputs(benchmark: Any) -> None:
    body = Body(4.0280e-3, 8.0027e-4, 7472.0, 104.67, 1.215, -7.0153e-6, 0.0524, True)
    start = np.array([106.023, 0.111685, 0.104887, -0.0033])
    inputs = np.tile([-0.008, 11580.0, 0.792], (SAMPLES, 1))
    measured = np.tile(np.append(start, [0.0, 0.97, -9.8]), (SAMPLES, 1))
    measured += np.random.default_rng(1).normal(size=measured.shape) * [0.1, 1e-3, 5e-4, 6e-4, 5e-3, 0.02, 0.1]
    noise = np.array([1.8e-2, 1e-6, 2e-7, 3e-7, 3e-5, 4e-4, 2e-2])
    tuning = Tuning(np.full(15, 10.0), np.concatenate([[1.3, 1e-4, 0, 0], np.zeros(11)]), noise)
    parameters = dict(zip(FREE, VALUES, strict=True))

    def run() -> None:
        extended_kalman(body, start, parameters, FREE, tuning, inputs, measured, 0.1)

    run()
    benchmark(run)
    if benchmark.stats:
        print(f"\nEKF, 15 states, 7 outputs: {benchmark.stats['mean'] / SAMPLES * 1e6:.1f} us a sample")


def test_output_error_of_401_samples_and_8_parameters(benchmark: Any) -> None:
    model, truth = made_up_doublet()

    def run() -> None:
        names = tuple(n for n in truth if n != "force_q")
        model.estimate({n: 0.8 * truth[n] for n in names} | {"force_q": truth["force_q"]}, names)

    run()
    benchmark(run)
    if benchmark.stats:
        print(f"\noutput error, 401 samples, 8 parameters: {benchmark.stats['mean'] * 1e3:.1f} ms")


def made_up_doublet() -> tuple[ShortPeriod, dict[str, float]]:
    """A record like NASA's 020213f1, from the model itself with noise."""
    n, dt = 401, 0.02
    t = np.arange(n) * dt
    airframe = Airframe(area=39.25, span=19.8, chord=1.98, mass=4945.0, ixx=28350.0, iyy=32910.0, izz=52170.0)
    one = np.ones(n)
    elevator = 0.022 * (np.sign(np.sin(2 * np.pi * (t - 1) / 1.6)) * ((t > 1) & (t < 4.2)))
    motion = {
        "airspeed": 72.5 * one,
        "dynamic_pressure": 2700.0 * one,
        "theta": 0.009 * one,
        "elevator": elevator,
        "q": 0 * one,
        "ax": 0.09 * one,
        "az": -9.8 * one,
    }
    truth = {
        "force_0": -0.4575,
        "force_alpha": -6.3,
        "force_q": 0.0,
        "force_de": -0.6,
        "Cm_0": 0.0,
        "Cm_alpha": -1.5,
        "Cm_q": -34.0,
        "Cm_de": -1.85,
        "az_bias": 0.0,
    }
    alpha = 0 * one
    c = coefficients(motion, airframe, alpha, dt)
    model = ShortPeriod.of(motion, alpha, c, airframe, dt, wind_axes=False)
    y = model.simulate(np.array(list(truth.values())))
    y += np.random.default_rng(2).normal(size=y.shape) * [5e-4, 1e-3, 0.03]
    motion |= {"q": y[:, 1], "az": y[:, 2]}
    return ShortPeriod.of(motion, y[:, 0], c, airframe, dt, wind_axes=False), truth

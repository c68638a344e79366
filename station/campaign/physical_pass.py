"""The method `physical` in the compiled pass: its kernels in the order of estimation.physical.Physical."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import TICK_HZ
from station.estimation import tick
from station.estimation.physical_method import SLACK_S, UPDATE_TICKS
from station.model import physical_columns as pc
from station.model import physical_fit
from station.model import physical_signals as ps
from station.numerics import spectra

Array = NDArray[np.float64]

_DT = 1.0 / TICK_HZ


class Constants(NamedTuple):
    """What the method takes of an aircraft and a card."""

    regressors: Array
    """physical_columns.constants."""
    noise: float
    """Of the vane, behind the body's upwash, rad2."""
    segment: float
    """Ticks after which the transform begins anew."""


class Memory(NamedTuple):
    """What the method carries from tick to tick, changed in place."""

    transform: spectra.State
    sums: Array
    """Time of the first sample, s; sum of the inertial speed, m/s; whether the last update was solved; standard error
    of the mean wind when the segment began, m/s."""
    regressors: Array
    past: Array
    row: Array
    theta: Array
    stat: Array
    total: Array
    quality: Array
    rho: Array


@njit(cache=True, error_model="numpy")
def begin(c: Constants, design: spectra.Design) -> Memory:
    """At the start of a flight."""
    return Memory(
        spectra.begin(design, pc.CHANNELS),
        np.zeros(4),
        c.regressors.copy(),
        np.zeros((pc.PARAMETERS, 2 * pc.PARAMETERS + 1 + pc.N)),
        np.zeros(pc.CHANNELS),
        np.zeros(pc.PARAMETERS),
        np.zeros(pc.PARAMETERS),
        np.zeros(pc.PARAMETERS),
        np.zeros(physical_fit.QUALITY),
        np.zeros(design.turn.shape[0]),
    )


@njit(cache=True, error_model="numpy")
def add(
    c: Constants,
    m: Memory,
    design: spectra.Design,
    frequencies: Array,
    derivative: Array,
    card: tuple[float, float],
    s: tick.State,
    made: Array,
    t: float,
    density: float,
    left: int,
) -> None:
    """One sample and, where an update is due that the end of the flight (`left` ticks on) or a segment needs, the
    estimate.

    `card`: warm-up, s, and step, Hz; `s`: the live filters now; `made`: what equation_error.sides gave; `density`: of
    the air, kg/m3.
    """
    m.row[: ps.SIGNALS] = s.signals.signals[0]
    m.row[ps.SIGNALS :] = made[:4]
    if m.transform.samples[spectra.FILTERED] == 0.0:
        m.sums[0] = t
    is_open = t >= card[0] and m.sums[0] <= t - card[0] + SLACK_S
    spectra.step(design, m.transform, m.row, is_open)
    samples = m.transform.samples[spectra.TRANSFORMED]
    if samples == 0.0:
        return
    if samples == 1.0:
        m.sums[3] = s.wind_sd
    m.sums[1] += s.inertial.flow.speed
    close = samples >= c.segment
    if not close and (samples % UPDATE_TICKS != 0.0 or left >= UPDATE_TICKS):
        return
    speed = m.sums[1] / samples
    pc.set_air(m.regressors, density, m.sums[3] / speed)
    solved = physical_fit.fit(
        m.transform.spectrum,
        2.0 * np.pi * frequencies,
        derivative,
        speed,
        m.regressors,
        samples * c.noise,
        samples * _DT * card[1],
        m.past,
        close,
        m.theta,
        m.stat,
        m.total,
        m.quality,
        m.rho,
    )
    m.sums[2] = 1.0 if solved else 0.0
    if close:
        spectra.clear(m.transform)
        m.sums[1] = 0.0

"""The method `physical` in the compiled pass: its kernels in the order of estimation.physical.Physical."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from station.conventions import TICK_HZ
from station.estimation import tick
from station.estimation.physical_method import SLACK_S, UPDATE_TICKS
from station.model import physical_fit, physical_posterior
from station.model import physical_signals as ps
from station.model.physical_columns import CHANNELS, Segment
from station.model.physical_constants import Constants as Profile
from station.numerics import spectra

Array = NDArray[np.float64]

_DT = 1.0 / TICK_HZ


class Constants(NamedTuple):
    """What the method takes of an aircraft and a card."""

    profile: Profile
    noise: float
    """Of the vane, behind the body's upwash, rad2."""
    segment: float
    """Ticks after which the transform begins anew."""
    warm_up: float
    """Seconds before the transform opens."""
    step: float
    """Between the lines, Hz."""
    omega: Array
    """Of the lines, rad/s."""
    derivative: Array
    """What a central difference loses of each line."""
    transform: spectra.Design


class Memory(NamedTuple):
    """What the method carries from tick to tick, changed in place."""

    transform: spectra.State
    flown: Array
    """By places BEGAN to SOLVED."""
    past: physical_posterior.Sums
    row: Array
    found: physical_posterior.Found


BEGAN, SPEEDS, WIND_SD, SOLVED = range(4)
"""Of Memory.flown: time of the first sample, s; sum of the inertial speed, m/s; standard error of the mean wind when
the segment began, m/s; whether the last update was solved."""


@njit(cache=True, error_model="numpy")
def begin(c: Constants) -> Memory:
    """At the start of a flight."""
    return Memory(
        spectra.begin(c.transform, CHANNELS),
        np.zeros(4),
        physical_posterior.no_sums(),
        np.zeros(CHANNELS),
        physical_posterior.nothing_found(c.omega.shape[0]),
    )


@njit(cache=True, error_model="numpy")
def add(c: Constants, m: Memory, s: tick.State, made: Array, t: float, density: float, remaining: int) -> None:
    """One sample and, where an update is due that a segment's end or the flight's, `remaining` ticks on, needs, the
    estimate.

    `s`: the live filters now; `made`: what equation_error.sides gave; `density`: of the air, kg/m3.
    """
    m.row[: ps.SIGNALS] = s.signals.signals[0]
    m.row[ps.SIGNALS :] = made[:4]
    if m.transform.samples[spectra.FILTERED] == 0.0:
        m.flown[BEGAN] = t
    is_open = t >= c.warm_up and m.flown[BEGAN] <= t - c.warm_up + SLACK_S
    spectra.step(c.transform, m.transform, m.row, is_open)
    samples = m.transform.samples[spectra.TRANSFORMED]
    if samples == 0.0:
        return
    if samples == 1.0:
        m.flown[WIND_SD] = s.wind_sd
    m.flown[SPEEDS] += s.inertial.flow.speed
    close = samples >= c.segment
    if not close and (samples % UPDATE_TICKS != 0.0 or remaining >= UPDATE_TICKS):
        return
    speed = m.flown[SPEEDS] / samples
    segment = Segment(
        m.transform.spectrum,
        c.omega,
        c.derivative,
        samples * _DT * c.step,
        samples * c.noise,
        speed,
        density,
        m.flown[WIND_SD] / speed,
    )
    m.flown[SOLVED] = 1.0 if physical_fit.fit(segment, c.profile, m.past, close, m.found) else 0.0
    if close:
        spectra.clear(m.transform)
        m.flown[SPEEDS] = 0.0

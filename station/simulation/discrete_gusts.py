"""Discrete gusts, 1 - cos over the way flown (MIL-F-8785C 3.7.1.3, CS 25.341), laid over the turbulence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.profile import DiscreteGust
from station.simulation.gusts import ALONG, SIDEWAYS, STEP, UP, Laid

Array = NDArray[np.float64]

COMPONENTS: Final[Mapping[str, int]] = {"along": ALONG, "side": SIDEWAYS, "up": UP}


def shape(gust: DiscreteGust, speed: float, after: float = 0.0) -> tuple[int, Array]:
    """Index of its first point in a field, and the gust from there on, m/s, until `after` m behind its end; `speed`: at
    which the flight gets there."""
    place = speed * gust.start
    first = math.floor(place / STEP)
    points = math.ceil((2.0 * gust.length + after) / STEP) + 2
    inside = np.clip((first + np.arange(points)) * STEP - place, 0.0, 2.0 * gust.length)
    return first, 0.5 * gust.peak * (1.0 - np.cos(np.pi * inside / gust.length))


def on_a_line(gusts: Sequence[DiscreteGust], speed: float) -> tuple[Laid, ...]:
    """For u_g, v_g and w_g on the way of the CG."""
    made = []
    for gust in gusts:
        first, values = shape(gust, speed)
        columns = np.zeros((len(values), 3))
        columns[:, COMPONENTS[gust.component]] = values
        made.append(Laid(first, columns))
    return tuple(made)

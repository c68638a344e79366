"""Test inputs: what the pilot adds to the trimmed surfaces.

Multisines that begin together and last equally long are one design: they share the harmonics of their bands out among
them, so that they are orthogonal over their duration whatever surfaces they move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from station.profile import Doublet, Manoeuvre, Multisine, Pulse, Sweep, ThreeTwoOneOne
from station.simulation.multisine import Wave, harmonics_between, interleaved, wave

_EDGE = 1e-9
"""Seconds by which an edge may miss its sample and still fall on it."""


def elevator_input(manoeuvres: Sequence[Manoeuvre], time: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the manoeuvres add to the trimmed elevator at times of flight (s), rad. See `surface_input`."""
    return surface_input(manoeuvres, time, "elevator")


def surface_input(manoeuvres: Sequence[Manoeuvre], time: NDArray[np.float64], surface: str) -> NDArray[np.float64]:
    """What the manoeuvres add to a trimmed surface at times of flight (s), rad. Inputs that overlap add up; one
    repeated before its end starts anew.

    A positive amplitude moves the surface to its positive side first. Raises ProfileError for a multisine
    that has no harmonic to itself in its band.
    """
    total = np.zeros_like(time)
    for m in manoeuvres:
        if m.surface != surface:
            continue
        since = time - m.start + _EDGE
        if m.repeat is not None:
            since = np.where(since >= 0, np.mod(since, m.repeat), since)
        active = np.flatnonzero((since >= 0) & (since < duration(m)))
        if len(active):
            total[active] += m.amplitude * _shape(m, since[active] - _EDGE, manoeuvres)
    return total


def duration(m: Manoeuvre) -> float:
    """How long one run of the input lasts, s."""
    match m:
        case Doublet():
            return 2 * m.width
        case ThreeTwoOneOne():
            return 7 * m.unit
        case Pulse():
            return m.width
        case Multisine() | Sweep():
            return m.duration


def wave_of(m: Multisine, manoeuvres: Sequence[Manoeuvre]) -> Wave:
    """A multisine's harmonics and phases, among the `manoeuvres` that it is one of."""
    together = [
        x
        for x in manoeuvres
        if isinstance(x, Multisine) and (x.start, x.duration, x.repeat) == (m.start, m.duration, m.repeat)
    ]
    wanted = [harmonics_between(x.duration, x.low, x.high) for x in together]
    return wave(next(own for x, own in zip(together, interleaved(wanted), strict=True) if x is m))


def _shape(m: Manoeuvre, t: NDArray[np.float64], manoeuvres: Sequence[Manoeuvre]) -> NDArray[np.float64]:
    """The input for amplitude 1 at times since its start, among the `manoeuvres` that it is one of."""
    match m:
        case Doublet():
            return np.where(t + _EDGE < m.width, 1.0, -1.0)
        case ThreeTwoOneOne():
            edges = np.array([3.0, 5.0, 6.0]) * m.unit
            return np.where(np.searchsorted(edges, t + _EDGE, side="right") % 2 == 0, 1.0, -1.0)
        case Pulse():
            return np.ones_like(t)
        case Multisine():
            return wave_of(m, manoeuvres).at(t, m.duration)
        case Sweep():
            rate = (m.high - m.low) / m.duration
            swept: NDArray[np.float64] = np.sin(2 * math.pi * (m.low * t + 0.5 * rate * t**2))
            return swept

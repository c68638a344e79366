"""Slopes by finite differences: of residual spectra, and of the noise's way into them, for many moved aircraft."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.air_data import Unseen
from station.diagnosis.candidate import Slopes, State
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.series_spectra import Spectra
from station.diagnosis.stacked import stacked, stacks
from station.profile import Aircraft

Array = NDArray[np.float64]
T = TypeVar("T", np.float64, np.complex128)


@dataclass(frozen=True, slots=True)
class Move:
    """One parameter moved."""

    aircraft: Aircraft
    step: float
    """How far, in the parameter's unit."""
    of_noise: bool = True
    """Whether the noise's way into the residuals depends on it."""


@dataclass(frozen=True, slots=True)
class _Pass:
    """Moves that are made at once: the first row of a stack is the aircraft not moved; of one alone there is none."""

    places: list[int]
    series: Aircraft
    noisy: list[int]
    noise: Aircraft | None
    """For signals with an axis more: the sensors', one moved after the other."""


class Differences:
    """Slopes at `here`, from aircraft that are moved by one parameter each; of a move that is None they are 0."""

    def __init__(self, here: Aircraft, moves: Sequence[Move | None]) -> None:
        self.moves = moves
        moved = {i: m for i, m in enumerate(moves) if m}
        at = list(moved)
        self._passes = []
        for group in stacks([moved[i].aircraft for i in at], here):
            places = [at[j] for j in group]
            noisy = [i for i in places if moved[i].of_noise]
            self._passes.append(
                _Pass(places, self._stack(here, places, 1), noisy, self._stack(here, noisy, 2) if noisy else None)
            )

    def _stack(self, here: Aircraft, places: Sequence[int], axes: int) -> Aircraft:
        rows = [m.aircraft for i in places if (m := self.moves[i])]
        return rows[0] if len(rows) == 1 else stacked([here, *rows], axes)

    def of(self, m: Manoeuvre, s: State, k: int, unseen: Unseen) -> Slopes:
        """Per unit of each parameter, of manoeuvre `k` of a state. What answers the gusts that nothing measures stays:
        the flight has the answer of the aircraft that flew, and no candidate's slopes change that."""
        z, r, count = s.spectra[k], s.responses[k][m.grouped.pick], len(self.moves)
        bins = np.zeros((count, *z.bins.shape), dtype=complex)
        steady = np.zeros((count, len(z.steady)))
        response = np.zeros((count, *r.shape), dtype=complex)
        for p in self._passes:
            there = m.differences(p.series, unseen)
            moved = there.minus(z) if len(p.places) == 1 else _of_rows(there)
            bins[p.places], steady[p.places] = moved.bins, moved.steady
            if p.noise is not None:
                shown = m.responses(p.noise, m.grouped.pick, s.flown)
                response[p.noisy] = shown - r if len(p.noisy) == 1 else _changes(shown, r.ndim)
        steps = np.array([m.step if m else 1.0 for m in self.moves])
        return Slopes(bins / steps[:, None, None], steady / steps[:, None], response / steps[:, None, None, None])


def unseen_differences(m: Manoeuvre, aircraft: Aircraft, here: Unseen, steps: Array) -> Spectra:
    """Changes (k, ...) of the spectra, by `steps` (k,) of one field of Unseen each, the first k of them."""
    rows = np.tile(np.array(here), (len(steps) + 1, 1))
    rows[np.arange(1, len(rows)), np.arange(len(steps))] += steps
    return _of_rows(m.differences(aircraft, Unseen(*rows.T[:, :, None])))


def _of_rows(there: Spectra) -> Spectra:
    return Spectra(_changes(there.bins, 2), _changes(there.steady, 1))


def _changes(rows: NDArray[T], own: int) -> NDArray[T]:
    """From the first row to each other, of `own` axes. What shows in nothing judged leaves one row without an axis for
    rows: no change."""
    return rows[1:] - rows[0] if rows.ndim > own else 0 * rows

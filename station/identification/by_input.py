"""How far gusts mislead least squares, as the pilot's input shows it.

What moves the aircraft beside its surfaces, a gust that the vane does not show at its time or one that differs along
the span, moves the regressors too: they answer it, and least squares take the answer for the derivative. In roll that
leaves a third of Cl_p in turbulence, with a small residual error. The surfaces' own history is no answer to the gusts
but for feedback, so that regressors projected on it give estimates without that (instrumental variables): how far these
are says how wrong the others may be. Source: Söderström and Stoica 1989, System identification, chapter 8.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz
from scipy.signal import butter, correlate, sosfiltfilt

from station.conventions import LATERAL
from station.estimation.flight_record import FlightRecord
from station.estimation.method_table import METHODS
from station.estimation.results import Axes, Equation, MethodResult, airframe_errors, equations, excited, with_errors_of
from station.numerics.regression import NotIdentifiable, least_squares

Array = NDArray[np.float64]

SURFACES: Final = {"de": "elevator", "da": "aileron", "dr": "rudder"}
HISTORY_S: Final = 3.0
"""Of a surface that the motion is projected on: a short period, or a Dutch roll."""
STEP_S: Final = 0.1
"""Between its values: a tenth of the fastest motion's period."""
ROUNDING: Final = 1e-12
"""Share of the largest singular value."""
ROWS: Final = 4
"""Rows for each of these values, at least."""
FLOWN_HZ: Final = (0.1, 2.5)
"""Below, trim and drift rule; above, no rigid aircraft follows its surfaces."""
MOSTLY: Final = 0.5
"""Share of a motion that may be the gusts'. Flights with inputs leave 0.01 (calm) to 0.3 (10 ft/s), those that
a wing leveller flies alone 0.5 to 0.8."""


class Shown(NamedTuple):
    """Of one derivative."""

    value: float
    """By the surfaces' history, and its standard error by coloured residuals,"""
    error: float
    apart: float
    """and least squares less that."""


def by_input(record: FlightRecord, axes: Axes, *, longitudinal: bool) -> dict[str, Shown]:
    """Each derivative of the lateral equations, and where asked for of the `longitudinal` ones."""
    found: dict[str, Shown] = {}
    for equation in equations(record, axes):
        if longitudinal or equation.parameters[0] in LATERAL:
            try:
                found |= _projected(record, equation)
            except (NotIdentifiable, np.linalg.LinAlgError):
                continue
    return found


def _projected(record: FlightRecord, equation: Equation) -> dict[str, Shown]:
    x, z = equation.regressors, equation.measured
    good = record.usable & np.isfinite(x).all(axis=1) & np.isfinite(z)
    history = input_history(record, equation, good)
    if history is None:
        return {}
    regressors = np.column_stack([x[good] - x[good].mean(axis=0), np.ones(good.sum())])
    value, error = instrumented(regressors, z[good], history)
    apart = least_squares(regressors, z[good]).estimate - value
    columns = (value.tolist(), error.tolist(), apart.tolist())
    return {name: Shown(*row) for name, row in zip(equation.parameters, zip(*columns, strict=True), strict=False)}


def input_history(
    record: FlightRecord, equation: Equation, good: NDArray[np.bool_], ahead_s: float = 0.0
) -> Array | None:
    """An orthonormal basis (rows, columns) of a constant and of the equation's surfaces that moved, HISTORY_S back and
    `ahead_s` on, in the rows that are `good`; None where they are too few or none moved."""
    moved = [SURFACES[mark] for mark in SURFACES if f"{equation.name}_{mark}" in equation.parameters]
    moved = [name for name in moved if excited(record, (name,))]
    late = np.arange(-ahead_s, HISTORY_S, max(STEP_S, record.dt))
    if not moved or good.sum() < ROWS * len(late) * len(moved):
        return None
    whole = {name: np.interp(record.t_s, record.t_s[good], record.motion[name][good]) for name in moved}
    history = np.column_stack([np.interp(record.t_s - s, record.t_s, u) for u in whole.values() for s in late])[good]
    history = np.column_stack([history - history.mean(axis=0), np.ones(good.sum())])
    return spanned(history)


def spanned(history: Array) -> Array:
    """An orthonormal basis (rows, at most columns) of what the columns span. Of inputs in a band the values in between
    say little that is new: rounding is left out."""
    basis, size, _ = np.linalg.svd(history, full_matrices=False)
    return np.asarray(basis[:, size > size[0] * ROUNDING])


def is_flown(record: FlightRecord, surfaces: Collection[str], answer: str) -> bool:
    """Whether what `surfaces` did before explains most of a signal, and more than what they did after it: else the
    signal answers gusts, and so do the surfaces, by feedback. Of the motion in FLOWN_HZ."""
    good = record.usable & np.isfinite(record.motion[answer])
    moved = [name for name in surfaces if record.has(name) and excited(record, (name,))]
    late = np.arange(0.0, HISTORY_S, max(STEP_S, record.dt))
    if not moved or good.sum() < ROWS * len(late) * len(moved):
        return False
    low, high = FLOWN_HZ
    # Of slow records up to four fifths of what they can show: a filter has to end below that.
    band = butter(2, (low, min(high, 0.8 * 0.5 / record.dt)), "bandpass", fs=1 / record.dt, output="sos")
    times = record.t_s[good]

    def shown(name: str, later_s: float) -> Array:
        x = np.interp(times - later_s, times, record.motion[name][good])
        return np.asarray(sosfiltfilt(band, x - x.mean()))

    y = shown(answer, 0.0)
    before, after = (np.column_stack([shown(n, way * s) for n in moved for s in late]) for way in (1.0, -1.0))
    left = [float(np.var(y - x @ np.linalg.lstsq(x, y, rcond=ROUNDING)[0]) / np.var(y)) for x in (before, after)]
    return left[0] < min(MOSTLY, left[1])


def instrumented(regressors: Array, measured: Array, history: Array) -> tuple[Array, Array]:
    """Estimates by instrumental variables, `history` (rows, columns, orthonormal), of a coefficient `measured` (rows,)
    on `regressors` (rows, m), and their standard errors by coloured residuals."""
    projected = history @ (history.T @ regressors)
    inverse = np.linalg.inv(projected.T @ projected)
    value = inverse @ projected.T @ measured
    rest = measured - regressors @ value
    alike = correlate(rest, rest)[len(rest) - 1 :] / len(rest)
    scores = projected.T @ matmul_toeplitz(alike, projected, check_finite=False)
    return value, np.sqrt(np.maximum(np.diag(inverse @ scores @ inverse), 0.0))


def misled(
    results: Mapping[str, MethodResult], shown: Mapping[str, Shown], record: FlightRecord, but: Collection[str] = ()
) -> dict[str, MethodResult]:
    """Results whose errors, but for those of the methods `but`, are no smaller than what the input shows; what mass and
    inertia add is in both. Lateral derivatives that are by the input themselves need no more."""
    made = {}
    for name, result in results.items():
        least: dict[str, float] = {}
        every = (*result.parameters, *result.quasi_steady)
        for p, share in zip(every, airframe_errors(record, every), strict=True):
            of = None if METHODS[name].by_input and p.name in LATERAL else shown.get(p.name)
            if of is not None and math.isfinite(p.value):
                error = math.hypot(p.value - of.value, of.error, of.apart, share)
                least |= {p.name: error} if error > p.sd else {}
        made[name] = result if name in but else with_errors_of(result, least, record, max)
    return made

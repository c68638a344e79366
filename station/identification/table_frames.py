"""A table's rows as frames at 50 Hz, as the live estimator takes them: those of a slower record interpolated."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from station.conventions import ANGLES_THAT_WRAP, FRESH_AGE_S, SIGNALS, TICK_HZ, TICK_NS
from station.log import Table
from station.rows import Frame, Quality

Array = NDArray[np.float64]

LEAST_ROWS: Final = 2
BRIDGED_S: Final = 0.1
"""Rows further apart than this are not interpolated between."""
ON_GRID: Final = 1e-3
"""Ticks by which a row's time may differ from the grid's."""
HOLD_S: Final = 3.0
"""Without flight before the interval, a steady trim of this length precedes it: filters and delay lines settle."""
TRIM_ROWS: Final = 5
"""That the trim is the mean of."""
SLOW_S: Final = 1.25 / TICK_HZ
"""Step of a record from which on its rows are interpolated by splines: 0.5 % is lost at a fifth of its rate."""
LONGEST_STEPS: Final = 2.5
"""Rows of such a record further apart than this many of its steps are not interpolated between."""
LEAST_KNOTS: Final = 4
MEASURED_SHARE: Final = 0.9
"""Of a signal's values must be measured at their rows' own time; else it is held between slower samples, and stays."""
RATES: Final = ("p", "q", "r", "pdot", "qdot", "rdot")


def frames(table: Table) -> list[Frame]:
    """The table's rows as frames on the 50 Hz grid; off-grid rows are interpolated, long gaps stay missing."""
    if len(table.t_s) < LEAST_ROWS:
        return []
    t = table.t_s
    k = np.round(t * TICK_HZ).astype(np.int64)
    on_grid = bool(np.all(np.abs(t * TICK_HZ - k - (t[0] * TICK_HZ - k[0])) < ON_GRID) and np.all(np.diff(k) > 0))
    slow = is_slow(t)
    if on_grid and not slow:
        grid, number = t, k
    else:
        number = np.arange(int(np.ceil(t[0] * TICK_HZ)), int(np.floor(t[-1] * TICK_HZ)) + 1)
        grid = number / TICK_HZ
    values = np.full((len(grid), len(SIGNALS)), np.nan)
    ages = np.full(values.shape, np.nan)
    marks = np.full(values.shape, int(Quality.MISSING))
    for i, name in enumerate(SIGNALS):
        if name not in table.columns:
            continue
        if slow:
            values[:, i], ages[:, i], held = _between_slow_rows(table, name, grid)
            mark = Quality.HELD if held else Quality.FRESH
        else:
            values[:, i] = table.columns[name] if on_grid else _between_rows(t, table.columns[name], grid)
            ages[:, i] = np.where(np.isnan(values[:, i]), np.nan, 0.0)
            mark = Quality.FRESH
        marks[:, i] = np.where(np.isnan(values[:, i]), int(Quality.MISSING), int(mark))
        if on_grid and not slow and name in table.quality:
            marks[:, i] = table.quality[name]
            ages[:, i] = np.where(np.isnan(values[:, i]), np.nan, table.age_s(name))
    return [
        Frame(table.t0_ns + round(t_s * 1e9), n, v, a, m)
        for t_s, n, v, a, m in zip(
            grid.tolist(),
            number.tolist(),
            map(tuple, values.tolist()),
            map(tuple, ages.tolist()),
            map(tuple, marks.tolist()),
            strict=True,
        )
    ]


def is_slow(t_s: Array) -> bool:
    """Whether rows come more slowly than ticks."""
    return len(t_s) > 1 and float(np.median(np.diff(t_s))) > SLOW_S


def _between_rows(t: Array, column: Array, grid: Array) -> Array:
    """Of a record faster than the ticks: straight between rows."""
    after = np.clip(np.searchsorted(t, grid, "left"), 1, len(t) - 1)
    far = t[after] - t[after - 1] > BRIDGED_S
    return np.where(far, np.nan, np.interp(grid, t, column))


def _between_slow_rows(table: Table, name: str, grid: Array) -> tuple[Array, Array, bool]:
    """Values and ages of a signal at `grid`, and whether it is held: a spline through the values measured at their
    rows' own time, which keeps all signals in step; one that is held between slower samples stays so."""
    t, column = table.t_s, table.columns[name]
    known = np.isfinite(column)
    if name in table.quality:
        known &= table.quality[name] < Quality.SUSPECT
    own = known & (table.age_s(name) <= FRESH_AGE_S)
    made, age = np.full(len(grid), np.nan), np.full(len(grid), np.nan)
    if own.sum() < LEAST_KNOTS or own.sum() < MEASURED_SHARE * known.sum():
        rows = np.flatnonzero(known)
        last = np.searchsorted(t[rows], grid, "right") - 1
        there = last >= 0
        row = rows[last[there]]
        made[there], age[there] = column[row], table.age_s(name)[row] + grid[there] - t[row]
        return made, age, True
    knots, values = t[own], column[own]
    if name in ANGLES_THAT_WRAP:
        values = np.unwrap(values)
    breaks = np.flatnonzero(np.diff(knots) > LONGEST_STEPS * float(np.median(np.diff(t)))) + 1
    for some, at in zip(np.split(values, breaks), np.split(knots, breaks), strict=True):
        if len(at) >= LEAST_KNOTS:
            inside = (grid >= at[0]) & (grid <= at[-1])
            made[inside] = CubicSpline(at, some)(grid[inside])
    if name in ANGLES_THAT_WRAP:
        made = np.remainder(made + np.pi, 2 * np.pi) - np.pi
    return made, np.where(np.isnan(made), np.nan, 0.0), False


def trim_before(table: Table) -> list[Frame]:
    """A steady trim of HOLD_S before the table's first row: the mean of its first 0.1 s, without rates."""
    rows = frames(table)
    if not rows:
        return []
    values = np.array([f.values for f in rows[:TRIM_ROWS]])
    with np.errstate(invalid="ignore"):
        count = np.isfinite(values).sum(axis=0)
        mean = np.where(count > 0, np.nansum(values, axis=0) / np.maximum(count, 1), np.nan)
    for i, name in enumerate(SIGNALS):
        if name in RATES and count[i]:
            mean[i] = 0.0
    ages = np.where(np.isnan(mean), np.nan, 0.0)
    marks = np.where(np.isnan(mean), int(Quality.MISSING), int(Quality.FRESH))
    row = tuple(mean.tolist()), tuple(ages.tolist()), tuple(marks.tolist())
    first = rows[0]
    ticks = round(HOLD_S * TICK_HZ)
    return [Frame(first.t_ns - n * TICK_NS, first.k - n, *row) for n in range(ticks, 0, -1)]

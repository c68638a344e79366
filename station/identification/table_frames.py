"""A table's rows as frames at 50 Hz, as the live estimator takes them."""

from __future__ import annotations

from typing import Final

import numpy as np

from station.conventions import SIGNALS, TICK_HZ, TICK_NS
from station.log import Table
from station.rows import Frame, Quality

LEAST_ROWS: Final = 2
BRIDGED_S: Final = 0.1
"""Rows further apart than this are not interpolated between."""
ON_GRID: Final = 1e-3
"""Ticks by which a row's time may differ from the grid's."""
HOLD_S: Final = 3.0
"""Without flight before the interval, a steady trim of this length precedes it: filters and delay lines settle."""
TRIM_ROWS: Final = 5
"""That the trim is the mean of."""
RATES: Final = ("p", "q", "r", "pdot", "qdot", "rdot")


def frames(table: Table) -> list[Frame]:
    """The table's rows as frames on the 50 Hz grid; off-grid rows are interpolated, long gaps stay missing."""
    if len(table.t_s) < LEAST_ROWS:
        return []
    t = table.t_s
    k = np.round(t * TICK_HZ).astype(np.int64)
    on_grid = bool(np.all(np.abs(t * TICK_HZ - k - (t[0] * TICK_HZ - k[0])) < ON_GRID) and np.all(np.diff(k) > 0))
    if on_grid:
        grid, number = t, k
    else:
        number = np.arange(int(np.ceil(t[0] * TICK_HZ)), int(np.floor(t[-1] * TICK_HZ)) + 1)
        grid = number / TICK_HZ
        after = np.clip(np.searchsorted(t, grid, "left"), 1, len(t) - 1)
        far = t[after] - t[after - 1] > BRIDGED_S
    values = np.full((len(grid), len(SIGNALS)), np.nan)
    ages = np.full(values.shape, np.nan)
    marks = np.full(values.shape, int(Quality.MISSING))
    for i, name in enumerate(SIGNALS):
        if name not in table.columns:
            continue
        column = table.columns[name]
        x = column if on_grid else np.where(far, np.nan, np.interp(grid, t, column))
        lost = np.isnan(x)
        values[:, i] = x
        marks[:, i] = np.where(lost, int(Quality.MISSING), int(Quality.FRESH))
        ages[:, i] = np.where(lost, np.nan, 0.0)
        if on_grid and name in table.quality:
            marks[:, i] = table.quality[name]
            ages[:, i] = np.where(lost, np.nan, table.age_s(name))
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

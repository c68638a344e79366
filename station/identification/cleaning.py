"""Values that were never measured taken out of a recording: rows that a recorder repeated, and lone spikes."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from station.log import Table
from station.numerics.default_noise import DEFAULT_NOISE

REPEATING: Final = 0.6
"""Share of rows that repeat the value before, above which a noisy signal is held between its samples."""
MOVING: Final = ("alpha_vane", "q", "az")
"""Signals that noise and motion change from row to row."""
AT_EVERY_ROW: Final = ("alpha_vane", "beta_vane", "elevator", "aileron", "rudder", "q", "theta", "airspeed", "ax", "az")
"""Signals sampled as fast as rows come, in which spikes are sought."""
FROZEN_S: Final = 0.15
JUMP: Final = 5.0
"""Over the usual step from row to row: what two of MOVING do when a recorder that had stopped resumes."""
WINDOW: Final = 5
"""Rows around a value that it is compared with."""
USUAL_SHARE: Final = 0.99
SPIKE: Final = 20.0
"""Over what USUAL_SHARE of the values differ from the median of their window."""
SPIKE_NOISE: Final = 10.0
"""And over the sensor's noise,"""
SPIKE_SPREAD: Final = 4.0
"""and over the spread within the window."""
SLOWEST_S: Final = 0.04
LEAST_ROWS: Final = 100
LEAST_FROZEN_ROWS: Final = 3


def cleaned(table: Table) -> tuple[Table, list[str]]:
    """The table without what was not measured, `thawed` and `despiked`, and the remarks on what was removed."""
    table, frozen = thawed(table)
    table, lone = despiked(table)
    return table, frozen + lone


def thawed(table: Table) -> tuple[Table, list[str]]:
    """The table with rows as missing that a recorder repeated while nothing new arrived, and the remark on it.

    Noise moves every signal, so rows identical in all of MOVING for FROZEN_S that end with a jump were not measured; a
    constructed trim without noise ends without one.
    """
    if len(table.t_s) < LEAST_FROZEN_ROWS or not all(name in table.columns for name in MOVING):
        return table, []
    steps = np.abs(np.diff(np.column_stack([table.columns[name] for name in MOVING]), axis=0))
    same = (steps == 0).all(axis=1)
    if same.mean() > REPEATING or same.all():
        return table, []
    usual = np.nanmedian(steps[~same], axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8))).reshape(-1, 2)
    lost = np.zeros(len(table.t_s), dtype=bool)
    for first, last in edges.tolist():
        jumps = last < len(steps) and np.count_nonzero(steps[last] > JUMP * usual) > 1
        if jumps and table.t_s[last] - table.t_s[first] >= FROZEN_S:
            lost[first + 1 : last + 1] = True
    if not lost.any():
        return table, []
    columns = {name: np.where(lost, np.nan, column) for name, column in table.columns.items()}
    at = float(table.t_s[np.argmax(lost)])
    seconds = float(lost.sum() * np.median(np.diff(table.t_s)))
    remark = f"{seconds:.2f} s of rows repeat the row before, first at {at:.2f} s: the recorder had stopped, excluded"
    return replace(table, columns=columns), [remark]


def despiked(table: Table) -> tuple[Table, list[str]]:
    """The table with lone values, one or two rows long, as missing that stand out from the rows around them as no
    motion does (a lost bit, a loose contact), and the remarks on them. At 25 Hz or faster; slower, a short pulse may be
    real."""
    if len(table.t_s) < LEAST_ROWS or not np.median(np.diff(table.t_s)) <= SLOWEST_S:
        return table, []
    half = WINDOW // 2
    columns, remarks = dict(table.columns), []
    for name, column in table.columns.items():
        if name not in AT_EVERY_ROW:
            continue
        around = np.lib.stride_tricks.sliding_window_view(column, WINDOW)
        middle = np.median(around, axis=1)
        deviation = np.abs(column[half:-half] - middle)
        known = np.isfinite(deviation)
        if not known.any():
            continue
        # Of the five, the three nearest to their median.
        spread = np.sort(np.abs(around - middle[:, None]), axis=1)[:, half]
        usual = float(np.quantile(deviation[known], USUAL_SHARE))
        threshold = np.maximum(np.maximum(SPIKE * usual, SPIKE_NOISE * DEFAULT_NOISE[name]), SPIKE_SPREAD * spread)
        lone = known & (deviation > threshold)
        if not lone.any():
            continue
        rows = np.flatnonzero(lone) + half
        columns[name] = column.copy()
        columns[name][rows] = np.nan
        values = "1 value is a spike" if len(rows) == 1 else f"{len(rows)} values are spikes"
        remarks.append(f"{name}: {values}, first at {table.t_s[rows[0]]:.2f} s: excluded")
    return (replace(table, columns=columns), remarks) if remarks else (table, [])

"""What a recording's columns say of themselves before anything is estimated."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from station.conventions import SIGNALS
from station.estimation.flight_record import NOISE
from station.log import Table

REPEATING: Final = 0.6
"""Share of rows that repeat the value before, above which a signal that noise moves is held between its samples."""
MOVING: Final = ("alpha_vane", "q", "az")
FROZEN_S: Final = 0.15
JUMP: Final = 5.0
"""Over the usual step from row to row: what two of MOVING do when a recorder that had stopped goes on."""

STANDS_OUT: Final = 20.0
"""Over what 99 of 100 values lie off the median of the five around them."""
SLOWEST_S: Final = 0.04
LEAST_ROWS: Final = 100


def cleaned(table: Table) -> tuple[Table, list[str]]:
    """The table without what was not measured, `thawed` and `despiked`, and what to say of it."""
    table, frozen = thawed(table)
    table, lone = despiked(table)
    return table, frozen + lone


def thawed(table: Table) -> tuple[Table, list[str]]:
    """The table without rows that a recorder repeated while nothing new came, and what to say of it.

    Noise moves every signal, so rows alike in all of MOVING for FROZEN_S that end with a jump were never measured; a
    made-up trim without noise ends without one.
    """
    if len(table.t_s) < 3 or not all(name in table.columns for name in MOVING):
        return table, []
    steps = np.abs(np.diff(np.column_stack([table.columns[name] for name in MOVING]), axis=0))
    same = (steps == 0).all(axis=1)
    if same.mean() > REPEATING or same.all():
        return table, []
    usual = np.nanmedian(steps[~same], axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8))).reshape(-1, 2)
    lost = np.zeros(len(table.t_s), dtype=bool)
    for first, last in edges.tolist():
        jumps = last < len(steps) and np.count_nonzero(steps[last] > JUMP * usual) >= 2
        if jumps and table.t_s[last] - table.t_s[first] >= FROZEN_S:
            lost[first + 1 : last + 1] = True
    if not lost.any():
        return table, []
    columns = {name: np.where(lost, np.nan, column) for name, column in table.columns.items()}
    at = float(table.t_s[np.argmax(lost)])
    seconds = float(lost.sum() * np.median(np.diff(table.t_s)))
    told = f"{seconds:.2f} s of rows that repeat the last one, first at {at:.2f} s: left out, nothing was recorded then"
    return replace(table, columns=columns), [told]


def despiked(table: Table) -> tuple[Table, list[str]]:
    """The table without lone values, one or two rows long, that stand out from the rows around them as no motion does:
    what a lost bit or a loose contact makes. At 25 Hz or faster; slower, a short pulse may be real."""
    if len(table.t_s) < LEAST_ROWS or not np.median(np.diff(table.t_s)) <= SLOWEST_S:
        return table, []
    columns, told = dict(table.columns), []
    for name, column in table.columns.items():
        if name not in NOISE:
            continue
        around = np.lib.stride_tricks.sliding_window_view(column, 5)
        middle = np.median(around, axis=1)
        off = np.abs(column[2:-2] - middle)
        known = np.isfinite(off)
        if not known.any():
            continue
        # Of the five, the three nearest to their median.
        spread = np.sort(np.abs(around - middle[:, None]), axis=1)[:, 2]
        usual = float(np.quantile(off[known], 0.99))
        lone = known & (off > STANDS_OUT * usual) & (off > 10 * NOISE[name]) & (off > 4 * spread)
        if not lone.any():
            continue
        rows = np.flatnonzero(lone) + 2
        columns[name] = column.copy()
        columns[name][rows] = np.nan
        values = "1 value" if len(rows) == 1 else f"{len(rows)} values"
        told.append(f"{name}: {values} out of line with the rows around, first at {table.t_s[rows[0]]:.2f} s, left out")
    return (replace(table, columns=columns), told) if told else (table, [])


def about_columns(table: Table) -> list[str]:
    """Signals beyond what can be true, which nothing is estimated from, and those held between slower samples."""
    told = []
    for name, column in table.columns.items():
        known = column[np.isfinite(column)]
        signal = SIGNALS.get(name)
        if signal is None or len(known) < 2:
            continue
        beyond = int(((known < signal.low) | (known > signal.high)).sum())
        if beyond:
            told.append(
                f"{name}: {beyond} of {len(known)} values are not within {signal.low:.4g} to {signal.high:.4g} "
                f"{signal.unit} and left out: is its unit right?"
            )
        same = float((np.diff(known) == 0).mean())
        if name in MOVING and REPEATING < same < 1.0:
            told.append(
                f"{name} repeats its last value in {same:.0%} of the rows: held between slower samples, it is late, "
                "and no estimate allows for that"
            )
    return told

"""A study's printed tables beside what is found here: change from the baseline in per cent, method by method.

    change = 100 (estimate - baseline)/|baseline|

A printed number is one flight's. It is held against the flights' own distribution: mean and standard deviation of one
flight, not of their mean. The simulated flights differ in gusts and noise only: the scatter of the printed baseline's
own points, flown in calm air, counts too, as does the print's rounding. What differs for a known reason says it.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from station.campaign.findings import Rows, chosen
from station.campaign.study import PARAMETERS, PrintedRow, PrintedTable

Array = NDArray[np.float64]

WITHIN: Final = 2.0
"""Standard deviations of one flight within which a printed number is called the same."""
ROUNDED: Final = 0.01 / math.sqrt(12.0)
"""Standard deviation of what rounding to two decimals takes away."""
_WIDTH: Final = 79
_HEAD: Final = 13
_CELL: Final = 11


@dataclass(frozen=True, slots=True)
class Beside:
    """A method at a test point, (6,) each: change in per cent, its standard deviation from flight to flight, what is
    printed, and how many standard deviations that is away; `flights` that gave an estimate."""

    label: str
    change: Array
    scatter: Array
    printed: Array
    away: Array
    flights: int
    says: str

    @property
    def differs(self) -> NDArray[np.bool_]:
        return np.abs(self.away) > WITHIN


def besides(rows: Rows, table: PrintedTable) -> list[Beside]:
    """Every row of a table, then the methods that the study has not. Needs a baseline in the specification."""
    base = _baseline(rows)
    known = rows.plan.campaign.baseline
    assert known is not None
    nothing = np.full(PARAMETERS, math.nan)
    made = []
    for row in table.rows:
        label = row.printed_as if row.printed_as == row.method else f"{row.printed_as} ({row.method})"
        old = np.array(known.estimate)
        change = 100.0 * (np.array(row.estimate) - old) / np.abs(old)
        made.append(_beside(rows, table, row.method, label, base, (change, row)))
    made += [_beside(rows, table, m, m, base, (nothing, None)) for m in table.beside]
    return made


def _beside(
    rows: Rows,
    table: PrintedTable,
    method: str,
    label: str,
    base: Array,
    printed: tuple[Array, PrintedRow | None],
) -> Beside:
    change, row = printed
    factor = np.array(row.factor) if row else np.ones(PARAMETERS)
    found = _estimates(rows, table, method) * factor[:, None]
    here = 100.0 * (found - base[:, None]) / np.abs(base)[:, None]
    flights = int(np.count_nonzero(np.isfinite(found).all(axis=0)))
    mean, scatter = np.full(PARAMETERS, math.nan), np.full(PARAMETERS, math.nan)
    for i, values in enumerate(here):
        known = values[np.isfinite(values)]
        if len(known) > 1:
            mean[i], scatter[i] = known.mean(), known.std(ddof=1)
    expected = np.sqrt(scatter**2 + (100.0 * _of_print(rows) / np.abs(base)) ** 2)
    return Beside(label, mean, scatter, change, (change - mean) / expected, flights, row.says if row else "")


def _estimates(rows: Rows, table: PrintedTable, method: str) -> Array:
    """(6, flights) of the table's case."""
    case = chosen(rows.plan, table.where)[0]
    return np.array([rows.values(p, case.number, method) for p in rows.plan.campaign.parameters])


def _baseline(rows: Rows) -> Array:
    """(6,): the baseline's estimates, mean of its flights."""
    known = rows.plan.campaign.baseline
    assert known is not None
    case = chosen(rows.plan, known.where)[0]
    return np.array([np.nanmean(rows.values(p, case.number, known.method)) for p in rows.plan.campaign.parameters])


def _of_print(rows: Rows) -> Array:
    """(6,): standard deviation of what is printed and not simulated: how a point differs from the others' mean in
    calm air, and rounding."""
    known = rows.plan.campaign.baseline
    assert known is not None
    n = len(known.points)
    between = np.array(known.points).var(axis=0, ddof=1) * (1.0 + 1.0 / n) if n > 1 else np.zeros(PARAMETERS)
    return np.sqrt(between + ROUNDED**2)


def lines(rows: Rows) -> Iterator[str]:
    """Every table as text, 79 columns wide."""
    campaign = rows.plan.campaign
    if campaign.baseline is None:
        return
    old = np.array(campaign.baseline.estimate)
    yield from textwrap.wrap(
        f"Change in % from the baseline: here, mean ± standard deviation of one flight, of {campaign.runs} flights; "
        f"as printed below it, * more than {WITHIN:g} standard deviations away, the scatter of the printed baseline's "
        "points among them.",
        _WIDTH,
    )
    yield "baseline".ljust(_HEAD) + "".join(name.rjust(_CELL) for name in campaign.parameters)
    yield "    here".ljust(_HEAD) + "".join(f"{v:{_CELL}.2f}" for v in _baseline(rows))
    yield "    printed".ljust(_HEAD) + "".join(f"{v:{_CELL}.2f}" for v in old)
    for table in campaign.tables:
        yield ""
        yield table.title
        found = besides(rows, table)
        for one in found:
            yield one.label.ljust(_HEAD) + "".join(
                (f"{m:+.0f} ± {s:.0f}" if math.isfinite(s) else "-").rjust(_CELL)
                for m, s in zip(one.change, one.scatter, strict=True)
            )
            if np.isfinite(one.printed).any():
                marked = zip(one.printed, one.differs, strict=True)
                cells = (f"{v:+.0f}{'*' if d else ' '}".rjust(_CELL - 3) + "   " for v, d in marked)
                yield "    printed".ljust(_HEAD) + "".join(cells).rstrip()
            if one.flights < campaign.runs:
                yield f"    an estimate in {one.flights} of {campaign.runs} flights"
        yield from _in_words(found)
        yield from textwrap.wrap(table.says, _WIDTH)


def _in_words(found: list[Beside]) -> Iterator[str]:
    """How many printed numbers are met, and why others are not."""
    plain = [b for b in found if np.isfinite(b.printed).any() and not b.says]
    met = sum(int(np.count_nonzero(~b.differs)) for b in plain)
    names = ", ".join(b.label for b in plain)
    yield f"{names}: {met} of {PARAMETERS * len(plain)} printed numbers within {WITHIN:g} standard deviations"
    for one in found:
        if one.says:
            met = int(np.count_nonzero(~one.differs))
            yield from textwrap.wrap(
                f"{one.label}: {met} of {PARAMETERS}: {one.says}", _WIDTH, subsequent_indent="    "
            )


def figures(rows: Rows) -> Iterator[tuple[str, Figure]]:
    """A figure a table, as the study's own: every estimate with two standard deviations, the printed one with its bound
    beside, and the baseline."""
    campaign = rows.plan.campaign
    if campaign.baseline is None:
        return
    base = _baseline(rows)
    for number, table in enumerate(campaign.tables, 1):
        figure = Figure(figsize=(11, 6.5), layout="constrained")
        panels = figure.subplots(2, 3).ravel()
        for i, panel in enumerate(panels):
            _panel(panel, rows, table, i, float(base[i]))
            panel.set_title(campaign.parameters[i], fontsize=10)
            panel.set_ylabel("1/rad")
        panels[0].legend(fontsize=7)
        figure.suptitle(f"{table.title}: {campaign.runs} flights\n{campaign.description or campaign.name}", fontsize=10)
        yield f"table_{number}", figure


def _panel(panel: Axes, rows: Rows, table: PrintedTable, i: int, base: float) -> None:
    campaign = rows.plan.campaign
    known = campaign.baseline
    assert known is not None
    panel.axhline(base, color="tab:green", linewidth=1.2, label="baseline here")
    panel.axhline(known.estimate[i], color="tab:green", linewidth=1.0, linestyle=":", label="baseline printed")
    every = [(b.method, b.printed_as, b) for b in table.rows]
    labels = [a if a == m else f"{a} ({m})" for m, a, _ in every] + list(table.beside)
    for at, method in enumerate(table.methods):
        row = table.rows[at] if at < len(table.rows) else None
        found = _estimates(rows, table, method)[i] * (row.factor[i] if row else 1.0)
        found = found[np.isfinite(found)]
        if len(found) > 1:
            word = "here, mean ± 2 sd of a flight" if at == 0 else None
            panel.errorbar(at - 0.12, found.mean(), 2 * found.std(ddof=1), fmt="o", color="tab:blue", markersize=4,
                           label=word)  # fmt: skip
        if row is not None:
            word = "printed, with its 95 % bound" if at == 0 else None
            panel.errorbar(at + 0.12, row.estimate[i], row.bound[i], fmt="D", color="tab:red", markersize=4, label=word)
    panel.set_xticks(range(len(labels)), labels, fontsize=8, rotation=40, ha="right", rotation_mode="anchor")

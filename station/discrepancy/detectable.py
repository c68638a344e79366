"""How large an effect must be to be found: for planning, from the Fisher information of the same likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import from_si
from station.discrepancy.effects import EFFECTS, judged_effects
from station.discrepancy.fit import Problem
from station.discrepancy.reference import Reference
from station.discrepancy.search import FIRST, RIVAL

Array = NDArray[np.float64]

NINE_IN_TEN: Final = 1.2816
"""Normal quantile."""


@dataclass(frozen=True, slots=True)
class Detectable:
    """One effect in one card and air; SI. `named` is the size that also tells it from its nearest rival."""

    id: str
    found: float
    named: float
    rival: str
    correlation: float


def detectable_sizes(references: Sequence[Reference], problem: Problem, gust: float) -> list[Detectable]:
    """Sizes found (and named alone) nine times in ten with these manoeuvres in that gust (m/s), by effect."""
    present = set.intersection(*(set(r.record.signals) for r in references))
    terms = judged_effects(problem.aircraft, present, any(r.setting.gusty for r in references), False)
    base = problem.at({})
    allowed = problem.allowed_columns({}, base)
    columns = [problem.effect_columns(t, {}, base) for t in terms]
    e, a = len(terms), len(allowed[0])
    whole = np.zeros((e + a, e + a))
    for k in range(len(references)):
        stacked = np.concatenate([np.stack([c[k] for c in columns]), allowed[k]])
        whole += (stacked * (problem.counts[k] / (1 + gust**2 * problem.shares[k]))) @ stacked.T
    inner = whole[e:, e:] + np.eye(a)
    information = whole[:e, :e] - whole[:e, e:] @ np.linalg.solve(inner, whole[e:, :e])
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    alike = information / scale[:, None] / scale
    found = (math.sqrt(FIRST) + NINE_IN_TEN) / scale
    apart = math.sqrt(RIVAL) + NINE_IN_TEN
    out = []
    for i, term in enumerate(terms):
        others = np.abs(alike[i]).copy()
        others[i] = -1.0
        j = int(np.argmax(others))
        separate = apart / scale[i] / math.sqrt(max(1 - alike[i, j] ** 2, 1e-9))
        named = max(float(found[i]), float(separate))
        out.append(Detectable(term.id, float(found[i]), named, terms[j].id, float(alike[i, j])))
    return out


def detectable_table(rows: Sequence[tuple[str, Sequence[Detectable]]]) -> str:
    """A table for people: one row an effect, one column a card and air; found, and named alone where that is larger."""
    by_column = {title: {d.id: d for d in sizes} for title, sizes in rows}
    lines = ["| effect | unit | " + " | ".join(by_column) + " |", "|---" * (2 + len(by_column)) + "|"]
    for term in EFFECTS:
        if not any(term.id in sizes for sizes in by_column.values()):
            continue
        cells = []
        for sizes in by_column.values():
            d = sizes.get(term.id)
            if d is None:
                cells.append("–")
                continue
            found, named = from_si(d.found, term.shown), from_si(d.named, term.shown)
            cells.append(f"{found:.2g}" if named < 1.05 * found else f"{found:.2g} ({named:.2g}: {d.rival})")
        lines.append(f"| `{term.id}` | {term.shown} | " + " | ".join(cells) + " |")
    return "\n".join(lines)

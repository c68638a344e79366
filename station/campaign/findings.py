"""What a campaign's rows say: bias, scatter and exceedances of every case, and whether a study's claims hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from station.campaign.spec import TURBULENCE, Case, Plan
from station.campaign.study import Claim, Comparison
from station.conventions import from_si

SURE: Final = 2.0
"""Standard errors by which a difference counts."""
OF_FLIGHTS: Final = 200
"""Exceedances are counted per so many flights, as the study does."""
NEARLY_ALL: Final = 0.95
_MAIN: Final = (0, 3, 4, 5)
"""Parameters that methods are compared by: all but the force by pitch rate and elevator, which weigh little in it."""
_ALIKE: Final = 1.1
"""Ratio of two errors below which neither method is called the better."""
_COLUMNS_KEPT: Final = 12
"""At once in memory: what errors and coverage of six parameters need."""


@dataclass(frozen=True, slots=True)
class Summary:
    """One parameter by one method in one case: errors in per cent of the reference's magnitude, above it positive."""

    case: Case
    flights: int
    bias: float
    scatter: float
    rmse: float
    exceedances: float
    """Flights of OF_FLIGHTS beyond the tolerance, or without an estimate."""
    coverage: float
    """Share of flights within 2 standard deviations."""


class Rows:
    """A campaign's result, read column by column."""

    def __init__(self, plan: Plan, result: Path) -> None:
        self.plan = plan
        self._file = result
        self._columns: dict[str, NDArray[Any]] = {}

    def values(self, column: str, case: int, method: str) -> NDArray[Any]:
        """A column of one case and method, (runs,)."""
        if column not in self._columns:
            if len(self._columns) >= _COLUMNS_KEPT:
                self._columns.pop(next(iter(self._columns)))
            # Not pq.read_table, nor to_numpy: both import pandas, which takes a second.
            read = pq.ParquetFile(self._file).read(columns=[column])[column].cast(pa.float64())
            self._columns[column] = np.concatenate([np.from_dlpack(chunk) for chunk in read.chunks])
        methods, runs = self.plan.campaign.methods, self.plan.campaign.runs
        first = case * runs * len(methods) + methods.index(method)
        return self._columns[column][first : first + runs * len(methods) : len(methods)]

    def summary(self, case: Case, method: str, parameter: str) -> Summary:
        """Statistics of one parameter's errors."""
        off = 100.0 * self.values(f"{parameter}_error", case.number, method)
        found = off[np.isfinite(off)]
        n = len(off)
        nothing = len(found) < 2
        beyond = np.count_nonzero(~(np.abs(off) <= 100.0 * self.plan.campaign.tolerance))
        return Summary(
            case,
            n,
            math.nan if nothing else float(found.mean()),
            math.nan if nothing else float(found.std(ddof=1)),
            math.nan if nothing else float(np.sqrt((found**2).mean())),
            beyond * OF_FLIGHTS / n,
            float(np.mean(self.values(f"{parameter}_covered", case.number, method))),
        )


def chosen(plan: Plan, levels: dict[str, Any]) -> list[Case]:
    """The cases with these levels, in order of turbulence where that is a factor."""
    found = [c for c in plan.cases if all(c.levels[name] == level for name, level in levels.items())]
    return sorted(found, key=lambda c: c.scenario.turbulence)


def judge(rows: Rows, claim: Claim) -> str:
    """One sentence: what the study found, what is found here, and whether they agree."""
    plan = rows.plan
    method = claim.method or plan.campaign.methods[0]
    cases = [c for c in chosen(plan, claim.where) if not (claim.except_calm and c.scenario.turbulence == 0)]
    summaries = [rows.summary(c, method, claim.parameter) for c in cases]
    by = f" by {claim.method}" if claim.method else ""
    head = f"{claim.figure}, {claim.parameter}{by}: the study finds "
    if claim.is_number:
        return head + _number(summaries, claim)
    if claim.finds in ("feasible", "not feasible"):
        return head + _feasibility(summaries, claim)
    calm, worst = summaries[0], summaries[-1]
    words = ", ".join(level_name(s.case) for s in summaries)
    if claim.finds in ("less scatter", "more scatter"):
        growth = math.log(worst.scatter / calm.scatter)
        error = math.sqrt(0.5 / (calm.flights - 1) + 0.5 / (worst.flights - 1))
        holds = growth < -SURE * error if claim.finds == "less scatter" else growth > SURE * error
        seen = f"the standard deviation is {_list(s.scatter for s in summaries)} % ({words})"
    else:
        more = abs(worst.bias) - abs(calm.bias)
        error = math.hypot(worst.scatter / math.sqrt(worst.flights), calm.scatter / math.sqrt(calm.flights))
        holds = more > SURE * error and more > 1.0
        spread = _list(s.scatter for s in summaries)
        seen = f"the bias is {_list(s.bias for s in summaries)} %, its standard deviation {spread} % ({words})"
    return f"{head}{claim.finds} with turbulence; here {seen}: {_verdict(holds)}."


def compare(rows: Rows, comparison: Comparison, cases: list[Case], among: str) -> str:
    """One sentence: which of two methods errs less at each level of turbulence, and where the better one is good.

    `cases` differ in turbulence only; `among` says what they share.
    """
    plan = rows.plan
    names = [plan.campaign.parameters[i] for i in _MAIN]

    def error(case: Case, method: str) -> float:
        return float(np.mean([rows.summary(case, method, name).rmse for name in names]))

    method, against = comparison.method, comparison.against
    found = [(level_name(c), error(c, method), error(c, against)) for c in cases]
    levels = {
        "better in": [level for level, a, b in found if a * _ALIKE < b],
        "no different in": [level for level, a, b in found if a < _ALIKE * b and b < _ALIKE * a],
        "worse in": [level for level, a, b in found if a > _ALIKE * b],
    }
    verdict = ", ".join(f"{word} {' and '.join(names)}" for word, names in levels.items() if names)
    limit = 100.0 * plan.campaign.tolerance
    good = [level for level, a, _ in found if a <= limit]
    within = f"below {limit:g} % in {' and '.join(good)}" if good else f"nowhere below {limit:g} %"
    numbers = ", ".join(f"{level} {a:.1f} against {b:.1f} %" for level, a, b in found)
    where = f", {among}" if among else ""
    return (
        f"{method} and {against}{where}: {comparison.says}; here the mean RMSE of {', '.join(names)} is {numbers}: "
        f"{method} is {verdict}, and {within}."
    )


def _feasibility(summaries: list[Summary], claim: Claim) -> str:
    over = sum(s.exceedances > claim.limit for s in summaries)
    most = max(s.exceedances for s in summaries)
    least = min(s.exceedances for s in summaries)
    share = over / len(summaries)
    holds = share >= NEARLY_ALL if claim.finds == "not feasible" else share <= 1 - NEARLY_ALL
    where = " in turbulence" if claim.except_calm else ""
    levels: dict[str, list[bool]] = {}
    for s in summaries:
        levels.setdefault(level_name(s.case), []).append(s.exceedances > claim.limit)
    each = ", ".join(f"{level} {sum(beyond)} of {len(beyond)}" for level, beyond in levels.items())
    return (
        f"accurate estimates {claim.finds}{where}; here {over} of {len(summaries)} cases have more than {claim.limit} "
        f"of {OF_FLIGHTS} flights beyond the tolerance ({least:.0f} to {most:.0f}; {each}): {_verdict(holds)}."
    )


def _number(summaries: list[Summary], claim: Claim) -> str:
    """Whether what is found in each case is the study's number, within its error here and the claim's own tolerance."""
    wanted = claim.value or 0.0
    found = [_with_error(s, claim.finds) for s in summaries]
    holds = all(abs(value - wanted) <= claim.within + SURE * error for value, error in found)
    unit = f" of {OF_FLIGHTS} flights" if claim.finds == "exceedances" else " %"
    seen = ", ".join(f"{value:.1f} ± {SURE * error:.1f}" for value, error in found)
    words = ", ".join(level_name(s.case) for s in summaries)
    allowed = f" (± {claim.within:g})" if claim.within else ""
    return f"{claim.finds} {wanted:g}{allowed}{unit}; here it is {seen}{unit} ({words}): {_verdict(holds)}."


def _with_error(s: Summary, what: str) -> tuple[float, float]:
    """A number of Claim.finds and its standard error: binomial for counts, by Wilson's shrunken share so that none and
    all have one too."""
    if what == "bias":
        return s.bias, s.scatter / math.sqrt(s.flights)
    if what == "scatter":
        return s.scatter, s.scatter / math.sqrt(2.0 * (s.flights - 1))
    full = OF_FLIGHTS if what == "exceedances" else 100.0
    share = s.exceedances / OF_FLIGHTS if what == "exceedances" else s.coverage
    shrunken = (share * s.flights + 0.5 * SURE**2) / (s.flights + SURE**2)
    return full * share, full * math.sqrt(shrunken * (1.0 - shrunken) / (s.flights + SURE**2))


def _verdict(holds: bool) -> str:
    return "we find it too" if holds else "we do not find it"


def _list(values: Any) -> str:
    return ", ".join(f"{v:+.1f}" if v < 0 else f"{v:.1f}" for v in values)


def level_name(case: Case) -> str:
    """The case's turbulence in a word, or the gust's standard deviation."""
    sigma = case.scenario.turbulence
    return next((n for n, v in TURBULENCE.items() if abs(v - sigma) < 1e-9), f"{from_si(sigma, 'ft/s'):g} ft/s")

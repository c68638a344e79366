"""The rows of a campaign: one a flight and method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from station.campaign.case import Setup, fly_case, prepare, reference
from station.campaign.one_pass import Results
from station.campaign.spec import METHODS, Case, Plan

Array = NDArray[np.float64]


_APART: Final = 1_000_003
"""Seeds of the first flights of two campaigns whose own seeds follow each other are so far apart."""


def seeds(plan: Plan, flights: range) -> range:
    """Every flight has its own."""
    first = plan.campaign.seed * _APART
    return range(first + flights.start, first + flights.stop)


_ready: dict[tuple[str, int], tuple[Setup, Array]] = {}
"""The case that this process flew last, by specification and number: most batches are of one case."""


def _prepared(plan: Plan, number: int) -> tuple[Setup, Array]:
    key = (plan.text, number)
    if key not in _ready:
        setup = prepare(plan, plan.cases[number])
        _ready.clear()
        _ready[key] = setup, reference(plan, setup)
    return _ready[key]


def fly_rows(plan: Plan, flights: range) -> pa.Table:
    """Fly some flights of a campaign, by their numbers; the same numbers give the same rows anywhere."""
    runs = plan.campaign.runs
    tables = []
    for number in range(flights.start // runs, (flights.stop - 1) // runs + 1):
        case = plan.cases[number]
        setup, target = _prepared(plan, number)
        mine = range(max(flights.start, number * runs), min(flights.stop, (number + 1) * runs))
        run = mine.start - number * runs
        for chunk, results in fly_case(setup, seeds(plan, mine)):
            tables.append(_table(plan, case, run, chunk, results, target))
            run += len(chunk)
    return pa.concat_tables(tables).combine_chunks()


def _numbers(values: NDArray[Any]) -> pa.Array:
    """An Arrow array of numbers, from its memory: pyarrow's own way there imports pandas, which takes seconds."""
    flat = np.ascontiguousarray(values).reshape(-1)
    return pa.Array.from_buffers(_ARROW[flat.dtype.name], len(flat), [None, pa.py_buffer(flat)])


_ARROW: Final = {"float64": pa.float64(), "int64": pa.int64(), "int32": pa.int32(), "uint8": pa.uint8()}


def _words(choice: Sequence[str], which: NDArray[np.int32]) -> pa.Array:
    """An Arrow array of words, chosen by number."""
    encoded = [word.encode() for word in choice]
    ends = np.cumsum([0, *(len(e) for e in encoded)], dtype=np.int32)
    words = pa.Array.from_buffers(pa.string(), len(choice), [None, pa.py_buffer(ends), pa.py_buffer(b"".join(encoded))])
    return words.take(_numbers(which))


def _table(plan: Plan, case: Case, first: int, chunk: range, results: Results, target: Array) -> pa.Table:
    campaign = plan.campaign
    slots = [METHODS.index(m) for m in campaign.methods]
    n, m = len(chunk), len(slots)

    def each(values: Array) -> Array:
        """(runs, slots) -> rows, all methods of a flight together."""
        return np.ascontiguousarray(values[:, slots]).reshape(-1)

    columns: dict[str, pa.Array] = {
        "case": _numbers(np.full(n * m, case.number, dtype=np.int32)),
        "run": _numbers(np.repeat(np.arange(first, first + n, dtype=np.int32), m)),
        "seed": _numbers(np.repeat(np.arange(chunk.start, chunk.stop, dtype=np.int64), m)),
        "method": _words(campaign.methods, np.tile(np.arange(m, dtype=np.int32), n)),
    }
    for name, level in case.levels.items():
        if isinstance(level, str):
            columns[name] = _words([level], np.zeros(n * m, dtype=np.int32))
        else:
            columns[name] = _numbers(np.full(n * m, float(level)))
    for equation in range(2):
        for i in range(3):
            name = campaign.parameters[3 * equation + i]
            value = each(results.estimate[:, :, equation, i])
            error = each(results.error[:, :, equation, i])
            model = each(results.model[:, :, equation, i])
            truth = np.tile(target[slots, equation, i], n)
            off = value - truth
            bound = 2.0 * np.hypot(error, model)
            columns[name] = _numbers(value)
            columns[f"{name}_sd"] = _numbers(error)
            columns[f"{name}_model"] = _numbers(model)
            columns[f"{name}_bound"] = _numbers(bound)
            columns[f"{name}_reference"] = _numbers(truth)
            columns[f"{name}_error"] = _numbers(off / np.abs(truth))
            columns[f"{name}_covered"] = _numbers((np.abs(off) <= bound).astype(np.uint8)).cast(pa.bool_())
        columns["r2_force" if equation == 0 else "r2_moment"] = _numbers(each(results.r2[:, :, equation]))
    return pa.table(columns)

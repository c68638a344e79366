"""Blind diagnoses counted, in one table: what is hidden, and whether it is named.

    uv run python tests/benchmarks/blind_matrices.py [--seed 1] [--workers 2] [--only WORDS] [--share 1.0]

The station's simulation flies aircraft off their profile with trims, zeros and noise of their own, in still air and in
gusts (tests/diagnosis/blind.py, lateral_blind.py), aircraft of 25 and 206 m/s (foreign.py), and JSBSim's DHC-6 beside
the shipped profile (jsbsim_flights.py). Each diagnosis has two manoeuvres, or three, and one held out; what is planted
is scored by code that the engine never sees. `--share` flies a part of each row.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # two processes on two cores
os.environ.setdefault("JSBSIM_DEBUG", "0")  # whose banner would stand in the table
sys.path.insert(0, str(Path(__file__).parents[1] / "diagnosis"))

import blind
import foreign
import lateral_blind
import matrices

from station.diagnosis.procedure import Diagnosis

NAMED: Final = ("exact", "group")
"""Alone, or with rivals that the report lists."""


@dataclass(frozen=True, slots=True)
class Row:
    """Cases of one kind; `of` are the scores counted, at least or at most so many of the cases."""

    name: str
    cases: Sequence[Any]
    of: tuple[str, ...]
    asked: float
    most: bool = False
    diagnosed: Callable[[Any], Diagnosis] = blind.diagnosed
    score: Callable[[Any, Diagnosis], str] = blind.score


@dataclass(frozen=True, slots=True)
class InScene:
    """A diagnosis of an aircraft of foreign.py."""

    name: str

    def __call__(self, case: blind.Case) -> Diagnosis:
        with foreign.flying(foreign.SCENES[self.name]):
            return blind.diagnosed(case)


def rows() -> Iterator[Row]:
    """The table, each row flown anew from matrices.SEED."""
    yield Row("nothing", matrices.clean(30), ("clean",), 0.99)
    yield Row("nothing, derivatives 8 % off", matrices.clean(12, derivative_sd=0.08), ("clean",), 0.99)
    yield Row("nothing, noise 1.5 times what is stated", matrices.clean(9, 1.5), ("clean",), 0.99)
    yield Row("nothing, noise 0.7 times", matrices.clean(9, 0.7), ("clean",), 0.99)
    yield Row("one, twice its detectable size", matrices.singles(2, 2.0), NAMED, 0.95)
    yield Row(
        "one, half of it: named wrongly", matrices.singles(1, 0.5)[::2], ("wrong", "companion", "left over"), 0.03, True
    )
    yield Row("one, ten times: with a companion", matrices.large(8), ("companion",), 0.03, True)
    yield Row("two, twice", matrices.pairs(18), NAMED, 0.92)
    yield Row("outside the catalogue", matrices.outside(11), ("unexplained",), 0.95)
    lateral = {"diagnosed": lateral_blind.diagnosed, "score": lateral_blind.score}
    yield Row("lateral: nothing", matrices.lateral_clean(100), ("clean",), 0.98, **lateral)
    yield Row("lateral: one, twice", matrices.lateral_singles(2.0), NAMED, 0.95, **lateral)
    for name, scene in foreign.SCENES.items():
        own = {"diagnosed": InScene(name)}
        yield Row(f"{name}: nothing", matrices.scene_clean(scene), ("clean",), 0.99, **own)
        yield Row(f"{name}: one, twice", matrices.scene_singles(scene), NAMED, 0.9, **own)
    try:
        import jsbsim_flights as other
    except ImportError:
        print("JSBSim is not there: its rows are left out", file=sys.stderr)
        return
    own = {"diagnosed": other.diagnosed, "score": other.score}
    yield Row("JSBSim's DHC-6: nothing", matrices.jsbsim_clean(9), ("clean",), 0.94, **own)
    yield Row("JSBSim's DHC-6: one, three times", matrices.jsbsim_singles(3.0), NAMED, 0.85, **own)


def scored(row: Row, i: int) -> tuple[str, list[bool]]:
    """Score of one case, and whether the intervals of what is named rightly hold it."""
    case = row.cases[i]
    d = row.diagnosed(case)
    found = row.score(case, d)
    of_axis = d.lateral if row.score is lateral_blind.score and d.lateral else d
    held = [inside for _, inside, _ in blind.covered(case, of_axis)]
    told = [(e.term.id, round(e.value, 5), round(e.sd, 5), e.alternatives) for e in of_axis.effects]
    if found not in (*row.of, "clean") or not all(held) or row.most:
        shown = f"{row.name}: seed {case.seed}, {case.sigma:.3g}, {dict(case.effects)}: {found} {told}"
        print(shown, file=sys.stderr, flush=True)
    return found, held


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", default="")
    parser.add_argument("--share", type=float, default=1.0)
    given = parser.parse_args()
    matrices.SEED = 1000 * given.seed
    told = [row for row in rows() if given.only in row.name]
    print("| hidden | flights | as asked | asked | intervals that hold | scores |\n|---|---|---|---|---|---|")
    with ProcessPoolExecutor(given.workers) as pool:
        jobs = {
            row.name: [pool.submit(scored, row, i) for i in range(max(1, round(given.share * len(row.cases))))]
            for row in told
        }
        for row in told:
            found = [job.result() for job in jobs[row.name]]
            counts = Counter(score for score, _ in found)
            counted = sum(counts[s] for s in row.of)
            held = [x for _, hits in found for x in hits]
            print(
                f"| {row.name} | {len(found)} | {100 * counted / len(found):.0f} % |"
                f" {'at most' if row.most else 'at least'} {100 * row.asked:.0f} % |"
                f" {f'{sum(held)} of {len(held)}' if held else ''} |"
                f" {', '.join(f'{name} {n}' for name, n in counts.most_common())} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

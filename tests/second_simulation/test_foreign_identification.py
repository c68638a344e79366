"""Identification of flights of the second simulation, against a profile that is not quite their aircraft's.

What must never happen: a derivative called estimated whose interval is far from the truth. tests/benchmarks/
foreign_flights.py counts more.
"""

from __future__ import annotations

import gzip
import json
import os
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.conventions import LATERAL, LONGITUDINAL
from tests.second_simulation.flights import QUIET, Case, identify_case, write

SEED = int(os.environ.get("SECOND_SEED", secrets.randbelow(1 << 24)))
"""Of the slow matrix: fresh each time, printed with the result; SECOND_SEED repeats one."""
FAR = 3.0
"""Half-widths of a 95 % interval: six standard errors, which no count of flights here would show by chance."""
Station = Callable[..., tuple[int, str, str]]


@dataclass(frozen=True)
class Estimate:
    """One recommended derivative that is called estimated."""

    flight: str
    name: str
    off: float
    """From the truth, relative."""
    widths: float
    """The same in half-widths of its 95 % interval."""


def recommended(result: dict[str, Any], answers: dict[str, Any], flight: str) -> list[Estimate]:
    chosen = result["recommended"]
    if not chosen:
        return []
    method, found = result["methods"][chosen], []
    for name in LONGITUDINAL:
        p = method["parameters"].get(name)
        if p is None or p["status"] != "estimated":
            continue
        default = "derivatives" if chosen == "physical" else "quasi_steady"
        truth = answers[p.get("definition") or method.get("definition") or default][name]
        low, high = p["ci95"]
        found.append(Estimate(flight, name, p["estimate"] / truth - 1, (p["estimate"] - truth) / (0.5 * (high - low))))
    return found


def sideways(result: dict[str, Any], answers: dict[str, Any], flight: str) -> list[Estimate]:
    """Lateral derivatives of `split` that are called estimated."""
    found = []
    for name, p in result["methods"]["split"]["parameters"].items():
        if name in LATERAL and p["status"] == "estimated":
            (low, high), truth = p["ci95"], answers["derivatives"][name]
            off = p["estimate"] - truth
            found.append(Estimate(flight, name, off / abs(truth), off / (0.5 * (high - low))))
    return found


def identified(station: Station, case: Case, folder: Path) -> list[Estimate]:
    """As a user would: written, imported and identified. Nothing where the aircraft departs or identify refuses."""
    write([case], folder)
    answers = json.loads((folder / "answers.json").read_text()).get(case.name)
    if answers is None:
        return []
    text, log, out = (folder / f"{case.name}{s}" for s in (".csv", ".mcap", ".json"))
    text.write_bytes(gzip.decompress((folder / f"{case.name}.csv.gz").read_bytes()))
    assert station("import", text, "-o", log, "--aircraft", "twin_otter")[0] == 0
    code, _, said = station("identify", log, "--from", QUIET, "--json", out)
    assert code in (0, 3), said
    return (sideways if case.lateral else recommended)(json.loads(out.read_text()), answers, case.name)


@pytest.mark.parametrize("index", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 5))])
def test_no_estimate_is_far_from_the_truth(index: int, station: Station, tmp_path: Path) -> None:
    found = identified(station, identify_case(20262, index), tmp_path)
    assert [e for e in found if abs(e.widths) > FAR] == []


@pytest.mark.slow
def test_intervals_hold_gusts_that_five_hertz_fold(station: Station, tmp_path: Path) -> None:
    """10 ft/s. Without what folds into the lines, CL_alpha is 24 % off with two standard errors of 14 %."""
    found = identified(station, identify_case(3, 6), tmp_path)
    assert {"CL_alpha", "Cm_q", "Cm_de"} <= {e.name for e in found}
    assert [e for e in found if abs(e.widths) > 1] == []


@pytest.mark.slow
def test_intervals_hold(station: Station, tmp_path: Path) -> None:
    """Of 48 flights, from 5 to 100 Hz, calm to 12 ft/s, most under feedback."""
    found = [e for i in range(48) for e in identified(station, identify_case(SEED, i), tmp_path)]
    print(f"seed {SEED}\n| derivative | estimated | mean error % | 95 % intervals that hold |\n|---|---|---|---|")
    held = {}
    for name in LONGITUDINAL:
        mine = [e for e in found if e.name == name]
        held[name] = float(np.mean([abs(e.widths) < 1 for e in mine]))
        print(f"| {name} | {len(mine)} | {100 * np.mean([abs(e.off) for e in mine]):.1f} | {100 * held[name]:.0f} % |")
    assert [e for e in found if abs(e.widths) > FAR] == []
    # 90 % wanted, less three standard deviations of a count of 40.
    assert min(held.values()) > 0.9 - 3 * np.sqrt(0.9 * 0.1 / 40)


@pytest.mark.slow
@pytest.mark.xfail(
    strict=False, reason="roll gusts, which nothing measures, pull Cl_p to half: equation error in gusts"
)
def test_no_lateral_estimate_is_far_from_the_truth(station: Station, tmp_path: Path) -> None:
    """Wings held level in roll gusts of MIL-F-8785C: the aileron and the roll rate answer what no vane shows."""
    found = [e for i in range(12) for e in identified(station, identify_case(SEED, i, lateral=True), tmp_path)]
    print(f"seed {SEED}")
    for name in LATERAL:
        mine = [e for e in found if e.name == name]
        off, held = ([f(e) for e in mine] or [np.nan] for f in (lambda e: abs(e.off), lambda e: abs(e.widths) < 1))
        print(f"{name:8s} {len(mine):3d} {100 * np.mean(off):6.1f} % {100 * np.mean(held):4.0f} %")
    assert [e for e in found if abs(e.widths) > FAR] == []

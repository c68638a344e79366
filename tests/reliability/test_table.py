"""The table says of which commit each row is, what was not made, and what does not hold."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.reliability import table
from tests.reliability.inputs import soaked

GOOD = {"name": "a", "limit": "1 s", "found": "0.5 s", "holds": True, "commit": "abc1234"}
FLOWN = """ticks done after 1.60 ms (median), 21.65 ms (p99), 344.0 ms (worst); {} missed
memory from 10 min on: {} MiB/h, extremes 1.8 MiB apart"""


def test_rows_are_of_a_commit_and_what_was_not_made_is_open() -> None:
    bad = {**GOOD, "name": "b", "holds": False}
    head, *rows = table.table({"x": GOOD, "y": bad}, ["x", "y", "z"])
    assert head.splitlines()[0].count("|") == 6
    assert rows == [
        "| a | 1 s | 0.5 s | holds | `abc1234` |",
        "| b | 1 s | 0.5 s | **does not hold** | `abc1234` |",
        "| z | | not made | **open** | |",
    ]


@pytest.mark.parametrize("text", ["{", "[]", '{"x": {"name": "a"}}', '{"x": 3}'])
def test_a_file_of_results_that_holds_something_else_is_told(tmp_path: Path, text: str) -> None:
    path = tmp_path / "results.json"
    path.write_text(text)
    with pytest.raises(SystemExit, match=r"no results.*remove it"):
        table.kept(path)
    assert table.kept(tmp_path / "none.json") == {}


def test_an_unknown_trial_is_told_before_any_is_made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text(json.dumps({"kill": GOOD}))
    monkeypatch.setattr(sys, "argv", ["table", "--only", "kill,flipps", "--results", str(path)])
    with pytest.raises(SystemExit, match="--only: no flipps; known: kill, "):
        table.main()


@pytest.mark.parametrize(
    ("missed", "slope", "holds"), [(0, "+0.42", True), (1, "+0.42", False), (0, "+7.57", False), (0, "-0.10", True)]
)
def test_an_hour_in_the_air_is_judged(missed: int, slope: str, holds: bool) -> None:
    _, limit, found, held = soaked(FLOWN.format(missed, slope), 60)
    assert held is holds
    assert limit == "0; 1 MiB/h"
    assert found == f"{missed} ticks missed, 21.65 ms (p99); {slope} MiB/h from 10 min on"

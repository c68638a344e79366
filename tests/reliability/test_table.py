"""The table says of which commit each row is, what was not made, and what does not hold."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.benchmarks.live_flight import still
from tests.reliability import table
from tests.reliability.inputs import mutations, soaked
from tests.reliability.mutations import added, code_of, is_short

GOOD = {"name": "a", "limit": "1 s", "found": "0.5 s", "holds": True, "commit": "abc1234"}
FLOWN = """ticks done after 1.60 ms (median), 21.65 ms (p99), 344.0 ms (worst); {} missed
memory from 10 min on: {} MiB/h, extremes 1.8 MiB apart
at real-time priority, load 7.5 on 2 cores; files: 2; exit code: {}"""


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
    ("missed", "slope", "code", "holds"),
    [
        (0, "+0.42", 0, True),
        (1, "+0.42", 0, False),
        (0, "+7.57", 0, False),
        (0, "-0.10", 0, True),
        (0, "+0.42", 3, False),
    ],
)
def test_an_hour_in_the_air_is_judged(missed: int, slope: str, code: int, holds: bool) -> None:
    told = FLOWN.format(missed, slope, code)
    name, limit, found, held = soaked(told, 60)
    assert held is holds
    assert name == "a flight of 60 min on the bench, at real-time priority, load 7.5 on 2 cores"
    assert limit == "0; 1 MiB/h"
    assert found == f"ticks missed: {missed}, 21.65 ms (p99); {slope} MiB/h from 10 min on; files: 2, exit code {code}"
    still = "the machine itself stood still 2 times, 29 ms at most"
    assert soaked(f"{told}\n{still}", 60)[2] == f"{found}; {still}"
    # With one core kept busy the ticks count, and how late they are is told.
    name, limit, _, held = soaked(told, 15, stressed=True)
    assert "one core kept busy" in name
    assert limit == "0"
    assert held is (not missed and not code)


def test_bad_inputs_add_up_while_their_reader_is_the_same(tmp_path: Path) -> None:
    counts = tmp_path / "mutated.json"
    first = added("lines", 100, 60.0, counts)
    assert added("lines", 100, 60.0, counts) == first
    again = added("lines", 250, 60.0, counts)
    assert (again.inputs, again.raised) == (250, 0)
    # The same inputs a second time would find the same again.
    assert again.read not in (first.read, 2.5 * first.read)
    assert is_short("lines", counts)
    *_, words, holds = mutations("lines", 300, 0.0, counts)
    assert words.endswith(" of 300 so far") is not holds
    counts.write_text(counts.read_text().replace(code_of("lines"), "0"))
    assert added("lines", 100, 60.0, counts).inputs == 100
    counts.write_text("{]")
    with pytest.raises(SystemExit, match="no counts of inputs; remove it"):
        added("lines", 100, 60.0, counts)


def test_code_of_a_reader_is_what_it_rests_on() -> None:
    assert code_of("ubx") == code_of("nmea")  # one module
    assert len({code_of(name) for name in ("ubx", "lines", "mavlink", "can", "dronecan", "mcap", "csv")}) == 7


def test_the_machine_stood_still_where_all_cores_did_at_once() -> None:
    assert still([[(10.0, 0.03), (20.0, 0.05)], [(10.01, 0.028), (30.0, 0.06)]]) == (
        "the machine itself stood still once, 30 ms at most"
    )
    assert still([[(10.0, 0.03)], []]) == "the machine itself never stood still"
    # A core alone that a witness before all others did not get was not to be had for the station either.
    assert still([[(10.0, 0.03)], []], [(10.04, 1), (20.0, 2)]) == (
        "the machine itself never stood still; ticks missed while a core of it did: 1"
    )


def test_ticks_that_the_machine_lost_are_told_and_not_held_against_the_station() -> None:
    told = FLOWN.format(5, "+0.42", 0) + "\nthe machine itself stood still 2 times, 41 ms at most"
    assert soaked(f"{told}; ticks missed while a core of it did: 5", 60)[3]
    assert not soaked(f"{told}; ticks missed while a core of it did: 4", 60)[3]
    assert not soaked(told, 60)[3]

"""A measured baseline: its profile reads back, holds the truth, and the next flight is held against it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from programme_flights import flown

from station.profile import load_aircraft

POINTS = (
    {"name": "one", "condition": "baseline", "start": "5 s", "end": "35 s"},
    {"name": "two", "condition": "baseline", "start": "35 s", "end": "65 s"},
    {"name": "three", "condition": "baseline", "start": "65 s", "end": "95 s"},
    {"name": "four", "condition": "other", "start": "95 s", "end": "96 s"},
)
ICE = """
[flight.truth]
drag.zero_lift = { at = ["0 s"], factor = [1.3] }
"""
VANE = """
[flight.truth]
boom.zero = { at = ["0 s"], value = ["1.0 deg"] }
"""


@pytest.fixture(scope="module")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown(tmp_path_factory.mktemp("baseline"), POINTS, 97.0)


def test_a_baseline_holds_the_truth_and_finds_more_drag(station, baseline: Path, tmp_path: Path) -> None:
    profile = tmp_path / "mine.toml"
    code, out, err = station("baseline", str(baseline), "-o", str(profile))
    assert code == 0, err
    assert "baseline of 3 points: one, two, three" in out
    made, truth = load_aircraft(str(profile)), load_aircraft("twin_otter")
    assert made.measured is not None
    assert made.measured.points == 3
    assert made.measured.lowest_speed == pytest.approx(56.6, abs=0.5)
    for name in ("CL_alpha", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"):
        own = made.derivatives[name]
        assert own.sd is not None
        assert abs(own.value - truth.value(name)) < 3 * own.sd, name
    assert pytest.approx(0.04, abs=5 * made.measured.CD_0_sd) == made.measured.CD_0
    assert pytest.approx(truth.value("CL_0"), abs=0.01) == made.measured.CL_0
    assert made.inertia == truth.inertia

    iced = flown(tmp_path, ({"name": "later", "condition": "ice", "start": "5 s", "end": "35 s"},), 36.0, ICE)
    where = tmp_path / "points.json"
    code, out, err = station(
        "points", str(iced), "--aircraft", str(profile), "--method", "physical", "--json", str(where)
    )
    assert code == 0, err
    said = json.loads(where.read_text())
    assert said["baseline_of"]["source"] == "measured"
    percent = said["points"][0]["change_percent"]["CD_0"]
    assert percent["ci95"][0] <= 30.0 <= percent["ci95"][1]
    assert percent["ci95"][1] - percent["ci95"][0] < 15.0
    assert "changed at later (ice)" in out
    assert not said["points"][0]["change_percent"]["CL_0"]["ci95"][0] > 0.0
    assert "a vane whose zero has moved" not in said["points"][0]["like"].partition(";")[0]

    wrong = tmp_path / "vane"
    wrong.mkdir()
    moved = flown(wrong, ({"name": "later", "condition": "clean", "start": "5 s", "end": "35 s"},), 36.0, VANE)
    code, out, err = station(
        "points", str(moved), "--aircraft", str(profile), "--method", "physical", "--json", str(where)
    )
    assert code == 0, err
    point = json.loads(where.read_text())["points"][0]
    # 0.85 deg of angle of attack: CL (1 + 2 k CD) e/CD_0 and -(CL_alpha + CD) e/CL_0, by hand.
    assert point["change_percent"]["CD_0"]["estimate"] == pytest.approx(26.0, abs=3.0)
    assert point["change_percent"]["CL_0"]["estimate"] == pytest.approx(-23.6, abs=3.0)
    assert point["like"].startswith("as by a vane whose zero has moved (1.0")

    code, _, err = station("baseline", str(baseline), "-o", str(profile))
    assert code == 2
    assert "never replaces" in err


def test_a_baseline_of_one_point_says_what_it_does_not_know(station, tmp_path: Path) -> None:
    one = flown(tmp_path, POINTS[:1], 36.0)
    code, out, _ = station("baseline", str(one), "-o", str(tmp_path / "one.toml"))
    assert code == 3
    assert "a baseline of one point" in out

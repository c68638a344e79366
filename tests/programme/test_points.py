"""Test points: what a programme of known ice says of itself, and what it cannot say."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from programme_flights import flown

from station.commands.simulate import simulate
from station.identification.flown_inputs import inputs_of
from station.log import table
from station.model.change_patterns import NAMES
from station.profile import Calibrated, Measured, load_aircraft, otherwise
from station.programme.changes import Change, drag_change
from station.programme.drag import DragOfPoint
from station.programme.histories_overlaid import history, pairs
from station.programme.points_json import as_json
from station.programme.points_listing import print_programme
from station.programme.points_report import answer, write_report
from station.programme.programme import Programme, changed, likeness, programme
from station.rows import UsageError

METHODS = ("II", "III", "split", "physical")
THIN = """
[flight.truth]
derivatives.CL_alpha = { at = ["60 s", "62 s"], factor = [1.0, 0.8] }
derivatives.Cm_de = { at = ["60 s", "62 s"], factor = [1.0, 0.85] }
"""
POINTS = (
    {"name": "one", "condition": "baseline, calm", "start": "5 s", "end": "32 s"},
    {"name": "two", "condition": "Baseline", "start": "35 s", "end": "62 s"},
    {"name": "three", "condition": "iced; calm", "start": "65 s", "end": "92 s"},
    {"name": "short", "start": "93 s", "end": "96 s"},
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown(tmp_path_factory.mktemp("programme"), POINTS, 100.0, THIN)


@pytest.fixture(scope="module")
def made(log: Path) -> Programme:
    return programme([log], [], load_aircraft("twin_otter"), METHODS, lambda _: None)


def test_points_are_those_marked(made: Programme) -> None:
    assert [(p.name, p.condition) for p in made.points] == [
        ("one", "baseline, calm"), ("two", "Baseline"), ("three", "iced; calm"), ("short", "")
    ]  # fmt: skip
    assert [(round(p.start_s), round(p.end_s)) for p in made.points] == [(5, 32), (35, 62), (65, 92), (93, 96)]
    assert made.baseline.points == ("one (baseline, calm)", "two (Baseline)")


def test_inputs_are_found_where_they_were_flown(made: Programme) -> None:
    """A doublet of 1.2 s at 8 s and a 3-2-1-1 of 3.5 s at 16 s, each 30 s; an actuator's lag of 0.08 s."""
    found = [(i.start_s, i.end_s) for i in made.points[2].inputs]
    np.testing.assert_allclose(found, [(68.0, 69.2), (76.0, 79.5)], atol=0.35)


def test_a_point_s_change_is_what_was_changed(made: Programme) -> None:
    """The aircraft's own derivatives: -20 and -15 %, the others as they were."""
    change = made.changes[2]["physical"]
    truth = {"CL_alpha": -20.0, "Cm_de": -15.0, "CL_de": 0.0, "Cm_q": 0.0}
    for name, percent in truth.items():
        assert change[name].low <= percent <= change[name].high, name
    assert change["CL_alpha"].is_significant
    assert change["Cm_de"].is_significant
    # Narrow enough to be of use: with 0 % and -40 % left out.
    assert change["CL_alpha"].high < -10
    assert change["CL_alpha"].low > -30


def test_of_points_at_which_nothing_has_changed_one_in_twenty_has() -> None:
    """Of seven independent changes each, drawn; of those whose own 95 % leave nought out it would be six in twenty."""
    rng = np.random.default_rng(15)
    half = 1.959964
    drawn = [
        {n: Change(x, x - half, x + half) for n, x in zip(NAMES, row, strict=True)}
        for row in rng.standard_normal((2000, len(NAMES)))
    ]
    told = np.mean([bool(changed(d)) for d in drawn])
    assert 0.03 < told < 0.07
    assert np.mean([any(c.is_significant for c in d.values()) for d in drawn]) > 0.25
    assert not likeness(drawn[0], load_aircraft("twin_otter")) or changed(drawn[0])
    assert set(changed({"CL_alpha": Change(-9.0, -12.0, -6.0), "CD_0": Change(math.nan, math.nan, math.nan)})) == {
        "CL_alpha"
    }


def test_methods_for_turbulence_do_not_apply_to_calm_inputs(made: Programme) -> None:
    point = made.points[0]
    assert point.turbulence == "calm"
    assert point.methods is not None
    assert point.methods["III"].why == "calm during the input"
    assert all(p.status.value == "invalid" for p in point.methods["III"].parameters)
    assert not made.changes[0]["III"]["CL_alpha"].is_known


def test_a_point_of_three_seconds_is_said_to_be_too_short(made: Programme) -> None:
    assert made.points[3].found is None
    assert made.points[3].why == "3.0 s long: 6 s are the least"


def test_a_point_s_drag_is_that_of_rest_whatever_was_flown(made: Programme) -> None:
    """Within a window of an input the mean of lift squared is more than the mean lift's square: taken for the same it
    was 1 % of drag, and a flight in turbulence, which has less of it, was told from its baseline."""
    truth = load_aircraft("twin_otter").drag
    assert truth is not None
    for point in made.points[:2]:
        assert point.drag is not None
        assert point.drag.value == pytest.approx(truth.zero_lift, rel=0.004)
        assert abs(point.drag.value - truth.zero_lift) < 3 * point.drag.error


def test_recordings_of_several_aircraft_are_refused_before_anything_is_made_of_them(log: Path, tmp_path: Path) -> None:
    """A baseline of another: its changes were told, +80 % of CL_alpha among them."""
    card, other, told = tmp_path / "card.toml", tmp_path / "other.mcap", []
    text = 'name = "x"\naircraft = "attas"\nrig = "boom_thrust"\n[flight]\nspeed = "230 kt"\naltitude = "15000 ft"\n'
    card.write_text(text)
    simulate(str(card), other, None, 1, 2.0)
    with pytest.raises(UsageError, match=r"several aircraft: attas in other.mcap, twin_otter in flight.mcap"):
        programme([log], [other], load_aircraft("twin_otter"), METHODS, told.append)
    assert told == []


def test_a_profile_measured_or_calibrated_with_another_aircraft_is_refused(log: Path, tmp_path: Path) -> None:
    """By --aircraft, as by --baseline: its derivatives and its vane were computed with the other's wing. A calibrated
    profile of the same aircraft is another name, and no more."""
    card, other, told = tmp_path / "card.toml", tmp_path / "other.mcap", []
    text = 'name = "x"\naircraft = "attas"\nrig = "boom_thrust"\n[flight]\nspeed = "230 kt"\naltitude = "15000 ft"\n'
    card.write_text(text)
    simulate(str(card), other, None, 1, 8.0)
    plain = load_aircraft("twin_otter")
    held = {"points": 3, "condition": "", "lowest_speed": "50 m/s", "highest_speed": "60 m/s"}
    flown = {"date": "", "recordings": ["a"], "lowest_speed": "50 m/s", "highest_speed": "60 m/s"}
    for how in ({"measured": Measured.model_validate(held)}, {"calibrated": Calibrated.model_validate(flown)}):
        known = plain.model_copy(update={**how, "name": f"mine_{next(iter(how))}"})
        with pytest.raises(
            UsageError, match=r"several aircraft: attas in other\.mcap, while mine_\w+ was \w+ with"
        ) as no:
            programme([other], [], known, ("II",), told.append)
        assert "wing area 39.02 m2, not 64" in str(no.value)
        assert told == []
    made = programme([log], [], known, ("II",), told.append)
    assert f"recorded with the profile twin_otter, identified with {known.name}" in made.remarks
    assert not any("is not the recorded" in words for words in made.remarks)
    remarks = programme([other], [], plain, ("II",), told.append).remarks
    assert any("twin_otter is not the recorded attas: wing area 39.02 m2, not 64" in words for words in remarks)


def test_another_configuration_than_the_baseline_s_is_said() -> None:
    assert otherwise("flaps 20, clean", "baseline, flaps up, clean") == (("flaps 20", "flaps up"),)
    assert otherwise("light turbulence, Flaps Up", "baseline, flaps up; baseline, flaps 10") == ()
    assert otherwise("flaps 20", "baseline, flaps up; baseline, flaps 10") == (("flaps 20", "flaps up or flaps 10"),)
    assert otherwise("iced", "") == ()


def test_a_point_of_another_configuration_remarks_it(tmp_path: Path) -> None:
    points = (
        {"name": "one", "condition": "baseline, flaps up", "start": "2 s", "end": "18 s"},
        {"name": "two", "condition": "flaps 20", "start": "20 s", "end": "38 s"},
    )
    log = flown(tmp_path, points, 40.0)
    made = programme([log], [], load_aircraft("twin_otter"), ("II",), lambda _: None)
    assert "two: flaps 20, the baseline flaps up: what that alone changes is told as changed" in made.remarks


def test_drag_that_has_changed_is_quoted_of_a_point_without_an_input(made: Programme) -> None:
    """As of a steady step amid ice: it was called one of which no change could be told."""
    why = "the elevator rests throughout: no input was flown"
    still = replace(made.points[2], name="still", why=why, methods=None, drag=DragOfPoint(0.0588, 0.0005))
    changes = {i: changes for i, changes in made.changes.items() if i < 2} | {2: {}}
    quoted = answer(replace(made, points=(*made.points[:2], still), changes=changes))
    assert "still: CD_0 +47 %" in quoted
    assert "no change could be told" not in quoted


def test_of_many_changed_points_those_that_stand_out_are_quoted(made: Programme, tmp_path: Path) -> None:
    """The last, all iced, was "1 more in the table" after the cloud's first drag; and what each looks like stood in a
    column of nine letters' width."""
    drags = {"first": 0.043, "second": 0.048, "third": 0.052, "iced": 0.0588}
    iced = [replace(made.points[2], name=n, methods=None, drag=DragOfPoint(d, 0.0005)) for n, d in drags.items()]
    changes = {i: changes for i, changes in made.changes.items() if i < 2} | {i: {} for i in range(2, 6)}
    flight = replace(made, points=(*made.points[:2], *iced), changes=changes)
    quoted = answer(flight)
    assert "first" not in quoted
    assert quoted.index("second: CD_0 +20 %") < quoted.index("third: ") < quoted.index("iced: CD_0 +47 %")
    assert "; and 1 more in the table" in quoted
    rows = write_report(flight, tmp_path).read_text().partition("</table>")[0].split("<tr>")[1:]
    (line,) = [r for r in rows if "CD_0 +47 %" in r]
    assert re.fullmatch(r"<td></td><td class='words' colspan='8'>CD_0 \+47 % .*: as by .*</td></tr>", line)


def test_why_a_point_s_drag_is_not_told(made: Programme) -> None:
    """Of a flight whose thrust is recorded."""
    assert drag_change(made.points[3], made.baseline).why == "3.0 s long: 6 s are the least"
    assert drag_change(made.points[2], made.baseline).is_known
    found = made.points[2].found
    assert found is not None
    beyond = "the engine's table says nothing of 80% of the record: it is not used"
    record = replace(found.record, why_no_thrust=beyond)
    exceeded = replace(made.points[2], drag=None, found=replace(found, record=record))
    assert drag_change(exceeded, made.baseline).why == beyond
    brief = replace(made.points[2], drag=None)
    assert "fewer than 3 stretches of 5 s" in drag_change(brief, made.baseline).why
    assert drag_change(made.points[2], replace(made.baseline, drag=None)).why == "the baseline does not have it"


@pytest.mark.parametrize(("start", "level"), [("26 s", "calm"), ("0 s", "light")])
def test_turbulence_is_judged_during_the_input(tmp_path: Path, start: str, level: str) -> None:
    """Martos 2013, test point 12: gusts that come after the input are none of its business."""
    gusts = f'gust_sigma = "5 ft/s"\ngust_start = "{start}"\n'
    points = ({"name": "TP 12", "start": "5 s", "end": "37 s"},)
    log = flown(tmp_path, points, 38.0, gusts)
    made = programme([log], [], load_aircraft("twin_otter"), ("II", "III"), lambda _: None)
    assert made.points[0].turbulence == level
    assert made.points[0].methods is not None
    assert (made.points[0].methods["III"].why == "calm during the input") == (level == "calm")
    assert made.baseline.source == "profile"
    assert any("no point is marked as baseline" in r for r in made.remarks)


def test_an_elevator_that_rests_has_no_inputs(log: Path) -> None:
    from station.estimation.flight_record import FlightRecord

    still = table(log).between(40.0, 44.0)
    columns = {**still.columns, "elevator": np.full(len(still.t_s), -0.02)}
    record = FlightRecord.of(still.t_s, columns, load_aircraft("twin_otter"))
    assert inputs_of(record) == ()


def test_a_point_is_laid_over_its_like_from_the_first_input_on(made: Programme) -> None:
    """The doublets at 8 and at 68 s: the same input, so the elevators agree as far as their noise; with 20 % less lift
    slope and 15 % less elevator the pitch rates do not."""
    (point, like), (short, _) = pairs(made)
    assert (point.name, like.name) == ("three", "one")
    assert history(short) is None
    mine, its = history(point), history(like)
    assert mine is not None
    assert its is not None
    assert mine.noise["q"] > 0
    t = np.arange(-1.0, 6.0, 0.02)
    a, b = ({n: np.interp(t, x.t_s, v) - np.interp(-1.0, x.t_s, v) for n, v in x.values.items()} for x in (mine, its))
    assert np.ptp(a["elevator"] - b["elevator"]) < 0.3 * np.ptp(b["elevator"])
    assert np.ptp(a["q"]) < 0.97 * np.ptp(b["q"])


def test_the_same_point_of_another_flight_goes_before_the_baseline(made: Programme) -> None:
    first, second = made.flights[0], replace(made.flights[0], path=Path("second.mcap"))
    again = [replace(p, log="second.mcap") for p in made.points]
    both = replace(made, flights=(first, second), points=(*made.points, *again))
    named = [(p.name, p.log == "second.mcap", other.name, other.log) for p, other in pairs(both)]
    log = str(first.path)
    assert ("three", True, "three", log) in named
    assert ("one", True, "one", log) in named
    assert ("three", False, "one", log) in named


def test_the_command(station, log: Path, tmp_path: Path) -> None:
    """JSON to a file, a page, a table; exit code 3 for the point that cannot be used."""
    where, page = tmp_path / "points.json", tmp_path / "report"
    words = ("points", str(log), "--method", "II", "split", "--json", str(where), "--report", str(page))
    code, out, err = station(*words)
    assert code == 3
    assert "short: 3.0 s long" in err
    assert "one (baseline, calm)" in out
    said = json.loads(where.read_text())
    assert said["schema"] == "station.points/1"
    assert [p["name"] for p in said["points"]] == ["one", "two", "three", "short"]
    assert said["baseline"]["CL_alpha"]["points"] == 2
    assert said["baseline"]["CL_alpha"]["definition"] == "quasi_steady"
    percent = said["points"][2]["methods"]["split"]["change_percent"]["CL_alpha"]
    assert percent["ci95"][0] < percent["estimate"] < percent["ci95"][1]
    assert -30 < percent["estimate"] < -10
    shown = (page / "points.html").read_text()
    assert shown.count("<img") == 7  # the flight's air, two of its vane, three points, one over a baseline's
    assert "Elevator, angle of attack, pitch rate and acceleration of three (iced; calm) over one" in shown
    sentence = shown.partition('<p class="verdict">')[2].partition("</p>")[0]
    assert "changed against the baseline of 2 points: three: " in sentence
    low, high = map(float, re.findall(r"Cm_de -\d+ % \((-\d+) to (-\d+)\)", sentence)[0])
    assert low < -15 < high  # as flown
    assert "no change could be told: short" in sentence


@pytest.mark.slow
def test_a_recording_without_points_is_one(station, log: Path, tmp_path: Path) -> None:
    bare = flown(tmp_path, (), 30.0)
    made = programme([bare], [log], load_aircraft("twin_otter"), ("split",), lambda _: None)
    assert [p.name for p in made.points][-1] == "flight"
    assert any("no test point is marked" in r for r in made.remarks)
    assert len(made.baseline.points) == 3  # all that can be used of the baseline's recording


def test_drag_is_told_of_each_point_and_of_the_baseline(made: Programme, tmp_path: Path, capsys) -> None:
    """CD_0 of the aircraft is 0.04, by its profile; where nothing is known of it, why."""
    page = as_json(made)
    for point in page["points"][:2]:
        assert point["CD_0"]["estimate"] == pytest.approx(0.04, rel=0.004)
        assert point["CD_0"]["ci95"][0] < point["CD_0"]["estimate"] < point["CD_0"]["ci95"][1]
    assert page["points"][3]["CD_0"]["status"] == "unestimated"
    assert page["points"][3]["CD_0"]["why"] == "3.0 s long: 6 s are the least"
    assert page["baseline"]["CD_0"]["estimate"] == pytest.approx(0.04, rel=0.004)
    print_programme(made)
    shown = capsys.readouterr().out.splitlines()
    (head,) = [x for x in shown if "condition" in x]
    assert head.split()[-1] == "CD_0"
    assert next(x for x in shown if " one " in x).split()[-1].startswith(("0.040", "0.0399"))
    assert sum("Cm_de" in x and "CD_0" in x for x in shown) == 1
    assert any("standard deviation of the vertical gust in 2 to 7 Hz" in x for x in shown)
    report = write_report(made, tmp_path).read_text()
    assert report.count("<th>CD_0</th>") == 2
    assert "w 2–7 Hz: standard deviation of the vertical gust in 2 to 7 Hz" in report
    assert "gust, m/s</th>" not in report

"""What replay --verify says of a difference."""

import math
from pathlib import Path

import msgspec
import pytest

from station.commands.replay import outcome
from station.flight.loop import Beat
from station.flight.replay_check import Comparison, deviation, difference, same_bits
from station.log import About, arithmetic, metadata, recover, unlike, write_log
from station.profile import load_aircraft
from station.rows import MethodEstimate, ParamEstimate, Status, Tick


def estimate(value: float, name: str = "Cm_q") -> MethodEstimate:
    known = ParamEstimate("Cm_de", -1.7, 0.1, Status.ESTIMATED)
    return MethodEstimate(5, "split", (known, ParamEstimate(name, value, math.nan, Status.INVALID, "why")))


def test_the_fields_that_differ_are_told_and_no_others() -> None:
    assert same_bits(estimate(math.nan), estimate(math.nan))
    assert not same_bits(estimate(0.0), estimate(-0.0))
    said = difference(estimate(-38.0), estimate(math.nextafter(-38.0, 0)))
    assert said == "MethodEstimate split\nparameters[Cm_q].value: -38.0 recorded, -37.99999999999999 now"
    assert difference(estimate(1.0), None) == "MethodEstimate recorded, nothing now"
    assert difference(estimate(1.0), Tick(5, 1, 4)) == "MethodEstimate recorded, Tick now"


def test_only_the_first_difference_is_kept_and_all_are_counted() -> None:
    found = Comparison()
    beat = Beat(Tick(5, 7, 4), (), recorded=(estimate(1.0), estimate(2.0)))
    found.take(beat, [estimate(1.0), estimate(2.0), estimate(3.0)])
    assert (found.beats, found.rows, found.different, found.first) == (1, 2, 0, "")
    found.take(beat, [estimate(1.5), estimate(2.5)])
    found.take(beat._replace(recorded=()), [estimate(1.0)])
    assert (found.beats, found.rows, found.different) == (3, 4, 2)
    assert found.first.splitlines()[0] == "first difference at tick 7: MethodEstimate split"
    assert "1.0 recorded, 1.5 now" in found.first


@pytest.mark.parametrize(
    ("was", "now", "apart"),
    [
        (-38.0, math.nextafter(-38.0, 0), 2**-47 / 38),  # 38 is between 2^5 and 2^6: the last of its bits is 2^-47
        (1e-9, 1.1e-9, 1e-10),
        (1.0, 1.5, 0.5 / 1.5),
        (math.nan, math.nan, 0.0),
        (math.nan, 1.0, math.inf),
        (math.inf, math.inf, 0.0),
    ],
)
def test_how_far_two_rows_are_apart(was: float, now: float, apart: float) -> None:
    assert deviation(estimate(was), estimate(now)) == pytest.approx(apart, rel=1e-3)


def test_other_words_names_and_kinds_are_no_rounding() -> None:
    assert deviation(estimate(1.0), estimate(1.0, "Cm_de")) == math.inf
    assert deviation(estimate(1.0), None) == deviation(estimate(1.0), Tick(5, 1, 4)) == math.inf
    why = msgspec.structs.replace(estimate(1.0), why="turbulence")
    assert deviation(estimate(1.0), why) == math.inf


def replayed(change: float) -> Comparison:
    found = Comparison()
    found.take(Beat(Tick(5, 7, 4), (), recorded=(estimate(40.0),)), [estimate(40.0 + change)])
    found.take(Beat(Tick(6, 8, 5), (), recorded=(estimate(40.0),)), [estimate(40.0)])
    return found


@pytest.mark.parametrize(
    ("change", "machine", "code", "words"),
    [
        (1e-13, "", 1, ["first difference at tick 7"]),
        (1e-13, "processor A recorded, B here", 3, ["within 1e-12", "processor A recorded, B here"]),
        (1e-9, "processor A recorded, B here", 1, ["first difference at tick 7", "processor A recorded, B here"]),
    ],
)
def test_what_another_machine_rounds_is_told_apart_from_a_real_difference(
    change: float, machine: str, code: int, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert outcome(replayed(change), machine) == code
    told = capsys.readouterr().err
    assert all(w in told for w in words)


def test_a_recording_keeps_the_machine_that_its_estimates_were_made_on(tmp_path: Path) -> None:
    """A copy of its rows made elsewhere, too; one from before says nothing of it."""
    other = {**arithmetic(), "processor": "another", "numpy": "2.1.0"}
    made = About(load_aircraft("twin_otter"), (), arithmetic=other)
    path, again = tmp_path / "one.mcap", tmp_path / "two.mcap"
    write_log(path, made, [Tick(10**9, 0, 10**9)])
    recover(path, again)
    for log in (path, again):
        assert dict(metadata(log).about.arithmetic) == other
    words = unlike(metadata(path).about.arithmetic, arithmetic())
    assert f"processor another recorded, {arithmetic()['processor']} here" in words
    assert ("numpy 2.1.0 recorded" in words) == (arithmetic()["numpy"] != "2.1.0")
    assert "scipy" not in words
    assert unlike(arithmetic(), arithmetic()) == ""
    assert "does not say" in unlike({}, arithmetic())

"""What replay --verify says of a difference."""

import math
from pathlib import Path

import msgspec
import pytest

from station.commands.replay import outcome
from station.flight.loop import Beat
from station.flight.replay_check import Comparison, difference, is_rounding, same_bits
from station.log import About, arithmetic, metadata, recover, unlike, write_log
from station.profile import load_aircraft
from station.rows import AlphaEstimate, Code, Event, MethodEstimate, ParamEstimate, Status, Tick


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


ALPHA = AlphaEstimate(
    5, alpha=0.05, alpha_sd=0.001, vane=0.06, zero=0.0, upwash=0.0, rate=0.0, lag=0.0, gust=0.0,
    alpha_inertial=math.nan, alpha_gust=0.0, gust_vertical=40.0, turbulence_level=0.1, turbulence="light",
    wind_north=0.0, wind_east=0.0, wind_down=0.0, valid=True, why="",
)  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "rounded"),
    [
        ({"alpha": 0.05 + 0.9e-12}, True),
        ({"alpha": 0.05 + 1.1e-12}, False),
        ({"gust_vertical": 40 + 39e-12}, True),
        ({"gust_vertical": 40 + 41e-12}, False),
        ({"alpha_inertial": 0.0}, False),
        ({"gust": -0.0}, True),
        ({"why": "vane held"}, False),
        ({"valid": False}, False),
    ],
)
def test_what_may_be_rounding_of_an_angle(changed: dict[str, object], rounded: bool) -> None:
    assert is_rounding(ALPHA, msgspec.structs.replace(ALPHA, **changed)) is rounded


@pytest.mark.parametrize("status", Status)
def test_what_may_be_rounding_of_a_derivative(status: Status) -> None:
    """A millionth of its standard error; what is not estimated is no result, but for its status and why."""

    def of(value: float, sd: float = 3.0, status: Status = status, why: str = "") -> MethodEstimate:
        return MethodEstimate(5, "II", (ParamEstimate("Cm_q", value, sd, status, why),))

    is_result = status is Status.ESTIMATED
    assert is_rounding(of(-38.0), of(-38.0 + 2.9e-6))
    assert is_rounding(of(-38.0), of(-38.0 + 3.1e-6)) != is_result
    assert is_rounding(of(-38.0), of(-38.0, 3.0 + 3.1e-6)) != is_result
    assert not is_rounding(of(-38.0), of(-38.0, why="turbulence"))
    for other in set(Status) - {status}:
        assert not is_rounding(of(-38.0), of(-38.0, status=other))


def test_other_names_and_kinds_are_no_rounding() -> None:
    assert not is_rounding(estimate(1.0), estimate(1.0, "Cm_de"))
    assert not is_rounding(estimate(1.0), None)
    assert not is_rounding(estimate(1.0), Tick(5, 1, 4))


def replayed(change: float) -> Comparison:
    found, moved = Comparison(), msgspec.structs.replace(ALPHA, alpha=ALPHA.alpha + change)
    found.take(Beat(Tick(5, 0, 4), (), recorded=(ALPHA,)), [moved])
    found.take(Beat(Tick(6, 1, 5), (), recorded=(ALPHA,)), [ALPHA])
    return found


@pytest.mark.parametrize(
    ("told", "differs_at", "code", "words"),
    [
        (0, 9, 3, "rows are missing from the recording before tick 5, and 1 after it differ"),
        (0, 1, 1, "first difference at tick 1"),
        (3, 9, 1, "first difference at tick 9"),
    ],
)
def test_what_rows_that_are_gone_change_is_told_apart_from_a_real_difference(
    told: int, differs_at: int, code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A disk was full for three ticks; the loop itself says which slots it left out."""
    found, moved = Comparison(), msgspec.structs.replace(ALPHA, alpha=1.0)
    for k in (0, 1, 5, 6, 9):
        late = [Event(5, "loop", Code.OVERRUN, told)] if k == 5 else []
        late += [Event(5, "loop", Code.OVERRUN, 2)] if k == 9 else []
        found.take(Beat(Tick(5, k, 4), late, recorded=(ALPHA,)), [moved if k == differs_at else ALPHA])
    assert outcome(found, "") == code
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "machine", "code", "words"),
    [
        (1e-13, "", 1, ["first difference at tick 0"]),
        (1e-13, "processor A recorded, B here", 3, ["as another machine rounds", "processor A recorded, B here"]),
        (
            1e-9,
            "processor A recorded, B here",
            1,
            ["first difference at tick 0", "1 rows differ by more", "processor A recorded, B here"],
        ),
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

"""After an input: enough, again and how often, another input, or out of reach."""

import math

import pytest

from station.flight.verdict import Known, Option, judge, known, obstacles
from station.profile import Condition, Measured, Step, load_aircraft
from station.rows import ParamEstimate, Status

DOUBLET = {"kind": "doublet", "start": "0 s", "amplitude": "2 deg", "width": "1 s"}


def step(**more) -> Step:
    return Step.model_validate({"name": "one", "inputs": [DOUBLET], **more})


def test_errors_fall_with_the_root_of_the_runs() -> None:
    """20 % after one run, 10 % wanted: four runs in all. With 6 % that no run takes away, (0.2^2 - 0.06^2)/(0.1^2 -
    0.06^2) = 5.7 runs in all."""
    assert Known("Cm_q", 0.2, 0.1, 0.0).runs(1) == 3
    assert Known("Cm_q", 0.2, 0.1, 0.06).runs(1) == 5
    assert Known("Cm_q", 0.2, 0.1, 0.0).runs(2) == 6


@pytest.mark.parametrize(
    ("have", "flown", "kind", "words"),
    [
        (0.05, 1, "enough", "enough"),
        (0.12, 1, "repeat", "repeat once more: Cm_q is known to 12 %, 10 % wanted"),
        (0.2, 1, "spent", "next: all 1 runs"),
        (math.inf, 1, "repeat", "repeat once more: Cm_q is known not (no elevator input), 10 % wanted"),
    ],
)
def test_what_comes_next(have: float, flown: int, kind: str, words: str) -> None:
    flies = step(accept={"Cm_q": "10 %"}, repeats=1 if kind == "spent" else 3)
    found = [Known("Cm_q", have, 0.1, 0.0, "no elevator input")]
    verdict = judge(flies, flown, found, [], {})
    assert verdict.kind == kind
    assert words in verdict.words


def test_another_input_is_named_where_it_takes_fewer_runs() -> None:
    flies = step(accept={"Cm_q": "10 %"}, repeats=3)
    found = [Known("Cm_q", 0.4, 0.1, 0.0)]  # 15 runs more
    better = {"Cm_q": Option("two 3-2-1-1 of 0.4 s units", 0.5)}
    verdict = judge(flies, 1, found, [], better)
    assert verdict.kind == "change"
    assert verdict.words.startswith("fly two 3-2-1-1 of 0.4 s units, 4 times")
    assert judge(flies, 1, found, [], {"Cm_q": Option("x", 0.95)}).kind == "repeat"


def test_what_was_not_as_wanted_is_flown_again_whatever_is_known() -> None:
    flies = step(accept={"Cm_q": "10 %"}, repeats=2)
    found = [Known("Cm_q", 0.05, 0.1, 0.0)]
    assert judge(flies, 1, found, ["the air was severe, calm is wanted"], {}).words.startswith("repeat: the air was")
    assert judge(flies, 2, found, ["the air was severe, calm is wanted"], {}).kind == "spent"


def test_what_mass_and_inertia_leave_cannot_be_flown_away() -> None:
    """The Twin Otter's inertia is known to 6 %: twice that of every moment derivative."""
    aircraft = load_aircraft("twin_otter")
    flies = step(accept={"Cm_q": "10 %", "CL_alpha": "7 %"})
    signals = ("alpha_vane", "airspeed", "q", "ax", "az", "elevator")
    assert obstacles(flies, aircraft, signals) == ["Cm_q to 10 %: mass and inertia of the profile leave 12 %"]
    unseen = obstacles(step(accept={"Cl_p": 0.2}), aircraft, signals)
    assert unseen[0] == "no aileron, ay, beta_vane, p, r, rudder"
    told = {"points": 3, "condition": "baseline, flaps up", "lowest_speed": "50 m/s", "highest_speed": "60 m/s"}
    held = aircraft.model_copy(update={"measured": Measured.model_validate(told)})
    slow = flies.model_copy(update={"accept": {}, "condition": Condition(configuration="flaps 20")})
    assert obstacles(slow, held, signals) == [
        "flaps 20, the baseline flaps up: what that changes would be told as changed"
    ]
    assert obstacles(slow, aircraft, signals) == []
    p = ParamEstimate("Cm_q", -35.0, 2.8, Status.ESTIMATED, "")
    verdict = judge(flies, 1, known(step(accept={"Cm_q": "10 %"}), {"Cm_q": p}, {"Cm_q": 0.12}), [], {})
    assert verdict.kind == "beyond"
    assert verdict.known[0].have == pytest.approx(0.16)

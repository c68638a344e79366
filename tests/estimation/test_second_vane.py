"""A second vane: brought to the first one's place by closed form, told where they disagree, in reserve for it."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from station.conventions import SIGNALS, TICK_NS
from station.estimation.second_vane import SecondVane, second_vanes
from station.identification.vanes_compared import in_reserve
from station.log import Table
from station.profile import elsewhere, load_aircraft, load_rig
from station.profile.declared import DeclaredSignal
from station.rows import AlphaEstimate, Code, Event, Frame, Quality

AIRCRAFT = load_aircraft("twin_otter")
PLACE = (1.0, -3.0, 0.0)
SPEED, NAN = 57.0, math.nan
DEG = math.pi / 180


def shown(k: int, place: tuple[float, float, float]) -> float:
    """A vane there, of a pitching and rolling aircraft: alpha less what the rates make of its place."""
    boom = AIRCRAFT.boom
    assert boom is not None
    t, q, p = k * 0.02, *rates(k)
    body = 1 + boom.upwash_body
    alpha = 0.05 + 0.03 * math.sin(1.5 * t)
    return (body + boom.upwash_wing) * alpha - body * (q * place[0] - p * place[1]) / SPEED


def rates(k: int) -> tuple[float, float]:
    t = k * 0.02
    return 0.2 * math.sin(2 * t), 0.3 * math.cos(1.1 * t)


def frame(k: int, first: float, second: float) -> Frame:
    values = dict.fromkeys(SIGNALS, NAN)
    q, p = rates(k)
    values |= {"alpha_vane": first, "q": q, "p": p, "airspeed": SPEED, "alpha_2": second}
    row = tuple(values.values())
    fresh = int(Quality.FRESH)
    marks = tuple(fresh if math.isfinite(v) else int(Quality.MISSING) for v in row)
    return Frame(k * TICK_NS, k, row, (0.0,) * len(row), marks)


def flown(vane: SecondVane, seconds: range, error: float = 0.0, first: bool = True) -> list[Event]:
    """What is told; `error` of the second vane, rad; the motion agrees with the first."""
    boom = AIRCRAFT.boom
    assert boom is not None
    place = (boom.vane_x, boom.vane_y, boom.vane_z)
    said: list[Event] = []
    for k in range(50 * seconds.start, 50 * seconds.stop):
        here = shown(k, place)
        seen = vane.seen(frame(k, here if first else NAN, shown(k, PLACE) + error))
        assert seen.values[SIGNAL_AT] == pytest.approx(here, abs=1e-9 if first else error * 1.05 + 1e-9)
        said += vane.step(seen, alpha(k))
    return said


SIGNAL_AT = list(SIGNALS).index("alpha_vane")


def alpha(k: int) -> AlphaEstimate:
    made = AlphaEstimate(k * TICK_NS, 0.05, 0.001, *(NAN,) * 10, "calm", NAN, NAN, NAN, True, "")
    return msgspec.structs.replace(made, alpha_inertial=0.05)


def one() -> SecondVane:
    (made,) = second_vanes({"alpha_2": PLACE}, {"alpha_2": len(SIGNALS)}, AIRCRAFT)
    return made


def test_at_another_place_it_shows_the_same_in_pitch_and_roll() -> None:
    assert flown(one(), range(20)) == []


def test_a_disagreement_is_told_with_the_one_that_the_motion_agrees_with_and_its_end() -> None:
    vane = one()
    said = [*flown(vane, range(20)), *flown(vane, range(20, 40), 1.5 * DEG), *flown(vane, range(40, 60))]
    assert [(e.source, e.code) for e in said] == [("alpha_2.bias", Code.DISAGREE), ("alpha_2.bias", Code.AGREE)]
    assert 20 < said[0].t_ns * 1e-9 < 24
    assert said[0].detail.endswith("deg high against alpha_vane: the motion agrees with alpha_vane")


def test_it_stands_in_less_what_they_differed_by() -> None:
    """0.3 deg of zero, within the tolerance, is known after 20 s; the first vane's value is met without it."""
    vane = one()
    flown(vane, range(20), 0.3 * DEG)
    lost = []
    for k in range(1000, 1200):
        seen = vane.seen(frame(k, NAN, shown(k, PLACE) + 0.3 * DEG))
        boom = AIRCRAFT.boom
        assert boom is not None
        assert seen.values[SIGNAL_AT] == pytest.approx(shown(k, (boom.vane_x, boom.vane_y, 0.0)), abs=1e-9)
        assert seen.quality[SIGNAL_AT] == int(Quality.FRESH)
        lost += vane.step(seen, alpha(k))
    assert [e.detail.partition(":")[0] for e in lost] == ["alpha_vane is missing"]
    nothing = vane.seen(frame(1200, NAN, NAN))
    assert math.isnan(nothing.values[SIGNAL_AT])


def test_afterwards_too() -> None:
    boom = AIRCRAFT.boom
    assert boom is not None
    k = np.arange(500)
    first = np.array([shown(i, (boom.vane_x, boom.vane_y, 0.0)) for i in k])
    second = np.array([shown(i, PLACE) for i in k]) + 0.8 * DEG
    q, p = np.array([rates(i) for i in k]).T
    there = np.where((k > 100) & (k < 200), NAN, first)
    columns = {"alpha_vane": there, "alpha_2": second, "q": q, "p": p, "airspeed": np.full(500, SPEED)}
    made, said = in_reserve(Table(k * 0.02, columns, AIRCRAFT, 0), {"alpha_2": PLACE}, AIRCRAFT)
    np.testing.assert_allclose(made.columns["alpha_vane"], first, atol=1e-9)
    assert said == [
        "alpha_vane is missing in 19.8% of the rows: alpha_2 stands in for it there",
        "alpha_2 is +0.80 deg off alpha_vane, 0.00 deg rms about that: the two vanes DISAGREE, by +0.8 deg at worst, "
        "first at 0 s",
    ]


def test_a_rig_says_which_it_is() -> None:
    declared = DeclaredSignal.model_validate(
        {"unit": "deg", "measures": "alpha_vane", "position": ["1 m", "-3 m", "0 m"]}
    )
    assert elsewhere({**load_rig("instrumented").signals, "alpha_2": declared}, "alpha_vane") == {"alpha_2": PLACE}

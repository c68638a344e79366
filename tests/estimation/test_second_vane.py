"""A second vane: brought to the first one's place by closed form, told where they disagree, in reserve for it."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from station import profile
from station.conventions import SIGNALS, TICK_NS
from station.estimation.second_vane import SecondVane, second_vanes
from station.identification.vanes_compared import in_reserve
from station.log import Table
from station.profile import Aircraft, elsewhere, load_aircraft, load_rig
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


def on_both_tips(averaged: bool) -> Aircraft:
    """The second vane on the left tip, of more upwash than the first on the right one."""
    assert AIRCRAFT.boom is not None
    first = AIRCRAFT.boom.model_copy(update={"vane_y": 9.9})
    keys = {**dict(first), "vane_y": -9.9, "upwash_body": 0.2, "averaged": averaged}
    own = profile.SecondVane.model_construct(**keys)
    return AIRCRAFT.model_copy(update={"boom": first, "second_vane": own})


def abreast(aircraft: Aircraft, right: np.ndarray, left: np.ndarray) -> dict[str, np.ndarray]:
    """What both show of a flight that pitches and rolls, with these gusts at either, rad."""
    assert aircraft.boom is not None
    columns = {n: np.empty(len(right)) for n in ("alpha_vane", "alpha_2", "q", "p", "airspeed")}
    for k in range(len(right)):
        q, p = rates(k)
        alpha = 0.05 + 0.03 * math.sin(0.03 * k)
        row = [q, p, SPEED]
        for vane, gust in ((aircraft.boom, right[k]), (aircraft.second_vane, left[k])):
            assert vane is not None
            body = 1 + vane.upwash_body
            turned = body * (q * vane.vane_x - p * vane.vane_y) / SPEED
            row.insert(0, (body + vane.upwash_wing) * (alpha + gust) - turned)
        for name, value in zip(("alpha_2", "alpha_vane", "q", "p", "airspeed"), row, strict=True):
            columns[name][k] = value
    return columns


@pytest.mark.parametrize("averaged", [False, True])
def test_the_mean_of_both_tips_shows_the_gust_in_the_middle(averaged: bool) -> None:
    """By closed form: half the sum of two gusts, as the first vane shows it; and live the same after a minute."""
    aircraft, t = on_both_tips(averaged), 0.02 * np.arange(6000)
    right, left = 0.01 * np.sin(5 * t), 0.01 * np.sin(3.1 * t)
    columns = abreast(aircraft, right, left)
    wanted = abreast(aircraft, 0.5 * (right + left), left)["alpha_vane"] if averaged else columns["alpha_vane"]
    place = (5.3, -9.9, 0.0)
    made, said = in_reserve(Table(t, columns, aircraft, 0), {"alpha_2": place}, aircraft)
    np.testing.assert_allclose(made.columns["alpha_vane"], wanted, atol=1e-4)
    assert any("mean of both vanes" in words for words in said) is averaged
    (vane,) = second_vanes({"alpha_2": place}, {"alpha_2": len(SIGNALS)}, aircraft)
    shown = [
        vane.seen(frame(k, columns["alpha_vane"][k], columns["alpha_2"][k])).values[SIGNAL_AT] for k in range(len(t))
    ]
    np.testing.assert_allclose(shown[3000:], wanted[3000:], atol=5e-4)


def test_gusts_across_a_span_are_no_disagreement() -> None:
    """Gusts that pass within the span, 1 deg rms of difference, and the same beside 1.5 deg of zero: the second alone
    is told."""
    aircraft, rng = on_both_tips(True), np.random.default_rng(4)
    n, keep = 6000, math.exp(-0.02 * SPEED / 19.8)
    gusts = np.empty((2, n))
    for gust in gusts:
        white, gust[0] = rng.standard_normal(n), 0.0
        for k in range(1, n):
            gust[k] = keep * gust[k - 1] + math.sqrt(1 - keep * keep) * white[k]
    columns = abreast(aircraft, *(math.radians(0.7) * gusts))
    for off, told in ((0.0, False), (1.5, True)):
        moved = columns | {"alpha_2": columns["alpha_2"] + math.radians(off)}
        _, said = in_reserve(Table(0.02 * np.arange(n), moved, aircraft, 0), {"alpha_2": (5.3, -9.9, 0.0)}, aircraft)
        assert any("DISAGREE" in words for words in said) is told
        assert any("mean of both" in words for words in said) is not told

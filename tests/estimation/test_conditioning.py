"""Which values of a frame count, for how long a lost one is held, and the dynamic pressure, case by case."""

import math

import numpy as np
import pytest

from station.conventions import SIGNALS, TICK_NS
from station.estimation import conditioning as cond
from station.estimation.conditioning import Conditioner
from station.rows import Frame, Quality

FLIGHT = {"alpha_vane": 0.1, "q": 0.02, "airspeed": 50.0, "az": -9.8, "ax": 0.5, "elevator": -0.05, "p": 0.01}


def frame(k, values, ages=None, quality=None):
    """These signals fresh but where `ages` and `quality` say otherwise, all others missing."""
    ages, quality = ages or {}, quality or {}
    return Frame(
        k * TICK_NS,
        k,
        tuple(values.get(n, math.nan) for n in SIGNALS),
        tuple(ages.get(n, 0.0 if n in values else math.nan) for n in SIGNALS),
        tuple(int(quality.get(n, Quality.FRESH if n in values else Quality.MISSING)) for n in SIGNALS),
    )


def moving(k):
    """Every signal moves, each tick by another amount."""
    return {name: value + 0.001 * math.sin(k + i) for i, (name, value) in enumerate(FLIGHT.items())}


def test_what_is_measured_now_is_used_as_it_is():
    c = Conditioner({})
    assert c.step(frame(0, FLIGHT)) == cond.FRESH
    assert c.u[cond.VANE] == 0.1
    assert c.u[cond.P] == 0.01
    assert math.isnan(c.u[cond.ALTITUDE])
    assert c.why(cond.FRESH) == ""


@pytest.mark.parametrize(("name", "code"), [("alpha_vane", cond.HELD), ("q", cond.HELD), ("az", cond.PARTLY)])
def test_a_value_of_an_earlier_time_is_marked(name, code):
    c = Conditioner({})
    assert c.step(frame(0, FLIGHT, ages={name: 0.04})) == code
    assert c.why(code) == (f"{name} held" if code == cond.HELD else "")


@pytest.mark.parametrize(
    "lost",
    [
        lambda k: frame(k, {n: v for n, v in moving(k).items() if n != "q"}),
        lambda k: frame(k, moving(k) | {"q": 1e6}),
        lambda k: frame(k, moving(k), quality={"q": Quality.SUSPECT}),
        lambda k: frame(k, moving(k), ages={"q": 3.0}),
    ],
    ids=["missing", "impossible", "suspect", "too old"],
)
def test_a_lost_value_is_held_for_a_fifth_of_a_second(lost):
    c = Conditioner({})
    c.step(frame(0, moving(0)))
    kept = moving(0)["q"]
    for k in range(1, 11):
        assert c.step(lost(k)) == cond.HELD
        assert c.u[cond.Q] == kept
    code = c.step(lost(11))
    assert code == cond.LOST + cond.Q
    assert c.why(code) == "q missing"
    assert math.isnan(c.u[cond.Q])
    assert c.step(frame(12, moving(12))) == cond.FRESH


def test_below_flying_speed():
    c = Conditioner({})
    code = c.step(frame(0, FLIGHT | {"airspeed": 5.0}))
    assert code == cond.SLOW
    assert "airspeed below" in c.why(code)


def test_a_signal_that_repeats_itself_while_others_move_is_frozen():
    c = Conditioner({"q": 1e-4})
    codes = [c.step(frame(k, moving(k) | {"q": 0.02})) for k in range(20)]
    # The first sample, and 13 ticks that repeat it.
    assert codes == [cond.FRESH] * 13 + [cond.FROZEN + cond.Q] * 7
    assert c.why(codes[-1]) == "q frozen"


def test_on_the_ground_where_nothing_moves_nothing_is_frozen():
    c = Conditioner({"q": 1e-4})
    assert {c.step(frame(k, FLIGHT)) for k in range(40)} == {cond.FRESH}


@pytest.mark.parametrize(
    ("given", "density", "expected"),
    [
        ({"dynamic_pressure": 1400.0, "altitude": 0.0}, 1.0, 1400.0),
        ({"altitude": 0.0}, 1.1, 0.5 * 1.1 * 50.0**2),
        ({"static_pressure": 90000.0, "air_temperature": 280.0}, math.nan, 0.5 * 90000 / (287.05287 * 280) * 50.0**2),
        # ISA troposphere: 1.225 (1 - 0.0065 h/288.15)^4.25588.
        ({"altitude": 1500.0}, math.nan, 0.5 * 1.225 * (1 - 0.0065 * 1500 / 288.15) ** 4.25588 * 50.0**2),
        ({}, math.nan, math.nan),
    ],
    ids=["measured", "of the profile", "of static air data", "of altitude", "unknown"],
)
def test_dynamic_pressure_is_of_the_best_there_is(given, density, expected):
    u = np.full(len(cond.INPUTS), math.nan)
    u[cond.AIRSPEED] = 50.0
    for name, value in given.items():
        u[cond.INPUTS.index(name)] = value
    assert cond.dynamic_pressure(u, density) == pytest.approx(expected, rel=1e-4, nan_ok=True)

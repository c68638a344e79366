"""The change monitor: false alarms of its sum as often as it is set for, and a rise of drag told in time."""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from station.clock import ManualClock
from station.conventions import G0, SIGNAL_INDEX, SIGNALS, TICK_NS
from station.estimation.change_monitor import ChangeMonitor, SlopeWatch
from station.estimation.drag_watch import limit_of_sum
from station.estimation.methods import Estimator
from station.flight.board import Board
from station.flight.chain import FORGETTING_S, forgetting_s
from station.profile import Aircraft, Card, Measured, ThrustTable, load_aircraft
from station.profile.quantity import SI_NUMBERS
from station.rows import AlphaEstimate, Code, Event, Frame, MethodEstimate, ParamEstimate, Quality, Status

SPEED, ALPHA, QBAR = 56.6, 0.06, 1800.0
MEASURED = {"points": 3, "lowest_speed": 56.0, "highest_speed": 57.0, "CD_0": 0.04, "CD_0_sd": 1e-4}
SDS = {"CL_alpha": 0.05, "CL_q": 2.0, "CL_de": 0.02, "Cm_alpha": 0.03, "Cm_q": 1.2, "Cm_de": 0.015}


def aircraft(**measured: object) -> Aircraft:
    made = load_aircraft("twin_otter")
    known = {n: d.model_copy(update={"sd": SDS.get(n, d.sd)}) for n, d in made.derivatives.items()}
    stated = Measured.model_validate({**MEASURED, **measured}, context=SI_NUMBERS)
    return made.model_copy(update={"derivatives": known, "measured": stated})


def flight(drags: list[float], thrust: float = 4000.0) -> Iterator[tuple[Frame, AlphaEstimate]]:
    """Level flight in which CD_0 is `drags`, 10 s each: forces by the definition of the coefficients."""
    own = load_aircraft("twin_otter")
    mass, force = own.inertia.mass, QBAR * own.geometry.wing_area
    lift = (mass * G0 - thrust * math.sin(ALPHA)) / force
    for k in range(500 * len(drags)):
        drag = drags[k // 500] + 0.045 * lift**2
        values = dict.fromkeys(SIGNALS, math.nan)
        values |= {"airspeed": SPEED, "dynamic_pressure": QBAR, "thrust": thrust}
        values["ax"] = (force * (lift * math.sin(ALPHA) - drag * math.cos(ALPHA)) + thrust) / mass
        values["az"] = -force * (drag * math.sin(ALPHA) + lift * math.cos(ALPHA)) / mass
        row = tuple(values[n] for n in SIGNALS)
        frame = Frame(k * TICK_NS, k, row, (0.0,) * len(row), (int(Quality.FRESH),) * len(row))
        nan = math.nan
        yield frame, AlphaEstimate(k * TICK_NS, ALPHA, 0.001, *(nan,) * 10, "calm", nan, nan, nan, True, "")


def shows(frame: Frame, **signals: float) -> Frame:
    """The frame with these signals as given."""
    values = list(frame.values)
    for name, value in signals.items():
        values[SIGNAL_INDEX[name]] = value
    return msgspec.structs.replace(frame, values=tuple(values))


def level_lift() -> float:
    """CL of `flight`."""
    own = load_aircraft("twin_otter")
    return (own.inertia.mass * G0 - 4000.0 * math.sin(ALPHA)) / (QBAR * own.geometry.wing_area)


def told(monitor: ChangeMonitor, drags: list[float]) -> list[Event]:
    return [e for frame, alpha in flight(drags) for e in monitor.step(frame, alpha, ())]


@pytest.mark.parametrize("shift", [0.5, 1.0, 2.0])
def test_the_sum_gives_false_alarms_as_often_as_it_is_set_for(shift: float) -> None:
    """Once in 200 normal values on average: 400 runs, whose mean has an error of 5 %; Siegmund's approximation of few
    values is a quarter off where the shift is as large as the values' scatter."""
    rng = np.random.default_rng(3)
    limit = limit_of_sum(shift, 200.0)
    runs = []
    for _ in range(400):
        total, n = 0.0, 0
        while total <= limit:
            total, n = max(0.0, total + rng.standard_normal() - shift), n + 1
        runs.append(n)
    assert 0.7 * 200 < np.mean(runs) < 1.7 * 200


def test_drag_that_rises_is_told_and_what_it_may_be() -> None:
    rng = np.random.default_rng(4)
    monitor = ChangeMonitor(aircraft(), 120.0)
    events = told(monitor, (0.04 + 0.0008 * rng.standard_normal(60)).tolist())
    assert events == []
    more = (0.04 * 1.5 + 0.0008 * rng.standard_normal(6)).tolist()
    found = [e for e in told(monitor, more) if e.code is Code.CHANGED]
    assert len(found) == 1
    assert found[0].t_ns <= 20e9  # within two means
    assert found[0].detail.startswith("drag +")
    assert "ice" in found[0].detail
    assert monitor.drag.change is not None
    assert monitor.drag.change[0] == pytest.approx(0.5, abs=0.03)
    over = told(monitor, [0.04] * 30)
    assert [e.code for e in over if e.code is Code.UNCHANGED] == [Code.UNCHANGED]


def test_without_thrust_it_says_that_drag_is_not_watched() -> None:
    """Ice without an input comes while thrust is lost for 50 s: no change is told; that it would not be is, once, with
    why and what is still watched, and its end."""
    known = iter([True] * 1500 + [False] * 2500 + [True] * 1000)
    monitor = ChangeMonitor(
        aircraft(), 120.0, thrust=lambda: (4000.0, "") if next(known) else (math.nan, "no engine_speed")
    )
    said = told(monitor, [0.04] * 3 + [0.04] + [0.08] * 3 + [0.04] * 3)
    assert [(e.source, e.code, round(e.t_ns * 1e-9)) for e in said] == [
        ("drag", Code.UNWATCHED, 40),
        ("drag", Code.WATCHED, 90),
    ]
    assert said[0].detail.startswith("no engine_speed: drag is NOT watched")
    assert "derivatives still are" in said[0].detail
    without = ChangeMonitor(aircraft(), 120.0)
    never = [e for f, a in flight([0.04] * 3) for e in without.step(shows(f, thrust=math.nan), a, ())]
    assert [(e.code, e.detail.partition(":")[0]) for e in never] == [(Code.UNWATCHED, "thrust is not recorded")]
    assert without.drag.change is None
    assert not ChangeMonitor(aircraft(CD_0=None), 120.0).drag.is_on


def test_thrust_that_comes_less_than_half_the_time_leaves_drag_unwatched() -> None:
    """4 s of each 10, of which no mean is made."""
    thrusts = ((4000.0, "") if k % 500 < 200 else (math.nan, "no thrust") for k in range(2000))
    monitor = ChangeMonitor(aircraft(), 120.0, thrust=lambda: next(thrusts))
    assert [e.code for e in told(monitor, [0.08] * 4)] == [Code.UNWATCHED]


def test_drag_before_the_thrust_was_lost_says_nothing_of_what_comes_after() -> None:
    """An unchanged drag tells ice from a lost elevator, but not one of a minute ago."""
    known = iter([True] * 1500 + [False] * 1500)
    monitor = ChangeMonitor(aircraft(), 120.0, thrust=lambda: (4000.0 if next(known) else math.nan, "no thrust"))
    list(told(monitor, [0.04] * 3))
    assert monitor.drag.change is not None
    list(told(monitor, [0.04] * 3))
    assert monitor.drag.change is None


def test_the_engine_s_thrust_tells_drag_and_its_table_s_end_is_told() -> None:
    """Through the estimator, whose thrust it is: an engine of 4000 N at its setting, then beyond its table."""
    engine = ThrustTable.model_validate(
        {"kind": "table", "signal": "engine_speed", "settings": [0.2, 1.0], "speeds": [40.0, 80.0],
         "altitudes": [0.0], "thrust": [[[2000.0, 2000.0]], [[6000.0, 6000.0]]]}, context=SI_NUMBERS
    )  # fmt: skip
    own = aircraft().model_copy(update={"engine": engine})
    estimator = Estimator(own, Card(name="t", aircraft="", rig=""), methods=("II",))
    monitor, said = ChangeMonitor(own, 120.0, thrust=estimator.thrust), []
    for frame, alpha in flight([0.04] * 2 + [0.06] * 3 + [0.04] * 2):
        shown = shows(frame, thrust=math.nan, engine_speed=0.6 if frame.t_ns < 50e9 else 1.1)
        estimator.step(shown)
        said += monitor.step(shown, alpha, ())
    assert [e.code for e in said] == [Code.CHANGED, Code.UNWATCHED]
    assert said[0].detail.startswith("drag +")
    assert said[0].t_ns <= 50e9
    assert said[1].detail.startswith("the engine's table is exceeded (engine_speed 1.1, 56.6 m/s)")
    assert "told before stands" in said[1].detail


def test_without_angle_of_attack_it_says_that_it_sees_nothing() -> None:
    """Ice that comes while the vane is lost is no change that is told; that it would not be is, once, and its end."""
    monitor, said = ChangeMonitor(aircraft(), 120.0), []
    for frame, alpha in flight([0.04] * 3 + [0.08] * 3 + [0.04] * 3):
        lost = 30e9 <= frame.t_ns < 60e9
        said += monitor.step(frame, msgspec.structs.replace(alpha, valid=not lost), ())
    assert [(e.code, round(e.t_ns * 1e-9)) for e in said] == [(Code.UNWATCHED, 40), (Code.WATCHED, 60)]
    assert "would NOT be noticed" in said[0].detail
    board = Board(None, ManualClock(0))
    board.update(said[:1])
    assert [e.code for e in board.disagreements] == [Code.UNWATCHED]
    board.update(said[1:])
    assert board.disagreements == []
    unseen = ChangeMonitor(aircraft(), 120.0)
    none_yet = [unseen.step(f, msgspec.structs.replace(a, valid=False), ()) for f, a in flight([0.04] * 2)]
    assert not any(none_yet)  # before there was one, the start says what is waited for


@pytest.mark.parametrize("error", [0.85, -0.85])
def test_a_vane_whose_zero_has_moved_is_no_ice(error: float) -> None:
    """By 0.85 deg of angle of attack: 26 % of drag more or less, and -+0.085 of CL_0 (5.74 by 0.0148 rad). One that
    shows too little hides as much ice. The derivatives are as they were."""
    own = aircraft(CL_0=level_lift() - 5.66 * ALPHA - 0.608 * -0.02, CL_0_sd=0.002)
    monitor, said = ChangeMonitor(own, 120.0), []
    for frame, alpha in flight([0.04] * 18):
        wrong = ALPHA + (math.radians(error) if frame.t_ns >= 60e9 else 0.0)
        seen = msgspec.structs.replace(alpha, alpha=wrong)
        said += monitor.step(shows(frame, q=0.0, elevator=-0.02, mass=4962.0), seen, of_physical({}))
    assert {e.code for e in said} == {Code.CHANGED}
    assert said[0].t_ns <= 90e9
    assert "a vane whose zero has moved" in said[-1].detail
    assert "ice" not in said[-1].detail
    assert "attitude against flight path" in said[-1].detail


def test_ice_moves_no_vane() -> None:
    own = aircraft(CL_0=level_lift() - 5.66 * ALPHA - 0.608 * -0.02, CL_0_sd=0.002)
    monitor, said = ChangeMonitor(own, 120.0), []
    for frame, alpha in flight([0.04] * 6 + [0.052] * 12):
        said += monitor.step(shows(frame, q=0.0, elevator=-0.02, mass=4962.0), alpha, ())
    assert "ice" in said[0].detail
    assert "vane" not in said[-1].detail


def test_a_slope_that_is_off_is_no_vane_at_another_speed() -> None:
    """A baseline at 76 m/s whose CL_alpha is 1.7 of its sds off: 3 deg more angle of attack at 56.6 m/s, times 0.5, is
    -0.026 of CL_0, as of a vane 0.26 deg off; at the baseline's own speed that is no slope's doing."""
    for speed, is_told in ((76.0, False), (SPEED, True)):
        zero = level_lift() - 5.66 * ALPHA - 0.608 * -0.02 + 0.026
        own = aircraft(CL_0=zero, CL_0_sd=0.002, lowest_speed=speed, highest_speed=speed)
        doubted = own.derivatives["CL_alpha"].model_copy(update={"sd": 0.3})
        own = own.model_copy(update={"derivatives": {**own.derivatives, "CL_alpha": doubted}})
        monitor, said = ChangeMonitor(own, 120.0), []
        for frame, alpha in flight([0.04] * 18):
            said += monitor.step(shows(frame, q=0.0, elevator=-0.02, mass=4962.0), alpha, of_physical({}))
        assert bool(said) is is_told, speed


def of_physical(values: dict[str, float], sd: float = 0.005) -> tuple[MethodEstimate, ...]:
    own = load_aircraft("twin_otter")
    parameters = tuple(
        ParamEstimate(n, values.get(n, own.value(n)), math.hypot(sd, 0.06 if n[1] == "m" else 0.03) * abs(own.value(n)),
                      Status.ESTIMATED, "")
        for n in SDS
    )  # fmt: skip
    return (MethodEstimate(0, "physical", parameters, True, ""),)


def test_a_derivative_that_has_changed_is_told_when_it_has_stood_off_for_5_s() -> None:
    monitor = ChangeMonitor(aircraft(), 120.0)
    said = []
    for frame, alpha in flight([0.04]):
        lost = {"Cm_de": -1.74 * 0.8, "CL_de": 0.608 * 0.8}
        said += monitor.step(frame, alpha, of_physical(lost if frame.t_ns > 3e9 else {}))
    assert len(said) == 1
    assert 8.0 <= said[0].t_ns * 1e-9 <= 9.0  # judged once a second
    assert "an elevator that has lost effect" in said[0].detail
    assert "To confirm" in said[0].detail


def test_what_flight_and_baseline_share_hides_no_change() -> None:
    """Cm_de -8 %, known to 30 % with all that the model may be wrong by, but to 0.5 % against the baseline."""
    lost = of_physical({"Cm_de": -1.74 * 0.92}, sd=0.3)
    errors = {n: 0.005 * abs(load_aircraft("twin_otter").value(n)) for n in SDS}
    for monitor, events in (
        (ChangeMonitor(aircraft(), 120.0, lambda: errors), 1),
        (ChangeMonitor(aircraft(), 120.0), 0),
    ):
        assert len([e for frame, alpha in flight([0.04]) for e in monitor.step(frame, alpha, lost)]) == events


def test_it_is_said_again_when_one_is_left_of_several() -> None:
    """Drag +20 % is any ice; with CL_alpha -4 % and the elevator as it was it is the wing's."""
    monitor = ChangeMonitor(aircraft(), 120.0)
    wing = of_physical({"CL_alpha": 5.66 * 0.96})
    said = [
        e.detail
        for frame, alpha in flight([0.048] * 12)
        for e in monitor.step(frame, alpha, wing if frame.t_ns > 40e9 else ())
    ]
    assert len(said) == 2
    assert "not told from" in said[0]
    assert "as by ice on the wing" in said[1]
    assert "not told from" not in said[1]


def test_the_limit_of_derivatives_goes_with_how_often_they_are_looked_at() -> None:
    slow, fast = SlopeWatch(aircraft(), 600.0, dict).limit, SlopeWatch(aircraft(), 20.0, dict).limit
    assert 3.5 < slow < fast < 5.0


def test_live_estimates_forget_where_there_is_a_baseline() -> None:
    card = Card(name="t", aircraft="", rig="")
    assert forgetting_s(load_aircraft("twin_otter"), card) == math.inf
    assert forgetting_s(aircraft(), card) == FORGETTING_S
    assert forgetting_s(aircraft(), card.model_copy(update={"forgetting": 45.0})) == 45.0


def test_the_operator_sees_it_until_it_is_over() -> None:
    board = Board(None, ManualClock(0))
    board.update([Event(1, "aircraft", Code.CHANGED, 1, "drag +24±5 %: as by ice on the wing")])
    assert [e.code for e in board.disagreements] == [Code.CHANGED]
    board.update([Event(2, "aircraft", Code.UNCHANGED, 1, "as the baseline again")])
    assert board.disagreements == []

"""Drag, and changes against a measured baseline in per cent, on the terminal, the page and in JSON lines."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from station.clock import ManualClock
from station.conventions import LONGITUDINAL, SIGNAL_INDEX, SIGNALS
from station.flight.board import Board
from station.profile import Derivative, Measured, Profiles, load_card
from station.rows import AlphaEstimate, Frame, MethodEstimate, ParamEstimate, Rows, Status, Tick
from station.screen import drag_plot
from station.screen import terminal as panel
from station.screen.brief import brief
from station.screen.glance_feed import content
from station.screen.page_words import first_words
from station.screen.plots import Setup
from station.screen.rerun_feed import setup_for
from tests.screen.a_board import ALPHA, START_NS, seconds

BASE = 0.04
HELD = {"points": 3, "condition": "", "lowest_speed": "50 m/s", "highest_speed": "60 m/s", "CD_0": BASE}
QBAR, MASS = 1800.0, 4900.0
AGES, FRESH = (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)


def profiles(**more: object) -> Profiles:
    made = load_card("bench")
    known = {n: Derivative(value=5.0, sd=0.1) for n in LONGITUDINAL}
    aircraft = made.aircraft.model_copy(
        update={"measured": Measured.model_validate({**HELD, **more}), "derivatives": known}
    )
    return made.model_copy(update={"aircraft": aircraft})


def rows(held: Profiles, drag: float, begin_s: float, end_s: float, *, thrust: bool = True) -> list[Rows]:
    """Level flight in which thrust balances this CD_0 and the induced drag: T cos alpha = (CD_0 + k CL^2) qbar S."""
    aircraft, alpha = held.aircraft, math.radians(4.0)
    assert aircraft.drag is not None
    force = QBAR * aircraft.geometry.wing_area
    lift = 0.7
    along = (drag + aircraft.drag.induced * lift**2) * force / math.cos(alpha)
    values = [math.nan] * len(SIGNALS)
    given = {"airspeed": 56.0, "dynamic_pressure": QBAR, "thrust": along if thrust else math.nan, "mass": MASS}
    # Specific force across the path is lift and the thrust's part of it; along the path there is none.
    up = (lift * force + along * math.sin(alpha)) / MASS
    given |= {"ax": up * math.sin(alpha), "az": -up * math.cos(alpha)}
    for name, value in given.items():
        values[SIGNAL_INDEX[name]] = value
    made: list[Rows] = []
    for k in range(round(begin_s * 50), round(end_s * 50)):
        t = START_NS + k * 20_000_000
        made.append(Tick(t, k, t))
        made.append(Frame(t, k, tuple(values), AGES, FRESH))
        made.append(msgspec.structs.replace(ALPHA, t_ns=t, alpha=alpha))
    return made


def derivatives(value: float, sd: float) -> MethodEstimate:
    found = tuple(ParamEstimate(n, value, sd, Status.ESTIMATED, "") for n in LONGITUDINAL)
    return MethodEstimate(START_NS, "physical", found)


def board(held: Profiles, *given: Rows) -> Board:
    made = Board(held, ManualClock(seconds(60)))
    made.update(given)
    return made


def line(made: Board, name: str, width: int = 80, height: int = 24) -> str:
    shown = [x.plain for x in panel.lines(made, seconds(60), width, height, None)]
    assert len(shown) == height
    assert all(len(x) <= width for x in shown)
    return next((x for x in shown if x.split()[:1] == [name]), "")


def test_cd_0_is_shown_with_its_error_and_change_on_80_by_24() -> None:
    held = profiles()
    made = board(held, *rows(held, 0.05, 0, 41))
    words = line(made, "CD_0").split()
    assert float(words[1]) == pytest.approx(0.05, abs=1e-4)
    assert words[2] == "±"
    assert "+25±" in line(made, "CD_0")
    assert "baseline 0.0400" in line(made, "CD_0")
    assert line(made, "Cm_de")
    drag = made.snapshot()["baseline"]
    assert drag["CD_0"]["estimate"] == pytest.approx(0.05, abs=1e-6)
    assert drag["CD_0"]["baseline"] == BASE
    assert drag["change_percent"]["CD_0"]["estimate"] == pytest.approx(25.0, abs=0.01)


def test_changes_of_derivatives_stand_beside_them() -> None:
    """4.5 against 5: a tenth less. Its 2 sd are those of both, 0.1 each, 2.8 of 5, without mass and inertia's."""
    held = profiles()
    made = board(held, derivatives(4.5, 0.1))
    assert made.against is not None
    value, sd = made.against.changes(made.methods)["CL_alpha"]
    assert value == pytest.approx(-0.1)
    assert 0.02 <= sd <= math.hypot(0.1, 0.1) / 5
    assert "-10±" in line(made, "CL_alpha")
    assert "vs baseline" in "\n".join(x.plain for x in panel.lines(made, seconds(60), 80, 24, None))
    plain = Board(load_card("bench"), ManualClock(seconds(60)))
    plain.update([derivatives(4.5, 0.1)])
    assert plain.snapshot()["baseline"] is None
    assert "baseline" not in "\n".join(x.plain for x in panel.lines(plain, seconds(60), 80, 24, None))


def test_drag_that_is_not_told_is_a_dash() -> None:
    """Before the first mean, without thrust, and half a minute after it has gone; without a baseline of it nothing."""
    held = profiles()
    assert line(board(held), "CD_0").split()[1] == "–"
    assert line(board(held, *rows(held, 0.05, 0, 30, thrust=False)), "CD_0").split()[1] == "–"
    made = board(held, *rows(held, 0.05, 0, 20), *rows(held, 0.05, 20, 45, thrust=False))
    assert line(made, "CD_0").split()[1] == "0.0500"
    made.update(rows(held, 0.05, 45, 60, thrust=False))
    assert line(made, "CD_0").split()[1] == "–"
    none = profiles(CD_0=None)
    assert line(board(none, *rows(none, 0.05, 0, 30)), "CD_0") == ""


def test_the_page_and_the_second_screen_have_it_too() -> None:
    held = profiles()
    made = board(held, derivatives(4.5, 0.1), *rows(held, 0.05, 0, 41))
    setup = setup_for(held, title="x")
    words = first_words(brief(made, seconds(60)), setup.references)
    (row,) = [x for x in words.splitlines() if x.startswith("| CD_0")]
    assert "**0.0500** ±" in row
    assert "| 0.0400 | +25±" in row
    assert any(x.startswith("| CL_alpha") and "-10±" in x for x in words.splitlines())
    shown = {d.name: d for d in content(made, seconds(60))["derivatives"]}
    assert shown["CD_0"].change.startswith("+25±")
    assert shown["CL_alpha"].change.startswith("-10±")


def test_the_page_draws_it_over_time_with_the_baseline_beside() -> None:
    """A mean each 10 s: 0.04, then 0.05; each drawn once."""
    held = profiles()
    setup = setup_for(held, title="x")
    known = drag_plot.against(setup)
    assert known is not None
    assert [p.name for p in drag_plot.drawn(known)] == ["CD_0 [1]"]
    for row in (*rows(held, 0.04, 0, 20.5), *rows(held, 0.05, 20.5, 60.5)):
        if isinstance(row, Frame):
            known.take_frame(row)
        elif isinstance(row, AlphaEstimate):
            known.take_alpha(row)
    (points,) = drag_plot.points(BASE, known.history, START_NS)
    assert np.all(points.values[:, 0] == BASE)
    assert points.values[0, 3] == pytest.approx(0.04, abs=1e-6)
    assert points.values[-1, 3] == pytest.approx(0.05, abs=1e-6)
    assert np.all(points.values[:, 1] < points.values[:, 3])
    assert np.all(np.diff(points.t_ns) > 0)
    assert drag_plot.drawn(drag_plot.against(Setup("x", "none", 0, 0))) == ()

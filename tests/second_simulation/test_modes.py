"""How this simulation's aircraft fly, against closed forms and against the station's theory of the same derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from station.model import flying_qualities as theory
from station.model.late_lift import INDUCED_DRAG, LAGS, ZERO_LIFT_DRAG, constants_of
from station.profile import Aircraft, load_aircraft, profile_changes
from station.profile.aircraft import Indicial
from tests.second_simulation.aircraft import CHORD, Drawn, G, density, drawn
from tests.second_simulation.flights import diagnose_cases
from tests.second_simulation.modes import free_flight, poles, qualities
from tests.second_simulation.motion import Hidden, constants


def test_poles_of_known_motions_are_read_off_them() -> None:
    t = np.arange(400) * 0.05
    known = (-2.0 + 2.5j, -0.02 + 0.2j, -0.7 + 0j)
    shown = np.stack(
        [sum((np.exp(p * t) * np.exp(1j * k * (n + 1))).real for n, p in enumerate(known)) for k in (0, 1)]
    )
    found = poles(shown, 0.05)
    for p in known:
        assert np.abs(found - p).min() < 1e-6


def test_what_drifts_is_no_phugoid() -> None:
    """Of this aircraft the slowest pole that 60 s of flight show is at 0.048 rad/s, and none of it at 0.01 m/s less. Of
    lift alone its phugoid is at 0.27; pitch damping slows it by some fifth, by the root of static over manoeuvre
    margin."""
    aircraft = diagnose_cases(11, 19)[0].aircraft
    found = [free_flight(replace(aircraft, speed=aircraft.speed + x), Hidden())["phugoid"][0] for x in (-0.01, 0.0)]
    assert found[0] == pytest.approx(found[1], rel=1e-3)
    assert 0.7 < found[0] / (2**0.5 * G / aircraft.speed) < 1.0


def quasi_steady() -> Drawn:
    return replace(drawn(np.random.default_rng(0), 0.1, True), memory=0.0, downwash=0.0, thrust_slope=0.0)


def told(aircraft: Drawn, body: Aircraft, late: bool) -> Mapping[str, theory.Derived]:
    here, above = (density(aircraft.altitude + x) for x in (0.0, 1.0))
    alpha, scale = constants(aircraft, Hidden()).alpha, here / (here - above)
    at = theory.Condition(aircraft.speed, here, aircraft.mass, aircraft.iyy, alpha, scale)
    return theory.qualities(body, at, aircraft.derivatives, 1e-12 * np.eye(6), late=late).quantities


def test_without_lags_it_flies_as_linear_theory_says() -> None:
    """The phugoid's damping rests on thrust, of which the theory takes the middle of all laws."""
    aircraft, profile = quasi_steady(), load_aircraft("twin_otter")
    drag = profile.drag.model_copy(update={"zero_lift": aircraft.CD_0, "induced": aircraft.induced})
    true = qualities(aircraft, Hidden())
    said = told(aircraft, profile.model_copy(update={"drag": drag}), late=False)
    for name in set(true) - {"phugoid_damping"}:
        assert said[name].estimate == pytest.approx(true[name], rel=3e-3), name
    assert said["phugoid_frequency"].estimate == pytest.approx(true["phugoid_frequency"], rel=1e-3)


def test_thrust_that_carries_weight_slows_the_phugoid() -> None:
    """Of an aircraft that flies slowly at a high angle of attack, by 1 %."""
    aircraft = replace(quasi_steady(), CL_0=0.0, speed=45.0, thrust_slope=sum(theory.THRUST_LAWS) / 2)
    assert constants(aircraft, Hidden()).alpha > 0.15
    drag = {"zero_lift": aircraft.CD_0, "induced": aircraft.induced}
    profile = load_aircraft("twin_otter")
    body = profile.model_copy(update={"drag": profile.drag.model_copy(update=drag)})
    true, said = qualities(aircraft, Hidden()), told(aircraft, body, late=False)
    assert said["phugoid_frequency"].estimate == pytest.approx(true["phugoid_frequency"], rel=1e-3)


@pytest.mark.parametrize(
    ("doubt", "size", "hidden"),
    [("thrust_arm", 0.05, lambda x: Hidden(thrust_arm=x * CHORD)), ("CL_V", 0.1, lambda x: Hidden(speed=x))],
)
def test_a_doubtful_thrust_line_or_speed_term_widens_the_phugoid_by_what_it_changes(
    doubt: str, size: float, hidden: Callable[[float], Hidden]
) -> None:
    """To the tenth that 1000 draws leave (three of their standard errors): drag and the thrust's law hardly matter."""
    aircraft, body = replace(quasi_steady(), thrust_slope=sum(theory.THRUST_LAWS) / 2), load_aircraft("twin_otter")
    alone = body.uncertainty.model_copy(update={"thrust_arm": 0.0, "CL_V": 0.0, doubt: size})
    one, other = (free_flight(aircraft, hidden(x))["phugoid"][0] for x in (size, -size))
    interval = told(aircraft, body.model_copy(update={"uncertainty": alone}), late=False)["phugoid_frequency"].ci95
    assert interval[1] - interval[0] == pytest.approx(1.96 * abs(one - other), rel=0.1)


def test_lags_of_wing_and_downwash_are_part_of_how_it_flies() -> None:
    """Of a profile that has this aircraft's tail and memory, both near enough to the short period to change it."""
    aircraft, body = drawn(np.random.default_rng(1), 0.1, True), load_aircraft("twin_otter")
    c = constants(aircraft, Hidden())
    own = {
        "tail_lift_slope": aircraft.tail_slope,
        "downwash": aircraft.downwash,
        "tail_arm": aircraft.tail_arm,
        "downwash_delay": 0.0,
        "reference_chord": CHORD,
        "lift_motion": Indicial(a=c.motion_a, b=c.motion_b),
    }
    body = body.model_copy(update={"unsteady": body.unsteady.model_copy(update=own)})
    true, said, quick = qualities(aircraft, Hidden()), told(aircraft, body, late=True), told(aircraft, body, late=False)
    for name in set(true) - {"phugoid_damping"}:
        assert said[name].estimate == pytest.approx(true[name], rel=3e-3), name
    assert abs(quick["short_period_frequency"].estimate / true["short_period_frequency"] - 1) > 0.1


@pytest.mark.parametrize("name", LAGS)
def test_a_lag_that_is_known_by_an_interval_moves_the_short_period_by_one(name: str) -> None:
    """Drawn beside the derivatives, it does what an aircraft does that has it."""
    body = load_aircraft("twin_otter")
    change = {
        "late tail slope": profile_changes.unsteady("tail_lift_slope"),
        "late tail arm": profile_changes.unsteady("tail_arm"),
        "late downwash": profile_changes.unsteady("downwash"),
        "late delay": profile_changes.unsteady("downwash_delay"),
        "late amplitude": profile_changes.indicial_amplitude("lift_motion"),
        "late rate": profile_changes.indicial_rate("lift_motion"),
    }[name]
    other = change(body, 0.05)
    at = theory.Condition(56.6, 1.1, 4960.0, 33400.0)
    own = {n: body.value(n) for n in ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")}
    none, period = np.zeros((7, 7)), "short_period_frequency"
    said = theory.qualities(other, at, own, none[:6, :6]).quantities[period].estimate
    found = own | {name: constants_of(other, body)[name]}
    assert theory.qualities(body, at, found, none).quantities[period].estimate == pytest.approx(said, rel=1e-6)
    assert said != pytest.approx(theory.qualities(body, at, own, none[:6, :6]).quantities[period].estimate, rel=1e-4)
    wide = none.copy()
    wide[6, 6] = 0.05**2
    told = theory.qualities(body, at, own | {name: constants_of(body, body)[name]}, wide).quantities[period]
    assert told.ci95[1] - told.ci95[0] > abs(said - told.estimate)


@pytest.mark.parametrize(
    ("name", "field", "more"), [(ZERO_LIFT_DRAG, "zero_lift", 0.008), (INDUCED_DRAG, "induced", 0.01)]
)
def test_drag_that_was_fitted_counts_with_its_own_error(name: str, field: str, more: float) -> None:
    """In the phugoid's damping: of a profile's own, a tenth is not known, whatever was measured."""
    body = load_aircraft("twin_otter")
    other = body.model_copy(update={"drag": body.drag.model_copy(update={field: getattr(body.drag, field) + more})})
    at = theory.Condition(56.6, 1.1, 4960.0, 33400.0)
    own = {n: body.value(n) for n in ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")}

    def damping(aircraft: Aircraft, found: dict[str, float], sd: float = 0.0) -> theory.Derived:
        covariance = np.diag([*np.zeros(6), *([sd**2] if len(found) > 6 else [])])
        return theory.qualities(aircraft, at, found, covariance).quantities["phugoid_damping"]

    here, there = (constants_of(x, body)[name] for x in (body, other))
    assert damping(body, own | {name: there}).estimate == pytest.approx(damping(other, own).estimate, rel=1e-9)
    told = [damping(body, own | {name: here}, k * abs(there - here)).ci95 for k in (0, 4)]
    assert told[1][1] - told[1][0] > 1.1 * (told[0][1] - told[0][0])

"""How this simulation's aircraft fly, against closed forms and against the station's theory of the same derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.model import flying_qualities as theory
from station.profile import Aircraft, load_aircraft
from station.profile.aircraft import Indicial
from tests.second_simulation.aircraft import CHORD, Drawn, density, drawn
from tests.second_simulation.modes import poles, qualities
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


def quasi_steady() -> Drawn:
    return replace(drawn(np.random.default_rng(0), 0.1, True), memory=0.0, downwash=0.0, thrust_slope=0.0)


def told(aircraft: Drawn, body: Aircraft, late: bool) -> dict[str, float]:
    at = theory.Condition(
        aircraft.speed, density(aircraft.altitude), aircraft.mass, aircraft.iyy, constants(aircraft, Hidden()).alpha
    )
    found = theory.qualities(body, at, aircraft.derivatives, 1e-12 * np.eye(6), late=late)
    return {name: q.estimate for name, q in found.quantities.items()}


def test_without_lags_it_flies_as_linear_theory_says() -> None:
    """The phugoid's damping rests on drag and thrust, which the profile has otherwise."""
    aircraft = quasi_steady()
    true, said = qualities(aircraft, Hidden()), told(quasi_steady(), load_aircraft("twin_otter"), late=False)
    for name in set(true) - {"phugoid_damping"}:
        assert said[name] == pytest.approx(true[name], rel=3e-3), name


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
    for name in ("short_period_frequency", "short_period_damping", "n_per_alpha", "elevator_per_g"):
        assert said[name] == pytest.approx(true[name], rel=0.01), name
    assert abs(quick["short_period_frequency"] / true["short_period_frequency"] - 1) > 0.1

"""Gusts that meet the vane elsewhere, a boom that swings and a bent sensor: flown and diagnosed."""

from __future__ import annotations

import numpy as np
import pytest
from blind import DEG, FT, SIGMAS, Case, covered, diagnosed, planted, score

from station.diagnosis.backlash import linearised
from station.diagnosis.effects import extended
from station.profile import Flight, load_aircraft
from station.simulation import Simulation
from station.simulation.installed import Installed


def test_a_vane_without_lead_meets_gusts_where_the_cg_does():
    aircraft = load_aircraft("twin_otter")
    plain = {"upwash_body": 0.0, "upwash_wing": 0.0, "vane_frequency": 200.0, "vane_damping": 1.0}
    aircraft = aircraft.model_copy(update={"boom": aircraft.boom.model_copy(update=plain)})
    air = Flight().model_copy(update={"gust_sigma": 5 * FT, "seed": 3})
    apart = {}
    for lead in (0.0, 1.0):
        truth = Simulation(extended(aircraft, {"gust.lead": lead - 1.0}), air).advance(2000)
        expected = truth["alpha"] - truth["q"] * aircraft.boom.vane_x / truth["airspeed"]
        apart[lead] = float(np.std((truth["alpha_vane"] - expected)[50:]))
    # What is left without lead is the vane's own lag of 1.6 ms, against 94 ms.
    assert apart[0.0] < 0.1 * apart[1.0]


@pytest.mark.parametrize("bend", [0.4, -0.3])
def test_a_bent_sensor_is_flown_and_straightened(bend):
    aircraft = extended(load_aircraft("twin_otter"), {"elevator.nonlinearity": bend})
    ramp = np.linspace(-10 * DEG, 10 * DEG, 101)

    class Ramp:
        def advance(self, n):
            return {"elevator": ramp[:n], "elevator_drive": ramp[:n]}

    shown = Installed(Ramp(), aircraft).advance(101)["elevator"]
    assert shown[-1] == pytest.approx(10 * DEG * (1 + bend))
    np.testing.assert_allclose(linearised(shown, aircraft.instruments["elevator"].cubic), ramp, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "sigma", "name", "sign"),
    [
        (1901, SIGMAS[2], "gust.lead", -1),
        (1902, SIGMAS[0], "boom.mode", 1),
        (1903, SIGMAS[1], "elevator.nonlinearity", 1),
        (1904, SIGMAS[2], "aero.Cm_alpha_squared", -1),
    ],
)
def test_each_is_found_or_grouped_with_what_it_resembles(seed, sigma, name, sign):
    case = Case(seed=seed, sigma=sigma, effects={name: planted(name, 2.5, sigma, sign)})
    d = diagnosed(case)
    assert score(case, d) in ("exact", "group"), [(e.term.id, e.value, e.alternatives) for e in d.effects]
    for _, inside, z in covered(case, d):
        assert inside or abs(z) < 3

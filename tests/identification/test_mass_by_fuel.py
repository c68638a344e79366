"""Mass by the recorded fuel flow, where no mass is recorded: by closed form."""

from __future__ import annotations

import numpy as np
import pytest

from station.identification.analysis import identify
from station.identification.preparation import less_fuel
from station.identification.request import Request
from station.log import Table
from station.profile import Card, Doublet, Flight, load_aircraft, load_rig
from station.simulation.sortie import fly

AIRCRAFT, RIG = load_aircraft("twin_otter"), load_rig("bench")


def table(**columns: np.ndarray) -> Table:
    return Table(np.arange(101) * 0.1, columns, AIRCRAFT, 0)


def test_what_is_burnt_is_the_integral_of_the_flow() -> None:
    t = np.arange(101) * 0.1
    flow = 0.04 + 0.01 * t
    flow[30:40] = np.nan
    made, aircraft = less_fuel(table(fuel_flow=flow), AIRCRAFT)
    assert made.columns["mass"] == pytest.approx(AIRCRAFT.inertia.mass - (0.04 * t + 0.005 * t**2))
    assert aircraft.uncertainty.recorded_mass == AIRCRAFT.uncertainty.mass


def test_a_recorded_mass_takes_precedence() -> None:
    weighed = table(fuel_flow=np.full(101, 0.05), mass=np.full(101, 4800.0))
    assert less_fuel(weighed, AIRCRAFT) == (weighed, AIRCRAFT)
    without = table(q=np.zeros(101))
    assert less_fuel(without, AIRCRAFT) == (without, AIRCRAFT)


def test_derivatives_are_by_the_mass_that_is_left() -> None:
    """A tenth of the mass burnt before an interval: lift by a tenth less."""
    flight = Flight.model_validate({"speed": "110 kt", "altitude": "2500 ft"})
    doublet = Doublet.model_validate({"kind": "doublet", "start": "25 s", "width": "1 s", "amplitude": "3.5 deg"})
    card = Card(name="t", aircraft="t", rig="bench", flight=flight, manoeuvres=(doublet,))
    shown = fly(AIRCRAFT, RIG, card, 35.0, 4)[0]
    columns = {n: c for n, c in shown.items() if n not in ("mass", "thrust", "pdot", "qdot", "rdot")}
    t = np.arange(len(columns["q"])) * 0.02
    burnt = 0.1 * AIRCRAFT.inertia.mass
    flow = np.where(t < 10, burnt / 10, 0.0)
    request = Request(["II"], 20.0, noise=RIG.noise_si())
    plain, fuel = (
        identify(Table(t, columns | more, AIRCRAFT, 0), AIRCRAFT, request).methods["II"].parameters
        for more in ({}, {"fuel_flow": flow})
    )
    ratio = {p.name: p.value / next(x.value for x in plain if x.name == p.name) for p in fuel}
    assert ratio["CL_alpha"] == pytest.approx(0.9, abs=0.003)
    assert ratio["Cm_alpha"] == pytest.approx(1.0, abs=0.003)

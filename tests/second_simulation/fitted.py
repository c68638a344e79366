"""Flights of the second simulation as a likelihood of candidates."""

from __future__ import annotations

from dataclasses import replace

from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import Manoeuvre, manoeuvre
from station.diagnosis.measured_record import manoeuvres
from station.profile import Aircraft, load_aircraft
from tests.second_simulation.flights import QUIET, Case, Flown, diagnose_cases, flown


def fitted(
    seed: int, index: int, hidden: bool = True, noise: float = 1.0, names: tuple[str, ...] | None = None
) -> tuple[Problem, list[Flown]]:
    """Two manoeuvres of a case, with what it hides, or with `names`, and so many times its noise, about the shipped
    profile, which is not that aircraft's."""
    profile, made, flights = load_aircraft("twin_otter"), [], []
    for case in diagnose_cases(seed, index, names)[:2]:
        one, flight = manoeuvre_of(
            replace(case, hidden=case.hidden if hidden else {}, noise=noise * case.noise), profile
        )
        made.append(one)
        flights.append(flight)
    return Problem(made, profile), flights


def manoeuvre_of(case: Case, profile: Aircraft) -> tuple[Manoeuvre, Flown]:
    """A case as it is flown, and as it is judged by the profile."""
    flight = flown(case)
    (record,) = manoeuvres(case.name, flight.time, flight.shown, profile, [(QUIET, QUIET + case.seconds)])
    return manoeuvre(record, profile), flight

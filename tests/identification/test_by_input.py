"""What the input shows of how far gusts mislead least squares: roll by one equation, solved in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from station.conventions import LATERAL
from station.estimation.flight_record import FlightRecord
from station.estimation.results import MethodResult
from station.identification.analysis import _recommended
from station.identification.by_input import by_input, misled
from station.profile import load_aircraft
from station.rows import ParamEstimate, Status

AIRCRAFT = load_aircraft("twin_otter")
DT, SECONDS, SPEED = 0.02, 120.0, 60.0
CL_P, CL_DA = -0.5, -0.2
ROLL = -4.0
"""1/s: of the roll mode."""


def rolling(gust: float, seed: int) -> FlightRecord:
    """An aircraft that rolls alone: pdot = ROLL (p + gust) + b aileron, exact for what is constant between samples. The
    gust's roll rate is first-order noise of 0.5 s, which nothing measures."""
    rng = np.random.default_rng(seed)
    n = round(SECONDS / DT)
    t = DT * np.arange(n)
    assert AIRCRAFT.inertia.ixx is not None
    span, area = AIRCRAFT.geometry.span, AIRCRAFT.geometry.wing_area
    by_aileron = ROLL * CL_DA / CL_P / (span / (2 * SPEED))
    aileron = 0.05 * np.sign(np.sin(2 * np.pi * t / 4.0)) * (np.mod(t, 12.0) < 8.0)
    keep = math.exp(-DT / 0.5)
    gusts = gust * lfilter([math.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(n))
    push = ROLL * gusts + by_aileron * aileron
    held = math.exp(ROLL * DT)
    p = lfilter([0.0, (held - 1) / ROLL], [1, -held], push)
    pdot = ROLL * p + push
    # The dynamic pressure with which these are the derivatives.
    pressure = AIRCRAFT.inertia.ixx * ROLL / (CL_P * area * span * span / (2 * SPEED))
    level = {"alpha_vane": 0.03, "q": 0.0, "ax": 0.3, "az": -9.81, "elevator": 0.0, "airspeed": SPEED, "mass": 4500.0}
    columns = {name: np.full(n, value) for name, value in level.items()}
    small = {name: sd * rng.standard_normal(n) for name, sd in (("r", 1e-3), ("beta_vane", 1e-3), ("rudder", 1e-9))}
    columns |= small | {"p": p, "pdot": pdot, "rdot": 0 * p, "ay": 0 * p, "aileron": aileron}
    columns["dynamic_pressure"] = np.full(n, pressure)
    still = AIRCRAFT.model_copy(update={"boom": None, "inertia": AIRCRAFT.inertia.model_copy(update={"ixz": 0.0})})
    return FlightRecord.of(t, columns, still)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_roll_damping_in_gusts_that_nothing_measures(seed: int) -> None:
    shown = by_input(rolling(0.15, seed), "wind", longitudinal=False)
    damping, aileron = shown["Cl_p"], shown["Cl_da"]
    assert damping.apart > 0.2 * abs(CL_P)  # what least squares take for damping is too little
    for known, of in ((CL_P, damping), (CL_DA, aileron)):
        least_squares = of.value + of.apart
        assert abs(of.value - known) < 0.5 * abs(least_squares - known)
        assert abs(least_squares - known) < 1.96 * np.hypot(of.error, np.hypot(of.apart, of.apart))
    assert damping.error < 0.15 * abs(CL_P)


def test_calm_air_misleads_nobody() -> None:
    shown = by_input(rolling(0.0, 1), "wind", longitudinal=False)
    assert shown["Cl_p"].value == pytest.approx(CL_P, rel=1e-3)
    assert abs(shown["Cl_p"].apart) < 1e-3 * abs(CL_P)


def test_errors_are_no_smaller_than_what_the_input_shows() -> None:
    record = rolling(0.15, 1)
    shown = by_input(record, "wind", longitudinal=False)
    least_squares = shown["Cl_p"].value + shown["Cl_p"].apart
    given = MethodResult("ok", "", (ParamEstimate("Cl_p", least_squares, 0.01, Status.ESTIMATED),))
    made = misled({"I": given, "II": given}, shown, record, ("II",))
    assert made["I"].parameters[0].sd > 1.4 * shown["Cl_p"].apart  # by itself, and by least squares' own distance
    assert made["II"] == given
    wide = MethodResult("ok", "", (ParamEstimate("Cl_p", least_squares, 5.0, Status.ESTIMATED),))
    assert misled({"I": wide}, shown, record)["I"].parameters[0].sd == 5.0


@pytest.mark.parametrize(
    ("given", "level", "expected"),
    [((15, 15), "moderate", "split+gust"), ((15, 12), "moderate", "split"), ((15, 15), "calm", "split")],
)
def test_a_flight_of_lateral_derivatives_alone_is_told_by_what_the_surfaces_move(
    given: tuple[int, int], level: str, expected: str
) -> None:
    """In gusts, where it gives as many as least squares."""
    results = {
        name: MethodResult(
            "ok", parameters=tuple(ParamEstimate(n, 1.0, 0.1, Status.ESTIMATED) for n in LATERAL[:count])
        )
        for name, count in zip(("split", "split+gust"), given, strict=True)
    }
    assert _recommended(results, level) == expected

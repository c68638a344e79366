"""Records without attitude, without vertical velocity, or by a vane that comes a second late."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from station.conventions import G0
from station.estimation.flight_record import FlightRecord
from station.identification.analysis import identify
from station.identification.instrument_bias import out_of_time
from station.identification.pitch_by_rates import RECONSTRUCTED, with_pitch
from station.identification.request import Request
from station.log import Table
from station.profile import Card, load_aircraft, load_rig
from station.rows import Status
from station.simulation.sortie import fly

AIRCRAFT, RIG = load_aircraft("twin_otter"), load_rig("bench")
DT = 0.02
Array = NDArray[np.float64]


def a_flight(sigma: float) -> dict[str, Array]:
    card = {
        "name": "t",
        "aircraft": "twin_otter",
        "rig": "bench",
        "flight": {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{sigma} ft/s"},
        "manoeuvres": [
            {"kind": "3-2-1-1", "start": "12 s", "amplitude": "3 deg", "unit": "0.7 s"},
            {"kind": "3-2-1-1", "start": "26 s", "amplitude": "3 deg", "unit": "0.5 s"},
        ],
    }
    shown, _ = fly(AIRCRAFT, RIG, Card.model_validate(card), 45.0, 4)
    return {n: c for n, c in shown.items() if n not in ("mass", "pdot", "qdot", "rdot")}


def of(columns: dict[str, Array]) -> Table:
    return Table(np.arange(len(columns["q"])) * DT, columns, AIRCRAFT, 0)


@pytest.mark.parametrize("drift", [0.0, math.radians(0.02)])
def test_pitch_of_a_known_motion(drift: float) -> None:
    """A pitch that swings by 5 deg about 4 deg at a speed that it changes, in closed form; a gyro that drifts."""
    t = np.arange(0.0, 60.0, DT)
    omega, alpha = 2 * math.pi * 0.2, 0.05
    theta = 0.07 + math.radians(5) * np.sin(omega * t)
    speed = 60.0 - 2.0 * np.sin(2 * math.pi * t / 40.0)
    rate = math.radians(5) * omega * np.cos(omega * t)
    pull = -2.0 * 2 * math.pi / 40.0 * np.cos(2 * math.pi * t / 40.0) * math.cos(alpha)
    columns = {
        "q": rate + drift,
        "airspeed": speed,
        "alpha_vane": np.full(len(t), alpha),
        "ax": pull + (rate + drift) * speed * math.sin(alpha) + G0 * np.sin(theta),
    }
    found = with_pitch(Table(t, columns, AIRCRAFT, 0)).columns["theta"]
    # The drift beside the speed, which it feels as well, is 0.02 deg/s of 3 m/s.
    assert np.abs(found - theta).max() < math.radians(0.05)


def test_a_recorded_pitch_is_kept_and_too_little_gives_none() -> None:
    whole = of(a_flight(0.0))
    assert with_pitch(whole) is whole
    without = {n: c for n, c in whole.columns.items() if n not in ("theta", "ax")}
    assert "theta" not in with_pitch(of(without)).columns
    short = replace(whole, columns={n: c for n, c in whole.columns.items() if n != "theta"}).between(0.0, 3.0)
    assert "theta" not in with_pitch(short).columns


@pytest.mark.parametrize("missing", [("theta",), ("v_down",), ("theta", "phi", "psi", "v_north", "v_east", "v_down")])
def test_derivatives_in_gusts_without_attitude_or_path(missing: tuple[str, ...]) -> None:
    """The simulation's own derivatives lie within three standard errors, and none is lost."""
    columns = {n: c for n, c in a_flight(5.0).items() if n not in missing}
    made = identify(of(columns), AIRCRAFT, Request(methods=("split+gust", "physical"), start_s=10.0))
    found = {p.name: p for p in made.methods["physical"].parameters}
    for name in ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de"):
        assert found[name].status is Status.ESTIMATED, (name, found[name].why)
        assert abs(found[name].value - AIRCRAFT.value(name)) < 3 * found[name].sd, name
    assert (RECONSTRUCTED in made.remarks) == ("theta" in missing)


@pytest.mark.parametrize("late_s", [0.0, 0.4, 1.0])
def test_a_vane_that_shows_what_lift_has_followed_already_is_late(late_s: float) -> None:
    for sigma in (0.0, 8.0):
        columns = a_flight(sigma)
        rows = round(late_s / DT)
        vane = columns["alpha_vane"]
        columns["alpha_vane"] = np.concatenate((np.full(rows, vane[0]), vane[: len(vane) - rows]))
        record = FlightRecord.of(np.arange(len(vane)) * DT, columns, AIRCRAFT)
        found = out_of_time(record, "wind").get("alpha_vane")
        if not late_s:
            assert found is None
        else:
            # Lift itself is later than the angle, by its memory and the gusts' way.
            assert found is not None
            assert late_s - 0.2 <= found.late <= late_s + 0.05
            assert "or more" in found.worded("alpha_vane")

"""The aircraft simulated beside flights of another program, whose derivatives are not quite the profile's."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from station.convert import import_file
from station.diagnosis.measured_record import manoeuvres
from station.diagnosis.qualification import flown_beside
from station.diagnosis.vane_gust import inputs_of, without_errors
from station.log import table
from station.profile import load_aircraft
from station.simulation.measured_inputs import MeasuredFlight, Start
from tests.second_simulation.flights import diagnose_cases, write

SCALES = {"theta": 0.0262, "q": 0.0349, "az": 0.981, "alpha_vane": 0.0262, "airspeed": 1.543}
"""1.5 deg, 2 deg/s, 0.1 g, 1.5 deg, 3 kt."""
STARTED = ("speed", "alpha", "theta", "q", "cl_0", "cm_0", "cd_0")
SIZES = (3.0, 0.052, 0.035, 0.035, 0.3, 0.1, 0.05)


def test_trim_and_initial_state_are_those_of_the_least_difference(tmp_path: Path) -> None:
    """In gusts, with a vane that is 43 ms late, far from the trim that fits: scipy ends at the same differences."""
    case = replace(diagnose_cases(1, 10, ("alpha_vane.delay",), 1.5)[1], rate=50.0, seconds=30.0)
    write([case], tmp_path)
    plain, log = tmp_path / "flight.csv", tmp_path / "flight.mcap"
    plain.write_bytes(gzip.decompress((tmp_path / f"{case.name}.csv.gz").read_bytes()))
    profile = load_aircraft("twin_otter")
    import_file(plain, log, profile)
    read = table(log)
    record = manoeuvres("flight", read.t_s, read.columns, profile)[0]
    aircraft = profile.model_copy(update={"air_density": record.density})
    found = flown_beside(record, profile)
    inputs = inputs_of(without_errors(record, profile), record.dt, aircraft)
    flight = MeasuredFlight(aircraft, inputs, record.height, record.imu, found.judged_from_s)
    at = round(found.judged_from_s / record.dt)
    begin = dict(zip(STARTED, inputs.motion[at], strict=False))

    def off(x: np.ndarray) -> np.ndarray:
        start = {n: begin.get(n, 0.0) + s * float(v) for n, s, v in zip(STARTED, SIZES, x, strict=True)}
        shown = flight.fly(Start(**start))
        return np.concatenate([(shown[n] - record.signals[n])[at::5] / s for n, s in SCALES.items()])

    known = least_squares(lambda x: np.concatenate([off(x), x]), np.zeros(7), xtol=1e-6)
    mine = np.concatenate([(found.after[n] - record.signals[n])[at::5] / s for n, s in SCALES.items()])
    theirs = off(known.x)
    assert mine @ mine == pytest.approx(theirs @ theirs, rel=0.02)

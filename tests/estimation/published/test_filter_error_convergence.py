"""Filter error comes to an end on every record: in calm air, where its process noise is nothing, and in strong gusts,
where its gain is held at the bound."""

import numpy as np
import pytest

from station.conventions import SIGNALS
from station.estimation.published.batch import run
from station.identification.preparation import flight_record
from station.log import Table
from station.profile import Card, load_aircraft, load_rig
from station.rows import Status
from station.simulation.sortie import fly

AIRCRAFT = load_aircraft("twin_otter")
RIG = load_rig("bench")
INPUTS = (
    {"kind": "doublet", "start": "3 s", "amplitude": "3.5 deg", "width": "0.6 s"},
    {"kind": "3-2-1-1", "start": "25 s", "amplitude": "-2.5 deg", "unit": "0.5 s"},
    {"kind": "doublet", "start": "45 s", "amplitude": "3.5 deg", "width": "1.2 s"},
)


def filter_error(gust, seconds, seed):
    flight = {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": f"{gust} ft/s"}
    about = {"name": "t", "aircraft": "twin_otter", "rig": "bench", "flight": flight, "manoeuvres": INPUTS}
    shown, _ = fly(AIRCRAFT, RIG, Card.model_validate(about), seconds, seed)
    columns = {n: v for n, v in shown.items() if n in SIGNALS and n not in ("thrust", "mass", "pdot", "qdot", "rdot")}
    table = Table(np.arange(len(columns["q"])) / 50.0, columns, AIRCRAFT, 0)
    record, _ = flight_record(table, AIRCRAFT, RIG.imu_position, RIG.noise_si())
    return run("fe", record, "wind")


def agrees(found):
    assert found.status == "ok", found.why
    assert found.settings["iterations"] <= 15
    slope = found.parameters[0]
    assert slope.status is Status.ESTIMATED
    # Quasi-steady, of an aircraft that is not: some per cent low, more where the vane's lead on gusts counts.
    assert abs(slope.value - AIRCRAFT.value("CL_alpha")) < 0.1 * AIRCRAFT.value("CL_alpha") + 2 * slope.sd


@pytest.mark.parametrize("seed", [2, 3])
def test_filter_error_converges_on_a_short_turbulent_record(seed):
    agrees(filter_error(5, 10.0, seed))


@pytest.mark.slow
@pytest.mark.parametrize("gust", [0, 5, 10])
def test_filter_error_converges_on_ten_records_of_80_s(gust):
    for seed in range(1, 11):
        agrees(filter_error(gust, 80.0, seed))

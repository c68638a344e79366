"""A raised thrust line with a pitching arm and a thrust that changes within the manoeuvre: recorded, it must not show
in the derivatives, live or post-flight. Oracle: the simulation's own truth, quasi-steady, without noise."""

import functools
import math

import numpy as np

from station.conventions import LONGITUDINAL, SIGNAL_INDEX, SIGNALS, TICK_HZ, TICK_NS
from station.estimation.methods import Estimator
from station.identification.analysis import identify
from station.identification.request import Request
from station.log import Table
from station.model.coefficients import Airframe, coefficients
from station.profile import Aircraft, Card, load_aircraft
from station.rows import Frame, Quality
from station.simulation.motion import EVERY
from station.simulation.three_degrees import Simulation

PROFILE = load_aircraft("twin_otter")
AIRCRAFT = PROFILE.model_copy(
    update={
        "boom": None,
        "unsteady": PROFILE.unsteady.model_copy(update={"memory": False}),
        "thrust_angle": math.radians(8.0),
        "thrust_pitch_arm": -0.8,
    }
)
UNTOLD = AIRCRAFT.model_copy(update={"thrust_angle": 0.0, "thrust_pitch_arm": 0.0})
TRUTH = np.array([AIRCRAFT.value(name) for name in LONGITUDINAL])
CARD = Card.model_validate(
    {
        "name": "t",
        "aircraft": "twin_otter",
        "rig": "bench",
        "warm_up": "4 s",
        "flight": {"speed": "110 kt", "altitude": "2500 ft", "gust_sigma": "0 ft/s"},
        "manoeuvres": [
            {"kind": "doublet", "start": "6 s", "amplitude": "3.5 deg", "width": "0.6 s"},
            {"kind": "doublet", "start": "16 s", "amplitude": "3.5 deg", "width": "1.2 s"},
        ],
    }
)
SECONDS = 30.0


@functools.cache
def flown(told: bool = True) -> dict[str, np.ndarray]:
    """Every signal and the simulation's truth at 50 Hz; the pilot's throttle is quick and coarse, so that the thrust
    moves with the motion. Not `told`: the same flight with the thrust through the CG, along x."""
    simulation = Simulation(AIRCRAFT if told else UNTOLD, CARD.flight, CARD.manoeuvres)
    coarse = simulation.flown.constants._replace(hold_speed=1.5, hold_lag=0.4)
    simulation.aircraft.flown = simulation.flown._replace(constants=coarse)
    truth = simulation.advance(round(SECONDS * TICK_HZ) * EVERY)
    return {name: values[::EVERY] for name, values in truth.items()}


def signals(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: values for name, values in columns.items() if name in SIGNALS}


def live(aircraft: Aircraft, told: bool = True) -> np.ndarray:
    """II's derivatives, all estimated."""
    columns = signals(flown(told))
    table = np.full((len(columns["q"]), len(SIGNALS)), math.nan)
    for name, values in columns.items():
        table[:, SIGNAL_INDEX[name]] = values
    ages = np.where(np.isfinite(table), 0.0, math.nan)
    quality = np.where(np.isfinite(table), int(Quality.FRESH), int(Quality.MISSING))
    estimator, made = Estimator(aircraft, CARD, methods=("II",)), ()
    for k, (v, a, q) in enumerate(zip(table.tolist(), ages.tolist(), quality.tolist(), strict=True)):
        _, made = estimator.step(Frame(k * TICK_NS, k, tuple(v), tuple(a), tuple(q)))
    return np.array([p.value for p in made[0].parameters])


def post_flight(aircraft: Aircraft, method: str, told: bool = True) -> np.ndarray:
    columns = signals(flown(told))
    record = Table(np.arange(len(columns["q"])) / TICK_HZ, columns, aircraft, 0)
    found = {p.name: p.value for p in identify(record, aircraft, Request((method,))).methods[method].parameters}
    return np.array([found[name] for name in LONGITUDINAL])


def test_the_thrust_changes_with_the_motion() -> None:
    thrust = flown()["thrust"]
    assert np.std(thrust) > 0.1 * np.mean(thrust)


def test_coefficients_are_those_of_the_air_alone() -> None:
    columns = flown()
    motion = signals(columns)
    c = coefficients(motion, Airframe.of(AIRCRAFT), columns["alpha"], 1 / TICK_HZ)
    np.testing.assert_allclose(c.CL, columns["CL"], rtol=1e-9)
    np.testing.assert_allclose(c.Cm, columns["Cm"], rtol=1e-9, atol=1e-12)
    polar = AIRCRAFT.drag
    assert polar is not None
    np.testing.assert_allclose(c.CD, polar.zero_lift + polar.induced * c.CL**2, rtol=1e-9)


def test_derivatives_do_not_show_where_the_thrust_acts() -> None:
    """Equation error differs from the table by up to 2 % in either flight (the transform ends while the motion dies
    away); the thrust line adds nothing to that, but 5 % and more where the estimator's profile has none."""
    np.testing.assert_allclose(live(AIRCRAFT), live(UNTOLD, told=False), rtol=3e-3)
    np.testing.assert_allclose(post_flight(AIRCRAFT, "I"), post_flight(UNTOLD, "I", told=False), rtol=3e-3)
    assert abs(live(UNTOLD)[4] / live(AIRCRAFT)[4] - 1) > 0.05
    assert abs(post_flight(UNTOLD, "I")[4] / post_flight(AIRCRAFT, "I")[4] - 1) > 0.05


def test_output_error_gives_the_table() -> None:
    np.testing.assert_allclose(post_flight(AIRCRAFT, "oe"), TRUTH, rtol=5e-3)

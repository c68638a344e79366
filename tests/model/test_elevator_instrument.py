"""What the elevator alone does by the profile, the instrument of the warnings in flight, for aircraft of any size."""

import math

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from station.model import consistency as c
from station.numerics.named_state import packed
from station.profile import load_aircraft

DT = 0.02
SPEED, PRESSURE = 56.59, 1820.0
TWIN_OTTER = load_aircraft("twin_otter")


def subject(share_of_iyy, **derivatives):
    """The Twin Otter with another inertia and other derivatives, its vane at the CG."""
    made = {n: TWIN_OTTER.derivatives[n].model_copy(update={"value": v}) for n, v in derivatives.items()}
    inertia = TWIN_OTTER.inertia.model_copy(update={"iyy": TWIN_OTTER.inertia.iyy * share_of_iyy})
    boom = TWIN_OTTER.boom.model_copy(update={"vane_x": 0.0})
    update = {"inertia": inertia, "boom": boom, "derivatives": {**TWIN_OTTER.derivatives, **made}}
    return TWIN_OTTER.model_copy(update=update)


def instrument(aircraft, elevator):
    """Means over 0.1 s of the angle of attack that the elevator (n,) makes, rad."""
    constants, state = packed(c.constants(aircraft, (0.0, 0.0, 0.0), DT)[0]), c.at_rest()
    made = []
    for de in elevator:
        u = np.full(c.INPUTS, math.nan)
        given = {"elevator": de, "airspeed": SPEED, "dynamic_pressure": PRESSURE}
        for name, value in given.items():
            u[c.SIGNALS_USED.index(name)] = value
        if c.add(constants, state, u, np.zeros(c.OF_ITS_TIME)):
            made.append(state["means"][0, len(made) % c.KEEP, c.FLOW_Z])
    return np.array(made)


def doublet(seconds):
    t = np.arange(round(seconds / DT)) * DT
    return np.interp(t, [1.0, 1.1, 1.3, 1.5, 1.7, 1.8], [0.0, 0.05, 0.05, -0.05, -0.05, 0.0])


@pytest.mark.parametrize(("share", "cm_q", "hz"), [(1.0, -34.2, 0.47), (0.06, -34.2, 1.9), (0.06, -3.0, 1.57)])
def test_it_follows_the_short_period_of_small_aircraft_too(share, cm_q, hz):
    aircraft = subject(share, Cm_q=cm_q)
    v, chord = aircraft.value, aircraft.geometry.chord
    force = PRESSURE * aircraft.geometry.wing_area
    lift, pitch = force / (aircraft.inertia.mass * SPEED), force * chord / aircraft.inertia.iyy
    a = [[-lift * v("CL_alpha"), 1.0], [pitch * v("Cm_alpha"), pitch * v("Cm_q") * chord / (2 * SPEED)]]
    b = [[-lift * v("CL_de")], [pitch * v("Cm_de")]]
    assert math.sqrt(np.linalg.det(a)) / (2 * math.pi) == pytest.approx(hz, rel=0.1)
    fine = np.arange(0, 8.0, DT / 10)
    moved = np.interp(fine, np.arange(len(doublet(8.0))) * DT, doublet(8.0))
    exact = lsim(StateSpace(a, b, [[1.0, 0.0]], [[0.0]]), moved, fine)[1]
    # Each step takes the elevator of its end: half a tick ahead of the mean.
    wanted = np.interp(np.arange(len(doublet(8.0))) * DT + DT / 2, fine, exact)
    wanted = wanted.reshape(-1, 5).mean(axis=1)
    found = instrument(aircraft, doublet(8.0))
    assert np.abs(found - wanted).max() < 0.06 * np.abs(wanted).max()


def test_an_unstable_aircraft_does_not_run_away():
    found = instrument(subject(1.0, Cm_alpha=3.0), doublet(60.0))
    assert np.isfinite(found).all()
    assert np.abs(found).max() < 1.0

"""Flow that leaves the wing: against Kirchhoff's limits, a lag written out, and the residuals that diagnosis makes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from station.numerics import separation as compared_law
from station.numerics.separation import attached, lift_left
from station.profile import Aircraft, Doublet, Flight, Separation, load_aircraft
from station.rows import ProfileError
from station.simulation import Simulation
from station.simulation import stalling as flown_law
from station.simulation.airframe import find_trim
from station.simulation.stalling import BRIEF

SPEED, HEIGHT = 56.6, 762.0
PUSH_AND_PULL = {"kind": "doublet", "start": 1.0, "amplitude": 0.08, "width": 1.2}


def leaving(**keys: float) -> Aircraft:
    """A Twin Otter of quasi-steady lift whose flow leaves the wing."""
    plain = load_aircraft("twin_otter")
    unsteady = plain.unsteady.model_copy(update={"memory": False})
    return plain.model_copy(update={"unsteady": unsteady, "separation": plain.separation.model_copy(update=keys)})


def flown(aircraft: Aircraft, steps: int = 1600) -> dict[str, np.ndarray]:
    shape = Doublet.model_validate(PUSH_AND_PULL, context="si")
    return dict(Simulation(aircraft, Flight(), (shape,)).advance(steps))


@pytest.mark.parametrize("alpha", [0.0, 0.2, 0.31, 0.6])
def test_what_is_flown_and_what_is_compared_are_one_law(alpha: float) -> None:
    """It is written twice: residuals must not be right by the simulation's own mistake."""
    law = Separation(alpha_star="0.3 rad", a1=17.0)
    assert flown_law.steady(law, alpha) == pytest.approx(compared_law.steady(law, alpha))


def test_half_of_the_flow_has_left_at_alpha_star_and_a_quarter_of_the_lift_stays_without_any() -> None:
    """Kirchhoff: a plate with all of its flow separated keeps a quarter of its lift."""
    assert attached(0.3, 20.0, 0.3) == pytest.approx(0.5)
    assert attached(0.1, 20.0, 0.3) == pytest.approx(1.0, abs=1e-3)
    assert (lift_left(1.0), lift_left(0.0)) == (1.0, 0.25)
    # Half: (1 + sqrt(1/2))^2 / 4.
    assert lift_left(0.5) == pytest.approx(0.7285, abs=1e-4)


def test_flow_that_leaves_beyond_the_flight_changes_nothing() -> None:
    plain, other = flown(leaving()), flown(leaving(alpha_star=1.0))
    for name in ("alpha", "az", "q"):
        np.testing.assert_allclose(other[name], plain[name], atol=1e-8)


def test_lift_in_flight_is_what_the_lag_leaves() -> None:
    """X by an integrator of scipy along the angle of attack that was flown."""
    a1, star, tau1, tau2, rising, none = 25.0, math.radians(6), 12.0, 8.0, 5.0, math.radians(-3)
    aircraft = leaving(a1=a1, alpha_star=star, tau1=tau1, tau2=tau2, tau2_rising=rising, Cm_X=-0.05, alpha_0=none)
    x = flown(aircraft)
    t, alpha, v = x["time"], x["alpha"], x["airspeed"]
    chord = aircraft.geometry.chord
    assert alpha.max() > star

    def rates(now: float, y: np.ndarray) -> list[float]:
        a, passage = np.interp(now, t, alpha), chord / np.interp(now, t, v)
        turning = (a - y[1]) / BRIEF
        late = (rising if turning > 0 else tau2) * passage * turning
        towards = 0.5 * (1 - math.tanh(a1 * (a - late - star)))
        return [(towards - y[0]) / (tau1 * passage), turning]

    start = [0.5 * (1 - math.tanh(a1 * (alpha[0] - star))), alpha[0]]
    share = solve_ivp(rates, (t[0], t[-1]), start, t_eval=t, max_step=0.02).y[0]
    d = aircraft.value
    qhat = 0.5 * x["q"] * chord / v
    left = 0.25 * (1 + np.sqrt(share)) ** 2
    circulatory = d("CL_alpha") * (none + left * (alpha - none))
    lift = d("CL_0") + circulatory + d("CL_q") * qhat + d("CL_de") * x["elevator"]
    moment = d("Cm_0") + d("Cm_alpha") * alpha + d("Cm_q") * qhat + d("Cm_de") * x["elevator"] - 0.05 * (1 - share)
    # The share is held over a step of 5 ms: of the lift that goes, a hundredth.
    assert np.ptp(left) > 0.1
    assert np.abs(x["CL"] - lift).max() < 0.01 * np.ptp(left * alpha) * d("CL_alpha")
    assert np.abs(x["Cm"] - moment).max() < 0.01 * 0.05


def test_trim_is_found_with_the_lift_that_is_left() -> None:
    plain, stalling = leaving(), leaving(alpha_star=math.radians(9))
    at = find_trim(stalling, 53.0, HEIGHT)
    assert at.alpha > find_trim(plain, 53.0, HEIGHT).alpha
    x = Simulation(stalling, Flight().model_copy(update={"speed": 53.0}), ()).advance(400)
    assert np.ptp(x["alpha"]) < 1e-6
    with pytest.raises(ProfileError, match="no trim"):
        find_trim(leaving(alpha_star=math.radians(2)), 40.0, HEIGHT)

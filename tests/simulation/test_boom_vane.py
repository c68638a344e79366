"""The vane model driven with sines, against the tables of the boom's physics, and its signs."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np
import pytest

from station.profile import Boom, load_aircraft
from station.simulation.airframe import indicial_table
from station.simulation.boom import flow_angle, lag, second_order_step, upwash_step, vane_constants

SPEED = 185.66 * 0.3048
CHORD = 6.46 * 0.3048
DT = 0.005
AIRCRAFT = load_aircraft("twin_otter")
BOOM, UNSTEADY = AIRCRAFT.boom, AIRCRAFT.unsteady
assert BOOM is not None
VANE = vane_constants(BOOM, DT)
MOTION, GUST = indicial_table(UNSTEADY.upwash_motion), indicial_table(UNSTEADY.upwash_gust)
AMPLITUDE = 1e-3


def response(f: float, step: Callable[[float], float]) -> complex:
    """Output over input at f Hz for an input of AMPLITUDE sin(2 pi f t), after the lags have settled."""
    settle, n = 6.0, 200 * math.ceil(4 / f) * math.ceil(f)
    t = np.arange(round(settle / f) * 200 + 2000 + n) * DT
    y = np.array([step(float(s)) for s in t])[-n:]
    e = np.exp(-2j * math.pi * f * t[-n:])
    return complex(2j * np.mean(y * e) / AMPLITUDE)


def upwash(f: float, table: np.ndarray) -> complex:
    state = np.zeros(table.shape[1])
    last = [0.0]

    def step(t: float) -> float:
        new = AMPLITUDE * math.sin(2 * math.pi * f * t)
        out = upwash_step(table, state, last[0], new, SPEED * DT / CHORD)
        last[0] = new
        return float(out)

    return response(f, step)


UPWASH = {  # f: motion gain, degrees; gust gain, degrees
    0.1: (0.993, -5, 0.993, -6),
    0.5: (0.889, -19, 0.887, -24),
    1.0: (0.755, -31, 0.750, -40),
    2.0: (0.547, -44, 0.532, -62),
    5.0: (0.282, -48, 0.240, -93),
}


@pytest.mark.parametrize("f", UPWASH)
def test_upwash_memory_is_the_vortex_lattices(f: float) -> None:
    gain_m, phase_m, gain_g, phase_g = UPWASH[f]
    for table, gain, phase in ((MOTION, gain_m, phase_m), (GUST, gain_g, phase_g)):
        h = upwash(f, table)
        assert abs(h) == pytest.approx(gain, abs=0.005)
        assert math.degrees(cmath.phase(h)) == pytest.approx(phase, abs=2.0)


def test_two_chords_after_a_step_of_motion_half_the_upwash_is_there() -> None:
    state = np.zeros(MOTION.shape[1])
    out = [upwash_step(MOTION, state, 1.0, 1.0, 0.01) for _ in range(200)]
    assert out[-1] == pytest.approx(0.50, abs=0.005)


APPARENT = {  # f: motion gain, lag ms; gust gain, lead ms
    0.1: (0.999, 24, 0.998, 60),
    0.5: (0.988, 21, 0.975, 65),
    1.0: (0.978, 18, 0.944, 71),
    2.0: (0.982, 16, 0.923, 77),
    3.0: (1.017, 15, 0.955, 79),
}


TWO_TERMS = np.array([[0.1985, 0.8015], [0.1043, 0.3140]])
"""The coarser fit of the gust's upwash, which the table below was made with."""


def vane(f: float, motion: bool) -> complex:
    """The steadily calibrated vane's reading of an incidence of AMPLITUDE sin(2 pi f t) at the CG."""
    memory_m, memory_g, state = np.zeros(MOTION.shape[1]), np.zeros(2), np.zeros(3)
    last = [0.0, 0.0]

    def step(t: float) -> float:
        def at(x: float) -> float:  # a gust meets what is x ahead of the CG x/V earlier
            return AMPLITUDE * math.sin(2 * math.pi * f * (t + x / SPEED))

        angle, met = (at(0.0), 0.0) if motion else (0.0, at(0.25 * CHORD))
        wing = upwash_step(MOTION, memory_m, last[0], angle, SPEED * DT / CHORD)
        wing += upwash_step(TWO_TERMS, memory_g, last[1], met, SPEED * DT / CHORD)
        last[:] = angle, met
        wg = 0.0 if motion else SPEED * math.tan(at(VANE.x))
        flow = flow_angle(VANE, SPEED * math.cos(angle), SPEED * math.sin(angle), 0.0, 0.0, wg, wing)
        return float(second_order_step(VANE.dynamics, state, flow)) * BOOM.steady_calibration

    return response(f, step)


@pytest.mark.parametrize("f", APPARENT)
def test_apparent_gain_and_delay_of_a_steadily_calibrated_vane(f: float) -> None:
    gain_m, lag_ms, gain_g, lead_ms = APPARENT[f]
    for motion, gain, ms in ((True, gain_m, -lag_ms), (False, gain_g, lead_ms)):
        h = vane(f, motion)
        assert abs(h) == pytest.approx(gain, abs=0.003)
        assert 1000 * cmath.phase(h) / (2 * math.pi * f) == pytest.approx(ms, abs=1.0)


def test_vane_dynamics_are_the_second_order_systems() -> None:
    for f in (1.0, 5.0, 9.0, 15.0):
        state, last = np.zeros(3), 2 * math.pi * f

        def step(t: float, state: np.ndarray = state, w: float = last) -> float:
            return float(second_order_step(VANE.dynamics, state, AMPLITUDE * math.sin(w * t)))

        s, wn = 2j * math.pi * f, 2 * math.pi * 9
        exact = wn**2 / (s**2 + 2 * 0.35 * wn * s + wn**2)
        hold = np.sinc(f * DT) ** 2  # a sine drawn as straight lines between samples has this much of itself
        assert response(f, step) == pytest.approx(exact * hold, abs=2e-3)


def test_a_lag_is_exact_on_a_straight_line() -> None:
    """Output of a unit lag to a ramp t is t - 1 + exp(-t)."""
    state = 0.0
    for k in range(10):
        state = lag(state, 0.7 * k, 0.7 * (k + 1), 0.7)
    assert state == pytest.approx(7.0 - 1 + math.exp(-7.0), rel=1e-12)


BARE = vane_constants(Boom.model_validate({"vane_x": "5.3 m"}), DT)


def test_signs_nose_up_2_deg_in_still_air_on_a_level_path() -> None:
    two = math.radians(2)
    assert flow_angle(BARE, 56.6 * math.cos(two), 56.6 * math.sin(two), 0.0, 0.0, 0.0, 0.0) == pytest.approx(
        0.0349, abs=1e-4
    )


def test_signs_a_nose_up_rate_lowers_the_reading_by_q_r_over_v() -> None:
    assert flow_angle(BARE, 56.6, 0.0, 0.1, 0.0, 0.0, 0.0) == pytest.approx(-0.1 * 5.3 / 56.6, rel=1e-4)


def test_signs_an_updraught_raises_it_and_a_headwind_lowers_it() -> None:
    assert flow_angle(BARE, 56.6, 0.0, 0.0, 0.0, 1.0, 0.0) == pytest.approx(1 / 56.6, rel=1e-3)
    assert flow_angle(BARE, 56.6, 3.0, 0.0, 5.0, 0.0, 0.0) < flow_angle(BARE, 56.6, 3.0, 0.0, 0.0, 0.0, 0.0)


def test_steady_reading_is_the_flow_angle_over_the_calibration() -> None:
    angle = 0.05
    reading = flow_angle(VANE, 56.6 * math.cos(angle), 56.6 * math.sin(angle), 0.0, 0.0, 0.0, angle)
    assert reading * 0.85 == pytest.approx(angle, rel=1e-3)

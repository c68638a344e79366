"""The boom's bending mode and load, and gusts averaged along the span, against closed forms."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from station.profile import Aircraft, Boom, Doublet, Flight, load_aircraft
from station.simulation import Simulation
from station.simulation.airframe import indicial_tables, span_averaged
from station.simulation.boom import bending, second_order, second_order_step, tip_force, vane_constants
from station.simulation.motion import DT

MODE, ZETA = 8.0, 0.03
G_PER_DEG = math.radians(0.05) / 9.81


def boom(**keys: object) -> Boom:
    return Boom.model_validate({"vane_x": "5.3 m", **keys})


def test_mode_has_its_frequency_and_damping() -> None:
    """Released from a load: free vibration of a damped oscillator, exactly."""
    wn, state = 2 * math.pi * MODE, np.array([1e-3, 0.0, 0.0])
    mode = second_order(MODE, ZETA, DT)
    found = np.array([second_order_step(mode, state, 0.0) for _ in range(300)])
    t, wd = (1 + np.arange(300)) * DT, wn * math.sqrt(1 - ZETA**2)
    decay = 1e-3 * np.exp(-ZETA * wn * t)
    np.testing.assert_allclose(found, decay * (np.cos(wd * t) + ZETA * wn / wd * np.sin(wd * t)), atol=1e-12)


@pytest.mark.parametrize("f", [1.0, 4.0, 8.0, 12.0])
def test_response_to_the_load_is_the_second_orders(f: float) -> None:
    """Normal acceleration shaken at f: bending and what the tip's velocity takes off, after the start has died away."""
    v = vane_constants(boom(flexure="0.05 deg/g", mode_frequency="8 Hz", mode_length="3.5 m"), DT)
    speed, amplitude, state = 56.6, 5.0, np.zeros(3)
    n = round(20 / DT)
    t = np.arange(n) * DT
    out = np.array(
        [
            bending(v, state, k == 0, float(amplitude * math.sin(2 * math.pi * f * x)), 0.0, 0.0, speed, 0.0)
            for k, x in enumerate(t)
        ]
    )
    last = slice(n - round(8 / DT), n)
    found = 2j * np.mean(out[last] * np.exp(-2j * math.pi * f * t[last])) / amplitude
    s, wn = 2j * math.pi * f, 2 * math.pi * MODE
    exact = G_PER_DEG * 9.81 / 9.80665 * (1 - 3.5 * s / speed) * wn**2 / (s**2 + 2 * ZETA * wn * s + wn**2)
    # A sine drawn in straight lines between samples has sinc^2 of itself.
    assert found == pytest.approx(exact * np.sinc(f * DT) ** 2, abs=0.01 * abs(exact))


@pytest.mark.parametrize("f", [2.0, 7.0, 8.0, 10.0])
def test_an_accelerometer_at_the_tip_feels_the_modes_own_acceleration(f: float) -> None:
    """Shaken at f: specific force at the CG, less what the tip rises by, differentiated twice in closed form."""
    v = vane_constants(boom(flexure="0.05 deg/g", mode_frequency="8 Hz", mode_length="3.5 m"), DT)
    amplitude, state = 5.0, np.zeros(3)
    n = round(20 / DT)
    t = np.arange(n) * DT
    felt = np.empty(n)
    for k, x in enumerate(t):
        az = float(amplitude * math.sin(2 * math.pi * f * x))
        bending(v, state, k == 0, az, 0.0, 0.0, 56.6, 0.0)
        felt[k] = tip_force(v, state, az, 0.0, 0.0)
    last = slice(n - round(8 / DT), n)
    found = 2j * np.mean(felt[last] * np.exp(-2j * math.pi * f * t[last])) / amplitude
    s, wn = 2j * math.pi * f, 2 * math.pi * MODE
    bent = G_PER_DEG * 9.81 / 9.80665 * wn**2 / (s**2 + 2 * ZETA * wn * s + wn**2)
    # A sine drawn in straight lines between samples has sinc^2 of itself.
    assert found == pytest.approx(1 - 3.5 * s**2 * bent, abs=0.03 * abs(1 - 3.5 * s**2 * bent))


def test_a_tip_without_a_mode_moves_with_the_aircraft() -> None:
    """Levers of a rigid body: az - qdot x - q^2 z."""
    v = vane_constants(boom(vane_z="-0.4 m"), DT)
    assert tip_force(v, np.zeros(3), -9.0, 0.2, 1.5) == pytest.approx(-9.0 - 1.5 * 5.3 + 0.04 * 0.4)


def test_static_bending_is_the_load_with_a_mode_or_without() -> None:
    for mode in ({}, {"mode_frequency": "8 Hz"}):
        v = vane_constants(boom(flexure="0.05 deg/g", tip_load=0.01, **mode), DT)
        state = np.zeros(3)
        for k in range(3):
            angle = bending(v, state, k == 0, -2 * 9.80665, 0.0, 1800.0, 56.6, 0.05)
        assert angle == pytest.approx(-2 * math.radians(0.05) + 0.01 * 1.8 * 0.05, rel=1e-9)


def test_pitching_up_loads_the_boom_with_its_own_mass() -> None:
    v = vane_constants(boom(flexure="0.05 deg/g", mode_frequency="8 Hz"), DT)
    assert bending(v, np.zeros(3), True, -9.80665, 1.0, 0.0, 56.6, 0.0) == pytest.approx(
        math.radians(0.05) * (-1 - 5.3 / 9.80665), rel=1e-9
    )


def changed(aircraft: Aircraft, part: str, **keys: object) -> Aircraft:
    return aircraft.model_copy(update={part: getattr(aircraft, part).model_copy(update=keys)})


def test_a_flight_with_the_mode_rings_at_it_and_nothing_else_changes() -> None:
    kick = Doublet.model_validate({"kind": "doublet", "start": "1 s", "width": "0.5 s", "amplitude": "4 deg"})
    plain = changed(load_aircraft("twin_otter"), "boom", vane_frequency=40.0, vane_damping=0.7)
    shaky = changed(plain, "boom", flexure=G_PER_DEG * 20, mode_frequency=MODE, mode_length=3.5)
    still, rung = (Simulation(a, Flight(), [kick]).advance(2000) for a in (plain, shaky))
    for name, values in still.items():
        if name not in ("alpha_vane", "az_boom"):
            np.testing.assert_array_equal(rung[name], values, err_msg=name)
    extra = (rung["alpha_vane"] - still["alpha_vane"])[600:1800]
    bare = np.diff(extra, 2)
    spectrum = np.abs(np.fft.rfft(bare * np.hanning(len(bare))))
    assert np.fft.rfftfreq(len(bare), DT)[np.argmax(spectrum)] == pytest.approx(MODE, abs=0.25)


def response(table: np.ndarray, f: float, chords_per_s: float) -> complex:
    s = 2j * math.pi * f
    return complex(1 - np.sum(table[0] * s / (s + table[1] * chords_per_s)))


@pytest.mark.parametrize("length", [0.3, 1.5, 1 / 0.3073])
def test_span_average_is_a_first_order_lag_behind_the_gusts_response(length: float) -> None:
    """Also where the lag's exponent is one of the response's own, where the closed form has a double root."""
    gust = load_aircraft("twin_otter").unsteady.lift_gust
    assert gust is not None
    table = np.array([gust.a, gust.b])
    for f in (0.1, 1.0, 5.0):
        expected = response(table, f, 28.7) / (1 + 2j * math.pi * f * length / 28.7)
        assert response(span_averaged(table, length), f, 28.7) == pytest.approx(expected, abs=1e-5)
    np.testing.assert_array_equal(span_averaged(table, 0.0), table)
    assert span_averaged(table, length)[0].sum() == pytest.approx(1.0, abs=1e-5)  # nothing of a gust is felt at once


def test_the_profile_states_the_averaging_length_in_metres() -> None:
    aircraft = changed(load_aircraft("twin_otter"), "unsteady", gust_span=6.0)
    chords = 56.6 / aircraft.unsteady.reference_chord
    made, plain = indicial_tables(aircraft).lift_gust, indicial_tables(load_aircraft("twin_otter")).lift_gust
    expected = response(plain, 2.0, chords) / (1 + 2j * math.pi * 2.0 * 6.0 / 56.6)
    assert response(made, 2.0, chords) == pytest.approx(expected, abs=1e-9)


def test_a_quarter_of_the_span_averages_as_isotropic_turbulence_does() -> None:
    """Mean over the span of w of a two-dimensional isotropic field of Dryden's correlation: what is left of its power.

    The plane's spectrum of w whose cut along the way is Dryden's is, but for a factor, (k L)^2 / (1 + (k L)^2)^(5/2).
    """
    span, length = 19.8, 533.0

    def left(omega: float) -> float:
        def power(across: float) -> float:
            k2 = (omega**2 + across**2) * length**2
            return float(k2 / (1 + k2) ** 2.5)

        def seen(across: float) -> float:
            return power(across) * float(np.sinc(across * span / 2 / math.pi)) ** 2

        top = 40 * max(omega, 1 / span)
        parts = [0.0, omega, 4 * omega, top]
        whole, kept = (sum(quad(g, a, b, limit=400)[0] for a, b in itertools.pairwise(parts)) for g in (power, seen))
        return kept / whole

    for f in (0.2, 0.5, 1.0, 2.0):  # above, an average falls as 1/f, a lag as 1/f^2
        omega = 2 * math.pi * f / 56.6
        lag = 1 / (1 + (omega * span / 4) ** 2)
        assert lag == pytest.approx(left(omega), abs=0.065)

"""Signals of method `physical` at every tick: delays and memories against scipy and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lsim, lti

from station.model import physical_signals as ps
from station.numerics.named_state import blank, packed
from station.profile import Aircraft, load_aircraft

DT = 0.02


def signals(aircraft: Aircraft, gust: np.ndarray, motion: np.ndarray, speed: float, upwash: float = 0.0) -> np.ndarray:
    """`upwash`: of gusts at the vane, as a share of the gust there."""
    constants, state, rows = packed(ps.constants(aircraft, DT))[0], blank(ps.State)[0], []
    for g, x in zip(gust, motion, strict=True):
        ps.step(constants, state, float(g), upwash * float(g), float(x), speed, speed, 0.05)
        rows.append(state["signals"][1].copy())
    return np.array(rows).T


def test_the_vane_is_undone_and_the_gust_arrives_in_time() -> None:
    aircraft, speed, f = load_aircraft("twin_otter"), 56.6, 0.9
    boom, arm = aircraft.boom, aircraft.unsteady.tail_arm
    assert boom is not None
    t = np.arange(2000) * DT
    wn = 2 * math.pi * boom.vane_frequency
    s = 2j * math.pi * f
    seen = wn**2 / (s**2 + 2 * boom.vane_damping * wn * s + wn**2)
    gust = 0.01 * (seen * np.exp(s * t)).real
    out = signals(aircraft, gust, np.full_like(t, 0.05), speed)

    def at(x: float) -> np.ndarray:
        return 0.01 * (np.exp(s * (t - (boom.vane_x - x) / speed))).real

    for name, place in ((ps.GC, 0.0), (ps.GT, -arm)):
        np.testing.assert_allclose(out[name, 500:], at(place)[500:], atol=2e-5)
    edge = at(aircraft.geometry.chord / 4)
    response = aircraft.unsteady.lift_gust
    assert response is not None
    per_second = speed / aircraft.unsteady.reference_chord
    for a, b in zip(response.a, response.b, strict=True):
        # 1 - a s/(s + b) for each term, by an independent simulation
        rate = b * per_second
        edge = edge - a * lsim(lti([1.0, 0.0], [1.0, rate]), at(aircraft.geometry.chord / 4), t)[1]
    np.testing.assert_allclose(out[ps.KG, 500:], edge[500:], atol=6e-5)


def test_what_a_span_takes_from_the_upwash_at_the_vane_is_a_gust_at_wing_and_tail() -> None:
    """Transfer functions of a sine: the upwash less that behind a lag of b/(V corner), carried to the leading edge and
    to the tail, through Kuessner's lift."""
    aircraft, speed, f, share = load_aircraft("twin_otter"), 56.6, 0.9, 0.1
    boom, arm, response = aircraft.boom, aircraft.unsteady.tail_arm, aircraft.unsteady.lift_gust
    assert boom is not None
    assert response is not None
    t, s = np.arange(2000) * DT, 2j * math.pi * f
    wn = 2 * math.pi * boom.vane_frequency
    shown = wn**2 / (s**2 + 2 * boom.vane_damping * wn * s + wn**2)
    out = signals(aircraft, 0.01 * (shown * np.exp(s * t)).real, np.full_like(t, 0.05), speed, share)
    chords = s * aircraft.unsteady.reference_chord / speed
    lift = 1 - sum(a * chords / (chords + b) for a, b in zip(response.a, response.b, strict=True))
    for corner, (wing, wash, tail) in zip(ps.CORNERS, ps.FREED, strict=True):
        lag = s * aircraft.geometry.span / (corner * speed)
        freed = 0.01 * share * lag / (1 + lag)

        def at(x: float, of: complex) -> np.ndarray:
            return np.asarray((of * np.exp(s * (t - (boom.vane_x - x) / speed))).real)

        edge = aircraft.geometry.chord / 4
        late = arm + aircraft.unsteady.downwash_delay * speed
        for name, wanted in (
            (wing, at(edge, freed * lift)), (tail, at(-arm, freed)), (wash, at(edge - late, freed * lift)),
        ):  # fmt: skip
            np.testing.assert_allclose(out[name, 700:], wanted[700:], atol=1e-5)


def test_motion_has_its_unsteady_lift_and_its_downwash_comes_a_tail_arm_later() -> None:
    aircraft, speed = load_aircraft("twin_otter"), 56.6
    t = np.arange(1500) * DT
    motion = 0.05 + 0.03 * np.sin(2 * math.pi * 0.7 * t) * (t > 1)
    out = signals(aircraft, np.zeros_like(t), motion, speed)
    response = aircraft.unsteady.lift_motion
    assert response is not None
    wing = motion.copy()
    for a, b in zip(response.a, response.b, strict=True):
        rate = b * speed / aircraft.unsteady.reference_chord
        wing -= a * lsim(lti([1.0, 0.0], [1.0, rate]), motion - motion[0], t)[1]
    np.testing.assert_allclose(out[ps.WX], wing, atol=1e-9)
    late = aircraft.unsteady.tail_arm / speed
    np.testing.assert_allclose(out[ps.DW, 200:], np.interp(t[200:] - late, t, out[ps.WX]), atol=5e-5)
    np.testing.assert_allclose(out[ps.GC], 0.0, atol=1e-15)


def test_the_carried_wind_meets_the_speed_of_its_arrival() -> None:
    """The same wind at twice the speed on arrival is half the angle; a steady headwind gust alone is no incidence."""
    aircraft = load_aircraft("twin_otter")
    constants, state = packed(ps.constants(aircraft, DT))[0], blank(ps.State)[0]
    for _ in range(400):
        ps.step(
            constants, state, 0.0, 0.0, 0.05, 60.0, 50.0, 0.05
        )  # 10 m/s of headwind gust, vane shows no vertical gust
    assert state["signals"][1, ps.GC] == pytest.approx(0.0, abs=1e-4)

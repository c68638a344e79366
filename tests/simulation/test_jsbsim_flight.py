"""JSBSim's DHC-6 as a source of flights: what our boom, sensors, gusts and inputs add to it, and that it is its own."""

from __future__ import annotations

import builtins
import math
from typing import Any

import numpy as np
import pytest

from station.conventions import SIGNALS
from station.profile import Instrument, load_aircraft, load_card
from station.rows import ProfileError
from station.simulation import fly
from station.simulation.jsbsim_flight import JsbsimFlight, trimmed
from station.simulation.motion import DT, FLOWN
from station.simulation.truth import TRUTH

CARD = load_card("jsbsim")
SLUG_FT2 = 1.3558179483


def flown(seconds: float, sigma: float = 0.0, aircraft: Any = None, **keys: Any) -> dict[str, np.ndarray]:
    flight = CARD.card.flight.model_copy(update={"gust_sigma": sigma, **keys})
    soon = tuple(m.model_copy(update={"start": m.start - 24.0}) for m in CARD.card.manoeuvres)
    return JsbsimFlight(aircraft or CARD.aircraft, flight, soon).advance(round(seconds / DT))


@pytest.fixture(scope="module")
def calm() -> dict[str, np.ndarray]:
    return flown(30.0)


@pytest.fixture(scope="module")
def gusty() -> dict[str, np.ndarray]:
    return flown(25.0, 1.524)


def test_it_is_trimmed_and_gives_every_signal_in_range(calm: dict[str, np.ndarray]) -> None:
    assert set(calm) == {"time", *FLOWN, *TRUTH}
    for name, signal in ((n, SIGNALS[n]) for n in FLOWN):
        assert (calm[name] >= signal.low).all(), name
        assert (calm[name] <= signal.high).all(), name
    before = slice(0, 190)
    for name, most in (("alpha", 5e-4), ("airspeed", 0.3), ("altitude", 1.0), ("phi", 2e-3)):
        assert np.ptp(calm[name][before]) < most, name
    assert calm["airspeed"][0] == pytest.approx(56.59, rel=0.01)
    assert calm["altitude"][0] == pytest.approx(762.0, abs=10.0)
    assert calm["az"][0] == pytest.approx(-9.8007 * math.cos(calm["theta"][0]), abs=0.03)


def test_the_profile_is_that_of_the_aircraft_flown() -> None:
    sim, inertia = trimmed(56.59, 762.0), CARD.aircraft.inertia
    for name, found in (("ixx", inertia.ixx), ("iyy", inertia.iyy), ("izz", inertia.izz)):
        assert found == pytest.approx(sim[f"inertia/{name}-slugs_ft2"] * SLUG_FT2, rel=1e-3)
    assert inertia.mass == pytest.approx(sim["inertia/mass-slugs"] * 14.5939029, rel=1e-4)
    assert CARD.aircraft.geometry.wing_area == pytest.approx(sim["metrics/Sw-sqft"] * 0.3048**2)


def test_signals_agree_with_each_other(gusty: dict[str, np.ndarray]) -> None:
    """Rates integrate to attitude, accelerations to velocity, velocity to position: in JSBSim's units and axes too."""
    f = gusty
    sin_b, cos_b, sin_t, cos_t = np.sin(f["phi"]), np.cos(f["phi"]), np.sin(f["theta"]), np.cos(f["theta"])
    rates = {
        "theta": f["q"] * cos_b - f["r"] * sin_b,
        "phi": f["p"] + (f["q"] * sin_b + f["r"] * cos_b) * sin_t / cos_t,
        "q": f["qdot"],
        "v_down": 9.8007 + f["az"] * cos_b * cos_t + f["ay"] * sin_b * cos_t - f["ax"] * sin_t,
        "altitude": -f["v_down"],
        "latitude": f["v_north"] / 6.3627e6,
    }
    for name, rate in rates.items():
        made = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * DT)))
        moved = f[name] - f[name][0]
        # Normal gravity at 41.4 N and 762 m; the trapezium's error where JSBSim's tables have corners.
        assert np.abs(moved - made).max() < (0.1 if name == "v_down" else 0.02 * np.ptp(moved)), name
    ground = np.sqrt(f["v_north"] ** 2 + f["v_east"] ** 2 + f["v_down"] ** 2)
    u, w = ground * np.cos(f["alpha_inertial"]), ground * np.sin(f["alpha_inertial"])
    through = np.hypot(u + f["u_gust"], w + f["w_gust"])
    assert np.abs(f["airspeed"] - through).max() < 0.3  # the side gust: 5 m/s across 57 m/s
    assert np.std(f["airspeed"] - through) < 0.05 * np.std(f["airspeed"] - ground)


def test_the_gust_is_felt_at_the_cg_and_shown_by_the_vane_before(gusty: dict[str, np.ndarray]) -> None:
    f = gusty
    ground = np.sqrt(f["v_north"] ** 2 + f["v_east"] ** 2 + f["v_down"] ** 2)
    u, w = ground * np.cos(f["alpha_inertial"]), ground * np.sin(f["alpha_inertial"])
    met = np.arctan2(w + f["w_gust"], u + f["u_gust"]) - f["alpha_inertial"]
    np.testing.assert_allclose(f["alpha_gust"], met, atol=1e-3)  # sideslip, which is in the ground speed, 5 deg at most
    assert f["w_gust"].std() > 0.4
    flow = 0.85 * (f["alpha_vane"] + 5.3 * f["q"] / f["airspeed"]) - f["alpha_inertial"]

    def likeness(lead: float) -> float:
        t = f["time"][400:-400]
        return float(np.corrcoef(np.interp(t - lead, f["time"], flow), f["alpha_gust"][400:-400])[0, 1])

    leads = np.arange(0.0, 0.16, 0.005)
    best = leads[np.argmax([likeness(x) for x in leads])]
    # The steadily calibrated vane shows gusts 60 to 79 ms early, whatever aircraft is behind the boom.
    assert 0.055 <= best <= 0.085
    assert likeness(best) > 0.97


def test_our_inputs_move_its_surfaces_and_signs_are_ours(calm: dict[str, np.ndarray]) -> None:
    """The first doublet: trailing edge down first, with the actuator's lag; the nose follows down."""
    k = round(1.5 / DT)
    assert calm["elevator"][k] - calm["elevator"][0] == pytest.approx(math.radians(3.5), rel=0.02)
    assert calm["q"][k] < -0.03
    for surface, rate, sign in (("aileron", "p", -1), ("rudder", "r", -1)):
        pulse = CARD.card.manoeuvres[0].model_copy(update={"surface": surface, "start": 0.2, "amplitude": 0.05})
        f = JsbsimFlight(CARD.aircraft, CARD.card.flight.model_copy(update={"gust_sigma": 0.0}), (pulse,)).advance(140)
        assert f[surface][100] - f[surface][0] > 0.03
        assert sign * f[rate][100] > 0.01


def test_its_derivatives_are_those_of_its_tables(calm: dict[str, np.ndarray]) -> None:
    """Least squares on CL and Cm as flown. Slopes of JSBSim's tables between 0 and 5 deg, moments about the CG; the
    lift's bends by a factor of two there, so the slopes are means."""
    f = calm
    hat = 0.5 * CARD.aircraft.geometry.chord / f["airspeed"]
    columns = np.stack([f["alpha"], f["q"] * hat, f["elevator"], np.ones_like(hat)], axis=1)
    for c in ("CL", "Cm"):
        found = np.linalg.lstsq(columns, f[c], rcond=None)[0]
        wanted = [CARD.aircraft.value(f"{c}_{a}") for a in ("alpha", "q", "de")]
        np.testing.assert_allclose(found[[0]], wanted[:1], rtol=0.2)
        if c == "Cm":
            np.testing.assert_allclose(found[1:3], wanted[1:], rtol=0.15)
        assert np.std(f[c] - columns @ found) < 0.2 * np.std(f[c])  # its tables have corners


def test_a_profile_s_play_and_instruments_are_flown_with_it() -> None:
    play = math.radians(1.0)
    worn = Instrument.model_validate({"backlash": play, "gain": 1.1})
    loose = CARD.aircraft.model_copy(update={"instruments": {"elevator": worn}})
    soon = tuple(m.model_copy(update={"start": m.start - 24.0}) for m in CARD.card.manoeuvres)
    shown, truth = fly(loose, CARD.rig.without_noise(), CARD.card.model_copy(update={"manoeuvres": soon}), 4.0)
    np.testing.assert_allclose(shown["elevator"], 1.1 * truth["elevator_drive"], atol=1e-12)
    assert np.abs(truth["elevator"] - truth["elevator_drive"]).max() == pytest.approx(play / 2)


def test_the_same_bits_again_in_pieces_and_other_air_with_another_seed() -> None:
    one = flown(1.5, 1.5)
    again = JsbsimFlight(CARD.aircraft, CARD.card.flight.model_copy(update={"gust_sigma": 1.5}))
    pieces = [again.advance(n) for n in (1, 99, 90)]
    np.testing.assert_array_equal(np.concatenate([p["az"] for p in pieces]), one["az"][:190])
    assert not np.array_equal(flown(0.5, 1.5, seed=2)["az"], one["az"][:100])


def test_it_says_what_is_missing_and_what_it_cannot_fly(monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    with pytest.raises(ProfileError, match="no trim at 20"):
        trimmed(20.0, 762.0)
    flown(0.1)
    assert capfd.readouterr().out == ""  # standard output is the emulators'
    actual = builtins.__import__

    def without(name: str, *more: Any, **keys: Any) -> Any:
        if name == "jsbsim":
            raise ImportError(name)
        return actual(name, *more, **keys)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ProfileError, match="pip install"):
        JsbsimFlight(load_aircraft("twin_otter"), CARD.card.flight)

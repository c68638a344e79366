"""Diagnosis of aircraft that the station was not developed on, with the noise of a rig: white."""

import math
from dataclasses import replace

import numpy as np
import pytest

from station.conventions import to_si
from station.diagnosis import effects as catalogue
from station.diagnosis.measured_record import Record, manoeuvres, why_not_flown
from station.diagnosis.procedure import diagnose
from station.profile import Aircraft, Card, Flight, load_aircraft, load_card, load_rig
from station.rows import UsageError
from station.simulation import fly

RIG = load_rig("bench")
SPEED, HEIGHT = 136.2, 100.0


def skyhawk() -> Aircraft:
    """A-4D at sea level, Mach 0.4, its vane at the CG. Nelson, Flight Stability and Automatic Control, appendix B."""
    twin = load_aircraft("twin_otter")
    values = {"CL_0": 0.0, "Cm_0": 0.01, "CL_alpha": 3.45, "CL_q": 3.0, "CL_de": 0.36, "Cm_alpha": -0.38}
    values |= {"Cm_q": -3.6, "Cm_de": -0.5}
    given = {
        "name": "skyhawk",
        "geometry": {"wing_area": "260 ft2", "span": "27.5 ft", "chord": "10.8 ft"},
        "inertia": {"mass": "17578 lb", "iyy": "25900 slug ft2"},
        "boom": {"vane_x": "0 m", "upwash_body": 0.1, "vane_frequency": "12 Hz", "vane_damping": 0.25},
        "derivatives": {name: {"value": value} for name, value in values.items()},
        "drag": {"zero_lift": 0.025, "induced": 0.12},
    }
    aircraft = Aircraft.model_validate(given)
    tail = {"tail_lift_slope": 0.5, "tail_arm": to_si(15, "ft"), "downwash": 0.45, "reference_chord": None}
    return aircraft.model_copy(update={"unsteady": twin.unsteady.model_copy(update=tail)})


def flown(subject: Aircraft, sigma_ft_s: float, kind: str, seed: int, seconds: float = 45.0):
    inputs = {
        "doublets": [
            {"kind": "doublet", "start": f"{5 + 12 * k} s", "width": f"{w} s", "amplitude": f"{2.5 * (-1) ** k} deg"}
            for k, w in enumerate((0.75, 1.3, 0.5))
        ],
        "3-2-1-1": [
            {"kind": "3-2-1-1", "start": f"{5 + 18 * k} s", "unit": f"{u} s", "amplitude": f"{2 * (-1) ** k} deg"}
            for k, u in enumerate((0.6, 0.4))
        ],
    }
    flight = Flight(speed=f"{SPEED} m/s", altitude=f"{HEIGHT} m", gust_sigma=f"{sigma_ft_s} ft/s")
    card = Card.model_validate({"name": kind, "aircraft": "", "rig": "", "flight": flight, "manoeuvres": inputs[kind]})
    return fly(subject, RIG, card, seconds, seed)


def record(subject: Aircraft, sigma_ft_s: float, kind: str, seed: int) -> Record:
    shown, _ = flown(subject, sigma_ft_s, kind, seed)
    found = manoeuvres(kind, 0.02 * np.arange(len(shown["q"])), shown, skyhawk())[0]
    return replace(found, imu=RIG.imu_position, stated=RIG.noise_si())


def test_a_profile_that_cannot_be_flown_says_what_it_lacks() -> None:
    whole = skyhawk()
    assert why_not_flown(whole) == ""
    without = whole.model_copy(update={"inertia": whole.inertia.model_copy(update={"iyy": None})})
    assert why_not_flown(without) == "the profile gives no inertia.iyy"
    assert why_not_flown(whole.model_copy(update={"derivatives": {}})) == "the profile gives no CL_alpha, Cm_de"


def test_a_banked_manoeuvre_is_refused() -> None:
    shown, _ = flown(skyhawk(), 0.0, "doublets", 1, 20.0)
    shown["phi"] = np.linspace(0.0, math.radians(50), len(shown["q"]))
    with pytest.raises(UsageError, match="banked beyond 30 deg"):
        manoeuvres("turn", 0.02 * np.arange(len(shown["q"])), shown, skyhawk())


@pytest.mark.slow
def test_a_vane_on_the_wing_tip_of_an_aircraft_that_rolls() -> None:
    """Aileron and rudder move in every manoeuvre, the vane is 5 m off the roll axis: no effect is named."""
    aircraft = load_aircraft("twin_otter")
    aircraft = aircraft.model_copy(update={"boom": aircraft.boom.model_copy(update={"vane_y": 5.0})})
    shown, _ = fly(aircraft, RIG, load_card("lateral").card, 135.0, 2)
    found = manoeuvres("lateral", 0.02 * np.arange(len(shown["q"])), shown, aircraft)
    found = [replace(r, imu=RIG.imu_position, stated=RIG.noise_si()) for r in found]
    assert diagnose(found[:2], found[2:], aircraft).effects == ()


@pytest.mark.slow
def test_a_record_beside_another_aircraft_s_profile() -> None:
    fitted = [record(skyhawk(), 0.0, kind, 100 + k) for k, kind in enumerate(("doublets", "3-2-1-1"))]
    found = diagnose(fitted, [], load_aircraft("twin_otter"))
    assert found.verdict == "unexplained"
    assert any("another aircraft's" in remark for remark in found.remarks)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.0, 3.0])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("", 0.0),
        ("alpha_vane.delay", 0.05),
        ("alpha_vane.scale", 0.3),
        ("accelerometer.position", 0.3048),
        ("mass.scale", 0.3),
        ("dynamic_pressure.scale", 0.3),
        ("elevator.lag", 0.02),
        ("q.scale", 0.05),
        ("velocity.delay", 0.05),
    ],
)
def test_a_fast_jet(name: str, value: float, sigma: float) -> None:
    subject = catalogue.BY_ID[name].extend(skyhawk(), value) if name else skyhawk()
    fitted = [record(subject, sigma, kind, 100 + k) for k, kind in enumerate(("doublets", "3-2-1-1"))]
    found = diagnose(fitted, [record(subject, sigma, "doublets", 102)], skyhawk())
    assert [e.term.id for e in found.effects] == ([name] if name else [])
    assert found.verdict in (("effect_found", "confounded") if name else ("no_effect",))
    for effect in found.effects:
        assert abs(effect.value - value) < 3 * effect.sd
        assert math.isfinite(effect.reduction)

"""What a campaign's scenario flies: the aircraft as it is and as the estimators know it, its sensors, its inputs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from station.campaign.spec import Campaign, Scenario
from station.profile import NO_BOOM, Aircraft, Boom, Derivative, Flight, Manoeuvre, load_aircraft
from station.profile.profile_changes import icing
from station.simulation.sensors import STANDARD, Sensor

_REGRESSORS: Final = ("alpha_vane", "q", "elevator")


def flown_aircraft(scenario: Scenario, beside: Path | None = None) -> Aircraft:
    """The aircraft that flies: the profile's, with the scenario's lift, vane and gust derivatives."""
    aircraft = load_aircraft(scenario.aircraft, beside)
    if scenario.icing:
        aircraft = icing(aircraft, scenario.icing)
    changes: dict[str, object] = {}
    if scenario.lift == "steady":
        changes["unsteady"] = aircraft.unsteady.model_copy(update={"memory": False})
    boom = aircraft.boom if scenario.alpha == "boom" and aircraft.boom else NO_BOOM
    vane = {"vane_frequency": scenario.vane_frequency, "vane_damping": scenario.vane_damping}
    changes["boom"] = boom.model_copy(update={k: v for k, v in vane.items() if v is not None})
    extra = {"CL_gust": scenario.CL_gust, "Cm_gust": scenario.Cm_gust}
    added = {n: Derivative(value=v) for n, v in extra.items() if v}
    return aircraft.model_copy(update={**changes, "derivatives": {**aircraft.derivatives, **added}})


def known_aircraft(scenario: Scenario, flown: Aircraft, beside: Path | None = None) -> Aircraft:
    """The aircraft as the estimators know it: any vane but the profile's is one at the CG that tells the truth.

    Nor do they know of ice. Where the lift has no memory they are not told: `physical` is to show what that costs.
    Mass, inertia and the scale of the elevator's sensor are those of the profile, and known to be.
    """
    boom: Boom | None = flown.boom if scenario.alpha == "boom" else None
    unsteady = flown.unsteady.model_copy(update={"memory": True})
    doubt = flown.uncertainty.model_copy(
        update={"mass": 0.0, "recorded_mass": 0.0, "inertia": 0.0, "surface_scale": 0.0}
    )
    known: dict[str, object] = {"boom": boom, "unsteady": unsteady, "uncertainty": doubt}
    if scenario.icing:
        clean = flown_aircraft(scenario.model_copy(update={"icing": 0.0}), beside)
        known |= {"derivatives": clean.derivatives, "drag": clean.drag}
    return flown.model_copy(update=known)


def sensors_flown(scenario: Scenario) -> dict[str, Sensor]:
    """Channels with noise. With a signal-to-noise ratio their noise depends on the flight, and is 1 here."""
    if scenario.signal_to_noise is not None:
        return {name: Sensor(1.0) for name in _REGRESSORS}
    return {name: replace(sensor, noise=scenario.noise * sensor.noise) for name, sensor in STANDARD.items()}


def flight_of(campaign: Campaign, scenario: Scenario) -> Flight:
    """What the simulation flies."""
    start = campaign.warm_up + scenario.turbulence_start if scenario.turbulence_start > 0 else 0.0
    values = {"speed": scenario.speed, "altitude": scenario.altitude, "gust_sigma": scenario.turbulence}
    return Flight().model_copy(update={**values, "gust_start": start, "field": scenario.field})


def manoeuvres_of(campaign: Campaign, scenario: Scenario) -> tuple[Manoeuvre, ...]:
    """Its input, in times of flight."""
    if not campaign.inputs:
        return ()
    chosen = campaign.inputs[scenario.input or next(iter(campaign.inputs))]
    return tuple(m.model_copy(update={"start": m.start + campaign.warm_up}) for m in chosen)

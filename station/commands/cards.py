"""Cards as the verbs take them: profiles, and the recording that a card may fly."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from station.log import metadata, table
from station.profile import Aircraft, Profiles, Rig, load_card
from station.rows import ProfileError


def recorded_flight(profiles: Profiles) -> dict[str, NDArray[np.float64]] | None:
    """The signals of the recording that the card wants flown, with their times; None where it flies the simulation."""
    flight = profiles.card.flight
    if flight.source != "recording":
        return None
    flown = table(_recording(profiles))
    flown_s = flown.t_s - flown.t_s[0]
    held_s = np.arange(0.0, flight.lead_in, 1.0 / flown.rate_hz)
    time = np.concatenate([held_s, flown_s + flight.lead_in])
    return {"time": time, **{n: np.concatenate([np.full(len(held_s), c[0]), c]) for n, c in flown.columns.items()}}


def _recording(profiles: Profiles) -> Path:
    card = profiles.card
    if card.flight.recording is None:
        raise ProfileError(f'card {card.name}: flight.recording: missing, with flight.source = "recording"')
    return Path(card.flight.recording)


def load(card: str, aircraft: str | None = None) -> Profiles:
    """A card's profiles, with this aircraft (name or path) in place of the card's. A recording that is flown brings its
    own aircraft where none is given, the place of its IMU and its own noise."""
    profiles = load_card(card, {} if aircraft is None else {"aircraft": aircraft})
    if profiles.card.flight.source != "recording":
        return profiles
    about = metadata(_recording(profiles)).about
    place = about.rig.imu_position if about.rig else (0.0, 0.0, 0.0)
    rig = profiles.rig.model_copy(update={"imu_position": place}).without_noise()
    own = {} if aircraft is not None else {"aircraft": about.aircraft}
    return profiles.model_copy(update={**own, "rig": rig})


def about_air(rig: Rig, aircraft: Aircraft) -> list[str]:
    """Where nothing tells the dynamic pressure: then there are no derivatives in flight."""
    has = {name for stream in rig.streams() for name in stream.signals}
    known = "dynamic_pressure" in has or {"static_pressure", "air_temperature"} <= has or "altitude" in has
    if known or aircraft.air_density is not None:
        return []
    return [
        f"rig {rig.name}: neither dynamic_pressure, static_pressure with air_temperature, nor altitude: no\n"
        "derivatives with no air density; give one of them, or air_density in the aircraft's profile"
    ]


def about_vane(aircraft: Aircraft) -> list[str]:
    """What the error of the angle of attack leaves out: a vane's zero that no calibration flight has told."""
    boom = aircraft.boom
    if boom is None or (aircraft.calibrated is not None and aircraft.calibrated.vane_zero_sd is not None):
        return []
    rigged = boom.steady_calibration * aircraft.uncertainty.vane_zero
    return [
        f"vane zero {math.degrees(boom.zero):.2f} deg by the profile, not by a calibration flight: beside the error\n"
        f"shown the angle of attack may be {math.degrees(rigged):.2f} deg off (1 sd); station calibrate tells it"
    ]

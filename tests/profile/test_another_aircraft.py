"""Another aircraft's profile in place of the recorded one is said; the same one under another name is not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from identification.glider import AIRCRAFT, flight, record

from station.diagnosis.checks import checked
from station.identification.preparation import prepare
from station.identification.request import Request
from station.profile import Aircraft, load_aircraft, unlike_recorded

TWIN, ATTAS = load_aircraft("twin_otter"), load_aircraft("attas")


def changed(aircraft: Aircraft, part: str, **values: Any) -> Aircraft:
    inner = getattr(aircraft, part).model_copy(update=values)
    return aircraft.model_copy(update={part: inner, "name": "mine"})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (TWIN.model_copy(update={"name": "calibrated"}), None),
        (changed(TWIN, "geometry", chord=TWIN.geometry.chord * 1.0004), None),
        (changed(TWIN, "geometry", chord=2.5), "chord 2.5 m, not 1.981"),
        (changed(TWIN, "inertia", mass=TWIN.inertia.mass * 1.05), None),
        (changed(TWIN, "inertia", mass=TWIN.inertia.mass * 1.07), "mass 5309 kg, not 4962"),
        (TWIN.model_copy(update={"kinematics_only": True, "geometry": ATTAS.geometry}), None),
    ],
)
def test_sizes_and_mass_tell_aircraft_apart(given: Aircraft, words: str | None) -> None:
    """Of mass 3 % are the profile's standard deviation: 5 % its intervals cover, 7 % they do not."""
    said = unlike_recorded(given, TWIN, mass_recorded=False)
    assert [f"mine is not the recorded twin_otter: {words}" in s for s in said] == [True] * (words is not None)


def test_a_recorded_mass_is_the_recording_s() -> None:
    assert unlike_recorded(changed(TWIN, "inertia", mass=9000.0), TWIN, mass_recorded=True) == []


def test_identification_and_diagnosis_remark_it() -> None:
    """Both make a record ready with the profile that is given."""
    flown = record(flight())
    other = changed(AIRCRAFT, "geometry", wing_area=2 * AIRCRAFT.geometry.wing_area)
    words = f"mine is not the recorded {AIRCRAFT.name}: wing area"
    assert any(words in r for r in prepare(flown, other, Request(("II",))).remarks)
    assert any(words in r for r in checked("a.mcap", flown, other).remarks)
    own = replace(flown, aircraft=AIRCRAFT)
    assert not any("is not the recorded" in r for r in prepare(own, AIRCRAFT, Request(("II",))).remarks)

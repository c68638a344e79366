"""Whether two profiles are of one aircraft, whatever they are called: a calibrated one, or one with a measured
baseline, is the same aircraft's."""

from __future__ import annotations

from typing import Final

from station.profile.aircraft import Aircraft

SAME: Final = 1e-3
"""Relative difference of sizes that are the same: profiles round them, in feet or metres, to four digits."""
COVERED: Final = 2.0
"""Standard deviations of a profile's mass that its intervals of 95 % cover."""
SIZES: Final = {"wing area": ("wing_area", "m2"), "span": ("span", "m"), "chord": ("chord", "m")}


def other_sizes(given: Aircraft, recorded: Aircraft) -> list[str]:
    """In which sizes they differ, in words; nothing where either's are placeholders."""
    if given.kinematics_only or recorded.kinematics_only:
        return []
    said = []
    for words, (key, unit) in SIZES.items():
        own, other = getattr(given.geometry, key), getattr(recorded.geometry, key)
        if abs(own - other) > SAME * other:
            said.append(f"{words} {own:.4g} {unit}, not {other:.4g}")
    return said


def unlike_recorded(given: Aircraft, recorded: Aircraft, *, mass_recorded: bool) -> list[str]:
    """What is to be said of a profile that stands in for the recorded one: of another size, or, where the recording
    has no mass, of another mass than its uncertainty covers."""
    if given.kinematics_only or recorded.kinematics_only:
        return []
    said = other_sizes(given, recorded)
    own, other = given.inertia.mass, recorded.inertia.mass
    if not mass_recorded and abs(own - other) > COVERED * given.uncertainty.mass * other:
        said.append(f"mass {own:.4g} kg, not {other:.4g}")
    if not said:
        return []
    what = "derivatives are in its sizes and mass: is it this aircraft's?"
    return [f"{given.name} is not the recorded {recorded.name}: {'; '.join(said)}: {what}"]

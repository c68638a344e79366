"""Whether a profile can be that of the aircraft recorded: a wrong one, too, gives small standard errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from station.estimation.flight_record import FlightRecord
from station.estimation.results import MethodResult
from station.profile import Aircraft
from station.rows import Status

SIZE: Final = 0.05
"""Share by which two profiles of one type may differ in wing area and chord."""
LOADING: Final = 0.25
"""Share by which a mass may differ from the profile's: more than fuel and payload account for in most aircraft."""
LIFT: Final = 0.3
"""Lift coefficient by which flight and profile may differ: 3 deg of angle of attack of an uncalibrated vane; the
HFB-320's own profile differs by 0.16."""
FACTOR: Final = 2.0
SURE: Final = 4.0
"""A derivative contradicts the profile beyond FACTOR, by this many standard errors."""
TELLING: Final = ("CL_alpha", "Cm_de")
"""Derivatives in which a wrong size or mass shows, and the vane's bias and delay hardly."""


def hint(aircraft: Aircraft, recorded: Aircraft, record: FlightRecord, result: MethodResult | None) -> str:
    """One line on what contradicts the profile, or "". `recorded`: the recording's own profile; `result`: of the
    recommended method."""
    if aircraft.kinematics_only:
        return ""
    found = [*_another(aircraft, recorded), *_mass(aircraft, record), *_lift(aircraft, record)]
    if result is not None:
        # What the profile states, its uncertainties too, is what is in question: by the noise alone.
        sds = result.statistical
        found += _derivatives(aircraft, {p.name: (p.value, sds.get(p.name, p.sd), p.status) for p in result.parameters})
    return f"is {aircraft.name} the aircraft recorded? {'; '.join(found)}" if found else ""


def _another(aircraft: Aircraft, recorded: Aircraft) -> list[str]:
    one, other = aircraft.geometry, recorded.geometry
    apart = max(abs(one.wing_area / other.wing_area - 1), abs(one.chord / other.chord - 1))
    if recorded.kinematics_only or recorded.name == aircraft.name or apart <= SIZE:
        return []
    return [f"the recording says {recorded.name}, wing {other.wing_area:.1f} m2 and not {one.wing_area:.1f}"]


def _mass(aircraft: Aircraft, record: FlightRecord) -> list[str]:
    mass = float(np.nanmean(np.asarray(record.airframe.mass)))
    if abs(mass / aircraft.inertia.mass - 1) <= LOADING:
        return []
    return [f"recorded mass {mass:.0f} kg, the profile's {aircraft.inertia.mass:.0f}"]


def _lift(aircraft: Aircraft, record: FlightRecord) -> list[str]:
    """Mean lift against the profile's at the mean angle of attack and elevator."""
    slope, zero = aircraft.value("CL_alpha"), aircraft.value("CL_0")
    if not (slope and zero):
        return []
    alpha, elevator = record.alpha, record.motion["elevator"]
    model = zero + slope * alpha + aircraft.value("CL_de") * elevator
    good = record.usable & np.isfinite(record.coefficients.CL) & np.isfinite(model)
    if not good.any():
        return []
    flown, made = float(np.mean(record.coefficients.CL[good])), float(np.mean(model[good]))
    if abs(flown - made) <= LIFT:
        return []
    angle = math.degrees(float(np.mean(alpha[good])))
    return [f"to carry its mass it flew at CL {flown:.2f}; the profile gives {made:.2f} at {angle:.1f} deg"]


def _derivatives(aircraft: Aircraft, estimates: Mapping[str, tuple[float, float, Status]]) -> list[str]:
    words = []
    for name in TELLING:
        value, sd, status = estimates.get(name, (math.nan, math.nan, Status.INVALID))
        stated = aircraft.value(name)
        if status is not Status.ESTIMATED or not stated:
            continue
        share, spread = value / stated, SURE * abs(sd / stated)
        if share - spread > FACTOR or share + spread < 1 / FACTOR:
            words.append(f"{name} is {share:.2g} times the profile's")
    return words

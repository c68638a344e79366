"""A calibration as an aircraft profile: boom and instruments as found, how well, and when."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from station.clock import utc_date
from station.conventions import from_si
from station.log import metadata
from station.model.air_data_calibration import PASCALS
from station.numerics.random_effects import NORMAL_95
from station.profile import NO_BOOM, Aircraft, Calibrated, Instrument
from station.programme.calibration import Calibration, Constant
from station.rows import UsageError

ZEROS: Final = {"phi_zero": "phi", "theta_zero": "theta", "psi_zero": "psi", "ax_zero": "ax", "ay_zero": "ay",
                "az_zero": "az", "beta_zero": "beta_vane"}  # fmt: skip
OF_UNCERTAINTY: Final = {"vane_zero": "vane_zero", "theta_zero": "theta_zero", "ax_zero": "ax_zero",
                         "az_zero": "az_zero", "vane_delay": "vane_delay"}  # fmt: skip
"""Constants whose standard deviation becomes the prior of later analyses, and its key."""

UNDATED: Final = "unknown"
"""Of a record whose file says no date."""
SIMULATED: Final = "simulated"
"""Of a simulation, which has none."""
WORSE: Final = 1.5
"""Times the error of before, from which it is said: errors themselves scatter by a third between flights."""
OF_CALIBRATED: Final = ("airspeed_error", "airspeed_slope", "pressure_scale", "static_position", "vane_zero", "upwash",
                        "vane_x", "vane_delay")  # fmt: skip
"""Constants whose standard deviation the profile's [calibrated] has."""


def calibrated_aircraft(made: Calibration) -> Aircraft:
    """The aircraft with what the flight has told; the rest as it was. Raises UsageError where that is nothing."""
    told = {n: c for n, c in made.constants.items() if c.is_told}
    if not told:
        raise UsageError("the flight tells nothing of the aircraft's instruments: no profile is written")
    aircraft = made.aircraft
    boom = aircraft.boom or NO_BOOM
    moved: dict[str, float] = {}
    if "vane_zero" in told:
        moved["zero"] = told["vane_zero"].value
    if "upwash" in told:
        moved["upwash_body"] = told["upwash"].value - boom.upwash_wing
    slope = told.get("upwash_slope")
    if slope is not None and "upwash" in told and abs(slope.value) > NORMAL_95 * slope.sd:
        # The profile's upwash is that of a boom without load.
        whole, load = 1 + told["upwash"].value, made.steady.pressure / PASCALS
        bends = slope.value / (whole - slope.value * load)
        moved["tip_load"] = boom.tip_load + bends
        moved["upwash_body"] = whole / (1 + bends * load) - 1 - boom.upwash_wing
    if "vane_x" in told:
        moved["vane_x"] = told["vane_x"].value
    return aircraft.model_copy(
        update={
            "name": f"{aircraft.name}_calibrated",
            "boom": boom.model_copy(update=moved),
            "instruments": _instruments(aircraft, told, made.steady.speed),
            "static_position": told["static_position"].value if "static_position" in told else aircraft.static_position,
            "uncertainty": aircraft.uncertainty.model_copy(update=_known(told, made)),
            "calibrated": _calibrated(made, told),
        }
    )


def known_worse(made: Calibration) -> list[str]:
    """Constants that this flight tells, and the profile knew better. They are not averaged: the flight's constants hang
    together, and a vane that was rigged anew meanwhile is another."""
    said = []
    before = made.aircraft.calibrated
    for name in OF_CALIBRATED:
        c, sd = made.constants.get(name), getattr(before, f"{name}_sd", None)
        if c is not None and c.is_told and sd is not None and c.sd > WORSE * sd:
            unit = "deg" if c.unit == "rad" else c.unit
            own, other = (f"{from_si(x, unit):.2g} {unit}".removesuffix(" 1") for x in (c.sd, sd))
            said.append(
                f"{name} is known to {own}, before it was to {other} (1 sd): {c.key} is now this flight's; unless the "
                "boom has been changed since, keep the profile's, or fly more runs"
            )
    return said


def _instruments(aircraft: Aircraft, told: Mapping[str, Constant], speed: float) -> dict[str, Instrument]:
    found = dict(aircraft.instruments)

    def state(signal: str, **values: float) -> None:
        found[signal] = found.get(signal, Instrument()).model_copy(update=values)

    if "airspeed_error" in told:
        # Without a slope that is told, the error is the same at every speed.
        slope = told["airspeed_slope"].value if "airspeed_slope" in told else 0.0
        state("airspeed", gain=1 + slope, bias=told["airspeed_error"].value - slope * speed)
    if "pressure_scale" in told:
        state("dynamic_pressure", gain=1 + told["pressure_scale"].value, bias=0.0)
    if "vane_delay" in told:
        state("alpha_vane", latency=told["vane_delay"].value)
    for name, signal in ZEROS.items():
        if name in told:
            state(signal, bias=told[name].value)
    return found


def _known(told: Mapping[str, Constant], made: Calibration) -> dict[str, float]:
    known = {key: told[name].sd for name, key in OF_UNCERTAINTY.items() if name in told}
    if "upwash" in told:
        known["vane_scale"] = told["upwash"].sd / (1 + told["upwash"].value)
    if "vane_x" in told:
        known["vane_x"] = told["vane_x"].sd / made.steady.speed
    if "pressure_scale" in told:
        known["dynamic_pressure"] = told["pressure_scale"].sd
    elif "airspeed_error" in told:
        known["dynamic_pressure"] = 2 * told["airspeed_error"].sd / made.steady.speed
    return known


def _calibrated(made: Calibration, told: Mapping[str, Constant]) -> Calibrated:
    low, high = made.speeds
    read = [metadata(path) for path in made.logs]
    first = min(m.utc_ns for m in read)
    undated = SIMULATED if all(m.about.source == "simulation" for m in read) else UNDATED
    sds: dict[str, Any] = {f"{n}_sd": told[n].sd for n in OF_CALIBRATED if n in told and math.isfinite(told[n].sd)}
    return Calibrated.model_construct(
        date=utc_date(first) if first > 0 else undated,
        recordings=tuple(p.name for p in made.logs),
        lowest_speed=low,
        highest_speed=high,
        **sds,
    )

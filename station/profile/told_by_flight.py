"""What flights have told of an aircraft: of its derivatives by `station baseline`, of its instruments by `station
calibrate`."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from station.profile.quantity import Frozen, Metres, MetresPerSecond, Radians, Seconds


def otherwise(condition: str, than: str) -> tuple[tuple[str, str], ...]:
    """Where one condition contradicts another, part by part of what commas separate: same first word, another rest, as
    "flaps 20" and "flaps up"; both parts of each."""
    found = []
    for own in _parts(condition):
        theirs = [part for part in _parts(than) if part.split()[0].lower() == own.split()[0].lower()]
        if theirs and own.lower() not in (part.lower() for part in theirs):
            found.append((own, " or ".join(dict.fromkeys(theirs))))
    return tuple(found)


def _parts(condition: str) -> list[str]:
    return [part.strip() for part in condition.replace(";", ",").split(",") if part.strip()]


class Measured(Frozen):
    """What `station baseline` measured: the aircraft as it is, which a flight is held against. Measured derivatives,
    and their sd with the scatter between points in it, are the profile's."""

    points: int = Field(ge=1)
    """Test points that it is pooled of."""
    condition: str = ""
    """What they were flown in: configuration, air."""
    lowest_speed: MetresPerSecond
    """Mean airspeed of the slowest point,"""
    highest_speed: MetresPerSecond
    """and of the fastest."""
    CD_0: float | None = None
    """Drag beside the induced, as measured with the recorded thrust; none where that was not recorded."""
    CD_0_sd: float = Field(default=0.0, ge=0)
    """By which that of another point would lie off it, standard deviation."""
    CL_0: float | None = None
    """Lift in level flight less what the measured slopes make of angle of attack, pitch rate and elevator."""
    CL_0_sd: float = Field(default=0.0, ge=0)
    """By which that of another point would lie off it, standard deviation."""


class Calibrated(Frozen):
    """What `station calibrate` found of the boom and the instruments, whose values stand there: when, of what, and how
    well, standard deviations."""

    date: str
    """Of the first recording, UTC; "unknown" where that says none, "simulated" of a simulation."""
    recordings: tuple[str, ...]
    """Their names."""
    lowest_speed: MetresPerSecond
    """True airspeeds between which it was flown, the lowest"""
    highest_speed: MetresPerSecond
    """and the highest."""
    airspeed_error_sd: MetresPerSecond | None = None
    """Of the airspeed's position error at the mean of these speeds."""
    airspeed_slope_sd: float | None = Field(default=None, ge=0)
    """Of its slope: of the airspeed's gain."""
    pressure_scale_sd: float | None = Field(default=None, ge=0)
    """Of the dynamic pressure's gain."""
    static_position_sd: float | None = Field(default=None, ge=0)
    """Of the static port's error, `static_position`."""
    vane_zero_sd: Radians | None = None
    """Of the vane's zero, attitude's included."""
    upwash_sd: float | None = Field(default=None, ge=0)
    """Of the steady upwash, body and wing together."""
    vane_x_sd: Metres | None = None
    """Of the vane's place."""
    vane_delay_sd: Seconds | None = None
    """Of its latency."""

    @model_validator(mode="before")
    @classmethod
    def _recordings(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("recordings"), list):
            raw = {**raw, "recordings": tuple(raw["recordings"])}
        return raw

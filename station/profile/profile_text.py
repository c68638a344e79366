"""An aircraft as a profile file, in SI, written beside the old one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from station.conventions import from_si
from station.profile.aircraft import Aircraft, Instrument
from station.profile.files import load_aircraft
from station.rows import LogError, UsageError

UNIT_OF: Final[Mapping[str, str]] = {
    "wing_area": "m2", "span": "m", "chord": "m", "mass": "kg", "ixx": "kg m2", "iyy": "kg m2", "izz": "kg m2",
    "ixz": "kg m2", "vane_x": "m", "vane_y": "m", "vane_z": "m", "zero": "rad", "vane_frequency": "Hz",
    "flexure": "deg/g", "mode_frequency": "Hz", "mode_length": "m", "gust_span": "m", "gust_span_tail": "m",
    "tail_arm": "m", "downwash_delay": "s", "reference_chord": "m", "time_constant": "s",
    "rate_limit": "rad/s", "position_limit": "rad", "latency": "s", "lag": "s", "reference_speed": "m/s",
    "alpha_star": "rad", "air_density": "kg/m3", "thrust_angle": "rad", "thrust_pitch_arm": "m", "imu_offset": "m",
    "lowest_speed": "m/s", "highest_speed": "m/s", "airspeed_error_sd": "m/s", "vane_zero_sd": "rad", "vane_x_sd": "m",
    "vane_delay_sd": "s",
    "static_thrust": "N", "speeds": "m/s", "altitudes": "m",
}  # fmt: skip
"""Keys of an aircraft that carry a unit."""
_OF_UNCERTAINTY: Final = {
    "downwash_delay": "s", "vane_x": "s", "vane_delay": "s", "pressure_delay": "s", "vane_zero": "rad",
    "theta_zero": "rad", "q_zero": "rad/s", "ax_zero": "m/s2", "az_zero": "m/s2", "drift": "m/s", "alpha_star": "rad",
}  # fmt: skip
"""The same in its section `uncertainty`, whose other values are relative."""

_STILL: Final = Instrument().model_dump()


def to_toml(aircraft: Aircraft, heading: str) -> str:
    """A profile's text, in SI; `heading` comes first, as comments."""
    lines = [f"# {line}" for line in heading.splitlines()]
    raw = aircraft.model_dump(exclude_none=True)
    plain = {k: v for k, v in raw.items() if not isinstance(v, dict)}
    lines += [f"{key} = {_value(key, value)}" for key, value in plain.items() if not _empty(value)]
    for section, content in raw.items():
        if not isinstance(content, dict) or not content:
            continue
        units = _OF_UNCERTAINTY if section == "uncertainty" else UNIT_OF
        lines += ["", f"[{section}]"]
        for key, value in content.items():
            if isinstance(value, dict):
                default = _STILL if section == "instruments" else {}
                value = {k: v for k, v in value.items() if not _empty(v) and v != default.get(k)}
            if not _empty(value):
                lines.append(f"{key} = {_value(key, value, units)}")
    return "\n".join(lines) + "\n"


def _empty(value: Any) -> bool:
    return bool(value == "" or value == () or value == {})


def _value(key: str, value: Any, units: Mapping[str, str] = UNIT_OF) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_value(k, v, units)}" for k, v in value.items()) + " }"
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(_value(key, v, units) for v in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    number = repr(value) if isinstance(value, int) else repr(float(value))
    if key in units:
        return f'"{from_si(float(value), units[key])!r} {units[key]}"'
    return number


def write_profile(aircraft: Aircraft, path: Path, heading: str) -> None:
    """Write a profile that reads back the same. Raises UsageError where a file is already, LogError where it fails."""
    if path.exists():
        raise UsageError(f"{path}: is there already: a written profile never replaces a file; name another")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(to_toml(aircraft, heading), encoding="utf-8")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error}") from error
    load_aircraft(str(path))

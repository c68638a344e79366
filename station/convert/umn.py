"""Flights of the University of Minnesota's small aircraft (`flight_data` in a .mat file), Thor among them.

Everything is on one 50 Hz time base, SI but for pressures (kPa), latitude and longitude of the GPS (deg). Angles of the
five-hole probe, rates and accelerations are as measured, with their biases; attitude and velocity are the navigation
filter's. The elevator is trailing edge down, the aileron the mean of both (right down, left up), as the station has
them. The navigation filter's estimates of the sensors' biases are kept beside.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from station.conventions import SEA_LEVEL_DENSITY
from station.convert.mat_variables import variables
from station.convert.tracks import Column, Record, Track, ordered
from station.numerics.atmosphere import PRESSURE_POWER, SEA_LEVEL_PRESSURE
from station.profile import Aircraft
from station.rows import LogError

VARIABLE: Final = "flight_data"
_FIELDS: Final[Mapping[str, str]] = {
    "alpha_vane": "aoa",
    "beta_vane": "aos",
    "p": "p",
    "q": "q",
    "r": "r",
    "ax": "ax",
    "ay": "ay",
    "az": "az",
    "phi": "phi",
    "theta": "theta",
    "psi": "psi",
    "v_north": "navvn",
    "v_east": "navve",
    "v_down": "navvd",
    "latitude": "navlat",
    "longitude": "navlon",
    "altitude": "navalt",
    "elevator": "de",
    "rudder": "dr",
}
_KEPT: Final = ("p_bias", "q_bias", "r_bias", "ax_bias", "ay_bias", "az_bias", "vn", "ve", "vd")


def is_umn(path: Path) -> bool:
    """Whether a .mat holds the structure. False too where the file cannot be read."""
    try:
        found = variables(path).get(VARIABLE)
    except LogError:  # read_fdata says it in words
        return False
    return found is not None and found.is_struct


def read_umn(path: Path, aircraft: Aircraft) -> Record:
    """A .mat with the struct `flight_data`. Raises LogError naming the field that is missing or of a wrong size."""
    found = variables(path).get(VARIABLE)
    try:
        data = None if found is None else found.read()
    except ValueError as error:
        raise LogError(f"{path}: {VARIABLE} is damaged: {error}") from error
    if not isinstance(data, dict):
        raise LogError(f"{path}: holds no struct {VARIABLE}")
    time = _field(path, data, "time", None)
    n = len(time)
    t_ns = np.round(time * 1e9).astype(np.int64)
    if n <= 1 or not np.all(np.diff(t_ns) > 0):
        raise LogError(f"{path}: {VARIABLE}.time does not increase")
    columns = {signal: _field(path, data, name, n) for signal, name in _FIELDS.items()}
    right, left = _field(path, data, "da_r", n), _field(path, data, "da_l", n)
    columns["aileron"] = 0.5 * (right - left)
    columns["psi"] = (columns["psi"] + np.pi) % (2 * np.pi) - np.pi
    pressure, indicated = 1e3 * _field(path, data, "Ps", n), np.maximum(_field(path, data, "ias", n), 0.0)
    columns["static_pressure"] = pressure
    columns["dynamic_pressure"] = 0.5 * SEA_LEVEL_DENSITY * indicated**2
    # No air temperature is recorded: the standard atmosphere's density at the static pressure (ISO 2533).
    density = SEA_LEVEL_DENSITY * np.maximum(pressure / SEA_LEVEL_PRESSURE, 0.1) ** (1 - 1 / PRESSURE_POWER)
    columns["airspeed"] = indicated * np.sqrt(SEA_LEVEL_DENSITY / density)
    extra = {f"navigation_{n_}": _field(path, data, n_, n) for n_ in _KEPT if n_ in data}
    notes = {
        "file": path.name,
        "airspeed": "from indicated airspeed and the standard atmosphere at the static pressure",
        "alpha_vane": "five-hole probe as recorded, calibration unknown",
    }
    return Record([Track("record", t_ns, ordered(columns), extra)], aircraft, "umn", notes)


def _field(path: Path, data: Mapping[str, Column | None], name: str, n: int | None) -> Column:
    if name not in data:
        raise LogError(f"{path}: {VARIABLE} has no field {name}")
    found = data[name]
    if found is None:
        raise LogError(f"{path}: {VARIABLE}.{name} is not numeric")
    column = found.squeeze()
    if column.ndim != 1 or (n is not None and len(column) != n):
        raise LogError(f"{path}: {VARIABLE}.{name} has shape {column.shape}, time has {n} rows")
    return column

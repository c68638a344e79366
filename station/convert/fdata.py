"""SIDPAC's `fdata` matrix in a MATLAB file, in and out (SIDPAC's channel list of 6 November 2005).

Channel 4 is the angle of attack at the CG, already corrected, and is kept as `alpha_vane`: the aircraft in the
recording therefore has no boom. Channels that are no signal of the station are kept beside, so that a file comes back
whole. An empty channel is all zeros. Converting units rounds twice, so a value may come back one unit in the last place
off.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import Unit, unit_named
from station.convert.mat_file import MatrixFile
from station.convert.mat_variables import variables
from station.convert.tracks import Column, Record, Track, from_si, in_si, ordered
from station.log import Table
from station.profile import Aircraft
from station.rows import LogError

CHANNELS: Final = 90
_LEAST_CHANNELS: Final = 48
"""Up to the mass: what is there in files of any version."""
_G: Final = Unit("m/s2", 32.174 * 0.3048)
"""SIDPAC's g, 32.174 ft/s2, which its accelerations are counted in: 1.5e-6 less than standard gravity."""


@dataclass(frozen=True, slots=True)
class _Channel:
    number: int
    name: str
    unit: Unit


def _channels(*rows: tuple[int, str, str]) -> tuple[_Channel, ...]:
    found = []
    for first, names, unit_name in rows:
        unit = _G if unit_name == "fdata g" else unit_named(unit_name)
        assert unit is not None
        found += [_Channel(first + i, name, unit) for i, name in enumerate(names.split())]
    return tuple(found)


_SIGNAL_CHANNELS: Final = _channels(
    (2, "airspeed", "ft/s"),
    (3, "beta_vane alpha_vane", "deg"),
    (5, "p q r", "deg/s"),
    (8, "phi theta psi", "deg"),
    (11, "ax ay az", "fdata g"),
    (14, "elevator aileron rudder", "deg"),
    (27, "dynamic_pressure", "psf"),
    (30, "altitude", "ft"),
    (42, "pdot qdot rdot", "deg/s2"),
    (48, "mass", "slug"),
)
_THRUST: Final = (38, 39, 40, 41)
_OTHER_CHANNELS: Final = _channels(
    (17, "flap_trailing_edge flap_leading_edge", "deg"),
    (19, " ".join(f"surface_{i}" for i in range(1, 9)), "deg"),
    (28, "mach", "1"),
    (29, "air_density", "slug/ft3"),
    (31, "stick_longitudinal stick_lateral pedal", "in"),
    (34, "throttle_1 throttle_2 throttle_3 throttle_4", "deg"),
    (38, "thrust_1 thrust_2 thrust_3 thrust_4", "lbf"),
    (45, "cg_x cg_y cg_z", "in"),
    (49, "ixx iyy izz ixz", "slug ft2"),
    (53, "ax_measured ay_measured az_measured", "fdata g"),
    (56, "alpha_dot beta_dot", "deg/s"),
    (58, "thrust_vector_1 thrust_vector_2 thrust_vector_3", "deg"),
    (61, "CX CY CZ Cl Cm Cn CD CY_wind CL CT p_hat q_hat r_hat", "1"),
    (74, "u v w", "ft/s"),
    (77, "wing_area", "ft2"),
    (78, "span chord", "ft"),
    (80, "beta_measured alpha_measured", "deg"),
    (82, " ".join(f"channel_{i}" for i in range(82, CHANNELS + 1)), "1"),
)
_BY_NAME: Final = {c.name: c for c in (*_SIGNAL_CHANNELS, *_OTHER_CHANNELS)}
EXTRA_UNITS: Final[Mapping[str, str]] = {c.name: c.unit.si for c in _OTHER_CHANNELS}
_LBF: Final = unit_named("lbf")
_LENGTHS: Final = ("wing_area", "span", "chord")
_INERTIAS: Final = ("ixx", "iyy", "izz", "ixz")


def read_fdata(path: Path, aircraft: Aircraft) -> Record:
    """A .mat file with `fdata` (n, 77 or more). The aircraft gets the file's mass, inertias and lengths, and no boom.

    Raises LogError naming what the file holds instead.
    """
    there = variables(path)
    if "fdata" not in there:
        raise LogError(f"{path}: holds no variable fdata (SIDPAC's matrix), but {', '.join(there) or 'nothing'}")
    try:
        fdata = there["fdata"].read()
    except ValueError as error:
        raise LogError(f"{path}: fdata is damaged: {error}") from error
    shape = there["fdata"].shape
    is_matrix = shape == shape[:2] and shape[0] > 1 and shape[1] >= _LEAST_CHANNELS
    if not isinstance(fdata, np.ndarray) or not is_matrix:
        raise LogError(f"{path}: fdata is {shape}: not a matrix of numbers, of 2 rows and {_LEAST_CHANNELS} channels")
    full = np.zeros((fdata.shape[0], max(CHANNELS, fdata.shape[1])))
    full[:, : fdata.shape[1]] = fdata
    t_ns = _time_ns(path, full[:, 0])
    columns = {c.name: in_si(full[:, c.number - 1], c.unit) for c in _SIGNAL_CHANNELS if np.any(full[:, c.number - 1])}
    thrusts = full[:, [c - 1 for c in _THRUST]]
    if np.any(thrusts) and _LBF is not None:
        columns["thrust"] = in_si(thrusts.sum(axis=1), _LBF)
    columns = ordered(columns)
    extra = {c.name: in_si(full[:, c.number - 1], c.unit) for c in _OTHER_CHANNELS if np.any(full[:, c.number - 1])}
    notes = {"file": path.name, "alpha_vane": "channel 4, at the CG: the aircraft is kept without its boom"}
    return Record([Track("record", t_ns, columns, extra)], _adapted(aircraft, columns, extra), "fdata", notes)


def _time_ns(path: Path, time: Column) -> NDArray[np.int64]:
    if not np.all(np.isfinite(time)):
        raise LogError(f"{path}: fdata row {int(np.argmin(np.isfinite(time))) + 1}, channel 1: no time")
    t_ns = np.round(time * 1e9).astype(np.int64)
    steps = np.diff(t_ns)
    if np.any(steps <= 0):
        raise LogError(f"{path}: fdata row {int(np.argmax(steps <= 0)) + 2}, channel 1: time does not increase")
    return t_ns


def _adapted(aircraft: Aircraft, columns: Mapping[str, Column], extra: Mapping[str, Column]) -> Aircraft:
    """The aircraft with the record's own lengths and mass properties; means where they vary."""
    lengths = {n: _mean(extra[n]) for n in _LENGTHS if n in extra}
    inertias = {n: _mean(extra[n]) for n in _INERTIAS if n in extra}
    if "mass" in columns:
        inertias["mass"] = _mean(columns["mass"])
    geometry = aircraft.geometry.model_copy(update=lengths)
    inertia = aircraft.inertia.model_copy(update=inertias)
    return aircraft.model_copy(update={"geometry": geometry, "inertia": inertia, "boom": None})


def _mean(values: Column) -> float:
    # A constant column keeps its bits.
    return float(values[0]) if np.all(values == values[0]) else float(np.mean(values))


def write_fdata(path: Path, aircraft: Aircraft, times: Column, blocks: Iterable[tuple[Table, Column | None]]) -> None:
    """A table, in blocks of rows one after the other, as `fdata` (n, 90) with the usual scalars; `times` (n,) of all of
    them, s. The angle of attack at the CG (n,), rad, of a block goes to channel 4 where there is one.

    What is not known stays zero, SIDPAC's mark of an empty channel. Raises OSError and LogError.
    """
    own = {"wing_area": aircraft.geometry.wing_area, "span": aircraft.geometry.span, "chord": aircraft.geometry.chord}
    own |= {"mass": aircraft.inertia.mass} | {n: getattr(aircraft.inertia, n) or 0.0 for n in _INERTIAS}
    made = (_rows(table, alpha_cg, own) for table, alpha_cg in blocks)
    first = next(made)
    scalars: dict[str, Any] = {
        "t": (times - times[0]).reshape(-1, 1),
        "dt": float(np.median(np.diff(times))) if len(times) > 1 else math.nan,
        "npts": len(times),
        "sarea": first[0, 76],
        "bspan": first[0, 77],
        "cbar": first[0, 78],
    }
    done = 0
    with MatrixFile(path, scalars, "fdata", len(times), CHANNELS) as file:
        for block in chain((first,), made):
            block[:, 0] = times[done : done + len(block)]
            done += len(block)
            file.add(block)
        for name, value in own.items():
            channel = _BY_NAME[name]
            file.fill(channel.number - 1, from_si(np.array([value]), channel.unit)[0])


def _rows(table: Table, alpha_cg: Column | None, own: Mapping[str, float]) -> NDArray[np.float64]:
    """(n, 90) without the times; NaN where nothing is known."""
    count = len(table.t_s)
    fdata = np.full((count, CHANNELS), np.nan)
    known: dict[str, Column] = {n: np.full(count, value) for n, value in own.items()}
    if not table.extra:
        known |= _vanes_and_rates(table)
    known |= table.extra
    known |= table.columns
    if alpha_cg is not None:
        known["alpha_vane"] = alpha_cg
    for channel in (*_SIGNAL_CHANNELS, *_OTHER_CHANNELS):
        if channel.name in known:
            fdata[:, channel.number - 1] = from_si(known[channel.name], channel.unit)
    if "thrust" in known and not any(f"thrust_{i}" in table.extra for i in range(1, 5)) and _LBF is not None:
        fdata[:, _THRUST[0] - 1] = from_si(known["thrust"], _LBF)
    return fdata


def _vanes_and_rates(table: Table) -> dict[str, Column]:
    """What SIDPAC keeps as well, for a flight of the station: raw vane angles and normalised rates."""
    found: dict[str, Column] = {}
    for vane, channel in (("beta_vane", "beta_measured"), ("alpha_vane", "alpha_measured")):
        if vane in table.columns:
            found[channel] = table.columns[vane]
    if "airspeed" in table.columns:
        geometry = table.aircraft.geometry
        with np.errstate(divide="ignore", invalid="ignore"):
            for rate, length in (("p", geometry.span), ("q", geometry.chord), ("r", geometry.span)):
                if rate in table.columns:
                    found[f"{rate}_hat"] = table.columns[rate] * length / (2 * table.columns["airspeed"])
    return found

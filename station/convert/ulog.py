"""PX4's .ulg logs, read with pyulog: each topic a track with its own times, frames FRD and NED as the station's."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from station.convert.tracks import Column, Record, Track
from station.profile import Aircraft
from station.rows import LogError

Topic = Mapping[str, Any]
_MAGIC: Final = b"ULog"
_HEAD: Final = 16
"""Bytes before the first message (PX4's "ULog File Format")."""
_DEFINITIONS: Final = b"BFIMPQ"
_DATA: Final = b"ALC"
"""Kinds of messages: of the definitions, and those at which pyulog ends them."""
_LONGEST: Final = 10_000
"""Beyond it pyulog takes a message for noise, and looks for another from the next byte on."""


def _euler(data: Topic) -> dict[str, Column]:
    """Attitude from the quaternion body -> NED, order 3-2-1."""
    w, x, y, z = (_column(data, f"q[{i}]") for i in range(4))
    return {
        "phi": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        "theta": np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)),
        "psi": np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    }


def _column(data: Topic, name: str) -> Column:
    return np.asarray(data[name], dtype=np.float64)


def _plain(**signals: str) -> Callable[[Topic], dict[str, Column]]:
    return lambda data: {signal: _column(data, name) for signal, name in signals.items()}


def _position(data: Topic) -> dict[str, Column]:
    return {
        "latitude": np.radians(_column(data, "lat")),
        "longitude": np.radians(_column(data, "lon")),
        "altitude": _column(data, "alt"),
    }


def _imu(data: Topic) -> dict[str, Column]:
    names = [f"gyro_rad[{i}]" for i in range(3)] + [f"accelerometer_m_s2[{i}]" for i in range(3)]
    return {s: _column(data, n) for s, n in zip(("p", "q", "r", "ax", "ay", "az"), names, strict=True)}


def _angle(signal: str, name: str) -> Callable[[Topic], dict[str, Column]]:
    """Of an airflow sensor, NaN where it says that it is not valid."""
    return lambda data: {signal: np.where(_column(data, "valid") > 0, _column(data, name), np.nan)}


_TOPICS: Final[tuple[tuple[str, Callable[[Topic], dict[str, Column]]], ...]] = (
    ("sensor_combined", _imu),
    ("vehicle_attitude", _euler),
    ("vehicle_local_position", _plain(v_north="vx", v_east="vy", v_down="vz")),
    ("vehicle_global_position", _position),
    ("airspeed_validated", _plain(airspeed="true_airspeed_m_s")),
    ("airspeed", _plain(airspeed="true_airspeed_m_s")),
    ("differential_pressure", _plain(dynamic_pressure="differential_pressure_pa")),
    ("vehicle_air_data", _plain(static_pressure="baro_pressure_pa")),
    # Of PX4's branches with airflow sensors (ETH Zurich's; SENSOR_AIRFLOW_ANGLES over MAVLink).
    ("airflow_aoa", _angle("alpha_vane", "aoa_rad")),
    ("airflow_slip", _angle("beta_vane", "slip_rad")),
)
"""The first topic that gives a signal keeps it. Surfaces are not here: PX4 logs commands, not positions."""


def read_ulog(path: Path, aircraft: Aircraft) -> Record:
    """A PX4 log. Raises LogError if it is none or holds no topic the station knows."""
    from pyulog import ULog  # slow to import, and wanted here only

    try:
        with path.open("rb") as file:
            _check_definitions(path, file)
            log = ULog(file, message_name_filter_list=[name for name, _ in _TOPICS])
        topics = {d.name: d.data for d in reversed(log.data_list) if len(d.data["timestamp"])}
    except LogError:
        raise
    except Exception as error:  # pyulog raises whatever a broken file makes of it
        raise LogError(f"{path}: not a PX4 log that can be read: {type(error).__name__}: {error}") from error
    tracks: list[Track] = []
    taken: set[str] = set()
    for name, convert in _TOPICS:
        data = topics.get(name)
        if data is None:
            continue
        try:
            columns = {s: c for s, c in convert(data).items() if s not in taken}
        except KeyError:
            # A version of PX4 that calls a field otherwise: the topic's other version or another topic may do.
            continue
        taken |= columns.keys()
        stamp = data["timestamp_sample"] if "timestamp_sample" in data else data["timestamp"]
        t_ns = np.asarray(stamp, dtype=np.int64) * 1000
        keep = np.concatenate([[True], np.diff(np.maximum.accumulate(t_ns)) > 0])
        if columns:
            tracks.append(Track(name, t_ns[keep], {s: c[keep] for s, c in columns.items()}))
    if not tracks:
        known = ", ".join(name for name, _ in _TOPICS)
        raise LogError(f"{path}: holds none of the topics that the station knows: {known}")
    return Record(tracks, aircraft, "ulog", {"file": path.name, "dropouts": str(len(log.dropouts))})


def _check_definitions(path: Path, file: BinaryIO) -> None:
    """At a message of no known kind among the definitions that runs past the end of the file pyulog goes round for
    ever: it goes back by what the message ought to have. Raises LogError for one."""
    is_one = file.read(len(_MAGIC)) == _MAGIC
    size, at = file.seek(0, os.SEEK_END), _HEAD
    while is_one and at + 3 <= size:
        file.seek(at)
        length, kind = struct.unpack("<HB", file.read(3))
        if kind in _DATA:
            break
        if kind not in _DEFINITIONS and at + 3 + length > size:
            raise LogError(
                f"{path}: damaged at byte {at}: a message runs past the end of the file\ndownload the log anew"
            )
        is_noise = kind not in _DEFINITIONS and (not kind or not length or length > _LONGEST)
        at += 1 if is_noise else 3 + length
    file.seek(0)

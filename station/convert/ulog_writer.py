"""A recording as PX4's ULog, under PX4's own topics where it has them, so that its tools draw what they know.

Format: docs.px4.io, "ULog File Format", version 1. Topics and fields are those of PX4 v1.14, as Flight Review, pyulog
and PlotJuggler read them; what PX4 has no topic for stands under `station_...`, SI. Times are microseconds of the
station's clock.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

from station.convert.aligned import aligned_rows
from station.convert.groups import ROWS, Told
from station.log import LogInfo, metadata
from station.numerics.angles import quaternion
from station.rows import Event, Level, LogError

MAGIC: Final = bytes((0x55, 0x4C, 0x6F, 0x67, 0x01, 0x12, 0x35, 1))
_TYPES: Final = {"uint64_t": "Q", "int32_t": "i", "uint8_t": "B", "bool": "?", "float": "f", "double": "d"}
_LEVELS: Final = {Level.INFO: ord("6"), Level.WARNING: ord("4"), Level.ALARM: ord("1")}
"""As Linux's kernel has them: information, warning, alert."""
FIXED_WING: Final = 1
"""MAV_TYPE of MAVLink's common set."""
_KELVIN: Final = 273.15

Values = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class _Topic:
    """`fields` after the timestamp, as ULog writes them, and their `values` in that order; `needs` these signals."""

    name: str
    needs: tuple[str, ...]
    fields: str
    values: Callable[[Values, int], Sequence[Any]]


def _degrees(v: Values) -> tuple[float, float, float]:
    return math.degrees(v["latitude"]), math.degrees(v["longitude"]), v["altitude"]


_IMU: Final = ("p", "q", "r", "ax", "ay", "az")
_VELOCITY: Final = ("v_north", "v_east", "v_down")
_POSITION: Final = ("latitude", "longitude", "altitude")
_TOPICS: Final = (
    _Topic(
        "sensor_combined",
        _IMU,
        "float[3] gyro_rad;float[3] accelerometer_m_s2",
        lambda v, _: [v[n] for n in _IMU],
    ),
    _Topic(
        "vehicle_attitude",
        ("phi", "theta", "psi"),
        "uint64_t timestamp_sample;float[4] q",
        lambda v, us: [us, *quaternion(v["phi"], v["theta"], v["psi"])],
    ),
    _Topic(
        "vehicle_angular_velocity",
        ("p", "q", "r"),
        "uint64_t timestamp_sample;float[3] xyz",
        lambda v, us: [us, v["p"], v["q"], v["r"]],
    ),
    _Topic(
        "vehicle_local_position",
        _VELOCITY,
        "uint64_t timestamp_sample;float vx;float vy;float vz;bool v_xy_valid;bool v_z_valid",
        lambda v, us: [us, *(v[n] for n in _VELOCITY), True, True],
    ),
    _Topic(
        "vehicle_global_position",
        _POSITION,
        "uint64_t timestamp_sample;double lat;double lon;float alt",
        lambda v, us: [us, *_degrees(v)],
    ),
    _Topic(
        "vehicle_gps_position",
        _POSITION,
        "uint64_t timestamp_sample;double latitude_deg;double longitude_deg;double altitude_msl_m;uint8_t fix_type",
        lambda v, us: [us, *_degrees(v), 3],
    ),
    _Topic(
        "airspeed_validated",
        ("airspeed",),
        "float true_airspeed_m_s",
        lambda v, _: [v["airspeed"]],
    ),
    _Topic(
        "differential_pressure",
        ("dynamic_pressure",),
        "uint64_t timestamp_sample;float differential_pressure_pa",
        lambda v, us: [us, v["dynamic_pressure"]],
    ),
    _Topic(
        "vehicle_air_data",
        ("static_pressure",),
        "uint64_t timestamp_sample;float baro_pressure_pa;float baro_temp_celcius;float baro_alt_meter",
        lambda v, us: [us, v["static_pressure"], v["air_temperature"] - _KELVIN, v["altitude"]],
    ),
)
_OF_PX4: Final = frozenset(n for t in _TOPICS for n in t.needs)


def _own_topic(names: Sequence[str]) -> _Topic:
    """The signals that no topic of PX4 has."""
    fields = ";".join(f"float {n}" for n in names)
    return _Topic("station_signals", (), fields, lambda v, _: [v[n] for n in names])


def _layout(fields: str) -> struct.Struct:
    """Bytes of a topic's fields, its timestamp first."""
    letters = ""
    for field in fields.split(";"):
        kind, _, many = field.partition(" ")[0].partition("[")
        letters += (many.rstrip("]") or "") + _TYPES[kind]
    return struct.Struct(f"<Q{letters}")


def write_ulog(path: Path, out: Path, told: Told = lambda _: None) -> None:
    """Write a recording's aligned rows and events as ULog. Raises LogError and OSError."""
    info = metadata(path)
    with out.open("xb") as file:
        if not _write(file, path, info, told):
            raise LogError(f"{path}: holds neither frames nor samples")


def _write(file: BinaryIO, path: Path, info: LogInfo, told: Told) -> int:
    """Returns the number of rows."""
    names = tuple(info.about.signals)
    known = {n for s in info.streams for n in s.signals} | {d.signal.name for d in info.about.further.derived}
    topics = [t for t in _TOPICS if known.issuperset(t.needs)]
    others = [n for n in names if n in known and n not in _OF_PX4]
    topics += [_own_topic(others)] if others else []
    layouts = [_layout(t.fields) for t in topics]
    count = 0
    first: int | None = None
    for row in aligned_rows(path):
        if first is None:
            first = row.t_ns if isinstance(row, Event) else row[0]
            _write_definitions(file, info, topics, first)
        # Of the station's clock, but never negative.
        zero = min(first, 0)
        if isinstance(row, Event):
            words = f"[{row.source}] {row.code} {row.detail}".rstrip().encode()
            _message(file, "L", struct.pack("<BQ", _LEVELS[row.level], max(row.t_ns - zero, 0) // 1000) + words)
            continue
        t_ns, values = row
        us = (t_ns - zero) // 1000
        named = dict(zip(names, values, strict=True))
        for number, (topic, layout) in enumerate(zip(topics, layouts, strict=True)):
            if not topic.needs or any(math.isfinite(named[n]) for n in topic.needs):
                _message(file, "D", struct.pack("<H", number) + layout.pack(us, *topic.values(named, us)))
        count += 1
        if not count % ROWS:
            told(t_ns)
    return count


def _write_definitions(file: BinaryIO, info: LogInfo, topics: Sequence[_Topic], first_ns: int) -> None:
    file.write(MAGIC + struct.pack("<Q", max(first_ns, 0) // 1000))
    _message(file, "B", bytes(40))
    for topic in topics:
        _message(file, "F", f"{topic.name}:uint64_t timestamp;{topic.fields};".encode())
    told = {
        "sys_name": "flight-test-station",
        "ver_sw_release_str": info.software,
        "ver_hw": info.about.aircraft.name,
        "sys_uuid": info.flight,
    }
    for name, text in told.items():
        key = f"char[{len(text.encode())}] {name}".encode()
        _message(file, "I", struct.pack("<B", len(key)) + key + text.encode())
    key = b"int32_t MAV_TYPE"
    _message(file, "P", struct.pack("<B", len(key)) + key + struct.pack("<i", FIXED_WING))
    for number, topic in enumerate(topics):
        _message(file, "A", struct.pack("<BH", 0, number) + topic.name.encode())


def _message(file: BinaryIO, kind: str, content: bytes) -> None:
    file.write(struct.pack("<HB", len(content), ord(kind)) + content)

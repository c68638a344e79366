"""A recording for Foxglove and PlotJuggler: MCAP in calendar time, with the map and the attitude that they draw, and
without raw bytes.

Schemas are Foxglove's where it has one (LocationFix, PoseInFrame, Log), JSON with units otherwise. The pose is in
metres east, north and up of the first position, the body's axes forward, left and up, as 3-D panels have them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final

import msgspec
from mcap.writer import CompressionType, Writer

from station.conventions import SIGNAL_INDEX
from station.convert.groups import ROWS, Told
from station.log import LogInfo, metadata, read_rows
from station.log.messages import RowWriter
from station.log.part import Topic
from station.numerics.angles import quaternion
from station.numerics.earth import radii
from station.rows import AlphaEstimate, Event, Extra, Frame, Health, MethodEstimate, Sample, Truth

LOCATION, POSE, LOCAL = "/location", "/pose", "local"
KINDS: Final = (Frame, Sample, AlphaEstimate, MethodEstimate, Event, Health, Truth, Extra)
EVERY: Final = 5
"""Frames from one position to the next: 10 Hz."""
_TIME: Final = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0}},
}
_NUMBER: Final = {"type": "number"}


def _object(title: str, **properties: Any) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _numbers(title: str, names: str) -> dict[str, Any]:
    return _object(title, **dict.fromkeys(names, _NUMBER))


_SCHEMAS: Final = {
    LOCATION: _object(
        "foxglove.LocationFix",
        timestamp=_TIME,
        frame_id={"type": "string"},
        latitude={**_NUMBER, "description": "deg"},
        longitude={**_NUMBER, "description": "deg"},
        altitude={**_NUMBER, "description": "m"},
        position_covariance={"type": "array", "items": _NUMBER, "minItems": 9, "maxItems": 9},
        position_covariance_type={"type": "integer", "oneOf": [{"const": n} for n in range(4)]},
    ),
    POSE: _object(
        "foxglove.PoseInFrame",
        timestamp=_TIME,
        frame_id={"type": "string"},
        pose=_object(
            "foxglove.Pose",
            position=_numbers("foxglove.Vector3", "xyz"),
            orientation=_numbers("foxglove.Quaternion", "xyzw"),
        ),
    ),
}


class _Sink:
    """An MCAP file whose channels are made when they are first written to."""

    def __init__(self, file: BinaryIO) -> None:
        self.writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._channels: dict[str, int] = {}

    def add(self, name: str, schema: bytes, title: str, time_ns: int, data: bytes) -> None:
        channel = self._channels.get(name)
        if channel is None:
            number = self.writer.register_schema(title, "jsonschema", schema)
            channel = self._channels[name] = self.writer.register_channel(name, "json", number)
        self.writer.add_message(channel, time_ns, data, time_ns)

    def add_topic(self, topic: Topic, time_ns: int, data: bytes) -> None:
        self.add(topic.name, topic.schema, topic.schema_name, time_ns, data)


def write_mcap(path: Path, out: Path, told: Told = lambda _: None) -> int:
    """Write a recording for Foxglove into a new file; returns the messages. Raises LogError and OSError."""
    with out.open("xb") as file:
        return _write(file, path, metadata(path), told)


def _write(file: BinaryIO, path: Path, info: LogInfo, told: Told) -> int:
    sink, rows, drawn = _Sink(file), RowWriter(info.streams, info.about.further.own), _Drawn()
    sink.writer.start(profile="", library=f"flight-test-station {info.software}")
    about = {"aircraft": info.aircraft.name, "source": info.about.source, "recording": path.name}
    sink.writer.add_metadata("station", about)
    to_utc = info.utc_ns - info.station_ns
    count = 0
    for row in read_rows(path, KINDS):
        time_ns = max(row.t_ns + to_utc, 0)
        topic, data = rows.message(row)
        if isinstance(row, Event):
            data = _logged(data, time_ns)
        elif b"null" in data:
            data = msgspec.json.encode(_known(msgspec.json.decode(data)))
        sink.add_topic(topic, time_ns, data)
        count += 1
        if not count % ROWS:
            told(row.t_ns)
        if isinstance(row, Frame):
            for name, body in drawn.messages(row, time_ns).items():
                sink.add(name, json.dumps(_SCHEMAS[name]).encode(), _SCHEMAS[name]["title"], time_ns, body)
                count += 1
    sink.writer.finish()  # type: ignore[no-untyped-call]
    return count


def _known(body: Any) -> Any:
    """Without what is missing: its schema says number, and readers that hold to it refuse a null; an array with
    missing numbers is left out whole."""
    if isinstance(body, list):
        return [_known(item) for item in body]
    if not isinstance(body, dict):
        return body
    return {k: _known(v) for k, v in body.items() if v is not None and not (isinstance(v, list) and None in v)}


def _time(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def _logged(data: bytes, time_ns: int) -> bytes:
    """An event in calendar time, with the fields of foxglove.Log that the station has no use for."""
    return json.dumps({**json.loads(data), "timestamp": _time(time_ns), "file": "", "line": 0}).encode()


class _Drawn:
    """Frames as positions on a map and poses in space."""

    def __init__(self) -> None:
        self._origin: tuple[float, float, float] | None = None
        self._count = 0

    def messages(self, row: Frame, time_ns: int) -> Mapping[str, bytes]:
        self._count += 1
        if self._count % EVERY:
            return {}
        lat, lon, alt, *angles = (
            row.values[SIGNAL_INDEX[n]] for n in ("latitude", "longitude", "altitude", "phi", "theta", "psi")
        )
        made: dict[str, Any] = {}
        stamp = {"timestamp": _time(time_ns), "frame_id": LOCAL}
        if math.isfinite(lat + lon):
            height = alt if math.isfinite(alt) else 0.0
            made[LOCATION] = {
                **stamp,
                "latitude": math.degrees(lat),
                "longitude": math.degrees(lon),
                "altitude": height,
                "position_covariance": [0.0] * 9,
                "position_covariance_type": 0,
            }
        if all(map(math.isfinite, angles)):
            pose = {"position": self._position(lat, lon, alt), "orientation": _orientation(*angles)}
            made[POSE] = {**stamp, "pose": pose}
        return {name: json.dumps(body).encode() for name, body in made.items()}

    def _position(self, lat: float, lon: float, alt: float) -> dict[str, float]:
        """East, north and up of the first position, m; there where the position is not known."""
        if not math.isfinite(lat + lon + alt):
            return {"x": 0.0, "y": 0.0, "z": 0.0}
        if self._origin is None:
            self._origin = lat, lon, alt
        lat0, lon0, alt0 = self._origin
        along, across = radii(lat0)
        return {"x": (lon - lon0) * math.cos(lat0) * across, "y": (lat - lat0) * along, "z": alt - alt0}


def _orientation(phi: float, theta: float, psi: float) -> dict[str, float]:
    """Axes forward, left, up to east, north, up: the same turns about the roll axis, the left wing and up, counted from
    east."""
    w, x, y, z = quaternion(phi, -theta, math.pi / 2 - psi)
    return {"x": x, "y": y, "z": z, "w": w}

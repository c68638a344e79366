"""Rows <-> messages of a recording: JSON with schemas that carry units, raw bytes as they are.

A finite float is written as the shortest decimal that reads back to the same bits; NaN is null, and an infinity the
string "Infinity" or "-Infinity".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import msgspec

from station.conventions import SIGNALS, Signal, Stream
from station.log.frame_message import body_of, frame_properties, key_of, number, numbers, read_frame
from station.log.part import Topic
from station.rows import (
    AlphaEstimate,
    Code,
    Event,
    Extra,
    Frame,
    Health,
    Level,
    MethodEstimate,
    ParamEstimate,
    Quality,
    RawBlock,
    Row,
    Rows,
    Sample,
    Status,
    StreamHealth,
    Tick,
    TimeSync,
    Truth,
)

_INF: Final = math.inf
_INFINITE: Final = (math.inf, -math.inf)

ESTIMATE_UNITS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("alpha", "alpha_sd", "vane", "instrument", "zero", "upwash", "rate", "lag", "gust"), "rad"),
    **dict.fromkeys(("alpha_inertial", "alpha_gust"), "rad"),
    **dict.fromkeys(("gust_vertical", "turbulence_level", "wind_north", "wind_east", "wind_down"), "m/s"),
}
_FOXGLOVE_LEVELS: Final = {Level.INFO: 2, Level.WARNING: 3, Level.ALARM: 4}


def _plain(value: Any) -> Any:
    """numpy's scalars, which a row may carry by accident."""
    return value.item()


_ENCODE: Final = msgspec.json.Encoder(enc_hook=_plain).encode
_DECODE: Final = msgspec.json.Decoder().decode


def _spelled(value: Any) -> Any:
    """The same with infinities as strings: JSON has no number for them."""
    if isinstance(value, float):
        return value if abs(value) != _INF else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, dict):
        return {k: _spelled(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_spelled(v) for v in value]
    return value


def _json(body: Any) -> bytes:
    data = _ENCODE(body)
    # Only a NaN, an infinity or a None leaves a null; the slow way then finds out which.
    return data if b"null" not in data else _ENCODE(_spelled(msgspec.to_builtins(body, enc_hook=_plain)))


def _schema(title: str, properties: Mapping[str, Mapping[str, Any]]) -> bytes:
    return _ENCODE({"type": "object", "title": title, "properties": properties})


def _quantity(unit: str, meaning: str = "") -> dict[str, Any]:
    text = f"{unit}; {meaning}" if meaning else unit
    return {"type": "number", "unit": unit, "description": text}


def signal_property(name: str, signals: Mapping[str, Signal] = SIGNALS) -> dict[str, Any]:
    """JSON schema of a signal: its unit and what positive means."""
    known = signals.get(name)
    if known is None:
        return {"type": "number"}
    return _quantity(known.unit, f"positive: {known.positive}" if known.positive else "")


_TEXT: Final = {"type": "string"}
_WHOLE: Final = {"type": "integer"}
_TRUE_OR_FALSE: Final = {"type": "boolean"}


def _sample_topic(stream: str, key: str, signals: Iterable[str] = (), known: Mapping[str, Signal] = SIGNALS) -> Topic:
    properties = {
        "t_device_ns": {"type": "integer", "unit": "ns", "description": "ns; the device's own time"},
        "seq": _WHOLE,
        "quality": {"type": "integer", "description": "0 fresh, 1 held, 2 suspect, 3 missing"},
        **{n: signal_property(n, known) for n in signals},
    }
    title = f"station.Sample.{stream}"
    return Topic(f"/sample/{key}", "json", title, _schema(title, properties), {"row": "Sample", "key": stream})


class _Announced:
    """A stream of the rig. A struct of its own encodes a sample five times as fast as a dict."""

    def __init__(self, name: str, signals: tuple[str, ...], known: Mapping[str, Signal]) -> None:
        self.topic = _sample_topic(name, name, signals, known)
        self.count = len(signals)
        self.body: Callable[..., msgspec.Struct] = msgspec.defstruct(
            "Sample", ("t_device_ns", "seq", "quality", *signals), gc=False
        )


class RowWriter:
    """Turns rows into messages. Topics are made when first seen, so a file holds only those it uses."""

    def __init__(self, streams: Iterable[Stream], further: Iterable[Signal] = ()) -> None:
        """`further`: signals after SIGNALS in a frame."""
        more = {s.name: s for s in further}
        self._known = {**SIGNALS, **more}
        self._frame_key, self._frame_body = key_of(more), body_of(more)
        self._signals = {s.name: s.signals for s in streams}
        self._announced = {name: _Announced(name, own, self._known) for name, own in self._signals.items()}
        self._topics: dict[tuple[type, str], Topic] = {}
        self._newest: dict[str, tuple[MethodEstimate, bytes]] = {}
        """Of each method, and what became of it."""
        self._raw_topics: dict[str, Topic] = {}
        self._kinds: dict[type, Callable[[Any], tuple[Topic, bytes]]] = {
            Sample: self._sample,
            RawBlock: self._raw,
            Frame: self._frame,
            MethodEstimate: self._method,
            Event: self._event,
            Truth: self._named,
            Extra: self._named,
            AlphaEstimate: self._struct,
            Health: self._struct,
            Tick: self._struct,
            TimeSync: self._struct,
        }

    def message(self, row: Rows) -> tuple[Topic, bytes]:
        return self._kinds[type(row)](row)

    def _topic(self, row: Row, key: str, name: str, properties: Callable[[], Mapping[str, Any]]) -> Topic:
        kind = type(row)
        topic = self._topics.get((kind, key))
        if topic is None:
            title = f"station.{kind.__name__}"
            topic = Topic(name, "json", title, _schema(title, properties()), {"row": kind.__name__, "key": key})
            self._topics[kind, key] = topic
        return topic

    def _sample(self, row: Sample) -> tuple[Topic, bytes]:
        announced = self._announced.get(row.stream)
        if announced is None or len(row.values) != announced.count or row.t_ns < 0:
            return self._odd_sample(row)
        data = _ENCODE(announced.body(row.t_device_ns, row.seq, row.quality, *row.values))
        if b"null" in data and (_INF in row.values or -_INF in row.values):
            return self._odd_sample(row)
        return announced.topic, data

    def _odd_sample(self, row: Sample) -> tuple[Topic, bytes]:
        """One with an infinity, before time 0, or not as the rig announced it, which is kept without names."""
        announced = self._announced.get(row.stream)
        body: dict[str, Any] = {"t_device_ns": row.t_device_ns, "seq": row.seq, "quality": int(row.quality)}
        if announced is not None and announced.count == len(row.values):
            topic = announced.topic
            body.update(zip(self._signals[row.stream], row.values, strict=True))
        else:
            topic = self._topics.setdefault((Sample, row.stream), _sample_topic(row.stream, f"{row.stream}#unnamed"))
            body["values"] = row.values
        if row.t_ns < 0:
            body["t_ns"] = row.t_ns
        return topic, _ENCODE(_spelled(body))

    def _raw(self, row: RawBlock) -> tuple[Topic, bytes]:
        topic = self._raw_topics.get(row.device)
        if topic is None:
            topic = Topic(f"/raw/{row.device}", "x-octets", "", b"", {"row": "RawBlock", "key": row.device})
            self._raw_topics[row.device] = topic
        return topic, row.data

    def _frame(self, row: Frame) -> tuple[Topic, bytes]:
        topic = self._topic(row, self._frame_key, "/frame", self._frame_properties)
        if row.t_ns < 0 or _INF in row.values or -_INF in row.values or _INF in row.age_s or -_INF in row.age_s:
            body: dict[str, Any] = dict(zip(self._known, row.values, strict=True))
            body.update(k=row.k, age_s=row.age_s, quality=row.quality)
            if row.t_ns < 0:
                body["t_ns"] = row.t_ns
            return topic, _ENCODE(_spelled(body))
        return topic, _ENCODE(self._frame_body(*row.values, row.k, row.age_s, row.quality))

    def _frame_properties(self) -> Mapping[str, Any]:
        return frame_properties((signal_property(n, self._known) for n in self._known), self._known)

    def _method(self, row: MethodEstimate) -> tuple[Topic, bytes]:
        was, data = self._newest.get(row.method, (None, b""))
        # A method that is not renewed at every tick hands on the same parameters.
        if (
            was is not None
            and was.parameters is row.parameters
            and (was.applicable, was.why) == (row.applicable, row.why)
            and 0 <= was.t_ns <= row.t_ns
        ):
            return self._topics[MethodEstimate, row.method], data
        body: dict[str, Any] = {p.name: p for p in row.parameters}
        body["applicable"] = row.applicable
        body["why"] = row.why
        if row.t_ns < 0:
            body["t_ns"] = row.t_ns

        def properties() -> Mapping[str, Any]:
            derivative = {
                "type": "object",
                "properties": {"name": _TEXT, "value": _quantity("1/rad"), "sd": _quantity("1/rad"), "status": _TEXT},
            }
            return {**{p.name: derivative for p in row.parameters}, "applicable": _TRUE_OR_FALSE, "why": _TEXT}

        data = _ENCODE(body)
        if b"null" in data and any(p.value in _INFINITE or p.sd in _INFINITE for p in row.parameters):
            data = _json(body)
        self._newest[row.method] = row, data
        return self._topic(row, row.method, f"/method/{row.method}", properties), data

    def _event(self, row: Event) -> tuple[Topic, bytes]:
        topic = self._topics.get((Event, ""))
        if topic is None:
            stamp = {"type": "object", "properties": {"sec": _WHOLE, "nsec": _WHOLE}}
            properties: dict[str, Mapping[str, Any]] = {"timestamp": stamp}
            properties.update(dict.fromkeys(("level", "line", "count"), _WHOLE))
            properties.update(dict.fromkeys(("message", "name", "file", "code", "detail"), _TEXT))
            # Foxglove's own schema name, so that its log panel lists the events.
            topic = Topic(
                "/event", "json", "foxglove.Log", _schema("foxglove.Log", properties), {"row": "Event", "key": ""}
            )
            self._topics[Event, ""] = topic
        body: dict[str, Any] = {
            "timestamp": {"sec": row.t_ns // 10**9, "nsec": row.t_ns % 10**9},
            "level": _FOXGLOVE_LEVELS[row.level],
            "message": f"{row.code} x{row.count} {row.detail}".rstrip(),
            "name": row.source,
            "code": row.code,
            "count": row.count,
            "detail": row.detail,
        }
        return topic, _ENCODE(body)

    def _named(self, row: Truth | Extra) -> tuple[Topic, bytes]:
        body: dict[str, Any] = {"values": row.values}
        if row.t_ns < 0:
            body["t_ns"] = row.t_ns

        def properties() -> Mapping[str, Any]:
            return {
                "values": {"type": "object", "properties": {n: signal_property(n, self._known) for n in row.values}}
            }

        return self._topic(row, "", f"/{type(row).__name__.lower()}", properties), _json(body)

    def _struct(self, row: AlphaEstimate | Health | Tick | TimeSync) -> tuple[Topic, bytes]:
        kind = type(row)

        def properties() -> Mapping[str, Any]:
            return _struct_properties(kind)

        return self._topic(row, "", _STRUCT_TOPICS[kind], properties), _json(row)


_STRUCT_TOPICS: Final[Mapping[type, str]] = {
    AlphaEstimate: "/alpha",
    Health: "/health",
    Tick: "/tick",
    TimeSync: "/time_sync",
}


def _struct_properties(kind: type) -> Mapping[str, Any]:
    found: dict[str, Any] = {}
    for item in msgspec.structs.fields(kind):
        if item.type is float:
            found[item.name] = _quantity(ESTIMATE_UNITS.get(item.name, ""))
        elif item.type in (int, bool, str):
            found[item.name] = {int: _WHOLE, bool: _TRUE_OR_FALSE, str: _TEXT}[item.type]
        elif item.type == tuple[StreamHealth, ...]:
            found[item.name] = {"type": "array", "items": _object(_struct_properties(StreamHealth))}
    return found


def _object(properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_ALPHA_FLOATS: Final = tuple(f.name for f in msgspec.structs.fields(AlphaEstimate) if f.type is float)
_HEALTH_FLOATS: Final = tuple(f.name for f in msgspec.structs.fields(StreamHealth) if f.type is float)

ROW_KINDS: Final[Mapping[str, type[Row]]] = {
    kind.__name__: kind
    for kind in (
        RawBlock, Sample, Event, TimeSync, Tick, Frame, AlphaEstimate, MethodEstimate, Health, Truth, Extra,
    )
}  # fmt: skip


def read_row(kind: str, key: str, time_ns: int, data: bytes) -> Rows:
    """A message back as the row it was; a sample's values come in the order they were written in.

    Raises ValueError, KeyError or TypeError where the message is not a row of that kind.
    """
    if kind == "RawBlock":
        return RawBlock(time_ns, key, bytes(data))
    if kind == "Frame":
        return read_frame(key, time_ns, data)
    body = _DECODE(data)
    t_ns = body.get("t_ns", time_ns)
    if kind == "Sample":
        t_device_ns, seq, quality = body.pop("t_device_ns"), body.pop("seq"), Quality(body.pop("quality"))
        body.pop("t_ns", None)
        values = body["values"] if "values" in body else body.values()
        return Sample(t_ns, key, t_device_ns, seq, numbers(values), quality)
    if kind == "MethodEstimate":
        parameters = tuple(
            ParamEstimate(p["name"], number(p["value"]), number(p["sd"]), Status(p["status"]), p["why"])
            for p in body.values()
            if type(p) is dict
        )
        return MethodEstimate(t_ns, key, parameters, body["applicable"], body["why"])
    if kind == "Event":
        stamp = body["timestamp"]
        t_ns = stamp["sec"] * 10**9 + stamp["nsec"]
        return Event(t_ns, body["name"], Code(body["code"]), body["count"], body["detail"])
    if kind in ("Truth", "Extra"):
        named = {n: number(v) for n, v in body["values"].items()}
        return Truth(t_ns, named) if kind == "Truth" else Extra(t_ns, named)
    if kind == "AlphaEstimate":
        # A recording made before the profile's instruments were undone lacks what that came to.
        body.update({n: number(body[n]) for n in _ALPHA_FLOATS if n in body})
        return AlphaEstimate(**body)
    if kind == "Health":
        for stream in body["streams"]:
            stream.update({n: number(stream[n]) for n in _HEALTH_FLOATS})
        body["streams"] = tuple(StreamHealth(**s) for s in body["streams"])
        return Health(**body)
    if kind == "Tick":
        return Tick(**body)
    if kind == "TimeSync":
        return TimeSync(**body)
    raise ValueError(f"no row is called {kind}")

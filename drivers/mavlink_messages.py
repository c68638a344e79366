"""The MAVLink messages the station knows, and their fields in plain units: one table for reading and for writing.

Field names are MAVLink's. Definitions: mavlink.io, common.xml; AOA_SSA is in ardupilotmega.xml only. Where they leave
open how a number is not known, a float is NaN, and a measurement's integer has its most negative count (the highest of
an unsigned one); the next one and the other end are a value beyond what it can carry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from station.numerics.angles import euler_angles, quaternion


@dataclass(frozen=True, slots=True)
class Field:
    """A field in plain units: what is on the wire divided by `counts`. `missing` on the wire means not known."""

    unit: str
    counts: float = 1.0
    missing: float | None = None


@dataclass(frozen=True, slots=True)
class Layout:
    """What of a message is read: its time field (time_boot_ms, time_usec or none) and its fields.

    Several of one kind from one device are distinguished by the field `instance`: they are called MESSAGE:INSTANCE, and
    plain MESSAGE for instance 0. `short_time`: senders count the time in 32 bits.
    """

    time: str | None
    fields: Mapping[str, Field]
    instance: str | None = None
    short_time: bool = False


def _each(names: str, unit: str, counts: float = 1.0, missing: float | None = None) -> dict[str, Field]:
    return {name: Field(unit, counts, missing) for name in names.split()}


_U16: Final = 65_535.0
_I16: Final = 32_767.0
_SERVOS: Final = " ".join(f"servo{i}_raw" for i in range(1, 17))
_ACTUATORS: Final = " ".join(f"actuator{i}" for i in range(32))
_BODY_RATES: Final = _each("rollspeed pitchspeed yawspeed", "rad/s")
_SCALED_IMU: Final = (
    _each("xacc yacc zacc", "g", 1e3)
    | _each("xgyro ygyro zgyro", "rad/s", 1e3)
    | _each("xmag ymag zmag", "gauss", 1e3)
    | _each("temperature", "degC", 100, 0.0)
)

TABLE: Final[Mapping[str, Layout]] = MappingProxyType(
    {
        "HEARTBEAT": Layout(None, _each("type autopilot base_mode custom_mode system_status", "1")),
        "HIGHRES_IMU": Layout(
            "time_usec",
            _each("xacc yacc zacc", "m/s2")
            | _each("xgyro ygyro zgyro", "rad/s")
            | _each("xmag ymag zmag", "gauss")
            | _each("abs_pressure diff_pressure", "hPa")
            | _each("pressure_alt", "m")
            | _each("temperature", "degC"),
            instance="id",
        ),
        "RAW_IMU": Layout(  # counts of the sensor, but for ArduPilot's, which are mg and mrad/s
            "time_usec",
            _each("xacc yacc zacc xgyro ygyro zgyro xmag ymag zmag", "1") | _each("temperature", "degC", 100, 0.0),
            instance="id",
        ),
        "SCALED_IMU": Layout("time_boot_ms", _SCALED_IMU),
        "SCALED_IMU2": Layout("time_boot_ms", _SCALED_IMU),
        "SCALED_IMU3": Layout("time_boot_ms", _SCALED_IMU),
        "ATTITUDE": Layout("time_boot_ms", _each("roll pitch yaw", "rad") | _BODY_RATES),
        "ATTITUDE_QUATERNION": Layout("time_boot_ms", _each("q1 q2 q3 q4", "1") | _BODY_RATES),
        "LOCAL_POSITION_NED": Layout("time_boot_ms", _each("x y z", "m") | _each("vx vy vz", "m/s")),
        "GLOBAL_POSITION_INT": Layout(
            "time_boot_ms",
            _each("lat lon", "deg", 1e7)
            | _each("alt relative_alt", "m", 1e3)
            | _each("vx vy vz", "m/s", 100)
            | _each("hdg", "deg", 100, _U16),
        ),
        "GPS_RAW_INT": Layout(
            "time_usec",
            _each("fix_type", "1")
            | _each("satellites_visible", "1", missing=255.0)
            | _each("lat lon", "deg", 1e7)
            | _each("alt", "m", 1e3)
            | _each("eph epv", "1", 100, _U16)
            | _each("vel", "m/s", 100, _U16)
            | _each("cog", "deg", 100, _U16),
        ),
        "SCALED_PRESSURE": Layout(
            "time_boot_ms", _each("press_abs press_diff", "hPa") | _each("temperature", "degC", 100)
        ),
        "VFR_HUD": Layout(
            None,
            _each("airspeed groundspeed climb", "m/s")
            | _each("heading", "deg")
            | _each("throttle", "%")
            | _each("alt", "m"),
        ),
        "AIRSPEED": Layout(
            None,
            _each("airspeed", "m/s") | _each("temperature", "degC", 100, _I16) | _each("raw_press", "hPa"),
            instance="id",
        ),
        "AOA_SSA": Layout("time_usec", _each("AOA SSA", "deg"), short_time=True),
        "SERVO_OUTPUT_RAW": Layout("time_usec", _each(_SERVOS, "us"), instance="port", short_time=True),
        "ACTUATOR_OUTPUT_STATUS": Layout("time_usec", _each("active", "1") | _each(_ACTUATORS, "1")),
        "NAMED_VALUE_FLOAT": Layout("time_boot_ms", _each("value", "1"), instance="name"),
        "DEBUG_VECT": Layout("time_usec", _each("x y z", "1"), instance="name"),
    }
)
"""Message -> layout. `actuator0` to `actuator31` are the elements of the array `actuator`."""

DERIVED: Final[Mapping[str, Mapping[str, str]]] = {
    "ATTITUDE_QUATERNION": {"roll": "rad", "pitch": "rad", "yaw": "rad"},
    "GPS_RAW_INT": {"v_north": "m/s", "v_east": "m/s"},
}
"""Fields that are worked out of others, with their units; a writer may be given them instead."""

_DEFAULTS: Final[Mapping[str, Mapping[str, float]]] = {
    "HEARTBEAT": {
        "type": 1,  # fixed wing
        "autopilot": 3,  # ArduPilot: ground stations pass over a vehicle without an autopilot they know
        "system_status": 4,  # active
        "mavlink_version": 3,
    },
    "HIGHRES_IMU": {"fields_updated": 0x1FFF},
    "GPS_RAW_INT": {"fix_type": 3},
    "ATTITUDE_QUATERNION": {"q1": 1.0},
}
_NO_FIX: Final = 1
_KINDS: Final[Mapping[str, Any]] = {k.msgname: k for k in dialect.mavlink_map.values() if k.msgname in TABLE}
_WIRES: Final = {name: dict(zip(k.fieldnames, k.fieldtypes, strict=True)) for name, k in _KINDS.items()}
_ENDS: Final = {
    "int16_t": (-(1 << 15), 1 - (1 << 15), (1 << 15) - 1),
    "uint16_t": ((1 << 16) - 1, 0, (1 << 16) - 2),
    "int32_t": (-(1 << 31), 1 - (1 << 31), (1 << 31) - 1),
}
"""Integers that carry measurements: the count for not known, the least and the greatest."""
_ARRAYS: Final[Mapping[str, int]] = {"actuator": 32, "repr_offset_q": 4}


def fields_known(message: str) -> tuple[str, ...]:
    """Names a channel may use with that message (MESSAGE or MESSAGE:INSTANCE); empty for an unknown message."""
    name, _, instance = message.partition(":")
    layout = TABLE.get(name)
    if layout is None or (instance and layout.instance is None):
        return ()
    return (*layout.fields, *DERIVED.get(name, ()))


def message_id(message: str) -> int:
    """MAVLink's number of a message (MESSAGE or MESSAGE:INSTANCE). Raises KeyError."""
    return int(_KINDS[message.partition(":")[0]].id)


def title(message: Any) -> str:
    """What a rig calls a pymavlink message of the table: MESSAGE or MESSAGE:INSTANCE."""
    name = str(message.get_type())
    field = TABLE[name].instance
    instance = getattr(message, field) if field else None
    return f"{name}:{instance}" if instance else name


def plain_fields(message: Any) -> dict[str, float]:
    """A pymavlink message's fields, read and derived, in plain units; NaN where the sender does not know."""
    name = message.get_type()
    out = {}
    for field, f in TABLE[name].fields.items():
        if field.startswith("actuator"):
            raw = message.actuator[int(field.removeprefix("actuator"))]
        else:
            raw = getattr(message, field)
        out[field] = math.nan if raw == f.missing else _measured(raw, _WIRES[name].get(field, "float")) / f.counts
    if name == "ATTITUDE_QUATERNION":
        angles = euler_angles(out["q1"], out["q2"], out["q3"], out["q4"])
        out |= dict(zip(DERIVED[name], angles, strict=True))
    elif name == "GPS_RAW_INT":
        if out["fix_type"] <= _NO_FIX:
            out |= dict.fromkeys(out.keys() - {"fix_type", "satellites_visible"}, math.nan)
        # A course beyond what its integer can carry is none, and the cosine of it no number but an error.
        course = math.radians(out["cog"]) if math.isfinite(out["cog"]) else math.nan
        out |= {"v_north": out["vel"] * math.cos(course), "v_east": out["vel"] * math.sin(course)}
    return out


def build(message: str, fields: Mapping[str, float], t_device_ns: int) -> Any:
    """The pymavlink message that carries the fields (plain units), stamped with the device's time since boot.

    Fields left out are unknown where the definitions have a way to say so, otherwise 0 or a usual value; NaN is not
    known. Integers are rounded and held within their range. Raises KeyError for a message or field that the table does
    not have.
    """
    name, _, instance = message.partition(":")
    layout = TABLE[name]
    for field in fields:
        if field not in fields_known(message):
            raise KeyError(f"{message} has no field {field}")
    given = {**_DEFAULTS.get(name, {}), **_without_derived(name, fields)}
    kind = _KINDS[name]
    values: list[Any] = []
    for field, wire in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        if field == layout.time:
            values.append(_time_count(field, wire, t_device_ns))
        elif field == layout.instance:
            values.append(instance.encode("ascii")[:10] if wire == "char" else int(instance or 0))
        elif field in _ARRAYS:
            values.append([given.get(f"{field}{i}", 0.0) for i in range(_ARRAYS[field])])
        else:
            f = layout.fields.get(field, Field("1"))
            raw = given[field] * f.counts if field in given else f.missing or 0.0
            values.append(raw if wire == "float" else _whole(raw, wire, f.missing))
    return kind(*values)


def _time_count(field: str, wire: str, t_ns: int) -> int:
    unit_ns = 1_000_000 if field == "time_boot_ms" else 1_000
    modulus = (1 << 64) if wire == "uint64_t" else (1 << 32)
    return ((t_ns + unit_ns // 2) // unit_ns) % modulus


def _measured(raw: float, wire: str) -> float:
    """A count: NaN where it is not known, infinite beyond what the integer can carry."""
    if wire not in _ENDS:
        return raw
    unknown, least, most = _ENDS[wire]
    if raw == unknown:
        return math.nan
    if raw == most or raw == least < 0:
        return math.copysign(math.inf, raw)
    return raw


def _whole(raw: float, wire: str, missing: float | None) -> int:
    """Rounded and held within an integer type such as int16_t; its count for not known for NaN."""
    bits = int(wire.removeprefix("u").removeprefix("int").removesuffix("_t"))
    least = 0 if wire.startswith("u") else -(1 << bits - 1)
    unknown, low, high = _ENDS.get(wire, (0, least, least + (1 << bits) - 1))
    if math.isnan(raw) or raw == missing:
        return int(unknown if missing is None else missing)
    return round(min(max(raw, low), high))


def _without_derived(name: str, fields: Mapping[str, float]) -> dict[str, float]:
    """The same with derived fields turned into those they come from."""
    out = dict(fields)
    if name == "ATTITUDE_QUATERNION" and not out.keys().isdisjoint(DERIVED[name]):
        q = quaternion(*(out.pop(angle, 0.0) for angle in DERIVED[name]))
        out |= dict(zip(("q1", "q2", "q3", "q4"), q, strict=True))
    elif name == "GPS_RAW_INT" and not out.keys().isdisjoint(DERIVED[name]):
        north, east = (out.pop(v, 0.0) for v in DERIVED[name])
        out |= {"vel": math.hypot(north, east), "cog": math.degrees(math.atan2(east, north)) % 360.0}
    return out

"""DroneCAN (UAVCAN v0): broadcasts of a bus's nodes, defined and decoded by the dronecan library.

The station listens: it has no node id, allocates none, answers nothing. A stream's message is DroneCAN's full name, a
field its name there (`rate_gyro_latest[0]` of an array), in the definition's units. `MESSAGE:ID` is one of several
sensors or actuators of a kind, by its sensor_id or actuator_id. ahrs.Solution also gives roll, pitch and yaw in rad.

Device time is the message's timestamp, where it has one that is not 0 (unknown), of the first node that stamps: nodes
need not have one time. A fix without position (status below 2) has no fields. Transfers of several frames are put
together here, by node and message, so that the result depends on nothing but the frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final

import dronecan
from dronecan import dsdl
from dronecan.transport import Frame, Transfer

from drivers.can_frames import FrameCodec, encode_slcan
from drivers.codec import Reading
from station.numerics.angles import euler_angles, quaternion
from station.profile import DronecanDevice
from station.rows import Code

NODE_STATUS: Final = "uavcan.protocol.NodeStatus"
_SOLUTION: Final = "uavcan.equipment.ahrs.Solution"
_FIXES: Final = ("uavcan.equipment.gnss.Fix", "uavcan.equipment.gnss.Fix2")
USUAL: Final = (
    "uavcan.equipment.air_data.AngleOfAttack",
    "uavcan.equipment.air_data.Sideslip",
    "uavcan.equipment.air_data.RawAirData",
    "uavcan.equipment.air_data.TrueAirspeed",
    "uavcan.equipment.air_data.IndicatedAirspeed",
    "uavcan.equipment.air_data.StaticPressure",
    "uavcan.equipment.air_data.StaticTemperature",
    "uavcan.equipment.ahrs.RawIMU",
    _SOLUTION,
    *_FIXES,
    "uavcan.equipment.actuator.Status",
)
"""What a rig usually names."""

_DERIVED: Final = ("roll", "pitch", "yaw")
_INSTANCE: Final = ("sensor_id", "actuator_id")
_HAS_POSITION: Final = 2
"""gnss.Fix status of a fix in two dimensions; less is none."""
_TRANSFER_IDS: Final = 32
_LONGEST_TRANSFER: Final = 64
"""Frames; the longest of the equipment messages has 25."""
_HEALTH: Final = ("OK", "WARNING", "ERROR", "CRITICAL")
_MODE: Final = {0: "operational", 1: "initialising", 2: "in maintenance", 3: "updating its software", 7: "offline"}


@lru_cache
def fields_of(message: str) -> tuple[str, ...]:
    """What a rig may name of a message (or MESSAGE:ID); none where there is no such message."""
    name, _, instance = message.partition(":")
    kind = dronecan.TYPENAMES.get(name)
    if kind is None or kind.kind != dsdl.CompoundType.KIND_MESSAGE or kind.default_dtid is None:
        return ()
    names: list[str] = []
    for part in kind.fields:
        if part.type.category == dsdl.Type.CATEGORY_PRIMITIVE:
            names.append(part.name)
        elif part.type.category == dsdl.Type.CATEGORY_ARRAY and _is_vector(part.type):
            names += (f"{part.name}[{i}]" for i in range(part.type.max_size))
    if instance and not (instance.isdecimal() and any(n in names for n in _INSTANCE)):
        return ()
    return (*names, *_DERIVED) if name == _SOLUTION else tuple(names)


def _is_vector(array: Any) -> bool:
    return bool(array.mode == dsdl.ArrayType.MODE_STATIC and array.value_type.category == dsdl.Type.CATEGORY_PRIMITIVE)


@dataclass(slots=True)
class _Assembly:
    """Frames of a transfer so far; none: what comes is passed over until the next one starts."""

    frames: list[Any] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Health:
    """What a node says of itself."""

    health: int
    mode: int
    uptime_s: int

    def words(self) -> str:
        return f"{_HEALTH[self.health]}, {_MODE.get(self.mode, f'mode {self.mode}')}"


class DronecanCodec(FrameCodec):
    """Frames to readings. Messages that the rig does not name, services and anonymous frames are passed over."""

    def __init__(self, device: DronecanDevice) -> None:
        """Of a device whose messages all have `fields_of`."""
        super().__init__()
        self.foreign: dict[str, int] = {}
        self._node = device.node_id
        self._wanted: dict[int, set[str]] = {}
        for message in (NODE_STATUS, *(str(stream.message) for stream in device.streams)):
            kind = dronecan.TYPENAMES[message.partition(":")[0]]
            self._wanted.setdefault(kind.default_dtid, set()).add(message)
        self._speakers: dict[int, int] = {}
        self._clock_node: int | None = None
        self._assemblies: dict[tuple[int, int], _Assembly] = {}
        self._healths: dict[int, _Health] = {}
        self._news: list[tuple[Code, str]] = []

    def reset(self) -> None:
        super().reset()
        self._assemblies.clear()

    def news(self) -> Sequence[tuple[Code, str]]:
        told, self._news = self._news, []
        return told

    def read_frame(self, frame_id: int, is_extended: bool, data: bytes) -> Sequence[Reading]:
        number, node = frame_id >> 8 & 0xFFFF, frame_id & 0x7F
        is_broadcast = is_extended and not frame_id & 0x80 and node
        if not is_broadcast or not data or number not in self._wanted:
            return ()
        frames = self._assembled(number, node, Frame(frame_id, data))
        if frames is None:
            return ()
        transfer = Transfer()
        try:
            transfer.from_frames(frames)
            values = _values(transfer.payload)
        except Exception:  # the library's decoder raises whatever its bit strings do
            self.bad += 1
            return ()
        if number == dronecan.TYPENAMES[NODE_STATUS].default_dtid:
            self._hear_status(node, values)
            return ()
        return self._readings(number, node, transfer, values)

    def _assembled(self, number: int, node: int, frame: Any) -> list[Any] | None:
        """All frames of a transfer with its last one. A lost frame is counted once, with the transfer's other ones."""
        own = self._assemblies.setdefault((number, node), _Assembly())
        if frame.start_of_transfer:
            self.bad += bool(own.frames)
            own.frames = [frame]
        elif not own.frames:
            return None
        else:
            last = own.frames[-1]
            is_next = (frame.bytes[-1] ^ last.bytes[-1]) & 0x3F == 0x20  # the same transfer, the other toggle
            if not is_next or len(own.frames) == _LONGEST_TRANSFER:
                self.bad += 1
                own.frames = []
                return None
            own.frames.append(frame)
        if not frame.end_of_transfer:
            return None
        whole, own.frames = own.frames, []
        return whole

    def _readings(self, number: int, node: int, transfer: Any, values: Mapping[str, float]) -> list[Reading]:
        if node != (self._node or self._speakers.setdefault(number, node)):
            self.foreign[f"node {node}"] = self.foreign.get(f"node {node}", 0) + 1
            return []
        name = _name(transfer)
        instance = next((values[n] for n in _INSTANCE if n in values), None)
        stamp_us = getattr(getattr(transfer.payload, "timestamp", None), "usec", 0)
        if stamp_us and self._clock_node is None:
            self._clock_node = node
        t_ns = stamp_us * 1000 if stamp_us and node == self._clock_node else None
        if name in _FIXES and values["status"] < _HAS_POSITION:
            values = {}
        readings = []
        for message in sorted(self._wanted[number]):
            _, _, wanted = message.partition(":")
            if not wanted or (instance is not None and int(wanted) == instance):
                # Sensors and actuators of one kind share a node's count of the transfers.
                seq = transfer.transfer_id if instance is None else None
                readings.append(Reading(message, t_ns, seq, dict(values), 0, 0 if seq is None else _TRANSFER_IDS))
        return readings

    def _hear_status(self, node: int, values: Mapping[str, float]) -> None:
        if self._node not in (None, node):
            return
        now = _Health(int(values["health"]), int(values["mode"]), int(values["uptime_sec"]))
        last = self._healths.get(node)
        self._healths[node] = now
        if last is not None and now.uptime_s < last.uptime_s:
            self._news.append((Code.HEARD, f"node {node} has restarted"))
        if (now.health, now.mode) != ((last.health, last.mode) if last else (0, 0)):
            is_well = (now.health, now.mode) == (0, 0)
            words = f"node {node} is {now.words()}"
            self._news.append((Code.FRESH, f"{Code.HEALTH} over: {words}") if is_well else (Code.HEALTH, words))


def _name(transfer: Any) -> str:
    return str(dronecan.get_dronecan_data_type(transfer.payload).full_name)


def _values(payload: Any) -> dict[str, float]:
    """A message's numbers by the names of `fields_of`."""
    kind = dronecan.get_dronecan_data_type(payload)
    values: dict[str, float] = {}
    for part in kind.fields:
        if part.type.category == dsdl.Type.CATEGORY_PRIMITIVE:
            values[part.name] = float(getattr(payload, part.name))
        elif part.type.category == dsdl.Type.CATEGORY_ARRAY and _is_vector(part.type):
            values |= {f"{part.name}[{i}]": float(v) for i, v in enumerate(getattr(payload, part.name))}
    if kind.full_name == _SOLUTION:
        x, y, z, w = (values[f"orientation_xyzw[{i}]"] for i in range(4))
        values |= dict(zip(_DERIVED, euler_angles(w, x, y, z), strict=True))
    return values


class DronecanEncoder:
    """An emulated node: readings to the slcan lines of their transfers, whose ids it counts for each message."""

    def __init__(self, node: int) -> None:
        self._node = node
        self._sent: dict[str, int] = {}

    def encode(self, reading: Reading) -> bytes:
        """What the reading lacks is no number, or 0 where the field has none."""
        name, _, instance = str(reading.message).partition(":")
        payload = dronecan.TYPENAMES[name]()
        given = dict(reading.fields)
        if name == _SOLUTION and not given.keys().isdisjoint(_DERIVED):
            w, x, y, z = quaternion(*(given.pop(angle, 0.0) for angle in _DERIVED))
            given |= {f"orientation_xyzw[{i}]": v for i, v in enumerate((x, y, z, w))}
        if name in _FIXES:
            given["status"] = 3 if all(map(math.isfinite, given.values())) else 0
        if instance:
            given |= {n: int(instance) for n in _INSTANCE if n in fields_of(name)}
        if name == NODE_STATUS:
            payload.uptime_sec = (reading.t_device_ns or 0) // 10**9 & 0xFFFF_FFFF
        if hasattr(payload, "timestamp"):
            payload.timestamp.usec = (reading.t_device_ns or 0) // 1000
        for part in dronecan.get_dronecan_data_type(payload).fields:
            if part.type.category == dsdl.Type.CATEGORY_ARRAY and _is_vector(part.type):
                for i in range(part.type.max_size):
                    getattr(payload, part.name)[i] = _fitting(part.type.value_type, given.get(f"{part.name}[{i}]"))
            elif part.name in given:
                setattr(payload, part.name, _fitting(part.type, given[part.name]))
        number = self._sent[name] = self._sent.get(name, -1) + 1
        transfer = Transfer(payload=payload, source_node_id=self._node, transfer_id=number % _TRANSFER_IDS)
        return b"".join(encode_slcan(f.message_id, True, bytes(f.bytes)) for f in transfer.to_frames())


def _fitting(kind: Any, value: float | None) -> float:
    """A value as a field of this kind takes it."""
    if kind.kind == dsdl.PrimitiveType.KIND_FLOAT:
        return math.nan if value is None else value
    low, high = kind.value_range
    return int(min(max(round(value), low), high)) if value is not None and math.isfinite(value) else 0

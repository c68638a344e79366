"""MAVLink devices: bytes to readings, and for emulated ones field values to bytes. No port, thread or clock."""

from __future__ import annotations

import ipaddress
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.codec import Codec, Reading, TimeReply
from drivers.mavlink_frame import SILENT_NS, Framer, Packer
from drivers.mavlink_messages import TABLE, build, message_id, plain_fields, title
from station.profile import MavlinkDevice
from station.rows import ProfileError

KEY_BYTES: Final = 32
MOST_FOREIGN: Final = 16
"""So many others on a link are told apart."""
STATION_SYSTEM: Final = 254
STATION_COMPONENT: Final = dialect.MAV_COMP_ID_MISSIONPLANNER
SECOND_NS: Final = 1_000_000_000
TIME_REQUEST_NS: Final = 250_000_000
STREAM_REQUEST_NS: Final = 5_000_000_000

_BOOT_WRAP_NS: Final = (1 << 32) * 1_000_000
"""When time_boot_ms starts over (49.7 days); all times of a device are taken within it, to be on one timeline."""
_SHORT_WRAP_NS: Final = (1 << 32) * 1_000
_UNIX_NS: Final = 10**18
"""A time beyond this (2001, counted from 1970) is no time since boot but of another clock."""


def read_signing_key(device: MavlinkDevice, rig_dir: Path) -> bytes | None:
    """The 32-byte key in the device's key file (its path relative to the rig's); None without. Raises ProfileError."""
    if device.signing_key_file is None:
        return None
    path = rig_dir / device.signing_key_file
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except OSError as error:
        raise ProfileError(f"signing_key_file: {path}: {error.strerror}") from error
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise ProfileError(f"signing_key_file: {path}: write the 32-byte key as 64 hexadecimal digits")
    return key


def requests(device: MavlinkDevice) -> str:
    """What the station sends on this link, in words."""
    sent = [f"TIMESYNC {SECOND_NS // TIME_REQUEST_NS} times a second and answers to it"] if device.timesync else []
    if device.request_streams:
        sent.append("SET_MESSAGE_INTERVAL for its streams, again each 5 s for those that do not come")
    return ", ".join(sent) or "nothing"


def belief(device: MavlinkDevice) -> str:
    """Why the vehicle may be anybody, and how to mend it; "" with a key, and where others do not reach the
    link."""
    kind, _, rest = device.url.partition(":")
    host = rest.rpartition(":")[0].strip("[]")
    if device.signing_key_file is not None or kind[:3] not in ("udp", "tcp") or _is_loopback(host):
        return ""
    return "unsigned: whoever sends the first heartbeat is believed; signing_key_file in the rig has it checked"


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class MavlinkCodec(Codec):
    """One vehicle's messages to readings; other systems and components on the link are passed over and counted.

    The vehicle is component `device.component_id` of system `device.system_id`, or else of the first system where that
    component sends a heartbeat and is no ground station; such a one is given up when it has been silent for SILENT_NS.
    MAVLink numbers the packets of a sender, not those of a message: readings have no `seq`, and `lost` counts what is
    missing from the link. `refused` counts packets (also in `bad`) with no, a wrong or an old signature. Sends nothing
    but what `device.timesync` and `device.request_streams` allow.
    """

    def __init__(self, device: MavlinkDevice, key: bytes | None = None, utc_ns: int = 0, station_ns: int = 0) -> None:
        """With `key`, packets not signed with it are refused and ours are signed; `utc_ns` is then the time at
        `station_ns`."""
        self.bad = 0
        self.resyncs = 0
        self.noise = 0
        self.refused = 0
        self.lost = 0
        self.foreign: dict[str, int] = {}
        self._refused_before = 0
        self._utc_less_station_ns = utc_ns - station_ns
        self._device = device
        self._framer = Framer(key, utc_ns)
        self._packer = Packer(STATION_SYSTEM, STATION_COMPONENT, key, utc_ns)
        self._rates = {str(s.message): s.rate for s in device.streams if str(s.message).partition(":")[0] in TABLE}
        self._asked: deque[int] = deque(maxlen=16)
        self._questions: deque[int] = deque(maxlen=4)
        self.reset()

    def reset(self) -> None:
        self._framer.reset()
        self._vehicle: tuple[int, int] | None = None
        self._is_heard = False
        self._heard_ns = 0
        self._boot_ns: int | None = None
        self._heard: set[str] = set()
        self._asked.clear()
        self._questions.clear()
        self._next_time_request_ns: int | None = None
        self._next_stream_request_ns: int | None = None

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        readings: list[Reading | TimeReply] = []
        for message in self._framer.feed(data):
            if not self._is_ours(message):
                continue
            self._is_heard = True
            if message.get_type() in TABLE:
                readings.append(self._reading(message))
            elif message.get_type() == "TIMESYNC" and self._device.timesync:
                readings += self._time_message(message.tc1, message.ts1)
        self.bad, self.resyncs = self._framer.bad + self._refused_before, self._framer.resyncs
        self.noise = self._framer.noise
        self.refused, self.lost = self._framer.refused + self._refused_before, self._framer.lost
        return readings

    def vouches_for(self, datagram: bytes) -> bool:
        """Whether the vehicle's heartbeat is in it; unsigned and wrongly signed ones are counted as refused."""
        messages, refused = self._framer.look_at(datagram)
        self._refused_before += refused
        self.refused += refused
        self.bad += refused
        wanted = [m for m in messages if _is_heartbeat(m) and self._may_be(_sender(m))]
        return any(self._vehicle in (None, _sender(m)) for m in wanted)

    def pass_over(self, who: str) -> None:
        """Count a message of somebody who is not the vehicle."""
        if who not in self.foreign and len(self.foreign) >= MOST_FOREIGN:
            who = "more others"
        self.foreign[who] = self.foreign.get(who, 0) + 1

    def outgoing(self, now_ns: int) -> bytes:
        """Time requests and answers, and stream requests, to a vehicle that is heard, as far as the rig allows them.

        Where the rig has the station call, a time request goes to the address that it names before anything is heard.
        """
        self._look_after_vehicle(now_ns)
        if self._vehicle is None and not self._device.url.startswith("udpout:"):
            return b""
        utc_ns = now_ns + self._utc_less_station_ns
        packets = []
        if self._device.timesync:
            answers = [dialect.MAVLink_timesync_message(now_ns, ts1) for ts1 in self._questions]
            packets += [self._packer.pack(answer, utc_ns) for answer in answers]
            self._questions.clear()
            if self._next_time_request_ns is None or now_ns >= self._next_time_request_ns:
                self._next_time_request_ns = now_ns + TIME_REQUEST_NS
                self._asked.append(now_ns)
                packets.append(self._packer.pack(dialect.MAVLink_timesync_message(0, now_ns), utc_ns))
        if (
            self._device.request_streams
            and self._vehicle is not None
            and (self._next_stream_request_ns is None or now_ns >= self._next_stream_request_ns)
        ):
            first = self._next_stream_request_ns is None
            self._next_stream_request_ns = now_ns + STREAM_REQUEST_NS
            missing = {m: rate for m, rate in self._rates.items() if first or m not in self._heard}
            packets += [self._packer.pack(_interval(self._vehicle, m, rate), utc_ns) for m, rate in missing.items()]
            self._heard.clear()
        return b"".join(packets)

    def _look_after_vehicle(self, now_ns: int) -> None:
        """A vehicle that the rig does not name is given up when it has gone; another may then be the one."""
        if self._is_heard:
            self._is_heard, self._heard_ns = False, now_ns
        elif self._device.system_id is None and now_ns - self._heard_ns > SILENT_NS:
            self._vehicle = None

    def _is_ours(self, message: Any) -> bool:
        sender = _sender(message)
        if self._vehicle is None and self._may_be(sender) and (self._device.system_id or _is_heartbeat(message)):
            doubt = belief(self._device)
            self._vehicle, self.speaker = sender, _words(sender) + (f" ({doubt})" if doubt else "")
        if sender == self._vehicle:
            return True
        # What comes before a vehicle's first heartbeat is nobody's yet; our own packets may be echoed.
        if (self._vehicle or not self._may_be(sender)) and sender != (STATION_SYSTEM, STATION_COMPONENT):
            self.pass_over(_words(sender))
        return False

    def _may_be(self, sender: tuple[int, int]) -> bool:
        """Whether the rig does not exclude that these are the vehicle's system and component."""
        return self._device.system_id in (None, sender[0]) and sender[1] == self._device.component_id

    def _reading(self, message: Any) -> Reading:
        name = title(message)
        self._heard.add(name)
        layout = TABLE[message.get_type()]
        fields = plain_fields(message)
        if layout.time is None:
            return Reading(name, None, None, fields)
        unit_ns = 1_000_000 if layout.time == "time_boot_ms" else 1_000
        t_ns = getattr(message, layout.time) * unit_ns
        if t_ns >= _UNIX_NS:
            return Reading(name, None, None, fields)
        if layout.short_time and t_ns < _SHORT_WRAP_NS:
            if self._boot_ns is None:
                return Reading(name, t_ns, None, fields, _SHORT_WRAP_NS)
            t_ns += (self._boot_ns - t_ns + _SHORT_WRAP_NS // 2) // _SHORT_WRAP_NS * _SHORT_WRAP_NS
        t_ns %= _BOOT_WRAP_NS
        if not layout.short_time:
            self._boot_ns = t_ns
        return Reading(name, t_ns, None, fields, _BOOT_WRAP_NS)

    def _time_message(self, tc1: int, ts1: int) -> list[TimeReply]:
        if tc1 == 0:
            self._questions.append(ts1)
        elif ts1 in self._asked and 0 < tc1 < _UNIX_NS:
            self._asked.remove(ts1)
            return [TimeReply(ts1, tc1 % _BOOT_WRAP_NS)]
        return []


def _sender(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _words(sender: tuple[int, int]) -> str:
    return f"system {sender[0]}, component {sender[1]}"


def _is_heartbeat(message: Any) -> bool:
    """Of a vehicle or a component, and not of a ground station."""
    return bool(message.get_type() == "HEARTBEAT" and message.type != dialect.MAV_TYPE_GCS)


def _interval(vehicle: tuple[int, int], message: str, rate: float) -> Any:
    """Asks a vehicle to send a message so many times a second."""
    number, period_us = message_id(message), 1e6 / rate
    return dialect.MAVLink_command_long_message(
        *vehicle, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, period_us, *(0.0,) * 5
    )


class MavlinkEncoder:
    """An emulated autopilot: plain field values to packets, and the answers a ground station expects of one."""

    def __init__(self, system_id: int = 1, component_id: int = 1, key: bytes | None = None, utc_ns: int = 0) -> None:
        """With `key`, packets are signed and unsigned ones not heard; `utc_ns` is then the time now."""
        self._packer = Packer(system_id, component_id, key, utc_ns)
        self._framer = Framer(key, utc_ns)
        self._address = (system_id, component_id)
        self._parameters = {"SYSID_THISMAV": float(system_id), "STATION_EMULATED": 1.0}

    def encode(self, message: str, fields: Mapping[str, float], t_device_ns: int) -> bytes:
        """A packet of a message in the table (MESSAGE or MESSAGE:INSTANCE), fields in its plain units.

        Left out: unknown where the definitions can say so, otherwise 0 or a usual value; NaN: not known. Raises
        KeyError for names that the table does not have.
        """
        return self._packer.pack(build(message, fields, t_device_ns))

    def heartbeat(self) -> bytes:
        return self.encode("HEARTBEAT", {}, 0)

    def answer(self, data: bytes, t_device_ns: int) -> bytes:
        """What the autopilot says to bytes from the station: time, parameters, acknowledgements. Never raises."""
        return b"".join(
            self._packer.pack(reply)
            for message in self._framer.feed(data)
            for reply in self._replies(message, t_device_ns)
        )

    def _replies(self, message: Any, t_device_ns: int) -> list[Any]:
        kind = message.get_type()
        if kind == "TIMESYNC" and message.tc1 == 0:
            return [dialect.MAVLink_timesync_message(t_device_ns, message.ts1)]
        if getattr(message, "target_system", 0) not in (0, self._address[0]):
            return []
        if kind == "PARAM_REQUEST_LIST":
            return [self._parameter(name) for name in self._parameters]
        if kind == "PARAM_REQUEST_READ":
            names = list(self._parameters)
            name = names[message.param_index] if 0 <= message.param_index < len(names) else message.param_id
            return [self._parameter(name)] if name in self._parameters else []
        if kind == "COMMAND_LONG":
            known = message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL
            result = dialect.MAV_RESULT_ACCEPTED if known else dialect.MAV_RESULT_UNSUPPORTED
            return [dialect.MAVLink_command_ack_message(message.command, result)]
        return []

    def _parameter(self, name: str) -> Any:
        names = list(self._parameters)
        return dialect.MAVLink_param_value_message(
            name.encode("ascii"),
            self._parameters[name],
            dialect.MAV_PARAM_TYPE_REAL32,
            len(names),
            names.index(name),
        )

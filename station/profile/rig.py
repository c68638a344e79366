"""What is plugged in where, and how a field on the wire becomes a signal."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from station.conventions import SIGNALS, TICK_HZ, UNIT_ALIASES, UNITS, Stream, to_si, unit_named
from station.profile.quantity import Frozen, Hertz, Metres, Positive, Seconds, nearest


class Channel(Frozen):
    """How a field on the wire becomes a signal: unit-value = slope (field - zero), or a table of (field, value)."""

    field: str
    """The field's name in the message."""
    unit: str
    """Of the value that slope and zero, or the table, give: any unit that fits the signal."""
    slope: float = 1.0
    """Units per count of the field."""
    zero: float = 0.0
    """The field's count where the value is 0."""
    table: tuple[tuple[float, float], ...] | None = None
    """Points (field, value) in place of slope and zero; linear between them and beyond its ends."""
    noise: float = Field(default=0.0, ge=0)
    """Standard deviation, in `unit`: what the emulated device adds and what the estimator expects."""
    drift: float = Field(default=0.0, ge=0)
    """How far the emulated device's zero wanders in a minute (standard deviation of a random walk), in `unit`."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("table"), list):
            raw = {**raw, "table": tuple(tuple(float(x) for x in row) for row in raw["table"])}
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if unit_named(self.unit) is None:
            raise PydanticCustomError(
                "unit",
                "unknown unit {unit}{near}",
                {"unit": repr(self.unit), "near": nearest(self.unit, tuple(UNITS))},
            )
        if self.slope == 0:
            raise PydanticCustomError("slope", "slope must not be 0")
        if self.table is not None:
            x = [row[0] for row in self.table]
            if len(x) < 2 or any(b <= a for a, b in itertools.pairwise(x)):
                raise PydanticCustomError("table", "table needs at least 2 points with the field's value increasing")
        return self

    def to_si(self, raw: float) -> float:
        """The signal's value in SI; beyond a table's ends its last slope goes on."""
        value = self.slope * (raw - self.zero) if self.table is None else _interpolate(self.table, raw)
        return to_si(value, self.unit)

    def from_si(self, value: float) -> float:
        """The field's value for a signal's value in SI (the inverse of to_si), before rounding to the wire."""
        u = UNITS[UNIT_ALIASES.get(self.unit, self.unit)]
        physical = (value - u.offset) / u.factor
        if self.table is None:
            return physical / self.slope + self.zero
        inverse = sorted((y, x) for x, y in self.table)
        return _interpolate(tuple(inverse), physical)

    def noise_si(self) -> float:
        """The noise's standard deviation in SI."""
        return self.noise * UNITS[UNIT_ALIASES.get(self.unit, self.unit)].factor

    def drift_si(self) -> float:
        """The random walk's standard deviation after a second, SI."""
        return self.drift * UNITS[UNIT_ALIASES.get(self.unit, self.unit)].factor / math.sqrt(60.0)


def _interpolate(table: tuple[tuple[float, float], ...], x: float) -> float:
    i = 1
    while i < len(table) - 1 and x > table[i][0]:
        i += 1
    (x0, y0), (x1, y1) = table[i - 1], table[i]
    return y0 + (x - x0) * (y1 - y0) / (x1 - x0)


class StreamProfile(Frozen):
    """One message of a device and the signals in it."""

    name: str
    """What the recording calls it, after the device's name."""
    message: str | int
    """Which message of the protocol: a number, or a name such as "NAV-PVT" or a DBC message."""
    rate: Annotated[Hertz, Positive]
    """How often it comes; after 2.2 periods without one (0.2 s at least, 3 s at most) it is stale."""
    latency: Seconds = 0.0
    """How old the values are when the message is stamped by the device (or arrives, if it carries no time)."""
    stamp_resolution: Seconds = 0.0
    """The step in which the device counts its time."""
    dropout: float = Field(default=0.0, ge=0, le=0.9)
    """Share of its messages that the emulated device loses."""
    dropout_length: Seconds = Field(default=0.0, ge=0)
    """Mean length of a gap; 0: each message is lost or not by itself."""
    signals: dict[str, Channel]
    """Which field becomes which signal."""

    @model_validator(mode="after")
    def _known_signals(self) -> Self:
        for name, channel in self.signals.items():
            signal = SIGNALS.get(name)
            if signal is None:
                raise PydanticCustomError(
                    "signal", "unknown signal {name}{near}", {"name": name, "near": nearest(name, tuple(SIGNALS))}
                )
            unit = unit_named(channel.unit)
            if unit is None or unit.si != signal.unit:
                raise PydanticCustomError(
                    "unit",
                    "signal {name} is in {si}: unit {unit} does not fit",
                    {"name": name, "si": signal.unit, "unit": repr(channel.unit)},
                )
        return self


class _Device(Frozen):
    name: str
    """What events and the screen call it."""
    streams: tuple[StreamProfile, ...] = Field(min_length=1)
    """Its messages."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("streams"), list):
            raw = {**raw, "streams": tuple(raw["streams"])}
        return raw


class SerialDevice(_Device):
    """A serial port, whose bytes one of the protocols of the drivers reads."""

    link: Literal["serial"]
    """The kind of link."""
    protocol: str
    """boombox, boombox_ascii, ubx, nmea, or one that an installed package adds (drivers/README.md)."""
    port: str
    """A port's path, "usb:SERIAL" for the USB adapter with that serial number under whatever path, or "emulated"."""
    baud: int | None = Field(default=None, gt=0)
    """The protocol's usual one if left out."""


class CanDevice(_Device):
    """A CAN bus through any of python-can's interfaces, its messages from a DBC file beside the rig."""

    link: Literal["can"]
    """The kind of link."""
    interface: str = "slcan"
    """One of python-can's interfaces: slcan, socketcan, pcan, ..."""
    channel: str
    """What python-can's interface calls its channel (for slcan a port's path or "usb:SERIAL"), or "emulated"."""
    bitrate: int = Field(default=1_000_000, gt=0)
    """Bits per second of the bus."""
    listen_only: bool = True
    """Whether frames are not acknowledged nor errors flagged, so that a wrong bit rate disturbs nobody; false where the
    station is the only other node of the bus, or the adapter cannot listen only."""
    dbc: str
    """The DBC file that describes its messages."""


class MavlinkDevice(_Device):
    """An autopilot or other MAVLink source. Receive-only but for what `timesync` and `request_streams` allow."""

    link: Literal["mavlink"]
    """The kind of link."""
    url: str
    """pymavlink's connection string (udpin:HOST:PORT, tcp:HOST:PORT, a serial path or usb:SERIAL), or "emulated"."""
    baud: int = Field(default=115_200, gt=0)
    """Bits per second, of a serial link."""
    system_id: int | None = Field(default=None, ge=1, le=255)
    """Only messages of this system; of the first whose component sends a heartbeat if left out."""
    component_id: int = Field(default=1, ge=1, le=255)
    """Only messages of this component of it; 1 is the autopilot."""
    timesync: bool = False
    """Whether the station may send TIMESYNC, to measure the clocks' offset."""
    request_streams: bool = False
    """Whether the station may ask for messages at their rates."""
    signing_key_file: str | None = None
    """File with the 32-byte key in hexadecimal; with it, unsigned and wrongly signed packets are refused."""


Device = Annotated[SerialDevice | CanDevice | MavlinkDevice, Field(discriminator="link")]


class Rig(Frozen):
    name: str
    """What a card calls it."""
    description: str = ""
    """One sentence."""
    imu_position: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """IMU from the CG, body axes (forward, right, down)."""
    devices: tuple[Device, ...] = Field(min_length=1)
    """What is plugged in."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict):
            raw = {
                k: tuple(v) if k in ("devices", "imu_position") and isinstance(v, list) else v for k, v in raw.items()
            }
        return raw

    @model_validator(mode="after")
    def _one_source_per_signal(self) -> Self:
        seen: dict[str, str] = {}
        names: set[str] = set()
        for device in self.devices:
            if device.name in names:
                raise PydanticCustomError("device", "two devices are named {name}", {"name": device.name})
            names.add(device.name)
            for stream in device.streams:
                for signal in stream.signals:
                    other = seen.setdefault(signal, f"{device.name}.{stream.name}")
                    if other != f"{device.name}.{stream.name}":
                        raise PydanticCustomError(
                            "claimed",
                            "signal {signal} is claimed by {one} and by {two}: take it out of one of them",
                            {"signal": signal, "one": other, "two": f"{device.name}.{stream.name}"},
                        )
        return self

    def streams(self) -> Iterator[Stream]:
        """Every stream, named device.stream."""
        for device in self.devices:
            for s in device.streams:
                yield Stream(
                    name=f"{device.name}.{s.name}",
                    signals=tuple(s.signals),
                    rate_hz=s.rate,
                    stale_after_s=min(max(0.2, 2.2 / s.rate), 3.0),
                    device=device.name,
                    latency_s=s.latency,
                    stamp_resolution_s=s.stamp_resolution,
                )

    def without_noise(self) -> Rig:
        """The same rig with every signal's noise unstated."""
        devices = []
        for device in self.devices:
            streams = []
            for s in device.streams:
                silent = {n: c.model_copy(update={"noise": 0.0}) for n, c in s.signals.items()}
                streams.append(s.model_copy(update={"signals": silent}))
            devices.append(device.model_copy(update={"streams": tuple(streams)}))
        return self.model_copy(update={"devices": tuple(devices)})

    def noise_si(self) -> dict[str, float]:
        """Standard deviation of each signal's noise in one sample, SI."""
        return {n: c.noise_si() for d in self.devices for s in d.streams for n, c in s.signals.items()}

    def frame_noise_si(self) -> dict[str, float]:
        """Standard deviation of each signal's noise in a 50 Hz frame, SI: a faster stream's samples are averaged."""
        return {
            n: c.noise_si() / math.sqrt(max(1.0, s.rate / TICK_HZ))
            for d in self.devices
            for s in d.streams
            for n, c in s.signals.items()
        }

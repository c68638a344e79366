"""What is plugged in where."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Annotated, Any, Final, Literal, NoReturn, Self

from pydantic import Field, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

from station.conventions import SIGNALS, SURFACES, TICK_HZ, Stream, unit_named
from station.profile.channel import Channel
from station.profile.declared import DeclaredSignal, DerivedSignal, Further, faults, further
from station.profile.probe import PROBE, Probe, wrong_fields
from station.profile.quantity import Frozen, Hertz, Metres, Positive, Seconds, nearest
from station.profile.rig_loop import Loop, MeasuredLoop


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
    probe: Probe | None = None
    """Pressures of which flow angles are made."""

    @model_validator(mode="after")
    def _probed(self) -> Self:
        if (wrong := wrong_fields(self.signals, self.probe)) is not None:
            raise PydanticCustomError("probe", "{words}", {"words": wrong})
        return self

    def on_the_wire(self) -> Self:
        """As its codec sees it: the ports in place of what the probe makes of them."""
        if self.probe is None:
            return self
        ports = {f"{PROBE}ports.{port}": channel for port, channel in self.probe.ports.items()}
        kept = {n: c for n, c in self.signals.items() if not c.field.startswith(PROBE)}
        return self.model_copy(update={"signals": {**kept, **ports}})


EMULATED: Final = "emulated"
"""In place of a port, channel or url."""


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

    @model_validator(mode="after")
    def _one_probe_per_message(self) -> Self:
        probed = [s.message for s in self.streams if s.probe is not None]
        if twice := [m for m in probed if probed.count(m) > 1]:
            words = "two streams of message {message} have a probe: one of them is enough"
            raise PydanticCustomError("probe", words, {"message": repr(twice[0])})
        return self

    def on_the_wire(self) -> Self:
        """As its codec sees it."""
        return self.model_copy(update={"streams": tuple(s.on_the_wire() for s in self.streams)})


class SerialDevice(_Device):
    """A serial port, whose bytes one of the protocols of the drivers reads."""

    link: Literal["serial"]
    """The kind of link."""
    protocol: str
    """boombox, boombox_ascii, ubx, nmea, vectornav, lines, msp, or one of an installed package (drivers/README.md)."""
    port: str
    """A port's path, "usb:SERIAL" for the USB adapter with that serial number under whatever path, or "emulated"."""
    baud: int | None = Field(default=None, gt=0)
    """The protocol's usual one if left out."""

    @property
    def address(self) -> str:
        return self.port


class CanBus(_Device):
    """A CAN bus through any of python-can's interfaces."""

    interface: str = "slcan"
    """One of python-can's interfaces: slcan, socketcan, pcan, ..."""
    channel: str
    """What python-can's interface calls its channel (for slcan a port's path or "usb:SERIAL"), or "emulated"."""
    bitrate: int = Field(default=1_000_000, gt=0)
    """Bits per second of the bus."""
    listen_only: bool = True
    """Whether frames are not acknowledged nor errors flagged, so that a wrong bit rate disturbs nobody; false where the
    station is the only other node of the bus, or the adapter cannot listen only."""

    @property
    def address(self) -> str:
        return self.channel


class CanDevice(CanBus):
    """A CAN bus whose messages a DBC file beside the rig describes."""

    link: Literal["can"]
    """The kind of link."""
    dbc: str
    """The DBC file that describes its messages."""


class DronecanDevice(CanBus):
    """The nodes of a DroneCAN bus, which the station only listens to: it has no node id."""

    link: Literal["dronecan"]
    """The kind of link."""
    node_id: int | None = Field(default=None, ge=1, le=127)
    """Only messages of this node; of the first that sends each message if left out."""


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

    @property
    def address(self) -> str:
        return self.url


Device = Annotated[SerialDevice | CanDevice | DronecanDevice | MavlinkDevice, Field(discriminator="link")]


def _refuse(key: tuple[str | int, ...], words: str) -> NoReturn:
    """An error at a key below the one that is validated."""
    why = PydanticCustomError("signal", "{words}", {"words": words})
    raise ValidationError.from_exception_data("Rig", [InitErrorDetails(type=why, loc=key, input=None)])


class Rig(Frozen):
    name: str
    """What a card calls it."""
    description: str = ""
    """One sentence."""
    imu_position: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """IMU from the CG, body axes (forward, right, down)."""
    signals: dict[str, DeclaredSignal] = Field(default_factory=dict)
    """What else its devices measure."""
    derived: dict[str, DerivedSignal] = Field(default_factory=dict)
    """What is made of signals by expressions."""
    devices: tuple[Device, ...] = Field(min_length=1)
    """What is plugged in."""
    loop: Loop | None = None
    """Who moves the surfaces of the simulated aircraft."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict):
            raw = {
                k: tuple(v) if k in ("devices", "imu_position") and isinstance(v, list) else v for k, v in raw.items()
            }
        return raw

    @model_validator(mode="after")
    def _known_signals(self) -> Self:
        units = {n: s.unit for n, s in SIGNALS.items()} | {n: d.si for n, d in self.signals.items() if n not in SIGNALS}
        for i, device in enumerate(self.devices):
            for j, stream in enumerate(device.streams):
                place = ("devices", i, "streams", j, "signals")
                for name, channel in stream.signals.items():
                    if name not in units:
                        declare = f"; or declare it: [signals.{name}] with its unit"
                        _refuse((*place, name), f"unknown signal {name}{nearest(name, units)}{declare}")
                    unit = unit_named(channel.unit)
                    if unit is None or unit.si != units[name]:
                        _refuse(
                            (*place, name), f"signal {name} is in {units[name]}: unit {channel.unit!r} does not fit"
                        )
        given = (n for d in self.devices for s in d.streams for n in s.signals)
        if (wrong := faults(self.signals, self.derived, given)) is not None:
            _refuse(*wrong)
        return self

    @cached_property
    def further(self) -> Further:
        """The signals that it declares beyond the station's."""
        return further(self.signals, self.derived)

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

    @model_validator(mode="after")
    def _has_surfaces(self) -> Self:
        if isinstance(self.loop, MeasuredLoop) and not self.measured_surfaces:
            raise PydanticCustomError(
                "loop", "loop: no device that is not emulated gives elevator, aileron or rudder: nothing moves them"
            )
        return self

    @property
    def measured_surfaces(self) -> dict[str, tuple[str, ...]]:
        """The surfaces that a hand moves in the loop, by stream, each in the stream's order; none without a loop."""
        found: dict[str, tuple[str, ...]] = {}
        for device in self.devices if isinstance(self.loop, MeasuredLoop) else ():
            for s in device.streams if device.address != EMULATED else ():
                if own := tuple(n for n in s.signals if n in SURFACES):
                    found[f"{device.name}.{s.name}"] = own
        return found

    def streams(self) -> Iterator[Stream]:
        """Every stream, named device.stream. What a surface in the loop is flown late by is in its latency."""
        measured = self.measured_surfaces
        for device in self.devices:
            for s in device.streams:
                late = self.loop.delay_s(s.rate) if self.loop and f"{device.name}.{s.name}" in measured else 0.0
                yield Stream(
                    name=f"{device.name}.{s.name}",
                    signals=tuple(s.signals),
                    rate_hz=s.rate,
                    stale_after_s=min(max(0.2, 2.2 / s.rate), 3.0),
                    device=device.name,
                    latency_s=s.latency - late,
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

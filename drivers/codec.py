"""What a codec is handed and what it returns: bytes in, readings out, no port, thread or clock.

A codec is pure: the same bytes give the same readings however they are cut. It never raises; what cannot be read is
counted. The port it is fed from belongs to the adapter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import msgspec

from station.rows import Code


class Reading(msgspec.Struct, frozen=True, gc=False):
    """One message of a device, values in the units of the wire: NaN for none, infinite beyond what it can carry.

    `message` is what the rig calls it. `t_device_ns` is the device's own time; where it is counted in a field that
    wraps, it is the bare count and `wrap_ns` its period: the adapter unwraps it with the arrival time at hand, for one
    timeline per device and period, which also survives a silence longer than the period. `seq` and `seq_wrap` are the
    message's own counter likewise (None where the link counts no message by itself).
    """

    message: str | int
    t_device_ns: int | None
    seq: int | None
    fields: dict[str, float]
    wrap_ns: int = 0
    seq_wrap: int = 0


@dataclass(frozen=True, slots=True)
class TimeReply:
    """A device's answer to a time request: the station time the request carried, the device's time when it answered.

    The adapter, which knows when it arrived, makes a TimeSync row of it.
    """

    sent_ns: int
    device_ns: int


class Codec(Protocol):
    """Bytes to readings. Inherit it for the defaults of what a listening device needs not do."""

    bad: int
    """Messages refused: checksum, length, signature, nonsense inside."""
    resyncs: int
    """Times bytes were skipped to find the start of a message."""
    noise: int = 0
    """Bytes that belong to no sound message."""
    lost: int = 0
    """Messages missing by a counter that all messages of the link share; one of a message's own is `Reading.seq`."""

    refused: int = 0
    """Of the bad ones, those without the signature that the rig asks for."""
    speaker: str = ""
    """Whose messages are taken, where a link can have several."""
    foreign: Mapping[str, int] = MappingProxyType({})
    """Messages of others on the link, who are not the device, by who they are."""

    def feed(self, data: bytes) -> list[Reading | TimeReply]:
        """Take bytes, cut anywhere; return what is complete. Half a message waits. Never raises."""
        ...

    def reset(self) -> None:
        """The link was lost and is back: forget half a message. Counters go on."""
        ...

    def outgoing(self, now_ns: int) -> bytes:  # noqa: ARG002 - most devices are only listened to
        """What to send now (time and stream requests), empty for nothing. Asked about 25 times a second or more."""
        return b""

    def news(self) -> Sequence[tuple[Code, str]]:
        """What the device has said of itself since it was asked last: its health, a restart."""
        return ()


class Port(Protocol):
    """An open link. Every method raises OSError when the link is gone."""

    def read(self, timeout_s: float) -> bytes:
        """What has arrived: returns as soon as there is something, empty after the timeout."""
        ...

    def write(self, data: bytes) -> None: ...

    def close(self) -> None:
        """Never raises; may be called twice."""
        ...

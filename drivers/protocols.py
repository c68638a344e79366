"""What serial devices speak: a row for each protocol, and how a rig's word for it finds its row.

A protocol is a codec, the fields that a rig may name, and the encoder with which its devices are emulated. Packages
add their own through the entry point group `station.drivers`: README.md shows how.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Final

from drivers.codec import Codec, Reading
from station.profile import nearest
from station.rows import ProfileError

GROUP: Final = "station.drivers"


@dataclass(frozen=True, slots=True)
class Protocol:
    """One row. Its name is its key in PROTOCOLS, or that of the entry point."""

    sentence: str
    """What is on the wire, in a few words."""
    codec: Callable[[], Codec]
    """A new codec for each device."""
    fields: Mapping[str | int, Sequence[str]]
    """Message -> the fields of its readings that a rig may name."""
    encode: Callable[[Reading], bytes]
    """The codec's inverse, for emulated devices: a NaN field is no reading; what the rig does not map is not there."""
    baud: int = 115_200
    """Where the rig gives none."""
    messages: str = ""
    """What a rig may write as message, in words; the names in `fields` if left out."""

    def named_messages(self) -> str:
        """What a rig may write as message."""
        return self.messages or f"one of {', '.join(map(str, self.fields))}"


PROTOCOLS: Final[Mapping[str, str]] = {
    "boombox": "drivers.serial_boombox:BOOMBOX",
    "boombox_ascii": "drivers.serial_boombox:BOOMBOX_ASCII",
    "ubx": "drivers.serial_gnss:UBX",
    "nmea": "drivers.serial_gnss:NMEA",
    "lines": "drivers.serial_lines:LINES",
    "vectornav": "drivers.serial_vectornav:VECTORNAV",
    "msp": "drivers.serial_msp:MSP",
}
"""The station's own: name in a rig -> its row, written as entry points are. It is loaded with its libraries, some of
which take long, only where a rig names it."""


def protocol_named(name: str) -> Protocol:
    """The row of a protocol. Raises ProfileError for an unknown one, naming those known, and for one of another package
    that cannot be loaded."""
    if name in PROTOCOLS:
        return _load(EntryPoint(name, PROTOCOLS[name], GROUP))
    others = {point.name: point for point in entry_points(group=GROUP)}
    if name in others:
        return _load(others[name])
    known = (*PROTOCOLS, *sorted(others.keys() - PROTOCOLS.keys()))
    raise ProfileError(f"protocol: unknown protocol {name}{nearest(name, known)}\nknown: {', '.join(known)}")


def _load(point: EntryPoint) -> Protocol:
    try:
        row = point.load()
    except Exception as error:  # a package may fail in any way
        raise ProfileError(f"protocol: {point.name}: {point.value} cannot be loaded: {error}") from error
    if not isinstance(row, Protocol):
        raise ProfileError(f"protocol: {point.name}: {point.value} is no drivers.protocols.Protocol")
    return row

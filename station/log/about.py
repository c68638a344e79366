"""What a recording says of itself at the start of each of its files: profiles, streams, version, UTC anchor."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import Final

from station.conventions import CLOCK_LAW, Signal, Stream
from station.log.arithmetic import arithmetic
from station.log.counts import NAME, Counts, counted
from station.log.scan import CRC, PartReader, seal
from station.profile import NOTHING, Aircraft, Card, Further, Rig, elsewhere, from_json, to_json
from station.rows import LogError, ProfileError

_MEND: Final = "\nsay what flew, and the rows it has are saved: station recover --aircraft NAME"


@dataclass(frozen=True, slots=True)
class About:
    """What a recording is of, kept at the start of each of its files."""

    aircraft: Aircraft
    streams: tuple[Stream, ...]
    rig: Rig | None = None
    card: Card | None = None
    source: str = "flight"
    """flight, simulation, or the kind of file it was imported from."""
    imported: bool = False
    notes: Mapping[str, str] = field(default_factory=dict)
    """Anything else worth keeping: the imported file's name, a simulation's settings."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Attached as they are: the rig's DBC files."""
    clock_law: int = CLOCK_LAW
    arithmetic: Mapping[str, str] = field(default_factory=arithmetic)
    """The machine whose estimates are recorded; empty where the recording does not say."""

    @property
    def further(self) -> Further:
        """The signals that the rig declares beyond the station's."""
        return self.rig.further if self.rig is not None else NOTHING

    @property
    def on_boom(self) -> Mapping[str, tuple[float, float, float]]:
        """Where the declared signals are that measure az elsewhere than the IMU, m from the CG, body axes."""
        return elsewhere(self.rig.signals, "az") if self.rig is not None else {}

    @property
    def vanes(self) -> Mapping[str, tuple[float, float, float]]:
        """Likewise of those that measure alpha_vane: further vanes."""
        return elsewhere(self.rig.signals, "alpha_vane") if self.rig is not None else {}

    @property
    def signals(self) -> Mapping[str, Signal]:
        """Every signal of a frame, in its order."""
        return self.further.signals

    @property
    def imu_position(self) -> tuple[float, float, float]:
        """Of the rig's IMU from the CG, body axes, m; at the CG where no rig says."""
        return self.rig.imu_position if self.rig is not None else (0.0, 0.0, 0.0)

    def noise_si(self, aligned: bool) -> dict[str, float] | None:
        """Standard deviation by signal, SI, as the rig states it; None without a rig. In `aligned` frames the samples
        of a stream faster than them are averaged, which leaves less of it."""
        if self.rig is None:
            return None
        return self.rig.frame_noise_si() if aligned else self.rig.noise_si()


@dataclass(frozen=True, slots=True)
class LogInfo:
    """What a recording says of itself."""

    about: About
    software: str
    flight: str
    part: int
    station_ns: int
    """Station time and UTC (ns since 1970) of the same instant."""
    utc_ns: int

    @property
    def aircraft(self) -> Aircraft:
        return self.about.aircraft

    @property
    def streams(self) -> tuple[Stream, ...]:
        return self.about.streams


def preamble(
    about: About, flight: str, part: int, station_ns: int, utc_ns: int
) -> tuple[dict[str, dict[str, str]], dict[str, bytes]]:
    """Metadata and attachments for the start of a file; `info_of` reads them back."""
    metadata = {
        "station": {
            "software": version("flight-test-station"),
            "flight": flight,
            "part": str(part),
            "source": about.source,
            "imported": "yes" if about.imported else "no",
            "streams": json.dumps([asdict(s) for s in about.streams]),
        },
        "clock": {"station_ns": str(station_ns), "utc_ns": str(utc_ns), "law": str(about.clock_law)},
        "arithmetic": dict(about.arithmetic),
        "notes": dict(about.notes),
    }
    attachments = {"aircraft.json": to_json(about.aircraft).encode()}
    if about.rig is not None:
        attachments["rig.json"] = to_json(about.rig).encode()
    if about.card is not None:
        attachments["card.json"] = to_json(about.card).encode()
    attachments.update({f"files/{name}": data for name, data in about.files.items()})
    return {name: {**found, CRC: seal(found)} for name, found in metadata.items()}, attachments


def closing(counts: Counts) -> dict[str, dict[str, str]]:
    """Metadata for the end of a file: what it holds; `counts_of` reads it back."""
    found = counts.as_metadata()
    return {NAME: {**found, CRC: seal(found)}}


def counts_of(reader: PartReader) -> Counts | None:
    """What a sound file says that it holds; None where it says nothing."""
    found = reader.metadata_at_end(NAME)
    return None if found is None else counted(found)


def info_of(reader: PartReader) -> LogInfo:
    """What the metadata read by a PartReader says, from its second copy where the first is hurt. Raises LogError if it
    is cut or not a station's."""
    if reader.damage:
        reader.open_again()
    try:
        return _info_of(reader)
    except LogError:
        reader.open_again()
        return _info_of(reader)


def _info_of(reader: PartReader) -> LogInfo:
    station, clock = reader.metadata.get("station"), reader.metadata.get("clock")
    aircraft = reader.attachments.get("aircraft.json")
    if station is None or clock is None or aircraft is None:
        cut = reader.truncated_at is not None or reader.damage
        why = "is cut or damaged before its profiles end" if cut else "is an MCAP file, but not of this station"
        raise LogError(f"{reader.path}: {why}{_MEND if cut else ''}")
    optional = {name: reader.attachments.get(name) for name in ("rig.json", "card.json")}
    try:
        streams = tuple(Stream(**{**s, "signals": tuple(s["signals"])}) for s in json.loads(station["streams"]))
        about = About(
            aircraft=from_json(Aircraft, aircraft.decode()),
            streams=streams,
            rig=from_json(Rig, optional["rig.json"].decode()) if optional["rig.json"] else None,
            card=from_json(Card, optional["card.json"].decode()) if optional["card.json"] else None,
            source=station["source"],
            imported=station["imported"] == "yes",
            notes=reader.metadata.get("notes", {}),
            files={n.removeprefix("files/"): d for n, d in reader.attachments.items() if n.startswith("files/")},
            clock_law=int(clock.get("law", "1")),
            arithmetic=reader.metadata.get("arithmetic", {}),
        )
        return LogInfo(
            about, station["software"], station["flight"], int(station["part"]), int(clock["station_ns"]),
            int(clock["utc_ns"]),
        )  # fmt: skip
    except (ValueError, KeyError, TypeError, ProfileError) as error:
        raise LogError(f"{reader.path}: its profiles cannot be read: {error}{_MEND}") from error

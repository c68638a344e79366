"""OnSpeed Gen 3 logs with a VectorNav and an air-data boom: a CSV told by its header.

A row holds the newest sample of either device and its age: `boomAge` and `vnDataAge`, ms. A device's samples are put at
the times they were true, row time less age, each once. Boom angles come as counts; they are turned into rad by the
curves that OnSpeed's source gives for its boom, which nobody has fitted to the boom of a given record: zero and scale
are to be calibrated. The counts are kept beside. Pressures of the aircraft's own pitot are counts without a curve and
are left out; true airspeed is OnSpeed's.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import UNITS
from station.convert.tracks import Column, Record, Track, in_si, ordered
from station.profile import Aircraft
from station.rows import LogError

MARKS: Final = ("timeStamp", "boomAlpha", "boomAge", "vnDataAge")
"""Headings that tell such a file."""

_OWN: Final[Mapping[str, tuple[str, str]]] = {
    "airspeed": ("TAS", "kt"),
    "static_pressure": ("PStatic", "mbar"),
    "air_temperature": ("OAT", "degC"),
    "altitude": ("Altitude", "ft"),
}
_VECTORNAV: Final[Mapping[str, tuple[str, str]]] = {
    "p": ("vnAngularRateRoll", "rad/s"),
    "q": ("vnAngularRatePitch", "rad/s"),
    "r": ("vnAngularRateYaw", "rad/s"),
    "ax": ("vnAccelFwd", "m/s2"),
    "ay": ("vnAccelLat", "m/s2"),
    "az": ("vnAccelVert", "m/s2"),
    "phi": ("vnRoll", "deg"),
    "theta": ("vnPitch", "deg"),
    "psi": ("vnYaw", "deg"),
    "v_north": ("vnVelNedNorth", "m/s"),
    "v_east": ("vnVelNedEast", "m/s"),
    "v_down": ("vnVelNedDown", "m/s"),
    "latitude": ("vnGnssLat", "deg"),
    "longitude": ("vnGnssLon", "deg"),
}
_BOOM: Final[Mapping[str, tuple[str, tuple[float, ...]]]] = {
    "alpha_vane": ("boomAlpha", (7.0918e-13, -1.1698e-8, 7.0109e-5, -0.21624, 310.21)),
    "beta_vane": ("boomBeta", (2.0096e-13, -3.7124e-9, 2.5497e-5, -3.7141e-2, -72.505)),
}
"""Counts to deg, highest power first."""
_SAME_MS: Final = 5.0
"""Two rows whose sample was true within this show the same sample."""


def is_onspeed(path: Path) -> bool:
    """Whether a CSV's first line is such a log's header. False too where the file cannot be read."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            names = file.readline().split(",")
    except OSError:
        return False
    return set(MARKS) <= {name.strip() for name in names}


def read_onspeed(path: Path, aircraft: Aircraft) -> Record:
    """An OnSpeed CSV. Raises LogError naming line and column of what cannot be read."""
    try:
        rows = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8-sig"))))
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: byte {error.start}: not UTF-8 text") from None
    except (OSError, csv.Error) as error:
        raise LogError(f"{path}: cannot be read: {error}") from error
    names = [name.strip() for name in rows[0]] if rows else []
    used = ["timeStamp", "boomAge", "vnDataAge"]
    used += [name for name, _ in (*_OWN.values(), *_VECTORNAV.values(), *_BOOM.values())]
    for name in used:
        if name not in names:
            raise LogError(f"{path}: line 1: no column {name}: not a log of OnSpeed with boom and VectorNav")
    raw = {name: _column(path, rows[1:], names, name) for name in used}
    time_ms = raw["timeStamp"]
    if len(time_ms) <= 1:
        raise LogError(f"{path}: no rows below the header")
    for i in np.flatnonzero(~(np.diff(time_ms) > 0)):
        raise LogError(f"{path}: line {i + 3}, column timeStamp: time does not increase")
    own = {signal: in_si(raw[name], UNITS[unit]) for signal, (name, unit) in _OWN.items()}
    vectornav = {signal: in_si(raw[name], UNITS[unit]) for signal, (name, unit) in _VECTORNAV.items()}
    boom = {signal: np.radians(np.polyval(curve, raw[name])) for signal, (name, curve) in _BOOM.items()}
    counts = {f"{signal}_counts": raw[name] for signal, (name, _) in _BOOM.items()}
    tracks = [
        Track("onspeed", _ns(time_ms), ordered(own)),
        _aged("vectornav", time_ms, raw["vnDataAge"], ordered(vectornav), {}),
        _aged("boom", time_ms, raw["boomAge"], boom, counts),
    ]
    notes = {
        "file": path.name,
        "alpha_vane": "boom counts by OnSpeed's curve, not fitted to this boom: calibrate zero and scale",
        "times": "boom and VectorNav samples at row time less their recorded age",
    }
    return Record(tracks, aircraft, "onspeed", notes)


def _column(path: Path, rows: Sequence[Sequence[str]], names: Sequence[str], name: str) -> Column:
    at = names.index(name)
    out = np.empty(len(rows))
    for i, row in enumerate(rows):
        if len(row) != len(names):
            raise LogError(f"{path}: line {i + 2}: {len(row)} columns, but the header has {len(names)}")
        cell = row[at].strip()
        try:
            out[i] = float(cell) if cell else math.nan
        except ValueError:
            raise LogError(f"{path}: line {i + 2}, column {name}: {cell!r} is not a number") from None
    return out


def _ns(time_ms: Column) -> NDArray[np.int64]:
    return np.round(time_ms * 1e6).astype(np.int64)


def _aged(name: str, time_ms: Column, age_ms: Column, columns: dict[str, Column], extra: dict[str, Column]) -> Track:
    """Each sample once, at the time it was true; of rows that show the same one, the first."""
    true_ms = time_ms - age_ms
    keep = np.isfinite(true_ms) & (age_ms >= 0)
    newest = -math.inf
    for i in np.flatnonzero(keep):
        if true_ms[i] - newest < _SAME_MS:
            keep[i] = False
        else:
            newest = float(true_ms[i])
    return Track(
        name, _ns(true_ms[keep]), {n: c[keep] for n, c in columns.items()}, {n: c[keep] for n, c in extra.items()}
    )

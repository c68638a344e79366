"""What a record's spectra show of its vane: a mode, and when the lift follows the vane and by how much.

Forced and gust-only parts apart: what the aircraft does meets vane and wing at once, a gust meets the vane x/V before
the wing. Martos 2013, Figures 19, 44, 45 and 49. SI, rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.estimation.published.cross_spectra import MIN_SEGMENTS, VaneSpectra, by_bins, vane_and_lift
from station.estimation.vane_mode import Mode, find_mode
from station.identification.flown_inputs import FlownInput, forced, inputs_of
from station.numerics.cross_spectrum import Bins, CrossSpectra, binned, cross_spectra, whole_segments
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SEGMENTS_S: Final = (20.0, 10.0, 5.0)
"""The longest of which there are MIN_SEGMENTS: the lowest frequency is twice its inverse."""
BINS_A_DECADE: Final = 24
MODE_BIN_HZ: Final = 0.3
"""Width of the bins that a mode is looked for in: a fifth of the width of one of 9 Hz damped by 0.08."""
RESOLVED: Final = 3.0
"""Lines that a mode must be wide for its damping to be told: a Hann window makes half as many of a single frequency."""
LOWEST_HZ: Final = 0.05


@dataclass(frozen=True, slots=True)
class Part:
    """A kind of part of a record: `seconds` of it, its spectra of vane and lift and of the elevator, or why there are
    none."""

    name: str
    seconds: float
    spectra: VaneSpectra | None
    elevator: Bins | None
    why: str = ""


@dataclass(frozen=True, slots=True)
class VaneDensity:
    """Of what the vane shows, rad2/Hz, up to `nyquist_hz`; `noise` is what its sensor's own noise makes, as the rig
    states it; the mode, or why there is none."""

    bins: Bins
    nyquist_hz: float
    noise: float
    mode: Mode | None
    mode_bins: Bins
    line_hz: float
    """Between the transform's lines."""
    why: str = ""

    @property
    def is_resolved(self) -> bool:
        """Whether the mode is wider than what the window makes of a single frequency."""
        return self.mode is not None and 2 * self.mode.damping * self.mode.frequency_hz > RESOLVED * self.line_hz


def vane_density(record: FlightRecord) -> VaneDensity:
    """Raises NotIdentifiable for a record that is too short."""
    shown = record.motion["alpha_vane"]
    usable = np.isfinite(shown)
    segment = segment_of(usable, record.dt)
    found = cross_spectra(shown, shown, usable, record.dt, segment)
    nyquist = 0.5 / record.dt
    # The Nyquist frequency's own line is one real number, not a complex one.
    edges = np.arange(MODE_BIN_HZ, nyquist, MODE_BIN_HZ)
    fine = binned(found, edges)
    noise = 2.0 * record.dt * record.noise["alpha_vane"] ** 2
    try:
        mode, why = find_mode(fine.frequencies_hz, fine.xx, fine.own, nyquist), ""
    except NotIdentifiable as none:
        mode, why = None, str(none)
    return VaneDensity(_by_decade(found, nyquist), nyquist, noise, mode, fine, 1.0 / (segment * record.dt), why)


def parts(record: FlightRecord) -> tuple[Part, ...]:
    """The forced and the gust-only part. Raises NotIdentifiable where the profile has no boom, or there is no lift."""
    angle, lift, usable, upwash, aspect = vane_and_lift(record)
    inputs = inputs_of(record)
    flown = forced(record, inputs)
    return (
        _part("forced", record, usable & flown, (angle, lift), (upwash, aspect), inputs),
        _part("gusts alone", record, usable & ~flown, (angle, lift), (upwash, aspect), inputs),
    )


def _part(
    name: str,
    record: FlightRecord,
    usable: Flags,
    series: tuple[Array, Array],
    steady: tuple[float, float],
    inputs: tuple[FlownInput, ...],
) -> Part:
    seconds = float(usable.sum()) * record.dt
    if name == "forced" and not inputs:
        return Part(name, seconds, None, None, "the elevator rests throughout")
    try:
        segment = segment_of(usable, record.dt)
    except NotIdentifiable as short:
        why = str(short) if name == "forced" else f"the elevator hardly rests: {short}"
        return Part(name, seconds, None, None, why if inputs else str(short))
    found = cross_spectra(*series, usable, record.dt, segment)
    made = by_bins(found, segment * record.dt, *steady)
    why = "" if made.believed.any() else "lift and vane are nowhere coherent: too little motion or gust"
    elevator = record.motion["elevator"]
    surface = cross_spectra(elevator, elevator, usable & np.isfinite(elevator), record.dt, segment)
    density = _by_decade(surface, 0.5 / record.dt) if surface.segments else None
    return Part(name, seconds, made, density, why)


def segment_of(usable: Flags, dt: float) -> int:
    """Samples of a segment. Raises NotIdentifiable where there are too few segments of the shortest."""
    for seconds in SEGMENTS_S:
        segment = round(seconds / dt) // 2 * 2
        count = whole_segments(usable, segment)
        if count >= MIN_SEGMENTS:
            return segment
    shortest = f"{SEGMENTS_S[-1]:g} s"
    raise NotIdentifiable(
        f"{usable.sum() * dt:.0f} s, {count} of {MIN_SEGMENTS} whole segments of {shortest}: too short"
    )


def _by_decade(found: CrossSpectra, nyquist_hz: float) -> Bins:
    decades = math.log10(nyquist_hz / LOWEST_HZ)
    return binned(found, np.geomspace(LOWEST_HZ, nyquist_hz, round(BINS_A_DECADE * decades) + 1))

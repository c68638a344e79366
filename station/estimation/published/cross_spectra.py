"""Delay and upwash of the vane as functions of frequency, as measured: spectra of the lift against the angle of attack.

    G(f) = S_aL / S_aa,   delay(f) = -arg G / 2 pi f,   coherence = |S_aL|^2 / (S_aa S_LL)
    S_G(f) = G / (2 pi e^{-j 2 pi f x/V} (1 - G k0/n)),   k_u(f) = 2 pi (k0/n) |S_G|

with a the vane's angle, corrected for bias and pitch rate but not for upwash, and L the lift coefficient at the CG. A
positive delay: the vane leads the lift, and its angle has to be delayed. Spectra are means over Hann segments and over
logarithmic bins. S_G is the response of the lift to a gust that Sears' function describes in theory; k0/n makes k_u at
S_G(0) = A/(A + 2) what the steady calibration says.

Source: Martos 2013, Method IV and Appendices 2 and 3. It takes minutes of flight, hence no live method: a test point of
30 s gives a handful of independent segments. Assumes that the lift follows the angle of attack alone;
the lift of pitch rate and elevator counts as delay too, so the result depends on how the aircraft is flown, and all of
alpha, not the gust's part alone, is corrected with it. SI, rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.numerics.cross_spectrum import CrossSpectra, binned, cross_spectra
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

SEGMENT_S: Final = 41.0
"""Longest; shorter where there would be fewer than MIN_SEGMENTS."""
MIN_SEGMENTS: Final = 7
MIN_SEGMENT_S: Final = 5.0
BINS: Final = 27
LOW_HZ: Final = 0.01
HIGH_HZ: Final = 10.0
COHERENT: Final = 0.5
"""Below this most of the lift does not follow the vane's angle."""
ENOUGH: Final = 0.5
"""Share of the bins in the band that must be coherent."""


@dataclass(frozen=True, slots=True)
class VaneSpectra:
    """Of each bin, (bins,): mean frequency; `delay_s` of the vane with its standard deviation; coherence; `sears`, the
    |S_G|, with its standard deviation; `upwash`, k_u; and whether it is coherent enough to be `believed`."""

    frequencies_hz: Array
    delay_s: Array
    delay_sd: Array
    coherence: Array
    sears: Array
    sears_sd: Array
    upwash: Array
    believed: Flags
    segments: int
    segment_s: float

    def at(self, frequencies_hz: Array) -> tuple[Array, Array]:
        """Delay (s) and k_u at other frequencies: straight lines over log f between the coherent bins."""
        f = np.log(self.frequencies_hz[self.believed])
        wanted = np.log(frequencies_hz)
        delay: Array = np.interp(wanted, f, self.delay_s[self.believed])
        upwash: Array = np.interp(wanted, f, self.upwash[self.believed])
        return delay, upwash


def vane_spectra(
    angle: Array,
    lift: Array,
    usable: Flags,
    dt: float,
    *,
    upwash: float,
    aspect_ratio: float,
    band_hz: tuple[float, float],
) -> VaneSpectra:
    """From the vane's angle with its upwash in it, rad, and the lift coefficient, (n,) each.

    `upwash`: k_u0 of the steady calibration. Raises NotIdentifiable where the record is too short, or vane and lift are
    not coherent in `band_hz`.
    """
    flown = int(np.count_nonzero(usable))
    segment = min(round(SEGMENT_S / dt), 2 * flown // (MIN_SEGMENTS + 1)) // 2 * 2
    shortest = round(max(MIN_SEGMENT_S, 1.0 / band_hz[0]) / dt)
    if segment < shortest:
        needed = shortest * dt * (MIN_SEGMENTS + 1) / 2
        raise NotIdentifiable(f"{flown * dt:.1f} s are too short to measure spectra: needs {needed:.0f} s or more")
    found = cross_spectra(angle, lift, usable, dt, segment)
    if found.segments < MIN_SEGMENTS:
        raise NotIdentifiable(f"gaps leave {found.segments} of {MIN_SEGMENTS} segments of {segment * dt:.0f} s whole")
    made = by_bins(found, segment * dt, upwash, aspect_ratio)
    inside = (made.frequencies_hz >= band_hz[0]) & (made.frequencies_hz <= band_hz[1])
    share = float(np.mean(made.believed[inside])) if inside.any() else 0.0
    if share < ENOUGH:
        band = f"{band_hz[0]:g} to {band_hz[1]:g} Hz"
        raise NotIdentifiable(f"vane and lift are coherent in {share:.0%} of {band}: too little motion or gust")
    return made


def by_bins(found: CrossSpectra, segment_s: float, upwash: float, aspect_ratio: float) -> VaneSpectra:
    """Of the cross-spectra of vane and lift, in logarithmic bins; `upwash`: k_u0 of the steady calibration."""
    bins = binned(found, np.logspace(math.log10(LOW_HZ), math.log10(HIGH_HZ), BINS + 1))
    frequencies, response, error = bins.frequencies_hz, bins.response, bins.relative_sd
    ratio = upwash * (aspect_ratio + 2) / aspect_ratio / (2 * math.pi)
    with np.errstate(divide="ignore", invalid="ignore"):
        delay = -np.angle(response) / (2 * math.pi * frequencies)
        sears = np.abs(response / (2 * math.pi * (1 - response * ratio)))
        # d ln S = d ln G/(1 - G k0/n)
        sears_sd = sears * error / np.abs(1 - response * ratio)
    coherent = bins.coherence > np.maximum(bins.by_chance, COHERENT)
    return VaneSpectra(
        frequencies_hz=frequencies,
        delay_s=delay,
        delay_sd=error / (2 * math.pi * frequencies),
        coherence=bins.coherence,
        sears=sears,
        sears_sd=sears_sd,
        upwash=2 * math.pi * ratio * sears,
        believed=coherent & np.isfinite(delay) & np.isfinite(sears),
        segments=found.segments,
        segment_s=segment_s,
    )


def vane_and_lift(record: FlightRecord) -> tuple[Array, Array, Flags, float, float]:
    """Of a flight: the vane's angle with its upwash in it, rad, and the lift coefficient, (n,); where both are known;
    k_u0 and the aspect ratio. Raises NotIdentifiable for a profile without a boom."""
    boom, geometry = record.aircraft.boom, record.aircraft.geometry
    if boom is None:
        raise NotIdentifiable("the aircraft profile has no boom: no delay or upwash to measure")
    lift = record.coefficients.named("CL")
    usable = record.usable & np.isfinite(lift) & np.isfinite(record.alpha)
    upwash = boom.upwash_body + boom.upwash_wing
    return record.alpha / boom.steady_calibration, lift, usable, upwash, geometry.span**2 / geometry.wing_area


def measure(record: FlightRecord, band_hz: tuple[float, float]) -> VaneSpectra:
    """Of a flight. Raises NotIdentifiable, also for a profile without a boom or a vane without upwash."""
    angle, lift, usable, upwash, aspect = vane_and_lift(record)
    return vane_spectra(angle, lift, usable, record.dt, upwash=upwash, aspect_ratio=aspect, band_hz=band_hz)

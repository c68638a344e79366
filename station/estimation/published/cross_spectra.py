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
from scipy.signal import get_window

from station.estimation.flight_record import FlightRecord
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

SEGMENT_S: Final = 41.0
"""Longest; shorter where there would be fewer than MIN_SEGMENTS."""
MIN_SEGMENTS: Final = 7
MIN_SEGMENT_S: Final = 5.0
BINS: Final = 27
MEAN_LINES: Final = 2
"""The lowest lines, which the window leaks the mean into."""
LOW_HZ: Final = 0.01
HIGH_HZ: Final = 10.0
COHERENT: Final = 0.5
"""Below this most of the lift does not follow the vane's angle."""
ENOUGH: Final = 0.5
"""Share of the bins in the band that must be coherent."""


@dataclass(frozen=True, slots=True)
class CrossSpectra:
    """One-sided densities (lines,) of x, y and from x to y, E[X* Y]; `segments` that they are means of."""

    frequencies_hz: Array
    xx: Array
    yy: Array
    xy: Complex
    segments: int


def cross_spectra(x: Array, y: Array, usable: Flags, dt: float, segment: int) -> CrossSpectra:
    """Of two series (n,) by Hann segments of `segment` samples that overlap by half, each less its mean (Welch 1967).

    Segments with a row that is not `usable` are left out. `segments` is 0 where none is whole.
    """
    window = get_window("hann", segment)
    scale = 2.0 * dt / float(window @ window)
    frequencies: Array = np.asarray(np.fft.rfftfreq(segment, dt), dtype=np.float64)
    xx, yy = np.zeros(len(frequencies)), np.zeros(len(frequencies))
    xy = np.zeros(len(frequencies), dtype=np.complex128)
    count = 0
    for start in range(0, len(x) - segment + 1, segment - segment // 2):
        part = slice(start, start + segment)
        if not usable[part].all():
            continue
        a, b = (np.fft.rfft(window * (s[part] - s[part].mean())) for s in (x, y))
        xx += np.abs(a) ** 2
        yy += np.abs(b) ** 2
        xy += a.conj() * b
        count += 1
    weight = np.full(len(frequencies), scale / max(count, 1))
    weight[0] /= 2.0
    if segment % 2 == 0:
        weight[-1] /= 2.0
    return CrossSpectra(frequencies, xx * weight, yy * weight, xy * weight, count)


@dataclass(frozen=True, slots=True)
class VaneSpectra:
    """Of each bin, (bins,): mean frequency; `delay_s` of the vane with its standard deviation; coherence; `sears`, the
    |S_G|; `upwash`, k_u; and whether it is coherent enough to be `believed`."""

    frequencies_hz: Array
    delay_s: Array
    delay_sd: Array
    coherence: Array
    sears: Array
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
    edges = np.logspace(math.log10(LOW_HZ), math.log10(HIGH_HZ), BINS + 1)
    member = np.digitize(found.frequencies_hz, edges) * (np.arange(len(found.frequencies_hz)) >= MEAN_LINES)
    kept = [np.flatnonzero(member == i) for i in range(1, BINS + 1)]
    kept = [lines for lines in kept if len(lines)]

    def binned(x: Array | Complex) -> Complex:
        return np.array([np.mean(x[lines]) for lines in kept], dtype=np.complex128)

    f, xx, yy, xy = (binned(x) for x in (found.frequencies_hz, found.xx, found.yy, found.xy))
    frequencies = f.real
    with np.errstate(divide="ignore", invalid="ignore"):
        response = xy / xx
        coherence = np.nan_to_num(np.abs(xy) ** 2 / (xx.real * yy.real))
        delay = -np.angle(response) / (2 * math.pi * frequencies)
        # Half-overlapping Hann segments, and neighbouring lines of a Hann window, are not quite independent.
        independent = 0.95 * found.segments * np.array([max(len(lines) / 1.5, 1.0) for lines in kept])
        error = np.sqrt((1 - coherence) / (2 * independent * np.maximum(coherence, 1e-12)))
        ratio = upwash * (aspect_ratio + 2) / aspect_ratio / (2 * math.pi)
        sears = np.abs(response / (2 * math.pi * (1 - response * ratio)))
    by_chance = 1 - 0.05 ** (1 / np.maximum(independent - 1, 1e-6))
    believed = (coherence > np.maximum(by_chance, COHERENT)) & np.isfinite(delay) & np.isfinite(sears)
    inside = (frequencies >= band_hz[0]) & (frequencies <= band_hz[1])
    share = float(np.mean(believed[inside])) if inside.any() else 0.0
    if share < ENOUGH:
        band = f"{band_hz[0]:g} to {band_hz[1]:g} Hz"
        raise NotIdentifiable(f"vane and lift are coherent in {share:.0%} of {band}: too little motion or gust")
    return VaneSpectra(
        frequencies_hz=frequencies,
        delay_s=delay,
        delay_sd=error / (2 * math.pi * frequencies),
        coherence=coherence,
        sears=sears,
        upwash=2 * math.pi * ratio * sears,
        believed=believed,
        segments=found.segments,
        segment_s=segment * dt,
    )


def measure(record: FlightRecord, band_hz: tuple[float, float]) -> VaneSpectra:
    """Of a flight. Raises NotIdentifiable, also for a profile without a boom or a vane without upwash."""
    boom, geometry = record.aircraft.boom, record.aircraft.geometry
    if boom is None:
        raise NotIdentifiable("the aircraft profile has no boom: no delay or upwash to measure")
    lift = record.coefficients.named("CL")
    return vane_spectra(
        record.alpha / boom.steady_calibration,
        lift,
        record.usable & np.isfinite(lift) & np.isfinite(record.alpha),
        record.dt,
        upwash=boom.upwash_body + boom.upwash_wing,
        aspect_ratio=geometry.span**2 / geometry.wing_area,
        band_hz=band_hz,
    )

"""An accelerometer on the boom against the centre of gravity's, over frequency, and the boom's bending mode in it.

    T(f) = 1 + g (f/f0)^2 / (1 - (f/f0)^2 + 2 i zeta f/f0)

from what a rigid boom would feel there (the acceleration of the CG carried there) to what is felt: the mode is loaded
by the one and its own acceleration adds to it. Both are measured with noise, of which the carried one has more than
there is motion about 8 Hz, so neither is divided by the other: the 2 x 2 spectral matrix of each bin is

    S_rr(f) [1, T*; T, |T|^2] + diag(N_x, N_y),   N as the rig states the noise,

by Whittle's likelihood, in which the best S_rr of a bin stands in closed form. Martos 2013, Figure 20; Whittle 1953;
Bendat and Piersol 2010, chapter 9. SI, Hz.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import chi2

from station.estimation.flight_record import FlightRecord
from station.identification.vane_spectra import segment_of
from station.numerics.cross_spectrum import Bins, binned, cross_spectra
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Position = tuple[float, float, float]

LOWEST_HZ: Final = 2.0
"""Below, the boom moves with the aircraft."""
FITTED: Final = 0.8
"""Of the Nyquist frequency: what is above is averaged with its neighbours, and folded."""
LINES: Final = 2
"""Of a bin, no more: through a lightly damped mode the phase turns by half a turn, and a mean is then too small."""
STARTS: Final = 8
LEAST_BINS: Final = 24
BY_CHANCE: Final = 1e-4
"""Probability with which a rigid boom is said to have a mode."""
DAMPED: Final = 0.7
"""From here on there is no peak."""
_STEP: Final = 1e-3
"""Of the second differences, in logarithms."""


@dataclass(frozen=True, slots=True)
class BoomMode:
    """Frequency (Hz) and damping ratio, with standard deviations; g, what the tip's own acceleration is of the load's,
    counted by (f/f0)^2."""

    frequency_hz: float
    frequency_sd: float
    damping: float
    damping_sd: float
    gain: float

    def transmitted(self, f: Array) -> Complex:
        return _transmitted(math.log(self.frequency_hz), math.log(self.damping), math.log(self.gain), f)


@dataclass(frozen=True, slots=True)
class BoomSpectra:
    """`bins`: x is what a rigid boom would feel, y what is felt; `noise` (bins,) of each, its densities; the mode, or
    why there is none."""

    name: str
    bins: Bins
    noise: tuple[Array, Array]
    nyquist_hz: float
    mode: BoomMode | None
    why: str = ""


def boom_spectra(
    record: FlightRecord, t_s: Array, columns: Mapping[str, Array], places: Mapping[str, Position]
) -> tuple[BoomSpectra, ...]:
    """Of every accelerometer for az in `places` (m from the CG, body axes) that the `columns` over `t_s` have. Raises
    NotIdentifiable for a record that is too short."""
    found = []
    for name, place in places.items():
        if name not in columns:
            continue
        felt = np.interp(record.t_s, t_s, columns[name])
        q = record.motion["q"]
        rigid = record.motion["az"] - place[0] * _slope(q, record.dt) - place[2] * q**2
        usable = np.isfinite(felt) & np.isfinite(rigid)
        segment = segment_of(usable, record.dt)
        raw = cross_spectra(rigid, felt, usable, record.dt, segment)
        nyquist, width = 0.5 / record.dt, LINES / (segment * record.dt)
        bins = binned(raw, np.arange(width, nyquist, width))
        noise = _noise(record, name, place, bins.frequencies_hz)
        try:
            found.append(BoomSpectra(name, bins, noise, nyquist, bending_mode(bins, noise, nyquist)))
        except NotIdentifiable as none:
            found.append(BoomSpectra(name, bins, noise, nyquist, None, str(none)))
    return tuple(found)


def _noise(record: FlightRecord, name: str, place: Position, f: Array) -> tuple[Array, Array]:
    """Densities of what is carried to the place, whose pitch acceleration is a difference of rates, and of what is
    felt."""
    one = np.full(len(f), 2.0 * record.dt)
    carried = record.noise["az"] ** 2 + (place[0] * 2 * math.pi * f * record.noise["q"]) ** 2
    return one * carried, one * record.noise.get(name, record.noise["az"]) ** 2


def _slope(x: Array, dt: float) -> Array:
    """The derivative, exact at every frequency: a tip's share of az and of the pitch acceleration nearly cancel, and
    differences of samples lose 3 % at 8 Hz of 50 Hz. NaN where x is."""
    at = np.arange(len(x))
    known = np.isfinite(x)
    if not known.any():
        return np.full(len(x), np.nan)
    whole = np.interp(at, at[known], x[known])
    line = np.linspace(whole[0], whole[-1], len(x))
    lines = np.fft.rfft(whole - line) * 2j * math.pi * np.fft.rfftfreq(len(x), dt)
    made = np.fft.irfft(lines, len(x)) + (whole[-1] - whole[0]) / (dt * max(len(x) - 1, 1))
    return np.asarray(np.where(known, made, np.nan))


def bending_mode(bins: Bins, noise: tuple[Array, Array], nyquist_hz: float) -> BoomMode:
    """Raises NotIdentifiable where no mode stands out, saying why."""
    kept = (bins.frequencies_hz >= LOWEST_HZ) & (bins.frequencies_hz <= FITTED * nyquist_hz)
    f = bins.frequencies_hz[kept]
    if len(f) < LEAST_BINS:
        raise NotIdentifiable(f"{len(f)} bins above {LOWEST_HZ:g} Hz: too few to show a mode")
    xx, yy, xy, n = (part[kept] for part in (bins.xx, bins.yy, bins.xy, bins.own))
    nx, ny = (part[kept] for part in noise)

    def deviance(made: Complex) -> float:
        """-2 ln of the likelihood, with the best S_rr, but for a constant."""
        size = 1 / nx + np.abs(made) ** 2 / ny
        along = (xx / nx**2 + np.abs(made) ** 2 * yy / ny**2 + 2 * (made.conj() * xy).real / (nx * ny)) / size
        seen = np.maximum(along, 1.0)
        return float(2 * np.sum(n * (np.log(seen) + along / seen - along)))

    def of(theta: Array) -> float:
        return deviance(_transmitted(theta[0], theta[1], theta[2], f))

    rigid = deviance(np.ones(len(f), dtype=np.complex128))
    starts = [np.log([f0, 0.05, 0.5]) for f0 in np.geomspace(f[0], f[-1], STARTS + 2)[1:-1]]
    best = min((minimize(of, start, method="Nelder-Mead") for start in starts), key=lambda r: float(r.fun))
    f0, zeta, gain = np.exp(best.x).tolist()
    band = f"between {f[0]:.2g} and {f[-1]:.2g} Hz"
    if chi2.sf(rigid - best.fun, 3) * len(f) > BY_CHANCE or zeta > DAMPED or not f[0] < f0 < f[-1]:
        raise NotIdentifiable(f"no bending mode stands out {band}: the boom is as good as rigid")
    curve = np.array([[_curved(of, best.x, i, j) for j in range(3)] for i in range(3)])
    sd = np.sqrt(np.maximum(np.diag(2 * np.linalg.pinv(curve)), 0.0))
    return BoomMode(f0, f0 * float(sd[0]), zeta, zeta * float(sd[1]), gain)


def _curved(of: Callable[[Array], float], at: Array, i: int, j: int) -> float:
    """A second derivative, by central differences."""
    a, b = _STEP * np.eye(3)[i], _STEP * np.eye(3)[j]
    return (of(at + a + b) - of(at + a - b) - of(at - a + b) + of(at - a - b)) / (4 * _STEP**2)


def _transmitted(ln_frequency: float, ln_damping: float, ln_gain: float, f: Array) -> Complex:
    ratio = f / math.exp(ln_frequency)
    return np.asarray(1 + math.exp(ln_gain) * ratio**2 / (1 - ratio**2 + 2j * math.exp(ln_damping) * ratio))

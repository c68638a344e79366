"""What the kinematic equations leave of a record, line by line, and the noise that it is weighed by.

Each row, with every reading's lag, scale and zero undone, is e(f), of covariance

    Sigma(f) = sum over instruments of S c(f) c(f)* + E(f)

S is an instrument's white noise, c what the rows make of it, E what a row has beyond (gusts in the flow angles' rows,
slow errors): smooth spectra, estimated along, and the heading instrument's own. Slopes de/dparameter are made of noisy
readings too: the part that Sigma^-1 e shows to be noise is subtracted, which leaves score and information without it.

Source: Pintelon and Schoukens 2012, chapter 8; Nakamura 1990 (errors in variables).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import prev_fast_len

from station.conventions import G0
from station.model.kinematic_equations import MISALIGNED, equations
from station.numerics.differentiation import white_variance
from station.numerics.modulation import MOST, Stretch
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Key = tuple[str, str]
"""An instrument, and "lag" (s), "filter" (s, time constant before a head's lag), "scale" (logarithm) or "zero"."""

REFERENCE: Final = "theta"
"""In time by definition."""
ROLL: Final = "phi"
"""In time too, unless another row than its own shows otherwise."""
LEVEL: Final = ("theta", "phi", "psi", "airspeed", "altitude")
"""Without a scale of their own: angles of an attitude reference; the speed, which gives the scale of the others."""
ZEROS: Final[Mapping[str, float]] = {
    **dict.fromkeys(("p", "q", "r"), 0.02),
    **dict.fromkeys(("ax", "ay", "az"), 0.5),
    **dict.fromkeys(("alpha_vane", "beta_vane"), 0.1),
    **dict.fromkeys(MISALIGNED, 0.0175),
}
"""Prior standard deviations of zeros, about 0; az's is that of its reading at 1 g. A vane's shows where the speed
changes; a boom is in line with the accelerometers to a degree."""
LAGS_S: Final = 1.5
"""Lags that are sought, either way, in a record ten times as long."""
HIGH_HZ: Final = 2.5
"""Above it structure and filters are not rigid motion,"""
OF_RATE: Final = 0.4
"""and samples no longer show it: share of the sampling rate."""
SEGMENT_S: Final = 60.0
LEAST_S: Final = 5.0
FIRST_LINE: Final = 3
"""Lines below it hold zeros and drift, and say nothing of the noise."""
BAND_GROWS: Final = 1.3
BAND_MISALIGNED: Final = 8
"""Lines of all segments that a level of noise is the mean of, at least: known to 35 %."""
LEAST_BAND: Final = 3
LEAST_SHARE: Final = 0.02
"""Of a row's noise that is its own."""
MOSTLY: Final = 0.5
TINY: Final = 1e-30


class Likelihood:
    """Rows of the kinematic equations over the spans of a record, as functions of every instrument's errors."""

    def __init__(
        self,
        motion: Mapping[str, Array],
        dt: float,
        arm: tuple[float, float, float],
        spans: Sequence[slice],
        upwash: float = 1.0,
        mended: Mapping[str, Array] | None = None,
        late: Mapping[str, float] | None = None,
    ) -> None:
        longest = max((s.stop - s.start for s in spans), default=0)
        if longest * dt < LEAST_S:
            raise NotIdentifiable(f"{longest * dt:.1f} s without gaps: instruments are compared over {LEAST_S:g} s")
        if "theta" not in motion or "q" not in motion:
            raise NotIdentifiable("no theta and q throughout: nothing to hold the others against")
        self.margin = math.ceil(min(LAGS_S, longest * dt / 10) / dt)
        whole = longest - 2 * self.margin - 1
        count = int(prev_fast_len(whole // max(1, int(whole * dt // SEGMENT_S)), real=True))
        self.high_hz = min(HIGH_HZ, OF_RATE / dt)
        lines = int(self.high_hz * count * dt) + 1
        self.stretches = [
            Stretch(start, count, dt, lines)
            for s in spans
            for start in range(s.start + self.margin, s.stop - self.margin - count, count)
        ]
        self.arm = arm
        self.model = equations(motion, arm, upwash, mended, late)
        self.rows = {head: r for r, head in enumerate(self.model.heads)}
        self.speed = float(np.mean(motion["airspeed"])) if "airspeed" in motion else math.nan
        instruments = list(dict.fromkeys(t.instrument for t in self.model.terms if t.instrument))
        references = {i for i in (REFERENCE, ROLL) if not self.elsewhere(i)} | {REFERENCE}
        self.keys = [(i, "lag") for i in instruments if i not in references | {*MISALIGNED}]
        self.keys += [(i, "scale") for i in instruments if i not in (*LEVEL, *MISALIGNED)]
        self.keys += [(i, "zero") for i in instruments if i in ZEROS]
        self.instruments = instruments
        self.white = {i: 0.0 if i in MISALIGNED else white_variance(motion[i]) * dt for i in instruments}
        self.frequencies = self.stretches[0].frequencies_hz
        self.omega = 2 * np.pi * self.frequencies
        self._kept: dict[tuple[int, int, float], tuple[list[Complex], Complex]] = {}
        self.own = np.ones((len(self.rows), lines))
        self.total = self.own

    def elsewhere(self, instrument: str) -> list[str]:
        """Rows that an instrument is in without heading them."""
        return list(dict.fromkeys(t.row for t in self.model.terms if t.instrument == instrument != t.row))

    def transforms(self, n: int, s: int, lag: float) -> tuple[list[Complex], Complex]:
        """Of a term's fluctuation `lag` later, from its own order on, and of its factor, in one stretch."""
        key = (n, s, lag)
        if key not in self._kept:
            term, stretch = self.model.terms[n], self.stretches[s]
            rows = slice(stretch.start - self.margin, stretch.start + stretch.count + self.margin + 1)
            # Only what moves is late; the factor of its mean (gravity, a trim) is the attitude's.
            mean = float(np.mean(term.readings[rows])) if term.order == 0 else 0.0
            highest = min(term.order + 2, MOST)
            made = stretch.transform(term.factor_read * (term.readings - mean), lag, highest)[term.order :]
            unit = stretch.transform(term.factor, 0.0, term.order)[term.order]
            made[0] = made[0] + mean * unit
            if len(self._kept) > 20 * len(self.model.terms) * len(self.stretches):
                self._kept.clear()
            self._kept[key] = made, unit
        return self._kept[key]

    def errors(
        self,
        values: Mapping[Key, float],
        keys: Sequence[Key],
        wanted: Sequence[str] = (),
        omitted: Sequence[str] = (),
    ) -> tuple[Complex, Complex]:
        """Rows (segments, rows, lines), and their slopes by `keys` (segments, rows, lines, keys); or `wanted` rows, and
        without the instruments `omitted`."""
        shape = len(self.stretches), len(self.rows), len(self.omega)
        e, slope = np.zeros(shape, complex), np.zeros((*shape, len(keys)), complex)
        place = {key: n for n, key in enumerate(keys)}
        for n, term in enumerate(self.model.terms):
            if (wanted and term.row not in wanted) or term.instrument in omitted:
                continue
            i, r = term.instrument, self.rows[term.row]
            gain = math.exp(-values.get((i, "scale"), 0.0))
            lag, late, zero = (values.get((i, kind), 0.0) for kind in ("lag", "filter", "zero"))
            heads = i == term.row
            level = -G0 if i == "az" else 0.0
            for s in range(len(self.stretches)):
                x, unit = self.transforms(n, s, lag)
                value = x[0] - (zero + level) * unit if i in ZEROS else x[0]
                if heads and late:
                    value = value + late * x[1]
                e[s, r] += gain * value + (level * unit if i in ZEROS else 0.0)
                if (i, "lag") in place:
                    slope[s, r, :, place[i, "lag"]] += gain * (x[1] + late * x[2] if heads and late else x[1])
                if (i, "scale") in place:
                    slope[s, r, :, place[i, "scale"]] -= gain * value
                if (i, "zero") in place:
                    slope[s, r, :, place[i, "zero"]] -= gain * unit
                if heads and (i, "filter") in place:
                    slope[s, r, :, place[i, "filter"]] += gain * x[1]
        return e, slope

    def paths(self, values: Mapping[Key, float]) -> dict[str, Complex]:
        """What every row makes of an instrument's noise, (rows, lines)."""
        made = {i: np.zeros((len(self.rows), len(self.omega)), complex) for i in self.instruments}
        for term in self.model.terms:
            if not term.instrument:
                continue
            i = term.instrument
            path = (1j * self.omega) ** term.order * term.slope * math.exp(-values.get((i, "scale"), 0.0))
            if i == term.row:
                path = path * (1 + 1j * self.omega * values.get((i, "filter"), 0.0))
            made[i][self.rows[term.row]] += path
        return made

    def bands(self) -> list[tuple[int, int]]:
        """Lines that share a level of noise, first and one after the last."""
        last, least = len(self.omega), max(LEAST_BAND, math.ceil(BAND_MISALIGNED / len(self.stretches)))
        edges = [min(FIRST_LINE, last - 1)]
        while edges[-1] + least < last:
            edges.append(max(edges[-1] + least, round(edges[-1] * BAND_GROWS)))
        edges[-1] = last
        return list(pairwise(edges)) or [(0, last)]

    def smooth(self, power: Array) -> Array:
        """Means of bands (rows, lines), straight between their middles on logarithmic axes."""
        bands = self.bands()
        middle = np.log([0.5 * (a + b) for a, b in bands])
        lines = np.log(np.maximum(np.arange(power.shape[1]), 1))
        levels = np.log([[max(float(row[a:b].mean()), TINY) for a, b in bands] for row in power])
        return np.exp([np.interp(lines, middle, row) for row in levels])

    def renew_noise(self, e: Complex, values: Mapping[Key, float]) -> None:
        """What each row has beyond its instruments' white noise; these no larger than the rows allow."""
        paths = self.paths(values)
        total = self.smooth((np.abs(e) ** 2).mean(axis=0))
        for _ in range(2):
            known = sum(self.white[i] * np.abs(paths[i]) ** 2 for i in self.instruments)
            share = np.median(total / np.maximum(known, TINY), axis=1)
            for r in np.flatnonzero(share < 1.0):
                for i in self.instruments:
                    if np.median(self.white[i] * np.abs(paths[i][r]) ** 2 / total[r]) > MOSTLY:
                        self.white[i] *= float(share[r])
        self.total = total
        self.own = np.maximum(total - known, LEAST_SHARE * total)

    def covariance(self, paths: Mapping[str, Complex]) -> Complex:
        """Sigma (lines, rows, rows)."""
        total = np.zeros((len(self.omega), len(self.rows), len(self.rows)), complex)
        for i in self.instruments:
            total += self.white[i] * np.einsum("rk,sk->krs", paths[i], paths[i].conj())
        diagonal = np.arange(len(self.rows))
        total[:, diagonal, diagonal] += self.own.T
        return total

    def denoised(self, slope: Complex, weighted: Complex, paths: Mapping[str, Complex], keys: Sequence[Key],
                  values: Mapping[Key, float]) -> Complex:  # fmt: skip
        """Slopes without the noise of the readings that they are made of; `weighted` is Sigma^-1 e."""
        made = slope.copy()
        for n, (i, kind) in enumerate(keys):
            if kind == "zero":
                continue
            noise = np.einsum(
                "rk,sk->srk", paths[i], self.white[i] * np.einsum("rk,skr->sk", paths[i].conj(), weighted)
            )
            if i in self.rows:
                noise[:, self.rows[i]] += self.own[self.rows[i]] * weighted[:, :, self.rows[i]]
            late = 1j * self.omega
            if kind == "filter":
                late = late / (1 + late * values[i, "filter"])
            made[..., n] += noise if kind == "scale" else -late * noise
        return made

    def heard(self, i: str, values: Mapping[Key, float]) -> float:
        """By how much deviance an instrument's readings explain a row that it does not head, or others the one it does:
        the best of them."""
        drops = []
        for head in {t.row for t in self.model.terms if t.instrument == i}:
            others = [t.instrument for t in self.model.terms if t.row == head and t.instrument != i]
            omitted = others if head == i else [i]
            drops.append(self.deviance(values, [head], omitted) - self.deviance(values, [head]))
        return max(drops)

    def deviance(
        self, values: Mapping[Key, float], rows: Sequence[str] | None = None, omitted: Sequence[str] = ()
    ) -> float:
        """-2 log likelihood of the heading readings of some rows, each row's noise at its own best level."""
        e, _ = self.errors(values, (), rows or (), omitted)
        power = (np.abs(e) ** 2).mean(axis=0)
        total = 0.0
        for head in rows if rows is not None else self.rows:
            gain = np.abs(1 + 1j * self.omega * values.get((head, "filter"), 0.0)) ** 2
            gain = gain * math.exp(-2 * values.get((head, "scale"), 0.0))
            for a, b in self.bands():
                level = math.log(max(float(power[self.rows[head], a:b].mean()), TINY)) * (b - a)
                total += 2 * len(self.stretches) * (level - float(np.log(gain[a:b]).sum()))
        return total

"""Where the extended model holds and where it fails: the misfit of lift and moment over angle of attack, speed and
deflection, and over time, with the envelope that was flown; nothing is said of what was not.

A misfit is a residual over the standard deviation that noise and gusts let expect: where the model holds its mean
square is 1. Whether a box fails is a test of its mean square against chi-square, at a level shared by all boxes
(Bonferroni), with as many independent values as the residual's own correlation leaves (Bartlett 1946: n over the sum of
the squared autocorrelation).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.stats import chi2

from station.conventions import from_si, to_si

Array = NDArray[np.float64]

SERIES: Final = ("lift", "moment")
LEVEL: Final = 0.001
"""Chance that any box of a sound model is said to fail."""
LEAST_S: Final = 0.5
"""Flown in a box for it to be judged."""
MOST_BOXES: Final = 10
"""Along an axis."""
AXES: Final = {"alpha": "deg", "airspeed": "m/s", "elevator": "deg"}
"""Of the maps, with the unit their boxes are cut in: whole steps of 1, 2 or 5 tens of it."""
MAPS: Final = (("alpha", "airspeed"), ("alpha", "elevator"))


@dataclass(frozen=True, slots=True)
class Misfit:
    """One manoeuvre: (n,) each, every `dt` seconds; angle of attack at the CG, true airspeed and elevator in SI, the
    misfits of lift and moment in standard deviations."""

    record: str
    dt: float
    alpha: Array
    airspeed: Array
    elevator: Array
    lift: Array
    moment: Array
    start: float = 0.0
    """When they begin, s of the manoeuvre."""


@dataclass(frozen=True, slots=True)
class Box:
    """A part of a map: its edges, SI, along both axes; how long it was flown, s; the root of the mean square misfit."""

    series: str
    axes: tuple[str, str]
    first: tuple[float, float]
    second: tuple[float, float]
    seconds: float
    rms: float
    fails: bool


@dataclass(frozen=True, slots=True)
class Course:
    """A manoeuvre: root of the mean square misfit of lift and moment, and the second in which it is worst."""

    record: str
    rms: dict[str, float]
    worst: dict[str, tuple[float, float]]
    """Its middle, s of the manoeuvre, and its root mean square."""


@dataclass(frozen=True, slots=True)
class Validity:
    """All of it."""

    misfits: tuple[Misfit, ...]
    boxes: tuple[Box, ...]
    courses: tuple[Course, ...]
    envelope: dict[str, tuple[float, float]]
    """Least and most of each of AXES, SI."""

    @property
    def failing(self) -> tuple[Box, ...]:
        return tuple(b for b in self.boxes if b.fails)


def validity(misfits: Sequence[Misfit]) -> Validity:
    """Of all manoeuvres together."""
    together = {name: np.concatenate([getattr(m, name) for m in misfits]) for name in (*AXES, *SERIES)}
    dt = np.concatenate([np.full(len(m.alpha), m.dt) for m in misfits])
    share = {s: float(np.mean([independent_share(getattr(m, s)) for m in misfits])) for s in SERIES}
    made = []
    for axes in MAPS:
        edges = tuple(edges_of(together[a], AXES[a]) for a in axes)
        at = tuple(np.digitize(together[a], e) - 1 for a, e in zip(axes, edges, strict=True))
        for i in range(len(edges[0]) - 1):
            for j in range(len(edges[1]) - 1):
                inside = (at[0] == i) & (at[1] == j)
                seconds = float(dt[inside].sum())
                if seconds < LEAST_S:
                    continue
                spans = tuple((float(e[k]), float(e[k + 1])) for e, k in zip(edges, (i, j), strict=True))
                for s in SERIES:
                    square = float(np.mean(together[s][inside] ** 2))
                    made.append((s, axes, spans, seconds, square, max(1.0, share[s] * int(inside.sum()))))
    level = LEVEL / max(len(made), 1)
    boxes = tuple(
        Box(s, axes, spans[0], spans[1], seconds, math.sqrt(square), bool(square > chi2.isf(level, n) / n))
        for s, axes, spans, seconds, square, n in made
    )
    envelope = {a: (float(together[a].min()), float(together[a].max())) for a in AXES}
    return Validity(tuple(misfits), boxes, tuple(_course(m) for m in misfits), envelope)


def independent_share(x: Array) -> float:
    """How many independent values of its square a series (n,) has, as a share of n.

    The correlation is that of the signs, by the arcsine law of Gaussian noise: where a model fails the misfit is large
    and slow, and would lend its correlation to the rest.
    """
    signs = np.sign(x - np.median(x))
    n = len(x)
    correlation = fft.irfft(np.abs(fft.rfft(signs, 2 * n)) ** 2)[:n]
    if correlation[0] <= 0:
        return 1.0
    found = np.sin(0.5 * math.pi * np.clip(correlation[1:] / correlation[0], -1, 1))
    # From where it is within two standard errors of nothing on it is chance, which would add up.
    ends = np.flatnonzero(np.abs(found) < math.pi / math.sqrt(n))
    squared = found[: int(ends[0]) if len(ends) else len(found)] ** 2
    return float(1.0 / (1.0 + 2.0 * squared.sum()))


def edges_of(x: Array, unit: str) -> Array:
    """Edges of boxes over what was flown, SI: whole steps of 1, 2 or 5 tens of the unit, at most MOST_BOXES of them."""
    low, high = from_si(float(x.min()), unit), from_si(float(x.max()), unit)
    size = max(high - low, 1e-9)
    step = 10.0 ** math.floor(math.log10(size / MOST_BOXES))
    step = next(step * k for k in (1, 2, 5, 10, 20) if size / (step * k) <= MOST_BOXES - 1)
    first = math.floor(low / step)
    count = math.floor(high / step) + 1 - first
    return np.array([to_si((first + k) * step, unit) for k in range(count + 1)])


def _course(m: Misfit) -> Course:
    window = max(1, round(1.0 / m.dt))
    rms, worst = {}, {}
    for s in SERIES:
        square = getattr(m, s) ** 2
        rms[s] = math.sqrt(float(square.mean()))
        running = np.convolve(square, np.full(window, 1 / window), mode="valid")
        k = int(np.argmax(running))
        worst[s] = (m.start + (k + 0.5 * (window - 1)) * m.dt, math.sqrt(float(running[k])))
    return Course(m.record, rms, worst)


def validity_json(v: Validity) -> dict[str, Any]:
    """Of station.diagnose/1; SI."""
    return {
        "envelope": {f"{a}": list(span) for a, span in v.envelope.items()},
        "boxes": [
            {
                "series": b.series,
                b.axes[0]: list(b.first),
                b.axes[1]: list(b.second),
                "seconds": b.seconds,
                "rms": b.rms,
                "fails": b.fails,
            }
            for b in v.boxes
        ],
        "manoeuvres": [
            {
                "record": c.record,
                "rms": c.rms,
                "worst": {s: {"at_s": at, "rms": rms} for s, (at, rms) in c.worst.items()},
            }
            for c in v.courses
        ],
    }


def validity_lines(v: Validity) -> list[str]:
    """Where it fails worst, and the envelope."""
    spans = ", ".join(f"{words(a, *span)}" for a, span in v.envelope.items())
    lines = [f"envelope flown: {spans}; beyond it nothing is known"]
    for s in SERIES:
        own = [b for b in v.boxes if b.series == s]
        failing = sorted((b for b in own if b.fails), key=lambda b: -b.rms)
        said = f"{s} holds in {len(own) - len(failing)} of {len(own)} boxes of the map"
        if failing:
            b = failing[0]
            at = " and ".join(words(a, *span) for a, span in zip(b.axes, (b.first, b.second), strict=True))
            said += f"; worst at {at}: {b.rms:.1f} times what noise and gusts let expect"
        lines.append(said)
    return lines


def words(axis: str, low: float, high: float) -> str:
    """A range along an axis."""
    unit = AXES[axis]
    return f"{axis} {from_si(low, unit):.3g} to {from_si(high, unit):.3g} {unit}"

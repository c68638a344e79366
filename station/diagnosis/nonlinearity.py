"""Whether an instrument, or what answers it, is nonlinear.

Each sensor is given a share of what is even in its signal: of its deviation from the mean of the manoeuvre, squared (it
bends), and of that deviation's size (it shows more one way than the other). What does not lie on a straight line is
else taken for something else: a vane that bends shows, with every pull-up, a gust that never was, and flow that leaves
the wing takes its lift back. Even shapes alone: noise, which is symmetric, is in the signal as in the residual, and
of an odd shape would make a share where there is none.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from station.diagnosis.candidate import Estimate, numbers
from station.diagnosis.likelihood import Problem
from station.diagnosis.refits import CONFOUNDED
from station.diagnosis.score_test import FALSE_ALARM, scores
from station.diagnosis.series_spectra import spectra

Array = NDArray[np.float64]

SHAPES: Final = {"square": np.square, "size": np.abs}
STRAIGHT: Final = ("v_along", "v_down", "v_across")
"""Velocities are counted, not sensed through a characteristic: they have no shape."""


class Nonlinear(NamedTuple):
    """A sensor whose signal, or what answers it, has an even part."""

    sensor: str
    shape: str
    """Of SHAPES."""
    share: float
    """SI."""
    log_p: float
    """Of as much by chance."""
    others: tuple[str, ...] = ()
    """Sensors of which that explains as much."""

    @property
    def words(self) -> str:
        instead = "".join(f" or {sensor}" for sensor in self.others)
        share = f"{self.share:+.2g} (SI) of the {self.shape} of its deviation from its mean"
        return f"{self.sensor}{instead} is nonlinear, or what answers it is: {share}; no effect of the catalogue"


def nonlinear(problem: Problem, e: Estimate) -> Nonlinear | None:
    """The sensor that has an even part by all series that are judged, if that is beyond chance."""
    made, common = problem.manoeuvres, set.intersection(*(set(m.trim.sensors) for m in problem.manoeuvres))
    common -= {*STRAIGHT}
    sensors = [s for s in made[0].trim.sensors if s in common and all(s in m.record.signals for m in made)]
    asked = [(s, shape) for s in sensors for shape in SHAPES]
    gained, share, told = scores(_whitened(problem, e, asked), len(e.state.values), e.state.a)
    best = int(gained.argmax())
    log_p = float(chi2.logsf(gained[best], 1))
    if log_p > math.log(FALSE_ALARM / max(told.sum(), 1)):
        return None
    sensor, shape = asked[best]
    near = [asked[i][0] for i in np.argsort(-gained) if gained[best] - gained[i] < CONFOUNDED]
    others = [s for s in dict.fromkeys(near) if s != sensor]
    return Nonlinear(sensor, shape, float(share[best]), log_p, tuple(others))


def _whitened(problem: Problem, e: Estimate, asked: list[tuple[str, str]]) -> tuple[Array, Array, Array]:
    """Of all manoeuvres: residuals (n,), slopes of what is fitted (p, n), and shares of 1 of what is `asked` (k, n)."""
    parts: list[tuple[Array, Array, Array]] = []
    for k, (m, response, slopes) in enumerate(zip(problem.manoeuvres, e.state.responses, e.slopes, strict=True)):
        inverse = np.linalg.inv(e.state.roots[k])
        signals = (m.record.signals[sensor] for sensor, _ in asked)
        even = np.stack([SHAPES[shape](x - x.mean()) for x, (_, shape) in zip(signals, asked, strict=True)])
        bins = spectra(even[:, None], m.setting, (0,), False).bins[:, 0]
        by_sensor = inverse @ response[..., [m.trim.sensors.index(sensor) for sensor, _ in asked]]
        parts.append(
            (
                numbers(e.state.white[k].reshape(1, -1))[0],
                numbers(np.ascontiguousarray((inverse @ slopes.bins.transpose(2, 1, 0)).transpose(2, 0, 1))),
                numbers(np.ascontiguousarray(by_sensor.transpose(2, 0, 1) * bins[..., None])),
            )
        )
    residuals, fitted, shares = (np.concatenate(x, axis=-1) for x in zip(*parts, strict=True))
    return residuals, fitted, shares

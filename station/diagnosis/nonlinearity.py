"""Whether an instrument, or what answers it, is nonlinear.

Each sensor is given a share of its deviation from the mean of the manoeuvre squared (it bends), of the size of that
deviation (it shows more one way than the other), and of the sign of its rate or the direction of its last and next
motion (it sticks: Coulomb friction, play; the first tells less play where gusts never let it rest, the second tells
what rests in between). What is not linear is else taken for something else: a vane that bends shows, with every
pull-up, a gust that never was, and flow that leaves the wing takes its lift back; one that sticks shows upwash with a
memory, or comes late. Noise is in the signal as in the residual, and of any other shape would make a share where there
is none: of these, the first two are even in it, and of the others noise has neither more nor less than it would have
the other way round in time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from station.diagnosis.backlash import lost_motion
from station.diagnosis.candidate import Estimate, numbers
from station.diagnosis.likelihood import Problem
from station.diagnosis.processing import HIGH_HZ, Setting, back, passed, transform
from station.diagnosis.refits import CONFOUNDED
from station.diagnosis.score_test import FALSE_ALARM, scores
from station.diagnosis.series_spectra import spectra

Array = NDArray[np.float64]


PASS_HZ: Final = (HIGH_HZ, 1.5 * HIGH_HZ)
"""A signal's motion is passed up to the first and stopped from the second: no more is judged."""
MOTION: Final = 0.1 * math.sqrt(2)
"""Of its standard deviation, that a signal has moved by when it has a direction: a tenth of the amplitude of a sine of
that power. Counted on 12 flights with 0.3 to 0.6 deg of play of a vane at 0 to 5 ft/s: with half of it a vane's play in
calm air gains half as much, for noise turns it, and with twice as much any gains half."""


def _deviation(x: Array) -> Array:
    return np.asarray(x - x.mean())


def _rate_sign(x: Array, s: Setting) -> Array:
    """The sign of the rate of what is judged of a signal."""
    return np.sign(back(1j * s.omega * passed(s.omega, PASS_HZ) * transform(x, s), s))


def _direction(x: Array, s: Setting) -> Array:
    """From -1 to 1: the mean of the directions in which a signal moved last and moves next, so that between two motions
    against each other, where a part with play goes from one end of it to the other, it is 0."""
    judged = back(passed(s.omega, PASS_HZ) * transform(x, s), s)
    play = MOTION * float(judged.std())
    if play == 0.0:
        return np.zeros(len(x))
    last, after = (-lost_motion(y, play) / (0.5 * play) for y in (judged, judged[::-1]))
    return 0.5 * (last - after[::-1])


SHAPES: Final[dict[str, Callable[[Array, Setting], Array]]] = {
    "square of its deviation from its mean": lambda x, _: _deviation(x) ** 2,
    "size of its deviation from its mean": lambda x, _: np.abs(_deviation(x)),
    "sign of its rate": _rate_sign,
    "direction of its motion": _direction,
}
STRAIGHT: Final = ("v_along", "v_down", "v_across")
"""Velocities are counted, not sensed through a characteristic: they have no shape."""


class Nonlinear(NamedTuple):
    """A sensor whose signal, or what answers it, has a share of one of SHAPES."""

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
        share = f"at least {self.share:+.2g} (SI) of the {self.shape}"  # noise in a shape makes its share smaller
        return f"{self.sensor}{instead} is nonlinear, or what answers it is: {share}; no effect of the catalogue"


def nonlinear(problem: Problem, e: Estimate) -> Nonlinear | None:
    """The sensor that is so by all series that are judged, if that is beyond chance."""
    made, common = problem.manoeuvres, set.intersection(*(set(m.trim.sensors) for m in problem.manoeuvres))
    common -= {*STRAIGHT}
    sensors = [s for s in made[0].trim.sensors if s in common and all(s in m.record.signals for m in made)]
    asked = [(s, shape) for s in sensors for shape in SHAPES]
    gained, share, told = scores(_whitened(problem, e, asked), len(e.state.values), e.state.a, problem.known)
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
        shapes = np.stack([SHAPES[shape](m.record.signals[sensor], m.setting) for sensor, shape in asked])
        bins = spectra(shapes[:, None], m.setting, (0,), False).bins[:, 0]
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

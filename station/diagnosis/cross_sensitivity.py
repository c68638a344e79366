"""Whether an instrument shows a share of what another one measures.

Attitude, velocities, gyros and accelerometers are compared with each other by kinematics alone: what remains of that is
their noise, and goes with nothing that is measured. A gyro that feels accelerations or an axis that is not square shows
there; by itself it hides well, as a zero (a gyro's sensitivity to acceleration, at 1 g) and slow noise. Each sensor is
given a share of each other signal, beside all else that is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from station.diagnosis.candidate import Estimate, numbers
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.refits import CONFOUNDED
from station.diagnosis.score_test import FALSE_ALARM, scores
from station.diagnosis.series_spectra import INTEGRALS, spectra

Array = NDArray[np.float64]


class Crossed(NamedTuple):
    """A sensor that shows a share of a signal."""

    sensor: str
    signal: str
    share: float
    """SI units of one by the other."""
    log_p: float
    """Of as much by chance."""
    others: tuple[tuple[str, str], ...] = ()
    """Sensors and signals that explain as much: an attitude that goes with the vertical speed is a rate that goes with
    the acceleration."""

    @property
    def words(self) -> str:
        instead = "".join(f", or of {sensor} to {signal}" for sensor, signal in self.others)
        of = f"cross-sensitivity of {self.sensor} to {self.signal}"
        return f"{of} by {self.share:+.2g} (SI){instead}: no effect of the catalogue"


def crossed(problem: Problem, e: Estimate) -> Crossed | None:
    """The pair of a sensor and another's signal that the kinematic series show best, if it is beyond chance."""
    common = set.intersection(*(set(m.trim.sensors) for m in problem.manoeuvres))
    sensors = [s for s in problem.manoeuvres[0].trim.sensors if s in common]
    signals = [s for s in sensors if all(s in m.record.signals for m in problem.manoeuvres)]
    if not signals or not any(_kinematic(m) for m in problem.manoeuvres):
        return None
    pairs = [(s, x) for s in sensors for x in signals]
    white = _whitened(problem, e, sensors, signals)
    gained, share, told = scores(white, len(e.state.values), e.state.a, problem.known)
    told &= np.array([s != x for s, x in pairs])
    gained = np.where(told, gained, 0.0)
    best = int(gained.argmax())
    log_p = float(chi2.logsf(gained[best], 1))
    if log_p > math.log(FALSE_ALARM / max(told.sum(), 1)):
        return None
    others = [pairs[i] for i in np.argsort(-gained)[1:] if gained[best] - gained[i] < CONFOUNDED]
    return Crossed(*pairs[best], float(share[best]), log_p, tuple(others))


def _kinematic(m: Manoeuvre) -> list[int]:
    """Rows of the series without aerodynamics, among those judged."""
    return [row for row, j in enumerate(m.setting.judged) if j < INTEGRALS]


def _whitened(
    problem: Problem, e: Estimate, sensors: Sequence[str], signals: Sequence[str]
) -> tuple[Array, Array, Array]:
    """Of the kinematic series of all manoeuvres: residuals (n,), slopes of what is fitted (p, n), and what a share of
    each signal in each sensor would be (sensors x signals, n); by the noise of these series alone, in which no gust
    is."""
    parts: list[tuple[Array, Array, Array]] = []
    for k, (m, response, slopes) in enumerate(zip(problem.manoeuvres, e.state.responses, e.slopes, strict=True)):
        rows = _kinematic(m)
        b = m.columns(response)[:, rows]
        inverse = np.linalg.inv(np.linalg.cholesky((b * e.state.levels.of(k)) @ np.conj(b.swapaxes(-1, -2))))
        shown = np.stack([m.record.signals[x] for x in signals])
        bins = spectra(shown[:, None], m.setting, (0,), False).bins[:, 0]
        by_sensor = inverse @ response[:, rows][:, :, [m.trim.sensors.index(s) for s in sensors]]
        shares = by_sensor.transpose(2, 0, 1)[:, None] * bins[None, :, :, None]
        parts.append(
            (
                numbers((inverse @ e.state.spectra[k].bins[rows].T[..., None]).reshape(1, -1))[0],
                numbers(np.ascontiguousarray((inverse @ slopes.bins[:, rows].transpose(2, 1, 0)).transpose(2, 0, 1))),
                numbers(np.ascontiguousarray(shares.reshape(-1, *shares.shape[2:]))),
            )
        )
    residuals, fitted, all_shares = (np.concatenate(x, axis=-1) for x in zip(*parts, strict=True))
    return residuals, fitted, all_shares

"""The misfit of a diagnosed aircraft's lift and moment over time, from the residuals that the diagnosis judges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.memo import Memo
from station.diagnosis.model_validity import Misfit
from station.diagnosis.procedure import Diagnosis
from station.diagnosis.processing import highest_hz
from station.diagnosis.residuals import LIFT, MOMENT, flow_angle, series
from station.profile import Aircraft

Array = NDArray[np.float64]

_ROWS: Final = (LIFT, MOMENT)


def misfits(found: Diagnosis) -> list[Misfit]:
    """Of every manoeuvre, fitted and held out, in which lift and moment can be judged. Those held out have the noise
    of the noisiest fitted."""
    levels = found.found.accepted.state.levels
    own = [levels.of(k) for k in range(len(found.problem.manoeuvres))]
    variances = [*own, *(np.max(own, axis=0) for _ in found.held_out)]
    manoeuvres: Sequence[Manoeuvre] = (*found.problem.manoeuvres, *found.held_out)
    pairs = zip(manoeuvres, variances, strict=True)
    return [_misfit(m, found.after, v) for m, v in pairs if set(_ROWS) <= set(m.setting.judged)]


def _misfit(m: Manoeuvre, aircraft: Aircraft, variances: Array) -> Misfit:
    own, s = m.loaded(aircraft), m.setting
    low = signal.butter(4, highest_hz(s.dt), fs=1 / s.dt, output="sos")
    made = series(m.record.signals, own, s)[..., _ROWS, :]
    # The ends, which filters join, are not judged: neither here nor by the likelihood.
    judged = slice(s.cut, s.n - s.cut)
    here = signal.sosfiltfilt(low, made, axis=-1)[..., judged]
    # Trim is free: what remains of the mean is no misfit.
    here = here - here.mean(axis=-1, keepdims=True)
    # Sensors and gusts alone: what the model misses is what is looked for. Bins are those of a white series.
    count = len(variances) - len(m.axis.missed)
    columns = m.columns(m.responses(aircraft))[..., :count]
    power = (np.abs(columns) ** 2 * variances[:count]).sum(-1).sum(0) / ((s.n - 2 * s.cut) / 2)
    rows = [s.judged.index(k) for k in _ROWS]
    lift, moment = here / np.sqrt(power[rows])[:, None]
    x = m.record.signals
    alpha, speed, elevator = (y[judged] for y in (flow_angle(x, own, s, Memo()), x["airspeed"], x["elevator"]))
    return Misfit(m.record.name, s.dt, alpha, speed, elevator, lift, moment, s.cut * s.dt)

"""The misfit of a diagnosed aircraft's lift and moment over time, from the residuals that the diagnosis judges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from station.diagnosis.model_validity import Misfit
from station.diagnosis.procedure import Diagnosis
from station.diagnosis.processing import HIGH_HZ
from station.diagnosis.reference import Reference, loaded, spread
from station.diagnosis.residuals import LIFT, MOMENT, series
from station.profile import Aircraft

Array = NDArray[np.float64]

_ROWS: Final = (LIFT, MOMENT)


def misfits(found: Diagnosis) -> list[Misfit]:
    """Of every manoeuvre, fitted and held out, in which lift and moment can be judged."""
    gusts = [*found.found.accepted.gust, *(r.gust_guess for r in found.held_out)]
    references: Sequence[Reference] = (*found.problem.references, *found.held_out)
    pairs = zip(references, gusts, strict=True)
    return [_misfit(r, found.after, gust) for r, gust in pairs if set(_ROWS) <= set(r.setting.judged)]


def _misfit(r: Reference, aircraft: Aircraft, gust: float) -> Misfit:
    own = loaded(aircraft, r.record, r.mass_share, r.iyy_share)
    low = signal.butter(4, min(HIGH_HZ, 0.35 / r.record.dt), fs=1 / r.record.dt, output="sos")

    def residuals(of: Reference) -> Array:
        made = series(of.record.signals, own, of.setting)[..., _ROWS, :]
        return np.asarray(signal.sosfiltfilt(low, made - made.mean(axis=-1, keepdims=True), axis=-1))

    # Trim is free: what remains of the mean is no misfit.
    here = residuals(r)
    noise = (residuals(r.with_more_noise()) - here).std(axis=(0, -1))
    calm, turbulent = (np.einsum("mii->i", x).real for x in spread(r.bins))
    rows = [r.setting.judged.index(k) for k in _ROWS]
    more = np.sqrt(1 + gust**2 * turbulent[rows] / calm[rows])
    lift, moment = here / (noise * more)[:, None]
    x = r.record.signals
    return Misfit(r.record.name, r.record.dt, r.flow_angle(aircraft), x["airspeed"], x["elevator"], lift, moment)

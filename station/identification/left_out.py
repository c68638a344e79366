"""What the linear equations of one axis leave out, and what that does to their derivatives.

Motion of the other axis: an aircraft is not quite symmetric nor its sensors quite in line, and what keeps it straight
answers the manoeuvre. Curvature, where it stands out of the residuals: lift and moment bend where the angle of attack
comes near the stall, and change with speed. Least squares with such a term and without it differ by what its absence
does; the standard errors of every method hold the difference. Source: Klein and Morelli 2006, section 5.4 (which terms
a model needs).

Gusts: wing and tail meet them one after the other, and later than the vane. Without a tail in the profile, or by a vane
that is late itself, no method knows when; where most of the angle of attack is gust, derivatives would be of that.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, detrend, sosfiltfilt

from station.conventions import LATERAL, LONGITUDINAL, LONGITUDINAL_BODY
from station.estimation.acceptance import EXCITED
from station.estimation.flight_record import FlightRecord
from station.estimation.results import Axes, Equation, equations, regress
from station.identification.instrument_bias import contradicted, filtered
from station.identification.instrument_table import MOSTLY, InstrumentTable
from station.model.instrument_lags import GUST_HZ
from station.numerics.regression import Fit, NotIdentifiable

Array = NDArray[np.float64]

SURE: Final = 3.0
"""Standard errors, of coloured residuals, by which a term that is left out stands out."""
MOST: Final = 0.5
"""Share of the gusts in the energy of the angle of attack above which most of it is gust."""
LEAST: Final = 1e-12
"""Energy of a signal that stands still."""


def left_out(record: FlightRecord, axes: Axes) -> dict[str, float]:
    """By how much each derivative differs with the terms that its equation lacks and the record shows."""
    if not np.isfinite(record.alpha).any():
        return {}
    c, m = record.coefficients, record.motion
    longitudinal = {"alpha_vane": record.alpha, "q": c.qhat, "elevator": m["elevator"]}
    lateral = {"beta_vane": record.beta, "p": c.phat, "r": c.rhat}
    lateral |= {n: m[n] for n in ("aileron", "rudder") if record.has(n)}
    if not record.has("beta_vane", "p", "r"):
        lateral = {}
    others = [x for n, x in lateral.items() if _moves(record, n)]
    curved = [(record.alpha - np.nanmean(record.alpha)) ** 2, m["airspeed"] / np.nanmean(m["airspeed"]) - 1]
    found: dict[str, float] = {}
    for equation in equations(record, axes):
        if equation.parameters[0] in LATERAL:
            across, bent = [x for n, x in longitudinal.items() if _moves(record, n)], []
        else:
            across, bent = others, curved
        k, first = len(equation.parameters), len(equation.parameters) + len(across)
        try:
            own = whole = _fitted(record, equation, [])
            if bent:
                whole = _fitted(record, equation, [*across, *bent])
                stands_out = np.abs(whole.estimate[first:-1]) > SURE * whole.se_coloured[first:-1]
                bent = [x for x, keep in zip(bent, stands_out, strict=True) if keep]
            if not (across or bent):
                continue
            whole = _fitted(record, equation, [*across, *bent])
        except (NotIdentifiable, np.linalg.LinAlgError):
            continue
        apart = (whole.estimate[:k] - own.estimate[:k]).tolist()
        found |= dict(zip(equation.parameters, apart, strict=True))
    return found


def _fitted(record: FlightRecord, equation: Equation, more: list[Array]) -> Fit:
    return regress(record, replace(equation, regressors=np.column_stack([equation.regressors, *more])))[0]


def _moves(record: FlightRecord, name: str) -> bool:
    """Whether a signal's motion stands out of its noise."""
    x = record.motion[name]
    good = record.usable & np.isfinite(x)
    noise = record.noise.get(name, 0.0)
    return bool(good.any() and np.mean(detrend(x[good]) ** 2) > EXCITED * noise**2 + LEAST)


def knows_gusts(record: FlightRecord) -> bool:
    """Whether there is what tells when a gust arrives: a boom, and the tail behind it. The motion that they are told
    from is integrated from rates and accelerations, whatever attitude and path the record has beside."""
    aircraft = record.aircraft
    return aircraft.boom is not None and aircraft.unsteady.tail_arm > 0


def mostly_gusts(record: FlightRecord, instruments: InstrumentTable | str | None) -> dict[str, str]:
    """Why no longitudinal derivative can be had, by their names, where gusts move the angle of attack more than the
    aircraft does and no method knows when wing and tail meet them; empty if one can."""
    if not isinstance(instruments, InstrumentTable) or not math.isfinite(instruments.gust_sd):
        return {}
    if "alpha_vane" in filtered(record, contradicted(record, instruments)):
        lacking, mend = "the vane is too late to show when they come", "move the elevator more"
    elif knows_gusts(record):
        return {}
    else:
        lacking, mend = "no method knows when the tail meets them", "move the elevator more, or state unsteady.tail_arm"
    good = record.usable & np.isfinite(record.alpha)
    low, high = GUST_HZ
    if good.mean() < MOSTLY or 1 / record.dt <= 2 * high:
        return {}
    band = butter(2, (low, high), "bandpass", fs=1 / record.dt, output="sos")
    alpha = np.interp(record.t_s, record.t_s[good], record.alpha[good])
    energy = float(np.mean(sosfiltfilt(band, detrend(alpha)) ** 2))
    share = (instruments.gust_sd / float(np.nanmean(record.motion["airspeed"]))) ** 2 / max(energy, LEAST)
    if share <= MOST:
        return {}
    why = f"most of the angle of attack is gusts ({instruments.gust_sd:.2f} m/s), and {lacking}: {mend}"
    return dict.fromkeys((*LONGITUDINAL, *LONGITUDINAL_BODY), why)

"""What errors of the instruments, which the others contradict, do to derivatives.

A vane that is late by T reads alpha - T alphadot, and with the angle of attack go its derivatives: the rate derivative
takes up T 2V/c of the angle's. No residual shows it, but the instruments show it among themselves, before any
aerodynamics (instrument_table.py). Least squares on the record as it is, and with its signals as their instruments'
lags and scales would have them, differ by what that does; the standard errors of every method hold the difference.

Source: Morelli 1995 (data compatibility before identification); Klein and Morelli 2006, sections 9.4 and 10.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from station.estimation.flight_record import FlightRecord, flow_angles
from station.estimation.results import Axes, equations, regress
from station.identification.instrument_table import InstrumentTable
from station.model.coefficients import coefficients
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]

SURE: Final = 3.0
"""Standard deviations of a lag or a scale beyond which instruments contradict each other."""
LATE_S: Final = 0.02
"""A lag that is no error of an instrument: unsteady upwash and the vane on its spring make it as late."""
REGRESSED: Final = ("alpha_vane", "q", "az", "ax", "airspeed", "beta_vane", "p", "r", "ay")
"""What the equations are made of; velocities over ground are not in them."""


def contradicted(record: FlightRecord, table: InstrumentTable) -> dict[str, tuple[float, float]]:
    """Lag (s) and scale, beyond what the profile says, of each instrument that the others contradict."""
    scale_known = record.aircraft.uncertainty.vane_scale
    found = {}
    for row in table.rows:
        lag, scale = 0.0, 1.0
        if not row.lag.why:
            beyond = row.lag.value - row.stated.get("lag", 0.0)
            lag = beyond if abs(beyond) > max(SURE * row.lag.sd, LATE_S) else 0.0
        if not row.scale.why:
            share = row.scale.value / row.stated.get("scale", 1.0)
            scale = share if abs(share - 1) > max(SURE * row.scale.sd / row.scale.value, scale_known) else 1.0
        if row.signal in REGRESSED and (lag, scale) != (0.0, 1.0):
            found[row.signal] = lag, scale
    return found


def undone(record: FlightRecord, errors: Mapping[str, tuple[float, float]]) -> FlightRecord:
    """The record with its signals as they were before those lags and scales."""
    motion = dict(record.motion)
    for name, (lag, scale) in errors.items():
        x = motion[name]
        good = np.isfinite(x)
        moved = CubicSpline(record.t_s[good], x[good], extrapolate=False)(record.t_s + lag)
        motion[name] = np.where(good, moved, np.nan) / scale
    alpha, beta = flow_angles(motion, record.aircraft)
    made = coefficients(motion, record.airframe, alpha, record.dt)
    return replace(record, motion=motion, alpha=alpha, beta=beta, coefficients=made)


def biases(record: FlightRecord, table: InstrumentTable | str, axes: Axes) -> tuple[dict[str, float], str]:
    """By how much each derivative differs by the instruments that the others contradict, and these in words."""
    errors = {} if isinstance(table, str) else contradicted(record, table)
    if not errors:
        return {}, ""
    before, after = _estimates(record, axes), _estimates(undone(record, errors), axes)
    words = []
    for name, (lag, scale) in errors.items():
        parts = [f"{abs(1e3 * lag):.0f} ms {'late' if lag > 0 else 'early'}"] if lag else []
        parts += [f"scale {scale:.3g}"] if scale != 1.0 else []
        words.append(f"{name} {' and '.join(parts)}")
    return {n: after[n] - x for n, x in before.items() if n in after}, "; ".join(words)


def _estimates(record: FlightRecord, axes: Axes) -> dict[str, float]:
    """Least squares' of every equation that has a solution."""
    found: dict[str, float] = {}
    for equation in equations(record, axes):
        try:
            fit, _ = regress(record, equation)
        except (NotIdentifiable, np.linalg.LinAlgError):
            continue
        found |= dict(zip(equation.parameters, fit.estimate.tolist(), strict=False))
    return found

"""What a record shows without aerodynamics: instrument errors, the vane's calibration, and its gust arrival offset.

From the longest stretch without gaps; a part that cannot be had is the reason in words. SI, rad.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.model.compatibility import Compatibility, compatibility, through_vane
from station.model.gust_delay import GustDelay, gust_delay
from station.model.gust_model import Equation
from station.model.inertial_path import InertialPath, inertial_path
from station.model.vane_calibration import VaneCalibration, calibrate_vane
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]
T = TypeVar("T")

LONGEST_S: Final = 300.0
CLOSED_S: Final = 60.0
"""Of that, the part that is integrated open loop."""
WANTED: Final = ("phi", "theta", "psi", "p", "r", "ay", "beta_vane", "v_north", "v_east", "v_down")
"""Optional: a record that has them is cut to a stretch that has them throughout."""
LEAST_ROWS: Final = 2
MOSTLY: Final = 0.5
"""A signal present in a smaller share of the rows is omitted."""
LEAST_HZ: Final = 25.0
"""For the gust's arrival."""


@dataclass(frozen=True, slots=True)
class Kinematics:
    """Each part, or why there is none, from `rows` of the record; the reconstruction from those of `closed`."""

    rows: slice
    closed: slice
    compatibility: Compatibility | str
    vane: VaneCalibration | str
    delay: GustDelay | str

    @property
    def any_found(self) -> bool:
        return not all(isinstance(part, str) for part in (self.compatibility, self.vane, self.delay))


def kinematics(record: FlightRecord) -> Kinematics:
    """All three parts of a record. Never raises: a part that cannot be had is the reason."""
    rows = _longest(record)
    closed = slice(rows.start, min(rows.stop, rows.start + round(CLOSED_S / record.dt)))
    if rows.stop - rows.start < LEAST_ROWS:
        why = "no stretch without gaps"
        return Kinematics(rows, closed, why, why, why)

    def cut(at: slice) -> dict[str, Array]:
        return {n: c[at] for n, c in record.motion.items() if np.isfinite(c[at]).all()}

    alpha, beta, vane = _as_the_vanes_show(record, closed)
    has_beta = record.has("beta_vane")
    made = _attempt(lambda: compatibility(cut(closed), alpha, beta if has_beta else None, record.dt, vane))
    motion = cut(rows)
    return Kinematics(
        rows,
        closed,
        made,
        _attempt(lambda: _vane(record, motion, rows)),
        _attempt(lambda: _delay(record, motion, rows)),
    )


def _attempt(make: Callable[[], T]) -> T | str:
    try:
        return make()
    except NotIdentifiable as refusal:
        return str(refusal)
    except (np.linalg.LinAlgError, FloatingPointError):
        return "the record does not determine it: a singular solution"


def _longest(record: FlightRecord) -> slice:
    good = record.usable & np.isfinite(record.alpha)
    for name in WANTED:
        column = record.motion.get(name)
        # A signal that is mostly missing is omitted, rather than cutting the stretch to its rows.
        if column is not None and np.isfinite(column).mean() > MOSTLY:
            good &= np.isfinite(column)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8))).reshape(-1, 2)
    if not len(edges):
        return slice(0, 0)
    start, end = (int(x) for x in edges[int(np.argmax(edges[:, 1] - edges[:, 0]))])
    return slice(start, min(end, start + round(LONGEST_S / record.dt)))


def _as_the_vanes_show(record: FlightRecord, rows: slice) -> tuple[Array, Array, tuple[float, float] | None]:
    """Angles of attack and sideslip at the CG, all of them seen through the vanes' dynamics, and these dynamics: the
    record subtracted the rate terms without the vanes' lag."""
    boom, motion, dt = record.aircraft.boom, record.motion, record.dt
    alpha, beta = record.alpha[rows], record.beta[rows]
    if boom is None:
        return alpha, beta, None
    vane = (boom.vane_frequency, boom.vane_damping)
    by_vane = (motion["alpha_vane"][rows] - boom.zero) * boom.steady_calibration
    by_side = motion["beta_vane"][rows] if "beta_vane" in motion else np.zeros_like(beta)
    turning = (through_vane(alpha - by_vane, vane, dt), through_vane(beta - by_side, vane, dt))
    return by_vane + turning[0], by_side + turning[1], vane


def _vane(record: FlightRecord, motion: Mapping[str, Array], rows: slice) -> VaneCalibration:
    if "theta" not in motion or "v_down" not in motion:
        raise NotIdentifiable("no inertial angle of attack: no theta and v_down throughout")
    # The air velocity that gives the wind must not rest on the vane that is to be calibrated.
    level = motion["theta"] + motion["v_down"] / motion["airspeed"]
    boom = record.aircraft.boom
    side = record.beta[rows] if boom and record.has("beta_vane") else np.zeros(len(level))
    path = inertial_path(motion, level, side, record.dt, wind_down=0.0)
    arm = boom.vane_x if boom else 0.0
    noise = record.noise.get("theta", 0.0)
    return calibrate_vane(motion["alpha_vane"], path.alpha, arm * motion["q"] / path.speed, record.dt, noise)


def _delay(record: FlightRecord, motion: Mapping[str, Array], rows: slice) -> GustDelay:
    if record.aircraft.kinematics_only:
        raise NotIdentifiable("the aircraft profile is for kinematics only")
    if record.dt > 1 / LEAST_HZ:
        raise NotIdentifiable(f"recorded at {1 / record.dt:.3g} Hz: needs {LEAST_HZ:g} Hz")
    path: InertialPath = inertial_path(motion, record.alpha[rows], record.beta[rows], record.dt)
    measured: dict[Equation, Array] = {"CL": record.coefficients.CL[rows]}
    moment = record.coefficients.Cm[rows]
    if np.isfinite(moment).all():
        measured["Cm"] = moment
    return gust_delay(motion, path, measured, record.aircraft, record.noise, record.dt)

"""A flight record for post-flight identification: one uniform grid, gaps marked, angle of attack at the CG.

SI, rad. The angle of attack is the vane's, corrected for bias, steady upwash and pitch rate (alpha =
(vane - zero)/(1 + k_u0) + q x/V), as in method II; without a boom in the profile the vane's own reading.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, detrend, sosfiltfilt

from station.conventions import ANGLES_THAT_WRAP, BRIDGED_S, FRESH_AGE_S, MIN_SPEED, SIGNALS
from station.model.coefficients import (
    Airframe,
    Coefficients,
    at_centre_of_gravity,
    coefficients,
    thrust_by_drag_polar,
)
from station.model.thrust import thrust_by_engine
from station.numerics.atmosphere import air_densities
from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.regression import NotIdentifiable
from station.numerics.turbulence import HIGH_HZ, LOW_HZ, classified
from station.profile import Aircraft
from station.rows import Quality

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STRICT: Final = ("alpha_vane", "q", "ax", "az", "elevator")
"""Signals that must be measured at the row's own time: a held one counts as missing."""
NEEDED: Final = (*STRICT, "airspeed")
SAME_S: Final = 1e-4
"""Instants this close are one."""
SAME_RATE: Final = 1e-6
"""Relative difference from a whole number of Hz that is rounding."""
EVEN: Final = 0.01
"""Share of a step that the steps of a uniform grid may differ by."""
SLOWEST_S: Final = 1 / 15
"""Step of a record in which the turbulence can be seen,"""
LEAST_S: Final = 2.0
"""its length,"""
LEAST_SHARE: Final = 0.5
"""and the share of its rows that must have a gust."""
LEAST_ROWS: Final = 10


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """`t_s` (n,) uniform with step `dt`; `motion` signals (n,) at the CG, short gaps bridged; `usable` (n,) rows that
    have all that equation error needs; `noise` standard deviations."""

    t_s: Array
    dt: float
    motion: Mapping[str, Array]
    usable: Flags
    alpha: Array
    beta: Array
    coefficients: Coefficients
    airframe: Airframe
    aircraft: Aircraft
    noise: Mapping[str, float]
    remarks: tuple[str, ...] = field(default=())
    why_no_thrust: str = ""
    """Why it is what the drag polar leaves over; "" where it is recorded or told by the profile's engine."""

    @classmethod
    def of(
        cls,
        t_s: Array,
        columns: Mapping[str, Array],
        aircraft: Aircraft,
        *,
        quality: Mapping[str, NDArray[np.uint8]] | None = None,
        ages: Mapping[str, Array] | None = None,
        extra: Mapping[str, Array] | None = None,
        imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
        noise: Mapping[str, float] | None = None,
    ) -> FlightRecord:
        """From a table's columns, with quality and age (s) of their values. Raises NotIdentifiable for one that no
        method can use, saying why."""
        missing = [name for name in NEEDED if name not in columns or not np.isfinite(columns[name]).any()]
        if missing:
            raise NotIdentifiable(f"the record has no {', '.join(missing)}")
        if len(t_s) < LEAST_ROWS:
            raise NotIdentifiable(f"the record has {len(t_s)} rows: too short")
        remarks: list[str] = []
        cleaned = {n: accepted(n, c, (quality or {}).get(n)) for n, c in columns.items() if n in SIGNALS}
        t_s = np.asarray(t_s, dtype=np.float64)
        cleaned = {n: _redated(t_s, c, ages[n], n) if ages and n in ages else c for n, c in cleaned.items()}
        grid, dt, motion = _uniform(t_s, cleaned, remarks)
        motion = {n: _bridged(c, dt, n) for n, c in motion.items()}
        motion["dynamic_pressure"] = _dynamic_pressure(motion, aircraft)
        slow = motion["airspeed"] < MIN_SPEED
        if slow.all():
            raise NotIdentifiable(f"airspeed stays below {MIN_SPEED:g} m/s")
        usable = np.all([np.isfinite(motion[n]) for n in (*NEEDED, "dynamic_pressure")], axis=0) & ~slow
        motion = at_centre_of_gravity(motion, aircraft.imu_at(imu_position), dt)
        # Next to a gap of the rates the angular acceleration is unknown, and with it the correction of an IMU's place.
        usable &= np.isfinite(motion["ax"]) & np.isfinite(motion["az"])
        airframe = _airframe(aircraft, motion.get("mass"), extra, len(grid) == len(t_s))
        alpha, beta = flow_angles(motion, aircraft)
        lacking = ""
        if "thrust" not in motion:
            push = _by_engine(aircraft, motion, remarks)
            if isinstance(push, str):
                lacking, push = push, _thrust(motion, airframe, aircraft, alpha, usable, remarks)
            motion["thrust"] = push
        return cls(
            t_s=grid,
            dt=dt,
            motion=motion,
            usable=usable,
            alpha=alpha,
            beta=beta,
            coefficients=coefficients(motion, airframe, alpha, dt),
            airframe=airframe,
            aircraft=aircraft,
            noise={**DEFAULT_NOISE, **{k: v for k, v in (noise or {}).items() if v > 0}},
            remarks=tuple(remarks),
            why_no_thrust=lacking,
        )

    @property
    def thrust_known(self) -> bool:
        """Whether it is recorded, or told by the profile's engine."""
        return not self.why_no_thrust

    def has(self, *names: str) -> bool:
        """Whether the record has all these signals."""
        return all(n in self.motion and np.isfinite(self.motion[n]).any() for n in names)

    @property
    def mean_density(self) -> float:
        """Of the air, kg/m3."""
        return float(np.nanmean(2 * self.motion["dynamic_pressure"] / self.motion["airspeed"] ** 2))

    def require_complete(self) -> None:
        """Raises NotIdentifiable where rows are missing, saying when and for how long."""
        bad = np.flatnonzero(~self.usable)
        if len(bad):
            at = self.t_s[bad[0]]
            raise NotIdentifiable(f"{len(bad) * self.dt:.2f} s lack a needed signal, first at {at:.2f} s")

    def turbulence(self, gust_vertical: Array | None = None) -> tuple[str, float]:
        """Class and standard deviation (m/s) of the vertical gust in 2-7 Hz; "unknown" and NaN if it cannot be had.

        `gust_vertical` (n,), m/s, NaN where unknown; without it that of alpha times V, which includes the motion.
        """
        if self.dt > SLOWEST_S:
            return "unknown", float("nan")
        w = self.alpha * self.motion["airspeed"] if gust_vertical is None else gust_vertical
        good = np.isfinite(w)
        if good.sum() * self.dt < LEAST_S or good.mean() < LEAST_SHARE:
            return "unknown", float("nan")
        w = np.interp(self.t_s, self.t_s[good], w[good])
        sos = butter(4, [LOW_HZ, HIGH_HZ], "bandpass", fs=1 / self.dt, output="sos")
        band = sosfiltfilt(sos, detrend(w))
        level = float(np.std(band[good]))
        speed = float(np.nanmean(self.motion["airspeed"]))
        return classified(level, speed, self.noise["alpha_vane"], self.dt), level


def accepted(name: str, column: Array, quality: NDArray[np.uint8] | None) -> Array:
    """NaN where the value is suspect, missing or impossible, or held where it must not be."""
    signal = SIGNALS[name]
    column = np.asarray(column, dtype=np.float64)
    bad = ~((column >= signal.low) & (column <= signal.high))
    if quality is not None:
        bad |= quality >= (Quality.HELD if name in STRICT else Quality.SUSPECT)
    return np.where(bad, np.nan, column)


def _redated(t: Array, column: Array, age: Array, name: str) -> Array:
    """A signal that was held between its samples, at the times that these were measured and straight between them."""
    known = np.isfinite(column) & np.isfinite(age)
    held = known & (age > FRESH_AGE_S)
    if not held.any():
        return column
    measured = (t - age)[known]
    before = np.concatenate(([-np.inf], np.maximum.accumulate(measured)[:-1]))
    new = measured > before + SAME_S
    made = column.copy()
    made[held] = _straight(t[held], measured[new], column[known][new], name)
    return made


def _straight(at: Array, t: Array, values: Array, name: str) -> Array:
    """Linear interpolation; of an angle that wraps the short way round: half-way from 179 to -179 deg is 180, not 0."""
    if name not in ANGLES_THAT_WRAP:
        return np.asarray(np.interp(at, t, values))
    turned, good = values.copy(), np.isfinite(values)
    turned[good] = np.unwrap(values[good])
    return np.asarray(np.remainder(np.interp(at, t, turned) + np.pi, 2 * np.pi) - np.pi)


def _uniform(t: Array, columns: Mapping[str, Array], remarks: list[str]) -> tuple[Array, float, dict[str, Array]]:
    """The columns on a uniform grid: as they are if theirs is one, else by linear interpolation."""
    steps = np.diff(t)
    if (steps <= 0).any():
        raise NotIdentifiable("time does not increase")
    dt = float(np.median(steps))
    rate = round(1 / dt)
    if rate > 0 and abs(dt * rate - 1) < SAME_RATE:
        dt = 1 / rate
    if np.max(np.abs(steps - dt)) < EVEN * dt:
        return t, dt, dict(columns)
    grid = t[0] + dt * np.arange(int(np.floor((t[-1] - t[0]) / dt + 1e-6)) + 1)
    remarks.append(f"time steps vary from {steps.min():.4g} to {steps.max():.4g} s: interpolated every {dt:.4g} s")
    after = np.clip(np.searchsorted(t, grid, "left"), 1, len(t) - 1)
    far = (t[after] - t[after - 1]) > BRIDGED_S + dt
    made = {}
    for name, column in columns.items():
        value = _straight(grid, t, column, name)
        value[far & (np.abs(grid - t[after]) > SAME_S) & (np.abs(grid - t[after - 1]) > SAME_S)] = np.nan
        made[name] = value
    return grid, dt, made


def _bridged(column: Array, dt: float, name: str) -> Array:
    """Gaps up to BRIDGED_S filled by a straight line; longer ones, and those at the ends, left."""
    bad = ~np.isfinite(column)
    if not bad.any() or bad.all():
        return column
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(np.int8)))
    filled = column.copy()
    good = np.flatnonzero(~bad).astype(np.float64)
    known = column[~bad]
    for start, end in edges.reshape(-1, 2):
        if start > 0 and end < len(column) and (end - start) * dt <= BRIDGED_S + 1e-9:
            filled[start:end] = _straight(np.arange(start, end, dtype=np.float64), good, known, name)
    return filled


def _dynamic_pressure(motion: Mapping[str, Array], aircraft: Aircraft) -> Array:
    """Pa: as measured, else rho V^2/2 by atmosphere.air_density."""
    v = motion["airspeed"]
    measured = motion.get("dynamic_pressure", np.full(len(v), np.nan))
    air = (motion.get(name, np.full(len(v), np.nan)) for name in ("static_pressure", "air_temperature", "altitude"))
    density = air_densities(np.nan if aircraft.air_density is None else aircraft.air_density, *air)
    filled: Array = np.where(measured > 0, measured, 0.5 * density * v * v)
    if not np.isfinite(filled).any():
        raise NotIdentifiable("the record has neither dynamic pressure nor signals that give the air density")
    return filled


def _thrust(
    motion: Mapping[str, Array],
    airframe: Airframe,
    aircraft: Aircraft,
    alpha: Array,
    usable: Flags,
    remarks: list[str],
) -> Array:
    """N, constant: on average what ax shows beyond the profile's drag polar. Left in CX it would add T/(qbar S) to
    CL_alpha."""
    if aircraft.drag is None or not usable.any():
        remarks.append("thrust not recorded: counted as 0, and CX, CL and Cm hold it")
        return np.zeros(len(alpha))
    force = motion["dynamic_pressure"] * airframe.area
    inertial = airframe.mass * motion["ax"], airframe.mass * motion["az"]
    polar = aircraft.drag.zero_lift, aircraft.drag.induced
    push = thrust_by_drag_polar(inertial, force, polar, airframe.thrust_angle, np.sin(alpha), np.cos(alpha))
    mean = float(np.mean(push[usable]))
    remarks.append(f"thrust not recorded: taken as {mean:.0f} N throughout, from the profile's drag polar")
    return np.full(len(alpha), mean)


def _by_engine(aircraft: Aircraft, motion: Mapping[str, Array], remarks: list[str]) -> Array | str:
    """N, by the profile's engine where its setting is recorded; where it says nothing, what it last said. Or why there
    is none."""
    push = thrust_by_engine(aircraft, motion)
    if push is None or aircraft.engine is None:
        return "thrust is not recorded"
    good = np.isfinite(push)
    if good.mean() < LEAST_SHARE:
        remarks.append(f"the engine's table says nothing of {1 - good.mean():.0%} of the record: it is not used")
        return remarks[-1]
    if not good.all():
        remarks.append(f"the engine's table is exceeded in {1 - good.mean():.0%} of the record: thrust held there")
        push = push[good][np.maximum(np.cumsum(good) - 1, 0)]
    share = 100 * aircraft.engine.uncertainty
    remarks.append(f"thrust by the profile's engine: {np.mean(push):.0f} N on average, known to {share:.2g} %")
    return push


def _airframe(aircraft: Aircraft, mass: Array | None, extra: Mapping[str, Array] | None, same_grid: bool) -> Airframe:
    """The profile's airframe with the record's own mass and, where it has them, inertias."""
    airframe = Airframe.of(aircraft, mass)
    if not extra or not same_grid:
        return airframe
    inertias: dict[str, Any] = {n: extra[n] for n in ("ixx", "iyy", "izz", "ixz") if n in extra}
    return replace(airframe, **inertias)


def flow_angles(motion: Mapping[str, Array], aircraft: Aircraft) -> tuple[Array, Array]:
    """Angle of attack and sideslip (n,) at the CG, from the vanes' where these are."""
    vane = motion["alpha_vane"]
    beta = motion.get("beta_vane", np.zeros(len(vane)))
    boom = aircraft.boom
    if boom is None:
        return vane, beta
    v = motion["airspeed"]
    with np.errstate(divide="ignore", invalid="ignore"):
        alpha = (vane - boom.zero) * boom.steady_calibration + motion["q"] * boom.vane_x / v
        if "r" in motion:
            beta = beta - motion["r"] * boom.vane_x / v
        if "p" in motion:
            # A vane off the roll axis.
            alpha = alpha - motion["p"] * boom.vane_y / v
            beta = beta + motion["p"] * boom.vane_z / v
    return alpha, beta

"""Inertial motion of a whole record: flow angles and speed relative to the mean wind, without lag.

Attitude and velocity over ground are the low-frequency part, body rates and specific force the high one: each stream is
corrected towards its integral by a zero-phase Gaussian (0.5 s), so that noise and coarse sampling of the streams go and
nothing is delayed. Air velocity less ground velocity, averaged over the record, is the mean wind. SI, rad; body axes
x forward, z down; earth NED.

Sources: Klein and Morelli 2006, equations 3.29-3.32 and 10.6; Martos 2013, equations 2-6 (wind as ground less air
velocity, lever arm of the vane).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from station.conventions import G0, ned_from_body
from station.numerics.regression import NotIdentifiable

Array = NDArray[np.float64]

BLEND_S: Final = 0.5
NEEDED: Final = ("theta", "v_down", "airspeed", "q", "az")


@dataclass(frozen=True, slots=True)
class InertialPath:
    """(n,) each, at the CG: attitude (n, 3), velocity over ground (n, 3), velocity through the mean air in body axes
    (n, 3), its flow angles and magnitude. `wind` (3,) NED, m/s; components that no stream measures are 0."""

    attitude: Array
    velocity: Array
    body: Array
    alpha: Array
    beta: Array
    speed: Array
    wind: Array

    def between(self, rows: slice) -> InertialPath:
        """Some of the rows; the wind stays that of all."""
        return replace(
            self,
            attitude=self.attitude[rows],
            velocity=self.velocity[rows],
            body=self.body[rows],
            alpha=self.alpha[rows],
            beta=self.beta[rows],
            speed=self.speed[rows],
        )


def euler_rates(attitude: Array, rates: Array) -> Array:
    """phi, theta, psi dot (n, 3), rad/s, from body rates p, q, r (n, 3)."""
    phi, theta = attitude[:, 0], attitude[:, 1]
    p, q, r = rates.T
    turn = q * np.sin(phi) + r * np.cos(phi)
    return np.column_stack(
        [p + np.tan(theta) * turn, q * np.cos(phi) - r * np.sin(phi), turn / np.maximum(np.cos(theta), 0.05)]
    )


def air_velocity(speed: Array, alpha: Array, beta: Array) -> Array:
    """u, v, w (n, 3) of a true airspeed at its flow angles: atan2(w, u) = alpha, asin(v / speed) = beta."""
    return np.column_stack(
        [speed * np.cos(alpha) * np.cos(beta), speed * np.sin(beta), speed * np.sin(alpha) * np.cos(beta)]
    )


def inertial_path(
    motion: Mapping[str, Array], alpha: Array, beta: Array, dt: float, wind_down: float | None = None
) -> InertialPath:
    """From signals (n,) at the CG on a uniform grid, all finite; `alpha`, `beta` (n,) of the air, at the CG.

    `wind_down`: the mean vertical wind where it is known; estimated, it also holds the vane's bias times the speed.

    Missing phi, p, r and ay count as 0, a missing heading as the track's, missing horizontal velocities as the air's.
    Raises NotIdentifiable where attitude or vertical velocity is lacking.
    """
    n = len(alpha)

    def column(name: str) -> Array | None:
        found = motion.get(name)
        return found if found is not None and np.isfinite(found).all() else None

    lacking = [name for name in NEEDED if column(name) is None]
    if lacking:
        raise NotIdentifiable(f"no inertial angle of attack: no {', '.join(lacking)} throughout")
    zero = np.zeros(n)

    def signal(name: str) -> Array:
        found = column(name)
        return zero if found is None else found

    north, east = column("v_north"), column("v_east")
    heading = column("psi")
    if heading is None:
        heading = zero if north is None or east is None else np.arctan2(east, north)
    raw = np.column_stack([signal("phi"), signal("theta"), np.unwrap(heading)])
    rates = np.column_stack([signal("p"), signal("q"), signal("r")])
    attitude = _blended(raw, euler_rates(raw, rates), dt)
    turned = ned_from_body(*attitude.T)
    air = air_velocity(signal("airspeed"), alpha, beta)
    through_air = np.einsum("nij,nj->ni", turned, air)
    ground = np.column_stack(
        [through_air[:, 0] if north is None else north, through_air[:, 1] if east is None else east, signal("v_down")]
    )
    force = np.column_stack([signal("ax"), signal("ay"), signal("az")])
    acceleration = np.einsum("nij,nj->ni", turned, force)
    acceleration[:, 2] += G0
    velocity = _blended(ground, acceleration, dt)
    wind = np.mean(velocity - through_air, axis=0)
    if wind_down is not None:
        wind[2] = wind_down
    body = np.einsum("nij,ni->nj", turned, velocity - wind)
    speed = np.linalg.norm(body, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        side = np.arcsin(np.clip(body[:, 1] / speed, -1.0, 1.0))
    return InertialPath(attitude, velocity, body, np.arctan2(body[:, 2], body[:, 0]), side, speed, wind)


def _blended(measured: Array, slope: Array, dt: float) -> Array:
    """The integral of `slope` (n, m), drawn to `measured` below the Gaussian's band; the ends are mirrored oddly."""
    integral = np.zeros_like(measured)
    integral[1:] = np.cumsum(0.5 * (slope[1:] + slope[:-1]) * dt, axis=0)
    difference = measured - integral
    pad = min(len(difference) - 1, round(4 * BLEND_S / dt))
    # Odd reflection goes on with a drift's slope beyond the ends, where even reflection would bend it.
    extended = np.pad(difference, ((pad, pad), (0, 0)), mode="reflect", reflect_type="odd")
    smooth: Array = gaussian_filter1d(extended, BLEND_S / dt, axis=0, mode="nearest")[pad : pad + len(difference)]
    return integral + smooth

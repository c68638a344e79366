"""What attitude, rates, accelerations and velocities say of the motion, and the airspeed with them, without
aerodynamics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0
from station.diagnosis.air_data import STILL, Unseen, air_data, own_motion
from station.diagnosis.processing import Setting, between_fresh, integral, own_speed, rate, sinking_line, without_line
from station.diagnosis.stacked import some, together
from station.model import coefficients
from station.profile import Aircraft

Array = NDArray[np.float64]

OF_MOTION: Final = (
    *("theta", "q", "ax", "az", "airspeed", "dynamic_pressure", "phi", "p", "r", "v_down", "v_along", "altitude"),
)
"""The signals that it is made of."""


class Motion(NamedTuple):
    """What attitude, rate, accelerations and velocities say, without aerodynamics; each (..., n)."""

    q: Array
    qdot: Array
    ax: Array
    az: Array
    differences: Array
    """(..., 3, n): THETA, DOWN, NORTH."""
    theta: Array
    down: Array
    base: Array
    """Speed through the air but for its mean: over ground where that is recorded, else along the path."""
    over_ground: bool
    mean_speed: Array
    airspeed: Array
    pressure: Array
    own: Array
    """The airspeed that accelerations and gusts across the path let expect, m/s."""
    across: Array
    """How far gusts across the path turn the flow at the CG, nearly, rad."""
    faster: Array
    """What they make of the airspeed, over it without them."""


def motion_of(x: Mapping[str, Array], aircraft: Aircraft, s: Setting, unseen: Unseen = STILL) -> Motion:
    """What instruments say of the motion, of signals (..., n) without their errors."""
    theta, q = x["theta"], x["q"]
    imu = aircraft.imu_at(s.imu)
    qdot = rate(q, s)
    p, r = x.get("p", 0.0), x.get("r", 0.0)
    # Roll and yaw acceleration matter to these two axes only where the imu is beside the plane of symmetry.
    pdot, rdot = (rate(x[n], s) if some(imu[1]) and n in x else 0.0 for n in ("p", "r"))
    ax, _, az = coefficients.specific_force_at_cg((x["ax"], 0.0, x["az"]), (p, q, r), (pdot, qdot, rdot), imu)
    bank = x.get("phi")
    turned = q if bank is None or "r" not in x else q * np.cos(bank) - x["r"] * np.sin(bank)
    level = 1.0 if bank is None else np.cos(bank)
    cos, sin = np.cos(theta), np.sin(theta)
    climb = integral(az * cos * level - ax * sin + G0, s)
    along = integral(ax * cos + az * sin * level, s)
    if s.rebuilt:
        down = without_line(climb) if "altitude" not in x else climb - sinking_line(x["altitude"], climb, s)
    else:
        down = between_fresh(x["v_down"], climb, s.held.get("v_down"))
    own = own_motion(x["airspeed"], along, down, s)
    across = np.zeros(s.n) if s.gust_across is None else s.gust_across + unseen.up / own
    lying = aircraft.unsteady.gust_tilt * (theta + np.arcsin(np.clip(down / own, -1, 1)))
    # They leave the velocity as it is that is square to them, and turn the flow.
    faster = np.cos(lying) / np.cos(lying + across)
    own = own * faster
    v, pressure = air_data(x["airspeed"], x["dynamic_pressure"], own, s, unseen.noise)
    ground = between_fresh(x["v_along"], along, s.held.get("v_along")) if "v_along" in x else None
    north = np.zeros_like(along) if ground is None else ground - along
    out = together([theta - integral(turned, s), down - climb, north])
    base = own_speed(v, along, s) if ground is None else ground
    base, mean = base - base.mean(-1, keepdims=True), v.mean(-1, keepdims=True)
    return Motion(q, qdot, ax, az, out, theta, down, base, ground is not None, mean, v, pressure, own, across, faster)

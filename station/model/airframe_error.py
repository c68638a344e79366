"""What a wrong mass or inertia of the profile, or a wrong position error, does to a derivative: forces are mass times
acceleration, moments inertia times angular acceleration, and coefficients are these over the dynamic pressure, so that
all derivatives of a coefficient are wrong by the same share, and no residual shows it. So with the scale of what
measures a surface, and all derivatives by that surface.

Roll and yaw have one matrix of inertia. With each of its moments and its product wrong by a share of its own,

    dCl = e_x Ixx p' - e_xz Ixz r',       dCn = e_z Izz r' - e_xz Ixz p'
    p' = (Izz Cl + Ixz Cn)/D,          r' = (Ixz Cl + Ixx Cn)/D

and D = Ixx Izz - Ixz^2: where an aileron rolls and hardly yaws, most of what Cn_da is wrong by is a share of Cl_da.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.profile import Aircraft

Array = NDArray[np.float64]

MOMENTS: Final = ("Cm", "Cl", "Cn")
RATES: Final = ("q", "p", "r")
BY_RATES: Final = 0.5
"""Share of the dynamic pressure's error in derivatives by rates: these are multiplied by the root of it, q c/2V."""
BY_SURFACES: Final = ("de", "da", "dr")


def relative_errors(aircraft: Aircraft, names: Sequence[str], *, of_inertia: bool = True) -> Array:
    """Standard deviation of each derivative, over its value, where the mass is the profile's and where it is recorded,
    (2, names); those of Cl and Cn each as if there were no product of inertia."""
    u = aircraft.uncertainty
    inertia = u.inertia if of_inertia else 0.0

    def error(name: str, force: float) -> float:
        to = name.rpartition("_")[2]
        air = u.dynamic_pressure * (BY_RATES if to in RATES else 1.0)
        surface = u.surface_scale if to in BY_SURFACES else 0.0
        return math.hypot(inertia if name[:2] in MOMENTS else force, air, surface)

    return np.array([[error(n, force) for n in names] for force in (u.mass, u.recorded_mass)])


def roll_and_yaw_errors(aircraft: Aircraft, roll: Array, yaw: Array) -> tuple[Array, Array]:
    """Standard deviations of derivatives of Cl and Cn by the same variables, (n,) each, by the inertias alone."""
    i, share = aircraft.inertia, aircraft.uncertainty.inertia
    if i.ixx is None or i.izz is None:
        return share * np.abs(roll), share * np.abs(yaw)
    scale = i.ixx * i.izz - i.ixz**2
    rolled, yawed = (i.izz * roll + i.ixz * yaw) / scale, (i.ixz * roll + i.ixx * yaw) / scale
    return share * np.hypot(i.ixx * rolled, i.ixz * yawed), share * np.hypot(i.izz * yawed, i.ixz * rolled)

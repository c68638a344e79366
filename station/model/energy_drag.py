"""Drag from energy: what thrust puts in and the motion does not show, at every moment of a flight, without a manoeuvre.

    D V = T V cos(alpha + sigma) - m V a_V,     a_V = ax cos alpha + az sin alpha

m V a_V is the rate at which the aircraft's energy relative to the air grows, m (g hdot + V Vdot) in air that moves
steadily; by accelerometer it is free of gusts along the path. dCD = (power put in - power shown - that of the profile's
polar)/(V qbar S): a performance monitor. Over windows of some seconds gusts' share of a_V averages out.

SI. Sources: Deiler and Fezans 2020, J. Aircraft 57(4): power imbalance as an equivalent drag coefficient, to tell ice
indirectly; Klein and Morelli 2006, equations 3.37.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.model.coefficients import Airframe
from station.profile import Aircraft

Array = NDArray[np.float64]

WINDOW_S: Final = 5.0
"""Long against the short period, short against a phugoid and a throttle."""
FULLEST: Final = 0.5
"""Share of a window's rows that must be usable."""
FEWEST: Final = 3
"""Windows, for a scatter."""
CORRELATED: Final = 2.0
"""Windows within the scale of turbulence along the path (533 m at 60 m/s, 9 s) count as one."""


@dataclass(frozen=True, slots=True)
class EnergyDrag:
    """Means over windows of WINDOW_S, (n,) each; `t_s` their middles."""

    t_s: Array
    CD: Array
    CL: Array
    expected: Array
    """CD of the profile's polar at CL; NaN without one."""
    imbalance: Array
    """Power put in that neither motion nor polar shows, W; NaN without a polar."""
    systematic: float
    """Standard deviation common to all windows: of thrust, mass, angle of attack and accelerometer."""
    by_motion: float
    """The same of the angle of attack's scale as far as it moves, which a flight in trim does not have: lift and angle
    of attack rise together, and what is wrong with the one in proportion to itself is drag on the mean."""

    @property
    def change(self) -> Array:
        """dCD against the polar, (n,)."""
        return self.CD - self.expected

    def random(self, values: Array) -> float:
        """Standard error of the mean of `values` (n,) by their scatter; NaN for too few windows."""
        if len(values) < FEWEST:
            return math.nan
        return float(np.std(values, ddof=1)) / math.sqrt(max(len(values) / CORRELATED, 1.0))


def drag_by_energy(
    motion: Mapping[str, Array],
    airframe: Airframe,
    aircraft: Aircraft,
    alpha: Array,
    t_s: Array,
    thrust_error: float | None = None,
) -> EnergyDrag:
    """Of a record on a uniform grid `t_s` (n,).

    `motion` holds (n,) each, SI, at the CG: airspeed, dynamic_pressure, ax, az, thrust, NaN where missing; `alpha` (n,)
    rad at the CG. `thrust_error`: standard deviation of the thrust over its value; the profile's where left out.
    """
    a, u = airframe, aircraft.uncertainty
    v, thrust = motion["airspeed"], motion["thrust"]
    force = motion["dynamic_pressure"] * a.area
    along = thrust * np.cos(alpha + a.thrust_angle)
    sin, cos = np.sin(alpha), np.cos(alpha)
    shown = a.mass * (motion["ax"] * cos + motion["az"] * sin)
    lift = a.mass * (motion["ax"] * sin - motion["az"] * cos) - thrust * np.sin(alpha + a.thrust_angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        cd, cl = (along - shown) / force, lift / force
    polar = aircraft.drag
    expected = np.full(len(cd), math.nan) if polar is None else polar.zero_lift + polar.induced * cl**2
    imbalance = v * force * (cd - expected)
    means = _windows(t_s, {"t": t_s, "CD": cd, "CL": cl, "expected": expected, "imbalance": imbalance})
    share = u.thrust if thrust_error is None else thrust_error
    mass = u.recorded_mass if "mass" in motion and np.isfinite(motion["mass"]).any() else u.mass
    size = np.array([np.nanmean(x) if np.isfinite(x).any() else math.nan for x in (along / force, shown / force, cl)])
    per_newton = float(np.nanmean(a.mass / force))
    # Drag is wrong by CL times what the angle of attack is wrong by.
    both = np.isfinite(cl) & np.isfinite(alpha)
    together = float(np.cov(cl[both], alpha[both])[0, 1]) if both.sum() > 1 else math.nan
    scale = u.vane_scale if aircraft.boom else 0.0
    parts = (share * size[0], mass * size[1], u.vane_zero * size[2], u.ax_zero * per_newton, scale * together)
    return EnergyDrag(
        t_s=means["t"],
        CD=means["CD"],
        CL=means["CL"],
        expected=means["expected"],
        imbalance=means["imbalance"],
        systematic=float(np.sqrt(sum(float(x) ** 2 for x in parts))),
        by_motion=scale * abs(together),
    )


def _windows(t_s: Array, columns: Mapping[str, Array]) -> dict[str, Array]:
    """Means of the rows that have CD, over each window that has enough of them."""
    good = np.isfinite(columns["CD"])
    number = ((t_s - t_s[0]) / WINDOW_S + 1e-9).astype(np.int64)
    # What is left at the end is too short for a window of its own.
    full = np.bincount(number)
    counted = np.bincount(number[good], minlength=len(full))
    kept = np.flatnonzero((counted >= FULLEST * full.max()) & (counted > 0))
    made = {}
    for name, x in columns.items():
        totals = np.bincount(number[good], weights=x[good], minlength=len(full))
        made[name] = totals[kept] / counted[kept]
    return made

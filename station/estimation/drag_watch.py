"""CD_0 in flight against the baseline's, by the power that the flight shows, where thrust is known, and CL_0.

Means of 10 s, in a cumulative sum (Page 1954) set for a rise by DRAG_TOLD, its limit by Siegmund's approximation of the
time between false alarms. A mean that cannot be made leaves drag unwatched, and `lacking` says why.
CL_0 of the same means (steady_lift) tells a vane whose zero has moved, which is drag too: a change where the mean of
the last RECENT_BLOCKS lies off by more than chance gives in FALSE_ALARM_H.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from station.conventions import SIGNAL_INDEX, TICK_HZ
from station.model.steady_lift import SteadyLift, induced_doubt, level_lift, outside
from station.profile import Aircraft
from station.rows import AlphaEstimate, Frame

FALSE_ALARM_H: Final = 20.0
"""Hours between false alarms of either watch: together one in ten."""
BLOCK_S: Final = 10.0
"""Over which drag is a mean."""
DRAG_TOLD: Final = 0.2
"""Rise of CD_0, of itself, that the sum is set for: two fifths of the reference icing condition's."""
KNOWN_WITHIN: Final = 2.0
"""Standard deviations that the baseline's CD_0 is allowed to be off before a rise counts."""
LEAST_SIGMA: Final = 0.25
"""Of DRAG_TOLD, that a mean is taken to scatter at least: a single mean that is off is no alarm."""
FIRST_SIGMA: Final = 0.5
FIRST_BLOCKS: Final = 6
"""The scatter that is taken before it is seen, of DRAG_TOLD, and how many means it counts for."""
FIRST_LIFT_SIGMA: Final = 0.005
"""As that, of CL_0: 0.05 deg in the mean angle of attack, four times what gusts of 10 ft/s were seen to make."""
SEEN_BLOCKS: Final = 30
"""Over which the scatter is seen."""
RECENT_BLOCKS: Final = 3
"""Whose mean is what drag is now."""
_V, _QBAR, _AX, _AZ, _MASS, _RATE, _ELEVATOR = (
    SIGNAL_INDEX[n] for n in ("airspeed", "dynamic_pressure", "ax", "az", "mass", "q", "elevator")
)
_NEEDED: Final = {"dynamic pressure": _QBAR, "ax": _AX, "az": _AZ}


def limit_of_sum(shift: float, blocks: float) -> float:
    """Of a cumulative sum of values of variance 1 less `shift`, reached by chance once in so many of them on average
    (Siegmund 1985: (exp(2 d b) - 2 d b - 1)/(2 d^2), b = h + 1.166)."""

    def excess(b: float) -> float:
        return math.expm1(2 * shift * b) - 2 * shift * b - 2 * shift**2 * blocks

    return max(float(brentq(excess, 1e-6, 40.0 / max(2 * shift, 1e-3))) - 1.166, 0.1)


class Scatter:
    """The variance of means by how they differ one from the next (von Neumann et al. 1941): what changes slowly is not
    in it."""

    def __init__(self, first: float) -> None:
        """`first`: the standard deviation taken before it is seen."""
        self.variance = first**2
        self._counts = FIRST_BLOCKS
        self._last = math.nan

    def see(self, mean: float) -> None:
        if math.isfinite(mean - self._last):
            self.variance += (0.5 * (mean - self._last) ** 2 - self.variance) / min(self._counts, SEEN_BLOCKS)
            self._counts += 1
        self._last = mean


class DragWatch:
    """CD_0 against the baseline's."""

    def __init__(self, aircraft: Aircraft) -> None:
        measured = aircraft.measured
        self._base = measured.CD_0 if measured else None
        self._allowed = KNOWN_WITHIN * measured.CD_0_sd if measured else 0.0
        self._area, self._mass = aircraft.geometry.wing_area, aircraft.inertia.mass
        self._cos, self._sin = math.cos(aircraft.thrust_angle), math.sin(aircraft.thrust_angle)
        self._induced = aircraft.drag.induced if aircraft.drag else 0.0
        self._aircraft = aircraft
        self._lift_base = (measured.CL_0, measured.CL_0_sd) if measured and measured.CL_0 else None
        self._lift_limit = float(norm.isf(0.5 * RECENT_BLOCKS * BLOCK_S / (FALSE_ALARM_H * 3600)))
        self._clear()
        self._step = (self._base or 0.0) * DRAG_TOLD
        self._scatter = Scatter(FIRST_SIGMA * self._step)
        self._lift_scatter = Scatter(FIRST_LIFT_SIGMA)
        self.cumulated = 0.0
        self.limit = math.inf
        self._recent: list[float] = []
        self._lifts: list[SteadyLift] = []
        self._by_lift = 0.0
        self._outside = 0.0
        """Of the lift that the baseline had, the newest mean's."""
        self.means = 0
        """Of drag, so far."""
        self._without = ""
        self.lacking = ""
        """Why the last mean could not be made; "" where it could, or the first one is under way."""

    @property
    def is_on(self) -> bool:
        return self._base is not None and self._base > 0

    @property
    def told(self) -> bool:
        return self.cumulated > self.limit

    @property
    def change(self) -> tuple[float, float] | None:
        """Relative, with its standard error, told or not: that drag has not risen tells one change from another too."""
        if not self._recent or not self._base:
            return None
        error = math.sqrt(self._scatter.variance / len(self._recent)) + 0.5 * self._allowed + abs(self._by_lift)
        return float(np.mean(self._recent)) / self._base - 1.0, error / self._base

    @property
    def now(self) -> tuple[float, float] | None:
        """CD_0 of the last means and its standard error, without the baseline's; None before there is one."""
        if not self._recent:
            return None
        random = math.sqrt(self._scatter.variance / len(self._recent))
        return float(np.mean(self._recent)), math.hypot(random, self._by_lift)

    @property
    def lift(self) -> float:
        """CL of the newest mean; NaN before there is one."""
        return self._lifts[-1].lift if self._lifts else math.nan

    @property
    def lift_change(self) -> tuple[float, float] | None:
        """Of CL_0, relative, with its standard error; None where the baseline has none, or a signal is missing."""
        base = self._lift_base
        if base is None or len(self._lifts) < RECENT_BLOCKS:
            return None
        values = np.array([x.at_zero(self._aircraft) for x in self._lifts])
        if not np.isfinite(values).all():
            return None
        newest = self._lifts[-1]
        shares = newest.by_mass(self._aircraft), newest.by_slope(self._aircraft, self._outside)
        error = math.hypot(math.sqrt(self._lift_scatter.variance / len(values)), *shares, base[1])
        return float(np.mean(values)) / base[0] - 1.0, error / abs(base[0])

    @property
    def lift_told(self) -> bool:
        change = self.lift_change
        return change is not None and abs(change[0]) > self._lift_limit * change[1]

    def step(self, frame: Frame, alpha: AlphaEstimate, thrust: float, why_no_thrust: str) -> None:
        """One tick; `thrust` along the thrust line, N, NaN where nothing tells it, and why."""
        self._ticks += 1
        v = frame.values
        without = "" if alpha.valid else "no angle of attack"
        without = without or next((f"no {name}" for name, i in _NEEDED.items() if not math.isfinite(v[i])), "")
        without = without or ("" if math.isfinite(thrust) else why_no_thrust)
        if without:
            self._without = without
        elif v[_QBAR] > 0:
            mass = v[_MASS] if v[_MASS] > 0 else self._mass
            force = v[_QBAR] * self._area
            cx = (mass * v[_AX] - thrust * self._cos) / force
            cz = (mass * v[_AZ] + thrust * self._sin) / force
            sin, cos = math.sin(alpha.alpha), math.cos(alpha.alpha)
            lift = cx * sin - cz * cos
            self._sum += -cx * cos - cz * sin - self._induced * lift * lift
            self._lift += lift
            self._pressure += v[_QBAR] / max(v[_V], 1.0) ** 2 if math.isfinite(v[_V]) else math.nan
            self._alpha += alpha.alpha
            self._rate += v[_RATE] * self._aircraft.geometry.chord / (2.0 * max(v[_V], 1.0))
            self._elevator += v[_ELEVATOR]
            self._has_mass = bool(v[_MASS] > 0)
            self._count += 1
        if self._ticks >= BLOCK_S * TICK_HZ:
            if self._count > 0.5 * self._ticks:
                self.lacking = ""
                n = self._count
                mean = SteadyLift(
                    self._lift / n,
                    self._alpha / n,
                    self._rate / n,
                    self._elevator / n,
                    self._has_mass,
                    2 * self._pressure / n,
                )
                self._lifts = [*self._lifts[1 - RECENT_BLOCKS :], mean]
                self._block(self._sum / n, mean)
            else:
                self.lacking = self._without or "no dynamic pressure"
                # What drag was tells nothing of a change that comes while it is not seen.
                self._recent = self._recent if self.told else []
                self._lifts = []
            self._clear()

    def begin(self) -> None:
        """A new mean, of which nothing is lacking yet."""
        self.lacking = self._without = ""
        self._clear()

    def _clear(self) -> None:
        self._sum = self._lift = self._pressure = 0.0
        self._alpha = self._rate = self._elevator = 0.0
        self._count = self._ticks = 0
        self._has_mass = False

    def _block(self, drag: float, mean: SteadyLift) -> None:
        """A mean of BLOCK_S: CD_0, and the lift."""
        assert self._base is not None
        self._scatter.see(drag)
        self._lift_scatter.see(mean.at_zero(self._aircraft))
        sigma = max(math.sqrt(self._scatter.variance), LEAST_SIGMA * self._step)
        shift = 0.5 * self._step / sigma
        self.limit = limit_of_sum(shift, FALSE_ALARM_H * 3600 / BLOCK_S)
        between = level_lift(self._aircraft, mean.density)
        self._outside = outside(mean.lift, between)
        self._by_lift = induced_doubt(self._aircraft, mean.lift, between)
        excess = (drag - self._base - self._allowed - self._by_lift) / sigma
        self.cumulated = min(max(0.0, self.cumulated + excess - shift), 2 * self.limit)
        self._recent = [*self._recent[1 - RECENT_BLOCKS :], drag]
        self.means += 1

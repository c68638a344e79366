"""Nonlinear lift and moment that no derivative describes: nuisances where the aircraft's model may be in error.

Tables follow no low polynomial: the slopes of lift and moment may change anywhere in the flow angles that were flown,
that of the moment also in the elevator, by as much as a random walk of the slope would; and the moment may follow the
rate of the flow angle, as the classical models have it. None of it is named, nor written to a profile: it is what keeps
the aircraft's own shape from being taken for an instrument's error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.nuisances import Nuisance
from station.profile import Aircraft

Array = NDArray[np.float64]

Curve = Literal["lift", "moment", "elevator"]
SPACING: Final = math.radians(0.5)
"""Least distance of two knots of a table."""
MOST_KNOTS: Final = 25
SLOPE_WALK: Final = {"lift": 0.3, "moment": 0.3, "elevator": 0.1}
"""Standard deviation of a slope's change over _PER, over the slope itself."""
UNKNOWN_SLOPE: Final = {"lift": 5.0, "moment": 1.0, "elevator": 1.0}
"""That slope, where the profile states none."""
_PER: Final = math.radians(2.0)
_SLOPE_OF: Final = {"lift": "CL_alpha", "moment": "Cm_alpha", "elevator": "Cm_de"}
_LEAST: Final = 0.03
"""Shapes whose size is below this share of the largest are left out."""
BESIDE: Final = {"moment_rate": 10.0, "moment_cross": 3.0}
"""Standard deviations of Cm per alpha rate c/2V, and of Cm per alpha times elevator."""


class Nonlinear(Aircraft):
    """An aircraft whose lift and moment follow tables beside the profile's own terms."""

    alpha_knots: tuple[float, ...] = ()
    elevator_knots: tuple[float, ...] = ()
    lift: tuple[float, ...] = ()
    """CL at alpha_knots, constant beyond."""
    moment: tuple[float, ...] = ()
    """Cm at alpha_knots."""
    elevator_moment: tuple[float, ...] = ()
    """Cm at elevator_knots."""
    moment_rate: float = 0.0
    moment_cross: float = 0.0

    def more_lift(self, alpha: Array) -> Array:
        """CL beside the profile's."""
        return np.interp(alpha, self.alpha_knots, self.lift) if self.lift else np.zeros(1)

    def more_moment(self, alpha: Array, rate: Array, elevator: Array) -> Array:
        """Cm beside the profile's; `rate` is that of the flow angle times c/2V."""
        extra = self.moment_rate * rate
        if self.moment:
            extra = extra + np.interp(alpha, self.alpha_knots, self.moment)
        if self.elevator_moment:
            extra = extra + np.interp(elevator, self.elevator_knots, self.elevator_moment)
        if self.moment_cross:
            product = (alpha - alpha.mean(-1, keepdims=True)) * (elevator - elevator.mean(-1, keepdims=True))
            extra = extra + self.moment_cross * product
        return np.asarray(extra)


LEAST_VISITS: Final = 0.25
"""Least weight of a knot, over that of one among knots alike: a manoeuvre is short beside the flight about it."""


def nonlinear_priors(aircraft: Aircraft, alpha: Sequence[Array], elevator: Sequence[Array]) -> tuple[Nuisance, ...]:
    """The nuisances, from the flow angles (rad, by manoeuvre) and elevator angles that were flown."""
    out = []
    angles, deflections = _knots(np.concatenate(alpha)), _knots(np.concatenate(elevator))
    curves: dict[Curve, tuple[tuple[Array, Array], int]] = {
        "lift": (angles, 3), "moment": (angles, 3), "elevator": (deflections, 1),
    }  # fmt: skip
    for curve, ((knots, visits), power) in curves.items():
        slope = abs(aircraft.value(_SLOPE_OF[curve])) or UNKNOWN_SLOPE[curve]
        for k, shape in enumerate(_shapes(knots, visits, SLOPE_WALK[curve] * slope, power)):
            change = partial(_moved, curve=curve, knots=tuple(map(float, knots)), shape=shape)
            out.append(Nuisance(f"{curve} curve {k}", 1.0, change))
    for name, sd in BESIDE.items():
        out.append(Nuisance(name.replace("_", " "), sd, partial(_added, field=name)))
    return tuple(out)


def _knots(x: Array) -> tuple[Array, Array]:
    """Knots over the range of a signal, and how much of the time is spent about each."""
    low, high = np.quantile(x, [0.001, 0.999])
    high = max(high, low + 1e-3 * SPACING)  # a signal that stands still
    count = int(np.clip(math.ceil((high - low) / SPACING) + 1, 3, MOST_KNOTS))
    knots = np.linspace(low, high, count)
    place = np.clip((x - low) / (high - low), 0, 1) * (count - 1)
    whole = np.minimum(place.astype(np.int64), count - 2)
    part = place - whole
    visits = np.bincount(whole, 1 - part, count) + np.bincount(whole + 1, part, count)
    return knots, np.maximum(visits / len(x), LEAST_VISITS / count)


def _shapes(knots: Array, visits: Array, walk: float, power: int) -> Array:
    """(k, knots) principal shapes of a curve whose slope walks, each of its own standard deviation; what polynomials up
    to `power` make is left out: derivatives stand for it."""
    size = walk * math.sqrt((knots[1] - knots[0]) / _PER)
    hinges = size * np.maximum(knots[:, None] - knots[None, 1:-1], 0.0)
    root = np.sqrt(visits)[:, None]
    middle, half = 0.5 * (knots[0] + knots[-1]), 0.5 * (knots[-1] - knots[0])
    basis = np.linalg.qr(root * np.vander((knots - middle) / half, min(power + 1, len(knots) - 1)))[0]
    weighted = root * hinges
    weighted = weighted - basis @ (basis.T @ weighted)
    left, sizes, _ = np.linalg.svd(weighted, full_matrices=False)
    kept = sizes > _LEAST * max(float(sizes[0]), 1e-12)
    return np.asarray((left[:, kept] * sizes[kept] / root).T)


def _nonlinear(aircraft: Aircraft) -> Nonlinear:
    return aircraft if isinstance(aircraft, Nonlinear) else Nonlinear.model_construct(**dict(aircraft))


def _moved(aircraft: Aircraft, x: float, curve: Curve, knots: tuple[float, ...], shape: Array) -> Aircraft:
    old = _nonlinear(aircraft)
    field = "elevator_moment" if curve == "elevator" else curve
    at = "elevator_knots" if curve == "elevator" else "alpha_knots"
    before = np.array(getattr(old, field)) if getattr(old, field) else np.zeros(len(knots))
    return old.model_copy(update={at: knots, field: tuple(before + x * shape)})


def _added(aircraft: Aircraft, x: float, field: str) -> Aircraft:
    old = _nonlinear(aircraft)
    return old.model_copy(update={field: getattr(old, field) + x})

"""Whether two methods differ by their angle of attack alone: alpha_base = t_alpha alpha + t_q q c/2V + t_de de.

Any linear error of the angle of attack changes lift and moment derivatives by the same three numbers:
C_alpha' = t_alpha C_alpha, C_q' = C_q + t_q C_alpha, C_de' = C_de + t_de C_alpha. Where lift and moment disagree on
these by more than their errors, the methods differ by something else. Per radian.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from station.estimation.results import DOF, Axes, MethodResult
from station.rows import ParamEstimate

BASES: Final = ("II", "I", "sidpac")
"""Methods that the others are compared with: the first of these that applies."""
LONGITUDINAL_COUNT: Final = 6
TOLERANCE: Final = 0.1
"""Relative difference of lift's and moment's number that passes without regard to their errors."""
ALPHA_SIZE: Final = 0.5
"""What TOLERANCE of t_alpha is relative to."""
SIGMAS: Final = 2.0


@dataclass(frozen=True, slots=True)
class Transformation:
    """What one equation gives for the three numbers."""

    t_alpha: float
    t_q: float
    t_de: float


@dataclass(frozen=True, slots=True)
class Pair:
    """A method against the base: by the lift (or CZ) and the moment equation, and whether these agree."""

    method: str
    force: Transformation
    moment: Transformation
    agree: bool


@dataclass(frozen=True, slots=True)
class Consistency:
    """Every method against `base`."""

    base: str
    pairs: tuple[Pair, ...]


def consistency(results: Mapping[str, MethodResult], axes: Axes) -> Consistency | None:
    """Compare all methods with a base method; None where there are not two with numbers."""
    ok = {
        n: r
        for n, r in results.items()
        if r.parameters and all(math.isfinite(p.value) for p in r.parameters[:LONGITUDINAL_COUNT])
    }
    base = next((n for n in BASES if n in ok), None)
    if base is None or len(ok) == 1:
        return None
    force = "CL" if axes == "wind" else "CZ"
    reference = {p.name: p for p in ok[base].parameters}
    if any(reference[f"{c}_alpha"].value == 0 for c in (force, "Cm")):
        return Consistency(base, ())
    pairs = []
    for name, result in ok.items():
        if name == base:
            continue
        here = {p.name: p for p in result.parameters}
        by_force, force_error = _transformation(force, reference, here)
        by_moment, moment_error = _transformation("Cm", reference, here)
        agree = True
        for t in ("t_alpha", "t_q", "t_de"):
            a, b = getattr(by_force, t), getattr(by_moment, t)
            size = ALPHA_SIZE if t == "t_alpha" else max(abs(a), abs(b))
            errors = math.hypot(getattr(force_error, t), getattr(moment_error, t))
            agree = agree and abs(a - b) <= max(TOLERANCE * size, SIGMAS * errors)
        pairs.append(Pair(name, by_force, by_moment, agree))
    return Consistency(base, tuple(pairs))


def _transformation(
    coefficient: str, reference: Mapping[str, ParamEstimate], here: Mapping[str, ParamEstimate]
) -> tuple[Transformation, Transformation]:
    """The three numbers of one equation, and their standard errors."""
    slope = reference[f"{coefficient}_alpha"].value
    old, new = ([p[f"{coefficient}_{d}"] for d in DOF] for p in (reference, here))
    change = [(n.value - o.value) / slope for n, o in zip(new, old, strict=True)]
    # Both estimates come from one record: the smaller error is nearer to that of their difference.
    errors = [min(n.sd, o.sd) / abs(slope) for n, o in zip(new, old, strict=True)]
    return Transformation(1 + change[0], change[1], change[2]), Transformation(*errors)

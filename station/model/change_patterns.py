"""What changes of derivatives and drag look like: ice, a CG that moved, mass, a surface that lost effect, a vane.

Each pattern is the relative change of the six longitudinal derivatives and CD_0 by one amount, from the profile itself.
A measured change is fitted by one pattern at a time, weighted by its errors; patterns that fit about as well are not
told apart.

    tail ice    the tail's lift slope a_h falls:   CL_alpha -a_h(1-e), CL_q -2 a_h l/c, Cm_alpha +a_h l/c (1-e),
                                                    Cm_q +2 a_h (l/c)^2, CL_de and Cm_de in proportion
    wing ice    what is left of CL_alpha and Cm_alpha without that tail falls
    all ice     both together
Drag: CD_0 +5 for each of the wing's relative loss, as in the Twin Otter's reference icing condition (CD_0 +50 % at
CL_alpha -10 %; Bragg et al. 2002), a tenth of it the tail's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from station.conventions import LONGITUDINAL
from station.profile import Aircraft
from station.profile.profile_changes import cg_aft

Array = NDArray[np.float64]

NAMES: Final = (*LONGITUDINAL, "CD_0")
DRAG_OF_ICE: Final = 5.0
"""Relative rise of CD_0 by the relative loss of the lift slope."""
TAIL_DRAG: Final = 0.1
"""Share of it that is the tail's."""
DRAG_DOUBT: Final = 0.5
"""Share by which drag may be another than the pattern's beside the same loss of lift: shape and place of the ice."""
NOT_APART: Final = 4.0
"""Deviance, two standard deviations, by which a pattern must fit better than another to be told from it."""
DOUBT_ROUNDS: Final = 10
"""Each takes three quarters of the way to an amount that drag and derivatives agree on, or more."""
SURE: Final = 2.0
"""Standard errors from which an amount is told."""
UNLIKELY: Final = 1e-3
"""Probability of what a pattern leaves, below which it is not that pattern."""


@dataclass(frozen=True, slots=True)
class Pattern:
    """A named change."""

    name: str
    words: str
    confirm: str
    """What would confirm it."""
    shares: Array
    """(7,): relative change of NAMES by an amount of one."""
    unit: str = ""
    """Of the amount; "" for a share."""
    one_way: bool = True
    """Whether only a positive amount makes sense."""


@dataclass(frozen=True, slots=True)
class Match:
    """A pattern fitted to a change."""

    pattern: Pattern
    amount: float
    error: float
    left: float
    """Deviance that it leaves, and the probability of no less by chance."""
    likely: float


def patterns(aircraft: Aircraft) -> tuple[Pattern, ...]:
    """Those that the profile can state: ice on the tail alone needs a tail."""
    tail = _tail(aircraft)
    whole = np.array([aircraft.value(n) for n in LONGITUDINAL])
    wing = np.where(np.isin(LONGITUDINAL, ("CL_alpha", "Cm_alpha")), whole - tail, 0.0)
    made = [_of("wing ice", "ice on the wing", "look at the wing; de-ice, and see drag fall", wing, whole, DRAG_OF_ICE)]
    if np.any(tail):
        drag = TAIL_DRAG * DRAG_OF_ICE
        made.append(
            _of("tail ice", "ice on the tail", "look at the tail; de-ice, fly the input again", tail, whole, drag)
        )
        both = "look for ice; de-ice, fly the input again"
        made.append(_of("all ice", "ice on wing and tail", both, wing + tail, whole, DRAG_OF_ICE))
    elevator = np.where(np.isin(NAMES, ("CL_de", "Cm_de")), -1.0, 0.0)
    slopes = np.where(np.isin(NAMES, ("CL_alpha", "Cm_alpha")), -1.0, 0.0)
    lift = np.where(np.char.startswith(NAMES, "CL"), -1.0, 0.0)
    made += [
        Pattern(
            "elevator", "an elevator that has lost effect", "the elevator to trim at the baseline's speed", elevator
        ),
        Pattern("vane", "a vane that shows too much", "the vane against attitude and path", slopes, one_way=False),
        Pattern("mass", "more mass than is taken", "fuel and loading", lift, one_way=False),
    ]
    moved = cg_aft(aircraft, 1.0)
    by_cg = [_share(moved.value(n) - aircraft.value(n), aircraft.value(n)) for n in LONGITUDINAL]
    made.append(
        Pattern(
            "cg", "a CG that has moved aft", "the elevator to trim at two speeds", np.array([*by_cg, 0.0]), "m", False
        )
    )
    return tuple(made)


def _tail(aircraft: Aircraft) -> Array:
    """The tail's part of each derivative."""
    u, arm = aircraft.unsteady, aircraft.unsteady.tail_arm / aircraft.geometry.chord
    slope, left = u.tail_lift_slope, 1.0 - u.downwash
    if not slope * arm:
        return np.zeros(len(LONGITUDINAL))
    own = {
        "CL_alpha": slope * left,
        "CL_q": 2 * slope * arm,
        "CL_de": aircraft.value("CL_de"),
        "Cm_alpha": -slope * arm * left,
        "Cm_q": -2 * slope * arm**2,
        "Cm_de": aircraft.value("Cm_de"),
    }
    return np.array([own[n] for n in LONGITUDINAL])


def _of(name: str, words: str, confirm: str, part: Array, whole: Array, drag: float) -> Pattern:
    """The loss of a part of each derivative."""
    shares = [-_share(p, w) for p, w in zip(part, whole, strict=True)]
    return Pattern(name, words, confirm, np.array([*shares, drag]))


def _share(part: float, whole: float) -> float:
    return part / whole if whole else 0.0


def matches(changes: Mapping[str, tuple[float, float]], known: tuple[Pattern, ...]) -> list[Match]:
    """Patterns that may be it, the best first: relative changes and their standard errors by NAMES in, what is not
    known left out. Empty where none fits."""
    names = [n for n in NAMES if n in changes and changes[n][1] > 0]
    if not names:
        return []
    at = [NAMES.index(n) for n in names]
    d, s = np.array([changes[n][0] for n in names]), np.array([changes[n][1] for n in names])
    is_drag = np.array(names) == "CD_0"
    found = []
    for pattern in known:
        shares = pattern.shares[at]
        if not np.any(shares):
            continue
        amount, error, allowed = _fitted(pattern, shares, d, s, is_drag)
        left = float(np.sum(((d - amount * shares) / allowed) ** 2))
        found.append(Match(pattern, amount, error, left, float(chi2.sf(left, max(1, len(names) - 1)))))
    # Those that fit alike in the order of `known`, so that what is said first does not flutter.
    found = sorted((m for m in found if m.likely > UNLIKELY and m.amount != 0.0), key=lambda m: round(m.left))
    return [m for m in found if m.left - found[0].left < NOT_APART]


def _fitted(
    pattern: Pattern, shares: Array, d: Array, s: Array, is_drag: NDArray[np.bool_]
) -> tuple[float, float, Array]:
    """Amount, its standard error, and the errors (n,) that it allows: of drag, the doubt of as much as it makes.

    Drag's doubt goes with the amount: it is found by turns, beginning with what the derivatives say where they do.
    """
    slopes = np.where(is_drag, 0.0, shares)
    weights = (slopes if np.any(slopes) else shares) / s**2
    for _ in range(DOUBT_ROUNDS):
        amount = math.fsum(weights * d) / math.fsum(weights * shares)
        amount = max(0.0, amount) if pattern.one_way else amount
        allowed = np.where(is_drag, np.hypot(s, DRAG_DOUBT * amount * shares), s)
        weights = shares / allowed**2
    return amount, 1 / math.sqrt(math.fsum(weights * shares)), allowed


def in_words(found: list[Match]) -> str:
    """What may be it, how much, and what would confirm it."""
    if not found:
        return "like none of the changes known by name"
    best = found[0]
    others = "; not told from " + ", ".join(m.pattern.words for m in found[1:]) if found[1:] else ""
    if abs(best.amount) < SURE * best.error:
        return f"as by {best.pattern.words}{others}. To confirm: {best.pattern.confirm}"
    share = f"{100 * best.amount:.0f} ± {200 * best.error:.0f} %"
    unit = best.pattern.unit
    amount = f"{best.amount:.2f} ± {2 * best.error:.2f} {unit}" if unit else share
    return f"as by {best.pattern.words} ({amount}){others}. To confirm: {best.pattern.confirm}"

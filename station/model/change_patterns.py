"""What changes of derivatives, drag and lift look like: ice, a CG that moved, mass, a surface that lost effect, a vane.

Each pattern is the relative change of the six longitudinal derivatives, CD_0 and CL_0 by one amount, from the profile
itself.
A measured change is fitted by one pattern at a time, weighted by its errors; patterns that fit about as well are not
told apart.

    tail ice    the tail's lift slope a_h falls:   CL_alpha -a_h(1-e), CL_q -2 a_h l/c, Cm_alpha +a_h l/c (1-e),
                                                    Cm_q +2 a_h (l/c)^2, CL_de and Cm_de in proportion
    wing ice    what is left of CL_alpha and Cm_alpha without that tail falls
    all ice     both together
Drag: CD_0 +5 for each of the wing's relative loss, as in the Twin Otter's reference icing condition (CD_0 +50 % at
CL_alpha -10 %; Bragg et al. 2002), a tenth of it the tail's.
CL_0, which is told with the baseline's slopes (steady_lift), falls by what a slope that is less makes of the lift,
CL_alpha alpha, and by no more than the same share of all lift. A vane's zero turns lift into drag and leaves the slopes
(steady_lift); its scale does so by its share of the angle of attack.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from station.conventions import LONGITUDINAL
from station.profile import Aircraft
from station.profile.profile_changes import cg_aft

Array = NDArray[np.float64]

NAMES: Final = (*LONGITUDINAL, "CD_0", "CL_0")
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
    """(8,): relative change of NAMES by an amount of one."""
    unit: str = ""
    """Of the amount; "" for a share."""
    one_way: bool = True
    """Whether only a positive amount makes sense."""
    tells: str = ""
    """What tells it from others where these flights do not."""


@dataclass(frozen=True, slots=True)
class Match:
    """A pattern fitted to a change."""

    pattern: Pattern
    amount: float
    error: float
    left: float
    """Deviance that it leaves, and the probability of no less by chance."""
    likely: float


class _Level(NamedTuple):
    """The flight in which drag and lift are told; zeros where it is not known."""

    of_slope: float = 0.0
    """CL_alpha alpha, over the baseline's CL_0."""
    alpha: float = 0.0
    drag_by_vane: float = 0.0
    lift_by_vane: float = 0.0
    """Relative changes of CD_0 and CL_0 by a radian of angle of attack too much."""
    of_mass: float = 0.0
    """CL over CL_0."""


def _level(aircraft: Aircraft, lift: float) -> _Level:
    measured, polar = aircraft.measured, aircraft.drag
    if not math.isfinite(lift):
        return _Level()
    induced = polar.induced if polar else 0.0
    least = (measured and measured.CD_0) or (polar.zero_lift if polar else 0.0)
    slope, zero = aircraft.value("CL_alpha"), (measured and measured.CL_0) or aircraft.value("CL_0")
    drag = least + induced * lift**2
    return _Level(
        of_slope=_share(lift - zero, zero),
        alpha=_share(lift - zero, slope),
        drag_by_vane=_share(lift * (1 + 2 * induced * drag), least),
        lift_by_vane=-_share(slope + drag, zero),
        of_mass=_share(lift, zero),
    )


def patterns(aircraft: Aircraft, lift: float = math.nan) -> tuple[Pattern, ...]:
    """Those that the profile can state: ice on the tail alone needs a tail. `lift`: CL of the flight in which drag and
    CL_0 are told; without it these are of no vane."""
    made = _of_slopes(aircraft)
    level = _level(aircraft, lift)
    by_slope = LONGITUDINAL.index("CL_alpha")
    # Of the zero as the profile states it, at the vane.
    degree = math.radians(aircraft.boom.steady_calibration if aircraft.boom else 1.0)
    zeros = [0.0] * len(LONGITUDINAL)
    by_zero = np.array([*zeros, degree * level.drag_by_vane, degree * level.lift_by_vane])
    how = "attitude against flight path in steady level flight"
    zero_moved = Pattern(
        "vane zero", "a vane whose zero has moved", how, by_zero, "deg", False, f"{how} tells the vane"
    )
    found = []
    for p in made:
        if p.name == "vane":
            found.append(zero_moved)
        drag, zero = p.shares[-2], p.shares[by_slope] * level.of_slope
        if p.name == "vane":
            drag = level.drag_by_vane * level.alpha
        if p.name == "mass":
            zero = -level.of_mass
        found.append(replace(p, shares=np.array([*p.shares[:-2], drag, zero])))
    return tuple(found)


def _of_slopes(aircraft: Aircraft) -> list[Pattern]:
    """Without what the flight's lift makes of them in CD_0 and CL_0."""
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
            "cg",
            "a CG that has moved aft",
            "the elevator to trim at two speeds",
            np.array([*by_cg, 0.0, 0.0]),
            "m",
            False,
        )
    )
    return made


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
    return Pattern(name, words, confirm, np.array([*shares, drag, 0.0]))


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
    found = []
    for pattern in known:
        shares = pattern.shares[at]
        if not np.any(shares):
            continue
        amount, error, allowed = _fitted(pattern, shares, d, s, np.array([_doubt(pattern, n) for n in names]))
        left = float(np.sum(((d - amount * shares) / allowed) ** 2))
        found.append(Match(pattern, amount, error, left, float(chi2.sf(left, max(1, len(names) - 1)))))
    # Those that fit alike in the order of `known`, so that what is said first does not flutter.
    found = sorted((m for m in found if m.likely > UNLIKELY and m.amount != 0.0), key=lambda m: round(m.left))
    return [m for m in found if m.left - found[0].left < NOT_APART]


def _doubt(pattern: Pattern, name: str) -> float:
    """Standard deviation of what an amount of one makes otherwise of CD_0, a share of it, and of CL_0, as much as of
    the slope; of what has either sign, a CG or a vane, the physics leaves none."""
    if not pattern.one_way or name not in ("CD_0", "CL_0"):
        return 0.0
    if name == "CD_0":
        return DRAG_DOUBT * float(pattern.shares[-2])
    return abs(float(pattern.shares[LONGITUDINAL.index("CL_alpha")]))


def _fitted(pattern: Pattern, shares: Array, d: Array, s: Array, doubt: Array) -> tuple[float, float, Array]:
    """Amount, its standard error, and the errors (n,) that it allows: `doubt` (n,) of as much as it makes.

    The doubt goes with the amount: it is found by turns, beginning with what the derivatives say where they do.
    """
    slopes = np.where(doubt > 0.0, 0.0, shares)
    weights = (slopes if np.any(slopes) else shares) / s**2
    for _ in range(DOUBT_ROUNDS):
        amount = math.fsum(weights * d) / math.fsum(weights * shares)
        amount = max(0.0, amount) if pattern.one_way else amount
        allowed = np.hypot(s, doubt * amount)
        weights = shares / allowed**2
    return amount, 1 / math.sqrt(math.fsum(weights * shares)), allowed


def in_words(found: list[Match]) -> str:
    """What may be it, how much, and what would confirm it."""
    if not found:
        return "like none of the changes known by name"
    best = found[0]
    others = "; not told from " + ", ".join(m.pattern.words for m in found[1:]) if found[1:] else ""
    tells = "".join(f"; {m.pattern.tells}" for m in found[1:] if m.pattern.tells)
    if abs(best.amount) < SURE * best.error:
        return f"as by {best.pattern.words}{others}. To confirm: {best.pattern.confirm}{tells}"
    share = f"{100 * best.amount:.0f} ± {200 * best.error:.0f} %"
    unit = best.pattern.unit
    amount = f"{best.amount:.2f} ± {2 * best.error:.2f} {unit}" if unit else share
    return f"as by {best.pattern.words} ({amount}){others}. To confirm: {best.pattern.confirm}{tells}"

"""When an estimate counts as estimated: one rule for every method, live and after the flight.

A control surface must have moved beyond its noise, the record must last half a period of the lowest frequency, R2 must
reach 0.3 (but for what the surfaces alone show: input_instruments.py), the regressor must not be collinear with the
others (variance inflation factor, VIF, of 100 or less), and the estimate must be significant: two standard errors
within the larger of estimate and profile value.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Final

from numba.extending import register_jitable

from station.rows import Status

EXCITED: Final = 10.0
"""Energy of a surface's motion over that of its noise."""
MIN_PERIODS: Final = 0.5
"""Of the lowest frequency, before anything counts as estimated."""
MIN_R2: Final = 0.3
"""Less, and something else than the model's regressors moves the aircraft."""
BANKED: Final = math.radians(30.0)
"""From which wings-level flight is no measure, and a steep turn no input. The equations hold in it, and an input flown
there tells what it tells in level flight; but where the elevator only holds the turn, moments stay in balance
throughout, and all derivatives of the moment at once being less is a solution too, whose errors do not show it."""
COLLINEAR: Final = 100.0
"""Variance inflation factor above which a regressor counts as collinear with the others."""

ESTIMATED, NOT_FINITE, UNSOLVED, MOVES_ALONG, WIDE, STILL, WARMING, SHORT, NO_SPLIT, NO_TAIL, NO_INERTIA = range(11)
UNEXPLAINED: Final = 100
"""Verdicts on an estimate; from UNEXPLAINED on by the share of the data that the model explains, %."""
_TOO_LITTLE: Final = "the model explains too little of the data"
_WORDS: Final = {
    ESTIMATED: (Status.ESTIMATED, ""),
    NOT_FINITE: (Status.INVALID, "no finite estimate"),
    UNSOLVED: (Status.INVALID, "collinear regressors: the normal equations have no solution"),
    MOVES_ALONG: (Status.INVALID, f"collinear with the other regressors (VIF > {COLLINEAR:.0f}): vary the input"),
    WIDE: (Status.UNESTIMATED, "not significant: 2 sigma > estimate and profile value"),
    STILL: (Status.UNESTIMATED, "no elevator input"),
    WARMING: (Status.UNESTIMATED, "warming up"),
    NO_SPLIT: (Status.INVALID, "no inertial angle of attack: attitude or accelerations are missing"),
    NO_TAIL: (Status.INVALID, "the aircraft profile gives no tail arm"),
    NO_INERTIA: (Status.INVALID, "the aircraft profile gives no iyy"),
}


@register_jitable
def of_equation(r2: float) -> int:
    """Verdict on all estimates of an equation."""
    return UNEXPLAINED + round(100.0 * max(r2, 0.0)) if r2 < MIN_R2 else ESTIMATED


@register_jitable
def of_estimate(value: float, error: float, known: float, inflation: float) -> int:
    """Verdict on one estimate, with its standard error, of an equation that is accepted. `known`: the size that the
    profile gives; `inflation`: of its variance by the other regressors, 0 where a prior keeps it from them."""
    if not math.isfinite(value + error):
        return NOT_FINITE
    if inflation > COLLINEAR:
        return MOVES_ALONG
    if 2.0 * error > max(abs(value), known):
        return WIDE
    return ESTIMATED


def banked(bank: float) -> str:
    """Why a flight with this bank, rad, is not used; "" where it may be, or is not known."""
    words = f"banked beyond {math.degrees(BANKED):.0f} deg: what is compared with flies wings level"
    return words if abs(bank) > BANKED else ""


def is_wide(why: str) -> bool:
    """Whether an estimate that is invalid for a reason has a number all the same, whose error says how little it is
    worth: of an equation that moves together, or that something else moves."""
    return why == _WORDS[MOVES_ALONG][1] or why.endswith(_TOO_LITTLE)


@cache
def worded(verdict: int) -> tuple[Status, str]:
    """What a verdict says."""
    if verdict >= UNEXPLAINED:
        return (
            Status.INVALID,
            f"R2 {0.01 * (verdict - UNEXPLAINED):.2f}, below {MIN_R2:g}: {_TOO_LITTLE}",
        )
    return _WORDS[verdict]

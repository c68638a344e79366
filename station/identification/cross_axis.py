"""Longitudinal derivatives from a lateral manoeuvre: a sensor that is turned by two degrees shows a thirtieth of the
lateral motion as longitudinal, and where the elevator hardly moves that is most of what there is."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend

from station.conventions import LATERAL
from station.estimation.flight_record import FlightRecord
from station.estimation.lateral_derivatives import ATTENUATED
from station.estimation.results import MethodResult
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

CROSS_AXIS: Final = 0.035
"""What a vane or gyro block turned by 2 deg, as such are installed, shows of the other axis."""


LEAST: Final = 1e-12
"""Energy of a signal that stands still."""


def drowned(record: FlightRecord) -> str:
    """Why no longitudinal derivative can be had from what the lateral motion puts into the longitudinal signals; "" if
    one can, or there are no lateral signals."""
    good = record.usable
    if not (good.any() and record.has("beta_vane", "p")):
        return ""
    pairs = (record.alpha, record.beta), (record.motion["q"], record.motion["p"])
    shares = []
    for own, other in pairs:
        both = good & np.isfinite(own) & np.isfinite(other)
        if not both.any():
            return ""
        shares.append(CROSS_AXIS**2 * _energy(other[both]) / max(_energy(own[both]), LEAST))
    if min(shares) <= ATTENUATED:
        return ""
    times = math.sqrt(shares[0]) / CROSS_AXIS
    return (
        f"sideslip moves {times:.0f} times as much as the angle of attack, and a vane turned by 2 deg shows it as "
        f"{shares[0]:.0%} of that: move the elevator more"
    )


def without_longitudinal(result: MethodResult, why: str) -> MethodResult:
    """The longitudinal numbers are kept for comparison, but are no estimates."""
    made = tuple(
        p if p.name in LATERAL or p.status is not Status.ESTIMATED else _refused(p, why) for p in result.parameters
    )
    own = tuple(_refused(p, why) for p in result.quasi_steady)
    if result.status == "ok" and not any(p.status is Status.ESTIMATED for p in made):
        result = replace(result, status="not_applicable", why=why)
    return replace(result, parameters=made, quasi_steady=own)


def _refused(p: ParamEstimate, why: str) -> ParamEstimate:
    return ParamEstimate(p.name, p.value, p.sd, Status.UNESTIMATED, why)


def _energy(x: Array) -> float:
    return float(np.mean(detrend(x) ** 2))

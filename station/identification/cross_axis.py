"""Derivatives of an axis that hardly moves by itself: a sensor that is turned by two degrees shows a thirtieth of the
lateral motion as longitudinal, or the contrary, and that is then most of what there is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend

from station.estimation.flight_record import FlightRecord
from station.estimation.lateral_derivatives import ATTENUATED
from station.estimation.results import LATERAL_FORCES, MethodResult
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

CROSS_AXIS: Final = 0.035
"""What a vane or gyro block turned by 2 deg, as such are installed, shows of the other axis."""
LEAST: Final = 1e-12
"""Energy of a signal that stands still."""
WORDS: Final = {
    "alpha": "the angle of attack", "beta": "sideslip", "q": "pitch rate", "p": "roll rate", "r": "yaw rate",
}  # fmt: skip
PAIRS: Final = (
    ("alpha", "beta", ("CL", "CZ", "Cm"), "elevator"),
    ("q", "p", ("Cm",), "elevator"),
    ("beta", "alpha", LATERAL_FORCES, "rudder"),
    ("p", "q", ("Cl",), "aileron"),
    ("r", "q", ("Cn",), "rudder"),
)
"""A motion, one of the other axis that its sensor shows, the coefficients that are made of it beside its own
derivatives, and what would move it."""


def drowned(record: FlightRecord) -> dict[str, str]:
    """Why derivatives cannot be had, by their names, from what another axis's motion puts into their signals; empty if
    all can, or there are no lateral signals."""
    if not (record.usable.any() and record.has("beta_vane", "p", "r")):
        return {}
    energy = _energies(record)
    found: dict[str, str] = {}
    for own, other, coefficients, surface in PAIRS:
        share = CROSS_AXIS**2 * energy[other] / max(energy[own], LEAST)
        if share <= ATTENUATED:
            continue
        times = math.sqrt(share) / CROSS_AXIS
        why = (
            f"{WORDS[other]} moves {times:.0f} times as much as {WORDS[own]}, and a sensor turned by 2 deg shows it as "
            f"{share:.0%} of that: move the {surface} more"
        )
        names = [f"{c}_{d}" for c in coefficients for d in ("alpha", "beta", "p", "q", "r", "de", "da", "dr")]
        names += [f"{c}_{own}" for c in ("CL", "CZ", "Cm", *LATERAL_FORCES)]
        found |= {name: why for name in names if name not in found}
    return found


def _energies(record: FlightRecord) -> dict[str, float]:
    """Mean squares of the motion by its mark in derivatives' names."""
    motion = {"alpha": record.alpha, "beta": record.beta, **{n: record.motion[n] for n in ("p", "q", "r")}}
    made = {}
    for name, x in motion.items():
        good = record.usable & np.isfinite(x)
        made[name] = float(np.mean(detrend(x[good]) ** 2)) if good.any() else 0.0
    return made


def refused(result: MethodResult, whys: Mapping[str, str]) -> MethodResult:
    """The numbers are kept for comparison, but are no estimates."""

    def judged(p: ParamEstimate) -> ParamEstimate:
        if p.name not in whys or p.status is not Status.ESTIMATED:
            return p
        return ParamEstimate(p.name, p.value, p.sd, Status.UNESTIMATED, whys[p.name])

    made = tuple(judged(p) for p in result.parameters)
    if result.status == "ok" and not any(p.status is Status.ESTIMATED for p in made):
        first = next(p.why for p in made if p.why)
        result = replace(result, status="not_applicable", why=first)
    return replace(result, parameters=made, quasi_steady=tuple(judged(p) for p in result.quasi_steady))

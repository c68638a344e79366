"""Vane calibration and gust arrival as they are reported: with status, and beside what the profile states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from station.model.gust_delay import GustDelay
from station.model.vane_calibration import VaneCalibration
from station.profile import Aircraft
from station.rows import ParamEstimate, Status

AGREED_SD: Final = 3.0
AGREED_S: Final = 0.002
"""Delays this close agree however small the standard error."""
NOT_SEPARATED: Final = "collinear: motion and gust act alike on lift and moment; the profile's upwash is assumed"
VANE_UNITS: Final = {"zero": "rad", "scale": "1", "delay": "s"}


@dataclass(frozen=True, slots=True)
class GustArrival:
    """What the profile states of the gust's arrival: the vane meets it `delay_s` before the CG, with `upwash` k_u0."""

    delay_s: float
    upwash: float


def vane_parameters(part: VaneCalibration) -> tuple[ParamEstimate, ...]:
    """Bias ("zero", rad), scale and delay (s) of the vane; unestimated where gusts hide the motion."""
    why = "" if part.is_calm else f"gusts: the motion explains {max(part.r2, 0.0):.0%} of the reading"
    status = Status.ESTIMATED if part.is_calm else Status.UNESTIMATED
    named = {"zero": part.bias, "scale": part.scale, "delay": part.delay}
    return tuple(ParamEstimate(name, p.value, p.sd, status, why) for name, p in named.items())


def vane_method(part: VaneCalibration) -> str:
    return "least squares" if part.is_calm else "generalised least squares"


def vane_assumptions(aircraft: Aircraft) -> tuple[str, ...]:
    """What the calibration rests on."""
    if aircraft.boom is not None:
        return ("no mean vertical wind",)
    return ("no mean vertical wind", "vane at the CG: for one x ahead, slow pitching adds x/V to the delay")


def vane_by_profile(aircraft: Aircraft) -> dict[str, float]:
    """Zero (rad) and scale that the profile states; none without a boom."""
    boom = aircraft.boom
    return {} if boom is None else {"zero": boom.zero, "scale": 1 / boom.steady_calibration}


def arrival_by_profile(part: GustDelay, aircraft: Aircraft) -> GustArrival | None:
    """None without a boom."""
    boom = aircraft.boom
    return None if boom is None else GustArrival(boom.gust_x / part.speed, boom.upwash_body + boom.upwash_wing)


def profile_fits(part: GustDelay, stated: GustArrival) -> bool:
    """Whether delay and upwash are within AGREED_SD of the profile's."""
    joint = part.joint
    return bool(
        abs(joint.delay_s - stated.delay_s) <= AGREED_SD * joint.delay_sd + AGREED_S
        and abs(joint.upwash - stated.upwash) <= AGREED_SD * joint.upwash_sd
    )


def disagreement(part: GustDelay) -> str:
    """What it means that lift and moment disagree on the gust arrival; "" where they agree."""
    if part.agree:
        return ""
    differ = "give different delays" if len(part.apart) > 1 else "do not both give a delay"
    return f"lift and moment {differ}: not the vane's arrival offset, but unsteady lift of the tail or the wing"

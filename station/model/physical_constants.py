"""Constants of method `physical`: what the profile says of wing, tail, boom and sensors, and how well it is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.indicial import Response, response
from station.profile import Aircraft

Array = NDArray[np.float64]


class Nuisance(NamedTuple):
    """A constant of the profile that may be wrong, estimated with a prior."""

    name: str
    prior: Callable[[Aircraft], float]
    """Standard deviation."""
    learnt: float = 1.0
    """Share of that which turbulence may move: there the rest, which stands for errors of another shape than the
    nuisance's own, is only considered. In calm air all of it is learnt."""


NUISANCE_TABLE: Final = (
    Nuisance("tail share", lambda a: a.uncertainty.tail_lift_slope * a.unsteady.tail_lift_slope),
    Nuisance("boom length", lambda a: a.uncertainty.vane_x),
    Nuisance("vane skew", lambda a: a.uncertainty.vane_delay),
    Nuisance("span", lambda a: a.uncertainty.span_lag),
    Nuisance("span, fast", lambda a: a.uncertainty.span_lag),
    Nuisance("indicial amplitude", lambda a: a.uncertainty.lift_memory, 0.67),
    Nuisance("upwash share", lambda a: a.uncertainty.upwash_wing, 0.5),
    Nuisance("upwash rate, gust", lambda a: a.uncertainty.upwash_rate, 0.5),
    Nuisance("downwash", lambda a: a.uncertainty.downwash * a.unsteady.downwash, 0.0),
    Nuisance("downwash delay", lambda a: a.uncertainty.downwash_delay, 0.0),
    Nuisance("tail arm", lambda a: a.uncertainty.tail_arm, 0.0),
    Nuisance("vane gain", lambda a: a.uncertainty.vane_scale, 0.0),
    Nuisance("upwash rate, motion", lambda a: a.uncertainty.upwash_rate, 0.0),
    Nuisance("indicial rate, gust", lambda a: a.uncertainty.lift_rate, 0.0),
    Nuisance("indicial rate, motion", lambda a: a.uncertainty.lift_rate, 0.0),
    Nuisance("span, middle", lambda a: a.uncertainty.span_lag),
    # How much of the span's lag the tail has, beyond TAIL_SPAN_SHARE.
    Nuisance("tail span", lambda a: a.uncertainty.tail_span_lag),
    # Of the segment, not of the profile: physical_fit.
    Nuisance("mean wind", lambda _: 0.0),
)
"""In the order of the parameters, after the six derivatives."""
NUISANCES: Final = tuple(nuisance.name for nuisance in NUISANCE_TABLE)
N: Final = len(NUISANCES)
DERIVATIVES: Final = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
CL_ALPHA, CL_Q, CL_DE, CM_ALPHA, CM_Q, CM_DE = range(len(DERIVATIVES))
FIRST_NUISANCE: Final = len(DERIVATIVES)
PARAMETERS: Final = FIRST_NUISANCE + N
OF_CM: Final = slice(CM_ALPHA, FIRST_NUISANCE)

TAIL, BOOM, SKEW, SPAN, SPAN_FAST, SPAN_MIDDLE, TAIL_SPAN = map(
    NUISANCES.index, ("tail share", "boom length", "vane skew", "span", "span, fast", "span, middle", "tail span")
)
TAIL_SPAN_SHARE: Final = 0.5
"""Of the wing's lag behind gusts that vary along the span, the tail's: none if the wing alone averages them, all of
it if the air that the tail meets is averaged too."""
LIFT_AMPLITUDE, LIFT_RATE, GUST_RATE = map(
    NUISANCES.index, ("indicial amplitude", "indicial rate, motion", "indicial rate, gust")
)  # fmt: skip
UPWASH_SHARE, UPWASH_RATE_GUST, UPWASH_RATE_MOTION, GAIN = map(
    NUISANCES.index, ("upwash share", "upwash rate, gust", "upwash rate, motion", "vane gain")
)
WASH, WASH_DELAY, ARM_LENGTH, WIND = map(
    NUISANCES.index, ("downwash", "downwash delay", "tail arm", "mean wind")
)  # fmt: skip

SOURCES: Final = ("theta", "q", "az", "v_down", "elevator")
"""Sensors whose noise is in the regressors."""
THETA, RATE, AZ, V_DOWN, ELEVATOR = range(len(SOURCES))


class Constants(NamedTuple):
    """What the profile says."""

    tail_share: float
    """a_h: the tail's lift slope, by the wing's area."""
    downwash: float
    """e: per angle of attack of the wing."""
    arm: float
    """l_t/c"""
    tail_arm: float
    """l_t, m, as all lengths."""
    boom: float
    """How far ahead of the CG the vane is."""
    lead: float
    """Gust arrival offset: how far ahead it meets a gust."""
    gust_edge: float
    """How far ahead the wing meets it."""
    reference_chord: float
    """That indicial responses are by."""
    half_chord: float
    span: float
    upwash_body: float
    upwash_wing: float
    downwash_delay: float
    """s, beyond the way from wing to tail."""
    per_az: float
    """2m/S: what the density times V^2 turns az into a lift coefficient by, kg/m2."""
    per_qdot: float
    """2 Iyy/(S c), kg m."""
    has_moment: bool
    """Whether Iyy is known."""
    cl_alpha: float
    cm_alpha: float
    """Where the estimation starts."""
    lift_motion: Response
    lift_gust: Response
    upwash_motion: Response
    upwash_gust: Response
    prior: Array
    """Standard deviation of each nuisance, (N,)."""
    learnt: Array
    """Nuisance.learnt of each, (N,)."""
    noise: Array
    """Energy of each of SOURCES' noise over that of the vane, (SOURCES,)."""


def constants(aircraft: Aircraft, noise: Mapping[str, float] | None = None) -> Constants:
    """Of an aircraft for which `why_not` gives no reason against it.

    `noise`: standard deviations of the sensors, SI.
    """
    g, unsteady, boom = aircraft.geometry, aircraft.unsteady, aircraft.boom
    assert boom is not None
    sd = {**DEFAULT_NOISE, **(noise or {})}
    vane = sd["alpha_vane"] / (1.0 + boom.upwash_body)
    return Constants(
        tail_share=unsteady.tail_lift_slope,
        downwash=unsteady.downwash,
        arm=unsteady.tail_arm / g.chord,
        tail_arm=unsteady.tail_arm,
        boom=boom.vane_x,
        lead=boom.gust_x,
        gust_edge=aircraft.gust_edge,
        reference_chord=unsteady.reference_chord or g.chord,
        half_chord=g.chord / 2,
        span=g.span,
        upwash_body=boom.upwash_body,
        upwash_wing=boom.upwash_wing,
        downwash_delay=unsteady.downwash_delay,
        per_az=2.0 * aircraft.inertia.mass / g.wing_area,
        per_qdot=2.0 * (aircraft.inertia.iyy or 0.0) / (g.wing_area * g.chord),
        has_moment=aircraft.inertia.iyy is not None,
        cl_alpha=aircraft.value("CL_alpha") or 5.0,
        cm_alpha=aircraft.value("Cm_alpha") or -1.0,
        lift_motion=response(unsteady.lift_motion),
        lift_gust=response(unsteady.lift_gust),
        upwash_motion=response(unsteady.upwash_motion),
        upwash_gust=response(unsteady.upwash_gust),
        prior=np.array([nuisance.prior(aircraft) for nuisance in NUISANCE_TABLE]),
        learnt=np.array([nuisance.learnt for nuisance in NUISANCE_TABLE]),
        noise=np.array([(sd[name] / vane) ** 2 for name in SOURCES]),
    )


def why_not(aircraft: Aircraft) -> str:
    """Why the method cannot be applied to an aircraft; "" if it can."""
    unsteady = aircraft.unsteady
    if not unsteady.memory:
        return "the aircraft profile says quasi-steady lift (unsteady.memory is false)"
    missing = [
        name
        for name, there in (
            ("boom", aircraft.boom),
            ("unsteady.tail_lift_slope", unsteady.tail_lift_slope),
            ("unsteady.tail_arm", unsteady.tail_arm),
            ("unsteady.lift_motion", unsteady.lift_motion),
            ("unsteady.lift_gust", unsteady.lift_gust),
        )
        if not there
    ]
    return f"the aircraft profile gives no {', '.join(missing)}" if missing else ""

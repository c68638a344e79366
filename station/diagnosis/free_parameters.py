"""Every parameter of an aircraft that no profile knows exactly, with its prior: what each fit estimates along."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.profile import Aircraft
from station.profile.profile_changes import (
    Extend,
    bias,
    boom,
    delay,
    derivative,
    gain,
    indicial_amplitude,
    indicial_rate,
    inertia,
    of_separation,
    pitot_gain,
    unsteady,
    vane_dynamics,
    zero_lift_drag,
)

DERIVATIVES: Final = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
PRIOR_SHARE: Final = 0.10
"""Standard deviation of a derivative, as a share of it, where the profile states none."""


SEPARATION: Final = "aero.separation"
NONLINEARITY: Final = "elevator.nonlinearity"
SPEED_TERMS: Final = "aero.speed_terms"
BEYOND: Final = 3.0
"""Prior standard deviations from which a derivative, or a zero, is itself named: no handbook is that wrong."""
OF_ZERO: Final = {"q bias": "q.bias"}
"""Free zeros that are named as effects; the others are of every day."""
UNKNOWN_LEAD_M: Final = 3.0
"""m: a boom's length, where the profile gives none."""
SCATTER: Final = {"CL_q": 0.25, "CL_de": 0.15}
"""Share by which an aircraft's derivative lies off its profile's besides: small parts of the lift, which handbook
methods miss by a quarter (CL_q) and by an eighth (CL_de), whatever error the source states."""


STEP: Final = 0.3
"""Prior standard deviations over which a slope is taken: far above rounding, and near enough to straight."""
LEAST_SHAPE: Final = 0.1
"""Of a span's lag: more even than any loading makes it."""
LIFT_AMPLITUDES: Final = ("lift amplitude", "gust lift amplitude")
LIFT_RATES: Final = ("lift rate", "gust lift rate")
"""Of the wing's indicial responses: of both, to motion and to gusts, and of that to gusts besides."""
OWN_SHARE: Final = 0.5
"""Of the doubt of both, that of the latter: one wing sheds both wakes, so that what gusts tell of its memory, they tell
of that to motion; fronts that meet a swept or tapered wing little by little make them differ."""
OF_SCALE: Final = ("mass", "inertia", "roll inertia", "yaw inertia", "dynamic pressure")
"""What scales the series of a force, together with its derivatives."""
DAY: Final = ("vane zero", "theta bias", "az bias", "ax bias", "q bias", "CL_0", "Cm_0", "CD_0", "thrust scale")
"""What is of the day, not of the aircraft: fitted to held-out manoeuvres, too."""
_MEANS: Final = (*DAY[:-1], "phi bias", "ay bias", "p bias", "r bias", "CY_0", "Cl_0", "Cn_0")


@dataclass(frozen=True, slots=True)
class Free:
    """A quantity with a Gaussian prior of standard deviation `sd` about the profile's value."""

    name: str
    sd: float
    extend: Extend
    step: float = STEP
    """Over how many standard deviations its slope is taken."""
    of: str = ""
    """The effect that it is a constant of: it changes nothing without that."""
    read: Callable[[Aircraft], float] | None = None
    """Its value in a profile, of an effect's constants."""
    held: bool = False
    """Whether it stays the profile's until the effect that it is a constant of is told: that an effect becomes more
    pliable by it is no reason to name the effect."""
    ends: tuple[float, float] = (-math.inf, math.inf)
    """Beyond which it changes nothing more, in standard deviations: no slope is taken across, no step goes there."""

    @property
    def of_noise(self) -> bool:
        """Whether the way of sensors' noise into the residuals depends on it: zeros and trims move means alone."""
        return self.name not in _MEANS


def _share(field: str) -> Extend:
    def change(a: Aircraft, x: float) -> Aircraft:
        old = getattr(a.unsteady, field)
        return a.model_copy(update={"unsteady": a.unsteady.model_copy(update={field: old * max(0.0, 1 + x)})})

    return change


def vane_damping(a: Aircraft, x: float) -> Aircraft:
    """The vane's damping ratio times 1 + x."""
    if a.boom is None:
        return a
    made = max(0.05, a.boom.vane_damping * (1 + x))
    return a.model_copy(update={"boom": a.boom.model_copy(update={"vane_damping": made})})


def _induced(a: Aircraft, x: float) -> Aircraft:
    if a.drag is None:
        return a
    return a.model_copy(update={"drag": a.drag.model_copy(update={"induced": a.drag.induced * max(0.0, 1 + x)})})


def _within(name: str, field: str, sd: float, aircraft: Aircraft, low: float, high: float) -> Free:
    """A constant of the unsteady lift that ends."""

    def change(a: Aircraft, x: float) -> Aircraft:
        made = min(max(getattr(a.unsteady, field) + x, low), high)
        return a.model_copy(update={"unsteady": a.unsteady.model_copy(update={field: made})})

    at = getattr(aircraft.unsteady, field)
    return Free(name, sd, change, ends=((low - at) / sd, (high - at) / sd) if sd else (0.0, 0.0))


def _upwash_share(a: Aircraft, x: float) -> Aircraft:
    """The wing's share of an upwash whose sum is calibrated."""
    return boom("upwash_wing")(boom("upwash_body")(a, -x), x)


def _is_calibrated(aircraft: Aircraft) -> bool:
    return aircraft.calibrated is not None and aircraft.calibrated.upwash_sd is not None


def _vane_scale(aircraft: Aircraft) -> float:
    """What the vane's scale is uncertain by besides the wing's upwash, which is free itself; where a calibration flight
    has told the sum of wing and body, by what that is."""
    u, boom = aircraft.uncertainty, aircraft.boom
    if _is_calibrated(aircraft):
        return u.vane_scale
    wing = u.upwash_wing * boom.upwash_wing * boom.steady_calibration if boom else 0.0
    return math.sqrt(max(u.vane_scale**2 - wing**2, 0.0))


def free_parameters(aircraft: Aircraft, speed: float, mass_recorded: bool = False) -> list[Free]:
    """Derivatives, constants of wing, tail and boom, loading, trims and zeros."""
    u, own = aircraft.uncertainty, aircraft.unsteady
    mass = u.recorded_mass if mass_recorded else u.mass
    found = []
    for name in DERIVATIVES:
        stated = aircraft.derivatives.get(name)
        if stated is not None and stated.value and stated.sd != 0:
            share = stated.sd / abs(stated.value) if stated.sd else PRIOR_SHARE
            share = math.hypot(share, u.handbook * SCATTER.get(name, 0.0))
            found.append(Free(name, share, derivative(name, relative=True)))
    if own.memory:
        found += [
            Free("tail lift slope", u.tail_lift_slope, _share("tail_lift_slope")),
            Free("downwash", u.downwash, _share("downwash")),
            Free("downwash delay", u.downwash_delay, unsteady("downwash_delay")),
            Free("tail arm", u.tail_arm, _share("tail_arm")),
            Free(LIFT_AMPLITUDES[0], u.lift_memory, indicial_amplitude("lift_motion", "lift_gust")),
            Free(LIFT_RATES[0], u.lift_rate, indicial_rate("lift_motion", "lift_gust")),
            Free(LIFT_AMPLITUDES[1], OWN_SHARE * u.lift_memory, indicial_amplitude("lift_gust")),
            Free(LIFT_RATES[1], OWN_SHARE * u.lift_rate, indicial_rate("lift_gust")),
            Free("gust span", 0.25 * u.span_lag * aircraft.geometry.span / 2, unsteady("gust_span")),
            _within("gust span shape", "gust_span_shape", u.span_shape, aircraft, LEAST_SHAPE, 1.0),
            _within("gust span cut", "gust_span_cut", u.span_cut, aircraft, 0.0, 0.5),
            # Shares: from none to all; of the tail's speed up to its square.
            _within("turned at once", "turned_at_once", u.turned_at_once, aircraft, 0.0, 1.0),
            _within("gust speed", "gust_speed", u.gust_speed, aircraft, 0.0, 1.0),
            _within("gust tilt", "gust_tilt", u.gust_tilt, aircraft, 0.0, 1.0),
            _within("tail speed", "tail_speed", u.tail_speed, aircraft, 0.0, 2.0),
            _within("convection", "convection", u.convection, aircraft, 0.0, 1.0),
            Free("gust span, tail", 0.25 * u.span_lag * aircraft.geometry.span / 2, unsteady("gust_span_tail")),
        ]
    if aircraft.boom is not None:
        wing = _upwash_share if _is_calibrated(aircraft) else boom("upwash_wing")
        found += [
            Free("upwash wing", u.upwash_wing * aircraft.boom.upwash_wing, wing),
            Free("upwash rate", u.upwash_rate, indicial_rate("upwash_motion")),
            Free("gust upwash rate", u.upwash_rate, indicial_rate("upwash_gust")),
            Free("vane lead", u.vane_x * speed, boom("vane_x")),
            Free("vane frequency", u.vane_frequency, vane_dynamics),
            Free("vane damping", u.vane_damping, vane_damping),
            Free("vane zero", u.vane_zero, bias("alpha_vane")),
        ]
    else:
        # Nothing is known of where the vane is, and of what the aircraft does to the flow there.
        found += [Free("vane lead", UNKNOWN_LEAD_M, boom("vane_x")), Free("upwash body", 0.1, boom("upwash_body"))]
    found += [
        Free("vane delay", u.vane_delay, delay("alpha_vane")),
        Free("dynamic pressure", u.dynamic_pressure, pitot_gain),
        Free("pressure delay", u.pressure_delay, delay("airspeed", "dynamic_pressure")),
        Free("vane scale", _vane_scale(aircraft), gain("alpha_vane")),
        Free("mass", mass, inertia("mass")),
        Free("inertia", u.inertia, inertia("iyy")),
        Free("theta bias", u.theta_zero, bias("theta")),
        Free("az bias", u.az_zero, bias("az")),
        Free("ax bias", u.ax_zero, bias("ax")),
        Free("q bias", u.q_zero, bias("q")),
        Free("CL_0", u.CL_0, derivative("CL_0")),
        Free("Cm_0", u.Cm_0, derivative("Cm_0")),
        Free("CD_0", u.CD_0, zero_lift_drag),
        Free("induced drag", u.induced_drag, _induced),
        Free("thrust scale", u.thrust, gain("thrust")),
    ]
    zero = Free("elevator zero", u.surface_zero, bias("elevator"), of=NONLINEARITY, read=_elevator_zero, held=True)
    return [f for f in (*found, *_of_separation(aircraft), _of_speed(aircraft), zero) if f.sd > 0]


def _elevator_zero(a: Aircraft) -> float:
    return a.instruments["elevator"].bias


def _of_speed(aircraft: Aircraft) -> Free:
    """What gusts change of what depends on the speed, by the profile, or where nothing does, of what is found."""
    there = any(aircraft.value(name) for name in ("CL_V", "Cm_V", "CD_V"))
    made = _within("speed gusts", "speed_gusts", aircraft.uncertainty.speed_gusts, aircraft, 0.0, 1.0)
    return replace(made, of="" if there else SPEED_TERMS, read=lambda a: a.unsteady.speed_gusts)


def _of_separation(aircraft: Aircraft) -> list[Free]:
    """Constants of the flow that leaves the wing, by the profile, or where it has none, of the one that is found."""
    u, there = aircraft.uncertainty, aircraft.separation.alpha_star is not None
    of = "" if there else SEPARATION
    return [
        *([Free("alpha_star", u.alpha_star, of_separation("alpha_star"))] if there else []),
        Free("alpha_0", u.alpha_0, of_separation("alpha_0"), of=of, read=lambda a: a.separation.alpha_0),
        Free("a1", u.a1, of_separation("a1", relative=True), of=of, read=lambda a: a.separation.a1),
        Free("tau1", u.tau1, of_separation("tau1"), of=of, read=lambda a: a.separation.tau1),
        Free("tau2", u.tau2, of_separation("tau2"), of=of, read=lambda a: a.separation.tau2),
        Free(
            "tau2_rising",
            u.tau2_rising,
            of_separation("tau2_rising"),
            of=of,
            read=lambda a: a.separation.tau2_rising,
            ends=(-aircraft.separation.tau2_rising / u.tau2_rising if u.tau2_rising else 0.0, math.inf),
        ),
        Free("CD_X", u.CD_X, of_separation("CD_X"), of=of, read=lambda a: a.separation.CD_X),
        Free("Cm_X", u.Cm_X, of_separation("Cm_X"), of=of, read=lambda a: a.separation.Cm_X),
    ]


def moved(aircraft: Aircraft, frees: Sequence[Free], a: NDArray[np.float64]) -> Aircraft:
    """The aircraft with its free parameters moved, in standard deviations; what comes after them in `a` is not of the
    aircraft."""
    for free, x in zip(frees, a, strict=False):
        if x:
            aircraft = free.extend(aircraft, free.sd * float(x))
    return aircraft

"""The lateral parameters that no profile knows exactly, with their priors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from station.conventions import LATERAL
from station.diagnosis.free_parameters import PRIOR_SHARE, Free, vane_damping
from station.diagnosis.measured_record import LATERAL_SURFACES
from station.profile import Aircraft
from station.profile.profile_changes import (
    bias,
    boom,
    delay,
    derivative,
    fin,
    gain,
    inertia,
    pitot_gain,
    principal_axes,
    sensor_lag,
    unsteady,
    vane_dynamics,
)

OF_ZERO: Final = {"p bias": "p.bias", "r bias": "r.bias"}
"""Free zeros that are named as effects."""
DAY: Final = ("phi bias", "ay bias", "p bias", "r bias", "CY_0", "Cl_0", "Cn_0")
"""What is of the day, not of the aircraft."""
HANDBOOK: Final = 0.10
"""Share by which a lateral derivative lies off its profile's besides: one configuration's, flown in another; no method
predicts Cn_r or Cl_beta to better (DATCOM, section 5)."""
LEAST_SD: Final[Mapping[str, float]] = {"CY": 0.05, "Cl": 0.005, "Cn": 0.004}
"""Of any derivative: of the small ones, by which adverse yaw, propellers and a mean angle of attack other than the
profile's make more than a share of their value."""
SIDEWASH_AT_VANE: Final = 0.05
"""Of the sideslip vane's scale: a body beside it turns the flow by up to a tenth, and profiles say nothing of that."""
TILT_SD: Final = math.radians(2.0)
"""Of the principal axes against the body's: a reference line is drawn along the cabin floor, to no better."""
TRIM: Final[Mapping[str, float]] = {"CY_0": 0.05, "Cl_0": 0.02, "Cn_0": 0.02}
"""Of the coefficients without sideslip: asymmetry, surfaces' and vane's zeros; wide, for nothing rests on means."""
STATED_LAG: Final = 0.1
"""Share of a surface's stated lag, by which it is uncertain: an actuator's time constant changes by as much with load
and temperature. Where sideslip and both rates are one motion, a Dutch roll, milliseconds of the rudder decide what is
whose."""


def lateral_free_parameters(aircraft: Aircraft, speed: float, mass_recorded: bool = False) -> list[Free]:
    """Derivatives, fin, boom, inertias, trims and zeros. `speed`: mean, m/s."""
    u = aircraft.uncertainty
    found = []
    for name in LATERAL:
        stated = aircraft.derivatives.get(name)
        if stated is None or stated.sd != 0:
            value = aircraft.value(name)
            sd = stated.sd if stated is not None and stated.sd else PRIOR_SHARE * abs(value)
            sd = math.hypot(sd, u.handbook * max(HANDBOOK * abs(value), LEAST_SD[name[:2]]))
            found.append(Free(name, sd / (abs(value) or 1.0), derivative(name, relative=bool(value))))
    if aircraft.fin is not None:
        found += [
            Free("fin lift slope", u.tail_lift_slope * aircraft.fin.lift_slope, fin("lift_slope")),
            Free("fin arm", u.tail_arm, fin("arm", relative=True)),
            Free("sidewash", u.sidewash, fin("sidewash")),
            Free("sidewash delay", u.downwash_delay, fin("sidewash_delay")),
        ]
    if aircraft.boom is not None:
        found += [
            Free("vane lead", u.vane_x * speed, boom("vane_x")),
            Free("vane frequency", u.vane_frequency, vane_dynamics),
            Free("vane damping", u.vane_damping, vane_damping),
        ]
    found += [
        Free("gust turning", u.gust_turning, unsteady("gust_turning")),
        Free("vane delay", u.vane_delay, delay("beta_vane")),
        Free("vane scale", math.hypot(u.vane_scale, u.handbook * SIDEWASH_AT_VANE), gain("beta_vane")),
        *(Free(f"{s} scale", u.surface_scale, gain(s)) for s in LATERAL_SURFACES),
        *(Free(f"{s} lag", STATED_LAG * abs(_lag(aircraft, s)), sensor_lag(s)) for s in LATERAL_SURFACES),
        Free("dynamic pressure", u.dynamic_pressure, pitot_gain),
        Free("mass", u.recorded_mass if mass_recorded else u.mass, inertia("mass")),
        Free("roll inertia", u.inertia, inertia("ixx")),
        Free("yaw inertia", u.inertia, inertia("izz")),
        Free("principal axes", u.inertia and TILT_SD, principal_axes),
        Free("phi bias", u.theta_zero, bias("phi")),
        Free("p bias", u.q_zero, bias("p")),
        Free("r bias", u.q_zero, bias("r")),
        Free("ay bias", u.ax_zero, bias("ay")),
        *(Free(name, sd, derivative(name)) for name, sd in TRIM.items()),
    ]
    return [f for f in found if f.sd > 0]


def _lag(aircraft: Aircraft, surface: str) -> float:
    own = aircraft.instruments.get(surface)
    return own.lag if own is not None else 0.0

"""What effects do to an aircraft's profile: each change is by one value in SI, and 0 changes nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Final

from station.conventions import to_si
from station.profile.aircraft import NO_BOOM, Aircraft, Derivative, Indicial, Instrument

Extend = Callable[[Aircraft, float], Aircraft]

CUBIC_AT: Final = to_si(10, "deg")
"""Deflection at which a sensor's nonlinearity is stated."""


def unchanged(a: Aircraft, _: float) -> Aircraft:
    """Of what no profile states."""
    return a


def _instruments(
    aircraft: Aircraft, names: Iterable[str], change: Callable[[Instrument], Mapping[str, float]]
) -> Aircraft:
    made = dict(aircraft.instruments)
    for name in names:
        old = made.get(name, Instrument())
        made[name] = old.model_copy(update=dict(change(old)))
    return aircraft.model_copy(update={"instruments": made})


def delay(*names: str) -> Extend:
    return lambda a, x: _instruments(a, names, lambda i: {"latency": i.latency + x})


def gain(*names: str) -> Extend:
    return lambda a, x: _instruments(a, names, lambda i: {"gain": i.gain * (1 + x)})


def bias(*names: str) -> Extend:
    return lambda a, x: _instruments(a, names, lambda i: {"bias": i.bias + x})


def sensor_lag(*names: str) -> Extend:
    return lambda a, x: _instruments(a, names, lambda i: {"lag": i.lag + x})


def pitot_gain(a: Aircraft, x: float) -> Aircraft:
    # One sensor gives both: the airspeed follows the root of the pressure.
    return gain("airspeed")(gain("dynamic_pressure")(a, x), math.sqrt(1 + x) - 1)


def backlash(*names: str) -> Extend:
    return lambda a, x: _instruments(a, names, lambda i: {"backlash": max(0.0, i.backlash + x)})


def boom(field: str) -> Extend:
    def change(a: Aircraft, x: float) -> Aircraft:
        old = a.boom or NO_BOOM
        return a.model_copy(update={"boom": old.model_copy(update={field: getattr(old, field) + x})})

    return change


MODE_HZ: Final = 8.0
"""Frequency of a boom's first bending mode where the profile states none; what is judged lies well below."""
MODE_SHARE: Final = 0.5
"""How far a vane rises per radian of bending where the profile does not say, as a share of vane_x: most of that is
boom, whose tip swings about a point a third of its length from the root."""


def boom_mode(a: Aircraft, x: float) -> Aircraft:
    """The boom flexes with the load at its tip, not at the CG, through its first bending mode."""
    if x == 0:
        return a
    old = a.boom or NO_BOOM
    frequency, length = old.mode_frequency or MODE_HZ, old.mode_length or MODE_SHARE * old.vane_x
    made = {"flexure": old.flexure + x, "mode_frequency": frequency, "mode_length": length}
    return a.model_copy(update={"boom": old.model_copy(update=made)})


def cubic(a: Aircraft, x: float) -> Aircraft:
    return _instruments(a, ("elevator",), lambda i: {"cubic": i.cubic + x / CUBIC_AT**2})


def vane_dynamics(a: Aircraft, x: float) -> Aircraft:
    old = a.boom or NO_BOOM
    return a.model_copy(update={"boom": old.model_copy(update={"vane_frequency": old.vane_frequency * (1 + x)})})


def imu_forward(a: Aircraft, x: float) -> Aircraft:
    return a.model_copy(update={"imu_offset": (a.imu_offset[0] + x, *a.imu_offset[1:])})


def imu_down(a: Aircraft, x: float) -> Aircraft:
    return a.model_copy(update={"imu_offset": (*a.imu_offset[:2], a.imu_offset[2] + x)})


def principal_axes(a: Aircraft, x: float) -> Aircraft:
    """The principal axes of roll and yaw are turned by x rad, nose down: the product of inertia follows the difference
    of the two moments. Of a profile without these, none."""
    own = a.inertia
    made = own.ixz + 0.5 * ((own.izz or 0.0) - (own.ixx or 0.0)) * math.sin(2 * x)
    return a.model_copy(update={"inertia": own.model_copy(update={"ixz": made})})


def inertia(field: str) -> Extend:
    def change(a: Aircraft, x: float) -> Aircraft:
        old = getattr(a.inertia, field)
        if old is None:
            return a
        return a.model_copy(update={"inertia": a.inertia.model_copy(update={field: old * (1 + x)})})

    return change


def derivative(name: str, relative: bool = False) -> Extend:
    """Add to a derivative, or to its logarithm."""

    def change(a: Aircraft, x: float) -> Aircraft:
        old = a.derivatives.get(name, Derivative(value=0.0))
        value = old.value * (1 + x) if relative else old.value + x
        return a.model_copy(update={"derivatives": {**a.derivatives, name: old.model_copy(update={"value": value})}})

    return change


def speed_lift(a: Aircraft, x: float) -> Aircraft:
    """Lift depends on speed by x, and at the reference speed is what it was: CL_V multiplies V over that."""
    return derivative("CL_0")(derivative("CL_V")(a, x), -x)


def zero_lift_drag(a: Aircraft, x: float) -> Aircraft:
    if a.drag is None:
        return derivative("CD_0")(a, x)
    return a.model_copy(update={"drag": a.drag.model_copy(update={"zero_lift": a.drag.zero_lift + x})})


def cg_aft(a: Aircraft, x: float) -> Aircraft:
    """The CG moves aft by x m: moments about it, and every arm from it."""
    arm = x / a.geometry.chord
    for name in ("0", "alpha", "q", "de", "V"):
        if a.value(f"CL_{name}"):
            a = derivative(f"Cm_{name}")(a, a.value(f"CL_{name}") * arm)
    a = imu_forward(a, x)
    if a.boom is not None:
        a = boom("vane_x")(a, x)
    tail = a.unsteady.model_copy(update={"tail_arm": max(0.0, a.unsteady.tail_arm - x)})
    return a.model_copy(update={"unsteady": tail})


ICING: Final = {"CL_alpha": -0.10, "CL_q": -0.013, "CL_de": -0.095, "Cm_alpha": -0.099, "Cm_q": -0.035, "Cm_de": -0.10}
"""Relative change of each derivative in the reference icing condition (eta = 1) of the Twin Otter; CD_0 +50 %."""


def icing(a: Aircraft, eta: float) -> Aircraft:
    for name, share in ICING.items():
        a = derivative(name, relative=True)(a, eta * share)
    zero = a.drag.zero_lift if a.drag else a.value("CD_0")
    return zero_lift_drag(a, 0.5 * eta * zero)


LATERAL_ICING: Final = {
    "CY_beta": -0.20, "CY_dr": -0.08, "Cl_beta": -0.10, "Cl_p": -0.10, "Cl_da": -0.10, "Cl_dr": -0.08,
    "Cn_beta": -0.20, "Cn_r": -0.061, "Cn_dr": -0.083,
}  # fmt: skip
"""The same of the lateral derivatives: dihedral, roll damping and ailerons lose as much as the wing's lift, fin and
rudder as the tail's. Bragg et al. 2000 (AIAA 2000-0360)."""


def lateral_icing(a: Aircraft, eta: float) -> Aircraft:
    for name, share in LATERAL_ICING.items():
        a = derivative(name, relative=True)(a, eta * share)
    return a


def fin(field: str, relative: bool = False) -> Extend:
    """Add to a constant of the fin, or to its logarithm; of a profile without a fin, none."""

    def change(a: Aircraft, x: float) -> Aircraft:
        if a.fin is None:
            return a
        old = getattr(a.fin, field)
        return a.model_copy(update={"fin": a.fin.model_copy(update={field: old * (1 + x) if relative else old + x})})

    return change


def unsteady(field: str) -> Extend:
    def change(a: Aircraft, x: float) -> Aircraft:
        old = getattr(a.unsteady, field)
        return a.model_copy(update={"unsteady": a.unsteady.model_copy(update={field: old + x})})

    return change


def _indicial(part: str, least: float, *fields: str) -> Extend:
    """Indicial responses with their amplitudes ("a") or rates ("b") times 1 + x, at `least` that."""

    def change(a: Aircraft, x: float) -> Aircraft:
        made: dict[str, Indicial] = {}
        for field in fields:
            old = getattr(a.unsteady, field)
            if old is not None:
                made[field] = old.model_copy(update={part: tuple(max(least, 1 + x) * v for v in getattr(old, part))})
        return a.model_copy(update={"unsteady": a.unsteady.model_copy(update=made)})

    return change


def indicial_amplitude(*fields: str) -> Extend:
    """Indicial responses with their amplitudes times 1 + x."""
    return _indicial("a", -math.inf, *fields)


SLOWEST: Final = 0.05
"""Share of its rate below which no indicial response falls: at nought it would not be one."""


def indicial_rate(*fields: str) -> Extend:
    """Indicial responses that follow 1 + x times as fast."""
    return _indicial("b", SLOWEST, *fields)


ATTACHED: Final = to_si(50, "deg")
"""Angle of attack beyond which flow that leaves the wing is met by no flight that is diagnosed."""


def separation(a: Aircraft, x: float) -> Aircraft:
    """The flow leaves the wing at x; from ATTACHED on it does not."""
    if x >= ATTACHED:
        return a
    return a.model_copy(update={"separation": a.separation.model_copy(update={"alpha_star": x})})


def of_separation(field: str, relative: bool = False) -> Extend:
    """Add to a constant of the separation, or to its logarithm; none of the lags is negative."""

    def change(a: Aircraft, x: float) -> Aircraft:
        old = getattr(a.separation, field)
        made = old * math.exp(x) if relative else old + x
        made = max(0.0, made) if field.startswith("tau") else made
        return a.model_copy(update={"separation": a.separation.model_copy(update={field: made})})

    return change


def thrust_arm(a: Aircraft, x: float) -> Aircraft:
    return a.model_copy(update={"thrust_pitch_arm": a.thrust_pitch_arm + x})

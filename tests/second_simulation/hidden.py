"""What can be hidden in a flight: the rows of the station's catalogue that can be laid over it, and some outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from tests.second_simulation.aircraft import (
    BOOM_X,
    CHORD,
    DEG,
    IYY,
    LATERAL,
    LONGITUDINAL,
    MASS,
    TAIL_ARM,
    Drawn,
    G,
)
from tests.second_simulation.motion import Hidden

PER_G: Final = DEG / G
"""1 deg/g in rad s2/m."""


@dataclass(frozen=True)
class Row:
    """How much of an effect is hidden, SI; and what a catalogue without it may rightly say instead."""

    low: float
    high: float
    signs: tuple[int, ...] = (-1, 1)
    also: tuple[str, ...] = ()
    lateral: bool = False


HIDDEN: Final[dict[str, Row]] = {
    "alpha_vane.delay": Row(0.02, 0.06, (1,)),
    "alpha_vane.scale": Row(0.06, 0.15),
    "alpha_vane.position": Row(0.8, 1.6),
    "alpha_vane.dynamics": Row(0.35, 0.5, (-1,)),
    "alpha_vane.upwash_memory": Row(0.7, 1.0),
    "boom.flexure": Row(0.25 * PER_G, 0.6 * PER_G),
    "boom.mode": Row(0.3 * PER_G, 0.6 * PER_G, (1,)),
    "gust.lead": Row(0.3, 0.6),
    "accelerometer.position": Row(0.4, 0.9),
    "accelerometer.scale": Row(0.05, 0.1),
    "accelerometer.bias": Row(0.3, 0.8),
    "accelerometer.delay": Row(0.02, 0.05, (1,)),
    "q.delay": Row(0.01, 0.03, (1,)),
    "q.scale": Row(0.04, 0.1),
    "q.bias": Row(0.01, 0.03),
    "imu.delay": Row(0.02, 0.04, (1,)),
    "theta.bias": Row(0.02, 0.04),
    "theta.scale": Row(0.05, 0.1),
    "elevator.lag": Row(0.03, 0.08, (1,)),
    "elevator.scale": Row(0.25, 0.4),
    "elevator.backlash": Row(0.4 * DEG, 0.8 * DEG, (1,)),
    "elevator.nonlinearity": Row(0.4, 0.9),
    "dynamic_pressure.scale": Row(0.07, 0.14),
    "dynamic_pressure.lag": Row(0.4, 1.0, (1,)),
    "mass.scale": Row(0.12, 0.2),
    "inertia.scale": Row(0.2, 0.35),
    "cg.shift": Row(0.1, 0.25),
    "aero.icing": Row(1.5, 3.0, (1,)),
    "aero.alpha_squared": Row(4.0, 10.0, (-1,)),
    "aero.speed_terms": Row(0.4, 1.0),
    "aero.unsteady_lift": Row(0.8, 1.5, (1,)),
    "gust.tail_penetration": Row(0.3, 0.6),
    "aero.downwash_lag": Row(0.04, 0.08, (1,)),
    "thrust.moment": Row(0.3, 0.8),
    "velocity.delay": Row(0.05, 0.2, (1,)),
    "aero.separation": Row(1.0, 1.0, (1,), ("aero.alpha_squared",)),
    "elevator.delay": Row(0.03, 0.06, (1,), ("elevator.lag",)),
    # Of lateral motion.
    "beta_vane.delay": Row(0.06, 0.1, (1,), lateral=True),
    "p.delay": Row(0.01, 0.03, (1,), lateral=True),
    "p.scale": Row(0.04, 0.1, lateral=True),
    "r.delay": Row(0.015, 0.04, (1,), lateral=True),
    "r.scale": Row(0.06, 0.12, lateral=True),
    "phi.delay": Row(0.02, 0.05, (1,), lateral=True),
    "phi.scale": Row(0.05, 0.1, lateral=True),
    "psi.delay": Row(0.05, 0.1, (1,), lateral=True),
    "ay.scale": Row(0.06, 0.12, lateral=True),
    "ay.delay": Row(0.02, 0.05, (1,), lateral=True),
    "aileron.lag": Row(0.03, 0.08, (1,), lateral=True),
    "rudder.lag": Row(0.03, 0.08, (1,), lateral=True),
    # Outside the catalogue.
    "alpha_vane.lag": Row(0.03, 0.08, (1,), ("alpha_vane.delay", "alpha_vane.dynamics")),
    "alpha_vane.stiction": Row(0.15 * DEG, 0.3 * DEG, (1,)),
    "slosh": Row(0.05, 0.1, (1,)),
}
OUTSIDE: Final = ("alpha_vane.lag", "alpha_vane.stiction", "slosh")
ICE: Final = {"CL_alpha": -0.10, "CL_q": -0.013, "CL_de": -0.095, "Cm_alpha": -0.099, "Cm_q": -0.035, "Cm_de": -0.10}
"""Bragg, Hutchison, Merret, Oltman and Pokhariyal 2000 (AIAA 2000-0360): the Twin Otter's iced derivatives; eta = 1."""


def size(rng: np.random.Generator, name: str) -> float:
    row = HIDDEN[name]
    return float(rng.uniform(row.low, row.high) * rng.choice(row.signs))


def changed(aircraft: Drawn, hidden: Mapping[str, float]) -> Drawn:
    """The aircraft itself with what is hidden in it."""
    d, x = dict(aircraft.derivatives), hidden.get
    made = replace(
        aircraft,
        mass=aircraft.mass * (1 + x("mass.scale", 0.0)),
        iyy=aircraft.iyy * (1 + x("inertia.scale", 0.0)),
        boom_x=aircraft.boom_x + x("alpha_vane.position", 0.0) + x("cg.shift", 0.0),
        vane_hz=aircraft.vane_hz * (1 + x("alpha_vane.dynamics", 0.0)),
        upwash_memory=aircraft.upwash_memory * (1 + x("alpha_vane.upwash_memory", 0.0)),
        memory=aircraft.memory * (1 + x("aero.unsteady_lift", 0.0)),
        tail_arm=aircraft.tail_arm - x("cg.shift", 0.0),
        CD_0=aircraft.CD_0 * (1 + 0.5 * x("aero.icing", 0.0)),
        Cm_0=aircraft.Cm_0 + aircraft.CL_0 * x("cg.shift", 0.0) / CHORD,
    )
    for name, share in ICE.items():
        d[name] *= 1 + share * x("aero.icing", 0.0)
    for argument in ("alpha", "q", "de"):
        d[f"Cm_{argument}"] += d[f"CL_{argument}"] * x("cg.shift", 0.0) / CHORD
    return replace(made, derivatives=d)


def of_motion(aircraft: Drawn, trim_alpha: float, hidden: Mapping[str, float]) -> Hidden:
    """What the equations of motion have of it. Separation: half the flow has left 3 deg above the trim's angle."""
    x = hidden.get
    gone = bool(x("aero.separation", 0.0))
    return Hidden(
        alpha2=x("aero.alpha_squared", 0.0),
        speed=x("aero.speed_terms", 0.0),
        tail_late=x("gust.tail_penetration", 0.0),
        downwash_late=x("aero.downwash_lag", 0.0),
        gust_early=x("gust.lead", 0.0),
        thrust_arm=x("thrust.moment", 0.0),
        backlash=x("elevator.backlash", 0.0),
        flexure=x("boom.flexure", 0.0),
        mode=x("boom.mode", 0.0),
        stall_sharpness=25.0 if gone else 0.0,
        stall_alpha=trim_alpha + 3 * DEG,
        stall_lag=15.0 * CHORD / aircraft.speed if gone else 0.0,
        stall_late=4.0 * CHORD / aircraft.speed if gone else 0.0,
        slosh=x("slosh", 0.0),
    )


def deviations(
    sound: Drawn, zeros: Mapping[str, float], hidden: Mapping[str, float], motion: Hidden
) -> dict[str, float]:
    """How the aircraft flown and its instruments differ from the profile, by the catalogue's ids, SI: what is hidden,
    and what was drawn. To name one of these with its right value is no false name. `motion`: of `of_motion`.
    """
    aircraft, x = changed(sound, hidden), hidden.get
    upwash = 1 + aircraft.upwash_body + aircraft.upwash_wing
    return {
        "mass.scale": aircraft.mass / MASS - 1,
        "inertia.scale": aircraft.iyy / IYY - 1,
        "alpha_vane.position": aircraft.boom_x - BOOM_X,
        "alpha_vane.dynamics": aircraft.vane_hz / 9.0 - 1,
        "alpha_vane.scale": upwash * (1 + x("alpha_vane.scale", 0.0)) / 1.177 - 1,
        "alpha_vane.upwash_memory": aircraft.upwash_memory * aircraft.upwash_wing / 0.107 - 1,
        "aero.unsteady_lift": aircraft.memory - 1,
        "gust.tail_penetration": aircraft.tail_arm * (1 + x("gust.tail_penetration", 0.0)) / TAIL_ARM - 1,
        **{f"aero.{n}": aircraft.derivatives[n] / v - 1 for n, v in LONGITUDINAL.items()},
        "q.bias": zeros.get("q", 0.0) + x("q.bias", 0.0),
        "alpha_vane.bias": zeros.get("alpha_vane", 0.0),
        "theta.bias": zeros.get("theta", 0.0) + x("theta.bias", 0.0),
        "accelerometer.bias": zeros.get("az", 0.0) + x("accelerometer.bias", 0.0),
        "p.bias": zeros.get("p", 0.0),
        "r.bias": zeros.get("r", 0.0),
        "phi.bias": zeros.get("phi", 0.0),
        "ay.bias": zeros.get("ay", 0.0),
        "ay.scale": x("accelerometer.scale", 0.0) + x("ay.scale", 0.0),
        "ay.delay": x("accelerometer.delay", 0.0) + x("ay.delay", 0.0),
        "imu_lateral.delay": x("imu.delay", 0.0),
        "beta_vane.scale": aircraft.sidewash + x("beta_vane.scale", 0.0),
        **{f"aero.{n}": aircraft.lateral[n] / v - 1 for n, v in LATERAL.items()},
        **({"aero.separation": motion.stall_alpha} if motion.stall_sharpness else {}),
    }

"""The catalogue: every effect that diagnosis can name, in one table, and the quantities it must allow for.

An effect is a change of the aircraft's profile, of its model or of its instruments, by one value in SI; the same
profile corrects measured signals, predicts, is simulated and is written to a file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from station.conventions import G0, from_si
from station.profile import Aircraft, Derivative, Indicial, Instrument
from station.simulation.boom import NO_BOOM

Extend = Callable[[Aircraft, float], Aircraft]

VELOCITY: Final = ("v_north", "v_east", "v_down")
ACCELEROMETER: Final = ("ax", "az")
IMU: Final = ("q", "theta", "ax", "az")
PITOT: Final = ("dynamic_pressure", "airspeed")


@dataclass(frozen=True, slots=True)
class Term:
    """One effect, or one quantity allowed for."""

    id: str
    target: str
    """The signals, or the part of the model, that it changes."""
    null: float
    """The value that changes nothing."""
    unit: str
    """SI unit of the value."""
    shown: str
    """The unit that the sentence speaks in."""
    low: float
    high: float
    """Physical range of the value, SI."""
    step: float
    """A small change, SI: of the size that three manoeuvres detect."""
    sentence: str
    """For the report; {value} is the value with its unit."""
    separate_by: str
    """The experiment that tells it from what it is confused with."""
    extend: Extend
    needs: tuple[str, ...] = ()
    """Optional signals without which it cannot be judged."""
    aerodynamic: bool = False
    gust_only: bool = False
    """Shows in turbulence only."""
    relinear: bool = False
    """It changes what the derivatives multiply: their columns are made anew at each step."""
    price: float = 0.0
    """What -2 log likelihood must fall by more than for others: it is that much rarer."""

    def words(self, value: float) -> str:
        """The sentence with the value in it."""
        unit = "" if self.shown == "1" else f" {self.shown}"
        return self.sentence.format(value=f"{from_si(value, self.shown):+.3g}{unit}")


# --- changes of a profile


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


def _pitot_gain(a: Aircraft, x: float) -> Aircraft:
    # One sensor gives both: the airspeed follows the root of the pressure.
    return gain("airspeed")(gain("dynamic_pressure")(a, x), math.sqrt(1 + x) - 1)


def _backlash(a: Aircraft, x: float) -> Aircraft:
    return _instruments(a, ("elevator",), lambda i: {"backlash": max(0.0, i.backlash + x)})


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


def _boom_mode(a: Aircraft, x: float) -> Aircraft:
    """The boom bends with the load at its tip, not at the CG, and swings."""
    if x == 0:
        return a
    old = a.boom or NO_BOOM
    frequency, length = old.mode_frequency or MODE_HZ, old.mode_length or MODE_SHARE * old.vane_x
    made = {"flexure": old.flexure + x, "mode_frequency": frequency, "mode_length": length}
    return a.model_copy(update={"boom": old.model_copy(update=made)})


def _cubic(a: Aircraft, x: float) -> Aircraft:
    return _instruments(a, ("elevator",), lambda i: {"cubic": i.cubic + x / _CUBIC_AT**2})


def _vane_dynamics(a: Aircraft, x: float) -> Aircraft:
    old = a.boom or NO_BOOM
    return a.model_copy(update={"boom": old.model_copy(update={"vane_frequency": old.vane_frequency * (1 + x)})})


def _imu_forward(a: Aircraft, x: float) -> Aircraft:
    return a.model_copy(update={"imu_offset": (a.imu_offset[0] + x, *a.imu_offset[1:])})


def _inertia(field: str) -> Extend:
    def change(a: Aircraft, x: float) -> Aircraft:
        old = getattr(a.inertia, field)
        return a.model_copy(update={"inertia": a.inertia.model_copy(update={field: old * (1 + x)})})

    return change


def derivative(name: str, relative: bool = False) -> Extend:
    """Add to a derivative, or to its logarithm."""

    def change(a: Aircraft, x: float) -> Aircraft:
        old = a.derivatives.get(name, Derivative(value=0.0))
        value = old.value * (1 + x) if relative else old.value + x
        return a.model_copy(update={"derivatives": {**a.derivatives, name: old.model_copy(update={"value": value})}})

    return change


def _zero_drag(a: Aircraft, x: float) -> Aircraft:
    if a.drag is None:
        return derivative("CD_0")(a, x)
    return a.model_copy(update={"drag": a.drag.model_copy(update={"zero_lift": a.drag.zero_lift + x})})


def _cg_aft(a: Aircraft, x: float) -> Aircraft:
    """The CG moves aft by x m: moments about it, and every arm from it."""
    arm = x / a.geometry.chord
    for name in ("0", "alpha", "q", "de", "V"):
        if a.value(f"CL_{name}"):
            a = derivative(f"Cm_{name}")(a, a.value(f"CL_{name}") * arm)
    a = _imu_forward(a, x)
    if a.boom is not None:
        a = boom("vane_x")(a, x)
    tail = a.unsteady.model_copy(update={"tail_arm": max(0.0, a.unsteady.tail_arm - x)})
    return a.model_copy(update={"unsteady": tail})


ICING: Final = {"CL_alpha": -0.10, "CL_q": -0.013, "CL_de": -0.095, "Cm_alpha": -0.099, "Cm_q": -0.035, "Cm_de": -0.10}
"""Relative change of each derivative in the reference icing condition (eta = 1) of the Twin Otter; CD_0 +50 %."""


def _icing(a: Aircraft, eta: float) -> Aircraft:
    for name, share in ICING.items():
        a = derivative(name, relative=True)(a, eta * share)
    zero = a.drag.zero_lift if a.drag else a.value("CD_0")
    return _zero_drag(a, 0.5 * eta * zero)


def unsteady(field: str) -> Extend:
    def change(a: Aircraft, x: float) -> Aircraft:
        old = getattr(a.unsteady, field)
        return a.model_copy(update={"unsteady": a.unsteady.model_copy(update={field: old + x})})

    return change


def _memory(*fields: str) -> Extend:
    """Indicial responses with their amplitudes times 1 + x."""

    def change(a: Aircraft, x: float) -> Aircraft:
        made: dict[str, Indicial] = {}
        for field in fields:
            old = getattr(a.unsteady, field)
            if old is not None:
                made[field] = old.model_copy(update={"a": tuple((1 + x) * v for v in old.a)})
        return a.model_copy(update={"unsteady": a.unsteady.model_copy(update=made)})

    return change


def _thrust_arm(a: Aircraft, x: float) -> Aircraft:
    return a.model_copy(update={"thrust_pitch_arm": a.thrust_pitch_arm + x})


# --- the table

_DEG = math.radians(1)
_CUBIC_AT = 10 * _DEG
"""Deflection at which a bent characteristic is told."""
_RARE: Final = 4.0
"""An attitude that is integrated and levelled has no scale to be wrong: one case in eight of gyro and attitude apart,
where turbulence leaves the two alike."""

EFFECTS: Final[tuple[Term, ...]] = (
    Term("alpha_vane.delay", "alpha_vane", 0, "s", "ms", -0.3, 0.5, 2e-3, "The alpha vane is {value} late.",
         "one calm and one turbulent manoeuvre, or doublets at two speeds: a delay is a time, a position a distance",
         delay("alpha_vane")),
    Term("alpha_vane.scale", "alpha_vane", 0, "1", "%", -0.6, 1.5, 0.01, "The alpha vane's scale is off by {value}.",
         "a multisine in place of doublets, and a load-factor change at constant pitch rate", gain("alpha_vane")),
    Term("alpha_vane.position", "alpha_vane", 0, "m", "ft", -12, 12, 0.15,
         "The alpha vane sits {value} further ahead of the CG than the profile says.",
         "one calm and one turbulent manoeuvre, or doublets at two speeds", boom("vane_x")),
    Term("alpha_vane.bias", "alpha_vane", 0, "rad", "deg", -0.3, 0.3, 3e-3, "The alpha vane's zero is off by {value}.",
         "trimmed flight at two speeds: mass acts through lift, a bias does not", bias("alpha_vane")),
    Term("alpha_vane.dynamics", "alpha_vane", 0, "1", "%", -0.7, 2, 0.1,
         "The vane's own frequency differs from the profile's by {value}.",
         "the vane's spectrum at 5 to 12 Hz in turbulence", _vane_dynamics),
    Term("alpha_vane.upwash_memory", "alpha_vane", 0, "1", "%", -1, 3, 0.1,
         "The upwash at the vane has {value} more memory than the profile says.",
         "a multisine in calm air and one in turbulence", _memory("upwash_motion", "upwash_gust")),
    Term("boom.flexure", "alpha_vane", 0, "rad s2/m", "deg/g", -1 * _DEG / G0, 1 * _DEG / G0, 1e-4,
         "The boom bends by {value} under load.",
         "a load-factor change at constant pitch rate, or a multisine in place of doublets", boom("flexure")),
    Term("boom.mode", "alpha_vane", 0, "rad s2/m", "deg/g", 0, 1 * _DEG / G0, 1e-4,
         "The boom bends by {value} under the acceleration of its tip, as one that swings does.",
         "a sharp doublet: the tip's acceleration leads that of the CG", _boom_mode),
    Term("gust.lead", "alpha_vane", 0, "1", "%", -1, 2, 0.03,
         "Gusts meet the vane earlier by {value} of its distance than the profile says.",
         "a calm manoeuvre: it shows in turbulence only", boom("gust_lead"), aerodynamic=True, gust_only=True),
    Term("accelerometer.position", "ax az", 0, "m", "ft", -5, 5, 0.1,
         "The accelerometer sits {value} further ahead than the rig says.",
         "a sharp doublet: position shows with pitch acceleration", _imu_forward),
    Term("accelerometer.scale", "ax az", 0, "1", "%", -0.3, 0.3, 0.01, "The accelerometer's scale is off by {value}.",
         "a tumble test on the ground", gain(*ACCELEROMETER)),
    Term("accelerometer.bias", "az", 0, "m/s2", "g", -3, 3, 0.02, "The normal accelerometer's zero is off by {value}.",
         "a tumble test on the ground", bias("az")),
    Term("accelerometer.delay", "ax az", 0, "s", "ms", -0.3, 0.3, 2e-3, "The accelerometer is {value} late.",
         "turbulence, which the accelerometer feels at once", delay(*ACCELEROMETER)),
    Term("q.delay", "q", 0, "s", "ms", -0.3, 0.3, 1e-3, "The pitch rate is {value} late.",
         "attitude measured by another instrument", delay("q")),
    Term("q.scale", "q", 0, "1", "%", -0.3, 0.3, 0.006, "The pitch rate's scale is off by {value}.",
         "a slow turn through a known attitude", gain("q")),
    Term("imu.delay", "q theta ax az", 0, "s", "ms", -0.3, 0.3, 1e-3,
         "Attitude, rate and accelerations are all {value} late.",
         "turbulence: a gust reaches the vane and the imu but not the elevator", delay(*IMU)),
    Term("theta.bias", "theta", 0, "rad", "deg", -0.1, 0.1, 3e-3, "The pitch attitude's zero is off by {value}.",
         "levelling on the ground", bias("theta")),
    Term("theta.scale", "theta", 0, "1", "%", -0.3, 0.3, 0.006, "The pitch attitude's scale is off by {value}.",
         "a tilt table on the ground", gain("theta"), price=_RARE),
    Term("elevator.lag", "elevator", 0, "s", "ms", -0.3, 0.5, 1e-3, "The elevator is measured with a lag of {value}.",
         "turbulence: a gust reaches the vane and the imu but not the elevator", sensor_lag("elevator"), relinear=True),
    Term("elevator.scale", "elevator", 0, "1", "%", -0.6, 1.5, 0.1, "The elevator's scale is off by {value}.",
         "a rigging check on the ground: in flight only the product with Cm_de shows", gain("elevator"), relinear=True),
    Term("elevator.backlash", "elevator", 0, "rad", "deg", 0, 0.05, 1e-3,
         "The elevator has {value} of play between sensor and surface.",
         "small and large doublets: play does not grow with the input", _backlash, relinear=True),
    Term("elevator.nonlinearity", "elevator", 0, "1", "%", -0.6, 1.0, 0.1,
         "The elevator's sensor bends: at 10 deg it shows {value} more than a straight one would.",
         "small and large doublets, and two trims", _cubic, relinear=True),
    Term("dynamic_pressure.scale", "dynamic_pressure airspeed", 0, "1", "%", -0.4, 0.6, 0.02,
         "The dynamic pressure is off by {value}.", "a calm manoeuvre, and ground-speed runs on reverse headings",
         _pitot_gain, relinear=True),
    Term("dynamic_pressure.lag", "dynamic_pressure airspeed", 0, "s", "s", -0.5, 3, 0.05,
         "The air data lag by {value}.", "u-gusts: airspeed against horizontal acceleration", sensor_lag(*PITOT)),
    Term("mass.scale", "mass", 0, "1", "%", -0.4, 0.6, 0.04, "The mass is off by {value}.",
         "trimmed flight at another speed, or the fuel log", _inertia("mass"), aerodynamic=True, relinear=True),
    Term("inertia.scale", "iyy", 0, "1", "%", -0.6, 1.0, 0.05, "The pitch inertia is off by {value}.",
         "turbulence, which moves the aircraft without the elevator; or another loading", _inertia("iyy"),
         aerodynamic=True, relinear=True),
    Term("cg.shift", "Cm", 0, "m", "ft", -1, 1, 0.05, "The CG is {value} further aft than the profile says.",
         "another loading, or trim at several speeds", _cg_aft, aerodynamic=True, relinear=True),
    Term("aero.icing", "CL Cm CD", 0, "1", "1", -1.5, 6, 0.3,
         "All derivatives have moved as they do with ice, {value} times the reference condition.",
         "drag at several speeds, and the same manoeuvre without ice", _icing, aerodynamic=True, relinear=True),
    Term("aero.alpha_squared", "CL", 0, "1", "1", -60, 60, 1.5,
         "Lift bends with the angle of attack: CL has a term of {value} alpha2.",
         "doublets of two amplitudes, or at two trims", derivative("CL_alpha2"), aerodynamic=True),
    Term("aero.speed_terms", "CL", 0, "1", "1", -3, 3, 0.1, "Lift depends on speed itself: CL_V = {value}.",
         "a slow speed change at constant elevator", derivative("CL_V"), aerodynamic=True),
    Term("aero.unsteady_lift", "CL Cm", 0, "1", "%", -1, 4, 0.2,
         "Lift follows the angle of attack with {value} more memory than the profile says.",
         "a multisine in calm air: phase of lift against the inertial angle of attack",
         _memory("lift_motion", "lift_gust"), aerodynamic=True),
    Term("gust.tail_penetration", "CL Cm", 0, "1", "%", -1, 2, 0.03,
         "Gusts meet the tail later by {value} of its arm than the profile says.",
         "a calm manoeuvre: it shows in turbulence only", unsteady("tail_penetration"), aerodynamic=True,
         gust_only=True),
    Term("aero.downwash_lag", "CL Cm", 0, "s", "ms", -0.1, 0.5, 0.01,
         "The downwash reaches the tail {value} later than the tail arm over the speed.",
         "a calm multisine and one in turbulence", unsteady("downwash_delay"), aerodynamic=True),
    Term("aero.CL_q", "CL", 0, "1", "1", -40, 40, 2, "Lift follows pitch rate: CL_q = {value}.",
         "a multisine in calm air", derivative("CL_q"), aerodynamic=True),
    Term("aero.CL_de", "CL", 0, "1", "1", -3, 3, 0.1, "The elevator itself lifts: CL_de = {value}.",
         "a multisine in calm air", derivative("CL_de"), aerodynamic=True),
    Term("thrust.moment", "Cm", 0, "m", "ft", -3, 3, 0.05, "Thrust pitches the aircraft with an arm {value} longer.",
         "idle and full power at one speed", _thrust_arm, ("thrust",), aerodynamic=True),
    Term("velocity.delay", "v_north v_east v_down", 0, "s", "ms", -0.5, 1.5, 5e-3, "The velocity is {value} late.",
         "vertical speed against the integral of the normal acceleration", delay(*VELOCITY), ("v_down",)),
)  # fmt: skip

BY_ID: Final[Mapping[str, Term]] = {t.id: t for t in EFFECTS}

DERIVATIVES: Final = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
PRIOR_SHARE: Final = 0.10
"""Standard deviation of a derivative, as a share of it, where the profile states none."""


@dataclass(frozen=True, slots=True)
class Nuisance:
    """A quantity known only so well: it may move, at a price."""

    name: str
    sd: float
    extend: Extend
    relinear: bool = False
    relative: bool = False
    """Whether moving it multiplies."""
    step: float = 1.0
    """Over what share of the standard deviation its slope is taken."""


def nuisance_priors(aircraft: Aircraft) -> tuple[Nuisance, ...]:
    """The derivatives with the profile's standard deviations, and what instruments and trims are off by."""
    found = []
    for name in DERIVATIVES:
        stated = aircraft.derivatives.get(name)
        if stated is not None and stated.value:
            share = (stated.sd or PRIOR_SHARE * abs(stated.value)) / abs(stated.value)
            found.append(Nuisance(name, share, derivative(name, relative=True), True, True))
    found += [
        Nuisance("theta bias", 0.1 * _DEG, bias("theta")),
        Nuisance("az bias", 0.005 * G0, bias("az")),
        Nuisance("ax bias", 0.003 * G0, bias("ax")),
        Nuisance("q bias", 0.05 * _DEG, bias("q")),
        Nuisance("CL_0", 0.01, derivative("CL_0")),
        Nuisance("Cm_0", 0.005, derivative("Cm_0")),
        Nuisance("CD_0", 0.003, _zero_drag),
    ]
    return tuple(found)


def extended(aircraft: Aircraft, values: Mapping[str, float]) -> Aircraft:
    """The profile with effects in it, by id."""
    for name, value in values.items():
        aircraft = BY_ID[name].extend(aircraft, value)
    return aircraft


NEEDS_MEMORY: Final = ("aero.unsteady_lift", "aero.downwash_lag", "gust.tail_penetration")


def judged_effects(aircraft: Aircraft, present: Iterable[str], gusty: bool, held: bool) -> tuple[Term, ...]:
    """What can be named from these signals: `held` tells that the velocity repeats its values."""
    there = set(present)
    out = []
    for term in EFFECTS:
        if any(n not in there for n in term.needs) or (term.gust_only and not gusty):
            continue
        if term.id == "velocity.delay" and held:
            continue  # shifting a staircase always finds a few milliseconds
        if term.id == "gust.lead" and aircraft.boom is None:
            continue  # a share of a distance that is not known
        if term.id in ("alpha_vane.upwash_memory",) and aircraft.unsteady.upwash_motion is None:
            continue
        if term.id in NEEDS_MEMORY and not aircraft.unsteady.memory:
            continue
        if term.id in ("aero.CL_q", "aero.CL_de") and aircraft.value(term.id.removeprefix("aero.")):
            continue  # allowed for with the profile's own uncertainty
        out.append(term)
    return tuple(out)

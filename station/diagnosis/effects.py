"""The catalogue: every effect that diagnosis can name, one row each with all that is known of it.

An effect is a change of the aircraft's profile, of its model or of its instruments, by one value in SI; the same
profile corrects measured signals, predicts, is simulated and is written to a file. Nothing else in this wing names an
effect: what distinguishes one is a field of its row.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Final

from station.conventions import G0
from station.diagnosis.lateral_effects import LATERAL_EFFECTS
from station.diagnosis.term import Kinematic, Term
from station.profile import Aircraft
from station.profile.profile_changes import (
    ATTACHED,
    backlash,
    bias,
    boom,
    boom_mode,
    cg_aft,
    cubic,
    delay,
    derivative,
    gain,
    icing,
    imu_forward,
    indicial_amplitude,
    inertia,
    pitot_gain,
    sensor_lag,
    separation,
    speed_lift,
    thrust_arm,
    unchanged,
    unsteady,
    vane_dynamics,
)
from station.rows import UsageError

VELOCITY: Final = ("v_north", "v_east", "v_down")
ACCELEROMETER: Final = ("ax", "az")
IMU: Final = ("q", "theta", "ax", "az")
PITOT: Final = ("dynamic_pressure", "airspeed")


def _has_indicial_lift(a: Aircraft) -> bool:
    return a.unsteady.memory


def _double_upwash(a: Aircraft) -> tuple[str, float] | None:
    return None if a.boom is None else (DOUBLE_UPWASH, a.boom.steady_calibration - 1)


_DEG: Final = math.radians(1)
_RARE: Final = 4.0
"""An attitude that is integrated and levelled has no scale to be wrong: one case in eight of gyro and attitude apart,
where turbulence leaves the two alike."""
_BENT: Final = 10.0
"""Flow may leave the wing at any of ten angles (twice the logarithm of that, 4.6), and sharpness, lag, return and
moment are fitted with it, which noise pays for with about 1 each."""
_LEAST_SHARE: Final = 0.02
"""Of the distance to the vane or to the tail: no drawing says better where on them a gust is met."""
DOUBLE_UPWASH: Final = "alpha_vane.double_upwash"

_STALLS: Final = tuple(math.radians(x) for x in (4, 6, 8, 10, 12, 14, 16, 18, 20, 22))
"""Angles of attack at which flow may leave the wing, closer to each other than it takes it to leave (2/a1)."""

_ALL: Final = ("theta", "v_down", "v_north", "alpha_vane", "lift", "moment", "drag")
_BY_VANE: Final = ("alpha_vane", "lift", "moment", "drag")
_BY_ACCELEROMETER: Final = ("v_down", "v_north", "lift", "drag")
_TWO_SPEEDS: Final = "one calm and one turbulent manoeuvre, or doublets at two speeds"
_LOAD_FACTOR: Final = "a load-factor change at constant pitch rate, or a multisine in place of doublets"
_GUST_AT_VANE: Final = "turbulence: a gust reaches the vane and the imu but not the elevator"

EFFECTS: Final[tuple[Term, ...]] = (
    Term("alpha_vane.delay", "alpha_vane", "s", "ms", -0.3, 0.5, 2e-3, "The alpha vane is delayed by {value}.",
         f"{_TWO_SPEEDS}: a delay is a time, a position a distance", delay("alpha_vane"), _BY_VANE,
         kinematic=Kinematic("vane delay", 0.01, lambda a: () if a.boom else ("alpha_vane.position",))),
    Term("alpha_vane.scale", "alpha_vane", "1", "%", -0.6, 1.5, 0.01, "The alpha vane has a scale error of {value}.",
         "a multisine in place of doublets, and a load-factor change at constant pitch rate", gain("alpha_vane"),
         _BY_VANE, same_value=_double_upwash,
         kinematic=Kinematic("vane scale", 0.02)),
    Term("alpha_vane.position", "alpha_vane", "m", "ft", -12, 12, 0.15,
         "The alpha vane sits {value} further ahead of the CG than the profile says.", _TWO_SPEEDS, boom("vane_x"),
         _BY_VANE),
    Term("alpha_vane.bias", "alpha_vane", "rad", "deg", -0.3, 0.3, 3e-3, "The alpha vane has a bias of {value}.",
         "trimmed flight at two speeds: mass acts through lift, a bias does not", bias("alpha_vane"), _BY_VANE,
         kinematic=Kinematic("vane bias", math.radians(0.2))),
    Term("alpha_vane.dynamics", "alpha_vane", "1", "%", -0.7, 2, 0.1,
         "The vane's natural frequency differs from the profile's by {value}.",
         "the vane's spectrum at 5 to 12 Hz in turbulence", vane_dynamics, _BY_VANE),
    Term("alpha_vane.upwash_memory", "alpha_vane", "1", "%", -1, 3, 0.1,
         "The unsteady part of the upwash at the vane differs from the profile's by {value}.",
         "a multisine in calm air and one in turbulence", indicial_amplitude("upwash_motion", "upwash_gust"),
         _BY_VANE, applies=lambda a: a.unsteady.upwash_motion is not None),
    Term("boom.flexure", "alpha_vane", "rad s2/m", "deg/g", -1 * _DEG / G0, 1 * _DEG / G0, 1e-4,
         "The boom flexes by {value} of normal acceleration.", _LOAD_FACTOR, boom("flexure"), _BY_VANE),
    Term("boom.mode", "alpha_vane", "rad s2/m", "deg/g", 0, 1 * _DEG / G0, 1e-4,
         "The boom flexes by {size} with the acceleration of its tip, through its first bending mode.",
         "a sharp doublet: the tip's acceleration leads that of the CG", boom_mode, _BY_VANE),
    Term("gust.lead", "alpha_vane", "1", "%", -1, 2, 0.03,
         "Gusts arrive at the vane earlier than the profile says, by {value} of the vane's distance ahead of the CG.",
         "a calm manoeuvre: it shows in turbulence only", boom("gust_lead"), _BY_VANE, aerodynamic=True,
         gust_only=True, applies=lambda a: a.boom is not None, least=_LEAST_SHARE),
    Term("accelerometer.position", "ax az", "m", "ft", -5, 5, 0.1,
         "The accelerometer sits {value} further ahead than the rig says.",
         "a sharp doublet: position shows with pitch acceleration", imu_forward, _BY_ACCELEROMETER),
    Term("accelerometer.scale", "ax az", "1", "%", -0.3, 0.3, 0.01, "The accelerometer has a scale error of {value}.",
         "a tumble test on the ground", gain(*ACCELEROMETER), _BY_ACCELEROMETER),
    Term("accelerometer.bias", "az", "m/s2", "g", -3, 3, 0.02, "The normal accelerometer has a bias of {value}.",
         "a tumble test on the ground", bias("az"), _BY_ACCELEROMETER,
         kinematic=Kinematic("az_bias", 0.01 * G0, lambda _: ("theta.bias",))),
    Term("accelerometer.delay", "ax az", "s", "ms", -0.3, 0.3, 2e-3, "The accelerometer is delayed by {value}.",
         "turbulence, which the accelerometer feels at once", delay(*ACCELEROMETER), _BY_ACCELEROMETER),
    Term("q.delay", "q", "s", "ms", -0.3, 0.3, 1e-3, "The pitch rate is delayed by {value}.",
         "attitude measured by another instrument", delay("q"), _ALL),
    Term("q.scale", "q", "1", "%", -0.3, 0.3, 0.006, "The pitch rate has a scale error of {value}.",
         "a slow turn through a known attitude", gain("q"), _ALL),
    Term("q.bias", "q", "rad/s", "deg/s", -0.2, 0.2, 1e-3, "The pitch-rate gyro has a bias of {value}.",
         "the gyro at rest on the ground", bias("q"), _ALL, searched=False,
         kinematic=Kinematic("q_bias", math.radians(0.1))),
    Term("imu.delay", "q theta ax az", "s", "ms", -0.3, 0.3, 1e-3,
         "Attitude, rate and accelerations are all delayed by {value}.", _GUST_AT_VANE, delay(*IMU), _ALL),
    Term("theta.bias", "theta", "rad", "deg", -0.1, 0.1, 3e-3, "The pitch attitude has a bias of {value}.",
         "levelling on the ground", bias("theta"), _ALL),
    Term("theta.scale", "theta", "1", "%", -0.3, 0.3, 0.006, "The pitch attitude has a scale error of {value}.",
         "a tilt table on the ground", gain("theta"), _ALL, price=_RARE),
    Term("elevator.lag", "elevator", "s", "ms", -0.3, 0.5, 1e-3, "The elevator is measured with a lag of {value}.",
         _GUST_AT_VANE, sensor_lag("elevator"), ("lift", "moment")),
    Term("elevator.delay", "elevator", "s", "ms", -0.3, 0.5, 1e-3, "The elevator is measured {value} late.",
         "a sharp doublet: a delay keeps its edges, a lag rounds them", delay("elevator"), ("lift", "moment")),
    Term("elevator.scale", "elevator", "1", "%", -0.6, 1.5, 0.1, "The elevator's sensor has a scale error of {value}.",
         "a rigging check on the ground: in flight only the product with Cm_de shows", gain("elevator"),
         ("lift", "moment")),
    Term("elevator.backlash", "elevator", "rad", "deg", 0, 0.05, 1e-3,
         "There is {size} of backlash between the elevator's sensor and the surface.",
         "small and large doublets: backlash does not grow with the input", backlash("elevator"), ("lift", "moment"),
         # How much of the noise a backlash stops depends on how the drive rests: in six flights of the second
         # simulation what is found is too small by 0.1 to 2.9 of the noise stated; corrections.DITHER is 2 of it.
         # Judged from where an interval with that tells it from none.
         least_in_noise=4.0, unsure_in_noise=2.0),
    Term("elevator.nonlinearity", "elevator", "1", "%", -0.95, 4.0, 0.1,
         "The elevator's sensor is nonlinear: at 10 deg its cubic term adds {value} to the reading.",
         "small and large doublets, and two trims", cubic, ("lift", "moment")),
    Term("dynamic_pressure.scale", "dynamic_pressure airspeed", "1", "%", -0.4, 0.6, 0.02,
         "The dynamic pressure has a scale error of {value}.",
         "a calm manoeuvre, and ground-speed runs on reverse headings", pitot_gain, _BY_VANE,
         kinematic=Kinematic("airspeed_scale", 0.02, sound_vane=True)),
    Term("dynamic_pressure.lag", "dynamic_pressure airspeed", "s", "s", -0.05, 3, 0.05,
         "The air data lag by {value}.", "u-gusts: airspeed against horizontal acceleration", sensor_lag(*PITOT),
         _BY_VANE),
    Term("mass.scale", "mass", "1", "%", -0.4, 0.6, 0.04, "The mass differs from the profile's by {value}.",
         "trimmed flight at another speed, or the fuel log", inertia("mass"), ("lift", "drag"), aerodynamic=True),
    Term("inertia.scale", "iyy", "1", "%", -0.6, 1.0, 0.05, "The pitch inertia differs from the profile's by {value}.",
         "turbulence, which moves the aircraft without the elevator; or another loading", inertia("iyy"), ("moment",),
         aerodynamic=True),
    Term("cg.shift", "Cm", "m", "ft", -1, 1, 0.05, "The CG is {value} further aft than the profile says.",
         "another loading, or trim at several speeds", cg_aft, _ALL[1:], aerodynamic=True),
    Term("aero.icing", "CL Cm CD", "1", "1", -1.5, 6, 0.3,
         "All derivatives have moved as they do with ice, {value} times the reference condition.",
         "drag at several speeds, and the same manoeuvre without ice", icing, ("lift", "moment", "drag"),
         aerodynamic=True),
    Term("aero.alpha_squared", "CL", "1", "1", -60, 60, 1.5,
         "Lift is nonlinear in the angle of attack: CL has a term of {value} alpha2.",
         "doublets of two amplitudes, or at two trims", derivative("CL_alpha2"), ("lift",), aerodynamic=True),
    Term("aero.Cm_alpha_squared", "Cm", "1", "1", -60, 60, 1.0,
         "The moment is nonlinear in the angle of attack: Cm has a term of {value} alpha2.",
         "doublets of two amplitudes, or at two trims", derivative("Cm_alpha2"), ("moment",), aerodynamic=True),
    Term("aero.separation", "CL", "rad", "deg", 0.06, 0.9, 3e-3,
         "The flow leaves the wing: half of it is gone at {size} of angle of attack.",
         "a stall, entered and left slowly", separation, ("lift",), null=ATTACHED, probes=_STALLS, price=_BENT,
         aerodynamic=True, applies=lambda a: a.separation.alpha_star is None),
    Term("aero.speed_terms", "CL", "1", "1", -3, 3, 0.1, "Lift depends on speed itself: CL_V = {value}.",
         "a slow speed change at constant elevator", speed_lift, ("lift",), aerodynamic=True),
    Term("aero.unsteady_lift", "CL Cm", "1", "%", -1, 4, 0.2,
         "The unsteady part of the lift (its indicial response) differs from the profile's by {value}.",
         "a multisine in calm air: phase of lift against the inertial angle of attack",
         indicial_amplitude("lift_motion", "lift_gust"), ("lift", "moment"), aerodynamic=True,
         applies=_has_indicial_lift),
    Term("gust.tail_penetration", "CL Cm", "1", "%", -1, 2, 0.03,
         "Gusts arrive at the tail later than the profile says, by {value} of the tail arm.",
         "a calm manoeuvre: it shows in turbulence only", unsteady("tail_penetration"), ("lift", "moment"),
         aerodynamic=True, gust_only=True, applies=_has_indicial_lift, least=_LEAST_SHARE),
    Term("aero.downwash_lag", "CL Cm", "s", "ms", -0.1, 0.5, 0.01,
         "The downwash reaches the tail {value} later than the tail arm over the speed.",
         "a calm multisine and one in turbulence", unsteady("downwash_delay"), ("lift", "moment"), aerodynamic=True,
         applies=_has_indicial_lift),
    Term("aero.CL_q", "CL", "1", "1", -40, 40, 2, "Lift follows pitch rate: CL_q = {value}.",
         "a multisine in calm air", derivative("CL_q"), ("lift",), aerodynamic=True,
         applies=lambda a: not a.value("CL_q")),
    Term("aero.CL_de", "CL", "1", "1", -3, 3, 0.1, "The elevator itself lifts: CL_de = {value}.",
         "a multisine in calm air", derivative("CL_de"), ("lift",), aerodynamic=True,
         applies=lambda a: not a.value("CL_de")),
    Term("thrust.moment", "Cm", "m", "ft", -3, 3, 0.05, "Thrust pitches the aircraft with an arm {value} longer.",
         "idle and full power at one speed", thrust_arm, ("moment",), aerodynamic=True, needs=("thrust",)),
    Term("velocity.delay", "v_north v_east v_down", "s", "ms", -0.5, 1.5, 5e-3, "The velocity is delayed by {value}.",
         "vertical speed against the integral of the normal acceleration", delay(*VELOCITY), _ALL[1:],
         needs=("v_down",), kinematic=Kinematic("velocity delay", 0.03),
         where_held=False),  # shifting a staircase always finds a few milliseconds
    Term("gust.vertical", "alpha_vane CL Cm", "m/s", "m/s", 0, 20, 0.1,
         "The air moves: a vertical gust of {size} (standard deviation), process noise that the profile's model lacks.",
         "the same manoeuvre in calm air", unchanged, searched=False, aerodynamic=True),
    Term(DOUBLE_UPWASH, "alpha_vane", "1", "%", -0.6, 1.5, 0.01,
         "The upwash was taken out of the alpha vane before it was recorded, by {value}.",
         "the instrument's calibration record", gain("alpha_vane"), _BY_VANE, searched=False),
    Term("stream.dropout", "rows", "1", "%", 0, 1, 0.01, "{size} of the rows lack a signal.",
         "the recorder's own counters", unchanged, searched=False),
)  # fmt: skip

SIGNAL_EFFECTS: Final[Mapping[str, Term]] = {
    "sign": Term("sign", "", "1", "1", -1, 1, 2, "The sign is wrong.", "a look at the calibration", unchanged,
                 searched=False),
    "unit": Term("unit", "", "1", "1", 0, math.inf, 1, "The unit is wrong.", "a look at the calibration", unchanged,
                 searched=False),
    "stale": Term("stale", "", "s", "s", 0, 60, 0.02, "Each value is repeated for {size} before it is new.",
                  "the instrument's own rate", unchanged, searched=False),
}  # fmt: skip
"""What may befall any signal, prefixed with its name (`elevator.sign`): seen before any fit."""

BY_ID: Final[dict[str, Term]] = {t.id: t for t in (*EFFECTS, *LATERAL_EFFECTS)}


def signal_effect(signal: str, kind: str, sentence: str = "") -> Term:
    """A row of SIGNAL_EFFECTS for one signal, with a sentence of its own where there is one."""
    row = SIGNAL_EFFECTS[kind]
    return replace(row, id=f"{signal}.{kind}", target=signal, sentence=sentence or f"{signal}: {row.sentence}")


def derivative_effect(name: str, aircraft: Aircraft) -> Term:
    """Of a derivative (`Cm_q`): how far it is from the profile's, relative; or its value where the profile has none."""
    known, stated = f"aero.{name}", aircraft.value(name)
    series = {"CL": ("lift",), "Cm": ("moment",), "CY": ("side_force",), "Cl": ("roll",), "Cn": ("yaw",)}
    shown, experiment = series.get(name[:2], ()), "a multisine in calm air"
    if stated:
        return Term(known, name[:2], "1", "%", -1, 3, 0.05, f"{name} differs from the profile's by {{value}}.",
                    experiment, derivative(name, relative=True), shown, aerodynamic=True)  # fmt: skip
    lacking = Term(known, name[:2], "1", "1", -math.inf, math.inf, 1.0, f"The model lacks {name} = {{value}}.",
                   experiment, derivative(name), shown, aerodynamic=True)  # fmt: skip
    return BY_ID.get(known, lacking)


def extended(aircraft: Aircraft, values: Mapping[str, float]) -> Aircraft:
    """The profile with effects in it, by id. Raises UsageError for an unknown id, naming the nearest known one."""
    for name, value in values.items():
        if name not in BY_ID:
            near = difflib.get_close_matches(name, BY_ID, n=1, cutoff=0.3)
            hint = f": did you mean {near[0]}?" if near else ""
            raise UsageError(f"no effect named {name}{hint}\nknown: {', '.join(BY_ID)}")
        aircraft = BY_ID[name].extend(aircraft, value)
    return aircraft


def judged_effects(
    aircraft: Aircraft, present: Iterable[str], gusty: bool, held: bool, lateral: bool = False
) -> tuple[Term, ...]:
    """The candidates of a search with these signals: `held` where the velocity repeats its values; along the flight, or
    `lateral`."""
    there = set(present)
    return tuple(
        t
        for t in BY_ID.values()
        if t.searched
        and t.lateral == lateral
        and there.issuperset(t.needs)
        and (gusty or not t.gust_only)
        and (t.where_held or not held)
        and t.applies(aircraft)
    )

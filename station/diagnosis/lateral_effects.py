"""The catalogue's lateral rows.

Not in it, for no flight shows them: zeros of heading and of the sideslip vane (a steady wind across, and the asymmetry
of any aircraft, look the same), a CG or an accelerometer beside the plane of symmetry (an aileron's trim; squares of
rates), and zeros of the surfaces (trims).
"""

from __future__ import annotations

from functools import partial
from typing import Final

from station.diagnosis.term import Term
from station.profile import Aircraft
from station.profile.profile_changes import (
    backlash,
    bias,
    boom,
    delay,
    fin,
    gain,
    imu_down,
    imu_forward,
    inertia,
    lateral_icing,
    principal_axes,
    sensor_lag,
)

IMU: Final = ("p", "r", "phi", "psi", "ay")
_BY_VANE: Final = ("beta_vane", "side_force", "roll", "yaw")
_BY_SURFACE: Final = ("side_force", "roll", "yaw")
_BY_ROLL_RATE: Final = ("bank", "v_across", *_BY_SURFACE)
_BY_HEADING: Final = ("heading", "v_across", *_BY_VANE)
_BY_ACCELEROMETER: Final = ("v_across", "side_force")
_ALL: Final = ("bank", *_BY_HEADING)
_MOMENTS: Final = ("roll", "yaw")
_TWO_SPEEDS: Final = "one calm and one turbulent manoeuvre, or doublets at two speeds"
_GUST: Final = "turbulence: a gust reaches the vane and the imu but not the surfaces"
_GROUND: Final = "a rigging check on the ground: in flight only the product with its derivatives shows"


def _has_fin(a: Aircraft) -> bool:
    return a.fin is not None and a.fin.lift_slope > 0


_row = partial(Term, lateral=True)
_aero = partial(Term, lateral=True, aerodynamic=True)

LATERAL_EFFECTS: Final[tuple[Term, ...]] = (
    _row("beta_vane.delay", "beta_vane", "s", "ms", -0.3, 0.5, 2e-3, "The sideslip vane is delayed by {value}.",
         f"{_TWO_SPEEDS}: a delay is a time, a position a distance", delay("beta_vane"), _BY_VANE),
    _row("beta_vane.scale", "beta_vane", "1", "%", -0.6, 1.5, 0.01, "The sideslip vane has a scale error of {value}.",
         "flat turns without yaw rate, or a multisine in place of doublets", gain("beta_vane"), _BY_VANE),
    _row("beta_vane.position", "beta_vane", "m", "ft", -12, 12, 0.15,
         "The sideslip vane sits {value} further ahead of the CG than the profile says.", _TWO_SPEEDS, boom("vane_x"),
         _BY_VANE),
    _row("p.delay", "p", "s", "ms", -0.3, 0.3, 1e-3, "The roll rate is delayed by {value}.",
         "attitude measured by another instrument", delay("p"), _BY_ROLL_RATE),
    _row("p.scale", "p", "1", "%", -0.3, 0.3, 0.006, "The roll rate has a scale error of {value}.",
         "a roll through a known bank", gain("p"), _BY_ROLL_RATE),
    _row("p.bias", "p", "rad/s", "deg/s", -0.2, 0.2, 1e-3, "The roll-rate gyro has a bias of {value}.",
         "the gyro at rest on the ground", bias("p"), _BY_ROLL_RATE, searched=False),
    _row("r.delay", "r", "s", "ms", -0.3, 0.3, 1e-3, "The yaw rate is delayed by {value}.",
         "heading measured by another instrument", delay("r"), _ALL),
    _row("r.scale", "r", "1", "%", -0.3, 0.3, 0.006, "The yaw rate has a scale error of {value}.",
         "a turn through a known heading", gain("r"), _ALL),
    _row("r.bias", "r", "rad/s", "deg/s", -0.2, 0.2, 1e-3, "The yaw-rate gyro has a bias of {value}.",
         "the gyro at rest on the ground", bias("r"), _ALL, searched=False),
    _row("phi.delay", "phi", "s", "ms", -0.3, 0.3, 1e-3, "The bank angle is delayed by {value}.",
         "attitude measured by another instrument", delay("phi"), _ALL),
    _row("phi.scale", "phi", "1", "%", -0.3, 0.3, 0.006, "The bank angle has a scale error of {value}.",
         "a tilt table on the ground", gain("phi"), _ALL),
    _row("phi.bias", "phi", "rad", "deg", -0.1, 0.1, 3e-3, "The bank angle has a bias of {value}.",
         "levelling on the ground", bias("phi"), _ALL, needs=("v_across",)),
    _row("psi.delay", "psi", "s", "ms", -0.5, 0.5, 1e-3, "The heading is delayed by {value}.",
         "heading measured by another instrument", delay("psi"), _BY_HEADING, needs=("psi",)),
    _row("psi.scale", "psi", "1", "%", -0.3, 0.3, 0.006, "The heading has a scale error of {value}.",
         "a compass swing", gain("psi"), _BY_HEADING, needs=("psi",)),
    _row("imu_lateral.delay", "p r phi psi ay", "s", "ms", -0.3, 0.3, 1e-3,
         "Bank, heading, their rates and the side acceleration are all delayed by {value}.", _GUST, delay(*IMU), _ALL),
    _row("ay.scale", "ay", "1", "%", -0.3, 0.3, 0.01, "The side accelerometer has a scale error of {value}.",
         "a tumble test on the ground", gain("ay"), _BY_ACCELEROMETER),
    _row("ay.bias", "ay", "m/s2", "g", -3, 3, 0.02, "The side accelerometer has a bias of {value}.",
         "a tumble test on the ground", bias("ay"), _BY_ACCELEROMETER, needs=("v_across",)),
    _row("ay.delay", "ay", "s", "ms", -0.3, 0.3, 2e-3, "The side accelerometer is delayed by {value}.",
         "turbulence, which the accelerometer feels at once", delay("ay"), _BY_ACCELEROMETER),
    _row("ay.position", "ay", "m", "ft", -5, 5, 0.1,
         "The side accelerometer sits {value} further ahead than the rig says.",
         "a sharp rudder doublet: position shows with yaw acceleration", imu_forward, _BY_ACCELEROMETER),
    _row("ay.height", "ay", "m", "ft", -5, 5, 0.1, "The side accelerometer sits {value} lower than the rig says.",
         "a sharp aileron doublet: height shows with roll acceleration", imu_down, _BY_ACCELEROMETER),
    *(
        term
        for name in ("aileron", "rudder")
        for term in (
            _row(f"{name}.lag", name, "s", "ms", -0.3, 0.5, 1e-3,
                 f"The {name} is measured {{value}} late, by a lag or a delay.", _GUST, sensor_lag(name), _BY_SURFACE),
            _row(f"{name}.scale", name, "1", "%", -0.6, 1.5, 0.1,
                 f"The {name}'s sensor has a scale error of {{value}}.", _GROUND, gain(name), _BY_SURFACE),
            _row(f"{name}.backlash", name, "rad", "deg", 0, 0.05, 1e-3,
                 f"There is {{size}} of backlash between the {name}'s sensor and the surface.",
                 "small and large doublets: backlash does not grow with the input", backlash(name), _BY_SURFACE,
                 # As of the elevator.
                 least_in_noise=4.0, unsure_in_noise=2.0),
        )
    ),
    _aero("inertia.roll", "ixx", "1", "%", -0.6, 1.0, 0.05, "The roll inertia differs from the profile's by {value}.",
          "turbulence, which moves the aircraft without the ailerons; or another loading", inertia("ixx"), _MOMENTS),
    _aero("inertia.yaw", "izz", "1", "%", -0.6, 1.0, 0.05, "The yaw inertia differs from the profile's by {value}.",
          "turbulence, which moves the aircraft without the rudder; or another loading", inertia("izz"), _MOMENTS),
    _aero("inertia.axes", "ixz", "rad", "deg", -0.3, 0.3, 0.01,
          "The principal axes are turned {value} nose down from where the profile has them.",
          "a sharp aileron doublet: yaw acceleration at once", principal_axes, _MOMENTS),
    _aero("aero.lateral_icing", "CY Cl Cn", "1", "1", -1.5, 5, 0.3,
          "The lateral derivatives, dihedral among them, have moved as they do with ice, {value} times the reference "
          "condition.", "the same manoeuvre without ice", lateral_icing, _BY_SURFACE),
    _aero("gust.fin_penetration", "CY Cl Cn", "1", "%", -1, 2, 0.03,
          "Gusts arrive at the fin later than the profile says, by {value} of its arm.",
          "a calm manoeuvre: it shows in turbulence only", fin("penetration"), _BY_SURFACE, gust_only=True,
          applies=_has_fin, least=0.02),
    _aero("aero.sidewash_lag", "CY Cl Cn", "s", "ms", -0.1, 0.5, 0.01,
          "The sidewash reaches the fin {value} later than its arm over the speed.",
          "a calm multisine and one in turbulence", fin("sidewash_delay"), _BY_SURFACE,
          applies=lambda a: _has_fin(a) and a.fin is not None and a.fin.sidewash != 0),
)  # fmt: skip

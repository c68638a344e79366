"""What air that rolls and yaws along the span makes of an aircraft's motion, and of what its instruments show.

No vane shows such gusts. They act on wing and body as rates would, and the aircraft answers: roll rate, sideslip and
all that follows are no longer independent of what the moments leave, and least squares take the answer for the
derivatives (station/estimation/input_instruments.py). As noise whose way into the signals an aircraft tells, they are
taken out of the score like any sensor's. An autopilot's answer is not in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.measured_record import Record
from station.estimation import input_instruments as motion
from station.model.coefficients import specific_force_at_cg
from station.numerics.second_order import second_order_response
from station.profile import NO_BOOM, Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

GUSTS: Final = ("roll_gust", "yaw_gust")
"""rad/s at the wing's middle; the span meets the mean of them along the way that it takes."""
_BY: Final = ("beta", "p", "r")


def gust_answer(record: Record, aircraft: Aircraft, frequencies: Array) -> Mapping[str, Mapping[str, Complex]]:
    """By gust, the change of each signal (SI) per rad/s of it, (frequencies,), about the record's mean flight."""
    x = {
        name: float(np.mean(record.signals.get(name, 0.0))) for name in ("airspeed", "dynamic_pressure", "theta", "az")
    }
    own, span, speed = aircraft.inertia, aircraft.geometry.span, x["airspeed"]
    half, s = 0.5 * span / speed, 2j * np.pi * frequencies
    body = np.array([own.mass, aircraft.geometry.wing_area, span, own.ixx or 1.0, own.izz or 1.0, own.ixz])
    state = np.array([speed, x["dynamic_pressure"], half, x["theta"]])
    slopes = np.zeros((motion.EQUATIONS, motion.PLACES))
    slopes[:, :3] = [[aircraft.value(f"{c}_{name}") for name in _BY] for c in ("CY", "Cl", "Cn")]
    slopes[:, 3:] = half * (slopes[:, 1:3] - _of_fin(aircraft))
    moved = np.zeros((motion.MOTIONS, len(GUSTS), len(frequencies)), dtype=np.complex128)
    motion.respond(body, state, slopes, np.ascontiguousarray(frequencies), moved)
    met = 1 / (1 + s * (4 / np.pi) * span / speed)  # MIL-F-8785C 3.7.1
    boom, place = aircraft.boom or NO_BOOM, aircraft.imu_at(record.imu)
    vane = second_order_response(boom.vane_frequency, boom.vane_damping, s)
    found = {}
    for k, name in enumerate(GUSTS):
        beta, p, r = moved[0, k], moved[1, k] / half, moved[2, k] / half
        side = slopes[0, 0] * beta + slopes[0, 1] * half * p + slopes[0, 2] * half * r + slopes[0, 3 + k]
        side = side * x["dynamic_pressure"] * aircraft.geometry.wing_area / own.mass
        phi, psi = (p + r * np.tan(x["theta"])) / s, r / np.cos(x["theta"]) / s
        across = (side - x["az"] * phi) / s
        seen = across / speed - psi + np.sin(x["theta"]) * phi
        # Small, so that products of rates do not count: what is felt at the imu less what is felt at the CG.
        _, felt, _ = specific_force_at_cg((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (s * p, 0.0, s * r), place)
        shown = {
            "p": p, "r": r, "phi": phi, "psi": psi, "v_across": across, "ay": side - felt,
            "beta_vane": vane * (seen + (r * boom.vane_x - p * boom.vane_z) / speed),
        }  # fmt: skip
        found[name] = {signal: met * y for signal, y in shown.items()}
    return found


def _of_fin(aircraft: Aircraft) -> Array:
    """(3, 2): the fin's share of the derivatives by p b/2V and r b/2V, which no gradient along the span meets."""
    fin, span = aircraft.fin, aircraft.geometry.span
    if fin is None:
        return np.zeros((motion.EQUATIONS, len(GUSTS)))
    force = -fin.lift_slope * 2 / span * np.array([fin.height, -fin.arm * (1 + fin.sidewash)])
    return np.stack([force, force * fin.height / span, -force * fin.arm / span])

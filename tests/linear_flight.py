"""Level flight's longitudinal equations, linearised, as the textbook has them: an oracle of its own code."""

from __future__ import annotations

import math

import numpy as np

from station.numerics.atmosphere import atmosphere
from station.profile import Aircraft
from station.simulation.airframe import Constants

G = 9.80665


def textbook(aircraft: Aircraft, c: Constants) -> np.ndarray:
    """(5, 6): V, alpha, q, theta and elevator about level flight, by them and by the elevator that is asked for, from
    the equations in wind axes (Stevens and Lewis 2003, section 2.5) and the profile's own derivatives."""
    density, v = float(atmosphere(c.trim_height)[2]), aircraft.value
    m, iyy, area, chord = (
        aircraft.inertia.mass,
        aircraft.inertia.iyy,
        aircraft.geometry.wing_area,
        aircraft.geometry.chord,
    )
    assert iyy is not None
    assert aircraft.drag is not None
    drag = aircraft.drag
    lag = aircraft.elevator.time_constant
    thrust, line, arm = c.trim_thrust, aircraft.thrust_angle, aircraft.thrust_pitch_arm
    weight = m * G
    pressure = 0.5 * density * c.trim_speed**2
    cl_trim = (weight - thrust * math.sin(c.trim_alpha + line)) / (pressure * area)
    cm_trim = -thrust * arm / (pressure * area * chord)

    def rates(s: np.ndarray) -> np.ndarray:
        speed, alpha, q, theta, de, asked = s
        force, hat = 0.5 * density * speed**2 * area, q * chord / (2 * speed)
        cl = cl_trim + v("CL_alpha") * (alpha - c.trim_alpha) + v("CL_q") * hat + v("CL_de") * de
        cm = cm_trim + v("Cm_alpha") * (alpha - c.trim_alpha) + v("Cm_q") * hat + v("Cm_de") * de
        lift, dragging = force * cl, force * (drag.zero_lift + drag.induced * cl**2)
        climb, thrusting = theta - alpha, alpha + line
        faster = (thrust * math.cos(thrusting) - dragging) / m - G * math.sin(climb)
        turning = q - (lift + thrust * math.sin(thrusting)) / (m * speed) + G * math.cos(climb) / speed
        return np.array([faster, turning, (force * chord * cm + thrust * arm) / iyy, q, (asked - de) / lag])

    trim = np.array([c.trim_speed, c.trim_alpha, 0.0, c.trim_alpha, 0.0, 0.0])
    assert np.abs(rates(trim)).max() < 1e-6
    step = 1e-5
    return np.stack([(rates(trim + step * e) - rates(trim - step * e)) / (2 * step) for e in np.eye(6)], axis=1)

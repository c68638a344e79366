"""Trimmed level flight in still air as the instruments show it: what is flown until the simulation is compiled."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0
from station.numerics.atmosphere import atmosphere
from station.profile import Aircraft, Flight, Order
from station.simulation.airframe import find_trim
from station.simulation.declared_signals import EmulatedSignals
from station.simulation.legs import ORIGIN


class LevelFlight:
    """A source of rows that are all alike: where `Simulation` of the same flight begins, without gusts."""

    def __init__(self, aircraft: Aircraft, flight: Flight, declared: EmulatedSignals | None = None) -> None:
        """Raises ProfileError if the aircraft cannot be trimmed. `declared`: what the rig declares."""
        self._row = level_flight(aircraft, flight)
        if declared is not None:
            trim = find_trim(aircraft, flight.speed, flight.altitude)
            angles = dict.fromkeys(("alpha", "alpha_inertial"), trim.alpha) | {"elevator_drive": trim.elevator}
            still = dict.fromkeys(("time", "alpha_gust", "w_gust", "u_gust"), 0.0)
            now = {**self._row, **angles, **still, "az_boom": -G0 * math.cos(trim.alpha)}
            made = declared.rows({name: np.array([value]) for name, value in now.items()})
            self._row |= {name: float(values[0]) for name, values in made.items()}

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """Nothing: level it is."""

    def advance(self, n: int) -> Mapping[str, NDArray[np.float64]]:
        """The next n rows, (n,) each."""
        return {name: np.full(n, value) for name, value in self._row.items()}


def level_flight(aircraft: Aircraft, flight: Flight) -> dict[str, float]:
    """Every signal in SI, with bias, gain and nonlinearity of the profile's instruments; the boom does not bend."""
    trim = find_trim(aircraft, flight.speed, flight.altitude)
    pressure, temperature, density = atmosphere(flight.altitude)
    boom = aircraft.boom
    vane = boom.zero + trim.alpha / boom.steady_calibration if boom else trim.alpha
    true = {
        "alpha_vane": vane,
        "airspeed": flight.speed,
        "dynamic_pressure": 0.5 * (aircraft.air_density or density) * flight.speed**2,
        "static_pressure": pressure,
        "air_temperature": temperature,
        "ax": G0 * math.sin(trim.alpha),
        "az": -G0 * math.cos(trim.alpha),
        "theta": trim.alpha,
        "psi": flight.heading,
        "v_north": flight.speed * math.cos(flight.heading) + flight.wind_north,
        "v_east": flight.speed * math.sin(flight.heading) + flight.wind_east,
        "latitude": ORIGIN[0],
        "longitude": ORIGIN[1],
        "altitude": flight.altitude,
        "elevator": trim.elevator,
        "thrust": trim.thrust,
        "mass": aircraft.inertia.mass,
    }
    still = ("beta_vane", "p", "q", "r", "ay", "phi", "v_down", "aileron", "rudder", "pdot", "qdot", "rdot")
    true |= dict.fromkeys(still, 0.0)
    for name, e in aircraft.instruments.items():
        if name in true:
            true[name] = e.gain * (true[name] + e.cubic * true[name] ** 3) + e.bias
    return true

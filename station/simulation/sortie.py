"""What flies a card, and whole flights with their sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNALS, TICK_HZ
from station.profile import Aircraft, Card, Flight, Rig
from station.rows import ProfileError
from station.simulation.declared_signals import emulated_signals
from station.simulation.gust_plane import across
from station.simulation.installed import Installed, Source
from station.simulation.jsbsim_flight import JsbsimFlight
from station.simulation.motion import DT, EVERY
from station.simulation.sensors import Channel, Sensor, sensors_of
from station.simulation.side_flow import fin_apart, has_lateral
from station.simulation.six_degrees import LateralSimulation
from station.simulation.stepped_flight import SteppedFlight
from station.simulation.three_degrees import Simulation

Position = tuple[float, float, float]


def check_air(aircraft: Aircraft, flight: Flight) -> None:
    """Raises ProfileError where the flight's air asks more of the aircraft than its profile says."""
    if flight.is_plane:
        across(aircraft)
        if has_lateral(aircraft):
            fin_apart(aircraft)


def source_of(
    aircraft: Aircraft, card: Card, imu_position: Position = (0.0, 0.0, 0.0), seed: int | None = None
) -> Source:
    """The flight that a card asks for, true: three degrees of freedom, six where it moves ailerons or rudder, goes
    elsewhere or meets air that rolls it, or JSBSim's. `imu_position` from the CG in body axes, m; `seed` replaces the
    flight's. Raises ProfileError.
    """
    place = aircraft.imu_at(imu_position)
    if card.flight.source == "jsbsim":
        return JsbsimFlight(aircraft, card.flight, card.manoeuvres, place, seed, card.pilot)
    rolls = (card.flight.is_plane and has_lateral(aircraft)) or card.pilot.moved - {"elevator"}
    if rolls or card.goes_places or any(m.surface != "elevator" for m in card.inputs):
        return LateralSimulation(aircraft, card.flight, card.manoeuvres, place, seed, pilot=card.pilot)
    return Simulation(aircraft, card.flight, card.manoeuvres, place, seed, pilot=card.pilot)


def installed(aircraft: Aircraft, rig: Rig, card: Card, seed: int | None = None) -> Installed:
    """The card's flight as the profile's instruments show it; what the rig's devices add is still to come."""
    drifts = {name: sensor.drift for name, sensor in sensors_of(rig).items()}
    seed = card.flight.seed if seed is None else seed
    source, declared = source_of(aircraft, card, rig.imu_position, seed), emulated_signals(rig)
    return Installed(source, aircraft, drifts, seed, card.flight.truth, declared)


def fly(
    aircraft: Aircraft,
    sensors: Rig | Mapping[str, Sensor],
    card: Card,
    duration_s: float,
    seed: int | None = None,
) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
    """A whole flight of a card: what the sensors show at 50 Hz, and the truth at the same instants.

    With a rig, its signals with its noise; with a mapping, every signal, perfect where the mapping has none. The errors
    of the profile's instruments are in what is shown, and so is where the imu is. Both dictionaries hold (n,) arrays in
    SI; truth has "time" (s), all signals without errors, TRUTH, and
    what the card changes of the aircraft, by key. `seed` replaces the flight's. Raises ProfileError.
    """
    if isinstance(sensors, Rig):
        channels, place = sensors_of(sensors), sensors.imu_position
    else:
        channels, place = {name: sensors.get(name, Sensor()) for name in SIGNALS}, (0.0, 0.0, 0.0)
    seed = card.flight.seed if seed is None else seed
    drifts = {name: sensor.drift for name, sensor in channels.items()}
    declared = emulated_signals(sensors) if isinstance(sensors, Rig) else None
    flight = Installed(source_of(aircraft, card, place, seed), aircraft, drifts, seed, card.flight.truth, declared)
    exact = flight.advance(math.ceil(duration_s * TICK_HZ) * EVERY)
    shown = {
        name: Channel(name, s, DT, EVERY, seed).measure(exact[name]) for name, s in channels.items() if name in exact
    }
    return shown, {name: values[::EVERY].copy() for name, values in flight.truth.items()}


def stepped(
    aircraft: Aircraft, rig: Rig, card: Card, outside: Collection[str], measured: bool
) -> tuple[SteppedFlight, Callable[[Source], Installed]]:
    """The card's flight a step at a time, those `outside` moved by somebody else, and what makes the profile's
    instruments look at a source of its rows. Raises ProfileError."""
    flight = SteppedFlight(aircraft, card, aircraft.imu_at(rig.imu_position), outside, measured)
    drifts = {name: sensor.drift for name, sensor in sensors_of(rig).items()}

    def make(source: Source) -> Installed:
        shown = Installed(source, aircraft, drifts, card.flight.seed, card.flight.truth, emulated_signals(rig))
        if shown.ahead_s > 0:
            raise ProfileError(
                f"aircraft {aircraft.name}: instruments: a negative latency or lag shows what comes: not in real time"
            )
        return shown

    return flight, make

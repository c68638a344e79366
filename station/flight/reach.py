"""What a step's own inputs, the travel of the surfaces and the card's limits leave within reach, before it is flown,
and what a profile asks for that this rig or this air does not have."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from station.conventions import G0, LATERAL, TICK_HZ
from station.profile import AVERAGED_ALONE, Aircraft, Card, Flight, Manoeuvre, Profiles, Step, elsewhere
from station.profile.quantity import SI_NUMBERS
from station.rows import ProfileError
from station.simulation.input_table import input_table

OF_SURFACE: Final = {"de": ("elevator",), "da": ("aileron",), "dr": ("rudder",)}
"""What has to move for a surface's own derivative; for the others any surface of their axis."""


def unmoved(step: Step) -> list[str]:
    """Derivatives wanted of a step, none of whose inputs shows them."""
    moved = {m.surface for m in step.inputs}
    without: dict[tuple[str, ...], list[str]] = {}
    for name in step.accept:
        axis = ("aileron", "rudder") if name in LATERAL else ("elevator",)
        surfaces = OF_SURFACE.get(name.partition("_")[2], axis)
        if not moved.intersection(surfaces):
            without.setdefault(surfaces, []).append(name)
    return [
        f"{', '.join(names)}: no input moves the {' or the '.join(surfaces)}: add one to the step, "
        "or take them out of accept"
        for surfaces, names in without.items()
    ]


def beyond_travel(inputs: Sequence[Manoeuvre], aircraft: Aircraft) -> list[str]:
    """Surfaces that are asked for more than they move. Raises ProfileError for an input that cannot be made."""
    if not inputs:
        return []
    said = []
    for name, about_trim in input_table(inputs, TICK_HZ).surfaces.items():
        peak, travel = float(np.abs(about_trim).max()), getattr(aircraft, name).position_limit
        if peak > travel:
            said.append(
                f"an input of {math.degrees(peak):.3g} deg, the {name} moves {math.degrees(travel):.3g} deg: "
                f"less amplitude, or the profile's {name}.position_limit is wrong"
            )
    return said


def travel_remarks(card: Card, aircraft: Aircraft) -> Iterator[str]:
    """The same of all that a card flies, each with its name. Raises ProfileError as `beyond_travel` does."""
    for name, inputs in (("manoeuvres", card.manoeuvres), *((s.name, s.inputs) for s in card.steps)):
        yield from (f"{name}: {words}" for words in beyond_travel(inputs, aircraft))


def without_effect(profiles: Profiles, emulated: bool) -> list[str]:
    """What the aircraft's profile asks for and this rig, or where it is emulated the card's air, does not have."""
    aircraft, flight, said = profiles.flown, profiles.card.flight, []
    if aircraft.second_vane and aircraft.second_vane.averaged and not elsewhere(profiles.rig.signals, "alpha_vane"):
        said.append(AVERAGED_ALONE)
    has_gusts = bool(flight.gust_sigma or flight.turbulence or flight.gusts)
    swept = bool(aircraft.planform and aircraft.planform.sweep)
    if emulated and swept and has_gusts and not flight.is_plane:
        said.append('planform.sweep changes nothing in air that varies along the path alone: flight.field = "plane"')
    return said


def beyond_flight(step: Step, aircraft: Aircraft, card: Card) -> list[str]:
    """Where level flight, or the turn, in a step's condition needs more angle of attack than the card's limit, or is
    none at all by the profile; and where its input leads beyond a limit. It is asked of an emulated aircraft, which
    flies by the profile, and of a card that states limits; of others the profile may know too little."""
    from station.simulation.airframe import find_trim  # and with it the simulation

    limit, wanted = card.limits.angle_of_attack, step.condition
    speed = wanted.speed if wanted.speed is not None else card.flight.speed if card.emulate else None
    simulated = card.emulate and card.flight.source == "simulation"
    knows = aircraft.value("CL_alpha") and aircraft.value("Cm_de") and not aircraft.kinematics_only
    if speed is None or not knows or not (simulated or card.limits.model_fields_set):
        return []
    altitude = card.flight.altitude if wanted.altitude is None else wanted.altitude
    try:
        alpha = find_trim(aircraft, speed, altitude, wanted.bank).alpha
    except ProfileError as error:
        told = simulated or limit is not None
        return [f"cannot be flown in its condition: {error}: another speed or bank"] if told else []
    if limit is not None and alpha >= limit:
        return [
            f"its condition takes {math.degrees(alpha):.1f} deg of angle of attack, limits.angle_of_attack is "
            f"{math.degrees(limit):.3g} deg: more speed, less bank, or another limit"
        ]
    return [] if wanted.bank or not step.inputs else _led_beyond(step, aircraft, card, speed, altitude)


AFTER_S: Final = 3.0
"""Of flight after an input, in which what it has begun is at its largest."""


def _led_beyond(step: Step, aircraft: Aircraft, card: Card, speed: float, altitude: float) -> list[str]:
    """Limits that an input leads beyond, flown by the profile from level flight in still air."""
    from station.simulation.manoeuvres import duration
    from station.simulation.sortie import fly

    still = Flight.model_validate({"speed": speed, "altitude": altitude}, context=SI_NUMBERS)
    begin = min(m.start for m in step.inputs)
    inputs = [m.model_copy(update={"start": m.start - begin + 1.0}) for m in step.inputs]
    flown = card.model_copy(update={"flight": still, "manoeuvres": tuple(inputs), "steps": (), "points": ()})
    try:
        shown, truth = fly(aircraft, {}, flown, max(m.start + duration(m) for m in inputs) + AFTER_S)
    except ProfileError:  # of an input that cannot be made it has been said
        return []
    load, pitch, at = -shown["az"] / G0, shown["theta"], card.limits
    found = (
        ("angle_of_attack", truth["alpha"].max(), at.angle_of_attack),
        ("load_factor", load.max(), at.load_factor),
        ("least_load_factor", -load.min(), None if at.least_load_factor is None else -at.least_load_factor),
        ("nose_up", pitch.max(), at.nose_up),
        ("nose_down", -pitch.min(), at.nose_down),
        ("bank", np.abs(shown["phi"]).max(), at.bank),
        ("sideslip", np.abs(shown["beta_vane"]).max(), at.sideslip),
    )
    said = []
    for name, peak, limit in found:
        if limit is not None and peak > limit:
            sign = -1 if name == "least_load_factor" else 1
            most, allowed = (
                f"{sign * x:.3g}" if "load" in name else f"{math.degrees(x):.3g} deg" for x in (peak, limit)
            )
            said.append(
                f"its input leads to {most} by the profile, limits.{name} is {allowed}: "
                "less amplitude, or another limit"
            )
    return said

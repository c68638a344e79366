"""A profile's mass and inertia are known to some per cent, and so is every derivative: by closed form."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pytest

from station.conventions import LATERAL, LONGITUDINAL
from station.identification.analysis import identify
from station.identification.request import Request
from station.log import Table
from station.model.airframe_error import relative_errors
from station.profile import Aircraft, Card, Doublet, Flight, load_aircraft, load_rig
from station.rows import ParamEstimate
from station.simulation.sortie import fly

AIRCRAFT, RIG = load_aircraft("twin_otter"), load_rig("bench")
METHODS = ["I", "II", "split", "split+gust", "physical", "VI", "oe", "sidpac"]


@functools.cache
def columns() -> dict[str, np.ndarray]:
    flight = Flight.model_validate({"speed": "110 kt", "altitude": "2500 ft"})
    doublets = [
        Doublet.model_validate({"kind": "doublet", "start": start, "surface": surface, "width": "1 s", **size})
        for start, surface, size in (
            ("22 s", "elevator", {"amplitude": "3.5 deg"}),
            ("28 s", "aileron", {"amplitude": "3 deg"}),
            ("34 s", "rudder", {"amplitude": "3 deg"}),
        )
    ]
    card = Card(name="t", aircraft="t", rig="bench", flight=flight, manoeuvres=tuple(doublets))
    return fly(AIRCRAFT, RIG, card, 45.0, 4)[0]


def made(aircraft: Aircraft, with_mass: bool = False) -> dict[str, dict[str, ParamEstimate]]:
    shown = {n: c for n, c in columns().items() if n not in ("mass", "thrust", "pdot", "qdot", "rdot")}
    if with_mass:
        shown["mass"] = np.full(len(shown["q"]), AIRCRAFT.inertia.mass)
    table = Table(np.arange(len(shown["q"])) * 0.02, shown, aircraft, 0)
    found = identify(table, aircraft, Request(METHODS, 20.0, noise=RIG.noise_si())).methods
    return {m: {p.name: p for p in one.parameters} for m, one in found.items()}


def known(**changes: Any) -> Aircraft:
    doubt = AIRCRAFT.uncertainty.model_copy(update={"mass": 0.0, "recorded_mass": 0.0, "inertia": 0.0, **changes})
    return AIRCRAFT.model_copy(update={"uncertainty": doubt})


@functools.cache
def exact(with_mass: bool = False) -> dict[str, dict[str, ParamEstimate]]:
    """By a profile whose mass and inertia are known."""
    return made(known(), with_mass)


def by_inertia(roll: float, yaw: float) -> np.ndarray:
    """Of both moments, with 7 % of each moment of inertia and of the product."""
    i = AIRCRAFT.inertia
    assert i.ixx
    assert i.izz
    turned = np.linalg.solve([[i.ixx, -i.ixz], [-i.ixz, i.izz]], [roll, yaw])
    parts = ([[i.ixx, 0], [0, 0]], [[0, 0], [0, i.izz]], [[0, -i.ixz], [-i.ixz, 0]])
    return np.sqrt(sum((0.07 * np.array(part) @ turned) ** 2 for part in parts))


@pytest.mark.parametrize(
    ("key", "with_mass"), [("mass", False), pytest.param("recorded_mass", True, marks=pytest.mark.slow)]
)
def test_every_error_holds_those_of_mass_and_inertia(key: str, with_mass: bool) -> None:
    """Force derivatives go with the mass, the pitching moment's with its inertia, those of roll and yaw together with
    their matrix of it: another matrix times the angular acceleration that they are told by."""
    doubtful = made(known(**{key: 0.04, "inertia": 0.07}), with_mass)
    counted = 0
    for method in METHODS:
        for name, p in exact(with_mass)[method].items():
            more = doubtful[method][name]
            if not math.isfinite(p.sd):
                continue
            share = (0.04 if name[:2] in ("CL", "CY") else 0.07) * p.value
            if name in LATERAL and name[:2] != "CY":
                share = by_inertia(*(exact(with_mass)[method][f"{axis}{name[2:]}"].value for axis in ("Cl", "Cn")))[
                    ("Cl", "Cn").index(name[:2])
                ]
            assert more.value == p.value
            assert more.sd == pytest.approx(math.hypot(p.sd, share), rel=1e-9), (method, name)
            counted += 1
    assert counted >= 6 * len(LONGITUDINAL) + 3 * len(LATERAL)


@pytest.mark.slow
def test_a_profile_five_per_cent_too_heavy_gives_derivatives_five_per_cent_too_large() -> None:
    """Which the errors are for: lift by mass, moment by inertia, whatever the method."""
    heavy = AIRCRAFT.inertia.model_copy(
        update={"mass": 1.05 * AIRCRAFT.inertia.mass, "iyy": 1.05 * (AIRCRAFT.inertia.iyy or 0.0)}
    )
    right, wrong = exact(), made(known().model_copy(update={"inertia": heavy}))
    for method in ("I", "split", "physical"):
        for name in ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de"):
            ratio = wrong[method][name].value / right[method][name].value
            # The tail's own lift, known beside, does not scale, and thrust, estimated from the drag polar, does.
            assert ratio == pytest.approx(1.05, abs=0.012), (method, name)


def test_an_air_data_error_of_which_the_profile_speaks_is_in_every_error() -> None:
    """Coefficients are forces over the dynamic pressure; rates are normalised by its root."""
    plain = known(inertia=0.05)
    doubtful = known(inertia=0.05, dynamic_pressure=0.04)
    names = ("CL_alpha", "CL_q", "Cm_alpha", "Cm_q", "Cn_beta", "Cn_r", "CL_de")
    before, after = relative_errors(plain, names)[0], relative_errors(doubtful, names)[0]
    more = [0.04, 0.02, 0.04, 0.02, 0.04, 0.02, 0.04]
    assert after.tolist() == pytest.approx(np.hypot(before, more).tolist())


@pytest.mark.slow
def test_with_the_dynamic_pressure_four_per_cent_too_high_derivatives_are_as_much_too_small() -> None:
    """Which that error is for; airspeed with it, as one pitot gives both."""
    right = exact()
    high = {n: c.copy() for n, c in columns().items() if n not in ("mass", "thrust", "pdot", "qdot", "rdot")}
    high["dynamic_pressure"] *= 1.04
    high["airspeed"] *= math.sqrt(1.04)
    table = Table(np.arange(len(high["q"])) * 0.02, high, known(), 0)
    found = identify(table, known(), Request(["II"], 20.0, noise=RIG.noise_si())).methods["II"]
    for name, share in (("CL_alpha", 1.0), ("Cm_alpha", 1.0), ("Cm_de", 1.0), ("Cm_q", 0.5)):
        ratio = next(p.value for p in found.parameters if p.name == name) / right["II"][name].value
        assert ratio == pytest.approx(1.04**-share, abs=0.006), name

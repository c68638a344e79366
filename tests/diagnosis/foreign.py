"""Aircraft that the engine was not made on, one slow and one fast, in the blind generator's hands.

Scales go with the aircraft: inputs with its short period, gusts with its speed, and planted effects with what its own
card of three manoeuvres detects.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import blind
import pytest

from station.conventions import to_si
from station.diagnosis import null_fit
from station.diagnosis.detectable import detectable_sizes
from station.diagnosis.likelihood import Problem
from station.identification.input_ranking import short_period
from station.profile import Aircraft, Doublet, Flight, Multisine, ThreeTwoOneOne, load_aircraft
from station.simulation.airframe import atmosphere

AEROSONDE = {
    "geometry": {"wing_area": "0.55 m2", "span": "2.9 m", "chord": "0.19 m"},
    "inertia": {"mass": "11 kg", "iyy": "1.135 kg m2"},
    "boom": {"vane_x": "0.5 m", "upwash_body": 0.03, "upwash_wing": 0.09, "vane_frequency": "14 Hz",
             "vane_damping": 0.3},
    "derivatives": {"CL_0": 0.23, "Cm_0": 0.0135, "CL_alpha": 5.61, "CL_q": 7.95, "CL_de": 0.13, "Cm_alpha": -2.74,
                    "Cm_q": -38.21, "Cm_de": -0.99},
    "drag": {"zero_lift": 0.043, "induced": 0.03},
    "tail": {"tail_lift_slope": 0.55, "tail_arm": 0.9, "downwash": 0.35},
}  # fmt: skip
"""11 kg. Beard and McLain, Small Unmanned Aircraft, appendix E; tail and vane are ours."""
LEARJET = {
    "geometry": {"wing_area": "230 ft2", "span": "34 ft", "chord": "7 ft"},
    "inertia": {"mass": "13000 lb", "iyy": "18800 slug ft2"},
    "boom": {"vane_x": "6 m", "upwash_body": 0.04, "upwash_wing": 0.02, "vane_frequency": "12 Hz",
             "vane_damping": 0.3},
    "derivatives": {"CL_0": 0.13, "Cm_0": 0.05, "CL_alpha": 5.84, "CL_q": 4.7, "CL_de": 0.46, "Cm_alpha": -0.64,
                    "Cm_q": -15.5, "Cm_de": -1.24},
    "drag": {"zero_lift": 0.0216, "induced": 0.07},
    "tail": {"tail_lift_slope": 0.65, "tail_arm": to_si(20, "ft"), "downwash": 0.38},
}  # fmt: skip
"""Learjet 24, 40,000 ft, Mach 0.7. Roskam, Airplane Flight Dynamics, appendix B, airplane F; tail and vane are ours."""


@dataclass(frozen=True)
class Scene:
    """An aircraft and how it is flown, SI."""

    aircraft: Aircraft
    speed: float
    altitude: float
    peak: float
    """Of the elevator, rad."""
    imu: tuple[float, float, float]

    @property
    def sigmas(self) -> tuple[float, ...]:
        """Gusts that turn the flow as much as blind.SIGMAS do at 110 kt."""
        return tuple(s * self.speed / to_si(110, "kt") for s in blind.SIGMAS)


def made(name: str, given: Mapping[str, object]) -> Aircraft:
    plain = {k: v for k, v in given.items() if k not in ("tail", "derivatives")}
    values = {n: {"value": v} for n, v in given["derivatives"].items()}
    aircraft = Aircraft.model_validate({"name": name, "derivatives": values, **plain})
    unsteady = load_aircraft("twin_otter").unsteady.model_copy(update={**given["tail"], "reference_chord": None})
    return aircraft.model_copy(update={"unsteady": unsteady})


SCENES = {
    "aerosonde": Scene(made("aerosonde", AEROSONDE), 25.0, 100.0, math.radians(6), (0.05, 0.0, 0.02)),
    "learjet": Scene(made("learjet", LEARJET), 206.3, 12192.0, math.radians(2), (1.5, 0.0, 0.2)),
}


def inputs_of(scene: Scene):
    """blind.inputs for a scene."""
    frequency, _ = short_period(scene.aircraft, scene.speed, float(atmosphere(scene.altitude)[2]))
    period, peak = 2 * math.pi / frequency, scene.peak

    def inputs(kind: str):
        if kind == "doublets":
            rows = ((6.0, peak, 0.35), (18.0, -peak, 0.55), (30.0, peak, 0.25))
            shapes = ({"kind": "doublet", "start": s, "amplitude": a, "width": w * period} for s, a, w in rows)
            return tuple(Doublet.model_validate(x, context="si") for x in shapes)
        if kind == "3-2-1-1":
            rows = ((5.0, 0.8 * peak, 0.28), (24.0, -0.8 * peak, 0.2))
            shapes = ({"kind": kind, "start": s, "amplitude": a, "unit": u * period} for s, a, u in rows)
            return tuple(ThreeTwoOneOne.model_validate(x, context="si") for x in shapes)
        high = min(3.0, max(1.5, 2.2 / period))
        given = {"kind": kind, "start": 4.0, "duration": 38.0, "low": 0.1, "high": high, "amplitude": 0.8 * peak}
        return (Multisine.model_validate(given, context="si"),)

    return inputs


@contextmanager
def flying(scene: Scene) -> Iterator[None]:
    """The blind generator flies this aircraft."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blind, "aircraft", lambda: scene.aircraft)
        patch.setattr(blind, "inputs", inputs_of(scene))
        patch.setattr(blind, "IMU", scene.imu)
        air = {"speed": scene.speed, "altitude": scene.altitude}
        patch.setattr(blind, "Flight", lambda: Flight().model_copy(update=air))
        yield


def sizes(scene: Scene, sigma: float) -> dict[str, float]:
    """What a card of three manoeuvres detects, SI; while `flying`."""
    problem = Problem(blind.prepared(blind.Case(seed=1, sigma=sigma, fit_on=blind.KINDS)), scene.aircraft)
    return {d.id: d.found for d in detectable_sizes(problem, null_fit.null(problem))}

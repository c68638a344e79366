"""The methods of estimation, one row each with all its properties; imports nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

Angle = Literal["steady", "delayed", "split", "none"]
"""Which angle of attack a method regresses on: the calibrated vane with its rate term; that, delayed until the gust is
at the CG; the split one, whose gust part alone is delayed; or none, because it models the vane itself."""


@dataclass(frozen=True, slots=True)
class Method:
    """A way to the derivatives: its name on the command line and in files, what it does and what it needs."""

    name: str
    sentence: str
    angle: Angle
    live: bool = False
    """Runs at every tick."""
    turbulence_only: bool = False
    """Applied only where the turbulence detector says so (Martos 2013)."""
    needs_spectra: bool = False
    """Runs as the live ones do, but needs the vane's spectra from minutes of flight first."""
    lateral: bool = False
    """Also gives lateral derivatives."""
    by_input: bool = False
    """Its lateral derivatives are by what the surfaces move, or gusts are in its noise: they do not mislead it."""
    definition: Literal["derivatives", "quasi_steady"] = "quasi_steady"
    """Of what it estimates: the aircraft's own derivatives, as in a table, unsteady lift and late tail apart; or what
    equation error with a perfect angle of attack gives of the manoeuvre in calm air, these in it."""
    runner: str = ""
    """Of a post-flight method, "module:function", imported when it runs: (FlightRecord, Axes) -> MethodResult."""
    begin: str = ""
    """Of a long one that needs the recording as it is, "module:function": (identification.preparation.Prepared) -> what
    gives the MethodResult when it is called, made beside the other methods until then."""
    colour: int = 0xC0C0C0FF
    """On every plot, RGBA; told apart by colour-blind eyes too (after Okabe and Ito 2008)."""

    @property
    def errors_widened(self) -> bool:
        """Whether it is a post-flight method that takes the vane's for the angle of attack at the CG, so that gusts
        bias it: its standard errors are widened by its distance from the split."""
        return bool(self.runner) and self.angle == "steady"

    @property
    def is_split(self) -> bool:
        """Whether it needs the split angle of attack: attitude and accelerations."""
        return self.angle == "split"


METHODS: Final = {
    m.name: m
    for m in (
        Method("I", "equation error in the time domain, vane calibrated steadily", "steady", lateral=True,
               runner="station.estimation.published.batch:method_i", colour=0x999999FF),
        Method("II", "recursive Fourier transform, vane calibrated steadily with its rate term", "steady", live=True,
               lateral=True, colour=0xE69F00FF),
        Method("III", "II with all of alpha delayed by x/V", "delayed", live=True, turbulence_only=True,
               colour=0xF0E442FF),
        Method("IV", "II with delay and scale by frequency, from spectra measured before", "delayed",
               turbulence_only=True, needs_spectra=True, colour=0xD55E00FF),
        Method("V", "III with the upwash falling with frequency as Sears' lift", "delayed", live=True,
               turbulence_only=True, colour=0x56B4E9FF),
        Method("VI", "extended Kalman filter", "steady",
               runner="station.estimation.published.motion_methods:method_vi", colour=0xB0B0FFFF),
        Method("split", "motion and gust parts of the vane corrected apart", "split", live=True, lateral=True,
               colour=0x2BD9A5FF),
        Method("split+gust", "split, with tail and fin meeting the gust later; laterally by what the surfaces move",
               "split", live=True, lateral=True, by_input=True, colour=0xE58AC0FF),
        Method("physical", "wing, tail and gust as the regressors, with uncertain constants", "none", live=True,
               definition="derivatives", colour=0xF5F5F5FF),
        Method("ml", "all instruments and the aircraft in one likelihood, with uncertain constants", "none",
               lateral=True, by_input=True, definition="derivatives",
               begin="station.diagnosis.derivative_fit:begun", colour=0x0072B2FF),
        Method("oe", "output error", "steady", lateral=True,
               runner="station.estimation.published.motion_methods:method_oe"),
        Method("fe", "filter error", "steady", lateral=True,
               runner="station.estimation.published.motion_methods:method_fe"),
        Method("sidpac", "II with SIDPAC's settings", "steady", lateral=True,
               runner="station.estimation.published.batch:method_sidpac"),
    )
}  # fmt: skip
LIVE: Final = tuple(name for name, m in METHODS.items() if m.live)
LIVE_LATERAL: Final = tuple(name for name in LIVE if METHODS[name].lateral)
MEASURED: Final = next(name for name, m in METHODS.items() if m.needs_spectra)


def recommended(given: Mapping[str, int], level: str) -> str | None:
    """The method to believe first, or None.

    `given`: how many derivatives each method gives that applies; `level`: of turbulence. The first that
    gives as much as split does, or II where nothing tells the motion apart: after the flight ml; physical, whose
    profile has wing, tail and boom; split+gust where there is gust energy; else split.
    """
    split = given.get("split", 0)
    for own in ("ml", "physical"):
        if 0 < given.get(own, 0) >= (split or given.get("II", 0)):
            return own
    if level not in ("calm", "unknown") and 0 < given.get("split+gust", 0) >= split:
        return "split+gust"
    return "split" if split else None

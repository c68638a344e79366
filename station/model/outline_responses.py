"""What an aircraft's outline says of its unsteady lift: indicial responses, upwash at the vane, downwash, sidewash.

Lifting surfaces are thin and flat, and stand in a vortex lattice; bodies and propellers do not. The downwash is
averaged along the tail by width. Sidewash of wing and body at the fin: DATCOM (Hoak 1978) 5.4.1, of experiments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from station.numerics.indicial import Response, frequency_response
from station.numerics.indicial import response as response_of
from station.numerics.vortex_lattice import Lattice, StepResponse, WingResponse, trapezoid, wing_response
from station.profile.aircraft import Aircraft, Indicial
from station.profile.outline import Planform
from station.rows import ProfileError

Array = NDArray[np.float64]

PANELS: Final = (6, 14)
"""Chordwise and spanwise on a half: 10 and 24 move lift slope by 0.6 %, upwash by 0.3 %, downwash by 0.8 %."""
FOLLOWED: Final = 5.0
"""Spans after which a step is settled to within 0.1 % but for the upwash, 0.3 %."""
SLENDEREST: Final = 0.5
FULLEST: Final = 60.0
"""Aspect ratios of wings: slender deltas have some 1, the sailplane with the longest wing for its area 51."""
CHORDS: Final = (0.75, 2.2)
"""Mean aerodynamic over mean chord: 1 of a rectangle, by Cauchy and Schwarz no less of any wing, 4/3 of a delta, 2 of
Concorde's ogive; and what reference areas and chords differ by, with or without the part in the body."""
_FIRST: Final = 0.5
"""Chords after a step from which on responses are fitted: before, a panel's depth shows."""
_SAMPLES: Final = 120
"""Of a response, evenly in the logarithm of the way, that its exponentials are fitted to."""
TERMS: Final = {"lift_motion": 2, "lift_gust": 2, "upwash_motion": 2, "upwash_gust": 3}
"""Exponentials of each response."""
_SETTLING: Final = 12.0
"""Chords behind the tail over which the arrival of the downwash is fitted."""
BAND_HZ: Final = (0.1, 2.0)
"""In which responses are compared: that of the estimates."""


@dataclass(frozen=True, slots=True)
class FittedResponse:
    """A response as exponentials."""

    chords: Array
    """Travelled since the CG's quarter chord made the step, or the leading edge of the mean chord met the gust."""
    values: Array
    """The lattice's."""
    indicial: Indicial
    """Fitted."""
    worst: float
    """Largest difference of the fit."""
    profile: Indicial | None
    """What the profile has."""
    difference: float
    """Of the profile's response from the fitted one, at worst in BAND_HZ, as a share; nan without one."""


@dataclass(frozen=True, slots=True)
class Number:
    """One key of the profile."""

    key: str
    words: str
    value: float
    """Of the outline; SI."""
    profile: float | None
    """What the profile has; None where it has nothing."""
    unit: str = ""

    @property
    def difference(self) -> float:
        """The profile's from this, as a share; nan where there is none."""
        return self.profile / self.value - 1 if self.profile and self.value else math.nan


@dataclass(frozen=True, slots=True)
class PlanformAnswer:
    """What `station planform` found."""

    aircraft: Aircraft
    speed: float
    """m/s, at which lengths are times."""
    aspect_ratio: float
    lift_slope: float
    """Of the wing alone, thin and flat, per rad."""
    wing_lift_slope: float | None
    """The profile's CL_alpha less its tail's share, per rad, to which upwash and downwash are scaled; None: unknown."""
    responses: dict[str, FittedResponse]
    numbers: tuple[Number, ...]
    downwash: tuple[Array, Array] | None
    """At the tail after a step of the angle of attack: seconds, share of the steady one."""
    remarks: tuple[str, ...]

    def downwash_modelled(self) -> Array:
        """What a profile makes of that: the wing's lift, `tail_arm`/V and `downwash_delay` later."""
        delay = self.number("unsteady.downwash_delay")
        if self.downwash is None or delay is None:
            return np.zeros(0)
        fit, chord = (
            self.responses["lift_motion"].indicial,
            self.aircraft.geometry.wing_area / self.aircraft.geometry.span,
        )
        late = self.downwash[0] - self.aircraft.unsteady.tail_arm / self.speed - delay
        since = late[:, None] * self.speed / chord * np.array(fit.b)
        return np.asarray(np.where(late < 0, 0.0, 1 - np.exp(-np.maximum(since, 0.0)) @ fit.a))

    def number(self, key: str) -> float | None:
        """Of the outline; None where it could not be computed."""
        return next((n.value for n in self.numbers if n.key == key), None)


def planform_answer(aircraft: Aircraft, speed: float) -> PlanformAnswer:
    """Raises ProfileError where geometry and mass are placeholders, or no wing has this geometry."""
    if aircraft.kinematics_only:
        raise ProfileError(f"{aircraft.name}: its geometry is a placeholder (kinematics_only): describe it first")
    _check(aircraft)
    plan = aircraft.planform or Planform()
    geometry, boom, u = aircraft.geometry, aircraft.boom, aircraft.unsteady
    chord = geometry.wing_area / geometry.span
    behind = plan.quarter_chord(geometry.span)
    lattices = (_wing(aircraft, plan, 1), _wing(aircraft, plan, 2))
    points = [(behind - boom.vane_x, abs(boom.vane_y), -boom.vane_z)] if boom else []
    has_tail = plan.tail_area is not None and u.tail_span > 0 and u.tail_arm > 0
    along = _between(lattices[0].y, u.tail_span / 2) if has_tail else np.array([])
    points += [(behind + u.tail_arm, y, plan.tail_height) for y in along]
    travelled = max(FOLLOWED * geometry.span, u.tail_arm + 2 * _SETTLING * chord)
    wing = wing_response(lattices, np.array(points).reshape(-1, 3), travelled)
    scale, own = _scale(aircraft, wing)
    numbers = []
    responses = {
        "lift_motion": _fitted(wing.motion.way, wing.motion.lift, "lift_motion", aircraft, speed),
        "lift_gust": _fitted(_from_edge(wing.gust, behind, chord), wing.gust.lift, "lift_gust", aircraft, speed),
    }
    if boom and _sees_upwash(aircraft, plan) and wing.upwash[0] > 0:
        numbers.append(
            Number(
                "boom.upwash_wing", "upwash at the vane by the wing", float(wing.upwash[0] * scale), boom.upwash_wing
            )
        )
        responses["upwash_motion"] = _fitted(wing.motion.way, wing.motion.upwash[0], "upwash_motion", aircraft, speed)
        gust_way = _from_edge(wing.gust, behind, chord)
        responses["upwash_gust"] = _fitted(gust_way, wing.gust.upwash[0], "upwash_gust", aircraft, speed)
    downwash = None
    if has_tail and plan.tail_area is not None:
        first = 1 if boom else 0
        numbers += [_tail_slope(aircraft, plan.tail_area), _downwash(aircraft, wing, first, scale)]
        way, share = wing.motion.way, _along_tail(wing, first)
        delay = (_arrival(way, wing.motion.lift, share, u.tail_arm, chord) - u.tail_arm) / speed
        its = u.downwash_delay if u.downwash else None
        numbers.append(Number("unsteady.downwash_delay", "downwash later than tail_arm/V", delay, its, "s"))
        downwash = (way / speed, share)
    numbers += _sidewash(aircraft, plan)
    remarks = _remarks(aircraft, plan, has_tail)
    slope = wing.lift_slope
    aspect = geometry.span**2 / geometry.wing_area
    return PlanformAnswer(aircraft, speed, aspect, slope, own, responses, tuple(numbers), downwash, tuple(remarks))


def _check(aircraft: Aircraft) -> None:
    geometry = aircraft.geometry
    span, area, chord = geometry.span, geometry.wing_area, geometry.chord
    aspect, mean = span**2 / area, area / span
    if not SLENDEREST <= aspect <= FULLEST:
        raise ProfileError(
            f"{aircraft.name}: geometry.span {span:.4g} m and wing_area {area:.4g} m2 make an aspect ratio of"
            f" {aspect:.3g}: wings have {SLENDEREST:g} to {FULLEST:g}; correct whichever is wrong, or its unit"
        )
    if not CHORDS[0] <= chord / mean <= CHORDS[1]:
        raise ProfileError(
            f"{aircraft.name}: geometry.chord {chord:.4g} m is {chord / mean:.3g} times wing_area / span, {mean:.4g} m:"
            f" of wings it is {CHORDS[0]:g} to {CHORDS[1]:g}; correct whichever of the three is wrong, or its unit"
        )


def _sees_upwash(aircraft: Aircraft, plan: Planform) -> bool:
    """Whether the vane is ahead of the leading edge, beside which or behind which it is not upwash that it sees."""
    boom, geometry = aircraft.boom, aircraft.geometry
    if boom is None:
        return False
    root, tip = plan.chords(geometry.wing_area, geometry.span)
    aside = min(abs(boom.vane_y), geometry.span / 2)
    edge = (root + (tip - root) * 2 * aside / geometry.span) / 4 - aside * math.tan(plan.sweep)
    return boom.vane_x - plan.quarter_chord(geometry.span) > edge


def _wing(aircraft: Aircraft, plan: Planform, deeper: int) -> Lattice:
    geometry = aircraft.geometry
    root, tip = plan.chords(geometry.wing_area, geometry.span)
    return trapezoid(geometry.span, root, tip, plan.sweep, (PANELS[0] * deeper, PANELS[1]))


def _between(lines: Array, tip: float) -> Array:
    """Where the tail is looked at, m: midway between the lines that the wing's wake is gone along, up to its tip."""
    middle = (lines[1:] + lines[:-1]) / 2
    return np.asarray(middle[middle < max(tip, middle[0] * 1.001)])


def _scale(aircraft: Aircraft, wing: WingResponse) -> tuple[float, float | None]:
    """What the wing's circulation is over that of a thin flat one, by the profile's CL_alpha; and that of its wing."""
    whole, u = aircraft.value("CL_alpha"), aircraft.unsteady
    if whole <= 0:
        return 1.0, None
    own = whole - u.tail_lift_slope * (1 - u.downwash)
    return own / wing.lift_slope, own


def _from_edge(gust: StepResponse, behind: float, chord: float) -> Array:
    """Way since the gust met the leading edge of the mean chord, m."""
    return np.asarray(gust.way - behind + chord / 4)


def _fitted(way: Array, values: Array, name: str, aircraft: Aircraft, speed: float) -> FittedResponse:
    chord = aircraft.geometry.wing_area / aircraft.geometry.span
    chords = way / chord
    at = np.geomspace(_FIRST, chords[-1], _SAMPLES)
    wanted = np.interp(at, chords, values)
    found = exponentials(at, wanted, TERMS[name], starts_at_none=name.endswith("gust"))
    fit = 1 - np.exp(-np.outer(at, found.b)) @ found.a
    its = getattr(aircraft.unsteady, name)
    worst = float(np.max(np.abs(fit - wanted)))
    return FittedResponse(chords, values, found, worst, its, _difference(found, its, aircraft, speed))


def exponentials(chords: Array, values: Array, terms: int, starts_at_none: bool) -> Indicial:
    """The sum of so many exponentials nearest to 1 - values; where the response `starts_at_none` they add up to 1."""

    def amplitudes(logs: Array) -> Array:
        e = np.exp(-np.outer(chords, np.exp(logs)))
        left = 1 - values
        if not starts_at_none:
            return np.asarray(np.linalg.lstsq(e, left, rcond=None)[0])
        rest = np.linalg.lstsq(e[:, :-1] - e[:, -1:], left - e[:, -1], rcond=None)[0]
        return np.append(rest, 1 - rest.sum())

    def error(logs: Array) -> Array:
        return np.asarray(np.exp(-np.outer(chords, np.exp(logs))) @ amplitudes(logs) + values - 1)

    low, high = math.log(1 / chords[-1]), math.log(4.0)
    best = min(
        (least_squares(error, np.linspace(first, math.log(1.5), terms), bounds=(low, high)) for first in (-2.8, -1.2)),
        key=lambda fit: float(fit.cost),
    )
    logs = np.sort(best.x)
    return Indicial(
        a=tuple(round(float(a), 5) for a in amplitudes(logs)), b=tuple(round(float(math.exp(x)), 5) for x in logs)
    )


def _difference(found: Indicial, its: Indicial | None, aircraft: Aircraft, speed: float) -> float:
    if its is None:
        return math.nan
    omega = 2j * math.pi * np.linspace(*BAND_HZ, 20) / speed
    mean = aircraft.geometry.wing_area / aircraft.geometry.span
    theirs = frequency_response(
        response_of(its), omega * (aircraft.unsteady.reference_chord or aircraft.geometry.chord)
    )
    ours: Response = response_of(found)
    return float(np.max(np.abs(theirs / frequency_response(ours, omega * mean) - 1)))


def _tail_slope(aircraft: Aircraft, area: float) -> Number:
    u = aircraft.unsteady
    chord = area / u.tail_span
    pair = (trapezoid(u.tail_span, chord, chord, 0.0, (n, PANELS[1])) for n in (PANELS[0], 2 * PANELS[0]))
    coarse, fine = pair
    slope = wing_response((coarse, fine), np.zeros((0, 3)), chord).lift_slope * area / aircraft.geometry.wing_area
    its = u.tail_lift_slope or None
    return Number("unsteady.tail_lift_slope", "tail's lift slope, of the wing's area", slope, its)


def _downwash(aircraft: Aircraft, wing: WingResponse, first: int, scale: float) -> Number:
    e = -float(np.mean(wing.upwash[first:])) * scale
    return Number("unsteady.downwash", "downwash at the tail, d eps/d alpha", e, aircraft.unsteady.downwash or None)


def _along_tail(wing: WingResponse, first: int) -> Array:
    steady = wing.upwash[first:]
    return np.asarray(steady @ wing.motion.upwash[first:] / steady.sum())


def _arrival(way: Array, lift: Array, share: Array, arm: float, chord: float) -> float:
    """How far the wing flies before its downwash is at the tail as its lift was, m: fitted around that."""
    around = (way > chord) & (way < arm + _SETTLING * chord)

    def error(shift: Array) -> Array:
        return np.asarray(np.interp(way[around] - shift[0], way, lift, left=0.0) - share[around])

    trials = np.linspace(arm - 2 * chord, arm + 4 * chord, 121)
    costs = [float(np.sum(error(np.array([x])) ** 2)) for x in trials]
    return float(trials[int(np.argmin(costs))])


def _sidewash(aircraft: Aircraft, plan: Planform) -> list[Number]:
    if plan.fin_area is None or plan.body_depth is None:
        return []
    geometry = aircraft.geometry
    share = plan.fin_area / geometry.wing_area
    aspect = geometry.span**2 / geometry.wing_area
    # z_w is counted down from the body's middle.
    kept = 0.724 + 3.06 * share / (1 + math.cos(plan.sweep)) - 0.4 * plan.wing_height / plan.body_depth + 0.009 * aspect
    its = aircraft.fin.sidewash if aircraft.fin else None
    return [Number("fin.sidewash", "sidewash at the fin, d sigma/d beta", 1 - kept, its)]


def _remarks(aircraft: Aircraft, plan: Planform, has_tail: bool) -> list[str]:
    said = []
    if aircraft.planform is None:
        said.append("no [planform]: the wing is taken for a rectangle of its area and span")
    if aircraft.boom is None:
        said.append("no [boom]: no upwash at the vane")
    elif not _sees_upwash(aircraft, plan):
        said.append("boom.vane_x is not ahead of the wing: no upwash at the vane")
    if not has_tail:
        u = aircraft.unsteady
        wanted = {
            "planform.tail_area": plan.tail_area,
            "unsteady.tail_span": u.tail_span,
            "unsteady.tail_arm": u.tail_arm,
        }
        lacking = [key for key, value in wanted.items() if not value]
        said.append(f"no downwash: {', '.join(lacking)} missing")
    if plan.fin_area is None or plan.body_depth is None:
        said.append("no sidewash: planform.fin_area and planform.body_depth are needed")
    if aircraft.value("CL_alpha") <= 0:
        said.append("no CL_alpha: upwash and downwash are those of a thin flat wing")
    return said


def with_planform(made: PlanformAnswer) -> Aircraft:
    """The aircraft with what was computed of it; what was not stays."""
    aircraft = made.aircraft
    u = {name: fit.indicial for name, fit in made.responses.items()}
    tables: dict[str, dict[str, object]] = {"unsteady": {"memory": True, **u}, "boom": {}, "fin": {}}
    tables["unsteady"]["reference_chord"] = aircraft.geometry.wing_area / aircraft.geometry.span
    for n in made.numbers:
        table, _, key = n.key.partition(".")
        tables[table][key] = n.value
    update: dict[str, object] = {"unsteady": aircraft.unsteady.model_copy(update=tables["unsteady"])}
    if aircraft.boom is not None:
        update["boom"] = aircraft.boom.model_copy(update=tables["boom"])
    if aircraft.fin is not None:
        update["fin"] = aircraft.fin.model_copy(update=tables["fin"])
    return aircraft.model_copy(update=update)

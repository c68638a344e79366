"""The baseline of test points, and what another point is changed by against it, in per cent with its interval.

Both sides share the profile's mass and inertia, so that what these may be wrong by is in neither's error here. A point
is held against what another baseline point would give: the baseline's mean with its error, and the scatter between
its points.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from station.conventions import LONGITUDINAL
from station.estimation.method_table import METHODS
from station.estimation.results import MethodResult, without_airframe_errors
from station.model.energy_drag import FEWEST, WINDOW_S
from station.model.steady_lift import SteadyLift, induced_doubt, level_lift, outside
from station.numerics.random_effects import NORMAL_95, Pooled, pooled
from station.profile import Aircraft
from station.programme.flown_points import FlownPoint
from station.rows import ParamEstimate, Status

OWN: Final = "derivatives"
CALM: Final = "quasi_steady"
DEFINITIONS: Final = (OWN, CALM)
PROFILE: Final = "profile"
MEASURED: Final = "measured"
"""Where a baseline is from that no point of the recordings belongs to: a profile, or one that was measured."""


LIFT_ERROR: Final = 1e-3
"""Of a point's CL_0 by noise: of 0.01 deg in the mean angle of attack of some windows of 5 s."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """What points are held against: by definition and derivative, the pooled value."""

    values: Mapping[str, Mapping[str, Pooled]]
    """By definition, then by derivative."""
    points: tuple[str, ...]
    """Titles of its points."""
    source: str
    """"points", or PROFILE or MEASURED where no point is one of the baseline's."""
    method: str = ""
    """By which its points were estimated."""
    drag: Pooled | None = None
    """CD_0, where its points have it."""
    lift: Pooled | None = None
    """CL_0, with the slopes of the profile that the points are identified with,"""
    lifts: tuple[float, float] | None = None
    """and between which CL that is, where it is of points."""


@dataclass(frozen=True, slots=True)
class Change:
    """Of one derivative, per cent; NaN where it is not known, and why."""

    estimate: float
    low: float
    high: float
    why: str = ""

    @property
    def is_known(self) -> bool:
        return math.isfinite(self.estimate)

    @property
    def is_significant(self) -> bool:
        """Whether its 95 % interval leaves nought out."""
        return self.is_known and (self.low > 0 or self.high < 0)


def recommended(point: FlownPoint) -> str | None:
    """The point's recommended method that the air during its input lets apply; none in a steep turn."""
    best = point.found.recommended if point.found else None
    if best is None or point.banked or point.methods is None or point.methods[best].status != "ok":
        return None
    return best


def estimates(point: FlownPoint, method: str) -> dict[str, dict[str, ParamEstimate]]:
    """A method's estimates by definition and derivative, errors without those of mass and inertia."""
    if point.methods is None or point.found is None:
        return {}
    result = point.methods[method]
    own = without_airframe_errors(result, point.found.record)
    made: dict[str, dict[str, ParamEstimate]] = {}
    made[METHODS[method].definition] = {p.name: p for p in own.parameters if p.name in LONGITUDINAL}
    if result.quasi_steady:
        beside = without_airframe_errors(_of(result.quasi_steady), point.found.record)
        made[CALM] = {p.name: p for p in beside.parameters}
    if result.status != "ok":
        return {}
    return made


def _of(parameters: tuple[ParamEstimate, ...]) -> MethodResult:
    return MethodResult("ok", parameters=parameters)


def baseline_of(points: Iterable[FlownPoint], aircraft: Aircraft) -> Baseline:
    """Pooled over the points that are the baseline's; the profile's derivatives where there are none."""
    used = [p for p in points if recommended(p)]
    gathered: dict[str, dict[str, list[ParamEstimate]]] = {d: {} for d in DEFINITIONS}
    for point in used:
        for definition, made in estimates(point, recommended(point) or "").items():
            for name, p in made.items():
                if p.status is Status.ESTIMATED and p.sd > 0:
                    gathered[definition].setdefault(name, []).append(p)
    values = {
        d: {name: pooled([p.value for p in ps], [p.sd for p in ps]) for name, ps in by_name.items()}
        for d, by_name in gathered.items()
    }
    if any(values.values()):
        methods = sorted({recommended(p) or "" for p in used})
        drags = [p.drag for p in used if p.drag is not None and p.drag.error > 0]
        drag = pooled([d.value for d in drags], [d.error for d in drags]) if drags else None
        known = [p.drag.lift.lift for p in used if p.drag is not None and p.drag.lift is not None]
        lifts = (min(known), max(known)) if known else None
        titles = tuple(p.title for p in used)
        return Baseline(values, titles, "points", ", ".join(methods), drag, lift_of(used, aircraft), lifts)
    measured = aircraft.measured
    drag = Pooled(measured.CD_0, measured.CD_0_sd, math.nan, 1) if measured and measured.CD_0 is not None else None
    lift = Pooled(measured.CL_0, measured.CL_0_sd, math.nan, 1) if measured and measured.CL_0 is not None else None
    return Baseline({OWN: _of_profile(aircraft), CALM: {}}, (), MEASURED if measured else PROFILE, drag=drag, lift=lift)


def lift_of(points: Iterable[FlownPoint], aircraft: Aircraft) -> Pooled | None:
    """CL_0 of points with the aircraft's slopes; None where none has it."""
    known = [p.drag.lift for p in points if p.drag is not None and p.drag.lift is not None]
    if not known:
        return None
    return pooled([x.at_zero(aircraft) for x in known], [LIFT_ERROR] * len(known))


def _of_profile(aircraft: Aircraft) -> dict[str, Pooled]:
    known = {n: aircraft.derivatives.get(n) for n in LONGITUDINAL}
    return {n: Pooled(d.value, d.sd, math.nan, 1) for n, d in known.items() if d is not None and d.sd}


def change_of(p: ParamEstimate | None, reference: Pooled | None) -> Change:
    """Of an estimate against the baseline."""
    if p is None or p.status is not Status.ESTIMATED:
        return _unknown((p.why if p else "") or "not estimated")
    if reference is None:
        return _unknown("the baseline does not have it")
    base = reference.value
    if abs(base) < 2 * reference.error:
        return _unknown("not significant in the baseline")
    ratio = p.value / base
    ends = (NORMAL_95 * p.sd, ratio * reference.widening * reference.of_another)
    half = 100 * math.hypot(*ends) / abs(base)
    estimate = 100 * (ratio - 1)
    return Change(estimate, estimate - half, estimate + half)


def _unknown(why: str) -> Change:
    return Change(math.nan, math.nan, math.nan, why)


def changes_of(point: FlownPoint, method: str, baseline: Baseline) -> dict[str, Change]:
    """Of every derivative of a method, against the baseline of the same definition."""
    values = compared(point, method, baseline)
    reference = baseline.values.get(definition_of(method, baseline), {})
    return {n: change_of(values.get(n), reference.get(n)) for n in LONGITUDINAL}


def drag_change(point: FlownPoint, baseline: Baseline) -> Change:
    """Of CD_0; in its error is what a recorded thrust is wrong by, of the change too, and what the induced drag may be
    of a lift that the baseline did not have."""
    if point.found is not None and point.found.record.thrust_known and point.drag is None:
        return _unknown(f"fewer than {FEWEST} stretches of {WINDOW_S:g} s have all that drag is told by")
    if point.drag is None or point.found is None:
        return _unknown(point.found.record.why_no_thrust if point.found else point.why or "not estimated")
    if baseline.drag is None:
        return _unknown("the baseline does not have it")
    (value, error, lift), aircraft = point.drag, point.found.aircraft
    doubt = aircraft.uncertainty.thrust * abs(value - baseline.drag.value)
    induced = induced_doubt(aircraft, lift.lift, _lifts(baseline, aircraft, lift)) if lift else 0.0
    error = math.hypot(error, doubt, induced)
    return change_of(ParamEstimate("CD_0", value, error, Status.ESTIMATED, ""), baseline.drag)


def _lifts(baseline: Baseline, aircraft: Aircraft, lift: SteadyLift) -> tuple[float, float]:
    """The least and the largest CL of the baseline."""
    return baseline.lifts or level_lift(aircraft, lift.density)


def lift_change(point: FlownPoint, baseline: Baseline, aircraft: Aircraft) -> Change:
    """Of CL_0, which a vane's zero moves and ice hardly does; its error is that of the mass, fuel and load, and of the
    slope where the baseline was flown at another lift."""
    if point.drag is None or point.drag.lift is None:
        return _unknown(drag_change(point, baseline).why or "elevator or pitch rate is missing")
    lift = point.drag.lift
    by_slope = lift.by_slope(aircraft, outside(lift.lift, _lifts(baseline, aircraft, lift)))
    error = math.hypot(lift.by_mass(aircraft), by_slope, LIFT_ERROR)
    return change_of(ParamEstimate("CL_0", lift.at_zero(aircraft), error, Status.ESTIMATED, ""), baseline.lift)


def definition_of(method: str, baseline: Baseline) -> str:
    """In which a method is held against the baseline: its own where the baseline has that."""
    own = METHODS[method].definition
    return own if baseline.values.get(own) else CALM


def compared(point: FlownPoint, method: str, baseline: Baseline) -> Mapping[str, ParamEstimate]:
    """A method's estimates at a point that are held against the baseline; none where the method gives none."""
    if point.methods is None or method not in point.methods:
        return {}
    return estimates(point, method).get(definition_of(method, baseline), {})


def scatter_of(baseline: Baseline) -> Sequence[str]:
    """What is to be known of a baseline before it is relied upon, in sentences."""
    if baseline.source == MEASURED:
        return ()
    if baseline.source == PROFILE:
        return ("no point is marked as baseline: changes are against the profile's derivatives and their sd",)
    if len(baseline.points) == 1:
        return ("a baseline of one point: by how much points scatter is not known, and not in the intervals",)
    return ()

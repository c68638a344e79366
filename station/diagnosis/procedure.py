"""Records and an aircraft's profile -> a diagnosis, without files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from station.diagnosis import judge
from station.diagnosis.axis import ACROSS, LONGITUDINAL, Axis
from station.diagnosis.backlash_or_noise import searched
from station.diagnosis.candidate import Estimate
from station.diagnosis.checks import first_seen
from station.diagnosis.diagnosis_result import Constant, Effect, Gain, Verdict, by_reduction, verdict_of
from station.diagnosis.effects import BY_ID, derivative_effect, judged_effects
from station.diagnosis.free_parameters import BEYOND, Free
from station.diagnosis.inertial_evidence import INERTIAL, inertial_reduction, is_inertial
from station.diagnosis.judge import RemainingResidual
from station.diagnosis.likelihood import Problem
from station.diagnosis.manoeuvre import Manoeuvre, manoeuvre
from station.diagnosis.measured_record import (
    LATERAL_SURFACES,
    Record,
    describe_missing,
    lateral_record,
    was_moved,
    why_not_lateral,
)
from station.diagnosis.model_error import with_model_error
from station.diagnosis.refits import ASKED
from station.diagnosis.residuals import VANE
from station.diagnosis.search import Found, is_told, rivals_of_constant
from station.diagnosis.taken_back import freed, is_named_alone, less, outdone, told_from_error
from station.profile import Aircraft

NOTABLE_GUST: Final = 0.1
"""m/s of standard deviation from which turbulence is told: a calm real flight (PH-LAB) shows 0.02 to 0.06."""
OF_THE_DAY: Final = frozenset(("accelerometer.bias", "alpha_vane.bias", "ay.bias"))
"""Zeros that these signals contradict, and that what is held out cannot confirm: its own zero is fitted to it."""
BEYOND_DOUBT: Final = 30.0
"""Deviance reduction from which they need no confirmation by what is held out."""
MOST_FAR_OFF: Final = 2
"""Derivatives beyond, from which the profile may be another aircraft's."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What was found, and everything needed to report it."""

    aircraft: Aircraft
    verdict: Verdict
    effects: tuple[Effect, ...]
    """Those fitted, the strongest evidence first."""
    gain: Gain | None
    remaining: RemainingResidual
    found: Found
    problem: Problem
    held_out: tuple[Manoeuvre, ...]
    remarks: tuple[str, ...]
    extended: Aircraft
    """The profile with the accepted effects in it."""
    before: Aircraft
    """The profile with its free parameters as fitted, nothing named."""
    after: Aircraft
    """The same with what was found."""
    seen: tuple[Effect, ...] = ()
    """Effects that needed no fit."""
    not_named: tuple[Effect, ...] = ()
    """What the fitted manoeuvres ask for and the held-out ones do not confirm."""
    unconfirmed: Estimate | None = None
    """The estimate with those in it: the aircraft may be this one. None where all is named."""
    lateral: Diagnosis | None = None
    """Of the lateral motion by itself, where that could be judged; what the whole says has it in it."""

    @property
    def named(self) -> tuple[Effect, ...]:
        return (*self.seen, *self.effects, *(self.lateral.effects if self.lateral else ()))

    @property
    def not_judged(self) -> Mapping[str, str]:
        return {}

    @property
    def missed(self) -> Mapping[str, float]:
        """What the model misses though its parameters are free, as a share of each force or signal."""
        return {**dict(self.remaining.missed), **(self.lateral.missed if self.lateral else {})}

    @property
    def unexplained(self) -> tuple[tuple[str, ...], tuple[float, float]] | None:
        """Signals and band (Hz) of what no effect explains."""
        if self.remaining.in_signals:
            return self.remaining.signals, self.remaining.band_hz
        return self.lateral.unexplained if self.lateral else None


def diagnose(
    fitted: Sequence[Record],
    held_out: Sequence[Record],
    aircraft: Aircraft,
    progress: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Compare, name, extend, measure: along the flight, then across it. Raises UsageError."""
    seen = first_seen([*fitted, *held_out])
    sideways = [[lateral_record(r) for r in records] for records in (fitted, held_out)]
    flown = [[r for r in records if isinstance(r, Record)] for records in sideways]
    why = why_not_lateral(aircraft) or next((r for r in sideways[0] if isinstance(r, str) and not flown[0]), "")
    # With the elevator still, what lateral motion makes of the vane and the moments would be taken for its effects.
    across_alone = any(was_moved(r, s) for r in fitted for s in LATERAL_SURFACES)
    judged = any(was_moved(r, "elevator") for r in fitted) or not across_alone
    along = _diagnosed((fitted, held_out), aircraft, LONGITUDINAL, progress, seen, judged)
    if why:
        return replace(along, remarks=(*along.remarks, f"lateral motion is not judged: {why}"))
    across = _diagnosed((flown[0], flown[1]), along.extended, ACROSS, lambda words: progress(f"lateral: {words}"), ())
    remarks = [*along.remarks, *across.remarks]
    if along.gain and across.gain:
        before, after = across.gain.before, across.gain.after
        remarks.append(f"lateral held-out error {before:.3f} -> {after:.3f}: {across.gain.words}")
    return replace(
        along,
        verdict=verdict_of((*along.named, *across.effects), "unexplained" in (along.verdict, across.verdict)),
        gain=along.gain or across.gain,
        remarks=tuple(remarks),
        extended=across.extended,
        not_named=(*along.not_named, *across.not_named),
        lateral=across,
    )


def _diagnosed(
    records: tuple[Sequence[Record], Sequence[Record]],
    aircraft: Aircraft,
    axis: Axis,
    progress: Callable[[str], None],
    seen: Sequence[Effect],
    judged: bool = True,
) -> Diagnosis:
    """Of one axis. `records`: to fit, and held out; `seen`: what needed no fit; `judged`: whether anything may be
    named."""
    fitted = records[0]
    made, kept = ([manoeuvre(r, aircraft, axis) for r in part] for part in records)
    problem = Problem(made, aircraft)
    present = set.intersection(*(set(r.signals) for r in fitted))
    terms = judged_effects(aircraft, present, True, any(len(r.held) for r in fitted), axis.lateral)
    found, doubted = outdone(searched(problem, terms if judged else (), progress), problem)
    progress("residual test")
    remaining = judge.remaining_residual(problem, found.accepted, found.beyond)
    if not judged:
        remaining = remaining.not_judged
    gusty = gusts(problem, found.accepted)
    found, lost = told_from_error(found, problem, remaining)
    progress("gain on what is held out")
    effects, gain, confirmed = _measured(found, problem, kept, lambda _: judged)
    not_named: tuple[Effect, ...] = ()
    unconfirmed = None
    if not confirmed:
        # What does not lower the error of data held out is no finding, but where instruments contradict each other.
        every, asked = effects, found.accepted
        found, effects, gain = _confirmed(found, problem, kept, effects)
        named = {e.term.id for e in effects}
        not_named = tuple(e for e in every if e.term.id not in named)
        unconfirmed = with_model_error(problem, freed(problem, asked)) if not_named else None
        # What the fitted manoeuvres ask for is unexplained once it is taken out.
        left = judge.remaining_residual(problem, found.accepted, found.beyond)
        remaining = replace(left, inhomogeneous=(*remaining.inhomogeneous, *left.inhomogeneous))
    found = replace(found, accepted=with_model_error(problem, freed(problem, found.accepted)))
    before, after = (problem.aircraft_at(e.state.values, e.state.a) for e in (found.null, found.accepted))
    gust, of = ("side", "lateral: ") if axis.lateral else ("vertical", "")
    remarks = [
        f"turbulence in {m.record.name}: {gust} gust of {g:.2f} m/s standard deviation"
        f" at {m.setting.frequencies[0]:.1f} to {m.setting.frequencies[-1]:.1f} Hz"
        for m, g in zip(made, gusty, strict=True)
        if g > NOTABLE_GUST
    ]
    remarks += remaining.words(of)
    if not axis.lateral:
        remarks += dict.fromkeys(words for m in made for words in describe_missing(m.record))
    if not judged:
        remarks.append("longitudinal motion is not judged: the elevator did not move")
    taken_back = {"noise of its sensor explains as much": found.of_noise}
    taken_back["it may be no more than what the model misses"] = lost
    taken_back |= {f"{small}, which is too small to be judged, explains more": names for small, names in doubted}
    remarks += [f"not named, for {why}: {', '.join(names)}" for why, names in taken_back.items() if names]
    if not_named:
        names = ", ".join(f"{e.term.id} {e.shown(e.value)}" for e in not_named)
        why = "it does not lower the error of what is held out" if kept else "nothing is held out that would confirm it"
        also = "" if axis.lateral or aircraft.inertia.iyy is None else "; derived quantities allow for it"
        remarks.append(f"not named, for {why}: {names}{also}")
    if sum(e.term.id.startswith("aero.C") for e in effects) >= MOST_FAR_OFF:
        remarks.append("several derivatives are far from the profile's: is it another aircraft's? use --aircraft")
    return Diagnosis(
        aircraft=aircraft,
        verdict=verdict_of((*seen, *effects), remaining.present),
        effects=tuple(replace(e, suspect=remaining.present) for e in effects),
        gain=gain,
        remaining=remaining,
        found=found,
        problem=problem,
        held_out=tuple(kept),
        remarks=tuple(remarks),
        extended=_with(aircraft, effects),
        before=before,
        after=after,
        seen=tuple(seen),
        not_named=not_named,
        unconfirmed=unconfirmed,
    )


def _measured(
    found: Found,
    problem: Problem,
    kept: Sequence[Manoeuvre],
    named: Callable[[Effect], bool] = lambda _: True,
) -> tuple[tuple[Effect, ...], Gain | None, bool]:
    """What could be named, the gain of that on held-out data, and whether they confirm it."""
    accepted = freed(problem, found.accepted)
    effects = tuple(e for e in _effects(found, accepted, problem) if named(e))
    if not effects:
        return (), None, True
    fitted = [problem.aircraft_at(e.state.values, e.state.a) for e in (found.null, accepted)]
    gain = _gain((problem.aircraft, fitted[0]), (_with(problem.aircraft, effects), fitted[1]), kept)
    if gain is not None and gain.low <= 0:
        bounded = judge.within_doubt(problem, found.null, accepted)
        gain = gain if bounded is None else judge.gain(bounded, fitted[1], kept)
    return effects, gain, gain is not None and gain.low > 0


def _confirmed(
    found: Found, problem: Problem, kept: Sequence[Manoeuvre], effects: Sequence[Effect]
) -> tuple[Found, tuple[Effect, ...], Gain | None]:
    """Of effects that together do not lower the error of what is held out: those without which it is more, if they do;
    else what instruments say of each other."""
    sure = {e.term.id for e in effects if _contradicts(problem, found, e)}
    doubtful = [i for i in found.accepted.state.values if i not in sure]
    if kept and len(doubtful) > 1:
        whole = problem.aircraft_at(found.accepted.state.values, found.accepted.state.a)
        idle = []
        for name in doubtful:
            fewer = less(found, problem, [name]).accepted
            gain = judge.gain(problem.aircraft_at(fewer.state.values, fewer.state.a), whole, kept)
            if gain is None or gain.low <= 0:
                idle.append(name)
        if len(idle) < len(doubtful):
            rest = less(found, problem, idle)
            named, gain, confirmed = _measured(rest, problem, kept)
            sound = rest.reduction > ASKED * len(rest.accepted.state.values)
            if confirmed and sound and all(is_told(e.term, e.value, e.sd) for e in named):
                return rest, named, gain
    found = less(found, problem, [e.term.id for e in effects if e.term.id not in sure])
    named, gain, _ = _measured(found, problem, kept, lambda e: _contradicts(problem, found, e))
    return found, named, gain


def _contradicts(problem: Problem, found: Found, e: Effect) -> bool:
    """Whether gyro, attitude, velocity and the zeros of accelerometers and vane say so among themselves, beyond doubt;
    what else is of accelerometers, where it is so without the forces."""
    if (e.reduction or 0.0) <= BEYOND_DOUBT:
        return False
    if set(e.term.target.split()) <= INERTIAL or e.term.id in OF_THE_DAY:
        return True
    values = found.accepted.state.values
    inertial = e.term.id in values and is_inertial(e.term.id)
    return inertial and inertial_reduction(problem, values, e.term.id) > BEYOND_DOUBT


def _with(aircraft: Aircraft, effects: Sequence[Effect]) -> Aircraft:
    """The profile with effects in it."""
    for e in effects:
        aircraft = e.onto(aircraft)
    return aircraft


def gusts(problem: Problem, e: Estimate) -> list[float]:
    """Standard deviation of the vertical gust, or of the side gust, at the frequencies judged, m/s, by manoeuvre: what
    the vane shows beyond motion and noise."""
    boom = problem.aircraft.boom
    share = boom.steady_calibration if boom and not problem.axis.lateral else 1.0
    found, s = [], e.state
    for k, (m, z, response) in enumerate(zip(problem.manoeuvres, s.spectra, s.responses, strict=True)):
        row, gust, levels = m.setting.judged.index(VANE), 2 * len(m.trim.sensors), s.levels.of(k)
        power = np.abs(m.columns(response)[:, row]) ** 2 * levels
        beyond = float((np.abs(z.bins[row]) ** 2 - power.sum(-1) + power[:, gust]).sum())
        sd = math.sqrt(max(beyond, 0.0) * 2 / (m.setting.n - 2 * m.setting.cut))
        found.append(sd * share * float(m.record.signals["airspeed"].mean()))
    return found


def _gain(before: tuple[Aircraft, ...], after: tuple[Aircraft, ...], kept: Sequence[Manoeuvre]) -> Gain | None:
    """Of the profile, or where that shows none, of the profile with its free parameters fitted in either case: what a
    free parameter takes the place of, the profile as it is shows."""
    there = [g for b, a in zip(before, after, strict=True) if (g := judge.gain(b, a, kept)) is not None]
    return max(there, key=lambda g: g.low, default=None)


def _constant(aircraft: Aircraft, free: Free, x: float, sd: float) -> Constant:
    """As the profile will have it; `x` and `sd` in prior standard deviations."""
    assert free.read is not None
    low, value, high = (free.read(free.extend(aircraft, free.sd * (x + k * sd))) for k in (-1.96, 0.0, 1.96))
    return Constant(free, x, value, (low, high))


def _effects(found: Found, accepted: Estimate, problem: Problem) -> tuple[Effect, ...]:
    """The accepted effects, and what is beyond its prior, at `accepted`, freed from priors; the strongest evidence
    first."""
    sd = np.sqrt(np.diag(with_model_error(problem, accepted).solved.covariance))
    first = len(accepted.state.values)
    out = []
    for k, (name, value) in enumerate(accepted.state.values.items()):
        term = BY_ID[name]
        without = found.tried.get(frozenset(accepted.state.values) - {name}, found.null)
        if not math.isfinite(without.cost):  # what is left is nothing then
            without = found.null
        error = math.hypot(float(sd[k]), problem.unsure(term))
        alternatives = judge.alternatives_of(found, name)
        same = term.same_value(problem.aircraft)
        if same is not None and abs(value - same[1]) < 1.96 * error:
            alternatives = (same[0], *alternatives)
        constants = tuple(
            _constant(problem.aircraft, f, float(accepted.state.a[i]), float(sd[first + i]))
            for i, f in enumerate(problem.frees)
            if f.of == name
        )
        out.append(Effect(term, value, error, without.cost - accepted.cost, alternatives, constants=constants))
    for i, free in enumerate(problem.frees):
        x, error = float(accepted.state.a[i]), float(sd[first + i])
        if abs(x) < BEYOND or error > 0.5 * abs(x) or not is_named_alone(problem, free):
            continue
        if free.name in problem.axis.derivatives:
            term = derivative_effect(free.name, problem.aircraft)
        else:
            term = BY_ID[problem.axis.of_zero[free.name]]
        rivals = rivals_of_constant(problem, found, i)
        # By how much less likely its prior makes it: it has been freed from that.
        out.append(Effect(term, free.sd * x, free.sd * error, x * x / (1 + error * error), rivals))
    return tuple(sorted(out, key=by_reduction))

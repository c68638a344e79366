"""Whether a surface lags behind its drive by a backlash, or the drive's sensor is noisier than it is taken to be.

While a drive rests, a backlash holds the surface still: it takes the sensor's noise out, and gains by that as well,
however little the surface is late. A filter that takes out as much and delays nothing tells which it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from station.diagnosis.candidate import Estimate
from station.diagnosis.effects import BY_ID
from station.diagnosis.likelihood import ROUNDS, Problem
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.memo import Memo
from station.diagnosis.refits import CONFOUNDED
from station.diagnosis.search import Found, search
from station.diagnosis.term import Term


def searched(problem: Problem, terms: Sequence[Term], progress: Callable[[str], None] = lambda _: None) -> Found:
    """The outcome of a search; without backlash where it is the noise of a drive at rest."""
    found = search(problem, terms, progress)
    played = [i for i in found.accepted.state.values if BY_ID[i].is_backlash]
    if not played or _is_late(problem, found.accepted, played):
        return found
    progress(f"without {', '.join(played)}: it is noise")
    less = search(problem, [t for t in terms if t.id not in played], progress)
    # Sizes that would be found are told of every effect.
    return replace(less, slopes=found.slopes, of_noise=tuple(played))


def _is_late(problem: Problem, accepted: Estimate, played: Sequence[str]) -> bool:
    """Whether its surfaces follow late: whether noise within a width explains clearly less than the backlash does, by
    itself or beside half of that noise."""
    try:
        noise = _again(problem, accepted, None)
        if noise.cost - accepted.cost > CONFOUNDED:
            return True
        half = 0.5 * max(noise.state.values[i] for i in played)
        return noise.cost - _again(problem, accepted, half).cost > CONFOUNDED
    except np.linalg.LinAlgError:  # so far off that its noise cannot be told
        return True


def _again(problem: Problem, e: Estimate, rest: float | None) -> Estimate:
    """An estimate again with its surfaces' drives at rest within a width, see Setting.rest."""
    p, s = Problem([_resting(m, rest) for m in problem.manoeuvres], problem.aircraft, problem.frees), e.state
    return p.estimate(p.relevelled(p.state(s.values, s.a, s.levels, s.flown)), ROUNDS, p.whole)


def _resting(m: Manoeuvre, rest: float | None) -> Manoeuvre:
    trim = replace(m.trim, setting=replace(m.trim.setting, rest=rest), memo=Memo())
    return replace(m, setting=replace(m.setting, rest=rest), trim=trim, memo=Memo())

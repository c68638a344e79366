"""One likelihood: residual series of all manoeuvres, the noise of their sensors, and every parameter with its prior.

Noise reaches the residuals through the equations, linearised about the candidate itself: Sigma = J C J* + gust + what
the model misses. Parameters minimise Q = sum e* Sigma^-1 e + priors with Sigma following the candidate (errors in
variables: Pintelon and Schoukens 2012, chapter 8), so that scaling a series changes nothing. The slopes de/dtheta are
made from noisy signals too: what their noise puts into the information is taken out again (Nakamura 1990, corrected
score). Candidates are compared by the density of what the sensors show: see Problem.volume.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.diagnosis.air_data import Unseen
from station.diagnosis.candidate import Estimate, Normal, Slopes, Solved, State, solution, without_first
from station.diagnosis.effects import BY_ID, extended
from station.diagnosis.finite_differences import Differences, Move, unseen_differences
from station.diagnosis.free_parameters import OF_SCALE, STEP, Free, moved
from station.diagnosis.manoeuvre import Manoeuvre
from station.diagnosis.memo import Memo
from station.diagnosis.score import normal_of
from station.diagnosis.series_spectra import Spectra
from station.diagnosis.surface_sampling import of_sampling
from station.diagnosis.term import Term
from station.diagnosis.variances import (
    INDEPENDENT,
    Levels,
    fitted,
    log_determinants,
    prior_levels,
    prior_unseen,
    stiffness_of,
    wandering,
)
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROUNDS: Final = 25
DONE: Final = 0.2
NEAR: Final = 10.0
"""Of Q: a step that would gain less is the last where slopes are rough; one that would gain more is a long way."""
HOPED: Final = 3.0
"""Times what a step promises, that a candidate may still gain: variances fitted to a worse state promise too little."""
MOST_DAMPED: Final = 100.0
LIGHTLY_DAMPED: Final = 0.1
LONG: Final = 0.3
"""Prior standard deviations: after a longer step all slopes are made anew, or where an effect went farther than its
Term.step; those of the effects at every step."""
BLAMED: Final = 3.0
"""Times the share that any sensor misses, from which it is asked whether the model misses it instead: in variance an
order of magnitude. To ask costs two fits."""
HELD: Final = 1e6
"""Times a prior's information, of what is held: it moves by less than a thousandth of its standard deviation."""
UNKNOWN: Final = 1e-4
"""Of a prior's information, what is left where the data contradict it: a standard deviation a hundred times as wide."""


class Problem:
    """All manoeuvres of a diagnosis and one base aircraft; candidates are effects on top of it."""

    def __init__(
        self, manoeuvres: Sequence[Manoeuvre], aircraft: Aircraft, frees: Sequence[Free] | None = None
    ) -> None:
        self.manoeuvres = tuple(manoeuvres)
        self.aircraft = aircraft
        speed = float(np.mean([m.record.signals["airspeed"].mean() for m in manoeuvres]))
        recorded = all(m.record.mass is not None for m in manoeuvres)
        self.axis = manoeuvres[0].axis
        if frees is None:
            frees = [*self.axis.free_parameters(aircraft, speed, recorded), *of_sampling(self.manoeuvres)]
        self.frees = tuple(frees)
        self.unseen_sd = prior_unseen(manoeuvres, aircraft)
        """(1 or 3, manoeuvres) of Unseen."""
        ends = [f.ends for f in self.frees] + [(-math.inf, math.inf)] * self.unseen_sd.size
        self.ends = np.array(ends).T
        """(2, parameters) where free parameters and what is unseen end."""
        self._usual = np.array([HELD if f.held else 1.0 for f in self.frees] + [1.0] * self.unseen_sd.size)
        self.known = self._usual.copy()
        """Information of the priors of free parameters and what is unseen."""
        self.prior = prior_levels(self.manoeuvres)
        self.stiffness = stiffness_of(self.manoeuvres, self.prior)
        self._zeros_wander = True
        self._frozen: list[int] = []
        self.memo = Memo()

    @property
    def of_profile(self) -> Array:
        """(parameters,) where all are the profile's, and no gust lasts."""
        return np.zeros(self.ends.shape[1])

    def unsure(self, term: Term) -> float:
        """What an effect's value is uncertain by however long the record, SI."""
        share = term.unsure_in_noise
        return share * max(m.noise(term.target) for m in self.manoeuvres) if share else 0.0

    def aircraft_at(self, values: Mapping[str, float], a: Array) -> Aircraft:
        """With its free parameters moved, then the effects."""
        return extended(moved(self.aircraft, self.frees, a), values)

    def state(
        self, values: Mapping[str, float], a: Array, levels: Levels | None = None, flown: Aircraft | None = None
    ) -> State:
        """A candidate, with the levels given or those of the prior. `flown`: what answers the gusts that nothing
        measures; the aircraft itself, if left out."""
        craft = self.aircraft_at(values, a)
        flown = flown or craft
        spectra = tuple(m.differences(craft, x) for m, x in zip(self.manoeuvres, self._unseen(a), strict=True))
        responses_ = tuple(m.responses(craft, flown=flown) for m in self.manoeuvres)
        return self._with_levels(values, a, flown, spectra, responses_, levels or self.prior)

    def _unseen(self, a: Array) -> list[Unseen]:
        """By manoeuvre."""
        rows = a[len(self.frees) :].reshape(self.unseen_sd.shape) * self.unseen_sd
        return [Unseen(*x) for x in rows.T.tolist()]

    def beside(self, s: State, values: Mapping[str, float], a: Array) -> State:
        """A candidate near the state `s`, with its levels. Where gusts are answered (Axis.answers), the likelier of
        two, each with levels of its own: answered by the candidate's aircraft, or by what answered in `s`."""
        own = self.state(values, a, s.levels)
        if self.axis.answers is None:
            return own
        both = own, self.state(values, a, s.levels, s.flown)
        return min((self.relevelled(x) for x in both), key=self.cost)

    def relevelled(self, s: State, frozen: Sequence[int] = ()) -> State:
        """The same candidate with the variances fitted to it, but for what is missed `frozen`."""
        frozen = [*frozen, *self._frozen]
        columns = [m.columns(r, m.grouped.pick) for m, r in zip(self.manoeuvres, s.responses, strict=True)]
        bins = [m.grouped.gathered(z.bins.T) for m, z in zip(self.manoeuvres, s.spectra, strict=True)]
        counts = [m.grouped.count for m in self.manoeuvres]
        levels = fitted(bins, columns, counts, s.levels, self.prior, self.stiffness, frozen)
        if self._zeros_wander:
            levels = replace(levels, zeros=wandering(self.manoeuvres, s.spectra, levels))
        return self._with_levels(s.values, s.a, s.flown, s.spectra, s.responses, levels)

    def _with_levels(
        self, values: Mapping[str, float], a: Array, flown: Aircraft, spectra: tuple[Spectra, ...],
        responses_: tuple[Complex, ...], levels: Levels,
    ) -> State:  # fmt: skip
        roots: list[Complex] = []
        white: list[Complex] = []
        steady: list[Array] = []
        q = float(a @ (self.known * a))
        for k, (m, own, r) in enumerate(zip(self.manoeuvres, spectra, responses_, strict=True)):
            b = m.columns(r)
            root = np.asarray(np.linalg.cholesky((b * levels.of(k)) @ np.conj(b.swapaxes(-1, -2))), dtype=complex)
            w = np.asarray(np.linalg.solve(root, own.bins.T[..., None])[..., 0], dtype=complex)
            e = own.steady / np.sqrt(m.steady_variances(levels.of(k), levels.zeros))
            q += 2 * INDEPENDENT * float((np.abs(w) ** 2).sum()) + float(e @ e)
            roots.append(root)
            white.append(w)
            steady.append(e)
        return State(dict(values), a, flown, levels, spectra, responses_, tuple(roots), tuple(white), tuple(steady), q)

    def volume(self, s: State) -> float:
        """log det Sigma, less log |det A|2 of the responses of the series to the sensors at their heads, and the prior
        of the variances: with Q the density of what these sensors show, given the others. Candidates are compared by
        it, each at its own parameters, and not fitted: where these are hardly known it would move them by tens."""
        return log_determinants(self.manoeuvres, s.responses, s.levels, self.prior, self.stiffness)

    def cost(self, s: State) -> float:
        """-2 log likelihood with priors, and how rare the effects are: what candidates are compared by."""
        return s.q + self.volume(s) + sum(BY_ID[i].price for i in s.values)

    def effect_slopes(self, s: State, terms: Sequence[Term]) -> list[Slopes]:
        """Per unit of each effect's value, by manoeuvre."""
        here = moved(self.aircraft, self.frees, s.a)
        moves = []
        for t in terms:
            at = s.values.get(t.id, t.null)
            h = t.step if at + t.step <= t.high else -t.step
            moves.append(Move(extended(here, {**s.values, t.id: at + h}), h))
        return self._slopes(s, moves)

    def free_slopes(self, s: State, rough: bool = False) -> list[Slopes]:
        """Per prior standard deviation of each free parameter and of what is unseen, by manoeuvre."""
        made = self._slopes(
            s,
            [
                None if f.of and f.of not in s.values else self._moved(s, i, f.of_noise and not rough)
                for i, f in enumerate(self.frees)
            ],
        )
        craft, count, out = self.aircraft_at(s.values, s.a), self.unseen_sd.size, []
        for k, (m, own, here) in enumerate(zip(self.manoeuvres, made, self._unseen(s.a), strict=True)):
            air = unseen_differences(m, craft, here, STEP * self.unseen_sd[:, k])
            bins, steady = (np.zeros((count, *x.shape[1:]), dtype=x.dtype) for x in (air.bins, air.steady))
            bins[k :: len(made)], steady[k :: len(made)] = air.bins / STEP, air.steady / STEP
            none = np.zeros((count, *own.response.shape[1:]), dtype=complex)
            out.append(Slopes(bins, steady, none).after(own))
        return out

    def renewed(self, s: State, slopes: Sequence[Slopes]) -> list[Slopes]:
        """Slopes of the free parameters, of which the constants of the state's own effects are made anew."""
        own = np.array([i for i, f in enumerate(self.frees) if f.of in s.values], dtype=np.int64)
        if not len(own):
            return list(slopes)
        made = [Slopes(x.bins.copy(), x.steady.copy(), x.response.copy()) for x in slopes]
        fresh = self._slopes(s, [self._moved(s, i, True) for i in own.tolist()])
        for there, here in zip(made, fresh, strict=True):
            there.bins[own], there.steady[own], there.response[own] = here.bins, here.steady, here.response
        return made

    def _moved(self, s: State, i: int, of_noise: bool) -> Move:
        """One free parameter moved, in prior standard deviations."""
        there, step = s.a.copy(), self.frees[i].step
        step = step if s.a[i] + step <= self.frees[i].ends[1] else -step
        there[i] += step
        return Move(self.aircraft_at(s.values, there), step, of_noise)

    def _slopes(self, s: State, moves: Sequence[Move | None]) -> list[Slopes]:
        """By manoeuvre."""
        differences = Differences(self.aircraft_at(s.values, s.a), moves)
        every = enumerate(zip(self.manoeuvres, self._unseen(s.a), strict=True))
        return [differences.of(m, s, k, unseen) for k, (m, unseen) in every]

    def normal(self, s: State, slopes: Sequence[Slopes]) -> Normal:
        """Normal equations of Q at a state, for the parameters of `slopes`."""
        parts = [normal_of(m, s, k, own) for k, (m, own) in enumerate(zip(self.manoeuvres, slopes, strict=True))]
        return Normal(*(np.sum(part, axis=0) for part in zip(*parts, strict=True)))

    def solve(self, s: State, normal: Normal, damping: float = 0.0) -> Solved:
        """The step of all parameters, effects first; those of the aircraft that are at an end do not go beyond it."""
        effects = np.zeros(len(normal.gradient) - len(s.a))
        ends = np.concatenate([np.array([[-math.inf], [math.inf]]) + effects, self.ends], axis=1)
        at, known = (np.concatenate([effects, x]) for x in (s.a, self.known))
        return solution(at, normal, known, ends, damping)

    def advance(self, s: State, solved: Solved, terms: Sequence[Term], far: bool) -> State | None:
        """The state a step further, see `beside`; None where neither its cost nor its Q is less: steps go by the
        corrected score, the slope of neither. Q does not count `far` off, nor where the aircraft answers gusts:
        there it falls with a noise that grows."""
        values = dict(s.values)
        for t, x in zip(terms, solved.step, strict=False):
            values[t.id] = min(max(values.get(t.id, 0.0) + float(x), t.low), t.high)
        try:
            there = self.beside(s, values, np.clip(s.a + solved.step[len(terms) :], *self.ends))
            by_cost = far or self.axis.answers is not None
            better = self.cost(there) < self.cost(s) or (not by_cost and there.q < s.q)
        except np.linalg.LinAlgError:  # so far off that its noise cannot be told
            return None
        return there if better else None

    def from_profile(self, values: Mapping[str, float], begun: State | None = None, free: bool = False) -> Estimate:
        """Fitted from the profile on, with effects that begin at `values`; or from a state on the way. `free`: what
        scales a series is so from the first step on, without effects too."""
        return self.from_near(self.near(values, begun, free))

    def near(self, values: Mapping[str, float], begun: State | None = None, free: bool = False) -> State:
        """A state near the best, as `from_profile` comes by it: zeros do not wander yet, see `_far_off`."""
        with self._far_off(held=begun is None, rough=not values and not free):
            start = begun or self._profile_state(values)
            return self.estimate(start, ROUNDS, self.whole if values else self.rough, NEAR).state

    def from_near(self, s: State) -> Estimate:
        """Fitted to the end from there, with variances that let zeros wander: by those of before, no step may be better
        though the fit is far from its best."""
        return self._laid_to_the_model(self.estimate(self.relevelled(s), ROUNDS, self.whole))

    def _laid_to_the_model(self, e: Estimate) -> Estimate:
        """An estimate by which sensors miss a share of what they show, or one that lays that to forces first, if it is
        likelier: once either explains what is missed, nothing is left for the other."""
        missed, least = e.state.levels.missed, self.prior.missed
        of_sensors = np.array([name not in self.axis.forces for name in self.axis.missed])
        if not (missed > BLAMED**2 * least)[of_sensors].any():
            return e
        s = replace(e.state, levels=replace(e.state.levels, missed=np.where(of_sensors, least, missed)))
        self._frozen = np.flatnonzero(of_sensors).tolist()
        try:
            s = self.estimate(self.relevelled(s), ROUNDS, self.whole, NEAR).state
        finally:
            self._frozen = []
        return min(e, self.estimate(self.relevelled(s), ROUNDS, self.whole), key=lambda e: e.cost)

    def at_profile(self, values: Mapping[str, float]) -> Estimate:
        """The profile's aircraft with these effects, and the variances fitted to it."""
        s = self._profile_state(values)
        return self._here(s, self.whole(s)[0])

    def few_steps(self, values: Mapping[str, float], free: Sequence[Slopes], rounds: int) -> Estimate:
        """From the profile on, by the free parameters' slopes there: of what is nearly right the constants hardly move.
        With the normal equations of where that ends."""
        with self._far_off(held=False):
            s = self.estimate(self._profile_state(values), rounds, self.with_free(free)).state
        return self._here(s, self.with_free(free)(s)[0])

    def _here(self, s: State, made: list[Slopes]) -> Estimate:
        normal = self.normal(s, made)
        return Estimate(s, self.solve(s, normal), made, normal, self.cost(s))

    def _profile_state(self, values: Mapping[str, float]) -> State:
        return self.relevelled(self.state(values, self.of_profile))

    @contextmanager
    def _far_off(self, held: bool, rough: bool = False) -> Iterator[None]:
        """A zero that all manoeuvres share is looked for before zeros wander. `held`: parameters between two ends stay
        the profile's, and the air still: while the rest is far off, a step may take them to the wrong side for good. So
        do, by slopes as `rough`, those that scale a series: noise that does not follow them is less in a series that is
        scaled down, and the way back is long and bent."""
        self._zeros_wander = False
        if held:
            self.known[np.isfinite(self.ends).all(0)] = self.known[len(self.frees) :] = HELD
        if rough:
            self.known[[i for i, f in enumerate(self.frees) if f.name in OF_SCALE]] = HELD
        try:
            yield
        finally:
            self._zeros_wander, self.known[:] = True, self._usual

    def freed(self, e: Estimate, which: Sequence[int], released: Sequence[int]) -> Estimate:
        """An estimate again, at its cost, with free parameters `which` known by the data alone: a prior that they
        contradict draws them to itself, and from it what they share their part with. `released`: held no longer."""
        self.known[list(released)], self.known[list(which)] = 1.0, UNKNOWN
        try:
            return replace(self.estimate(self.relevelled(e.state), ROUNDS, self.whole), cost=e.cost)
        finally:
            self.known[:] = self._usual

    def with_free(self, free: Sequence[Slopes]) -> Callable[[State], tuple[list[Slopes], Sequence[Term]]]:
        """All slopes of a state, of which the free parameters' are these."""

        def slopes(s: State) -> tuple[list[Slopes], Sequence[Term]]:
            terms = [BY_ID[i] for i in s.values]
            own = self.renewed(s, free)
            return [f.after(e) for f, e in zip(own, self.effect_slopes(s, terms), strict=True)], terms

        return slopes

    def rough(self, s: State) -> tuple[list[Slopes], Sequence[Term]]:
        """The free parameters' slopes, as if the noise did not depend on them: for half of the time."""
        return self.free_slopes(s, True), ()

    def whole(self, s: State) -> tuple[list[Slopes], Sequence[Term]]:
        """All slopes of a state, its effects first."""
        terms = [BY_ID[i] for i in s.values]
        return [f.after(e) for f, e in zip(self.free_slopes(s), self.effect_slopes(s, terms), strict=True)], terms

    def estimate(
        self,
        s: State,
        rounds: int,
        slopes: Callable[[State], tuple[list[Slopes], Sequence[Term]]],
        done: float = DONE,
        beaten: float = math.inf,
    ) -> Estimate:
        """Gauss-Newton, damped where Q would rise (Levenberg), from a state; the variances are fitted anew after each
        step. `slopes` are made anew where the last step was long, or a damped one by old slopes promised less than
        `done`; a step by new slopes that does, of any damping, or an undamped one, is the last. Left where it is when a
        step promises no cost below `beaten`."""
        damping, long, stale = 0.0, True, False
        made, terms = slopes(s)
        for _ in range(rounds):
            if stale and long:
                made, terms = slopes(s)
                stale = False
            elif stale and terms:
                made = self.with_free(without_first(made, len(terms)))(s)[0]
            normal = self.normal(s, made)
            # However short a damped step is: the way left is as long as an undamped one promises.
            far = self.solve(s, normal).gained > NEAR
            solved = self.solve(s, normal, damping)
            if self.cost(s) - HOPED * solved.gained > beaten:
                break
            there = self.advance(s, solved, terms, far)
            while there is None and damping < MOST_DAMPED:
                damping = max(10 * damping, 0.01)
                solved = self.solve(s, normal, damping)
                there = self.advance(s, solved, terms, far)
            if there is None:
                if not stale:
                    break
                long, damping = True, 0.0
                continue
            fresh, stale = not stale, True
            far_away = [abs(there.values[t.id] - s.values[t.id]) > t.step for t in terms]
            long = bool(np.abs(there.a - s.a).max(initial=0.0) > LONG or any(far_away))
            damping *= 0.1
            s = self.relevelled(there)
            if solved.gained < done:
                # A damped step gains little too where slopes are old; where they are not, there is no more to gain.
                if fresh or damping < LIGHTLY_DAMPED:
                    break
                long, damping = True, 0.0
        return Estimate(s, self.solve(s, normal), made, normal, self.cost(s))

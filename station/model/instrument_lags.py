"""Lag, scale and zero of every instrument against the others, before any aerodynamics.

    reading(t) = scale x(t - lag) + zero + noise                x: what the kinematic equations hold of

Maximum likelihood in the frequency domain, 0 to 2.5 Hz (kinematic_likelihood.py), Gauss-Newton with the noise estimated
along. Attitude is the reference of lags and scales; airspeed gives the scale of speeds. Accelerometers have the
attitude's clock within CLOCK_S, which is not estimated: lift follows the angle of attack, gusts included, so their lag
and a vane's scale look alike. A flow angle or a vertical speed may come through a first-order filter instead of late,
or as well: its lag is that of slow motion, filter and delay together. An aircraft follows the gusts that its vane
shows; what that may do to the vane's lag and scale is part of their errors. SI, rad.

Sources: Feik 1984, ARL-AERO-R-161, and Raab 2023 (time shifts by data compatibility); Klein and Morelli 2006,
chapter 10.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.model.kinematic_equations import FLOW
from station.model.kinematic_likelihood import LAGS_S, ROLL, TINY, ZEROS, Key, Likelihood

Array = NDArray[np.float64]

CLOCKED: Final = ("ax", "ay", "az")
RATES: Final = ("p", "q", "r")
CLOCK_S: Final = 0.005
"""Of accelerometers against attitude: they are what the attitude is made of, less a filter."""
PLACE_M: Final = 0.3
"""Of a vane ahead of the CG, which moves with fuel and payload: as far as x/V goes, a lag."""
LAG_SD: Final = 1.0
SCALE_SD: Final = 0.3
"""Prior standard deviations: of a lag, s, and of the logarithm of a scale."""
TURNED: Final = 0.0087
"""rad: by which sensors are out of line with their axes, half a degree: what they then show of other axes' motion."""
ACROSS: Final[Mapping[str, tuple[str, ...]]] = {
    "p": ("q", "r"), "q": ("p", "r"), "r": ("p", "q"), "ax": ("ay", "az"), "ay": ("ax", "az"), "az": ("ax", "ay"),
    "alpha_vane": ("beta_vane",), "beta_vane": ("alpha_vane",),
}  # fmt: skip
ATTITUDE_DRIFT: Final = 0.0035
"""rad: by which an attitude's error changes over a record: 0.2 deg of a vertical gyro or AHRS."""
GRAVITY: Final = 0.02
"""m/s2: standard gravity is 9.780 to 9.832 by latitude, and 0.003 less a kilometre up; it is all in az's zero."""
DOWN_MPS: Final = 0.2
"""Mean vertical wind of a minute or more, which a vane's zero holds."""
BLOCK_S: Final = 10.0
ITERATIONS: Final = 40
SETTLED: Final = 0.05
"""Standard deviations by which no parameter moves any more."""
STEPS: Final[Mapping[str, float]] = {"lag": 0.15, "filter": 0.15, "scale": 0.2, "zero": math.inf}
"""Largest step of an iteration: a fraction of a period, a fifth."""
SCAN_S: Final = 0.1
SURE: Final = 3.0
"""Standard deviations from its null beyond which an instrument's error is beyond doubt."""
RENEWALS: Final = 3
"""Of the factors, at most: one vane in error makes the other look so, which the first renewal shows."""
STEADY: Final = 0.1
"""Samples by which lags then still move, at most: less than any lag's error."""
BETTER: Final = SURE**2
"""Deviance by which a lag elsewhere, or a filter, must be better."""
HEARD: Final = 25.0
"""Deviance by which an instrument must explain another, or they it, before its lag and scale say anything: five
standard deviations, for lags are sought at thirty places."""
LEAST_SEGMENTS: Final = 4
"""To say how much they scatter: to 35 %."""
CORRELATED: Final = 8
"""Lines apart that the window leaves correlated."""
FILTERS_S: Final = 0.05
"""Lag above which a filter is looked for in it."""
LONGEST_FILTER_S: Final = 0.5
GUST_HZ: Final = (0.1, 2.0)
HARDLY: Final = "hardly moves beside its noise"
CLOCKED_WHY: Final = "taken as in time with the attitude: lift makes it look like a vane's scale"
TOLD: Final[Mapping[str, float]] = {"lag": 0.1, "scale": 0.5 * SCALE_SD, "zero": 0.5}
"""Largest standard deviation that says something: of a lag, s, of a scale; of a zero as a share of its prior's."""
APART: Final = 2 * HEARD
"""Deviance by which the roll angle must be late before it is told: it comes with the pitch angle, and its lag shows
only by what the weight does sideways. Sound records show 15 and 25 (ATTAS), one of 0.1 s 230."""


@dataclass(frozen=True, slots=True)
class Value:
    """An estimate and its standard deviation; `why` it cannot be told, or "" where it can."""

    value: float
    sd: float
    why: str = ""


@dataclass(frozen=True, slots=True)
class Solution:
    """Estimates by instrument and kind ("lag", "scale", "zero"), and what they are made of."""

    values: Mapping[Key, Value]
    gust_sd: float
    """Of the vertical gust between 0.1 and 2 Hz that the vane shows, m/s; NaN without a vane."""
    seconds: float
    high_hz: float


def solve(
    motion: Mapping[str, Array],
    dt: float,
    arm: tuple[float, float, float],
    spans: Sequence[slice],
    upwash: float = 1.0,
) -> Solution:
    """Of signals (n,), forces at the CG, without gaps within `spans` of rows; `arm`: place of the vanes from the CG, m;
    `upwash`: the vane's scale by the profile, which only the airspeed's and side force's rows take from it.

    A flow angle, a rate or a roll angle in error is also wrong in the factors that multiply the others, and goes with
    their values of another time: once it is known by how much, these are made anew.

    Raises NotIdentifiable for spans too short, and LinAlgError for a record in which nothing moves.
    """
    (found, deviance), before = _Fit(motion, dt, arm, spans, upwash).solve(motion), dict[str, float]()
    for _ in range(RENEWALS):
        mended, late = _mended(motion, dt, found, upwash)
        if late.keys() == before.keys() and all(abs(late[n] - before[n]) < STEADY for n in late):
            break
        renewed, now = _Fit(motion, dt, arm, spans, upwash, mended, late).solve(motion)
        if now >= deviance or any(renewed.values[n, "lag"].why for n, samples in late.items() if samples):
            break  # it was not that, or a lag taken for known is then not known
        found, deviance, before = renewed, now, late
    return found


def _mended(
    motion: Mapping[str, Array], dt: float, found: Solution, upwash: float
) -> tuple[dict[str, Array], dict[str, float]]:
    """Flow angles, rates and roll angle (n,) beyond doubt wrong, as they were; by how many samples they are late."""
    made, samples = {}, {}
    for name in (n for n in (*FLOW, *RATES, ROLL) if n in motion):
        lag, scale = found.values.get((name, "lag")), found.values.get((name, "scale"))
        stated = upwash if name == "alpha_vane" else 1.0
        late = lag.value if lag and not lag.why and abs(lag.value) > SURE * lag.sd else 0.0
        told = scale and not scale.why and abs(math.log(scale.value / stated)) > SURE * scale.sd / scale.value
        share = scale.value if scale and told else stated
        if late or share != stated:
            ticks, samples[name] = np.arange(len(motion[name])), late / dt
            made[name] = np.interp(ticks + samples[name], ticks, motion[name]) / share
    return made, samples


class _Fit(Likelihood):
    """The search for the parameters, and their errors."""

    slopes: NDArray[np.complex128]
    _root: NDArray[np.complex128]
    """Of the rows' covariance (lines, rows, rows), which the slopes are divided by,"""
    _white: NDArray[np.complex128]
    """and the residuals (segments, lines, rows)."""
    information: Array
    scores: Array

    def solve(self, motion: Mapping[str, Array]) -> tuple[Solution, float]:
        """What is found, and its deviance."""
        in_time = [key for key in self.keys if key != (ROLL, "lag")]
        values, deviance = self._fitted(self._scanned(dict.fromkeys(in_time, 0.0)))
        if len(in_time) < len(self.keys):
            late, less = self._fitted(self._scanned(dict.fromkeys(self.keys, 0.0)))
            if less < deviance - APART and all(self.heard(i, late) >= HEARD for i in {ROLL, "p"} & {*self.instruments}):
                values, deviance = late, less
        for head in self.rows:
            if head in (*FLOW, "v_down") and abs(values[head, "lag"]) > FILTERS_S:
                values, deviance = self._filtered(head, values, deviance)
        return self._solution(values, motion), deviance

    def _scanned(self, values: dict[Key, float]) -> dict[Key, float]:
        """A lag that one instrument alone has far from 0, found by its rows' noise."""
        step = max(1, round(SCAN_S / self.stretches[0].dt))
        ticks = range(-(self.margin // step) * step + step, self.margin, step)
        for i in self.instruments:
            if (i, "lag") not in values or i in CLOCKED:
                continue
            # The roll angle's own row would take it for late where the roll rate is early.
            rows = [i] if i in self.rows and i != ROLL else self.elsewhere(i)
            found = {k: self.deviance({**values, (i, "lag"): k * self.stretches[0].dt}, rows) for k in {*ticks, 0}}
            best = min(found, key=lambda k: found[k])
            if found[best] < found[0] - BETTER:
                values[i, "lag"] = best * self.stretches[0].dt
        return values

    def _prior(self, keys: Sequence[Key]) -> Array:
        """Standard deviations."""
        kinds = {"lag": LAG_SD, "filter": LAG_SD, "scale": SCALE_SD}
        clocked = [i in CLOCKED and kind == "lag" for i, kind in keys]
        return np.array(
            [CLOCK_S if c else ZEROS[i] if k == "zero" else kinds[k] for (i, k), c in zip(keys, clocked, strict=True)]
        )

    def _free(self, keys: Sequence[Key]) -> NDArray[np.intp]:
        """Places of what is estimated: all but the accelerometers' clocks."""
        return np.flatnonzero([not (i in CLOCKED and kind == "lag") for i, kind in keys])

    def _fitted(self, values: dict[Key, float]) -> tuple[dict[Key, float], float]:
        """Gauss-Newton, noise renewed along; keeps `information` and `slopes` for the errors."""
        keys, values = list(values), dict(values)
        prior = self._prior(keys)
        furthest = self.margin * self.stretches[0].dt - 1e-3
        bound = np.array([STEPS[kind] for _, kind in keys])
        free = self._free(keys)
        damped, before = np.ones(len(keys)), np.zeros(len(keys))
        for _ in range(ITERATIONS):
            e, slope = self.errors(values, keys)
            self.renew_noise(e, values)
            paths = self.paths(values)
            sigma = self.covariance(paths)
            weighted = np.asarray(np.linalg.solve(sigma[None], np.moveaxis(e, 1, 2)[..., None])[..., 0], complex)
            slope = self.denoised(slope, weighted, paths, keys, values)
            root = np.linalg.cholesky(sigma)
            white = np.linalg.solve(root[None], np.moveaxis(e, 1, 2)[..., None])[..., 0]
            slopes = np.asarray(np.linalg.solve(root[None], np.moveaxis(slope, 1, 2)), dtype=np.complex128)
            now = np.array([values[key] for key in keys])
            information = np.diag(1 / prior**2) + 2 * np.einsum("skrp,skrq->pq", slopes.conj(), slopes).real
            score = -now / prior**2 - 2 * np.einsum("skrp,skr->p", slopes.conj(), white).real
            step, sd = np.zeros(len(keys)), np.ones(len(keys))
            inverse = np.linalg.inv(information[np.ix_(free, free)])
            step[free] = np.clip(inverse @ score[free], -bound[free], bound[free])
            sd[free] = np.sqrt(np.diag(inverse))
            # What a record hardly shows swings about: half the step where the last one went the other way.
            damped = np.where(step * before < 0, 0.5 * damped, np.minimum(2 * damped, 1.0))
            step, before = damped * step, step
            for key, x, dx in zip(keys, now, step, strict=True):
                low, high = {"lag": (-furthest, furthest), "filter": (0.0, LAGS_S)}.get(key[1], (-np.inf, np.inf))
                values[key] = float(np.clip(x + dx, low, high))
            self.information, self.slopes = information, slopes
            self._root, self._white = np.asarray(root, np.complex128), np.asarray(white, np.complex128)
            self.scores = 2 * np.einsum("skrp,skr->sp", slopes.conj(), white).real
            if np.max(np.abs(step) / sd) < SETTLED:
                break
        return values, self.deviance(values)

    def _filtered(self, head: str, values: dict[Key, float], deviance: float) -> tuple[dict[Key, float], float]:
        """With a first-order filter instead of a head's delay, or before it, where that explains its row better."""
        lag = values[head, "lag"]
        instead = {key: x for key, x in values.items() if key != (head, "lag")} | {(head, "filter"): abs(lag)}
        before = {**values, (head, "lag"): 0.5 * lag, (head, "filter"): 0.5 * abs(lag)}
        for start, price in ((instead, 0.0), (before, BETTER)):
            trial, better = self._fitted(start)
            if better < deviance - price and 0 < trial[head, "filter"] < LONGEST_FILTER_S:
                values, deviance = trial, better
        return values, deviance

    def _solution(self, values: dict[Key, float], motion: Mapping[str, Array]) -> Solution:
        values, _ = self._fitted(values)
        keys = list(values)
        covariance = self._errors_of(keys)
        found: dict[Key, Value] = {}
        unheard = {i for i in self.instruments if self.heard(i, values) < HEARD}
        for n, (i, kind) in enumerate(keys):
            if kind in ("lag", "filter"):
                parts = [m for m, key in enumerate(keys) if key in ((i, "lag"), (i, "filter"))]
                sd = math.sqrt(max(float(covariance[np.ix_(parts, parts)].sum()), 0.0))
                why = CLOCKED_WHY if i in CLOCKED else HARDLY if i in unheard or sd > TOLD["lag"] else ""
                found[i, "lag"] = Value(sum(values[keys[m]] for m in parts), sd, why)
                continue
            sd = math.sqrt(max(covariance[n, n], 0.0))
            if kind == "scale":
                scale = math.exp(values[i, kind])  # what was estimated is its logarithm
                found[i, kind] = Value(scale, scale * sd, HARDLY if i in unheard or sd > TOLD[kind] else "")
            else:
                sd = math.hypot(sd, ATTITUDE_DRIFT / self._length if i in RATES else GRAVITY if i == "az" else 0.0)
                found[i, kind] = Value(values[i, kind], sd, "" if sd < TOLD[kind] * ZEROS[i] else HARDLY)
        vane = found.get(("alpha_vane", "lag"), Value(0.0, math.inf, HARDLY))
        if "v_down" in motion and not vane.why and not found["alpha_vane", "scale"].why:
            level = self._level(motion, found)
            found["alpha_vane", "zero"] = min(level, found["alpha_vane", "zero"], key=lambda v: v.sd)
        return Solution(found, self._gust(values, not vane.why), self._length, self.high_hz)

    def _level(self, motion: Mapping[str, Array], found: Mapping[Key, Value]) -> Value:
        """Zero of the vane by the mean of attitude less path, without mean vertical wind and sideslip."""
        rows = np.concatenate([np.arange(s.start, s.start + s.count) for s in self.stretches])
        roll = motion["phi"][rows] if "phi" in motion else np.zeros(len(rows))
        pitch, speed = motion["theta"][rows], motion["airspeed"][rows]
        up, across = np.sin(pitch), np.cos(pitch) * np.cos(roll)
        climb = np.clip(-motion["v_down"][rows] / speed / np.hypot(up, across), -1.0, 1.0)
        flow = np.arctan2(up, across) - np.arcsin(climb) - self.arm[0] * motion["q"][rows] / speed
        scale = found["alpha_vane", "scale"]
        left = motion["alpha_vane"][rows] - scale.value * flow
        width = round(BLOCK_S / self.stretches[0].dt)
        blocks = [float(left[k : k + width].mean()) for k in range(0, max(len(left) - width, 1), width)]
        scatter = float(np.std(blocks)) / math.sqrt(max(len(blocks) - 1, 1))
        sd = math.hypot(scatter, scale.sd * abs(float(flow.mean())), DOWN_MPS / self.speed)
        return Value(float(left.mean()), sd)

    @property
    def _length(self) -> float:
        return sum(s.length for s in self.stretches)

    def _errors_of(self, keys: Sequence[Key]) -> Array:
        """Covariance: of noise through the window, the segments' scatter, gusts, clocks and a vane's place."""
        lines = len(self.omega)
        window = self.stretches[0].correlation
        spread = np.diag(1 / self._prior(keys) ** 2)
        for apart in range(min(CORRELATED, lines)):
            a, b = self.slopes[:, : lines - apart], self.slopes[:, apart:]
            part = 2 * (np.einsum("skrp,skrq->pq", a.conj(), b) * window[apart].conj()).real
            spread += part if apart == 0 else part + part.T
        free = self._free(keys)
        held = np.setdiff1d(np.arange(len(keys)), free)
        inverse = np.zeros_like(self.information)
        inverse[np.ix_(free, free)] = np.linalg.inv(self.information[np.ix_(free, free)])
        moved = inverse @ self._gust_score(keys)
        clocks = CLOCK_S * inverse @ self.information[:, held]
        made = inverse @ spread @ inverse
        made = made * np.outer(scatter := self._scatter(inverse, made), scatter)
        made = made + np.outer(moved, moved) + clocks @ clocks.T + self._turned(inverse)
        made[held, held] = CLOCK_S**2
        for n, (i, kind) in enumerate(keys):
            if i in FLOW and kind == ("lag" if (i, "lag") in keys else "filter"):
                made[n, n] += (PLACE_M / self.speed) ** 2
        return np.asarray(made)

    def _turned(self, inverse: Array) -> Array:
        """Covariance by sensors TURNED to other axes, as far as the record does not show that they are not."""
        shown, readings = [], {t.instrument: t.readings for t in reversed(self.model.terms)}
        for i, other in ((i, other) for i, others in ACROSS.items() for other in others):
            terms = [t for t in self.model.terms if t.instrument == i]
            if terms and other in readings:
                shown.append(self._whitened([(t.row, t.factor * TURNED * readings[other], t.order) for t in terms]))
        if not shown:
            return np.zeros_like(inverse)
        turns = np.array(shown)
        apart = 2 * np.einsum("skrp,tskr->pt", self.slopes.conj(), turns).real
        known = 2 * np.einsum("askr,bskr->ab", turns.conj(), turns).real - apart.T @ inverse @ apart
        posterior = np.linalg.inv(known + np.eye(len(turns)))
        mean = posterior @ (2 * np.einsum("tskr,skr->t", turns.conj(), self._white).real)
        moved = inverse @ apart
        return np.asarray(moved @ (posterior + np.outer(mean, mean)) @ moved.T)

    def _whitened(self, parts: Sequence[tuple[str, Array, int]]) -> NDArray[np.complex128]:
        """Of rows, what is added to them (n,) and its order; over the rows' covariance, (segments, lines, rows)."""
        e = np.zeros((len(self.stretches), len(self.omega), len(self.rows)), complex)
        for row, x, order in parts:
            for s, stretch in enumerate(self.stretches):
                e[s, :, self.rows[row]] += stretch.transform(x, 0.0, order)[order]
        return np.asarray(np.linalg.solve(self._root[None], e[..., None])[..., 0], dtype=np.complex128)

    def _scatter(self, inverse: Array, covariance: Array) -> Array:
        """By how much the segments' own estimates scatter beyond `covariance`, in standard deviations, at least 1."""
        count = len(self.scores)
        if count < LEAST_SEGMENTS:
            return np.ones(len(covariance))
        apart = self.scores @ inverse
        found = (apart**2).sum(axis=0) * count / (count - 1)
        return np.asarray(np.sqrt(np.maximum(found / np.maximum(np.diag(covariance), TINY), 1.0)))

    def _gust_score(self, keys: Sequence[Key]) -> Array:
        """Mean of the score that gusts add where the aircraft heaves with them: w = -gust / (1 + j omega/L), L the
        vertical (or side) acceleration over the speed across (1/s); no more gust than the acceleration answers to."""
        made = np.zeros(len(keys))
        for head, force in (("alpha_vane", "az"), ("beta_vane", "ay")):
            mine = (
                (n, t) for n, t in enumerate(self.model.terms) if t.row == head and t.order == (t.instrument == head)
            )
            places = {t.instrument: n for n, t in mine}
            if head not in places or force not in places:
                continue
            r, (across, pushed) = self.rows[head], (self.model.terms[places[n]] for n in (head, force))
            moved = across.readings * across.factor
            fall = max(abs(float(np.cov(moved, pushed.readings)[0, 1] / np.var(moved))), 1e-3)
            force_power = np.mean([np.abs(self.transforms(places[force], s, 0.0)[0][0]) ** 2
                                   for s in range(len(self.stretches))], axis=0)  # fmt: skip
            answered = force_power * (self.omega**2 + fall**2) / fall**2
            share = 2 * len(self.stretches) * np.minimum(self.own[r], self.smooth(answered[None])[0])
            share /= np.maximum(self.total[r], TINY)
            x = self.omega / fall
            for kind, each in (("lag", fall * x * x), ("filter", fall * x * x), ("scale", 1.0)):
                if (head, kind) in keys:
                    made[keys.index((head, kind))] = float((share * each / (1 + x * x)).sum())
            if (force, "scale") in keys:
                # The row has the heave twice, by the vane and by the force, which it subtracts.
                made[keys.index((force, "scale"))] = -float((share / (1 + x * x)).sum())
        return made

    def _gust(self, values: Mapping[Key, float], told: bool) -> float:
        """Standard deviation of the vertical gust of GUST_HZ, m/s: what the vane shows beyond motion and noise.

        A lag above FILTERS_S is a filter's, whichever explains the motion better: what it took of the gust is put back.
        """
        if "alpha_vane" not in self.rows:
            return math.nan
        row, late = self.rows["alpha_vane"], sum(values.get(("alpha_vane", kind), 0.0) for kind in ("lag", "filter"))
        if not told:
            values = {**values, ("alpha_vane", "lag"): 0.0, ("alpha_vane", "filter"): 0.0}
        elif late > FILTERS_S:
            values = {**values, ("alpha_vane", "lag"): 0.0, ("alpha_vane", "filter"): min(late, LONGEST_FILTER_S)}
        e, _ = self.errors(values, (), ("alpha_vane",))
        inside = (self.frequencies >= GUST_HZ[0]) & (self.frequencies <= GUST_HZ[1])
        noise = sum(self.white[i] * np.abs(path[row]) ** 2 for i, path in self.paths(values).items())
        density = (np.abs(e[:, row]) ** 2).mean(axis=0) - noise
        power = 2 * float((density[inside] / self.omega[inside] ** 2).sum()) / self.stretches[0].length
        return math.sqrt(max(power, 0.0))

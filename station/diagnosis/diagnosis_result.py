"""What diagnosis finds: effects with values and evidence, the verdict, the gain; and the same in a few lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np

from station.conventions import from_si
from station.diagnosis.free_parameters import Free, moved
from station.diagnosis.term import Term
from station.profile import Aircraft

Verdict = Literal["no_effect", "effect_found", "confounded", "unexplained"]


class Constant(NamedTuple):
    """A constant of an effect, fitted with it: a free parameter, by how many prior standard deviations it is moved, and
    what the profile then has."""

    free: Free
    x: float
    value: float
    ci95: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Effect:
    """One effect found."""

    term: Term
    value: float
    sd: float = 0.0
    reduction: float | None = None
    """Of the deviance (-2 log likelihood), against the same without it; None where it was seen before any fit."""
    alternatives: tuple[str, ...] = ()
    """Effects that it is confounded with, by id."""
    signature: str = ""
    """The evidence in words."""
    suspect: bool = False
    """Whether what remains unexplained may have made it."""
    constants: tuple[Constant, ...] = ()
    """What else the fit says of it."""

    def onto(self, aircraft: Aircraft) -> Aircraft:
        """The aircraft with the effect in it."""
        aircraft = self.term.extend(aircraft, self.value)
        return moved(aircraft, [c.free for c in self.constants], np.array([c.x for c in self.constants]))

    @property
    def ci95(self) -> tuple[float, float]:
        return self.value - 1.96 * self.sd, self.value + 1.96 * self.sd

    @property
    def sentence(self) -> str:
        return self.term.words(self.value)

    def shown(self, value: float) -> str:
        """A value of this effect, in the unit of its sentence."""
        return f"{from_si(value, self.term.shown):.3g}{'' if self.term.shown == '1' else f' {self.term.shown}'}"


def by_reduction(e: Effect) -> float:
    """Orders effects by evidence, the strongest first."""
    return -(e.reduction or 0.0)


def verdict_of(effects: Sequence[Effect], unexplained: bool = False) -> Verdict:
    """What effects, and whether anything remains unexplained, amount to."""
    if unexplained:
        return "unexplained"
    if any(e.alternatives for e in effects):
        return "confounded"
    return "effect_found" if effects else "no_effect"


@dataclass(frozen=True, slots=True)
class Gain:
    """Held-out error without and with the effects, and its reduction with a 95 % interval (shares)."""

    before: float
    after: float
    reduction: float
    low: float
    high: float
    by_record: tuple[tuple[str, float, float], ...] = ()
    metric: str = "held-out normalised output error"

    @property
    def words(self) -> str:
        """The reduction with its interval: the error is less, or it is more."""
        low, high = sorted((self.low, self.high), key=abs)
        if low * self.reduction < 0 or high * self.reduction < 0:
            return f"{_less(self.reduction)} (95 %: {_less(self.low)} to {_less(self.high)})"
        return f"{_less(self.reduction)} (95 %: {100 * abs(low):.1f} to {100 * abs(high):.1f})"


def _less(share: float) -> str:
    return f"{100 * abs(share):.1f} % {'less' if share >= 0 else 'more'}"


class Result(Protocol):
    """What both kinds of diagnosis have in common."""

    @property
    def aircraft(self) -> Aircraft: ...
    @property
    def verdict(self) -> Verdict: ...
    @property
    def named(self) -> Sequence[Effect]: ...
    @property
    def gain(self) -> Gain | None: ...
    @property
    def remarks(self) -> Sequence[str]: ...
    @property
    def extended(self) -> Aircraft: ...
    @property
    def not_judged(self) -> Mapping[str, str]: ...
    @property
    def missed(self) -> Mapping[str, float]: ...
    @property
    def unexplained(self) -> tuple[Sequence[str], tuple[float, float]] | None: ...


_SAID: Final[Mapping[Verdict, str]] = {
    "no_effect": "no effect found", "effect_found": "found", "confounded": "found, but confounded",
    "unexplained": "UNEXPLAINED: the named effects are suspect",
}  # fmt: skip


def partly_judged(found: Result) -> bool:
    """Whether less was judged than the kinematic part can, which never judges what rests on aerodynamics."""
    return len(found.not_judged) > 1


_OF_THE_MODEL: Final = {
    "lift": "lift", "moment": "moment", "drag": "drag", "elevator": "what the elevator does",
    "side_force": "side force", "roll": "rolling moment", "yaw": "yawing moment",
    "aileron": "what the aileron does", "rudder": "what the rudder does",
}  # fmt: skip
"""A surface is compared with nothing but the model: what is missed in step with it may be either's."""


def missed_words(missed: Mapping[str, float]) -> list[str]:
    """What is missed though every parameter is free: by the aircraft's model, or of signals by any effect."""

    def shares(of_forces: bool) -> str:
        own = {n: v for n, v in missed.items() if (n in _OF_THE_MODEL) == of_forces}
        return ", ".join(f"{100 * v:.2g} % of {_OF_THE_MODEL.get(n, n)}" for n, v in own.items())

    out = []
    if forces := shares(True):
        out.append(f"the aircraft's model is in error: with its parameters free it still misses {forces}")
    if signals := shares(False):
        out.append(f"instruments are in error as no effect explains: what they show is off by {signals}")
    return out


def summary(found: Result) -> list[str]:
    """The diagnosis in a few lines."""
    partly = " in what could be judged" if partly_judged(found) else ""
    lines = [f"{found.aircraft.name}: {_SAID[found.verdict]}{partly}"]
    lines += [f"  {words}" for words in missed_words(found.missed)]
    for e in found.named:
        low, high = (from_si(x, e.term.shown) for x in e.ci95)
        span = f"{low:.3g} to {high:.3g}{'' if e.term.shown == '1' else f' {e.term.shown}'}"
        lines.append(f"  {e.term.id}: {e.sentence} (95 %: {span})")
        if e.alternatives:
            lines.append(f"    confounded with {', '.join(e.alternatives)}; to separate: {e.term.separate_by}")
    if found.unexplained is not None:
        signals, (low, high) = found.unexplained
        lines.append(f"  unexplained residual: {', '.join(signals)}, {low:.2f} to {high:.2f} Hz")
    gain = found.gain
    if gain is not None:
        lines.append(f"  held-out error {gain.before:.3f} -> {gain.after:.3f}: {gain.words}")
    lines += [f"  {remark}" for remark in found.remarks]
    return lines

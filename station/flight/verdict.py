"""Whether what a step was flown for is known, at once after the input: enough, again, or something else."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from station.conventions import LATERAL
from station.flight.reach import beyond_flight, beyond_travel, unmoved
from station.model.airframe_error import relative_errors
from station.profile import Aircraft, Card, Step, otherwise
from station.rows import ParamEstimate, ProfileError, Status

WORTH: Final = 0.8
"""Share of the error of the step's own input, to which another one must bring it to be worth the change."""
MOST: Final = 99


@dataclass(frozen=True, slots=True)
class Option:
    """An input that tells more of a derivative than the step's own, and its predicted error over that one's, both of
    the same peak and time."""

    name: str
    ratio: float


@dataclass(frozen=True, slots=True)
class Known:
    """How well a derivative is known, and how well it is wanted: 2 sd over its value."""

    name: str
    have: float
    """inf where it is not estimated."""
    wanted: float
    floor: float
    """What of it mass and inertia of the profile leave, however often is flown."""
    why: str = ""

    @property
    def enough(self) -> bool:
        return self.have <= self.wanted

    def runs(self, flown: int) -> int:
        """How many runs more bring it to what is wanted: errors but the floor's fall with the root of their number."""
        room = self.wanted**2 - self.floor**2
        if room <= 0 or not math.isfinite(self.have):
            return MOST
        return min(max(1, math.ceil(flown * ((self.have**2 - self.floor**2) / room - 1) - 1e-9)), MOST)


@dataclass(frozen=True, slots=True)
class Verdict:
    """`enough`; `repeat` the input; `change` it for another; `spent`: the step's runs are; `beyond` reach of any."""

    kind: Literal["enough", "repeat", "change", "spent", "beyond"]
    words: str
    known: tuple[Known, ...] = ()


NEEDED: Final = {
    "longitudinal": ("alpha_vane", "airspeed", "q", "ax", "az", "elevator"),
    "lateral": ("beta_vane", "airspeed", "p", "r", "ay", "aileron", "rudder"),
}
"""Signals without which no method gives derivatives of an axis."""


def obstacles(step: Step, aircraft: Aircraft, signals: Collection[str], card: Card | None = None) -> list[str]:
    """Before the flight: what keeps the step's criteria from being reached, however well it is flown. With the card,
    also what keeps it from being flown within the card's limits."""
    said = []
    axes = {"lateral" if n in LATERAL else "longitudinal" for n in step.accept}
    lacking = sorted({s for axis in axes for s in NEEDED[axis]} - set(signals))
    if lacking:
        said.append(f"no {', '.join(lacking)}")
    said += unmoved(step)
    try:
        said += beyond_travel(step.inputs, aircraft)
    except ProfileError as error:
        said.append(str(error))
    if card is not None:
        said += beyond_flight(step, aircraft, card)
    shares = relative_errors(aircraft, tuple(step.accept))[int("mass" in signals)] if step.accept else ()
    for (name, wanted), share in zip(step.accept.items(), shares, strict=True):
        if 2 * float(share) >= wanted:
            said.append(f"{name} to {_percent(wanted)}: mass and inertia of the profile leave {_percent(2 * share)}")
    if aircraft.measured is not None:
        pairs = otherwise(step.condition.configuration, aircraft.measured.condition)
        said += [f"{own}, the baseline {other}: what that changes would be told as changed" for own, other in pairs]
    return said


def known(step: Step, found: Mapping[str, ParamEstimate | None], floors: Mapping[str, float]) -> tuple[Known, ...]:
    """Of each derivative that the step is flown for."""
    made = []
    for name, wanted in step.accept.items():
        p = found.get(name)
        good = p is not None and p.status is Status.ESTIMATED and p.value != 0
        have = 2 * p.sd / abs(p.value) if p is not None and good else math.inf
        why = "" if good else (p.why if p is not None else "") or "not estimated"
        made.append(Known(name, have, wanted, floors.get(name, 0.0), why))
    return tuple(made)


def judge(
    step: Step, flown: int, found: Sequence[Known], faults: Sequence[str], options: Mapping[str, Option]
) -> Verdict:
    """After `flown` runs. `faults`: what was not as the step wants it; `options`: a better input, by derivative."""
    every, left = tuple(found), step.repeats - flown
    poor = [k for k in every if not k.enough]
    if faults:
        words = "; ".join(faults)
        return Verdict("repeat", f"repeat: {words}", every) if left > 0 else Verdict("spent", f"next: {words}", every)
    if not poor:
        return Verdict("enough", "enough: next step", every)
    reachable = [k for k in poor if k.floor < k.wanted]
    if not reachable:
        k = max(poor, key=lambda one: one.floor / one.wanted)
        words = f"next: mass and inertia of the profile alone leave {_percent(k.floor)} of {k.name}"
        return Verdict("beyond", f"{words}, {_percent(k.wanted)} wanted", every)
    worst = max(reachable, key=lambda k: k.runs(flown))
    more = worst.runs(flown)
    size = f"to {_percent(worst.have)}" if math.isfinite(worst.have) else f"not ({worst.why})"
    state = f"{worst.name} is known {size}, {_percent(worst.wanted)} wanted"
    option = options.get(worst.name)
    if option is not None and option.ratio < WORTH and (more > left or not math.isfinite(worst.have)):
        times = max(1, math.ceil(more * option.ratio**2 - 1e-9)) if math.isfinite(worst.have) else 1
        return Verdict("change", f"fly {option.name}, {_times(times)}: {state}", every)
    if left <= 0:
        return Verdict("spent", f"next: all {step.repeats} runs are flown; {state}", every)
    many = "once more" if more in (1, MOST) else f"about {_times(more)}"
    return Verdict("repeat", f"repeat {many}: {state}", every)


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.0f} %"


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"

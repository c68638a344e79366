"""What a diagnosis says (station.diagnose/1), held against what was hidden in its flights."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

NEIGHBOURS: Final[Mapping[str, tuple[str, ...]]] = {
    "elevator.delay": ("elevator.delay", "elevator.lag"),
    "pot_cubic": ("elevator.nonlinearity",),
    "alpha_vane.lag": ("alpha_vane.delay", "alpha_vane.dynamics"),
    "aero.separation": ("aero.separation", "aero.alpha_squared"),
    "alpha_vane.stiction": (),
    "slosh": (),
}
"""What a catalogue without such an effect may say instead; its size is then of another unit and not judged."""


@dataclass(frozen=True)
class Score:
    """Of one case."""

    name: str
    air: str
    hidden: Mapping[str, float]
    verdict: str
    named: tuple[str, ...]
    alone: tuple[str, ...]
    """Of what is hidden, what is named for itself."""
    grouped: tuple[str, ...]
    """What is named with rivals, or as one."""
    held: tuple[str, ...]
    """Of those alone, whose 95 % interval holds the truth; of the sizes that can be judged."""
    judged: tuple[str, ...]
    sound: tuple[str, ...]
    """Names that are no effect hidden, but a true difference from the profile, with an interval that holds it."""
    false: tuple[str, ...]
    """All other names whose rivals have nothing of the hidden either."""
    suspect: bool
    """Whether the diagnosis itself says that its names are suspect."""
    worse: bool
    """Whether names were printed though the held-out error did not fall."""
    seconds: float = 0.0

    @property
    def confident(self) -> tuple[str, ...]:
        """False names that are not called suspect."""
        return () if self.suspect else self.false


def answers_of(hidden: str) -> tuple[str, ...]:
    """What names an effect rightly: itself, unless it lies outside the catalogue."""
    return NEIGHBOURS.get(hidden, (hidden,))


def score(
    name: str,
    air: str,
    hidden: Mapping[str, float],
    deviations: Mapping[str, float],
    unjudged: Iterable[str],
    result: Mapping[str, Any],
) -> Score:
    """`hidden`, and all `deviations` from the profile, what is hidden among them, in SI by the catalogue's ids;
    `unjudged`: whose size has no known unit."""
    effects = result.get("effects", [])
    wanted = {answer: h for h in hidden for answer in answers_of(h)}
    alone, grouped, held, judged, sound, false = [], [], [], [], [], []
    for e in effects:
        rivals = set(e.get("confounded_with", []))
        low, high = e["ci95"]
        if (h := wanted.get(e["id"])) is not None:
            (grouped if rivals else alone).append(h)
            if not rivals and h == e["id"] and h not in unjudged:
                judged.append(h)
                if low <= deviations.get(h, hidden[h]) <= high:
                    held.append(h)
        elif rivals & wanted.keys():
            grouped += [wanted[r] for r in rivals & wanted.keys()]
        elif e["id"] in deviations and low <= deviations[e["id"]] <= high:
            sound.append(e["id"])
        else:
            false.append(e["id"])
    gain = result.get("gain") or {}
    verdict = result.get("verdict", "refused")
    return Score(
        name=name,
        air=air,
        hidden=hidden,
        verdict=verdict,
        named=tuple(e["id"] for e in effects),
        alone=tuple(dict.fromkeys(alone)),
        grouped=tuple(g for g in dict.fromkeys(grouped) if g not in alone),
        held=tuple(held),
        judged=tuple(judged),
        sound=tuple(sound),
        false=tuple(false),
        suspect=verdict == "unexplained" or any(e.get("suspect") for e in effects),
        worse=bool(effects) and gain.get("after", 0.0) > gain.get("before", 0.0),
    )


def table(scores: list[Score]) -> str:
    """A row a case."""
    lines = ["| case | air | hidden | verdict | named | false | holds |", "|---|---|---|---|---|---|---|"]
    for s in scores:
        marked = [f"**{n}**" if n in {a for h in s.hidden for a in answers_of(h)} else n for n in s.named]
        hides = ", ".join(f"{n} {v:.3g}" for n, v in s.hidden.items()) or "nothing"
        false = f"{len(s.false)}{' suspect' if s.false and s.suspect else ''}"
        holds = f"{len(s.held)}/{len(s.judged)}" if s.judged else ""
        lines.append(f"| {s.name} | {s.air} | {hides} | {s.verdict} | {', '.join(marked)} | {false} | {holds} |")
    return "\n".join(lines)


def totals(scores: list[Score]) -> str:
    """Clean cases, single effects, pairs and triples, and those outside the catalogue, each in a row."""

    def outside(s: Score) -> bool:
        return any(h not in answers_of(h) for h in s.hidden)

    groups = {
        "nothing hidden": [s for s in scores if not s.hidden],
        "one": [s for s in scores if len(s.hidden) == 1 and not outside(s)],
        "two or three": [s for s in scores if len(s.hidden) > 1 and not outside(s)],
        "outside the catalogue": [s for s in scores if outside(s)],
    }
    lines = [
        "| hidden | cases | effects | named alone | in a group | intervals that hold | cases with a false name | "
        "of them called suspect | false names | other true differences named | worse held out |",
        "|" + "---|" * 11,
    ]
    for words, chosen in groups.items():
        if chosen:
            cells = (
                len(chosen),
                sum(len(s.hidden) for s in chosen),
                sum(len(s.alone) for s in chosen),
                sum(len(s.grouped) for s in chosen),
                f"{sum(len(s.held) for s in chosen)}/{sum(len(s.judged) for s in chosen)}",
                sum(bool(s.false) for s in chosen),
                sum(bool(s.false) and s.suspect for s in chosen),
                sum(len(s.false) for s in chosen),
                sum(len(s.sound) for s in chosen),
                sum(s.worse for s in chosen),
            )
            lines.append(f"| {words} | " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)

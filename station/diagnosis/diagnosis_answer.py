"""What a diagnosis answers, in one sentence to quote: what is wrong, by how much, how sure, and what is not known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from station.diagnosis.diagnosis_result import Effect, Result, Verdict, missed_words

QUOTED: Final = 3
"""Effects in the sentence, those with the strongest evidence; all are in the table."""
_SIMULATED: Final[Mapping[Verdict, str]] = {
    "no_effect": (
        "the measured flight agrees with the simulation within noise, gusts and the profile's doubt: no effect found"
    ),
    "effect_found": "the measured flight differs from the simulation, explained by: {}",
    "confounded": "the measured flight differs from the simulation; a possible cause, not separated from others: {}",
    "unexplained": "UNEXPLAINED, the measured flight differs from the simulation beyond what the catalogue explains",
}
_INSTRUMENTS: Final[Mapping[Verdict, str]] = {
    "no_effect": "the instruments agree with each other within noise, so far as they could be judged",
    "effect_found": "the instruments disagree with each other, explained by: {}",
    "confounded": "the instruments disagree with each other; a possible cause, not separated from others: {}",
}


def answer(found: Result, not_confirmed: Sequence[Effect] = (), of_instruments: bool = False) -> str:
    """One sentence. `not_confirmed`: effects that the manoeuvres fitted ask for and those held out do not confirm;
    `of_instruments`: nothing was simulated, the instruments were held against each other."""
    said = (_INSTRUMENTS if of_instruments else _SIMULATED)[found.verdict]
    clauses = [f"{found.aircraft.name}: {said.format(_effects(found.named))}"]
    if found.verdict == "unexplained":
        clauses += missed_words(found.missed)
        if found.unexplained is not None:
            signals, (low, high) = found.unexplained
            clauses.append(f"residual in {', '.join(signals)} at {low:.2g} to {high:.2g} Hz")
        if found.named:
            clauses.append(f"suspect: {_effects(found.named)}")
    if found.gain is not None:
        clauses.append(f"error in manoeuvres held out: {found.gain.words}")
    elif found.named:
        clauses.append("not tested on a manoeuvre held out")
    if not_confirmed:
        clauses.append(f"asked for, but not confirmed: {', '.join(e.term.id for e in not_confirmed)}")
    if found.not_judged:
        clauses.append(f"not judged: {', '.join(found.not_judged)}")
    return "; ".join(clauses) + "."


def _effects(effects: Sequence[Effect]) -> str:
    """In words, with intervals and what each is confounded with."""
    words = []
    for e in effects[:QUOTED]:
        low, high = (e.shown(x) for x in e.ci95)
        span = f" (95 %: {low} to {high})" if e.sd > 0 else ""
        other = f", or {' or '.join(e.alternatives)}" if e.alternatives else ""
        sentence = e.sentence.rstrip(".")
        start = sentence[0].lower() if sentence[1:2].islower() or sentence[1:2] == " " else sentence[0]
        words.append(f"{start}{sentence[1:]}{span}{other}")
    more = len(effects) - QUOTED
    return " and ".join(words) + (f", and {more} more in the table" if more > 0 else "")

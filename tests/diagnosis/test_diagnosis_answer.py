"""The sentence that a diagnosis's page begins with: the effect with its interval, and whatever makes it less sure."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from station.diagnosis.diagnosis_answer import answer
from station.diagnosis.diagnosis_result import Effect, Gain, verdict_of
from station.diagnosis.effects import BY_ID
from station.profile import Aircraft, load_aircraft

DELAY = Effect(BY_ID["alpha_vane.delay"], 0.030, 0.005, 40.0)
BETTER = Gain(2.0, 1.0, 0.5, 0.4, 0.6)


@dataclass
class Found:
    """What `answer` asks of a diagnosis."""

    named: tuple[Effect, ...] = ()
    gain: Gain | None = None
    unexplained: tuple[tuple[str, ...], tuple[float, float]] | None = None
    missed: dict[str, float] = field(default_factory=dict)
    not_judged: dict[str, str] = field(default_factory=dict)
    aircraft: Aircraft = field(default_factory=lambda: load_aircraft("twin_otter"))
    remarks: tuple[str, ...] = ()

    @property
    def extended(self) -> Aircraft:
        return self.aircraft

    @property
    def verdict(self):
        return verdict_of(self.named, self.unexplained is not None)


@pytest.mark.parametrize(
    ("found", "says"),
    [
        (Found(), ["no effect found"]),
        (
            Found((DELAY,), BETTER),
            ["explained by: the alpha vane is delayed by +30 ms (95 %: 20.2 ms to 39.8 ms)", "50.0 % less"],
        ),
        (Found((DELAY,)), ["not tested on a manoeuvre held out"]),
        (
            Found((Effect(DELAY.term, 0.03, 0.005, 40.0, ("gust.lead",)),)),
            ["possible cause, not separated from others", "or gust.lead"],
        ),
        (
            Found((DELAY,), unexplained=(("lift",), (0.5, 1.0)), missed={"lift": 0.1}),
            ["UNEXPLAINED", "10 % of lift", "residual in lift at 0.5 to 1 Hz", "suspect: the alpha vane"],
        ),
        (Found(not_judged={"mass": "no elevator"}), ["not judged: mass"]),
    ],
)
def test_one_sentence_says_what_is_wrong_and_how_sure(found: Found, says: list[str]) -> None:
    """1.96 x 5 ms about 30 ms."""
    said = answer(found)
    assert said.startswith("twin_otter: ")
    assert said.endswith(".")
    for words in says:
        assert words in said


def test_what_is_not_confirmed_is_no_finding_and_is_said() -> None:
    assert "asked for, but not confirmed: alpha_vane.delay" in answer(Found(), (DELAY,))


def test_instruments_alone_are_not_said_to_agree_with_a_simulation() -> None:
    said = answer(Found(), of_instruments=True)
    assert "instruments agree with each other" in said
    assert "simulation" not in said

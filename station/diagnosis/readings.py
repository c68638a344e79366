"""What engineers of simulators and of handling qualities read in a diagnosis: as JSON, lines and pieces of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from station.diagnosis.derivative_posterior import diagnosed_qualities
from station.diagnosis.misfit import misfits
from station.diagnosis.model_validity import Validity, validity, validity_json, validity_lines
from station.diagnosis.procedure import Diagnosis
from station.diagnosis.qualification import Flown, qualification_json, qualification_lines, qualified
from station.diagnosis.reported import Moved, free_parameters_of
from station.identification.handling_qualities import derived_json, derived_lines
from station.model.flying_qualities import Qualities

_SUSPECT = "suspect, for what is unexplained: "
_USUAL = 1.96
"""Prior standard deviations that 95 % of derivatives lie within, if the profile's doubt is what it says."""


@dataclass(frozen=True, slots=True)
class Readings:
    """Derived quantities after the extension, or why there are none, and before; every manoeuvre
    simulated from its measured inputs."""

    derived: Qualities | str
    derived_before: Qualities | None
    qualification: Sequence[Flown]
    validity: Validity | None
    """Where the model holds; None where lift and moment cannot be judged."""
    suspect: bool
    """Whether something remains unexplained, which all of this may suffer from."""
    unusual: Sequence[Moved]
    """Derivatives outside the profile's 95 % range that are not named."""

    def as_json(self) -> dict[str, Any]:
        """Keys of station.diagnose/1."""
        return {
            "derived": {**derived_json(self.derived), "suspect": self.suspect},
            "qualification": qualification_json(self.qualification),
            "where_it_holds": None if self.validity is None else validity_json(self.validity),
        }

    def lines(self) -> list[str]:
        """For the terminal."""
        first, *more = derived_lines(self.derived)
        own = [f"{_SUSPECT}{first}" if self.suspect else first, *more]
        holds = [] if self.validity is None else validity_lines(self.validity)
        return [*self._unusual_lines, *own, *qualification_lines(self.qualification), *holds]

    @property
    def _unusual_lines(self) -> list[str]:
        words = ", ".join(f"{p.name} {p.words}" for p in self.unusual)
        return [f"outside the profile's 95 % range, but too little to be named: {words}"] if words else []

    def page(self) -> list[str]:
        """Pieces of HTML."""
        from station.diagnosis.qualification_pages import qualification_page  # and with it matplotlib
        from station.diagnosis.validity_pages import validity_page
        from station.identification.handling_pages import derived_page

        head, *rest = derived_page(self.derived, self.derived_before)
        doubt = ["<p>Suspect: something remains unexplained.</p>"] if self.suspect else []
        holds = [] if self.validity is None else validity_page(self.validity)
        return [head, *doubt, *rest, *qualification_page(self.qualification), *holds]


def readings_of(found: Diagnosis) -> Readings:
    """From a diagnosis against the simulation."""
    after, before = diagnosed_qualities(found)
    records = [m.recorded for m in (*found.problem.manoeuvres, *found.held_out)]
    flown = qualified(records, found.aircraft, found.after)
    over_time = misfits(found)
    held = validity(over_time) if over_time else None
    return Readings(after, before, flown, held, found.verdict == "unexplained", _unusual(found))


def _unusual(found: Diagnosis) -> list[Moved]:
    named = {e.term.id for e in found.named}
    of = [found, *([found.lateral] if found.lateral else [])]
    moved = [p for d in of for p in free_parameters_of(d) if p.of_derivative and f"aero.{p.name}" not in named]
    return [p for p in moved if abs(p.in_prior_sd) > _USUAL]

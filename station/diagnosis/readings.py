"""What engineers of simulators and of handling qualities read in a diagnosis: as JSON, lines and pieces of a page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from station.diagnosis.derivative_posterior import diagnosed_qualities
from station.diagnosis.procedure import Diagnosis
from station.identification.handling_qualities import derived_json, derived_lines
from station.model.flying_qualities import Qualities

_SUSPECT = "suspect, for what is unexplained: "


@dataclass(frozen=True, slots=True)
class Readings:
    """Derived quantities after the extension, or why there are none, and before."""

    derived: Qualities | str
    derived_before: Qualities | None
    suspect: bool
    """Whether something remains unexplained, which all of this may suffer from."""

    def as_json(self) -> dict[str, Any]:
        """Keys of station.diagnose/1."""
        return {"derived": {**derived_json(self.derived), "suspect": self.suspect}}

    def lines(self) -> list[str]:
        """For the terminal."""
        first, *more = derived_lines(self.derived)
        return [f"{_SUSPECT}{first}" if self.suspect else first, *more]

    def page(self) -> list[str]:
        """Pieces of HTML."""
        from station.identification.handling_pages import derived_page  # and with it matplotlib

        head, *rest = derived_page(self.derived, self.derived_before)
        return [head, *(["<p>Suspect: something remains unexplained.</p>"] if self.suspect else []), *rest]


def readings_of(found: Diagnosis) -> Readings:
    """From a diagnosis against the simulation."""
    after, before = diagnosed_qualities(found)
    return Readings(after, before, found.verdict == "unexplained")

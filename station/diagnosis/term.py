"""One row of the catalogue: an effect that diagnosis can name, and all that is known of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from station.conventions import from_si
from station.profile import Aircraft
from station.profile.profile_changes import Extend


@dataclass(frozen=True, slots=True)
class Kinematic:
    """How an effect shows in the instruments alone: see kinematic_diagnosis."""

    parameter: str
    """Of the vane's calibration or of the reconstruction."""
    least: float
    """Below this it is of no consequence, SI."""
    confounded_with: Callable[[Aircraft], tuple[str, ...]] = lambda _: ()
    sound_vane: bool = False
    """Whether it can only be judged where the vane shows no effect."""


@dataclass(frozen=True, slots=True)
class Term:
    """One effect."""

    id: str
    target: str
    """The signals, or the part of the model, that it changes."""
    unit: str
    """SI unit of the value."""
    shown: str
    """The unit that the sentence speaks in."""
    low: float
    high: float
    """Physical range of the value, SI."""
    step: float
    """A small change, SI: of the size that three manoeuvres detect."""
    sentence: str
    """For the report; {value} is the value with sign and unit, {size} without the sign."""
    separate_by: str
    """The experiment that separates it from what it is confounded with."""
    extend: Extend
    """How it acts on a profile."""
    shows_in: tuple[str, ...] = ()
    """The series of residuals.SERIES that it changes."""
    null: float = 0.0
    """The value that changes nothing."""
    probes: tuple[float, ...] = ()
    """Values from which it is tried: its effect is so bent that no small change from nothing shows it."""
    searched: bool = True
    """Whether it is a candidate of the search; others are seen before, or are found with the model in error."""
    aerodynamic: bool = False
    lateral: bool = False
    """Whether it is looked for in what is lateral: another search."""
    gust_only: bool = False
    """Shows in turbulence only."""
    price: float = 0.0
    """What -2 log likelihood must fall by more than for others: it is that much rarer."""

    # --- when it can be judged
    needs: tuple[str, ...] = ()
    """Optional signals without which it cannot be judged."""
    where_held: bool = True
    """Whether it can be judged where the velocity repeats its values."""
    applies: Callable[[Aircraft], bool] = lambda _: True
    """Whether the aircraft's profile describes what it changes."""
    least: float = 0.0
    """Smallest size judged, SI."""
    least_in_noise: float = 0.0
    """The same, in standard deviations of the noise of its target."""
    unsure_in_noise: float = 0.0
    """What its value is uncertain by however long the record, in standard deviations of the noise of its target."""

    # --- what it is confounded with
    same_value: Callable[[Aircraft], tuple[str, float] | None] = lambda _: None
    """Another effect that acts as this one does, and the value that it then has by the profile."""

    # --- with the model in error, or without any model
    kinematic: Kinematic | None = None

    def words(self, value: float) -> str:
        """The sentence with the value in it."""
        return self.sentence.format(value=self.signed(value), size=self.signed(abs(value)).removeprefix("+"))

    def signed(self, value: float) -> str:
        """A value with its sign, in the unit that the sentence speaks in."""
        return f"{from_si(value, self.shown):+.3g}{'' if self.shown == '1' else f' {self.shown}'}"

    def at_end(self, value: float) -> bool:
        """Whether it is at an end of what is physical, and would go on: something else then is the matter. That nothing
        of a thing is left (-100 %), or that the effect is not there, is no such end."""
        return value >= self.high or (value <= self.low and self.low not in (-1.0, self.null))

    @property
    def tried(self) -> tuple[Term, ...]:
        """The effect as a linear model tries it: by a small change, or by one to each of its probes."""
        return tuple(replace(self, step=x - self.null) for x in self.probes) or (self,)

    @property
    def is_backlash(self) -> bool:
        """Whether a surface follows its drive through lost motion."""
        return self.id.endswith(".backlash")

    @property
    def of_vane(self) -> bool:
        """Whether it is an error of what the alpha vane shows."""
        return self.target == "alpha_vane" and not self.aerodynamic

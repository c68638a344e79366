"""A campaign's specification: TOML -> frozen Campaign and its cases.

    [flight]     what every flight has in common
    [factors]    lists of levels, each of a key of [flight]; every combination is a case of `runs` flights
    [[variants]] keys of [flight] that change together; every one is flown with every combination
    [[inputs.NAME]]  manoeuvres that the flight's `input` names
    [pilots.NAME]    feedback that the flight's `pilot` names: a card's [pilot]

Anything else is as in profiles: quantities with their units, unknown keys refused.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BeforeValidator, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from station.campaign.study import Baseline, Claim, Comparison, PrintedTable
from station.campaign.whole_records import WHOLE
from station.conventions import LONGITUDINAL, LONGITUDINAL_BODY, to_si
from station.estimation.method_fits import KINDS
from station.profile import (
    Frozen,
    Hertz,
    Instrument,
    Manoeuvre,
    Metres,
    MetresPerSecond,
    Pilot,
    Positive,
    Seconds,
    explain,
    find,
    load_aircraft,
    nearest,
    read_profile,
)
from station.rows import ProfileError
from station.simulation.gusts import LEVELS

TURBULENCE: Final = {"calm": 0.0} | {level: aloft for level, (_, aloft) in LEVELS.items()}
"""Standard deviation of the vertical gust above 2,000 ft, m/s."""

BENCHMARKS: Final = ("perfect", "raw")
"""Regressors no station has or should use: the true angle of attack at the CG, and the vane as it is."""
METHODS: Final = (*KINDS, *BENCHMARKS, "physical", *WHOLE)
"""In the order of the compiled pass's places, then those that need the whole record."""


def _turbulence(value: object) -> object:
    if isinstance(value, str) and value in TURBULENCE:
        return f"{TURBULENCE[value]!r} m/s"
    if isinstance(value, str) and not any(c.isdigit() for c in value):
        raise PydanticCustomError(
            "quantity",
            "unknown turbulence {word}{near}; use {known} or a speed, for example {eg}",
            {
                "word": value,
                "near": nearest(value, tuple(TURBULENCE)),
                "known": ", ".join(TURBULENCE),
                "eg": '"5 ft/s"',
            },
        )
    return value


class Scenario(Frozen):
    """One kind of flight. Each key may be a factor."""

    point: str = ""
    """What the test point is called."""
    aircraft: str = "twin_otter"
    """Name or path of the profile."""
    icing: Annotated[float, Field(ge=0)] = 0.0
    """Ice on the whole aircraft, 1 as in the reference icing condition of the Twin Otter; no estimator is told."""
    lift: Literal["steady", "unsteady"] = "unsteady"
    """steady: quasi-steady lift, everything at the CG; unsteady: as the aircraft's profile says."""
    speed: MetresPerSecond = to_si(110.0, "kt")
    """True airspeed of the trim."""
    altitude: Metres = to_si(2500.0, "ft")
    """Above mean sea level."""
    turbulence: Annotated[MetresPerSecond, Field(ge=0), BeforeValidator(_turbulence)] = 0.0
    """Standard deviation of the vertical gust, or calm, light, moderate or severe."""
    field: Literal["line", "plane"] = "line"
    """What gusts vary over, as a card's flight has it; the wings stay level."""
    turbulence_start: Annotated[Seconds, Field(ge=0)] = 0.0
    """After the record begins; 0: it was always there."""
    input: str = ""
    """Which of the inputs; the only one if left out."""
    pilot: str = ""
    """Which of the pilots moves the elevator beside the input; hands off if left out."""
    alpha: Literal["boom", "perfect", "vane", "distorted", "distorted gust"] = "boom"
    """What is measured. boom: the profile's, which the estimators know. perfect: the angle of attack at the CG. vane:
    that through the vane's dynamics. distorted: through `distortion` as well; distorted gust: the gust's part only."""
    vane_frequency: Annotated[Hertz, Positive] | None = None
    """The vane's, in place of the profile's."""
    vane_damping: float | None = Field(default=None, gt=0, lt=2)
    """The vane's, in place of the profile's."""
    signal_to_noise: float | None = Field(default=None, gt=0)
    """White noise on alpha_vane, q and elevator of their standard deviation over this; the noise of a good installation
    on every channel if left out."""
    noise: float = Field(default=1.0, ge=0)
    """Of a good installation's noise on every channel, where no signal-to-noise ratio is given."""
    CL_gust: float = 0.0
    """Additional to CL_alpha, per rad of the gust's part of alpha. Cm alike."""
    Cm_gust: float = 0.0
    """As CL_gust."""


class Distortion(Frozen):
    """What the measured angle of attack is at each frequency: divided by `correction`, early by `lead`."""

    frequency: tuple[Hertz, ...]
    """Rising."""
    correction: tuple[float, ...]
    """At each frequency."""
    lead: tuple[Seconds, ...]
    """At each frequency."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        return {k: tuple(v) if isinstance(v, list) else v for k, v in raw.items()} if isinstance(raw, dict) else raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        f = self.frequency
        if not len(f) == len(self.correction) == len(self.lead) or any(b <= a for a, b in itertools.pairwise(f)):
            raise PydanticCustomError("table", "frequency must rise, correction and lead have a value for each")
        if min(self.correction, default=0.0) <= 0:
            raise PydanticCustomError("table", "correction must be above 0")
        return self


_LISTS: Final = ("methods", "figures", "show", "variants", "claims", "comparisons", "tables")


class Campaign(Frozen):
    """A specification as it is written."""

    name: str
    """What its results are called."""
    description: str = ""
    """One sentence."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Of all its gusts and noise."""
    runs: Annotated[int, Field(gt=0)]
    """Flights a case."""
    methods: tuple[str, ...]
    """What estimates: methods, or the benchmarks `perfect` and `raw`."""
    axes: Literal["wind", "body"] = "wind"
    """CL or CZ."""
    reference: Literal["truth", "calm"] = "truth"
    """Errors are from the aircraft's own derivatives, or from what perfect sensors give in calm air (`physical`
    estimates the former always)."""
    tolerance: Annotated[float, Positive] = 0.1
    """An estimate further from its reference, as a share of it, is an exceedance."""
    record: Annotated[Seconds, Positive] = 20.0
    """Estimates are taken after so long."""
    warm_up: Annotated[Seconds, Field(ge=0)] = 0.0
    """Flown before the record, for the filters to settle."""
    low: Annotated[Hertz, Positive] = 0.1
    """Lowest frequency of the estimates."""
    high: Annotated[Hertz, Positive] = 2.0
    """Highest frequency of the estimates."""
    step: Annotated[Hertz, Positive] = 0.04
    """Spacing of the transform's lines."""
    spectra: Annotated[Seconds, Positive] = 400.0
    """Flight in the same air, its input repeated every `record`, that method IV takes its spectra from."""
    segments: bool = True
    """As in flight, the transform begins anew every 1/step; false: one transform over the record."""
    figures: tuple[Literal["estimates", "exceedances", "errors"], ...] = ()
    """Drawn at the end."""
    show: tuple[str, ...] = ()
    """Parameters in the figures; all if left out."""
    flight: Scenario
    factors: dict[str, tuple[Any, ...]] = Field(default={})
    """`[factors]`: lists of levels of keys of [flight]; every combination is a case."""
    variants: tuple[dict[str, Any], ...] = ()
    """`[[variants]]`: keys of [flight] that change together, flown with every combination."""
    inputs: dict[str, tuple[Manoeuvre, ...]] = Field(default={})
    """Their times count from the record's begin."""
    pilots: dict[str, Pilot] = Field(default={})
    """As a card's [pilot]."""
    distortion: Distortion | None = None
    claims: tuple[Claim, ...] = ()
    comparisons: tuple[Comparison, ...] = ()
    """One sentence each for every combination of the factors but turbulence."""
    baseline: Baseline | None = None
    tables: tuple[PrintedTable, ...] = ()
    """A study's tables, to be printed with what is found here beside."""

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if not isinstance(raw, dict):
            return raw
        raw = {k: tuple(v) if k in _LISTS and isinstance(v, list) else v for k, v in raw.items()}
        for table in ("factors", "inputs"):
            if isinstance(raw.get(table), dict):
                raw[table] = {k: tuple(v) if isinstance(v, list) else v for k, v in raw[table].items()}
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        def unless(word: str, known: tuple[str, ...], what: str) -> None:
            if word not in known:
                raise PydanticCustomError(
                    "signal", "unknown {what} {word}{near}", {"what": what, "word": word, "near": nearest(word, known)}
                )

        for method in self.methods:
            unless(method, METHODS, "method")
        if "physical" in self.methods and self.axes == "body":
            raise PydanticCustomError("signal", 'method physical estimates in wind axes only: write axes = "wind"')
        for name, levels in self.factors.items():
            unless(name, tuple(Scenario.model_fields), "factor")
            if not levels or len(set(levels)) < len(levels):
                raise PydanticCustomError("signal", "factor {name}: needs levels, each once", {"name": name})
        for variant in self.variants:
            for name in variant:
                unless(name, tuple(Scenario.model_fields), "factor")
            if set(variant) != set(self.variants[0]) or set(variant) & set(self.factors):
                raise PydanticCustomError("signal", "variants: every one needs the same keys, and none of the factors'")
        for parameter in self.show:
            unless(parameter, self.parameters, "parameter")
        for claim in self.claims:
            unless(claim.parameter, self.parameters, "parameter")
            if claim.method:
                unless(claim.method, self.methods, "method of this campaign")
            for name in claim.where:
                unless(name, self.varied, "factor")
        if self.tables and self.baseline is None:
            raise PydanticCustomError("table", "tables need a [baseline] that their change is from")
        for table in (*self.tables, *((self.baseline,) if self.baseline else ())):
            for method in table.methods:
                unless(method, self.methods, "method of this campaign")
            for name in table.where:
                unless(name, self.varied, "factor")
        for comparison in self.comparisons:
            for method in (comparison.method, comparison.against):
                unless(method, self.methods, "method of this campaign")
        if self.high <= self.low:
            raise PydanticCustomError("signal", "high must be above low")
        return self

    @property
    def varied(self) -> tuple[str, ...]:
        """Keys of the flight that differ from case to case."""
        return (*self.factors, *(self.variants[0] if self.variants else ()))

    @property
    def parameters(self) -> tuple[str, ...]:
        return LONGITUDINAL if self.axes == "wind" else LONGITUDINAL_BODY


@dataclass(frozen=True, slots=True)
class Case:
    """One combination of levels, as the specification writes them, and the flight it makes."""

    number: int
    levels: dict[str, Any]
    scenario: Scenario


@dataclass(frozen=True, slots=True)
class Plan:
    """A campaign, its cases, and the text that it came from."""

    campaign: Campaign
    cases: tuple[Case, ...]
    text: str
    path: Path | None = None

    @property
    def flights(self) -> int:
        return len(self.cases) * self.campaign.runs

    @property
    def ticks(self) -> int:
        """50 Hz samples of one flight."""
        return math.ceil((self.campaign.warm_up + self.campaign.record) * 50.0 - 1e-9)


def load_plan(name: str) -> Plan:
    """A campaign by name or path. Raises ProfileError."""
    path = find("campaigns", name)
    campaign = read_profile(Campaign, path)
    wrong = partial(_wrong, path)
    cases: list[Case] = []
    for levels in itertools.product(*campaign.factors.values(), campaign.variants or ({},)):
        chosen = {**dict(zip(campaign.factors, levels, strict=False)), **levels[-1]}
        values = {name: _level(path, name, level) for name, level in chosen.items()}
        cases.append(Case(len(cases), chosen, campaign.flight.model_copy(update=values)))
    _require_cases(campaign, cases, wrong)
    known = tuple(campaign.inputs)
    for scenario in {c.scenario for c in cases}:
        aircraft = load_aircraft(scenario.aircraft, path)
        if scenario.input and scenario.input not in known:
            raise wrong("input", f"no inputs.{scenario.input}{nearest(scenario.input, known)}")
        if scenario.pilot and scenario.pilot not in campaign.pilots:
            raise wrong("pilot", f"no pilots.{scenario.pilot}{nearest(scenario.pilot, campaign.pilots)}")
        if scenario.pilot and campaign.pilots[scenario.pilot].moved - {"elevator"}:
            raise wrong(f"pilots.{scenario.pilot}", "a campaign's wings are level: leave bank, heading and dampers out")
        if not scenario.input and len(known) > 1:
            raise wrong("flight.input", f"missing: which of {', '.join(known)}?")
        if scenario.alpha.startswith("distorted") and campaign.distortion is None:
            raise wrong("distortion", f'missing, with alpha = "{scenario.alpha}"')
        if scenario.alpha == "boom" and aircraft.boom is None:
            raise wrong("flight.alpha", f'aircraft {aircraft.name} has no boom: write alpha = "perfect" or "vane"')
        faulty = sorted(name for name, errors in aircraft.instruments.items() if errors != Instrument())
        if faulty:
            raise wrong(
                "flight.aircraft",
                f"{scenario.aircraft} has instruments with errors ({', '.join(faulty)}), which no campaign flies\n"
                "name a profile without [instruments], or fly this one with `station simulate`",
            )
    return Plan(campaign, tuple(cases), path.read_text(encoding="utf-8"), path)


def _require_cases(campaign: Campaign, cases: Sequence[Case], wrong: Callable[[str, str], ProfileError]) -> None:
    """A claim is of some case, a table and its baseline of one."""
    asked: list[tuple[str, dict[str, Any], bool]] = [("claims", c.where, False) for c in campaign.claims]
    asked += [("tables", t.where, True) for t in campaign.tables]
    asked += [("baseline", campaign.baseline.where, True)] if campaign.baseline else []
    for key, where, one in asked:
        found = sum(all(c.levels[n] == level for n, level in where.items()) for c in cases)
        words = ", ".join(f"{n} {level}" for n, level in where.items()) or "any level"
        if not found:
            raise wrong(f"{key}.where", f"no case has {words}")
        if one and found > 1:
            raise wrong(f"{key}.where", f"{found} cases have {words}: name one")


def _wrong(path: Path, key: str, what: str) -> ProfileError:
    return ProfileError(f"{path}: {key}: {what}")


def _level(path: Path, name: str, level: Any) -> Any:
    """A factor's level as the flight has it."""
    try:
        return getattr(Scenario.model_validate({name: level}), name)
    except ValidationError as error:
        raise ProfileError(
            explain(path, Scenario, error).replace(f": {name}:", f": factors.{name}: {level!r}:", 1)
        ) from None

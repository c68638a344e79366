"""A test card: aircraft, rig, what to fly, what goes wrong, and when the answers are good enough."""

from __future__ import annotations

import math
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from station.profile.altered import Change, flattened
from station.profile.quantity import (
    SI_NUMBERS,
    Bytes,
    Frozen,
    Hertz,
    Metres,
    MetresPerSecond,
    Positive,
    Radians,
    RadiansPerMetre,
    RadiansPerSpeed,
    Seconds,
)
from station.profile.shapes import DiscreteGust, Leg, Manoeuvre
from station.profile.step import Limits, Step


class Fault(Frozen):
    """What an emulated device does wrong, from `start` for `duration` (seconds of flight)."""

    device: str
    """Which device of the rig."""
    kind: Literal["off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent", "clock_step", "unplug"]
    """What goes wrong."""
    start: Seconds
    """From when on."""
    duration: Annotated[Seconds, Positive]
    """For how long."""
    stream: str | None = None
    """Only this stream of the device; all of them if left out."""
    signal: str | None = None
    """For "wrong": the signal that is offset."""
    value: float = 0.0
    """"wrong": SI offset added; "delayed" and "clock_step": seconds; "slow": divisor of the rate (4 if left out);
    "intermittent" and "garbage": share of messages lost or replaced by random bytes (half if left out)."""


class Flight(Frozen):
    """What the emulated aircraft flies."""

    source: Literal["simulation", "jsbsim", "recording"] = "simulation"
    """jsbsim: JSBSim's DHC-6, which needs the package jsbsim; boom, sensors and gusts are those of the profiles."""
    recording: str | None = None
    """A station log, for source = "recording"; its aircraft is flown."""
    lead_in: Seconds = 0.0
    """The recording's first values are held so long before it plays, for filters to settle."""
    speed: MetresPerSecond = 56.59
    """True airspeed of the trim."""
    altitude: Metres = 762.0
    """Above mean sea level."""
    gust_sigma: Annotated[MetresPerSecond, Field(ge=0)] = 0.0
    """Standard deviation of the vertical gust."""
    turbulence: Literal["light", "moderate", "severe"] | None = None
    """In place of gust_sigma: that of MIL-F-8785C at the altitude."""
    gust_start: Seconds = 0.0
    """Calm until then."""
    field: Literal["line", "plane"] = "line"
    """What gusts vary over. line: the way flown, wings and fin meet what the CG does. plane: also across it, isotropic:
    wing, tail, fin and boom meet their own, wings roll and yaw in it; the profile needs [unsteady] and [fin]."""
    spectrum: Literal["dryden", "von_karman"] = "dryden"
    """Of the gusts in a plane; a line is Dryden's."""
    gust_length: Annotated[Metres, Field(ge=20, le=3000)] | None = None
    """Scale length of all three components, isotropic; MIL-F-8785C's at the altitude if left out."""
    gusts: tuple[DiscreteGust, ...] = ()
    """Discrete gusts, laid over the turbulence."""
    wind_north: MetresPerSecond = 0.0
    """Steady wind, towards the north."""
    wind_east: MetresPerSecond = 0.0
    """Steady wind, towards the east."""
    wind_walk: Annotated[MetresPerSecond, Field(ge=0)] = 0.0
    """By how much either component of the wind changes in a minute, standard deviation of a random walk."""
    heading: Radians = 0.0
    """Clockwise from north."""
    legs: tuple[Leg, ...] = ()
    """To which speeds and headings it flies, and when; it needs lateral derivatives."""
    seed: int = Field(default=1, ge=0)
    """Of gusts and sensor noise."""
    device_clock_offset: Seconds = 3600.0
    """Device clocks start this far from the station's, each a multiple of it."""
    device_clock_drift_ppm: float = 30.0
    """How fast the devices' clocks gain, parts per million, each a multiple of it."""
    truth: dict[str, Change] = Field(default_factory=dict)
    """What the flown aircraft has otherwise than its profile, and when."""

    @property
    def is_plane(self) -> bool:
        """Whether gusts vary across the way flown."""
        return self.field == "plane"

    @model_validator(mode="before")
    @classmethod
    def _truth(cls, raw: Any) -> Any:
        if isinstance(raw, dict) and isinstance(raw.get("truth"), dict):
            raw = {**raw, "truth": flattened(raw["truth"])}
        if isinstance(raw, dict):
            raw = {k: tuple(v) if k in ("legs", "gusts") and isinstance(v, list) else v for k, v in raw.items()}
        return raw

    @model_validator(mode="after")
    def _can_change(self) -> Self:
        if self.truth and self.source != "simulation":
            raise PydanticCustomError("truth", "truth: only the simulation flies an aircraft that changes")
        if self.is_plane and self.source != "simulation":
            raise PydanticCustomError("field", 'field: only the simulation flies in a plane; use "line"')
        if self.spectrum != "dryden" and not self.is_plane:
            raise PydanticCustomError("spectrum", 'spectrum: a line has Dryden\'s; write field = "plane"')
        if not self.is_plane and any(g.half != "both" for g in self.gusts):
            raise PydanticCustomError("half", 'gusts: half a span is met in a plane only; write field = "plane"')
        if (self.legs or self.wind_walk) and self.source != "simulation":
            raise PydanticCustomError("legs", "legs, wind_walk: only the simulation flies them")
        return self


class TestPoint(Frozen):
    """A test point: in flight the operator starts and ends it, in the order of the card; `simulate` marks it by its
    times."""

    __test__ = False

    name: str
    """What reports call it."""
    condition: str = ""
    """Ice, flaps, air, free text; a point whose condition says "baseline" is one that others are held against."""
    start: Seconds | None = None
    """Seconds of a simulated flight."""
    end: Seconds | None = None
    """The same."""

    @property
    def note(self) -> str:
        """As it is recorded."""
        return f"{self.name}; {self.condition}" if self.condition else self.name

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if ";" in self.name or not self.name.strip():
            raise PydanticCustomError("point", "name: write one, without a semicolon")
        if (self.start is None) != (self.end is None):
            raise PydanticCustomError("point", "start and end: give both or neither")
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise PydanticCustomError("point", "end: it must come after start")
        return self


SIMULATION_HZ: Final = 200
"""Steps a second of a simulated flight; a pilot's delay is a whole number of them."""


class Pilot(Frozen):
    """Feedback from what is measured to the surfaces, all the flight long: gusts are answered too. Without a gain,
    hands off. Its sensors have the noise of a good installation."""

    pitch_rate: Annotated[Seconds, Field(ge=0, le=5)] = 0.0
    """Pitch damper: elevator, trailing edge down, by pitch rate."""
    attitude: float = Field(default=0.0, ge=0, le=5)
    """Attitude hold: elevator by pitch attitude above the trim's."""
    altitude: Annotated[RadiansPerMetre, Field(ge=0, le=0.05)] = 0.0
    """Altitude hold: elevator by height above the trim's."""
    speed: Annotated[RadiansPerSpeed, Field(ge=0, le=0.1)] = 0.0
    """Speed hold by pitch: elevator, trailing edge up, by true airspeed above the trim's, or the leg's. Attitude, which
    it needs, makes of it speed / attitude of pitch for each m/s."""
    roll_rate: Annotated[Seconds, Field(ge=0, le=5)] = 0.0
    """Roll damper: aileron, to the left, by roll rate."""
    bank: float = Field(default=0.0, ge=0, le=5)
    """Bank hold: aileron by bank beyond level, or beyond that which heading asks for, in place of slow ailerons."""
    heading: float = Field(default=0.0, ge=0, le=5)
    """Heading hold: bank, 20 deg at most, by what the heading, the flight's or the leg's, is ahead; it needs bank."""
    yaw_rate: Annotated[Seconds, Field(ge=0, le=5)] = 0.0
    """Yaw damper: rudder by yaw rate beyond that of a level turn with the bank that there is."""
    delay: Annotated[Seconds, Field(ge=0, le=0.3)] = 0.04
    """From what is measured to what the actuator is asked for, a multiple of 5 ms: 0.2 s to 0.3 s of a human, who sees,
    decides and moves (McRuer and Krendel 1974)."""
    neuromuscular: Annotated[Seconds, Field(ge=0, le=0.5)] = 0.0
    """Time constant of a human's arm on the control: about 0.1 s."""
    remnant: Annotated[Radians, Field(ge=0, le=0.1)] = 0.0
    """Standard deviation of what a human does beside that, on each surface that it moves: noise of the first order,
    below 3 rad/s."""

    @property
    def flies(self) -> bool:
        """Whether it moves any surface."""
        return bool(self.moved)

    @property
    def moved(self) -> frozenset[str]:
        """The surfaces that it moves."""
        gains = {
            "elevator": self.pitch_rate or self.attitude or self.altitude or self.speed,
            "aileron": self.roll_rate or self.bank,
            "rudder": self.yaw_rate,
        }
        return frozenset(surface for surface, gain in gains.items() if gain)

    @property
    def words(self) -> str:
        """What it does, for a description."""
        gains = (
            (self.pitch_rate, f"pitch damper {self.pitch_rate:g} s"),
            (self.attitude, f"attitude hold {self.attitude:g}"),
            (self.altitude, f"altitude hold {self.altitude:g} rad/m"),
            (self.speed, f"speed hold {self.speed:g} rad/(m/s)"),
            (self.roll_rate, f"roll damper {self.roll_rate:g} s"),
            (self.bank, f"bank hold {self.bank:g}"),
            (self.heading, f"heading hold {self.heading:g}"),
            (self.yaw_rate, f"yaw damper {self.yaw_rate:g} s"),
        )
        named = ", ".join(words for gain, words in gains if gain)
        human = "a human's " if self.neuromuscular or self.remnant else ""
        return f"{human}{named}, {1000 * self.delay:g} ms late" if named else "hands off"

    @model_validator(mode="after")
    def _can_be_flown(self, info: ValidationInfo) -> Self:
        if info.context == SI_NUMBERS:  # as a recording was flown, it is read
            return self
        steps = self.delay * SIMULATION_HZ
        if not math.isclose(steps, round(steps), abs_tol=1e-6):
            raise PydanticCustomError(
                "pilot",
                "delay: {ms} ms is no multiple of 5 ms, the simulation's step; write {near} ms",
                {"ms": f"{1e3 * self.delay:g}", "near": f"{round(steps) * 1000 // SIMULATION_HZ}"},
            )
        of_a_human = [name for name in ("neuromuscular", "remnant") if getattr(self, name)]
        if of_a_human and not self.flies:
            raise PydanticCustomError(
                "pilot",
                "{names}: of a pilot who moves no surface; write a gain beside it, for example attitude = 0.5",
                {"names": ", ".join(of_a_human)},
            )
        return self

    @model_validator(mode="after")
    def _bank_for_heading(self) -> Self:
        if self.heading and not self.bank:
            raise PydanticCustomError(
                "pilot", "heading: it is held by bank, which bank holds; write bank = 0.5 beside it"
            )
        return self

    @model_validator(mode="after")
    def _one_elevator(self) -> Self:
        if self.altitude and self.speed:
            raise PydanticCustomError("pilot", "altitude, speed: one elevator holds one of the two; take the other out")
        if self.speed and not self.attitude:
            raise PydanticCustomError(
                "pilot", "speed: it is held by pitch, which attitude holds; write attitude = 0.5 beside it"
            )
        return self


class Card(Frozen):
    """A test card: aircraft, rig, what to fly, what to record and when the answers are good enough."""

    name: str
    """What `station run` calls it."""
    description: str = ""
    """One sentence."""
    aircraft: str
    """Name or path of the aircraft profile."""
    emulated_aircraft: str | None = None
    """Name or path of the emulated aircraft's profile, where what is known of it, `aircraft`, is another."""
    rig: str
    """Name or path of the rig."""
    emulate: bool = False
    """Serve emulated devices wherever the rig says "emulated"."""
    lag: Annotated[Seconds, Field(ge=0.02, le=1.0)] = 0.06
    """How far behind now the aligned frame stands."""
    needs: tuple[str, ...] = ("alpha_vane", "airspeed", "q", "ax", "az", "theta", "v_down", "elevator")
    """Signals without which the check says no-go."""
    low: Annotated[Hertz, Positive] = 0.1
    """Lowest frequency of the estimates."""
    high: Annotated[Hertz, Positive] = 2.0
    """Highest frequency of the estimates: 1.3 times the short period or more."""
    step: Annotated[Hertz, Positive] = 0.04
    """Spacing of the transform's lines."""
    warm_up: Seconds = 20.0
    """Filters run this long before the transform opens."""
    rotate: Annotated[Bytes, Positive] = 512 * 1024.0**2
    """A recording goes on in a new file at this size."""
    forgetting: Annotated[Seconds, Field(ge=20)] | None = None
    """Time constant with which live estimates forget; without one they do not, but with a measured baseline they do in
    two minutes."""
    accuracy: float = Field(default=0.1, gt=0)
    """Enough: 2 sd below this share of the value."""
    lateral: bool | None = None
    """Whether CY, Cl and Cn are estimated too; if left out, where a manoeuvre moves aileron or rudder."""
    flight: Flight = Flight()
    """What the emulated aircraft flies."""
    manoeuvres: tuple[Manoeuvre, ...] = ()
    """What the pilot does, unasked."""
    points: tuple[TestPoint, ...] = ()
    """The test points, in the order flown."""
    steps: tuple[Step, ...] = ()
    """What the crew is guided through."""
    limits: Limits = Limits()
    """What must not be exceeded."""
    pilot: Pilot = Pilot()
    """What moves the surfaces beside the manoeuvres."""
    faults: tuple[Fault, ...] = ()
    """What emulated devices do wrong."""

    @property
    def flown(self) -> str:
        """Who moves surfaces beside the manoeuvres, to be added to a sentence; nothing where nobody does."""
        return f", flown with {self.pilot.words}" if self.pilot.flies else ""

    @property
    def asks_lateral(self) -> bool:
        """Whether the lateral derivatives are to be estimated."""
        return any(m.surface != "elevator" for m in self.inputs) if self.lateral is None else self.lateral

    @property
    def inputs(self) -> tuple[Manoeuvre, ...]:
        """All that may be flown: unasked, and step by step."""
        return (*self.manoeuvres, *(m for step in self.steps for m in step.inputs))

    @property
    def goes_places(self) -> bool:
        """Whether an emulated aircraft turns, or changes its speed, on the way."""
        wanted = [s.condition for s in self.steps]
        speeds = {c.speed for c in wanted if c.speed is not None}
        return bool(self.flight.legs) or len(speeds) > 1 or any(c.heading is not None or c.bank for c in wanted)

    @model_validator(mode="before")
    @classmethod
    def _tuples(cls, raw: Any) -> Any:
        if isinstance(raw, dict):
            keys = ("needs", "manoeuvres", "points", "steps", "faults")
            raw = {k: tuple(v) if k in keys and isinstance(v, list) else v for k, v in raw.items()}
        return raw

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if self.high <= self.low:
            raise PydanticCustomError("band", "high must be above low")
        if self.pilot.flies and self.flight.source == "recording":
            raise PydanticCustomError("pilot", "a recording is flown as it is: no [pilot] moves its elevator")
        if self.pilot.moved - {"elevator"} and self.flight.source == "jsbsim":
            raise PydanticCustomError("pilot", "JSBSim's aircraft has a pilot of its own for wings and heading")
        return self

    @model_validator(mode="after")
    def _steps_sound(self, info: ValidationInfo) -> Self:
        if info.context == SI_NUMBERS:  # as a recording was flown, it is read
            return self
        names = [s.name for s in self.steps]
        twice = next((n for i, n in enumerate(names) if n in names[:i]), None)
        if twice is not None:
            raise PydanticCustomError("steps", "steps: two are named {name}: call one otherwise", {"name": repr(twice)})
        for step in self.steps:
            beyond = step.beyond(self.limits)
            if beyond:
                words = {"name": repr(step.name), "beyond": beyond}
                raise PydanticCustomError("steps", "step {name}: {beyond}: change one of the two", words)
        return self

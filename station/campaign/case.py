"""From a case of a campaign to what the compiled pass takes, and its flights."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.campaign import physical_pass as physical
from station.campaign.flown_scenario import flight_of, flown_aircraft, known_aircraft, manoeuvres_of, sensors_flown
from station.campaign.one_pass import Air, Estimation, Results, Sensors, compile_fits, estimate, fly_and_measure
from station.campaign.spec import BENCHMARKS, METHODS, Campaign, Case, Plan
from station.campaign.whole_records import SPECTRA_SEED, WHOLE, WholeRecords
from station.conventions import SIGNAL_INDEX, TICK_HZ
from station.estimation import tick
from station.estimation.derivatives import SEARS, SEARS_K, lengths
from station.estimation.equation_error import Sides
from station.estimation.method_table import MEASURED
from station.estimation.method_table import METHODS as METHOD_TABLE
from station.estimation.physical_method import SEGMENT
from station.model import regressor_error, unsteady_lift
from station.model.physical_constants import constants, why_not
from station.numerics import spectra
from station.numerics.default_noise import DEFAULT_NOISE
from station.numerics.named_state import blank
from station.profile import NO_BOOM, Aircraft, Card, Flight, Pilot
from station.simulation import airframe as ac
from station.simulation.boom import second_order, vane_constants
from station.simulation.distortion import REACH, distortion_filter
from station.simulation.flown_aircraft import reach, site
from station.simulation.gust_plane import PlaneField, across
from station.simulation.gusts import STEP, Field, dryden, field_constants, field_start, ramp
from station.simulation.manoeuvres import elevator_input
from station.simulation.motion import DT, EVERY
from station.simulation.pilot import deviation, hands

Array = NDArray[np.float64]

TOGETHER: Final = 8
"""Flights of one call of the compiled halves: little memory, and no time lost between calls."""
_FASTER: Final = 2.5
"""The field is made for flights that go this many standard deviations of the gust faster than trimmed, and 2 %; those
that go farther are flown again."""
_TICK_S: Final = 1.0 / TICK_HZ
_ROUNDING: Final = 1e-9
"""Of a time in ticks."""


@dataclass(frozen=True, slots=True)
class Setup:
    """A case, ready to be flown."""

    air: Air
    sensors: Sensors
    estimation: Estimation
    physical: physical.Constants | None
    points: int
    """Of the gust field."""
    whole: WholeRecords | None = None
    """The methods that the compiled pass has not, and"""
    spectra: Setup | None = None
    """the longer flight that IV takes its spectra from."""


def prepare(plan: Plan, case: Case) -> Setup:
    """Everything that the flights of a case share. Raises ProfileError for an aircraft that cannot fly it."""
    campaign, scenario = plan.campaign, case.scenario
    flown = flown_aircraft(scenario, plan.path)
    flight = flight_of(campaign, scenario)
    is_distorted = scenario.alpha.startswith("distorted") and campaign.distortion is not None
    steps = (plan.ticks + (REACH if is_distorted else 0)) * EVERY
    behind, ahead = reach(flown)
    first = field_start(behind)
    fastest = 1.02 * flight.speed + _FASTER * flight.gust_sigma
    points = math.ceil((fastest * steps * DT + ahead) / STEP) + 4 - first
    constants = ac.constants(flown, flight.speed, flight.altitude)
    pilot = campaign.pilots.get(scenario.pilot, Pilot())
    half_steps = np.arange(2 * steps + 1, dtype=np.float64) * (0.5 * DT)
    added = elevator_input(manoeuvres_of(campaign, scenario), half_steps)
    boom = flown.boom or NO_BOOM
    air = Air(
        constants=constants,
        tables=ac.indicial_tables(flown, flight.is_plane),
        vanes=(vane_constants(boom, DT), vane_constants(None, DT)),
        site=site(flight, (0.0, 0.0, 0.0)),
        field=field_constants(dryden(flight.altitude, flight.gust_sigma), flight.speed, flight.gust_start),
        plane=plane_of(flight, flown, behind) if flight.is_plane else None,
        behind=behind,
        first=first,
        command=constants.trim_elevator + added + np.zeros_like(half_steps),
        hands=hands(pilot, constants.trim_alpha, constants.trim_height, flight.speed),
        tremor=(deviation(pilot), pilot.remnant if "elevator" in pilot.moved else 0.0),
    )
    channels = sensors_flown(scenario)
    d = campaign.distortion
    sensors = Sensors(
        ticks=plan.ticks,
        is_perfect=scenario.alpha == "perfect",
        distortion=distortion_filter(d.frequency, d.correction, d.lead, _TICK_S) if d and is_distorted else np.empty(0),
        distorts_gust=scenario.alpha == "distorted gust",
        vane=second_order(boom.vane_frequency, boom.vane_damping, _TICK_S),
        noisy=np.array([SIGNAL_INDEX[name] for name in channels], dtype=np.int64),
        noise=np.array([s.noise for s in channels.values()]),
        signal_to_noise=scenario.signal_to_noise or 0.0,
    )
    known = known_aircraft(scenario, flown, plan.path)
    own = _physical(campaign, known)
    e = _estimation(campaign, known, own is not None)
    return Setup(air, sensors, e, own, points, _whole_records(campaign, known), _for_spectra(plan, case))


def plane_of(flight: Flight, flown: Aircraft, behind: float) -> Callable[[int, int], Field]:
    """What makes a flight's field of a seed, for its first so many points. Raises ProfileError."""
    parts, begins = across(flown), ramp(flight.speed, flight.gust_start)
    model = dryden(flight.altitude, flight.gust_sigma)

    def made(seed: int, points: int) -> Field:
        field = PlaneField(parts, model, flight.spectrum, begins, behind, np.random.SeedSequence(seed))
        field.cover(-behind, (points + field.now.first - 3) * STEP)
        return field.now

    return made


def _whole_records(campaign: Campaign, known: Aircraft) -> WholeRecords | None:
    methods = {name: METHODS.index(name) for name in campaign.methods if name in WHOLE}
    if not methods:
        return None
    frequencies = {key: getattr(campaign, key) for key in ("warm_up", "low", "high", "step")}
    card = Card(name=campaign.name, aircraft=known.name, rig="").model_copy(update=frequencies)
    return WholeRecords(methods, known, card, campaign.axes, math.ceil(campaign.warm_up * TICK_HZ - _ROUNDING))


def _for_spectra(plan: Plan, case: Case) -> Setup | None:
    """IV's longer flight: the same air throughout, the same input again and again."""
    campaign = plan.campaign
    if MEASURED not in campaign.methods:
        return None
    again = {
        name: tuple(m.model_copy(update={"repeat": campaign.record}) for m in manoeuvres)
        for name, manoeuvres in campaign.inputs.items()
    }
    flown = {"methods": ("II",), "record": campaign.spectra, "warm_up": 0.0, "inputs": again}
    longer = Plan(campaign.model_copy(update=flown), (), plan.text, plan.path)
    throughout = case.scenario.model_copy(update={"turbulence_start": 0.0})
    return prepare(longer, Case(case.number, case.levels, throughout))


def _estimation(campaign: Campaign, known: Aircraft, has_physical: bool) -> Estimation:
    methods = campaign.methods
    # The split angle of attack also turns the forces of the other methods to wind axes.
    has_split = campaign.axes == "wind" or any(m == "physical" or m.startswith("split") for m in methods)
    frequencies = spectra.grid(campaign.low, campaign.high, campaign.step)
    imu = (0.0, 0.0, 0.0)
    return Estimation(
        has_split=has_split,
        has_benchmarks=any(m in BENCHMARKS for m in methods),
        channels=7 if has_split or {"III", "V"} & set(methods) else 5,
        filters=tick.constants(known, imu, _TICK_S, campaign.high, has_physical),
        sides=Sides(known, imu, _TICK_S, campaign.axes == "body").constant,
        transform=spectra.design(frequencies, _TICK_S),
        frequencies=frequencies,
        derivative=spectra.central_difference_factor(frequencies, _TICK_S),
        lengths=lengths(known),
        unsteady=unsteady_lift.known(known, campaign.axes == "body"),
        sears_k=SEARS_K,
        sears=SEARS,
        paths=regressor_error.lengths(known),
        noisy=regressor_error.deviations(known, DEFAULT_NOISE),
        vane_noise=DEFAULT_NOISE["alpha_vane"],
        warm_up=campaign.warm_up,
        step=campaign.step,
        segment=1.0 / campaign.step if campaign.segments else math.inf,
    )


def _physical(campaign: Campaign, known: Aircraft) -> physical.Constants | None:
    if "physical" not in campaign.methods or why_not(known):
        return None
    body = known.boom.upwash_body if known.boom else 0.0
    frequencies = spectra.grid(campaign.low, campaign.high, campaign.step)
    return physical.Constants(
        profile=constants(known),
        noise=(DEFAULT_NOISE["alpha_vane"] / (1.0 + body)) ** 2,
        segment=round(SEGMENT / campaign.step / _TICK_S) if campaign.segments else math.inf,
        warm_up=campaign.warm_up,
        step=campaign.step,
        omega=2.0 * np.pi * frequencies,
        derivative=spectra.central_difference_factor(frequencies, _TICK_S),
        transform=spectra.design(frequencies, _TICK_S),
    )


def fly_case(setup: Setup, seeds: range, quiet: bool = False) -> Iterator[tuple[range, Results]]:
    """Fly the seeds, TOGETHER at a time. `quiet`: without turbulence and noise."""
    if quiet:
        calm = setup.air._replace(field=setup.air.field._replace(sigmas=(0.0, 0.0, 0.0)), plane=None, tremor=(0.0, 0.0))
        silent = setup.sensors._replace(noisy=np.empty(0, dtype=np.int64), noise=np.empty(0))
        setup = replace(setup, air=calm, sensors=silent)
    room = Room.of(setup, TOGETHER)
    for begin in range(seeds.start, seeds.stop, TOGETHER):
        chunk = range(begin, min(begin + TOGETHER, seeds.stop))
        here = _flown(setup, chunk, room)
        results = nothing(len(chunk))
        for run in range(len(chunk)):
            state, shown, true_alpha = blank(tick.State), here.shown[run], here.true_alpha[run]
            estimate(setup.estimation, setup.physical, state, shown, true_alpha, results, run)
            if setup.whole is not None:
                setup.whole.estimate(shown, _longer(setup, chunk[run], quiet), results, run)
        results.estimate[~results.solved] = math.nan
        results.error[~results.solved] = math.nan
        yield chunk, results


def _flown(setup: Setup, seeds: range, room: Room) -> Room:
    """The seeds flown in a room that is large enough for them, if none goes far."""
    here = room.first(len(seeds))
    here.fly(setup, seeds)
    wider = setup
    while not _stayed(wider, here.reached):
        # A flight went farther than the field: one that goes on begins with the same numbers.
        wider = replace(wider, points=2 * wider.points)
        here = Room.of(wider, len(seeds))
        here.fly(wider, seeds)
    return here


def _longer(setup: Setup, seed: int, quiet: bool) -> Array | None:
    """What the sensors show of the flight that IV's spectra of one with this seed are of."""
    if setup.spectra is None or quiet:
        return None
    seeds = range(seed + SPECTRA_SEED, seed + SPECTRA_SEED + 1)
    shown: Array = _flown(setup.spectra, seeds, Room.of(setup.spectra, 1)).shown[0]
    return shown


@dataclass(frozen=True, slots=True)
class Room:
    """Arrays for some flights, used again and again: see fly_and_measure."""

    state: Array
    wind: Array
    white: Array
    shown: Array
    true_alpha: Array
    reached: Array

    @classmethod
    def of(cls, setup: Setup, runs: int) -> Room:
        ticks = setup.sensors.ticks
        return cls(
            np.zeros((runs, 5)),
            np.zeros((runs, setup.points, 5)),
            np.zeros((runs, len(setup.sensors.noisy), ticks)),
            np.full((runs, ticks, len(SIGNAL_INDEX)), np.nan),
            np.empty((runs, ticks)),
            np.zeros(runs),
        )

    def first(self, runs: int) -> Room:
        """That part of it."""
        return Room(
            self.state[:runs],
            self.wind[:runs],
            self.white[:runs],
            self.shown[:runs],
            self.true_alpha[:runs],
            self.reached[:runs],
        )

    def fly(self, setup: Setup, seeds: range) -> None:
        """Random numbers are drawn as GustField and Channel draw them: a stream for the field, one for each noisy
        signal."""
        for i, seed in enumerate(seeds):
            if setup.air.field.sigmas[2] > 0 and setup.air.plane is None:
                rng = np.random.default_rng(np.random.SeedSequence(seed))
                rng.standard_normal(out=self.state[i])
                rng.standard_normal(out=self.wind[i])
            for j, signal in enumerate(setup.sensors.noisy.tolist()):
                np.random.default_rng([seed, 1 + signal]).standard_normal(out=self.white[i, j])
            self.reached[i] = fly_and_measure(
                setup.air,
                setup.sensors,
                seed,
                self.state[i],
                self.wind[i],
                self.white[i],
                self.shown[i],
                self.true_alpha[i],
            )


def nothing(runs: int) -> Results:
    """Results to be filled."""
    return Results(
        np.full((runs, len(METHODS), 2, 3), math.nan),
        np.full((runs, len(METHODS), 2, 3), math.nan),
        np.zeros((runs, len(METHODS), 2, 3)),
        np.full((runs, len(METHODS), 2), math.nan),
        np.zeros((runs, len(METHODS), 2), dtype=np.bool_),
    )


PARTS: Final = 3
"""Of the compiled code, which take the same time when two processes share them in this order."""


def compile_part(plan: Plan, part: int) -> None:
    """Compile a part of what flies and estimates, or load it where that has been done."""
    # A compiler makes millions of small objects, none of them garbage: looking for it costs a sixth of the time.
    often = gc.get_threshold()
    gc.set_threshold(100_000, *often[1:])
    setup = prepare(plan, max(plan.cases, key=lambda c: c.scenario.turbulence))
    e, none = setup.estimation, Room.of(setup, 1)
    if part == 0:
        estimate(e, setup.physical, blank(tick.State), none.shown[0, :0], none.true_alpha[0, :0], nothing(1), 0)
    elif part == 1:
        compile_fits(e)
    else:
        none.fly(setup, range(1))
    gc.set_threshold(*often)


def _stayed(setup: Setup, reached: Array) -> bool:
    """Whether no flight left its field."""
    air = setup.air
    end = (setup.points + air.first) * STEP - max(air.vanes[0].x, air.constants.chord) - 1.0
    return air.field.sigmas[2] == 0 or bool(reached.max() < end)


def reference(plan: Plan, setup: Setup) -> Array:
    """What each method's errors are from, (METHODS, 2, 3).

    The aircraft's own derivatives, or what perfect sensors make of the manoeuvre in calm air; the former always for
    `physical`, which estimates those whatever the manoeuvre.
    """
    target = np.broadcast_to(_tabulated(plan, setup), (len(METHODS), 2, 3)).copy()
    if plan.campaign.reference == "calm":
        perfect = replace(setup, estimation=setup.estimation._replace(has_benchmarks=True), whole=None)
        _, results = next(fly_case(perfect, range(1), quiet=True))
        by_manoeuvre = [n not in METHOD_TABLE or METHOD_TABLE[n].definition == "quasi_steady" for n in METHODS]
        target[by_manoeuvre] = results.estimate[0, METHODS.index("perfect")]
    return target


def _tabulated(plan: Plan, setup: Setup) -> Array:
    """The six derivatives of the aircraft that flies, (2, 3)."""
    c = setup.air.constants
    lift = np.array([c.cl_alpha, c.cl_q, c.cl_de])
    moment = np.array([c.cm_alpha, c.cm_q, c.cm_de])
    if plan.campaign.axes == "wind":
        return np.stack([lift, moment])
    # CZ = -CL cos a - CD sin a, its slope about trim; drag's follows from the polar.
    sin, cos = math.sin(c.trim_alpha), math.cos(c.trim_alpha)
    drag = c.cd_0 + c.cd_v * c.trim_speed / c.reference_speed + c.cd_alpha * c.trim_alpha + c.cd_induced * c.cl_trim**2
    force = -lift * (cos + 2 * c.cd_induced * c.cl_trim * sin)
    force[0] += c.cl_trim * sin - drag * cos - c.cd_alpha * sin
    return np.stack([force, moment])

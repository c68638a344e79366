"""Derivatives stay right under feedback: the campaign `feedback`, its flights hands off and under three autopilots.

Elevator that answers gusts correlates with them; where the vane measures the gust that is no harm. `physical` is held
against the tabulated derivatives, `split+gust` and II against what perfect sensors give in calm air under the same
autopilot. STATION_SEEDS sets the flights of each slow case (default 100); print the table with -s.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from station.campaign import case as flying
from station.campaign.case import fly_case, prepare, reference
from station.campaign.flown_scenario import known_aircraft
from station.campaign.spec import METHODS, Case, Plan, load_plan
from station.conventions import from_si
from station.profile import load_aircraft
from tests.estimation.test_physical_montecarlo import drawn

SEEDS = int(os.environ.get("STATION_SEEDS", "100"))
FIRST = 3100
SHOWN = ("physical", "split+gust", "II")
FOUR = [0, 3, 4, 5]
"""CL_alpha, Cm_alpha, Cm_q, Cm_de."""
LEAST = 0.90
"""Coverage wanted of intervals of 95 %."""


@dataclass(frozen=True)
class Counted:
    """One method's six derivatives in one case."""

    bias: NDArray[np.float64]
    """Mean, per cent."""
    scatter: NDArray[np.float64]
    """Standard deviation, per cent."""
    coverage: NDArray[np.float64]
    """Share of the 95 % intervals that hold the truth."""

    @property
    def cells(self) -> str:
        both = zip(self.bias, self.scatter, self.coverage, strict=True)
        return " | ".join(f"{b:+.1f} ± {s:.1f}, {100 * c:.0f}" for b, s, c in both)


def counted(plan: Plan, case: Case, count: int) -> dict[str, Counted]:
    setup = prepare(plan, case)
    truth = reference(plan, setup)
    flown = [results for _, results in fly_case(setup, range(FIRST, FIRST + count))]
    value = np.concatenate([r.estimate for r in flown])
    sd = np.concatenate([np.hypot(r.error, r.model) for r in flown])
    out = {}
    for method in SHOWN:
        at = METHODS.index(method)
        off = (value[:, at] - truth[at]).reshape(count, 6)
        size = np.abs(truth[at]).reshape(6)
        inside = np.abs(off) < 1.96 * sd[:, at].reshape(count, 6)
        out[method] = Counted(*(100 * x(off / size, axis=0) for x in (np.mean, np.std)), inside.mean(axis=0))
    return out


def counted_on_drawn(plan: Plan, case: Case, count: int) -> Counted:
    """`physical` on aircraft all of whose constants are drawn anew every two flights, known as the profile has them."""
    known = load_aircraft(case.scenario.aircraft)
    truth = np.array([known.value(n) for n in plan.campaign.parameters])
    value, sd = [], []
    for i, first in enumerate(range(FIRST, FIRST + count, 2)):
        real = drawn(known, np.random.default_rng([FIRST, i]))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(flying, "flown_aircraft", lambda *_, real=real: real)
            patch.setattr(flying, "known_aircraft", lambda scenario, _, beside: known_aircraft(scenario, known, beside))
            setup = prepare(plan, case)
        for _, r in fly_case(setup, range(first, first + 2)):
            at = METHODS.index("physical")
            value.append(r.estimate[:, at].reshape(-1, 6))
            sd.append(np.hypot(r.error, r.model)[:, at].reshape(-1, 6))
    off, sds = np.concatenate(value) - truth, np.concatenate(sd)
    shares = (100 * x(off / np.abs(truth), axis=0) for x in (np.mean, np.std))
    return Counted(*shares, (np.abs(off) < 1.96 * sds).mean(axis=0))


def case_of(plan: Plan, turbulence: float, pilot: str, form: str) -> Case:
    return next(
        c
        for c in plan.cases
        if round(from_si(c.scenario.turbulence, "ft/s")) == turbulence
        and (c.scenario.pilot, c.scenario.input) == (pilot, form)
    )


def covers(found: Counted, count: int) -> bool:
    """Whether LEAST of each of six, and of all together, is within three standard deviations of a count."""
    sd = np.sqrt(LEAST * (1 - LEAST) / count)
    return bool(found.coverage.min() > LEAST - 3 * sd and found.coverage.mean() > LEAST)


@pytest.mark.slow
def test_a_few_flights_under_altitude_hold() -> None:
    plan = load_plan("feedback")
    found = counted(plan, case_of(plan, 5, "altitude", "multisine"), 6)["physical"]
    assert np.abs(found.bias[FOUR]).max() < 3.0
    assert covers(found, 6)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["doublet", "multisine"])
@pytest.mark.parametrize("turbulence", [0, 5, 10])
def test_derivatives_stay_right_under_feedback(turbulence: int, form: str) -> None:
    """Each autopilot against hands off, in the same gusts and noise: of `physical`, no bias of the four that is more
    than 1 % beyond that of hands off, and intervals that hold as often as they say."""
    plan = load_plan("feedback")
    found = {p: counted(plan, case_of(plan, turbulence, p, form), SEEDS) for p in plan.campaign.pilots}
    print(f"\n| {turbulence} ft/s, {form} | method | " + " | ".join(plan.campaign.parameters) + " |")
    for method in SHOWN:
        for pilot, of in found.items():
            print(f"| {pilot} | {method} | {of[method].cells} |")
    free = np.abs(found["hands_off"]["physical"].bias[FOUR])
    for pilot, of in found.items():
        physical = of["physical"]
        assert np.all(np.abs(physical.bias[FOUR]) < free + 1.0), pilot
        assert covers(physical, SEEDS), pilot
        assert covers(of["split+gust"], SEEDS), pilot


@pytest.mark.slow
@pytest.mark.parametrize("form", ["doublet", "multisine"])
@pytest.mark.parametrize("turbulence", [0, 5, 10])
def test_intervals_hold_under_feedback_where_every_constant_is_drawn(turbulence: int, form: str) -> None:
    plan = load_plan("feedback")
    found = {p: counted_on_drawn(plan, case_of(plan, turbulence, p, form), SEEDS) for p in plan.campaign.pilots}
    print(f"\n| {turbulence} ft/s, {form}, drawn | method | " + " | ".join(plan.campaign.parameters) + " |")
    for pilot, of in found.items():
        print(f"| {pilot} | physical | {of.cells} |")
    for pilot, of in found.items():
        assert covers(of, SEEDS // 2), pilot  # two flights share their constants

"""The compiled pass gives what the simulation and the estimator give one after the other."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from station.campaign.case import fly_case, prepare, reference
from station.campaign.flown_scenario import flight_of, flown_aircraft, known_aircraft, manoeuvres_of, sensors_flown
from station.campaign.spec import BENCHMARKS, METHODS, Campaign, Case, Plan
from station.conventions import SIGNAL_INDEX, SIGNALS, TICK_NS
from station.estimation.method_fits import KINDS
from station.estimation.methods import Estimator
from station.profile import Card, Pilot
from station.rows import Frame, MethodEstimate
from station.simulation import fly
from station.simulation.boom import second_order, vane_constants
from station.simulation.distortion import REACH, distort, distortion_filter

COMPILED = [*KINDS, *BENCHMARKS]
MULTISINE = {"kind": "multisine", "start": "1 s", "duration": "10 s", "amplitude": "2 deg"}


def plan(flight: dict[str, Any], **keys: Any) -> Plan:
    campaign = Campaign.model_validate(
        {
            "name": "t",
            "runs": 3,
            "methods": COMPILED,
            "inputs": {"m": [MULTISINE]},
            "flight": flight,
        }
        | keys
    )
    return Plan(campaign, (Case(0, {}, campaign.flight),), "")


def plain(p: Plan, seed: int) -> tuple[MethodEstimate, ...]:
    """Fly, then measure, then estimate tick by tick."""
    campaign, scenario = p.campaign, p.cases[0].scenario
    flown = flown_aircraft(scenario)
    card = Card.model_validate({"name": "t", "aircraft": "t", "rig": "t"}).model_copy(
        update={
            "flight": flight_of(campaign, scenario),
            "manoeuvres": manoeuvres_of(campaign, scenario),
            "pilot": campaign.pilots.get(scenario.pilot, Pilot()),
            **{key: getattr(campaign, key) for key in ("warm_up", "low", "high", "step")},
        }
    )
    if scenario.field == "plane":  # a campaign keeps the wings level, as an aircraft does that cannot roll
        level = {n: d for n, d in flown.derivatives.items() if n[:2] in ("CL", "CD", "Cm")}
        flown = flown.model_copy(update={"derivatives": level})
    is_distorted = scenario.alpha.startswith("distorted")
    seconds = (p.ticks + (REACH if is_distorted else 0)) / 50
    shown, truth = fly(flown, {} if scenario.signal_to_noise else sensors_flown(scenario), card, seconds, seed)
    shown = {name: x[: p.ticks].copy() for name, x in shown.items()}
    if scenario.alpha == "perfect":
        shown["alpha_vane"] = truth["alpha"].copy()
    if is_distorted and (d := campaign.distortion) and flown.boom:
        part = truth["alpha_gust" if scenario.alpha == "distorted gust" else "alpha"]
        filter_ = distortion_filter(d.frequency, d.correction, d.lead, 0.02)
        distort(filter_, vane_constants(flown.boom, 0.02).dynamics, part, shown["alpha_vane"])
    if scenario.signal_to_noise:
        for name in ("alpha_vane", "q", "elevator"):
            white = np.random.default_rng([seed, 1 + SIGNAL_INDEX[name]]).standard_normal(p.ticks)
            shown[name] += shown[name].std() / scenario.signal_to_noise * white
    methods = (*KINDS, "physical") if "physical" in campaign.methods else KINDS
    estimator = Estimator(known_aircraft(scenario, flown), card, axes=campaign.axes, force=True, methods=methods)
    nothing, fresh = (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)
    unknown = np.full(len(shown["q"]), np.nan)
    for k, row in enumerate(np.stack([shown.get(name, unknown) for name in SIGNALS], axis=1).tolist()):
        _, found = estimator.step(Frame(k * TICK_NS, k, tuple(row), nothing, fresh))
    return found


DISTORTION = {"frequency": ["0 Hz", "2 Hz"], "correction": [0.75, 0.9], "lead": ["0.1 s", "0.1 s"]}


@pytest.mark.parametrize(
    ("flight", "keys"),
    [
        (
            {"turbulence": "light"},
            {"warm_up": "3 s", "record": "35 s", "methods": [*COMPILED, "physical"]},
        ),
        ({"turbulence": "moderate", "turbulence_start": "8 s", "CL_gust": 1.0, "Cm_gust": -0.5}, {"record": "15 s"}),
        ({"turbulence": "severe", "alpha": "perfect", "lift": "steady", "signal_to_noise": 50.0}, {"axes": "body"}),
        ({"turbulence": "light", "field": "plane"}, {"record": "15 s"}),
        (
            {"turbulence": "light", "pilot": "hold"},
            {"record": "15 s", "pilots": {"hold": {"pitch_rate": "0.5 s", "attitude": 0.5, "altitude": "0.1 deg/m"}}},
        ),
        (
            {"turbulence": "light", "alpha": "distorted gust", "signal_to_noise": 50.0, "vane_frequency": "5 Hz"},
            {"axes": "body", "distortion": DISTORTION},
        ),
    ],
)
def test_one_pass_agrees_with_the_plain_path(flight: dict[str, Any], keys: dict[str, Any]) -> None:
    p = plan(flight, **keys)
    _, results = next(fly_case(prepare(p, p.cases[0]), range(41, 44)))
    for i, seed in enumerate((41, 42)):
        for method in plain(p, seed):
            slot = METHODS.index(method.method)
            value = np.array([x.value for x in method.parameters]).reshape(2, 3)
            sd = np.array([x.sd for x in method.parameters]).reshape(2, 3)
            np.testing.assert_allclose(results.estimate[i, slot], value, rtol=1e-10, err_msg=method.method)
            total = np.hypot(results.error[i, slot], results.model[i, slot])
            np.testing.assert_allclose(total, sd, rtol=1e-10, err_msg=method.method)


def test_leaving_methods_out_changes_no_estimate() -> None:
    flight = {"turbulence": "light", "alpha": "vane", "signal_to_noise": 50.0, "lift": "steady"}
    every, few = plan(flight, axes="body"), plan(flight, axes="body", methods=["II"])
    both = [next(fly_case(prepare(p, p.cases[0]), range(3)))[1] for p in (every, few)]
    np.testing.assert_array_equal(both[0].estimate[:, 0], both[1].estimate[:, 0])
    np.testing.assert_array_equal(both[0].error[:, 0], both[1].error[:, 0])


def test_a_flight_is_the_same_alone_and_among_others() -> None:
    p = plan({"turbulence": "severe"}, record="6 s")
    setup = prepare(p, p.cases[0])
    together = np.concatenate([r.estimate for _, r in fly_case(setup, range(5, 25))])
    alone = np.concatenate([r.estimate for k in range(5, 25) for _, r in fly_case(setup, range(k, k + 1))])
    np.testing.assert_array_equal(together, alone)
    assert len(np.unique(together[:, 0, 0, 0])) == 20


def test_a_flight_beyond_its_field_is_flown_in_a_longer_one() -> None:
    p = plan({"turbulence": "severe"}, record="8 s")
    setup = prepare(p, p.cases[0])
    _, wide = next(fly_case(setup, range(4)))
    short = replace(setup, points=setup.points // 4)
    _, found = next(fly_case(short, range(4)))
    np.testing.assert_array_equal(found.estimate, wide.estimate)


def test_errors_are_from_the_aircraft_s_own_derivatives_or_from_calm_air() -> None:
    """A quasi-steady aircraft gives its table back; in body axes the same, but for sign and 1 % of drag."""
    for axes, reach in itertools.product(("wind", "body"), ("truth", "calm")):
        p = plan({"lift": "steady"}, axes=axes, reference=reach)
        setup = prepare(p, p.cases[0])
        wanted = np.array([[5.66, 19.97, 0.608], [-1.31, -34.2, -1.74]])
        if axes == "body":
            wanted[0] *= -1.0
        np.testing.assert_allclose(reference(p, setup)[0], wanted, rtol=0.012)


def test_the_distortion_has_the_gain_and_the_lead_of_its_tables() -> None:
    """A sine through the filter, less vane dynamics: gain 1/correction, early by the lead."""
    filter_ = distortion_filter([0.0, 2.0], [0.75, 0.9], [0.1, 0.05], 0.02)
    vane = second_order(400.0, 0.7, 0.02)
    for f, gain, lead in ((0.5, 1 / 0.7875, 0.0875), (1.0, 1 / 0.825, 0.075), (1.5, 1 / 0.8625, 0.0625)):
        t = np.arange(2000 + REACH) * 0.02
        part = np.sin(2 * np.pi * f * t)
        out = part[:2000].copy()
        distort(filter_, vane, part, out)
        wanted = gain * np.sin(2 * np.pi * f * (t[:2000] + lead))
        np.testing.assert_allclose(out[100:], wanted[100:], atol=0.03)

"""Campaigns with the methods that need a whole record, and IV."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from station.campaign.case import Room, _flown, fly_case, prepare
from station.campaign.engine import batches
from station.campaign.flown_scenario import flown_aircraft, known_aircraft
from station.campaign.spec import METHODS, Campaign, Case, Plan
from station.campaign.whole_records import WHOLE

DOUBLET = {"kind": "doublet", "start": "2 s", "amplitude": "2 deg", "width": "1 s"}
TABLE = np.array([[5.66, 19.97, 0.608], [-1.31, -34.2, -1.74]])
"""Of the profile twin_otter: CL and Cm by alpha, q c/2V and elevator, per rad."""


def plan(flight: dict[str, Any], **keys: Any) -> Plan:
    made = {"name": "t", "runs": 2, "inputs": {"d": [DOUBLET]}, "flight": flight, "warm_up": "3 s", "record": "20 s"}
    campaign = Campaign.model_validate(made | keys)
    return Plan(campaign, (Case(0, {}, campaign.flight),), "")


@pytest.mark.parametrize("method", ["I", "VI", "oe"])
def test_a_whole_record_s_method_finds_a_quasi_steady_aircraft_s_table(method: str) -> None:
    """No gust, no noise, no memory, a perfect vane: each finds the derivatives flown, to some drag."""
    p = plan({"lift": "steady", "alpha": "perfect"}, methods=[method])
    _, results = next(fly_case(prepare(p, p.cases[0]), range(1), quiet=True))
    slot = METHODS.index(method)
    assert results.solved[0, slot].all()
    np.testing.assert_allclose(results.estimate[0, slot], TABLE, rtol=0.03)


def test_iv_takes_its_spectra_of_a_longer_flight_in_the_same_air_throughout() -> None:
    p = plan(
        {"turbulence": "light", "turbulence_start": "15 s"}, methods=["IV"], spectra="90 s", step="0.04 Hz"
    )  # fmt: skip
    setup = prepare(p, p.cases[0])
    assert setup.spectra is not None
    assert setup.spectra.sensors.ticks == 90 * 50
    assert setup.spectra.air.field.start < setup.air.field.start
    steps = setup.spectra.air.command - setup.spectra.air.command[0]
    begins = np.flatnonzero((np.abs(steps[1:]) > 1e-6) & (np.abs(steps[:-1]) < 1e-6))
    np.testing.assert_allclose(np.diff(begins) / 400.0, 20.0, atol=0.01)
    _, results = next(fly_case(setup, range(5, 7)))
    slot = METHODS.index("IV")
    assert results.solved[:, slot].all()
    # The vane's delay and upwash are not those of the motion: what IV gives is of the right size, no better.
    np.testing.assert_allclose(results.estimate[:, slot, 1, 0], TABLE[1, 0], rtol=0.6)
    _, alone = next(fly_case(setup, range(6, 7)))
    np.testing.assert_array_equal(alone.estimate[0], results.estimate[1])


def test_a_batch_of_slow_methods_is_short() -> None:
    """What a kill loses, and what many workers share, stays seconds of work."""
    live, whole = plan({}, methods=["II"], runs=200), plan({}, methods=["II", "fe"], runs=200)
    assert len(batches(live)[0]) > 100
    assert len(batches(whole)[0]) == 2
    assert [b.stop for b in batches(whole)][-1] == 200


def test_methods_of_a_whole_record_are_those_of_identify() -> None:
    assert WHOLE == ("IV", "I", "VI", "oe", "fe", "sidpac")


def test_ice_is_flown_and_nobody_is_told() -> None:
    """The Twin Otter's reference icing condition (Bragg et al. 2002): CL_alpha -10 %, Cm_de -10 %, Cm_q -3.5 %."""
    scenario = Campaign.model_validate({"name": "t", "runs": 1, "methods": ["I"], "flight": {"icing": 1.0}}).flight
    flown = flown_aircraft(scenario)
    known = known_aircraft(scenario, flown)
    for name, share in (("CL_alpha", 0.90), ("Cm_de", 0.90), ("Cm_q", 0.965)):
        assert flown.value(name) == pytest.approx(share * known.value(name))
    assert known.value("CL_alpha") == 5.66
    assert known.drag is not None
    assert flown.drag is not None
    assert flown.drag.zero_lift == pytest.approx(1.5 * known.drag.zero_lift)
    p = plan({"lift": "steady", "alpha": "perfect", "icing": 1.0}, methods=["I"])
    _, results = next(fly_case(prepare(p, p.cases[0]), range(1), quiet=True))
    assert results.estimate[0, METHODS.index("I"), 0, 0] == pytest.approx(0.9 * 5.66, rel=0.03)


def test_a_room_is_used_again() -> None:
    p = plan({"turbulence": "light"}, methods=["I"])
    setup = prepare(p, p.cases[0])
    room = Room.of(setup, 2)
    first = _flown(setup, range(2), room).shown[1].copy()
    np.testing.assert_array_equal(_flown(setup, range(1, 2), room).shown[0], first)

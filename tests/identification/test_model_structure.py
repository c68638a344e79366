"""The structure that made the data is the one preferred, and nothing is preferred without gusts."""

import math

import msgspec
import numpy as np
import pytest

from station.identification.flown import fly as refly
from station.identification.model_structure import compare_structures, structures
from station.identification.preparation import flight_record
from station.identification.request import Request
from station.log import Table
from station.numerics.regression import NotIdentifiable
from station.profile import Card, Flight, load_aircraft
from station.simulation.sensors import STANDARD
from station.simulation.sortie import fly

DT = 0.02
N = 3000


def _series(seed: int) -> dict[str, np.ndarray]:
    """Band-limited motion and gust, independent of each other, the tail's gust 0.13 s later."""
    rng = np.random.default_rng(seed)
    made = {}
    for name, corner in (("alpha_i", 0.8), ("alpha_g", 1.5), ("q", 1.0), ("de", 1.2)):
        white = rng.standard_normal(N + 200)
        keep = np.exp(-DT * 2 * np.pi * corner)
        slow = np.zeros(N + 200)
        for k in range(1, N + 200):
            slow[k] = keep * slow[k - 1] + (1 - keep) * white[k]
        made[name] = 0.1 * slow
    late = np.interp(np.arange(200, N + 200) - 0.13 / DT, np.arange(N + 200), made["alpha_g"])
    made = {name: x[200:] for name, x in made.items()}
    made["alpha_g_tail"] = late
    return made


def _measured(x: dict[str, np.ndarray], values: dict[str, float], seed: int) -> np.ndarray:
    columns = {**x, "alpha": x["alpha_i"] + x["alpha_g"], "d": x["alpha_g"] - x["alpha_g_tail"]}
    noise = 0.002 * np.random.default_rng(100 + seed).standard_normal(N)
    return np.asarray(sum(v * columns[name] for name, v in values.items()) + noise)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("split", {"alpha": 5.5, "q": 15.0, "de": 0.6}),
        ("eq65", {"alpha_i": 5.5, "alpha_g": 4.6, "q": 15.0, "de": 0.6}),
        ("split+gust", {"alpha": -1.3, "d": -1.5, "q": -35.0, "de": -1.7}),
        ("S5", {"alpha_i": -1.3, "alpha_g": 0.4, "alpha_g_tail": -1.2, "q": -35.0, "de": -1.7}),
    ],
)
def test_the_structure_of_the_data_is_preferred(name: str, values: dict[str, float]) -> None:
    right = 0
    for seed in range(5):
        x = _series(seed)
        made = compare_structures(x, _measured(x, values, seed), DT)
        right += made.preferred == name
        best = made.structures[name]
        for parameter, value in values.items():
            assert abs(best.estimate[parameter] - value) < 5 * best.std_error[parameter]
        assert best.held_out < 1.3 * best.residual + 0.02
    assert right >= 4


def test_a_larger_structure_than_the_data_s_is_not_significant() -> None:
    """Under the simple structure the p-value is uniform: 5 % of runs below 0.05."""
    small = 0
    for seed in range(40):
        x = _series(seed)
        made = compare_structures(x, _measured(x, {"alpha": 5.5, "q": 15.0, "de": 0.6}, seed), DT)
        small += made.structures["eq65"].p_values["split"] < 0.05
    assert small <= 7


def test_records_without_gusts_too_short_or_collinear_are_refused() -> None:
    x = _series(1)
    z = _measured(x, {"alpha": 5.0}, 1)
    with pytest.raises(NotIdentifiable, match="no gust energy"):
        compare_structures({**x, "alpha_g": 1e-3 * x["alpha_g"], "alpha_g_tail": 0 * z}, z, DT)
    with pytest.raises(NotIdentifiable, match="needs 20 s"):
        compare_structures({name: c[:500] for name, c in x.items()}, z[:500], DT)
    with pytest.raises(NotIdentifiable, match="collinear"):
        compare_structures({**x, "q": 2.0 * x["alpha_i"]}, z, DT)


def test_angles_that_settle_within_the_record_are_compared_from_there_on() -> None:
    """The tail meets at first what the vane met before: unknown where the split had not settled."""
    aircraft = load_aircraft("twin_otter")
    flight = Flight.model_validate({"speed": "110 kt", "gust_sigma": "5 ft/s"})
    shown, truth = fly(aircraft, STANDARD, Card(name="t", aircraft="t", rig="", flight=flight), 40.0, 3)
    flown = Table(truth["time"], {**shown, "thrust": truth["thrust"]}, aircraft, 0)
    record, _ = flight_record(flown, aircraft)
    seen = refly(flown, record, ("split",), Request())
    unsettled = {"alpha_inertial": math.nan, "alpha_gust": math.nan}
    alphas = [msgspec.structs.replace(a, **unsettled) if k < 100 else a for k, a in enumerate(seen.alphas)]
    found = structures(record, seen.t_s, alphas)
    assert not isinstance(found, str)
    assert all(math.isfinite(s.residual) for made in found.values() for s in made.structures.values())

"""NASA's records through import and identify: SIDPAC's numbers, to every line of the 1 Hz history."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from records import record

from station.conventions import from_si
from station.convert import import_file
from station.estimation.flight_record import FlightRecord
from station.identification.analysis import identify
from station.identification.identification_json import as_json
from station.identification.request import Request
from station.log import Table, table
from station.profile import Aircraft, load_aircraft

RECORDS = ("totter_demo_data", "totter_pred_data", "totter_f1_017_data")


def identified(of: Table, aircraft: Aircraft, methods: Sequence[str] = ("all",), *span: float, **options: Any) -> Any:
    """What identify finds, as its JSON has it."""
    return as_json(identify(of, aircraft, Request(methods, *span, **options)))


@cache
def reference() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(record("reference.json").read_text())
    return found


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Table]:
    folder = tmp_path_factory.mktemp("nasa")
    made = {}
    for name in RECORDS:
        import_file(record(f"twin_otter/{name}.mat"), folder / f"{name}.mcap", load_aircraft("twin_otter"))
        made[name] = table(folder / f"{name}.mcap")
    return made


def compare(history: dict[str, Any], expected: dict[str, Any]) -> None:
    np.testing.assert_allclose(history["t_s"], expected["th"], rtol=1e-8)
    np.testing.assert_allclose(history["estimate"], expected["ph"], rtol=1e-7)
    np.testing.assert_allclose(history["std_error"], expected["seh"], rtol=1e-7)


@pytest.mark.parametrize("name", ["totter_demo_data", "totter_pred_data"])
def test_sidpac_s_longitudinal_history_is_reproduced(name: str, tables: dict[str, Table]) -> None:
    flown = tables[name]
    found = identified(flown, flown.aircraft, ["sidpac"])["methods"]["sidpac"]
    assert found["status"] == "ok"
    expected = reference()["twin_otter_longitudinal"][name]
    for grid in ("rtpid_36", "rtpid_191"):
        for equation in ("CZ", "CL", "Cm"):
            compare(found["history"][grid][equation], expected[grid][equation])
    for equation in ("CL", "Cm"):
        published = expected["rtpid_36"][equation]
        for term, value, error in zip(("alpha", "q", "de"), published["est"], published["se"], strict=True):
            p = found["parameters"][f"{equation}_{term}"]
            assert (p["estimate"], p["std_error_statistical"]) == pytest.approx((value, error), rel=1e-7)
            assert p["std_error"] > math.hypot(error, 0.0099 * value)  # that of a weighed mass, at the least


def test_sidpac_s_lateral_history_is_reproduced(tables: dict[str, Table]) -> None:
    flown = tables["totter_f1_017_data"]
    found = identified(flown, flown.aircraft, ["sidpac"])["methods"]["sidpac"]
    for equation in ("CY", "Cl", "Cn"):
        expected = reference()["twin_otter_lateral"]["totter_f1_017"]["rtpid_36"][equation]
        compare(found["history"]["rtpid_36"][equation], expected)


def test_method_i_gives_sidpac_s_estimates_and_coloured_errors(tables: dict[str, Table]) -> None:
    for name in ("totter_demo_data", "totter_pred_data"):
        flown = tables[name]
        found = identified(flown, flown.aircraft, ["I"])["methods"]["I"]["parameters"]
        for equation in ("CL", "Cm"):
            expected = reference()["twin_otter_longitudinal"][name]["lesq"][equation]
            for i, term in enumerate(("alpha", "q", "de")):
                assert found[f"{equation}_{term}"]["estimate"] == pytest.approx(expected["est"][i], rel=1e-7)
                errors = found[f"{equation}_{term}"]
                assert errors["std_error_statistical"] == pytest.approx(expected["se_colored"][i], rel=1e-7)
                assert errors["std_error"] > errors["std_error_statistical"]


@pytest.mark.parametrize("name", RECORDS)
def test_nasa_s_air_is_calm_and_the_level_is_the_reference_s(name: str, tables: dict[str, Table]) -> None:
    flown = tables[name]
    record = FlightRecord.of(flown.t_s, flown.columns, flown.aircraft)
    kind = "twin_otter_lateral" if "f1_017" in name else "twin_otter_longitudinal"
    expected = reference()[kind][name.removesuffix("_data") if "f1_017" in name else name]
    expected = expected["turb_w"] if "turb_w" in expected else expected["turb_w_ftps"]
    level, std = record.turbulence()
    assert level == "calm"
    assert from_si(std, "ft/s") == pytest.approx(expected["std_2_7_all"], rel=2e-2)


def test_all_methods_agree_on_the_calm_doublet(tables: dict[str, Table]) -> None:
    flown = tables["totter_demo_data"]
    found = identified(flown, flown.aircraft, log="demo.mcap")
    json.dumps(found, allow_nan=False)
    assert found["schema"] == "station.identify/1"
    assert found["interval_s"] == [0.0, 8.0]
    assert found["turbulence"]["level"] == "calm"
    methods = found["methods"]
    assert methods["III"]["status"] == methods["V"]["status"] == "not_applicable"
    assert found["recommended"] not in ("III", "V", None)
    calm = {"CL_alpha": 6.29, "Cm_alpha": -1.47, "Cm_q": -37.0, "Cm_de": -1.88}
    for name in ("I", "II", "VI", "oe", "fe", "sidpac"):
        assert methods[name]["status"] == "ok", name
        for parameter, value in calm.items():
            assert methods[name]["parameters"][parameter]["estimate"] == pytest.approx(value, rel=0.1), (
                name,
                parameter,
            )

"""A post-flight method is one row of the table and a function of its own."""

from __future__ import annotations

import math
import sys
from types import ModuleType

import pytest
from identification.glider import AIRCRAFT, flight, record

from station.estimation.flight_record import FlightRecord
from station.estimation.method_table import METHODS, Method
from station.estimation.results import Axes, MethodResult, names, result_of
from station.identification.analysis import identify
from station.identification.identification_json import as_json
from station.identification.request import Request
from station.rows import ParamEstimate, Status, UsageError


def by_handbook(record: FlightRecord, axes: Axes) -> MethodResult:
    """The profile's own values, a tenth uncertain."""
    known = {n: record.aircraft.value(n) or 1.0 for n in names(axes)}
    return result_of([ParamEstimate(n, v, 0.1 * abs(v), Status.ESTIMATED) for n, v in known.items()], {}, {})


@pytest.fixture
def handbook(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("handbook")
    module.method = by_handbook  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "handbook", module)
    monkeypatch.setitem(METHODS, "handbook", Method("handbook", "the profile", "none", runner="handbook:method"))


@pytest.mark.usefixtures("handbook")
def test_an_added_method_is_in_what_identify_finds() -> None:
    """With the profile's 3 % of the mass in its error."""
    found = as_json(identify(record(flight()), AIRCRAFT, Request(["I", "handbook"])))
    assert found["methods"]["handbook"]["status"] == "ok"
    assert found["methods"]["handbook"]["parameters"]["CL_q"]["std_error"] == pytest.approx(math.hypot(0.1, 0.03))
    assert found["recommended"] == "I"
    alone = identify(record(flight()), AIRCRAFT, Request(["handbook"]))
    assert alone.recommended == "handbook"


@pytest.mark.usefixtures("handbook")
def test_a_mistyped_method_names_the_added_one() -> None:
    with pytest.raises(UsageError, match="did you mean handbook"):
        identify(record(flight()), AIRCRAFT, Request(["handbok"]))

"""The corrected angle of attack against the true one, of aircraft that differ from their profile as real ones do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.true_alpha import flown
from tests.second_simulation.flights import identify_case, write

FLIGHTS = {"calm, quiet": 39, "calm": 20, "gusts": 4, "strong gusts": 32, "25 Hz": 45, "5 Hz": 37}


@pytest.mark.parametrize(
    "kind", [pytest.param(x, marks=[pytest.mark.slow] * (x not in ("calm", "gusts", "5 Hz"))) for x in FLIGHTS]
)
def test_two_standard_errors_hold_the_true_angle_of_attack(kind: str, tmp_path: Path) -> None:
    """Of one flight its aircraft's scale is one draw: four of five values at least."""
    case = identify_case(1, FLIGHTS[kind])
    write([case], tmp_path)
    flight = flown((tmp_path, case.name, json.loads((tmp_path / "answers.json").read_text())[case.name]))
    assert flight.held > 0.8
    assert np.sqrt(np.mean(flight.sd**2)) < 4 * np.sqrt(np.mean(flight.off**2))

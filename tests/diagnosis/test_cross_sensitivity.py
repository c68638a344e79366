"""An instrument that shows a share of what another one measures: nothing of the catalogue, and said."""

from __future__ import annotations

import blind
import pytest

from station.conventions import G0
from station.diagnosis import null_fit
from station.diagnosis.judge import remaining_residual
from station.diagnosis.likelihood import Problem


@pytest.mark.parametrize(
    ("seed", "sigma", "felt"), [pytest.param(8, 0.0, 0.006, marks=pytest.mark.slow), (7, 1.5, -0.006)]
)
def test_a_gyro_that_feels_acceleration_is_told(seed: int, sigma: float, felt: float) -> None:
    case = blind.Case(seed=seed, sigma=sigma, outside={"g_sensitivity": felt})
    problem = Problem(blind.prepared(case), blind.aircraft())
    remaining = remaining_residual(problem, null_fit.null(problem))
    found = remaining.crossed
    assert found is not None
    # In calm air the vane moves as the acceleration does.
    assert ("q", "az") in [(found.sensor, found.signal), *found.others]
    if (found.sensor, found.signal) == ("q", "az"):
        # One standard deviation is a tenth: what is felt counts as noise of the gyro.
        assert found.share == pytest.approx(felt / G0, rel=0.3)
    assert remaining.present
    assert any(
        words.startswith(f"cross-sensitivity of {found.sensor} to {found.signal} by ") for words in remaining.words("")
    )

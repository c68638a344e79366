"""An instrument that shows a share of what another one measures: nothing of the catalogue, and said."""

from __future__ import annotations

import blind
import pytest

from station.conventions import G0


def test_a_gyro_that_feels_acceleration_is_told_beside_the_zero_that_it_looks_like() -> None:
    felt = 0.008 / G0
    case = blind.Case(seed=401_013, outside={"g_sensitivity": -felt * G0})
    d = blind.diagnosed(case)
    found = d.remaining.crossed
    assert found is not None
    assert (found.sensor, found.signal) == ("q", "az")
    # One standard deviation is a tenth: the share's own motion counts as noise of the gyro.
    assert found.share == pytest.approx(-felt, rel=0.3)
    assert d.verdict == "unexplained"
    assert all(e.suspect for e in d.effects)
    assert any(words.startswith("what q shows goes with az, by ") for words in d.remarks)

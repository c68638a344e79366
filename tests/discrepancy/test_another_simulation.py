"""Flights of a simulation that shares nothing with the station's: nothing is found where nothing is hidden."""

from __future__ import annotations

from pathlib import Path

import another_simulation as flown
import pytest
from another_simulation import Case

from station.discrepancy.diagnosis import Diagnosis, diagnose
from station.discrepancy.record import manoeuvres
from station.profile import load_aircraft


def diagnosed(case: Case, folder: Path) -> Diagnosis:
    profile = folder / "navion.toml"
    profile.write_text(flown.PROFILE)
    aircraft = load_aircraft(str(profile))
    records = [manoeuvres(f"flight{kind}", *flown.fly(case, kind), aircraft)[0] for kind in range(3)]
    return diagnose([records[0], records[2]], [records[1]], aircraft)


@pytest.mark.parametrize("sigma", [0.0, 1.5])
def test_nothing_is_found_where_nothing_is_hidden(sigma: float, tmp_path: Path) -> None:
    found = diagnosed(Case(seed=1, sigma=sigma), tmp_path)
    assert found.verdict == "no_effect", (found.effects, found.leftover)

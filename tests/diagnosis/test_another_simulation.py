"""Flights of a simulation that shares nothing with the station's: nothing is found where nothing is hidden."""

from __future__ import annotations

from pathlib import Path

import another_simulation as flown
import pytest
from another_simulation import Case

from station.diagnosis.measured_record import manoeuvres
from station.diagnosis.procedure import Diagnosis, diagnose
from station.diagnosis.readings import readings_of
from station.identification.analysis import identify
from station.identification.identification_json import as_json
from station.identification.request import Request
from station.log import Table
from station.profile import load_aircraft


def diagnosed(case: Case, folder: Path) -> Diagnosis:
    profile = folder / "navion.toml"
    profile.write_text(flown.PROFILE)
    aircraft = load_aircraft(str(profile))
    records = [manoeuvres(f"flight{kind}", *flown.fly(case, kind), aircraft)[0] for kind in range(3)]
    return diagnose([records[0], records[2]], [records[1]], aircraft)


@pytest.mark.parametrize("sigma", [0.0, pytest.param(1.5, marks=pytest.mark.slow)])
def test_nothing_is_found_where_nothing_is_hidden(sigma: float, tmp_path: Path) -> None:
    found = diagnosed(Case(seed=1, sigma=sigma), tmp_path)
    assert found.verdict == "no_effect", (found.effects, found.remaining)


@pytest.mark.slow
def test_a_derivative_far_from_the_profile_s_and_a_gyro_s_zero_are_named_and_mended(tmp_path: Path) -> None:
    """Nothing is left over: the data can have what they want, at a price that the profile says is too high."""
    damping = -22.0
    found = diagnosed(Case(seed=2, derivatives={"Cm_q": damping}, gyro=0.01), tmp_path)
    named = {e.term.id: e for e in found.effects}
    assert (found.verdict, set(named)) == ("effect_found", {"aero.Cm_q", "q.bias"})
    assert abs(named["q.bias"].value - 0.01) < 3 * named["q.bias"].sd < 0.002
    assert found.extended.instruments["q"].bias == pytest.approx(named["q.bias"].value)
    effect = named["aero.Cm_q"]
    share = damping / flown.NAVION["Cm_q"] - 1
    # The inertia is known to 6 % alone; the prior, which is 6 of its standard deviations off, draws nothing to itself.
    assert abs(effect.value - share) < 2 * effect.sd < 0.25
    assert found.extended.value("Cm_q") == pytest.approx(flown.NAVION["Cm_q"] * (1 + effect.value))
    assert found.gain is not None
    assert found.gain.low > 0
    assert found.gain.before > 1.3 > 1.05 > found.gain.after  # a third more than noise, and nothing but noise is left


def test_a_derivative_that_is_off_by_more_than_usual_is_told_though_it_is_not_named(tmp_path: Path) -> None:
    """A quarter, where the profile says 10 %: one profile in a hundred is as wrong, so nothing is found; but told."""
    found = diagnosed(Case(seed=5, derivatives={"Cm_de": 0.75 * flown.NAVION["Cm_de"]}), tmp_path)
    assert (found.verdict, found.named) == ("no_effect", ())
    readings = readings_of(found)
    off = {p.name: p for p in readings.unusual}
    assert abs(off["Cm_de"].change + 0.25) < 2 * off["Cm_de"].prior_sd * off["Cm_de"].sd < 0.15
    (line,) = [x for x in readings.lines() if x.startswith("outside the profile's")]
    assert "Cm_de -2" in line


@pytest.mark.parametrize("sigma", [0.0, 1.5])
def test_a_profile_that_gives_a_quasi_steady_aircraft_lift_memory_is_contradicted(sigma: float, tmp_path: Path) -> None:
    """`physical` is then 20 % off in Cm_alpha in gusts. The data prefer the quasi-steady model, and its interval goes
    so far as to hold that model's value; no number changes its meaning."""
    profile = tmp_path / "navion.toml"
    profile.write_text(flown.PROFILE)
    plain, other = load_aircraft(str(profile)), load_aircraft("twin_otter").unsteady
    memory = {name: getattr(other, name) for name in ("lift_motion", "lift_gust", "downwash")}
    aircraft = plain.model_copy(update={"unsteady": plain.unsteady.model_copy(update=memory)})
    t, shown = flown.fly(Case(seed=3, sigma=sigma, seconds=65.0), 0)
    request = Request(("split", "split+gust", "physical"), noise=flown.NOISE)
    found = as_json(identify(Table(t, shown, aircraft, 0), aircraft, request))
    assert found["recommended"] == "physical"
    made = found["methods"]["physical"]
    assert made["settings"]["model_preferred"] == "quasi-steady"
    for table in ("parameters", "quasi_steady"):
        low, high = made[table]["Cm_alpha"]["ci95"]
        assert low < flown.NAVION["Cm_alpha"] < high

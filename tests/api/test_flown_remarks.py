"""What a simulated flight says of its card, its rig and its aircraft: what is out of hand, and what has no effect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.api.simulated_rows import write_simulated
from station.identification.vanes_compared import in_reserve
from station.log import Table
from station.profile import Aircraft, load_aircraft, profiles_dir

TWIN_OTTER = (profiles_dir() / "aircraft" / "twin_otter.toml").read_text(encoding="utf-8")
SECOND = '[second_vane]\nvane_x = "2 m"\nvane_y = "9 m"\naveraged = {averaged}\n'


def card(folder: Path, aircraft: str, field: str, gusts: str = "5 ft/s", more: str = "") -> Path:
    (folder / "mine.toml").write_text(aircraft)
    made = folder / "card.toml"
    made.write_text(
        f'name = "c"\naircraft = "{folder / "mine.toml"}"\nrig = "bench"\n{more}[flight]\nspeed = "110 kt"\n'
        f'altitude = "2500 ft"\ngust_sigma = "{gusts}"\nfield = "{field}"\n'
    )
    return made


def remarks(folder: Path, aircraft: str, field: str, gusts: str = "5 ft/s") -> tuple[str, ...]:
    return write_simulated(str(card(folder, aircraft, field, gusts)), folder / "out.mcap", {}, 1, 1.0).remarks


@pytest.mark.parametrize(("field", "seed"), [("line", 1), ("plane", 1), ("plane", 3)])
def test_gusts_that_no_aircraft_flies_in_are_said_to_be(field: str, seed: int, tmp_path: Path, station: Any) -> None:
    """Of 60 m/s, beside 57 m/s of airspeed; in a plane the position was soon no number."""
    words = ("--duration", "5", "--seed", seed, "--set", "flight.gust_sigma=60 m/s", "--set", f"flight.field={field}")
    code, out, err = station("simulate", "bench", "-o", tmp_path / "out.mcap", *words)
    assert code == 3, err
    assert "beyond 34 deg of angle of attack" in out + err


@pytest.mark.parametrize(("averaged", "is_said"), [("true", True), ("false", False)])
def test_a_mean_of_two_vanes_without_a_second_is_said(averaged: str, is_said: bool, tmp_path: Path) -> None:
    said = remarks(tmp_path, TWIN_OTTER + SECOND.format(averaged=averaged), "line")
    assert any("no second vane is shown" in words for words in said) is is_said


def test_identify_says_so_too() -> None:
    """At rest as well, where an airspeed of exactly none divided by it."""
    aircraft = load_aircraft("twin_otter")
    second = {"vane_x": 2.0, "vane_y": 9.0, "averaged": True}
    averaging = Aircraft.model_validate({**aircraft.model_dump(), "second_vane": second}, context="si")
    t = np.arange(0.0, 10.0, 0.02)
    columns = {n: np.zeros(len(t)) for n in ("alpha_vane", "p", "q", "airspeed", "tip")}
    places = {"tip": (2.0, 9.0, 0.0)}
    for subject, present, is_said in ((averaging, {}, True), (averaging, places, False), (aircraft, {}, False)):
        _, said = in_reserve(Table(t, columns, subject, 0), present, subject)
        assert any("no second vane is shown" in words for words in said) is is_said


@pytest.mark.parametrize(
    ("sweep", "field", "gusts", "is_said"),
    [("20 deg", "line", "5 ft/s", True), ("20 deg", "plane", "5 ft/s", False), ("0 deg", "line", "5 ft/s", False),
     ("20 deg", "line", "0 ft/s", False)],
)  # fmt: skip
def test_a_sweep_in_a_line_of_air_is_said_to_change_nothing(
    sweep: str, field: str, gusts: str, is_said: bool, tmp_path: Path
) -> None:
    swept = TWIN_OTTER.replace("[planform]", f'[planform]\nsweep = "{sweep}"\n#', 1)
    assert any("planform.sweep changes nothing" in words for words in remarks(tmp_path, swept, field, gusts)) is is_said


@pytest.mark.parametrize("verb", [("check", "--seconds", "0.5"), ("run", "--duration", "0.5", "--view", "none")])
def test_what_is_asked_in_vain_is_said_before_a_flight(verb: tuple[str, ...], tmp_path: Path, station: Any) -> None:
    aircraft = TWIN_OTTER.replace("[planform]", '[planform]\nsweep = "20 deg"\n#', 1) + SECOND.format(averaged="true")
    flown = card(tmp_path, aircraft, "line", more="emulate = true\n")
    more = ("--log", tmp_path / "logs") if verb[0] == "run" else ()
    _, out, err = station(verb[0], flown, *verb[1:], *more)
    assert "no second vane is shown" in out + err
    assert "planform.sweep changes nothing" in out + err

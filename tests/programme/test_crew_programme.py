"""A crew's programme as profiles/programme.md says it: its commands, its cards, and all of it, simulated."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import typer

from station.__main__ import app
from station.api.simulated_rows import write_simulated
from station.flight.verdict import obstacles
from station.log import metadata, table
from station.profile import load_aircraft, load_card, profiles_dir
from station.profile.profile_text import write_profile

PAGE = (profiles_dir() / "programme.md").read_text()
CARDS = tuple(dict.fromkeys(re.findall(r"uv run station run (\w+)", PAGE)))
COMMANDS = re.findall(r"^ *uv run station (.*?)(?:  +#.*)?$", PAGE, re.MULTILINE)


def test_the_page_has_all_of_it() -> None:
    assert CARDS == ("calibration", "crew_baseline", "crew_turbulence", "crew_ice")
    assert {line.split()[0] for line in COMMANDS} == {"check", "run", "calibrate", "baseline", "points", "replay"}


@pytest.mark.parametrize("line", COMMANDS)
def test_its_commands_are_the_station_s(line: str) -> None:
    verb, *words = shlex.split(line)
    command = typer.main.get_command(app).commands[verb]  # type: ignore[attr-defined]
    command.make_context(verb, words)


@pytest.mark.parametrize("name", CARDS)
def test_each_step_can_reach_what_it_is_flown_for(name: str) -> None:
    """CL_alpha to 5 % could not: the profile's mass alone is uncertain by 6."""
    profiles = load_card(name)
    signals = {signal for stream in profiles.rig.streams() for signal in stream.signals}
    for step in profiles.card.steps:
        assert obstacles(step, profiles.aircraft, signals) == [], step.name


def test_all_of_them_fly_the_same_aircraft() -> None:
    """What the calibration is to find is in the later flights too; ice comes in the last."""
    truths = [load_card(name).card.flight.truth for name in CARDS]
    for truth in truths[1:]:
        assert {k: truth[k] for k in truths[0]} == truths[0]
    assert [truth.keys() - truths[0].keys() for truth in truths] == [set(), set(), set(), {"icing"}]


def test_what_is_measured_of_the_aircraft_does_not_change_what_is_emulated(tmp_path: Path) -> None:
    """A lighter aircraft with more drag, as a profile may have it: the thrust that level flight takes is the same."""
    known, body = tmp_path / "measured.toml", load_aircraft("twin_otter")
    light = body.inertia.model_copy(update={"mass": 0.8 * body.inertia.mass})
    write_profile(body.model_copy(update={"name": "measured", "inertia": light}), known, "another")
    thrust = {}
    for name in ("twin_otter", str(known)):
        log = tmp_path / f"{len(thrust)}.mcap"
        made = write_simulated("crew_turbulence", log, {"aircraft": name}, None, 5.0)
        assert metadata(log).about.aircraft.name == made.profiles.aircraft.name == load_aircraft(name).name
        thrust[name] = table(log).columns["thrust"]
    assert made.profiles.emulated_words == ", emulated as twin_otter"
    assert np.array_equal(*thrust.values(), equal_nan=True)


@pytest.mark.slow
def test_the_programme_from_calibration_to_ice(station, tmp_path: Path) -> None:
    """Simulated, card after card: what is planted is found, ice is told at the points that have it and at no other."""
    log = {name: tmp_path / f"{name}.mcap" for name in CARDS}

    def done(*words: object) -> str:
        code, out, err = station(*map(str, words))
        assert code == 0, err
        return out

    calibrated, baseline, page = tmp_path / "calibrated.toml", tmp_path / "baseline.toml", tmp_path / "points.json"
    done("simulate", "calibration", "-o", log["calibration"])
    done("calibrate", log["calibration"], "-o", calibrated)
    made = load_aircraft(str(calibrated))
    assert made.boom is not None
    assert made.calibrated is not None
    assert made.calibrated.vane_zero_sd is not None
    assert abs(made.boom.zero - 0.0104720) < 3.5 * made.calibrated.vane_zero_sd
    done("simulate", "crew_baseline", "--set", f"aircraft={calibrated}", "-o", log["crew_baseline"])
    assert "baseline of 3 points" in done("baseline", log["crew_baseline"], "-o", baseline)
    for name in ("crew_turbulence", "crew_ice"):
        done("simulate", name, "--set", f"aircraft={baseline}", "-o", log[name])
    flights = [log[name] for name in CARDS[1:]]
    done("points", *flights, "--method", "physical", "--json", page, "--report", tmp_path / "report")
    points = {p["name"]: p for p in json.loads(page.read_text())["points"]}
    drag = {name: p["change_percent"]["CD_0"] for name, p in points.items()}
    assert abs(drag["TP 4, turbulence"]["estimate"]) < 4
    assert 10 < drag["TP 5, ice building up"]["estimate"] < 45
    assert 40 < drag["TP 6, iced"]["estimate"] < 60
    assert "ice" in points["TP 6, iced"]["like"]
    assert points["TP 4, turbulence"]["like"] == ""
    assert points["TP 6, iced"]["change_percent"]["CL_alpha"]["ci95"][1] < 0

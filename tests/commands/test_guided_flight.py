"""A card's steps, flown by the emulated devices through the whole station, and without keys."""

import json
import subprocess
import sys

import pytest

from station.commands.cards import load
from station.log import points
from station.profile import profiles_dir


def test_without_steps_there_is_nothing_to_go_through(station):
    code, _, told = station("run", "bench", "--auto", "--view", "none")
    assert code == 2
    assert "card bench has no steps" in told


@pytest.mark.slow
def test_the_emulated_aircraft_flies_what_the_card_asks_for(tmp_path):
    """Half a minute of real time: the recording has the test point, and the elevator moved as drawn."""
    text = (profiles_dir() / "cards" / "guided.toml").read_text()
    first = text.partition('[[steps]]\nname = "Roll')[0].replace("repeats = 4", "repeats = 1")
    card = tmp_path / "mine.toml"
    card.write_text(first.replace('lag = "60 ms"', 'lag = "60 ms"\nwarm_up = "8 s"'))
    words = [sys.executable, "-m", "station", "run", str(card), "--auto", "--view", "none", "--json"]
    done = subprocess.run([*words, "--log", str(tmp_path)], capture_output=True, text=True, timeout=300)
    last = json.loads(done.stdout.splitlines()[-1])
    assert last["step"]["phase"] == "done"
    assert [one["name"] for one in last["step"]["results"]] == ["Short period, 110 kt"]
    verdicts = [e["detail"] for line in done.stdout.splitlines() for e in json.loads(line)["events"]]
    assert not any("of what is drawn" in words or "was not recorded" in words for words in verdicts)
    assert [p.n for p in points(next(tmp_path.glob("*.mcap")))] == [1]


def test_another_aircraft_flies_the_card():
    """By name or path; the recorded card, and the processes that compile for it, go by the same."""
    mine = profiles_dir() / "aircraft" / "attas.toml"
    assert load("bench").aircraft.name == "twin_otter"
    for name in ("attas", str(mine)):
        profiles = load("bench", name)
        assert profiles.aircraft.name == "attas"
        assert profiles.card.aircraft == name


def test_an_aircraft_that_is_not_there_is_told_before_the_flight(station):
    code, _, told = station("run", "bench", "--aircraft", "twin_oter", "--view", "none")
    assert code == 2
    assert "no aircraft named twin_oter" in told
    assert "twin_otter" in told

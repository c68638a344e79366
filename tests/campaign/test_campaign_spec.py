"""Specifications: the shipped ones load, wrong ones say what is wrong, where, and how to mend it."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.campaign.spec import load_plan
from station.profile import profiles_dir
from station.rows import ProfileError

GOOD = """
name = "t"
runs = 3
methods = ["II"]
[flight]
turbulence = "light"
[factors]
vane_damping = [0.1, 0.2]
vane_frequency = ["5 Hz", "9 Hz", "15 Hz"]
[[inputs.doublet]]
kind = "doublet"
start = "1 s"
width = "1 s"
amplitude = "2 deg"
"""


def written(folder: Path, text: str) -> str:
    path = folder / "t.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_every_shipped_campaign_loads_and_the_first_is_short() -> None:
    names = sorted(p.stem for p in (profiles_dir() / "campaigns").glob("*.toml"))
    plans = {name: load_plan(name) for name in names}
    assert plans[names[0]].flights * plans[names[0]].ticks <= 200 * 2000
    assert plans["chapter4_condition2_map"].flights == 96_800
    assert {plans[f"chapter4_condition{i}"].flights for i in (1, 2, 4)} == {800}


def test_cases_are_all_combinations(tmp_path: Path) -> None:
    plan = load_plan(written(tmp_path, GOOD))
    assert plan.flights == 18
    assert [c.levels for c in plan.cases][1] == {"vane_damping": 0.1, "vane_frequency": "9 Hz"}
    assert plan.cases[1].scenario.vane_frequency == 9.0
    assert plan.cases[5].scenario.vane_damping == 0.2
    assert plan.cases[0].scenario.turbulence == pytest.approx(5 * 0.3048)


def test_variants_change_together(tmp_path: Path) -> None:
    variant = '[[variants]]\nlift = "{}"\naltitude = "{} km"\n'
    text = GOOD.replace("[factors]", variant.format("steady", 1) + variant.format("unsteady", 2) + "[factors]")
    plan = load_plan(written(tmp_path, text))
    assert len(plan.cases) == 12
    assert {(c.scenario.lift, c.scenario.altitude) for c in plan.cases} == {("steady", 1000.0), ("unsteady", 2000.0)}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("vane_damping = [", "vane_dampng = [", r"unknown factor vane_dampng; did you mean vane_damping\?"),
        ('"9 Hz", ', '"9 kg", ', r"factors.vane_frequency: '9 kg': unit 'kg' does not fit here"),
        ('"9 Hz", ', "9.0, ", r"factors.vane_frequency: 9.0: missing unit"),
        ("[0.1, 0.2]", "[0.1, -0.2]", "factors.vane_damping: -0.2: "),
        ("[0.1, 0.2]", "[0.1, 0.1]", "vane_damping: needs levels, each once"),
        ('turbulence = "light"', 'turbulence = "ligt"', r"unknown turbulence ligt; did you mean light\?"),
        ('turbulence = "light"', 'turbulance = "light"', r"turbulance: unknown key; did you mean turbulence\?"),
        ('methods = ["II"]', 'methods = ["VII"]', r"unknown method VII; did you mean VI\?"),
        ("runs = 3", "runs = 0", "runs: "),
        ("runs = 3", "runs = -200", "runs: "),
        ("runs = 3", "", "runs: missing key"),
        ("[flight]", '[flight]\nalpha = "distorted"', "distortion: missing"),
        ("[flight]", '[flight]\ninput = "dublet"', r"no inputs.dublet; did you mean doublet\?"),
        ("[flight]", '[flight]\naircraft = "twin_oter"', r"twin_oter; did you mean twin_otter\?"),
        ("[flight]", "[flight", "not valid TOML"),
    ],
)
def test_wrong_specifications_say_why(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(ProfileError, match=said) as caught:
        load_plan(written(tmp_path, GOOD.replace(old, new)))
    assert 1 <= len(str(caught.value).splitlines()) <= 3


def test_an_unknown_campaign_names_the_known_ones() -> None:
    with pytest.raises(ProfileError, match="did you mean a_short_one"):
        load_plan("a_shrt_one")


def test_an_aircraft_whose_instruments_err_is_refused(tmp_path: Path) -> None:
    aircraft = (profiles_dir() / "aircraft" / "twin_otter.toml").read_text(encoding="utf-8")
    (tmp_path / "bent.toml").write_text(aircraft + '\n[instruments.q]\nlatency = "20 ms"\n', encoding="utf-8")
    spec = written(tmp_path, GOOD.replace("[flight]", '[flight]\naircraft = "bent.toml"'))
    with pytest.raises(ProfileError, match=r"flight.aircraft: bent.toml has instruments with errors \(q\)") as caught:
        load_plan(spec)
    assert len(str(caught.value).splitlines()) <= 3

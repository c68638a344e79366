"""What the Twin Otter's outline says, against the lifting line, Helmbold and the lattice of the shipped constants."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from station.__main__ import app
from station.model.outline_responses import PlanformAnswer, exponentials, planform_answer
from station.profile import load_aircraft
from station.profile.profile_text import write_profile
from station.rows import ProfileError

Array = NDArray[np.float64]

FEET = 0.3048


@pytest.fixture(scope="module")
def otter() -> PlanformAnswer:
    return planform_answer(load_aircraft("twin_otter"), 56.59)


def value(made: PlanformAnswer, key: str) -> float:
    found = made.number(key)
    assert found is not None
    return found


def test_shipped_responses_are_reproduced(otter: PlanformAnswer) -> None:
    """Those of another lattice, of other panels and another wake; 10 % is what is asked."""
    assert set(otter.responses) == {"lift_motion", "lift_gust", "upwash_motion", "upwash_gust"}
    assert max(fit.difference for fit in otter.responses.values()) < 0.1
    # Steady upwash of a thin flat wing by that lattice.
    assert otter.wing_lift_slope is not None
    assert value(otter, "boom.upwash_wing") * otter.lift_slope / otter.wing_lift_slope == pytest.approx(
        0.0926, rel=0.01
    )
    assert otter.lift_slope == pytest.approx(4.92, rel=0.01)


def lifting_line(aspect: float, terms: int = 40) -> Array:
    """Prandtl's series for a rectangular wing at 1 rad: Gamma = 2 b V sum A_n sin n theta, odd n."""
    theta = np.linspace(0, math.pi / 2, terms + 1)[1:]
    n = 2 * np.arange(terms) + 1
    mu = 2 * math.pi / (4 * aspect)
    left = np.sin(np.outer(theta, n)) * (mu * n + np.sin(theta)[:, None])
    return np.asarray(np.linalg.solve(left, mu * np.sin(theta)))


def downwash_of_the_line(aspect: float, x: float, y: float, z: float) -> tuple[float, float]:
    """Downwash of that line and its flat wake, over V, and the lift slope; lengths in semispans. Biot and Savart."""
    a = lifting_line(aspect)
    n = 2 * np.arange(len(a)) + 1
    theta = (np.arange(4000) + 0.5) / 4000 * math.pi
    edge = np.arange(4001) / 4000 * math.pi
    at, ends = np.cos(theta), np.cos(edge)
    gamma = 4 * np.sin(np.outer(theta, n)) @ a
    shed = np.diff(4 * np.sin(np.outer(edge, n)) @ a)
    bound = np.sum(gamma * -np.diff(ends) * x / (x**2 + (y - at) ** 2 + z**2) ** 1.5)
    across = (y - at) ** 2 + z**2
    trailing = np.sum(shed * (y - at) / across * (1 + x / np.sqrt(x**2 + across)))
    return float((bound - trailing) / (4 * math.pi)), math.pi * aspect * float(a[0])


def test_downwash_is_as_the_lifting_line_has_it(otter: PlanformAnswer) -> None:
    """For the same lift; a lifting line and a lifting surface of one aspect ratio load the span alike."""
    semispan = 65 / 2
    along = np.linspace(0.02, 0.98, 25) * 20.7 / 2 / semispan
    made = [downwash_of_the_line(otter.aspect_ratio, 24.5 / semispan, y, 1 / semispan) for y in along]
    slope = 5.66 - 0.817 * (1 - 0.35)
    expected = float(np.mean([w / lift for w, lift in made])) * slope
    assert value(otter, "unsteady.downwash") == pytest.approx(expected, rel=0.05)


def test_tail_is_as_helmbold_has_it(otter: PlanformAnswer) -> None:
    aspect = 20.7**2 / 97.8
    helmbold = 2 * math.pi * aspect / (2 + math.sqrt(4 + aspect**2)) * 97.8 / 420
    assert value(otter, "unsteady.tail_lift_slope") == pytest.approx(helmbold, rel=0.06)


def test_the_wake_leaves_the_trailing_edge(otter: PlanformAnswer) -> None:
    """So the downwash comes sooner than from the quarter chord, by less than a chord."""
    chord = 420 / 65 * FEET
    assert -chord / 56.59 < value(otter, "unsteady.downwash_delay") < 0


def test_exponentials_are_found_again() -> None:
    chords = np.geomspace(0.3, 50, 80)
    made = exponentials(chords, 1 - 0.2 * np.exp(-0.1 * chords) - 0.8 * np.exp(-1.0 * chords), 2, starts_at_none=True)
    assert made.a == pytest.approx((0.2, 0.8), abs=1e-3)
    assert made.b == pytest.approx((0.1, 1.0), abs=1e-3)


@pytest.fixture
def few_panels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("station.model.outline_responses.PANELS", (3, 6))


@pytest.mark.usefixtures("few_panels")
def test_the_written_profile_reads_back(tmp_path: Path) -> None:
    out, answer = tmp_path / "mine.toml", tmp_path / "answer.json"
    words = ["planform", "twin_otter", "-o", str(out), "--json", str(answer), "--report", str(tmp_path)]
    assert app(words, standalone_mode=False) == 0
    made = load_aircraft(str(out))
    said = json.loads(answer.read_text())
    assert made.unsteady.downwash == pytest.approx(said["numbers"]["unsteady.downwash"]["value"])
    assert made.unsteady.lift_gust is not None
    assert list(made.unsteady.lift_gust.a) == said["responses"]["lift_gust"]["a"]
    assert "<img" in (tmp_path / "planform.html").read_text()


def test_without_span_it_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "spanless.toml"
    path.write_text(
        'name = "spanless"\n[geometry]\nwing_area = "16 m2"\nchord = "1.5 m"\n[inertia]\nmass = "1000 kg"\n'
    )
    with pytest.raises(ProfileError, match=r"geometry\.span"):
        app(["planform", str(path)], standalone_mode=False)


@pytest.mark.usefixtures("few_panels")
def test_what_is_not_there_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bare.toml"
    path.write_text(
        'name = "bare"\n[geometry]\nwing_area = "16 m2"\nspan = "11 m"\nchord = "1.5 m"\n[inertia]\nmass = "1000 kg"\n'
    )
    assert app(["planform", str(path)], standalone_mode=False) == 0
    said = capsys.readouterr().out
    assert "no [planform]: the wing is taken for a rectangle" in said
    assert "no downwash: planform.tail_area, unsteady.tail_span, unsteady.tail_arm missing" in said


BARE = """name = "bare"
[geometry]
wing_area = "420 ft2"
span = "{span}"
chord = "{chord}"
[inertia]
mass = "340 slug"
[boom]
vane_x = "{vane}"
"""


def bare(path: Path, span: str = "65 ft", chord: str = "6.5 ft", vane: str = "5.3 m") -> str:
    path.write_text(BARE.format(span=span, chord=chord, vane=vane))
    return str(path)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"span": "65 in"}, r"geometry\.span 1\.651 m and wing_area 39\.02 m2 make an aspect ratio of 0\.0699: "),
        ({"span": "650 ft"}, r"geometry\.span 198\.1 m and wing_area 39\.02 m2 make an aspect ratio of 1\.01e\+03: "),
        ({"span": "6500 ft"}, r"aspect ratio of 1\.01e\+05: "),
        ({"span": "30 ft"}, r"geometry\.chord 1\.981 m is 0\.464 times wing_area / span, 4\.267 m: "),
        ({"chord": "6.5 m"}, r"geometry\.chord 6\.5 m is 3\.3 times wing_area / span, 1\.969 m: "),
    ],
)
def test_an_outline_that_cannot_be_is_refused(given: dict[str, str], words: str, tmp_path: Path) -> None:
    """65 ft and 420 ft2 make 10.06; 65 in, 1.651 m, squared over 39.02 m2 0.0699."""
    out = tmp_path / "out.toml"
    with pytest.raises(ProfileError, match=words + ".*; correct whichever"):
        app(["planform", bare(tmp_path / "bare.toml", **given), "-o", str(out)], standalone_mode=False)
    assert not out.exists()


@pytest.mark.usefixtures("few_panels")
def test_beside_or_behind_the_wing_no_upwash_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The wing's leading edge is 0.49 m ahead of the CG; behind it the lattice gives numbers, too."""
    for vane, is_ahead in (("-1 m", False), ("0.3 m", False), ("0.6 m", True)):
        assert app(["planform", bare(tmp_path / "bare.toml", vane=vane)], standalone_mode=False) == 0
        said = capsys.readouterr().out
        assert ("boom.upwash_wing" in said) is is_ahead, vane
        assert ("not ahead of the wing: no upwash" in said) is not is_ahead, vane


def test_a_profile_that_would_not_read_back_leaves_no_file(tmp_path: Path) -> None:
    aircraft, out = load_aircraft("twin_otter"), tmp_path / "out.toml"
    assert aircraft.boom is not None
    wrong = aircraft.model_copy(update={"boom": aircraft.boom.model_copy(update={"upwash_wing": 15.2})})
    with pytest.raises(ProfileError, match="upwash_wing"):
        write_profile(wrong, out, "wrong")
    assert list(tmp_path.iterdir()) == []

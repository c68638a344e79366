"""The card's step on the operator's terminal, at the size that every terminal has."""

from __future__ import annotations

import math

import pytest
from cockpit import STEP, Cockpit

from station.screen import terminal


def shown(cockpit: Cockpit, width: int = 80, height: int = 24) -> list[str]:
    cockpit.board.guide = cockpit.guide
    made = terminal.lines(cockpit.board, cockpit.clock.now_ns(), width, height, None)
    assert len(made) == height
    assert max(line.cell_len for line in made) <= width
    return [line.plain for line in made]


def heading(cockpit: Cockpit) -> str:
    return next(line for line in shown(cockpit) if "STEP" in line).rstrip()


def test_the_step_is_seen_from_condition_to_verdict() -> None:
    cockpit = Cockpit(STEP)
    cockpit.changed = {"airspeed": 60.0}
    cockpit.fly(0.5)
    text = "\n".join(shown(cockpit))
    for words in ("STEP 1/1  short period", "flaps up", "speed 117 kt (110±5)", "wanted: Cm_q to 20 %", "n  next"):
        assert words in text
    assert "●" not in text
    cockpit.changed = {}
    cockpit.press("n")
    cockpit.fly(2.0)
    assert "INPUT IN 3 s" in "\n".join(shown(cockpit))
    cockpit.fly(4.0)
    lines = shown(cockpit)
    assert any("FLY, 1 s to go" in line for line in lines)
    # A doublet trailing edge down first, then up: the flown half lies over the drawn one.
    top, bottom = (next(i for i, line in enumerate(lines) if words in line) for words in ("+2.0°", "-2.0°"))
    assert bottom - top == 4
    assert lines[top].count("●") > 25
    assert "·" in lines[bottom]
    assert "a  abort" in lines[-1]
    cockpit.fly(5.0)
    text = "\n".join(shown(cockpit))
    assert "Cm_q ±11 % (20)" in text
    assert "enough: next step" in text
    assert "CL_alpha" in text
    cockpit.press("n")
    text = "\n".join(shown(cockpit))
    assert "CARD FLOWN" in text
    assert "short period: enough" in text


def test_a_limit_is_in_sight_at_once() -> None:
    cockpit = Cockpit(STEP)
    cockpit.fly(0.5)
    cockpit.changed = {"phi": 0.9}
    cockpit.fly(0.3)
    assert any(line.startswith(" ALARM  bank LIMIT") and "the limit is +45 deg" in line for line in shown(cockpit))
    cockpit.changed = {}
    cockpit.fly(1.5)
    assert not any("ALARM" in line for line in shown(cockpit))


def test_the_crew_sees_whether_it_may_begin() -> None:
    cockpit = Cockpit(STEP)
    cockpit.changed = {"airspeed": 60.0}
    cockpit.fly(0.1)
    assert "GET READY" in heading(cockpit)
    cockpit.changed = {}
    cockpit.fly(0.1)
    assert heading(cockpit).endswith("  READY")


def test_a_condition_is_held_not_flown() -> None:
    """Of a step without an input nothing says INPUT, FLY or HANDS OFF."""
    cockpit = Cockpit({"name": "turn", "steady": "4 s", "condition": {"bank": "30 deg"}})
    cockpit.changed = {"phi": math.radians(30.0)}
    cockpit.fly(0.1)
    cockpit.press("n")
    cockpit.fly(2.0)
    assert "HOLD IN 3 s" in heading(cockpit)
    cockpit.fly(4.0)
    assert "HOLD, 3 s to go" in heading(cockpit)
    cockpit.fly(4.0)
    assert heading(cockpit).endswith("HOLD")


@pytest.mark.parametrize("name", ["q", "phi", "airspeed", "altitude"])
def test_what_is_not_known_is_called_so(name: str) -> None:
    cockpit = Cockpit({**STEP, "condition": {**STEP["condition"], "altitude": "2500 ft"}})
    cockpit.changed = {name: math.nan}
    cockpit.fly(0.1)
    words = {"q": "pitch rate", "phi": "bank", "airspeed": "speed"}.get(name, name)
    text = "\n".join(shown(cockpit))
    assert f"{words} unknown" in text
    assert "nan" not in text

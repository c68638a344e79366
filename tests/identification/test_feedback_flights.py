"""An aircraft that nobody here wrote, JSBSim's DHC-6, gives the same derivatives hands off and under feedback."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest

FOUR = ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de")
DAMPER = ("pilot.pitch_rate=0.5 s",)
HOLD = (*DAMPER, "pilot.attitude=0.5", "pilot.altitude=0.1 deg/m")
Station = Callable[..., tuple[int, str, str]]


def intervals(station: Station, folder: Path, settings: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """The recommended estimates of the card `jsbsim`, and half of their 95 % intervals."""
    log, out = folder / f"{len(settings)}.mcap", folder / f"{len(settings)}.json"
    chosen = [word for setting in settings for word in ("--set", setting)]
    assert station("simulate", "jsbsim", "-o", log, "--duration", 110, *chosen)[0] == 0
    assert station("identify", log, "--from", 20, "--method", "split", "--method", "split+gust", "--json", out)[0] == 0
    found = json.loads(out.read_text())
    parameters = found["methods"][found["recommended"]]["parameters"]
    assert {parameters[n]["status"] for n in FOUR} == {"estimated"}
    return {n: (parameters[n]["estimate"], 0.5 * (p["ci95"][1] - p["ci95"][0])) for n in FOUR for p in [parameters[n]]}


@pytest.mark.slow
def test_jsbsim_s_derivatives_are_the_same_under_feedback(station: Station, tmp_path: Path) -> None:
    """In gusts of 5 ft/s, the same in each flight: each within both intervals."""
    free = intervals(station, tmp_path, ())
    for settings in (DAMPER, HOLD):
        held = intervals(station, tmp_path, settings)
        print(settings, free, held)
        for name in FOUR:
            (a, wide), (b, other) = free[name], held[name]
            assert abs(a - b) < math.hypot(wide, other), name

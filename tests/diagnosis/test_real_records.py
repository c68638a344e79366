"""Diagnosis from the command line: a real flight in turbulence, foreign flights of aircraft unlike their profile."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest
from records import record

from station.__main__ import app


def run(*words: object) -> int:
    return int(app([str(w) for w in words], prog_name="station", standalone_mode=False) or 0)


def test_a_real_flight_in_turbulence_blames_no_instrument(tmp_path: Path) -> None:
    """DLR's HFB-320, whose data nobody has found fault with in thirty years of identification: the gusts are process
    noise and no effect, whatever the aircraft's model lacks beside them."""
    log, out = tmp_path / "hfb.mcap", tmp_path / "d.json"
    run("import", record("hfb320/hfb320_1_10.asc"), "-o", log, "--aircraft", "hfb320")
    assert run("diagnose", log, "--json", out) in (0, 3)
    result = json.loads(out.read_text())
    assert all(e["id"].startswith("aero.") for e in result["effects"])
    told = any("turbulence" in remark for remark in result["remarks"])
    assert (
        told or "alpha_vane" in result["unexplained"]["signals"]
    )  # what moves the vane alone is its gust or its error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "hidden"),
    {"00": {}, "01": {}, "02": {}, "03": {}, "04": {"alpha_vane.delay": 0.02}, "06": {"q.delay": 0.006},
     "09": {"inertia.scale": 1.3}}.items(),
)  # fmt: skip
def test_an_aircraft_unlike_its_profile(case: str, hidden: dict[str, float], tmp_path: Path) -> None:
    """Derivatives, tail, boom and indicial responses are not the profile's: only what was hidden is named, with its
    value, and what was not hidden is not."""
    answers = json.loads(record("flights/answers.json").read_text())
    assert answers[f"diagnose_{case}_a"]["hidden"] == hidden
    logs = []
    for m in "abh":
        name = f"diagnose_{case}_{m}"
        text, log = tmp_path / f"{name}.csv", tmp_path / f"{name}.mcap"
        text.write_bytes(gzip.decompress(record(f"flights/{name}.csv.gz").read_bytes()))
        assert run("import", text, "-o", log, "--aircraft", "twin_otter") == 0
        logs.append(log)
    out = tmp_path / "d.json"
    run("diagnose", *logs[:2], "--hold-out", logs[2], "--json", out)
    result = json.loads(out.read_text())
    named = {e["id"]: e for e in result["effects"]}
    assert set(named) <= set(hidden)
    for name, true in hidden.items():
        if name == "q.delay":  # instruments tell it among themselves; a vane's 20 ms no profile excludes
            assert named[name]["ci95"][0] < true < named[name]["ci95"][1]
            assert result["gain"]["ci95"][0] > 0
    assert hidden or result["verdict"] == "no_effect"

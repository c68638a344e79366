"""Diagnosis of a real flight: DLR's HFB-320 in turbulence, where the profile's model lacks the process noise."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from station.__main__ import app

HFB320 = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "hfb320" / "hfb320_1_10.asc"


def test_turbulence_is_found_and_no_instrument_blamed(tmp_path):
    if not HFB320.is_file():
        pytest.skip("hfb320_1_10.asc is not at ../shared/data/hfb320")
    log, out = tmp_path / "hfb.mcap", tmp_path / "d.json"
    for words in (
        ("import", HFB320, "-o", log, "--aircraft", "hfb320"),
        ("diagnose", log, "--json", out),
    ):
        code = int(app([str(w) for w in words], prog_name="station", standalone_mode=False) or 0)
    result = json.loads(out.read_text())
    found = {e["id"]: e for e in result["effects"]}
    assert code in (0, 3)
    assert found["gust.vertical"]["ci95"][0] > 0
    assert all(name.startswith(("gust.", "aero.")) for name in found)

"""Diagnosis of a real flight: DLR's HFB-320 in turbulence, where the profile's model lacks the process noise."""

from __future__ import annotations

import json

from records import record

from station.__main__ import app


def test_turbulence_is_found_and_no_instrument_blamed(tmp_path):
    log, out = tmp_path / "hfb.mcap", tmp_path / "d.json"
    for words in (
        ("import", record("hfb320/hfb320_1_10.asc"), "-o", log, "--aircraft", "hfb320"),
        ("diagnose", log, "--json", out),
    ):
        code = int(app([str(w) for w in words], prog_name="station", standalone_mode=False) or 0)
    result = json.loads(out.read_text())
    found = {e["id"]: e for e in result["effects"]}
    assert code in (0, 3)
    assert found["gust.vertical"]["ci95"][0] > 0
    assert all(name.startswith(("gust.", "aero.")) for name in found)

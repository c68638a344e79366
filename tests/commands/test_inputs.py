"""station inputs: the table that an autopilot flies, and what is refused."""

import json
import math

import numpy as np

from station.profile import profiles_dir


def test_the_table_and_the_harmonics_are_one_design(station, tmp_path):
    out = tmp_path / "inputs.csv"
    code, said, _ = station("inputs", "multisine", "-o", out, "--rate", "100", "--json", tmp_path / "design.json")
    assert code == 0
    assert "elevator with aileron: correlation" in said
    assert out.read_text().startswith("time [s],elevator [rad],aileron [rad],rudder [rad]\n#")
    t, *surfaces = np.loadtxt(out, delimiter=",", skiprows=2).T
    assert len(t) == 2001
    assert [x[-1] for x in surfaces] == [0, 0, 0]
    assert np.abs(np.corrcoef([x[:-1] for x in surfaces]) - np.eye(3)).max() < 1e-9  # twelve digits are written
    design = json.loads((tmp_path / "design.json").read_text())
    assert [one["surface"] for one in design["inputs"]] == ["elevator", "aileron", "rudder"]
    for one, flown in zip(design["inputs"], surfaces, strict=True):
        made = sum(
            h["amplitude_rad"] * np.sin(2 * math.pi * h["frequency_hz"] * t[:-1] + h["phase_rad"])
            for h in one["harmonics"]
        )
        assert np.abs(made - flown[:-1]).max() < 1e-9
        assert one["relative_peak_factor"] <= 1.15
    assert all(abs(pair["value"]) < 1e-12 for pair in design["correlation"])
    code, _, told = station("inputs", "multisine", "-o", out)
    assert code == 1
    assert "exists already" in told


def test_what_cannot_be_designed_is_said(station, tmp_path):
    text = (profiles_dir() / "cards" / "multisine.toml").read_text()
    short = tmp_path / "short.toml"
    short.write_text(text.replace('duration = "20 s"', 'duration = "1 s"'))
    code, _, told = station("inputs", short)
    assert code == 2
    assert "1 harmonics for 3 inputs" in told
    peaky = tmp_path / "peaky.toml"
    peaky.write_text(text.replace('duration = "20 s"', 'duration = "6 s"'))
    code, said, _ = station("inputs", peaky)
    assert code == 0
    assert "above 1.15: a longer one peaks less" in said
    none = tmp_path / "none.toml"
    none.write_text(text.partition("[[manoeuvres]]")[0])
    code, _, told = station("inputs", none)
    assert code == 2
    assert "it has no manoeuvres" in told


def test_a_step_s_inputs_are_a_table_of_their_own(station, tmp_path):
    """Of the card guided: the first step is a 3-2-1-1 of -2.5 deg, 0.5 s units; the second moves rudder and aileron."""
    code, _, told = station("inputs", "guided")
    assert code == 2
    assert "say of which" in told
    assert "--step N, of 1 Short period, 110 kt; 2 " in told
    assert len(told.splitlines()) <= 3
    out = tmp_path / "one.csv"
    code, said, _ = station("inputs", "guided", "--step", "1", "-o", out, "--json", tmp_path / "one.json")
    assert code == 0
    assert "3-2-1-1, 0.5 s units" in said
    lines = out.read_text().splitlines()
    assert lines[0] == "time [s],elevator [rad]"
    assert lines[1] == "# card guided, step 1: Short period, 110 kt: added to each surface's trim"
    t, x = np.loadtxt(out, delimiter=",", skiprows=2).T
    drawn = [(0.7, -2.5), (2.0, 2.5), (2.7, -2.5), (3.2, 2.5)]
    assert [round(math.degrees(np.interp(at, t, x)), 6) for at, _ in drawn] == [deg for _, deg in drawn]
    design = json.loads((tmp_path / "one.json").read_text())
    assert (design["card"], design["step"], design["name"]) == ("guided", 1, "Short period, 110 kt")
    code, _, _ = station("inputs", "guided", "--step", "2", "-o", tmp_path / "two.csv")
    assert code == 0
    assert "rudder [rad]" in (tmp_path / "two.csv").read_text().splitlines()[0]
    code, _, told = station("inputs", "guided", "--step", "9")
    assert code == 2
    assert "no step 9" in told
    code, _, told = station("inputs", "crew_ice", "--step", "1")
    assert code == 2
    assert "is steady: nothing moves in it" in told

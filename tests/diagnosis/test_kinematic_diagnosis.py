"""Diagnosis of records without aerodynamics: instruments against each other, and what cannot be judged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from real_records import phlab, write_csv
from records import record

from station.__main__ import app
from station.convert import import_file
from station.diagnosis.checks import checked
from station.diagnosis.effects import EFFECTS
from station.diagnosis.kinematic_diagnosis import diagnose_kinematics, judge
from station.log import Table
from station.profile import Card, Doublet, Flight, Instrument, load_aircraft, load_rig
from station.rows import UsageError
from station.simulation.sortie import fly

RIG = load_rig("bench")


def flown(sigma: str, seed: int, **errors) -> Table:
    """A flight of four doublets, as a table of a profile without aerodynamics."""
    made = {n: Instrument.model_validate(e, context="si") for n, e in errors.items()}
    aircraft = load_aircraft("twin_otter").model_copy(update={"instruments": made, "kinematics_only": True})
    inputs = tuple(
        Doublet(kind="doublet", start=f"{s} s", amplitude="3.5 deg", width=f"{w} s")
        for s, w in ((5, 0.6), (18, 1.2), (31, 0.8), (44, 1.6))
    )
    card = Card(name="t", aircraft="twin_otter", rig="bench", manoeuvres=inputs,
                flight=Flight(speed="110 kt", gust_sigma=sigma, seed=seed))  # fmt: skip
    shown, truth = fly(aircraft, RIG, card, 58.0, seed)
    return Table(truth["time"], shown, aircraft.model_copy(update={"instruments": {}}), 0)


def diagnosed(*tables: Table, held: Table | None = None):
    aircraft = tables[0].aircraft

    def judged(name: str, table: Table):
        return judge(name, checked(name, table, aircraft, RIG.noise_si(), RIG.imu_position), aircraft)

    kept = [] if held is None else [judged("held", held)]
    return diagnose_kinematics([judged(f"r{k}", t) for k, t in enumerate(tables)], kept, aircraft)


def test_sound_instruments_are_found_sound():
    found = diagnosed(flown("0 ft/s", 1))
    assert found.verdict == "no_effect", found.effects
    assert {"alpha_vane.bias", "alpha_vane.scale", "alpha_vane.delay", "q.bias"} <= set(found.judged)
    assert found.gain is None
    assert found.extended.instruments == {}
    told = {t.id for t in EFFECTS if t.kinematic is not None}
    assert told == set(found.judged) | (told & set(found.not_judged))


def test_a_biased_gyro_is_named():
    found = diagnosed(flown("0 ft/s", 5, q={"bias": np.radians(0.5)}))
    (effect,) = found.effects
    assert effect.term.id == "q.bias"
    assert effect.value == pytest.approx(np.radians(0.5), abs=max(3 * effect.sd, 1e-4))
    assert found.extended.instruments["q"].bias == effect.value


@pytest.mark.slow
def test_a_late_and_scaled_vane_is_named_and_the_gain_is_held_out():
    wrong = {"latency": 0.05, "gain": 1.2}
    result = diagnosed(flown("0 ft/s", 2, alpha_vane=wrong), held=flown("0 ft/s", 3, alpha_vane=wrong))
    found = {e.term.id: e for e in result.effects}
    # The upwash's own memory, which a constant scale does not have, takes a share.
    assert found["alpha_vane.delay"].value == pytest.approx(0.05, abs=0.012)
    assert found["alpha_vane.scale"].value == pytest.approx(0.2, abs=0.04)
    assert set(found) <= {"alpha_vane.delay", "alpha_vane.scale", "alpha_vane.bias"}
    assert "the vane has an error" in result.not_judged["dynamic_pressure.scale"]
    assert result.gain.before > 2 * result.gain.after
    assert result.gain.low > 0
    assert result.extended.instruments["alpha_vane"].latency == found["alpha_vane.delay"].value


def test_in_gusts_the_vane_is_not_judged():
    result = diagnosed(flown("8 ft/s", 4, alpha_vane={"latency": 0.1}))
    assert not [e for e in result.effects if e.term.of_vane]
    assert "gusts" in result.not_judged["alpha_vane.delay"]


def test_a_record_with_nothing_to_judge_is_refused():
    t = np.arange(100) * 0.02
    columns = {n: np.full(100, v) for n, v in (("alpha_vane", 0.1), ("q", 0.0), ("airspeed", 40.0), ("theta", 0.1),
                                               ("ax", 0.0), ("az", -9.8), ("dynamic_pressure", 900.0))}  # fmt: skip
    unknown = load_aircraft("unknown")
    with pytest.raises(UsageError, match="nothing can be judged"):
        judge("short", checked("short", Table(t, columns, unknown, 0), unknown), unknown)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["onspeed/vac_decel_run.csv", "thor/thor_flight75.mat"])
def test_records_of_real_booms(name: str, tmp_path: Path):
    log, out = tmp_path / "a.mcap", tmp_path / "d.json"
    import_file(record(name), log, load_aircraft("unknown"))
    words = ["diagnose", log, "--json", out, "--report", tmp_path / "r"]
    assert app([str(w) for w in words], prog_name="station", standalone_mode=False) == 3
    result = json.loads(out.read_text())
    assert result["schema"] == "station.diagnose/1"
    found = {e["id"]: e for e in result["effects"]}
    if "onspeed" in name:
        # Seen by eye: 7.4 to 15.8 deg of motion against 11.6 to 22.0 deg of vane.
        assert found["alpha_vane.scale"]["value"] == pytest.approx((22.0 - 11.6) / (15.8 - 7.4) - 1, abs=0.15)
        assert found["alpha_vane.delay"]["confounded_with"] == ["alpha_vane.position"]
        assert result["verdict"] == "confounded"
    else:
        assert found == {}
        assert "gusts" in result["not_judged"]["alpha_vane.scale"]
    assert (tmp_path / "r" / "diagnosis.rrd").read_bytes()[:4] == b"RRF2"
    assert "Vane against the inertial angle of attack" in (tmp_path / "r" / "diagnosis.html").read_text()


@pytest.mark.slow
def test_late_air_data_of_a_real_flight_are_named(tmp_path: Path):
    """PH-LAB, 10 Hz, light turbulence: vane 0.29 +- 0.03 s, altitude rate 0.84 +- 0.06 s late by fits made apart."""
    log, out = tmp_path / "a.mcap", tmp_path / "d.json"
    import_file(write_csv(phlab(480.0, 4600.0), tmp_path / "a.csv"), log, load_aircraft("unknown"))
    app([str(w) for w in ("diagnose", log, "--json", out)], prog_name="station", standalone_mode=False)
    result = json.loads(out.read_text())
    found = {e["id"]: e for e in result["effects"]}
    for name, low, high in (("alpha_vane.delay", 0.26, 0.32), ("velocity.delay", 0.78, 0.90)):
        below, above = found[name]["ci95"]
        assert below < high, found[name]
        assert above > low, found[name]
    assert {row["signal"] for row in result["lags"]} >= {"q", "alpha_vane", "v_down"}

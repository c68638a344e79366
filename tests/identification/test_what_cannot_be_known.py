"""Real records from which a derivative cannot be had, or not by every method: identify says so."""

from __future__ import annotations

import functools
from pathlib import Path

import pytest
from records import record as real

from station.conventions import LATERAL
from station.convert import import_file
from station.identification.analysis import identify
from station.identification.identified import Identification
from station.identification.request import Request
from station.log import table
from station.profile import load_aircraft
from station.rows import Status


@functools.cache
def found(file: str, own: str, folder: Path, *methods: str) -> Identification:
    log = folder / "record.mcap"
    import_file(real(file), log, load_aircraft(own))
    return identify(
        table(log), load_aircraft(own), Request(methods or ("I", "II", "VI", "oe", "fe", "sidpac"), log="x")
    )


def test_a_lateral_manoeuvre_gives_no_longitudinal_derivative(tmp_path: Path) -> None:
    """NASA's: aileron and rudder 1 to 2 deg, sideslip 2 deg, elevator and angle of attack 0.1 deg. CL_alpha came out at
    7.4 ± 0.4, where the same aircraft has 6.0 to 6.3 elsewhere."""
    made = found("twin_otter/totter_f1_017_data.mat", "twin_otter", tmp_path)
    for method, result in made.methods.items():
        for p in result.parameters:
            assert p.name in LATERAL or p.status is not Status.ESTIMATED, (method, p.name)
    sides = [p for p in made.methods["I"].parameters if p.name in LATERAL and p.status is Status.ESTIMATED]
    assert len(sides) > 10
    assert any("sideslip moves" in p.why for p in made.methods["I"].parameters)


def test_an_elevator_manoeuvre_of_the_same_aircraft_does(tmp_path: Path) -> None:
    made = found("twin_otter/totter_demo_data.mat", "twin_otter", tmp_path, "I")
    given = {p.name for p in made.methods["I"].parameters if p.status is Status.ESTIMATED}
    assert {"CL_alpha", "Cm_alpha", "Cm_q", "Cm_de"} <= given


def test_output_error_and_filter_error_that_disagree_are_told_of(tmp_path: Path) -> None:
    """HFB-320 in light turbulence: CL_alpha 3.2 by output error, 4.3 by filter error, each sure to 5 %."""
    made = found("hfb320/hfb320_1_10.asc", "hfb320", tmp_path, "oe", "fe")
    said = [r for r in made.remarks if r.startswith("oe and fe disagree")]
    assert len(said) == 1
    assert "CL_alpha 3.2" in said[0]
    assert said[0].endswith("go by fe, which allows for gusts")
    assert made.recommended == "fe"


@pytest.mark.parametrize("missing", [("v_down", "v_north", "v_east"), ("theta",), ("thrust",), ("v_down",)])
def test_a_record_without_a_signal_gets_what_can_be_known(missing: tuple[str, ...], tmp_path: Path) -> None:
    """NASA's elevator record, which has neither velocity nor thrust: each method gives estimates or says why not."""
    aircraft, log = load_aircraft("twin_otter"), tmp_path / "record.mcap"
    import_file(real("twin_otter/totter_demo_data.mat"), log, aircraft)
    whole = table(log)
    for name in missing:
        whole.columns.pop(name, None)
    made = identify(whole, aircraft, Request(("I", "II", "split", "physical")))
    assert made.recommended is not None
    for result in made.methods.values():
        assert result.status == "ok" or result.why

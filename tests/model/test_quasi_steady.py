"""Quasi-steady derivatives of a model with unsteady lift, against the answers of a program that shares no formula."""

from __future__ import annotations

import gzip
import json

import numpy as np
import pytest
from records import record

from station.model.physical_columns import CHANNELS, Segment
from station.model.physical_constants import (
    DERIVATIVES,
    FIRST_NUISANCE,
    PARAMETERS,
    Constants,
    constants,
)
from station.model.quasi_steady import of_elevator, products, quasi_steady
from station.numerics.spectra import grid
from station.profile import Aircraft, Indicial, load_aircraft

FT, SLUG, SLUG_FT2 = 0.3048, 14.5939, 1.35582
HZ = grid(0.1, 2.0, 0.04)


def segment(speed: float, density: float) -> Segment:
    lines = len(HZ)
    empty = np.zeros((CHANNELS, lines), dtype=complex)
    return Segment(empty, 2 * np.pi * HZ, np.ones(lines), 1.0, 0.0, speed, density, 0.0)


def by_elevator(spectrum: np.ndarray) -> np.ndarray:
    """Of an elevator (lines,) in gusts, where nothing else that is measured counts."""
    return products(np.stack([0.0 * spectrum, 0.0 * spectrum, spectrum, 1.0 + 0.0 * spectrum]))


def flown(name: str) -> tuple[dict[str, np.ndarray], dict]:
    answers = json.loads(record("flights/answers.json").read_text())[name]
    with gzip.open(record(f"flights/{name}.csv.gz"), "rt") as file:
        head = [column.split(" [")[0] for column in file.readline().strip().split(",")]
        table = np.genfromtxt(file, delimiter=",")
    return {n: table[:, i] for i, n in enumerate(head)}, answers


def scaled(response: Indicial | None, amplitude: float, rate: float) -> Indicial:
    assert response is not None
    return Indicial(a=tuple(amplitude * a for a in response.a), b=tuple(rate * b for b in response.b))


def aircraft_of(c: dict[str, float]) -> Aircraft:
    """The aircraft that a foreign flight was flown with."""
    known = load_aircraft("twin_otter")
    u, inertia = known.unsteady, known.inertia
    keys = {
        "tail_lift_slope": c["AH"],
        "downwash": c["EPS"],
        "tail_arm": c["LT"] * FT,
        "lift_motion": scaled(u.lift_motion, c["mem_a"], c["mem_b"]),
    }
    mass = {"mass": c["MASS"] * SLUG, "iyy": c["IYY"] * SLUG_FT2}
    parts = {"unsteady": u.model_copy(update=keys), "inertia": inertia.model_copy(update=mass)}
    return known.model_copy(update=parts)


@pytest.mark.parametrize("number", [4, 9, 12, 13, 24, 36, 42, 44])
def test_a_foreign_aircraft_s_are_its_equation_error_in_calm_air(number: int) -> None:
    """With its own constants: CL_alpha within 1 %, moments within 3 % (a derivative's own differs by up to 40 %). What
    is left is the foreign flight's changing speed."""
    x, answers = flown(f"identify_{number:02d}")
    during = x["time"] >= answers["manoeuvre_from_s"]
    t, elevator = x["time"][during], x["elevator"][during]
    spectrum = np.exp(-2j * np.pi * np.outer(HZ, t)) @ (elevator - elevator.mean())
    speed = float(x["airspeed"][during].mean())
    density = float(np.mean(2 * x["dynamic_pressure"] / x["airspeed"] ** 2))
    theta = np.zeros(PARAMETERS)
    theta[:FIRST_NUISANCE] = [answers["derivatives"][n] for n in DERIVATIVES]
    # The flight's indicial table has its rates; lift and moment of pitch rate hold the tail's own.
    con = constants(aircraft_of(answers["constants"]))
    found = quasi_steady(
        segment(speed, density), con, theta, np.zeros((PARAMETERS, PARAMETERS)), by_elevator(spectrum)
    ).value
    wanted = np.array([answers["quasi_steady"][n] for n in DERIVATIVES])
    assert np.all(np.abs(found / wanted - 1) < [0.01, 0.05, 0.02, 0.03, 0.03, 0.02]), found / wanted
    assert np.abs(theta[3] / wanted[3] - 1) > 0.1
    alone = of_elevator(con, theta[:FIRST_NUISANCE], HZ, speed, density, np.abs(spectrum) ** 2)
    assert alone == pytest.approx(found, rel=1e-9)


@pytest.mark.parametrize("number", [1, 3])
def test_in_calm_air_the_motion_measured_counts_not_the_model_s(number: int) -> None:
    """A model whose moments are 20 % too large answers a pilot's elevator otherwise than the aircraft did, and CL_q is
    3 to 4 off though its lift is the aircraft's own; in the motion that was flown it is the foreign program's within
    0.5. How far the model's motion is from it is in the error."""
    x, answers = flown(f"identify_{number:02d}")
    truth = np.load(record(f"flights/identify_{number:02d}.truth.npz"))
    during = x["time"] >= answers["manoeuvre_from_s"]
    t, speed = x["time"][during], float(x["airspeed"][during].mean())
    alpha = np.interp(t, truth["time_s"], truth["alpha_rad"])
    con = constants(aircraft_of(answers["constants"]))
    measured = np.stack([alpha, x["q"][during] * con.half_chord / x["airspeed"][during], x["elevator"][during]])
    lines = (measured - measured.mean(axis=1, keepdims=True)) @ np.exp(-2j * np.pi * np.outer(t, HZ))
    theta = np.zeros(PARAMETERS)
    theta[:FIRST_NUISANCE] = [answers["derivatives"][n] * (1.2 if n[1] == "m" else 1.0) for n in DERIVATIVES]
    density = float(np.mean(2 * x["dynamic_pressure"] / x["airspeed"] ** 2))
    about = segment(speed, density), con, theta, np.zeros((PARAMETERS, PARAMETERS))
    wanted = answers["quasi_steady"]["CL_q"]
    gust, none = lines[:1], 0.0 * lines[:1]
    turbulent, calm = (quasi_steady(*about, products(np.concatenate([lines, g]))) for g in (gust, none))
    assert abs(turbulent.value[1] - wanted) > 2.5
    assert abs(calm.value[1] - wanted) < 0.5
    assert turbulent.error[1] == 0.0
    assert calm.error[1] == pytest.approx(abs(calm.value[1] - turbulent.value[1]))


def test_without_unsteady_lift_and_tail_they_are_the_derivatives_themselves() -> None:
    """And so are their errors."""
    rng = np.random.default_rng(3)
    con: Constants = constants(load_aircraft("twin_otter"))
    plain = con._replace(tail_share=0.0, lift_motion=con.lift_motion._replace(a=0.0 * con.lift_motion.a))
    theta = np.zeros(PARAMETERS)
    theta[:FIRST_NUISANCE] = [5.6, 20.0, 0.6, -1.3, -34.0, -1.7]
    root = np.zeros((PARAMETERS, PARAMETERS))
    root[:FIRST_NUISANCE, :FIRST_NUISANCE] = 0.02 * rng.standard_normal((6, 6)) * np.abs(theta[:6])[:, None]
    covariance = root @ root.T
    found = quasi_steady(segment(56.6, 1.14), plain, theta, covariance, by_elevator(rng.standard_normal(len(HZ)) + 0j))
    assert found.value == pytest.approx(theta[:FIRST_NUISANCE], rel=1e-9)
    assert found.error == pytest.approx(np.sqrt(np.diag(covariance))[:FIRST_NUISANCE], rel=1e-5)

"""Simulated from measured inputs: a foreign simulation's flights, a real jet's, and the tolerances' arithmetic."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import another_simulation as foreign
import numpy as np
import pytest
from another_simulation import Case
from records import record
from scipy.io import loadmat
from scipy.signal import lfilter

from station.conventions import G0
from station.diagnosis.measured_record import Record, manoeuvres
from station.diagnosis.oscillation import apart, oscillation
from station.diagnosis.qualification import _short_period, qualification_json, qualification_lines, qualified
from station.diagnosis.qualification_pages import qualification_page
from station.diagnosis.vane_gust import inputs_of, undone, without_errors
from station.profile import Aircraft, Instrument, load_aircraft
from station.profile.profile_changes import derivative


@pytest.fixture(scope="module")
def navion(tmp_path_factory) -> Aircraft:
    path = tmp_path_factory.mktemp("navion") / "navion.toml"
    path.write_text(foreign.PROFILE.replace("[unsteady]", "[unsteady]\nmemory = true"))
    return load_aircraft(str(path))


def flown(aircraft: Aircraft, case: Case, kind: int) -> Record:
    return manoeuvres("flight", *foreign.fly(case, kind), aircraft)[0]


@pytest.mark.parametrize(("sigma", "most"), [pytest.param(0.0, 0.5, marks=pytest.mark.slow), (1.5, 0.8)])
def test_the_right_aircraft_stays_inside_and_a_wrong_one_does_not(navion: Aircraft, sigma: float, most: float) -> None:
    """A simulation of another hand, open loop over 45 s: well within the tolerance by the right constants, in moderate
    turbulence by the gust from a vane with 0.1 deg of noise; with the pitch stiffness 40 % off, outside."""
    wrong = derivative("Cm_alpha", relative=True)(navion, -0.4)
    (found,) = qualified([flown(navion, Case(seed=4, sigma=sigma), 1)], wrong, navion)
    (entry,) = [e for e in found.entries if e.name.startswith("short")]
    assert entry.after < most
    assert entry.inside
    assert entry.outside_s is None
    assert entry.before > 1.0
    (found,) = qualified([flown(navion, Case(seed=4, sigma=sigma), 1)], navion, wrong)
    assert found.entries[0].outside_s is not None
    assert "outside from" in qualification_lines([found])[1]


@pytest.mark.parametrize("sigma", [0.0, 1.5])
def test_a_trim_that_is_wrong_is_taken_up_by_the_fit(navion: Aircraft, sigma: float) -> None:
    """CL_0, Cm_0 and CD_0 are fitted: an aircraft whose own are far off is the same aircraft."""
    record = flown(navion, Case(seed=11, sigma=sigma, seconds=80.0), 1)
    off = {"CL_0": 0.25, "Cm_0": -0.05}
    wrong = {
        name: d.model_copy(update={"value": d.value + off.get(name, 0.0)}) for name, d in navion.derivatives.items()
    }
    assert navion.drag is not None
    drag = navion.drag.model_copy(update={"zero_lift": navion.drag.zero_lift + 0.02})
    (found,) = qualified([record], navion.model_copy(update={"derivatives": wrong, "drag": drag}), navion)
    assert found.entries[0].after < 0.8
    assert found.entries[0].before == pytest.approx(found.entries[0].after, abs=0.05)


@pytest.mark.parametrize("seed", [4, 11, 12])
def test_a_record_that_begins_amid_a_gust_is_not_outside_for_what_the_vane_met_before_it(
    navion: Aircraft, seed: int
) -> None:
    """It begins where the gust changed most in the 0.3 s before: the acceleration was 0.12 g off at 0.0 s."""
    whole = flown(navion, Case(seed=seed, sigma=3.0), 1)
    gust = inputs_of(without_errors(whole, navion), whole.dt, navion).gust
    late = round(0.3 / whole.dt)
    at = int(np.argmax(np.abs(gust[late : whole.n // 2] - gust[: whole.n // 2 - late]))) + late
    cut = replace(whole, signals={n: x[at:] for n, x in whole.signals.items()})
    (found,) = qualified([cut], navion, navion)
    entry = found.entries[0]
    assert 0.1 < found.judged_from_s < 1.0
    first = found.t_s < found.judged_from_s
    assert np.abs(found.after["theta"] - cut.signals["theta"])[first].max() < math.radians(0.3)  # as it was flown
    assert entry.outside_s is None or entry.outside_s > 2.0


def test_the_gust_that_the_vane_shows_is_the_one_that_was_met(navion: Aircraft) -> None:
    """Against the gust flown, in the band that it is passed in and without trend: what remains is the vane's noise, 0.1
    deg of 55 m/s, and the pitot's and GPS's in the inertial angle."""
    case = Case(seed=7, sigma=1.5)
    record = flown(navion, case, 1)
    got = inputs_of(without_errors(record, navion), record.dt, navion).gust
    rng = np.random.default_rng([case.seed, 1])
    before = 2.0
    met = foreign.dryden(rng, case.sigma, case.seconds + 2 * before)
    along = np.arange(len(met)) * foreign.FINE - before
    t = foreign.DT * np.arange(len(got))
    true = np.interp(t + foreign.BOOM / foreign.SPEED, along, met)
    off = got - true - np.polyval(np.polyfit(t, got - true, 1), t)
    assert off.std() < 0.15 * case.sigma


def test_air_data_that_lag_do_not_shake_the_simulation(navion: Aircraft) -> None:
    """A lag of 0.9 s undone raises 0.2 m/s of noise a hundred times and more: the aircraft would begin anywhere."""
    record = flown(navion, Case(seed=4, sigma=1.5), 1)
    behind = {"airspeed": 0.2, "dynamic_pressure": 12.0}
    rng, pole = np.random.default_rng(40), math.exp(-record.dt / 0.9)
    shown = {
        n: lfilter([1 - pole], [1, -pole], record.signals[n], zi=[pole * record.signals[n][0]])[0]
        + sd * rng.standard_normal(record.n)
        for n, sd in behind.items()
    }
    late = navion.model_copy(update={"instruments": dict.fromkeys(behind, Instrument(lag="0.9 s"))})
    (found,) = qualified([replace(record, signals={**record.signals, **shown})], navion, late)
    assert found.entries[0].after < 0.8
    assert np.abs(found.after["airspeed"] - found.measured["airspeed"]).max() < 2.0


def test_an_instrument_s_errors_are_undone() -> None:
    """gain * lagged(x, latency) + bias of a sine is a sine: closed form."""
    t = 0.02 * np.arange(1000)
    w, e = 3.0, Instrument().model_copy(update={"latency": 0.05, "lag": 0.1, "gain": 1.1, "bias": 0.2})
    phase = w * (t - e.latency) - math.atan(w * e.lag)
    shown = e.gain * np.sin(phase) / math.hypot(1.0, w * e.lag) + e.bias
    found = undone(shown, e, 0.02)
    assert np.abs(found - np.sin(w * t))[10:-10].max() < 1e-3


def test_of_two_tolerances_the_less_restrictive_counts() -> None:
    t = np.arange(300.0)
    middle = (t >= 100) & (t < 200)
    still = {n: np.zeros(300) for n in ("theta", "q", "az")}

    def worst(theta: float, q: float, az: float):
        other = {n: x * middle for n, x in (("theta", theta), ("q", q), ("az", az))}
        return _short_period(t, still, other, other, 0.0)

    far, near = math.radians(30.0), math.radians(1.0)
    assert worst(far, math.radians(1.9), 0.0).inside
    assert worst(math.radians(1.4), far, 0.0).inside
    assert worst(far, far, 0.0).outside_s == 100.0
    assert worst(near, near, 0.11 * G0).outside_s == 100.0
    assert worst(near, near, 0.09 * G0).after == pytest.approx(0.9)


def test_an_oscillation_s_period_and_damping_are_those_it_was_made_with() -> None:
    t = 0.1 * np.arange(400)
    omega, zeta = 2 * math.pi / 30.0, 0.05
    rate, damped = zeta * omega, omega * math.sqrt(1 - zeta**2)
    x = np.exp(-rate * t) * np.cos(damped * t + 0.4) + 0.1 + 0.002 * t
    found = oscillation(t, x, 25.0)
    assert found.period == pytest.approx(2 * math.pi / damped, rel=1e-4)
    assert found.damping == pytest.approx(zeta, rel=1e-3)
    assert found.to_half == pytest.approx(math.log(2) / rate, rel=1e-3)
    assert found.share == pytest.approx(1.0, abs=1e-6)
    slower = oscillation(t, np.exp(-rate * t) * np.cos(1.05 * damped * t), 25.0)
    assert 0.4 < apart(slower, found) < 0.6


ATTAS = """
name = "attas"
[geometry]
wing_area = "64 m2"
span = "21.5 m"
chord = "3.159 m"
[inertia]
mass = "17631 kg"
iyy = "252687 kg m2"
[boom]
vane_x = "13.08 m"
[derivatives]
CL_0 = { value = 0.1 }
Cm_0 = { value = 0.05 }
CL_alpha = { value = 5.38 }
CL_q = { value = 7.5 }
CL_de = { value = 0.47 }
Cm_alpha = { value = -0.975 }
Cm_q = { value = -23.2 }
Cm_de = { value = -1.41 }
[drag]
zero_lift = 0.03
induced = 0.05
"""
"""Geometry and mass of the book; derivatives by least squares on the records, made apart from the station; trims and
drag are guesses, which the fit of the trim takes up."""
COLUMNS = {"ax": 2, "ay": 3, "az": 4, "p": 7, "q": 8, "r": 9, "phi": 10, "theta": 11, "psi": 12, "alpha_vane": 13,
           "airspeed": 15, "altitude": 16, "elevator": 22, "static_pressure": 33}  # fmt: skip
IN_DEGREES = {"p", "q", "r", "phi", "theta", "psi", "alpha_vane", "elevator"}


@pytest.mark.parametrize("name", ["fAttasElv1", "fAttasElv2"])
def test_a_real_jet_is_inside_with_its_boom_where_it_is_and_outside_with_it_at_the_cg(name: str, tmp_path) -> None:
    """DLR's ATTAS, whose vane is 13 m ahead: the boom's rate taken for a gust spoils the simulation."""
    made = loadmat(record(f"attas/{name}.mat"))
    rows = next(v for k, v in made.items() if not k.startswith("__"))
    columns = {n: rows[:, k - 1] * (math.pi / 180 if n in IN_DEGREES else 1.0) for n, k in COLUMNS.items()}
    columns["altitude"] = 0.3048 * columns["altitude"]
    columns["static_pressure"] = 100 * columns["static_pressure"]
    (tmp_path / "attas.toml").write_text(ATTAS)
    aircraft = load_aircraft(str(tmp_path / "attas.toml"))
    assert aircraft.boom is not None
    at_cg = aircraft.model_copy(update={"boom": aircraft.boom.model_copy(update={"vane_x": 0.0})})
    (found,) = qualified(manoeuvres(name, rows[:, 0] - rows[0, 0], columns, aircraft), at_cg, aircraft)
    assert found.entries[0].inside
    assert found.entries[0].before > 2.0


def test_an_aircraft_that_cannot_be_trimmed_says_so(navion: Aircraft) -> None:
    heavy = navion.inertia.model_copy(update={"mass": 9000.0})
    found = qualified([flown(navion, Case(seed=1), 0)], navion.model_copy(update={"inertia": heavy}), navion)
    assert "no trim" in found[0].why
    assert qualification_json(found)["manoeuvres"][0]["entries"] == []
    assert "not simulated" in " ".join(qualification_page(found))


def test_a_simulation_that_departs_says_so(navion: Aircraft) -> None:
    (found,) = qualified([flown(navion, Case(seed=1), 0)], navion, navion)
    lost = {name: np.full_like(x, np.nan) for name, x in found.after.items()}
    departed = replace(found, after=lost, entries=(replace(found.entries[0], after=math.nan),))
    said = json.loads(json.dumps(qualification_json([departed]), allow_nan=False))["manoeuvres"][0]
    assert said["entries"][0]["worst_after"] is None
    assert not said["entries"][0]["inside"]
    assert said["rms"]["q"]["after"] is None
    assert "departs" in qualification_lines([departed])[1]

"""The second simulation itself: held against spectra, kinematics and the station's own flight of the same aircraft."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.diagnosis.air_data import Unseen
from station.diagnosis.effects import BY_ID
from station.diagnosis.manoeuvre import manoeuvre
from station.diagnosis.measured_record import NEEDED, manoeuvres
from station.diagnosis.residuals import LIFT, MOMENT
from station.diagnosis.series_spectra import spectra
from station.profile import Doublet, Flight, load_aircraft
from station.simulation.three_degrees import Simulation
from tests.second_simulation import aircraft as book
from tests.second_simulation import hidden as hides
from tests.second_simulation.air import air, noise, over_span
from tests.second_simulation.aircraft import DEG, FT, SHAPES, Drawn, G
from tests.second_simulation.flights import (
    QUIET,
    Case,
    autopilot,
    csv,
    diagnose_cases,
    flown,
    identify_case,
    quasi_steady,
)
from tests.second_simulation.instruments import coloured, lagging, sticking
from tests.second_simulation.motion import DT, RATE, Feedback, Hidden, fly

PROFILED = Drawn(
    derivatives=book.LONGITUDINAL, lateral=book.LATERAL, CL_0=0.36, Cm_0=0.04, CD_0=0.04, induced=0.045,
    mass=book.MASS, iyy=book.IYY, tail_slope=0.817, downwash=0.35, tail_arm=book.TAIL_ARM, boom_x=5.3,
    upwash_body=0.07, upwash_wing=0.107, sidewash=0.0, vane_hz=9.0, vane_damping=0.35, memory=1.0, memory_rate=1.0,
    upwash_memory=1.0, upwash_rate=1.0, span_lag=0.0, span_shape="one lag", speed=56.59, altitude=762.0,
    thrust_slope=0.0, actuator_lag=0.08,
)  # fmt: skip
"""As the profile `twin_otter` has it."""


def doublet(seconds: float, size: float = 0.05, start: float = 2.0) -> np.ndarray:
    t = np.arange(round(seconds * RATE)) * DT - start
    out = np.zeros((3, len(t)))
    out[0] = size * ((t >= 0) & (t < 0.8)) - size * ((t >= 0.8) & (t < 1.6))
    return out


def still(aircraft: Drawn, seconds: float):
    rng = np.random.default_rng(1)
    return air(rng, aircraft, "dryden", 0.0, 500.0, aircraft.speed * seconds)


def test_the_profile_s_aircraft_flies_as_in_the_station_s_simulation() -> None:
    """Two programs of other equations, axes, gust fields and integrators: 2 % of each signal's own motion, which is
    what commands held for 20 ms instead of 5 ms make of a doublet's edges."""
    true = fly(PROFILED, still(PROFILED, 20), doublet(20), Hidden(), Feedback(), np.random.default_rng(1))
    shape = {"kind": "doublet", "start": 2.0, "amplitude": 0.05, "width": 0.8}
    flight = Simulation(
        load_aircraft("twin_otter"), Flight(), (Doublet.model_validate(shape, context="si"),), hold=False
    )
    theirs = flight.advance(20 * 200)
    for name in ("alpha", "q", "theta", "az", "ax", "airspeed", "alpha_vane", "altitude", "v_down", "CL", "Cm"):
        apart = true[name][:: RATE // 200] - theirs[name]
        assert np.sqrt(np.mean(apart**2)) < 0.02 * np.std(theirs[name]), name


@pytest.mark.parametrize(("kind", "axis"), [(k, a) for k in ("dryden", "von_karman") for a in ("along", "across")])
def test_gusts_have_the_variance_that_they_are_asked_for(kind: str, axis: str) -> None:
    """Of 20 draws of 160 scale lengths: each variance scatters by sqrt(2/160), the mean of 20 by 2.5 %; the longest
    waves of all, a few per cent of the spectrum, do not fit in."""
    rng = np.random.default_rng(5)
    drawn = [noise(rng, kind, axis, 2.0, 100.0, 80_000).var() for _ in range(20)]
    assert np.mean(drawn) == pytest.approx(4.0, rel=0.08)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_span_follows_a_gust_as_late_as_it_is_asked_to(shape: str) -> None:
    """A ramp comes out as a ramp, later by the mean of the kernel."""
    ramp = np.arange(2000) * 0.2
    late = (ramp - over_span(ramp, 0.6, shape))[-1]
    assert late == pytest.approx(0.6 * book.SPAN / 2, rel=0.03)  # the grid is 0.2 m of 5.9 m


def test_attitude_and_velocity_are_the_integrals_of_rates_and_forces() -> None:
    """In a banked flight with everything moving, against Euler's angles and Newton's law written out."""
    case = identify_case(3, 1, lateral=True)
    true = flown(case).true
    y = {k: v[2000:12000] for k, v in true.items()}

    def rate(x: np.ndarray) -> np.ndarray:
        return np.gradient(x, DT)

    phi, theta, psi = y["phi"], y["theta"], y["psi"]
    assert np.abs(phi).max() > 5 * DEG
    theta_dot = y["q"] * np.cos(phi) - y["r"] * np.sin(phi)
    phi_dot = y["p"] + np.tan(theta) * (y["q"] * np.sin(phi) + y["r"] * np.cos(phi))
    down = -y["ax"] * np.sin(theta) + (y["ay"] * np.sin(phi) + y["az"] * np.cos(phi)) * np.cos(theta) + G
    north = (
        y["ax"] * np.cos(theta) * np.cos(psi)
        + y["ay"] * (np.sin(phi) * np.sin(theta) * np.cos(psi) - np.cos(phi) * np.sin(psi))
        + y["az"] * (np.cos(phi) * np.sin(theta) * np.cos(psi) + np.sin(phi) * np.sin(psi))
    )
    for made, expected in ((theta, theta_dot), (phi, phi_dot), (y["v_down"], down), (y["v_north"], north)):
        apart = (rate(made) - expected)[2:-2]
        assert np.sqrt(np.mean(apart**2)) < 5e-3 * np.sqrt(np.mean(expected**2))  # the field has kinks


def test_without_memory_or_downwash_equation_error_gives_the_table_back() -> None:
    plain = replace(PROFILED, memory=0.0, downwash=0.0)
    true = fly(plain, still(plain, 50), doublet(50, start=25.0), Hidden(), Feedback(), np.random.default_rng(1))
    found = quasi_steady(true)
    for name, value in book.LONGITUDINAL.items():
        assert found[name] == pytest.approx(value, rel=1e-3), name  # u varies by 1 %, and alpha with the square


def test_the_rate_is_the_integral_of_its_acceleration_while_the_elevator_moves() -> None:
    """To the trapezoid's error, 1e-4 of it. With the surface held over a step of the integration all followed it half a
    step late: 4e-3."""
    inputs = doublet(12)
    true = fly(PROFILED, still(PROFILED, 12), inputs, Hidden(), Feedback(), np.random.default_rng(1))
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (true["qdot"][1:] + true["qdot"][:-1])) / RATE])
    np.testing.assert_allclose(true["q"] - true["q"][0], integral, atol=3e-4 * np.abs(true["q"]).max())


def test_what_lags_follows_a_ramp_by_its_lag() -> None:
    """Closed form: of the first order, the ramp behind by the time constant, once it has come there."""
    ramp = np.arange(4000.0)
    np.testing.assert_allclose(lagging(ramp, 0.1)[2000:], ramp[2000:] - 0.1 * RATE, atol=1e-6)


def test_a_pitch_damper_damps() -> None:
    """A pulse's pitch rate dies away sooner under feedback of q."""
    moved = []
    for gain in (0.0, 0.7):
        inputs = doublet(12)
        true = fly(PROFILED, still(PROFILED, 12), inputs, Hidden(), Feedback(q=gain), np.random.default_rng(1))
        moved.append(np.abs(true["q"][round(4.2 * RATE) :]).max() / np.abs(true["q"]).max())
    assert moved[1] < 0.8 * moved[0]


def test_every_hidden_effect_is_in_the_catalogue_or_said_to_be_outside() -> None:
    unknown = {n for n in hides.HIDDEN if n not in BY_ID} - set(hides.OUTSIDE)
    assert unknown <= {"aero.separation"}
    assert set(hides.OUTSIDE).isdisjoint(BY_ID)


@pytest.mark.parametrize("name", hides.HIDDEN)
def test_every_hidden_effect_changes_what_is_recorded(name: str) -> None:
    cases = diagnose_cases(7, 0, names=(name,), sigma=1.5, lateral=hides.HIDDEN[name].lateral)
    seen = cases[0]
    shown, sound = (flown(replace(c, seconds=15.0)).shown for c in (seen, replace(seen, hidden={})))
    assert any(np.abs(shown[n] - sound[n]).max() > 0 for n in shown)
    assert seen.hidden.keys() == {name}


def test_a_flight_is_the_same_each_time() -> None:
    case = replace(identify_case(4, 2), seconds=5.0)
    assert csv(flown(case)) == csv(flown(case))


@pytest.mark.parametrize("colour", ["white", "flicker", "drifting", "slow"])
def test_noise_is_as_large_as_it_is_asked_to_be(colour: str) -> None:
    """Within a tenth over a second; a drift is small by then, and outliers and steps are no standard deviation."""
    rng = np.random.default_rng(2)
    drawn = [coloured(rng, colour, 3.0, np.zeros(3000), 50.0) for _ in range(20)]
    first = np.concatenate([d - d.mean() if colour != "drifting" else np.diff(d) / np.sqrt(2) for d in drawn])
    assert first.std() == pytest.approx(3.0, rel=0.1)


def test_a_vane_that_sticks_stays_within_its_breakaway() -> None:
    y = np.sin(np.arange(4000) * DT)
    out = sticking(y, 0.1)
    assert np.abs(out - y).max() <= 0.1
    assert len(np.unique(out)) < 70  # 6.4 of way in steps of 0.1


def test_autopilots_are_drawn_of_each_kind() -> None:
    drawn = [autopilot(np.random.default_rng(i), False) for i in range(60)]
    kinds = {(bool(f.q), bool(f.theta), bool(f.h)) for f in drawn}
    assert kinds == {(False, False, False), (True, False, False), (True, True, False), (True, True, True)}


@pytest.mark.parametrize("seed", [1, 2])
def test_gusts_along_the_path_are_no_motion_where_only_the_speed_to_the_north_is_recorded(seed: int) -> None:
    """The profile's aircraft at 12 ft/s, almost without noise: moment that the profile does not make is what the air
    is mistaken for. Both flights fly north; without the ground speed slow gusts count as motion."""
    case = Case(
        name="plane", seed=(seed,), aircraft=PROFILED, sigma=12 * FT, scale=1000 * FT, spectrum="dryden",
        kind="doublets", rate=50.0, noise=0.02, feedback=Feedback(), hidden={}, zeros={}, thrust_recorded=True,
        seconds=45.0,
    )  # fmt: skip
    flight, profiled = flown(case), load_aircraft("twin_otter")
    slower = float(np.mean((flight.shown["v_north"] - flight.shown["airspeed"])[flight.time >= QUIET]))
    rest = []
    for kept in (flight.shown, {n: x for n, x in flight.shown.items() if n != "v_north"}):
        (record,) = manoeuvres("plane", flight.time, kept, profiled, [(QUIET, QUIET + case.seconds)])
        made = manoeuvre(record, profiled)
        bins = made.differences(profiled, Unseen(slower)).bins[made.setting.judged.index(MOMENT)]
        rest.append(float(np.sqrt(np.mean(np.abs(bins[made.setting.frequencies > 0.5]) ** 2))))
    assert rest[0] < 0.5 * rest[1]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_gust_goes_from_the_vane_to_the_wing_as_a_velocity(seed: int) -> None:
    """The profile's aircraft at 12 ft/s, almost without noise, whose wing follows gusts over 4 m: lift that the profile
    does not make is more where a gust's angle is taken to stay the same, and where a gust along the path is taken to
    turn the mean angle of attack as late as one across it. Half of the rest is there without gusts along the path."""
    case = Case(
        name="plane", seed=(seed,), aircraft=replace(PROFILED, span_lag=0.4), sigma=12 * FT, scale=500 * FT,
        spectrum="von_karman", kind="doublets", rate=100.0, noise=0.002, feedback=Feedback(), hidden={}, zeros={},
        thrust_recorded=True, seconds=45.0,
    )  # fmt: skip
    flight, profiled = flown(case), load_aircraft("twin_otter")
    (record,) = manoeuvres("plane", flight.time, flight.shown, profiled, [(QUIET, QUIET + case.seconds)])
    made, x = manoeuvre(record, profiled), record.signals
    drift = float(np.mean(np.hypot(x["v_along"], x["v_down"])) - np.mean(x["airspeed"]))

    def rest(gust_speed: float, turned_at_once: float) -> float:
        update = {"gust_speed": gust_speed, "turned_at_once": turned_at_once, "gust_span": 0.4 * book.SPAN / 2}
        craft = profiled.model_copy(update={"unsteady": profiled.unsteady.model_copy(update=update)})
        bins = made.differences(craft, Unseen(drift)).bins[made.setting.judged.index(LIFT)]
        return float(np.sqrt(np.mean(np.abs(bins[made.setting.frequencies > 0.5]) ** 2)))

    assert rest(1.0, 1.0) < 0.85 * rest(0.0, 1.0)
    assert rest(1.0, 1.0) < 0.85 * rest(1.0, 0.0)


@pytest.mark.parametrize(("speed", "seed"), [(45.0, 2), (45.0, 4), (58.0, 1), (58.0, 4)])
def test_strong_gusts_leave_little_unexplained_where_the_constants_are_right(speed: float, seed: int) -> None:
    """The profile's aircraft at 12 ft/s, almost without noise, with up to 20 deg of inertial incidence, in a mean wind
    along and across of up to 5 m/s: lift and moment that are not explained, as a share of what moves."""
    case = Case(
        name="plane", seed=(seed,), aircraft=replace(PROFILED, speed=speed), sigma=12 * FT, scale=1000.0,
        spectrum="dryden", kind="doublets", rate=50.0, noise=0.002, feedback=Feedback(q=0.3, theta=0.3), hidden={},
        zeros={}, thrust_recorded=True, seconds=45.0,
    )  # fmt: skip
    flight, profiled = flown(case), load_aircraft("twin_otter")
    (record,) = manoeuvres("plane", flight.time, flight.shown, profiled, [(QUIET, QUIET + case.seconds)])
    made, x = manoeuvre(record, profiled), record.signals
    along = float(np.mean(np.hypot(x["v_along"], x["v_down"])) - np.mean(x["airspeed"]))
    up = float(np.mean(flight.true["w_gust"][round(QUIET * RATE) :]))
    # The air as this simulation has it.
    air = {"turned_at_once": 1.0, "gust_tilt": 1.0}
    there = profiled.model_copy(update={"unsteady": profiled.unsteady.model_copy(update=air)})
    for name, row, left in (("CL", LIFT, 0.011), ("Cm", MOMENT, 0.016)):
        rest = made.differences(there, Unseen(along, up)).bins[made.setting.judged.index(row)]
        shown = flight.true[name][:: round(made.setting.dt * RATE)][None, -made.setting.n :]
        moved = spectra(shown, made.setting, (0,), False).bins[0]
        assert np.linalg.norm(rest) < left * np.linalg.norm(moved), name


def test_a_recorder_starts_at_any_time_and_keeps_its_rate() -> None:
    case = Case(
        name="plane", seed=(1,), aircraft=PROFILED, sigma=0.0, scale=1000 * FT, spectrum="dryden", kind="doublets",
        rate=12.5, noise=1e-6, feedback=Feedback(), hidden={}, zeros={}, thrust_recorded=True, seconds=10.0,
    )  # fmt: skip
    flights = [flown(replace(case, seed=(seed,))) for seed in range(4)]
    starts = [f.time[0] for f in flights]
    assert len(set(starts)) == 4
    assert min(starts) >= 0
    assert max(starts) < 0.08
    for f in flights:
        np.testing.assert_allclose(np.diff(f.time), 0.08)
        fine = np.arange(len(f.true["q"])) * DT
        np.testing.assert_allclose(f.shown["theta"], np.interp(f.time, fine, f.true["theta"]), atol=1e-6)


def test_a_speed_to_the_north_that_is_not_along_the_path_is_left_out() -> None:
    t = np.arange(0, 20, 0.02)
    columns = {n: np.zeros(len(t)) for n in NEEDED} | {
        "airspeed": np.full(len(t), 50.0),
        "az": np.full(len(t), -G),
        "elevator": 0.1 * np.sin(t),
    }
    aircraft = load_aircraft("twin_otter")
    for north, along in ((52.0, 52.0), (-52.0, 52.0), (40.0, None)):
        (record,) = manoeuvres("plane", t, columns | {"v_north": np.full(len(t), north)}, aircraft)
        assert ("v_along" in record.signals) == (along is not None)
        assert ("v_along" in record.missing) == (along is None)
        if along is not None:
            assert record.signals["v_along"] == pytest.approx(along)

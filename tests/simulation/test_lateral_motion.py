"""Six degrees of freedom against the textbook's linear equations, rigid-body laws and the longitudinal simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from station.numerics.atmosphere import atmosphere
from station.profile import Aircraft, Card, Flight, load_aircraft
from station.rows import ProfileError
from station.simulation import Simulation, fly, side_flow
from station.simulation import airframe as ac
from station.simulation import longitudinal as eq
from station.simulation import six_degrees as six
from station.simulation.motion import DT
from station.simulation.six_degrees import LateralSimulation

G = 9.80665
AIRCRAFT = load_aircraft("twin_otter")


def flight(**keys: object) -> Flight:
    return Flight.model_validate(keys)


def inputs(*rows: dict[str, object]):
    return Card.model_validate({"name": "t", "aircraft": "a", "rig": "r", "manoeuvres": list(rows)}).manoeuvres


ELEVATOR = {"kind": "doublet", "start": "1 s", "width": "0.7 s", "amplitude": "3 deg"}


def test_without_lateral_motion_it_is_the_longitudinal_simulation_to_the_last_bit() -> None:
    place = (0.5, 0.3, -0.1)
    one = Simulation(AIRCRAFT, flight(wind_east="3 m/s", heading="0.3 rad"), inputs(ELEVATOR), place).advance(3000)
    two = LateralSimulation(AIRCRAFT, flight(wind_east="3 m/s", heading="0.3 rad"), inputs(ELEVATOR), place).advance(
        3000
    )
    for name, values in one.items():
        if name in ("latitude", "longitude", "psi"):  # the way is integrated north and east, not along the heading
            np.testing.assert_allclose(two[name], values, rtol=0, atol=1e-14, err_msg=name)
        else:
            np.testing.assert_array_equal(two[name], values, err_msg=name)
    assert not any(two[name].any() for name in six.LATERAL_TRUTH)


def test_the_same_bits_in_any_pieces() -> None:
    rudder = {"kind": "doublet", "surface": "rudder", "start": "1 s", "width": "1 s", "amplitude": "5 deg"}
    whole = LateralSimulation(AIRCRAFT, flight(gust_sigma="5 ft/s"), inputs(rudder)).advance(1500)
    cut = LateralSimulation(AIRCRAFT, flight(gust_sigma="5 ft/s"), inputs(rudder))
    pieces = [cut.advance(n) for n in (1, 399, 1, 700, 399)]
    for name, values in whole.items():
        np.testing.assert_array_equal(np.concatenate([p[name] for p in pieces]), values, err_msg=name)


def textbook(aircraft: Aircraft, c: ac.Constants) -> np.ndarray:
    """(4, 4): v, p, r, bank about level flight, body axes (Nelson 1998, section 5.3, with w0 and the product of
    inertia kept)."""
    density = float(atmosphere(c.trim_height)[2])
    speed, alpha = c.trim_speed, c.trim_alpha
    area, span, m = aircraft.geometry.wing_area, aircraft.geometry.span, aircraft.inertia.mass
    ixx, izz, ixz = aircraft.inertia.ixx, aircraft.inertia.izz, aircraft.inertia.ixz
    pressure = 0.5 * density * speed**2

    def row(name: str, factor: float) -> np.ndarray:
        v = aircraft.value
        hat = span / (2 * speed)
        return factor * np.array([v(f"{name}_beta") / speed, v(f"{name}_p") * hat, v(f"{name}_r") * hat, 0.0])

    side = row("CY", pressure * area / m)
    roll, yaw = row("Cl", pressure * area * span), row("Cn", pressure * area * span)
    coupled = np.linalg.inv(np.array([[ixx, -ixz], [-ixz, izz]])) @ np.stack([roll, yaw])
    side += np.array([0.0, speed * math.sin(alpha), -speed * math.cos(alpha), G * math.cos(alpha)])
    return np.stack([side, coupled[0], coupled[1], np.array([0.0, 1.0, math.tan(alpha), 0.0])])


def test_dutch_roll_roll_and_spiral_modes_are_flown() -> None:
    """Let go at 0.5 deg of sideslip: the flight against the matrix exponential of the textbook's matrix."""
    simulation = LateralSimulation(AIRCRAFT, flight(), hold=False)
    c = simulation.flown.constants
    a = textbook(AIRCRAFT, c)
    start = np.array([c.trim_speed * math.radians(0.5), 0.0, 0.0, 0.0])
    simulation._state[: len(start)] = start
    f = simulation.advance(1600)
    flown = np.stack([f["airspeed"] * np.sin(f["beta"]), f["p"], f["r"], f["phi"]])
    step, state = expm(a * DT), start
    for k in range(1600):
        # What is left is of second order in the sideslip.
        np.testing.assert_allclose(flown[:, k], state, atol=0.01 * np.abs(flown).max(axis=1).max(), err_msg=str(k))
        state = step @ state
    scale = np.abs(flown).max(axis=1)
    errors = np.abs(flown[:, -1] - expm(a * DT * 1599) @ start) / scale
    assert errors.max() < 0.02
    roots = np.linalg.eigvals(a)
    dutch = roots[roots.imag > 0.1]
    assert len(dutch) == 1
    # The roots say what a Twin Otter does: about 4 s a swing, well damped roll within half a second, slow spiral.
    assert 1.0 < abs(dutch[0]) < 2.5
    assert 0.05 < -dutch[0].real / abs(dutch[0]) < 0.5
    slow, quick = sorted(np.abs(roots[np.abs(roots.imag) < 0.1].real))
    assert quick > 2.0
    assert slow < 0.1


def test_roll_mode_s_closed_form() -> None:
    """With nothing but roll damping and ailerons, a step of aileron gives p = p_end (1 - exp(t/T)) (Nelson, 5.2)."""
    keep = {"Cl_p", "Cl_da"}
    derivatives = {n: d for n, d in AIRCRAFT.derivatives.items() if n[:2] not in side_flow.COEFFICIENTS or n in keep}
    level = AIRCRAFT.inertia.model_copy(update={"ixz": 0.0})
    quick = AIRCRAFT.aileron.model_copy(update={"time_constant": 0.002, "rate_limit": 100.0})
    aircraft = AIRCRAFT.model_copy(update={"derivatives": derivatives, "inertia": level, "aileron": quick})
    pulse = {"kind": "pulse", "surface": "aileron", "start": "0.5 s", "width": "9 s", "amplitude": "0.5 deg"}
    f = LateralSimulation(aircraft, flight(), inputs(pulse), hold=False).advance(400)
    pressure, v = f["dynamic_pressure"][0], f["airspeed"][0]
    span = aircraft.geometry.span
    turn = pressure * aircraft.geometry.wing_area * span / aircraft.inertia.ixx
    constant = -1 / (turn * aircraft.value("Cl_p") * span / (2 * v))
    end = turn * aircraft.value("Cl_da") * math.radians(0.5) * constant
    since = np.maximum(f["time"] - 0.502, 0.0)
    assert end < 0  # trailing edge of the right aileron down: to the left
    np.testing.assert_allclose(f["p"], end * (1 - np.exp(-since / constant)), atol=0.01 * abs(end))


def test_angular_momentum_is_kept_where_there_is_no_torque() -> None:
    """The equations alone, without air and thrust's moment, through another integrator; body spinning on all axes."""
    c = ac.constants(AIRCRAFT, 56.6, 762.0, hold=False)
    constants = six.lateral_constants(AIRCRAFT, hold=False)
    i = AIRCRAFT.inertia
    tensor = np.array([[i.ixx, 0.0, -i.ixz], [0.0, i.iyy, 0.0], [-i.ixz, 0.0, i.izz]])
    x, y = eq.trimmed_state(c, 0), np.zeros(six.SIZE)
    still = side_flow.SideAir(0.0, 0.0, 0.0, 0.0, 0.0)

    def rates(_: float, s: np.ndarray) -> np.ndarray:
        y[six.ROLL], x[eq.Q], y[six.YAW], y[six.BANK], x[eq.THETA], y[six.TURN] = s
        dx, dy = np.zeros_like(x), np.zeros(six.SIZE)
        no_air = eq.Flow(*np.zeros(len(eq.Flow._fields)))._replace(airspeed=50.0)
        six.add_lateral(c, constants, 0.0, six.Both(x, y), (0.0, 0.0), still, six.Both(dx, dy), no_air)
        return np.array([dy[six.ROLL], dx[eq.Q], dy[six.YAW], dy[six.BANK], dx[eq.THETA], dy[six.TURN]])

    def momentum(s: np.ndarray) -> np.ndarray:
        b, t, h = s[3:]
        roll = np.array([[1, 0, 0], [0, math.cos(b), -math.sin(b)], [0, math.sin(b), math.cos(b)]])
        pitch = np.array([[math.cos(t), 0, math.sin(t)], [0, 1, 0], [-math.sin(t), 0, math.cos(t)]])
        turn = np.array([[math.cos(h), -math.sin(h), 0], [math.sin(h), math.cos(h), 0], [0, 0, 1]])
        return turn @ pitch @ roll @ tensor @ s[:3]

    start = np.array([0.5, 0.2, -0.3, 0.1, 0.05, 0.0])
    end = solve_ivp(rates, (0.0, 3.0), start, rtol=1e-10, atol=1e-12).y[:, -1]
    assert np.abs(end[:3] - start[:3]).max() > 0.1  # it tumbles
    np.testing.assert_allclose(momentum(end), momentum(start), rtol=1e-7, atol=1e-4)
    energy = 0.5 * start[:3] @ tensor @ start[:3]
    assert 0.5 * end[:3] @ tensor @ end[:3] == pytest.approx(energy, rel=1e-8)


MIXED = (
    {"kind": "doublet", "surface": "rudder", "start": "1 s", "width": "1.2 s", "amplitude": "6 deg"},
    {"kind": "doublet", "surface": "aileron", "start": "4 s", "width": "1 s", "amplitude": "6 deg"},
    ELEVATOR,
)


def test_acceleration_attitude_and_way_agree() -> None:
    """Kinematics written again: what the accelerometers feel integrates to the velocity, the rates to the attitude."""
    f = LateralSimulation(AIRCRAFT, flight(gust_sigma="3 ft/s", heading="2 rad"), inputs(*MIXED)).advance(2000)
    b, t, h = f["phi"], f["theta"], f["psi"]
    sin_b, cos_b, sin_t, cos_t = np.sin(b), np.cos(b), np.sin(t), np.cos(t)
    down = G + f["az"] * cos_b * cos_t + f["ay"] * sin_b * cos_t - f["ax"] * sin_t
    level = f["ax"] * cos_t + (f["ay"] * sin_b + f["az"] * cos_b) * sin_t
    right = f["ay"] * cos_b - f["az"] * sin_b
    for name, rate in (
        ("v_down", down),
        ("v_north", level * np.cos(h) - right * np.sin(h)),
        ("v_east", level * np.sin(h) + right * np.cos(h)),
        ("phi", f["p"] + (f["q"] * sin_b + f["r"] * cos_b) * sin_t / cos_t),
        ("theta", f["q"] * cos_b - f["r"] * sin_b),
        ("psi", (f["q"] * sin_b + f["r"] * cos_b) / cos_t),
    ):
        made = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * DT)))
        moved = f[name] - f[name][0]
        # The trapezium's own error, at the steps of the surfaces.
        assert np.abs(moved - made).max() < 2e-4 * np.ptp(moved) + 1e-5, name
    north = np.gradient(f["latitude"], DT) * 6.3627e6
    np.testing.assert_allclose(north[1:-1], f["v_north"][1:-1], atol=0.05)


def test_accelerations_away_from_the_cg_follow_from_rigid_rotation() -> None:
    place = (1.7, 0.9, -0.4)
    cg, away = (LateralSimulation(AIRCRAFT, flight(), inputs(*MIXED), p).advance(1600) for p in ((0.0,) * 3, place))
    spin = np.stack([cg[n] for n in "pqr"], axis=1)
    turn = np.stack([cg[f"{n}dot"] for n in "pqr"], axis=1)
    r = np.broadcast_to(place, spin.shape)
    extra = np.cross(turn, r) + np.cross(spin, np.cross(spin, r))
    for i, name in enumerate(("ax", "ay", "az")):
        np.testing.assert_allclose(away[name] - cg[name], extra[:, i], atol=1e-12)
    assert np.abs(extra[:, 1]).max() > 0.1


def test_the_beta_vane_is_at_the_boom_and_the_signs_are_those_of_the_table() -> None:
    aircraft = AIRCRAFT.model_copy(
        update={"boom": AIRCRAFT.boom.model_copy(update={"vane_frequency": 45.0, "vane_damping": 0.7})}
    )
    rudder = {"kind": "pulse", "surface": "rudder", "start": "0.5 s", "width": "1.5 s", "amplitude": "3 deg"}
    f = LateralSimulation(aircraft, flight(), inputs(rudder), hold=False).advance(600)
    k = 200
    assert f["rudder"][k] > 0.03
    assert f["r"][k] < -0.01  # trailing edge left: yaws left
    assert f["beta"][k] > 0.002  # and slips to the right: wind in the right ear
    local = np.arcsin(np.sin(f["beta"]) + f["r"] * 5.3 / f["airspeed"])
    delay = 2 * 0.7 / (2 * math.pi * 45)
    np.testing.assert_allclose(np.interp(f["time"] + delay, f["time"], f["beta_vane"])[:-2], local[:-2], atol=2e-4)
    aileron = {**rudder, "surface": "aileron"}
    rolled = LateralSimulation(AIRCRAFT, flight(), inputs(aileron), hold=False).advance(400)
    assert rolled["phi"][-1] < -0.05  # right aileron down: rolls left


def test_the_pilot_keeps_wings_and_heading_in_turbulence() -> None:
    f = LateralSimulation(AIRCRAFT, flight(gust_sigma="5 ft/s"), inputs(*MIXED)).advance(60_000)
    assert np.abs(f["phi"]).max() < math.radians(25)
    assert np.abs(f["psi"]).max() < math.radians(25)
    assert np.abs(f["altitude"] - 762).max() < 120


def test_least_squares_on_a_flight_gives_the_lateral_table_back() -> None:
    sensors: dict[str, object] = {}
    flown = Card.model_validate({"name": "t", "aircraft": "a", "rig": "r", "manoeuvres": list(MIXED)})
    _, f = fly(AIRCRAFT, sensors, flown, 12.0)
    hat = AIRCRAFT.geometry.span / (2 * f["airspeed"])
    columns = np.stack([f["beta"], f["p"] * hat, f["r"] * hat, f["aileron"], f["rudder"]], axis=1)
    force = f["dynamic_pressure"] * AIRCRAFT.geometry.wing_area
    i = AIRCRAFT.inertia
    roll = i.ixx * f["pdot"] - i.ixz * (f["rdot"] + f["p"] * f["q"]) + (i.izz - i.iyy) * f["q"] * f["r"]
    yaw = i.izz * f["rdot"] - i.ixz * (f["pdot"] - f["q"] * f["r"]) + (i.iyy - i.ixx) * f["p"] * f["q"]
    moments = force * AIRCRAFT.geometry.span
    for name, values in (("CY", f["ay"] * i.mass / force), ("Cl", roll / moments), ("Cn", yaw / moments)):
        found = np.linalg.lstsq(columns, values, rcond=None)[0]
        wanted = [AIRCRAFT.value(f"{name}_{a}") for a in side_flow.ARGUMENTS]
        np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-9)


def test_an_aircraft_without_lateral_derivatives_is_refused() -> None:
    rudder = {"kind": "doublet", "surface": "rudder", "start": "1 s", "width": "1 s", "amplitude": "5 deg"}
    flown = Card.model_validate({"name": "t", "aircraft": "a", "rig": "r", "manoeuvres": [rudder]})
    with pytest.raises(ProfileError, match="lateral"):
        fly(load_aircraft("twin_otter_martos"), {}, flown, 1.0)
    heavy = AIRCRAFT.model_copy(update={"inertia": AIRCRAFT.inertia.model_copy(update={"izz": None})})
    with pytest.raises(ProfileError, match=r"inertia\.izz"):
        fly(heavy, {}, flown, 1.0)
    lopsided = AIRCRAFT.derivatives | {"Cn_0": AIRCRAFT.derivatives["Cn_r"]}
    with pytest.raises(ProfileError, match="Cn_0"):
        fly(AIRCRAFT.model_copy(update={"derivatives": lopsided}), {}, flown, 1.0)

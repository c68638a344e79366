"""Wind and inertial flow angles in a banked, slipping, pitching turn that is known in closed form."""

import numpy as np
import pytest

from station.conventions import G0, ned_from_body
from station.estimation.flight_record import FlightRecord
from station.model.inertial_path import air_velocity, inertial_path
from station.numerics.regression import NotIdentifiable
from station.profile import load_aircraft

DT = 0.02
POSITION = (5.3, 0.7, -0.9)
WIND = np.array([6.0, -4.0, 0.8])


def _attitude(t: np.ndarray) -> np.ndarray:
    """A turn at 35 deg of bank, rolling and pitching a little."""
    return np.column_stack(
        [0.6 + 0.1 * np.sin(0.7 * t), 0.08 + 0.04 * np.sin(1.3 * t + 0.4), 0.12 * t + 0.05 * np.sin(0.9 * t)]
    )


def _body_velocity(t: np.ndarray) -> np.ndarray:
    return np.column_stack([55 + np.sin(0.4 * t), 3.0 * np.sin(0.6 * t + 1), 3 + 1.5 * np.sin(1.3 * t)])


def _gust(t: np.ndarray) -> np.ndarray:
    """NED; whole periods in 40 s, so that its mean is 0."""
    turn = 2 * np.pi * t / 40
    return np.column_stack([0.5 * np.sin(9 * turn), 0.8 * np.sin(14 * turn + 1), 1.2 * np.sin(23 * turn)])


def _turn(gusts: float = 1.0) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Signals at the CG, the vane's at its place; truth. Derivatives by differences over 0.1 ms."""
    t = np.arange(round(40 / DT)) * DT
    h = 1e-4
    attitude = _attitude(t)
    euler = (_attitude(t + h) - _attitude(t - h)) / (2 * h)
    phi, theta = attitude[:, 0], attitude[:, 1]
    rates = np.column_stack(
        [
            euler[:, 0] - euler[:, 2] * np.sin(theta),
            euler[:, 1] * np.cos(phi) + euler[:, 2] * np.sin(phi) * np.cos(theta),
            -euler[:, 1] * np.sin(phi) + euler[:, 2] * np.cos(phi) * np.cos(theta),
        ]
    )

    def ground(at: np.ndarray) -> np.ndarray:
        turned = np.array([ned_from_body(*a) for a in _attitude(at)])
        return np.einsum("nij,nj->ni", turned, _body_velocity(at)) + WIND

    turned = np.array([ned_from_body(*a) for a in attitude])
    acceleration = (ground(t + h) - ground(t - h)) / (2 * h) - np.array([0.0, 0.0, G0])
    force = np.einsum("nij,ni->nj", turned, acceleration)
    velocity = ground(t)
    gust = gusts * _gust(t)
    air = np.einsum("nij,ni->nj", turned, velocity - WIND - gust)
    there = air + np.cross(rates, np.array(POSITION))
    speed, speed_there = np.linalg.norm(air, axis=1), np.linalg.norm(there, axis=1)
    signals = {
        **dict(zip(("p", "q", "r"), rates.T, strict=True)),
        **dict(zip(("ax", "ay", "az"), force.T, strict=True)),
        **dict(zip(("phi", "theta", "psi"), attitude.T, strict=True)),
        **dict(zip(("v_north", "v_east", "v_down"), velocity.T, strict=True)),
        "airspeed": speed,
        "alpha_vane": np.arctan2(there[:, 2], there[:, 0]),
        "beta_vane": np.arcsin(there[:, 1] / speed_there),
    }
    inertial = _body_velocity(t)
    truth = {
        "alpha": np.arctan2(air[:, 2], air[:, 0]),
        "beta": np.arcsin(air[:, 1] / speed),
        "alpha_inertial": np.arctan2(inertial[:, 2], inertial[:, 0]),
        "beta_inertial": np.arcsin(inertial[:, 1] / np.linalg.norm(inertial, axis=1)),
        "wind": WIND + gust,
    }
    return signals, truth


def test_attitude_and_velocity_give_the_whole_wind_vector_in_a_turn() -> None:
    signals, truth = _turn()
    path = inertial_path(signals, truth["alpha"], truth["beta"], DT)
    # Velocity over ground less velocity through the air (Martos 2013, equations 2-6, with the full rotation).
    air = air_velocity(signals["airspeed"], truth["alpha"], truth["beta"])
    found = path.velocity - np.einsum("nij,nj->ni", ned_from_body(*path.attitude.T), air)
    assert np.abs(found - truth["wind"]).max() < 0.02
    assert path.wind == pytest.approx(WIND, abs=0.01)
    assert np.abs(path.alpha - truth["alpha_inertial"]).max() < np.radians(0.03)
    assert np.abs(path.beta - truth["beta_inertial"]).max() < np.radians(0.03)


def test_coarse_and_noisy_streams_are_smoothed_without_delay() -> None:
    signals, truth = _turn()
    rng = np.random.default_rng(4)
    for name, sd in (("theta", 5e-4), ("phi", 5e-4), ("psi", 5e-4), ("v_down", 0.05), ("v_north", 0.05)):
        signals[name] = signals[name] + sd * rng.standard_normal(len(signals[name]))
    path = inertial_path(signals, truth["alpha"], truth["beta"], DT)
    raw = np.einsum(
        "nij,ni->nj",
        ned_from_body(*(signals[n] for n in ("phi", "theta", "psi"))),
        np.column_stack([signals[n] for n in ("v_north", "v_east", "v_down")]) - WIND,
    )
    unsmoothed = np.arctan2(raw[:, 2], raw[:, 0]) - truth["alpha_inertial"]
    assert np.std(path.alpha - truth["alpha_inertial"]) < 0.25 * np.std(unsmoothed)


def test_record_takes_a_vane_off_the_roll_axis_to_the_cg() -> None:
    signals, truth = _turn()
    aircraft = load_aircraft("twin_otter")
    assert aircraft.boom is not None
    place = {
        "vane_x": POSITION[0],
        "vane_y": POSITION[1],
        "vane_z": POSITION[2],
        "upwash_body": 0.0,
        "upwash_wing": 0.0,
    }
    aircraft = aircraft.model_copy(update={"boom": aircraft.boom.model_copy(update=place)})
    n = len(truth["alpha"])
    columns = {**signals, "elevator": np.zeros(n), "dynamic_pressure": 0.5 * 1.1 * signals["airspeed"] ** 2}
    record = FlightRecord.of(np.arange(n) * DT, columns, aircraft)
    # First order in the angles: the product of rate and angle is left out.
    assert np.std(record.alpha - truth["alpha"]) < np.radians(0.1)
    assert np.std(record.beta - truth["beta"]) < np.radians(0.1)


@pytest.mark.parametrize("missing", ["rows", "values"])
def test_a_heading_is_bridged_the_short_way_round(missing: str) -> None:
    """South, from 179.9 to -179.9 deg and back: what lies between is 180 deg, not 0."""
    n = 500
    t, psi = np.arange(n) * DT, np.radians(180.0 - 0.1 * (-1.0) ** (np.arange(n) // 3))
    psi = np.where(psi > np.pi, psi - 2 * np.pi, psi)
    columns = {m: np.zeros(n) for m in ("alpha_vane", "q", "ax", "theta", "elevator", "phi")}
    columns |= {
        "airspeed": np.full(n, 60.0),
        "az": np.full(n, -9.81),
        "dynamic_pressure": np.full(n, 1980.0),
        "psi": psi,
    }
    lost = np.arange(50, 450, 7)
    if missing == "rows":
        t, columns = np.delete(t, lost), {m: np.delete(x, lost) for m, x in columns.items()}
    else:
        columns["psi"][lost] = np.nan
    record = FlightRecord.of(t, columns, load_aircraft("twin_otter"))
    assert np.abs(np.cos(record.motion["psi"]) + 1).max() < 1e-5


def test_air_velocity_is_the_inverse_of_the_flow_angles() -> None:
    u = air_velocity(np.array([50.0]), np.array([0.2]), np.array([-0.1]))[0]
    assert np.linalg.norm(u) == pytest.approx(50.0)
    assert np.arctan2(u[2], u[0]) == pytest.approx(0.2)
    assert np.arcsin(u[1] / 50.0) == pytest.approx(-0.1)


def test_without_attitude_there_is_none() -> None:
    signals, truth = _turn()
    del signals["theta"]
    with pytest.raises(NotIdentifiable, match="no theta"):
        inertial_path(signals, truth["alpha"], truth["beta"], DT)

"""Instrument errors planted in a motion known in closed form, in simulated flights, and NASA's records."""

import math

import numpy as np
import pytest
from records import record
from scipy.signal import lsim

from station.convert.fdata import read_fdata
from station.model.compatibility import Compatibility, compatibility
from station.numerics.regression import NotIdentifiable
from station.profile import Card, Flight, Multisine, load_aircraft
from station.rows import ParamEstimate, Status
from station.simulation.sensors import STANDARD, Sensor
from station.simulation.sortie import fly

DT = 0.02
G0 = 9.80665
PLANTED = {
    "p_bias": 0.002,
    "q_bias": -0.003,
    "r_bias": 0.001,
    "ax_bias": 0.1,
    "ay_bias": -0.15,
    "az_bias": 0.2,
    "alpha_bias": 0.02,
    "alpha_scale": 1.12,
    "beta_bias": -0.01,
    "beta_scale": 0.9,
    "airspeed_scale": 1.03,
    "wind_north": 5.0,
    "wind_east": -3.0,
    "wind_down": 0.5,
}
NOISE = {
    **dict.fromkeys(("p", "q", "r"), 3e-4),
    **dict.fromkeys(("ax", "ay", "az"), 0.02),
    **dict.fromkeys(("alpha_vane", "beta_vane"), 8e-4),
    **dict.fromkeys(("phi", "theta", "psi"), 5e-4),
    **dict.fromkeys(("v_north", "v_east", "v_down"), 0.03),
    "airspeed": 0.1,
}


def _waves(t: np.ndarray, *terms: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """A sum of a sin(w t + c) and its derivative."""
    value = sum(a * np.sin(w * t + c) for a, w, c in terms)
    return np.asarray(value), np.asarray(sum(a * w * np.cos(w * t + c) for a, w, c in terms))


def closed_form(seconds: float = 30.0) -> dict[str, np.ndarray]:
    """Attitude and air velocity chosen freely as sines; rates and forces follow by differentiation by hand."""
    t = np.arange(round(seconds / DT)) * DT
    phi, phi_d = _waves(t, (0.4, 0.35, 0.0), (0.1, 1.7, 1.0))
    theta, theta_d = _waves(t, (0.1, 0.5, 0.3), (0.05, 2.1, 0.0))
    psi, psi_d = _waves(t, (0.5, 0.25, 0.0), (0.05, 1.1, 2.0))
    u, u_d = _waves(t, (4.0, 0.3, 0.2))
    v, v_d = _waves(t, (2.0, 0.6, 0.0), (0.8, 1.9, 1.0))
    w, w_d = _waves(t, (2.5, 0.45, 0.0), (1.0, 2.3, 0.5))
    u, w = u + 55.0, w + 3.0
    p = phi_d - psi_d * np.sin(theta)
    q = theta_d * np.cos(phi) + psi_d * np.sin(phi) * np.cos(theta)
    r = -theta_d * np.sin(phi) + psi_d * np.cos(phi) * np.cos(theta)
    speed = np.sqrt(u**2 + v**2 + w**2)
    north = np.array([np.cos(theta) * np.cos(psi), np.cos(theta) * np.sin(psi), -np.sin(theta)])
    side = np.array(
        [
            np.sin(phi) * np.sin(theta) * np.cos(psi) - np.cos(phi) * np.sin(psi),
            np.sin(phi) * np.sin(theta) * np.sin(psi) + np.cos(phi) * np.cos(psi),
            np.sin(phi) * np.cos(theta),
        ]
    )
    down = np.array(
        [
            np.cos(phi) * np.sin(theta) * np.cos(psi) + np.sin(phi) * np.sin(psi),
            np.cos(phi) * np.sin(theta) * np.sin(psi) - np.sin(phi) * np.cos(psi),
            np.cos(phi) * np.cos(theta),
        ]
    )
    ground = north * u + side * v + down * w
    return {
        "p": p,
        "q": q,
        "r": r,
        "ax": u_d + q * w - r * v + G0 * np.sin(theta),
        "ay": v_d + r * u - p * w - G0 * np.cos(theta) * np.sin(phi),
        "az": w_d + p * v - q * u - G0 * np.cos(theta) * np.cos(phi),
        "phi": phi,
        "theta": theta,
        "psi": psi,
        "airspeed": speed,
        "alpha_vane": np.arctan2(w, u),
        "beta_vane": np.arcsin(v / speed),
        "v_north": ground[0],
        "v_east": ground[1],
        "v_down": ground[2],
    }


def _spoilt(seed: int | None) -> dict[str, np.ndarray]:
    found = closed_form()
    for name, size in PLANTED.items():
        signal, _, kind = name.rpartition("_")
        vane = f"{signal}_vane" if signal in ("alpha", "beta") else signal
        if kind == "scale":
            found[vane] = found[vane] * size
    for name, size in PLANTED.items():
        signal, _, kind = name.rpartition("_")
        vane = f"{signal}_vane" if signal in ("alpha", "beta") else signal
        if kind == "bias":
            found[vane] = found[vane] + size
        elif signal == "wind":
            found[f"v_{kind}"] = found[f"v_{kind}"] + size
    if seed is not None:
        rng = np.random.default_rng(seed)
        for name, sd in NOISE.items():
            found[name] = found[name] + sd * rng.standard_normal(len(found[name]))
    return found


def _solve(motion: dict[str, np.ndarray]) -> Compatibility:
    return compatibility(motion, motion["alpha_vane"], motion.get("beta_vane"), DT)


def _named(made: Compatibility) -> dict[str, ParamEstimate]:
    return {e.name: e for e in made.parameters}


def test_errors_planted_in_a_closed_form_come_back() -> None:
    found = _named(_solve(_spoilt(None)))
    assert set(found) == set(PLANTED)
    for name, size in PLANTED.items():
        assert found[name].status is Status.ESTIMATED, name
        # Integration of straight lines between samples, and the priors, leave this much.
        assert found[name].value == pytest.approx(size, abs=max(2e-3 * abs(size), 4e-4)), name


def test_intervals_cover_the_planted_errors() -> None:
    inside = dict.fromkeys(PLANTED, 0)
    runs = 8
    for seed in range(runs):
        found = _named(_solve(_spoilt(seed)))
        for name, size in PLANTED.items():
            inside[name] += abs(found[name].value - size) < 1.96 * found[name].sd
    assert min(inside.values()) >= runs - 2, inside
    assert sum(inside.values()) >= 0.9 * runs * len(PLANTED), inside


def test_reconstructed_alpha_is_the_true_one() -> None:
    made = _solve(_spoilt(1))
    truth = closed_form()
    assert np.std(made.reconstructed["alpha"] - truth["alpha_vane"]) < 5e-4
    assert np.std(made.corrected["alpha"] - truth["alpha_vane"]) < 1.2 * NOISE["alpha_vane"] / 1.12
    assert made.residual_rms["alpha"] == pytest.approx(NOISE["alpha_vane"], rel=0.1)


def test_simulated_flight_with_planted_vane_and_accelerometer_errors() -> None:
    aircraft = load_aircraft("twin_otter")
    assert aircraft.boom is not None
    plain = {"upwash_body": 0.0, "upwash_wing": 0.0, "vane_frequency": 60.0, "vane_damping": 0.7, "vane_x": 0.0}
    aircraft = aircraft.model_copy(update={"boom": aircraft.boom.model_copy(update=plain)})
    sensors = {
        **STANDARD,
        "alpha_vane": Sensor(noise=9e-4, bias=0.015, gain=1.1),
        "az": Sensor(noise=0.04, bias=0.15),
        "q": Sensor(noise=5e-4, bias=0.002),
    }
    inputs = Multisine.model_validate({"kind": "multisine", "start": "1 s", "amplitude": "2 deg", "duration": "20 s"})
    card = Card(name="test", aircraft=aircraft.name, rig="", flight=Flight(), manoeuvres=(inputs,))
    shown, truth = fly(aircraft, sensors, card, 25.0, 3)
    made = compatibility(shown, shown["alpha_vane"], None, DT)
    found = _named(made)
    # Doing without what happens between samples leaves 0.2 mg.
    for name, size, left in (("alpha_scale", 1.1, 2e-3), ("az_bias", 0.15, 2e-3), ("q_bias", 0.002, 2e-5)):
        assert abs(found[name].value - size) < 3 * found[name].sd + left, name
        assert found[name].status is Status.ESTIMATED, name
    # A mean updraught would look the same as the vane's zero: with the vertical wind free only alpha's shape is told.
    difference = made.reconstructed["alpha"] - truth["alpha"]
    assert np.std(difference) < 1e-3


@pytest.mark.parametrize("name", ["totter_demo_data", "totter_pred_data", "totter_f1_017_data"])
def test_nasa_records_are_compatible(name: str) -> None:
    flown = read_fdata(record(f"twin_otter/{name}.mat"), load_aircraft("twin_otter"))
    motion = dict(flown.tracks[0].columns)
    made = compatibility(motion, motion["alpha_vane"], motion.get("beta_vane"), DT)
    found = _named(made)
    # A flight-test installation: the kinematics close within a fraction of a degree, biases are small.
    assert made.residual_rms["alpha"] < math.radians(0.25)
    assert made.residual_rms["theta"] < math.radians(0.25)
    assert made.residual_rms["airspeed"] < 0.5
    assert abs(found["q_bias"].value) < 0.01
    assert abs(found["az_bias"].value) < 0.6
    assert all(math.isfinite(e.value) and e.sd > 0 for e in made.parameters)
    # NASA had corrected the vanes: the one that moved reads the flow angle itself.
    scale = found["beta_scale" if "f1_017" in name else "alpha_scale"]
    assert abs(scale.value - 1) < 3 * scale.sd < 0.15


def test_a_slow_vane_is_told_apart_from_scales_and_wind() -> None:
    """The vane's dynamics by scipy's lsim, started on the first value; 2 Hz is slow beside this motion's 0.4 Hz."""
    motion, omega = _spoilt(5), 2 * math.pi * 2.0
    t = np.arange(len(motion["q"])) * DT
    system = ([omega**2], [1.0, omega, omega**2])
    for name in ("alpha_vane", "beta_vane"):
        angle = _spoilt(None)[name]
        noise = motion[name] - angle
        motion[name] = lsim(system, angle - angle[0], t)[1] + angle[0] + noise
    found = _named(compatibility(motion, motion["alpha_vane"], motion["beta_vane"], DT, (2.0, 0.5)))
    off = {name: abs(found[name].value - size) / found[name].sd for name, size in PLANTED.items()}
    assert max(off.values()) < 3.5, off  # of 14
    # Not told of the vane, the residuals hold its lag: 22 times the error.
    assert _named(_solve(motion))["alpha_scale"].sd > 5 * found["alpha_scale"].sd


def test_the_scale_of_an_angle_that_is_noise_alone_is_unestimated() -> None:
    """Integrated noise of ay and r moves the modelled sideslip, which nothing measured answers."""
    motion, rng = closed_form(60.0), np.random.default_rng(7)
    n = len(motion["q"])
    for name in ("p", "r", "ay", "phi", "psi", "v_east"):
        motion[name] = np.zeros(n)
    # Wings level and straight: the equations of u, w and theta are left, with v = phi = psi = 0.
    t = np.arange(n) * DT
    theta, q = _waves(t, (0.1, 0.5, 0.3), (0.05, 2.1, 0.0))
    (u, u_d), (w, w_d) = _waves(t, (4.0, 0.3, 0.2)), _waves(t, (2.5, 0.45, 0.0), (1.0, 2.3, 0.5))
    u, w = u + 55.0, w + 3.0
    motion |= {"theta": theta, "q": q, "ax": u_d + q * w + G0 * np.sin(theta), "az": w_d - q * u - G0 * np.cos(theta)}
    motion |= {"airspeed": np.hypot(u, w), "alpha_vane": np.arctan2(w, u)}
    motion |= {"v_north": u * np.cos(theta) + w * np.sin(theta), "v_down": -u * np.sin(theta) + w * np.cos(theta)}
    for name, sd in NOISE.items():
        motion[name] = motion[name] + (3.0 if name in ("r", "ay") else 1.0) * sd * rng.standard_normal(n)
    motion["beta_vane"] = NOISE["beta_vane"] * rng.standard_normal(n)
    found = _named(_solve(motion))
    assert found["beta_scale"].status is Status.UNESTIMATED
    assert "hardly moves beyond its noise" in found["beta_scale"].why
    assert found["beta_bias"].status is Status.ESTIMATED
    assert found["alpha_scale"].status is Status.ESTIMATED
    # In a steady sideslip what is not told of the scale passes for a bias.
    motion["beta_vane"] = motion["beta_vane"] + 0.1
    assert _named(_solve(motion))["beta_bias"].status is Status.UNESTIMATED


def test_what_the_record_does_not_tell_is_unestimated() -> None:
    n = 500
    steady = {name: np.zeros(n) for name in ("p", "q", "r", "ay", "phi", "psi", "beta_vane")}
    steady |= {"airspeed": np.full(n, 50.0), "theta": np.full(n, 0.05), "alpha_vane": np.full(n, 0.05)}
    steady |= {"ax": np.full(n, G0 * math.sin(0.05)), "az": np.full(n, -G0 * math.cos(0.05))}
    found = _named(_solve(steady))
    assert found["alpha_scale"].status is Status.UNESTIMATED
    assert "not identifiable" in found["alpha_scale"].why


def test_refusals() -> None:
    motion = closed_form(10.0)
    with pytest.raises(NotIdentifiable, match="needs 3 to 120 s"):
        _solve({name: c[:100] for name, c in motion.items()})
    gap = {name: c.copy() for name, c in motion.items()}
    gap["q"][100:200] = np.nan
    with pytest.raises(NotIdentifiable, match="no q throughout"):
        _solve(gap)

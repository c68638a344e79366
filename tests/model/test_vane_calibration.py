"""A vane's zero, scale and delay planted in simulated flights, and in signals made by hand."""

import numpy as np
import pytest

from station.model.inertial_path import inertial_path
from station.model.vane_calibration import VaneCalibration, calibrate_vane
from station.numerics.regression import NotIdentifiable
from station.profile import Card, Doublet, Flight, load_aircraft
from station.simulation.sensors import STANDARD, Sensor
from station.simulation.sortie import fly

DT = 0.02
ZERO, SCALE, LATENCY, NOISE = 0.03, 1.15, 0.04, 0.0009
DOUBLETS = Doublet.model_validate(
    {"kind": "doublet", "start": "5 s", "amplitude": "3.5 deg", "width": "0.8 s", "repeat": "15 s"}
)
VANE_LAG = 2 * 0.7 / (2 * np.pi * 60)


def _flown(seed: int, sigma: str) -> VaneCalibration:
    """A vane without upwash, fast, whose electronics are off by ZERO, SCALE and LATENCY."""
    aircraft = load_aircraft("twin_otter")
    assert aircraft.boom is not None
    plain = {"upwash_body": 0.0, "upwash_wing": 0.0, "vane_frequency": 60.0, "vane_damping": 0.7}
    aircraft = aircraft.model_copy(update={"boom": aircraft.boom.model_copy(update=plain)})
    sensors = {**STANDARD, "alpha_vane": Sensor(noise=NOISE, bias=ZERO, gain=SCALE, latency=LATENCY)}
    flight = Flight.model_validate({"gust_sigma": sigma, "seed": seed})
    card = Card(name="test", aircraft=aircraft.name, rig="", flight=flight, manoeuvres=(DOUBLETS,))
    shown, _ = fly(aircraft, sensors, card, 60.0, seed)
    path = inertial_path(shown, shown["alpha_vane"], shown["beta_vane"], DT, wind_down=0.0)
    return calibrate_vane(shown["alpha_vane"], path.alpha, shown["q"] * 5.3 / path.speed, DT)


def test_calm_air_gives_it_all_within_its_errors() -> None:
    for seed in range(4):
        made = _flown(seed, "0 ft/s")
        assert made.is_calm
        assert abs(made.scale.value - SCALE) < 3 * made.scale.sd < 0.01
        assert abs(made.delay.value - LATENCY - VANE_LAG) < 3 * made.delay.sd + 1e-3
        assert made.delay.sd < 0.002
        assert abs(made.bias.value - ZERO) < 4 * made.bias.sd < 0.001
        assert made.rms_after < 2 * NOISE
        assert made.rms_before > 0.03


def test_gusts_widen_the_errors_and_do_not_take_the_scale_down() -> None:
    found = [_flown(seed, "5 ft/s") for seed in range(5)]
    assert not any(made.is_calm for made in found)
    for made in found:
        assert abs(made.scale.value - SCALE) < 3 * made.scale.sd
        assert abs(made.delay.value - LATENCY - VANE_LAG) < 4 * made.delay.sd
    # Ordinary least squares would say 0.24 here: the aircraft flies with the gust.
    assert abs(np.mean([made.scale.value for made in found]) - SCALE) < 0.12


def _sweep(n: int = 3000) -> np.ndarray:
    t = np.arange(n) * DT
    return 0.05 * np.sin(0.8 * t + 0.05 * t**2)


@pytest.mark.parametrize("delay", [-0.08, 0.0, 0.13])
def test_exact_numbers_come_back(delay: float) -> None:
    t = np.arange(3000) * DT
    reading = -0.02 + 0.8 * 0.05 * np.sin(0.8 * (t - delay) + 0.05 * (t - delay) ** 2)
    made = calibrate_vane(reading, _sweep(), np.zeros(3000), DT)
    assert made.bias.value == pytest.approx(-0.02, abs=1e-6)
    assert made.scale.value == pytest.approx(0.8, rel=1e-4)
    assert made.delay.value == pytest.approx(delay, abs=1e-5)
    assert made.r2 == pytest.approx(1.0, abs=1e-5)


def test_errors_cover_in_coloured_noise() -> None:
    rng = np.random.default_rng(3)
    inside = 0
    for _ in range(40):
        noise = np.zeros(3000)
        for k in range(1, 3000):
            noise[k] = 0.95 * noise[k - 1] + 0.001 * rng.standard_normal()
        made = calibrate_vane(0.01 + 1.1 * _sweep() + noise, _sweep(), np.zeros(3000), DT)
        inside += abs(made.scale.value - 1.1) < 1.96 * made.scale.sd
    assert inside >= 34


def test_what_cannot_be_calibrated_is_refused() -> None:
    flat = np.zeros(1000)
    with pytest.raises(NotIdentifiable, match="hardly moves"):
        calibrate_vane(flat, flat, flat, DT)
    with pytest.raises(NotIdentifiable, match="needs 10 s"):
        calibrate_vane(flat[:100], flat[:100], flat[:100], DT)
    broken = _sweep(1000)
    broken[5] = np.nan
    with pytest.raises(NotIdentifiable, match="missing"):
        calibrate_vane(broken, broken, flat, DT)

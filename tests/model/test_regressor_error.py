"""What wrong regressors do to the estimates: against least squares on regressors that are wrong."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from station.model import regressor_error as wrong
from station.numerics.spectra import grid

SPEED = 56.6
HALF, LEAD, ARM = 1.0, 5.3, 7.5
FREQUENCIES = grid(0.1, 2.0, 0.04)
S = 2j * np.pi * FREQUENCIES
TO_CG, TO_TAIL = LEAD / SPEED, ARM / SPEED
Kind = Callable[[np.ndarray, np.ndarray, np.ndarray, float], tuple[np.ndarray, np.ndarray]]
THETA = np.array([[5.7, 12.0, 0.6, 0.8], [-1.1, -39.0, -1.8, -3.0]])


def fitted(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Complex least squares with real parameters."""
    columns, target = np.concatenate([x.real, x.imag], axis=1).T, np.concatenate([z.real, z.imag])
    return np.linalg.lstsq(columns, target)[0]


def mean_wind(a: np.ndarray, g: np.ndarray, pitch: np.ndarray, e: float) -> tuple[np.ndarray, np.ndarray]:
    """Angle of attack and d, true and used; the inertial speed is wrong by a share e."""
    inertial = a + e * (a - pitch)
    boom = a + g * np.exp(S * TO_CG) - inertial
    used = inertial + boom * np.exp(-S * TO_CG), boom * np.exp(-S * TO_CG) * (1 - np.exp(-S * TO_TAIL))
    return np.array([a + g, g * (1 - np.exp(-S * TO_TAIL))]), np.array(used)


def headwind(a: np.ndarray, g: np.ndarray, _: np.ndarray, e: float) -> tuple[np.ndarray, np.ndarray]:
    """A headwind gust of a share e: motion makes less of an angle, and delays by the airspeed are too short."""
    boom = -e * a + g * np.exp(S * TO_CG * (1 + e))
    used = a + boom * np.exp(-S * TO_CG), boom * np.exp(-S * TO_CG) * (1 - np.exp(-S * TO_TAIL))
    return np.array([(1 - e) * a + g, g * (1 - np.exp(-S * TO_TAIL * (1 + e)))]), np.array(used)


def through_the_vane(a: np.ndarray, g: np.ndarray, pitch: np.ndarray, shown: Kind) -> tuple[np.ndarray, np.ndarray]:
    """Angle of attack and d, true and used, of a vane as `shown` for the motion, its q and the gust."""
    q = pitch * S
    boom = shown(a, q, g) - (a - q * TO_CG)
    used = a + boom * np.exp(-S * TO_CG), boom * np.exp(-S * TO_CG) * (1 - np.exp(-S * TO_TAIL))
    return np.array([a + g, g * (1 - np.exp(-S * TO_TAIL))]), np.array(used)


def scale(a: np.ndarray, g: np.ndarray, pitch: np.ndarray, e: float) -> tuple[np.ndarray, np.ndarray]:
    return through_the_vane(a, g, pitch, lambda a, q, g: (1 + e) * (a - q * TO_CG + g * np.exp(S * TO_CG)))


def delay(a: np.ndarray, g: np.ndarray, pitch: np.ndarray, e: float) -> tuple[np.ndarray, np.ndarray]:
    return through_the_vane(a, g, pitch, lambda a, q, g: np.exp(-S * e) * (a - q * TO_CG + g * np.exp(S * TO_CG)))


def lead(a: np.ndarray, g: np.ndarray, pitch: np.ndarray, e: float) -> tuple[np.ndarray, np.ndarray]:
    return through_the_vane(a, g, pitch, lambda a, q, g: a - q * (TO_CG + e) + g * np.exp(S * (TO_CG + e)))


@pytest.mark.parametrize(("kinds", "sd"), [((mean_wind, headwind), 0.0), ((scale, delay, lead), 1.0)])
def test_a_wrong_wind_or_vane_moves_the_estimates_as_least_squares_on_wrong_regressors_do(
    kinds: tuple[Kind, ...], sd: float
) -> None:
    """Two segments, the first closed. The share is so small that its square does not count."""
    e = 1e-8
    rng = np.random.default_rng(5)
    made = wrong.no_weights(len(S))
    about = wrong.Lengths(HALF, LEAD, ARM, 0.0)
    wrong.weights(about, SPEED, FREQUENCIES, wrong.Deviations(0.0, 0.0, 0.0, sd, sd, sd), made)
    past = np.zeros(wrong.SUMS)
    normal = np.zeros((4, 4))
    all_used: list[list[np.ndarray]] = [[] for _ in kinds]
    all_true: list[list[np.ndarray]] = [[] for _ in kinds]
    for close in (True, False):
        a, g, qhat, de = rng.normal(size=(4, len(S))) + 1j * rng.normal(size=(4, len(S)))
        pitch = qhat * SPEED / HALF / S
        x = np.array([a + g, qhat, de, g * (1 - np.exp(-S * TO_TAIL))])
        normal += (x.conj() @ x.T).real
        out = wrong.standard_deviations(made, 1.0, 1.0 - sd, x, THETA, np.linalg.inv(normal), past, close)
        for k, kind in enumerate(kinds):
            true, used = kind(a, g, pitch, e)
            all_true[k].append(np.array([true[0], qhat, de, true[1]]))
            all_used[k].append(np.array([used[0], qhat, de, used[1]]))
    for equation in range(2):
        found = [
            (fitted(np.hstack(used), THETA[equation] @ np.hstack(true)) - THETA[equation])[:3] / e
            for used, true in zip(all_used, all_true, strict=True)
        ]
        assert out[equation] == pytest.approx(np.linalg.norm(found, axis=0), rel=1e-4)


def test_gusts_seen_too_late_move_the_estimates_as_least_squares_on_late_gusts_do() -> None:
    """A vane 2 m behind the CG with a lag of 12 ms; two segments, the first closed."""
    behind, lag = 2.0, 0.012
    rng = np.random.default_rng(7)
    made = wrong.no_weights(len(S))
    about = wrong.Lengths(HALF, -behind, ARM, lag)
    wrong.weights(about, SPEED, FREQUENCIES, wrong.Deviations(*(0.0,) * 6), made)
    past = np.zeros(wrong.SUMS)
    normal = np.zeros((4, 4))
    seen, met = [], []
    for close in (True, False):
        a, g, qhat, de = rng.normal(size=(4, len(S))) + 1j * rng.normal(size=(4, len(S)))
        step, late = 1 - np.exp(-S * TO_TAIL), np.exp(-S * (lag + behind / SPEED))
        seen.append(np.array([a + g * late, qhat, de, g * late * step]))
        met.append(np.array([a + g, qhat, de, g * step]))
        normal += (seen[-1].conj() @ seen[-1].T).real
        out = wrong.standard_deviations(made, 1.0, 0.0, seen[-1], THETA, np.linalg.inv(normal), past, close)
    for equation in range(2):
        found = fitted(np.hstack(seen), THETA[equation] @ np.hstack(met)) - THETA[equation]
        assert out[equation] == pytest.approx(np.abs(found[:3]), rel=1e-9)


def test_noise_of_the_sensors_takes_off_what_it_takes_off_on_average() -> None:
    dt, n, late = 0.02, 1500, 7
    rng = np.random.default_rng(6)
    vane, pitch_rate, elevator = 0.02, 0.03, 0.02
    made = wrong.no_weights(len(S))
    about = wrong.Lengths(HALF, LEAD, late * dt * SPEED, 0.0)
    wrong.weights(about, SPEED, FREQUENCIES, wrong.Deviations(vane, pitch_rate, elevator, 0.0, 0.0, 0.0), made)
    turn = np.exp(-np.outer(np.arange(n) * dt, S))
    clean = 6 * (rng.normal(size=(4, len(S))) + 1j * rng.normal(size=(4, len(S)))) * np.array([[1], [0.1], [1], [1]])
    z = THETA[1] @ clean
    draws = []
    for _ in range(300):
        v = vane * rng.normal(size=n + late)
        own = (v[late:], HALF / SPEED * pitch_rate * rng.normal(size=n), elevator * rng.normal(size=n))
        x = clean + np.array([*own, v[late:] - v[:-late]]) @ turn
        draws.append(fitted(x, z) - THETA[1])
    normal = (clean.conj() @ clean.T).real + n * made.noise
    past = np.zeros(wrong.SUMS)
    out = wrong.standard_deviations(made, n, 0.0, clean, THETA, np.linalg.inv(normal), past, False)
    off, sd = np.mean(draws, axis=0)[:3], np.std(draws, axis=0)[:3] / np.sqrt(len(draws))
    # Three standard errors of the mean; the next order is a tenth of the first.
    assert np.all(np.abs(np.abs(off) - out[1]) < 3 * sd + 0.1 * out[1])
    assert np.all(out[1][[0, 2]] > 5 * sd[[0, 2]])


def test_a_longer_record_knows_its_wind_better() -> None:
    assert wrong.wind_share(1.5, 50.0, 30.0) == pytest.approx(0.03)
    assert wrong.wind_share(1.5, 50.0, 240.0) == pytest.approx(0.015)

"""Lags, scales and zeros planted in a motion known in closed form, and those that real records are known to have."""

from __future__ import annotations

import numpy as np
import pytest
from real_records import ATTAS_BOOM, attas, dasmat, phlab

from station.conventions import unit_named
from station.model.instrument_lags import Solution, solve
from station.numerics.regression import NotIdentifiable

G0 = 9.80665


def si(columns: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], float]:
    """Signals in SI without the surfaces, and their step."""
    made = {}
    for title, column in columns.items():
        name, unit = title.rstrip("]").split(" [")
        known = unit_named(unit)
        assert known is not None
        made[name] = known.factor * column
    time = made.pop("time")
    for name in ("elevator", "aileron", "rudder", "air_temperature"):
        made.pop(name, None)
    return made, float(np.median(np.diff(time)))


def solved(columns: dict[str, np.ndarray], arm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Solution:
    motion, dt = si(columns)
    return solve(motion, dt, arm, [slice(0, len(motion["q"]))])


def closed_form(
    rng: np.random.Generator, rate_hz: float, gust: float = 0.0, vane_s: float = 0.30
) -> dict[str, np.ndarray]:
    """A longitudinal flight whose every signal is a function of time: pitch and flow angle sums of sines, speed and
    path by the laws of motion. `gust`: standard deviation of a first-order vertical gust in the vane, m/s."""
    t = np.arange(0.0, 60.0, 1 / rate_hz)
    fine = np.arange(0.0, 60.0, 1e-3)
    speed = 60.0
    terms = [(0.05, 0.11, 0.3), (0.03, 0.29, 1.1), (0.02, 0.53, 2.0), (0.01, 0.87, 0.4)]

    def waves(shares: tuple[float, ...], shift: float, order: int = 0) -> np.ndarray:
        total = np.zeros(len(fine))
        for share, (a, f, phase) in zip(shares, terms, strict=True):
            w = 2 * np.pi * f
            total += share * a * w**order * np.sin(w * fine + phase + shift + order * np.pi / 2)
        return total

    theta, q = 0.05 + waves((1, 1, 1, 1), 0.0), waves((1, 1, 1, 1), 0.0, 1)
    alpha, alpha_dot = 0.05 + waves((0.2, 0.5, 0.7, 0.8), -0.5), waves((0.2, 0.5, 0.7, 0.8), -0.5, 1)
    u, w = speed * np.cos(alpha), speed * np.sin(alpha)
    ax = -speed * np.sin(alpha) * alpha_dot + q * w + G0 * np.sin(theta)
    az = speed * np.cos(alpha) * alpha_dot - q * u - G0 * np.cos(theta)
    v_down = -speed * np.sin(theta - alpha)
    true = {"theta": theta, "q": q, "ax": ax, "az": az, "alpha_vane": alpha, "v_down": v_down}
    made = {"time": t, "airspeed": np.full(len(t), speed)}
    late = {"q": 0.012, "alpha_vane": vane_s, "v_down": 0.85}
    for name, x in true.items():
        # The sample of a fine grid that lies a lag ago.
        made[name] = np.interp(t - late.get(name, 0.0), fine, x)
    made["q"] = 1.03 * made["q"] + 0.004
    made["az"] = made["az"] + 0.08
    made["alpha_vane"] = 0.95 * made["alpha_vane"]
    if gust:
        noise = np.zeros(len(t))
        keep = np.exp(-1 / (rate_hz * 3.0))
        for k in range(1, len(t)):
            noise[k] = keep * noise[k - 1] + np.sqrt(1 - keep**2) * rng.standard_normal()
        made["alpha_vane"] = made["alpha_vane"] + 0.95 * gust * noise / speed
    for name, sd in {"q": 3e-4, "theta": 3e-4, "az": 0.03, "ax": 0.02, "alpha_vane": 5e-4, "v_down": 0.05}.items():
        made[name] = made[name] + sd * rng.standard_normal(len(t))
    return made


PLANTED = {
    ("q", "lag"): 0.012, ("q", "scale"): 1.03, ("q", "zero"): 0.004, ("az", "zero"): 0.08, ("az", "scale"): 1.0,
    ("alpha_vane", "lag"): 0.30, ("alpha_vane", "scale"): 0.95, ("v_down", "lag"): 0.85, ("v_down", "scale"): 1.0,
}  # fmt: skip


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 25.0, 50.0])
@pytest.mark.parametrize("v_down", [True, False])
def test_planted_errors_are_found_at_any_rate_and_without_v_down(rate_hz: float, v_down: bool) -> None:
    made = closed_form(np.random.default_rng(3), rate_hz)
    motion = {n: x for n, x in made.items() if n != "time" and (v_down or n != "v_down")}
    found = solve(motion, 1 / rate_hz, (0.0, 0.0, 0.0), [slice(0, len(made["time"]))])
    for key, truth in PLANTED.items():
        if key[0] in motion:
            value = found.values[key]
            assert not value.why, key
            # Nine of them in eight cases: 3.3 standard deviations are 1 in 1000 each.
            assert abs(value.value - truth) < 3.3 * value.sd, (key, value)
    assert found.values["q", "lag"].sd < 0.002
    assert found.values["alpha_vane", "lag"].sd < 0.02


def rolling(rng: np.random.Generator, lag_s: float) -> dict[str, np.ndarray]:
    """Attitude and rates of an aircraft that rolls and yaws and hardly pitches, r late; most of its pitch rate is what
    the heading's rate makes in a bank."""
    fine = np.arange(0.0, 60.0, 1e-3)

    def waves(*terms: tuple[float, float]) -> np.ndarray:
        phases = rng.uniform(0, 2 * np.pi, len(terms))
        parts = [a * np.sin(2 * np.pi * f * fine + p) for (a, f), p in zip(terms, phases, strict=True)]
        return np.asarray(np.sum(parts, axis=0))

    phi = waves((0.25, 0.11), (0.15, 0.31), (0.08, 0.67))
    theta, psi = waves((0.004, 0.13), (0.001, 0.53)), waves((0.3, 0.05), (0.06, 0.23), (0.03, 0.59), (0.01, 0.97))
    phi_dot, theta_dot, psi_dot = (np.gradient(x, 1e-3) for x in (phi, theta, psi))
    exact = {
        "theta": theta, "phi": phi, "psi": psi, "p": phi_dot - psi_dot * np.sin(theta),
        "q": theta_dot * np.cos(phi) + psi_dot * np.sin(phi) * np.cos(theta),
        "r": np.interp(fine - lag_s, fine, psi_dot * np.cos(phi) * np.cos(theta) - theta_dot * np.sin(phi)),
    }  # fmt: skip
    t = np.arange(0.0, 60.0, 0.02)
    return {n: np.interp(t, fine, x) + 1e-4 * rng.standard_normal(len(t)) for n, x in exact.items()}


def test_a_late_yaw_rate_goes_with_the_bank_of_its_motion() -> None:
    """In theta' = q cos(phi) - r sin(phi) the bank is that of the motion, not that of when r is read."""
    for seed in range(3):
        motion = rolling(np.random.default_rng(seed), 0.05)
        found = solve(motion, 0.02, (0.0, 0.0, 0.0), [slice(0, len(motion["q"]))])
        for key, truth in ((("q", "scale"), 1.0), (("r", "scale"), 1.0), (("r", "lag"), 0.05), (("q", "lag"), 0.0)):
            value = found.values[key]
            assert not value.why, key
            # Twelve of them: 3.3 standard deviations are 1 in 1000 each.
            assert abs(value.value - truth) < 3.3 * value.sd, (key, value)
        # With the bank of when r is read it comes out 7 to 14 ms wrong.
        assert found.values["r", "lag"].value == pytest.approx(0.05, abs=0.005)


def in_one_plane(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """A flight along north, by Newton's law on a fine grid: the vane 5 m ahead reads 0.5 deg too much, 0.06 s late and
    1.15 times; the accelerometer along the body 1.05 times. Nothing else is wrong."""
    fine = np.arange(0.0, 60.0, 1e-3)

    def waves(level: float, *terms: tuple[float, float]) -> np.ndarray:
        phases = rng.uniform(0, 2 * np.pi, len(terms))
        parts = [a * np.sin(2 * np.pi * f * fine + p) for (a, f), p in zip(terms, phases, strict=True)]
        return level + np.sum(parts, axis=0)

    theta = waves(0.08, (0.05, 0.06), (0.03, 0.29), (0.02, 0.53), (0.01, 0.87))
    alpha = waves(0.06, (0.01, 0.05), (0.02, 0.33), (0.015, 0.61), (0.008, 0.97))
    speed = waves(60.0, (1.5, 0.04), (0.5, 0.17), (0.1, 0.4))
    u, w, q = speed * np.cos(alpha), speed * np.sin(alpha), np.gradient(theta, 1e-3)
    path = theta - alpha
    vane = np.arctan2(w - 5.0 * q, u)
    exact = {
        "airspeed": speed, "theta": theta, "q": q, "v_north": speed * np.cos(path), "v_down": -speed * np.sin(path),
        "ax": 1.05 * (np.gradient(u, 1e-3) + q * w + G0 * np.sin(theta)),
        "az": np.gradient(w, 1e-3) - q * u - G0 * np.cos(theta),
        "alpha_vane": 1.15 * np.interp(fine - 0.06, fine, vane) + 0.0087,
    }  # fmt: skip
    noise = {"airspeed": 0.05, "v_north": 0.03, "v_down": 0.03, "ax": 0.02, "az": 0.03}
    made = {n: x[::40] + noise.get(n, 3e-4) * rng.standard_normal(len(fine[::40])) for n, x in exact.items()}
    still = np.zeros(len(fine[::40]))
    return made | {"psi": still, "phi": still, "v_east": still}


def test_accelerometer_and_airspeed_in_a_flight_in_one_plane() -> None:
    """The path over ground shows the accelerometer's scale though the heading never moves, and an airspeed without lag
    gets none from a vane that is ahead, late and out of line."""
    lags, scales = [], []
    for seed in range(5):
        motion = in_one_plane(np.random.default_rng(seed))
        found = solve(motion, 0.04, (5.0, 0.0, 0.0), [slice(0, len(motion["q"]))], upwash=1.15)
        lags.append(found.values["airspeed", "lag"])
        scales.append(found.values["ax", "scale"])
    assert not any(v.why for v in (*lags, *scales))
    assert max(v.sd for v in scales) < 0.02
    # Of 10 values at 95 % more than 3 outside are 1 in 1000.
    outside = sum(abs(v.value) > 1.96 * v.sd for v in lags) + sum(abs(v.value - 1.05) > 1.96 * v.sd for v in scales)
    assert outside <= 3, (lags, scales)


@pytest.mark.slow
def test_intervals_hold_in_gusts_that_the_vane_alone_shows() -> None:
    """Gusts up to 1 m/s in the vane, motion free of them: 95 % intervals hold 88 to 100 % of 20 flights."""
    held: dict[tuple[str, str], int] = dict.fromkeys(PLANTED, 0)
    flights = 20
    for seed in range(flights):
        rng = np.random.default_rng(seed)
        made = closed_form(rng, 10.0, gust=float(rng.uniform(0.2, 1.0)))
        motion = {n: x for n, x in made.items() if n != "time"}
        found = solve(motion, 0.1, (0.0, 0.0, 0.0), [slice(0, len(made["time"]))])
        for key, truth in PLANTED.items():
            value = found.values[key]
            held[key] += abs(value.value - truth) < 1.96 * value.sd
    # Of 20 draws at 95 % fewer than 16 are 1 in 400.
    assert min(held.values()) >= 16, held


def test_the_gust_that_the_vane_shows_is_measured() -> None:
    """First-order gust of 1 m/s and 3 s: between 0.1 and 2 Hz lies the share (2/pi) (atan 37.7 - atan 1.885)."""
    levels = []
    for seed in range(8):
        made = closed_form(np.random.default_rng(seed), 10.0, gust=1.0, vane_s=0.02)
        motion = {n: x for n, x in made.items() if n != "time"}
        levels.append(solve(motion, 0.1, (0.0, 0.0, 0.0), [slice(0, len(made["time"]))]).gust_sd)
    inside = np.sqrt((2 / np.pi) * (np.arctan(2 * np.pi * 2.0 * 3.0) - np.arctan(2 * np.pi * 0.1 * 3.0)))
    # A minute holds 60 s / 3 s = 20 independent gusts: 16 % each, 6 % of eight, at 95 % 12 %.
    assert abs(np.mean(levels) / inside - 1) < 0.12, levels


def test_without_an_attitude_nothing_is_told() -> None:
    made = closed_form(np.random.default_rng(1), 10.0)
    made.pop("theta")
    with pytest.raises((NotIdentifiable, KeyError)):
        solve({n: x for n, x in made.items() if n != "time"}, 0.1, (0.0, 0.0, 0.0), [slice(0, 600)])


@pytest.mark.parametrize("name", [pytest.param("fAttasElv1", marks=pytest.mark.slow), "fAttasElv2"])
def test_attas(name: str) -> None:
    """Published zeros of the book's test case 22; lag and scale by independent fits: 12 ms, 1.02 to 1.04."""
    found = solved(attas(name), ATTAS_BOOM).values
    lag, scale = found["q", "lag"], found["q", "scale"]
    assert abs(lag.value - 0.012) < 0.003
    assert lag.value - 1.96 * lag.sd < 0.012 < lag.value + 1.96 * lag.sd
    assert 1.02 < scale.value < 1.04
    for key, published in ((("q", "zero"), 3.409e-3), (("az", "zero"), 0.0840)):
        assert abs(found[key].value - published) < 1.96 * found[key].sd, key


@pytest.mark.slow
def test_attas_gyro_lag_is_that_of_its_repeat() -> None:
    first, again = (solved(attas(n), ATTAS_BOOM).values["q", "lag"] for n in ("fAttasElv1", "fAttasElv2"))
    assert abs(first.value - again.value) < 1.96 * np.hypot(first.sd, again.sd)


@pytest.mark.parametrize(
    ("name", "until"), [pytest.param("fAttasElv2", np.inf, marks=pytest.mark.slow), ("fAttasAilRud1", 29.9)]
)
def test_attas_rolls_in_time(name: str, until: float) -> None:
    """Gyros and attitude are one unit, its pitch rate 12 ms late (the test above), the others half a sample from that
    at most. What the weight does sideways had made the roll angle 294 ms early where nobody rolled, and 106 ms late
    where nobody pitched, and all others with it."""
    columns = attas(name)
    there = columns["time [s]"] <= until
    found = solved({n: x[there] for n, x in columns.items()}, ATTAS_BOOM).values
    late = {i: v for (i, kind), v in found.items() if kind == "lag" and i in ("p", "q", "r", "phi") and not v.why}
    assert "p" in late
    assert "phi" not in late
    for i, v in late.items():
        assert abs(v.value - 0.012) < max(3 * v.sd, 0.01), (i, v)


@pytest.mark.slow
def test_dasmat_has_no_lag() -> None:
    """A foreign simulation without instruments: nothing stands out, with noise laid over it either."""
    for noise in (0.0, 1.0):
        found = solved(dasmat("de3211_1", noise)).values
        told = {i: v for (i, kind), v in found.items() if kind == "lag" and not v.why}
        assert {"q", "alpha_vane", "v_down"} <= told.keys()
        for i, v in told.items():
            # Without noise the intervals are of rounding: a tenth of a sample is no lag.
            assert abs(v.value) < max(3.0 * v.sd, 1e-3), (noise, i, v)


PHLAB_TURBULENT = {(4419.0, 4479.0): 1.02, (534.0, 594.0): 0.58, (4284.0, 4344.0): 0.46}
PHLAB_CALM = ((849.0, 909.0), (909.0, 969.0), (1689.0, 1749.0), (4029.0, 4089.0))


@pytest.mark.parametrize(
    ("span", "level"),
    [pytest.param(*x, marks=[pytest.mark.slow] * (k > 0)) for k, x in enumerate(PHLAB_TURBULENT.items())],
)
def test_phlab_gusts(span: tuple[float, float], level: float) -> None:
    assert abs(solved(phlab(*span)).gust_sd / level - 1) < 0.2


@pytest.mark.parametrize("span", [PHLAB_CALM[0], *(pytest.param(x, marks=pytest.mark.slow) for x in PHLAB_CALM[1:])])
def test_phlab_calm(span: tuple[float, float]) -> None:
    assert solved(phlab(*span)).gust_sd < 0.08

"""Gusts along the path, spans that meet gusts one strip after the other, air data's noise, zeros that wander."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from blind import Case, aircraft, fly_case, prepared
from scipy import signal, special, stats

from station.diagnosis.air_data_noise import air_noise, noise_alone
from station.diagnosis.manoeuvre import SLOW_SHARE, manoeuvre
from station.diagnosis.measured_record import Record
from station.diagnosis.processing import SLOW_S, Setting, bridge_of, own_speed, slow_spectrum
from station.diagnosis.recorded_noise import GUST_SCALE_M, RECORDED_THRUST, lasting_gust
from station.diagnosis.series_spectra import Spectra
from station.diagnosis.span_lags import span_response
from station.diagnosis.variances import ZERO_DOF, ZERO_SD, Levels, prior_levels, wandering
from tests.second_simulation.air import STEP, noise

SPEED, DENSITY = 52.0, 1.0


def test_a_gust_along_the_path_is_no_motion_of_the_aircraft() -> None:
    """Airspeed holds motion and gust; the acceleration shows the motion, with a zero that tilts its integral."""
    dt, n = 0.02, 3000
    s = Setting(dt, n, bridge_of(dt, n), (0,), (0.0, 0.0, 0.0), 0.0, 0.0, False, {})
    t = dt * np.arange(n)
    motion = 1.5 * np.sin(0.9 * t) + 0.05 * t
    gust = 0.8 * np.sin(2 * math.pi * 0.4 * t) + 0.4 * np.sin(2 * math.pi * 1.3 * t + 1.0)
    tilted = motion - motion[0] + 0.03 * t
    inner = slice(500, -500)
    found = own_speed(SPEED + motion + gust, tilted, s)
    assert np.std((found - SPEED - motion)[inner]) < 0.02 * np.std(gust)
    np.testing.assert_allclose(own_speed(SPEED + motion, motion, s), SPEED + motion, atol=1e-9)


@pytest.mark.parametrize("shape", [1.0, 0.5, 0.2])
@pytest.mark.parametrize("cut", [0.0, 0.15, 0.4])
def test_a_span_follows_gusts_by_the_transform_of_its_lags(shape: float, cut: float) -> None:
    """Of a gamma distribution, or where it ends of a beta distribution of the same mean and variance: characteristic
    function by quadrature of the density of scipy."""
    length, wave = 3.0, np.array([0.0, 0.05, 0.2, 0.6])
    lags = stats.gamma(1 / shape, scale=length * shape)
    if cut:
        a = (1 + cut) / shape - cut
        lags = stats.beta(a, a * (1 - cut) / cut, scale=length / cut)
    np.testing.assert_allclose((lags.mean(), lags.var()), (length, shape * (1 - cut) / (1 + cut) * length**2))
    middle = lags.ppf((np.arange(200_000) + 0.5) / 200_000)
    by_sum = np.exp(-1j * wave[:, None] * middle).mean(1)
    np.testing.assert_allclose(span_response(length, shape, cut, wave), by_sum, atol=1e-4)


def test_even_strips_and_an_elliptic_loading_are_met_exactly() -> None:
    """Lags that end at twice their mean: sin x / x and 2 J1(x) / x of the mean's phase."""
    length, wave = 8.0, np.linspace(0.01, 0.7, 50)
    x = wave * length
    strips, ellipse = (np.exp(-1j * x) * f for f in (np.sinc(x / np.pi), 2 * special.j1(x) / x))
    np.testing.assert_allclose(span_response(length, 1.0, 0.5, wave), strips, atol=1e-9)
    np.testing.assert_allclose(span_response(length, 0.75, 0.5, wave), ellipse, atol=1e-9)


def flight(alike: float, speed: float, pressure: float) -> Record:
    rng = np.random.default_rng(8)
    n = 3000
    both = alike * rng.standard_normal(n)
    q = 0.5 * DENSITY * (SPEED + both) ** 2 + pressure * rng.standard_normal(n)
    signals = {"airspeed": SPEED + both + speed * rng.standard_normal(n), "dynamic_pressure": q}
    return Record("noisy", 0.02, 0.0, signals, DENSITY, 1000.0)


@pytest.mark.parametrize(("alike", "speed", "pressure"), [(0.2, 0.03, 1.5), (0.02, 0.2, 10.0), (0.15, 0.15, 8.0)])
def test_what_airspeed_and_dynamic_pressure_show_alike_is_told_from_their_own(
    alike: float, speed: float, pressure: float
) -> None:
    """Each level within a fifth, or where it is small beside the others, small."""
    found = air_noise(flight(alike, speed, pressure))
    drawn = {"pitot": alike, "airspeed": speed, "dynamic_pressure": pressure}
    per = {"pitot": 1.0, "airspeed": 1.0, "dynamic_pressure": DENSITY * SPEED}
    most = max(x / per[name] for name, x in drawn.items())
    for name, x in drawn.items():
        assert found[name] / per[name] == pytest.approx(x / per[name], rel=0.2, abs=0.25 * most), name


def test_each_one_s_noise_is_told_by_what_the_other_does_not_show() -> None:
    """At 25 Hz, where samples tell nothing, in the mean of 20 minutes in gusts: the root of each one's spectrum within
    a sixth, of an airspeed whose noise is slow, and of a pressure whose noise is white and three times as strong as of
    good instruments."""
    dt, n, told = 0.04, 1500, []
    decay, drawn = math.exp(-dt / SLOW_S), {"airspeed": (0.1, 0.3), "dynamic_pressure": (15.0, 0.0)}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        white = rng.standard_normal((4, n))
        gust = signal.lfilter([math.sqrt(1 - 0.98**2)], [1.0, -0.98], white[0])
        slow = 0.3 * signal.lfilter([math.sqrt(1 - decay**2)], [1.0, -decay], white[1])
        q = 0.5 * DENSITY * (SPEED + gust) ** 2 + 15.0 * white[3]
        signals = {"airspeed": SPEED + gust + slow + 0.1 * white[2], "dynamic_pressure": q}
        record = Record("noisy", dt, 0.0, signals, DENSITY, 1000.0)
        told.append([noise_alone(record, record)[name] for name in drawn])
    f = np.array([0.3, 1.0, 2.5])
    shapes = np.stack([np.ones(3), slow_spectrum(f, dt)])
    found = np.sqrt(np.mean(told, axis=0) @ shapes) / np.sqrt(np.square(list(drawn.values())) @ shapes)
    there = np.array([[True, True, True], [False, True, True]])  # at 0.3 Hz gusts are a hundred times the pressure's
    np.testing.assert_allclose(found[there], 1.0, atol=1 / 6)


@pytest.mark.parametrize(("own", "both"), [(0.3, 0.0), (0.05, 0.4)])
def test_slow_noise_of_the_airspeed_alone_is_what_the_dynamic_pressure_does_not_show(own: float, both: float) -> None:
    """Autoregressive noise of the slow part's correlation time, laid on a recorded flight: its variance within a third,
    whatever the two show alike."""
    record = fly_case(Case(seed=993, fit_on=("doublets",)), "doublets", 0)
    decay = math.exp(-record.dt / SLOW_S)
    shocks = math.sqrt(1 - decay**2) * np.random.default_rng(12).standard_normal((2, record.n))
    alone, alike = signal.lfilter([1.0], [1.0, -decay], shocks) * np.array([[own], [both]])
    x = record.signals
    speed = x["airspeed"] + alike
    pressure = x["dynamic_pressure"] * (speed / x["airspeed"]) ** 2
    laid = replace(record, signals={**x, "airspeed": speed + alone, "dynamic_pressure": pressure})
    made = manoeuvre(laid, aircraft())
    at, n = made.trim.sensors.index("airspeed"), len(made.trim.sensors)
    slope = 2 * float(pressure.mean() / speed.mean())
    slow = prior_levels([made]).noise[0, n:]
    told = slow[at] + slow[made.trim.sensors.index("dynamic_pressure")] / slope**2
    assert told == pytest.approx(own**2, rel=1 / 3, abs=0.1**2)


@pytest.mark.parametrize("moves", [False, True])
def test_thrust_is_as_noisy_as_its_samples_show_and_no_more_than_it_moves(moves: bool) -> None:
    """White noise within a tenth. A tenth of what nothing states, on a thrust that does not move, leaves no slow noise
    either: were there more, to scale the thrust up would explain whatever the accelerometer shows. On one that moves
    much, slow noise is what any thrust's is."""
    record = fly_case(Case(seed=993, fit_on=("doublets",)), "doublets", 0)
    trim = float(record.signals["thrust"].mean())
    sd = 0.1 * RECORDED_THRUST * trim
    t = np.arange(record.n) * record.dt
    thrust = trim * (1 + (0.2 * np.sign(np.sin(2 * np.pi * 0.1 * t)) if moves else 0.0))
    laid = thrust + sd * np.random.default_rng(13).standard_normal(record.n)
    made = manoeuvre(replace(record, signals={**record.signals, "thrust": laid}), aircraft())
    at, n = made.trim.sensors.index("thrust"), len(made.trim.sensors)
    white, slow = prior_levels([made]).noise[0, [at, n + at]]
    assert math.sqrt(white) == pytest.approx(sd * made.thinner, rel=0.1)
    if moves:
        assert slow == pytest.approx(SLOW_SHARE * (RECORDED_THRUST * laid.mean()) ** 2)
    else:
        assert slow < 0.2 * sd**2


def test_a_zero_wanders_as_far_as_manoeuvres_disagree() -> None:
    """Where noise is nothing beside it, the mode of a scaled inverse chi-squared has a closed form. What manoeuvres
    have in common is none of it."""
    seconds, rates = 40.0, (5.6e-3, 4.6e-3)
    here = SimpleNamespace(
        setting=SimpleNamespace(judged=(0, 1, 3)),
        of_zeros=np.array([seconds**2, seconds**2, 1.0]),
        steady_variances=lambda *_: np.full(3, 1e-12),
    )
    prior = np.square(ZERO_SD)
    levels = Levels(np.ones((2, 2)), np.ones(2), np.ones(5), prior)
    shown = [Spectra(np.empty((3, 0), dtype=complex), np.array([seconds * x, 0.0, 0.0])) for x in rates]
    found = wandering([here, here], shown, levels)
    disagree = np.array([2 * 5e-4**2, 0.0, 0.0, 0.0])
    count = np.array([1, 1, 0, 1])
    np.testing.assert_allclose(found, (ZERO_DOF * prior + disagree) / (ZERO_DOF + count), rtol=0.01)
    np.testing.assert_allclose(wandering([here], shown[:1], levels), prior)


@pytest.mark.parametrize("seconds", [15.0, 45.0])
def test_the_mean_of_gusts_along_the_path_is_as_uncertain_as_their_strength_lets_expect(seconds: float) -> None:
    """400 draws of Dryden's spectrum by the second simulation: means over their own standard deviation expected, which
    is itself of each short draw."""
    rng, speed = np.random.default_rng(7), 55.0
    count = round(speed * seconds / STEP)
    squares, expected = [], []
    for _ in range(400):
        gust = noise(rng, "dryden", "along", 3.0, GUST_SCALE_M, 12 * count)[:count]
        there = np.interp(np.arange(0, seconds, 0.05) * speed, STEP * np.arange(count), gust)
        signals = {"airspeed": speed + there, "v_along": np.full(len(there), speed)}
        made = Record("gusts", 0.05, 0.0, signals | {"q": there}, DENSITY, 0.0, ())
        squares.append(float(np.mean(there)) ** 2)
        expected.append(lasting_gust(made) ** 2)
    # Of 400 squares of a normal variable: sqrt(2/400) is 7 %.
    assert np.mean(squares) == pytest.approx(np.mean(expected), rel=0.21)
    del signals["v_along"]
    assert lasting_gust(Record("no ground speed", 0.05, 0.0, signals, DENSITY, 0.0, ())) == 0.0


def test_a_vanes_zero_does_not_follow_the_airspeed() -> None:
    """A gust is a velocity, and its angle less where the air comes faster; a zero taken for such a gust would be told
    by how gusts along the path act (by a tenth of the moment for 1.1 deg), and by whatever the model misses of that."""
    still = aircraft()
    assert still.boom is not None
    off = still.model_copy(update={"boom": still.boom.model_copy(update={"zero": still.boom.zero + 0.02})})
    for m in prepared(Case(1003, 1.52, {})):
        before = m.differences(still)
        row = m.axis.series.index("moment")
        change = m.differences(off).minus(before).bins[row]
        assert np.linalg.norm(change) < 1e-3 * np.linalg.norm(before.bins[row])

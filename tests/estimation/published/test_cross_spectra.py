"""Measured delay, coherence and upwash of the vane: against scipy's own estimator, signals of known delay and gain, and
another simulation's delays."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from station.conventions import SIGNALS, TICK_NS
from station.estimation.flight_record import FlightRecord
from station.estimation.methods import Estimator
from station.estimation.published.cross_spectra import VaneSpectra, measure, vane_spectra
from station.numerics.cross_spectrum import cross_spectra
from station.numerics.regression import NotIdentifiable
from station.profile import Boom, Card, Doublet, Flight, load_aircraft, load_rig
from station.rows import Frame, UsageError
from station.simulation.sortie import fly

DT, BAND = 0.02, (0.1, 2.0)
SPEED, ARM, UPWASH, ASPECT = 60.0, 5.3, 0.1765, 10.05
RATIO = UPWASH * (ASPECT + 2) / ASPECT / (2 * math.pi)
"""k0/n that makes the upwash UPWASH where S_G is A/(A + 2)."""


def coloured(n, seed):
    """Gust-like noise: first order, 0.3 Hz."""
    rng = np.random.default_rng(seed)
    return signal.lfilter([1.0], [1.0, -math.exp(-2 * math.pi * 0.3 * DT)], rng.normal(size=n))


def through(x, response):
    """x (n,) through a frequency response, circularly."""
    f = np.fft.rfftfreq(len(x), DT)
    return np.fft.irfft(np.fft.rfft(x) * response(f), len(x))


def spectra_of(angle, lift, usable=None):
    usable = np.ones(len(angle), dtype=bool) if usable is None else usable
    return vane_spectra(angle, lift, usable, DT, upwash=UPWASH, aspect_ratio=ASPECT, band_hz=BAND)


@pytest.mark.parametrize("segment", [512, 511])
def test_spectra_are_those_of_scipy(segment):
    x = coloured(6000, 1)
    y = through(x, lambda f: 3 * np.exp(-0.4j * f)) + np.random.default_rng(2).normal(size=6000)
    found = cross_spectra(x, y, np.ones(6000, dtype=bool), DT, segment)
    options = {"fs": 1 / DT, "window": "hann", "nperseg": segment, "noverlap": segment // 2}
    frequencies, xy = signal.csd(x, y, **options)
    np.testing.assert_allclose(found.frequencies_hz, frequencies, atol=1e-12)
    np.testing.assert_allclose(found.xy, xy, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.xx, signal.welch(x, **options)[1], rtol=1e-9, atol=1e-12)
    # At zero frequency there is nothing but the window's leakage of the mean.
    coherence = np.abs(found.xy[1:]) ** 2 / (found.xx[1:] * found.yy[1:])
    np.testing.assert_allclose(coherence, signal.coherence(x, y, **options)[1][1:], rtol=1e-9)


def test_segments_with_missing_rows_are_excluded():
    x, y = coloured(4096, 3), coloured(4096, 4)
    usable = np.ones(4096, dtype=bool)
    usable[1100] = False
    x[1100] = np.nan
    found = cross_spectra(x, y, usable, DT, 512)
    # Of the 15 segments, every 256 rows, those from 768 and from 1024 hold row 1100.
    assert found.segments == 13
    assert np.isfinite(found.xy).all()


@pytest.mark.parametrize("delay", [0.08, -0.05])
def test_a_known_delay_gain_and_coherence_are_found(delay):
    """Positive: the lift comes after the vane, as cpsd's phase in the dissertation's Appendix 3 has it."""
    n = 20000
    angle = coloured(n, 5)
    clean = through(angle, lambda f: 4.5 * np.exp(-2j * np.pi * f * delay))
    noise = coloured(n, 7)
    lift = clean + 0.2 * noise * clean.std() / noise.std()
    found = spectra_of(angle, lift)
    inside = (found.frequencies_hz > 0.2) & (found.frequencies_hz < 4.0)
    off = (found.delay_s - delay)[inside] / found.delay_sd[inside]
    assert np.sqrt(np.mean(off**2)) < 2.0
    at, _ = found.at(np.array([0.5, 1.0, 2.0]))
    np.testing.assert_allclose(at, delay, atol=0.01)
    # Noise of the same colour and a fifth of the amplitude: 1/(1 + 1/25) at every frequency.
    assert np.mean(found.coherence[inside]) == pytest.approx(0.962, abs=0.01)


def test_the_response_of_the_lift_and_the_upwash_that_follows_it():
    """A gust f at the vane lifts with 2 pi S later, and its lift's upwash is in the vane: f + k0/n CL."""
    gust = coloured(20000, 8)

    def lift_of(f):
        falling = 0.8 / np.sqrt(1 + 0.3 * f)
        return 2 * math.pi * falling * np.exp(-2j * np.pi * f * ARM / SPEED)

    lift = through(gust, lift_of)
    found = spectra_of(gust + RATIO * lift, lift)
    f = found.frequencies_hz
    inside = (f > 0.15) & (f < 5.0)
    wanted = 0.8 / np.sqrt(1 + 0.3 * f)
    np.testing.assert_allclose(found.sears[inside], wanted[inside], rtol=0.03)
    _, upwash = found.at(np.array([0.5, 2.0]))
    steady = ASPECT / (ASPECT + 2)
    np.testing.assert_allclose(upwash, UPWASH * 0.8 / np.sqrt(1 + 0.3 * np.array([0.5, 2.0])) / steady, rtol=0.03)


def test_short_or_incoherent_records_are_refused():
    x, y = coloured(9000, 9), coloured(9000, 10)
    with pytest.raises(NotIdentifiable, match=r"coherent in \d+% of 0.1 to 2 Hz"):
        spectra_of(x, y)
    with pytest.raises(NotIdentifiable, match=r"30\.0 s are too short to measure spectra: needs 40 s"):
        spectra_of(x[:1500], x[:1500])
    usable = np.ones(9000, dtype=bool)
    usable[::400] = False
    with pytest.raises(NotIdentifiable, match="gaps leave 0 of 7 segments"):
        spectra_of(x, x, usable)


def flown(aircraft, manoeuvres, seconds, seed, sigma="5 ft/s"):
    rig = load_rig("bench")
    flight = Flight(speed="110 kt", altitude="2500 ft", gust_sigma=sigma)
    card = Card(name="t", aircraft="t", rig="bench", flight=flight, manoeuvres=manoeuvres)
    shown, _ = fly(aircraft, rig, card, seconds, seed)
    shown.pop("qdot", None)
    return card, rig, shown


def test_delays_in_turbulence_are_those_of_another_simulation():
    """Gusts alone, set A: -4, 17, 36, 57, 77, 91 and 97 ms from 0.35 to 3 Hz by a simulation not written here."""
    aircraft = load_aircraft("twin_otter_martos")
    _, rig, shown = flown(aircraft, (), 400.0, 3)
    t = np.arange(len(shown["q"])) * DT
    record = FlightRecord.of(t, shown, aircraft, imu_position=rig.imu_position)
    delay, _ = measure(record, BAND).at(np.array([0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0]))
    np.testing.assert_allclose(1000 * delay, [-4, 17, 36, 57, 77, 91, 97], atol=12)


def frames(columns):
    n = len(columns["q"])
    table = np.full((n, len(SIGNALS)), math.nan)
    for i, name in enumerate(SIGNALS):
        if name in columns:
            table[:, i] = columns[name]
    ages = np.where(np.isfinite(table), 0.0, math.nan).tolist()
    quality = np.where(np.isfinite(table), 0, 3).tolist()
    rows = zip(table.tolist(), ages, quality, strict=True)
    return [Frame(k * TICK_NS, k, tuple(v), tuple(a), tuple(m)) for k, (v, a, m) in enumerate(rows)]


def test_a_vane_distorted_as_the_spectra_say_is_corrected():
    """The vane early by 0.06 s at 0.1 Hz and 0.12 s at 2 Hz, and 30 and 10 % too large: IV finds what II finds with the
    vane before that."""
    aircraft = load_aircraft("twin_otter")
    doublets = tuple(Doublet(kind="doublet", start=f"{s} s", amplitude="3.5 deg", width="0.9 s") for s in (25, 40))
    card, rig, shown = flown(aircraft, doublets, 70.0, 4, "0 ft/s")
    true = shown["alpha_vane"] * aircraft.boom.steady_calibration
    true += shown["q"] * aircraft.boom.vane_x / shown["airspeed"]
    nothing = aircraft.model_copy(update={"boom": Boom(vane_x="0 m")})
    f = np.geomspace(0.05, 10.0, 40)
    delay = np.interp(np.log(f), np.log([0.1, 2.0]), [0.06, 0.12])
    upwash = np.interp(np.log(f), np.log([0.1, 2.0]), [0.3, 0.1])
    ones = np.ones(len(f))
    spectra = VaneSpectra(f, delay, 0 * ones, ones, ones, 0 * ones, upwash, ones > 0, 10, 40.0)
    slow = np.minimum(np.maximum(np.fft.rfftfreq(len(true), DT), 0.05), 10.0)
    late, more = spectra.at(slow)
    turn = np.exp(2j * np.pi * np.fft.rfftfreq(len(true), DT) * late) * (1 + more)
    turn[0] = 1.0
    mean = true.mean()
    early = np.fft.irfft(np.fft.rfft(true - mean) * turn, len(true)) + mean

    def last(vane, method, given):
        columns = {k: v for k, v in shown.items() if k not in ("theta", "phi", "v_down")} | {"alpha_vane": vane}
        estimator = Estimator(nothing, card, rig.imu_position, None, (method,), force=True, spectra=given)
        found = ()
        for frame in frames(columns):
            _, found = estimator.step(frame)
        return np.array([p.value for p in found[0].parameters])

    wanted = last(true, "II", None)
    without = last(early, "II", None)
    assert abs(without[0] / wanted[0] - 1) > 0.05
    # Transforms of the two segments, not of the circular record: a delay moves what lies at their ends.
    np.testing.assert_allclose(last(early, "IV", spectra)[[0, 3, 4, 5]], wanted[[0, 3, 4, 5]], rtol=0.02)


def test_method_iv_needs_spectra():
    with pytest.raises(UsageError, match="IV needs spectra"):
        Estimator(load_aircraft("twin_otter"), Card(name="t", aircraft="t", rig=""), methods=("IV",))

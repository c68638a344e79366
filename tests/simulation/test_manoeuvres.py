"""Test inputs: shapes by hand, and what makes a multisine good."""

from __future__ import annotations

import math

import numpy as np
import pytest

from station.profile import Doublet, Multisine, Pulse, Sweep, ThreeTwoOneOne
from station.rows import ProfileError
from station.simulation.manoeuvres import elevator_input, surface_input
from station.simulation.multisine import harmonics_between, wave

DEG = math.pi / 180


def make(kind: type, **keys: object):
    names = {Doublet: "doublet", ThreeTwoOneOne: "3-2-1-1", Multisine: "multisine", Pulse: "pulse", Sweep: "sweep"}
    return kind.model_validate({"kind": names[kind], "start": "1 s", "amplitude": "2 deg", **keys})


def sampled(m, until: float, rate: float = 100.0) -> np.ndarray:
    return elevator_input([m], np.arange(round(until * rate)) / rate) / DEG


def runs(x: np.ndarray, rate: float = 100.0) -> list[tuple[float, float]]:
    """(level, seconds) of each constant stretch."""
    edges = np.flatnonzero(np.diff(x)) + 1
    return [(round(float(piece[0]), 9), len(piece) / rate) for piece in np.split(x, edges)]


def test_doublet_goes_trailing_edge_down_first() -> None:
    assert runs(sampled(make(Doublet, width="0.5 s"), 4)) == [(0, 1), (2, 0.5), (-2, 0.5), (0, 2)]
    assert runs(sampled(make(Doublet, width="0.5 s", amplitude="-2 deg"), 4))[1] == (-2, 0.5)


def test_three_two_one_one_and_pulse() -> None:
    wanted = [(0, 1), (2, 0.9), (-2, 0.6), (2, 0.3), (-2, 0.3), (0, 0.9)]
    assert runs(sampled(make(ThreeTwoOneOne, unit="0.3 s"), 4)) == wanted
    assert runs(sampled(make(Pulse, width="0.7 s"), 3)) == [(0, 1), (2, 0.7), (0, 1.3)]


def test_repeat_and_overlap() -> None:
    one = make(Pulse, width="1 s", repeat="3 s")
    assert runs(sampled(one, 9)) == [(0, 1), (2, 1), (0, 2), (2, 1), (0, 2), (2, 1), (0, 1)]
    two = elevator_input([one, one], np.array([1.5])) / DEG
    assert two[0] == pytest.approx(4.0)


def test_sweep_runs_from_low_to_high() -> None:
    x = sampled(make(Sweep, duration="20 s", low="0.2 Hz", high="2 Hz"), 22, 1000)
    crossings = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0)) / 1000 - 1
    assert np.abs(x).max() == pytest.approx(2.0, abs=1e-6)
    for t, period in zip(0.5 * (crossings[:-1] + crossings[1:]), np.diff(crossings), strict=True):
        assert 1 / period == pytest.approx(0.2 + 1.8 * t / 20, rel=0.08)


@pytest.mark.parametrize(("duration", "low", "high"), [(10, 0.1, 2.0), (30, 0.1, 2.0), (20, 0.2, 1.5), (8, 0.3, 2.0)])
def test_multisine_is_flat_peaks_low_and_is_orthogonal(duration: float, low: float, high: float) -> None:
    m = make(Multisine, duration=f"{duration} s", low=f"{low} Hz", high=f"{high} Hz")
    n = duration * 200
    x = elevator_input([m], 1.0 + np.arange(n) / 200)
    assert np.ptp(x) / (2 * math.sqrt(2) * x.std()) <= 1.15
    assert np.abs(x).max() == pytest.approx(2 * DEG, rel=1e-3)
    assert abs(x[0]) < 1e-12
    spectrum = np.abs(np.fft.rfft(x)) / n
    harmonics = np.arange(math.ceil(low * duration), math.floor(high * duration) + 1)
    np.testing.assert_allclose(spectrum[harmonics], spectrum[harmonics[0]], rtol=1e-9)
    assert np.delete(spectrum, harmonics).max() < 1e-12

    made = wave(harmonics_between(duration, low, high))
    t = np.arange(n) / 200
    pairs = zip(made.harmonics, made.phases, strict=True)
    parts = np.array([np.sin(2 * math.pi * k / duration * t + p) for k, p in pairs])
    gram = parts @ parts.T / (n / 2)
    assert np.abs(gram - np.eye(len(parts))).max() < 1e-12


def test_multisine_without_a_harmonic_in_its_band() -> None:
    with pytest.raises(ProfileError, match="no harmonic"):
        sampled(make(Multisine, duration="2 s", low="0.1 Hz", high="0.4 Hz"), 2)


SURFACES = ("elevator", "aileron", "rudder")


@pytest.mark.parametrize("duration", [10, 15, 20, 30, 60])
def test_multisines_that_begin_together_are_orthogonal_and_peak_low(duration: float) -> None:
    """Three surfaces, 0.1 to 2 Hz, over one period at 50 Hz, as an autopilot flies the table."""
    three = [make(Multisine, duration=f"{duration} s", surface=s) for s in SURFACES]
    t = 1.0 + np.arange(duration * 50) / 50
    x = np.array([surface_input(three, t, s) for s in SURFACES])
    assert np.abs(np.corrcoef(x) - np.eye(3)).max() < 1e-12
    assert np.all(np.ptp(x, axis=1) / (2 * math.sqrt(2) * x.std(axis=1)) <= 1.15)
    assert np.abs(x[:, 0]).max() < 1e-12
    # All that one alone would have is flown, by one of them.
    lines = [set(np.flatnonzero(np.abs(np.fft.rfft(row)) > 1e-9 * len(t)).tolist()) for row in x]
    assert set().union(*lines) == set(harmonics_between(duration, 0.1, 2.0))
    assert sum(map(len, lines)) == len(set().union(*lines))


def test_multisines_share_only_what_both_want_and_only_when_they_begin_together() -> None:
    t = 1.0 + np.arange(500) / 50
    slow = make(Multisine, duration="10 s", high="1 Hz")
    fast = make(Multisine, duration="10 s", surface="rudder", low="1.1 Hz")
    late = make(Multisine, duration="10 s", surface="rudder", start="12 s", high="1 Hz")
    alone = elevator_input([slow], t)
    assert np.array_equal(elevator_input([slow, fast], t), alone)
    assert np.array_equal(elevator_input([slow, late], t), alone)
    with pytest.raises(ProfileError, match="2 harmonics for 3 inputs"):
        surface_input([make(Multisine, duration="2 s", high="1 Hz", surface=s) for s in SURFACES], t, "aileron")

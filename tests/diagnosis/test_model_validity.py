"""Where a model holds: noise fails nowhere, a planted failure where it was planted, and beyond the envelope nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from station.diagnosis.model_validity import (
    LEAST_S,
    Misfit,
    edges_of,
    independent_share,
    validity,
    validity_json,
    validity_lines,
)
from station.diagnosis.validity_pages import validity_page

DT = 0.02


def coloured(rng: np.random.Generator, n: int, decay: float) -> np.ndarray:
    """First-order autoregressive noise of variance 1."""
    drawn = rng.standard_normal(n + 200) * math.sqrt(1 - decay**2)
    return np.asarray(lfilter([1.0], [1.0, -decay], drawn)[200:])


def manoeuvre(seed: int, stalls: bool = False) -> Misfit:
    rng = np.random.default_rng(seed)
    t = DT * np.arange(2250)
    alpha = np.radians(3 + 4 * np.sin(0.4 * t + seed) + 2 * np.sin(1.1 * t))
    lift, moment = coloured(rng, len(t), 0.8), coloured(rng, len(t), 0.8)
    if stalls:
        lift = lift - 6.0 * np.maximum(np.degrees(alpha) - 6.0, 0.0)
    speed = 60 + 6 * np.sin(0.2 * t + seed)
    return Misfit(f"flight{seed}", DT, alpha, speed, np.radians(-2 + 3 * np.sin(0.9 * t)), lift, moment)


def test_noise_fails_in_no_box() -> None:
    """A level of 0.1 % for all boxes together: of 60 sound flights none (chance of one: 6 %; seeded)."""
    failing = [validity([manoeuvre(3 * k), manoeuvre(3 * k + 1), manoeuvre(3 * k + 2)]).failing for k in range(60)]
    assert sum(map(bool, failing)) == 0


def test_a_stall_fails_where_it_is_and_nowhere_else() -> None:
    """Lift breaks at 6 deg: boxes that end at or below hold, those from 8 deg on fail, and the moment holds."""
    found = validity([manoeuvre(k, stalls=True) for k in range(3)])
    lift = [b for b in found.boxes if b.series == "lift"]
    assert {b.series for b in found.failing} == {"lift"}
    for box in lift:
        low, high = np.degrees(box.first)
        if high <= 6 + 1e-9:
            assert not box.fails, box
        elif low >= 7.9:
            assert box.fails, box
    assert any(np.degrees(b.first[0]) >= 7.9 for b in lift)
    assert found.courses[0].worst["lift"][1] > found.courses[0].rms["lift"] > 1
    assert "worst at alpha" in validity_lines(found)[1]


def test_nothing_is_said_beyond_what_was_flown() -> None:
    """Every box holds at least half a second of flight; the envelope is that of the record."""
    one = manoeuvre(1)
    found = validity([one])
    assert all(b.seconds >= LEAST_S for b in found.boxes)
    for box in found.boxes:
        for axis, (low, high) in zip(box.axes, (box.first, box.second), strict=True):
            x = getattr(one, axis)
            assert (x >= low - 1e-12).any()
            assert (x < high).any()
    assert found.envelope["alpha"] == (one.alpha.min(), one.alpha.max())
    assert validity_json(found)["envelope"]["airspeed"] == [one.airspeed.min(), one.airspeed.max()]


@pytest.mark.parametrize("decay", [0.0, 0.5, 0.9])
def test_independent_values_are_those_of_the_correlation(decay: float) -> None:
    """Of an autoregression of first order: n (1 - a^2)/(1 + a^2), Bartlett 1946; to 15 % for 20,000 values."""
    x = coloured(np.random.default_rng(5), 20_000, decay)
    assert independent_share(x) == pytest.approx((1 - decay**2) / (1 + decay**2), rel=0.15)


def test_edges_are_whole_steps_around_what_was_flown() -> None:
    edges = np.degrees(edges_of(np.radians(np.array([-2.97, 9.0])), "deg"))
    assert np.allclose(edges, [-4, -2, 0, 2, 4, 6, 8, 10])
    assert len(edges_of(np.full(5, 60.0), "m/s")) == 2


def test_the_page_says_it() -> None:
    page = " ".join(validity_page(validity([manoeuvre(k, stalls=True) for k in range(2)])))
    assert "Where the model holds" in page
    assert page.count("data:image/png;base64,") == 2

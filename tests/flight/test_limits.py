"""Limits are told when exceeded, once, and when they no longer are."""

import math

import pytest

from station.conventions import SIGNALS, TICK_NS, to_si
from station.flight.limits import LimitWatch
from station.profile import Limits
from station.rows import Code, Event, Frame

STILL = {"airspeed": 56.6, "az": -9.81, "phi": 0.0, "theta": 0.06, "alpha_vane": 0.05, "beta_vane": 0.0}


def flown(watch: LimitWatch, *stretches: tuple[float, dict[str, float]]) -> list[tuple[float, Event]]:
    """(seconds, values) one after the other; what is told, and when."""
    told, k = [], 0
    for seconds, changed in stretches:
        for _ in range(round(seconds * 50)):
            row = tuple({**STILL, **changed}.get(name, math.nan) for name in SIGNALS)
            frame = Frame(k * TICK_NS, k, row, (0.0,) * len(row), (0,) * len(row))
            told += [(k * 0.02, event) for event in watch.step(frame, None)]
            k += 1
    return told


@pytest.mark.parametrize(
    ("limits", "signal", "value", "name"),
    [
        ({}, "phi", to_si(-46, "deg"), "bank"),
        ({}, "theta", to_si(26, "deg"), "nose up"),
        ({}, "theta", to_si(-11, "deg"), "nose down"),
        ({"angle_of_attack": "12 deg"}, "alpha_vane", to_si(13, "deg"), "angle of attack"),
        ({"sideslip": "10 deg"}, "beta_vane", to_si(-11, "deg"), "sideslip"),
        ({"load_factor": 2.0}, "az", -2.1 * 9.80665, "load factor"),
        ({"least_load_factor": 0.2}, "az", -0.1 * 9.80665, "least load factor"),
        ({"speed": "150 kt"}, "airspeed", to_si(151, "kt"), "speed"),
        ({"least_speed": "80 kt"}, "airspeed", to_si(79, "kt"), "least speed"),
    ],
)
def test_each_limit_is_told_once_and_ends(limits: dict, signal: str, value: float, name: str) -> None:
    watch = LimitWatch(Limits.model_validate(limits))
    told = flown(watch, (1, {}), (3, {signal: value}), (3, {}))
    assert [(event.source, event.code) for _, event in told] == [(name, Code.LIMIT), (name, Code.FRESH)]
    assert told[0][0] == pytest.approx(1.1, abs=0.03)
    assert told[1][0] == pytest.approx(5.0, abs=0.03)
    assert told[1][1].detail.startswith("LIMIT")


def test_one_bad_sample_a_missing_signal_and_a_limit_taken_away_are_no_alarm() -> None:
    steep = {"phi": 1.0}
    assert flown(LimitWatch(Limits()), (1, {}), (0.08, steep), (1, {}), (1, {"phi": math.nan})) == []
    assert flown(LimitWatch(Limits(bank=None)), (2, steep)) == []

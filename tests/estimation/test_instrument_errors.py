"""A profile's instrument errors undone: signals known in closed form go through the errors as the profile defines them,
written here anew, and have to come out as they were."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import pytest

from station.conventions import SIGNAL_INDEX, SIGNALS, TICK_NS
from station.estimation.instrument_errors import Corrector, corrector, known
from station.profile import Aircraft, Instrument, load_aircraft
from station.rows import Frame, Quality

AIRCRAFT = load_aircraft("twin_otter")
DT, N = 0.02, 500
T = np.arange(N) * DT
W = 2 * math.pi * 0.8


def errs(**keys: float) -> Instrument:
    return Instrument.model_validate(keys, context="si")


def with_errors(**errors: Instrument) -> Aircraft:
    return AIRCRAFT.model_copy(update={"instruments": errors})


def true(t: np.ndarray) -> np.ndarray:
    return 0.1 * np.sin(W * t) + 0.02 * np.cos(2.3 * W * t)


def lagged(t: np.ndarray, lag: float) -> np.ndarray:
    """The steady answer of lag y' + y = true; for a negative lag of y = true - lag true'."""
    out = np.zeros_like(t)
    for amplitude, w in ((0.1 * np.exp(-0.5j * math.pi), W), (0.02, 2.3 * W)):
        response = 1 / (1 + 1j * w * lag) if lag >= 0 else 1 - 1j * w * lag
        out += (amplitude * response * np.exp(1j * w * t)).real
    return out


def frames(columns: Mapping[str, np.ndarray], ages: Mapping[str, np.ndarray] = {}) -> list[Frame]:
    table = np.full((len(next(iter(columns.values()))), len(SIGNALS)), math.nan)
    age = np.full(table.shape, math.nan)
    for name, values in columns.items():
        table[:, SIGNAL_INDEX[name]] = values
        age[:, SIGNAL_INDEX[name]] = np.where(np.isnan(values), np.nan, ages.get(name, 0.0))
    marks = np.where(np.isnan(table), int(Quality.MISSING), np.where(age > 0, int(Quality.HELD), int(Quality.FRESH)))
    rows = zip(table.tolist(), age.tolist(), marks.tolist(), strict=True)
    return [Frame(k * TICK_NS, k, tuple(v), tuple(a), tuple(q)) for k, (v, a, q) in enumerate(rows)]


def undone(made: Corrector, given: list[Frame]) -> list[tuple[Frame, Frame]]:
    return [pair for pair in map(made.step, given) if pair is not None]


def column(pairs: list[tuple[Frame, Frame]], name: str, which: int = 1) -> np.ndarray:
    return np.array([pair[which].values[SIGNAL_INDEX[name]] for pair in pairs])


CASES: dict[str, tuple[Instrument, Callable[[np.ndarray], np.ndarray], float]] = {
    "zero and scale": (errs(gain=0.9, bias=0.03), lambda t: 0.9 * true(t) + 0.03, 1e-15),
    "three frames late": (errs(latency=0.06), lambda t: true(t - 0.06), 1e-15),
    # Between frames: the cubic's error at 1.84 Hz, 0.02 (w dt)^4 9/384.
    "late": (errs(latency=0.0513), lambda t: true(t - 0.0513), 3e-6),
    "early": (errs(latency=-0.0487), lambda t: true(t + 0.0487), 3e-6),
    # The slope of the fitted cubic: 0.2 % low at 2 Hz.
    "lagging": (errs(lag=0.1), lambda t: lagged(t, 0.1), 1.5e-4),
    # A lag of straight lines between frames: (w dt)^2/12 at 0.8 and 1.84 Hz.
    "leading": (errs(lag=-0.1), lambda t: lagged(t, -0.1), 2e-4),
    "bent": (errs(cubic=2.0), lambda t: true(t) + 2.0 * true(t) ** 3, 1e-15),
    "bent the other way": (errs(cubic=-2.0), lambda t: true(t) - 2.0 * true(t) ** 3, 1e-15),
    "all": (
        errs(gain=1.2, bias=-0.1, latency=0.04, lag=0.05),
        lambda t: 1.2 * lagged(t - 0.04, 0.05) - 0.1,
        1e-4,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_was_measured_comes_back(name: str) -> None:
    error, shown, bound = CASES[name]
    aircraft = with_errors(q=error)
    made = Corrector(aircraft, {})
    pairs = undone(made, frames({"q": shown(T), "elevator": true(T)}))
    assert len(pairs) == N - made.ahead
    t = T[: len(pairs)]
    settled = slice(60, None)
    np.testing.assert_allclose(column(pairs, "q")[settled], true(t)[settled], atol=bound)
    # All else is of the same instant and as it was, and so is what was measured.
    np.testing.assert_array_equal(column(pairs, "elevator"), true(t))
    np.testing.assert_array_equal(column(pairs, "q", 0), shown(t))
    assert [seen.t_ns for _, seen in pairs] == [k * TICK_NS for k in range(len(pairs))]
    assert {seen.quality[SIGNAL_INDEX["q"]] for _, seen in pairs[60:]} == {int(Quality.FRESH)}
    assert np.abs(column(pairs, "q", 0) - true(t))[settled].max() > 20 * bound


def test_a_table_gives_the_bits_of_the_flight() -> None:
    aircraft = with_errors(q=errs(latency=0.033, lag=0.04), elevator=errs(backlash=0.02, cubic=1.0), psi=errs(bias=0.3))
    columns = {"q": true(T), "elevator": true(1.3 * T), "psi": np.zeros(N)}
    pairs = undone(Corrector(aircraft, {}), frames(columns))
    whole = Corrector(aircraft, {}, DT, N)
    values = np.column_stack([columns[n] for n in whole.names])
    t_s = np.array([k * TICK_NS for k in range(N)]) * 1e-9
    found, _, quality = whole.sweep(t_s, values, np.zeros_like(values))
    for j, name in enumerate(whole.names):
        np.testing.assert_array_equal(column(pairs, name), found[: len(pairs), j])
        assert (quality[: len(pairs), j] == [p[1].quality[SIGNAL_INDEX[name]] for p in pairs]).all()


def test_a_surface_follows_its_sensor_with_play() -> None:
    """The play operator from its definition; an edge comes late by what it is widened by, four times 0.02 deg."""
    play = 0.02
    drive = 0.08 * np.sin(W * T)
    at, surface = drive[0], []
    for x in drive:
        at = min(max(at, x - play / 2), x + play / 2)
        surface.append(at)
    pairs = undone(Corrector(with_errors(elevator=errs(backlash=play)), {}), frames({"elevator": drive}))
    late = np.abs(column(pairs, "elevator") - surface)
    assert late.max() < 4.01 * math.radians(0.02)
    assert late.mean() < 0.05 * play
    assert np.abs(drive - surface).mean() > 0.4 * play


def test_a_heading_is_followed_through_180_degrees() -> None:
    turned = np.remainder(3.0 + 0.1 * T + math.pi, 2 * math.pi) - math.pi
    pairs = undone(Corrector(with_errors(psi=errs(latency=-0.05, bias=0.2)), {}), frames({"psi": turned}))
    psi = column(pairs, "psi")[10:]
    assert np.abs(psi).max() <= math.pi
    expected = 3.0 + 0.1 * (T[10:] - 0.05) - 0.2
    np.testing.assert_allclose(np.remainder(psi - expected + 1.0, 2 * math.pi), 1.0, atol=1e-9)


def test_nothing_is_made_up_across_a_gap_and_what_is_held_says_so() -> None:
    shown = true(T - 0.05)
    shown[200:230] = math.nan
    aircraft = with_errors(q=errs(latency=0.05, lag=0.04))
    pairs = undone(Corrector(aircraft, {}), frames({"q": shown}))
    q, marks = column(pairs, "q"), np.array([p[1].quality[SIGNAL_INDEX["q"]] for p in pairs])
    ages = np.array([p[1].age_s[SIGNAL_INDEX["q"]] for p in pairs])
    # Measured until 3.98 s, of what was 0.05 s before: from there on to what was seen at 4.6 s nothing is known, and
    # what was last seen is held as long as a pitch rate may be old, 0.2 s.
    assert set(marks[198:207]) == {int(Quality.HELD)}
    assert set(marks[207:227]) == {int(Quality.MISSING)}
    assert set(marks[60:190]) | set(marks[240:]) == {int(Quality.FRESH)}
    np.testing.assert_allclose(np.diff(ages[200:207]), DT, atol=1e-9)
    assert np.ptp(q[200:207]) == 0.0


def test_a_stream_slower_than_the_frames_keeps_its_own_time() -> None:
    """5 Hz, 0.12 s late: frames repeat the newest value and its age; nothing lies between two values so far apart."""
    age = np.remainder(T, 0.2)
    held = true(T - age - 0.12)
    pairs = undone(Corrector(with_errors(v_down=errs(latency=0.12)), {}), frames({"v_down": held}, {"v_down": age}))
    for _, seen in pairs[20:]:
        value, old = seen.values[SIGNAL_INDEX["v_down"]], seen.age_s[SIGNAL_INDEX["v_down"]]
        assert value == pytest.approx(true(np.array([seen.t_ns * 1e-9 - old]))[0], abs=1e-12)
        assert old < 0.2 + 1e-9


def test_ticks_left_out_shift_nothing() -> None:
    given = frames({"q": true(T - 0.05), "elevator": true(T)})
    kept = [f for k, f in enumerate(given) if k not in (200, 201, 300)]
    pairs = undone(Corrector(with_errors(q=errs(latency=0.05)), {}), kept)
    t = np.array([seen.t_ns * 1e-9 for _, seen in pairs])
    # Straight lines across the missing frames: (w 3 dt)^2/8 at most.
    np.testing.assert_allclose(column(pairs, "q")[20:], true(t)[20:], atol=2e-3)
    np.testing.assert_allclose(column(pairs, "elevator"), true(t), atol=1e-12)


def test_what_cannot_be_undone_stays_and_is_told() -> None:
    aircraft = with_errors(
        v_down=errs(latency=0.8, bias=0.5), airspeed=errs(lag=2.0), psi=errs(gain=1.1), alpha_vane=errs(latency=0.06)
    )
    found = known(aircraft)
    assert found.errors == {"v_down": errs(bias=0.5), "alpha_vane": errs(latency=0.06)}
    assert found.words == ("v_down bias +0.5 m/s", "alpha_vane 60 ms late")
    told = "; ".join(found.refused)
    for words in ("v_down 800 ms late: not undone beyond 500 ms", "airspeed lag 2000 ms", "psi scale +10 %"):
        assert words in told
    assert Corrector(aircraft, {}).ahead == 3


def test_a_profile_without_errors_needs_nothing() -> None:
    assert corrector(AIRCRAFT, {}) is None
    assert corrector(with_errors(q=errs(gain=1.0)), {}) is None
    assert known(AIRCRAFT).words == ()
    assert known(AIRCRAFT.model_copy(update={"imu_offset": (0.3, 0.0, 0.0)})).words == (
        "imu +0.3 +0 +0 m from the rig's place",
    )

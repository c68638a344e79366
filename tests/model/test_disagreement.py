"""Warnings in flight: none for sound instruments in any air, and soon for one that is late, scaled or off.

The flights go through the live loop itself, from recorded rows, faster than real time.
"""

import itertools
import math
import re

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from station.clock import ManualClock
from station.conventions import SIGNALS, STREAMS, TICK_HZ, TICK_NS, Stream
from station.estimation.methods import Estimator
from station.flight.alignment import Aligner
from station.flight.board import Board
from station.flight.loop import Chain, recorded_beats, run
from station.flight.replay_check import same_bits
from station.model.disagreement import CHECKS, Disagreement, Value
from station.model.gain_and_delay import compare
from station.profile import Card, Doublet, Flight, Instrument, ThreeTwoOneOne, load_aircraft, load_rig
from station.rows import Code, Event, Frame, Sample, Tick
from station.simulation.sortie import fly

RIG = load_rig("bench")
AIRCRAFT = load_aircraft("twin_otter")
SENSED = [name for stream in RIG.streams() for name in stream.signals]
ROWS = [
    Stream(f"imported.{s.name}", tuple(n for n in s.signals if n in SENSED), float(TICK_HZ), 0.5)
    for s in STREAMS.values()
    if any(n in SENSED for n in s.signals)
]
SECONDS = 125.0
LAG_NS = 60_000_000
START_NS = 10_000_000_000


class Log:
    def __init__(self):
        self.rows = []

    def append(self, rows):
        self.rows.extend(rows)

    def flush(self):
        pass


def card(sigma_ft_s, seed):
    """An input every 20 s, as on the bench card."""
    manoeuvres = (
        Doublet(kind="doublet", start="25 s", repeat="60 s", amplitude="3.5 deg", width="0.6 s"),
        ThreeTwoOneOne(kind="3-2-1-1", start="45 s", repeat="60 s", amplitude="-2.5 deg", unit="0.5 s"),
        Doublet(kind="doublet", start="65 s", repeat="60 s", amplitude="3.5 deg", width="1.2 s"),
    )
    flight = Flight(speed="110 kt", altitude="2500 ft", gust_sigma=f"{sigma_ft_s} ft/s", seed=seed)
    return Card(name="t", aircraft="twin_otter", rig="bench", flight=flight, manoeuvres=manoeuvres)


def flown(sigma_ft_s, seed, seconds=SECONDS, errors=None, wrong=None):
    """Rows of a flight as a recording has them. `errors`: instruments' errors by signal; `wrong`: signal, what is
    added to it, and from when, s."""
    made = {name: Instrument.model_validate(e, context="si") for name, e in (errors or {}).items()}
    aircraft = AIRCRAFT.model_copy(update={"instruments": made})
    shown, _ = fly(aircraft, RIG, card(sigma_ft_s, seed), seconds, seed)
    if wrong is not None:
        name, added, from_s = wrong
        shown[name] = shown[name].copy()
        shown[name][round(from_s * TICK_HZ) :] += added
    columns = {s.name: list(zip(*(shown[n].tolist() for n in s.signals), strict=True)) for s in ROWS}
    rows = []
    for k in range(len(shown["q"])):
        t_ns = START_NS + k * TICK_NS
        rows += [Sample(t_ns, name, None, k, values[k]) for name, values in columns.items()]
        # What a recording says of the frame is made anew.
        rows += [Tick(t_ns + LAG_NS, k, t_ns), Frame(t_ns, k, (), (), ())]
    return rows


def told(rows, log=None):
    """The warnings of a flight, through the loop."""
    of = card(0.0, 1)
    estimator = Estimator(AIRCRAFT, of, RIG.imu_position, RIG.noise_si(), methods=("II",))
    watch = Disagreement(AIRCRAFT, RIG.imu_position, RIG.noise_si())
    found = []

    def keep(_, made):
        found.extend(r for r in made if isinstance(r, Event))

    chain = Chain(estimator, watch)
    run(recorded_beats(rows), Aligner(ROWS, RIG.noise_si()), lambda: chain, log, None, keep)
    return found


def warned(events):
    """What was told, and when, s of flight."""
    return [((e.t_ns - START_NS) * 1e-9, e.source, e.detail) for e in events if e.code is Code.DISAGREE]


@pytest.mark.parametrize("sigma", [pytest.param(x, marks=[pytest.mark.slow] * (x != 5)) for x in (0, 3, 5, 10)])
def test_sound_instruments_give_no_warning(sigma):
    assert warned(told(flown(sigma, 7, 85.0))) == []


def test_a_rate_in_degrees_is_told_as_one_of_another_unit():
    words = {source: detail for _, source, detail in warned(told(flown(3, 8, 50.0, {"q": {"gain": math.degrees(1)}})))}
    assert words["q.scale"].startswith("q shows 56")
    assert words["q.scale"].endswith("): is a unit wrong?")


def test_a_gain_below_nothing_is_told_as_a_sign():
    az = CHECKS["accelerometer.scale"]
    assert az.sentence(Value(-2.02, 0.004)).endswith("than v_down changes (±0.8): is a sign wrong?")
    assert az.sentence(Value(-0.2, 0.004)).endswith("(±0.8)")


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0, 3, 5, 10])
def test_sound_instruments_give_no_warning_in_twenty_flights(sigma):
    assert [w for seed in range(100, 120) for w in warned(told(flown(sigma, seed)))] == []


LATE = {n: {"latency": 0.1} for n in ("v_north", "v_east", "v_down")}
CALM = {
    "vane late": ({"alpha_vane": {"latency": 0.06}}, "alpha_vane.delay", 60, "ms late", 1),
    "vane scaled": ({"alpha_vane": {"gain": 1.15}}, "alpha_vane.scale", 15, "% more", 2),
    "q scaled": ({"q": {"gain": 0.92}}, "q.scale", 8, "% less", 2),
    "q late": ({"q": {"latency": 0.03}}, "q.delay", 30, "ms late", 2),
    "velocity late": (LATE, "velocity.delay", 100, "ms late", 2),
}
"""Errors, what is to be told, its size and words, and after how many inputs."""
WRONG = {
    "vane": ("alpha_vane", math.radians(2), "alpha_vane.bias", 0.85 * 2, "deg high"),
    "q": ("q", math.radians(1), "q.bias", 1, "deg/s high"),
    "theta": ("theta", math.radians(2), "theta.bias", 2, "deg high"),
    "az": ("az", 0.5, "accelerometer.bias", 0.051, "g high"),
    "ax": ("ax", 0.5, "ax.bias", 0.051, "g high"),
    "airspeed": ("airspeed", 5.0, "airspeed.bias", 5, "m/s high"),
    "elevator": ("elevator", math.radians(3), "model.moment_0", 1.74 * math.radians(3), "Cm nose down"),
}
"""What is added to a signal, and what is to be told of it; the vane's steady calibration is 0.85."""


def value_told(found, source, words):
    """When the first warning of a source came, and the size that it tells; it must be put in those words."""
    for at_s, said, detail in found:
        if said == source:
            assert words in detail, detail
            return at_s, float(re.search(r"[0-9.]+", detail)[0])
    pytest.fail(f"{source} not told: {found}")


@pytest.mark.parametrize("name", CALM)
def test_an_instrument_at_fault_is_named_within_two_manoeuvres_in_calm_air(name):
    errors, source, size, words, inputs = CALM[name]
    at_s, value = value_told(warned(told(flown(0, 3, 20.0 * inputs + 25.0, errors))), source, words)
    assert value == pytest.approx(size, rel=0.15)
    assert at_s < 20.0 * inputs + 22.0


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=[pytest.mark.slow] * (x not in ("q", "vane", "airspeed"))) for x in WRONG]
)
def test_a_constant_wrong_value_is_told_within_half_a_minute(name):
    signal, added, source, size, words = WRONG[name]
    found = warned(told(flown(0, 4, 91.0, wrong=(signal, added, 60.0))))
    at_s, value = value_told(found, source, words)
    assert 60.0 < found[0][0] <= at_s < 90.5
    assert value == pytest.approx(size, rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [3, 5])
@pytest.mark.parametrize("name", WRONG)
def test_a_constant_wrong_value_is_told_in_turbulence(name, sigma):
    signal, added, source, _, _ = WRONG[name]
    for seed in range(5):
        found = warned(told(flown(sigma, 40 + seed, 91.0, wrong=(signal, added, 60.0))))
        # Gusts hide a vane's zero: lift and trim still say it, and of theta only ax.
        assert {source, "model.alpha", "ax.bias"} & {s for at_s, s, _ in found if 60.0 < at_s < 90.5}, found


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_a_late_vane_is_told_in_light_turbulence(seed):
    found = warned(told(flown(3, 300 + seed, 145.0, {"alpha_vane": {"latency": 0.1}})))
    assert any(s == "alpha_vane.delay" and "late" in d for _, s, d in found), found


def test_a_recording_with_warnings_replays_to_the_same_bits():
    rows = flown(0, 3, 50.0, CALM["vane late"][0])
    log = Log()
    first = told(rows, log)
    assert any(e.code is Code.DISAGREE for e in first)
    differences = []

    def same(beat, made):
        if not all(itertools.starmap(same_bits, zip(beat.recorded, made, strict=True))):
            differences.append(beat.tick.k)

    estimator = Estimator(AIRCRAFT, card(0, 1), RIG.imu_position, RIG.noise_si(), methods=("II",))
    watch = Disagreement(AIRCRAFT, RIG.imu_position, RIG.noise_si())
    again = [[r for r in b.recorded if isinstance(r, Event)] for b in recorded_beats(log.rows)]
    assert [e for events in again for e in events] == first
    chain = Chain(estimator, watch)
    run(recorded_beats(log.rows), Aligner(ROWS, RIG.noise_si()), lambda: chain, None, None, same)
    told_again = [k for k in differences if any(isinstance(r, Event) for r in again[k])]
    assert told_again == []


def test_gain_and_delay_of_a_signal_that_feeds_back_are_right_on_average():
    """The oracle: x answers to the error e of y as an aircraft does to a gust, besides to its input z."""
    errors = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n = 1200
        z = lfilter([1], [1, -1.6, 0.7], np.repeat(rng.choice([-1.0, 0, 0, 0, 1], n // 10), 10))
        z /= z.std()
        e = lfilter([0.3], [1, -0.95], rng.standard_normal(n))
        x = z - lfilter([0.2], [1, -0.8], e)
        t = np.arange(n) * 0.1
        late = CubicSpline(t, x)(np.maximum(t - 0.06, 0))
        found = compare(0.9 * late + e, x, z, 0.0)
        errors.append([(found.gain - 0.9) / found.gain_sd, (found.delay - 0.06) / found.delay_sd])
    errors = np.array(errors)
    assert np.isfinite(errors).all()
    # Without an instrument the gain would be 20 standard deviations off.
    assert np.abs(errors.mean(0)).max() < 0.25
    assert errors.std(0).min() > 0.85
    assert errors.std(0).max() < 1.15


def test_the_screen_shows_a_disagreement_until_it_is_over():
    board = Board(None, ManualClock(0))
    board.update([Event(1, "alpha_vane.delay", Code.DISAGREE, 1, "α vane 60 ms late against inertial α (±8)")])
    assert [e.source for e in board.disagreements] == ["alpha_vane.delay"]
    assert board.snapshot()["disagreements"][0]["detail"].startswith("α vane 60 ms late")
    board.update([Event(2, "alpha_vane.delay", Code.AGREE, 1, "agrees again")])
    assert board.disagreements == []


@pytest.mark.parametrize("value", ["zero", "low", "high", "missing"])
def test_an_aircraft_at_rest_and_values_at_their_ends_do_not_end_a_flight(value):
    """An air-data sensor that says 0 m/s and 0 Pa before take-off divides nothing by 0."""
    ends = {
        "zero": [0.0] * len(SIGNALS),
        "low": [s.low for s in SIGNALS.values()],
        "high": [s.high for s in SIGNALS.values()],
        "missing": [math.nan] * len(SIGNALS),
    }
    watch = Disagreement(AIRCRAFT, RIG.imu_position, RIG.frame_noise_si())
    estimator = Estimator(AIRCRAFT, Card(name="t", aircraft="twin_otter", rig="bench"), RIG.imu_position)
    flying = {"airspeed": 56.0, "az": -9.81, "ax": 0.5, "alpha_vane": 0.05, "static_pressure": 92_000.0}
    steady = [flying.get(name, 0.0) for name in SIGNALS]  # dynamic pressure 0 among others
    for k in range(4 * TICK_HZ):
        now = ends[value] if k // TICK_HZ % 2 == 0 else [x + 0.001 * math.sin(k) if x else x for x in steady]
        ages = [math.nan if math.isnan(x) else 0.0 for x in now]
        frame = Frame(k * TICK_NS, k, tuple(now), tuple(ages), tuple(3 if math.isnan(x) else 0 for x in now))
        alpha, _ = estimator.step(frame)
        assert watch.step(frame, alpha) == ()

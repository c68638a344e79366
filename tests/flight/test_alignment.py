"""Frames and stream health, with streams whose truth is a closed form."""

import itertools
import math

import numpy as np
import pytest

from station.conventions import SIGNAL_INDEX, TICK_NS, Stream
from station.flight.alignment import Aligner
from station.rows import Code, Quality, Sample, TimeSync

S = 1_000_000_000
ALPHA, Q = SIGNAL_INDEX["alpha_vane"], SIGNAL_INDEX["q"]


def stream(name="boom.vanes", signals=("alpha_vane",), rate=200.0, latency=0.0, stale=0.1):
    return Stream(name, signals, rate, stale, device=name.split(".")[0], latency_s=latency)


def wave(t_s):
    return 0.1 * math.sin(2 * math.pi * 0.8 * t_s)


def fly(aligner, samples, seconds, lag_s=0.06):
    """Feed samples by arrival and take a frame each 20 ms; all frames and events."""
    frames, events, k, i = [], [], 0, 0
    samples = sorted(samples, key=lambda s: s.t_ns)
    while k * TICK_NS < seconds * S:
        now = k * TICK_NS
        while i < len(samples) and samples[i].t_ns <= now:
            aligner.accept(samples[i])
            i += 1
        frame, new, _ = aligner.frame(k, now, now - round(lag_s * S))
        frames.append(frame)
        events += new
        k += 1
    return frames, events


def sampled(name, rate, seconds, f=wave, n=1, device=None, journey=lambda t: 0.0, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    rows = []
    for j in range(int(rate * seconds)):
        t = j / rate
        values = (f(t) + rng.normal(0, noise),) * n
        t_device = None if device is None else round(device(t) * S)
        rows.append(Sample(round((t + journey(t)) * S), name, t_device, j, values))
    return rows


def test_interpolated_frame_is_the_signal_at_the_frames_time():
    aligner = Aligner([stream()], {})
    frames, events = fly(aligner, sampled("boom.vanes", 200, 5), 5)
    for frame in frames[10:]:
        # A line through samples at 0, +-5 and +-10 ms: curvature leaves half of it times their mean square, 5e-5 s2.
        curvature = 0.1 * (2 * math.pi * 0.8) ** 2
        assert frame.values[ALPHA] == pytest.approx(wave(frame.t_ns / S), abs=1.05 * curvature / 2 * 5e-5)
        assert frame.age_s[ALPHA] == 0.0
        assert frame.quality[ALPHA] == Quality.FRESH
    assert not events


@pytest.mark.parametrize("law", [2, 3])
@pytest.mark.parametrize("leap_s", [0.0, 5.0, -5.0])
def test_samples_of_one_read_are_where_they_were_measured(law, leap_s):
    """1 kHz, read every 5 ms; the device's clock leaps between two samples of a read, at 3.003 s."""
    clock = lambda t: 1000.0 + t + (leap_s if t > 3.0025 else 0.0)  # noqa: E731
    rows = sampled("boom.vanes", 1000, 5, device=clock, journey=lambda t: math.ceil(t / 0.005 - 1e-6) * 0.005 - t)
    assert len({r.t_ns for r in rows}) == 1001
    aligner = Aligner([stream(rate=1000.0)], {}, law)
    frames, events = fly(aligner, [*rows, TimeSync(S, "boom", -1000 * S, 10**9)], 5)
    curvature = 0.1 * (2 * math.pi * 0.8) ** 2
    leapt = range(round(2.9 * 50), round(3.5 * 50)) if leap_s else ()
    for frame in frames[10:]:
        if frame.k not in leapt:
            # 21 samples at 0 to +-10 ms: their mean square is 3.7e-5 s2.
            assert frame.values[ALPHA] == pytest.approx(wave(frame.t_ns / S), abs=1.05 * curvature / 2 * 3.7e-5)
            assert frame.quality[ALPHA] == Quality.FRESH
    assert sum(e.count for e in events if e.code is Code.CLOCK_STEP) == (leap_s != 0)


def test_a_value_that_cannot_be_true_is_found_among_many():
    """20 samples a tick are looked at together first: what is found in them is what is found one by one."""
    rows = sampled("boom.vanes", 1000, 4, noise=1e-3)
    for i, value in ((1507, 4.0), (2009, wave(2.009) + 0.5), (3013, math.nan)):
        rows[i] = Sample(rows[i].t_ns, rows[i].stream, None, i, (value,))
    noise, one_by_one = {"alpha_vane": 1e-3}, []
    frames, events = fly(Aligner([stream(rate=1000.0)], noise), rows, 4)
    singly = Aligner([stream(rate=1000.0)], noise)
    fly_each = iter(rows)
    for k in range(200):
        for row in itertools.islice(fly_each, 1 if k == 0 else 20):
            singly.accept(row)
            singly.accept(TimeSync(row.t_ns, "boom", 0, 10**9))  # what waits is taken
        frame, new, _ = singly.frame(k, k * TICK_NS, (k - 3) * TICK_NS)
        assert frame.values == pytest.approx(frames[k].values, nan_ok=True, abs=0.0)
        one_by_one += new
    assert [e.code for e in events] == [e.code for e in one_by_one]
    assert {Code.RANGE, Code.JUMP} <= {e.code for e in events}


def test_samples_that_waited_for_a_frame_are_as_good_as_those_of_each_tick():
    """The loop was away for 2 s: 400 samples at once, some of them out of order."""
    samples = sampled("boom.vanes", 200, 3, device=lambda t: t)
    each, at_once = Aligner([stream()], {}), Aligner([stream()], {})
    frames, _ = fly(each, samples, 3)
    for i in range(100, 500, 10):
        samples[i : i + 10] = samples[i : i + 10][::-1]
    for sample in samples:
        at_once.accept(sample)
    for frame in frames[60:140]:
        assert at_once.frame(frame.k, 3 * S, frame.t_ns)[0].values == pytest.approx(
            frame.values, abs=1e-15, nan_ok=True
        )


def test_a_saturated_value_is_told_and_missing_and_does_not_doubt_those_behind_it():
    samples = [
        Sample(s.t_ns, s.stream, None, s.seq, (math.inf if 2 * S <= s.t_ns < 2.1 * S else s.values[0],))
        for s in sampled("boom.vanes", 200, 3)
    ]
    frames, events = fly(Aligner([stream()], {}), samples, 3)
    assert events[0].detail == "alpha_vane is beyond what its message carries"
    assert {e.code for e in events} == {Code.RANGE}
    missing = [f.t_ns / S for f in frames[10:] if math.isnan(f.values[ALPHA])]
    assert missing
    assert 1.97 < min(missing) <= max(missing) < 2.13


@pytest.mark.parametrize("drift_ppm", [100.0, -100.0])
def test_streams_with_clocks_hours_apart_are_aligned_to_2_ms_rms(drift_ppm):
    """5 ms of arrival jitter, device clocks off by hours and drifting apart by 200 ppm."""
    rng = np.random.default_rng(7)
    jitter = lambda t: rng.uniform(0, 0.005)  # noqa: E731
    ramp = lambda t: 1e-3 * t  # noqa: E731  a ramp turns a time error into a value error
    vane = sampled("boom.vanes", 200, 60, ramp, device=lambda t: 7200 + t * (1 + drift_ppm * 1e-6), journey=jitter)
    gyro = sampled("can.gyro", 200, 60, ramp, device=lambda t: -3600 + t * (1 - drift_ppm * 1e-6), journey=jitter)
    aligner = Aligner([stream(), stream("can.gyro", ("q",))], {})
    frames, _ = fly(aligner, vane + gyro, 60)
    synced = [f for f in frames if f.t_ns > 15 * S]
    skew_ms = np.array([(f.values[ALPHA] - f.values[Q]) / 1e-3 for f in synced]) * 1e3
    error_ms = np.array([f.values[ALPHA] / 1e-3 - f.t_ns / S for f in synced]) * 1e3
    assert np.sqrt(np.mean(skew_ms**2)) <= 2.0
    assert np.sqrt(np.mean(error_ms**2)) <= 2.0


def test_latency_of_the_rig_is_taken_out():
    aligner = Aligner([stream(latency=0.02)], {})
    frames, _ = fly(aligner, sampled("boom.vanes", 200, 3, lambda t: 1e-3 * (t - 0.02)), 3)
    assert frames[-1].values[ALPHA] == pytest.approx(1e-3 * frames[-1].t_ns / S, abs=1e-9)


@pytest.mark.parametrize("stamped", [math.floor, round])
def test_a_coarse_stamp_costs_no_skew(stamped):
    """Stamps in whole milliseconds, cut or rounded, at times that are no whole milliseconds."""
    coarse = Stream("can.gyro", ("q",), 190.0, 0.1, device="can", stamp_resolution_s=1e-3)
    ramp = lambda t: 1e-3 * t  # noqa: E731
    device = lambda t: 500.0 + stamped(t * 1e3) * 1e-3  # noqa: E731
    frames, _ = fly(Aligner([coarse], {}), sampled("can.gyro", 190.0, 20, ramp, device=device), 20)
    errors_ms = [f.values[Q] / 1e-6 - f.t_ns / 1e6 for f in frames[500:]]
    assert abs(np.mean(errors_ms)) < 0.1  # half a step is 0.5 ms


def test_a_fast_streams_noise_is_averaged_without_delay():
    """Five samples a frame: white noise falls by sqrt(5), and a ramp stays where it is."""
    ramp = lambda t: 1e-3 * t  # noqa: E731
    frames, _ = fly(Aligner([stream()], {}), sampled("boom.vanes", 200, 60, ramp, noise=1e-3), 60)
    errors = np.array([f.values[ALPHA] - 1e-3 * f.t_ns / S for f in frames[10:]])
    assert np.std(errors) == pytest.approx(1e-3 / math.sqrt(5), rel=0.05)  # 3000 frames: sd of an sd is 1.3 %
    assert abs(np.mean(errors)) < 4e-5  # 0.04 s of the ramp's slope would be a delay; this is noise


def test_slow_stream_is_held_with_its_age_not_passed_off_as_fresh():
    aligner = Aligner([stream("gnss.velocity", ("v_down",), 5.0, stale=0.44)], {})
    frames, _ = fly(aligner, sampled("gnss.velocity", 5, 5), 5)
    column = SIGNAL_INDEX["v_down"]
    ages = [f.age_s[column] for f in frames[50:] if f.quality[column] == Quality.HELD]
    assert ages
    assert max(ages) <= 0.2
    assert all(f.age_s[column] == 0 for f in frames if f.quality[column] == Quality.FRESH)


def flagged(events, code, after_s):
    """Seconds from `after_s` to the first such event."""
    return min(e.t_ns / S for e in events if e.code is code and e.t_ns / S >= after_s) - after_s


def test_faults_are_flagged_within_half_a_second_and_the_frame_is_marked():
    noise = {"alpha_vane": 1e-3}
    base = sampled("boom.vanes", 200, 6, noise=1e-3, device=lambda t: t + 100)

    off = [s for s in base if s.t_ns < 3 * S]
    frames, events = fly(Aligner([stream()], noise), off, 6)
    assert flagged(events, Code.STALE, 3.0) <= 0.5
    assert math.isnan(frames[-1].values[ALPHA])
    assert frames[-1].quality[ALPHA] == Quality.MISSING

    stuck = [s if s.t_ns < 3 * S else Sample(s.t_ns, s.stream, s.t_device_ns, s.seq, (0.05,)) for s in base]
    frames, events = fly(Aligner([stream()], noise), stuck, 6)
    assert flagged(events, Code.STUCK, 3.0) <= 0.5
    assert frames[-1].quality[ALPHA] == Quality.SUSPECT

    slow = [s for i, s in enumerate(base) if s.t_ns < 3 * S or i % 3 == 0]
    _, events = fly(Aligner([stream()], noise), slow, 6)
    assert flagged(events, Code.SLOW, 3.0) <= 0.5
    assert flagged(events, Code.GAP, 3.0) <= 0.5

    wrong = [
        s if s.t_ns < 3 * S else Sample(s.t_ns, s.stream, s.t_device_ns, s.seq, (s.values[0] + 0.3,)) for s in base
    ]
    frames, events = fly(Aligner([stream()], noise), wrong, 6)
    assert flagged(events, Code.JUMP, 3.0) <= 0.5
    after = [f for f in frames if 3.02 * S < f.t_ns < 3.9 * S]
    assert all(f.quality[ALPHA] == Quality.SUSPECT for f in after)

    impossible = [s if s.t_ns < 3 * S else Sample(s.t_ns, s.stream, s.t_device_ns, s.seq, (4.0,)) for s in base]
    frames, events = fly(Aligner([stream()], noise), impossible, 6)
    assert flagged(events, Code.RANGE, 3.0) <= 0.5
    assert frames[-1].quality[ALPHA] == Quality.SUSPECT

    late = [s if s.t_ns < 3 * S else Sample(s.t_ns + S // 5, s.stream, s.t_device_ns, s.seq, s.values) for s in base]
    _, events = fly(Aligner([stream()], noise), late, 6)
    assert flagged(events, Code.LATE, 3.0) <= 0.5

    step = [
        s if s.t_ns < 3 * S else Sample(s.t_ns, s.stream, (s.t_device_ns or 0) + 5 * S, s.seq, s.values) for s in base
    ]
    frames, events = fly(Aligner([stream()], noise), step, 6)
    assert flagged(events, Code.CLOCK_STEP, 3.0) <= 0.5
    assert frames[-1].quality[ALPHA] == Quality.FRESH


def test_a_healthy_stream_raises_nothing_and_recovery_is_told():
    noise = {"alpha_vane": 1e-3}
    base = sampled("boom.vanes", 200, 8, noise=1e-3, device=lambda t: t + 100)
    _, events = fly(Aligner([stream()], noise), base, 8)
    assert {e.code for e in events} <= {Code.CLOCK_STATE}
    gap = [s for s in base if not 3 * S < s.t_ns < 4 * S]
    _, events = fly(Aligner([stream()], noise), gap, 8)
    assert [e.code for e in events if e.code in (Code.STALE, Code.FRESH)][:2] == [Code.STALE, Code.FRESH]


def test_a_stream_in_trouble_leaves_the_others_every_sample():
    noise = {"alpha_vane": 1e-3}
    vane = [s for s in sampled("boom.vanes", 200, 5, noise=1e-3) if s.t_ns < 2 * S]
    gyro = sampled("can.gyro", 200, 5)
    frames, _ = fly(Aligner([stream(), stream("can.gyro", ("q",))], noise), vane + gyro, 5)
    assert all(f.quality[Q] == Quality.FRESH for f in frames[10:])


def test_angles_are_interpolated_across_the_wrap():
    aligner = Aligner([stream("ap.attitude", ("psi",), 50.0)], {})
    heading = lambda t: math.remainder(math.pi - 0.01 + 0.1 * t, 2 * math.pi)  # noqa: E731
    frames, _ = fly(aligner, sampled("ap.attitude", 50, 3, heading), 3, lag_s=0.067)
    for frame in frames[10:]:
        assert math.cos(frame.values[SIGNAL_INDEX["psi"]] - heading(frame.t_ns / S)) == pytest.approx(1.0, abs=1e-9)


def doublets(t_s):
    """4 deg each way for half a second every 5 s, the aircraft in trim meanwhile."""
    phase = t_s % 5.0
    return 0.07 if phase < 0.5 else -0.07 if phase < 1.0 else 0.0


def hand(t_s):
    """The same, no faster than a hand moves."""
    return float(np.mean([doublets(t_s - lag) for lag in np.linspace(0.0, 0.1, 11)]))


def pots(noise, step=0.0, seconds=20):
    """Of a pot that is read in whole steps of an ADC."""
    rows = sampled("can.pots", 100, seconds, f=hand, n=2, noise=noise)
    return [Sample(s.t_ns, s.stream, None, s.seq, tuple(step * round(v / step) for v in s.values)) if step else s
            for s in rows]  # fmt: skip


@pytest.mark.parametrize(
    ("noise", "step"),
    [
        pytest.param(0.0, 0.0, id="emulated without noise"),
        pytest.param(0.0, 1.7e-4, id="a 12-bit ADC, no noise"),
        pytest.param(3e-5, 1.7e-4, id="noise below a step"),
    ],
)
def test_a_surface_that_keeps_still_is_not_stuck(noise, step):
    surfaces = stream("can.pots", ("aileron", "rudder"), rate=100.0, stale=0.2)
    frames, events = fly(Aligner([surfaces], {"aileron": 3.5e-4, "rudder": 3.5e-4}), pots(noise, step), 20)
    assert not [e for e in events if e.code is Code.STUCK]
    column = SIGNAL_INDEX["aileron"]
    assert all(f.quality[column] == Quality.FRESH for f in frames[50:])


@pytest.mark.parametrize("step", [0.0, 1.7e-4])
def test_a_surface_that_has_shown_its_noise_and_shows_it_no_more_is_stuck(step):
    surfaces = stream("can.pots", ("aileron", "rudder"), rate=100.0, stale=0.2)
    healthy = pots(3.5e-4, step)
    held = healthy[1200].values
    stuck = [s if s.t_ns < 12 * S else Sample(s.t_ns, s.stream, None, s.seq, held) for s in healthy]
    frames, events = fly(Aligner([surfaces], {"aileron": 3.5e-4, "rudder": 3.5e-4}), stuck, 20)
    assert next(e for e in events if e.code is Code.STUCK).t_ns / S == pytest.approx(12.3, abs=0.2)
    # Once, to the end.
    assert len([e for e in events if e.code is Code.STUCK]) == 1
    assert all(f.quality[SIGNAL_INDEX["aileron"]] == Quality.SUSPECT for f in frames[-300:])


def test_a_vane_without_noise_is_stuck_still():
    """Air is never still."""
    still = [Sample(s.t_ns, s.stream, None, s.seq, (0.05,)) for s in sampled("boom.vanes", 200, 3)]
    _, events = fly(Aligner([stream()], {"alpha_vane": 1e-3}), still, 3)
    assert flagged(events, Code.STUCK, 0.0) <= 0.5

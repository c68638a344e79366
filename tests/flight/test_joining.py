"""A flight records before what is compiled is ready: the rest joins later, in a replay at the same ticks."""

import math
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from numba import njit

from station.clock import ManualClock
from station.conventions import SIGNAL_INDEX, Stream
from station.flight.alignment import Aligner
from station.flight.bus import Bus
from station.flight.loop import ESTIMATORS, FRAMES, Chain, beats, recorded_beats, run
from station.flight.preparing import NotCompiled, children_fly_behind, refusing_to_compile
from station.flight.replay_check import Comparison
from station.rows import AlphaEstimate, Code, Event, Frame, Health, Quality, Sample, Tick

STREAM = Stream("boom.vanes", ("alpha_vane",), 200.0, 0.1, device="boom")
LAG_S = 0.06
FRAMES_AT, ESTIMATORS_AT, SECONDS = 70, 120, 4.0
VANE = SIGNAL_INDEX["alpha_vane"]


class Counting:
    """An estimator whose estimates depend on all frames since it joined."""

    def __init__(self):
        self.frames = 0

    def step(self, frame):
        self.frames += 1
        alpha = AlphaEstimate(frame.t_ns, self.frames, *[math.nan] * 11, "unknown", *[math.nan] * 3, True, "")
        return alpha, ()

    def start_point(self):
        self.frames = 0


class Recorder(list):
    def append(self, rows):
        self.extend(rows)

    def flush(self):
        pass


def wave(t_ns):
    return 0.1 * math.sin(2e-9 * math.pi * t_ns)


def flown(jump_at=None):
    """The rows of a flight whose frames and estimators are ready at ticks of their own, and the estimator."""
    clock, bus, log, estimator = ManualClock(10**10), Bus(), Recorder(), Counting()
    for part in (FRAMES, ESTIMATORS):
        bus.put(Event(clock.now_ns(), part, Code.PREPARING))

    def feeding():
        for beat in beats(bus, clock, LAG_S, threading.Event(), SECONDS):
            now = clock.now_ns()
            for i in range(4):
                t_ns = now + i * 5_000_000
                # From a tick on, the device's clock has jumped: what was before does not count.
                device_ns = t_ns + (10**9 if jump_at is not None and beat.tick.k >= jump_at else 0)
                bus.put(Sample(t_ns, "boom.vanes", device_ns, None, (wave(t_ns),)))
            for part, at in ((FRAMES, FRAMES_AT), (ESTIMATORS, ESTIMATORS_AT)):
                if beat.tick.k == at - 1:
                    bus.put(Event(now, part, Code.READY))
            if beat.tick.k == 20:
                bus.put(Event(now, "operator", Code.POINT_START, 1))
            yield beat

    run(feeding(), Aligner([STREAM], {}), lambda: Chain(estimator), log)
    return log, estimator


def test_rows_are_recorded_from_the_first_tick_and_the_rest_joins_in_its_turn():
    log, estimator = flown()
    ticks = [r for r in log if isinstance(r, Tick)]
    frames = [r for r in log if isinstance(r, Frame)]
    alphas = [r for r in log if isinstance(r, AlphaEstimate)]
    assert len(frames) == len(ticks) == 50 * SECONDS
    assert len([r for r in log if isinstance(r, Sample)]) == 4 * (len(ticks) - 1)
    assert {q for f in frames[:FRAMES_AT] for q in f.quality} == {int(Quality.MISSING)}
    assert np.isnan([f.values[VANE] for f in frames[:FRAMES_AT]]).all()
    seen = [f.values[VANE] for f in frames[FRAMES_AT:]]
    # A line between samples 5 ms apart is off a sine of 1 Hz by (2 pi 0.005 s)^2/8 of its height, the mean over a tick
    # by (2 pi 0.02 s)^2/24 more.
    assert seen == pytest.approx([wave(f.t_ns) for f in frames[FRAMES_AT:]], abs=0.1 * 1e-3)
    assert [a.t_ns for a in alphas] == [f.t_ns for f in frames[ESTIMATORS_AT:]]
    assert estimator.frames == len(alphas)


def test_links_are_watched_before_frames_are_ready():
    log, _ = flown()
    first = next(r for r in log[: log.index(next(f for f in log if isinstance(f, Frame) and f.k == 60))][::-1]
                 if isinstance(r, Health))  # fmt: skip
    (link,) = first.streams
    assert link.alive
    assert link.samples > 150


@pytest.mark.parametrize("jump_at", [None, 40, FRAMES_AT - 1, FRAMES_AT + 10])
def test_a_replay_gives_the_same_rows(jump_at):
    log, _ = flown(jump_at)
    found, estimator = Comparison(), Counting()
    run(recorded_beats(log), Aligner([STREAM], {}), lambda: Chain(estimator), None, None, found.take)
    assert (found.beats, found.different, found.first) == (50 * SECONDS, 0, "")
    assert found.rows == 50 * SECONDS + 50 * SECONDS - ESTIMATORS_AT


def test_estimators_that_never_join_end_no_flight():
    log, _ = flown()
    cut = [r for r in log if not (isinstance(r, Event) and r.code is Code.READY and r.source == ESTIMATORS)]
    cut = [r for r in cut if not isinstance(r, AlphaEstimate)]
    failed = Event(cut[-1].t_ns, ESTIMATORS, Code.ESTIMATOR, 1, "could not be prepared")
    k = max(i for i, r in enumerate(cut) if isinstance(r, Tick))
    found = Comparison()
    replayed = [*cut[:k], failed, *cut[k:]]
    run(recorded_beats(replayed), Aligner([STREAM], {}), lambda: pytest.fail("asked"), None, None, found.take)
    assert (found.beats, found.different) == (50 * SECONDS, 0)


def test_ticks_are_made_up_for_while_estimators_are_prepared_and_given_up_after():
    clock, preparing = ManualClock(0), [True]
    source = beats(Bus(), clock, LAG_S, threading.Event(), 2.0, lambda: preparing[0])
    ticks = [next(source).tick.k for _ in range(10)]
    clock.advance_s(0.2)
    ticks += [next(source).tick.k for _ in range(20)]
    assert ticks == list(range(30))
    preparing[0] = False
    clock.advance_s(0.2)
    assert next(source).tick.k > 35


def test_a_kernel_that_would_have_to_be_compiled_is_refused_in_this_thread_alone():
    @njit
    def twice(x):
        return 2 * x

    with refusing_to_compile():
        with pytest.raises(NotCompiled, match="twice"):
            twice(1)
        other = threading.Thread(target=twice, args=(1,))
        other.start()
        other.join()
        assert twice(1) == 2, "what is compiled is called"
        with pytest.raises(NotCompiled):
            twice(1.0)
    assert twice(1.0) == 2.0


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="Linux alone has it")
def test_what_compiles_has_an_ordinary_priority_under_a_flight_at_a_real_time_one():
    tell = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0) == os.SCHED_OTHER)"]
    found = []

    def preparing():
        try:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
        except PermissionError:
            return
        for step_back in (lambda: None, children_fly_behind):
            step_back()
            found.append(subprocess.run(tell, stdout=subprocess.PIPE, text=True, check=True).stdout.strip())
        found.append(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR)

    thread = threading.Thread(target=preparing)
    thread.start()
    thread.join()
    if not found:
        pytest.skip("this user may not fly at a real-time priority")
    assert found == ["False", "True", True]

"""The loop: schedule, order of rows, replay of what was recorded."""

import itertools
import math
import threading

from station.clock import ManualClock, asleep_ns
from station.conventions import TICK_NS, Stream
from station.flight.alignment import Aligner
from station.flight.bus import Bus
from station.flight.loop import Beat, Chain, beats, recorded_beats, run
from station.rows import AlphaEstimate, Code, Event, Frame, MethodEstimate, RawBlock, Sample, Tick

STREAMS = [Stream("boom.vanes", ("alpha_vane",), 200.0, 0.1, device="boom")]


class Echo:
    """An estimator that shows what it was given."""

    def __init__(self):
        self.points = 0

    def step(self, frame):
        a = frame.values[0]
        alpha = AlphaEstimate(frame.t_ns, a, *[math.nan] * 11, "unknown", *[math.nan] * 3, False, "echo")
        return alpha, (MethodEstimate(frame.t_ns, "II", (), False, f"{self.points}"),)

    def start_point(self):
        self.points += 1


def joined(estimator):
    """The estimator as a flight has it from its first tick on."""
    return lambda: Chain(estimator)


class Recorder:
    def __init__(self):
        self.rows = []

    def append(self, rows):
        self.rows.extend(rows)

    def flush(self):
        pass


def record(seconds=1.0, late_at=None):
    clock, bus, log = ManualClock(10_000_000_000), Bus(), Recorder()
    stop = threading.Event()

    def feeding():
        for beat in beats(bus, clock, 0.06, stop, seconds):
            now = clock.now_ns()
            bus.put(RawBlock(now, "boom", b"\x01"))
            for i in range(4):
                t = now + i * 5_000_000
                bus.put(Sample(t, "boom.vanes", None, None, (0.01 * math.sin(t * 1e-9),)))
            if beat.tick.k == 20:
                bus.put(Event(now, "operator", Code.POINT_START, 1, "test point 1"))
            yield beat
            if late_at is not None and beat.tick.k == late_at:
                clock.advance_s(0.07)

    run(feeding(), Aligner(STREAMS, {}), joined(Echo()), log, None)
    return log.rows


def test_ticks_keep_an_absolute_schedule():
    ticks = [r for r in record() if isinstance(r, Tick)]
    assert len(ticks) == 50
    assert {b.t_ns - a.t_ns for a, b in itertools.pairwise(ticks)} == {TICK_NS}
    assert all(t.t_ns - t.frame_t_ns == 60_000_000 for t in ticks)


def test_an_overrun_is_told_and_its_slots_skipped_without_a_burst():
    rows = record(late_at=10)
    ticks = [r for r in rows if isinstance(r, Tick)]
    assert [t.k for t in ticks][10:12] == [10, 13]
    assert all((t.t_ns - ticks[0].t_ns) == t.k * TICK_NS for t in ticks)
    (overrun,) = [r for r in rows if isinstance(r, Event) and r.code is Code.OVERRUN]
    assert overrun.count == 2


def test_every_stage_is_logged_before_the_next():
    kinds = [type(r) for r in record() if not isinstance(r, (Event, RawBlock, Sample))]
    kinds = [k for k in kinds if k in (Tick, Frame, AlphaEstimate, MethodEstimate)]
    assert kinds == [Tick, Frame, AlphaEstimate, MethodEstimate] * 50


def test_a_recording_replays_to_the_same_rows():
    rows = record(late_at=10)
    again, differences = Recorder(), []

    def compare(beat: Beat, made):
        if list(beat.recorded) != list(made):
            differences.append((beat.tick.k, beat.recorded, made))

    run(recorded_beats(rows), Aligner(STREAMS, {}), joined(Echo()), again, None, compare)
    repeated = [r for r in again.rows if isinstance(r, MethodEstimate)]
    assert [r.why for r in repeated] == ["0"] * 19 + ["1"] * 29  # the test point resets at the same tick
    assert not [d for d in differences if repr(d[1]) != repr(d[2])]


def test_an_estimator_that_fails_does_not_end_the_flight():
    class Failing(Echo):
        def step(self, frame):
            if 10 <= frame.k < 15 or frame.k == 20:
                raise ZeroDivisionError("division by zero")
            return super().step(frame)

    log, again, differences = Recorder(), Recorder(), []
    bus = Bus()
    source = beats(bus, ManualClock(10**10), 0.06, threading.Event(), 1.0)
    run(source, Aligner(STREAMS, {}), joined(Failing()), log, None)
    alphas = [r for r in log.rows if isinstance(r, AlphaEstimate)]
    assert len(alphas) == 50
    assert [k for k, a in enumerate(alphas) if "division by zero" in a.why] == [10, 11, 12, 13, 14, 20]
    assert not any(a.valid for a in alphas)
    told = [r for r in log.rows if isinstance(r, Event) and r.code is Code.ESTIMATOR]
    assert [(e.t_ns, e.detail) for e in told] == [
        (alphas[k].t_ns, "ZeroDivisionError: division by zero") for k in (10, 20)
    ]

    def compare(beat: Beat, made):
        if repr(list(beat.recorded)) != repr(list(made)):
            differences.append(beat.tick.k)

    run(recorded_beats(log.rows), Aligner(STREAMS, {}), joined(Failing()), again, None, compare)
    assert differences == []


def test_a_cut_recording_replays_up_to_its_last_tick():
    rows = record()
    cut = rows[: len(rows) * 2 // 3]
    whole = list(recorded_beats(rows))
    part = list(recorded_beats(cut))
    assert [b.tick for b in part] == [b.tick for b in whole][: len(part)]
    assert [list(b.rows) for b in part] == [list(b.rows) for b in whole][: len(part)]


def test_the_bus_drops_the_oldest_and_says_so():
    bus = Bus(capacity=10)
    for t in range(25):
        bus.put(RawBlock(t, "boom", b""))
    rows = bus.drain()
    assert [r.t_ns for r in rows if isinstance(r, RawBlock)] == list(range(15, 25))
    (event,) = [r for r in rows if isinstance(r, Event)]
    assert (event.code, event.count, bus.dropped) == (Code.DROPPED, 15, 15)


def test_the_bus_takes_rows_from_many_threads():
    bus = Bus()

    def feed(n):
        for t in range(2000):
            bus.put(RawBlock(t, f"d{n}", b""))

    threads = [threading.Thread(target=feed, args=(n,)) for n in range(4)]
    for t in threads:
        t.start()
    rows = []
    while any(t.is_alive() for t in threads):
        rows += bus.drain()
    for t in threads:
        t.join()
    rows += bus.drain()
    for n in range(4):
        assert [r.t_ns for r in rows if r.device == f"d{n}"] == list(range(2000))


def test_a_machine_that_slept_says_for_how_long_and_skips_no_tick():
    clock, bus, slept = ManualClock(10**10), Bus(), [7 * 10**9]

    def asleep_ns():
        if clock.now_ns() > 10**10 + TICK_NS * 20:
            return slept[0] + 3_200_000_000
        return slept[0] + 90_000_000 * (clock.now_ns() > 10**10 + TICK_NS * 10)  # a busy machine's reading

    source = beats(bus, clock, 0.06, threading.Event(), 1.0, asleep_ns=asleep_ns)
    found = [(beat.tick.k, row) for beat in source for row in beat.rows]
    ((k, event),) = found
    assert (k, event.code, event.source) == (20, Code.SUSPEND, "loop")
    assert event.detail.startswith("the machine slept for 3.2 s of which nothing is recorded; it is 20")


def test_the_system_tells_how_long_it_slept():
    """Since it was switched on, so it never runs backwards; a machine that never slept says 0."""
    assert asleep_ns() + 1_000_000 >= 0

"""A flight in real time over pty, CAN and UDP in which every device fails in every way, one after the other.

The emulators' script is the truth: each fault must be flagged within half a second in the log and on the screen, the
estimate marked, and the devices that are well must lose nothing.
"""

import dataclasses
import gc
import threading
from itertools import pairwise

import pytest

from drivers.adapter import open_devices
from drivers.emulation import serve
from station.clock import SystemClock
from station.estimation.methods import Estimator
from station.flight.alignment import Aligner
from station.flight.board import Board
from station.flight.bus import Bus
from station.flight.loop import Chain, beats, run
from station.profile import Fault, Flight, load_card
from station.rows import AlphaEstimate, Code, Event, Sample

S = 1_000_000_000
FLAGS = {
    "off": {Code.STALE, Code.SLOW},
    "stuck": {Code.STUCK},
    "garbage": {Code.CRC},
    "wrong": {Code.JUMP, Code.RANGE},
    "slow": {Code.SLOW},
    "delayed": {Code.LATE, Code.STALE, Code.SLOW},
    "intermittent": {Code.GAP, Code.SLOW, Code.STALE},
    "clock_step": {Code.CLOCK_STEP},
    "unplug": {Code.DISCONNECT, Code.STALE, Code.SLOW},
}
VALUES = {"slow": 4.0, "delayed": 0.2, "intermittent": 0.6, "clock_step": 5.0, "garbage": 0.5}
WRONG = {
    "bench": {
        "boom": ("vanes", "alpha_vane", 0.3),
        "autopilot": ("attitude", "theta", 0.35),
        "can": ("gyro", "q", 0.8),
    },
    "boom_serial": {"boom": ("vanes", "alpha_vane", 0.3), "gnss": ("fix", "v_north", 60.0)},
    "mixed": {"gnss": ("track", "v_east", 60.0)},
    "can_only": {"can": ("vanes", "alpha_vane", 0.3)},
    "mavlink_only": {"autopilot": ("vanes", "alpha_vane", 0.3)},
}
STUCK = {
    "bench": {"boom": "vanes", "can": "gyro", "autopilot": "velocity"},
    "boom_serial": {"boom": "vanes", "gnss": "fix"},
    "mixed": {"gnss": "track"},
    "can_only": {"can": "vanes"},
    "mavlink_only": {"autopilot": "vanes"},
}
LINKS = ["bench", "boom_serial", "mixed", "can_only", "mavlink_only", "mavlink_only tcp:", "mavlink_only /"]
"""A rig, and where its autopilot is to be found if not at its UDP port: on TCP, on a serial line."""
RIGS = [pytest.param(rig, marks=[pytest.mark.slow] if LINKS.index(rig) else []) for rig in LINKS]
"""Packets, CAN and MAVLink in every run; text lines, UBX, NMEA, and MAVLink otherwise carried, when there is time."""
FIRST_S, EVERY_S, LAST_S = 6.0, 4.5, 1.0
"""The first fault; how soon a device has its next one, others having theirs between; how long each lasts. A vane that
was wrong or unplugged is away for 2 s, so the autopilot's turn is before that of the gyros."""


def script(rig):
    """One fault after another, each half a second or more after the last is over."""
    faults, start = [], FIRST_S
    apart = min(2.4, EVERY_S / len(WRONG[rig]))
    for kind in FLAGS:
        for device, wrong in WRONG[rig].items():
            stream, signal, offset = wrong if kind == "wrong" else (None, None, VALUES.get(kind, 0.0))
            if kind == "stuck":
                stream = STUCK[rig][device]
            what = {"stream": stream, "signal": signal, "value": offset}
            faults.append(Fault(device=device, kind=kind, start=f"{start} s", duration=f"{LAST_S} s", **what))
            start += apart
    return tuple(faults), start


class Log:
    def __init__(self):
        self.rows = []

    def append(self, rows):
        self.rows.extend(rows)

    def flush(self):
        pass


@dataclasses.dataclass
class Flown:
    rows: list
    start_ns: int
    faults: tuple
    rig: str
    seen: list
    """(station time, device, flags) of every tick that the screen showed a flag at."""


STILL_SLOTS = 5
"""Slots of the loop given up at once, 0.1 s: a fifth of what a flag may take."""


@pytest.fixture(scope="module", params=RIGS)
def flown(request):
    """A flight in which the machine did not stand still, or the third: what is told late there may be the machine's."""
    for _ in range(3):
        made = fly(request.param)
        if not any(isinstance(r, Event) and r.code is Code.OVERRUN and r.count >= STILL_SLOTS for r in made.rows):
            break
    return made


def fly(link):
    name, _, url = link.partition(" ")
    faults, seconds = script(name)
    profiles = load_card(name)
    card = profiles.card.model_copy(update={"faults": faults, "flight": Flight(seed=5)})
    profiles = profiles.model_copy(update={"card": card})
    if url:
        devices = tuple(d.model_copy(update={"url": url}) for d in profiles.rig.devices)
        profiles = profiles.model_copy(update={"rig": profiles.rig.model_copy(update={"devices": devices})})
    clock, bus, stop, told, ready = SystemClock(), Bus(), threading.Event(), [], threading.Event()

    def announce(what):
        told.append(what)
        if "start_ns" in what:
            ready.set()

    estimator = Estimator(profiles.aircraft, card, profiles.rig.imu_position, profiles.rig.frame_noise_si())
    estimator.warm_up()
    streams = list(profiles.rig.streams())
    aligner = Aligner(streams, profiles.rig.noise_si())
    aligner.begin()  # this too compiles: before the devices' clock runs, for the first fault comes at its sixth second
    emulators = threading.Thread(target=serve, args=(profiles, announce, stop, clock))
    emulators.start()
    try:
        assert ready.wait(120)
        start_ns = next(t["start_ns"] for t in told if "start_ns" in t)
        endpoints = {t["device"]: t["endpoint"] for t in told if "device" in t}
        adapters = open_devices(profiles.rig, endpoints, profiles.rig_dir, clock, bus.put)
        board, log, seen = Board(profiles, clock), Log(), []

        def show(rows):
            board.update(rows)
            now = clock.now_ns()
            for s in streams:
                flags = board.flags(s.name, s.device, now)
                if flags:
                    seen.append((now, s.device, set(flags)))

        for adapter in adapters:
            adapter.start()
        try:
            gc.freeze()  # as in a flight: a collection of all that was imported and compiled stops the readers
            run(beats(bus, clock, card.lag, stop, seconds), aligner, lambda: Chain(estimator), log, show)
        finally:
            for adapter in adapters:
                adapter.stop()
    finally:
        stop.set()
        emulators.join()
        gc.unfreeze()
    return Flown(log.rows, start_ns, faults, name, seen)


def window(flown, fault, after_s=0.5):
    """The fault's start and the time by which it must be flagged, ns."""
    start = flown.start_ns + round(fault.start * S)
    return start, start + round(after_s * S)


@pytest.mark.parametrize("kind", FLAGS)
def test_a_fault_is_flagged_in_the_log_and_on_the_screen_within_half_a_second(flown, kind):
    for device in WRONG[flown.rig]:
        flagged(flown, kind, device)


def flagged(flown, kind, device):
    fault = next(f for f in flown.faults if (f.kind, f.device) == (kind, device))
    start, end = window(flown, fault)
    events = [r for r in flown.rows if isinstance(r, Event) and r.source.split(".")[0] == device]
    assert any(start <= e.t_ns <= end and e.code in FLAGS[kind] for e in events), [
        (round((e.t_ns - start) / S, 2), e.code) for e in events if abs(e.t_ns - start) < 2 * S
    ]
    shown = any(start <= t <= end + S // 20 and d == device and codes & FLAGS[kind] for t, d, codes in flown.seen)
    assert shown, device


@pytest.mark.parametrize("kind", ["off", "stuck", "wrong", "unplug", "delayed"])
def test_the_estimate_is_marked(flown, kind):
    for fault in flown.faults:
        if fault.kind == kind and gives(flown.rig, fault.device, ("alpha_vane", "q")):
            start, end = window(flown, fault, 0.6)
            alphas = [r for r in flown.rows if isinstance(r, AlphaEstimate)]
            before = [a for a in alphas if start - S // 10 <= a.t_ns <= start]
            assert held_up(alphas, start) or all(a.valid for a in before), [(fault.device, a.why) for a in before]
            assert any(not a.valid and a.why for a in alphas if start < a.t_ns <= end), fault.device


def held_up(alphas, at):
    """Whether the machine let ticks pass in the second before, after which estimates may be invalid without a fault."""
    ticks = [a.t_ns for a in alphas if at - S <= a.t_ns <= at]
    return any(later - earlier > 1.5 * S / 50 for earlier, later in pairwise(ticks))


def gives(rig, device, signals):
    """Whether the angle of attack rests on the device."""
    streams = next(d for d in load_card(rig).rig.devices if d.name == device).streams
    return any(name in s.signals for s in streams for name in signals)


def test_a_stream_that_is_well_loses_no_sample(flown):
    for stream in load_card(flown.rig).rig.streams():
        complete(flown, stream.name, stream.rate_hz)


def complete(flown, stream, rate):
    """By the device's own clock: no step longer than a period but near its own device's faults."""
    device = stream.split(".")[0]
    own = [(window(flown, f)[0], f) for f in flown.faults if f.device == device]
    samples = [r for r in flown.rows if isinstance(r, Sample) and r.stream == stream]
    settled = flown.start_ns + 3 * S
    well = [
        (a, b)
        for a, b in pairwise(samples)
        if a.t_ns > settled and not any(t - S // 4 <= b.t_ns <= t + round((LAST_S + 0.75) * S) for t, _ in own)
    ]
    free_s = (flown.rows[-1].t_ns - settled) / S - len(own) * (LAST_S + 1)
    assert len(well) > rate * free_s - 2 * len(own) - 0.1 * rate
    if samples[0].t_device_ns is not None:  # AIRSPEED has no time: it is counted only
        # A stamp in whole milliseconds puts a millisecond on top.
        assert max(b.t_device_ns - a.t_device_ns for a, b in well) < 1.5e9 / rate + 1e6

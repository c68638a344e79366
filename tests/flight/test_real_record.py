"""NASA's Twin Otter record flown over serial, CAN and MAVLink, in lock step, and estimated as live.

Each emulated device's bytes come to its production adapter and codec when they are due on the adapter's own clock, so
nothing rests on how busy this machine is. The same record fed to the same estimator straight from the imported file is
the reference: what the wires may add is quantisation, and skew between three device clocks hours apart. Tolerance 1 %
of each derivative.
"""

import subprocess
import sys
import threading
from bisect import insort
from collections import deque

import numpy as np
import pytest
from records import record

from drivers.adapter import Adapter, open_devices
from drivers.emulated_device import wire_of
from drivers.emulated_messages import DeviceScript
from drivers.emulation import Playback
from station.clock import ManualClock
from station.commands.cards import load, recorded_flight
from station.conventions import SIGNALS, TICK_NS
from station.convert import import_file
from station.estimation.methods import Estimator
from station.flight.alignment import Aligner
from station.flight.bus import Bus
from station.flight.chain import chain
from station.flight.loop import beats, run
from station.log import About, LogWriter, metadata, read_rows, table
from station.profile import load_aircraft
from station.rows import AlphaEstimate, Frame, MethodEstimate, Quality, Status

LEAD_S = 25.0
CARD = """
name = "real_record"
aircraft = "twin_otter"
rig = "bench"
emulate = true
needs = ["alpha_vane", "airspeed", "q", "ax", "az", "theta", "elevator"]
[flight]
source = "recording"
recording = "{recording}"
lead_in = "{lead} s"
"""


START_NS = 10**12
JOURNEY_NS = 1_000_000
"""From a device to the station, each way."""


class Link:
    """An open port whose device speaks when its messages are due: reading moves the clock there."""

    def __init__(self, clock, due, answer):
        self.over = threading.Event()
        self._clock, self._due, self._answer = clock, deque(due), answer

    def read(self, timeout_s):
        if not self._due:
            self.over.set()
            return b""
        until_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        self._clock.sleep_until_ns(min(self._due[0][0], until_ns))
        return self._due.popleft()[1] if self._due[0][0] <= self._clock.now_ns() else b""

    def write(self, data):
        now_ns = self._clock.now_ns()
        reply = self._answer(data, now_ns + JOURNEY_NS)
        if reply:
            insort(self._due, (now_ns + 2 * JOURNEY_NS, reply))

    def close(self):
        self.over.set()


def spoken(index, profiles, recording, folder):
    """What device number `index` sends, [(arrival ns, bytes)], and how it answers at a station time."""
    device = profiles.rig.devices[index]
    wire = wire_of(device, profiles.rig_dir, folder)
    wire.port.close()
    playback = Playback(recording)
    absent = {s for stream in device.streams for s in stream.signals} - playback.signals
    script = DeviceScript(index, device, profiles.card, START_NS, wire.encode, wire.also, absent)
    truth = playback.advance(10**6)
    missing = np.full(len(truth["q"]), np.nan)
    made = script.extend(np.column_stack([truth.get(name, missing) for name in script.signals]))
    due = [(m.due_ns + JOURNEY_NS, data) for m in made if (data := script.encode(m))]
    return due, lambda data, t_ns: wire.answer(data, script.clock.at(t_ns)) if wire.answer else b""


def heard(profiles, recording, folder):
    """The rows that the adapters make of it, by arrival."""
    rows = []
    endpoints = {device.name: "nowhere" for device in profiles.rig.devices}
    for index, made in enumerate(open_devices(profiles.rig, endpoints, profiles.rig_dir, ManualClock(), rows.append)):
        clock = ManualClock(START_NS)
        link = Link(clock, *spoken(index, profiles, recording, folder))
        adapter = Adapter(made.device, made.codec, lambda link=link: link, clock, rows.append)
        adapter.start()
        assert link.over.wait(300)
        adapter.stop()
    return sorted(rows, key=lambda row: row.t_ns)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The imported record and the station's own recording of it."""
    folder = tmp_path_factory.mktemp("real")
    imported, path = folder / "demo.mcap", folder / "real_record.toml"
    import_file(record("twin_otter/totter_demo_data.mat"), imported, load_aircraft("twin_otter"))
    path.write_text(CARD.format(recording=imported, lead=LEAD_S))
    profiles = load(str(path))
    recording = recorded_flight(profiles)
    there = Playback(recording).signals
    streams = tuple(s for s in profiles.rig.streams() if there & set(s.signals))
    rows = deque(heard(profiles, recording, folder))
    clock = ManualClock(START_NS)
    bus, stop = Bus(), threading.Event()
    writer = LogWriter(folder, About(profiles.aircraft, streams, profiles.rig, profiles.card), clock, bus.put, "flown")

    def arriving():
        for beat in beats(bus, clock, profiles.card.lag, stop, 36.0):
            due = []
            while rows and rows[0].t_ns <= beat.tick.t_ns:
                due.append(rows.popleft())
            yield beat._replace(rows=[*beat.rows, *due])

    made = chain(profiles.aircraft, profiles.card, profiles.rig)
    run(arriving(), Aligner(streams, profiles.rig.noise_si()), lambda: made, writer)
    writer.close()
    return imported, writer.path


def estimates_of(rows):
    """Each method's last estimates, as long as the angle of attack was measured."""
    last, usable = {}, False
    for row in rows:
        if isinstance(row, AlphaEstimate):
            usable = row.valid
        elif usable and row.applicable:
            last[row.method] = {p.name: p for p in row.parameters}
    return last


def reference(imported, log):
    """The estimator over the imported record, from the signals that the rig carries, behind the same lead-in."""
    record, about = table(imported), metadata(log).about
    carried = {s for stream in about.streams for s in stream.signals}
    columns = {n: c for n, c in record.columns.items() if n in carried}
    held = round(LEAD_S * 50)
    estimator = Estimator(about.aircraft, about.card, about.rig.imu_position, about.rig.frame_noise_si())
    rows = []
    for k in range(held + len(record.t_s)):
        now = {n: float(c[max(k - held, 0)]) for n, c in columns.items()}
        values = tuple(now.get(n, np.nan) for n in SIGNALS)
        ages = tuple(0.0 if n in now else np.nan for n in SIGNALS)
        quality = tuple(int(Quality.FRESH if n in now else Quality.MISSING) for n in SIGNALS)
        alpha, methods = estimator.step(Frame(k * TICK_NS, k, values, ages, quality))
        rows += [alpha, *methods]
    return estimates_of(rows)


def test_derivatives_over_the_wires_are_those_of_the_file(flown):
    imported, log = flown
    expected = reference(imported, log)
    live = estimates_of(read_rows(log, (AlphaEstimate, MethodEstimate)))
    for method in ("II", "split"):
        for name, p in expected[method].items():
            assert p.status is Status.ESTIMATED
            assert live[method][name].value == pytest.approx(p.value, rel=0.01), (method, name)


def test_replay_gives_the_same_bits_while_both_cores_are_busy(flown):
    _, log = flown
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        words = [sys.executable, "-m", "station", "replay", str(log), "--verify"]
        done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert done.returncode == 0, done.stdout + done.stderr
    assert ", 0 different" in done.stdout


def test_signals_over_the_wires_are_those_of_the_file(flown):
    """Within the wires' steps: 0.005 deg of the boom box, 0.025 deg/s and 1 mg of the CAN bus, averaged over a tick."""
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    imported, log = flown
    record, seen = table(imported), table(log)

    def differences(name, start_s):
        inside = (seen.t_s > start_s + 0.2) & (seen.t_s < start_s + 7.8) & np.isfinite(seen.columns[name])
        return seen.columns[name][inside] - CubicSpline(record.t_s, record.columns[name])(seen.t_s[inside] - start_s)

    guesses = np.arange(LEAD_S - 1, LEAD_S + 2, 0.01)
    near = guesses[np.argmin([np.mean(differences("alpha_vane", g) ** 2) for g in guesses])]
    bounds = (near - 0.02, near + 0.02)
    start = {}
    for name in ("alpha_vane", "elevator", "q", "az", "theta"):
        cost = lambda s, name=name: float(np.mean(differences(name, s) ** 2))  # noqa: E731
        start[name] = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-6}).x
    # 1 ms of skew would move CL_q by 2 %.
    assert np.ptp(list(start.values())) < 1e-3
    for name, step in (("alpha_vane", np.radians(0.005)), ("elevator", np.radians(0.005)), ("q", np.radians(0.025))):
        assert np.std(differences(name, start[name])) < step

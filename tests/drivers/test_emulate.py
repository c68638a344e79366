"""Emulated devices end to end: processes, real links, the production adapters; nothing left behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can  # noqa: F401 - takes seconds; the adapter would miss the first of the flight importing it
import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

from drivers.adapter import open_devices
from drivers.emulation import Playback, serve
from station.clock import SystemClock
from station.profile import Profiles, load_card
from station.rows import Code, DeviceError, Event, ProfileError, Rows, Sample, TimeSync

T = np.arange(0.0, 6.0, 0.02)


def recorded() -> dict[str, NDArray[np.float64]]:
    """A made-up record of 6 s at 50 Hz: every signal of the bench rig but the beta vane."""
    waves = ("alpha_vane", "elevator", "p", "q", "r", "ax", "ay", "phi", "theta", "psi", "v_east", "v_down")
    swing = {name: 0.1 * np.sin(2 * np.pi * 0.4 * T + i) for i, name in enumerate((*waves, "aileron", "rudder"))}
    level = {
        "az": -9.8,
        "airspeed": 56.6,
        "dynamic_pressure": 1800.0,
        "static_pressure": 92_500.0,
        "air_temperature": 283.0,
        "v_north": 56.0,
        "latitude": 0.7,
        "longitude": -1.4,
        "altitude": 762.0,
    }
    return {"time": T + 100.0, **swing, **{n: v + np.sin(T) * 1e-3 for n, v in level.items()}}


def profiles(rig: str = "bench", **card: Any) -> Profiles:
    loaded = load_card(rig)
    flight = loaded.card.flight.model_copy(update={"source": "recording"})
    return loaded.model_copy(update={"card": loaded.card.model_copy(update={"flight": flight, **card})})


def test_a_recording_is_played_through_its_values_and_smoothly_between() -> None:
    playback = Playback(recorded())
    rows = [playback.advance(7) for _ in range(172)]
    q = np.concatenate([r["q"] for r in rows])
    assert playback.duration_s == pytest.approx(5.98)
    assert len(q) == 1197
    assert len(rows[-1]["q"]) == 0
    np.testing.assert_allclose(q[::4], recorded()["q"], atol=1e-12)
    t = np.arange(len(q)) / 200
    np.testing.assert_allclose(q[8:-8], (0.1 * np.sin(2 * np.pi * 0.4 * t + 3))[8:-8], atol=2e-7)


def test_missing_values_are_bridged_and_missing_signals_are_not_invented() -> None:
    record = recorded()
    record["q"][150:160] = np.nan
    record["theta"][:] = np.nan
    record["psi"] = np.remainder(0.3 * T + 3.0 + np.pi, 2 * np.pi) - np.pi  # passes +-180 deg
    playback = Playback(record)
    assert "theta" not in playback.signals
    assert "beta_vane" not in playback.signals
    rows = playback.advance(4000)
    np.testing.assert_allclose(rows["q"][600:640], np.interp(np.arange(600, 640) / 200, T, recorded()["q"]), atol=5e-3)
    np.testing.assert_allclose(np.diff(rows["psi"]), 0.3 / 200, atol=1e-9)


@pytest.mark.parametrize("time", [[], [0.0], [0.0, 1.0, 1.0], [2.0, 1.0, 3.0]])
def test_a_recording_without_usable_time_is_refused(time: list[float]) -> None:
    with pytest.raises(DeviceError, match="time"):
        Playback({"time": np.array(time), "q": np.zeros(len(time))})


def test_a_card_that_flies_a_recording_needs_one() -> None:
    with pytest.raises(DeviceError, match="recording"):
        serve(profiles(), lambda _: None, threading.Event(), SystemClock())


@contextmanager
def emulated(flown: Profiles) -> Iterator[tuple[dict[str, str], list[dict[str, Any]]]]:
    """Endpoints once the flight has begun, and everything announced."""
    told: list[dict[str, Any]] = []
    begun, stop = threading.Event(), threading.Event()

    def announce(line: dict[str, Any]) -> None:
        told.append(line)
        if "start_ns" in line:
            begun.set()

    failed: list[BaseException] = []

    def run() -> None:
        try:
            serve(flown, announce, stop, SystemClock(), recorded())
        except BaseException as error:
            failed.append(error)
            begun.set()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        assert begun.wait(60.0)
        assert not failed
        yield {line["device"]: line["endpoint"] for line in told if "device" in line}, told
    finally:
        stop.set()
        thread.join(20.0)
    assert not thread.is_alive()
    assert not failed


def wait_for(condition: Callable[[], bool], seconds: float = 20.0) -> bool:
    patience = threading.Event()
    return any(condition() or patience.wait(0.05) for _ in range(int(seconds / 0.05)))


def test_all_links_at_once_from_process_to_sample() -> None:
    threads, descriptors = threading.active_count(), len(os.listdir("/proc/self/fd"))
    unplug = {"device": "can", "kind": "unplug", "start": "4 s", "duration": "0.7 s"}
    flown = profiles()
    with_fault = type(flown.card).model_validate(
        {"name": "t", "aircraft": "twin_otter", "rig": "bench", "faults": [unplug], "flight": {"source": "recording"}}
    )
    flown = flown.model_copy(update={"card": with_fault})
    rows: list[Rows] = []
    with emulated(flown) as (endpoints, told):
        assert [line["link"] for line in told if "device" in line] == ["serial", "can", "mavlink"]
        assert told[-1]["absent"] == ["beta_vane"]
        folder = Path(endpoints["boom"]).parent
        adapters = open_devices(flown.rig, endpoints, flown.rig_dir, SystemClock(), rows.append)
        for adapter in adapters:
            adapter.start()
        try:
            assert wait_for(lambda: any(isinstance(r, Event) and r.code == Code.RECONNECT for r in rows))
            seen = len(rows)
            assert wait_for(lambda: any(isinstance(r, Sample) and r.stream == "can.gyro" for r in rows[seen:]))
            # The record ends, and with it the messages.
            assert wait_for(lambda: "end_s" in told[-1])
        finally:
            for adapter in adapters:
                adapter.stop()
    start_ns = told[-2]["start_ns"]
    assert told[-1]["end_s"] == pytest.approx(5.985)
    assert max(r.t_ns for r in rows if isinstance(r, Sample)) - start_ns == pytest.approx(5.985e9, rel=0.02)
    events = [(r.source, r.code) for r in rows if isinstance(r, Event) and r.code not in (Code.CONNECT, Code.HEARD)]
    assert events[:2] == [("can", Code.DISCONNECT), ("can", Code.RECONNECT)]
    assert any(isinstance(r, TimeSync) for r in rows)
    record = recorded()
    for stream, profile in ((f"{d.name}.{s.name}", s) for d in flown.rig.devices for s in d.streams):
        samples = [r for r in rows if isinstance(r, Sample) and r.stream == stream]
        arrivals = np.array([(r.t_ns - start_ns) * 1e-9 for r in samples])
        # Nothing is lost but by the unplug; the stamps say the rate, however busy this machine is.
        stamps = np.array([(r.t_device_ns or 0) * 1e-9 for r in samples])
        plugged = stamps[arrivals < 3.9]
        assert (len(plugged) - 1) / (plugged[-1] - plugged[0]) == pytest.approx(profile.rate, rel=0.02), stream
        if profile.rate < 100 or "elevator" not in profile.signals:
            continue
        column = list(profile.signals).index("elevator")
        values = np.array([r.values[column] for r in samples])
        # By the stamps, whose clock the quickest sample tells: a busy machine may be late by half a second. The record
        # moves by 0.25 rad/s at most.
        shown = stamps + (arrivals - stamps).min()
        np.testing.assert_allclose(values, np.interp(shown, record["time"] - 100.0, record["elevator"]), atol=0.005)
    assert not folder.exists()
    assert multiprocessing.active_children() == []
    assert threading.active_count() == threads
    # Python's own resource tracker, started with the first child process, stays and holds one descriptor.
    assert len(os.listdir("/proc/self/fd")) <= descriptors + 1


def test_what_keeps_the_flight_from_starting_is_raised_and_leaves_nothing() -> None:
    flown = profiles("can_only")
    device = flown.rig.devices[0].model_copy(update={"dbc": "no_such.dbc"})
    flown = flown.model_copy(update={"rig": flown.rig.model_copy(update={"devices": (device,)})})
    with pytest.raises(ProfileError, match=r"no_such\.dbc"):
        serve(flown, lambda _: None, threading.Event(), SystemClock(), recorded())
    assert multiprocessing.active_children() == []


def test_a_simulation_that_fails_is_reported_and_level_flight_is_not_passed_off_for_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def failing(*_: Any) -> None:
        raise MemoryError("no room for the gust field")

    monkeypatch.setattr("station.simulation.sortie.installed", failing)
    said: list[dict[str, Any]] = []
    stop = threading.Event()

    def announce(words: dict[str, Any]) -> None:
        said.append(words)
        if "error" in words:
            stop.set()

    overdue = threading.Timer(30.0, stop.set)
    overdue.start()
    serve(load_card("boom_serial"), announce, stop, SystemClock())
    overdue.cancel()
    assert said[-1]["process"] == "flight"
    assert "the simulation cannot be flown: MemoryError: no room for the gust field" in said[-1]["error"]


KILLED = """
import threading
from drivers.emulation import serve
from station.clock import SystemClock
from station.profile import load_card

if __name__ == "__main__":
    serve(load_card("boom_serial"), lambda line: print(line, flush=True), threading.Event(), SystemClock())
"""


def test_devices_end_with_the_process_that_serves_them_however_it_ends(tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    environment = {**os.environ, "TMPDIR": str(tmp_path), "PYTHONPATH": os.getcwd()}
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=environment) as server:
        assert server.stdout is not None
        for line in server.stdout:
            if "start_ns" in line:
                break
        children = psutil.Process(server.pid).children(recursive=True)
        assert len(children) >= 3
        server.send_signal(signal.SIGKILL)
        server.wait(10.0)
        _, alive = psutil.wait_procs(children, timeout=10.0)
        server.stdout.read()
    assert alive == []
    assert wait_for(lambda: list(tmp_path.glob("station-*")) == [], 5.0)

"""The emulated devices' process is waited for while it lives, and missed when it has died."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from drivers import emulation
from station.clock import ManualClock, SystemClock
from station.flight.bus import Bus
from station.flight.emulators import emulators
from station.profile import load_card
from station.rows import DeviceError

Announce = Callable[[dict[str, Any]], None]


def test_a_slow_start_is_waited_for_and_told(capsys: pytest.CaptureFixture[str]) -> None:
    def serve(announce: Announce, stop: threading.Event, *_: object) -> None:
        announce({"device": "boom", "link": "serial", "endpoint": "/dev/pts/9"})
        for seconds in (10, 20):
            announce({"preparing": "flight", "seconds": seconds})
        time.sleep(1.0)  # longer than the pipe is looked at
        announce({"start_ns": 5, "absent": []})
        stop.wait()

    with emulators(serve, Bus(), ManualClock()) as emulated:
        assert emulated.endpoints == {"boom": "/dev/pts/9"}
    told = capsys.readouterr().err.splitlines()
    assert told == [f"waiting for the emulated devices: flight, {n} s so far; Ctrl-C gives up" for n in (10, 20)]


def test_a_stray_line_of_the_devices_is_not_on_the_stations_standard_output(capfd: pytest.CaptureFixture[str]) -> None:
    def serve(announce: Announce, stop: threading.Event, *_: object) -> None:
        os.write(1, b"a library's stray line\n")
        announce({"start_ns": 5, "absent": []})
        stop.wait()

    with emulators(serve, Bus(), ManualClock()):
        pass
    told = capfd.readouterr()
    assert (told.out, told.err) == ("", "a library's stray line\n")


def test_devices_that_die_before_they_start_are_an_error_that_says_how() -> None:
    def serve(announce: Announce, stop: threading.Event, *_: object) -> None:
        os._exit(7)

    with (
        pytest.raises(DeviceError, match=r"ended before they had started \(exit status 7\)"),
        emulators(serve, Bus(), ManualClock()),
    ):
        pass


def test_a_flight_that_takes_its_time_is_announced_while_it_does(monkeypatch: pytest.MonkeyPatch) -> None:
    made = emulation._source

    def slowly(*words: Any) -> emulation.Source:
        time.sleep(0.5)
        return made(*words)

    monkeypatch.setattr(emulation, "_source", slowly)
    monkeypatch.setattr(emulation, "TELL_EVERY_S", 0.1)
    told: list[dict[str, Any]] = []
    stop = threading.Event()

    def hear(said: dict[str, Any]) -> None:
        told.append(said)
        if "start_ns" in said:
            stop.set()

    emulation.serve(load_card("boom_serial"), hear, stop, SystemClock())
    assert {"preparing": "flight", "seconds": 0} in told
    assert "start_ns" in told[-1]

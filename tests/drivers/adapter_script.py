"""An adapter fed by a script, and the rows that it gives."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence

from drivers.adapter import Adapter
from drivers.codec import Codec
from drivers.serial_boombox import BoomboxCodec
from station.clock import ManualClock
from station.profile import SerialDevice, profiles_dir
from station.rows import Code, Event, Rows, Sample

RIGS = profiles_dir() / "rigs"
PATIENCE_S = 20.0
GYRO = b"t10082800F6070069525F\r"
"""Worked out by hand in test_wire_formats: p = 1 deg/s, q = -2 deg/s, r = 0.025 deg/s."""


class Rowsink:
    """Takes rows from the adapter's thread and lets a test wait for one."""

    def __init__(self) -> None:
        self.rows: list[Rows] = []
        self._new: queue.SimpleQueue[Rows] = queue.SimpleQueue()

    def put(self, row: Rows) -> None:
        self._new.put(row)

    def wait_for(self, wanted: Callable[[Rows], bool]) -> Rows:
        while True:
            row = self._new.get(timeout=PATIENCE_S)
            self.rows.append(row)
            if wanted(row):
                return row

    def wait_for_event(self, code: Code) -> Event:
        row = self.wait_for(lambda r: isinstance(r, Event) and r.code == code)
        assert isinstance(row, Event)
        return row

    def wait_for_sample(self) -> Sample:
        row = self.wait_for(lambda r: isinstance(r, Sample))
        assert isinstance(row, Sample)
        return row

    def take_all(self) -> list[Rows]:
        while not self._new.empty():
            self.rows.append(self._new.get())
        return self.rows

    def events(self, code: Code) -> list[Event]:
        return [row for row in self.take_all() if isinstance(row, Event) and row.code == code]

    def samples(self) -> list[Sample]:
        return [row for row in self.take_all() if isinstance(row, Sample)]


class Script:
    """A port that hands out (seconds since the last, bytes) on a hand-moved clock, then stays silent."""

    def __init__(self, clock: ManualClock, steps: Sequence[tuple[float, bytes]]) -> None:
        self._clock = clock
        self._steps = iter(steps)
        self.played = threading.Event()
        self.written: list[bytes] = []
        self.closed = False
        self._gap = threading.Event()

    def read(self, timeout_s: float) -> bytes:
        step = next(self._steps, None)
        if step is None:
            self.played.set()
            self._gap.wait(timeout_s)
            return b""
        self._clock.advance_s(step[0])
        return step[1]

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def close(self) -> None:
        self.closed = True


def boom(**vanes: object) -> SerialDevice:
    signals = {"alpha_vane": {"field": "v0", "unit": "deg", "slope": 0.005, "zero": 100.0}, **vanes}
    return SerialDevice.model_validate(
        {
            "name": "boom",
            "link": "serial",
            "protocol": "boombox",
            "port": "nowhere",
            "streams": [{"name": "vanes", "message": 1, "rate": "200 Hz", "signals": signals}],
        }
    )


def play(
    steps: Sequence[tuple[float, bytes]], codec: Codec | None = None, device: SerialDevice | None = None
) -> tuple[Rowsink, Script]:
    clock = ManualClock(10**12)
    sink, port = Rowsink(), Script(clock, steps)
    adapter = Adapter(device or boom(), codec or BoomboxCodec(), lambda: port, clock, sink.put)
    adapter.start()
    assert port.played.wait(PATIENCE_S)
    adapter.stop()
    assert port.closed
    return sink, port

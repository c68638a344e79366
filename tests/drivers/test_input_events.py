"""Input events out of bytes, packed by hand as linux/input.h has them; and what comes through a pipe that is none."""

from __future__ import annotations

import os
import random
import struct
from pathlib import Path

import pytest

from drivers.input_events import InputEvents
from drivers.joystick import JoystickInput
from station.clock import SystemClock
from station.rows import Code
from tests.drivers.test_joystick import rig_loop

T = 1_764_000_000


def at(k: int) -> tuple[int, int]:
    """Seconds and microseconds of the kth movement."""
    return divmod(T * 1_000_000 + 8000 * k + 7, 1_000_000)


def wide(k: int, value: int) -> bytes:
    return b"".join(struct.pack("<qqHHi", *at(k), *event) for event in ((3, 1, value), (0, 0, 0)))


def narrow(k: int, value: int, timed: bool) -> bytes:
    when = at(k) if timed else (0, 0)
    return b"".join(struct.pack("<IIHHi", *when, *event) for event in ((3, 1, value), (0, 0, 0)))


def axis(events: list[tuple[int, int, int]]) -> list[int]:
    return [value for kind, code, value in events if (kind, code) == (3, 1)]


def test_events_are_the_same_however_they_are_cut() -> None:
    data = b"".join(wide(k, 100 * k) for k in range(20))
    for size in (1, 7, 24, 960):
        events = InputEvents()
        found = [e for i in range(0, len(data), size) for e in events.feed(data[i : i + size])]
        assert axis(found) == [100 * k for k in range(20)]
        assert events.passed_over == ""


@pytest.mark.parametrize("timed", [True, False])
def test_events_of_a_32_bit_machine_are_no_movement(timed: bool) -> None:
    events = InputEvents()
    moves = [random.Random(k).randint(-32_768, 32_767) for k in range(200)]
    assert axis(events.feed(b"".join(narrow(k, v, timed) for k, v in enumerate(moves)))) == []
    assert events.passed_over.endswith("it looks like a 32-bit machine's, of 16 bytes")


@pytest.mark.parametrize("stray", [b"garbage!!", b"\x00", bytes(23), random.Random(1).randbytes(1000)])
def test_stray_bytes_are_passed_over_and_what_follows_is_read(stray: bytes) -> None:
    events = InputEvents()
    assert axis(events.feed(wide(0, 5))) == [5]
    found = axis(events.feed(stray + b"".join(wide(k, 100 * k) for k in range(1, 10))))
    assert found[-7:] == [300, 400, 500, 600, 700, 800, 900]
    assert set(found) <= {100 * k for k in range(1, 10)}
    assert events.passed_over.startswith("passed over: b'")


def test_text_in_the_pipe_is_told_once_and_no_joystick(tmp_path: Path) -> None:
    path = tmp_path / "stick"
    os.mkfifo(path)
    come = JoystickInput(rig_loop(device=str(path)), SystemClock())
    taken: dict[str, float] = {}

    def receive() -> None:
        for descriptor in come.descriptors():
            come.receive(descriptor, 0, lambda _, name, value: taken.update({name: value}))

    with path.open("wb", buffering=0) as pipe:
        for _ in range(3):
            pipe.write(b"hello, this is not a joystick at all, sorry")
            receive()
        assert not come.holds
        ((_, code, words),) = come.told()
        assert code is Code.FOREIGN
        assert words.startswith("passed over: b'hello, this is not a joy'")
        pipe.write(b"".join(wide(k, 1000) for k in range(3)))
        receive()
        assert come.holds
        assert set(taken) == {"elevator"}
        assert [code for _, code, _ in come.told()] == [Code.CONNECT]
    come.close()


def test_who_writes_nothing_but_text_and_goes_is_no_longer_read(tmp_path: Path) -> None:
    """An end of file is ready to be read for ever."""
    path = tmp_path / "stick"
    os.mkfifo(path)
    come = JoystickInput(rig_loop(device=str(path)), SystemClock())
    with path.open("wb", buffering=0) as pipe:
        pipe.write(b"hello")
        come.receive(come.descriptors()[0], 0, lambda *_: None)
    come.receive(0, 0, lambda *_: None)
    assert come.descriptors() == []
    come.close()

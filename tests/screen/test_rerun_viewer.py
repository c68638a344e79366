"""The page in a viewer: served, drawn, stalled and killed."""

from __future__ import annotations

import os
import signal
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
from browser import Browser, chromium

from station.rows import (
    Code,
    Event,
)
from station.screen.rerun_feed import QUEUE_TICKS, View
from tests.screen.flown_rows import flight


class Flying:
    """A view fed at 50 Hz by a thread, as the loop would."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.view = View("web", "test", on_event=self.events.append)
        self.address = self.view.start()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._feed)
        self._thread.start()

    def _feed(self) -> None:
        for rows in flight(1_000_000):
            self.view.show(rows)
            if self._stop.wait(0.02):
                return

    def wait(self, condition: Callable[[], object], what: str, limit_s: float = 60.0) -> None:
        until = time.monotonic() + limit_s
        while not condition():
            assert time.monotonic() < until, f"{what}: not within {limit_s} s; told: {self.events}"
            time.sleep(0.05)

    def told(self, words: str) -> bool:
        return any(words in e.detail and e.code is Code.VIEW for e in self.events)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.view.close()


@pytest.fixture(scope="module")
def flying() -> Iterator[Flying]:
    made = Flying()
    family: list[psutil.Process] = []
    try:
        made.wait(lambda: made.view.alive, "page up")
        family = _family(made.view)
        yield made
    finally:
        family += _family(made.view)
        made.close()
        assert not [p for p in family if p.is_running() and p.status() != psutil.STATUS_ZOMBIE], "left running"


def _family(view: View) -> list[psutil.Process]:
    if view.pid is None:
        return []
    child = psutil.Process(view.pid)
    return [child, *child.children(recursive=True)]


def test_page_is_served_and_nothing_listens_beyond_loopback(flying: Flying) -> None:
    listening = [c.laddr for p in _family(flying.view) for c in p.net_connections() if c.status == psutil.CONN_LISTEN]
    assert len(listening) == 2
    assert {address.ip for address in listening} == {"127.0.0.1"}
    with urllib.request.urlopen(flying.address, timeout=10) as page:
        assert b"rerun" in page.read().lower()


def test_page_draws(flying: Flying, tmp_path: Path) -> None:
    corrected, vane = (np.array([c >> 24, c >> 16 & 255, c >> 8 & 255]) for c in (0x2BD9A5FF, 0xE69F00FF))
    with Browser(chromium(), tmp_path) as browser:
        empty = browser.picture()
        browser.open(flying.address)
        until = time.monotonic() + 90
        while True:
            time.sleep(1.0)
            picture = browser.picture()
            counts = [int((np.abs(picture - colour).max(axis=2) < 12).sum()) for colour in (corrected, vane)]
            if min(counts) > 300:
                break
            assert time.monotonic() < until, f"pixels in the lines' colours: {counts}"
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
    assert (picture != empty).any()


def test_a_stalled_page_is_reported_and_what_it_misses_is_counted(flying: Flying) -> None:
    pid = flying.view.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    try:
        flying.wait(lambda: flying.told("stalled"), "stall told")
        flying.wait(lambda: not flying.view.alive, "page not alive")
        ticks = flight(QUEUE_TICKS + 100)
        before = flying.view.dropped
        for rows in ticks:
            flying.view.show(rows)
        assert flying.view.dropped >= before + 50
    finally:
        os.kill(pid, signal.SIGCONT)
    flying.wait(lambda: flying.told("goes on") and flying.view.alive, "page goes on")
    assert flying.view.pid == pid


@pytest.mark.parametrize("victim", [0, 1], ids=["child", "server"])
def test_a_killed_page_is_reported_and_comes_back_at_the_same_address(flying: Flying, victim: int) -> None:
    family = _family(flying.view)
    told = len(flying.events)
    family[victim].kill()
    flying.wait(lambda: any("page lost" in e.detail for e in flying.events[told:]), "loss told")
    flying.wait(lambda: flying.view.alive, "page back")
    assert flying.view.address == flying.address
    flying.wait(
        lambda: not [p for p in family if p.is_running() and p.status() != psutil.STATUS_ZOMBIE], "old ones gone"
    )

"""The glance page: the terminal's content in a browser, its age, who may see it, and that no page costs the flight."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import os
import signal
import socket
import threading
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import msgspec
import psutil
import pytest
from browser import Browser, chromium

from station.clock import Clock, ManualClock, SystemClock
from station.conventions import LONGITUDINAL
from station.flight.board import Board
from station.rows import (
    AlphaEstimate,
    Code,
    Event,
    Health,
    MethodEstimate,
    ParamEstimate,
    Rows,
    Status,
    StreamHealth,
    Tick,
    UsageError,
)
from station.screen import glance_feed, glance_server, terminal
from station.screen.glance_feed import GlanceFeed, address_of, content, listening

START_NS = 7_000_000_000_000
DEG = 0.017453292519943295
ALPHA = AlphaEstimate(
    START_NS, alpha=4.21 * DEG, alpha_sd=0.12 * DEG, vane=5.02 * DEG, zero=0.0, upwash=-0.75 * DEG, rate=0.02 * DEG,
    lag=0.1 * DEG, gust=-0.18 * DEG, alpha_inertial=4.1 * DEG, alpha_gust=0.11 * DEG, gust_vertical=0.11,
    turbulence_level=0.123, turbulence="light", wind_north=3.0, wind_east=-2.0, wind_down=0.1, valid=True, why="",
)  # fmt: skip
STREAM = StreamHealth("boom.vanes", "boom", 199.6, 0.004, "synced", -3600.0, 30.0, 1000, 0, 0, True)
LIMIT_S = 20.0


def estimated(sd: float, status: Status = Status.ESTIMATED, why: str = "") -> Rows:
    names = tuple(ParamEstimate(n, 5.64, sd, status, why) for n in LONGITUDINAL)
    return MethodEstimate(START_NS, "split", names)


def board_with(*rows: Rows, now_s: float = 12.0) -> tuple[Board, ManualClock]:
    clock = ManualClock(START_NS + round(now_s * 1e9))
    board = Board(None, clock)
    board.accuracy = 0.1
    board.update([Tick(START_NS, 0, START_NS), Tick(clock.now_ns(), 600, START_NS), *rows])
    return board, clock


def said(*rows: Rows) -> dict[str, Any]:
    board, clock = board_with(*rows)
    return json.loads(msgspec.json.encode(content(board, clock.now_ns())))


SOUND = (ALPHA, estimated(0.06), Health(START_NS, (STREAM,)))


@pytest.mark.parametrize(
    ("question", "rows", "state", "words"),
    [
        ("alpha", (), "none", "no estimate yet"),
        ("alpha", (ALPHA,), "good", ""),
        ("alpha", (msgspec.structs.replace(ALPHA, why="held"),), "doubt", "held"),
        ("alpha", (msgspec.structs.replace(ALPHA, valid=False, why="vanes stale"),), "bad", "vanes stale"),
        ("point", SOUND, "good", "6 of 6 derivatives known to 10 %"),
        ("point", (estimated(0.6),), "none", "0 of 6 derivatives known to 10 %"),
        ("wrong", SOUND, "good", ""),
        ("wrong", (*SOUND, Event(START_NS, "boom.vanes", Code.STALE, 1, "no sample")), "bad", "no sample"),
        ("wrong", (*SOUND, Event(START_NS, "q", Code.DISAGREE, 1, "the gyro differs")), "doubt", "the gyro differs"),
        ("wrong", (Health(START_NS, (msgspec.structs.replace(STREAM, alive=False),)),), "doubt", "boom.vanes"),
        ("wrong", (Health(START_NS, (STREAM,), dropped=3),), "doubt", "3 rows dropped"),
    ],
)
def test_the_three_questions_are_answered(question: str, rows: tuple[Rows, ...], state: str, words: str) -> None:
    answer = said(*rows)["answers"][question]
    assert answer["state"] == state
    assert words in answer["why"]


@pytest.mark.parametrize("status", Status)
def test_the_page_says_what_the_terminal_says(status: Status) -> None:
    board, clock = board_with(ALPHA, estimated(0.06, status, "" if status is Status.ESTIMATED else "too calm"))
    shown = content(board, clock.now_ns())
    lines = [line.plain for line in terminal.lines(board, clock.now_ns(), 100, 40, None)]
    assert any(shown["alpha"]["text"] in line for line in lines)
    for d in shown["derivatives"]:
        row = next(line for line in lines if d.name in line).split()
        assert row == [d.name, d.value, *d.bound.split(), d.state]
        assert d.why == "" or any(d.why in line for line in lines)


@pytest.mark.parametrize(
    ("text", "address"),
    [("10.0.0.5", ("10.0.0.5", 0)), ("10.0.0.5:8080", ("10.0.0.5", 8080)), ("[::1]:8080", ("::1", 8080)),
     ("::1", ("::1", 0)), ("[fe80::2]", ("fe80::2", 0))],
)  # fmt: skip
def test_addresses_are_read(text: str, address: tuple[str, int]) -> None:
    assert address_of(text) == address


@pytest.mark.parametrize("text", ["", "tablet", "10.0.0.5:0", "10.0.0.5:x", "10.0.0.5:99999", "10.0.0.256", ":8080"])
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--serve"):
        address_of(text)


def test_an_address_of_another_machine_and_one_that_is_taken_are_refused() -> None:
    with pytest.raises(UsageError, match="give an address of this machine"):
        listening("192.0.2.1", 0)  # RFC 5737: nobody's
    with listening("127.0.0.1", 0) as taken, pytest.raises(UsageError, match="in use"):
        listening("127.0.0.1", taken.getsockname()[1])


@pytest.mark.parametrize("token", ["", "short", "with space in it", "ümlaut-ümlaut"])
def test_a_token_that_is_none_is_refused(token: str) -> None:
    with pytest.raises(UsageError, match="--token"):
        GlanceFeed("127.0.0.1", token)


class Served:
    """A feed of a board, and who asks for it."""

    def __init__(self, board: Board, clock: Clock, serve: str | None = None, token: str | None = None) -> None:
        self.events: list[Event] = []
        self.asked = contextlib.ExitStack()
        self.feed = GlanceFeed(serve, token)
        self.feed.start(board, clock, self.events.append)

    def ask(self, path: str = "/", method: str = "GET", **headers: str) -> http.client.HTTPResponse:
        where = urlsplit(self.feed.origin)
        connection = http.client.HTTPConnection(where.hostname or "", where.port, timeout=LIMIT_S)
        connection.request(method, path, headers={"Host": where.netloc, **headers})
        answer = connection.getresponse()
        self.asked.callback(connection.close)
        self.asked.callback(answer.close)
        return answer

    def servers(self) -> list[psutil.Process]:
        """Processes that have the page's socket."""
        port = urlsplit(self.feed.origin).port
        others = [p for p in psutil.Process().children() if p.status() != psutil.STATUS_ZOMBIE]
        return [p for p in others if any(c.laddr.port == port for c in p.net_connections())]


@contextlib.contextmanager
def served(board: Board, clock: Clock, serve: str | None = None, token: str | None = None) -> Iterator[Served]:
    made = Served(board, clock, serve, token)
    try:
        yield made
    finally:
        made.asked.close()
        made.feed.close()
        assert not made.servers()


def first_message(answer: http.client.HTTPResponse) -> dict[str, Any]:
    while not (line := answer.readline()).startswith(b"data: "):
        assert line, "the stream ended"
    return json.loads(line[6:])["shown"]


def test_on_loopback_there_is_no_token_but_only_loopback_is_answered() -> None:
    with served(*board_with(*SOUND)) as page:
        assert page.feed.address == page.feed.origin
        answer = page.ask()
        assert answer.status == 200
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        assert b"http" not in answer.read()  # nothing from elsewhere
        assert first_message(page.ask("/live"))["alpha"]["text"] == "+4.21 ± 0.24"
        assert page.ask(Host="evil.example").status == 403  # a name that its owner had lead here
        assert page.ask("/live", Host="evil.example").status == 403
        assert page.ask("/../glance_feed.py").status == 404
        assert {page.ask(method=m).status for m in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS")} == {405}


def test_for_other_machines_nothing_is_said_without_the_token() -> None:
    with served(*board_with(*SOUND), serve="127.0.0.2", token="right-right-right") as page:
        assert page.feed.address.startswith("http://127.0.0.2:")
        wrong = [{}, {"Cookie": "station=right"}, {"Authorization": "Bearer wrong-wrong-wrong"}]
        for path in ("/", "/live", "/glance.js", "/?token=wrong-wrong-wrong", "/live?token=r%C3%A9"):
            answers = [page.ask(path, **more) for more in wrong]
            assert [a.status for a in answers] == [403] * 3
            assert all(b"4.21" not in a.read() for a in answers)
        answer = page.ask("/?token=right-right-right")
        assert (answer.status, answer.headers["Location"]) == (302, "./")
        cookie = answer.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        assert page.ask(Cookie=cookie.partition(";")[0]).status == 200
        live = page.ask("/live", Authorization="Bearer right-right-right")
        assert first_message(live)["alpha"]["text"] == "+4.21 ± 0.24"
    with served(*board_with(), serve="127.0.0.2") as one, served(*board_with(), serve="127.0.0.2") as other:
        assert len(one.feed.token) > 12
        assert one.feed.token != other.feed.token


def test_a_server_that_dies_is_told_and_comes_back_at_its_address() -> None:
    with served(*board_with(*SOUND)) as page:
        first_message(page.ask("/live"))
        page.servers()[0].kill()
        assert first_message(page.ask("/live"))["alpha"]["text"] == "+4.21 ± 0.24"  # waits in the open socket meanwhile
        assert [e.code for e in page.events] == [Code.VIEW]
        assert "glance page lost" in page.events[0].detail


def test_a_board_that_changes_while_it_is_read_is_told_and_the_page_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, asked = glance_feed.content, []

    def once_changed(board: Board, now_ns: int) -> dict[str, Any]:
        asked.append(now_ns)
        if len(asked) <= 2:
            raise RuntimeError("dictionary changed size during iteration")
        return kept(board, now_ns)

    monkeypatch.setattr(glance_feed, "content", once_changed)
    with served(*board_with(*SOUND)) as page:
        assert first_message(page.ask("/live"))["alpha"]["text"] == "+4.21 ± 0.24"
        (event,) = page.events
        assert "dictionary changed size" in event.detail


def test_a_page_that_takes_nothing_is_dropped_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glance_server, "STUCK_S", 0.3)
    listener = listening("127.0.0.1", 0)
    port = listener.getsockname()[1]
    out, into = os.pipe()
    thread = threading.Thread(
        target=lambda: asyncio.run(glance_server.serve(listener, "", os.fdopen(out, "rb", buffering=0)))
    )
    thread.start()
    request = f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()
    with socket.socket() as stuck, socket.create_connection(("127.0.0.1", port), LIMIT_S) as good:
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stuck.connect(("127.0.0.1", port))
        stuck.sendall(request)
        good.sendall(request)
        heard, number, dropped = good.makefile("rb"), 0, False
        while not dropped:
            number += 1
            os.write(into, b'{"n":%d,"filler":"%s"}\n' % (number, b"x" * 30_000))
            until = f'"n":{number},'.encode()
            while until not in (line := heard.readline()):
                assert line
            here = next((c for c in psutil.Process().net_connections() if c.raddr == stuck.getsockname()), None)
            dropped = here is None or here.status != psutil.CONN_ESTABLISHED
            assert number < 1000
        os.close(into)
        assert b"event: ended" in heard.read()
    thread.join()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(chromium(), tmp_path_factory.mktemp("chromium")) as made:
        yield made


def text(name: str) -> str:
    return f"document.getElementById('{name}')?.textContent"


STALE = "document.body?.classList.contains('stale')"
LOST = "(document.body && getComputedStyle(document.getElementById('lost')).display != 'none')"


@contextlib.contextmanager
def ticking(board: Board, clock: SystemClock) -> Iterator[threading.Event]:
    """A loop that ticks, but for while the event is set."""
    held, ended = threading.Event(), threading.Event()

    def tick() -> None:
        while not ended.wait(0.05):
            if not held.is_set():
                board.update([Tick(clock.now_ns(), 0, 0)])

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        yield held
    finally:
        ended.set()
        thread.join()


def test_in_a_browser_values_live_age_and_are_never_shown_as_new(browser: Browser) -> None:
    clock = SystemClock()
    board = Board(None, clock)
    board.update(SOUND)
    with ticking(board, clock) as held, served(board, clock) as page:
        browser.open(page.feed.address)
        browser.wait(f"{text('alpha-value')} == '+4.21' && !{STALE}")
        for width, height in ((390, 844), (820, 1180), (1280, 800)):
            browser.resize(width, height)
            assert browser.run("document.documentElement.scrollWidth") <= width
            seen = "[...document.querySelectorAll('#answers .words, #alpha-value')].map(e => e.getBoundingClientRect())"
            assert browser.run(f"{seen}.every(b => b.left >= 0 && b.right <= {width} && b.top < {height})")
        board.update([Event(clock.now_ns(), "boom.vanes", Code.STALE, 1, "no sample for 0.2 s")])
        browser.wait(f"{text('alarms')}.includes('no sample') && document.title.startsWith('(1)')")
        assert browser.run("calledMs") > 0
        browser.run("document.getElementById('sound').click()")
        browser.wait("sound.state == 'running'")
        held.set()
        browser.wait(f"{STALE} && {LOST} && {text('lost-words')} == 'STATION STALLED'")
        assert browser.run(f"parseFloat({text('age')})") >= 1
        held.clear()
        browser.wait(f"!{STALE} && !{LOST}")
        (server,) = page.servers()
        server.send_signal(signal.SIGSTOP)
        browser.wait(f"{STALE} && {LOST} && {text('lost-words')} == 'CONNECTION LOST'")
        server.send_signal(signal.SIGCONT)
        browser.wait(f"!{STALE} && !{LOST}")
    browser.wait(f"{STALE} && {text('lost-words')} == 'FLIGHT ENDED'")

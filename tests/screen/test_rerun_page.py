"""The operator's page: what it draws, that it stays on loopback, and that its death costs the station nothing."""

from __future__ import annotations

import itertools
import math
import os
import signal
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import psutil
import pytest
from browser import Browser, chromium

from station.clock import ManualClock
from station.conventions import LATERAL, LONGITUDINAL, SIGNALS, TICK_NS
from station.flight.board import Board
from station.rows import (
    AlphaEstimate,
    Code,
    Event,
    Frame,
    Health,
    LogError,
    MethodEstimate,
    ParamEstimate,
    RawBlock,
    Rows,
    Status,
    StreamHealth,
    Tick,
    Truth,
)
from station.screen import lateral_plots, plots
from station.screen.plots import Setup
from station.screen.rerun_feed import QUEUE_TICKS, View
from station.screen.rerun_files import write_rrd
from station.screen.rerun_page import Page

BOOK = dict(zip(LONGITUDINAL, (5.64, 20.0, 0.62, -1.05, -34.2, -1.88), strict=True))
BIAS = {"II": 0.85, "III": 1.12, "V": 1.08, "split": 0.98, "split+gust": 1.0}
START_NS = 5_000_000_000_000


def flight(ticks: int, first: int = 0, seed: int = 1) -> Iterator[list[Rows]]:
    """A made-up flight, the rows of one tick at a time: doublets every 20 s, gusts, converging derivatives."""
    rng = np.random.default_rng(seed)
    gust = 0.0
    for k in range(first, first + ticks):
        t = k / 50
        t_ns = START_NS + k * TICK_NS
        phase = t % 20
        elevator = math.radians(3) * ((2 < phase < 3) - (3 < phase < 4))
        q = math.radians(4) * math.exp(-0.5 * max(0.0, phase - 2)) * math.sin(2.5 * max(0.0, phase - 2))
        gust += -0.06 * gust + math.radians(0.12) * rng.standard_normal()
        inertial = math.radians(4) + 0.8 * q
        rate = -0.09 * q
        vane = (inertial + gust) * 1.18 - rate + math.radians(0.05) * rng.standard_normal()
        upwash = -0.15 * vane
        lag = 0.1 * q
        late = -0.2 * gust
        values = [0.0] * len(SIGNALS)
        for name, value in (("elevator", elevator), ("q", q), ("airspeed", 56.6 + 2 * math.sin(t / 9))):
            values[list(SIGNALS).index(name)] = value
        valid = not 31 < t < 34
        rows: list[Rows] = [Tick(t_ns, k, t_ns - 60_000_000)]
        zeros = (0.0,) * len(SIGNALS)
        rows.append(Frame(t_ns, k, tuple(values), zeros, (0,) * len(SIGNALS)))
        rows.append(
            AlphaEstimate(
                t_ns,
                alpha=vane + upwash + rate + lag + late,
                alpha_sd=math.radians(0.12 if valid else 0.6),
                vane=vane,
                zero=0.0,
                upwash=upwash,
                rate=rate,
                lag=lag,
                gust=late,
                alpha_inertial=inertial,
                alpha_gust=gust,
                gust_vertical=56.6 * gust,
                turbulence_level=0.02 + 0.1 * (1 - math.exp(-t / 20)),
                turbulence="unknown" if t < 5 else "calm" if t < 12 else "light",
                wind_north=3.0,
                wind_east=-2.0,
                wind_down=0.1,
                valid=valid,
                why="" if valid else "boom.vanes stale",
            )
        )
        for method, bias in BIAS.items():
            found = t > 6
            share = 1.2 / math.sqrt(max(t, 1))
            parameters = tuple(
                ParamEstimate(
                    name,
                    value * (bias + 0.3 * share * math.sin(t / 5 + i)),
                    abs(value) * share * 0.5,
                    Status.ESTIMATED if found and not (name == "CL_q" and t < 15) else Status.UNESTIMATED,
                    "" if found else "not enough excitation",
                )
                for i, (name, value) in enumerate(BOOK.items())
            )
            rows.append(MethodEstimate(t_ns, method, parameters))
        rows.append(Truth(t_ns, {"alpha": inertial + gust}))
        if k % 50 == 0:
            rows.append(health(t_ns, t))
        if k == 0:
            rows.append(Event(t_ns, "station", Code.START))
        if k % 500 == 250:
            rows.append(Event(t_ns, "boom", Code.CRC, 3, "bad checksum"))
        if k == 1550:
            rows.append(Event(t_ns, "boom.vanes", Code.STALE, 1, "no sample for 0.2 s"))
        if k == 1700:
            rows.append(Event(t_ns, "boom.vanes", Code.FRESH, 1, "STALE over after 3.00 s"))
        if k % 1000 == 100:
            rows.append(Event(t_ns, "operator", Code.POINT_START, k // 1000 + 1, f"test point {k // 1000 + 1}"))
        if k % 1000 == 900:
            rows.append(Event(t_ns, "operator", Code.POINT_END, k // 1000 + 1, f"test point {k // 1000 + 1}"))
        yield rows


STREAMS = (
    ("boom.vanes", 200.0), ("can.gyro", 200.0), ("can.accel", 200.0), ("can.air", 50.0), ("can.pots", 100.0),
    ("autopilot.attitude", 50.0), ("autopilot.velocity", 50.0), ("autopilot.position", 5.0),
)  # fmt: skip


def health(t_ns: int, t: float) -> Health:
    out = 31 < t < 34
    return Health(
        t_ns,
        tuple(
            StreamHealth(
                stream=name,
                device=name.partition(".")[0],
                rate_hz=0.0 if out and name == "boom.vanes" else rate * (1 + 0.004 * math.sin(t + i)),
                age_s=t - 31 if out and name == "boom.vanes" else 0.004 + 0.3 / rate,
                clock="unsynced" if t < 2 else "converging" if t < 8 else "synced",
                offset_s=-3600.0 * (1 + i),
                drift_ppm=30.0 + i,
                samples=int(rate * t),
                gaps=int(t // 30) if i == 0 else 0,
                bad=3 * int(t // 10) if i == 0 else 0,
                alive=not (out and name == "boom.vanes"),
            )
            for i, (name, rate) in enumerate(STREAMS)
        ),
    )


NOMINAL = dict(STREAMS)
SETUP = Setup("test", "none", 0, 0, references=BOOK, nominal_hz=NOMINAL, class_limits=(0.05, 0.2, 0.5))


def lines_of(rows: list[Rows]) -> dict[str, np.ndarray]:
    """Newest point of each plot."""
    made = plots.points(plots.batch(rows, START_NS), SETUP)
    return {"/".join(p.path): p.values[-1] for p in made}


def with_alpha(**changes: object) -> list[Rows]:
    (tick,) = flight(1)
    return [msgspec.structs.replace(r, **changes) if isinstance(r, AlphaEstimate) else r for r in tick]


def test_angles_are_drawn_in_degrees_with_a_band_of_two_sd() -> None:
    drawn = lines_of(with_alpha(alpha=math.radians(5), alpha_sd=math.radians(0.5), vane=math.radians(6)))
    vane, _, low, high, corrected, doubted = drawn["alpha [deg]"]
    assert (vane, low, high, corrected) == pytest.approx((6, 4, 6, 5))
    assert math.isnan(doubted)


def test_each_correction_of_the_vane_is_drawn_under_its_own_name() -> None:
    """That of the instrument, too; where the profile states no error of the vane it has no line."""
    names = [line.name for line in plots.CORRECTIONS.lines]
    degrees = {"zero": 1.0, "upwash": -2.0, "rate": 3.0, "lag": -4.0, "gust": 5.0, "instrument": -1.5}
    drawn = lines_of(with_alpha(**{name: math.radians(x) for name, x in degrees.items()}))[plots.CORRECTIONS.name]
    assert dict(zip(names, drawn, strict=True)) == pytest.approx(degrees)
    sound = lines_of(with_alpha())[plots.CORRECTIONS.name]
    assert np.isnan(sound).tolist() == [name == "instrument" for name in names]


def test_an_angle_that_is_not_valid_leaves_the_line_of_the_valid_ones() -> None:
    drawn = lines_of(with_alpha(alpha=math.radians(5), valid=False, why="vane stale"))
    assert drawn["alpha [deg]"][5] == pytest.approx(5)
    assert np.isnan(drawn["alpha [deg]"][2:5]).all()
    assert math.isnan(drawn["gust part of alpha [deg]"][0])


def test_turbulence_has_no_level_before_the_filter_has_settled() -> None:
    assert math.isnan(lines_of(with_alpha(turbulence="unknown"))["turbulence, w in 2-7 Hz [m/s]"][0])
    assert lines_of(with_alpha(turbulence="calm"))["turbulence, w in 2-7 Hz [m/s]"][1:].tolist() == [0.05, 0.2, 0.5]


@pytest.mark.parametrize(
    ("status", "applicable", "drawn"),
    [
        (Status.ESTIMATED, True, True),
        (Status.UNESTIMATED, True, False),
        (Status.INVALID, True, False),
        (Status.ESTIMATED, False, False),
    ],
)
def test_only_derivatives_to_be_believed_are_drawn(status: Status, applicable: bool, drawn: bool) -> None:
    found = ParamEstimate("CL_alpha", 5.0, 0.25, status, "" if status is Status.ESTIMATED else "why")
    other = MethodEstimate(START_NS, "II", (ParamEstimate("CL_alpha", 4.0, 0.1, Status.ESTIMATED),))
    values = lines_of([MethodEstimate(START_NS, "split", (found,), applicable), other])["CL_alpha [1/rad]"]
    names = [line.name for line in plots.derivative_plot("CL_alpha", SETUP).lines]
    at = names.index("split")
    assert values[0] == BOOK["CL_alpha"]
    if drawn:
        assert values[at - 2 : at + 1] == pytest.approx((4.5, 5.5, 5.0))
    else:
        assert np.isnan(values[at - 2 : at + 1]).all()
    assert values[names.index("II")] == 4.0


class Styled:
    """A recording that keeps the widths of each derivative's lines."""

    def __init__(self) -> None:
        self.widths: dict[str, list[float]] = {}

    def log(self, path: str, entity: Any, static: bool = False) -> None:
        if "1/rad" in path and static:
            self.widths[path] = entity.widths.as_arrow_array().to_pylist()

    def set_time(self, *_: object, **__: object) -> None: ...

    def send_columns(self, *_: object, **__: object) -> None: ...


def test_the_page_draws_bold_the_method_that_the_terminal_recommends() -> None:
    """And both follow the data: physical where it gives as much, split+gust in turbulence, else split."""
    recording, board = Styled(), Board(None, ManualClock(0))
    page = Page(recording, SETUP)  # type: ignore[arg-type]
    lines = plots.derivative_plot("CL_alpha", SETUP).lines
    found = (ParamEstimate("CL_alpha", 5.0, 0.25, Status.ESTIMATED),)
    none = (ParamEstimate("CL_alpha", 5.0, 0.25, Status.UNESTIMATED),)
    for at, (air, physical, expected) in enumerate(
        (("calm", none, "split"), ("calm", found, "physical"), ("light", none, "split+gust"), ("calm", none, "split"))
    ):
        t_ns = START_NS + at * 10**9
        alpha = next(r for r in with_alpha(turbulence=air) if isinstance(r, AlphaEstimate))
        given = {"split": found, "split+gust": found, "physical": physical}
        rows = [alpha, *(MethodEstimate(t_ns, m, p) for m, p in given.items()), health(t_ns, 32.0)]
        board.update(rows)
        page.show(plots.batch(rows, START_NS))
        assert board.recommended == expected
        for widths in recording.widths.values():
            bold = [line.name for line, width in zip(lines, widths, strict=True) if width > 2]
            assert bold == [expected]


def test_a_plot_of_a_lateral_derivative_shows_its_own_lines_only() -> None:
    setup = msgspec.structs.replace(SETUP, lateral_methods=("II", "split"), references={"Cn_r": -0.2})
    of = {n: ParamEstimate(n, float(k), 0.25, Status.ESTIMATED) for k, n in enumerate(LATERAL)}
    of["Cn_p"] = ParamEstimate("Cn_p", 9.0, 0.25, Status.INVALID, "collinear with the other regressors")
    rows = [MethodEstimate(START_NS, m, tuple(of.values())) for m in ("II", "split")]
    made = {p.path: p.values[-1] for p in lateral_plots.points(plots.batch(rows, START_NS), setup)}
    drawn = {name: (plot, shown) for name, plot, shown in lateral_plots.views(setup)}
    assert [name.split()[0] for name in drawn] == list(LATERAL)
    plot, shown = drawn["Cn_r [1/rad]"]
    lines = {(line.name, value) for line, value, on in zip(plot.lines, made[plot.path], shown, strict=True) if on}
    assert lines == {("profile", -0.2), ("II", 12.0), ("split", 12.0), ("±2 sd", 11.5), ("±2 sd", 12.5)}
    plot, shown = drawn["Cn_p [1/rad]"]
    assert np.isnan(made[plot.path][shown]).all()  # not to be believed: no line
    assert not lateral_plots.drawn(SETUP)
    assert not list(lateral_plots.points(plots.batch(rows, START_NS), SETUP))


def test_slow_lines_get_two_points_a_second_however_the_ticks_are_batched() -> None:
    ticks = list(flight(200, first=400))
    for size in (1, 7, 50, 200):
        times: list[int] = []
        for start in range(0, 200, size):
            rows = list(itertools.chain(*ticks[start : start + size]))
            for points in plots.points(plots.batch(rows, START_NS), SETUP):
                if points.path == ("Cm_q [1/rad]",):
                    times += points.t_ns.tolist()
        assert np.diff(times).tolist() == [plots.SLOW_NS] * 7


def test_link_rate_is_in_percent_of_the_rig_s() -> None:
    drawn = lines_of([health(START_NS, 32.0)])
    assert drawn["link rate [% of nominal]"][0] == 0.0
    assert drawn["link rate [% of nominal]"][-1] == pytest.approx(100, abs=1)
    assert drawn["link age [ms]"][0] == pytest.approx(1000)


def test_raw_bytes_and_samples_never_reach_the_page() -> None:
    view = View("none", "test")
    assert view.start() == ""
    view.show([RawBlock(1, "boom", b"x")])
    assert view.flush(0.0)
    view.close()
    assert plots.batch([RawBlock(1, "boom", b"x")], 0) == plots.Batch(0)


def test_recording_for_rerun_holds_every_line_and_event(tmp_path: Path) -> None:
    import rerun as rr

    out = tmp_path / "flight.rrd"
    write_rrd(itertools.chain.from_iterable(flight(600)), out)
    found: dict[str, int] = {}
    for chunk in rr.chunk.RrdReader(out).stream().to_chunks():
        if not chunk.is_static:
            found[chunk.entity_path] = found.get(chunk.entity_path, 0) + chunk.num_rows
    plain = {path.replace("\\", ""): rows for path, rows in found.items()}
    assert plain["/alpha [deg]"] == 600
    assert plain["/true airspeed [kt]"] == 600
    assert (plain["/events/alarms"], plain["/events/informations"]) == (1, 2)
    assert plain["/Cm_q [1/rad]"] == 14  # two a second, from the first 5 s on that have one


def test_recording_into_a_folder_that_is_not_there_says_so(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be written"):
        write_rrd(flight(1).__next__(), tmp_path / "none" / "flight.rrd")


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
        assert not flying.view.alive
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

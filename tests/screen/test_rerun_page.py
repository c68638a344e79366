"""The operator's page: what it draws, that it stays on loopback, and that its death costs the station nothing."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from station.clock import ManualClock
from station.conventions import LATERAL
from station.flight.board import Board
from station.rows import (
    AlphaEstimate,
    LogError,
    MethodEstimate,
    ParamEstimate,
    RawBlock,
    Status,
)
from station.screen import lateral_plots, plots
from station.screen.rerun_feed import View
from station.screen.rerun_files import write_rrd
from station.screen.rerun_page import Page
from tests.screen.flown_rows import BOOK, SETUP, START_NS, flight, health, lines_of, with_alpha


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

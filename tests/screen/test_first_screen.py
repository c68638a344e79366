"""What an operator sees at a glance: answers, like events together, points that stay, drawings."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from cockpit import STEP, Cockpit

from station.clock import ManualClock
from station.commands.cards import load
from station.conventions import LONGITUDINAL, SIGNAL_INDEX, TICK_NS
from station.flight.board import Board
from station.flight.loop import ESTIMATORS
from station.rows import AlphaEstimate, Code, Event, Frame, Health, MethodEstimate, ParamEstimate, Status, StreamHealth
from station.screen import terminal
from station.screen.answer_tiles import COLOURS, PALETTE, tiles
from station.screen.answers import Answer, wrong_answer
from station.screen.attitude import attitude
from station.screen.brief import Brief, brief
from station.screen.drawings import FLOWN, HIGH, step_drawing
from station.screen.event_groups import QUIET_NS, EventGate, grouped
from station.screen.ground_track import BARB_COLOUR, PLAIN, POINT_COLOURS, SIDE, GroundTrack, barb
from station.screen.live_spectra import densities
from station.screen.page_words import first_words
from station.screen.point_table import point_markdown
from station.screen.rerun_feed import setup_for

S = 1_000_000_000
ALPHA = AlphaEstimate(
    t_ns=0, alpha=math.radians(4), alpha_sd=math.radians(0.1), vane=0.0, zero=0.0, upwash=0.0, rate=0.0, lag=0.0,
    gust=0.0, alpha_inertial=0.0, alpha_gust=0.0, gust_vertical=0.0, turbulence_level=0.1, turbulence="light",
    wind_north=-10.0, wind_east=0.0, wind_down=0.0, valid=True, why="",
)  # fmt: skip
ALIVE = StreamHealth("boom.vanes", "boom", 200.0, 0.01, "synced", 0.0, 0.0, 1, 0, 0, True)


def board_of(share: float = 0.05, **alpha: object) -> Board:
    """Every derivative known to `share`, 10 % wanted."""
    board = Board(None, ManualClock(0))
    board.accuracy = 0.1
    found = tuple(ParamEstimate(n, 2.0, share, Status.ESTIMATED) for n in LONGITUDINAL)
    board.update([msgspec.structs.replace(ALPHA, **alpha), MethodEstimate(0, "split", found), Health(0, (ALIVE,))])
    return board


def test_a_page_that_is_late_is_told_after_what_is_worse() -> None:
    board = board_of()
    assert wrong_answer(board, 0).words == "NOTHING"
    board.view_behind_s = 12.0
    assert (wrong_answer(board, 0).state, wrong_answer(board, 0).words) == ("doubt", "PAGE LATE")
    board.update([Event(1, "vane", Code.DISAGREE, 1, "vane and motion disagree")])
    assert wrong_answer(board, 0).words == "CHECK"


@pytest.mark.parametrize(("code", "state"), [(Code.PREPARING, "none"), (Code.ESTIMATOR, "bad")])
def test_nothing_is_not_said_to_be_wrong_while_there_are_no_estimators(code: Code, state: str) -> None:
    board = board_of()
    board.update([Event(1, ESTIMATORS, code, 1, "the estimators are being prepared")])
    assert (wrong_answer(board, 1).state, wrong_answer(board, 1).words) == (state, "NO ESTIMATES")
    board.update([Event(2, ESTIMATORS, Code.READY, 1, "")])
    assert wrong_answer(board, 2).words == "NOTHING"


def test_the_first_screen_says_what_is_known_and_what_is_wanted() -> None:
    words = first_words(brief(board_of(share=0.1), 0), {"CL_alpha": 5.0})
    assert "| CL_alpha | **2.00** ± 0.20 | 10 % | 10 % | estimated | 5.00 |" in words
    assert "| Cm_q | **2.00** ± 0.10 | 5 % | 10 % | ✔ enough | – |" in first_words(brief(board_of(), 0), {})
    nothing = first_words(brief(Board(None, ManualClock(0)), 0), {})
    assert "all: unestimated" in nothing


def test_the_step_is_told_from_condition_to_verdict() -> None:
    cockpit = Cockpit(STEP)
    cockpit.changed = {"airspeed": 60.0}
    cockpit.fly(0.5)

    def said() -> Brief:
        return brief(cockpit.board, cockpit.clock.now_ns())

    cockpit.board.guide = cockpit.guide
    assert "**✗ speed 117 kt (110±5)**" in first_words(said(), {})
    cockpit.changed = {}
    cockpit.fly(0.5)
    assert "**READY** flaps up" in first_words(said(), {})
    cockpit.press("n")
    cockpit.fly(6.0)
    # What is flown lies over what is drawn, as far as it has come; it goes to the page as bytes.
    step = msgspec.msgpack.decode(msgspec.msgpack.encode(said()), type=Brief).step
    assert step is not None
    flown = [strip for strip in step_drawing(step).strips if strip.colour == FLOWN]
    assert flown
    assert 0 <= min(s.points[:, 1].min() for s in flown) < max(s.points[:, 1].max() for s in flown) <= HIGH
    cockpit.fly(5.0)
    words = first_words(said(), {})
    assert "**enough: next step**" in words
    assert "| Cm_q |" in words
    cockpit.press("n")
    assert "short period: **enough**" in first_words(said(), {})


def test_a_finished_point_stays_with_what_it_found() -> None:
    board = board_of()
    board.start_ns = 0
    board.update([Event(1 * S, "operator", Code.POINT_START, 1, "short period; flaps up")])
    for at, air in enumerate(("calm", "moderate", "light", "light")):
        board.update([msgspec.structs.replace(ALPHA, t_ns=(2 + at) * S, turbulence=air, valid=at > 0)])
    board.update([Event(9 * S, "operator", Code.POINT_END, 1, "short period; flaps up")])
    later = tuple(ParamEstimate(n, 9.0, 0.1, Status.ESTIMATED) for n in LONGITUDINAL)
    board.update([MethodEstimate(10 * S, "split", later)])
    (point,) = board.points.ended
    assert (point.air, point.valid_share) == ("moderate", 0.75)
    assert [p.value for p in point.found if p is not None] == [2.0] * 6
    text = "\n".join(line.plain for line in terminal.lines(board, 10 * S, 80, 24, None))
    assert "POINTS" in text
    assert "1 short period moderate" in " ".join(text.split())
    assert "2.00±0.10" in text
    table = point_markdown(board.points.ended, board.derivatives, 0)
    assert "| 1 short period; flaps up | 1 | 9 | moderate | 75 % | split | 2.00±0.10 |" in table
    assert board.snapshot()["points"][0]["derivatives"]["Cm_q"]["estimate"] == 2.0


def test_an_end_without_a_beginning_makes_no_point() -> None:
    board = board_of()
    board.update([Event(1, "operator", Code.POINT_END, 3)])
    assert not board.points.ended


def overruns(count: int, every_ns: int, first_ns: int = 0) -> list[Event]:
    return [Event(first_ns + i * every_ns, "loop", Code.OVERRUN, 2, f"tick {i}") for i in range(count)]


def test_thirty_overruns_make_two_lines() -> None:
    gate = EventGate()
    told = list(gate.passed(overruns(30, S // 10), 3 * S))
    assert [e.count for e in told] == [2]
    told = list(gate.passed([], 2 * QUIET_NS))
    assert [(e.count, e.detail) for e in told] == [(58, "tick 29")]
    assert not list(gate.passed([], 9 * QUIET_NS))
    # Nothing is lost, however they come, and other kinds are told at once.
    gate, counted = EventGate(), 0
    for event in overruns(200, S):
        counted += sum(e.count for e in gate.passed([event, Event(event.t_ns, "crew", Code.MARK)], event.t_ns))
    assert counted + sum(e.count for e in gate.rest()) == 2 * 200 + 200


def test_like_events_are_one_line_on_the_terminal_until_a_pause() -> None:
    events = [*overruns(30, S // 10), Event(4 * S, "boom", Code.CRC), *overruns(3, S, 60 * S)]
    assert [(e.code, e.count) for e in grouped(events)] == [
        (Code.OVERRUN, 60),
        (Code.CRC, 1),
        (Code.OVERRUN, 6),
    ]
    board = board_of()
    board.start_ns = 0
    board.update(events[:30])
    text = "\n".join(line.plain for line in terminal.lines(board, 10 * S, 80, 30, None))
    assert text.count("OVERRUN") == 1
    assert "OVERRUN x60" in text


@pytest.mark.parametrize(
    ("knots", "pennants", "long", "short"), [(3, 0, 0, 1), (5, 0, 0, 1), (17, 0, 1, 1), (65, 1, 1, 1), (100, 2, 0, 0)]
)
def test_a_barb_tells_speed_and_where_the_wind_comes_from(knots: float, pennants: int, long: int, short: int) -> None:
    """Feathers as WMO-No. 485 has them; a wind from the north points up, its feathers to the east."""
    speed = knots * 1852 / 3600
    staff, *feathers = barb(0.0, 0.0, -speed, 0.0, 100.0)
    assert staff.points[-1] == pytest.approx((0, -100))
    lengths = [float(np.hypot(*(f.points[1] - f.points[0]))) for f in feathers]
    assert all(f.points[:, 0].max() > 0 for f in feathers)
    assert sum(len(f.points) == 3 for f in feathers) == pennants
    plain = [length for length, f in zip(lengths, feathers, strict=True) if len(f.points) == 2]
    assert (sum(x > 30 for x in plain), sum(x <= 30 for x in plain)) == (long, short)


def frame(k: int, **values: float) -> Frame:
    row = [0.0] * len(SIGNAL_INDEX)
    for name, value in values.items():
        row[SIGNAL_INDEX[name]] = value
    return Frame(k * TICK_NS, k, tuple(row), (0.0,) * len(row), (0,) * len(row))


def test_the_track_is_to_scale_and_coloured_by_test_points() -> None:
    """A minute of latitude is a nautical mile; of longitude, at 60 degrees, half of one (to the ellipsoid's 0.5 %)."""
    track = GroundTrack()
    minute = math.radians(1 / 60)
    for k in range(0, 1201, 10):
        share = k / 1200
        place = {"latitude": math.radians(60) + minute * share, "longitude": minute * share}
        events = [Event(k * TICK_NS, "operator", Code.POINT_START, 1)] if k == 600 else []
        track.take([frame(k, **place)], [replace_time(k)], events)
    drawing = track.drawing(1200 * TICK_NS)
    assert drawing is not None
    assert track.drawing(1201 * TICK_NS) is None  # nothing new within seconds
    plain, coloured = (s.points for s in drawing.strips if s.colour in (PLAIN, POINT_COLOURS[0]))
    assert plain[-1] == pytest.approx(coloured[0])  # nothing is missing between them
    east, south = coloured[-1] - plain[0]
    scale = next(s.points for s in drawing.strips if s.points[0, 1] == SIDE)[1, 0]
    assert next(label.words for label in drawing.labels if label.words.endswith(" m")) == "100 m"
    assert (100 * east / scale, 100 * south / scale) == pytest.approx((1852 / 2, -1852), rel=0.01)
    every = np.concatenate([s.points for s in drawing.strips])
    assert every.min() >= 0
    assert every.max() <= SIDE
    assert sum(s.colour == BARB_COLOUR for s in drawing.strips) > 1
    lost = GroundTrack()
    lost.take([frame(0, latitude=math.nan)], [], [])
    assert lost.drawing(0) is None


def replace_time(k: int) -> AlphaEstimate:
    return msgspec.structs.replace(ALPHA, t_ns=k * TICK_NS)


def test_spectra_hold_the_variance_and_the_frequency_of_a_sine() -> None:
    t = np.arange(3000) / 50
    rng = np.random.default_rng(3)
    noise = 0.1 * rng.standard_normal(3000)
    f, density = densities(np.column_stack((2 * np.sin(2 * np.pi * 8.2 * t), noise)))
    assert f[density[0].argmax()] == pytest.approx(8.2, abs=0.05)
    power = density.sum(axis=1) * (f[1] - f[0])
    assert power[0] == pytest.approx(2.0, rel=0.02)
    # 11 half-overlapping segments of a white signal: its variance to 4 % (1 sd), as 3000 samples have 2.6 %.
    assert power[1] == pytest.approx(noise.var(), rel=0.12)


def test_the_attitude_turns_the_nose_up_and_the_right_wing_down() -> None:
    """Rotating body axes by the quaternion: Stevens and Lewis 2003, eq. 1.3-17, with down positive."""
    turned = attitude(frame(0, theta=math.radians(10), phi=math.radians(30)))
    assert turned is not None
    x, y, z, w = turned
    vector = np.array([x, y, z])

    def rotated(v: np.ndarray) -> np.ndarray:
        return v + 2 * np.cross(vector, np.cross(vector, v) + w * v)

    assert rotated(np.array([1.0, 0, 0])) == pytest.approx((math.cos(0.1745), 0, -math.sin(0.1745)), abs=1e-4)
    assert rotated(np.array([0, 1.0, 0]))[2] == pytest.approx(math.sin(math.radians(30)) * math.cos(0.1745), abs=1e-4)
    assert attitude(frame(0, theta=math.nan)) is None


def test_a_tile_has_the_colour_of_its_answer() -> None:
    three = [Answer(state, "WORDS", "why " * 80) for state in ("good", "doubt", "bad")]
    shown = msgspec.structs.replace(brief(board_of(), 0), alpha=three[0], point=three[1], wrong=three[2])
    picture = np.array(PALETTE)[tiles(shown, "foot")]
    for i, answer in enumerate(three):
        tile = picture[:100, 430 * i : 430 * i + 420]
        ground = [int(COLOURS[answer.state][k : k + 2], 16) for k in (1, 3, 5)]
        assert (tile == ground).all(axis=2).mean() > 0.6
        assert (tile == 255).all(axis=2).sum() > 300  # and words on it


@pytest.mark.parametrize(("is_guided", "card", "has_steps"), [(True, "guided", True), (False, "guided", False)])
def test_a_replay_has_no_guide_to_show(is_guided: bool, card: str, has_steps: bool) -> None:
    """Its first screen shows the controls in the place of the step's input."""
    assert setup_for(load(card), title="test", is_guided=is_guided).has_steps is has_steps

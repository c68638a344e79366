"""The operator's terminal: what is said, what is never said, and what the keys do."""

from __future__ import annotations

import msgspec
import pytest

from station.conventions import LATERAL
from station.rows import (
    Code,
    Event,
    Health,
    MethodEstimate,
    ParamEstimate,
    Rows,
    Status,
)
from station.screen import terminal as panel
from station.screen.answers import wrong_answer
from tests.screen.a_board import ALPHA, LINK, START_NS, board_with, estimate, line_with, screen, seconds


def test_angle_of_attack_is_shown_in_degrees_with_two_sd() -> None:
    lines = screen(board_with(ALPHA))
    assert "+4.21 ± 0.24" in line_with(lines, "corrected")
    assert "-0.75" in line_with(lines, "upwash")
    assert "light" in line_with(lines, "turbulence")
    assert "00:00:12" in lines[0]


def test_an_invalid_angle_is_bracketed_dimmed_and_says_why() -> None:
    board = board_with(msgspec.structs.replace(ALPHA, valid=False, why="boom.vanes stale"))
    lines = panel.lines(board, seconds(12), 100, 40, None)
    shown = next(line for line in lines if "corrected" in line.plain)
    assert "( +4.21 ± 0.24)" in shown.plain
    assert any(span.style == "dim" and "4.21" in shown.plain[span.start : span.end] for span in shown.spans)
    assert "INVALID: boom.vanes stale" in line_with([line.plain for line in lines], "ANGLE OF ATTACK")


def test_the_numbers_fit_a_terminal_of_80_columns() -> None:
    wide = msgspec.structs.replace(ALPHA, wind_north=-23.0, wind_east=-12.5, turbulence="moderate", gust_vertical=-9.87)
    assert max(len(line.plain) for line in panel.alpha_lines(board_with(wide))) <= 80


def test_a_level_that_has_not_settled_is_a_dash() -> None:
    board = board_with(msgspec.structs.replace(ALPHA, turbulence="unknown"))
    assert "0.123" not in line_with(screen(board), "turbulence")


def test_derivatives_carry_status_and_the_other_methods_stand_beside() -> None:
    board = board_with(estimate("split"), estimate("II", 4.9))
    board.accuracy = 0.1
    row = line_with(screen(board), "CL_alpha")
    assert row.split() == ["CL_alpha", "5.64", "±", "0.12", "enough", "4.90"]
    board.accuracy = 0.01
    assert "estimated" in line_with(screen(board), "CL_alpha")


@pytest.mark.parametrize(("width", "shown"), [(110, 5), (84, 4), (80, 4), (64, 2), (40, 0)])
def test_a_narrow_terminal_drops_columns_whole(width: int, shown: int) -> None:
    board = board_with(*(estimate(m, 4.917) for m in ("II", "III", "V", "split+gust", "physical", "split")))
    row = next(line.plain for line in panel.lines(board, seconds(12), width, 30, None) if "CL_alpha" in line.plain)
    assert row.split() == ["CL_alpha", "4.92", "±", "0.12", "estimated", *["4.92"] * shown]


def test_the_column_in_front_is_the_method_to_believe_first() -> None:
    health = Health(START_NS, ())
    both = estimate("split"), estimate("physical")
    assert line_with(screen(board_with(ALPHA, *both, health)), "DERIVATIVES").split()[1] == "physical"
    # Where the data prefer split's model, physical is not applicable.
    refused = msgspec.structs.replace(estimate("physical"), applicable=False, why="the data prefer split")
    assert line_with(screen(board_with(ALPHA, estimate("split"), refused, health)), "DERIVATIVES").split()[1] == "split"


def lateral(method: str, status: Status = Status.ESTIMATED, why: str = "", applicable: bool = True) -> Rows:
    """CY_p is in doubt; all others have the status given."""
    doubt = {"CY_p": (0.1, 0.09, Status.UNESTIMATED, "not significant: 2 sigma > estimate and profile value")}
    of = [ParamEstimate(n, *doubt.get(n, (-0.822, 0.0038, status, why))) for n in LATERAL]
    return MethodEstimate(START_NS, method, (*estimate(method).parameters, *of), applicable, why)


def test_lateral_derivatives_stand_in_a_table_of_their_own_with_status_and_why() -> None:
    board = board_with(ALPHA, lateral("II"), lateral("split"), Health(START_NS, ()))
    board.accuracy = 0.1
    lines = screen(board)
    title = line_with(lines, "LATERAL")
    assert title.split()[1] == "split"
    assert "14 of 15 estimated, 14 enough" in title
    assert line_with(lines, " CY ").split() == ["CY", "-0.822±0.008", "–", *["-0.822±0.008"] * 3]
    assert "CY_p: not significant: 2 sigma > estimate and profile value" in line_with(lines, "CY_p")
    assert "LATERAL" not in "".join(screen(board_with(ALPHA, estimate("split"), Health(START_NS, ()))))


def test_lateral_derivatives_are_method_ii_s_where_split_is_not_applicable() -> None:
    refused = lateral("split", applicable=False, why="no inertial angle of attack")
    board = board_with(ALPHA, lateral("II"), refused, Health(START_NS, ()))
    assert line_with(screen(board), "LATERAL").split()[1] == "II"
    nothing = board_with(ALPHA, lateral("II", Status.INVALID, "too noisy"), refused, Health(START_NS, ()))
    assert "±" not in "".join(line for line in screen(nothing) if line.strip()[:3] in ("CY ", "Cl ", "Cn "))


def test_lateral_derivatives_do_not_decide_which_method_leads() -> None:
    few = msgspec.structs.replace(lateral("split"), parameters=lateral("split").parameters[2:])
    board = board_with(ALPHA, few, estimate("physical"), Health(START_NS, ()))
    assert board.recommended == "physical"


def test_an_unestimated_derivative_is_a_dash_with_why_and_no_number() -> None:
    board = board_with(estimate("split", status=Status.UNESTIMATED, why="not enough excitation"))
    lines = screen(board)
    assert "5.64" not in "".join(lines)
    assert "–" in line_with(lines, "CL_alpha")
    assert "all: not enough excitation" in "".join(lines)


@pytest.mark.parametrize("applicable", [True, False])
def test_an_invalid_derivative_is_bracketed(applicable: bool) -> None:
    status = Status.INVALID if applicable else Status.ESTIMATED
    row = msgspec.structs.replace(estimate("split", status=status, why="x"), applicable=applicable, why="stale vane")
    text = line_with(screen(board_with(row)), "CL_alpha")
    assert "(5.64)" in text
    assert "INVALID" in text


def test_links_show_rate_age_clock_and_what_is_the_matter() -> None:
    bad = msgspec.structs.replace(LINK, stream="can.gyro", device="can", alive=False, rate_hz=0.0, age_s=2.5)
    crc = Event(seconds(11), "boom", Code.CRC, 3, "unreadable messages")
    board = board_with(Health(START_NS, (LINK, bad)), crc, Event(seconds(10), "can.gyro", Code.STALE, 1, "nothing"))
    lines = screen(board)
    shown = " ".join(line_with(lines, "boom.vanes").split())
    assert shown == "● boom.vanes 200 Hz 4 ms synced -3600.00 +30 0/0 CRC"
    assert "✗ can.gyro" in line_with(lines, "Hz   2.5 s")
    assert line_with(lines, "2.5 s").endswith("STALE")
    assert "CRC" not in line_with(screen(board, now_s=20.0), "boom.vanes")


@pytest.mark.parametrize(
    ("begin", "end"),
    [
        ((Code.STALE, "nothing"), (Code.FRESH, "STALE over after 1 s")),
        ((Code.DISCONNECT, "gone"), (Code.RECONNECT, "")),
        ((Code.DISK, "no space left"), (Code.DISK, "recording again in b.mcap")),
    ],
)
def test_alarms_stand_in_a_red_banner_until_they_are_over(begin: tuple[Code, str], end: tuple[Code, str]) -> None:
    board = board_with(Event(seconds(1), "boom", begin[0], 1, begin[1]))
    banner = next(line for line in panel.lines(board, seconds(5), 80, 30, None) if "ALARM" in line.plain)
    assert f"boom {begin[0]}" in banner.plain
    assert begin[1] in banner.plain
    assert "white on red" in str(banner.style)
    assert len(banner.plain) == 80
    board.update([Event(seconds(2), "boom", end[0], 1, end[1])])
    assert not board.alarms
    assert not [line for line in screen(board) if line.startswith(" ALARM")]


def test_the_end_of_one_condition_leaves_another_of_the_same_source() -> None:
    board = board_with(
        Event(seconds(1), "boom.vanes", Code.STALE, 1, "nothing"),
        Event(seconds(1), "boom.vanes", Code.SLOW, 1, "slow"),
        Event(seconds(2), "boom.vanes", Code.FRESH, 1, "SLOW over after 1 s"),
    )
    assert [e.code for e in board.alarms] == [Code.STALE]


def test_a_flight_is_complete_once_all_streams_were_alive_together() -> None:
    dead = msgspec.structs.replace(LINK, stream="can.gyro", alive=False)
    board = board_with(Health(START_NS, (LINK, dead)))
    assert not board.ever_complete
    board.update([Health(START_NS, (LINK, LINK))])
    board.update([Health(START_NS, (LINK, dead))])
    assert board.ever_complete


@pytest.mark.parametrize("width", [40, 80, 120, 160, 220])
@pytest.mark.parametrize("height", [8, 16, 24, 30, 50])
def test_any_terminal_is_filled_and_never_overrun(width: int, height: int) -> None:
    links = tuple(msgspec.structs.replace(LINK, stream=f"device.stream{i}") for i in range(8))
    events = [Event(seconds(i), "boom", Code.CRC, i, "unreadable messages") for i in range(20)]
    board = board_with(ALPHA, estimate("split"), estimate("II"), Health(START_NS, links), *events)
    lines = panel.lines(board, seconds(12), width, height, None)
    assert len(lines) == height
    assert all(line.cell_len <= width for line in lines)
    assert "quit" in lines[-1].plain or width < 80


def test_events_are_seen_on_a_small_terminal_with_many_links() -> None:
    links = tuple(msgspec.structs.replace(LINK, stream=f"device.stream{i}") for i in range(8))
    board = board_with(
        ALPHA, estimate("split"), Health(START_NS, links), Event(seconds(1), "operator", Code.MARK, 1, "gear down")
    )
    assert line_with(screen(board, width=80, height=24), "gear down")


def test_missed_ticks_are_told_in_80_columns_while_a_test_point_is_open() -> None:
    """With the longest title of a shipped card."""
    board = board_with(
        Health(START_NS, (LINK,), overruns=117, dropped=3), Event(START_NS, "operator", Code.POINT_START, 12, "TP 12")
    )
    board.title = "instrumented: twin_otter_calibrated_baseline on instrumented"
    shown = screen(board, width=80, height=24)
    assert "117 ticks missed, 3 rows dropped" in "\n".join(shown)
    assert "00:00:12" in shown[0]
    assert "TEST POINT 12  12 s" in shown[0]
    only = board_with(Health(START_NS, (LINK,), overruns=1))
    assert "1 tick missed" in "\n".join(screen(only))
    assert "dropped" not in "\n".join(screen(only))


ICE = "drag +44±15 %: as by ice on the wing; not told from ice on the tail. By chance once in 20 h"


def test_a_changed_aircraft_is_said_in_words_and_by_the_bell_until_it_is_over() -> None:
    board = board_with(ALPHA)
    assert "baseline" not in "\n".join(screen(board)), "no flight is held against one that it has not"
    board.has_baseline = True
    assert "baseline not watched" in line_with(screen(board, width=80, height=24), " log "), "no derivative is known"
    board.has_baseline_of_drag = True
    assert "baseline unchanged" in line_with(screen(board, width=80, height=24), " log ")
    assert panel.heard(board) == 0
    board.update([Event(seconds(5), "aircraft", Code.CHANGED, 1, ICE)])
    shown = screen(board, width=80, height=24)
    assert "baseline CHANGED" in line_with(shown, " log ")
    first = next(i for i, line in enumerate(shown) if line.startswith(" AIRCRAFT CHANGED  00:00:05  drag +44±15 %"))
    told = " ".join(line.strip() for line in shown[first : first + 2])
    assert told == f"AIRCRAFT CHANGED  00:00:05  {ICE}"
    assert panel.heard(board) == 1
    board.update([Event(seconds(6), "aircraft", Code.UNWATCHED, 1, "no angle of attack")])
    board.update([Event(seconds(7), "aircraft", Code.UNCHANGED, 1, "as the baseline again")])
    assert "baseline not watched" in line_with(screen(board, width=80, height=24), " log ")
    assert panel.heard(board) == 0


def test_what_is_not_watched_does_not_look_unchanged() -> None:
    """Drag whose thrust is lost: only what derivatives tell is left, and nothing before an input was flown."""
    board = board_with(ALPHA, Health(START_NS, (LINK,), overruns=0, dropped=0))
    board.has_baseline = board.has_baseline_of_drag = True
    lost = Event(seconds(5), "drag", Code.UNWATCHED, 1, "no thrust: drag is NOT watched")
    board.update([lost])
    assert "baseline not watched" in line_with(screen(board, width=80, height=24), " log ")
    assert wrong_answer(board, seconds(12)).words == "WARNING"
    board.update([estimate("physical")])
    assert "baseline derivatives unchanged, drag not watched" in line_with(screen(board, width=80, height=24), " log ")
    assert any("CHECK" in line and "drag is NOT watched" in line for line in screen(board, width=80, height=24))
    board.update([Event(seconds(6), "aircraft", Code.UNWATCHED, 1, "no angle of attack")])
    assert "baseline not watched" in line_with(screen(board, width=80, height=24), " log ")
    board.update([Event(seconds(7), source, Code.WATCHED, 0, "again") for source in ("aircraft", "drag")])
    assert "baseline unchanged" in line_with(screen(board, width=80, height=24), " log ")

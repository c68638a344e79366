"""The finished test points with their recommended values: rows of text, for the terminal and the page alike."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

from rich.text import Text

from station.flight.board import Board
from station.flight.finished_points import FinishedPoint
from station.rows import ParamEstimate, Status
from station.screen.answers import significant
from station.screen.derivative_tables import TITLE, styled

_NUMBER: Final = 4
_NAME: Final = 14
_AIR: Final = 9
_CELL: Final = 14


def cell(p: ParamEstimate | None) -> str:
    """Value and 2 sd; a dash where it was not estimated."""
    if p is None or p.status is not Status.ESTIMATED or not math.isfinite(p.value):
        return "–"
    return f"{significant(p.value, p.value)}±{significant(2 * p.sd, p.value)}"


def point_lines(board: Board, width: int, count: int) -> Iterator[Text]:
    """A title and the last points, `count` lines in all; as many derivatives as fit whole into `width`."""
    points = board.points.ended
    if not points or count < 2:  # noqa: PLR2004  a title alone tells nothing
        return
    fitting = max(1, (width - 1 - _NUMBER - _NAME - _AIR) // _CELL)
    names = board.derivatives[:fitting]
    title = styled(f"{' POINTS':<{1 + _NUMBER + _NAME}}", TITLE)
    yield title.append(f"{'air':<{_AIR}}" + "".join(f"{name:>{_CELL}}" for name in names), "bold dim")
    for p in points[-(count - 1) :]:
        yield _line(p, len(names))


def _line(p: FinishedPoint, columns: int) -> Text:
    name = p.note.partition(";")[0]
    line = Text(f" {p.number:>{_NUMBER - 1}} {name[: _NAME - 1]:<{_NAME}}")
    line.append(f"{p.air:<{_AIR}}", "" if p.air in ("calm", "light") else "yellow")
    for found in p.found[:columns]:
        text = cell(found)
        line.append(f"{text:>{_CELL}}", "dim" if text == "–" else "")
    return line


def point_markdown(points: Sequence[FinishedPoint], names: Sequence[str], start_ns: int) -> str:
    """All points, each with its time in s since `start_ns`, the worst air in it and what it found."""
    if not points:
        return "No test point is finished. The key **p** on the terminal begins and ends one; so does a card's step."
    head = ["point", "from s", "to s", "worst air", "alpha valid", "method", *names]
    lines = [_row(head), _row(["---"] * len(head))]
    for p in points:
        note = f"{p.number} {p.note}".replace("|", "/")
        valid = f"{100 * p.valid_share:.0f} %" if math.isfinite(p.valid_share) else "–"
        begun, ended = (f"{(t - start_ns) * 1e-9:.0f}" for t in (p.begun_ns, p.ended_ns))
        lines.append(_row([note, begun, ended, p.air, valid, p.method, *map(cell, p.found)]))
    return "\n".join(["Values when each ended ± 2 sd, 1/rad.", "", *lines])


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"

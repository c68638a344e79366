"""What a rig declares or derives beyond the station's signals, as lines of the terminal screen."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from rich.text import Text

from station.conventions import from_si
from station.flight.board import Board
from station.rows import Code
from station.screen.derivative_tables import TITLE, styled

MOST_LINES: Final = 2
"""On a screen of 80 columns that shows derivatives and links, too."""


def signal_lines(board: Board, width: int) -> Iterator[Text]:
    """As many to a line as fit, each as value and unit, those beyond their limits in red and first; nothing where none
    is declared."""
    line, made = styled(" SIGNALS", TITLE), 0
    if not board.signals:
        return
    for s in sorted(board.signals, key=lambda s: (s.name, Code.LIMIT) not in board.conditions):
        value = board.frame.values[s.column] if board.frame is not None else math.nan
        known = math.isfinite(value)
        text = f"  {s.name} {from_si(value, s.unit):.4g} {s.unit}" if known else f"  {s.name} –"
        text = text.removesuffix(" 1")
        if line.cell_len + len(text) > width:
            yield line
            line, made = Text("        "), made + 1
            if made == MOST_LINES:
                return
        line.append(text, "bold red" if (s.name, Code.LIMIT) in board.conditions else "" if known else "dim")
    yield line


def signal_words(board: Board) -> str:
    """The same in a line of plain text."""
    return "".join(line.plain for line in signal_lines(board, 10_000)).removeprefix(" SIGNALS").strip()

"""The operator's tables of derivatives, as lines of the terminal screen.

A number without status is never shown as valid: what is not estimated is a dash, what is invalid is in brackets, with
why.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from rich.text import Text

from station.flight.board import Board
from station.rows import ParamEstimate, Status
from station.screen.answers import Derivative, derivatives, drag_answer, significant, value_text

TITLE: Final = "bold cyan"
_NAME: Final = 12
_VALUE: Final = 8
_BOUND: Final = 10
_STATUS: Final = 11
_CHANGE: Final = 12
_CELL: Final = 15
_FIRST_TO_GO: Final = ("V", "III")
"""Of the columns, where the terminal is narrow."""
_EQUATIONS: Final = ("CY", "Cl", "Cn")


def styled(text: str, style: str) -> Text:
    """Text whose style does not reach what is appended."""
    return Text().append(text, style)


def derivative_lines(board: Board, width: int) -> Iterator[Text]:
    """One line a longitudinal derivative: the recommended method's estimate, the other methods' beside as far as they
    fit whole into `width`, and why not."""
    others = [m for m in list(board.methods) if m != board.recommended]
    changed = _CHANGE if board.against is not None else 0
    for m in (*_FIRST_TO_GO, *reversed(list(board.methods))):
        if _NAME + _VALUE + _BOUND + _STATUS + changed + sum(map(_column, others)) > width and m in others:
            others.remove(m)
    title = styled(f"{' DERIVATIVES':<{_NAME}}", TITLE)
    title.append(f" {board.recommended + ' ± 2σ':<{_VALUE + _BOUND - 1}}", "bold").append(
        f"{'[1/rad]':<{_STATUS}}", "dim"
    )
    title.append(f"{'vs baseline':>{changed}}" if changed else "", "bold dim")
    yield title.append("".join(f"{m:>{_column(m)}}" for m in others), "bold dim")
    whys: dict[str, list[str]] = {}
    for d in derivatives(board):
        p = board.parameter(board.recommended, d.name)
        line = Text(f"{'   ' + d.name:<{_NAME}}").append_text(_estimate(d))
        line.append(f"{d.change or '–':>{changed}}" if changed else "", "" if d.change else "dim")
        for m in others:
            q = board.parameter(m, d.name)
            text = value_text(q, p.value if p is not None else math.nan)
            line.append(f"{text:>{_column(m)}}", "" if q is not None and q.status is Status.ESTIMATED else "dim")
        if p is not None and not d.bound:
            whys.setdefault(d.why or p.status, []).append(d.name)
        yield line
    for why, names in whys.items():
        yield styled(f"   {'all' if len(names) == len(board.derivatives) else ', '.join(names)}: {why}", "yellow")


def drag_lines(board: Board) -> Iterator[Text]:
    """CD_0 in the columns of the derivatives, and the baseline's; nothing without a baseline of it."""
    d = drag_answer(board)
    if d is None or board.against is None:
        return
    line = Text(f"{'   ' + d.name:<{_NAME}}")
    if not d.bound:
        yield line.append(f"{d.value:>{_VALUE}}  {d.why}", "dim")
        return
    line.append(f"{d.value:>{_VALUE}}", "bold green").append(f"{' ' + d.bound:<{_BOUND + _STATUS}}")
    yield line.append(f"{d.change:>{_CHANGE}}").append(f"  baseline {board.against.CD_0:.4f}", "dim")


def _column(method: str) -> int:
    return max(8, len(method) + 2)


def _estimate(d: Derivative) -> Text:
    """Value, 2 sd and status of the recommended method, in fixed columns."""
    if not d.bound:
        return styled(f"{d.value:>{_VALUE}}{'':{_BOUND}}{d.state:<{_STATUS}}", "dim")
    text = styled(f"{d.value:>{_VALUE}}", "bold green").append(f"{' ' + d.bound:<{_BOUND}}")
    return text.append(f"{d.state:<{_STATUS}}", "green" if d.state == "enough" else "")


def lateral_lines(board: Board) -> Iterator[Text]:
    """A line for each of CY, Cl and Cn, a column a regressor; nothing where no method gives them."""
    if not board.lateral:
        return
    method = board.lateral_method
    yield Text()
    title = styled(f"{' LATERAL':<{_NAME}}", TITLE).append(f" {method} ± 2σ", "bold").append("  [1/rad]   ", "dim")
    yield title.append(lateral_summary(board).partition(" ")[2])
    columns = list(dict.fromkeys(name.partition("_")[2] for name in board.lateral))
    yield styled(f"{'':6}" + "".join(f"{column:>{_CELL}}" for column in columns), "bold dim")
    whys: dict[str, list[str]] = {}
    for equation in _EQUATIONS:
        line = Text(f"   {equation:<3}")
        for column in columns:
            p = board.parameter(method, f"{equation}_{column}")
            enough = p is not None and board.is_enough(p)
            style = "bold green" if enough else "" if p is not None and p.status is Status.ESTIMATED else "dim"
            line.append(f"{_cell(p):>{_CELL}}", style)
            if p is not None and p.status is not Status.ESTIMATED:
                whys.setdefault(p.why or p.status, []).append(p.name)
        yield line
    for why, names in whys.items():
        yield styled(f"   {'all' if len(names) == len(board.lateral) else ', '.join(names)}: {why}", "yellow")


def lateral_summary(board: Board) -> str:
    """Method, and how many of the lateral derivatives are estimated and well enough known."""
    found = [p for name in board.lateral if (p := board.parameter(board.lateral_method, name)) is not None]
    estimated = sum(p.status is Status.ESTIMATED for p in found)
    enough = sum(board.is_enough(p) for p in found)
    return f"{board.lateral_method} {estimated} of {len(board.lateral)} estimated, {enough} enough"


def _cell(p: ParamEstimate | None) -> str:
    """Value and 2 sd to the bound's first digit, its second too where it is 1 or 2; at most four decimals."""
    if p is None or p.status is Status.UNESTIMATED or not math.isfinite(p.value):
        return "–"
    if p.status is Status.INVALID:
        return f"({significant(p.value, p.value)})"
    bound = 2 * p.sd
    first = math.floor(math.log10(bound)) if bound > 0 else -4
    decimals = min(max(-first + (bound < 3 * 10.0**first), 0), 4)
    return f"{p.value:.{decimals}f}±{bound:.{decimals}f}"

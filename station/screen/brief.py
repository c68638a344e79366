"""What the Rerun page's first screen says, as plain data: its process has neither the board nor the guide."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from station.screen.answers import (
    Answer,
    Derivative,
    alpha_answer,
    alpha_text,
    every_derivative,
    phase_words,
    point_answer,
    wrong_answer,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from station.flight.board import Board
    from station.flight.guide import Guide

MOST_POINTS: Final = 250
"""Of a drawn input: about one a pixel of its picture."""


class Picture(msgspec.Struct, frozen=True):
    """One surface's input, deg: as drawn, and as flown, NaN where it is still to come."""

    surface: str
    drawn: list[float]
    flown: list[float]


class StepBrief(msgspec.Struct, frozen=True):
    """What there is to see of the step under way."""

    name: str
    number: int
    """From 1."""
    of: int
    run: int
    """How often it has been flown; the one under way counts."""
    repeats: int
    phase: str
    """ready, countdown, flying, settling, verdict, done."""
    since_s: float
    """Since the input begins; negative in the countdown."""
    length_s: float
    """Of the input."""
    words: str = ""
    """What the crew does now."""
    configuration: str = ""
    checks: tuple[tuple[str, bool], ...] = ()
    """Of its condition: words, and whether it is met."""
    verdict: str = ""
    """Empty before there is one."""
    pictures: tuple[Picture, ...] = ()
    results: tuple[tuple[str, str], ...] = ()
    """Steps that are over: name, and how they ended."""


class Brief(msgspec.Struct, frozen=True):
    """What the page's first screen says."""

    alpha: Answer
    alpha_text: str
    """Value and 2 sd, deg; empty where there is none."""
    point: Answer
    wrong: Answer
    method: str
    """To believe first."""
    derivatives: tuple[Derivative, ...]
    """Longitudinal ones, and what else the step is flown for."""
    step: StepBrief | None = None


def brief(board: Board, now_ns: int) -> Brief:
    """What a board says now. Called from a screen's thread while the loop goes on."""
    asked = () if board.guide is None else tuple(board.guide.step.accept)
    return Brief(
        alpha=alpha_answer(board),
        alpha_text="" if board.alpha is None else alpha_text(board.alpha).strip(),
        point=point_answer(board),
        wrong=wrong_answer(board, now_ns),
        method=board.recommended,
        derivatives=tuple(
            every_derivative(board, [*board.derivatives, *(n for n in asked if n not in board.derivatives)])
        ),
        step=None if board.guide is None else _step(board.guide),
    )


def _step(guide: Guide) -> StepBrief:
    shown, step, table = guide.shown, guide.step, guide.table
    verdict = shown.verdict
    return StepBrief(
        name=step.name,
        number=shown.number,
        of=len(guide.steps),
        run=shown.run,
        repeats=step.repeats,
        phase=shown.phase.value,
        words=phase_words(guide),
        since_s=shown.since_s,
        length_s=float(table.t_s[-1]),
        configuration=step.condition.configuration,
        checks=tuple((c.words, c.good) for c in shown.checks),
        verdict="" if verdict is None else verdict.words,
        pictures=tuple(_picture(name, drawn, guide.flown.get(name)) for name, drawn in table.surfaces.items()),
        results=shown.results,
    )


def _picture(name: str, drawn: NDArray[np.float64], flown: NDArray[np.float64] | None) -> Picture:
    if flown is None or len(flown) != len(drawn):  # of another step: the loop goes on meanwhile
        flown = np.full(len(drawn), math.nan)
    stride = max(1, math.ceil(len(drawn) / MOST_POINTS))
    return Picture(name, np.degrees(drawn[::stride]).tolist(), np.degrees(flown[::stride]).tolist())

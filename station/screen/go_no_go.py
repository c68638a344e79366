"""The go / no-go table of `station check`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from station.conventions import TICK_HZ, Stream, from_si
from station.flight.board import CONDITIONS, Board
from station.flight.verdict import obstacles
from station.profile import DeclaredSignal, Derived, DerivedSignal, Profiles, Rig, why_none
from station.rows import Code, Event, Level
from station.screen.plots import event_text

WIDE: Final = 100
"""Columns from which on the table has room for what is out of range; below, it stands under the table."""
LATE_SHARE: Final = 0.05
"""Of the ticks of a check; beyond, a low rate may be this machine's doing. On a quiet one no tick is late."""
_SLOW: Final = ("[red]NO-GO[/]", "[yellow]busy[/]")
"""The verdict of a stream that is only too slow, on a machine that has time and on a busy one."""


def print_check(
    card: str,
    board: Board,
    streams: Sequence[Stream],
    told: Sequence[Event],
    sent: Mapping[str, str],
    rates: Mapping[str, float],
    seconds: float,
) -> bool:
    """The go / no-go table of what was heard, what is the matter and what is `sent` to each device; whether all go.

    `rates`: of each stream (Hz) over the `seconds` that were listened; health's are those of its last half second,
    which one late message moves below what is asked.
    """
    console = Console()
    console = console if console.is_terminal else Console(width=100)
    grid, below = Table(title=f"check {card}"), list[str]()
    for name in ("stream", "alive", "rate Hz", "clock", "range", "verdict"):
        grid.add_column(name, no_wrap=name != "range")
    heard = board.health.streams if board.health is not None else ()
    all_go = bool(heard)
    late = sum(e.count for e in told if e.code is Code.OVERRUN)
    is_busy = late > LATE_SHARE * seconds * TICK_HZ
    for s, stream in zip(heard, streams, strict=False):
        mine = (s.stream, s.device)
        holding = [e for (source, _), e in board.conditions.items() if source in mine]
        outside = next((e.detail for e in told if e.source in mine and e.code is Code.RANGE), "")
        rate = rates.get(s.stream, 0.0)
        is_slow = not s.alive or rate < 0.9 * stream.rate_hz
        go = s.clock != "rejected" and not outside
        go &= not any((e.level is Level.ALARM and e.code is not Code.STALE) or e.code is Code.STUCK for e in holding)
        verdict = "[red]NO-GO[/]" if not go else "[green]GO[/]" if not is_slow else _SLOW[is_busy]
        all_go &= go and not is_slow
        if outside and console.width < WIDE:
            below.append(f"{s.stream}: {outside}")
            outside = "outside"
        grid.add_row(
            *(s.stream, "yes" if s.alive else "no", f"{rate:.0f} of {stream.rate_hz:g}", s.clock),
            Text(outside or ("ok" if s.alive else "-")),
            verdict,
        )
    for source in _absent(board):
        all_go = False
        grid.add_row(source, "no", "-", "-", "-", "[red]NO-GO[/]")
    console.print(grid)
    if is_busy:
        below.append(
            f"this machine was too busy to judge rates: {late} of {seconds * TICK_HZ:.0f} ticks came late\n"
            "stop what else runs, or check by `chrt -r 5 station check`"
        )
    for line in [
        *below,
        *_remarks(board, streams, told),
        *(f"sent to {name}: {words}" for name, words in sent.items()),
    ]:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    return all_go


def print_signals(rig: Rig, newest: Mapping[str, float]) -> bool:
    """What the rig declares, derives or limits, from the `newest` values (SI); whether none is beyond its limits."""
    entries: dict[str, DeclaredSignal | DerivedSignal] = {**rig.signals, **{n: rig.derived[n] for n in derived_of(rig)}}
    if not entries:
        return True
    grid = Table(title=f"signals of {rig.name}")
    for name in ("signal", "value", "limits", "verdict"):
        grid.add_column(name, no_wrap=name != "value")
    all_go, values = True, dict(newest)
    made = {d.signal.name: d for d in rig.further.derived}
    for name, entry in entries.items():
        why = ""
        if name in made:
            values[name], why = worked_out(made[name], values)
        value = values.get(name, math.nan)
        go = not (value < (-math.inf if entry.limit_low is None else entry.limit_low))
        go &= not (value > (math.inf if entry.limit_high is None else entry.limit_high))
        all_go &= go
        shown = f"{from_si(value, entry.unit):.4g} {entry.unit}" if math.isfinite(value) else why or "not heard"
        bounds = (entry.limit_low, entry.limit_high)
        low, high = ("" if x is None else f"{from_si(x, entry.unit):.4g}" for x in bounds)
        limits = f"{low} to {high} {entry.unit}" if low or high else "-"
        grid.add_row(name, Text(shown), Text(limits.strip()), "[green]GO[/]" if go else "[red]NO-GO[/]")
    console = Console()
    console = console if console.is_terminal else Console(width=100)
    console.print(grid)
    return all_go


def derived_of(rig: Rig) -> list[str]:
    """Each after those it is made of."""
    return [d.signal.name for d in rig.further.derived]


def worked_out(derived: Derived, values: Mapping[str, float]) -> tuple[float, str]:
    """A derived signal of other values, SI, and why there is none."""
    names = derived.formula.names
    given = [values.get(n, math.nan) for n in names]
    if any(math.isnan(x) for x in given):
        return math.nan, f"{next(n for n, x in zip(names, given, strict=True) if math.isnan(x))} is not heard"
    try:
        made = derived.formula.numbers({n: i for i, n in enumerate(names)})(given)
        return float(made) * derived.factor + derived.offset, "is too large a number"
    except (ArithmeticError, ValueError) as error:
        return math.nan, f"{why_none(error)} now: missing while it does"


def print_steps(profiles: Profiles, signals: Collection[str]) -> bool:
    """Whether the card's steps can reach what they are flown for with these signals; whether all can."""
    if not profiles.card.steps:
        return True
    grid = Table(title=f"steps of {profiles.card.name}")
    for name in ("step", "runs", "wanted", "verdict"):
        grid.add_column(name, no_wrap=name == "verdict")
    all_go = True
    for step in profiles.card.steps:
        told = obstacles(step, profiles.aircraft, signals, profiles.card)
        all_go &= not told
        wanted = ", ".join(f"{name} to {100 * share:g} %" for name, share in step.accept.items())
        why = Text("; ".join(told) or wanted or "the record")
        grid.add_row(step.name, f"{step.repeats}", why, "[red]NO-GO[/]" if told else "[green]GO[/]")
    console = Console()
    console = console if console.is_terminal else Console(width=100)
    console.print(grid)
    return all_go


def _absent(board: Board) -> list[str]:
    """Who is not there and has no stream: who is in a loop, a process of the emulator."""
    seen = {name for s in (board.health.streams if board.health is not None else ()) for name in (s.stream, s.device)}
    return [source for source, code in board.conditions if code is Code.DISCONNECT and source not in seen]


def _remarks(board: Board, streams: Sequence[Stream], told: Sequence[Event]) -> list[str]:
    """What holds at the end, then what was counted; nothing of the streams of a device that is not there."""
    away = {source for source, code in board.conditions if code is Code.DISCONNECT}
    silent = {s.name for s in streams if s.device in away}
    lines = [event_text(e) for (source, _), e in board.conditions.items() if source not in silent]
    counts: Counter[tuple[str, Code]] = Counter()
    for e in told:
        if e.level is Level.WARNING and e.code not in CONDITIONS and e.source not in silent:
            counts[e.source, e.code] += e.count
    return lines + [f"{source} {code} {n}" for (source, code), n in counts.items()]

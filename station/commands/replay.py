"""station replay: the same estimators over a recording."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from station.clock import SystemClock
from station.commands.common import LogPath, ViewMode, judged, page_words, profiles_of
from station.commands.long_work import shown
from station.console import DONE, ERROR, judge, say
from station.conventions import TICK_HZ
from station.log import arithmetic, metadata, points, read_rows, unlike
from station.rows import Frame, Rows, UsageError

if TYPE_CHECKING:
    from station.flight import loop
    from station.flight.replay_check import Comparison

LEAD_S: Final = 30.0
"""Flight before a point that the filters run on."""
LEAD_NS: Final = round(LEAD_S * 1e9)


def replay(
    log: LogPath,
    speed: Annotated[str, typer.Option(metavar="X|max", help="times real time")] = "max",
    view: Annotated[ViewMode, typer.Option(help="Rerun viewer")] = ViewMode.none,
    verify: Annotated[
        bool,
        typer.Option("--verify", help="compare with the recorded estimates bit for bit; exit code 3: but for rounding"),
    ] = False,
    point: Annotated[
        int | None, typer.Option(metavar="N", help="only this test point, and the flight before it")
    ] = None,
) -> int:
    """Run the same estimators over a recording."""
    from station.flight import loop as live
    from station.flight.alignment import Aligner
    from station.flight.chain import chain
    from station.flight.replay_check import Comparison
    from station.screen.rerun_feed import View

    if point is not None and verify:
        raise UsageError("--verify needs the flight from its beginning on: leave out --point")
    rate = None if speed == "max" else _positive(speed, "--speed")
    about = metadata(log).about
    if about.imported or about.rig is None or about.card is None:
        what = "a simulated flight" if about.source == "simulation" else "an imported record"
        raise UsageError(f"{log}: {what} has no ticks to replay\nuse: station identify {log}")
    clock = SystemClock()
    made = chain(about.aircraft, about.card, about.rig)
    begin_ns, end_ns = (0, sys.maxsize) if point is None else _interval(log, point)
    recorded = live.recorded_beats(read_rows(log))
    source: Iterator[live.Beat] = (b for b in recorded if begin_ns - LEAD_NS <= b.tick.t_ns <= end_ns)
    if rate is not None:
        source = live.paced(source, clock, rate)
    found = Comparison()
    with ExitStack() as stack:
        show = None
        if view is not ViewMode.none:
            viewer = View(view.value, f"replay of {log.name}", profiles_of(about), on_event=lambda _: None)
            stack.callback(viewer.close)
            say(page_words(viewer.start()))

            def show(rows: Sequence[Rows]) -> None:
                viewer.show(rows)
                # Faster than it can be drawn: wait, or ticks would be dropped.
                if rate is None and found.beats % 200 == 0:
                    viewer.flush(10.0)

        told = stack.enter_context(shown(f"replaying {log.name}", log))
        aligner = Aligner(about.streams, about.rig.noise_si(), about.clock_law, about.further)
        live.run(_telling(source, told), aligner, lambda: made, None, show, found.take)
    if found.beats == 0:
        raise UsageError(f"{log}: no ticks in it: nothing to replay")
    compared = f"{found.rows} rows compared, {found.different} different"
    print(f"{found.beats} ticks, " + (compared if point is None else f"test point {point} and {LEAD_S:g} s before it"))
    if verify and found.different:
        return outcome(found, unlike(about.arithmetic, arithmetic()))
    whole = judged(log)
    return DONE if verify else whole


def outcome(found: Comparison, other: str) -> int:
    """The exit code of a replay whose bits differ; `other`: in what the recording's station and machine differ."""
    if found.gap_k is not None and not found.before_gap:
        words = f"rows are missing from the recording before tick {found.gap_k}, and {found.different} after it differ"
        return judge([f"{words}: what was flown with them cannot be repeated; all before is the same"])
    if other and not found.beyond:
        return judge([f"differs as another machine rounds, and no more; recorded by another: {other}"])
    say(found.first)
    if other:
        say(f"{found.beyond} rows differ by more than another machine's rounding; recorded by another: {other}")
    return ERROR


def _telling(source: Iterator[loop.Beat], told: Callable[[int], None]) -> Iterator[loop.Beat]:
    """The same beats; a second of flight after the other is told."""
    for beat in source:
        if not beat.tick.k % TICK_HZ:
            told(beat.tick.t_ns)
        yield beat


def _interval(log: Path, number: int) -> tuple[int, int]:
    """Begin and end of a test point, ns of station time."""
    known = points(log)
    origin = next((r.t_ns for r in read_rows(log, (Frame,))), 0)
    for p in known:
        if p.n == number:
            return origin + round(p.start_s * 1e9), origin + round(p.end_s * 1e9)
    numbers = ", ".join(str(p.n) for p in known) or "none"
    raise UsageError(f"{log}: no test point {number}\nmarked in it: {numbers}")


def _positive(text: str, option: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < math.inf:
        raise UsageError(f"{option}: {text!r} is not a number above 0")
    return value

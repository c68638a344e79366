"""The operator's table of links, as lines of the terminal screen."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from rich.text import Text

from station.flight.board import Board
from station.rows import StreamHealth
from station.screen.answers import fixed, is_alive
from station.screen.derivative_tables import TITLE, styled

_STREAM: Final = 22
_CLOCK_STYLES: Final = {"synced": "green", "none": "", "converging": "yellow"}


def link_lines(board: Board, now_ns: int, *, only_bad: bool = False) -> Iterator[Text]:
    title = f"{' LINKS':<{_STREAM}}{'rate':>6}{'age':>8}  {'clock':<10}{'offset s':>10}{'ppm':>5}{'gaps/bad':>9}"
    health = board.health
    if health is None:
        yield styled(" LINKS", TITLE).append("   nothing heard yet", "dim")
        return
    if only_bad:
        title = f" LINKS  {sum(s.alive for s in health.streams)} of {len(health.streams)} alive"
    yield styled(title, TITLE)
    for s in health.streams:
        flags = board.flags(s.stream, s.device, now_ns)
        alive = is_alive(board, s, now_ns)
        if flags or not alive or not only_bad:
            yield _link_line(s, alive, " ".join(flags))


def _link_line(s: StreamHealth, alive: bool, flags: str) -> Text:
    style = "bold red" if not alive else "yellow" if flags else "green"
    room = _STREAM - 4
    name = s.stream if len(s.stream) <= room else f"{s.stream[: room - 1]}…"
    line = styled(f" {'●' if alive else '✗'} {name:<{room}} ", style)
    age = f"{1000 * s.age_s:.0f} ms" if s.age_s < 1 else f"{s.age_s:.1f} s" if math.isfinite(s.age_s) else "–"
    line.append(f"{fixed(s.rate_hz, '.0f'):>3} Hz{age:>8}", "" if alive else "bold red")
    line.append(f"  {s.clock:<10}", _CLOCK_STYLES.get(s.clock, "bold red"))
    known = s.clock not in ("none", "unsynced")
    line.append(f"{fixed(s.offset_s, '+.2f') if known else '–':>10}{fixed(s.drift_ppm, '+.0f') if known else '–':>5}")
    line.append(f"{f'{s.gaps}/{s.bad}':>9}", "yellow" if s.gaps or s.bad else "")
    return line.append(f"  {flags}", "bold red" if not alive else "bold yellow")

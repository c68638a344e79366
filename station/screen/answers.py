"""What the operator's screens say, before it is drawn: may alpha be believed, is the point done, what is wrong.

The terminal draws it with rich, the glance page in a browser. A number without status is never given as valid: what is
not estimated is a dash, what is invalid is in brackets, with why.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Literal

import msgspec

from station.conventions import DRAG, LATERAL, TICK_HZ, from_si
from station.flight.board import Board
from station.flight.guide import Guide, Phase
from station.rows import LEVELS, MISSED_SHARE, AlphaEstimate, Code, Level, ParamEstimate, Status, StreamHealth

State = Literal["good", "doubt", "bad", "none"]
"""none: nothing can be said yet."""

NO_ALPHA: Final = {
    "ready": "no estimate yet",
    "preparing": "the estimators are being prepared; recording meanwhile",
    "failed": "no estimators: see the events",
}
"""Why there is no angle of attack, by the state of the estimators."""


SLOW_PAGE_S: Final = 5.0
"""So long behind, the Rerun page no longer shows what is."""


class Answer(msgspec.Struct, frozen=True):
    """One of the operator's questions: how it stands, in a word or two, and why."""

    state: State
    words: str
    why: str = ""


class Derivative(msgspec.Struct, frozen=True):
    """A derivative of the method to believe first, as it is written; `have` and `wanted`: 2 sd over its value."""

    name: str
    value: str
    bound: str
    """2 sd with its sign; empty where there is none to be believed."""
    state: Literal["enough", "estimated", "INVALID", "unestimated"]
    have: float | None
    wanted: float
    """0 where nothing says how well."""
    why: str = ""
    change: str = ""
    """Against a measured baseline, with 2 sd; empty where that is not known."""


def alpha_answer(board: Board) -> Answer:
    """May the corrected angle of attack be believed?"""
    a = board.alpha
    if a is None:
        return Answer("bad" if board.estimators == "failed" else "none", "NOT YET", NO_ALPHA[board.estimators])
    if not a.valid:
        return Answer("bad", "INVALID", a.why)
    return Answer("doubt", "DEGRADED", a.why) if a.why else Answer("good", "VALID")


def alpha_text(a: AlphaEstimate) -> str:
    """Value and 2 sd in degrees, in brackets where they are not to be believed."""
    text = f"{degrees(a.alpha)} ± {degrees(2 * a.alpha_sd, sign=False)}"
    return f" {text} " if a.valid else f"({text})"


def point_answer(board: Board) -> Answer:
    """Is the test point done: of a card with steps the step's verdict, else what of the derivatives is known as well as
    the card asks."""
    if board.guide is not None:
        return _step_answer(board.guide)
    point = board.point
    where = "" if point is None else f"test point {point.count}: "
    if board.accuracy <= 0:
        return Answer("none", "NO TARGET", f"{where}the card asks for no accuracy")
    enough, names = sum(d.state == "enough" for d in derivatives(board)), len(board.derivatives)
    why = f"{where}{enough} of {names} derivatives known to {100 * board.accuracy:g} %"
    return Answer("good", "DONE", why) if enough == names else Answer("doubt" if enough else "none", "NOT YET", why)


def _step_answer(guide: Guide) -> Answer:
    shown = guide.shown
    if shown.phase is Phase.DONE:
        enough = sum(how == "enough" for _, how in shown.results)
        why = f"{enough} of {len(shown.results)} steps enough"
        return Answer("good" if enough == len(shown.results) else "doubt", "CARD FLOWN", why)
    if shown.phase is Phase.VERDICT and shown.verdict is not None:
        done = shown.verdict.kind == "enough"
        return Answer("good" if done else "doubt", "DONE" if done else "NOT YET", shown.verdict.words)
    amiss = [c.words for c in shown.checks if not c.good]
    words = phase_words(guide)
    if amiss:
        return Answer("doubt", words, "not as the step wants it: " + "; ".join(amiss))
    return Answer("none", words, "in the step's condition" if shown.phase is Phase.READY else guide.step.name)


def phase_words(guide: Guide) -> str:
    """What the crew does now."""
    shown, is_steady = guide.shown, guide.step.steady is not None
    match shown.phase:
        case Phase.READY:
            return "READY" if all(c.good for c in shown.checks) else "GET READY"
        case Phase.COUNTDOWN:
            return f"{'HOLD' if is_steady else 'INPUT'} IN {math.ceil(-shown.since_s)} s"
        case Phase.FLYING:
            verb = "HOLD" if is_steady else "FLY"
            return f"{verb}, {max(float(guide.table.t_s[-1]) - shown.since_s, 0):.0f} s to go"
        case Phase.SETTLING:
            return "HOLD" if is_steady else "HANDS OFF, estimating"
        case Phase.VERDICT:
            return "VERDICT"
        case Phase.DONE:
            return "CARD FLOWN"


def wrong_answer(board: Board, now_ns: int) -> Answer:
    """What is wrong: the worst first, and how much more there is."""
    # What is not watched is no finding: it stands with the other conditions that hold.
    alarms, checks = board.alarms, [e for e in board.disagreements if e.code is not Code.UNWATCHED]
    if alarms:
        newest = alarms[-1]
        words = "ALARM" if len(alarms) == 1 else f"{len(alarms)} ALARMS"
        return Answer("bad", words, f"{newest.source} {newest.code}: {newest.detail}")
    if checks:
        return Answer("doubt", "CHECK", checks[-1].detail)
    poor = [s.stream for s in board.health.streams if not is_alive(board, s, now_ns)] if board.health else []
    if poor:
        return Answer("doubt", "LINKS", f"not alive: {', '.join(poor)}")
    held = list(board.conditions.values())
    if held:
        more = f", and {len(held) - 1} more" if len(held) > 1 else ""
        return Answer("doubt", "WARNING", f"{held[-1].source} {held[-1].code}: {held[-1].detail}{more}")
    if board.view_behind_s > SLOW_PAGE_S:
        return Answer("doubt", "PAGE LATE", f"the Rerun page is {board.view_behind_s:.0f} s behind")
    if board.health is None:
        return Answer("none", "NOT YET", "nothing heard yet")
    missed = board.health.overruns > MISSED_SHARE * TICK_HZ * board.elapsed_s(now_ns)
    if missed or board.health.dropped:
        return Answer("doubt", "LOSSES", losses_words(board))
    if board.estimators != "ready":
        state: State = "none" if board.estimators == "preparing" else "bad"
        return Answer(state, "NO ESTIMATES", NO_ALPHA[board.estimators])
    return Answer("good", "NOTHING", losses_words(board))


def baseline_answer(board: Board) -> Answer | None:
    """Is the aircraft as its baseline, and how much of it is watched? None where it has none, or is not held against it
    yet."""
    if not board.has_baseline or board.alpha is None:
        return None
    found = board.disagreements
    if Code.CHANGED in {e.code for e in found}:
        return Answer("doubt", "CHANGED")
    unwatched = {e.source for e in found if e.code is Code.UNWATCHED}
    sees_drag = board.has_baseline_of_drag and DRAG not in unwatched
    physical = board.methods.get("physical")
    known = physical.parameters if physical is not None and physical.applicable else ()
    sees_derivatives = any(p.status is Status.ESTIMATED for p in known)
    if unwatched - {DRAG} or not (sees_drag or sees_derivatives):
        return Answer("none", "not watched")
    return Answer("good", "unchanged") if sees_drag else Answer("none", "derivatives unchanged, drag not watched")


def losses_words(board: Board) -> str:
    health = board.health
    if health is None or not (health.overruns or health.dropped):
        return ""
    counts = ((health.overruns, "tick", "missed"), (health.dropped, "row", "dropped"))
    return ", ".join(f"{n} {what}{'s' if n > 1 else ''} {how}" for n, what, how in counts if n)


def is_alive(board: Board, s: StreamHealth, now_ns: int) -> bool:
    """Whether a stream comes and nothing that is an alarm is the matter with it."""
    return s.alive and not any(LEVELS[flag] is Level.ALARM for flag in board.flags(s.stream, s.device, now_ns))


def derivatives(board: Board, names: Sequence[str] | None = None) -> list[Derivative]:
    """By the method to believe first for each: the longitudinal ones, unless others are asked for."""
    made = []
    changes = board.against.changes(board.methods) if board.against is not None else {}
    for name in board.derivatives if names is None else names:
        change = change_text(*changes[name]) if name in changes else ""
        p = board.parameter(board.lateral_method if name in LATERAL else board.recommended, name)
        wanted = board.target(name)
        if p is None or p.status is Status.UNESTIMATED:
            made.append(Derivative(name, "–", "", "unestimated", None, wanted, p.why if p is not None else "", change))
        elif p.status is Status.INVALID:
            made.append(Derivative(name, value_text(p), "", "INVALID", None, wanted, p.why, change))
        else:
            have = 2 * p.sd / abs(p.value) if p.value else None
            bound = f"± {significant(2 * p.sd, p.value)}"
            state: Literal["enough", "estimated"] = "enough" if board.is_enough(p) else "estimated"
            made.append(Derivative(name, value_text(p), bound, state, have, wanted, "", change))
    return made


def change_text(change: float, sd: float) -> str:
    """In per cent, with 2 sd."""
    return f"{100 * change:+.0f}±{200 * sd:.0f} %"


def drag_answer(board: Board) -> Derivative | None:
    """CD_0 by the power that the flight shows, as the derivatives are written; None without a baseline of it."""
    if board.against is None or board.against.CD_0 is None:
        return None
    drag = board.against.drag
    if drag is None:
        return Derivative("CD_0", "–", "", "unestimated", None, 0.0, "means of 10 s with thrust and angle of attack")
    have = 2 * drag.sd / abs(drag.value) if drag.value else None
    change = change_text(drag.change, drag.change_sd)
    return Derivative("CD_0", f"{drag.value:.4f}", f"± {2 * drag.sd:.4f}", "estimated", have, 0.0, "", change)


def every_derivative(board: Board, names: Sequence[str]) -> list[Derivative]:
    """Those of these names, and drag beside them where it is held against a baseline."""
    drag = drag_answer(board)
    return [*derivatives(board, names), *([drag] if drag is not None else [])]


def value_text(p: ParamEstimate | None, scale: float = math.nan) -> str:
    """A dash where nothing is estimated; brackets round what is not to be believed."""
    if p is None or p.status is Status.UNESTIMATED or not math.isfinite(p.value):
        return "–"
    text = significant(p.value, scale if math.isfinite(scale) else p.value)
    return text if p.status is Status.ESTIMATED else f"({text})"


def significant(value: float, scale: float) -> str:
    """A derivative to three or four figures of `scale`, so that value and bound have the same decimals."""
    decimals = 1 if abs(scale) >= 10 else 2 if abs(scale) >= 2 else 3
    return f"{value:.{decimals}f}" if math.isfinite(value) else "–"


def hms(seconds: float) -> str:
    """Hours, minutes and seconds of flight."""
    whole = int(max(0.0, seconds))
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def degrees(angle: float, *, sign: bool = True) -> str:
    return fixed(from_si(angle, "deg"), "+6.2f" if sign else ".2f")


def fixed(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "–".rjust(int(form[1]) if form[1:2].isdigit() else 1)

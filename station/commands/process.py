"""The station as a process: the words it is called with, the signals that end it, and output that nobody reads."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from station.console import say

ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SEVERAL: Final = {"identify": ("--method",), "diagnose": ("--hold-out",), "points": ("--baseline", "--method")}
"""Options that take all words up to the next option, by verb; the command line's library knows them as repeatable."""


def spread(words: Sequence[str]) -> list[str]:
    """`--hold-out A B` as `--hold-out A --hold-out B`. A recording after methods is the one to identify."""
    verb = next((w for w in words if not w.startswith("-")), "")
    options, out, k = SEVERAL.get(verb, ()), list[str](), 0
    while k < len(words):
        out.append(words[k])
        k += 1
        option = words[k - 1]
        if option not in options or k == len(words):
            continue
        out.append(words[k])
        k += 1
        while (
            k < len(words) and not words[k].startswith("-") and not (option == "--method" and _is_recording(words[k]))
        ):
            out += [option, words[k]]
            k += 1
    return out


def _is_recording(word: str) -> bool:
    return word.endswith(".mcap") or os.path.isfile(word)


@contextmanager
def guarded() -> Iterator[None]:
    """While a verb is carried out: a signal to end closes what is open on the way out, letters that the terminal does
    not have become question marks, and numpy's warnings are not for the user: a number that is none has its status."""
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    before = {number: signal.getsignal(number) for number in ENDING}
    try:
        for number in ENDING[1:]:
            if before[number] is signal.SIG_DFL:
                signal.signal(number, _leave)
        with warnings.catch_warnings():
            if not sys.warnoptions:
                warnings.simplefilter("ignore", RuntimeWarning)
            yield
        sys.stdout.flush()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _open_closed_streams() -> None:
    """Started with standard streams closed, the next files opened would stand in their places."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))


def _leave(number: int, _: object) -> None:
    raise SystemExit(128 + number)


def stop_on_signals(stop: threading.Event) -> None:
    """From now on Ctrl-C, and whoever ends the process or hangs up its terminal, sets `stop` and no more."""
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, lambda *_: stop.set())


def write_line(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def line_writer() -> Callable[[str], None]:
    """Prints lines for as long as somebody takes them: a reader that dies does not end a flight."""
    is_read = True

    def write(line: str) -> None:
        nonlocal is_read
        if is_read:
            try:
                write_line(line)
            except BrokenPipeError:
                is_read = False
                discard_output()
                say("station: nobody reads standard output any more: flying on without\nCtrl-C ends the flight")

    return write


def discard_output() -> None:
    """What is still to be printed goes nowhere: its reader is gone."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)

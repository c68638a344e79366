"""The command line: which verbs there are, and what a failure of one looks like to its user."""

from __future__ import annotations

import importlib
import signal
import sys
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException
from typer.main import get_command

from station.commands.process import discard_output, guarded, spread
from station.console import DONE, ERROR, USAGE, say
from station.rows import ProfileError, StationError, UsageError

VERBS: Final = {
    "run": "Fly: read the rig's devices, estimate at 50 Hz, record and show.",
    "emulate": "Serve the card's emulated devices alone.",
    "check": "Listen to each device of a card and print go / no-go.",
    "replay": "Run the same estimators over a recording.",
    "info": "What is in a recording, and whether all of it is there.",
    "recover": "Write what can be read of a broken recording into a new one.",
    "import": "Make a station recording of a record from elsewhere.",
    "identify": "Derivatives of a recording, by every method, with their errors.",
    "points": "Test points by every method, the baseline, and what has changed.",
    "baseline": "Pool test points into an aircraft profile of measured derivatives and drag.",
    "calibrate": "A calibration flight: air data, vane and zeros, into a new aircraft profile.",
    "export": "Write a recording's table and raw streams for other programs.",
    "inputs": "What a card asks to be flown, as a table for an autopilot.",
    "simulate": "Fly the simulation with the rig's sensors into a recording.",
    "diagnose": "Compare recordings with the simulation: what is wrong, and why.",
    "campaign": "Monte Carlo: simulated flights by the thousand, all estimated.",
    "rig": "Listen to what is plugged in and write a rig and a card (rig new NAME).",
    "aircraft": "Describe an aircraft in a new profile (aircraft new NAME).",
    "planform": "Indicial lift, upwash and downwash of an aircraft's outline, into a new profile.",
    "doctor": "Look at the machine: versions, clock, disk, ports, permissions, browser.",
}
"""What `station --help` says. A verb is a function of its own module in station/commands, imported when it is called:
together they take seconds, which a station that is to record at once does not have."""

_OTHERWISE: Final = ("import", "rig", "aircraft")
"""Verbs whose modules have an underscore behind the name: a keyword, and modules of that name elsewhere."""


class _Commands(Mapping[str, Any]):
    """The verbs as the command line's library wants them, made one by one."""

    def __getitem__(self, name: str) -> Any:
        if name not in VERBS:
            raise KeyError(name)
        function = name if name not in _OTHERWISE else f"{name}_"
        made = typer.Typer(add_completion=False, rich_markup_mode=None)
        made.command(name)(getattr(importlib.import_module(f"station.commands.{function}"), function))
        return get_command(made)

    def __iter__(self) -> Iterator[str]:
        return iter(VERBS)

    def __len__(self) -> int:
        return len(VERBS)


class _Verbs(TyperGroup):
    def __init__(self, **attributes: Any) -> None:
        super().__init__(**{**attributes, "commands": {}})
        self.commands = _Commands()  # type: ignore[assignment]

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        return list(VERBS)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        with formatter.section("Commands"):
            formatter.write_dl(list(VERBS.items()))


app = typer.Typer(cls=_Verbs, pretty_exceptions_enable=False, rich_markup_mode=None)


def _version(wanted: bool) -> None:
    if wanted:
        import importlib.metadata

        print(importlib.metadata.version("flight-test-station"))
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version and leave")
    ] = False,
) -> None:
    """Flight test station: corrected angle of attack and live derivatives at 50 Hz. --debug shows tracebacks."""


def main() -> None:
    """Run the command line; exit codes: 0 done, 1 error, 2 usage or invalid profile, 3 done but degraded.

    Ended by a signal: 128 and its number, as of any program.
    """
    debug = "--debug" in sys.argv
    words = spread([a for a in sys.argv[1:] if a != "--debug"]) or ["--help"]
    try:
        with guarded():
            code = app(words, prog_name="station", standalone_mode=False)
    except typer.Exit as leaving:
        code = leaving.exit_code
    except (typer.Abort, KeyboardInterrupt):
        code = 128 + signal.SIGINT
    except TyperException as error:
        told = getattr(error, "format_message", error.__str__)()
        say(f"station: {told}\nsee: station --help")
        code = USAGE
    except StationError as error:
        if debug:
            raise
        say(f"station: {error}")
        code = USAGE if isinstance(error, (ProfileError, UsageError)) else ERROR
    except BrokenPipeError:
        discard_output()
        code = ERROR
    except OSError as error:
        if debug:
            raise
        say(f"station: {error.filename or 'the system'}: {error.strerror or error}")
        code = ERROR
    except Exception as error:
        if debug:
            raise
        say(f"station: internal error: {type(error).__name__}: {error}\nrun again with --debug to see where")
        code = ERROR
    sys.exit(code or DONE)


if __name__ == "__main__":
    main()

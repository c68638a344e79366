"""The command line: which verbs there are, and what a failure of one looks like to its user."""

from __future__ import annotations

import importlib.metadata
import signal
import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

from station.commands.campaign import campaign
from station.commands.check import check
from station.commands.diagnose import diagnose
from station.commands.emulate import emulate
from station.commands.export import export
from station.commands.identify import identify
from station.commands.import_ import import_
from station.commands.info import info
from station.commands.process import discard_output, guarded, spread
from station.commands.recover import recover
from station.commands.replay import replay
from station.commands.run import run
from station.commands.simulate import simulate
from station.console import DONE, ERROR, USAGE, say
from station.rows import ProfileError, StationError, UsageError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
for _verb in (run, emulate, check, replay, info, recover, identify, export, simulate, diagnose, campaign):
    app.command()(_verb)
app.command("import")(import_)


def _version(wanted: bool) -> None:
    if wanted:
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

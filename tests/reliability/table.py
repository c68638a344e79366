"""What the station withstands, as a table: each trial with its limit, how it came out, and of which commit.

    uv run python -m tests.reliability.table                        all: three hours, one of them the soak
    uv run python -m tests.reliability.table --only kill,soak       these anew, the others as they were kept
    uv run python -m tests.reliability.table --missing              those never made, bad inputs short of a million
    uv run python -m tests.reliability.table --quick                a twentieth of each; nothing is kept

Results are kept beside this file, each with the commit that it is of; the table is printed from there. Bad inputs add
up over calls. Needs root, loop devices and ext4 for the power cuts of a real file system; without them it says so.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Final, TypedDict

from tests.reliability import inputs, recordings
from tests.reliability.counts import ASKED
from tests.reliability.endings import CUT_S, KILLED_S, cut_on_ext4, kill, may_mount
from tests.reliability.mutations import NAMES, is_short
from tests.reliability.recordings import Told

ROOT: Final = Path(__file__).parents[2]
KEPT: Final = Path(__file__).with_name("results.json")
MUTATED: Final = {f"mutated-{name.replace(' ', '-')}": name for name in NAMES}
UNMOUNTABLE: Final = "not made: needs root, loop devices and mkfs.ext4"


NO_CODE: Final = (":!*.json", ":!*.md")
"""What is written here, and the pages, change no result."""


class Result(TypedDict):
    """Of one trial."""

    name: str
    limit: str
    found: str
    holds: bool
    commit: str


def trials(part: int, seconds: float, counts: Path | None = None) -> dict[str, Callable[[], Told]]:
    """By name; each 1/`part` of its size, mutations for so much processor time each, those of before in `counts`."""
    found: dict[str, Callable[[], Told]] = {
        "kill": lambda: recordings.endings("kill -9", 100 // part, KILLED_S, kill),
        "cuts-of-power": lambda: recordings.journal(50),
        "cuts-of-power-ext4": lambda: _on_ext4(50 // part),
        "stalls": lambda: recordings.stalls(60 / min(part, 5)),
        "full-disk": recordings.full_disk,
        "vanished-disk": recordings.vanished_disk,
        "flips": lambda: recordings.hurt("flipped bits", 2000 // part, recordings.flip),
        "cuts": lambda: recordings.hurt("cuts", 2000 // part, recordings.cut),
        "foreign-files": lambda: inputs.foreign(200 // part),
        "jumps": lambda: inputs.clock_jumps(20 // part),
        "jumps-behind-a-queue": lambda: inputs.jumps_behind_a_queue(20 // part),
        "wraps": lambda: inputs.all_wraps(500 // part),
        "sound-clocks": lambda: inputs.stalls_of_the_station(10.0 / part),
        "crafted": inputs.crafted_bytes,
        "foreign-senders": lambda: inputs.foreign_senders(200_000 // part),
        "signatures": lambda: inputs.wrong_signatures(200_000 // part),
        "flood": lambda: inputs.fast_links(8, 200, 60 / part, is_flooded=True),
        "fast-links": lambda: inputs.fast_links(32, 1000, 60 / part, is_flooded=False),
        "soak": lambda: inputs.soak(60 / part),
        "soak-stressed": lambda: inputs.soak(15 / part, stressed=True),
    }
    many = ASKED // part
    return found | {trial: partial(inputs.mutations, n, many, seconds, counts) for trial, n in MUTATED.items()}


def _on_ext4(moments: int) -> Told:
    name = "power cut of an ext4 disk"
    if not may_mount():
        return f"{name}, {moments} moments", f"{CUT_S:g} s", UNMOUNTABLE, False
    return recordings.endings(name, moments, CUT_S, cut_on_ext4)


def commit() -> str:
    """Of the working tree; with a mark where that has been changed."""
    made, changed = (
        subprocess.run(["git", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
        for words in (["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "--", ".", *NO_CODE])
    )
    return f"{made}{'+' if changed else ''}"


def kept(path: Path) -> dict[str, Result]:
    """Results of before, by trial. Raises SystemExit for a file that holds something else."""
    try:
        found: dict[str, Result] = json.loads(path.read_text())
        wanted = set(Result.__annotations__)
        bad = [name for name, result in found.items() if set(result) != wanted]
    except FileNotFoundError:
        return {}
    except (ValueError, AttributeError, TypeError) as error:
        raise SystemExit(f"{path}: no results: {error}; remove it") from error
    if bad:
        raise SystemExit(f"{path}: {', '.join(bad)}: no results; remove it")
    return found


def table(results: dict[str, Result], wanted: Iterable[str]) -> Iterable[str]:
    """Its lines."""
    yield "| trial | limit | found | | of |\n| --- | --- | --- | --- | --- |"
    for name in wanted:
        if (r := results.get(name)) is None:
            yield f"| {name} | | not made | **open** | |"
        else:
            fallen = "**open**" if r["found"].endswith(inputs.SO_FAR) else "**does not hold**"
            verdict = "holds" if r["holds"] else fallen
            yield f"| {r['name']} | {r['limit']} | {r['found']} | {verdict} | `{r['commit']}` |"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--only", default="", help="trials, with commas between")
    options.add_argument("--missing", action="store_true", help="those without a kept result, or short of inputs")
    options.add_argument("--quick", action="store_true", help="a twentieth of each")
    options.add_argument("--seconds", type=float, default=60.0, help="of processor time for the mutations of a reader")
    options.add_argument("--results", type=Path, default=KEPT, help="where results are kept")
    chosen = options.parse_args()
    counts = chosen.results.with_name("mutated.json")
    all_trials = trials(20 if chosen.quick else 1, chosen.seconds, None if chosen.quick else counts)
    results = {} if chosen.quick else kept(chosen.results)
    asked = [name for name in chosen.only.split(",") if name] or list(all_trials)
    if unknown := set(asked) - set(all_trials):
        raise SystemExit(f"--only: no {', '.join(sorted(unknown))}; known: {', '.join(all_trials)}")
    if chosen.missing:
        asked = [n for n in asked if n not in results or (n in MUTATED and is_short(MUTATED[n], counts))]
    for name in asked:
        print(f"{name} ...", file=sys.stderr, flush=True)
        told, limit, found, holds = all_trials[name]()
        results[name] = Result(name=told, limit=limit, found=found, holds=holds, commit=commit())
        if not chosen.quick:
            # Others may have been made meanwhile, beside this.
            results = kept(chosen.results) | {name: results[name]}
            chosen.results.parent.mkdir(exist_ok=True)
            chosen.results.write_text(json.dumps(results, indent=1) + "\n")
    shown = asked if chosen.quick else all_trials
    print(*table(results, shown), sep="\n")
    sys.exit(not all(name in results and results[name]["holds"] for name in shown))


if __name__ == "__main__":
    main()

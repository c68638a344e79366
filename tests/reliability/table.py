"""What the station withstands, as a table: each trial with its limit, how it came out, and of which commit.

    uv run python -m tests.reliability.table                        all of it: three hours, one of them the soak
    uv run python -m tests.reliability.table --only kill,soak       these anew, the others as they were kept
    uv run python -m tests.reliability.table --missing              those that were never made
    uv run python -m tests.reliability.table --quick                a twentieth of each; nothing is kept

Results are kept in logs/reliability.json, each with the commit that it is of; the table is printed from there. Needs
root, loop devices and ext4 for the power cuts of a real file system; without them it says so.
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
from tests.reliability.endings import CUT_S, KILLED_S, cut_on_ext4, kill, may_mount
from tests.reliability.mutations import NAMES
from tests.reliability.recordings import Told

ROOT: Final = Path(__file__).parents[2]
KEPT: Final = ROOT / "logs" / "reliability.json"
UNMOUNTABLE: Final = "not made: needs root, loop devices and mkfs.ext4"


class Result(TypedDict):
    """Of one trial."""

    name: str
    limit: str
    found: str
    holds: bool
    commit: str


def trials(part: int, seconds: float) -> dict[str, Callable[[], Told]]:
    """By name; each 1/`part` of its size, mutations for so much processor time each."""
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
        "wraps": lambda: inputs.all_wraps(500 // part),
        "sound-clocks": lambda: inputs.stalls_of_the_station(10.0 / part),
        "crafted": inputs.crafted_bytes,
        "foreign-senders": lambda: inputs.foreign_senders(200_000 // part),
        "signatures": lambda: inputs.wrong_signatures(200_000 // part),
        "flood": lambda: inputs.fast_links(8, 200, 60 / part, is_flooded=True),
        "fast-links": lambda: inputs.fast_links(32, 1000, 60 / part, is_flooded=False),
        "soak": lambda: inputs.soak(60 / part),
    }
    many = 1_000_000 // part
    return found | {f"mutated-{n.replace(' ', '-')}": partial(inputs.mutations, n, many, seconds) for n in NAMES}


def _on_ext4(moments: int) -> Told:
    name = "power cut of an ext4 disk"
    if not may_mount():
        return f"{name}, {moments} moments", f"{CUT_S:g} s", UNMOUNTABLE, False
    return recordings.endings(name, moments, CUT_S, cut_on_ext4)


def commit() -> str:
    """Of the working tree; with a mark where that has been changed."""
    words = ["git", "describe", "--always", "--dirty=+", "--exclude=*"]
    return subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout.strip()


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
            verdict = "holds" if r["holds"] else "**does not hold**"
            yield f"| {r['name']} | {r['limit']} | {r['found']} | {verdict} | `{r['commit']}` |"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--only", default="", help="trials, with commas between")
    options.add_argument("--missing", action="store_true", help="those without a kept result")
    options.add_argument("--quick", action="store_true", help="a twentieth of each")
    options.add_argument("--seconds", type=float, default=60.0, help="of processor time for the mutations of a reader")
    options.add_argument("--results", type=Path, default=KEPT, help="where results are kept")
    chosen = options.parse_args()
    all_trials = trials(20 if chosen.quick else 1, chosen.seconds)
    results = {} if chosen.quick else kept(chosen.results)
    asked = [name for name in chosen.only.split(",") if name] or list(all_trials)
    if unknown := set(asked) - set(all_trials):
        raise SystemExit(f"--only: no {', '.join(sorted(unknown))}; known: {', '.join(all_trials)}")
    if chosen.missing:
        asked = [name for name in asked if name not in results]
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

"""Bad inputs by the million: what each codec and each reader of files makes of sound messages and files, mutated.

    uv run python -m tests.reliability.mutations [--inputs 1000000] [--seconds 600] [--only ubx,mat] [--seed 1]

Each goes on until it has had so many inputs or taken so much processor time. A codec must never raise, must give only
numbers, and must read a sound message after a reset. A reader must end in a LogError or in what can be read; files from
elsewhere are read in a child (station/convert/confined.py), hundreds each, and one that ends its child is tried
again as a user's import would; of those that are read one in ten is written too. No input may take longer than
LONGEST_S, or memory beyond GROWTH_MIB. The table's inputs add up over its calls, each with a seed of its own, for as
long as the code that reads them is the same.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import resource
import sys
import tempfile
from pathlib import Path
from typing import Final

from tests.reliability.counts import ASKED, FOREIGN, Flown, keep, kept_counts
from tests.reliability.mutated_files import files, fly_files, fly_recording
from tests.reliability.mutated_links import LINKS, fly_link, links

NAMES: Final = (*LINKS, "mcap", *FOREIGN)
LOOKED: Final = 100
"""Inputs between two looks at the time that they took together."""
IN_MEMORY: Final = Path("/dev/shm")
"""Where a system has it; on a disk most of the time is the disk's."""
HARM: Final = "content hurt before it was sealed"
"""What tells these inputs from those of an older way of hurting, whose counts do not add to them."""
READERS: Final = {
    "csv": ("station.convert.delimited", "station.convert.onspeed"),
    "asc": ("station.convert.delimited",),
    "mat": ("station.convert.fdata", "station.convert.umn"),
    "mat compressed": ("station.convert.fdata", "station.convert.umn"),
    "bin": ("drivers.dataflash",),
    "ulg": ("station.convert.ulog",),
    "ch10": ("station.convert.ch10",),
    "mat umn": ("station.convert.umn",),
    "csv onspeed": ("station.convert.onspeed",),
}
"""Modules that read a file of each kind, beside what confines them."""


def code_of(name: str) -> str:
    """A digest of the code that reads `name`: its module and what of the same wing that imports, in turn."""
    root = Path(__file__).parents[2]
    if name in LINKS:
        wings, waiting = ("drivers",), ["drivers", type(links()[name].codec()).__module__]
    elif name == "mcap":
        wings, waiting = ("station.log",), ["station.log"]
    else:
        wings, waiting = ("drivers", "station.convert"), ["station.convert.confined", *READERS[name]]
    seen, digest = set[Path](), hashlib.sha256(HARM.encode())
    while waiting:
        module = root / waiting.pop().replace(".", "/")
        path = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
        if path in seen or not path.exists():
            continue
        seen.add(path)
        tree = ast.parse(path.read_text())
        imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
        within = [node for node in imported if str(node.module).startswith(wings)]
        waiting += [str(node.module) for node in within]
        waiting += [f"{node.module}.{alias.name}" for node in within for alias in node.names]
    for path in sorted(seen):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def added(name: str, inputs: int, seconds: float, kept: Path | None) -> Flown:
    """Those of earlier calls in `kept`, of the same code, and more of them up to `inputs`."""
    if kept is None:
        return fly(name, inputs, seconds)
    before = kept_counts(kept)
    code, flown = code_of(name), Flown(name)
    if (row := before.get(name)) is not None and row["code"] == code:
        flown = Flown(**{field: value for field, value in row.items() if field != "code"})
    if flown.inputs < inputs:
        # A seed of its own: the inputs of a call are not those of one before.
        flown.add(fly(name, inputs - flown.inputs, seconds, seed=flown.inputs + 1))
        keep(kept, flown, code)
    return flown


def is_short(name: str, kept: Path) -> bool:
    """Whether there are inputs still to be tried of `name`."""
    row = kept_counts(kept).get(name)
    return row is None or row["inputs"] < ASKED or row["code"] != code_of(name)


def _memory_mib() -> float:
    own, children = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return max(own, children) / 1024


def fly(name: str, inputs: int, seconds: float, seed: int = 1) -> Flown:
    """`name`: of `links()`, or a kind of file."""
    flown, all_links = Flown(name), links()
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None) as folder:
        work = Path(folder)
        if name in all_links:
            flight = fly_link(name, all_links[name], flown, seed)
        elif name == "mcap":
            flight = fly_recording(files(work)[name], flown, seed, work)
        else:
            flight = fly_files(name, files(work)[name], flown, seed, work)
        next(flight)
        flown.inputs, before, began = 1, _memory_mib(), _spent_s()
        for _ in range(inputs - 1):
            next(flight)
            flown.inputs += 1
            if flown.inputs % LOOKED == 0 and _spent_s() - began > seconds:
                break
        flown.took_s, flown.growth_mib = _spent_s() - began, _memory_mib() - before
    return flown


def _spent_s() -> float:
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--inputs", type=int, default=ASKED, help="of each")
    options.add_argument("--seconds", type=float, default=600.0, help="of processor time for each, at most")
    options.add_argument("--only", default=",".join(NAMES), help="some of them, with commas between")
    options.add_argument("--seed", type=int, default=1)
    chosen = options.parse_args()
    names = chosen.only.split(",")
    if unknown := set(names) - set(NAMES):
        raise SystemExit(f"--only: no {', '.join(sorted(unknown))}; known: {', '.join(NAMES)}")
    holds = True
    for name in names:
        flown = fly(name, chosen.inputs, chosen.seconds, chosen.seed)
        holds &= flown.is_sound
        said = f"{name}: {flown.inputs} inputs, {flown.words()}; {flown.took_s:.0f} s"
        print(said, *[flown.first] * bool(flown.raised), sep="\n", flush=True)
    sys.exit(not holds)


if __name__ == "__main__":
    main()

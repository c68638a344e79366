"""What of bad inputs has been tried, and what came of it: counted, judged, kept."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

ASKED: Final = 1_000_000
"""Inputs of each."""
TOGETHER: Final = 20
"""Inputs between two looks at the processor's clock, which costs as much as some of them do: the time of the longest is
that of so many."""
LONGEST_S: Final = 2.0
"""Of processor time for one input of some kilobytes: a hang, and not a machine that is slow."""
FOREIGN_S: Final = 65.0
"""Of a file from elsewhere: its parser is ended after 60 s of processor time."""
GROWTH_MIB: Final = 200.0
FOREIGN: Final = ("csv", "asc", "mat", "mat compressed", "bin", "ulg", "ch10", "mat umn", "csv onspeed")


@dataclass(slots=True)
class Flown:
    """What has been tried, and what came of it."""

    name: str
    inputs: int = 0
    read: int = 0
    """Of them, those in which something sound was found."""
    written: int = 0
    """Of the files read, those made a recording, which was read back; each counts as read too."""
    ended: int = 0
    """Files that ended the process which read them: a LogError to the user."""
    raised: int = 0
    longest_s: float = 0.0
    """Of processor time for TOGETHER of them, one after another."""
    took_s: float = 0.0
    growth_mib: float = 0.0
    first: str = ""
    """The first fault."""

    @property
    def limit_s(self) -> float:
        return FOREIGN_S if self.name in FOREIGN else LONGEST_S

    @property
    def is_sound(self) -> bool:
        return not self.raised and self.longest_s <= self.limit_s and self.growth_mib <= GROWTH_MIB

    def add(self, more: Flown) -> None:
        """Those of another call."""
        self.inputs, self.read = self.inputs + more.inputs, self.read + more.read
        self.written, self.ended = self.written + more.written, self.ended + more.ended
        self.raised, self.first = self.raised + more.raised, self.first or more.first
        self.longest_s = max(self.longest_s, more.longest_s)
        self.growth_mib = max(self.growth_mib, more.growth_mib)
        self.took_s += more.took_s

    def fault(self, seed: str, what: str) -> None:
        self.raised += 1
        self.first = self.first or f"{seed}: {what}"

    def words(self) -> str:
        words = f"{self.raised} faults, {self.read / max(self.inputs, 1):.0%} read"
        words += f", {self.written} made recordings" if self.written else ""
        words += f", {self.ended} ended their reader" if self.ended else ""
        return f"{words}; {self.longest_s * 1e3:.0f} ms, {self.growth_mib:.0f} MiB at most"


def kept_counts(path: Path) -> dict[str, Any]:
    """By name, each with the `code` that it is of. Raises SystemExit for a file that holds something else."""
    try:
        found: dict[str, Any] = json.loads(path.read_text())
        if all(set(row) == {*Flown.__slots__, "code"} for row in found.values()):
            return found
    except FileNotFoundError:
        return {}
    except (ValueError, AttributeError, TypeError):
        pass
    raise SystemExit(f"{path}: no counts of inputs; remove it")


def keep(path: Path, flown: Flown, code: str) -> None:
    """Beside what others have kept there meanwhile."""
    path.write_text(json.dumps(kept_counts(path) | {flown.name: asdict(flown) | {"code": code}}, indent=1) + "\n")

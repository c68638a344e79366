"""Makes the validation anew: runs a claim's command and writes what it prints into tests/README.md, with the commit.

uv run python tests/house/validation.py                 each claim, its command, and the commit its result is of
uv run python tests/house/validation.py foreign costs   runs these and writes their results
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
import tomllib
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "tests" / "README.md"
PAGES: Final = (PAGE, ROOT / "README.md")
"""A result stands on the first; the second may repeat it."""
RESULT: Final = re.compile(r"<!-- result: (\S+) -->\n(.*?)<!-- end -->", re.DOTALL)
MADE_OF: Final = re.compile(r"commit `(\w+)`")


@dataclass(frozen=True, slots=True)
class Claim:
    """What is asked of the station, and the command whose output answers it."""

    name: str
    question: str
    command: str


CLAIMS: Final = {
    name: Claim(name, row["question"].strip(), row["command"])
    for name, row in tomllib.loads((Path(__file__).parent / "claims.toml").read_text()).items()
}


def unmade(claim: Claim) -> str:
    return f"Not made on this build. To be made: `uv run python tests/house/validation.py {claim.name}`\n"


def section(claim: Claim, result: str) -> str:
    """A claim as the page has it."""
    return f"{claim.question}\n\n    {claim.command}\n\n{result}"


def git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout.strip()


def made(claim: Claim) -> str:
    """Runs a claim's command; what it prints, with commit, date, machine and time. Raises SystemExit where it fails."""
    if any(not line.endswith("README.md") for line in git("status", "--porcelain").splitlines()):
        raise SystemExit("commit first: a result is of a commit")
    began = time.monotonic()
    done = subprocess.run(claim.command, shell=True, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        print(done.stdout)
        raise SystemExit(f"{claim.name}: exit code {done.returncode}")
    minutes, commit = (time.monotonic() - began) / 60, git("rev-parse", "--short", "HEAD")
    text = done.stdout.strip()
    shown = text if text.startswith("|") else f"```text\n{text}\n```"
    head = f"Made of commit `{commit}`, {datetime.now(UTC):%Y-%m-%d}, {os.cpu_count()} cores, {minutes:.1f} min:"
    return f"{head}\n\n{shown}\n"


def renewed(page: str, results: dict[str, str]) -> str:
    """The page with these results; a claim without one on the page keeps what stands there."""

    def block(match: re.Match[str]) -> str:
        claim = CLAIMS[match[1]]
        kept = re.search(r"(?:Made of|Not made on).*", match[2], re.DOTALL)
        result = results.get(claim.name) or (kept[0] if kept else unmade(claim))
        return f"<!-- result: {claim.name} -->\n{section(claim, result)}<!-- end -->"

    return RESULT.sub(block, page)


def write(results: dict[str, str]) -> None:
    for page in PAGES:
        page.write_text(renewed(page.read_text(), results))


def main() -> None:
    asked = sys.argv[1:]
    if unknown := set(asked) - set(CLAIMS):
        raise SystemExit(f"no such claim: {', '.join(unknown)}; known: {', '.join(CLAIMS)}")
    write({})
    for name in asked:
        write({name: made(CLAIMS[name])})
    of = {m[1]: MADE_OF.search(m[2]) for m in RESULT.finditer(PAGE.read_text())}
    for claim in CLAIMS.values():
        commit = of.get(claim.name)
        print(f"{claim.name:12s} {commit[1] if commit else 'not made':10s} {claim.command}")


if __name__ == "__main__":
    main()

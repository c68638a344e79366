"""A table as the READMEs have it."""

from __future__ import annotations

from collections.abc import Iterable


def markdown(head: Iterable[str], body: Iterable[Iterable[str]]) -> str:
    """A table of cells; a bar in a cell is escaped."""
    lines = [list(head)]
    lines += [["---"] * len(lines[0])]
    lines += [[cell.replace("|", "\\|") for cell in row] for row in body]
    return "".join(f"| {' | '.join(row)} |\n" for row in lines)

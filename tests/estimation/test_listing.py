"""The terminal's table of estimates at the widths that terminals have."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from station.identification.listing import estimates_grid

NAMES = ["CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"]
ROWS = {
    "split+gust *": ["3.08±0.35", "-", "-1.52±0.55", "-0.76±0.14", "-13.5±2.8", "-1.05±0.21"],
    "physical q.s.": ["3.08±0.35", "-14.5±3.6", "-1.52±0.55", "-0.749±0.031", "-13.84±0.66", "-1.047±0.037"],
}


@pytest.mark.parametrize(("width", "lines_a_row"), [(80, 2), (100, 1)])
def test_no_estimate_loses_its_error_to_the_width(width: int, lines_a_row: int) -> None:
    out = io.StringIO()
    console = Console(file=out, width=width)
    console.print(estimates_grid(NAMES, ROWS, console))
    words = out.getvalue().split()
    assert "…" not in out.getvalue()
    for cell in (c for cells in ROWS.values() for c in cells if c != "-"):
        value, _, error = cell.partition("±")
        assert cell in words if lines_a_row == 1 else {value, f"±{error}"} <= set(words)
    assert all(line.rstrip() == line.rstrip()[:width] for line in out.getvalue().splitlines())

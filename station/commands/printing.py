"""The option --pdf: a report's page printed beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from station.api.page_printing import check_printable, print_page
from station.console import say
from station.rows import UsageError

Pdf = Annotated[
    bool,
    typer.Option("--pdf", help="print the page of --report, by Chromium, Chrome, Edge or WeasyPrint"),
]


def check_pdf(pdf: bool, report: Path | None) -> None:
    """Before anything is computed: UsageError without a page to print or anything to print it with."""
    if not pdf:
        return
    if report is None:
        raise UsageError("--pdf prints the page of --report: name its folder, as in --report report --pdf")
    check_printable()


def told(page: Path, pdf: bool) -> None:
    """Say where a report's page is and, if `pdf`, print it beside and say where that is. Raises LogError."""
    say(str(page))
    if pdf:
        say(str(print_page(page)))

"""--pdf: pages of A4 that another reader of PDF counts, and what is said where nothing can print."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from browser import chromium
from matplotlib.figure import Figure

from station.api import page_printing as printing
from station.api.page_printing import print_page
from station.commands.printing import check_pdf
from station.identification.html_page import image, write_page
from station.rows import LogError, UsageError

A4_PT = (595.276, 841.89)
"""210 by 297 mm, ISO 216."""


def page_of(folder: Path) -> Path:
    figure = Figure(figsize=(10, 4))
    figure.subplots().plot([0, 1], [0, 1])
    return write_page("a page", ["<h1>a page</h1>", *(image(figure, "a line") for _ in range(6))], folder / "page.html")


def test_a_page_is_printed_on_a4(tmp_path: Path) -> None:
    """By the boxes that the file states; a browser rounds to 1/96 in, 0.75 pt. Six pictures of 74 mm (186 mm wide,
    10 to 4) do not fit on one page of 267 mm, nor do they need more than three."""
    chromium()
    page = page_of(tmp_path)
    page.with_suffix(".pdf").write_text("an older one")
    made = print_page(page).read_bytes()
    boxes = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)\s*\]", made)
    assert 2 <= len(boxes) <= 3
    for box in boxes:
        assert [float(x) for x in box] == pytest.approx(A4_PT, abs=0.75)


def test_nothing_that_prints_is_said_before_anything_is_computed(monkeypatch, tmp_path: Path) -> None:
    check_pdf(False, None)
    with pytest.raises(UsageError, match="--report"):
        check_pdf(True, None)
    monkeypatch.setattr(printing, "_browser", lambda: None)
    monkeypatch.setattr(printing, "_has_weasyprint", lambda: False)
    with pytest.raises(UsageError, match="install Chromium"):
        check_pdf(True, tmp_path)


def test_a_browser_that_fails_is_named_and_leaves_no_older_file(monkeypatch, tmp_path: Path) -> None:
    page = page_of(tmp_path)
    page.with_suffix(".pdf").write_text("%PDF-an older one")
    broken = shutil.which("false")
    monkeypatch.setattr(printing, "_browser", lambda: broken)
    with pytest.raises(LogError, match="false: exit code 1"):
        print_page(page)
    assert not page.with_suffix(".pdf").exists()

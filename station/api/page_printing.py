"""A report's page printed to PDF by a browser that is there, or by WeasyPrint."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final

from station.rows import LogError, UsageError

BROWSERS: Final = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
    "microsoft-edge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
)
"""Programs that print as Chromium does, by name or, on macOS, by path."""
LIMIT_S: Final = 120.0
"""For a page of 20 pictures a browser takes 2 s; on a busy machine ten times that."""
HEADER: Final = b"%PDF-"


def check_printable() -> None:
    """Before anything is computed: UsageError where nothing here prints a page."""
    if _browser() is None and not _has_weasyprint():
        raise UsageError(
            "nothing here prints a page to PDF: install Chromium, Google Chrome or Microsoft Edge, or `pip install "
            "weasyprint`; or open the report's page in any browser and print it"
        )


def print_page(page: Path) -> Path:
    """The page on A4, as a file with the suffix .pdf beside it. Raises LogError if it cannot be printed."""
    target = page.with_suffix(".pdf")
    try:
        target.unlink(missing_ok=True)  # an older one is not to be taken for this
    except OSError as error:
        raise LogError(f"{target}: cannot be written: {error.strerror}") from error
    browser = _browser()
    if browser is not None:
        why = _by_browser(browser, page.resolve(), target.resolve())
    else:
        why = _by_weasyprint(page, target)
    if not target.is_file() or not target.read_bytes().startswith(HEADER):
        raise LogError(f"{target}: cannot be printed: {why or 'nothing was written'}; the page itself is {page}")
    return target


def _browser() -> str | None:
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def _has_weasyprint() -> bool:
    return importlib.util.find_spec("weasyprint") is not None


def _by_browser(browser: str, page: Path, target: Path) -> str:
    """What it says if it fails. Its folder is its own: one that is open already would take the page over."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        options = ["--headless=new", "--disable-gpu", "--no-pdf-header-footer", "--no-first-run"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            options.append("--no-sandbox")  # which it refuses to root
        command = [browser, *options, f"--user-data-dir={folder}", f"--print-to-pdf={target}", page.as_uri()]
        try:
            done = subprocess.run(command, capture_output=True, timeout=LIMIT_S, check=False)
        except subprocess.TimeoutExpired:
            return f"{browser} did not end within {LIMIT_S:.0f} s"
        except OSError as error:
            return f"{browser}: {error.strerror}"
    lines = done.stderr.decode(errors="replace").strip().splitlines()
    return f"{browser}: {lines[-1] if lines else f'exit code {done.returncode}'}"


def _by_weasyprint(page: Path, target: Path) -> str:
    try:
        from weasyprint import HTML  # an optional package

        HTML(filename=str(page)).write_pdf(str(target))
    except OSError as error:
        return f"WeasyPrint: {error}"  # a library of its own, Pango, or the file
    return ""

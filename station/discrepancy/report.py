"""The diagnosis report: one HTML file with its figures inside."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from station.discrepancy.diagnosis import Diagnosis
from station.rows import LogError

FILE_NAME: Final = "diagnosis.html"


def write_report(found: Diagnosis, result: Mapping[str, Any], folder: Path) -> Path:
    """Write the page into `folder`; returns its path. Raises LogError if it cannot be written."""
    raise LogError(f"{folder}: no report yet")

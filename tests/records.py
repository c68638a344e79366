"""Finds the flight records that the project may not carry, by the manifest records.toml beside this file.

They lie in `../shared/data` beside the checkout, or where the environment variable STATION_RECORDS says; `flights` may
lie beside that folder instead of in it. A record that is missing skips the test that needs it, or fails it under
`pytest --require-records`; one whose contents are not those of the manifest always fails it.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
from functools import cache
from pathlib import Path
from typing import Final

import pytest

MANIFEST: Final = Path(__file__).parent / "records.toml"
FOLDER: Final = Path(os.environ.get("STATION_RECORDS") or Path(__file__).parents[2] / "shared" / "data")

required: bool = False
"""Whether a missing record fails its test; conftest.py sets it from the command line."""


@cache
def manifest() -> dict[str, str]:
    """SHA-256 of every record, by its path under the records folder."""
    groups = tomllib.loads(MANIFEST.read_text())["records"]
    return {str(Path(group["folder"], name)): sha for group in groups for name, sha in group["sha256"].items()}


@cache
def found(name: str, folder: Path) -> Path | None:
    """Where a record lies, its contents checked; None where it is missing. Raises KeyError for one not listed."""
    expected = manifest()[name]
    path = next((p for p in (folder / name, folder.parent / name) if p.is_file()), None)
    if path is not None:
        actual = hashlib.sha256(path.read_bytes()).hexdigest()
        assert actual == expected, f"{name} differs from that of tests/records.toml: its sha256 is {actual}"
    return path


def record(name: str) -> Path:
    """Path of a record such as "twin_otter/totter_demo_data.mat". Skips, or fails, the test where it is missing."""
    path = found(name, FOLDER)
    if path is None:
        reason = f"{name} is not in {FOLDER} (set STATION_RECORDS); tests/records.toml says where it is from"
        if required:
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason)
    return path

"""What tests of drivers share."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator

import pytest


@pytest.fixture
def nothing_left_behind() -> Iterator[None]:
    """No thread of an adapter and no open file outlives the test."""
    descriptors = len(os.listdir("/proc/self/fd"))
    yield
    assert not [t.name for t in threading.enumerate() if t.name.startswith("adapter-")]
    assert len(os.listdir("/proc/self/fd")) <= descriptors

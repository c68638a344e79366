"""The methods table stands by itself: what lists, draws or names methods needs no compiler for it."""

import subprocess
import sys

import pytest

from station.estimation.method_table import LIVE, LIVE_LATERAL, MEASURED, METHODS, recommended


def test_the_table_imports_no_numerics():
    heavy = "print([m for m in ('numba', 'scipy', 'numpy', 'pydantic') if m in sys.modules])"
    script = f"import sys; import station.estimation.method_table; {heavy}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_names_are_those_of_the_command_line_and_the_files():
    assert LIVE == ("II", "III", "V", "split", "split+gust", "physical")
    assert LIVE_LATERAL == ("II", "split", "split+gust")
    assert MEASURED == "IV"
    assert len({m.sentence for m in METHODS.values()}) == len(METHODS)
    assert len({METHODS[name].colour for name in (*LIVE, MEASURED)}) == len(LIVE) + 1


@pytest.mark.parametrize(
    ("given", "level", "expected"),
    [
        ({}, "calm", None),
        ({"split": 6, "split+gust": 6}, "calm", "split"),
        ({"split": 6, "split+gust": 6}, "light", "split+gust"),
        ({"split": 6, "split+gust": 5}, "severe", "split"),
        ({"split": 6, "split+gust": 6, "physical": 6}, "unknown", "physical"),
        ({"split": 6, "physical": 5}, "light", "split"),
        ({"II": 4, "ml": 1}, "light", None),
        ({"II": 4, "ml": 4}, "light", "ml"),
    ],
)
def test_recommended(given: dict[str, int], level: str, expected: str | None):
    assert recommended(given, level) == expected

"""Flight records are found by their manifest, and a missing or altered one is never taken for a passed test."""

from pathlib import Path

import pytest
import records

NAME = "hfb320/hfb320_1_10.asc"


@pytest.mark.parametrize(("required", "raised"), [(False, pytest.skip.Exception), (True, pytest.fail.Exception)])
def test_a_missing_record_skips_or_fails_as_asked(required, raised, tmp_path, monkeypatch):
    monkeypatch.setattr(records, "FOLDER", tmp_path)
    monkeypatch.setattr(records, "required", required)
    with pytest.raises(raised, match=r"hfb320_1_10\.asc is not in"):
        records.record(NAME)


def test_an_altered_record_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(records, "FOLDER", tmp_path)
    (tmp_path / NAME).parent.mkdir()
    (tmp_path / NAME).write_text("0 1 2\n")
    # printf '0 1 2\n' | sha256sum
    with pytest.raises(AssertionError, match=r"differs from .* sha256 is 073cc8cc"):
        records.record(NAME)


def test_only_listed_records_are_asked_for():
    with pytest.raises(KeyError):
        records.record("twin_otter/another.mat")


def test_no_test_finds_a_record_by_a_path_of_its_own():
    """Paths to the records folder stand in tests/records.py alone."""
    tests = Path(__file__).parents[1]
    others = (p for p in tests.rglob("*.py") if p.name not in ("records.py", Path(__file__).name))
    assert [p.name for p in others if '"shared"' in p.read_text()] == []

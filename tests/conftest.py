"""Property tests find the same cases every time, and a slow machine is not a failure; the command line as a fixture."""

import os
import sys

import pytest
import records
from hypothesis import settings

from station.__main__ import main

os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")  # there are as many tests at once as processors
settings.register_profile("station", deadline=None, derandomize=True)
settings.load_profile("station")


def pytest_addoption(parser):
    parser.addoption(
        "--require-records", action="store_true", help="fail where a record of tests/records.toml is missing"
    )


def pytest_configure(config):
    records.required = config.getoption("--require-records")


@pytest.fixture
def station(monkeypatch, capsys):
    """Runs the command line; exit code, stdout, stderr."""

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["station", *map(str, words)])
        with pytest.raises(SystemExit) as leaving:
            main()
        told = capsys.readouterr()
        return leaving.value.code, told.out, told.err

    return call

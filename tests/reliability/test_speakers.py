"""Others on a MAVLink link, and counters that wrap: the trials of the table, short."""

from __future__ import annotations

import pytest

from tests.reliability.speakers import foreign, forged
from tests.reliability.wraps import fly, wrapping


@pytest.mark.parametrize("named", [1, None], ids=["the rig names the system", "the first autopilot"])
def test_nothing_of_others_gets_into_the_signals(named: int | None) -> None:
    told = foreign(2_000, seed=7, system_id=named)
    assert told.others > 500
    assert (told.mixed, told.counted, told.taken) == (0, told.others, told.sent)


def test_nothing_forged_gets_into_the_signals() -> None:
    told = forged(2_000, seed=7)
    assert told.others > 500
    assert (told.mixed, told.counted, told.taken) == (0, told.others, told.sent)


@pytest.mark.parametrize("name", list(wrapping()))
def test_counters_that_wrap_go_on(name: str) -> None:
    found = fly(wrapping()[name], turns=8, seed=7)
    assert found.wraps > 8
    assert found.messages == 160
    assert (found.worst_ns, found.numbers) == (0, 0)

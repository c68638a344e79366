"""Fits side by side: in order, in other processes, the same bits as one after the other, whatever becomes of these."""

import os
import time
from collections.abc import Iterator

import numpy as np
import pytest
from blind import Case, aircraft, prepared

from station.diagnosis import side_by_side
from station.diagnosis.candidate import Estimate
from station.diagnosis.likelihood import Problem
from station.diagnosis.side_by_side import each, meanwhile, processes


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Two processors, as many as there are."""
    monkeypatch.setattr(side_by_side, "cpu_count", lambda: 2)
    yield
    side_by_side.get_reusable_executor(max_workers=1).shutdown()


def where(x: int) -> tuple[int, int, int]:
    return x, os.getpid(), processes()


def killed_elsewhere(x: int, here: int) -> int:
    if os.getpid() != here:
        os._exit(1)
    return x


def refused(x: int) -> int:
    if x == 3:
        raise np.linalg.LinAlgError("far off")
    return x


class Counting:
    """Changes with each call, and takes a while to be packed."""

    def __init__(self) -> None:
        self.calls = 0

    def __getstate__(self) -> dict[str, int]:
        time.sleep(0.3)
        return dict(self.__dict__)

    def fit(self, _: int) -> int:
        self.calls += 1
        return self.calls


def test_what_is_made_here_changes_nothing_elsewhere(two: None) -> None:
    list(each(where, [(0,), (1,)]))  # or the share made here would be done before the other process is there
    assert list(each(Counting().fit, [(x,) for x in range(4)])) == [1, 1, 2, 2]


def test_calls_are_shared_between_processes_and_come_back_in_order(two: None) -> None:
    found = list(each(where, [(x,) for x in range(5)]))
    assert [x for x, _, _ in found] == list(range(5))
    assert [pid == os.getpid() for _, pid, _ in found] == [True, False, True, False, True]
    assert {count for _, _, count in found} == {1}  # none begins others again
    assert processes() == 2
    assert [pid == os.getpid() for _, pid, _ in meanwhile(where, [(1,), (2,)])()] == [False, False]
    assert list(each(where, [])) == []


def test_with_one_processor_nothing_is_made_before_it_is_asked_for() -> None:
    made: list[int] = []
    asked = each(made.append, [(1,), (2,)])
    next(asked)
    assert made == [1]
    assert [pid for _, pid, _ in meanwhile(where, [(1,)])()] == [os.getpid()]


def test_what_a_process_that_ends_leaves_is_made_here(two: None) -> None:
    calls = [(x, os.getpid()) for x in range(4)]
    assert list(each(killed_elsewhere, calls)) == [0, 1, 2, 3]
    assert meanwhile(killed_elsewhere, calls)() == [0, 1, 2, 3]


def test_what_a_fit_raises_elsewhere_is_raised(two: None) -> None:
    with pytest.raises(np.linalg.LinAlgError, match="far off"):
        list(each(refused, [(x,) for x in range(4)]))
    assert processes() == 2  # and the next ones are shared again


def test_fits_are_the_same_to_the_last_bit(two: None) -> None:
    case = Case(seed=178900, fit_on=("3-2-1-1", "multisine"), effects={"elevator.delay": -0.0066})
    problem = Problem(prepared(case), aircraft())
    there = problem.at_profile({})
    calls = [(values, there.slopes, 3) for values in ({"elevator.lag": -0.01}, {"elevator.delay": -0.0066})]
    shared: list[Estimate] = list(each(problem.few_steps, calls))
    for call, e in zip(calls, shared, strict=True):
        alone = problem.few_steps(*call)
        assert (alone.cost, dict(alone.state.values)) == (e.cost, dict(e.state.values))
        np.testing.assert_array_equal(alone.state.a, e.state.a)
        np.testing.assert_array_equal(alone.solved.covariance, e.solved.covariance)

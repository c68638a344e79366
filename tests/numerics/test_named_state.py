"""State by name, in Python and in compiled kernels."""

from typing import Annotated, Any, NamedTuple

import numpy as np
from numba import njit

from station.numerics.named_state import Array, blank, layout, packed


class Lag(NamedTuple):
    seconds: float
    gains: Annotated[Array, 2]


class Constants(NamedTuple):
    steps: int
    lag: Lag


class Inner:
    value: float
    is_open: bool


class State:
    count: int
    table: Annotated[Array, (2, 3)]
    inner: Inner


@njit
def advance(constants: Any, state: Any) -> float:
    c, s = constants[0], state[0]
    for _ in range(c.steps):
        s.count += 1
        s.table[1, 2] += c.lag.gains[1]
        s.inner.value = c.lag.seconds * s.count
    s.inner.is_open = s.count > 2
    return s.inner.value


def test_a_kernel_reads_constants_and_changes_state_by_name():
    constants, state = packed(Constants(3, Lag(0.5, np.array([1.0, 2.0])))), blank(State)
    assert advance(constants, state) == 1.5
    assert state["count"][0] == 3
    assert state["inner"].item() == (1.5, True)
    np.testing.assert_array_equal(state["table"][0], [[0, 0, 0], [0, 0, 6]])


def test_a_part_is_a_view_of_the_whole():
    state = blank(State)
    part = state["inner"]
    state["inner"]["value"] = 4.0
    assert part["value"][0] == 4.0
    assert layout(State)["inner"] == layout(Inner)

"""Fits that do not depend on each other, side by side on the processors that there are.

Their results are the same to the last bit on any number of processors, one included.
"""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from typing import Any, Final, TypeVar

import cloudpickle
from loky import cpu_count, get_reusable_executor

T = TypeVar("T")

MOST: Final = 4
"""Processes, this one included: there are hardly ever more fits at once that are long."""
IDLE_S: Final = 30.0
"""After which a process that waits for the next fits ends, s: a start takes two."""

_inside = False
"""Whether this process is at a share of such fits: what these split again would only wait."""


def processes() -> int:
    """How many there may be: one where this is itself one of several; LOKY_MAX_CPU_COUNT of the environment limits
    them."""
    if _inside or multiprocessing.parent_process() is not None:
        return 1
    return min(int(cpu_count()), MOST)


def each(fit: Callable[..., T], calls: Sequence[tuple[Any, ...]]) -> Iterator[T]:
    """What `fit` makes of each call's arguments, in order: each when it is asked for, or elsewhere while others are
    made. Raises what `fit` raises."""
    count = min(processes(), len(calls))
    if count <= 1:
        yield from (fit(*call) for call in calls)
        return
    others = [_begun(fit, calls[k::count]) for k in range(1, count)]
    own = _share(fit, calls[::count])
    for i in range(len(calls)):
        yield (others[i % count - 1]() if i % count else own)[i // count]


def meanwhile(fit: Callable[..., T], calls: Sequence[tuple[Any, ...]]) -> Callable[[], list[T]]:
    """The same, begun elsewhere now, or made when it is called."""
    return _begun(fit, calls) if processes() > 1 else lambda: _share(fit, calls)


def _share(fit: Callable[..., T], calls: Sequence[tuple[Any, ...]]) -> list[T]:
    global _inside
    _inside = True
    try:
        return [fit(*call) for call in calls]
    finally:
        _inside = False


def _begun(fit: Callable[..., T], calls: Sequence[tuple[Any, ...]]) -> Callable[[], list[T]]:
    """A share begun in another process; where that cannot be or does not last, made here."""
    # Packed now: the pool would do so in a thread of its own, while the share made here changes what is packed.
    packed = cloudpickle.dumps((fit, calls))
    try:
        future = get_reusable_executor(max_workers=processes() - 1, timeout=IDLE_S).submit(_unpacked, packed)
    except (OSError, BrokenExecutor):
        return lambda: _unpacked(packed)

    def made() -> list[T]:
        try:
            found: list[T] = future.result()
        except (OSError, BrokenExecutor):  # the system took its memory
            found = _unpacked(packed)
        return found

    return made


def _unpacked(packed: bytes) -> list[Any]:
    return _share(*pickle.loads(packed))

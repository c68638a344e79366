"""Several aircraft as one, whose quantities are columns where they differ: one pass makes the series of them all.

Series are short, and what a pass costs is mostly the calls: sixteen aircraft take hardly longer than one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterator, Sequence
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from station.profile import Aircraft
from station.profile.aircraft import Derivative, Instrument

T = TypeVar("T", np.float64, np.complex128)
Quantity = Any
"""A number, or a column of them."""

MOST: Final = 16
"""Aircraft in a pass, at most: an array of their series of a minute is 200 kB, of which a processor's second cache
holds a few. With twice as many a pass is no faster for each."""
_PARTS: Final = ("instruments", "imu_offset", "boom", "unsteady", "fin")
"""Of an aircraft, what changes more than the coefficients."""
_MISSING: Final = {"derivatives": Derivative(value=0.0), "instruments": Instrument()}
"""What stands for an entry that an aircraft does not have."""


def some(x: Quantity) -> bool:
    """Whether any of them is not 0."""
    return bool(x.any()) if isinstance(x, np.ndarray) else bool(x)


def together(rows: Sequence[NDArray[T]]) -> NDArray[T]:
    """Series (..., n) as (..., rows, n); the leading axes of some may be fewer."""
    return np.stack(np.broadcast_arrays(*rows), axis=-2)


def joined(parts: Sequence[NDArray[T]], axis: int = -2) -> NDArray[T]:
    """Parts one after the other along an axis; the leading axes of some may be fewer."""
    lead = np.broadcast_shapes(*[x.shape[:axis] for x in parts])
    return np.concatenate([np.broadcast_to(x, lead + x.shape[axis:]) for x in parts], axis=axis)


def stacks(aircraft: Sequence[Aircraft], about: Aircraft) -> Iterator[list[int]]:
    """Groups, by their places, of aircraft to be stacked with `about`: MOST at most, that change the same parts, so
    that what comes before these is computed once. One that cannot be stacked is a group by itself."""
    own, alike = _kind(about), defaultdict[Hashable, list[int]](list)
    for i, a in enumerate(aircraft):
        if _kind(a) == own:
            alike[tuple(getattr(a, part) == getattr(about, part) for part in _PARTS)].append(i)
        else:
            yield [i]
    for places in alike.values():
        yield from (places[k : k + MOST] for k in range(0, len(places), MOST))


def _kind(a: Aircraft) -> Hashable:
    """What must be the same within a stack: which parts there are, and what is computed sample after sample."""
    played = tuple((name, i) for name, i in sorted(a.instruments.items()) if i.backlash or i.cubic)
    boom = (True, True) if a.boom is None else (False, a.boom.mode_frequency is None)
    return boom, a.drag is None, a.fin is None, a.separation.alpha_star is None, played


def stacked(aircraft: Sequence[Aircraft], axes: int) -> Aircraft:
    """Aircraft as one: numbers that differ become columns, (aircraft, 1) for `axes` 1, (aircraft, 1, 1) for 2: as many
    as the signals have. Nothing computed with it may be edited in place: that would edit the column. Raises TypeError
    where anything else differs."""
    made: Aircraft = _one(aircraft, axes)
    return made


def _one(values: Sequence[Any], axes: int) -> Any:
    first = values[0]
    if all(v is first or (isinstance(v, float) and v == first) for v in values):
        return first
    if any(type(v) is not type(first) for v in values) and not all(isinstance(v, int | float) for v in values):
        raise TypeError(f"aircraft of different kinds: {first!r} and others")
    if isinstance(first, Derivative):
        return first.model_copy(update={"value": _one([v.value for v in values], axes)})
    if isinstance(first, BaseModel):
        update = {}
        for name in type(first).model_fields:
            parts = [getattr(v, name) for v in values]
            if isinstance(parts[0], dict):
                update[name] = _entries(parts, axes, _MISSING.get(name))
            else:
                update[name] = _one(parts, axes)
        return first.model_copy(update=update)
    if isinstance(first, tuple):
        return tuple(_one(column, axes) for column in zip(*values, strict=True))
    if all(isinstance(v, int | float) for v in values):
        return np.array(values, dtype=np.float64).reshape(-1, *(1,) * axes)
    if all(v == first for v in values):
        return first
    raise TypeError(f"aircraft of different kinds: {first!r} and others")


def _entries(parts: Sequence[dict[str, Any]], axes: int, missing: Any) -> dict[str, Any]:
    names = dict.fromkeys(name for part in parts for name in part)
    return {name: _one([part.get(name, missing) for part in parts], axes) for name in names}

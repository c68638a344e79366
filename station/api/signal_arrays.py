"""Columns of a recording as xarray's arrays, read when they are looked at and no more of them than is looked at."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

Column = NDArray[np.float64]
Read = Callable[[int, int], Mapping[str, Column]]
"""Of rows from the first number to before the second: each name's column; a name may be missing where all is."""

BLOCK: Final = 3000
"""Rows read together: a minute at 50 Hz."""


class Blocks:
    """A table of n rows in blocks of BLOCK, each read once when it is first asked for."""

    def __init__(self, n: int, read: Read) -> None:
        self.n = n
        self._read = read
        self._kept: dict[int, Mapping[str, Column]] = {}
        self._lock = threading.Lock()

    def column(self, name: str, first: int, last: int) -> Column:
        """Rows from `first` to before `last` of a column."""
        pieces = [np.zeros(0)]
        for block in range(first // BLOCK, -(-last // BLOCK)):
            begin, end = block * BLOCK, min((block + 1) * BLOCK, self.n)
            with self._lock:
                if block not in self._kept:
                    self._kept[block] = self._read(begin, end)
            column = self._kept[block].get(name)
            column = np.full(end - begin, np.nan) if column is None else column
            pieces.append(column[max(first - begin, 0) : last - begin])
        return np.concatenate(pieces)


class _Lazy(BackendArray):
    """One column of `blocks`, as xarray wants what is on a disk."""

    def __init__(self, blocks: Blocks, name: str) -> None:
        self._blocks, self._name = blocks, name
        self.shape = (blocks.n,)
        self.dtype = np.dtype(np.float64)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._of)

    def _of(self, key: tuple[int | slice, ...]) -> Any:
        (which,) = key
        if isinstance(which, slice):
            numbers = range(*which.indices(self._blocks.n))
            if not numbers:
                return np.zeros(0)
            low, high = min(numbers), max(numbers) + 1
            return self._blocks.column(self._name, low, high)[np.asarray(numbers) - low]
        at = which % self._blocks.n
        return self._blocks.column(self._name, at, at + 1)[0]


def dataset(
    t_s: Column, blocks: Blocks, names: Mapping[str, Mapping[str, str]], about: Mapping[str, Any]
) -> xr.Dataset:
    """A dataset over "time" (s) with a variable for each of `names`, whose attributes are theirs."""
    variables = {
        name: xr.Variable("time", indexing.LazilyIndexedArray(_Lazy(blocks, name)), attributes)
        for name, attributes in names.items()
    }
    time = xr.Variable("time", t_s, {"units": "s", "long_name": "time since the first frame"})
    return xr.Dataset(variables, {"time": time}, dict(about))

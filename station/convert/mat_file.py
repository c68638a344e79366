"""A matrix in a MATLAB file (level 5, *MAT-File Format*), written by blocks of rows: it need not be in memory."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from station.rows import LogError

_INT8, _INT32, _UINT32, _DOUBLE, _MATRIX = 1, 5, 6, 9, 14
_CLASS_DOUBLE: Final = 6
_LARGEST: Final = 2**32 - 1
"""Bytes of an element: its length stands in 32 bits."""


class MatrixFile:
    """`name` (rows, columns) behind the other variables of a new file; rows are added from the first to the last."""

    def __init__(self, path: Path, others: Mapping[str, Any], name: str, rows: int, columns: int) -> None:
        """Raises OSError, and LogError for a matrix that is too large for the format."""
        self._rows, self._columns, self._done = rows, columns, 0
        self._there = np.zeros(columns, dtype=bool)
        size = rows * columns * 8
        label = name.encode("ascii")
        head = struct.pack("<4I", _UINT32, 8, _CLASS_DOUBLE, 0) + struct.pack("<2I2i", _INT32, 8, rows, columns)
        head += struct.pack("<2I", _INT8, len(label)) + label + bytes(-len(label) % 8)
        head += struct.pack("<2I", _DOUBLE, size)
        if len(head) + size > _LARGEST:
            raise LogError(
                f"{path}: {rows} rows are too many for a MATLAB file of level 5: export a part, or to parquet"
            )
        self._file = path.open("xb")
        try:
            savemat(self._file, dict(others))
            self._file.write(struct.pack("<2I", _MATRIX, len(head) + size) + head)
            self._first = self._file.tell()
            self._file.truncate(self._first + size)
        except BaseException:
            self._file.close()
            raise

    def add(self, block: NDArray[np.float64]) -> None:
        """Rows (n, columns); a column that is NaN throughout stays zero. Raises OSError."""
        there = self._there | ~np.isnan(block).all(axis=0)
        for column in np.flatnonzero(there & ~self._there).tolist():
            self._write(column, 0, np.full(self._done, np.nan))
        for column in np.flatnonzero(there).tolist():
            self._write(column, self._done, block[:, column])
        self._there = there
        self._done += len(block)

    def fill(self, column: int, value: float) -> None:
        """The whole of a column of which no row had a value. Raises OSError."""
        if not self._there[column]:
            self._write(column, 0, np.full(self._done, value))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        self._file.close()
        assert kind is not None or self._done == self._rows

    def _write(self, column: int, row: int, values: NDArray[np.float64]) -> None:
        self._file.seek(self._first + (column * self._rows + row) * 8)
        self._file.write(np.ascontiguousarray(values, dtype="<f8").tobytes())

"""Numbers out of a MATLAB file (*MAT-File Format*, MathWorks R2019b, chapter 1).

scipy's reader of level 5 believes the sizes that a file tells: a wrong one takes it beyond its memory, and what it
reads after that may be anything. Here each size is held against what is there before it is used. Level 4, which scipy
reads without code of its own, is left to it.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, whosmat

from station.rows import LogError

Numbers = NDArray[np.float64]
Value = Numbers | Mapping[str, Numbers | None] | None
"""An array of real numbers in its own shape, a structure by its fields, or None for all else."""

_HEAD: Final = 128
_TAG: Final = 8
"""Bytes of a tag; elements are filled up to a multiple of so many."""
_MATRIX, _COMPRESSED = 14, 15
_LETTERS: Final = (1, 2, 16)
_SIZES: Final = (5, 6)
"""Types that programs give to names, and to flags and sizes; the format has int8 and int32."""
_STORED: Final = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8", 16: "u1",
}  # fmt: skip
"""Types of data by their number."""
_STRUCT: Final = 2
_OPAQUE: Final = 17
"""A string, a table, a date: without dimensions, and what stands in it is not documented."""
_NUMERIC: Final = range(6, 16)
"""Classes of arrays: double to uint64."""
_COMPLEX: Final = 0x0800
_OLDEST_BYTES: Final = 4
"""A file of level 4 has a zero in one of the first, a later one text."""
_PEEPED: Final = 4096
"""Bytes of a compressed variable that hold its flags, its dimensions (32 at most) and its name (63 letters)."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One of a file, not read yet."""

    shape: tuple[int, ...]
    is_struct: bool
    read: Callable[[], Value]
    """Raises ValueError for damaged bytes, and for a structure of more than one element."""


def variables(path: Path) -> dict[str, Variable]:
    """By name. Raises LogError for what is no MATLAB file, and for one of version 7.3 (HDF5)."""
    try:
        data = path.read_bytes()
        if 0 in data[:_OLDEST_BYTES]:
            return {name: Variable(shape, False, partial(_oldest, path, name)) for name, shape, _ in whosmat(path)}
        if len(data) < _HEAD or data[126:128] not in (b"IM", b"MI"):
            raise ValueError("it does not begin as one")
        order = "<" if data[126:128] == b"IM" else ">"
        if struct.unpack_from(order + "H", data, 124)[0] >> 8 != 1:
            raise ValueError("it is of version 7.3 or none: save it with -v7")
        return dict(_level5(data, order))
    except Exception as error:  # scipy raises whatever a broken file makes of it
        raise LogError(f"{path}: not a MATLAB file that can be read: {error}") from error


def _oldest(path: Path, name: str) -> Value:
    try:
        found = loadmat(path, variable_names=[name])[name]
    except Exception as error:  # as in `variables`
        raise ValueError(str(error)) from error
    return np.asarray(found, dtype=np.float64) if found.dtype.kind in "fiu" else None


def _level5(data: bytes, order: str) -> Iterator[tuple[str, Variable]]:
    for kind, start, stop in _elements(data, _HEAD, len(data), order):
        if kind == _COMPRESSED:
            peeped = zlib.decompressobj().decompress(data[start:stop], _PEEPED)
            head, read = _Array(peeped, _TAG, len(peeped), order), partial(_inflated, data[start:stop], order)
        elif kind == _MATRIX:
            head, read = _Array(data, start, stop, order), partial(_value, data, start, stop, order)
        else:
            raise ValueError(f"at byte {start}: no variable, but data of type {kind}")
        if head.kind != _OPAQUE:
            yield head.name, Variable(head.shape, head.kind == _STRUCT, read)


def _inflated(packed: bytes, order: str) -> Value:
    unpacking = zlib.decompressobj()
    data = unpacking.decompress(packed)
    ((kind, start, stop),) = _elements(data, 0, len(data), order)
    if kind != _MATRIX or not unpacking.eof:
        raise ValueError("a compressed variable is cut off")
    return _value(data, start, stop, order)


def _value(data: bytes, start: int, stop: int, order: str) -> Value:
    array = _Array(data, start, stop, order)
    return array.fields() if array.kind == _STRUCT else array.numbers()


def _elements(data: bytes, at: int, end: int, order: str) -> Iterator[tuple[int, int, int]]:
    """Type of each from `at` to `end`, and where its bytes begin and end. Raises ValueError where one does not fit."""
    while at < end:
        if end - at < _TAG:
            raise ValueError(f"at byte {at}: {end - at} bytes are left over")
        kind, size = struct.unpack_from(order + "2I", data, at)
        start, left = at + _TAG, end - at - _TAG
        following = start + size + (0 if kind == _COMPRESSED else -size % _TAG)
        if kind >> 16:  # up to four bytes stand in the second half of the tag
            kind, size, start, left, following = kind & 0xFFFF, kind >> 16, at + 4, 4, at + _TAG
        if size > left:
            raise ValueError(f"at byte {at}: an element of {size} bytes where {left} are left")
        yield kind, start, start + size
        at = following


class _Array:
    """The array whose elements stand from `at` to `end`."""

    def __init__(self, data: bytes, at: int, end: int, order: str) -> None:
        """Raises ValueError."""
        self._data, self._order, self._end = data, order, end
        self._rest = _elements(data, at, end, order)
        flags = self._stored(_SIZES)
        if not len(flags):
            raise ValueError(f"at byte {at}: no array of MATLAB's")
        self.kind, self._is_complex = int(flags[0]) & 0xFF, bool(int(flags[0]) & _COMPLEX)
        self.shape, self.name = tuple[int, ...](), ""
        if self.kind == _OPAQUE:
            return
        sizes = self._stored(_SIZES)
        self.name = self._stored(_LETTERS).tobytes().decode("latin-1")
        if not len(sizes) or np.any(sizes < 0):
            raise ValueError(f"at byte {at}: no array of MATLAB's")
        self.shape = tuple(sizes.tolist())

    def numbers(self) -> Numbers | None:
        """None where it is no array of real numbers. Raises ValueError."""
        if self.kind not in _NUMERIC or self._is_complex:
            return None
        found = self._stored(tuple(_STORED))
        if len(found) != math.prod(self.shape):
            raise ValueError(f"{self.name or 'a field'} has {len(found)} numbers for a shape of {self.shape}")
        return found.astype(np.float64).reshape(self.shape, order="F")

    def fields(self) -> dict[str, Numbers | None]:
        """Of a structure. Raises ValueError for one of more elements than one, or none."""
        if math.prod(self.shape) != 1:
            raise ValueError(f"{self.name} is a structure of {math.prod(self.shape)} elements, not of one")
        (length,), letters = self._stored(_SIZES), self._stored(_LETTERS).tobytes()
        if length < 1 or len(letters) % length:
            raise ValueError(f"{self.name} has {len(letters)} letters for names of {length} each")
        names = [letters[k : k + length].split(b"\0")[0].decode("latin-1") for k in range(0, len(letters), length)]
        return {name: self._field() for name in names}

    def _field(self) -> Numbers | None:
        kind, start, stop = self._next()
        if kind != _MATRIX:
            raise ValueError(f"at byte {start}: no array in a field, but data of type {kind}")
        # An empty field may have no bytes at all.
        return _Array(self._data, start, stop, self._order).numbers() if stop > start else None

    def _stored(self, kinds: tuple[int, ...]) -> NDArray[Any]:
        kind, start, stop = self._next()
        if kind not in kinds:
            raise ValueError(f"at byte {start}: data of type {kind}, not of {', '.join(map(str, kinds))}")
        stored = np.dtype(self._order + _STORED[kind])
        if (stop - start) % stored.itemsize:
            raise ValueError(f"at byte {start}: {stop - start} bytes for numbers of {stored.itemsize}")
        return np.frombuffer(self._data, stored, (stop - start) // stored.itemsize, start)

    def _next(self) -> tuple[int, int, int]:
        found = next(self._rest, None)
        if found is None:
            raise ValueError(f"at byte {self._end}: it ends within a variable")
        return found

"""State and constants that compiled kernels share by name: a class of annotations, laid out as one structured element.

numba cannot change a scalar of a NamedTuple and takes 1 us to unpack each array of one at every call. One element of a
structured array is one pointer, whatever it holds, and its fields can change. Python keeps the array of one element and
hands it to the outermost kernel, which takes the element out of it; kernels within pass the element, or a part, on.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Element = NDArray[np.void]
"""A structured array of one element, (1,)."""
Vector = Annotated[Array, 3]


@cache
def layout(of: type) -> np.dtype[np.void]:
    """The structured type of a class: a field for each annotation, which is float, int, bool, `Annotated[Array, shape]`
    or another such class."""
    fields: list[tuple[Any, ...]] = []
    for name, kind in get_type_hints(of, include_extras=True).items():
        if get_origin(kind) is Annotated:
            fields.append((name, np.float64, get_args(kind)[1]))
        elif kind in (float, int, bool):
            fields.append((name, np.dtype(kind)))
        else:
            fields.append((name, layout(kind)))
    return np.dtype(fields, align=True)


def blank(of: type) -> Element:
    """All zero."""
    return np.zeros(1, layout(of))


def packed(values: tuple[Any, ...]) -> Element:
    """A NamedTuple of values, or of such NamedTuples."""
    element = blank(type(values))
    _fill(element, values)
    return element


def _fill(element: Element, values: tuple[Any, ...]) -> None:
    for name, value in zip(element.dtype.names or (), values, strict=True):
        if isinstance(value, tuple) and element.dtype[name].names:
            _fill(element[name], value)
        else:
            element[name] = value

"""Formulas over signals: read into a tree of known operations and worked out by it, never run as a program.

Numbers, names, + - * / **, parentheses and FUNCTIONS. A formula works out one instant's numbers, or whole columns.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0

Array = NDArray[np.float64]

LONGEST: Final = 300
"""Letters of a formula: deeper ones would exhaust the parser."""
CONSTANTS: Final[Mapping[str, float]] = {"pi": math.pi, "g0": G0}
"""Beside the numbers; g0 is standard gravity, m/s2."""
_ONE: Final[Mapping[str, tuple[Callable[..., Any], Callable[..., Any]]]] = {
    "abs": (abs, np.abs),
    "sqrt": (math.sqrt, np.sqrt),
    "exp": (math.exp, np.exp),
    "log": (math.log, np.log),
    "log10": (math.log10, np.log10),
    "sin": (math.sin, np.sin),
    "cos": (math.cos, np.cos),
    "tan": (math.tan, np.tan),
    "asin": (math.asin, np.arcsin),
    "acos": (math.acos, np.arccos),
    "atan": (math.atan, np.arctan),
    "tanh": (math.tanh, np.tanh),
}
_TWO: Final[Mapping[str, tuple[Callable[..., Any], Callable[..., Any]]]] = {
    "atan2": (math.atan2, np.arctan2),
    "hypot": (math.hypot, np.hypot),
    "min": (min, np.minimum),
    "max": (max, np.maximum),
}
FUNCTIONS: Final = (*_ONE, *_TWO)
"""What a formula may call: angles in rad, log to the base e."""
_OPERATORS: Final[Mapping[type[ast.operator], tuple[Callable[..., Any], Callable[..., Any]]]] = {
    ast.Add: (operator.add, np.add),
    ast.Sub: (operator.sub, np.subtract),
    ast.Mult: (operator.mul, np.multiply),
    ast.Div: (operator.truediv, np.divide),
    ast.Pow: (math.pow, np.power),
}
_ALLOWED: Final = f"numbers, signals, + - * / **, parentheses and {', '.join(FUNCTIONS)}"

Work = Callable[[Sequence[Any]], Any]
"""Values in a fixed order to the formula's."""


class FormulaError(ValueError):
    """What is wrong with a formula, in words."""


class Formula:
    """A formula that can be worked out; `names` are the signals in it, in the order in which they occur."""

    def __init__(self, text: str) -> None:
        """Raises FormulaError, also for one that divides by a constant zero."""
        if len(text) > LONGEST:
            raise FormulaError(f"the expression has more than {LONGEST} letters")
        try:
            tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise FormulaError(f"{text!r} is not an expression: write {_ALLOWED}") from None
        self.text = text
        self.names = tuple(dict.fromkeys(_names(tree)))
        self._tree = tree
        fixed = _constant(tree)
        if fixed is not None and not math.isfinite(fixed):
            raise FormulaError(f"{text!r} has no finite value")

    def numbers(self, places: Mapping[str, int]) -> Work:
        """What works it out of one instant's values, in which each name has its place. The result raises
        ArithmeticError or ValueError where it has no value."""
        return _work(self._tree, places, 0)

    def over(self, columns: Mapping[str, Array]) -> Array:
        """Of columns (n,) of its names; NaN where it has no value."""
        places = {name: i for i, name in enumerate(self.names)}
        given = [np.asarray(columns[name], dtype=np.float64) for name in self.names]
        with np.errstate(all="ignore"):
            made = np.asarray(_work(self._tree, places, 1)(given), dtype=np.float64)
        out = np.broadcast_to(made, np.broadcast_shapes(made.shape, *(c.shape for c in given))).copy()
        out[~np.isfinite(out)] = np.nan
        return out


def why_none(error: Exception) -> str:
    """In words, why a formula has no value now."""
    if isinstance(error, ZeroDivisionError):
        return "divides by zero"
    return "is too large a number" if isinstance(error, OverflowError) else "has no value here (a root, log, ...)"


def _names(node: ast.expr) -> list[str]:
    """Signals of a tree. Raises FormulaError for what is no part of a formula."""
    match node:
        case ast.Constant(value=bool() | str() | bytes() | complex() | None):
            raise FormulaError(f"{node.value!r} is no number: write {_ALLOWED}")
        case ast.Constant(value=int() | float()):
            _number(node)
            return []
        case ast.Name(id=name):
            if name in FUNCTIONS:
                raise FormulaError(f"{name} is a function: write {name}(...)")
            return [] if name in CONSTANTS else [name]
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=inner):
            return _names(inner)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return [*_names(left), *_names(right)]
        case ast.Call(func=ast.Name(id=name), args=given, keywords=[]):
            if name not in FUNCTIONS:
                raise FormulaError(f"unknown function {name}: known are {', '.join(FUNCTIONS)}")
            wanted = 1 if name in _ONE else 2
            if len(given) != wanted:
                raise FormulaError(f"{name} takes {wanted} value{'s'[: wanted - 1]}, not {len(given)}")
            return [name for one in given for name in _names(one)]
    raise FormulaError(f"{ast.unparse(node)!r} is no part of an expression: write {_ALLOWED}")


def _number(node: ast.Constant) -> float:
    try:
        return float(node.value)  # type: ignore[arg-type]
    except OverflowError:
        raise FormulaError("a number in it is too large") from None


def _constant(node: ast.expr) -> float | None:
    """The value of a tree without signals; None of one with. Raises FormulaError where some part has none."""
    parts = {ast.BinOp: ("left", "right"), ast.UnaryOp: ("operand",)}.get(type(node), ())
    below = [_constant(getattr(node, part)) for part in parts]
    if isinstance(node, ast.Call):
        below = [_constant(one) for one in node.args]
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div) and below[1] == 0:
        raise FormulaError(f"{ast.unparse(node)!r} divides by zero")
    if any(value is None for value in below) or (isinstance(node, ast.Name) and node.id not in CONSTANTS):
        return None
    try:
        return float(_work(node, {}, 0)(()))
    except (ArithmeticError, ValueError) as error:
        raise FormulaError(f"{ast.unparse(node)!r} {why_none(error)}") from None


def _work(node: ast.expr, places: Mapping[str, int], kind: int) -> Work:
    """`kind` 0 of numbers, 1 of columns."""
    match node:
        case ast.Constant():
            number = _number(node)
            return lambda _: number
        case ast.Name(id=name):
            if name in CONSTANTS:
                fixed = CONSTANTS[name]
                return lambda _: fixed
            return operator.itemgetter(places[name])
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            turned = _work(inner, places, kind)
            return lambda v: -turned(v)
        case ast.UnaryOp(operand=inner):
            return _work(inner, places, kind)
        case ast.BinOp(left=left, op=op, right=right):
            both, one, other = _OPERATORS[type(op)][kind], _work(left, places, kind), _work(right, places, kind)
            return lambda v: both(one(v), other(v))
        case ast.Call(func=ast.Name(id=name), args=[only]):
            apply, inside = _ONE[name][kind], _work(only, places, kind)
            return lambda v: apply(inside(v))
        case ast.Call(func=ast.Name(id=name), args=[first, second]):
            join, a, b = _TWO[name][kind], _work(first, places, kind), _work(second, places, kind)
            return lambda v: join(a(v), b(v))
    raise AssertionError(ast.dump(node))  # _names refused it

"""What the bits of estimates hang on beside the rows: the station's own code; in the last of them the processor and
the libraries of numerics.

Products and solutions are summed in one order (station/numerics/products.py), but numpy's own functions and the
system's exponentials and sines have kernels for each kind of processor. The same rows give the same bits on one kind of
machine with the same libraries.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Final

from station.sources import sources

LIBRARIES: Final = ("numpy", "scipy", "numba", "llvmlite")
PRODUCTS: Final = "fixed order"
"""Who sums products of matrices: since then station.numerics.products, before OpenBLAS by the processor's kind."""
SWITCHES: Final = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES", "NUMBA_CPU_NAME")
"""Variables of the environment that choose kernels."""


@cache
def arithmetic() -> Mapping[str, str]:
    """Of this machine, as a recording's metadata `arithmetic` keeps it."""
    found = {"station": sources(), "processor": processor(), "python": platform.python_version(), "products": PRODUCTS}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "missing"
    return found | {name: value for name in SWITCHES if (value := os.environ.get(name))}


def processor() -> str:
    """Its name and, where the system tells them, the numbers of its kind: names are shared by generations."""
    try:
        told = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        told = ""
    name = re.search(r"^model name\s*:\s*(.+)$", told, re.M)
    kinds = re.findall(r"^(cpu family|model|CPU implementer|CPU part)\s*:\s*(\w+)$", told, re.M)
    numbers = ", ".join(f"{key} {value}" for key, value in dict(reversed(kinds)).items())
    named = name[1].strip() if name else platform.processor() or "unknown"
    return f"{platform.machine()} {named}" + (f" ({numbers})" if numbers else "")


def unlike(recorded: Mapping[str, str], here: Mapping[str, str]) -> str:
    """In what a recording's machine differs from this one, in words; "" where it does in nothing."""
    if not recorded:
        return "which one, this recording does not say"
    names = [name for name in {**here, **recorded} if recorded.get(name) != here.get(name)]
    return "; ".join(f"{name} {recorded.get(name, 'unset')} recorded, {here.get(name, 'unset')} here" for name in names)

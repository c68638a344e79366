"""The licences of what the station brings along, as its packages state them."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from pathlib import Path
from typing import Final

from markdown_table import markdown

ROOT: Final = Path(__file__).parents[2]
LONGEST: Final = 60
FAMILIES: Final = {
    "LGPL": ("LGPL", "Lesser General Public"),
    "MIT": ("MIT",),
    "BSD": ("BSD",),
    "Apache 2.0": ("Apache",),
    "PSF": ("Python Software Foundation", "PSF"),
}


def direct() -> list[str]:
    """Names of the packages that the station and its extras ask for."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"], *(d for more in project["optional-dependencies"].values() for d in more)]
    return sorted(re.split(r"[^\w.-]", one)[0] for one in asked)


def brought() -> set[str]:
    """Those and all that they bring along here."""
    found, left = set[str](), direct()
    while left:
        name = re.sub(r"[-_.]+", "-", left.pop()).lower()
        try:
            needs = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            continue  # for another system or Python
        if name not in found:
            found.add(name)
            left += [re.split(r"[^\w.-]", one)[0] for one in needs if "extra ==" not in one]
    return found


def licence(name: str) -> str:
    """An SPDX expression, or the words of a classifier; "" where a package states none."""
    about = importlib.metadata.metadata(name)
    if expression := about.get("License-Expression"):
        return str(expression)
    words = [c.rpartition(" :: ")[2] for c in about.get_all("Classifier") or [] if c.startswith("License ::")]
    stated = (about.get("License") or "").strip()
    return ", ".join(words) or (stated if len(stated) <= LONGEST else "")


def family(stated: str) -> str:
    """Of what is stated, which releases word differently: LGPL, MIT, ..."""
    return ", ".join(name for name, words in FAMILIES.items() if any(word in stated for word in words)) or stated


def licences() -> str:
    packages: dict[str, list[str]] = {}
    for name in direct():
        packages.setdefault(family(licence(name)), []).append(f"`{name}`")
    return markdown(("licence", "packages"), [(kind, ", ".join(of)) for kind, of in sorted(packages.items())])

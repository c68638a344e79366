"""The rules of station/README.md that a linter has no word for: names, sizes, first sentences, links, and paths."""

from __future__ import annotations

import ast
import platform
import re
import subprocess
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
LINES_OF_A_MODULE: Final = 400
LINES_OF_A_FUNCTION: Final = 80
ARGUMENTS: Final = 8
LINES_OF_README: Final = 150

OPTIONS: Final = "options of a verb or of the estimator, one argument each"
EXEMPT: Final = {
    "station/commands/rig_.py:rig_": OPTIONS,
    "station/commands/identify.py:identify": OPTIONS,
    "station/commands/run.py:run": OPTIONS,
    "station/estimation/methods.py:__init__": OPTIONS,
}
"""Modules above 400 lines, and functions above 80 lines or with more than 8 arguments, each with its reason."""


@cache
def modules() -> dict[str, ast.Module]:
    """Syntax tree of every module of the station and its drivers, by path."""
    paths = sorted(p for wing in ("station", "drivers") for p in (ROOT / wing).rglob("*.py"))
    return {p.relative_to(ROOT).as_posix(): ast.parse(p.read_text()) for p in paths}


@cache
def tracked() -> tuple[Path, ...]:
    """Every file of the project, as git has it."""
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("no git checkout: its files are not listed")
    return tuple(ROOT / name for name in done.stdout.split("\0") if name and (ROOT / name).is_file())


def too_large() -> set[str]:
    """Modules and functions above their limits, as EXEMPT names them."""
    found = set()
    for path, tree in modules().items():
        if len((ROOT / path).read_text().splitlines()) > LINES_OF_A_MODULE:
            found.add(path)
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            a = node.args
            arguments = [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs) if x.arg not in ("self", "cls")]
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if lines > LINES_OF_A_FUNCTION or len(arguments) > ARGUMENTS:
                found.add(f"{path}:{node.name}")
    return found


def test_modules_and_functions_keep_their_size_or_say_why() -> None:
    assert too_large() - EXEMPT.keys() == set()


def test_nothing_is_exempt_that_need_not_be() -> None:
    assert EXEMPT.keys() - too_large() == set()


def test_no_two_modules_have_one_name() -> None:
    stems = Counter(Path(path).stem for path in modules())
    assert [name for name, n in stems.items() if n > 1 and name not in ("__init__", "__main__")] == []


@pytest.mark.parametrize("path", modules())
def test_a_module_opens_with_one_sentence(path: str) -> None:
    first = (ast.get_docstring(modules()[path]) or "").split("\n\n")[0]
    assert first.endswith((".", ":")), first


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < LINES_OF_README


@pytest.mark.parametrize("folder", ["station/estimation", "station/diagnosis", "station", "profiles", "logs", "tests"])
def test_a_folder_has_its_readme(folder: str) -> None:
    assert (ROOT / folder / "README.md").is_file()


def anchors(text: str) -> set[str]:
    """Anchors that GitHub gives the headings of a page."""
    kept = (re.sub(r"[^\w\- ]", "", line.lstrip("#").strip().lower()) for line in text.splitlines() if line[:1] == "#")
    return {name.replace(" ", "-") for name in kept}


def test_links_lead_somewhere() -> None:
    broken = []
    for page in (p for p in tracked() if p.suffix == ".md"):
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
            if re.match(r"[a-z]+:", target):
                continue
            path, _, anchor = target.partition("#")
            aim = page.parent / path if path else page
            if not aim.exists() or (anchor and anchor not in anchors(aim.read_text())):
                broken.append(f"{page.relative_to(ROOT)}: {target}")
    assert broken == []


def test_no_file_names_the_machine_it_was_written_on() -> None:
    """Absolute paths of a home or of this checkout, and this machine's name."""
    words = [r"/(?:home|Users)/\w+"] + [re.escape(f"{Path.home()}/")] * (len(Path.home().parts) > 1)
    words += [re.escape(str(ROOT))] * (len(ROOT.parts) > 2) + [re.escape(platform.node())] * (len(platform.node()) > 8)
    named = re.compile("|".join(words))
    found = []
    for path in tracked():
        if path == Path(__file__).resolve() or path.suffix in (".png", ".bin", ".mcap"):
            continue
        if match := named.search(path.read_text(encoding="utf-8", errors="replace")):
            found.append(f"{path.relative_to(ROOT)}: {match[0]}")
    assert found == []


def test_pages_that_code_refers_to_are_in_the_project() -> None:
    """A docstring that names a page names one that its reader has."""
    missing = []
    for path in (p for p in tracked() if p.suffix in (".py", ".toml") and p != Path(__file__).resolve()):
        for name in re.findall(r"[\w/]+\.md\b", path.read_text()):
            if not any(str(p.relative_to(ROOT)).endswith(name) for p in tracked()):
                missing.append(f"{path.relative_to(ROOT)}: {name}")
    assert missing == []

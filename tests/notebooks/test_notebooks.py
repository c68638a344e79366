"""The notebooks run from their first cell to their last, and show what they say; a log that is cut is said to be."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parent
LIMIT_S = 300


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What each cell showed, by the beginning of its source."""
    monkeypatch.setenv("IPYTHONDIR", str(folder / "ipython"))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")
    book = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    assert all(not cell.get("outputs") for cell in book.cells), "kept without its outputs"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the kernel's own libraries
        NotebookClient(book, timeout=LIMIT_S, resources={"metadata": {"path": str(folder)}}).execute()
    return {cell.source: cell.outputs for cell in book.cells if cell.cell_type == "code"}


def shown(outputs: dict[str, Any], begins: str, kind: str = "text/html") -> str:
    (found,) = [made for source, made in outputs.items() if source.startswith(begins)]
    return "".join(o.get("text", "") or o.get("data", {}).get(kind, "") for o in found)


def test_the_cells_of_your_csv_to_derivatives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a kernel, whose start takes as long as the notebook: that everything it names is there, and works."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for cell in nbformat.read(FOLDER / "csv_to_derivatives.ipynb", as_version=4).cells:
        if cell.cell_type == "code":
            exec(compile(cell.source, "csv_to_derivatives.ipynb", "exec"), names)
    assert names["found"].recommended == "split"
    assert names["found"].derivatives.loc["Cm_de", "status"] == "estimated"


@pytest.mark.slow
def test_your_csv_to_derivatives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outputs = run("csv_to_derivatives", tmp_path, monkeypatch)
    assert "line 1, column 3: q: unit that does not fit: 'deg'" in shown(outputs, "mine.rename")
    assert "<b>twin_otter, 5.00 to 55.00 s" in shown(outputs, "found = ")
    assert "estimated" in shown(outputs, 'found.json()["methods"]', "text/plain")


@pytest.mark.slow
def test_first_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outputs = run("first_flight", tmp_path, monkeypatch)
    assert "positive: nose up" in shown(outputs, "vane = ")
    assert "recommended: physical" in shown(outputs, "found = ")
    assert shown(outputs, "found.plot", "image/png")


@pytest.mark.slow
def test_hidden_effect_to_a_written_profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outputs = run("hidden_effect", tmp_path, monkeypatch)
    assert "q.scale" in shown(outputs, "result = ")
    found = re.search(r"gain=([\d.]+)", shown(outputs, "print(result.write_profile"))
    assert found is not None
    assert abs(float(found[1]) - 1.04) < 0.005  # the 95 % interval of such a flight is 0.002 to either side
    assert "no effect found" in shown(outputs, "again = ")

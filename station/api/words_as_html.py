"""Pieces of HTML and pictures that results are made of in a notebook."""

from __future__ import annotations

import html
import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def facts(rows: Mapping[str, str]) -> str:
    """A table of a name and a value each."""
    left = "style='text-align:left'"
    cells = (f"<tr><th {left}>{html.escape(k)}</th><td {left}>{html.escape(v)}</td></tr>" for k, v in rows.items())
    return f"<table>{''.join(cells)}</table>"


def lines(words: Iterable[str]) -> str:
    """A list of sentences; nothing where there are none."""
    items = "".join(f"<li>{html.escape(w)}</li>" for w in words)
    return f"<ul>{items}</ul>" if items else ""


def heading(words: str) -> str:
    """The answer in a sentence."""
    return f"<p><b>{html.escape(words)}</b></p>"


class Picture:
    """A figure that a notebook shows; `figure` is matplotlib's."""

    def __init__(self, figure: Figure) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        FigureCanvasAgg(figure)
        self.figure = figure

    def savefig(self, path: Path | str) -> None:
        """Write it to a file: .png, .pdf or .svg."""
        self.figure.savefig(path)

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.figure.savefig(buffer, format="png")
        return buffer.getvalue()

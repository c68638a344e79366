"""The frame of a report: one HTML file, self-contained, its figures inside."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from station.rows import LogError

INK: Final = "#1f2430"
FAINT: Final = "#a9b0bd"
ORANGE: Final = "#d55e00"
BLUE: Final = "#0072b2"
_STYLE: Final = """
body{font:15px/1.5 system-ui,sans-serif;color:#1f2430;max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}p.verdict{font-size:1.15rem;font-weight:600}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}
th,td{padding:.2rem .6rem;text-align:right;border-bottom:1px solid #e3e6eb;vertical-align:top}
th:first-child,td:first-child,.words{text-align:left}td:not(.words){white-space:nowrap}
.faint{color:#8a92a0}.chosen td{font-weight:600}img{max-width:100%}p.note{color:#5a6270;font-size:.9rem}
"""


def text(value: object) -> str:
    """Escaped for HTML."""
    return html.escape(str(value))


def image(figure: Figure, says: str) -> str:
    """The figure as an element of the page."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return f'<img alt="{text(says)}" src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'


def write_page(title: str, body: Sequence[str], path: Path) -> Path:
    """A page of these pieces of HTML; returns its path. Raises LogError if it cannot be written."""
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{text(title)}</title>'
        f"<style>{_STYLE}</style>{''.join(body)}</html>\n"
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error
    return path

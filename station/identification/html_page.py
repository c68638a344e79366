"""The frame of a report: one HTML file, self-contained, its figures inside."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes as Panel
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from station.rows import LogError

INK: Final = "#1f2430"
FAINT: Final = "#a9b0bd"
ORANGE: Final = "#d55e00"
BLUE: Final = "#0072b2"
_STYLE: Final = """
:root{color-scheme:light dark;--ink:#1f2430;--paper:#fff;--note:#5a6270;--faint:#767e8c;--rule:#e3e6eb}
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--paper);max-width:60rem;margin:1.5rem auto;
padding:0 1rem}
h1{font-size:1.5rem;margin:0 0 .5rem}h2{font-size:1.15rem;margin-top:2rem}
p.verdict{font-size:1.15rem;font-weight:600;margin:.5rem 0 1rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}
th,td{padding:.2rem .6rem;text-align:right;border-bottom:1px solid var(--rule);vertical-align:top}
th:first-child,td:first-child,.words{text-align:left}td:not(.words){white-space:nowrap}
.faint{color:var(--faint)}.chosen td{font-weight:600}img{max-width:100%}p.note{color:var(--note);font-size:.9rem}
.wide{overflow-x:auto}
@media screen and (prefers-color-scheme:dark){
:root{--ink:#dfe3ea;--paper:#1a1a1a;--note:#a6aebb;--faint:#8d95a3;--rule:#3a3f47}
img{filter:invert(.9) hue-rotate(180deg)}}
@page{size:A4;margin:14mm 12mm 16mm}
@media print{
:root{color-scheme:light;font-size:9.5pt}body{font-size:1rem;max-width:none;margin:0;padding:0}
h1,h2,summary{break-after:avoid}img,tr,li,p{break-inside:avoid}p{orphans:3;widows:3}thead{display:table-header-group}
img{display:block;max-height:235mm;object-fit:contain;object-position:left}
table{font-size:7.5pt;break-inside:avoid}th,td{padding:.12rem .3rem}.wide td:not(.words){white-space:normal}
.wide{overflow:visible}details::details-content{content-visibility:visible;height:auto}}
"""
"""Pictures are drawn on white; the dark page is of the grey that their inversion makes of it, colours kept."""


def text(value: object) -> str:
    """Escaped for HTML."""
    return html.escape(str(value))


def image(figure: Figure, says: str) -> str:
    """The figure as an element of the page."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return f'<img alt="{text(says)}" src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'


def without_frame(panel: Panel, *sides: str) -> None:
    for side in sides:
        panel.spines[side].set_visible(False)


def write_page(title: str, body: Sequence[str], path: Path) -> Path:
    """A page of these pieces of HTML; returns its path. Raises LogError if it cannot be written."""
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width"><title>{text(title)}</title>'
        f"<style>{_STYLE}</style>{''.join(body)}</html>\n"
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error
    return path

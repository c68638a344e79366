"""Pieces of HTML that results are made of in a notebook."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from station.identification.html_page import text


def facts(rows: Mapping[str, str]) -> str:
    """A table of a name and a value each."""
    cells = (f"<tr><th style='text-align:left'>{text(k)}</th><td style='text-align:left'>{text(v)}</td></tr>"
             for k, v in rows.items())  # fmt: skip
    return f"<table>{''.join(cells)}</table>"


def lines(words: Iterable[str]) -> str:
    """A list of sentences; nothing where there are none."""
    items = "".join(f"<li>{text(w)}</li>" for w in words)
    return f"<ul>{items}</ul>" if items else ""


def heading(words: str) -> str:
    """The answer in a sentence."""
    return f"<p><b>{text(words)}</b></p>"

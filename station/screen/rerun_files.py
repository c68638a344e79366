"""Rerun's own files: a flight with the page's layout, and a report's words and series."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from station.rows import LogError, Rows
from station.screen import plots
from station.screen.rerun_feed import setup_for
from station.screen.rerun_layout import TIMELINE, entity, layout
from station.screen.rerun_page import Page

if TYPE_CHECKING:
    from station.profile import Profiles

BATCH_NS: Final = 5_000_000_000
"""The words of a file's first screen change so often."""

FloatArray = NDArray[np.float64]


def write_rrd(rows: Iterable[Rows], path: Path | str, profiles: Profiles | None = None, title: str = "station") -> None:
    """Write rows, in time order, as a Rerun recording with the page's layout. Raises LogError.

    Derivatives are thinned to two points a second; the recording proper is the MCAP log. Nothing is overwritten.
    """
    import rerun as rr

    try:
        Path(path).touch(exist_ok=False)
    except FileExistsError:
        raise LogError(f"{path}: exists already and is not overwritten") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error
    setup = setup_for(profiles, title=title)
    recording = rr.RecordingStream("station")
    page = Page(recording, setup, is_live=False)
    try:
        recording.save(path, default_blueprint=layout(page.shown))
    except (OSError, RuntimeError) as error:
        raise LogError(f"{path}: cannot be written: {error}") from error
    start_ns: int | None = None
    for _, taken in itertools.groupby(rows, key=lambda row: row.t_ns // BATCH_NS):
        some = list(taken)
        if start_ns is None:
            start_ns = plots.start_of(some)
        page.show(plots.batch(some, start_ns or 0))
    page.flush()
    recording.flush()
    recording.disconnect()


_OF_REPORT: Final = {"before": (0, 114, 178), "after": (213, 94, 0), "measured": (128, 134, 148)}
"""Colours of lines, as on the report's page."""


def write_report_rrd(
    page: str, series: Mapping[str, Mapping[str, tuple[FloatArray, FloatArray]]], path: Path | str, title: str
) -> None:
    """Write a report's words (Markdown) and its series over time as a Rerun recording. Raises LogError.

    `series`: by plot, by line: times (s) and values (n,).
    """
    import rerun as rr
    import rerun.blueprint as rrb

    plots_shown = [rrb.TimeSeriesView(origin=entity(("plots", plot)), name=plot) for plot in series]
    recording = rr.RecordingStream("station report")
    blueprint = rrb.Blueprint(
        rrb.Horizontal(
            rrb.TextDocumentView(origin="words", name=title), rrb.Grid(*plots_shown, grid_columns=1),
            column_shares=[2, 3],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        collapse_panels=True,
    )  # fmt: skip
    try:
        recording.save(path, default_blueprint=blueprint)
    except (OSError, RuntimeError) as error:
        raise LogError(f"{path}: cannot be written: {error}") from error
    recording.send_recording_name(title)
    recording.log("words", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN), static=True)
    for plot, lines in series.items():
        for name, (t_s, values) in lines.items():
            where = entity(("plots", plot, name))
            colour = _OF_REPORT.get(name)
            recording.log(where, rr.SeriesLines(names=name, colors=None if colour is None else [colour]), static=True)
            times = rr.TimeColumn(TIMELINE, duration=(np.asarray(t_s) * 1e9).astype("timedelta64[ns]"))
            recording.send_columns(where, indexes=[times], columns=rr.Scalars.columns(scalars=values))
    recording.flush()
    recording.disconnect()

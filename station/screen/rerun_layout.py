"""Where the page shows what: its tabs and views, over the entities that rerun_page.py fills."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from station.screen import lateral_plots, live_spectra, plots, signal_plots, simulation_beside
from station.screen.answer_tiles import HEIGHT, WIDTH
from station.screen.drawings import HIGH, WIDE
from station.screen.ground_track import SIDE
from station.screen.plots import Plot, Setup

if TYPE_CHECKING:
    import rerun.blueprint as rrb

Span = tuple[float, float]

TIMELINE: Final = "station_time"
ANSWERS: Final = "answers"
WORDS: Final = "words"
STEP: Final = "step"
POINTS: Final = "points"
TRACK: Final = "track"
ATTITUDE: Final = "attitude"
SPECTRA: Final = "spectra"
MODEL: Final = "model"
AWAITED: Final = {
    SPECTRA: "spectra after half a minute of valid alpha without a gap",
    MODEL: "simulated after the first 20 s",
    TRACK: "no position yet",
}
"""What drawings say before they are drawn."""
EVENTS: Final = "events"
ALARMS, INFORMATIONS = f"{EVENTS}/alarms", f"{EVENTS}/informations"
KEY: Final = "key"
GROUND: Final = (13, 16, 17)
"""The viewer's own background."""
LEGEND_SHARE: Final = 0.3
"""Of a window's length, the empty time at the right end of its axis, which the legend stands in."""


@dataclass(frozen=True, slots=True)
class Shown:
    """What a layout shows."""

    setup: Setup
    derivatives: tuple[Plot, ...]
    links: tuple[Plot, ...]
    drag: tuple[Plot, ...] = ()
    """Where the flight is held against a baseline that has it."""


def entity(parts: plots.Path) -> str:
    import rerun as rr

    return rr.new_entity_path(list(parts))


def layout(shown: Shown) -> rrb.Blueprint:
    """The three answers first; what they rest on, tab by tab."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        rrb.Tabs(
            _now(shown),
            _flight(),
            _derivatives(shown),
            *_model(shown.setup),
            *_lateral(shown.setup),
            *_signals(shown.setup),
            _air(),
            _spectra(),
            _map(),
            _document(POINTS, "Test points"),
            rrb.Grid(*(_view(plot) for plot in shown.links), grid_columns=2, name="Links"),
            active_tab=0,
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_views=False,
        auto_layout=False,
    )


def _now(shown: Shown) -> rrb.Vertical:
    """The three answers; below them alpha, the input, the derivatives and the events."""
    import rerun.blueprint as rrb

    below = (
        _drawing(STEP, "Input: drawn blue, flown yellow", (0, WIDE), (0, HIGH))
        if shown.setup.has_steps
        else _view(plots.CONTROLS)
    )
    events = rrb.Horizontal(_event_log(ALARMS, "Alarms and warnings"), _event_log(INFORMATIONS, "Informations"))
    return rrb.Vertical(
        _drawing(ANSWERS, "Answers", (0, WIDTH), (0, HEIGHT), titlebar=False),
        rrb.Horizontal(
            rrb.Vertical(_view(plots.ALPHA), below, row_shares=[3, 2]),
            rrb.Vertical(_document(WORDS, "Step and derivatives"), events, row_shares=[3, 1.3]),
            column_shares=[1, 1],
        ),
        row_shares=[1, 5],
        name="Now",
    )


def _flight() -> rrb.Vertical:
    import rerun.blueprint as rrb

    return rrb.Vertical(
        _view(plots.ALPHA),
        rrb.Horizontal(_view(plots.CORRECTIONS), _view(plots.GUST)),
        rrb.Horizontal(_view(plots.CONTROLS), _view(plots.AIRSPEED)),
        rrb.StateTimelineView(origin="state", name="State"),
        row_shares=[2, 1.6, 1.6, 1],
        name="Flight",
    )


def _derivatives(shown: Shown) -> rrb.Vertical:
    """The recommended method with its band; the others faint, their bands for whoever shows them."""
    import rerun.blueprint as rrb

    return rrb.Vertical(
        rrb.Grid(*(_view(plot) for plot in (*shown.derivatives, *shown.drag)), grid_columns=3),
        _drawing(KEY, "Lines", (0, WIDE), (-15, 40), titlebar=False),
        row_shares=[9, 1],
        name="Derivatives",
    )


def _model(setup: Setup) -> list[rrb.Vertical]:
    """The aircraft simulated from what was measured, over it; nothing where no profile is known."""
    import rerun.blueprint as rrb

    if not setup.simulated:
        return []
    return [
        rrb.Vertical(
            _drawing(MODEL, "Model against measured", (-90, WIDE + 20), (-95, simulation_beside.HIGH + 30)),
            rrb.StateTimelineView(origin="state", contents=["state/model", "state/test_point"], name="Over the flight"),
            row_shares=[5, 1],
            name="Model",
        )
    ]


def _lateral(setup: Setup) -> list[rrb.Vertical]:
    """What was flown above, the derivatives below; nothing where the card does not ask for them."""
    import rerun.blueprint as rrb

    if not setup.lateral_methods:
        return []
    motion = (lateral_plots.SURFACES, lateral_plots.RATES, lateral_plots.SIDESLIP)
    views = [_view(plot, only=seen, name=name) for name, plot, seen in lateral_plots.views(setup)]
    *others, believed = setup.lateral_methods
    return [
        rrb.Vertical(
            rrb.Horizontal(*(_view(plot) for plot in motion)),
            rrb.Grid(*views, grid_columns=5),
            row_shares=[1, 3],
            name=f"Lateral ({believed} bold, {', '.join(others)} thin, profile grey)",
        )
    ]


def _signals(setup: Setup) -> list[rrb.Grid]:
    """What the rig declares or derives; nothing where it does not."""
    import rerun.blueprint as rrb

    drawn = signal_plots.drawn(setup)
    return [rrb.Grid(*map(_view, drawn), grid_columns=2, name="Signals")] if drawn else []


def _air() -> rrb.Vertical:
    """The last two minutes of gust and wind, and turbulence with its classes over the whole flight."""
    import rerun.blueprint as rrb

    return rrb.Vertical(
        rrb.Horizontal(_view(plots.GUST_SPEED), _view(plots.WIND)),
        _view(plots.TURBULENCE, whole=True, name=f"{plots.TURBULENCE.name}: {plots.CLASS_WORDS}"),
        rrb.StateTimelineView(
            origin="state", contents=["state/turbulence", "state/test_point"], name="Class, test point"
        ),
        row_shares=[2, 2, 1],
        name="Air",
    )


def _spectra() -> rrb.Spatial2DView:
    return _drawing(SPECTRA, "Spectra", (-80, WIDE + 120), (-40, live_spectra.HIGH + 40))


def _map() -> rrb.Horizontal:
    import rerun.blueprint as rrb

    behind = rrb.EyeControls3D(position=(-20.0, -4.0, -6.0), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, -1.0))
    return rrb.Horizontal(
        _drawing(TRACK, "Ground track, north up; test points coloured; wind barbs", (0, SIDE), (0, SIDE)),
        rrb.Spatial3DView(
            origin=ATTITUDE, name="Attitude, from behind; grid level", background=GROUND, eye_controls=behind
        ),
        column_shares=[3, 2],
        name="Map and attitude",
    )


def _drawing(origin: str, name: str, x: Span, y: Span, *, titlebar: bool = True) -> rrb.Spatial2DView:
    """`x`, `y`: what of the drawing is seen, in its own units."""
    import rerun.blueprint as rrb

    seen = rrb.VisualBounds2D(x_range=x, y_range=y)
    return rrb.Spatial2DView(origin=origin, name=name, background=GROUND, titlebar=titlebar, visual_bounds=seen)


def _document(origin: str, name: str) -> rrb.TextDocumentView:
    import rerun.blueprint as rrb

    return rrb.TextDocumentView(origin=origin, name=name)


def _event_log(origin: str, name: str) -> rrb.TextLogView:
    import rerun.blueprint as rrb
    from rerun.blueprint.encodings import TextLogColumn

    kept = [TextLogColumn(kind, visible=True) for kind in ("body",)]
    return rrb.TextLogView(origin=origin, name=name, columns=rrb.TextLogColumns(text_log_columns=kept))


def _view(
    plot: Plot, *, only: list[bool] | None = None, name: str | None = None, whole: bool = False
) -> rrb.TimeSeriesView:
    """`only`: which lines; `whole`: of the whole flight, however short the plot's own window."""
    import rerun as rr
    import rerun.blueprint as rrb

    now = rrb.TimeRangeBoundary.cursor_relative(seconds=0)
    begin = rrb.TimeRangeBoundary.infinite()
    axis = None
    legend = plot.legend and not whole
    if plot.window_s is not None and not whole:
        begin = rrb.TimeRangeBoundary.cursor_relative(seconds=-plot.window_s)
        room = rrb.TimeRangeBoundary.cursor_relative(seconds=LEGEND_SHARE * plot.window_s if legend else 0)
        axis = rrb.TimeAxis(view_range=rr.TimeRange(start=begin, end=room))
    fixed = None if plot.low is None or plot.high is None else rr.encodings.Range1D([plot.low, plot.high])
    where = entity(plot.path)
    return rrb.TimeSeriesView(
        origin=where,
        overrides={where: rr.SeriesLines(visible_series=only)} if only else None,
        name=name or plot.name,
        axis_x=axis,
        axis_y=rrb.ScalarAxis(range=fixed) if fixed else None,
        plot_legend=rrb.PlotLegend("RightTop", visible=legend),
        time_ranges=[rrb.VisibleTimeRange(TIMELINE, start=begin, end=now)],
    )

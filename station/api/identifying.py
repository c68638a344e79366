"""Derivatives of a recording, as `station identify` finds them, in a result that tabulates and plots itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from station.api.flown_recording import Recording
from station.api.page_printing import check_printable, print_page
from station.api.words_as_html import Picture, heading, lines
from station.log import Point, metadata, points, table
from station.profile import Aircraft, load_aircraft
from station.rows import UsageError

if TYPE_CHECKING:
    import pandas as pd

    from station.identification.identified import Identification

CI95: Final = 1.96
NEARBY_S: Final = 300.0
"""Of the recording before and after an interval that is read with it: filters settle on 30 s of it
(identification.flown.LEAD_S), and the vane's spectra, of method IV, average over what is read."""


@dataclass(frozen=True, slots=True)
class Identified:
    """Derivatives of one interval by every method. `found` has all that was found, of which this shows a part."""

    found: Identification

    @property
    def recommended(self) -> str | None:
        """The method to go by."""
        return self.found.recommended

    @property
    def remarks(self) -> tuple[str, ...]:
        """What its user should know of the record and of the estimates."""
        hint = (self.found.hint,) if self.found.hint else ()
        return (*hint, *self.found.remarks)

    @property
    def estimates(self) -> pd.DataFrame:
        """A row for each method and derivative: `estimate`, `std_error`, 95 % interval `low` to `high` (1/rad),
        `status` and `why`."""
        import pandas as pd

        rows = [
            (m, p.name, p.value, p.sd, p.value - CI95 * p.sd, p.value + CI95 * p.sd, str(p.status), p.why)
            for m, made in self.found.methods.items()
            for p in made.parameters
        ]
        names = ["method", "derivative", "estimate", "std_error", "low", "high", "status", "why"]
        return pd.DataFrame(rows, columns=names).set_index(["method", "derivative"])

    @property
    def derivatives(self) -> pd.DataFrame:
        """The recommended method's estimates, a row a derivative; empty where none is recommended."""
        every = self.estimates
        mine = every.index.get_level_values("method") == self.recommended
        return every[mine].droplevel("method")

    def json(self) -> dict[str, Any]:
        """As `identify --json` writes it."""
        from station.identification.identification_json import as_json

        return as_json(self.found)

    def plot(self, lateral: bool = False) -> Picture:
        """One panel a derivative: every method's estimate with two standard errors. Raises UsageError where the flight
        shows none of them."""
        from station.identification.identification_report import estimates_figure, groups

        every = groups(self.found)
        if lateral and len(every) < 2:  # noqa: PLR2004 longitudinal and lateral
            raise UsageError(f"{self.found.log}: no lateral derivatives: no aileron or rudder moves")
        return Picture(estimates_figure(self.found, every[int(lateral)]))

    def report(self, folder: Path | str, *, pdf: bool = False) -> Path:
        """Write the page with pictures, as `--report` does, and with `pdf` as `--pdf` prints it beside; returns the
        page's path. Raises LogError, and UsageError where nothing prints."""
        from station.identification.identification_report import write_report

        if pdf:
            check_printable()
        page = write_report(self.found, Path(folder))
        if pdf:
            print_page(page)
        return page

    def __repr__(self) -> str:
        start, end = self.found.interval_s
        known = [
            f"{name} {row.estimate:.3g} ± {2 * row.std_error:.2g}"
            for name, row in self.derivatives.iterrows()
            if row.status == "estimated" and math.isfinite(row.std_error)
        ]
        of = f"{self.found.aircraft.name}, {start:.2f} to {end:.2f} s, turbulence {self.found.turbulence}"
        return f"<{of}; {self.recommended or 'no method'} recommended: {', '.join(known) or 'nothing estimated'}>"

    def _repr_html_(self) -> str:
        from station.identification.identification_report import estimates_table, groups

        start, end = self.found.interval_s
        said = (
            f"{self.found.aircraft.name}, {start:.2f} to {end:.2f} s, turbulence {self.found.turbulence}; "
            f"recommended: {self.recommended or 'none'} (bold). Estimate ± standard error, per radian."
        )
        tables = [estimates_table(self.found, names) for names in groups(self.found)]
        return heading(said) + "".join(tables) + lines(self.remarks)


def identify(
    log: Recording | Path | str,
    method: str | Sequence[str] = "all",
    *,
    start: float | None = None,
    end: float | None = None,
    point: int | None = None,
    axes: Literal["wind", "body"] = "wind",
    sift: bool = False,
    aircraft: Aircraft | str | None = None,
) -> Identified:
    """Identify the derivatives of a recording by these methods, over `start` to `end` s or over a test point.

    `axes`: CL (wind) or CZ (body); `sift`: II and split from the lines that multisines excite; `aircraft`: a profile,
    or its name or path, instead of the recording's. Raises UsageError, LogError and ProfileError.
    """
    from station.identification.analysis import identify as solve
    from station.identification.request import Request

    path = log.path if isinstance(log, Recording) else Path(log)
    about = metadata(path).about
    if point is not None:
        if start is not None or end is not None:
            raise UsageError("--point and --from/--to both name an interval: give one")
        marked = _point(path, point)
        start, end = marked.start_s, marked.end_s
    near = (-math.inf if start is None else start - NEARBY_S, math.inf if end is None else end + NEARBY_S)
    # An interval that is none is refused with what the whole recording has.
    flown = table(path) if (start is None and end is None) or not near[0] < near[1] else table(path, near)
    names = [method] if isinstance(method, str) else list(method)
    request = Request(
        names,
        start,
        end,
        axes,
        card=about.card,
        imu_position=about.imu_position,
        noise=about.noise_si(flown.aligned),
        sift=sift,
        log=str(path),
        on_boom=about.on_boom,
        vanes=about.vanes,
    )
    subject = load_aircraft(aircraft) if isinstance(aircraft, str) else aircraft
    return Identified(solve(flown, subject or flown.aircraft, request))


def _point(log: Path, number: int) -> Point:
    known = points(log)
    for p in known:
        if p.n == number:
            return p
    numbers = ", ".join(str(p.n) for p in known) or "none"
    raise UsageError(f"{log}: no test point {number}\nmarked in it: {numbers}")

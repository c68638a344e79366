"""Monte Carlo campaigns, as `station campaign` flies them, in a result that tabulates and plots itself."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from station.api.words_as_html import Picture, heading, lines
from station.campaign.engine import Store, fly_dask, fly_local
from station.campaign.spec import Plan, load_plan
from station.rows import UsageError

if TYPE_CHECKING:
    import pandas as pd

Flown = Callable[[int, int], None]
"""Told how many flights are kept, and of how many."""


def _silent(kept: int, of: int) -> None:
    pass


@dataclass(frozen=True, slots=True)
class Campaigned:
    """A campaign that was flown: `result` is its Parquet file, a row a flight and method."""

    plan: Plan
    folder: Path
    result: Path
    sentences: tuple[str, ...]
    """What the flights say of the claims of the study that they repeat."""
    flown: int
    """Flights of this call; the others were kept from before."""

    @property
    def rows(self) -> pd.DataFrame:
        """A row a flight and method: factors, estimates, errors and coverage."""
        import pandas as pd

        return pd.read_parquet(self.result)

    @property
    def table(self) -> pd.DataFrame:
        """Of each case, method and derivative: `bias`, `scatter` and `rmse` in per cent of the reference, `coverage` of
        2 standard deviations in per cent of flights."""
        import pandas as pd

        from station.campaign.findings import Rows, level_name

        rows, found = Rows(self.plan, self.result), list[tuple[Any, ...]]()
        for case in self.plan.cases:
            for method in self.plan.campaign.methods:
                for name in self.plan.campaign.parameters:
                    s = rows.summary(case, method, name)
                    numbers = (s.flights, s.bias, s.scatter, s.rmse, 100 * s.coverage)
                    found.append((level_name(case), case.number, method, name, *numbers))
        head = ["turbulence", "case", "method", "derivative", "flights", "bias", "scatter", "rmse", "coverage"]
        return pd.DataFrame(found, columns=head).set_index(["case", "method", "derivative"])

    @property
    def figures(self) -> dict[str, Path]:
        """The figures that were written, by their names."""
        return {p.stem: p for p in sorted((self.folder / "figures").glob("*.png"))}

    def plot(self) -> Picture:
        """Bias and scatter of every method, a panel a derivative."""
        from station.campaign.figures import errors_figure

        return Picture(errors_figure(self.plan, self.result))

    def __repr__(self) -> str:
        return f"<campaign {self.plan.campaign.name}: {self.plan.flights} flights in {self.result}>"

    def _repr_html_(self) -> str:
        said = f"{self.plan.campaign.name}: {self.plan.flights} flights, {len(self.plan.campaign.methods)} methods"
        return heading(said) + lines(self.sentences) + str(self.table.round(2).to_html(max_rows=60))


def campaign(
    spec: str,
    out: Path | str,
    *,
    engine: Literal["local", "dask"] = "local",
    scheduler: str | None = None,
    resume: bool = False,
    workers: int | None = None,
    progress: Flown = _silent,
    say: Callable[[str], None] = print,
) -> Campaigned:
    """Fly a campaign, a name under profiles/campaigns or a path, into the folder `out`.

    `engine` "dask" with the `scheduler`'s address flies it on a cluster, "local" in `workers` processes, one a core if
    left out; `resume` goes on where it was stopped; `say` is told what it waits
    for. Raises UsageError, ProfileError, LogError and StationError.
    """
    from station.campaign.figures import draw

    if (engine == "dask") != (scheduler is not None):
        raise UsageError(
            "--engine dask and --scheduler ADDRESS go together\nfor example --scheduler tcp://127.0.0.1:8786"
        )
    plan, folder = load_plan(spec), Path(out)
    store = Store(folder, plan, resume)
    already = plan.flights - store.flights_missing()
    kept = already
    progress(kept, plan.flights)

    def done(flights: int) -> None:
        nonlocal kept
        kept += flights
        progress(kept, plan.flights)

    if scheduler is not None:
        fly_dask(plan, store, scheduler, done, say)
    else:
        fly_local(plan, store, workers or len(os.sched_getaffinity(0)), done)
    result = store.finish()
    sentences = store.writing(lambda: draw(plan, result, folder))
    return Campaigned(plan, folder, result, tuple(sentences), plan.flights - already)

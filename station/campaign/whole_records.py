"""Methods of a campaign that the compiled pass has not: those of a whole record (I, VI, oe, fe, sidpac), and IV, whose
spectra come of a longer flight in the same air.

They are the functions that `station identify` runs, a flight at a time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from station.campaign.one_pass import Results
from station.conventions import SIGNALS, TICK_HZ, TICK_NS
from station.estimation.flight_record import FlightRecord
from station.estimation.method_table import MEASURED, METHODS
from station.estimation.methods import Estimator
from station.estimation.published import batch, cross_spectra
from station.estimation.results import names
from station.numerics.regression import NotIdentifiable
from station.profile import Aircraft, Card
from station.rows import Frame, ParamEstimate, Status

Array = NDArray[np.float64]

WHOLE: Final = (MEASURED, *(name for name, method in METHODS.items() if method.runner))
"""Methods that are run here."""
SPECTRA_SEED: Final = 1 << 40
"""Added to a flight's seed for the longer one that shows IV its spectra: beyond every campaign's own seeds."""


@dataclass(frozen=True, slots=True)
class WholeRecords:
    """What these methods know: some of WHOLE, each with its place among a campaign's methods; the aircraft; `card` with
    the estimates' frequencies; `begin`, the record's first tick."""

    methods: dict[str, int]
    known: Aircraft
    card: Card
    axes: Literal["wind", "body"]
    begin: int

    def estimate(self, shown: Array, longer: Array | None, results: Results, run: int) -> None:
        """Every method on what the sensors show, (ticks, signals), -> `results` of this `run`; `longer`: the flight
        that IV's spectra are of."""
        record = _record(shown[self.begin :], self.known)
        for method, slot in self.methods.items():
            if method == MEASURED:
                self._fill(self._measured(shown, longer), {}, results, run, slot)
                continue
            made = batch.run(method, record, self.axes)
            r2 = {name: fit.r2 for name, fit in made.fit.items()}
            self._fill(made.parameters if made.status == "ok" else (), r2, results, run, slot)

    def _measured(self, shown: Array, longer: Array | None) -> tuple[ParamEstimate, ...]:
        """IV, tick by tick as in flight; nothing where the longer flight gives no spectra."""
        if longer is None:
            return ()
        try:
            spectra = cross_spectra.measure(_record(longer, self.known), (self.card.low, self.card.high))
        except NotIdentifiable:
            return ()
        estimator = Estimator(
            self.known, self.card, axes=self.axes, force=True, methods=(MEASURED,), spectra=spectra
        )  # fmt: skip
        nothing, fresh = (0.0,) * len(SIGNALS), (0,) * len(SIGNALS)
        for k, row in enumerate(shown.tolist()):
            _, found = estimator.step(Frame(k * TICK_NS, k, tuple(row), nothing, fresh))
        return next((m.parameters for m in found if m.method == MEASURED), ())

    def _fill(
        self, found: tuple[ParamEstimate, ...], r2: dict[str, float], results: Results, run: int, slot: int
    ) -> None:
        known = {p.name: p for p in found if p.status is not Status.INVALID}
        for place, name in enumerate(names(self.axes)):
            equation, i = divmod(place, 3)
            p = known.get(name)
            results.estimate[run, slot, equation, i] = p.value if p else math.nan
            results.error[run, slot, equation, i] = p.sd if p else math.nan
            results.r2[run, slot, equation] = r2.get(name.split("_")[0], math.nan)
            results.solved[run, slot, equation] = p is not None


def _record(shown: Array, known: Aircraft) -> FlightRecord:
    """As a recording of these signals gives it."""
    columns = {name: shown[:, i] for i, name in enumerate(SIGNALS) if np.isfinite(shown[:, i]).any()}
    return FlightRecord.of(np.arange(len(shown)) / TICK_HZ, columns, known)

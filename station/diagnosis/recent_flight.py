"""The last seconds of a flight beside the profile's aircraft, simulated from the inputs that were measured meanwhile.

As `diagnose` simulates a manoeuvre: the gust that the vane shows is met, initial state and trim are fitted, and the
tolerances are those of the qualification of simulators (qualification.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import SIGNALS
from station.diagnosis.measured_record import manoeuvres, why_not_flown
from station.diagnosis.qualification import ACCELERATION, PITCH, PITCH_RATE, flown_beside
from station.diagnosis.vane_gust import as_the_gust
from station.estimation.flight_record import accepted
from station.profile import Aircraft
from station.rows import ProfileError, UsageError

Array = NDArray[np.float64]

SECONDS: Final = 20.0
"""Some five periods of a light aircraft's short period, and less than half of its phugoid's."""
TOLERANCES: Final = {"alpha_vane": PITCH, "q": PITCH_RATE, "theta": PITCH, "az": ACCELERATION}
"""SI. The table has none of the angle of attack: it is given the pitch angle's."""
_NAME: Final = "recent flight"


@dataclass(frozen=True, slots=True)
class Beside:
    """TOLERANCES' signals as measured and simulated, (n,) each, SI, from when on the simulation is judged; `why` they
    were not simulated.

    `middle` is the measured signal as far up as the gust is known, about which the tolerance lies; `worst` is the
    largest difference as a share of it, `overall` that of the table's entry, in which the less restrictive of pitch
    angle and pitch rate counts.
    """

    t_s: Array
    measured: Mapping[str, Array] = field(default_factory=dict)
    middle: Mapping[str, Array] = field(default_factory=dict)
    simulated: Mapping[str, Array] = field(default_factory=dict)
    worst: Mapping[str, float] = field(default_factory=dict)
    overall: float = float("nan")
    why: str = ""

    @property
    def inside(self) -> bool:
        return not self.why and self.overall <= 1.0


def beside(
    t_s: Array,
    values: Array,
    quality: NDArray[np.uint8],
    aircraft: Aircraft,
    imu: tuple[float, float, float],
    names: Sequence[str] = tuple(SIGNALS),
) -> Beside:
    """Frames (n, signals) at `t_s`, with the quality of each value; `imu`: from the CG in body axes, m."""
    why = why_not_flown(aircraft)
    if why:
        return Beside(t_s, why=why)
    columns = {name: accepted(name, values[:, i], quality[:, i]) for i, name in enumerate(names)}
    try:
        record = replace(manoeuvres(_NAME, t_s, columns, aircraft, [(float(t_s[0]), float(t_s[-1]))])[-1], imu=imu)
        flown = flown_beside(record, aircraft)
    except (UsageError, ProfileError) as refusal:
        return Beside(t_s, why=str(refusal).removeprefix(f"{_NAME}: ").splitlines()[0])
    judged = slice(round(flown.judged_from_s / record.dt), None)
    measured, simulated = ({name: x[name][judged] for name in TOLERANCES} for x in (flown.measured, flown.after))
    middle = {name: as_the_gust(x, record.dt) for name, x in measured.items()}
    worst = {
        name: float(np.abs(as_the_gust(simulated[name] - x, record.dt)).max()) / TOLERANCES[name]
        for name, x in measured.items()
    }
    t_s = record.start_s + flown.t_s[judged]
    return Beside(t_s, measured, middle, simulated, worst, flown.entries[0].after)

"""What differs between the diagnosis of longitudinal and of lateral motion: series, sensors, model and its parameters.

Likelihood, search and judgement are the same for either. Of either, the first three series are integrals, the fourth is
a vane's, the last three are coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0, LATERAL, to_si
from station.diagnosis import free_parameters, gust_answer, lateral_free, lateral_residuals, residuals
from station.diagnosis.air_data import Unseen
from station.diagnosis.free_parameters import Free
from station.diagnosis.measured_record import Record
from station.diagnosis.memo import Memo
from station.diagnosis.processing import Setting
from station.diagnosis.residuals import LIFT, VANE, Signals
from station.diagnosis.series_spectra import Spectra
from station.profile import Aircraft

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Densities = Mapping[str, float]
"""Of the noise of sensors, variance times seconds."""


@dataclass(frozen=True, slots=True)
class Axis:
    """Longitudinal, or lateral."""

    lateral: bool
    series: tuple[str, ...]
    """(7,) names."""
    series_of: Callable[[Signals, Aircraft, Setting, Unseen, Memo], Array]
    spectra_of: Callable[[Signals, Aircraft, Setting, Unseen, Memo], Spectra]
    heads: tuple[str, ...]
    """(7,) the sensor at the head of each series."""
    signals_of: tuple[tuple[str, ...], ...]
    """(7,) the measured signals that a series is about."""
    sensors: tuple[str, ...]
    """What reaches the residuals by itself."""
    always: Mapping[str, float]
    """Those that no record has, and the standard deviation of what nothing states; 0 where another rule does."""
    answers: Callable[[Record, Aircraft, Array], Mapping[str, Mapping[str, Complex]]] | None
    """What gusts that nothing measures make of the signals: see gust_answer."""
    load: str
    """The sensor whose share in the vane is the answer to a gust; "" for none."""
    surfaces: tuple[str, ...]
    least_missed: tuple[float, ...]
    """The share of `missed` that any model misses."""
    trim_sd: tuple[float, float, float]
    """By what the three coefficients in trim differ between manoeuvres of one flight."""
    steady: Callable[[Densities, float, float, float], tuple[float, float, float, float]]
    """Variances of the steady parts of the first four series: of densities, seconds, speed (m/s) and the gust's density
    (rad2 s)."""
    unjudged: Callable[[str, Record, Aircraft], bool]
    """Whether a series cannot be judged."""
    still: Mapping[str, Any]
    """What an aircraft has instead of its model, so that series are the coefficients measured."""
    free_parameters: Callable[[Aircraft, float, bool], list[Free]]
    derivatives: tuple[str, ...]
    of_zero: Mapping[str, str]
    """Free zeros that are named as effects."""
    day: tuple[str, ...]
    """Free parameters of the day, not of the aircraft."""

    @property
    def forces(self) -> Mapping[str, str]:
        """The coefficients' series, and the sensor that each is made of."""
        return dict(zip(self.series[LIFT:], self.heads[LIFT:], strict=True))

    @property
    def missed(self) -> tuple[str, ...]:
        """What the model may miss a share of: a force, or what a sensor of the air or of a surface shows."""
        return (*self.series[LIFT:], self.series[VANE], *self.surfaces)


# Variance of a mean is density/T; of a line's rise 12 density/T; of the rise of an integral 6/5 density T.


def _steady_along(d: Densities, seconds: float, speed: float, gust: float) -> tuple[float, float, float, float]:
    return (
        12 * d["theta"] / seconds + 1.2 * seconds * d["q"],
        12 * d["v_down"] / seconds + 1.2 * seconds * d["az"],
        12 * d["v_along"] / seconds + 1.2 * seconds * (d["ax"] + G0**2 * d["theta"]),
        (d["alpha_vane"] + d["theta"] + d["v_down"] / speed**2 + gust) / seconds,
    )


def _steady_across(d: Densities, seconds: float, _speed: float, _gust: float) -> tuple[float, float, float, float]:
    return (
        12 * d["phi"] / seconds + 1.2 * seconds * d["p"],
        12 * d["psi"] / seconds + 1.2 * seconds * d["r"],
        12 * d["v_across"] / seconds + 1.2 * seconds * (d["ay"] + G0**2 * d["phi"]),
        UNKNOWN_WIND**2,
    )


def _unjudged_along(name: str, record: Record, aircraft: Aircraft) -> bool:
    if name == "v_down":
        return "v_down" not in record.signals
    if name == "v_north":
        return "v_along" not in record.signals
    if name == "drag":
        return (aircraft.drag is None and not aircraft.value("CD_0")) or "thrust" not in record.signals
    if name == "moment":
        return aircraft.inertia.iyy is None
    return False


def _unjudged_across(name: str, record: Record, _: Aircraft) -> bool:
    needed = {"heading": "psi", "v_across": "v_across"}
    return name in needed and needed[name] not in record.signals


UNKNOWN_WIND: Final = to_si(20, "deg")
"""Mean sideslip by inertial motion: a steady wind across turns it by as much, and nothing tells of that."""

LONGITUDINAL: Final = Axis(
    lateral=False,
    series=residuals.SERIES,
    series_of=residuals.series,
    spectra_of=residuals.series_spectra,
    heads=("theta", "v_down", "v_along", "alpha_vane", "az", "q", "ax"),
    signals_of=(
        ("theta", "q"), ("v_down", "az"), ("v_north", "ax"), ("alpha_vane",), ("az",), ("q", "elevator"), ("ax",),
    ),
    sensors=(
        "theta", "q", "ax", "az", "v_down", "v_along", "airspeed", "dynamic_pressure", "alpha_vane", "elevator",
        "thrust", "pitot",
    ),
    # "pitot": what airspeed and dynamic pressure show alike, m/s.
    always={"thrust": 0.0, "pitot": 0.0},
    answers=None,
    load="az",
    surfaces=("elevator",),
    # No linear model is better than a hundredth, no parabolic polar than a fifth of what moves, no vane than half a
    # hundredth (its friction), no surface's sensor than a five-hundredth.
    least_missed=(0.01, 0.01, 0.2, 0.005, 0.002),
    # Fuel burnt, power, configuration.
    trim_sd=(0.02, 0.01, 0.01),
    steady=_steady_along,
    unjudged=_unjudged_along,
    still={"derivatives": {}, "drag": None},
    free_parameters=free_parameters.free_parameters,
    derivatives=free_parameters.DERIVATIVES,
    of_zero=free_parameters.OF_ZERO,
    day=free_parameters.DAY,
)  # fmt: skip

ACROSS: Final = Axis(
    lateral=True,
    series=lateral_residuals.SERIES,
    series_of=lateral_residuals.lateral_series,
    spectra_of=lateral_residuals.lateral_spectra,
    heads=("phi", "psi", "v_across", "beta_vane", "ay", "p", "r"),
    signals_of=(
        ("phi", "p"), ("psi", "r"), ("v_east", "ay"), ("beta_vane",), ("ay",), ("p", "aileron"), ("r", "rudder"),
    ),
    sensors=(
        "phi", "psi", "p", "r", "ay", "v_across", "beta_vane", "aileron", "rudder", "roll_gust", "yaw_gust",
    ),
    # rad/s, white before the span averages it: of that 0.02 is left, as turbulence of 1 m/s rolls the air (MIL-F-8785C
    # 3.7.2.3). A level to start from, held loosely.
    always={"roll_gust": 0.05, "yaw_gust": 0.05},
    answers=gust_answer.gust_answer,
    load="",
    surfaces=("aileron", "rudder"),
    # Wing, fin and propellers in each other's wake: side force and yaw follow no linear model to better than two
    # hundredths, where sideslip reaches 5 deg.
    least_missed=(0.02, 0.01, 0.02, 0.005, 0.002, 0.002),
    # Another wind across, power on one side.
    trim_sd=(0.02, 0.005, 0.005),
    steady=_steady_across,
    unjudged=_unjudged_across,
    still={"derivatives": {}, "fin": None},
    free_parameters=lateral_free.lateral_free_parameters,
    derivatives=LATERAL,
    of_zero=lateral_free.OF_ZERO,
    day=lateral_free.DAY,
)  # fmt: skip

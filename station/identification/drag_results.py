"""Drag of a record beside its derivatives: CD and CD_0 with errors, and what they say of the profile's polar."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from station.estimation.flight_record import FlightRecord
from station.model.energy_drag import FEWEST, WINDOW_S, EnergyDrag, drag_by_energy

SIGNIFICANT: Final = 2.0
"""Standard errors that a change must exceed to be told."""
NOTHING_OF_DRAG: Final = "drag is not known, nor a change of it"
UNKNOWN: Final = f"the thrust is neither recorded nor told by the profile's [engine]: {NOTHING_OF_DRAG}"


@dataclass(frozen=True, slots=True)
class DragResult:
    """Value and standard error of each; NaN where the profile gives no polar."""

    CD: tuple[float, float]
    CL: float
    CD_0: tuple[float, float]
    """At no lift, with the polar's induced drag."""
    change: tuple[float, float]
    """CD against the profile's polar."""
    random: float
    """Of CD, by scatter alone: what tells a change within the flight."""
    thrust: str
    """recorded or engine"""
    windows: EnergyDrag

    @property
    def systematic_share(self) -> float:
        """Of CD, what thrust, mass, angle of attack and accelerometer may be wrong by."""
        return self.windows.systematic / abs(self.CD[0])


def drag_of(record: FlightRecord) -> DragResult | str:
    """Of all of a record, or why there is none."""
    if not record.thrust_known:
        return UNKNOWN if record.aircraft.engine is None else f"{record.why_no_thrust}: {NOTHING_OF_DRAG}"
    engine = record.aircraft.engine
    by_engine = any(words.startswith("thrust by the profile's engine") for words in record.remarks)
    motion = {n: np.where(record.usable, x, math.nan) for n, x in record.motion.items()}
    error = engine.uncertainty if by_engine and engine is not None else None
    made = drag_by_energy(motion, record.airframe, record.aircraft, record.alpha, record.t_s, error)
    if len(made.t_s) < FEWEST:
        return f"{FEWEST * WINDOW_S:.0f} s of flight are needed: there are {len(made.t_s)} windows of {WINDOW_S:g} s"
    polar = record.aircraft.drag
    cd, scatter = float(np.mean(made.CD)), made.random(made.CD)
    whole = math.hypot(scatter, made.systematic)
    if polar is None:
        nothing = (math.nan, math.nan)
        zero_lift = change = nothing
    else:
        apart = made.change
        change = float(np.mean(apart)), math.hypot(made.random(apart), made.systematic)
        zero_lift = polar.zero_lift + change[0], change[1]
    return DragResult(
        (cd, whole), float(np.mean(made.CL)), zero_lift, change, scatter, "engine" if by_engine else "recorded", made
    )


def drag_json(found: DragResult | str) -> dict[str, Any]:
    """For the section `drag`."""
    if isinstance(found, str):
        return {"status": "not_applicable", "why": found}
    parts = {"CD": found.CD, "CD_0": found.CD_0, "change": found.change}
    return {
        "status": "ok",
        "why": "",
        "thrust": found.thrust,
        "parameters": {n: _parameter(*pair) for n, pair in parts.items()},
        "CL": found.CL,
        "std_error_random": found.random,
        "window_s": WINDOW_S,
        "t_s": found.windows.t_s.tolist(),
        "CD": found.windows.CD.tolist(),
        "power_imbalance_w": [x if math.isfinite(x) else None for x in found.windows.imbalance.tolist()],
    }


def _parameter(value: float, sd: float) -> dict[str, Any]:
    if not math.isfinite(value + sd):
        return {
            "estimate": None,
            "std_error": None,
            "ci95": None,
            "status": "invalid",
            "why": "the profile has no [drag]",
        }
    ci95 = [value - 1.96 * sd, value + 1.96 * sd]
    return {"estimate": value, "std_error": sd, "ci95": ci95, "status": "estimated", "why": ""}


def drag_lines(found: DragResult | str) -> list[str]:
    """For the terminal and the page."""
    if isinstance(found, str):
        return [f"drag: {found}"]
    (cd, sd), (change, error) = found.CD, found.change
    told = "thrust recorded" if found.thrust == "recorded" else "thrust by the profile's engine"
    lines = [f"drag from energy: CD {cd:.4f}±{2 * sd:.4f} at CL {found.CL:.2f}, {told}"]
    if math.isfinite(change + error):
        share = 100 * change / (cd - change)
        verdict = "as the polar has it" if abs(change) <= SIGNIFICANT * error else "the polar does not hold"
        lines.append(f"  {change:+.4f}±{2 * error:.4f} against the profile's polar ({share:+.0f} %): {verdict}")
        lines.append(
            f"  CD_0 {found.CD_0[0]:.4f}±{2 * found.CD_0[1]:.4f}; a change within the flight shows from "
            f"{2 * math.sqrt(2) * found.random:.4f} on"
        )
    return lines

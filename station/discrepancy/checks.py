"""What is seen before any fit: held values, lost rows, signs and units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0
from station.discrepancy.record import Record
from station.profile import Aircraft

Array = NDArray[np.float64]

FACTORS: Final = {
    "-1": -1.0, "deg for rad": math.degrees(1), "rad for deg": math.radians(1), "ft for m": 1 / 0.3048,
    "m for ft": 0.3048, "kt for m/s": 3600 / 1852, "m/s for kt": 1852 / 3600, "g for m/s2": 1 / G0,
    "m/s2 for g": G0,
}  # fmt: skip
"""Reported over true, where a unit or a sign is mistaken; each also with the other sign."""
NEAR: Final = 0.12
"""How far a measured factor may be from one of FACTORS."""
ALIKE: Final = 0.8
"""Correlation with what other instruments say, below which a factor means nothing."""
LOST: Final = 0.01


@dataclass(frozen=True, slots=True)
class Seen:
    """An effect that needs no fit."""

    id: str
    sentence: str
    value: float
    unit: str
    signature: str
    separate_by: str = ""


def examine(records: Sequence[Record], aircraft: Aircraft) -> tuple[list[Seen], list[Record]]:
    """What is seen at once in the records, and the records with mistaken signs and units put right."""
    seen: list[Seen] = []
    factors: dict[str, list[float]] = {}
    for record in records:
        for name, (mine, theirs) in _twins(record, aircraft).items():
            found = _factor(mine, theirs)
            if found is not None:
                factors.setdefault(name, []).append(found)
    wrong: dict[str, float] = {}
    for name, all_found in factors.items():
        factor = float(np.median(all_found))
        if len(all_found) == len(records) and (known := _known(factor)) is not None:
            words, exact = known
            wrong[name] = exact
            kind = "sign" if exact == -1 else "unit"
            seen.append(
                Seen(
                    f"{name}.{kind}",
                    f"{name} is {'of the wrong sign' if exact == -1 else f'in the wrong unit ({words})'}.",
                    exact,
                    "1",
                    f"{name} is {factor:.4g} times what the other instruments say",
                )
            )
    held = [(s, r, fresh) for r in records for s, fresh in r.held.items() if s == "v_down"]
    if held:
        hold = float(np.median([np.median(np.diff(fresh)) * r.dt for _, r, fresh in held]))
        words = f"The velocity is repeated for {hold:.3g} s before it is new."
        seen.append(Seen("velocity.stale", words, hold, "s", "v_down repeats its values"))
    lost = max(r.lost for r in records)
    if lost > LOST:
        words = f"{100 * lost:.1f} % of the rows lack a signal."
        seen.append(Seen("stream.dropout", words, lost, "1", "rows missing"))
    mended = [replace(r, signals={n: x / wrong[n] if n in wrong else x for n, x in r.signals.items()}) for r in records]
    return seen, mended


def _twins(record: Record, aircraft: Aircraft) -> dict[str, tuple[Array, Array]]:
    """Signals beside what others say of them: both without mean and line, but for the weight in az."""
    x, dt = record.signals, record.dt
    out: dict[str, tuple[Array, Array]] = {"q": (_smooth(x["q"], dt), _smooth(np.gradient(x["theta"], dt), dt))}
    if "v_down" in x:
        flow = x["theta"] + np.arcsin(np.clip(x["v_down"] / np.maximum(x["airspeed"], 1.0), -1, 1))
        out["alpha_vane"] = (_smooth(x["alpha_vane"], dt), _smooth(flow, dt))
    # The angular acceleration a moment after the elevator moves: only its sign and rough size are asked for.
    if aircraft.value("Cm_de") and aircraft.inertia.iyy:
        effect = aircraft.value("Cm_de") * aircraft.geometry.wing_area * aircraft.geometry.chord / aircraft.inertia.iyy
        moment = np.gradient(x["q"], dt) / (effect * float(np.mean(x["dynamic_pressure"])))
        edge = np.gradient(_smooth(x["elevator"], dt), dt)
        answer = np.gradient(_smooth(moment, dt), dt)
        out["elevator"] = (edge, answer)
    weight = -G0 * np.cos(x["theta"])
    out["az"] = (x["az"], weight)
    return {n: (a, b) if n == "az" else (_levelled(a), _levelled(b)) for n, (a, b) in out.items()}


def _smooth(x: Array, dt: float) -> Array:
    """Mean over a fifth of a second."""
    width = max(1, round(0.2 / dt))
    return np.convolve(x, np.full(width, 1 / width), "same")


def _levelled(x: Array) -> Array:
    inside = x[len(x) // 20 : len(x) - len(x) // 20]
    t = np.linspace(-0.5, 0.5, len(inside))
    return np.asarray(inside - inside.mean() - float((inside * t).sum() / (t * t).sum()) * t)


def _factor(mine: Array, theirs: Array) -> float | None:
    """mine over theirs, both noisy; None where they do not go together."""
    cross = float(mine @ theirs)
    size = math.sqrt(float(mine @ mine) * float(theirs @ theirs))
    if size == 0 or abs(cross) / size < ALIKE:
        return None
    return math.copysign(math.sqrt(float(mine @ mine) / float(theirs @ theirs)), cross)


def _known(factor: float) -> tuple[str, float] | None:
    for words, exact in FACTORS.items():
        for sign in (1.0, -1.0):
            wanted = sign * exact
            if wanted == 1.0:
                continue
            if abs(factor / wanted - 1) < NEAR:
                return (words if sign > 0 else f"{words}, and its sign"), wanted
    return None

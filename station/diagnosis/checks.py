"""What is seen before any fit: held values, lost rows, signs and units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import G0
from station.diagnosis.measured_record import Record
from station.profile import Aircraft

Array = NDArray[np.float64]

ANGLE_FACTORS: Final = {"": 1.0, "deg for rad": math.degrees(1), "rad for deg": math.radians(1)}
FORCE_FACTORS: Final = {"": 1.0, "g for m/s2": 1 / G0, "ft/s2 for m/s2": 1 / 0.3048}
"""Reported over true, where a unit is mistaken."""
ANGLE_NEAR: Final = math.log(4)
FORCE_NEAR: Final = math.log(1.12)
"""How far the logarithm of a measured factor may be from that of a mistake: a gust moves the vane, not the attitude."""
ALIKE: Final = 0.35
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
        known = _known(name, factor)
        if len(all_found) == len(records) and known is not None:
            words, exact = known
            wrong[name] = exact
            kind = "sign" if exact == -1 else "unit"
            seen.append(
                Seen(
                    f"{name}.{kind}",
                    f"{name} is {'of the wrong sign' if exact == -1 else f'in the wrong unit: {words}'}.",
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
        factor = _factor(*(_levelled(y) for y in out["q"]))
        mistake = None if factor is None else _known("q", factor)
        rate = x["q"] if mistake is None else x["q"] / mistake[1]
        moment = np.gradient(rate, dt) / (effect * float(np.mean(x["dynamic_pressure"])))
        edge = np.gradient(_smooth(x["elevator"], dt), dt)
        answer = np.gradient(_smooth(moment, dt), dt)
        out["elevator"] = (edge, answer)
    weight = -G0 * np.cos(x["theta"]) * (np.cos(x["phi"]) if "phi" in x else 1.0)
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


def _known(name: str, factor: float) -> tuple[str, float] | None:
    """The mistake that a factor comes from; None where it is near 1 or near none."""
    factors, near = (FORCE_FACTORS, FORCE_NEAR) if name == "az" else (ANGLE_FACTORS, ANGLE_NEAR)
    words, size = min(factors.items(), key=lambda f: abs(math.log(abs(factor) / f[1])))
    if abs(math.log(abs(factor) / size)) > near:
        return None
    sign = math.copysign(1.0, factor)
    if size == 1.0 and sign > 0:
        return None
    return words + (" and of the wrong sign" if sign < 0 and words else ""), sign * size

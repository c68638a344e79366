"""Two vanes after a flight: one in place of the other where that is missing, their mean where the profile wants it, and
how far they differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from station.conventions import from_si
from station.estimation.second_vane import WINDOW_S, Position, SecondVane
from station.log import Table
from station.profile import AVERAGED_ALONE, Aircraft

Array = NDArray[np.float64]


def in_reserve(table: Table, places: Mapping[str, Position], aircraft: Aircraft) -> tuple[Table, list[str]]:
    """The table with the second vane in place of alpha_vane where that is missing, and how the two
    compare, in words."""
    columns, quality, said = dict(table.columns), dict(table.quality), []
    nothing = np.full(len(table.t_s), np.nan)
    shown = [n for n in places if n in columns and np.isfinite(columns[n]).any()]
    if aircraft.second_vane and aircraft.second_vane.averaged and not shown:
        said.append(AVERAGED_ALONE)
    for name, position in places.items():
        if name not in shown:
            continue
        vane = SecondVane(name, 0, position, aircraft)
        rates = (columns.get(n, nothing).tolist() for n in ("p", "q", "airspeed"))
        speed = columns.get("airspeed", nothing)
        second = np.array([vane.brought(*row) for row in zip(columns[name].tolist(), *rates, strict=True)])
        first = columns.get("alpha_vane", nothing)
        both = np.isfinite(first) & np.isfinite(second)
        less = float(np.median((second - first)[both])) if both.any() else 0.0
        lost = ~np.isfinite(first) & np.isfinite(second)
        if lost.any():
            columns["alpha_vane"] = np.where(lost, second - less, first)
            if "alpha_vane" in quality and name in quality:
                quality["alpha_vane"] = np.where(lost, quality[name], quality["alpha_vane"])
            said.append(f"alpha_vane is missing in {lost.mean():.1%} of the rows: {name} stands in for it there")
        if both.any():
            words, agree = _compared(vane, table.t_s[both], (second - first)[both], speed[both])
            said.append(words)
            if vane.averaged and agree:
                now = columns["alpha_vane"]
                columns["alpha_vane"] = np.where(both, now + 0.5 * (second - less - now), now)
                said.append(f"alpha_vane is the mean of both vanes, as [second_vane] averaged asks: {name} is in it")
    return replace(table, columns=columns, quality=quality), said


def _compared(vane: SecondVane, t_s: Array, less: Array, speed: Array) -> tuple[str, bool]:
    """How far the second vane is off the first, and where their difference, over WINDOW_S, is too large; whether they
    agree."""
    block = ((t_s - t_s[0]) / WINDOW_S).astype(np.int64)
    means = np.bincount(block, less) / np.maximum(np.bincount(block), 1)
    known = speed[np.isfinite(speed)]
    limit = vane.tolerance(float(np.std(less - means[block])), float(known.mean()) if len(known) else 0.0)
    off, rms = (from_si(float(x), "deg") for x in (np.median(less), np.std(less)))
    words = f"{vane.name} is {off:+.2f} deg off alpha_vane, {rms:.2f} deg rms about that"
    far = np.flatnonzero(np.abs(means) > limit)
    if not len(far):
        return words, True
    worst = from_si(float(means[np.argmax(np.abs(means))]), "deg")
    since = t_s[0] + far[0] * WINDOW_S
    return f"{words}: the two vanes DISAGREE, by {worst:+.1f} deg at worst, first at {since:.0f} s", False

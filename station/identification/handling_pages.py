"""The page of the derived quantities: their table, and the short period against the boundaries of MIL-F-8785C."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, NullFormatter

from station.identification.handling_qualities import WORDS, level_words, shown
from station.identification.html_page import BLUE, FAINT, INK, ORANGE, image, text
from station.model.flying_qualities import Derived, Qualities
from station.model.flying_quality_levels import LEVELS, PHUGOID_DAMPING, levels_of

CATEGORIES: Final = {"B": "climb, cruise, descent", "C": "approach, landing"}
_SHADES: Final = ("#c3d4e8", "#dfe6ef", "#f3f4f7")
"""Of levels 1 to 3."""
_HIGHEST: Final = 30.0
"""Frequency shown, rad/s."""


def derived_page(q: Qualities | str, before: Qualities | None = None) -> list[str]:
    """The table, and the short period against the boundaries; `before`: of the aircraft before its extension."""
    head = "<h2>Derived quantities</h2>"
    if isinstance(q, str):
        return [head, f'<p class="note">None: {text(q)}.</p>']
    rows = []
    for name, d in q.quantities.items():
        word, unit = WORDS[name]
        own = f"<td colspan='2' class='words faint'>cannot be known: {text(d.why)}</td>"
        if not d.why:
            low, high = (shown(d, x) for x in d.ci95)
            own = f"<td>{shown(d, d.estimate)}</td><td>{low} to {high}</td>"
        was = ""
        if before is not None:
            d0 = before.quantities[name]
            was = f"<td>{'–' if d0.why else shown(d0, d0.estimate)}</td>"
        rests = f"the profile's {', '.join(d.rests_on)}" if d.rests_on and not d.why else ""
        rows.append(
            f"<tr><td>{word}</td><td>{'' if unit == '1' else unit}</td>{was}{own}<td class='words'>{rests}</td></tr>"
        )
    was = "" if before is None else "<th>before</th>"
    table = f"<table><tr><th></th><th>unit</th>{was}<th>estimate</th><th>95 %</th><th class='words'>rests on</th></tr>"
    at = q.condition
    note = (
        f"Level flight at {at.speed:.1f} m/s, density {at.density:.3f} kg/m3, {at.mass:.0f} kg; linear motion of four "
        "states. Mass and inertia cancel in the modes where the derivatives were found with the same ones, not in the "
        "margins. The drag is taken as known to 10 %, the thrust between constant and constant power."
    )
    made = [head, table, *rows, f'</table><p class="note">{note}</p>']
    found = levels_of(q)
    if found:
        words = "; ".join(f"category {c} ({CATEGORIES[c]}): {level_words(*v)}" for c, v in found.items())
        asked = f"Phugoid: level 1 asks for a damping of {PHUGOID_DAMPING[0]:g}."
        made.append(f"<p>Short period by MIL-F-8785C: {words}. {asked}</p>")
        made.append(image(boundaries(q, before), "short period against the boundaries of MIL-F-8785C"))
    return made


def boundaries(q: Qualities, before: Qualities | None = None) -> Figure:
    """Frequency over n/alpha and damping, with an interval's cloud, against the levels of both categories."""
    figure = Figure(figsize=(10, 4.2), dpi=90)
    panels = figure.subplots(1, 3, gridspec_kw={"width_ratios": [3, 3, 2]})
    figure.subplots_adjust(left=0.065, right=0.99, bottom=0.13, top=0.9, wspace=0.28)
    n, omega, zeta = (q.quantities[x] for x in ("n_per_alpha", "short_period_frequency", "short_period_damping"))
    for panel, category in zip(panels, LEVELS, strict=False):
        _frequency_panel(panel, category, n.estimate)
        panel.plot(q.draws[n.name], q.draws[omega.name], ".", ms=1.5, color=BLUE, alpha=0.25, zorder=2)
        _cross(panel, n, omega, BLUE)
        if before is not None and not before.quantities[omega.name].why:
            panel.plot(
                *(before.quantities[x].estimate for x in (n.name, omega.name)), "o", mfc="none", color=ORANGE, ms=7
            )
    _damping_panel(panels[-1], zeta, before)
    return figure


def _cross(panel: Panel, x: Derived, y: Derived, colour: str) -> None:
    wide = [[x.estimate - x.ci95[0]], [x.ci95[1] - x.estimate]]
    high = [[y.estimate - y.ci95[0]], [y.ci95[1] - y.estimate]]
    panel.errorbar(x.estimate, y.estimate, xerr=wide, yerr=high, fmt="o", color=colour, ms=5, lw=1.5, zorder=3)


def _frequency_panel(panel: Panel, category: str, n_alpha: float) -> None:
    """Where each level lies: between lines of constant CAP, above the least n/alpha and frequency."""
    span = (min(1.0, 0.5 * n_alpha), max(100.0, 2 * n_alpha))
    for k, limits in reversed(list(enumerate(LEVELS[category], start=1))):
        x = np.geomspace(max(span[0], limits.n_per_alpha), span[1], 60)
        low = np.maximum(np.sqrt(limits.cap[0] * x), limits.frequency)
        high = np.minimum(np.sqrt(limits.cap[1] * x), _HIGHEST)
        panel.fill_between(x, low, high, color=_SHADES[k - 1], lw=0)
        if math.isfinite(limits.cap[1]):
            outline = np.concatenate([x[:1], x, x[::-1], x[:1]]), np.concatenate([low[:1], low, high[::-1], low[:1]])
            panel.plot(*outline, color=INK, lw=1.2 if k == 1 else 0.7, ls="-" if k == 1 else "--")
        at = x[0] * 1.15
        panel.text(at, 0.82 * min(math.sqrt(limits.cap[1] * at), _HIGHEST), f"level {k}", fontsize=7, color=INK)
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlim(*span)
    panel.set_ylim(0.1, _HIGHEST)
    panel.set_title(f"category {category}: {CATEGORIES[category]}", fontsize=9, loc="left")
    panel.set_xlabel("n/α, g/rad", fontsize=8)
    panel.set_ylabel("short period, rad/s", fontsize=8)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter(FormatStrFormatter("%g"))
        axis.set_minor_formatter(NullFormatter())
    _plain(panel)


def _damping_panel(panel: Panel, zeta: Derived, before: Qualities | None) -> None:
    for k, levels in enumerate(LEVELS.values()):
        for limits, colour in zip(reversed(levels), reversed(_SHADES), strict=True):
            low, high = limits.damping
            panel.fill_betweenx([low, min(high, 3.0)], k - 0.4, k + 0.4, color=colour, lw=0)
        for i, limits in enumerate(levels, start=1):
            panel.annotate(
                f"level {i}", (k - 0.37, limits.damping[0]), (0, 2), textcoords="offset points", fontsize=7, color=INK
            )
        wide = [[zeta.estimate - zeta.ci95[0]], [zeta.ci95[1] - zeta.estimate]]
        panel.errorbar(
            k, zeta.estimate, yerr=wide, fmt="o", color=BLUE, ms=5, lw=1.5, label="" if k else "estimate, 95 %"
        )
        if before is not None and not before.quantities[zeta.name].why:
            was = before.quantities[zeta.name].estimate
            panel.plot(k, was, "o", mfc="none", color=ORANGE, ms=7, label="" if k else "before")
    panel.set_yscale("log")
    panel.set_ylim(0.1, 3.0)
    panel.set_yticks([0.1, 0.2, 0.5, 1, 2])
    panel.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.set_xlim(-0.5, len(LEVELS) - 0.5)
    panel.set_xticks(range(len(LEVELS)), [f"category {c}" for c in LEVELS])
    panel.set_title("damping ratio", fontsize=9, loc="left")
    panel.legend(fontsize=7, frameon=False, loc="upper center", ncols=2)
    _plain(panel)


def _plain(panel: Panel) -> None:
    panel.tick_params(labelsize=8, length=2)
    panel.grid(color=FAINT, lw=0.3)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)

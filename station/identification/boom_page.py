"""The report's page of accelerometers on the boom against the centre of gravity's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from station.identification.boom_spectra import BoomSpectra
from station.identification.html_page import BLUE, INK, ORANGE, image, text
from station.profile import Aircraft


def boom_page(found: Sequence[BoomSpectra] | str, aircraft: Aircraft) -> list[str]:
    """A picture and words for each; nothing where none is declared, and why where there is no spectrum."""
    if not found:
        return []
    if isinstance(found, str):
        return ["<h2>The boom's bending</h2>", _note(f"Boom against centre of gravity: {found}.")]
    body = ["<h2>The boom's bending</h2>"]
    for one in found:
        body += [
            image(_drawn(one), f"{one.name}: boom and centre of gravity over frequency"),
            _note(_said(one, aircraft)),
        ]
    return body


def _note(words: str) -> str:
    return f'<p class="note">{text(words)}</p>'


def _said(one: BoomSpectra, aircraft: Aircraft) -> str:
    boom = aircraft.boom
    known = boom.mode_frequency if boom is not None else None
    profile = f" The profile has {known:g} Hz." if known else " The profile's boom has no mode."
    if one.mode is None:
        return f"{one.name}: {one.why}.{profile}"
    m = one.mode
    return (
        f"{one.name}: the boom's bending mode at {m.frequency_hz:.2f} ± {2 * m.frequency_sd:.2f} Hz, damping "
        f"{m.damping:.3f} ± {2 * m.damping_sd:.3f} (95 %), from what the centre of gravity's acceleration, carried "
        f"there by a rigid boom, becomes at its tip.{profile} Dotted: the sensors' noise as the rig states it."
    )


def _drawn(one: BoomSpectra) -> Figure:
    figure = Figure(figsize=(10, 3.6), layout="constrained", dpi=120)
    left, right = figure.subplots(1, 2)
    f, bins = one.bins.frequencies_hz, one.bins
    for density, colour, name in ((bins.xx, BLUE, "centre of gravity, carried there"), (bins.yy, ORANGE, one.name)):
        low, high = bins.band(density)
        left.fill_between(f, low, high, color=colour, alpha=0.25, lw=0)
        left.plot(f, density, color=colour, lw=1.0, label=name)
    left.set_xscale("log")
    left.set_yscale("log")
    left.set_title("density of the specific force down, (m/s²)²/Hz", fontsize=10, loc="left")
    # What stands clear of the noise of both, by their densities.
    clear = (bins.xx > 2 * one.noise[0]) & (bins.yy > 2 * one.noise[1])
    ratio = np.sqrt((bins.yy - one.noise[1])[clear] / (bins.xx - one.noise[0])[clear])
    right.plot(f[clear], ratio, "o", ms=2.5, color=ORANGE, label="measured, noise taken off")
    for density, colour in zip(one.noise, (BLUE, ORANGE), strict=True):
        left.plot(f, density, color=colour, lw=0.8, ls=":")
    if one.mode is not None:
        right.plot(f, np.abs(one.mode.transmitted(f)), color=INK, lw=1.2, label="rigid boom and a mode")
        for panel in (left, right):
            panel.axvline(one.mode.frequency_hz, color=INK, lw=0.7, ls="--")
    right.set_xscale("log")
    right.set_yscale("log")
    right.set_title("boom over centre of gravity, 1", fontsize=10, loc="left")
    for panel in (left, right):
        panel.set_xlim(right=one.nyquist_hz)
        panel.legend(fontsize=8, frameon=False)
        panel.set_xlabel("frequency, Hz", fontsize=8, loc="right")
        panel.tick_params(labelsize=8, length=2)
        panel.grid(color="#eceef2")
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    return figure

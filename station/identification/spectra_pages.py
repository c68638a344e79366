"""The report's pages of spectra: the vane to its Nyquist frequency with its mode, and delay, response of the lift and
upwash over frequency, forced and in gusts alone, with Sears' and Theodorsen's functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.figure import Figure
from numpy.typing import NDArray

from station.conventions import from_si
from station.estimation.flight_record import FlightRecord
from station.estimation.published.cross_spectra import VaneSpectra
from station.estimation.vane_mode import LOWEST_HZ
from station.identification.html_page import BLUE, FAINT, INK, ORANGE, image, text
from station.identification.vane_spectra import Part, VaneDensity, parts, vane_density
from station.numerics.regression import NotIdentifiable
from station.numerics.thin_aerofoil import sears_magnitude, theodorsen

Array = NDArray[np.float64]

COLOURS: Final = {"forced": ORANGE, "gusts alone": BLUE}
DELAYS_S: Final = 0.3
"""Drawn up to so much, either way."""
DRAWN: Final = 200
"""Points of a theoretical curve."""
GREEN: Final = "#009e73"


def spectra_pages(record: FlightRecord, title: str = "Spectra of the vane") -> list[str]:
    """What is to be seen, and where nothing is, why."""
    return [f"<h2>{text(title)}</h2>", *_density_page(record), *_parts_page(record)]


def _note(words: str) -> str:
    return f'<p class="note">{text(words)}</p>'


def _density_page(record: FlightRecord) -> list[str]:
    try:
        found = vane_density(record)
    except NotIdentifiable as why:
        return [_note(f"The vane's own spectrum: {why}.")]
    figure = Figure(figsize=(10, 3.4), layout="constrained", dpi=120)
    _draw_density(figure.subplots(), found)
    boom = record.aircraft.boom
    profile = f" The profile has {boom.vane_frequency:g} Hz, {boom.vane_damping:g}." if boom else ""
    if found.mode is not None:
        m = found.mode
        damping = f"damping {m.damping:.2f} ± {2 * m.damping_sd:.2f} (95 %)"
        if not found.is_resolved:
            most = m.damping + 2 * m.damping_sd
            damping = f"damping at most {most:.2g}, which segments of {1 / found.line_hz:.0f} s do not resolve"
        frequency = f"{m.frequency_hz:.2f} ± {2 * m.frequency_sd:.2f} Hz"
        apart = "of the vane or of its boom, which a vane alone cannot tell apart"
        said = f"A mode at {frequency}, {damping}, {apart}.{profile}"
    else:
        said = f"{found.why[:1].upper()}{found.why[1:]}.{profile}"
    return [
        image(figure, "Spectral density of the vane's angle up to the Nyquist frequency"),
        _note(
            f"{said} Band: 95 % by chi-squared, {2 * float(np.median(found.bins.independent)):.0f} degrees of freedom "
            "in the middle. Dotted: the sensor's own noise as the rig states it."
        ),
    ]


def _draw_density(panel: Panel, found: VaneDensity) -> None:
    square = from_si(1.0, "deg") ** 2
    bins = found.bins
    low, high = bins.band(bins.xx)
    panel.fill_between(bins.frequencies_hz, low * square, high * square, color=BLUE, alpha=0.25, lw=0)
    panel.plot(bins.frequencies_hz, bins.xx * square, color=BLUE, lw=1.0, label="vane")
    if found.mode is not None:
        fitted = found.mode_bins.frequencies_hz >= LOWEST_HZ
        f, model = found.mode_bins.frequencies_hz[fitted], found.mode.density[fitted]
        panel.plot(f, model * square, color=ORANGE, lw=1.4, label="gusts, mode and noise")
        panel.axvline(found.mode.frequency_hz, color=ORANGE, lw=0.8, ls="--")
    panel.axhline(found.noise * square, color=INK, lw=0.8, ls=":", label="sensor noise")
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlim(right=found.nyquist_hz)
    panel.set_title("density of the vane's angle, deg²/Hz", fontsize=10, loc="left")
    panel.legend(fontsize=8, frameon=False)
    _plain(panel, "frequency, Hz")


def _plain(panel: Panel, label: str) -> None:
    panel.set_xlabel(label, fontsize=8, loc="right")
    panel.tick_params(labelsize=8, length=2)
    panel.grid(color="#eceef2")
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)


def _parts_page(record: FlightRecord) -> list[str]:
    try:
        found = parts(record)
    except NotIdentifiable as why:
        return [_note(f"Delay and upwash over frequency: {why}.")]
    refused = [_note(f"{p.name.capitalize()}: {p.why}.") for p in found if p.why]
    shown = [p for p in found if p.spectra is not None]
    if not shown:
        return refused
    figure = Figure(figsize=(10, 8), layout="constrained", dpi=120)
    panels = figure.subplot_mosaic([["delay", "coherence"], ["response", "upwash"], ["elevator", "elevator"]])
    speed = float(np.nanmean(record.motion["airspeed"]))
    _delays(panels["delay"], shown, record, speed)
    _coherences(panels["coherence"], shown)
    _responses(panels["response"], shown, record.aircraft.geometry.chord / (2 * speed))
    _corrections(panels["upwash"], shown, record, speed)
    _elevators(panels["elevator"], shown)
    return [
        *refused,
        image(figure, "Delay, coherence, response of the lift, upwash and elevator over frequency, by part"),
        _note(
            f"{_lengths(shown)} Bars: 95 % by the coherence; faint: not coherent enough to be believed. A positive "
            "delay: the vane leads the lift; a gust's is x/V, dashed, a motion's none. Lines of the response: Sears' "
            "function (a gust) and Theodorsen's (the aerofoil's motion), as in two dimensions; 1/(1 + k_u): by Sears, "
            "from the profile's steady upwash, dashed. Pitch rate and elevator make lift too, so what is forced "
            "depends on how it was flown."
        ),
    ]


def _lengths(shown: Sequence[Part]) -> str:
    words = [
        f"{p.name.capitalize()}: {p.seconds:.0f} s, {p.spectra.segments} segments of {p.spectra.segment_s:.0f} s."
        for p in shown
        if p.spectra
    ]
    return " ".join(words)


def _points(panel: Panel, part: Part, x: Array, y: Array, sd: Array | None) -> None:
    """Those coherent enough in colour with 95 % bars, the others faint."""
    made = part.spectra
    if made is None:
        return
    good, lowest = made.believed, _lowest(made)
    rest = ~good & lowest & np.isfinite(y)
    panel.plot(x[rest], y[rest], ".", color=FAINT, ms=3)
    good = good & lowest
    error = 1.96 * sd[good] if sd is not None else None
    panel.errorbar(
        x[good], y[good], yerr=error, fmt="o", color=COLOURS[part.name], ms=3.5, lw=1.0, label=part.name
    )  # fmt: skip


def _lowest(made: VaneSpectra) -> NDArray[np.bool_]:
    """Frequencies that a segment holds two periods of."""
    return np.asarray(made.frequencies_hz >= 2.0 / made.segment_s)


def _unwrapped(made: VaneSpectra) -> Array:
    """The delay, s, by a phase that goes on beyond half a turn where the bins are coherent."""
    turn = 2 * math.pi * made.frequencies_hz
    delay = made.delay_s.copy()
    good = np.flatnonzero(made.believed)
    delay[good] = np.unwrap(turn[good] * delay[good]) / turn[good]
    return delay


def _delays(panel: Panel, shown: Sequence[Part], record: FlightRecord, speed: float) -> None:
    for part in shown:
        if part.spectra:
            made = part.spectra
            _points(panel, part, made.frequencies_hz, _unwrapped(made), made.delay_sd)
    boom = record.aircraft.boom
    if boom is not None:
        panel.axhline(boom.vane_x / speed, color=BLUE, lw=0.8, ls="--")
    panel.axhline(0.0, color=INK, lw=0.6)
    panel.set_ylim(-DELAYS_S, DELAYS_S)
    panel.set_xscale("log")
    panel.set_title("delay of the lift behind the vane, s", fontsize=10, loc="left")
    panel.legend(fontsize=8, frameon=False)
    _plain(panel, "frequency, Hz")


def _coherences(panel: Panel, shown: Sequence[Part]) -> None:
    for part in shown:
        if part.spectra:
            _points(panel, part, part.spectra.frequencies_hz, part.spectra.coherence, None)
    panel.set_xscale("log")
    panel.set_ylim(0, 1.02)
    panel.set_title("coherence of vane and lift", fontsize=10, loc="left")
    _plain(panel, "frequency, Hz")


def _responses(panel: Panel, shown: Sequence[Part], half_chord_s: float) -> None:
    """Over reduced frequency; `half_chord_s`: c/2V."""
    k = np.geomspace(5e-3, 2.0, DRAWN)
    panel.plot(k, sears_magnitude(k), color=INK, lw=1.0, label="Sears")
    panel.plot(k, np.abs(theodorsen(k)), color=GREEN, lw=1.0, label="Theodorsen")
    for part in shown:
        if part.spectra:
            reduced = 2 * math.pi * part.spectra.frequencies_hz * half_chord_s
            _points(panel, part, reduced, part.spectra.sears, part.spectra.sears_sd)
    panel.set_xscale("log")
    panel.set_ylim(0, 1.6)
    panel.set_title("|S_G|, response of the lift", fontsize=10, loc="left")
    panel.legend(fontsize=8, frameon=False, ncols=2)
    _plain(panel, "k = ωc/2V")


def _corrections(panel: Panel, shown: Sequence[Part], record: FlightRecord, speed: float) -> None:
    boom = record.aircraft.boom
    steady = boom.upwash_body + boom.upwash_wing if boom else 0.0
    f = np.geomspace(0.05, 10.0, DRAWN)
    k = math.pi * f * record.aircraft.geometry.chord / speed
    panel.plot(f, 1 / (1 + steady * sears_magnitude(k)), color=INK, lw=1.0, label="by Sears")
    panel.axhline(1 / (1 + steady), color=INK, lw=0.8, ls="--", label="steady")
    for part in shown:
        if part.spectra:
            s = part.spectra
            upwash_sd = s.upwash * s.sears_sd / np.maximum(s.sears, 1e-12)
            _points(panel, part, s.frequencies_hz, 1 / (1 + s.upwash), upwash_sd / (1 + s.upwash) ** 2)
    panel.set_xscale("log")
    panel.set_ylim(0.6, 1.05)
    panel.set_title("1/(1 + k_u), correction of the upwash", fontsize=10, loc="left")
    panel.legend(fontsize=8, frameon=False, ncols=2)
    _plain(panel, "frequency, Hz")


def _elevators(panel: Panel, shown: Sequence[Part]) -> None:
    square = from_si(1.0, "deg") ** 2
    for part in shown:
        if part.elevator is not None:
            bins, colour = part.elevator, COLOURS[part.name]
            low, high = bins.band(bins.xx)
            panel.fill_between(bins.frequencies_hz, low * square, high * square, color=colour, alpha=0.25, lw=0)
            panel.plot(bins.frequencies_hz, bins.xx * square, color=colour, lw=1.0, label=part.name)
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_title("density of the elevator, deg²/Hz", fontsize=10, loc="left")
    panel.legend(fontsize=8, frameon=False)
    _plain(panel, "frequency, Hz")

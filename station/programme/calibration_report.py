"""A calibration as a page: constants, position error over speed, the vane over angle of attack, wind, manoeuvres."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from station.identification.html_page import BLUE, FAINT, INK, ORANGE, image, text, without_frame, write_page
from station.model.vane_in_motion import KEPT_HZ
from station.numerics.random_effects import NORMAL_95
from station.programme.calibration import Calibration, Constant
from station.programme.calibration_listing import WORDS, interval_of, named, shown, unit_of, value_of

Array = NDArray[np.float64]

FILE_NAME: Final = "calibration.html"
QUOTED: Final = ("airspeed_error", "vane_zero", "upwash", "vane_delay")
"""Constants in the sentence: what a calibration flight is flown for; all are in the table."""


def write_report(made: Calibration, folder: Path) -> Path:
    """Write calibration.html into `folder`; returns its path. Raises LogError if it cannot be written."""
    logs = ", ".join(p.name for p in made.logs)
    body = [
        f"<h1>{text(made.aircraft.name)}: calibration flight</h1>",
        f'<p class="verdict">{text(answer(made))}</p>',
        _constants(made),
        "<h2>Position error</h2>",
        _position_error(made),
        '<p class="note">Airspeed shown less true airspeed, by GNSS velocity less wind; each point a block of four '
        "seconds, its scatter gusts along the path. Triangles: steady runs, pointing where they were headed, north up. "
        "Band: 95 %.</p>",
        *_static(made),
        f'<p class="note">Recordings: {text(logs)}</p>',
        *(f'<p class="note">{text(r)}</p>' for r in made.remarks),
        "<h2>Vane</h2>",
        _vane(made),
        '<p class="note">Vane, pitch rate taken out, over the angle of attack of the path; left: with the line found, '
        "right: what is left of it. Gusts scatter the path's angle, not the vane's.</p>",
        "<h2>Wind</h2>",
        _wind(made),
        f'<p class="note">With 95 %. It walks by {made.steady.walk:g} m/s in a minute, the likeliest of those tried.'
        "</p>",
        *_motion(made),
        "<h2>Runs</h2>",
        _runs(made),
    ]
    return write_page(f"Calibration: {made.aircraft.name}", body, folder / FILE_NAME)


def answer(made: Calibration) -> str:
    """One sentence to quote: position error, vane zero, upwash and lag with 95 %, and which are not told."""
    wanted = [made.constants[n] for n in QUOTED if n in made.constants]
    air = [_said(made, c) for c in wanted if c.is_told and c.name == "airspeed_error"]
    vane = [_said(made, c) for c in wanted if c.is_told and c.name != "airspeed_error"]
    parts = [f"the airspeed of {made.aircraft.name} {words}" for words in air]
    if vane:
        whose = "its alpha vane" if air else f"the alpha vane of {made.aircraft.name}"
        parts.append(f"{whose} {' and '.join([', '.join(vane[:-1]), vane[-1]] if vane[1:] else vane)}")
    lost = [named(made, c) for c in wanted if not c.is_told]
    low, high = made.speeds
    said = "; ".join(parts) or f"nothing of {made.aircraft.name} could be calibrated"
    missing = f"; NOT calibrated: {', '.join(lost)}" if lost else ""
    return f"{said[0].upper()}{said[1:]} (± 95 %; flown at {low:.0f} to {high:.0f} m/s){missing}."


def _said(made: Calibration, c: Constant) -> str:
    """A constant in words, with the half of its 95 % interval."""
    half = shown(c, NORMAL_95 * c.sd)
    digits = max(0, 1 - math.floor(math.log10(half))) if 0 < half < math.inf else 3
    value = shown(c, c.value)
    above = round(value, digits) >= 0
    size = f"{abs(value):.{digits}f} ± {half:.{digits}f}"
    return {
        "airspeed_error": f"reads {size} m/s {'high' if above else 'low'} at {made.steady.speed:.0f} m/s",
        "vane_zero": f"reads {size} deg {'high' if above else 'low'}",
        "upwash": f"turns by {1 + value:.{digits}f} ± {half:.{digits}f} deg for each degree of the flow",
        "vane_delay": f"is {size} ms {'late' if above else 'early'}",
    }[c.name]


def _constants(made: Calibration) -> str:
    rows = []
    for name in (n for n in WORDS if n in made.constants):
        c = made.constants[name]
        told = f"<td>{value_of(c)}</td><td>{interval_of(c)}</td>" if c.is_told else "<td>not told</td><td></td>"
        words = f"<td class='words'>{text(c.why or c.key)}</td>"
        kind = "" if c.is_told else " class='faint'"
        rows.append(
            f"<tr{kind}><td class='words'>{text(named(made, c))}</td>{told}<td>{text(unit_of(c))}</td>"
            f"<td>{shown(c, c.before):+.3g}</td>{words}</tr>"
        )
    head = "".join(f"<th>{h}</th>" for h in ("", "value ± sd", "95 %", "unit", "profile"))
    head += "<th class='words'>key of the profile</th>"
    return f'<div class="wide"><table><tr>{head}</tr>{"".join(rows)}</table></div>'


def _figure(height: float) -> Figure:
    return Figure(figsize=(10, height), layout="constrained", dpi=120)


def _position_error(made: Calibration) -> str:
    steady, columns = made.steady, made.flown.blocks.columns
    figure = _figure(3.6)
    panel = figure.subplots()
    v = steady.flow["speed"]
    way = np.arctan2(columns["v_east"] - steady.wind[:, 1], columns["v_north"] - steady.wind[:, 0])
    for kind, colour in (("steady", INK), ("turn", BLUE), ("input", ORANGE)):
        rows = _rows(made, kind)
        panel.plot(v[rows], (columns["airspeed"] - v)[rows], ".", color=colour, ms=4, label=kind)
    for run in (r for r in made.runs if r.kind == "steady"):
        middle = float(v[run.rows].mean())
        above = float((columns["airspeed"] - v)[run.rows].mean())
        heading = math.degrees(math.atan2(np.sin(way[run.rows]).mean(), np.cos(way[run.rows]).mean()))
        panel.plot(middle, above, marker=(3, 0, -heading), mfc="none", mec=INK, ms=11, ls="")
    line = np.linspace(*made.speeds, 50)
    error, sd = steady.error_at(line)
    panel.plot(line, error, color=ORANGE)
    panel.fill_between(line, error - NORMAL_95 * sd, error + NORMAL_95 * sd, color=ORANGE, alpha=0.2, lw=0)
    panel.set_xlabel("true airspeed, m/s", loc="right")
    panel.set_ylabel("shown - true, m/s")
    panel.legend(frameon=False, fontsize=8)
    without_frame(panel, "top", "right")
    return image(figure, "Position error of the airspeed over true airspeed, with its 95 % band and the blocks")


def _static(made: Calibration) -> Iterator[str]:
    port = made.static
    if port is None:
        return
    figure = _figure(2.6)
    panel = figure.subplots()
    panel.plot(port.dynamic_pressure, port.shown_less, ".", color=INK, ms=4)
    line = np.linspace(port.dynamic_pressure.min(), port.dynamic_pressure.max(), 2)
    panel.plot(line, port.error * line, color=ORANGE)
    for side in (-NORMAL_95, NORMAL_95):
        panel.plot(line, (port.error + side * port.sd) * line, color=ORANGE, lw=0.6)
    panel.set_xlabel("dynamic pressure, Pa", loc="right")
    panel.set_ylabel("shown - true, Pa")
    without_frame(panel, "top", "right")
    yield image(figure, "Static pressure shown less that of the height, over dynamic pressure, and the line found")
    yield (
        '<p class="note">Static pressure, by GNSS altitude; the constant part is the day\'s. Lines: found, and 95 %. '
        "What the pitot errs by is the rest of the airspeed's error.</p>"
    )


def _rows(made: Calibration, kind: str) -> NDArray[np.bool_]:
    found = np.zeros(len(made.flown.blocks.time), dtype=bool)
    for run in made.runs:
        found[run.rows] |= run.kind == kind
    return found


def _vane(made: Calibration) -> str:
    steady, columns = made.steady, made.flown.blocks.columns
    upwash = steady.value("upwash")
    body = upwash - steady.value("upwash_wing")
    lever = (1 + body) * columns["q"] * steady.value("vane_x") / steady.flow["speed"]
    alpha = np.degrees(steady.flow["alpha"])
    vane = np.degrees(columns["alpha_vane"] + lever)
    by_vane = (vane - math.degrees(steady.value("vane_zero"))) / (1 + upwash)
    figure = _figure(3.6)
    over, left = figure.subplots(1, 2)
    for kind, colour in (("steady", INK), ("turn", BLUE)):
        rows = _rows(made, kind)
        over.plot(alpha[rows], vane[rows], ".", color=colour, ms=4, label=kind)
        left.plot(by_vane[rows], -np.degrees(steady.left["alpha_vane"][rows]), ".", color=colour, ms=4)
    line = np.array([alpha.min(), alpha.max()])
    over.plot(line, math.degrees(steady.value("vane_zero")) + (1 + upwash) * line, color=ORANGE, lw=1)
    left.axhline(0, color=FAINT, lw=0.8)
    over.set_ylabel("vane, deg")
    left.set_ylabel("path's angle left over, deg")
    over.legend(frameon=False, fontsize=8)
    for panel in (over, left):
        panel.set_xlabel("angle of attack, deg", loc="right")
        without_frame(panel, "top", "right")
    return image(figure, "Vane over the angle of attack of the path, and what is left of the line")


def _wind(made: Calibration) -> str:
    steady, t = made.steady, made.flown.blocks.time
    figure = _figure(2.6)
    panel = figure.subplots()
    for i, (name, colour) in enumerate((("towards the north", BLUE), ("towards the east", ORANGE))):
        x, sd = steady.wind[:, i], NORMAL_95 * steady.wind_sd[:, i]
        panel.plot(t, x, color=colour, label=name)
        panel.fill_between(t, x - sd, x + sd, color=colour, alpha=0.2, lw=0)
    panel.set_xlabel("time, s", loc="right")
    panel.set_ylabel("m/s")
    panel.legend(frameon=False, fontsize=8)
    without_frame(panel, "top", "right")
    return image(figure, "Wind north and east over the flight, with 95 %")


def _motion(made: Calibration) -> Iterator[str]:
    yield "<h2>Vane in manoeuvres</h2>"
    motion = made.motion
    if motion is None:
        yield f"<p>{text(made.motion_why)}</p>"
        return
    count = len(motion.measured)
    figure = _figure(1.6 * count + 0.6)
    for panel, seen, made_of in zip(
        np.atleast_1d(figure.subplots(count, 1)), motion.measured, motion.expected, strict=True
    ):
        t = np.arange(len(seen)) / KEPT_HZ
        panel.plot(t, np.degrees(seen), color=INK, lw=0.8, label="vane")
        panel.plot(t, np.degrees(made_of), color=ORANGE, lw=0.8, label="by the motion")
        panel.set_ylabel("deg")
        without_frame(panel, "top", "right")
    panel.set_xlabel("time, s", loc="right")
    panel.legend(frameon=False, fontsize=8, ncols=2)
    yield image(figure, "Vane in manoeuvres, and what the motion makes it show with lag, place and upwash found")
    yield (
        f'<p class="note">0.15 to 2.5 Hz; {motion.seconds:.0f} s, of whose motion the elevator made '
        f"{motion.forced:.0%}; left over: {math.degrees(motion.rms):.3f} deg rms.</p>"
    )


def _runs(made: Calibration) -> str:
    steady, rows = made.steady, []
    shown_less = made.flown.blocks.columns["airspeed"] - steady.flow["speed"]
    for r in made.runs:
        heading = f"{math.degrees(r.heading) % 360:.0f}" if math.isfinite(r.heading) else "–"
        mass = f"{r.mass:.0f}" if math.isfinite(r.mass) else "–"
        left = steady.left["alpha_vane"][r.rows]
        angle = f"{-math.degrees(float(np.nanmean(left))):+.2f}" if np.isfinite(left).any() else "–"
        bank, error = f"{round(math.degrees(r.bank)):+d}", f"{float(shown_less[r.rows].mean()):+.2f}"
        cells = (r.log, r.kind, f"{round(r.start_s)}–{round(r.end_s)}", f"{r.speed:.1f}", heading, bank, mass, error,
                 angle)  # fmt: skip
        rows.append("<tr>" + "".join(f"<td>{text(c)}</td>" for c in cells) + "</tr>")
    head = "".join(
        f"<th>{h}</th>"
        for h in ("recording", "run", "s", "airspeed, m/s", "track, °", "bank, °", "mass, kg", "shown - true, m/s",
                  "angle left, °")
    )  # fmt: skip
    return f'<div class="wide"><table><tr>{head}</tr>{"".join(rows)}</table></div>'

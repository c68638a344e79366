"""The report's sections on instruments and input: vane calibration, reconstruction, gust arrival, next input."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.identification.advice import NextInput, SiftedMethod
from station.identification.html_page import image, text
from station.identification.identification_json import RANKED
from station.identification.identified import Identification
from station.identification.kinematic_results import (
    VANE_UNITS,
    arrival_by_profile,
    disagreement,
    vane_assumptions,
    vane_by_profile,
    vane_method,
    vane_parameters,
)
from station.identification.kinematics import Kinematics
from station.identification.model_structure import Comparison
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

_MEASURED, _TRUE, _AFTER = "#a9b0bd", "#1f2430", "#d55e00"
_POINTS: Final = 1500
_SHOWN: Final = {"rad": (180 / math.pi, "deg"), "s": (1e3, "ms"), "rad/s": (180 / math.pi, "deg/s")}
_UNITS: Final = {"p": "rad/s", "q": "rad/s", "r": "rad/s", "ax": "m/s2", "ay": "m/s2", "az": "m/s2"}
_DIGITS: Final = 4
"""Decimals of a number without an error."""


def kinematic_pages(made: Kinematics, record: FlightRecord) -> list[str]:
    """HTML of the sections that need no aerodynamics: vane calibration, data compatibility, gust arrival."""
    return [*_vane(made, record), *_reconstruction(made, record), *_arrival(made, record)]


def input_pages(found: Identification) -> list[str]:
    """HTML of the sections on model structure and input, of those that the identification has."""
    return [*_structures(found.structures), *_sifted(found.sifted), *_next_input(found.next_input)]


def _refused(head: str, why: str) -> list[str]:
    return [f"<h2>{head}</h2>", f"<p>Not available: {text(why)}.</p>"]


def _vane(made: Kinematics, record: FlightRecord) -> list[str]:
    head, part = "Vane against the inertial angle of attack", made.vane
    if isinstance(part, str):
        return _refused(head, part)
    rows = made.rows
    reading = record.motion["alpha_vane"][rows]
    t, step = record.t_s[rows], max(1, (rows.stop - rows.start) // _POINTS)
    figure = Figure(figsize=(10, 3.2), layout="constrained", dpi=120)
    panels = figure.subplots(1, 3, gridspec_kw={"width_ratios": [3, 3, 2]})
    titles = ("vane as measured, deg", "vane calibrated, deg")
    for axes, series, title in zip(panels[:2], (reading, part.corrected), titles, strict=True):
        axes.plot(t[::step], np.degrees(series[::step]), color=_AFTER, lw=0.9, label="vane")
        axes.plot(t[::step], np.degrees(part.expected[::step]), color=_TRUE, lw=0.9, label="inertial")
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xlabel("time, s", fontsize=8, loc="right")
        axes.legend(fontsize=8, frameon=False)
    expected = np.degrees(part.expected[::step])
    panels[2].plot(expected, np.degrees(reading[::step]), ".", ms=1.5, color=_MEASURED, label="as measured")
    panels[2].plot(expected, np.degrees(part.corrected[::step]), ".", ms=1.5, color=_AFTER, label="calibrated")
    panels[2].axline((float(expected[0]), float(expected[0])), slope=1, color=_TRUE, lw=0.8)
    panels[2].set_title("vane over inertial, deg", fontsize=10, loc="left")
    panels[2].legend(fontsize=8, frameon=False, markerscale=4)
    _plain(panels)
    profile = vane_by_profile(record.aircraft)
    lines = []
    for p in vane_parameters(part):
        known, unit = profile.get(p.name), VANE_UNITS[p.name]
        lines.append(_line(p, unit, "–" if known is None else _plain_value(known, unit)))
    before, after = math.degrees(part.rms_before), math.degrees(part.rms_after)
    notes = [
        f"Estimate ± standard error, {vane_method(part)}",
        f"Assumed: {', '.join(vane_assumptions(record.aircraft))}",
    ]
    notes += [f"Not estimated: {why}" for why in sorted({p.why for p in vane_parameters(part) if p.why})]
    return [
        f"<h2>{head}</h2>",
        image(figure, "Vane reading and the flow angle from the inertial motion, before and after calibration"),
        f"<table><tr><th>vane</th><th>estimate</th><th>profile</th></tr>{''.join(lines)}"
        f"<tr><td>rms difference</td><td>{before:.2f} deg as measured, {after:.2f} deg calibrated</td><td></td></tr>"
        "</table>",
        f'<p class="note">{text(". ".join(notes))}.</p>',
    ]


def _reconstruction(made: Kinematics, record: FlightRecord) -> list[str]:
    head, part = "Data compatibility", made.compatibility
    if isinstance(part, str):
        return _refused(head, part)
    shown = [n for n in ("alpha", "beta", "airspeed", "theta") if n in part.reconstructed]
    t = record.t_s[made.closed]
    step = max(1, len(t) // _POINTS)
    figure = Figure(figsize=(10, 1.0 + 1.5 * len(shown)), layout="constrained", dpi=120)
    panels = figure.subplots(len(shown), 1, squeeze=False, sharex=True)[:, 0]
    for axes, name in zip(panels, shown, strict=True):
        factor, unit = (1.0, "m/s") if name == "airspeed" else (180 / math.pi, "deg")
        axes.plot(t[::step], factor * part.corrected[name][::step], color=_AFTER, lw=0.9, label="measured, corrected")
        axes.plot(t[::step], factor * part.reconstructed[name][::step], color=_TRUE, lw=0.9, label="reconstructed")
        axes.set_title(f"{name}, {unit}", fontsize=10, loc="left")
    panels[0].legend(fontsize=8, frameon=False, ncols=2)
    panels[-1].set_xlabel("time, s", fontsize=8, loc="right")
    _plain(panels)
    lines = []
    for p in part.parameters:
        of, _, kind = p.name.rpartition("_")
        unit = "1" if kind == "scale" else "m/s" if of == "wind" else _UNITS.get(of, "rad")
        lines.append(_line(p, unit, text(p.why)))
    return [
        f"<h2>{head}</h2>",
        image(figure, "Measured and reconstructed air data and pitch attitude"),
        f"<table><tr><th>instrument error</th><th>estimate</th><th></th></tr>{''.join(lines)}</table>",
        '<p class="note">Reconstructed by integrating rates and accelerations. Estimate ± standard error; grey: not '
        "estimated, though the pictures show what is measured corrected by all of them.</p>",
    ]


def _arrival(made: Kinematics, record: FlightRecord) -> list[str]:
    head, part = "Gust arrival offset: vane before the CG", made.delay
    if isinstance(part, str):
        return _refused(head, part)
    lines = []
    for name, one in (("both", part.joint), *part.apart.items()):
        values = (
            _pair(one.delay_s, one.delay_sd, "s"),
            _pair(one.distance_m, one.distance_sd, "m"),
            _pair(one.upwash, one.upwash_sd, "1"),
        )
        cells = "".join(f"<td>{value}</td>" for value in values)
        lines.append(f"<tr><td>{text(name)}</td>{cells}</tr>")
    stated = arrival_by_profile(part, record.aircraft)
    if stated is not None:
        lines.append(
            f'<tr class="faint"><td>profile</td><td>{1e3 * stated.delay_s:.1f} ms</td>'
            f"<td>{stated.delay_s * part.speed:.2f} m</td><td>{stated.upwash:.3f}</td></tr>"
        )
    verdict = "Lift and moment give the same delay." if part.agree else f"{disagreement(part).capitalize()}."
    return [
        f"<h2>{head}</h2>",
        "<table><tr><th>equation</th><th>delay</th><th>distance</th><th>upwash k_u0</th></tr>"
        f"{''.join(lines)}</table><p>{text(verdict)}</p>",
    ]


def _structures(found: Mapping[str, Comparison] | str | None) -> list[str]:
    head = "Model structure: one angle of attack, or motion and gust apart?"
    if not found:
        return []
    if isinstance(found, str):
        return _refused(head, found)
    lines = []
    for equation, compared in found.items():
        for name, made in compared.structures.items():
            tests = "; ".join(f"{p:.2g} against {other}" for other, p in made.p_values.items()) or "–"
            chosen = ' class="chosen"' if name == compared.preferred else ""
            regressors = ", ".join(made.estimate)
            lines.append(
                f"<tr{chosen}><td>{text(equation)}: {text(name)}</td><td>{text(regressors)}</td>"
                f"<td>{made.residual:.3f}</td><td>{made.held_out:.3f}</td><td>{text(tests)}</td></tr>"
            )
    return [
        f"<h2>{head}</h2>",
        '<div class="wide"><table><tr><th>structure</th><th>regressors</th><th>residual</th>'
        f"<th>prediction error</th><th>p of the F-test</th></tr>{''.join(lines)}</table></div>",
        '<p class="note">Residual and prediction error over the measured coefficient, rms, 0.1 to 2 Hz; prediction: '
        "fitted to one half, tested on the other. Bold: selected by F-test and prediction. eq65: own slopes for motion "
        "and gust (Martos 2013, equation 65); split+gust: the tail meets the gust later; S5: both.</p>",
    ]


def _sifted(found: Mapping[str, SiftedMethod] | str | None) -> list[str]:
    if not found or isinstance(found, str):
        return []
    lines = []
    for name, made in found.items():
        values = ", ".join(f"{n} {_pair(value, sd, '1')}" for n, (value, sd) in made.parameters.items())
        verdict = "the lines between agree" if made.agree else "the lines between, driven by gusts, differ"
        lines.append(f"<li>{text(f'{name}: {values}; {verdict}')}</li>")
    return ["<h2>From the lines of the multisine alone</h2>", f"<ul>{''.join(lines)}</ul>"]


def _next_input(found: NextInput | str | None) -> list[str]:
    if found is None or isinstance(found, str):
        return []
    rows = "".join(
        f"<tr><td>{text(one.name)}</td><td>{one.relative[found.poorest]:.0%}</td></tr>"
        for one in found.ranking[:RANKED]
    )
    return [
        f"<h2>What to fly next</h2><p>Least well known: {text(found.poorest)}. Elevator inputs of 2 deg over 20 s, the "
        "most informative first, with the error predicted from the profile's short period and the residuals.</p>",
        f"<table><tr><th>input</th><th>2 standard errors of {text(found.poorest)}</th></tr>{rows}</table>",
    ]


def _plain(panels: Any) -> None:
    for axes in panels:
        axes.tick_params(labelsize=8, length=2)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)


def _plain_value(value: float, unit: str) -> str:
    factor, name = _SHOWN.get(unit, (1.0, "" if unit == "1" else unit))
    return f"{factor * value:.4g} {name}".strip()


def _pair(value: float, sd: float, unit: str) -> str:
    if not math.isfinite(sd):
        return "–"
    factor, name = _SHOWN.get(unit, (1.0, "" if unit == "1" else unit))
    error = factor * sd
    digits = max(0, 1 - math.floor(math.log10(error))) if error > 0 else _DIGITS
    return f"{factor * value:.{digits}f} ± {error:.{digits}f} {name}".strip()


def _line(p: ParamEstimate, unit: str, last: str) -> str:
    faint = "" if p.status is Status.ESTIMATED else f' class="faint" title="{text(p.why)}"'
    words = text("bias" if p.name == "zero" else p.name.replace("_", " "))
    return f"<tr><td>{words}</td><td{faint}>{_pair(p.value, p.sd, unit)}</td><td>{last}</td></tr>"

"""The report's pages on instruments: vane before and after calibration, reconstructed angle of attack, gust arrival."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from station.estimation.flight_record import FlightRecord
from station.identification.html_page import image, text
from station.identification.kinematics import Kinematics

Array = NDArray[np.float64]

_MEASURED, _TRUE, _AFTER = "#a9b0bd", "#1f2430", "#d55e00"
_POINTS: Final = 1500
_SHOWN: Final = {"rad": (180 / math.pi, "deg"), "s": (1e3, "ms"), "rad/s": (180 / math.pi, "deg/s")}
_UNITS: Final = {"p": "rad/s", "q": "rad/s", "r": "rad/s", "ax": "m/s2", "ay": "m/s2", "az": "m/s2"}


def instrument_pages(result: Mapping[str, Any], made: Kinematics, record: FlightRecord) -> list[str]:
    """HTML of the sections that `result` has; `made` gives the series."""
    return [
        *_vane(result, made, record),
        *_reconstruction(result, made, record),
        *_delay(result),
        *_structure(result),
        *_advice(result),
    ]


def _vane(result: Mapping[str, Any], made: Kinematics, record: FlightRecord) -> list[str]:
    section = result["vane_calibration"]
    head = "<h2>Vane against the inertial angle of attack</h2>"
    part = made.vane
    if section["status"] != "ok" or isinstance(part, str):
        return [head, f"<p>Not applicable: {text(section['why'])}.</p>"]
    rows = made.rows
    reading = record.motion["alpha_vane"][rows]
    t, step = record.t_s[rows], max(1, (rows.stop - rows.start) // _POINTS)
    figure = Figure(figsize=(10, 3.2), layout="constrained", dpi=120)
    panels = figure.subplots(1, 3, gridspec_kw={"width_ratios": [3, 3, 2]})
    for axes, series, title in ((panels[0], reading, "before"), (panels[1], part.corrected, "after")):
        axes.plot(t[::step], np.degrees(series[::step]), color=_AFTER, lw=0.9, label="vane")
        axes.plot(t[::step], np.degrees(part.expected[::step]), color=_TRUE, lw=0.9, label="motion")
        axes.set_title(f"{title}, deg", fontsize=10, loc="left")
        axes.set_xlabel("s", fontsize=8, loc="right")
        axes.legend(fontsize=8, frameon=False)
    expected = np.degrees(part.expected[::step])
    panels[2].plot(expected, np.degrees(reading[::step]), ".", ms=1.5, color=_MEASURED, label="before")
    panels[2].plot(expected, np.degrees(part.corrected[::step]), ".", ms=1.5, color=_AFTER, label="after")
    panels[2].axline((float(expected[0]), float(expected[0])), slope=1, color=_TRUE, lw=0.8)
    panels[2].set_title("vane over motion, deg", fontsize=10, loc="left")
    panels[2].legend(fontsize=8, frameon=False, markerscale=4)
    _plain(panels)
    lines = []
    profile = section.get("profile", {})
    for name, p in section["parameters"].items():
        known = profile.get(name)
        unit = section["units"][name]
        lines.append(_line(name, p, unit, "–" if known is None else _plain_value(known, unit)))
    before, after = (math.degrees(section[f"rms_{when}_rad"]) for when in ("before", "after"))
    notes = [f"{section['method']}; assumed: {', '.join(section['assumes'])}"]
    notes += sorted({p["why"] for p in section["parameters"].values() if p["why"]})
    return [
        head,
        image(figure, "Vane reading and the flow angle of the motion, before and after calibration"),
        f"<table><tr><th>vane</th><th>estimate</th><th>profile</th></tr>{''.join(lines)}"
        f"<tr><td>rms difference</td><td>{before:.2f} deg before, {after:.2f} deg after</td><td></td></tr></table>",
        f'<p class="note">{text("; ".join(notes))}.</p>',
    ]


def _reconstruction(result: Mapping[str, Any], made: Kinematics, record: FlightRecord) -> list[str]:
    section = result["compatibility"]
    head = "<h2>Data compatibility</h2>"
    part = made.compatibility
    if section["status"] != "ok" or isinstance(part, str):
        return [head, f"<p>Not applicable: {text(section['why'])}.</p>"]
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
    _plain(panels)
    lines = []
    for name, p in section["parameters"].items():
        of, _, kind = name.rpartition("_")
        unit = "1" if kind == "scale" else "m/s" if of == "wind" else _UNITS.get(of, "rad")
        lines.append(_line(name, p, unit, text(p["why"])))
    return [
        head,
        image(figure, "Measured and reconstructed air data and pitch"),
        f"<table><tr><th>instrument</th><th>estimate</th><th></th></tr>{''.join(lines)}</table>",
        '<p class="note">Reconstructed from rates and accelerations alone; estimate ± standard error.</p>',
    ]


def _delay(result: Mapping[str, Any]) -> list[str]:
    section = result["gust_delay"]
    head = "<h2>Arrival of gusts</h2>"
    if section["status"] != "ok":
        return [head, f"<p>Not applicable: {text(section['why'])}.</p>"]
    rows = [("both", section["parameters"]), *section["by_equation"].items()]
    lines = []
    for name, lead in rows:
        cells = "".join(
            f"<td>{_pair(lead[what], unit)}</td>" for what, unit in (("delay", "s"), ("distance", "m"), ("upwash", "1"))
        )
        lines.append(f"<tr><td>{text(name)}</td>{cells}</tr>")
    profile = section.get("profile")
    if profile:
        distance = profile["delay"] * section["speed_mps"]
        lines.append(
            f'<tr class="faint"><td>profile</td><td>{1e3 * profile["delay"]:.1f} ms</td><td>{distance:.2f} m</td>'
            f"<td>{profile['upwash']:.3f}</td></tr>"
        )
    verdict = "Lift and moment ask for the same delay." if section["equations_agree"] else f"{section['meaning']}."
    return [
        head,
        "<table><tr><th>equation</th><th>vane before CG</th><th>distance</th><th>upwash k_u0</th></tr>"
        f"{''.join(lines)}</table><p>{text(verdict)}</p>",
    ]


def _structure(result: Mapping[str, Any]) -> list[str]:
    section = result.get("model_structure")
    if section is None:
        return []
    head = "<h2>Motion and gust: one angle of attack or two?</h2>"
    if section["status"] != "ok":
        return [head, f"<p>Not applicable: {text(section['why'])}.</p>"]
    lines = []
    for equation, found in section["equations"].items():
        for name, made in found["structures"].items():
            tests = "; ".join(f"{p:.2g} against {other}" for other, p in made["p_values"].items()) or "–"
            chosen = ' class="chosen"' if name == found["preferred"] else ""
            regressors = ", ".join(made["parameters"])
            lines.append(
                f"<tr{chosen}><td>{text(equation)}: {text(name)}</td><td>{text(regressors)}</td>"
                f"<td>{made['residual']:.3f}</td><td>{made['held_out']:.3f}</td><td>{text(tests)}</td></tr>"
            )
    return [
        head,
        '<div style="overflow-x:auto"><table><tr><th>structure</th><th>regressors</th><th>residual</th>'
        f"<th>predicted half</th><th>p of the F-test</th></tr>{''.join(lines)}</table></div>",
        '<p class="note">Residual over measured, 0.1 to 2 Hz; bold is what F-test and prediction prefer.</p>',
    ]


def _advice(result: Mapping[str, Any]) -> list[str]:
    parts = []
    sifted = result.get("sifted", {})
    if sifted.get("status") == "ok":
        lines = []
        for name, found in sifted["methods"].items():
            values = ", ".join(f"{n} {_pair(p, '1')}" for n, p in found["parameters"].items())
            verdict = "the lines between agree" if found["agree"] else "the lines between tell otherwise"
            lines.append(f"<li>{text(f'{name}: {values}; {verdict}')}</li>")
        parts += ["<h2>Lines of the multisine alone</h2>", f"<ul>{''.join(lines)}</ul>"]
    advice = result.get("next_input", {})
    if advice.get("status") == "ok":
        rows = "".join(
            f"<tr><td>{text(one['input'])}</td><td>{one['predicted_relative_2sd']:.0%}</td></tr>"
            for one in advice["ranking"]
        )
        parts += [
            f"<h2>What to fly next</h2><p>Known worst: {text(advice['poorest'])}. Elevator inputs of 2 deg "
            "and 20 s, the best for it first, with the two standard errors they should leave of it.</p>",
            f"<table><tr><th>input</th><th>2 σ of it</th></tr>{rows}</table>",
        ]
    return parts


def _plain(panels: Any) -> None:
    for axes in panels:
        axes.tick_params(labelsize=8, length=2)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)


def _plain_value(value: float, unit: str) -> str:
    factor, name = _SHOWN.get(unit, (1.0, "" if unit == "1" else unit))
    return f"{factor * value:.4g} {name}".strip()


def _pair(p: Mapping[str, Any], unit: str) -> str:
    if p["estimate"] is None:
        return "–"
    factor, name = _SHOWN.get(unit, (1.0, "" if unit == "1" else unit))
    error = factor * p["std_error"]
    digits = max(0, 1 - math.floor(math.log10(error))) if error > 0 else 4
    return f"{factor * p['estimate']:.{digits}f} ± {error:.{digits}f} {name}".strip()


def _line(name: str, p: Mapping[str, Any], unit: str, last: str) -> str:
    faint = "" if p["status"] == "estimated" else f' class="faint" title="{text(p["why"])}"'
    words = text(name.replace("_", " "))
    return f"<tr><td>{words}</td><td{faint}>{_pair(p, unit)}</td><td>{last}</td></tr>"

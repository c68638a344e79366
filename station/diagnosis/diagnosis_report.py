"""The diagnosis report: one HTML file with its figures inside."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from station.conventions import SIGNALS, from_si
from station.diagnosis.effects import BY_ID
from station.diagnosis.model_error import GUST
from station.diagnosis.pictures import (
    MEANING,
    by_record,
    measured_and_predicted,
    reductions,
    spectra_before_and_after,
    times,
)
from station.diagnosis.procedure import Diagnosis
from station.diagnosis.search import FIRST
from station.identification.html_page import image, text, write_page
from station.profile import Aircraft

FILE_NAME: Final = "diagnosis.html"
_VERDICT: Final = {
    "no_effect": "Nothing found: the measured flight agrees with the simulation within noise and gusts.",
    "effect_found": "Found what is different, and nothing else could be it.",
    "confounded": "Found what is different, but these manoeuvres cannot tell it from something else.",
    "unexplained": "Something is different that no effect of the catalogue explains. Effects named below are suspect.",
}

_VERDICT_WITH_ERROR: Final = {
    "no_effect": "The aircraft's model does not suffice; no instrument is at fault.",
    "effect_found": "The aircraft's model does not suffice; what is named below stands in spite of that.",
    "confounded": "The aircraft's model does not suffice, and these manoeuvres cannot tell all causes apart.",
    "unexplained": _VERDICT["unexplained"],
}
"""The same where the model itself is in doubt."""


def write_report(found: Diagnosis, result: Mapping[str, Any], folder: Path) -> Path:
    """Write the page into `folder` as diagnosis.html; returns its path. Raises LogError if it cannot be written."""
    before, after = found.before, found.after
    body = [
        f"<h1>{text(result['aircraft'])}: measured against simulated</h1>",
        f'<p class="verdict">{(_VERDICT if found.with_error is None else _VERDICT_WITH_ERROR)[found.verdict]}</p>',
        effects_table(result),
        _left(result),
        _model_error(result["with_model_error"]),
        _next(found),
        _gain(result),
        image(by_record(found, before, after), "error of each manoeuvre before and after") if result["effects"] else "",
        "<h2>What differs, by instrument and model</h2>",
        image(spectra_before_and_after(found, before, after), "spectra of each series before and after"),
        _residuals(result),
        "<h2>In time</h2>",
        image(
            measured_and_predicted(found, before, after),
            "measured, and predicted before and after",
        )
        if result["effects"]
        else "",
        image(times(found, before, after), "each series over time before and after"),
        "<h2>What was checked</h2>",
        image(reductions(found), "how much each effect alone would explain"),
        _checked(result),
        _derivatives(result, found.problem.aircraft),
        _settings(result),
    ]
    return write_page(f"Diagnosis: {result['aircraft']}", body, folder / FILE_NAME)


# --- words and tables


def _shown(name: str, value: float, unit: str = "1") -> str:
    term = BY_ID.get(name)
    shown = term.shown if term else unit
    return f"{from_si(value, shown):.3g}{'' if shown == '1' else f' {shown}'}"


def effects_table(result: Mapping[str, Any]) -> str:
    """The effects of a result, with values and intervals; nothing where there are none."""
    if not result["effects"]:
        return ""
    rows = []
    for e in result["effects"]:
        low, high = e["ci95"]
        reduction, unit = e["evidence"]["drop"], e.get("shown", e["unit"])
        evidence = "seen at once" if reduction is None else f"{reduction:.1f}"
        alternatives = f"Could also be {', '.join(e['confounded_with'])}." if e["confounded_with"] else ""
        suspect = " (suspect)" if e["suspect"] else ""
        rows.append(
            f"<tr><td>{text(e['id'])}{suspect}</td><td class='words'>{text(e['sentence'])} {text(alternatives)}</td>"
            f"<td>{_shown(e['id'], e['value'], unit)}</td>"
            f"<td>{_shown(e['id'], low, unit)} to {_shown(e['id'], high, unit)}</td>"
            f"<td>{evidence}</td></tr>"
        )
    head = "<tr><th>effect</th><th class='words'>in words</th><th>value</th><th>95 %</th><th>evidence</th></tr>"
    note = f"Evidence is the drop of -2 log likelihood; {FIRST:g} is asked of a first effect."
    return f'<h2>Effects</h2><table>{head}{"".join(rows)}</table><p class="note">{note}</p>'


def _left(result: Mapping[str, Any]) -> str:
    left = result["unexplained"]
    if not left["present"]:
        return ""
    low, high = left["band_hz"]
    like = f", in step with {left['like']}" if left["like"] else ""
    where = f"{text(', '.join(left['signals']))} from {low:.2f} to {high:.2f} Hz{text(like)}"
    numbers = f"log p {left['log_p']:.1f} (limit {left['log_p_limit']:.1f}), coherence {left['score']:.1f} "
    return (
        f"<h2>Unexplained</h2><p>What is left has structure: {where}.</p>"
        f'<p class="note">{numbers}(limit {left["score_limit"]:.1f}).</p>'
    )


def _model_error(found: Mapping[str, Any] | None) -> str:
    """What was allowed for, where the model is in doubt."""
    if found is None:
        return ""
    missed = ", ".join(f"{100 * v:.0f} % of {n}" for n, v in found["missed"].items())
    words = " ".join(e["sentence"] for e in found["with_the_model_taken_for_right"])
    return (
        "<h2>The model in doubt</h2><p>The aircraft's model does not suffice. Its derivatives and terms were freed, "
        f"and what it still misses ({text(missed)}) was taken as noise. Instruments "
        "are named only where they contradict each other, without any aerodynamics.</p>"
        + (f'<p class="note">With the model taken for right: {text(words)}</p>' if words else "")
    )


def _next(found: Diagnosis) -> str:
    advice = [
        f"{e.term.id} or {', '.join(e.alternatives)}: {e.term.separate_by}." for e in found.effects if e.alternatives
    ]
    if found.remaining.present:
        advice.append(
            f"Unexplained in {found.remaining.series}: repeat the manoeuvre in calm air, at another amplitude and "
            "at another speed: what follows time, distance, amplitude or load tells what it is."
        )
    if not any(r.setting.gusty for r in found.problem.references) and GUST not in [e.term for e in found.effects]:
        advice.append("The gust path was not judged: all of this was calm. One manoeuvre in turbulence shows it.")
    lines = "".join(f"<li>{text(a)}</li>" for a in advice)
    return f"<h2>What to fly or check next</h2><ul>{lines}</ul>" if advice else ""


def _first_upper(words: str) -> str:
    return words[:1].upper() + words[1:]


def _gain(result: Mapping[str, Any]) -> str:
    gain = result["gain"]
    if gain is None:
        why = "nothing was accepted" if not result["effects"] else "no manoeuvre was held out"
        return f'<h2>Gain</h2><p class="note">Not measured: {why}.</p>'
    low, high = gain["ci95"]
    rows = "".join(
        f"<tr><td>{text(r['record'])}</td><td>{r['before']:.3f}</td><td>{r['after']:.3f}</td></tr>"
        for r in gain["by_record"]
    )
    return (
        f"<h2>Gain</h2><p>Held-out error {gain['before']:.3f} &rarr; {gain['after']:.3f}: "
        f"{gain['reduction_percent']:.1f} % less (95 %: {low:.1f} to {high:.1f} %), "
        "for manoeuvres and air of this kind.</p>"
        f"<table><tr><th>held out</th><th>before</th><th>after</th></tr>{rows}</table>"
        '<p class="note">In standard deviations of the noise and gust allowed for: at 1, or below, nothing is left to '
        "gain.</p>"
    )


def _residuals(result: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{text(name)}</td><td class='words'>{MEANING[name][0]}</td><td>{r['rms_before']:.2f}</td>"
        f"<td>{r['rms_after']:.2f}</td><td>{'yes' if r['white'] else 'no'}</td></tr>"
        for name, r in result["residuals"].items()
    )
    head = "<tr><th>series</th><th class='words'>is</th><th>before</th><th>after</th><th>as expected</th></tr>"
    return (
        f"<table>{head}{rows}</table>"
        '<p class="note">Over the noise of the sensors in calm air; gusts raise the vane and drag.</p>'
    )


def _checked(result: Mapping[str, Any]) -> str:
    sizes = {x["id"]: x for x in result["detectable"]}
    rows = ""
    for x in result["excluded"]:
        size = sizes.get(x["id"])
        reported = ("–", "–") if size is None else (_shown(x["id"], size["size"]), _shown(x["id"], size["size_named"]))
        rows += f"<tr><td>{text(x['id'])}</td><td>{_shown(x['id'], x['value'])}</td><td>{x['drop']:.1f}</td>"
        rows += f"<td>{reported[0]}</td><td>{reported[1]}</td><td>{text(size['rival']) if size else ''}</td></tr>"
    head = (
        "<tr><th>alone, not accepted</th><th>its best value</th><th>drop</th><th>would be found</th>"
        "<th>and told from</th><th>its nearest rival</th></tr>"
    )
    note = "Sizes that manoeuvres like these, in this air, show nine times in ten."
    return (
        "<details><summary>Every effect alone, and how large it would have to be</summary>"
        f'<table>{head}{rows}</table><p class="note">{note}</p></details>'
    )


def _derivatives(result: Mapping[str, Any], aircraft: Aircraft) -> str:
    rows = ""
    for n, d in result["derivatives"].items():
        change = d["change_percent"]
        reported = f"{change:+.1f} %" if aircraft.value(n) else f"{0.01 * change:.3g} (profile: none)"
        rows += f"<tr><td>{text(n)}</td><td>{reported}</td><td>{d['in_prior_sd']:+.2f}</td></tr>"
    head = "<tr><th>derivative</th><th>best within its prior</th><th>in prior sd</th></tr>"
    note = "Beyond 2 the profile's value, or its stated uncertainty, is doubtful."
    return f'<h2>Derivatives</h2><table>{head}{rows}</table><p class="note">{note}</p>'


def _settings(result: Mapping[str, Any]) -> str:
    lines = []
    for name, gust in result["gust_sigma_mps"].items():
        lines.append(f"<li>{text(name)}: vertical gust {gust:.2f} m/s (standard deviation)</li>")
    lines += [f"<li>{text(_first_upper(r))}.</li>" for r in result["remarks"]]
    held = text(", ".join(result["held_out"]) or "none")
    names = list(dict.fromkeys(s for found in result["noise"].values() for s in found))
    head = "".join(f"<th>{text(s)}<br>{text(_noise_unit(s))}</th>" for s in names)
    rows = "".join(
        f"<tr><td>{text(record)}</td>"
        + "".join(f"<td>{from_si(found[s], _noise_unit(s)):.2g}</td>" if s in found else "<td>–</td>" for s in names)
        + "</tr>"
        for record, found in result["noise"].items()
    )
    return (
        f"<h2>Records</h2><ul>{''.join(lines)}</ul><table><tr><th>noise found (sd)</th>{head}</tr>{rows}</table>"
        f"<p class='note'>Held out: {held}.</p>"
    )


def _noise_unit(name: str) -> str:
    """The unit that a signal's noise is told in."""
    si = SIGNALS.get(name, SIGNALS["v_north"]).unit
    return {"rad": "deg", "rad/s": "deg/s", "m/s2": "g"}.get(si, si)

"""The diagnosis report: one HTML file with its figures inside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from station.conventions import SIGNALS, from_si
from station.diagnosis import judge
from station.diagnosis.detectable import Detectable
from station.diagnosis.diagnosis_result import Effect, Gain, Verdict
from station.diagnosis.effects import BY_ID
from station.diagnosis.kinematic_diagnosis import KinematicDiagnosis
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
from station.identification.instrument_pages import kinematic_pages

FILE_NAME: Final = "diagnosis.html"
_VERDICT: Final[Mapping[Verdict, str]] = {
    "no_effect": "No effect found: the measured flight agrees with the simulation within noise and gusts.",
    "effect_found": "The measured flight differs from the simulation, and one explanation fits.",
    "confounded": "The measured flight differs from the simulation; these manoeuvres do not separate its causes.",
    "unexplained": "No effect of the catalogue explains all of what differs. Effects named below are suspect.",
}
_VERDICT_WITH_ERROR: Final[Mapping[Verdict, str]] = {
    "no_effect": "The aircraft's model is in error; no instrument is at fault.",
    "effect_found": "The aircraft's model is in error; what is named below stands in spite of that.",
    "confounded": "The aircraft's model is in error, and these manoeuvres do not separate all causes.",
    "unexplained": _VERDICT["unexplained"],
}
"""The same where the model itself is in error."""
_KINEMATIC_VERDICT: Final[Mapping[Verdict, str]] = {
    "no_effect": "The instruments agree with each other within noise.",
    "effect_found": "The instruments disagree with each other.",
    "confounded": "The instruments disagree with each other; this record does not separate the possible causes.",
}


def write_report(
    found: Diagnosis,
    sizes: Sequence[Detectable],
    folder: Path,
    more: Sequence[str] = (),
    instruments: Sequence[str] = (),
) -> Path:
    """Write the page into `folder` as diagnosis.html, with the sizes that its records would show, `more` pieces of
    HTML, and those of the `instruments` first; returns its path. Raises LogError if it cannot be written."""
    before, after = found.before, found.after
    verdict = (_VERDICT if found.with_error is None else _VERDICT_WITH_ERROR)[found.verdict]
    body = [
        f"<h1>{text(found.aircraft.name)}: measured against simulated</h1>",
        f'<p class="verdict">{verdict}</p>',
        *instruments,
        effects_table(found.named),
        _unexplained(found),
        _model_error(found),
        _next(found),
        _gain(found.gain, bool(found.named)),
        image(by_record(found, before, after), "error of each manoeuvre before and after") if found.named else "",
        "<h2>What differs, by instrument and model</h2>",
        image(spectra_before_and_after(found, before, after), "spectra of each series before and after"),
        _residuals(found),
        "<h2>In time</h2>",
        image(measured_and_predicted(found, before, after), "measured, and predicted before and after")
        if found.named
        else "",
        image(times(found, before, after), "each series over time before and after"),
        *more,
        "<h2>What was tested</h2>",
        image(reductions(found), "deviance reduction of each effect alone"),
        _tested(found, sizes),
        _derivatives(found),
        _records(found),
    ]
    return write_page(f"Diagnosis: {found.aircraft.name}", body, folder / FILE_NAME)


def write_kinematic_report(found: KinematicDiagnosis, folder: Path, instruments: Sequence[str] = ()) -> Path:
    """The page of the kinematic part: verdict, effects, each record's calibration with its pictures, and what was not
    judged."""
    lines = "".join(f"<li>{text(w)}: {text(y)}</li>" for w, y in found.not_judged.items())
    body = [
        f"<h1>{text(found.aircraft.name)}: what the instruments say of each other</h1>",
        f'<p class="verdict">{_KINEMATIC_VERDICT[found.verdict]}</p>',
        "<p>Kinematic part only: without aerodynamic data nothing is simulated.</p>",
        *instruments,
        effects_table(found.named),
        f"<h2>Not judged</h2><ul>{lines}</ul>",
    ]
    for j in found.fitted:
        body.append(f"<h1>{text(j.name)}</h1>")
        body += kinematic_pages(replace(j.made, delay="it needs the aircraft's lift"), j.record)
    return write_page(f"Diagnosis: {found.aircraft.name}", body, folder / FILE_NAME)


# --- words and tables


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], words: int = -1) -> str:
    """A table of cells that are HTML; the column `words` is of text."""

    def row(cells: Sequence[str], tag: str) -> str:
        kinds = (" class='words'" if k == words else "" for k in range(len(cells)))
        return f"<tr>{''.join(f'<{tag}{kind}>{c}</{tag}>' for c, kind in zip(cells, kinds, strict=True))}</tr>"

    return f"<table>{row(head, 'th')}{''.join(row(r, 'td') for r in rows)}</table>"


def _note(words: str) -> str:
    return f'<p class="note">{words}</p>'


def effects_table(effects: Sequence[Effect]) -> str:
    """Effects with values and intervals; nothing where there are none."""
    if not effects:
        return ""
    rows = []
    for e in effects:
        confounded = f" Confounded with {', '.join(e.alternatives)}." if e.alternatives else ""
        rows.append(
            (
                text(e.term.id) + (" (suspect)" if e.suspect else ""),
                text(e.sentence + confounded),
                e.shown(e.value),
                " to ".join(e.shown(x) for x in e.ci95),
                "seen before any fit" if e.reduction is None else f"{e.reduction:.1f}",
                ", ".join(e.term.shows_in) or "–",
            )
        )
    head = ("effect", "in words", "value", "95 %", "deviance reduction", "shows in")
    note = f"Deviance reduction: by how much -2 log likelihood falls; {FIRST:g} is asked of a first effect."
    return f"<h2>Effects</h2>{_table(head, rows, 1)}{_note(note)}"


def _unexplained(found: Diagnosis) -> str:
    remaining = found.remaining
    if not remaining.present:
        return ""
    low, high = remaining.band_hz
    like = f", correlated with {remaining.like}" if remaining.coherent else ""
    where = f"{text(', '.join(remaining.signals))} from {low:.2f} to {high:.2f} Hz{text(like)}"
    numbers = (
        f"log p {remaining.log_p:.1f} (limit {remaining.log_p_limit:.1f}), score {remaining.score:.1f} (limit "
        f"{remaining.score_limit:.1f})."
    )
    return f"<h2>Unexplained</h2><p>The remaining residual is not noise: {where}.</p>{_note(numbers)}"


def _model_error(found: Diagnosis) -> str:
    """What was freed, where the model is in error."""
    if found.with_error is None:
        return ""
    missed = ", ".join(f"{100 * v:.0f} % of {n}" for n, v in found.missed.items())
    words = " ".join(e.sentence for e in found.strict)
    return (
        "<h2>Model error</h2><p>The aircraft's model is in error. Its derivatives and terms were freed, "
        f"and what it still misses ({text(missed)}) was taken as noise. Instruments "
        "are named only where they contradict each other, without any aerodynamics.</p>"
        + (_note(f"With the model taken as exact: {text(words)}") if words else "")
    )


def _next(found: Diagnosis) -> str:
    confounded = [e for e in found.named if e.alternatives]
    advice = [f"{e.term.id} or {', '.join(e.alternatives)}: {e.term.separate_by}." for e in confounded]
    if found.remaining.present:
        advice.append(
            f"Unexplained in {found.remaining.series}: repeat the manoeuvre in calm air, at another amplitude and "
            "at another speed: whether it goes with time, distance, amplitude or load shows what it is."
        )
    gusty = any(r.setting.gusty for r in found.problem.references)
    if not gusty and not any(e.term.id == "gust.vertical" for e in found.effects):
        advice.append("The gust path was not judged: all of this was calm. One manoeuvre in turbulence shows it.")
    lines = "".join(f"<li>{text(a)}</li>" for a in advice)
    return f"<h2>What to fly or check next</h2><ul>{lines}</ul>" if advice else ""


def _gain(gain: Gain | None, named: bool) -> str:
    if gain is None:
        why = "no manoeuvre was held out" if named else "no effect was accepted"
        return f"<h2>Gain</h2>{_note(f'Not measured: {why}.')}"
    rows = [(text(name), f"{before:.3f}", f"{after:.3f}") for name, before, after in gain.by_record]
    note = "In standard deviations of noise and gust: at 1, or below, nothing remains to gain."
    return (
        f"<h2>Gain</h2><p>Held-out error {gain.before:.3f} &rarr; {gain.after:.3f}: "
        f"{100 * gain.reduction:.1f} % less (95 %: {100 * gain.low:.1f} to {100 * gain.high:.1f} %), "
        f"for manoeuvres and air of this kind.</p>{_table(('held out', 'before', 'after'), rows)}{_note(note)}"
    )


def _residuals(found: Diagnosis) -> str:
    rows = [
        (text(e.name), MEANING[e.name][0], f"{e.before:.2f}", f"{e.after:.2f}", "yes" if e.white else "no")
        for e in judge.series_errors(found.problem, found.remaining, found.before, found.after)
    ]
    note = "Rms over the noise of the sensors in calm air; gusts raise the vane and drag."
    return _table(("series", "is", "before", "after", "as expected"), rows, 1) + _note(note)


def _tested(found: Diagnosis, sizes: Sequence[Detectable]) -> str:
    known = {x.id: x for x in sizes}
    rows = []
    for name, value, reduction in found.found.not_accepted():
        shown, size = Effect(BY_ID[name], value).shown, known.get(name)
        limits = ("–", "–", "") if size is None else (shown(size.found), shown(size.named), text(size.alternative))
        rows.append((text(name), shown(value), f"{reduction:.1f}", *limits))
    head = ("alone, not accepted", "its best value", "deviance reduction", "detectable", "and separable", "from")
    note = "Sizes that manoeuvres like these, in this air, show nine times in ten."
    return (
        "<details><summary>Every effect alone, and how large it would have to be</summary>"
        f"{_table(head, rows)}{_note(note)}</details>"
    )


def _derivatives(found: Diagnosis) -> str:
    rows = []
    for a, m in zip(found.problem.nuisances, found.found.accepted.moved, strict=False):
        if a.relinear:
            change = a.sd * float(m)
            words = f"{100 * change:+.1f} %" if a.relative else f"{change:.3g} (profile: none)"
            rows.append((text(a.name), words, f"{float(m):+.2f}"))
    note = "Beyond 2 the profile's value, or its stated uncertainty, is doubtful."
    return "<h2>Derivatives</h2>" + _table(("derivative", "change", "in prior sd"), rows) + _note(note)


def _records(found: Diagnosis) -> str:
    references = found.problem.references
    lines = [f"<li>{text(r[:1].upper() + r[1:])}.</li>" for r in found.remarks]
    held = text(", ".join(r.record.name for r in found.held_out) or "none")
    names = list(dict.fromkeys(s for r in references for s in r.noise))
    rows = [
        (
            text(r.record.name),
            f"{gust:.2f}",
            *(f"{from_si(r.noise[s], _unit(s)):.2g}" if s in r.noise else "–" for s in names),
        )
        for r, gust in zip(references, found.found.accepted.gust, strict=True)
    ]
    head = ("noise found (sd)", "vertical gust<br>m/s", *(f"{text(s)}<br>{text(_unit(s))}" for s in names))
    return f"<h2>Records</h2><ul>{''.join(lines)}</ul>{_table(head, rows)}{_note(f'Held out: {held}.')}"


def _unit(name: str) -> str:
    """The unit that a signal's noise is stated in."""
    si = SIGNALS.get(name, SIGNALS["v_north"]).unit
    return {"rad": "deg", "rad/s": "deg/s", "m/s2": "g"}.get(si, si)

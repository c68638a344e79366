"""The diagnosis report: one HTML file with its figures inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from station.conventions import SIGNALS, from_si
from station.diagnosis import judge
from station.diagnosis.detectable import Detectable
from station.diagnosis.diagnosis_answer import answer
from station.diagnosis.diagnosis_result import Effect, missed_words
from station.diagnosis.effects import BY_ID
from station.diagnosis.kinematic_diagnosis import KinematicDiagnosis
from station.diagnosis.pictures import (
    MEANING,
    Compared,
    by_record,
    measured_and_predicted,
    reductions,
    spectra_before_and_after,
    times,
)
from station.diagnosis.procedure import NOTABLE_GUST, Diagnosis, gusts
from station.diagnosis.refits import ASKED
from station.diagnosis.reported import free_parameters_of, noise_of, not_accepted
from station.identification.html_page import image, text, write_page
from station.identification.instrument_pages import kinematic_pages

FILE_NAME: Final = "diagnosis.html"
_TOLD: Final = 1.5
"""Prior standard deviations from which a free parameter is worth a line."""


def write_report(
    found: Diagnosis, shown: Sequence[Compared], sizes: Sequence[Detectable], folder: Path, more: Sequence[str] = (),
    instruments: Sequence[str] = (),
) -> Path:  # fmt: skip
    """Write the page into `folder` as diagnosis.html, with its manoeuvres (`compared`), the sizes that they would show,
    `more` pieces of HTML, and those of the `instruments`; returns its path. Raises LogError if it cannot be
    written."""
    body = [
        f"<h1>{text(found.aircraft.name)}: measured against simulated</h1>",
        f'<p class="verdict">{text(answer(found, found.not_named))}</p>',
        effects_table(found.named) or _residuals(found),
        image(measured_and_predicted(shown), "measured and predicted"),
        _unexplained(found),
        _not_named(found),
        _next(found),
        _gain(found),
        *instruments,
        image(by_record(shown), "error of each manoeuvre, by series"),
        "<h2>What differs, by instrument and model</h2>",
        image(spectra_before_and_after(shown), "spectra of each series"),
        _residuals(found) if found.named else "",
        "<h2>In time</h2>",
        image(times(shown), "each series over time"),
        *more,
        "<h2>What was tested</h2>",
        image(reductions(found), "deviance reduction of each effect alone"),
        _tested(found, sizes),
        _free_parameters(found),
        _records(found),
        *_lateral(found, sizes),
    ]
    return write_page(f"Diagnosis: {found.aircraft.name}", body, folder / FILE_NAME)


def write_kinematic_report(found: KinematicDiagnosis, folder: Path, instruments: Sequence[str] = ()) -> Path:
    """The page of the kinematic part: verdict, effects, each record's calibration with its pictures, and what was not
    judged."""
    lines = "".join(f"<li>{text(w)}: {text(y)}</li>" for w, y in found.not_judged.items())
    body = [
        f"<h1>{text(found.aircraft.name)}: what the instruments say of each other</h1>",
        f'<p class="verdict">{text(answer(found, of_instruments=True))}</p>',
        "<p>Kinematic part only: without aerodynamic data nothing is simulated.</p>",
        effects_table(found.named),
        *instruments,
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


def effects_table(effects: Sequence[Effect], title: str = "Effects", more: str = "") -> str:
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
    note = f"Deviance reduction: by how much -2 log likelihood falls; {ASKED:g} is asked of each effect. {more}"
    return f"<h2>{title}</h2>{_table(head, rows, 1)}{_note(note)}"


def _lateral(found: Diagnosis, sizes: Sequence[Detectable]) -> list[str]:
    """Of the lateral motion, where it was judged; its effects stand among the others."""
    own = found.lateral
    if own is None:
        return []
    parts = _unexplained(own), _gain(own), _residuals(own), _tested(own, sizes), _free_parameters(own), _records(own)
    return ["<h1>Lateral motion</h1>", *parts]


def _unexplained(found: Diagnosis) -> str:
    """What is missed with every parameter free, and where the residual is not noise."""
    remaining = found.remaining
    if not remaining.present:
        return ""
    said = [f"{words[:1].upper()}{words[1:]}." for words in missed_words(found.missed)]
    if said:
        said.append("What is missed counts as noise in all that is said here.")
    if remaining.log_p < remaining.log_p_limit:
        low, high = remaining.band_hz
        where = f"{', '.join(remaining.signals)} from {low:.2f} to {high:.2f} Hz"
        said.append(f"The remaining residual is not noise: {where}.")
    if remaining.strained:
        far = ", ".join(f"{name} {x:+.1f}" for name, x in remaining.strained)
        said.append(f"Parameters are fitted far beyond the profile's stated doubt (in its standard deviations): {far}.")
    said += [f"Not named: {apart.words}." for apart in remaining.inhomogeneous]
    said += [f"{x.words}." for x in (remaining.crossed, remaining.nonlinear) if x]
    numbers = f"Most unlikely band: log p {remaining.log_p:.1f} (limit {remaining.log_p_limit:.1f})."
    return f"<h2>Unexplained</h2><p>{text(' '.join(said))}</p>{_note(numbers)}"


def _not_named(found: Diagnosis) -> str:
    note = "The manoeuvres fitted ask for it, but it does not lower the error of those held out: no finding."
    return effects_table(found.not_named, "Not confirmed", note)


def _next(found: Diagnosis) -> str:
    confounded = [e for e in found.named if e.alternatives]
    advice = [f"{e.term.id} or {', '.join(e.alternatives)}: {e.term.separate_by}." for e in confounded]
    if found.remaining.in_signals:
        advice.append(
            f"Unexplained in {found.remaining.series}: repeat the manoeuvre in calm air, at another amplitude and "
            "at another speed: whether it goes with time, distance, amplitude or load shows what it is."
        )
    if found.not_named:
        names = ", ".join(e.term.id for e in found.not_named)
        advice.append(f"{names}: more manoeuvres, to fit and to hold out, would confirm it or not.")
    if max(gusts(found.problem, found.found.accepted)) < NOTABLE_GUST:
        advice.append("All of this was calm: one manoeuvre in turbulence shows the gust path.")
    lines = "".join(f"<li>{text(a)}</li>" for a in advice)
    return f"<h2>What to fly or check next</h2><ul>{lines}</ul>" if advice else ""


def _gain(found: Diagnosis) -> str:
    gain = found.gain
    if gain is None:
        why = "no effect was accepted"
        if found.effects:
            why = "no manoeuvre was held out"
        elif found.not_named:
            why = "no effect was confirmed"
        return f"<h2>Gain</h2>{_note(f'Not measured: {why}.')}"
    rows = [(text(name), f"{before:.3f}", f"{after:.3f}") for name, before, after in gain.by_record]
    note = "In standard deviations of noise and gust: at 1, or below, nothing remains to gain."
    return (
        f"<h2>Gain</h2><p>Held-out error {gain.before:.3f} &rarr; {gain.after:.3f}: {text(gain.words)}, "
        f"for manoeuvres and air of this kind.</p>{_table(('held out', 'before', 'after'), rows)}{_note(note)}"
    )


def _residuals(found: Diagnosis) -> str:
    levels = found.found.accepted.state.levels
    rows = [
        (text(e.name), MEANING[e.name][0], f"{e.before:.2f}", f"{e.after:.2f}", "yes" if e.white else "no")
        for e in judge.series_errors(found.problem, levels, found.remaining, found.before, found.after)
    ]
    note = "Rms over what the sensors' noise, the gusts and what the model misses make of each series."
    return _table(("series", "is", "before", "after", "as expected"), rows, 1) + _note(note)


def _tested(found: Diagnosis, sizes: Sequence[Detectable]) -> str:
    known = {x.id: x for x in sizes}
    rows = []
    for name, value, reduction in not_accepted(found):
        shown, size = Effect(BY_ID[name], value).shown, known.get(name)
        limits = ("–", "–", "") if size is None else (shown(size.found), shown(size.named), text(size.alternative))
        rows.append((text(name), shown(value), f"{reduction:.1f}", *limits))
    head = ("alone, not accepted", "its best value", "deviance reduction", "detectable", "and separable", "from")
    note = "Sizes that manoeuvres like these, in this air, show nine times in ten."
    return (
        "<details><summary>Every effect alone, and how large it would have to be</summary>"
        f"{_table(head, rows)}{_note(note)}</details>"
    )


def _free_parameters(found: Diagnosis) -> str:
    """The derivatives, and what else the fit moved far."""
    free = free_parameters_of(found)
    told = [p for p in free if p.of_derivative or abs(p.in_prior_sd) > _TOLD]
    rows = [(text(p.name), text(p.words), f"{p.in_prior_sd:+.2f}", f"{p.sd:.2f}") for p in told]
    note = (
        f"All free parameters: {len(free)}; those not shown are within {_TOLD:g} standard deviations of the profile. "
        "Beyond 2 the profile's value, or its stated uncertainty, is doubtful. A standard deviation near 1: these "
        "manoeuvres do not show it."
    )
    head = ("free parameter", "change", "in prior sd", "its sd, in prior sd")
    return "<h2>Derivatives and other free parameters</h2>" + _table(head, rows) + _note(note)


def _records(found: Diagnosis) -> str:
    lines = [f"<li>{text(r[:1].upper() + r[1:])}.</li>" for r in found.remarks]
    held = text(", ".join(m.record.name for m in found.held_out) or "none")
    noise = noise_of(found)
    names = list(dict.fromkeys(s for own in noise for s in own))
    rows = [
        (
            text(m.record.name),
            f"{gust:.2f}",
            *(f"{from_si(own[s], _unit(s)):.2g}" if s in own else "–" for s in names),
        )
        for m, gust, own in zip(
            found.problem.manoeuvres, gusts(found.problem, found.found.accepted), noise, strict=True
        )
    ]  # fmt: skip
    gust_name = "side gust" if found.problem.axis.lateral else "vertical gust"
    head = ("noise found (sd)", f"{gust_name}<br>m/s", *(f"{text(s)}<br>{text(_unit(s))}" for s in names))
    return f"<h2>Records</h2><ul>{''.join(lines)}</ul>{_table(head, rows)}{_note(f'Held out: {held}.')}"


def _unit(name: str) -> str:
    """The unit that a signal's noise is stated in."""
    si = SIGNALS.get(name, SIGNALS["v_north"]).unit
    return {"rad": "deg", "rad/s": "deg/s", "m/s2": "g"}.get(si, si)

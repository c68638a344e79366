"""The words of the page's first screen, as Markdown: the card's step, and what is known of each derivative."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from station.screen.answers import Derivative, significant
from station.screen.brief import Brief, StepBrief


def first_words(brief: Brief, references: Mapping[str, float]) -> str:
    """The step, where there is one, above the recommended derivatives with bounds and targets."""
    step = _of_step(brief.step) if brief.step is not None else ()
    return "\n".join([*step, *_derivatives(brief.method, brief.derivatives, references)])


def _of_step(step: StepBrief) -> Iterator[str]:
    if step.phase == "done":
        yield "### Card flown"
        for name, how in step.results:
            yield f"- {name}: **{how}**"
        yield ""
        return
    run = f", run {step.run} of {step.repeats}" if step.run else ""
    yield f"### Step {step.number}/{step.of}: {step.name}{run}"
    yield f"**{step.words}** {step.configuration}  "
    yield " · ".join(words if good else f"**✗ {words}**" for words, good in step.checks)
    yield ""
    if step.verdict:
        yield f"**{step.verdict}**"
        yield ""


def _derivatives(method: str, known: Sequence[Derivative], references: Mapping[str, float]) -> Iterator[str]:
    has_baseline = any(d.change or d.name == "CD_0" for d in known)
    changed = " changed, ± 2 sd |" if has_baseline else ""
    yield f"| **{method}** [1/rad] | value ± 2 sd | ± | wanted | | profile |{changed}"
    yield "| --- | --- | --- | --- | --- | --- |" + (" --- |" if has_baseline else "")
    whys: dict[str, list[str]] = {}
    for d in known:
        have = f"{100 * d.have:.2g} %" if d.have is not None else "–"
        asked = f"{100 * d.wanted:g} %" if d.wanted else "–"
        reference = references.get(d.name, math.nan)
        shown = f"{reference:.4f}" if d.name == "CD_0" else significant(reference, reference)
        value = f"**{d.value}** {d.bound}" if d.bound else d.value
        state = "✔ enough" if d.state == "enough" else d.state
        change = f" {d.change} |" if has_baseline else ""
        yield f"| {d.name} | {value} | {have} | {asked} | {state} | {shown} |{change}"
        if not d.bound:
            whys.setdefault(d.why or d.state, []).append(d.name)
    yield ""
    for why, names in whys.items():
        yield f"{'all' if len(names) == len(known) else ', '.join(names)}: {why}  "

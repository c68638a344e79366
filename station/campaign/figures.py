"""A campaign's figures, and one sentence on each claim of the study that it repeats.

estimates: one diamond a flight with its 2-sigma bar, the truth as a line, the tolerance dashed, a panel a turbulence
level. exceedances: how many flights miss the tolerance, over two factors, a panel a level. errors: bias and scatter of
every method, a panel a parameter.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from station.campaign import beside_printed
from station.campaign.findings import OF_FLIGHTS, Rows, chosen, compare, judge, level_name
from station.campaign.spec import Case, Plan

SENTENCES: Final = "findings.txt"
_DPI: Final = 110
_LINE: Final = 17
"""Characters of a line under a figure, for each inch of its width."""
_LINE_HEIGHT: Final = 0.16
"""Inches."""
_PANEL_LIMIT: Final = 2.5
"""Estimates are shown within this many times the tolerance, or as wide as the widest 95 % of them need."""


def draw(plan: Plan, result: Path, out: Path) -> list[str]:
    """Write the figures and the sentences under `out`; returns the sentences, a study's tables before them."""
    rows = Rows(plan, result)
    folder = out / "figures"
    folder.mkdir(exist_ok=True)
    kinds = {"estimates": _estimates, "exceedances": _exceedances, "errors": _errors}
    for kind in plan.campaign.figures:
        for name, figure in kinds[kind](rows):
            figure.savefig(folder / f"{name}.png", dpi=_DPI)
    for name, figure in beside_printed.figures(rows):
        figure.savefig(folder / f"{name}.png", dpi=_DPI)
    sentences = [*beside_printed.lines(rows), *(judge(rows, claim) for claim in plan.campaign.claims)]
    for levels, cases in _groups(plan, ("turbulence",)):
        sentences += _compared(rows, levels, cases)
    (out / SENTENCES).write_text("".join(s + "\n" for s in sentences), encoding="utf-8")
    return sentences


def _groups(plan: Plan, apart: tuple[str, ...]) -> Iterator[tuple[dict[str, Any], list[Case]]]:
    """Cases that differ in the factors `apart` only."""
    names = [n for n in plan.campaign.varied if n not in apart]
    seen: list[dict[str, Any]] = []
    for case in plan.cases:
        levels = {n: case.levels[n] for n in names}
        if levels not in seen:
            seen.append(levels)
            yield levels, chosen(plan, levels)


def _title(levels: dict[str, Any]) -> str:
    return ", ".join(f"{n.replace('_', ' ')} {v}" for n, v in levels.items())


def _axis(name: str, levels: Sequence[Any]) -> tuple[str, list[str]]:
    """A factor's name, with the unit that all its levels have, and the levels without."""
    words = [str(level).split() for level in levels]
    units = {word[1] if len(word) == 2 else "" for word in words}
    label = name.replace("_", " ")
    if len(units) == 1 and units != {""}:
        return f"{label} [{units.pop()}]", [word[0] for word in words]
    return label, [str(level) for level in levels]


def _entitled(figure: Figure, rows: Rows, what: str, levels: dict[str, Any], sentences: list[str]) -> Figure:
    """A figure with its title, and below it what it shows in words, for which it grows."""
    campaign = rows.plan.campaign
    figure.suptitle(", ".join(filter(None, (what, _title(levels)))) + f"\n{campaign.description or campaign.name}")
    width, height = figure.get_size_inches()
    wrapper = textwrap.TextWrapper(round(_LINE * width), break_on_hyphens=False)
    lines = [line for sentence in sentences for line in wrapper.wrap(sentence)]
    figure.set_size_inches(width, height + _LINE_HEIGHT * len(lines))
    figure.supxlabel("\n".join(lines), x=0.02, horizontalalignment="left", fontsize=8)
    return figure


def _claimed(rows: Rows, parameter: str, method: str, levels: dict[str, Any]) -> list[str]:
    """What comes of the study's claims about what a figure shows."""
    campaign = rows.plan.campaign
    return [
        judge(rows, claim)
        for claim in campaign.claims
        if claim.parameter == parameter
        and method == (claim.method or campaign.methods[0])
        and all(levels.get(name, level) == level for name, level in claim.where.items())
    ]


def _compared(rows: Rows, levels: dict[str, Any], cases: list[Case]) -> list[str]:
    """How methods compare, level by level of turbulence."""
    return [compare(rows, c, cases, _title(levels)) for c in rows.plan.campaign.comparisons]


def _file_name(*parts: object) -> str:
    return re.sub(r"[^A-Za-z0-9+.]+", "_", "_".join(str(p) for p in parts if p)).strip("_")


def _estimates(rows: Rows) -> Iterator[tuple[str, Figure]]:
    campaign = rows.plan.campaign
    for levels, cases in _groups(rows.plan, ("turbulence",)):
        for method in campaign.methods:
            for parameter in campaign.show or campaign.parameters:
                figure = Figure(figsize=(9, 6.5), layout="constrained")
                panels = figure.subplots(-(-len(cases) // 2), min(2, len(cases)), sharey=True, squeeze=False).ravel()
                widest = max(
                    _scatter(panel, rows, case, method, parameter) for panel, case in zip(panels, cases, strict=False)
                )
                for panel in panels[len(cases) :]:
                    panel.axis("off")
                middle = rows.values(f"{parameter}_reference", cases[0].number, method)[0]
                panels[0].set_ylim(middle - widest, middle + widest)
                panels[0].legend(loc="upper right", fontsize=7, ncols=2)
                said = _claimed(rows, parameter, method, levels)
                _entitled(figure, rows, f"{parameter} by {method}", levels, said)
                yield _file_name("estimates", parameter, method, *levels.values()), figure


def _scatter(panel: Axes, rows: Rows, case: Case, method: str, parameter: str) -> float:
    """One panel; returns how far from the truth it should reach."""
    value = rows.values(parameter, case.number, method)
    bar = 2.0 * rows.values(f"{parameter}_sd", case.number, method)
    truth = float(rows.values(f"{parameter}_reference", case.number, method)[0])
    tolerance = rows.plan.campaign.tolerance
    run = np.arange(1, len(value) + 1)
    panel.errorbar(run, value, bar, fmt="none", ecolor="tab:blue", elinewidth=0.6, label="±2σ")
    panel.plot(run, value, "d", color="red", markersize=2.5, label="estimate")
    panel.axhline(truth, color="green", label=rows.plan.campaign.reference.replace("calm", "reference"))
    for side in (-1, 1):
        word = f"±{tolerance:.0%}" if side > 0 else None
        panel.axhline(truth * (1 + side * tolerance), color="red", linestyle="--", linewidth=0.8, label=word)
    s = rows.summary(case, method, parameter)
    panel.set_title(f"{level_name(case)}: bias {s.bias:+.1f} %, sd {s.scatter:.1f} %", fontsize=9)
    panel.set_xlabel("flight")
    panel.set_ylabel(f"{parameter} [1/rad]")
    off = np.abs(value - truth)[np.isfinite(value)]
    reach = float(np.quantile(off, 0.95)) * 1.3 if len(off) else 0.0
    return max(_PANEL_LIMIT * tolerance * abs(truth), reach)


def _exceedances(rows: Rows) -> Iterator[tuple[str, Figure]]:
    campaign = rows.plan.campaign
    axes = [n for n, v in campaign.factors.items() if n != "turbulence" and len(v) > 1][:2]
    if len(axes) < 2:
        return
    across, up = axes
    for levels, cases in _groups(rows.plan, ("turbulence", *axes)):
        sigmas = sorted({c.scenario.turbulence for c in cases})
        for method in campaign.methods:
            for parameter in campaign.show or campaign.parameters:
                figure = Figure(figsize=(9, 7.5), layout="constrained")
                panels = figure.subplots(-(-len(sigmas) // 2), min(2, len(sigmas)), squeeze=False).ravel()
                image = None
                for panel, sigma in zip(panels, sigmas, strict=False):
                    here = [c for c in cases if c.scenario.turbulence == sigma]
                    counts = np.full((len(campaign.factors[up]), len(campaign.factors[across])), np.nan)
                    for case in here:
                        at = (
                            campaign.factors[up].index(case.levels[up]),
                            campaign.factors[across].index(case.levels[across]),
                        )
                        counts[at] = rows.summary(case, method, parameter).exceedances
                    image = panel.imshow(counts, origin="lower", aspect="auto", cmap="viridis", vmin=0, vmax=OF_FLIGHTS)
                    panel.set_title(f"{level_name(here[0])}: {counts.min():.0f} to {counts.max():.0f}", fontsize=9)
                    for axis, name in ((panel.xaxis, across), (panel.yaxis, up)):
                        label, words = _axis(name, campaign.factors[name])
                        axis.set_ticks(range(len(words)), words, fontsize=7)
                        axis.set_label_text(label)
                if image is not None:
                    figure.colorbar(
                        image, ax=list(panels), label=f"flights of {OF_FLIGHTS} beyond ±{campaign.tolerance:.0%}"
                    )
                said = _claimed(rows, parameter, method, levels)
                _entitled(figure, rows, f"{parameter} by {method}", levels, said)
                yield _file_name("exceedances", parameter, method, *levels.values()), figure


_FROM: Final = {"calm": "what a perfect angle of attack gives in calm air", "truth": "the aircraft's own derivatives"}


def errors_figure(plan: Plan, result: Path) -> Figure:
    """Bias and scatter of every method, a panel a derivative; of the first of the figures where there are several."""
    return next(_errors(Rows(plan, result)))[1]


def _errors(rows: Rows) -> Iterator[tuple[str, Figure]]:
    campaign = rows.plan.campaign
    methods = campaign.methods
    for levels, cases in _groups(rows.plan, ("turbulence",)):
        figure = Figure(figsize=(11, 6.5), layout="constrained")
        panels = figure.subplots(2, 3).ravel()
        for panel, parameter in zip(panels, campaign.parameters, strict=True):
            panel.axhline(0.0, color="green", linewidth=1.0)
            for side in (-100.0, 100.0):
                word = f"±{campaign.tolerance:.0%}" if side > 0 else None
                panel.axhline(side * campaign.tolerance, color="red", linestyle="--", linewidth=0.8, label=word)
            for i, case in enumerate(cases):
                found = [rows.summary(case, method, parameter) for method in methods]
                at = np.arange(len(methods)) + 0.5 * ((i + 0.5) / len(cases) - 0.5)
                panel.errorbar(
                    at,
                    [s.bias for s in found],
                    [s.scatter for s in found],
                    fmt="o",
                    markersize=4,
                    label=level_name(case),
                )
            panel.set_xticks(range(len(methods)), methods, fontsize=8, rotation=30, ha="right", rotation_mode="anchor")
            panel.set_title(parameter, fontsize=10)
            panel.set_ylabel("error: bias ± sd [%]")
        panels[0].legend(fontsize=7)
        what = f"Errors of each method, from {_FROM[campaign.reference]}"
        if campaign.reference == "calm" and "physical" in methods:
            what += f" (physical: {_FROM['truth']})"
        _entitled(figure, rows, what, levels, _compared(rows, levels, cases))
        yield _file_name("errors", *levels.values()), figure

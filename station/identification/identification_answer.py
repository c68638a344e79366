"""What an identification answers, first on its page: one sentence to quote, the recommended estimates, one picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from station.conventions import LATERAL
from station.estimation.method_table import METHODS
from station.estimation.results import MethodResult, equations
from station.identification.html_page import FAINT, INK, ORANGE, image, text, without_frame
from station.identification.identified import Identification
from station.identification.remarks import about_disagreement, about_gusts
from station.rows import ParamEstimate, Status

Array = NDArray[np.float64]

POINTS: Final = 1500
"""Of a line in a picture."""
QUOTED: Final = ("CL_alpha", "CZ_alpha", "Cm_alpha", "Cm_q", "Cm_de")
"""Derivatives in the sentence: lift slope, static stability, damping in pitch, control power; all are in the table."""
MEANT: Final = {
    "derivatives": "the aircraft's own derivatives, unsteady lift apart",
    "quasi_steady": "quasi-steady derivatives, unsteady lift in them",
}
"""By a method's definition."""


def is_usable(result: MethodResult, p: ParamEstimate) -> bool:
    return p.status is Status.ESTIMATED and result.status == "ok"


def rounded(value: float, error: float) -> str:
    """The value to the second significant digit of its error."""
    if not (math.isfinite(error) and error > 0):
        return f"{value:.4g}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def answer(found: Identification) -> str:
    """One sentence: what was found and by how much, what was not estimated, and what makes it suspect."""
    start, end = found.interval_s
    air = "unknown turbulence" if found.turbulence == "unknown" else f"{found.turbulence} air"
    if found.turbulence not in ("unknown", "calm"):
        air = f"{found.turbulence} turbulence"
    where = f"{found.aircraft.name}, {start:.0f} to {end:.0f} s, {air}"
    best = found.methods.get(found.recommended or "")
    known = [p for p in best.parameters if is_usable(best, p)] if best else []
    if best is None or not known:
        whys = list(dict.fromkeys(r.why for r in found.methods.values() if r.why))
        return f"{where}: nothing could be estimated{f' ({whys[0]})' if whys else ''}."
    quoted = [p for p in known if p.name in QUOTED] or known[: len(QUOTED)]
    values = ", ".join(f"{p.name} {rounded(p.value, 2 * p.sd)}" for p in quoted)
    more = len(known) - len(quoted)
    others = f" and {more} more in the table" if more else ""
    meaning = MEANT[METHODS[found.recommended or ""].definition]
    said = f"{where}: {values} per rad{others} (± 2 standard errors; method {found.recommended}, {meaning})"
    missing = [p.name for p in best.parameters if not is_usable(best, p)]
    clauses = [f"not estimated: {', '.join(missing)}"] if missing else []
    return "; ".join([said, *clauses, *_suspicions(found)]) + "."


def _suspicions(found: Identification) -> list[str]:
    """Why the numbers of the sentence are not all that they seem."""
    words = []
    if found.hint:
        words.append(f"SUSPECT: the flight contradicts the profile, {found.hint}")
    if about_gusts(found.methods, found.turbulence):
        words.append("the standard errors do not include the gusts' effect")
    if found.recommended in ("oe", "fe") and about_disagreement(found.methods):
        words.append("SUSPECT: oe and fe disagree by more than their errors")
    return words


def answer_table(found: Identification, groups: Sequence[Sequence[str]]) -> str:
    """The recommended method's estimates beside the profile's, a column a derivative; why some are not estimated."""
    best = found.methods.get(found.recommended or "")
    if best is None:
        return ""
    tables: list[str] = []
    whys: dict[str, str] = {}
    for names in groups:
        own = [p for n in names if (p := best.parameter(n)) is not None]
        if not own:
            continue
        good = [is_usable(best, p) for p in own]
        whys |= {p.name: p.why for p, g in zip(own, good, strict=True) if not g}
        estimates = ["–" if not g else f"{rounded(p.value, 2 * p.sd)}" for p, g in zip(own, good, strict=True)]
        stated = [found.aircraft.derivatives.get(p.name) for p in own]
        rows = {
            found.recommended: estimates,
            "profile": ["–" if d is None else rounded(d.value, 2 * (d.sd or 0.0)) for d in stated],
        }
        lines = "".join(
            f"<tr{' class=chosen' if k == found.recommended else ''}><td>{text(k)}</td>"
            f"{''.join(f'<td>{c}</td>' for c in cells)}</tr>"
            for k, cells in rows.items()
        )
        head = "".join(f"<th>{text(p.name)}</th>" for p in own)
        tables.append(f'<div class="wide"><table><tr><th>per rad</th>{head}</tr>{lines}</table></div>')
    why = "; ".join(f"{name}: {words or 'not estimated'}" for name, words in whys.items())
    note = f" Not estimated: {text(why)}." if why else ""
    return f'{"".join(tables)}<p class="note">Estimate ± 2 standard errors.{note}</p>'


def modelled(
    found: Identification, method: str, alpha: Array, only: Sequence[str] | None = None
) -> list[tuple[str, Array, Array]]:
    """Name, measured and modelled coefficient (n,), less its constant, of a method's equations.

    `alpha` (n,): what the method regresses on. `only`: of the equations with these derivatives. Empty where the method
    has no values.
    """
    record, result = found.record, found.methods[method]
    shown = []
    for equation in equations(record, found.axes):
        known = [result.parameter(n) for n in equation.parameters]
        values = np.array([p.value if p else math.nan for p in known])
        if np.isfinite(values).all() and (only is None or equation.parameters[0] in only):
            x = equation.regressors.copy()
            if equation.parameters[0].endswith("_alpha"):
                x[:, 0] = alpha
            shown.append((equation.name, equation.measured, x @ values))
    return shown


def answer_picture(found: Identification, method: str, alpha: Array) -> str:
    """Measured lift and moment, and the model's with a band that holds 95 % of a white residual."""
    shown = [s for s in modelled(found, method, alpha) if s[0] not in _lateral(found)]
    if not shown:
        return ""
    figure = Figure(figsize=(10, 1.75 * len(shown)), layout="constrained", dpi=120)
    panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    t_s = found.record.t_s
    step = max(1, len(t_s) // POINTS)
    for panel, (name, measured, model) in zip(panels, shown, strict=True):
        residual = measured - model
        constant, band = float(np.nanmean(residual)), 2 * float(np.nanstd(residual))
        line = (model + constant)[::step]
        panel.fill_between(t_s[::step], line - band, line + band, color=ORANGE, alpha=0.2, lw=0)
        panel.plot(t_s[::step], measured[::step], color=INK, lw=0.9, label="measured")
        panel.plot(t_s[::step], line, color=ORANGE, lw=1.1, label=f"model, {method}")
        panel.set_ylabel(name, fontsize=9)
        panel.set_xlim(t_s[0], t_s[-1])
        panel.tick_params(labelsize=8, length=2, color=FAINT)
        without_frame(panel, "top", "right")
    panels[0].legend(fontsize=8, frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.98))
    panels[-1].set_xlabel("time, s", fontsize=8, loc="right")
    note = "Band: two standard deviations of the residual. The model has a free constant."
    if method != found.recommended:
        note += f" {found.recommended} regresses on no angle of attack: {method} is shown."
    return image(figure, "Measured and modelled lift and moment coefficients") + f'<p class="note">{text(note)}</p>'


def _lateral(found: Identification) -> set[str]:
    """Names of the lateral equations."""
    return {e.name for e in equations(found.record, found.axes) if e.parameters[0] in LATERAL}

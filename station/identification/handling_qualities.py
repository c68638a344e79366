"""Derived quantities as a handling-qualities engineer reads them: of an identification, as JSON and lines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import from_si
from station.estimation.method_table import METHODS
from station.estimation.results import DOF, without_airframe_errors
from station.identification.identified import Identification
from station.model.airframe_error import relative_errors
from station.model.flying_qualities import Condition, Derived, Qualities, bend, qualities
from station.model.flying_quality_levels import LEVELS, levels_of
from station.numerics.atmosphere import scale_height
from station.rows import Status

Array = NDArray[np.float64]

WORDS: Final[Mapping[str, tuple[str, str]]] = {
    "short_period_frequency": ("short period, undamped frequency", "rad/s"),
    "short_period_damping": ("short period, damping ratio", "1"),
    "phugoid_frequency": ("phugoid, undamped frequency", "rad/s"),
    "phugoid_damping": ("phugoid, damping ratio", "1"),
    "n_per_alpha": ("load factor per angle of attack", "g/rad"),
    "control_anticipation": ("control anticipation parameter", "1/(g s2)"),
    "static_margin": ("static margin, stick fixed", "chords"),
    "neutral_point": ("neutral point behind the CG", "m"),
    "manoeuvre_margin": ("manoeuvre margin, stick fixed", "chords"),
    "elevator_per_g": ("elevator per g", "deg/g"),
}
"""Each quantity in words, and the unit it is shown in."""


def identified_qualities(found: Identification) -> Qualities | str:
    """Of the recommended method's derivatives; else why there are none."""
    best = found.methods.get(found.recommended or "")
    if best is None:
        return "no method applies"
    record, body = found.record, found.aircraft
    best = without_airframe_errors(best, record)
    if body.inertia.iyy is None:
        return "the profile gives no iyy"
    good = {p.name: p for p in best.parameters if p.status is Status.ESTIMATED and math.isfinite(p.sd)}
    forces = ("CZ", "Cm") if "CZ_alpha" in good else ("CL", "Cm")
    x = np.column_stack([record.alpha, record.coefficients.qhat, record.motion["elevator"]])
    alike = _correlation(x[record.usable])
    names = [f"{c}_{d}" for c in forces for d in DOF]
    whole = np.kron(np.eye(len(forces)), alike)
    known = [k for k, n in enumerate(names) if n in good]
    sds = np.array([good[names[k]].sd for k in known])
    at = Condition(
        speed=float(np.nanmean(record.motion["airspeed"])),
        density=record.mean_density,
        mass=float(np.nanmean(record.airframe.mass)),
        iyy=float(np.nanmean(record.airframe.iyy)),
        alpha=float(np.nanmean(record.alpha)),
        scale_height=scale_height(record.mean_density),
    )
    late = METHODS[found.recommended or ""].definition == "derivatives"
    values = {names[k]: good[names[k]].value for k in known}
    for name, sign, of in (("CL_alpha", 1, "CL"), ("CZ_alpha", -1, "CL"), ("Cm_alpha", 1, "Cm")):
        if name in values:
            values[name] += sign * bend(body, of, at.alpha)
    mass, inertia = relative_errors(body, ("CL_alpha", "Cm_alpha"))[1 if record.has("mass") else 0]
    covariance = whole[np.ix_(known, known)] * np.outer(sds, sds)
    return qualities(body, at, values, covariance, late, (float(mass), float(inertia)))


def _correlation(x: Array) -> Array:
    """Of least squares' estimates on these regressors (n, 3) and a constant: methods weight them otherwise, but each
    has to tell them apart by the same motion. Without motion, none."""
    good = x[np.isfinite(x).all(axis=1)]
    spread = good.std(axis=0)
    if len(good) < len(DOF) or (spread == 0).any():
        return np.eye(x.shape[1])
    covariance = np.linalg.pinv(np.corrcoef(good.T), hermitian=True)
    scale = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(scale, scale))


# --- JSON and terminal


def derived_json(q: Qualities | str) -> dict[str, Any]:
    """Of station.identify/1 and station.diagnose/1: SI, `ci95`, and why where a quantity is not known."""
    if isinstance(q, str):
        return {"status": "not_applicable", "why": q}
    at = q.condition
    return {
        "status": "ok",
        "why": "",
        "condition": {
            "airspeed_mps": at.speed, "density_kgpm3": at.density, "mass_kg": at.mass, "iyy_kgm2": at.iyy,
            "alpha_rad": at.alpha,
        },
        "quantities": {name: _quantity(d) for name, d in q.quantities.items()},
        "levels": {
            c: {"specification": "MIL-F-8785C", "level": own, "ci95": [best, worst]}
            for c, (own, best, worst) in levels_of(q).items()
        },
    }  # fmt: skip


def _quantity(d: Derived) -> dict[str, Any]:
    known = not d.why
    return {
        "estimate": d.estimate if known else None,
        "ci95": list(d.ci95) if known else None,
        "unit": d.unit,
        "status": "estimated" if known else "unestimated",
        "why": d.why,
        "rests_on": list(d.rests_on),
    }


def shown(d: Derived, value: float) -> str:
    """A value of a quantity, in the unit of WORDS."""
    return f"{from_si(value, 'deg') if d.unit == 'rad' else value:.3g}"


def _spoken(q: Qualities, name: str) -> str:
    d = q.quantities[name]
    if d.why:
        return ""
    low, high = (shown(d, x) for x in d.ci95)
    unit = WORDS[name][1]
    return f"{shown(d, d.estimate)}{'' if unit == '1' else f' {unit}'} ({low} to {high})"


LINES: Final = (
    {"short period": ("short_period_frequency", "short_period_damping")},
    {"phugoid": ("phugoid_frequency", "phugoid_damping")},
    {"n/alpha": ("n_per_alpha",), "CAP": ("control_anticipation",)},
    {"static margin": ("static_margin",), "measured elevator": ("elevator_per_g",)},
)
"""Of the terminal."""


def derived_lines(q: Qualities | str) -> list[str]:
    """Derived quantities in a few lines, with their 95 % intervals."""
    if isinstance(q, str):
        return [f"derived quantities: none: {q}"]
    lines = []
    unknown: dict[str, list[str]] = {}
    for line in LINES:
        parts = []
        for word, names in line.items():
            said = [x for x in (_spoken(q, n) for n in names) if x]
            if said:
                parts.append(f"{word} {', damping '.join(said)}")
            else:
                unknown.setdefault(q.quantities[names[0]].why, []).append(word)
        lines += ["; ".join(parts)] if parts else []
    lines += [f"{', '.join(words)}: cannot be known: {why}" for why, words in unknown.items()]
    found = levels_of(q)
    if found:
        own = ", ".join(f"category {c} {level_words(*v)}" for c, v in found.items())
        lines.append(f"short period by MIL-F-8785C: {own}")
    return [f"derived at {q.condition.speed:.1f} m/s: {lines[0]}", *(f"  {line}" for line in lines[1:])]


def level_words(own: int, best: int, worst: int) -> str:
    """A level, and what its interval leaves open."""

    def word(k: int) -> str:
        return f"level {k}" if k <= len(LEVELS["B"]) else "no level"

    return word(own) if best == worst == own else f"{word(own)} ({best} to {worst} within the interval)"

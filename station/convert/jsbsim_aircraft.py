"""An aircraft profile as an aircraft of JSBSim: one XML file with mass, surfaces, thrust and aerodynamics.

Coefficients are the profile's own, per radian, rates normalised with q c/2V and b/2V, in the forces of the equations of
motion (X and Z from CL and CD by the angle of attack). Format: JSBSim Reference Manual, and its class documentation
(FGAerodynamics, FGFunction, FGActuator, FGExternalReactions). CG and reference point are the origin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final
from xml.sax.saxutils import escape

from station.conventions import to_si
from station.profile import Actuator, Aircraft
from station.rows import LogError, UsageError

SUFFIX: Final = ".xml"
THRUST: Final = "external_reactions/thrust/magnitude"
"""Property that is the thrust, lbf."""
_FORCE: Final = ("aero/qbar-psf", "metrics/Sw-sqft")
_MOTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "alpha": ("aero/alpha-rad",), "alpha2": ("aero/alpha-rad", "aero/alpha-rad"),
    "alpha3": ("aero/alpha-rad", "aero/alpha-rad", "aero/alpha-rad"), "beta": ("aero/beta-rad",),
    "q": ("velocities/q-aero-rad_sec", "aero/ci2vel"), "p": ("velocities/p-aero-rad_sec", "aero/bi2vel"),
    "r": ("velocities/r-aero-rad_sec", "aero/bi2vel"), "de": ("fcs/elevator-pos-rad",),
    "da": ("fcs/aileron-pos-rad",), "dr": ("fcs/rudder-pos-rad",),
}  # fmt: skip
"""What a derivative multiplies."""
_LATERAL: Final = ("CY", "Cl", "Cn")


def write_jsbsim(aircraft: Aircraft, path: Path, heading: str) -> None:
    """Write the file; `heading` comes first, as a comment. Raises UsageError where a file is already or the profile has
    no iyy, LogError where it fails."""
    if path.exists():
        raise UsageError(f"{path}: is there already: an extended profile never replaces a file; name another")
    if aircraft.inertia.iyy is None:
        raise UsageError(f"{path}: aircraft {aircraft.name}: inertia.iyy: missing; JSBSim needs it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(to_jsbsim(aircraft, heading), encoding="utf-8")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error}") from error


def to_jsbsim(aircraft: Aircraft, heading: str) -> str:
    """The text of the file."""
    parts = [
        '<?xml version="1.0"?>',
        _comment(f"{heading}\n\n{_about(aircraft)}"),
        f'<fdm_config name="{_quoted(aircraft.name)}" version="2.0" release="ALPHA">',
        _header(aircraft),
        _metrics(aircraft),
        _mass(aircraft),
        "  <ground_reactions/>",
        _thrust(aircraft),
        _surfaces(aircraft),
        _aerodynamics(aircraft),
        "</fdm_config>",
    ]
    return "\n".join(parts) + "\n"


def _comment(words: str) -> str:
    # Two hyphens would end a comment.
    return "<!--\n" + "\n".join(f"  {line}".rstrip() for line in words.replace("--", "- -").splitlines()) + "\n-->"


def _about(aircraft: Aircraft) -> str:
    """What the file is to be flown with, and what of the profile it does not carry."""
    lost = []
    if aircraft.unsteady.memory:
        lost.append(
            "unsteady lift and the tail's late gust and downwash: the derivatives are their steady limits, so that the "
            "short period is less damped and slower or faster by what the lags make"
        )
    if aircraft.separation.alpha_star is not None:
        lost.append("the flow that leaves the wing: the lift is that of attached flow at every angle of attack")
    if any(n.endswith("_gust") for n in aircraft.derivatives):
        lost.append("derivatives with respect to the gust's part of the angle of attack")
    if aircraft.instruments or any(aircraft.imu_offset):
        lost.append("errors of instruments, and the imu's place")
    if aircraft.boom is not None:
        lost.append("the boom and its vane")
    given = {n[:2] for n in aircraft.derivatives}
    lost += [f"{c}: the profile gives none" for c in _LATERAL if c not in given]
    lines = [
        f"For aircraft/{aircraft.name}/{aircraft.name}.xml in JSBSim's root. The thrust is the property",
        f"{THRUST} (lbf). Surfaces: *-cmd-norm times the profile's limit, by its",
        "lag and rate limit. Signs: elevator trailing edge down, aileron right wing's trailing edge down (rolls left),",
        "rudder trailing edge left (yaws left).",
        "Not carried:",
    ]
    return "\n".join([*lines, *(f"- {x}" for x in lost or ["nothing"])])


def _header(a: Aircraft) -> str:
    sources = "".join(f'\n    <reference refID="none" author="" title="{_quoted(s)}" date=""/>' for s in a.sources)
    return f"  <fileheader>\n    <description>{escape(a.description or a.name)}</description>{sources}\n  </fileheader>"


def _quoted(words: str) -> str:
    return escape(words, {'"': "&quot;"})


def _place(name: str, x: float = 0.0, z: float = 0.0) -> str:
    return f'    <location name="{name}" unit="M"><x>{x!r}</x><y>0.0</y><z>{z!r}</z></location>'


def _metrics(a: Aircraft) -> str:
    g = a.geometry
    lines = [
        "  <metrics>",
        f'    <wingarea unit="M2">{g.wing_area!r}</wingarea>',
        f'    <wingspan unit="M">{g.span!r}</wingspan>',
        f'    <chord unit="M">{g.chord!r}</chord>',
        _place("AERORP"),
        _place("EYEPOINT"),
        _place("VRP"),
        "  </metrics>",
    ]
    return "\n".join(lines)


def _mass(a: Aircraft) -> str:
    """JSBSim needs all of the inertia: where the profile gives none about an axis, the pitch inertia stands in."""
    i = a.inertia
    rows = {"ixx": i.ixx or i.iyy, "iyy": i.iyy, "izz": i.izz or i.iyy, "ixz": i.ixz}
    lines = [f'    <{name} unit="KG*M2">{float(v or 0.0)!r}</{name}>' for name, v in rows.items()]
    weight = f'    <emptywt unit="KG">{i.mass!r}</emptywt>'
    return "\n".join(["  <mass_balance>", *lines, weight, _place("CG"), "  </mass_balance>"])


def _thrust(a: Aircraft) -> str:
    """A force along the thrust line, so far below the CG as its nose-up arm says."""
    along = f"<x>{math.cos(a.thrust_angle)!r}</x><y>0.0</y><z>{-math.sin(a.thrust_angle)!r}</z>"
    lines = [
        "  <external_reactions>",
        '    <force name="thrust" frame="BODY">',
        "  " + _place("thrust", z=-a.thrust_pitch_arm),
        f"      <direction>{along}</direction>",
        "    </force>",
        "  </external_reactions>",
    ]
    return "\n".join(lines)


def _surfaces(a: Aircraft) -> str:
    channels = []
    own: tuple[tuple[str, Actuator], ...] = (("elevator", a.elevator), ("aileron", a.aileron), ("rudder", a.rudder))
    for name, x in own:
        channels.append(
            f'    <channel name="{name}">\n'
            f'      <pure_gain name="fcs/{name}-cmd-rad">\n'
            f"        <input>fcs/{name}-cmd-norm</input><gain>{x.position_limit!r}</gain>\n"
            "      </pure_gain>\n"
            f'      <actuator name="fcs/{name}-actuator">\n'
            f"        <input>fcs/{name}-cmd-rad</input><lag>{1 / x.time_constant!r}</lag>\n"
            f"        <rate_limit>{x.rate_limit!r}</rate_limit>\n"
            f"        <clipto><min>{-x.position_limit!r}</min><max>{x.position_limit!r}</max></clipto>\n"
            f"        <output>fcs/{name}-pos-rad</output>\n"
            "      </actuator>\n"
            "    </channel>"
        )
    return "\n".join(["  <flight_control>", *channels, "  </flight_control>"])


def _aerodynamics(a: Aircraft) -> str:
    """Coefficients first, as functions of their own; then the forces that they make."""
    parts = ["  <aerodynamics>", _coefficient(a, "CL")]
    if a.drag is not None:
        polar = _term(["aero/CL", "aero/CL"], a.drag.induced)
        parts.append(_function("aero/CD", f"<sum><value>{a.drag.zero_lift!r}</value>{polar}</sum>"))
    else:
        parts.append(_coefficient(a, "CD"))
    given = [c for c in _LATERAL if any(n.startswith(f"{c}_") for n in a.derivatives)]
    parts += [_coefficient(a, c) for c in ("Cm", *given)]

    def along(lift: str, drag: str, sign: float) -> str:
        one, other = _by(lift, "aero/CL"), _by(drag, "aero/CD")
        inner = f"<sum>{one}<product><value>{sign!r}</value>{other}</product></sum>"
        return f"<product>{_properties(_FORCE)}{inner}</product>"

    z = f"<product><value>-1.0</value>{along('cos', 'sin', 1.0)}</product>"
    parts += [_axis("X", along("sin", "cos", -1.0)), _axis("Z", z)]
    lengths = {"Cm": ("PITCH", "metrics/cbarw-ft"), "Cl": ("ROLL", "metrics/bw-ft"), "Cn": ("YAW", "metrics/bw-ft")}
    for c in ("Cm", *given):
        axis, length = lengths.get(c, ("Y", ""))
        parts.append(_axis(axis, f"<product>{_properties((*_FORCE, *filter(None, (length,)), f'aero/{c}'))}</product>"))
    return "\n".join([*parts, "  </aerodynamics>"])


def _coefficient(a: Aircraft, c: str) -> str:
    """A coefficient as the sum of what the profile gives of it."""
    terms = [f"<value>{a.value(f'{c}_0')!r}</value>"]
    if a.value(f"{c}_V") and a.reference_speed:
        terms.append(_term(["velocities/vt-fps"], a.value(f"{c}_V") * to_si(1.0, "ft/s") / a.reference_speed))
    for of, motion in _MOTIONS.items():
        if value := a.value(f"{c}_{of}"):
            if a.rate_reference == "fixed" and a.reference_speed and of in ("p", "q", "r"):
                length = a.geometry.chord if of == "q" else a.geometry.span
                motion, value = motion[:1], value * length / (2 * a.reference_speed)
            terms.append(_term(motion, value))
    return _function(f"aero/{c}", f"<sum>{''.join(terms)}</sum>")


def _term(properties: tuple[str, ...] | list[str], value: float) -> str:
    return f"<product>{_properties(properties)}<value>{value!r}</value></product>"


def _properties(names: tuple[str, ...] | list[str]) -> str:
    return "".join(f"<property>{n}</property>" for n in names)


def _by(function: str, coefficient: str) -> str:
    """A coefficient times a function of the angle of attack."""
    angle = "<property>aero/alpha-rad</property>"
    return f"<product><property>{coefficient}</property><{function}>{angle}</{function}></product>"


def _function(name: str, body: str, indent: str = "    ") -> str:
    return f'{indent}<function name="{name}">\n{indent}  {body}\n{indent}</function>'


def _axis(name: str, body: str) -> str:
    return f'    <axis name="{name}">\n' + _function(f"aero/force/{name}", body, "      ") + "\n    </axis>"

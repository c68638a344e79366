"""Every key of a profile as a table: unit, default and meaning, from the models and the strings below their fields."""

from __future__ import annotations

import ast
import inspect
import sys
import types
from collections.abc import Iterable, Iterator
from functools import cache
from typing import Annotated, Any, Final, Literal, get_args, get_origin

from markdown_table import markdown
from pydantic import BaseModel, BeforeValidator
from pydantic_core import PydanticUndefined

from station.campaign import spec, study
from station.conventions import from_si
from station.profile import (
    aircraft,
    altered,
    card,
    channel,
    declared,
    fin,
    outline,
    probe,
    propulsion,
    rig,
    rig_loop,
    shapes,
    step,
    told_by_flight,
    uncertainty,
)

SHOWN_IN: Final = {"rad": "deg", "byte": "MiB", "rad s2/m": "deg/g", "rad/s": "deg/s"}
"""Units in which a default is written, where SI is not what one says."""


@cache
def attribute_docs(module: types.ModuleType) -> dict[tuple[str, str], str]:
    """The string under a field, by class and field, which Python itself throws away."""
    found = {}
    for node in ast.parse(inspect.getsource(module)).body:
        if not isinstance(node, ast.ClassDef):
            continue
        for field, after in zip(node.body, node.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(after, ast.Expr):
                found[node.name, field.target.id] = " ".join(inspect.cleandoc(ast.literal_eval(after.value)).split())
    return found


def meaning(model: type[BaseModel], field: str) -> str:
    for cls in model.__mro__:
        module = sys.modules[cls.__module__]
        text = attribute_docs(module).get((cls.__name__, field)) if cls.__module__.startswith("station.") else None
        if text:
            return text
    raise KeyError(f"{model.__module__}.{model.__name__}.{field} has no docstring: say below it what it means")


def parts_of(annotation: Any, metadata: Iterable[Any] = ()) -> Iterator[Any]:
    """The types and validators that an annotation is put together from."""
    yield from metadata
    if get_origin(annotation) is Annotated:
        inner, *extra = get_args(annotation)
        yield from parts_of(inner, extra)
    elif get_origin(annotation) is Literal:
        yield annotation
    elif get_args(annotation):
        for inner in get_args(annotation):
            yield from parts_of(inner)
    else:
        yield annotation


def unit_of(parts: Iterable[Any]) -> str:
    """SI unit of a quantity, "" where it is none."""
    for part in parts:
        if isinstance(part, BeforeValidator):
            inside = inspect.getclosurevars(part.func).nonlocals
            if "si" in inside:
                return str(inside["si"])
    return ""


def kind_of(annotation: Any, parts: list[Any]) -> str:
    unit = unit_of(parts)
    if unit:
        return unit
    words = [w for p in parts if get_origin(p) is Literal for w in get_args(p)]
    if words:
        return " or ".join(f"`{w}`" for w in words)
    plain = {float: "number", int: "whole number", bool: "true or false", str: "text"}
    return next((plain[p] for p in parts if p in plain), "table")


def shown(value: Any, unit: str) -> str:
    """A default as one writes it in a profile."""
    if value is PydanticUndefined:
        return "required"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if value is None or isinstance(value, BaseModel) or value in ((), {}, ""):
        return "none"
    if isinstance(value, tuple):
        return ", ".join(shown(v, unit) for v in value)
    if unit:
        name = SHOWN_IN.get(unit, unit)
        return f'`"{from_si(value, name):.4g} {name}"`'
    return f"`{value}`"


def models_in(annotation: Any) -> list[type[BaseModel]]:
    return [p for p in parts_of(annotation) if isinstance(p, type) and issubclass(p, BaseModel)]


def keys(title: str, model: type[BaseModel], shared: type[BaseModel] | None = None) -> str:
    """The keys of one TOML table, but for those that are tables themselves or stand in `shared`."""
    body = []
    for name, info in model.model_fields.items():
        if models_in(info.annotation) or (shared is not None and name in shared.model_fields):
            continue
        parts = list(parts_of(info.annotation, info.metadata))
        default = info.get_default(call_default_factory=True) if not info.is_required() else PydanticUndefined
        kind, written = kind_of(info.annotation, parts), shown(default, unit_of(parts))
        body.append((f"`{name}`", kind, written, meaning(model, name)))
    about = " ".join((model.__doc__ or "").split())
    return (
        f"{f'{title}: {about}' if about else title}\n\n{markdown(('key', 'unit or kind', 'default', 'meaning'), body)}"
    )


def of(*tables: tuple[Any, ...]) -> str:
    return "\n".join(keys(*table) for table in tables)


def aircraft_keys() -> str:
    return of(
        ("Top of the file", aircraft.Aircraft),
        ("`[geometry]`", aircraft.Geometry),
        ("`[inertia]`", aircraft.Inertia),
        ("`[boom]`", aircraft.Boom),
        ("`[second_vane]`, whose other keys are as `[boom]`", aircraft.SecondVane, aircraft.Boom),
        ("`[derivatives.CL_alpha]` and so on", aircraft.Derivative),
        ("`[drag]`", aircraft.Drag),
        ('`[engine]` with `kind = "propeller"`', propulsion.Propeller),
        ('`[engine]` with `kind = "table"`', propulsion.ThrustTable),
        ("`[unsteady]`", aircraft.Unsteady),
        ("`[unsteady.lift_motion]` and the other indicial responses", aircraft.Indicial),
        ("`[fin]`", fin.Fin),
        ("`[planform]`", outline.Planform),
        ("`[separation]`", aircraft.Separation),
        ("`[uncertainty]`", uncertainty.Uncertainty),
        ("`[elevator]`, `[aileron]`, `[rudder]`", aircraft.Actuator),
        ("`[instruments.SIGNAL]`", aircraft.Instrument),
        ("`[measured]`", told_by_flight.Measured),
        ("`[calibrated]`", told_by_flight.Calibrated),
    )


def rig_keys() -> str:
    device = rig.SerialDevice.__mro__[1]
    return of(
        ("Top of the file", rig.Rig),
        ("`[[devices]]`, any", device),
        ('`[[devices]]` with `link = "serial"`', rig.SerialDevice, device),
        ('`[[devices]]` with `link = "can"`', rig.CanDevice, device),
        ('`[[devices]]` with `link = "dronecan"`, as `can` but for `dbc`', rig.DronecanDevice, rig.CanBus),
        ('`[[devices]]` with `link = "mavlink"`', rig.MavlinkDevice, device),
        ("`[[devices.streams]]`", rig.StreamProfile),
        ("`[devices.streams.signals]`, one line a signal", channel.Channel),
        ("`[devices.streams.probe]`", probe.Probe),
        ("`[devices.streams.probe.alpha]`, `.beta`, `.dynamic_pressure`", probe.Curve),
        ("`[signals.NAME]`", declared.DeclaredSignal),
        ("`[derived.NAME]`", declared.DerivedSignal),
        ("`[loop]`", rig_loop.MeasuredLoop),
        ("`[loop]`", rig_loop.JoystickLoop, rig_loop.MeasuredLoop.__mro__[1]),
        ("`[loop]`, an autopilot's", rig_loop.CommandedLoop, rig_loop.MeasuredLoop),
        ("`[loop]`", rig_loop.MavlinkLoop, rig_loop.CommandedLoop),
        ("`[loop]`", rig_loop.JsonLoop, rig_loop.CommandedLoop),
    )


def card_keys() -> str:
    wave = shapes.Doublet.__mro__[1]
    return of(
        ("Top of the file", card.Card),
        ("`[flight]`", card.Flight),
        ("`[[flight.gusts]]`", shapes.DiscreteGust),
        ("`[flight.truth]`, by key of the aircraft's profile", altered.Change),
        ("`[[manoeuvres]]`, any", wave),
        ('`kind = "doublet"`', shapes.Doublet, wave),
        ('`kind = "3-2-1-1"`', shapes.ThreeTwoOneOne, wave),
        ('`kind = "multisine"`', shapes.Multisine, wave),
        ('`kind = "sweep"`', shapes.Sweep, wave),
        ('`kind = "pulse"`', shapes.Pulse, wave),
        ("`[[points]]`", card.TestPoint),
        ("`[[steps]]`, whose `[[steps.inputs]]` are as `[[manoeuvres]]`", step.Step),
        ("`[steps.condition]`", step.Condition),
        ("`[limits]`", step.Limits),
        ("`[pilot]`, and `[pilots.NAME]` of a campaign", card.Pilot),
        ("`[[faults]]`", card.Fault),
    )


def campaign_keys() -> str:
    return of(
        ("Top of the file", spec.Campaign),
        ("`[flight]`", spec.Scenario),
        ("`[distortion]`", spec.Distortion),
        ("`[[claims]]`", study.Claim),
        ("`[[comparisons]]`", study.Comparison),
        ("`[baseline]`", study.Baseline),
        ("`[[tables]]`", study.PrintedTable),
        ("`[[tables.rows]]`", study.PrintedRow),
    )

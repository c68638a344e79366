"""Writes those tables of the READMEs that are tables in code, between `<!-- generated: NAME -->` and `<!-- end -->`.

uv run python tests/house/generated.py            lists what is stale, exit code 1 if anything is
uv run python tests/house/generated.py --write    writes it anew
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
import tomllib
import types
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args, get_origin

import msgspec
from pydantic import BaseModel, BeforeValidator
from pydantic_core import PydanticUndefined

from drivers.faults import FAULTS
from drivers.mavlink_messages import DERIVED, TABLE
from drivers.protocols import PROTOCOLS, protocol_named
from station import rows
from station.__main__ import VERBS
from station.campaign import spec
from station.conventions import SIGNALS, STREAMS, UNIT_ALIASES, UNITS, from_si
from station.convert import IMPORTERS
from station.diagnosis.effects import BY_ID, EFFECTS, Term
from station.estimation.method_table import METHODS
from station.profile import aircraft, card, rig, uncertainty

ROOT: Final = Path(__file__).parents[2]
BLOCK: Final = re.compile(r"<!-- generated: (\S+) -->\n(.*?)<!-- end -->", re.DOTALL)
SHOWN_IN: Final = {"rad": "deg", "byte": "MiB", "rad s2/m": "deg/g", "rad/s": "deg/s"}
"""Units in which a default is written, where SI is not what one says."""


def markdown(head: Iterable[str], body: Iterable[Iterable[str]]) -> str:
    """A table of cells; a bar in a cell is escaped."""
    lines = [list(head)]
    lines += [["---"] * len(lines[0])]
    lines += [[cell.replace("|", "\\|") for cell in row] for row in body]
    return "".join(f"| {' | '.join(row)} |\n" for row in lines)


# --- signals, units, rows


def signals() -> str:
    body = [(f"`{s.name}`", s.unit, f"{s.low:g} to {s.high:g}", s.positive) for s in SIGNALS.values()]
    return markdown(("signal", "unit", "believed from, to", "positive"), body)


def streams() -> str:
    return markdown(
        ("stream", "signals", "Hz"), ((f"`{s.name}`", " ".join(s.signals), f"{s.rate_hz:g}") for s in STREAMS.values())
    )


def units() -> str:
    """Every unit by the SI unit it is one of, with its other spellings."""
    others: dict[str, list[str]] = {}
    for alias, name in UNIT_ALIASES.items():
        others.setdefault(name, []).append(alias)
    kinds: dict[str, list[str]] = {}
    for name, unit in UNITS.items():
        also = [f"`{a}`" for a in others.get(name, []) if a]
        kinds.setdefault(unit.si, []).append(f"`{name}`" + (f" ({', '.join(also)})" if also else ""))
    return markdown(("SI", "known units (other spellings)"), ((si, ", ".join(names)) for si, names in kinds.items()))


def row_fields(kind: type[Any]) -> str:
    return ", ".join(f"`{f.name}`" for f in msgspec.structs.fields(kind) if f.name != "t_ns")


def first_sentence(documented: object) -> str:
    return " ".join((inspect.getdoc(documented) or "").split("\n\n")[0].split())


CHANNELS: Final = {
    "/raw/DEVICE": rows.RawBlock,
    "/sample/DEVICE.STREAM": rows.Sample,
    "/time_sync": rows.TimeSync,
    "/tick": rows.Tick,
    "/frame": rows.Frame,
    "/alpha": rows.AlphaEstimate,
    "/method/NAME": rows.MethodEstimate,
    "/health": rows.Health,
    "/event": rows.Event,
    "/truth": rows.Truth,
    "/extra": rows.Extra,
}


def channels() -> str:
    body = ((f"`{topic}`", row_fields(kind), first_sentence(kind)) for topic, kind in CHANNELS.items())
    return markdown(("channel", "fields", "what it is"), body)


def events() -> str:
    body = []
    for level in rows.Level:
        codes = [f"`{c}`" for c in rows.Code if rows.LEVELS[c] is level]
        body.append((level.name.lower(), ", ".join(codes)))
    return markdown(("level", "codes"), body)


# --- profiles


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
        ("`[derivatives.CL_alpha]` and so on", aircraft.Derivative),
        ("`[drag]`", aircraft.Drag),
        ("`[unsteady]`", aircraft.Unsteady),
        ("`[unsteady.lift_motion]` and the other indicial responses", aircraft.Indicial),
        ("`[uncertainty]`", uncertainty.Uncertainty),
        ("`[elevator]`, `[aileron]`, `[rudder]`", aircraft.Actuator),
        ("`[instruments.SIGNAL]`", aircraft.Instrument),
    )


def rig_keys() -> str:
    device = rig.SerialDevice.__mro__[1]
    return of(
        ("Top of the file", rig.Rig),
        ("`[[devices]]`, any", device),
        ('`[[devices]]` with `link = "serial"`', rig.SerialDevice, device),
        ('`[[devices]]` with `link = "can"`', rig.CanDevice, device),
        ('`[[devices]]` with `link = "mavlink"`', rig.MavlinkDevice, device),
        ("`[[devices.streams]]`", rig.StreamProfile),
        ("`[devices.streams.signals]`, one line a signal", rig.Channel),
    )


def card_keys() -> str:
    wave = card.Doublet.__mro__[1]
    return of(
        ("Top of the file", card.Card),
        ("`[flight]`", card.Flight),
        ("`[[manoeuvres]]`, any", wave),
        ('`kind = "doublet"`', card.Doublet, wave),
        ('`kind = "3-2-1-1"`', card.ThreeTwoOneOne, wave),
        ('`kind = "multisine"`', card.Multisine, wave),
        ('`kind = "sweep"`', card.Sweep, wave),
        ('`kind = "pulse"`', card.Pulse, wave),
        ("`[[faults]]`", card.Fault),
    )


def campaign_keys() -> str:
    return of(
        ("Top of the file", spec.Campaign),
        ("`[flight]`", spec.Scenario),
        ("`[distortion]`", spec.Distortion),
        ("`[[claims]]`", spec.Claim),
        ("`[[comparisons]]`", spec.Comparison),
    )


def library() -> str:
    """What ships: every aircraft, rig, card and campaign by its own description."""
    body = []
    for folder in ("aircraft", "rigs", "cards", "campaigns"):
        for path in sorted((ROOT / "profiles" / folder).glob("*.toml")):
            about = tomllib.loads(path.read_text())["description"]
            body.append((f"[{folder}/{path.stem}]({folder}/{path.name})", about))
    return markdown(("profile", "what it is"), body)


# --- wings, methods, effects, verbs


def sentence_of(name: str) -> str:
    """With what a module, or a package, opens."""
    path = ROOT / "station" / f"{name}.py"
    path = path if path.is_file() else ROOT / "station" / name / "__init__.py"
    text = ast.get_docstring(ast.parse(path.read_text())) or ""
    return " ".join(text.split("\n\n")[0].split())


def wings() -> str:
    """The floors of the import contract, the highest first."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    floors = next(c["layers"] for c in contracts if c["type"] == "layers")
    body = []
    for number, floor in zip(range(len(floors), 0, -1), floors, strict=True):
        body += [(str(number), f"`{name}`", sentence_of(name)) for name in floor.split(" | ")]
    return markdown(("floor", "wing", "what it is"), body)


def methods() -> str:
    def yes(of: bool) -> str:
        return "yes" if of else ""

    angles = {
        "steady": "vane, calibrated steadily",
        "delayed": "vane, delayed",
        "split": "motion and gust apart",
        "none": "models the vane",
    }
    body = (
        (
            f"`{m.name}`",
            m.sentence,
            angles[m.angle],
            yes(m.live),
            yes(m.lateral),
            "turbulence" if m.turbulence_only else "any",
        )
        for m in METHODS.values()
    )
    return markdown(("method", "what it is", "angle of attack", "live", "lateral too", "in which air"), body)


def range_of(term: Term) -> str:
    return f"{from_si(term.low, term.shown):.3g} to {from_si(term.high, term.shown):.3g}"


def effects() -> str:
    assert set(BY_ID) == {t.id for t in EFFECTS}
    body = (
        (
            f"`{t.id}`",
            t.sentence.format(value="x", size="x"),
            "" if t.shown == "1" else t.shown,
            range_of(t),
            t.target,
            ", ".join(t.shows_in),
            t.separate_by,
        )
        for t in EFFECTS
    )
    return markdown(
        ("effect", "what the report says", "unit", "range", "changes", "residuals that show it", "separated by"), body
    )


# --- drivers and other people's files


def protocols() -> str:
    body = []
    for name in PROTOCOLS:
        row = protocol_named(name)
        fields = tuple(dict.fromkeys(field for known in row.fields.values() for field in known))
        messages = row.messages or ", ".join(map(str, row.fields))
        body.append((f"`{name}`", row.sentence, messages, listed(fields), str(row.baud)))
    return markdown(("protocol", "on the wire", "`message`", "fields", "baud"), body)


def mavlink_messages() -> str:
    body = []
    for name, layout in TABLE.items():
        by_unit: dict[str, list[str]] = {}
        for field, unit in {**{n: f.unit for n, f in layout.fields.items()}, **DERIVED.get(name, {})}.items():
            by_unit.setdefault(unit, []).append(field)
        body.append((f"`{name}`", "; ".join(f"{listed(n)} {unit}".removesuffix(" 1") for unit, n in by_unit.items())))
    return markdown(("message", "fields"), body)


def listed(names: Sequence[str], most: int = 9) -> str:
    return " ".join(f"`{n}`" for n in names) if len(names) <= most else f"`{names[0]}` to `{names[-1]}`"


def faults() -> str:
    body = ((f"`{k}`", row.sentence, row.value, f"{row.usual:g}" if row.value else "") for k, row in FAULTS.items())
    return markdown(("kind", "what the device does", "`value`", "if left out"), body)


def importers() -> str:
    body = [(f"`{row.suffix}`", row.sentence) for row in IMPORTERS]
    return markdown(("file", "from"), [*body, ("`.bin`", "ArduPilot's DataFlash")])


def verbs() -> str:
    return markdown(("verb", ""), ((f"`station {name}`", words) for name, words in VERBS.items()))


BLOCKS: Final[dict[str, Callable[[], str]]] = {
    "signals": signals,
    "streams": streams,
    "units": units,
    "channels": channels,
    "events": events,
    "aircraft": aircraft_keys,
    "rig": rig_keys,
    "card": card_keys,
    "campaign": campaign_keys,
    "library": library,
    "wings": wings,
    "methods": methods,
    "effects": effects,
    "verbs": verbs,
    "protocols": protocols,
    "mavlink": mavlink_messages,
    "faults": faults,
    "importers": importers,
}


def renewed(page: str) -> str:
    """A page with its blocks as the code has them now. Raises KeyError for a block that nothing makes."""
    return BLOCK.sub(lambda m: f"<!-- generated: {m[1]} -->\n{BLOCKS[m[1]]()}<!-- end -->", page)


def pages() -> list[Path]:
    """Every README of the project."""
    return sorted(p for p in ROOT.rglob("README.md") if ".venv" not in p.parts)


def main() -> int:
    write = "--write" in sys.argv[1:]
    stale = 0
    for path in pages():
        old = path.read_text()
        new = renewed(old)
        if new != old:
            stale += 1
            print(f"{path.relative_to(ROOT)}: {'written' if write else 'stale'}")
            if write:
                path.write_text(new)
    return 0 if write else min(stale, 1)


if __name__ == "__main__":
    sys.exit(main())

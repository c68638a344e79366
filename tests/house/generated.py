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
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
from licences import licences
from markdown_table import markdown
from profile_keys import aircraft_keys, campaign_keys, card_keys, rig_keys

from drivers.can_dronecan import USUAL, fields_of
from drivers.faults import FAULTS
from drivers.mavlink_messages import DERIVED, TABLE
from drivers.protocols import PROTOCOLS, protocol_named
from station import rows
from station.__main__ import VERBS
from station.conventions import SIGNALS, STREAMS, UNIT_ALIASES, UNITS, from_si
from station.convert import IMPORTERS
from station.diagnosis.effects import BY_ID, EFFECTS
from station.diagnosis.lateral_effects import LATERAL_EFFECTS
from station.diagnosis.term import Term
from station.estimation.method_table import METHODS

ROOT: Final = Path(__file__).parents[2]
BLOCK: Final = re.compile(r"<!-- generated: (\S+) -->\n(.*?)<!-- end -->", re.DOTALL)


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
    assert set(BY_ID) == {t.id for t in (*EFFECTS, *LATERAL_EFFECTS)}
    return rows_of(EFFECTS)


def lateral_effects() -> str:
    return rows_of(LATERAL_EFFECTS)


def rows_of(terms: Sequence[Term]) -> str:
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
        for t in terms
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


def dronecan_messages() -> str:
    return markdown(("message", "fields"), ((f"`{name}`", listed(fields_of(name), 14)) for name in USUAL))


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
    "lateral_effects": lateral_effects,
    "verbs": verbs,
    "protocols": protocols,
    "dronecan": dronecan_messages,
    "mavlink": mavlink_messages,
    "faults": faults,
    "importers": importers,
    "licences": licences,
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

"""Frames <-> messages of a recording: every signal by name, its age and quality in the order of the names.

The further signals that a rig declares stand after the station's; their names are the key of the channel, so that a
frame reads back without anything else of the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any, Final

import msgspec

from station.conventions import SIGNALS
from station.rows import Frame, Quality

_NAMES: Final = tuple(SIGNALS)
_SPLIT: Final = " "
Spelled = float | str | None
"""A number as it is written: NaN is null, and an infinity a word."""


def key_of(further: Iterable[str]) -> str:
    """The channel's key for frames with these further signals; "" without any."""
    return _SPLIT.join(further)


def body_of(further: Iterable[str]) -> Callable[..., msgspec.Struct]:
    """Makes what is encoded, of values, then k, ages and quality."""
    return msgspec.defstruct("Frame", (*_NAMES, *further, "k", "age_s", "quality"), gc=False)


def frame_properties(signals: Iterable[Mapping[str, Any]], names: Iterable[str]) -> Mapping[str, Any]:
    """JSON schema of a frame, from those of its signals."""
    whole = {"type": "integer"}
    age = {"type": "number", "unit": "s", "description": "s"}
    return {
        **dict(zip(names, signals, strict=True)),
        "k": whole,
        "age_s": {"type": "array", "items": age, "description": "s; in the order of the signals"},
        "quality": {"type": "array", "items": whole},
    }


@lru_cache(maxsize=8)
def _decoder(key: str) -> Callable[[bytes], Any]:
    names = (*_NAMES, *key.split())
    fields: list[Any] = [(n, Spelled, None) for n in names]
    fields += [("k", int), ("age_s", list[Spelled]), ("quality", list[int]), ("t_ns", int | None, None)]
    return msgspec.json.Decoder(msgspec.defstruct("FrameRead", fields, gc=False, kw_only=True)).decode


def read_frame(key: str, time_ns: int, data: bytes) -> Frame:
    """A frame from its message. Raises ValueError where it is none."""
    *values, k, ages, quality, t_ns = msgspec.structs.astuple(_decoder(key)(data))
    # A recording made before a signal was added to the table lacks it: it is missing before the further ones.
    lacking = len(values) - len(ages)
    if lacking:
        at = len(ages) - len(key.split())
        ages = [*ages[:at], *[None] * lacking, *ages[at:]]
        quality = [*quality[:at], *[int(Quality.MISSING)] * lacking, *quality[at:]]
    return Frame(time_ns if t_ns is None else t_ns, k, numbers(values), numbers(ages), tuple(quality))


def number(value: Any) -> float:
    return math.nan if value is None else float(value)


def numbers(values: Iterable[Any]) -> tuple[float, ...]:
    return tuple([v if type(v) is float else number(v) for v in values])

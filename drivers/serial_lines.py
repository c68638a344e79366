"""Lines of numbers in text, as loggers, analogue boxes and home-made vanes send them: `2.51,0.03,101.3` and a line end.

Numbers are separated by commas, semicolons, blanks or tabs; an empty place between commas is no reading. A line that
begins with a name (`aoa 2.51`, `AIN,1.2,3.4`) is a message of that name, one of numbers alone is "line". The fields are
"c0", "c1", ... in order, as many as come. There is neither time nor checksum: arrival counts, and a garbled digit is
read as it came.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from drivers.codec import Reading
from drivers.framing import CutCodec
from drivers.protocols import Protocol

LINE: Final = "line"
"""What a rig calls a line without a name."""
FIELDS: Final = tuple(f"c{i}" for i in range(64))
"""What a rig may name."""
_LONGEST_LINE: Final = 1024
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_SEPARATOR: Final = re.compile(r"\s*[,;\t]\s*| +")


class _AnyName(Mapping[str | int, Sequence[str]]):
    """Any name may begin a line."""

    def __getitem__(self, name: str | int) -> Sequence[str]:
        if isinstance(name, str) and _NAME.fullmatch(name):
            return FIELDS
        raise KeyError(name)

    def __iter__(self) -> Iterator[str | int]:
        return iter((LINE,))

    def __len__(self) -> int:
        return 1


def _read_line(line: bytes) -> Sequence[Reading] | None:
    try:
        texts = _SEPARATOR.split(line.decode("ascii").strip())
    except UnicodeDecodeError:
        return None
    if texts == [""]:
        return ()
    name = texts.pop(0) if _NAME.fullmatch(texts[0]) and texts[0].lower() not in ("nan", "inf", "infinity") else LINE
    try:
        numbers = [float(text) if text else math.nan for text in texts]
    except ValueError:
        return None
    if not numbers or len(numbers) > len(FIELDS):
        return None
    return (Reading(name, None, None, dict(zip(FIELDS, numbers, strict=False))),)


class LinesCodec(CutCodec):
    """Lines to readings; one that is not numbers (a heading) is counted. What comes before the first line end is passed
    over: who listens in the middle of `13.25` hears `3.25`, and no checksum tells."""

    def __init__(self) -> None:
        super().__init__(b"\n", _LONGEST_LINE, _read_line, whole=False)


def _line(reading: Reading) -> bytes:
    """As many numbers as the last field that the rig maps, to nine figures."""
    highest = max(int(name[1:]) for name in reading.fields)
    values = (reading.fields.get(name, math.nan) for name in FIELDS[: highest + 1])
    texts = ["" if math.isnan(value) else f"{value:.9g}" for value in values]
    return (",".join(texts if reading.message == LINE else [str(reading.message), *texts]) + "\r\n").encode("ascii")


LINES: Final = Protocol(
    "lines of numbers in text: `2.51,0.03,101.3`, with or without a name before them",
    LinesCodec,
    _AnyName(),
    _line,
    messages='the name that begins the line, "line" without one',
)

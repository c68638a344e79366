"""What a setup record (TMATS, IRIG 106 Chapter 9) says of measurements: where each is, what its counts mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.convert.tracks import Column
from station.rows import LogError

Setup = Mapping[str, str]
Counts = NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class Fragment:
    """A piece of a sample: a word of the minor frame, counted from 1 behind the synchronisation pattern."""

    word: int
    interval: int
    """Words to the next sample in the frame; 0: there is none."""
    frame: int
    """Minor frame, from 1."""
    frames: int
    """Minor frames to the next sample; 0: once in a major frame."""
    mask: str
    """Of 0 and 1, a digit a bit; empty: the whole word."""


@dataclass(frozen=True, slots=True)
class Conversion:
    """Of counts into the engineering unit of the measurement."""

    name: str
    unit: str
    form: str
    """Binary format: UNS, TWO, ..."""
    convert: Callable[[Column], Column]


@dataclass(frozen=True, slots=True)
class PcmFormat:
    """A stream of minor frames."""

    rate: float
    """Bits a second."""
    widths: tuple[int, ...]
    """Bits of each word behind the synchronisation pattern."""
    sync: str
    """The pattern's digits; X may be either."""
    minor_frames: int
    counter: tuple[int, int, int, int, int, int] | None
    """Of subframes: word, its first bit (from 1), bits, initial value, the minor frame that has it, direction."""

    @property
    def bits(self) -> int:
        """Of a minor frame."""
        return len(self.sync) + sum(self.widths)


@dataclass(frozen=True, slots=True)
class Channel:
    """Of the recorder."""

    number: int
    data_type: str
    link: str
    index: str
    """x and n of R-x\\...-n: `x`, `n`."""


def indices(setup: Setup, code: str) -> list[str]:
    """What stands at * in `code`, of attributes that are there, in the order of its numbers."""
    head, tail = code.split("*")
    found = [k[len(head) : len(k) - len(tail) or None] for k in setup if k.startswith(head) and k.endswith(tail)]
    return sorted((i for i in found if i.isdecimal()), key=int)


def number(setup: Setup, code: str, default: float | None = None) -> float:
    """Raises LogError where it is missing (without default) or no number."""
    text = setup.get(code, "")
    if not text and default is not None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise LogError(f"setup record: {code}: {text or 'missing'}: a number is wanted")
    return value


def whole(setup: Setup, code: str, default: int | None = None, low: int = 0, high: int = 1_000_000) -> int:
    value = number(setup, code, default)
    if value != int(value) or not low <= value <= high:
        raise LogError(f"setup record: {code}: {setup.get(code)}: an integer of {low} to {high} is wanted")
    return int(value)


def channels(setup: Setup) -> list[Channel]:
    """Those with a number that names their packets."""
    found = []
    for x in indices(setup, "R-*\\ID") or indices(setup, "R-*\\N"):
        for n in indices(setup, f"R-{x}\\TK1-*"):
            link = next((setup[k] for k in (f"R-{x}\\{c}-{n}" for c in ("CDLN", "PDLN")) if k in setup), "")
            track = whole(setup, f"R-{x}\\TK1-{n}", high=0xFFFF)
            found.append(Channel(track, setup.get(f"R-{x}\\CDT-{n}", "").upper(), link, f"{x} {n}"))
    return found


def pcm_format(setup: Setup, link: str) -> PcmFormat:
    """Of the data link of that name. Raises LogError where TMATS does not tell enough, or what is not read here."""
    d = _of_link(setup, "P", link)
    if (kind := setup.get(f"P-{d}\\F2", "M").upper()) not in ("M", ""):
        raise LogError(f"setup record: P-{d}\\F2: {kind}: only words whose most significant bit comes first are read")
    if (parity := setup.get(f"P-{d}\\F3", "NO").upper()) not in ("NO", "NONE", ""):
        raise LogError(f"setup record: P-{d}\\F3: {parity}: words with parity are not read")
    common = whole(setup, f"P-{d}\\F1", low=1, high=64)
    count = whole(setup, f"P-{d}\\MF1", low=2, high=65536) - 1
    widths = [common] * count
    for n in indices(setup, f"P-{d}\\MFW1-*"):
        at = whole(setup, f"P-{d}\\MFW1-{n}", low=1, high=count)
        widths[at - 1] = whole(setup, f"P-{d}\\MFW2-{n}", low=1, high=64)
    sync = setup.get(f"P-{d}\\MF5", "").upper()
    if not sync or set(sync) - set("01X"):
        raise LogError(
            f"setup record: P-{d}\\MF5: {sync or 'missing'}: the synchronisation pattern of 0 and 1 is wanted"
        )
    frames = whole(setup, f"P-{d}\\MF\\N", 1, low=1)
    counter = None
    if frames > 1:
        if setup.get(f"P-{d}\\ISF2-1", setup.get(f"P-{d}\\ISF1-1", "ID")).upper() not in ("ID", "1", "SFID"):
            raise LogError(f"setup record: P-{d}\\ISF2-1: only subframes told by an ID counter are read")
        at = whole(setup, f"P-{d}\\IDC1-1", low=1, high=count)
        width = whole(setup, f"P-{d}\\IDC4-1", widths[at - 1], low=1, high=widths[at - 1])
        first = whole(setup, f"P-{d}\\IDC3-1", widths[at - 1] - width + 1, low=1, high=widths[at - 1] - width + 1)
        down = setup.get(f"P-{d}\\IDC10-1", "INC").upper().startswith("DEC")
        initial = whole(setup, f"P-{d}\\IDC6-1", 0)
        counter = (at, first, width, initial, whole(setup, f"P-{d}\\IDC7-1", 1), -1 if down else 1)
    rate = number(setup, f"P-{d}\\D2")
    if rate <= 0:
        raise LogError(f"setup record: P-{d}\\D2: {rate}: the bit rate is above 0")
    form = PcmFormat(rate, tuple(widths), sync, frames, counter)
    if (told := whole(setup, f"P-{d}\\MF2", form.bits, high=10**7)) != form.bits:
        raise LogError(f"setup record: P-{d}\\MF2: {told} bits a minor frame, but its words make {form.bits}")
    return form


def locations(setup: Setup, link: str) -> dict[str, list[list[Fragment]] | str]:
    """Measurements of a PCM link by name: the places of their samples, each in fragments, the most significant first;
    or why one is not read."""
    found: dict[str, list[list[Fragment]] | str] = {}
    for d in indices(setup, "D-*\\DLN"):
        if setup[f"D-{d}\\DLN"].upper() != link.upper():
            continue
        for y in indices(setup, f"D-{d}\\MLN-*") or ["1"]:
            for n in indices(setup, f"D-{d}\\MN-{y}-*"):
                kind = setup.get(f"D-{d}\\LT-{y}-{n}", "WDFR").upper()
                name = setup[f"D-{d}\\MN-{y}-{n}"]
                found[name] = (
                    _places(setup, d, f"{y}-{n}")
                    if kind == "WDFR"
                    else f"location type {kind}, where only word and frame (WDFR) is read"
                )
    return found


def _places(setup: Setup, d: str, yn: str) -> list[list[Fragment]] | str:
    order = setup.get(f"D-{d}\\MN3-{yn}", "D").upper()
    if order not in ("M", "D", ""):
        return f"transfer order {order}, where only the most significant bit first is read"
    places = []
    for m in range(1, whole(setup, f"D-{d}\\MML\\N-{yn}", 1, low=1, high=4096) + 1):
        place = []
        for e in range(1, whole(setup, f"D-{d}\\MNF\\N-{yn}-{m}", 1, low=1, high=64) + 1):
            at = f"{yn}-{m}-{e}"
            mask = setup.get(f"D-{d}\\WFM-{at}", "FW").upper()
            piece = Fragment(
                whole(setup, f"D-{d}\\WP-{at}", low=1),
                whole(setup, f"D-{d}\\WI-{at}", 0),
                whole(setup, f"D-{d}\\FP-{at}", 1, low=1),
                whole(setup, f"D-{d}\\FI-{at}", 1),
                "" if mask in ("FW", "") else mask,
            )
            if set(piece.mask) - set("01"):
                return f"mask {mask}, where 0 and 1 are wanted"
            place.append((whole(setup, f"D-{d}\\WFP-{at}", e), piece))
        places.append([piece for _, piece in sorted(place, key=lambda p: p[0])])
    return places


def conversions(setup: Setup) -> dict[str, Conversion | str]:
    """By the measurement's name: how its counts become its unit, or why that is not known."""
    found: dict[str, Conversion | str] = {}
    for d in indices(setup, "C-*\\DCN"):
        name = setup[f"C-{d}\\DCN"]
        convert = _convert(setup, d)
        if isinstance(convert, str):
            found[name] = convert
        else:
            found[name] = Conversion(
                name, setup.get(f"C-{d}\\MN3", ""), setup.get(f"C-{d}\\BFM", "UNS").upper(), convert
            )
    return found


def _convert(setup: Setup, d: str) -> Callable[[Column], Column] | str:
    kind = setup.get(f"C-{d}\\DCT", "NON").upper()
    if kind in ("NON", ""):
        return lambda counts: counts
    if kind in ("COE", "NPC"):
        code = "CO" if kind == "COE" else "NPC"
        order = whole(setup, f"C-{d}\\{code}\\N", high=20)
        terms = [number(setup, f"C-{d}\\{code}" + (f"-{n}" if n else ""), 0.0) for n in range(order + 1)]
        curve = np.polynomial.Polynomial(terms)
        return lambda counts: np.asarray(curve(counts if kind == "COE" else 1.0 / counts), dtype=np.float64)
    if kind == "PRS":
        pairs = indices(setup, f"C-{d}\\PS3-*")
        counts = np.array([number(setup, f"C-{d}\\PS3-{n}") for n in pairs])
        values = np.array([number(setup, f"C-{d}\\PS4-{n}") for n in pairs])
        if len(counts) < 2 or np.any(np.diff(np.sort(counts)) <= 0):  # noqa: PLR2004  a line has two points
            return "its pair sets are no curve: two or more, of different counts"
        by_count = np.argsort(counts)
        if setup.get(f"C-{d}\\PS1", "N").upper().startswith("Y"):
            order = whole(setup, f"C-{d}\\PS2", len(counts) - 1, low=1, high=len(counts) - 1)
            fit = np.polynomial.Polynomial.fit(counts, values, order)
            return lambda x: np.asarray(fit(x), dtype=np.float64)
        return lambda x: np.asarray(np.interp(x, counts[by_count], values[by_count]), dtype=np.float64)
    return f"conversion {kind}, where none (NON), coefficients (COE, NPC) and pair sets (PRS) are read"


def _of_link(setup: Setup, group: str, link: str) -> str:
    for d in indices(setup, f"{group}-*\\DLN"):
        if setup[f"{group}-{d}\\DLN"].upper() == link.upper():
            return d
    raise LogError(f"setup record: no {group} group of the data link {link!r}")


def as_numbers(counts: Counts, bits: int, form: str) -> Column | str:
    """Counts of that many bits in their binary format as numbers, or why not."""
    values = counts.astype(np.float64)
    top = 2.0 ** (bits - 1)
    negative = values >= top
    if form in ("UNS", "BIN", ""):
        return values
    if form == "TWO":
        return np.where(negative, values - 2.0**bits, values)
    if form == "OFF":
        return values - top
    if form == "ONE":
        return np.where(negative, values - (2.0**bits - 1), values)
    if form in ("SIG", "SIM"):  # the sign bit of a positive number is 0, is 1
        size = np.where(negative, values - top, values)
        return np.where(negative == (form == "SIG"), -size, size)
    if form == "FPT" and bits in (32, 64):
        return counts.astype(f"u{bits // 8}").view(f"f{bits // 8}").astype(np.float64)
    return f"binary format {form} of {bits} bits"

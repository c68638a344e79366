"""The three answers as a picture: one coloured tile each, in words that are read across a cockpit.

Of few colours, as numbers of a palette: a browser that draws without a graphics processor is seconds behind with
decoding a compressed one, and shows none meanwhile.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from station.screen.answers import State
from station.screen.brief import Brief

WIDTH: Final = 1280
"""Pixels: of a common screen."""
HEIGHT: Final = 126
FOOT: Final = 20
"""Of it, the line below the tiles."""
GAP: Final = 7
MARGIN: Final = 12
COLOURS: Final[dict[State, str]] = {"good": "#17663f", "doubt": "#8a5a00", "bad": "#a81f1f", "none": "#3d444d"}
GROUND: Final = "#0d1011"
"""The viewer's own, around the tiles."""
_SMALL, _LARGE, _DETAIL = 16, 42, 18
_LEAST: Final = 12
SHADES: Final = 6
"""Between a ground and white: edges of letters."""
PALETTE: Final = tuple(
    tuple(round(c + (255 - c) * shade / (SHADES - 1)) for c in bytes.fromhex(ground[1:]))
    for ground in (GROUND, *COLOURS.values())
    for shade in range(SHADES)
)
"""(red, green, blue), by number."""


def tiles(brief: Brief, foot: str) -> NDArray[np.uint8]:
    """Numbers of `PALETTE`, (HEIGHT, WIDTH); `foot` is a line below."""
    image = Image.new("L", (WIDTH, HEIGHT), 0)
    grounds = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    draw = ImageDraw.Draw(image)
    alpha, point, wrong = brief.alpha, brief.point, brief.wrong
    number = f"{brief.alpha_text} deg" if alpha.state in ("good", "doubt") else ""
    believed = ": ".join(w for w in (alpha.words if number else "", alpha.why) if w)
    asked = (
        ("May I believe alpha?", alpha.state, number or alpha.words, believed),
        ("Is the point done?", point.state, point.words, point.why),
        ("What is wrong?", wrong.state, wrong.words, wrong.why),
    )
    width = (WIDTH - GAP * (len(asked) - 1)) // len(asked)
    for i, (question, state, words, detail) in enumerate(asked):
        left = i * (width + GAP)
        grounds[: HEIGHT - FOOT - 3, left : left + width] = SHADES * (1 + list(COLOURS).index(state))
        room = width - 2 * MARGIN
        _write(draw, (left + MARGIN, 3), question, _SMALL, room, 210)
        _write(draw, (left + MARGIN, 21), words, _LARGE, room, 255)
        _write(draw, (left + MARGIN, 74), detail, _DETAIL, room, 255)
    _write(draw, (MARGIN, HEIGHT - FOOT), foot, _SMALL, WIDTH - 2 * MARGIN, 150)
    return grounds + np.round(np.asarray(image) * ((SHADES - 1) / 255)).astype(np.uint8)


def _write(draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str, size: int, room: float, light: int) -> None:
    """Smaller, then cut, until it fits."""
    while size > _LEAST and draw.textlength(text, _font(size)) > room:
        size -= 1
    if draw.textlength(text, _font(size)) > room:
        while text and draw.textlength(text + "…", _font(size)) > room:
            text = text[:-1]
        text += "…"
    draw.text(at, text, fill=light, font=_font(size))


@lru_cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)

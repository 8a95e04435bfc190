"""Text in a picture: names on what they name, a caption below, and a legend of the colours."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner_service.geometry.arrays import IntArray
from planner_service.view.triangles import Colour

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont

__all__ = ["CAPTION", "GREY", "INK", "MARGIN", "PAPER", "Caption", "Mark", "font_of", "lettered", "place_of"]

Image = NDArray[np.uint8]

CAPTION = 84
"""Height of the caption below the picture, in pixels."""

INK: Colour = (38, 43, 51)
GREY: Colour = (98, 105, 117)
PAPER: Colour = (255, 255, 255)
RULE: Colour = (218, 222, 228)

COARSE = 8
"""Pixels: names are placed on a grid of such cells."""

MOST_NAMES = 24
LEAST_SEEN = 150
"""Visible pixels that a thing needs to get its name; fewer are a sliver."""

MARGIN = 24
MOST_LINES = 2


@dataclass(frozen=True)
class Mark:
    """A name, and the pixel (right, down) that its middle is at if there is room."""

    text: str
    at: tuple[float, float]
    colour: Colour = INK


@dataclass(frozen=True)
class Caption:
    """The text below a picture.

    Attributes:
        title: In large letters.
        lines: In small letters, wrapped; what does not fit into two lines is left out.
        keys: The legend: (colour, meaning).
    """

    title: str
    lines: tuple[str, ...]
    keys: tuple[tuple[Colour, str], ...] = ()


def place_of(owners: IntArray, number: int) -> tuple[float, float] | None:
    """The pixel of a thing that is farthest from its visible edge, None if hardly any of it is seen.

    Args:
        owners: Which thing is seen at each pixel, (height, width).
    """
    mask = owners == number
    if np.count_nonzero(mask) < LEAST_SEEN:
        return None
    rows, columns = (size // COARSE * COARSE for size in mask.shape)
    coarse = mask[:rows, :columns].reshape(rows // COARSE, COARSE, -1, COARSE).any(axis=(1, 3))
    left = np.pad(coarse, 1)
    while True:
        inner = left.copy()
        inner[1:] &= left[:-1]
        inner[:-1] &= left[1:]
        inner[:, 1:] &= left[:, :-1]
        inner[:, :-1] &= left[:, 1:]
        if not inner.any():
            break
        left = inner
    places = np.argwhere(left)
    y, x = places[len(places) // 2].tolist()
    return (x - 0.5) * COARSE, (y - 0.5) * COARSE


def lettered(image: Image, marks: Sequence[Mark], caption: Caption) -> Image:
    """The picture with names on it and ``CAPTION`` pixels of text below; names without room are left out."""
    from PIL import Image as Pictures
    from PIL import ImageDraw

    height, width, _ = image.shape
    page = np.full((height + CAPTION, width, 3), PAPER, dtype=np.uint8)
    page[:height] = image
    picture = Pictures.fromarray(page)
    draw = ImageDraw.Draw(picture)
    _draw_marks(draw, marks, (width, height))
    draw.line([(0, height), (width, height)], fill=RULE, width=1)
    keys_from = _draw_keys(draw, caption.keys, (width, height + 14))
    title, small = font_of(22), font_of(15)
    draw.text((MARGIN, height + 10), _fitting(caption.title, title, keys_from - 2 * MARGIN), INK, font=title)
    for k, line in enumerate(_broken(caption.lines, small, width - 2 * MARGIN)):
        draw.text((MARGIN, height + 39 + 20 * k), line, GREY, font=small)
    return np.asarray(picture)


def font_of(size: int) -> FreeTypeFont:
    """The font of all texts, that many pixels high."""
    from PIL import ImageFont

    return ImageFont.load_default(size)  # type: ignore[return-value]  # a bitmap font only if no size is asked for


def _draw_marks(draw: ImageDraw, marks: Sequence[Mark], size: tuple[int, int]) -> None:
    font, taken = font_of(15), list[tuple[float, float, float, float]]()
    for mark in marks[:MOST_NAMES]:
        wide = font.getlength(mark.text)
        for shift in (0, -1, 1, -2, 2, -3, 3):
            x = min(max(mark.at[0] - wide / 2, 4.0), size[0] - wide - 4.0)
            y = min(max(mark.at[1] - 9 + 19 * shift, 4.0), size[1] - 22.0)
            left, top, right, bottom = x - 3, y - 1, x + wide + 3, y + 18
            if all(right < a or c < left or bottom < b or d < top for a, b, c, d in taken):
                taken.append((left, top, right, bottom))
                draw.text((round(x), round(y)), mark.text, mark.colour, font=font, stroke_width=2, stroke_fill=PAPER)
                break


def _draw_keys(draw: ImageDraw, keys: Sequence[tuple[Colour, str]], corner: tuple[int, int]) -> float:
    """Draw the legend in one line that ends at ``corner``; returns where it begins."""
    font, x, y = font_of(15), float(corner[0]), corner[1]
    for colour, meaning in reversed(keys):
        x -= MARGIN + font.getlength(meaning)
        draw.text((round(x), y), meaning, GREY, font=font)
        x -= 20
        draw.rounded_rectangle((round(x), y + 2, round(x) + 14, y + 15), 3, fill=colour, outline=GREY)
    return x


def _fitting(text: str, font: FreeTypeFont, room: float) -> str:
    """As much of the text as there is room for."""
    if font.getlength(text) <= room:
        return text
    fits = bisect_right(range(len(text)), room, key=lambda count: font.getlength(text[:count] + "...")) - 1
    return text[: max(fits, 0)] + "..."


def _broken(lines: Sequence[str], font: FreeTypeFont, room: float) -> list[str]:
    """The lines wrapped at spaces, at most two of them."""
    out: list[str] = []
    for line in filter(None, lines):
        rows = [""]
        for word in line.split():
            if rows[-1] and font.getlength(f"{rows[-1]} {word}") > room:
                rows.append("")
            rows[-1] = f"{rows[-1]} {word}".strip()
        left = MOST_LINES - len(out)
        out += [*rows[: left - 1], " ".join(rows[left - 1 :])] if 0 < left < len(rows) else rows[:left]
    return [_fitting(row, font, room) for row in out]

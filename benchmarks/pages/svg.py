"""A picture of matplotlib's as an SVG element that can stand in a page and takes its colours of text from it."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["GRID", "INK", "WIDTH", "drawn_as_svg"]

WIDTH = 5.2
"""Inches; half a wide screen, and still legible scaled down to a phone's."""

INK, GRID = "#010203", "#040506"
"""Stand-ins while drawing, of what the page's own colours take the place."""

SVG, XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"


def drawn_as_svg(name: str, draw: Callable[[Any], bool]) -> str | None:
    """A picture as SVG, None if there is nothing to draw.

    Args:
        name: Once on a page.
        draw: Given a ``Figure``; says whether there was anything to draw.
    """
    with _style(name) as figure:
        if not draw(figure):
            return None
        file = io.StringIO()
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return _inlined(file.getvalue(), re.sub(r"\W", "-", name))


@contextmanager
def _style(name: str) -> Iterator[Any]:
    import matplotlib
    from matplotlib.figure import Figure

    settings = {
        "svg.fonttype": "none",
        "svg.hashsalt": name,
        "font.size": 9.5,
        "font.family": "sans-serif",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.linewidth": 0.6,
        "legend.frameon": False,
        "legend.fontsize": 9,
        **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color", "axes.edgecolor"), INK),
        "grid.color": GRID,
    }
    with matplotlib.rc_context(settings):
        yield Figure(figsize=(WIDTH, 2.8), layout="constrained")


def _inlined(text: str, prefix: str) -> str:
    """The element alone: no prologue, no metadata, names that no other picture of the page has, the page's colours."""
    ElementTree.register_namespace("", SVG)
    ElementTree.register_namespace("xlink", XLINK)
    root = ElementTree.fromstring(text)
    for part in (f"{{{SVG}}}metadata", f"{{{SVG}}}defs"):
        for found in root.findall(part):
            if part.endswith("metadata") or found.find(f"{{{SVG}}}style") is not None:
                root.remove(found)
    for element in root.iter():
        for key, value in element.attrib.items():
            value = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", value)
            if key == "id":
                value = f"{prefix}-{value}"
            elif key == f"{{{XLINK}}}href" and value.startswith("#"):
                value = f"#{prefix}-{value[1:]}"
            element.set(key, value.replace(INK, "currentColor").replace(GRID, "var(--grid)"))
    for size in ("width", "height"):
        root.attrib.pop(size, None)
    root.set("role", "img")
    return ElementTree.tostring(root, encoding="unicode")

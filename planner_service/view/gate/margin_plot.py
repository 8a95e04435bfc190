"""The margin of a gate's tube over the last seconds, with a mark where something was refused."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from planner_service.view.gate.tube import WIDEST

__all__ = ["MarginPlot"]

SECONDS = 20.0
HEIGHT = 150
INK, REFUSED = "#1f6fb2", "#da2c2c"
TITLE = "margin of the tube in mm"
TOP = 1000.0 * WIDEST + 2.0


class MarginPlot:
    """A small plot that moves on.

    Args:
        gui: viser's controls.
    """

    def __init__(self, gui: Any) -> None:
        self._points = deque[tuple[float, float, bool]](maxlen=1_000)
        line = {"label": "margin", "stroke": INK, "width": 1.5, "points": {"show": False}}
        points = {"show": True, "size": 5, "fill": REFUSED}
        marks = {"label": "refused", "stroke": REFUSED, "width": 0, "points": points}
        scales = {"x": {"time": False, "range": (-SECONDS, 0.0)}, "y": {"range": (-2.0, TOP)}}
        self._plot = gui.add_uplot(
            (np.array([-SECONDS, 0.0]), np.full(2, np.nan), np.full(2, np.nan)), ({"label": "t"}, line, marks),
            title=TITLE, height=HEIGHT, scales=scales,
            legend={"show": False},
        )  # fmt: skip

    def add(self, seconds: float, margin: float, *, refused: bool) -> None:
        """Add the margin in metres of a decision at a time on a clock."""
        self._points.append((seconds, margin, refused))

    def draw(self) -> None:
        """Draw up to the last decision."""
        if len(self._points) < 2:
            return
        t, margin, refused = (np.array(each, dtype=np.float64) for each in zip(*self._points, strict=True))
        t = t - t[-1]
        last = t >= -SECONDS
        room = 1000.0 * margin[last]
        self._plot.data = (t[last], room, np.where(refused[last] > 0.0, room, np.nan))

"""The clocks of a cell's plan, a row for each arm: when it moves, when it waits before its start or on its way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planner_service.cell import Cell, CellPlan, OwnClock
from planner_service.geometry.arrays import FloatArray
from planner_service.view.still.lettering import GREY, INK, MARGIN, PAPER, font_of
from planner_service.view.triangles import Colour

__all__ = ["WAITS", "clock_rows", "strip_height", "tool_ways", "waits_of"]

Image = NDArray[np.uint8]

ROW, TOP = 24, 10
"""Pixels of a row, and above the first."""

LABEL, RIGHT = 120, 90
"""Pixels for the names, and for the seconds at the end."""

MOVES: Colour = (84, 140, 220)
WAITS: Colour = (242, 178, 80)
STANDS: Colour = (228, 232, 238)
NOW: Colour = (214, 51, 108)

MOMENTS, LEAST = 4000, 0.01
"""Moments of a motion that are looked at, and seconds of a wait that is shown."""

POINTS = 200
"""Of the way of a tool."""

RESTING = 1e-6
"""Of the path in a second; less is a wait."""


def strip_height(arms: int) -> int:
    """Pixels that the rows of so many arms take."""
    return TOP + ROW * arms + TOP


def waits_of(clock: OwnClock) -> tuple[tuple[float, float], ...]:
    """Where an arm rests on its way, from and to in seconds after the start of the whole."""
    trajectory = clock.plan.unwrap()[1]
    times = np.linspace(0.0, trajectory.duration, MOMENTS)
    rests = np.abs(trajectory(times, 1)).max(axis=1) < RESTING
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rests, [False]]).astype(int)))
    spans = [(float(times[first]), float(times[last - 1])) for first, last in edges.reshape(-1, 2)]
    return tuple((clock.start + a, clock.start + b) for a, b in spans if b - a >= LEAST)


def tool_ways(cell: Cell, plan: CellPlan) -> Iterator[FloatArray]:
    """Where the tool of each moving arm goes, (m, 3)."""
    Q = plan(np.linspace(0.0, plan.duration, POINTS))
    for name in (name for clock in plan.clocks for name in clock.arms):
        yield cell.arm(name).robot.tool_origins(cell.of_arm(name, Q))


def clock_rows(plan: CellPlan, arms: tuple[str, ...], width: int, now: float | None = None) -> Image:
    """A strip (height, width, 3) with a row for each arm.

    Args:
        now: Seconds at which a line is drawn; none if None.
    """
    from PIL import Image as Pictures
    from PIL import ImageDraw

    picture = Pictures.new("RGB", (width, strip_height(len(arms))), PAPER)
    draw, font = ImageDraw.Draw(picture), font_of(15)
    span, duration = width - LABEL - RIGHT, max(plan.duration, 1e-9)

    def x(t: float) -> float:
        return LABEL + span * t / duration

    clocks = {name: clock for clock in plan.clocks for name in clock.arms}
    for k, name in enumerate(arms):
        y = TOP + ROW * k
        shown = name if font.getlength(name) <= LABEL - MARGIN - 6 else f"{name[:9]}..."
        draw.text((MARGIN, y), shown, INK, font=font)
        draw.rectangle((x(0.0), y + 3, x(duration), y + ROW - 6), fill=STANDS)
        clock = clocks.get(name)
        if clock is None:
            draw.text((x(0.0) + 6, y), "stands", GREY, font=font)
            continue
        spans = [(clock.start, clock.end, MOVES), *((a, b, WAITS) for a, b in waits_of(clock))]
        if clock.start > 0.0:
            spans.append((0.0, clock.start, WAITS))
        for begin, end, colour in spans:
            draw.rectangle((x(begin), y + 3, x(end), y + ROW - 6), fill=colour)
        draw.text((x(duration) + 8, y), f"{clock.end:.2f} s", GREY, font=font)
    if now is not None:
        draw.line((x(now), TOP - 4, x(now), TOP + ROW * len(arms)), fill=NOW, width=3)
    return np.asarray(picture)

"""Pictures of cells: several arms, each where its own clock has it.

::

    from planner_service.view.still.cells import draw_cell

    draw_cell(cell.plan(requests, delay=0.1), "cell.png")
"""

from __future__ import annotations

import math
import os

import numpy as np

from planner_service.cell import Cell, CellPlan
from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.files.writing import require_writable, write_whole
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance, number
from planner_service.view.still.clocks import WAITS, clock_rows, strip_height, tool_ways
from planner_service.view.still.composition import GOAL, START, TOOL_PATH, WAY, Stand, View, camera_of, picture
from planner_service.view.still.lettering import Caption
from planner_service.view.still.moving import END, MAX_FRAMES, OURS
from planner_service.view.still.paint import Image, Line
from planner_service.view.still.pictures import SIZE, webp_bytes, write_png

__all__ = ["draw_cell", "draw_cell_motion"]

SMALL, RATE = (800, 560), 10
"""Pixels, and frames a second, of a picture that moves."""

ON_THE_WAY = 3
"""Moments between start and end that are drawn."""


def draw_cell(plan: CellPlan, file: str | os.PathLike[str]) -> None:
    """A picture of a cell's plan: all arms at the start, faint at moments of one clock, green at their goals; below it
    when each arm moves and when it waits.

    Raises:
        InvalidRequest: The plan does not know its cell, or there is none.
        InvalidFile: The file cannot be written.
    """
    cell, path = _cell(plan), as_path("file", file)
    kinds = [START, *[WAY] * ON_THE_WAY, GOAL]
    stands = tuple(Stand(q, kind) for q, kind in zip(_at(plan, len(kinds)), kinds, strict=True))
    view = View(cell.robot, cell.scene, stands, _tool_paths(cell, plan))
    said = ((START, "start"), (WAY, "at moments on the way"), (GOAL, "goals"))
    keys = (*((kind.colour, meaning) for kind, meaning in said), (TOOL_PATH, "tools"), (WAITS, "waits"))
    image = picture(view, Caption(_title(cell), _words(plan), keys), _above(SIZE, cell))
    write_png(path, np.concatenate([image, clock_rows(plan, cell.arms, SIZE[0])]))


def draw_cell_motion(plan: CellPlan, file: str | os.PathLike[str], *, speed: float = 1.0) -> None:
    """A picture that moves, of all arms on their own clocks: a WebP file.

    Args:
        speed: Seconds of motion in a second of the picture.

    Raises:
        InvalidRequest: The plan does not know its cell, or there is none; a speed outside [0.1, 10], or more than 1,000
            frames.
        InvalidFile: The file cannot be written.
    """
    cell, path = _cell(plan), as_path("file", file)
    require_writable(path, OURS)  # drawing takes a while
    rate = RATE / number("speed", speed, "seconds of motion in a second, in [0.1, 10]", 0.1, 10.0)
    count = math.ceil(plan.duration * rate) + 1
    if count > MAX_FRAMES:
        raise InvalidRequest("plan", f"{count} frames", f"at most {MAX_FRAMES:,}: more speed")
    lines, times = _tool_paths(cell, plan), np.linspace(0.0, plan.duration, count)
    views = [View(cell.robot, cell.scene, (Stand(q),), lines) for q in plan(times)]
    ends = [View(cell.robot, cell.scene, tuple(map(Stand, _at(plan, 2 + ON_THE_WAY))), lines)]
    size, words = _above(SMALL, cell), _words(plan)
    camera, pictures = camera_of(ends, size), list[Image]()
    for view, t in zip(views, times.tolist(), strict=True):
        caption = Caption(f"{_title(cell)}: {t:.2f} s", words, ((TOOL_PATH, "tools"), (WAITS, "waits")))
        rows = clock_rows(plan, cell.arms, SMALL[0], t)
        pictures.append(np.concatenate([picture(view, caption, size, camera), rows]))
    write_whole(path, webp_bytes(pictures, RATE, END), OURS)


def _above(size: tuple[int, int], cell: Cell) -> tuple[int, int]:
    """The part of a picture above the rows of the clocks."""
    return size[0], size[1] - strip_height(len(cell.arms))


def _cell(plan: CellPlan) -> Cell:
    instance("plan", plan, CellPlan, "a CellPlan")
    if plan.layout is None or not plan.ok:
        raise InvalidRequest("plan", str(plan.failure or "a plan of an unknown cell"), "a plan that Cell.plan made")
    return Cell.laid_out(plan.layout)


def _at(plan: CellPlan, count: int) -> list[FloatArray]:
    """All joints at so many moments from start to end."""
    return [np.asarray(q) for q in plan(np.linspace(0.0, plan.duration, count))]


def _tool_paths(cell: Cell, plan: CellPlan) -> tuple[Line, ...]:
    """The line of each moving arm's tool."""
    return tuple(Line(points, TOOL_PATH, 3.2) for points in tool_ways(cell, plan))


def _title(cell: Cell) -> str:
    return f"{', '.join(cell.arms)} in {cell.scene.name or 'a scene'}"


def _words(plan: CellPlan) -> tuple[str, str]:
    clocks = [f"{' and '.join(clock.arms)} from {clock.start:.2f} to {clock.end:.2f} s" for clock in plan.clocks]
    late = "one arm moves" if plan.tolerates == math.inf else f"each may be {plan.tolerates:.2f} s late"
    return " \u00b7 ".join(clocks), f"proven: {late}, between samples too"

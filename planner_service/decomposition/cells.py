"""The space of a few joints in cells, each cut again only where that may decide whether two ends are connected.

Cells are boxes of one integer grid. Those that are walls are kept, the rest form a graph in which neighbours share a
face; what touches in an edge only need not be joined, as walls include their faces. In each round the ways from end to
end with about the fewest undecided cells are looked for, and these cells are cut. So ways through large cells, of which
little is known, are cut first, and a pocket around an end is cut fine long before what is far away from it.

Before that, one of these ways is cut into stretches, and these again, where a wall may be. If none can be anywhere on
it, no cells will ever part the ends: that is found out long before all cells on a way are that small. Such a way is not
proven free, but worth a try where a search found none.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner_service.decomposition.walls import Judgement
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["CellArray", "Cells", "Region"]

FIRST = {1: 16, 2: 8, 3: 4, 4: 4}
"""Cells along each joint to begin with, by the number of joints."""

CUTS = 14
"""How often a cell may be halved along a joint."""

ALIKE = 0.6
"""Part of the largest width, in metres that a solid moves by, from which on a joint is cut, too."""

UNDECIDED = float(1 << 20)
"""What an undecided cell costs on a way, and an open one costs 1: sums of them are exact."""

SLACK = 1.5
"""Ways of up to so many times the fewest undecided cells are cut together."""

LARGE = 0.4
"""Of the width of the largest cell on these ways, from which on cells are cut."""

FINEST = 2e-4
"""Metres that a solid moves by in a cell that is not cut again."""

AT_ONCE = 4_000
"""Cells judged at once."""

STRAIGHT = 16
"""Stretches of the straight line from end to end, which is looked at before all cells."""

STRETCHES = 1_000
"""Of one way that are judged; it is undecided if that is not enough."""

Judged = Callable[[FloatArray, FloatArray, BoolArray | None], Judgement]
CellArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Region:
    """The cells that are connected with an end, and the walls around them; corners in units of the grid.

    Attributes:
        of_start: Whether it is that of the start, or of the goals.
        cells: Lower and upper corners (r, 2, k).
        walls: (w, 2, k).
        pairs: What each wall collides by, (w,).
    """

    of_start: bool
    cells: CellArray
    walls: CellArray
    pairs: IntArray


class Cells:
    """Cells of a box of joint values.

    Args:
        lower, upper: The box, (k,).
        endless: Of each joint whether the upper side is the lower one again.
        reaches: How far a solid is from the axis of each joint, in metres.
        judged: Judges cells by their centres and half widths, (m, k) each, and what is doubtful in those around them.
        start, goals: Points (k,) inside the box.

    Attributes:
        divisions: Units of the grid along each joint, (k,).
        count: Cells judged, stretches of ways among them.
        way: Points (m, k) of a polyline from the start to a goal, on which no wall can be, so that looking on is no
            use; None if none is known. A joint without end may be whole turns from where it was given.
    """

    def __init__(
        self,
        lower: FloatArray,
        upper: FloatArray,
        endless: Sequence[bool],
        reaches: Sequence[float],
        judged: Judged,
        start: FloatArray,
        goals: Sequence[FloatArray],
    ) -> None:
        k = len(lower)
        self._judged, self._endless = judged, np.array(endless)
        self.divisions: CellArray = np.full(k, FIRST[k] << CUTS, dtype=np.int64)
        self._lower, self._unit = lower, (upper - lower) / self.divisions
        self._metres = self._unit * np.array(reaches)
        self.count = 0
        self.way: FloatArray | None = None
        self._low: CellArray = np.zeros((0, k), dtype=np.int64)
        self._size: CellArray = np.zeros((0, k), dtype=np.int64)
        self._pair = np.zeros(0, dtype=np.intp)
        self._cost = np.zeros(0)
        self._cut = np.zeros(0, dtype=bool)
        self._doubtful: list[BoolArray] = []
        self._edges: IntArray = np.zeros((0, 2), dtype=np.intp)
        self._ends = np.clip((np.array([start, *goals]) - lower) / self._unit, 0, self.divisions)
        self._points = np.clip(np.floor(self._ends), 0, self.divisions - 1).astype(np.int64)
        self._homes = np.full(len(self._points), -1, dtype=np.intp)
        self._cells: list[int] = []

    def separated(self, most: int) -> Region | None:
        """A region that parts start and goals, found within so many cells; None if none was found.

        It may be asked again with more cells.
        """
        if not len(self._low):
            corners = _corners((self.divisions >> CUTS).tolist())
            straight = self._straight()
            if self.way is None and self._is_open(straight, None, most):
                self.way = self._polyline(straight)
            if self.way is not None or self.count + len(corners) > most:
                return None
            new = self._add(corners << CUTS, np.full_like(corners, 1 << CUTS), [])
            self._join(*new[np.stack(np.triu_indices(len(new), 1))])
        while True:
            ways = self._ways()
            if isinstance(ways, Region):
                return ways
            stretches, doubtful = self._stretches()
            if not len(ways) or self._is_open(stretches, doubtful, most):
                self.way = self._polyline(stretches)[::-1]
            widths = self._widths(ways).max(axis=1, initial=0.0)
            chosen = ways[widths >= LARGE * widths.max(initial=0.0)]
            sides = self._sides(chosen)
            if self.way is not None or self.count + int((1 << sides.sum(axis=1)).sum()) > most:
                return None
            self._halve(chosen, sides)

    def _ways(self) -> IntArray | Region:
        """The undecided cells on ways from end to end that have few of them; the region if there is no way.

        None of them if a way has no undecided cell.
        """
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        size = len(self._low)
        a, b = self._edges[(self._pair[self._edges] < 0).all(axis=1)].T
        start, goals = self._homes[:1], np.unique(self._homes[1:])
        start, goals = start[self._pair[start] < 0], goals[self._pair[goals] < 0]
        rows = np.concatenate([a, b, np.full(len(start), size), np.full(len(goals), size + 1)])
        columns = np.concatenate([b, a, start, goals])
        graph = csr_array((self._cost[columns], (rows, columns)), shape=(size + 2, size + 2))
        (of_start, before), (of_goals, _) = (
            dijkstra(graph, indices=end, return_predecessors=True) for end in (size, size + 1)
        )
        of_start, of_goals = of_start[:size], of_goals[:size]
        through = of_start + of_goals - np.where(np.isfinite(self._cost), self._cost, 0.0)
        fewest = float(through[start].min(initial=np.inf))
        if not np.isfinite(fewest):
            reached = [np.isfinite(each) & ~self._cut for each in (of_start, of_goals)]
            return self._region(reached, of_start=bool(reached[0].sum() <= reached[1].sum()))
        self._cells = [int(goals[of_start[goals].argmin()])]
        while before[self._cells[-1]] < size:
            self._cells.append(int(before[self._cells[-1]]))
        if fewest < UNDECIDED:
            return np.zeros(0, dtype=np.intp)
        return np.flatnonzero((through <= max(SLACK * fewest, fewest + UNDECIDED)) & (self._cost == UNDECIDED))

    def _is_open(self, stretches: FloatArray, doubtful: BoolArray | None, most: int) -> bool:
        """Whether no wall can be anywhere on straight stretches of a way, given so many cells and parts of stretches.

        Args:
            stretches: Their ends, (m, 2, k), in units of the grid.
            doubtful: What is doubtful around each, (m, pairs), if that is known.
        """
        most = min(most, self.count + STRETCHES)
        if self.count + len(stretches) > most or (self._along(stretches, 0.0, doubtful).pair >= 0).any():
            return False
        while len(stretches):
            widest = float((np.abs(stretches[:, 1] - stretches[:, 0]) * self._metres).max())
            if self.count + len(stretches) > most or widest < FINEST:
                return False
            judged = self._along(stretches, 1.0, doubtful)
            if (judged.pair >= 0).any():
                return False
            kept = judged.doubtful.any(axis=1)
            first, last = stretches[kept].transpose(1, 0, 2)
            middle = 0.5 * (first + last)
            stretches = np.stack([first, middle, middle, last], axis=1).reshape(-1, 2, len(self.divisions))
            doubtful = np.repeat(judged.doubtful[kept], 2, axis=0)
        return True

    def _along(self, stretches: FloatArray, part: float, doubtful: BoolArray | None) -> Judgement:
        """Judge boxes around stretches; with ``part`` 0 only their middles."""
        self.count += len(stretches)
        middle, width = 0.5 * stretches.sum(axis=1), np.abs(stretches[:, 1] - stretches[:, 0])
        return self._judged(self._lower + middle * self._unit, 0.5 * part * width * self._unit, doubtful)

    def _straight(self) -> FloatArray:
        """The straight line to the nearest goal in stretches, (m, 2, k)."""
        start, goals = self._ends[0], self._ends[1:]
        goal = goals[(np.abs(goals - start) * self._metres).max(axis=1).argmin()]
        points = start + (goal - start) * np.linspace(0.0, 1.0, STRAIGHT + 1)[:, None]
        return np.stack([points[:-1], points[1:]], axis=1)

    def _stretches(self) -> tuple[FloatArray, BoolArray]:
        """Straight lines in the cells of the last way that was found, from its goal; and what is doubtful in these."""
        goal = int(np.flatnonzero(self._homes[1:] == self._cells[0])[0]) + 1
        at, out = self._ends[goal], list[FloatArray]()
        for cell, following in itertools.pairwise(self._cells):
            turns = np.where(self._endless, np.stack([0 * self.divisions, self.divisions, -self.divisions]), 0)
            low = np.maximum(self._low[cell], self._low[following] + turns)
            high = np.minimum(self._low[cell] + self._size[cell], self._low[following] + self._size[following] + turns)
            best = (high - low).argmax(axis=0), np.arange(len(self.divisions))
            face = 0.5 * (low + high)[best]
            out.append(np.stack([at, face]))
            at = face - turns[best]
        doubtful = np.stack([self._doubtful[cell] for cell in self._cells])
        return np.stack([*out, np.stack([at, self._ends[0]])]), doubtful

    def _polyline(self, stretches: FloatArray) -> FloatArray:
        """The points of stretches (m, 2, k), joined where a joint without end goes on at its other side."""
        steps = np.cumsum(stretches[:, 1] - stretches[:, 0], axis=0)
        return np.asarray(self._lower + np.concatenate([stretches[:1, 0], stretches[0, 0] + steps]) * self._unit)

    def _region(self, reached: list[BoolArray], *, of_start: bool) -> Region:
        cells = reached[0 if of_start else 1]
        beside = self._edges[cells[self._edges].any(axis=1)].ravel()
        ends = self._homes[:1] if of_start else self._homes[1:]
        walls = np.unique(np.concatenate([beside, ends]))
        walls = walls[self._pair[walls] >= 0]
        corners = np.stack([self._low, self._low + self._size], axis=1)
        return Region(of_start, corners[cells], corners[walls], self._pair[walls])

    def _widths(self, cells: IntArray) -> FloatArray:
        """How far a solid moves by each joint within cells, in metres, (m, k)."""
        return np.asarray(self._size[cells] * self._metres)

    def _sides(self, cells: IntArray) -> BoolArray:
        """Along which joints to halve cells, (m, k): the widest."""
        widths = np.where(self._size[cells] > 1, self._widths(cells), 0.0)
        return np.asarray(widths >= ALIKE * widths.max(axis=1, initial=0.0, keepdims=True))

    def _halve(self, chosen: IntArray, sides: BoolArray) -> None:
        """Cut cells along sides, (m, k), and judge what they become."""
        first = np.full(len(self._low), -1, dtype=np.intp)
        number = np.ones(len(self._low), dtype=np.intp)
        for row in np.unique(sides, axis=0):
            mine = chosen[(sides == row).all(axis=1)]
            offsets = _corners([2 if halved else 1 for halved in row.tolist()])
            size = np.where(row, self._size[mine] >> 1, self._size[mine])
            low = self._low[mine][:, None] + offsets * size[:, None]
            around = [self._doubtful[cell] for cell in np.repeat(mine, len(offsets)).tolist()]
            new = self._add(low.reshape(-1, len(row)), np.repeat(size, len(offsets), axis=0), around)
            first[mine], number[mine] = new[:: len(offsets)], len(offsets)
            a, b = np.triu_indices(len(offsets), 1)
            brood = new.reshape(-1, len(offsets))
            self._join(brood[:, a].ravel(), brood[:, b].ravel())
        self._cut[chosen] = True
        self._cost[chosen] = np.inf
        old = (first[self._edges[self._edges.max(axis=1) < len(first)]] >= 0).any(axis=1)
        inherited = np.zeros(len(self._edges), dtype=bool)
        inherited[np.flatnonzero(self._edges.max(axis=1) < len(first))[old]] = True
        edges, self._edges = self._edges[inherited], self._edges[~inherited]
        for side in (0, 1):  # first the children of one cell beside the other, then those of both
            mine = edges[:, side]
            split = np.flatnonzero(first[mine] >= 0)
            counts = number[mine[split]]
            rows = np.repeat(split, counts)
            children = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + first[mine[rows]]
            below = edges[rows].copy()
            below[:, side] = children
            edges = np.concatenate([np.delete(edges, split, axis=0), below[self._touching(*below.T)]])
        self._join(*edges.T)

    def _add(self, low: CellArray, size: CellArray, around: list[BoolArray]) -> IntArray:
        """Judge new cells, given what is doubtful in those around them, if there are such; their numbers."""
        new = np.arange(len(self._low), len(self._low) + len(low))
        half = 0.5 * size * self._unit
        centres = self._lower + low * self._unit + half
        parts = []
        for first in range(0, len(low), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            parts.append(self._judged(centres[part], half[part], np.stack(around[part]) if around else None))
        self.count += len(low)
        pair = np.concatenate([part.pair for part in parts])
        hopeless = np.concatenate([~part.doubtful.any(axis=1) for part in parts])
        self._doubtful += [row for part in parts for row in part.doubtful]
        self._low, self._size = np.concatenate([self._low, low]), np.concatenate([self._size, size])
        self._pair = np.concatenate([self._pair, pair])
        hopeless |= ((size * self._metres < FINEST) | (size == 1)).all(axis=1)
        self._cost = np.concatenate([self._cost, np.where(pair >= 0, np.inf, np.where(hopeless, 1.0, UNDECIDED))])
        self._cut = np.concatenate([self._cut, np.zeros(len(low), dtype=bool)])
        for end, point in enumerate(self._points):
            inside = ((low <= point) & (point < low + size)).all(axis=1)
            self._homes[end] = new[inside][0] if inside.any() else self._homes[end]
        return new

    def _join(self, a: IntArray, b: IntArray) -> None:
        """Join those of the pairs of cells that share a face and are not both walls."""
        joined = ((self._pair[a] < 0) | (self._pair[b] < 0)) & self._touching(a, b)
        self._edges = np.concatenate([self._edges, np.stack([a[joined], b[joined]], axis=1)])

    def _touching(self, a: IntArray, b: IntArray) -> BoolArray:
        """Whether cells share a face."""
        low, high, other, end = self._low[a], self._low[a] + self._size[a], self._low[b], self._low[b] + self._size[b]
        overlap = np.minimum(high, end) - np.maximum(low, other)
        for turn in (self.divisions, -self.divisions):
            around = np.minimum(high, end + turn) - np.maximum(low, other + turn)
            overlap = np.where(self._endless, np.maximum(overlap, around), overlap)
        return np.asarray(((overlap > 0).sum(axis=1) == overlap.shape[1] - 1) & (overlap == 0).any(axis=1))


def _corners(counts: Sequence[int]) -> CellArray:
    """The lower corners of so many cells along each joint, (m, k)."""
    return np.stack([axis.ravel() for axis in np.meshgrid(*map(np.arange, counts), indexing="ij")], axis=-1)

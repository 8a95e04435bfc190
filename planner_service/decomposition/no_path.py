"""Proofs that there is no path: all ways between start and goal lead through walls of configuration space.

The joints that some pairs of solids depend on span a space of few dimensions, whatever the other joints do. It is cut
into cells (``cells``), finest around the end that is enclosed; those that are walls (``walls``) are closed. Where the
start's cells and those of the goals are not connected any more, face to face, no path exists.

Approximate cell decomposition is due to Brooks & Lozano-Perez (IEEE Trans. Systems, Man and Cybernetics 15(2), 1985),
its use to prove that no path exists to Zhang, Kim & Manocha (IJRR 27(11-12), 2008).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.certify.pairs import pairs_of_names
from planner_service.decomposition.cells import CellArray, Cells
from planner_service.decomposition.walls import Judgement, Middle, SolidPair, Walls, Witness, solid_pairs
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.geometry.validation import function_or_none, instance, items, whole
from planner_service.robot.model import TURN, Robot, joint_vector
from planner_service.scene.scene import Scene

__all__ = ["NoPath", "OpenWay", "divide", "prove_no_path"]

MOST_JOINTS = 4
"""That a proof cuts up together: with each more there are many times as many boxes."""

MOST_BOXES = 100_000

MOST_JUDGED = 100_000_000
"""Pairs of solids in all boxes together: among thousands of points a box costs as much as a hundred elsewhere."""

FIRST, MORE = 2_000, 4
"""Boxes that each set of joints may take at first, and how many times as many whenever all have had theirs."""


@dataclass(frozen=True, eq=False)
class NoPath:
    """A proof that no path exists, whatever the other joints do.

    The values of some joints are cut into boxes whose corners lie on a grid: value = range_lower + (range_upper -
    range_lower) * number / divisions. The region holds one end and not the other; each face of its boxes is covered by
    other boxes of it, by walls, and by the limits of the joints.

    Attributes:
        joints: The joints whose values are cut into boxes.
        pairs: The pairs of links and objects whose overlaps are the walls, each once.
        boxes: How many of these joints were judged.
        distances: Bounds computed for (box, pair).
        encloses: What the region holds, "start" or "goals"; an end that collides lies in a wall instead.
        range_lower, range_upper: What is cut into boxes, (k,), in radians or metres; of a joint without end a whole
            turn, and both sides are the same.
        divisions: Of the grid, (k,).
        region_cells: Lower and upper corners of the boxes of the region, numbers of the grid, (r, 2, k).
        wall_cells: Those of the walls, (w, 2, k).
        wall_pairs: For each wall the number of its pair in ``pairs``, (w,).
        witness: For each wall, what shows that it is one; the first of its points belongs to the first of the pair.
    """

    joints: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    boxes: int
    distances: int
    encloses: str
    range_lower: FloatArray
    range_upper: FloatArray
    divisions: CellArray
    region_cells: CellArray
    wall_cells: CellArray
    wall_pairs: IntArray
    witness: Witness

    @property
    def lower(self) -> FloatArray:
        """The lower corners of the walls, (w, k), in radians or metres."""
        return self._values(self.wall_cells[:, 0])

    @property
    def upper(self) -> FloatArray:
        """The upper corners of the walls, (w, k), in radians or metres."""
        return self._values(self.wall_cells[:, 1])

    def _values(self, numbers: CellArray) -> FloatArray:
        return np.asarray(self.range_lower + (self.range_upper - self.range_lower) * numbers / self.divisions)

    def __str__(self) -> str:
        names = ", ".join(f"{a} x {b}" for a, b in self.pairs[:3]) + (", ..." if len(self.pairs) > 3 else "")
        return f"no path exists: {names} block every way of {', '.join(self.joints)}, whatever other joints do"


@dataclass(frozen=True, eq=False)
class OpenWay:
    """A way on which no collision is known: not proven to be free, but worth to be judged.

    Attributes:
        points: Of a polyline from the start to a goal, (m, n), in radians or metres.
        goal_index: Which of the goals it ends at.
    """

    points: FloatArray
    goal_index: int


def prove_no_path(
    robot: Robot,
    scene: Scene,
    start: Sequence[float] | FloatArray,
    goals: Sequence[Sequence[float] | FloatArray],
    *,
    allowed: Iterable[tuple[str, str]] = (),
    max_boxes: int = MOST_BOXES,
    charge: Callable[[int], None] | None = None,
) -> NoPath | None:
    """A proof that none of the goals can be reached from the start; None if none was found, which says nothing.

    It is the same on every machine: it ends by a number of boxes and of pairs in them, not by a clock. Fixed ways out
    of named poses may collide, so the pairs that they except are no walls. Among more than 2,000,000 pairs of
    solids none is looked for.

    Args:
        start: Configuration (n,) in radians (metres for joints that slide).
        goals: Configurations (n,): all ends that would do.
        allowed: Pairs of link or object names that may touch.
        max_boxes: Boxes judged at most.
        charge: Told of the (box, pair) bounds before they are asked; may raise to end it.

    Raises:
        InvalidRequest: start or goals are no configurations, ``max_boxes`` is no positive integer, or ``charge`` is no
            function.
        UnknownName: ``allowed`` names nothing that is there.
    """
    instance("robot", robot, Robot, "a Robot")
    instance("scene", scene, Scene, "a Scene")
    given = items("goals", goals, object, "configurations")
    if not given:
        raise InvalidRequest("goals", goals, "at least one configuration")
    ends = [np.asarray(joint_vector(f"goals[{k}]", goal, robot)) for k, goal in enumerate(given)]
    begin = np.asarray(joint_vector("start", start, robot))
    left = whole("max_boxes", max_boxes, 1, 10**9)
    function_or_none("charge", charge, "a function of a number")
    found = divide(robot, scene, begin, ends, pairs_of_names("allowed", allowed), left, charge)
    return found if isinstance(found, NoPath) else None


def divide(
    robot: Robot,
    scene: Scene,
    begin: FloatArray,
    ends: Sequence[FloatArray],
    allowed: Iterable[tuple[str, str]],
    max_boxes: int = MOST_BOXES,
    charge: Callable[[int], None] | None = None,
) -> NoPath | OpenWay | None:
    """As ``prove_no_path``; or a way that is open for all joints of the robot, if there is no proof."""
    pairs = solid_pairs(robot, scene, allowed)
    way: OpenWay | None = None
    left, work = max_boxes, MOST_JUDGED
    searches: Iterable[_Search] = (_Search(robot, walls, begin, ends, charge) for walls in _choices(robot, pairs))
    most = FIRST
    while left > 0 and work > 0:
        unfinished = []
        for search in searches:
            before = search.cells.count
            found = search.run(min(most, before + min(left, work // search.pairs)))
            if found is not None:
                return found
            spent = search.cells.count - before
            left, work = left - spent, work - spent * search.pairs
            if search.cells.way is None:
                unfinished.append(search)
            elif search.cells.way.shape[1] == robot.n:
                way = _between(search.cells.way, begin, ends, robot)
        if most >= max_boxes or not unfinished:
            return way
        searches = unfinished
        most *= MORE
    return way


def _between(way: FloatArray, begin: FloatArray, ends: Sequence[FloatArray], robot: Robot) -> OpenWay | None:
    """A way that begins at a start and ends at a goal, or whole turns from it, to the last bit; None out of bounds."""
    endless = np.array(robot.continuous) if robot.continuous else np.zeros(robot.n, dtype=np.bool_)
    points = way + np.where(endless, TURN * np.round((begin - way[0]) / TURN), 0.0)
    turned = [end + np.where(endless, TURN * np.round((points[-1] - end) / TURN), 0.0) for end in ends]
    nearest = int(np.argmin([np.abs(end - points[-1]).max() for end in turned]))
    points[0], points[-1] = begin, turned[nearest]
    lower, upper = robot.bounds
    return OpenWay(points, nearest) if np.all((points >= lower) & (points <= upper)) else None


def _choices(robot: Robot, pairs: Sequence[SolidPair]) -> Iterator[Walls]:
    """Walls of sets of joints worth cutting up, small ones first: those of a pair, and all up to one of its own."""
    sets = {tuple(range(count)) for count in range(1, min(robot.n, MOST_JOINTS) + 1)}
    sets |= {tuple(sorted(pair.columns)) for pair in pairs if len(pair.columns) <= MOST_JOINTS}
    tried, middle = set[frozenset[tuple[int, frozenset[int]]]](), Middle(robot)
    for columns in sorted(sets, key=lambda columns: (len(columns), columns)):
        walls = Walls(middle, pairs, columns)
        judged = frozenset((id(pair), pair.columns & set(columns)) for pair in walls.pairs)
        if judged and judged not in tried:
            tried.add(judged)
            yield walls


class _Search:
    """Looks for a proof by the walls of some joints.

    Attributes:
        pairs: How many pairs of solids may be walls.
    """

    def __init__(
        self,
        robot: Robot,
        walls: Walls,
        begin: FloatArray,
        ends: Sequence[FloatArray],
        charge: Callable[[int], None] | None,
    ) -> None:
        self._walls, self._charge, self.pairs = walls, charge, max(1, len(walls.pairs))
        columns = list(walls.columns)
        self._joints = tuple(robot.joint_names[column] for column in columns)
        endless = [bool(robot.continuous) and robot.continuous[column] for column in columns]
        lower, upper = (bound[columns] for bound in robot.bounds)
        self._lower = np.where(endless, begin[columns] - math.pi, lower)
        self._upper = np.where(endless, begin[columns] + math.pi, upper)
        start, *goals = (_turned_into(q[columns], self._lower, endless) for q in (begin, *ends))
        self.cells = Cells(self._lower, self._upper, endless, walls.reaches(), self._judged, start, goals)

    def run(self, most: int) -> NoPath | None:
        """A proof, if there is one within so many boxes."""
        region = self.cells.separated(most)
        if region is None:
            return None
        walls, divisions = self._walls, self.cells.divisions
        unit = (self._upper - self._lower) / divisions
        half = 0.5 * (region.walls[:, 1] - region.walls[:, 0]) * unit
        witness = walls.witness(self._lower + region.walls[:, 0] * unit + half, half, region.pairs)
        used, numbers = np.unique(region.pairs, return_inverse=True)
        names = [walls.pairs[pair].names for pair in used.tolist()]
        distinct = list(dict.fromkeys(names))
        return NoPath(
            self._joints,
            tuple(distinct),
            self.cells.count,
            walls.asked,
            "start" if region.of_start else "goals",
            self._lower,
            self._upper,
            divisions,
            region.cells,
            region.walls,
            np.array([distinct.index(name) for name in names], dtype=np.intp)[numbers],
            witness,
        )

    def _judged(self, centres: FloatArray, half: FloatArray, doubtful: BoolArray | None) -> Judgement:
        if self._charge is not None:
            self._charge(int(doubtful.sum()) if doubtful is not None else len(centres) * len(self._walls.pairs))
        return self._walls.judged(centres, half, doubtful)


def _turned_into(q: FloatArray, lower: FloatArray, endless: Sequence[bool]) -> FloatArray:
    """Joint values, those of joints without end by whole turns from ``lower`` on."""
    turns = (q - lower) / TURN
    return np.where(endless, lower + TURN * (turns - np.floor(turns)), q)

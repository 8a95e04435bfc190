"""Proofs that there is no path: all ways between start and goal lead through walls of configuration space.

The joints that some pairs of solids depend on span a space of few dimensions, whatever the other joints do. It is cut
into boxes, finer and finer; those that are walls (``walls``) are closed. Where the start's boxes and those of the goals
are not connected any more, face to face, no path exists: neighbours that touch in an edge only have walls, which
include their faces, around it. Boxes that can never be shown to be walls are not cut again, and where these alone
connect start and goal, there is nothing to prove.

Approximate cell decomposition is due to Brooks & Lozano-Perez (IEEE Trans. Systems, Man and Cybernetics 15(2), 1985),
its use to prove that no path exists to Zhang, Kim & Manocha (IJRR 27(11-12), 2008).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner_service.certify.pairs import ProofPairs, pairs_of_names
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.geometry.validation import instance, items, whole
from planner_service.infeasibility.walls import Walls, solid_pairs
from planner_service.planning.request import joint_vector
from planner_service.robot.model import TURN, Robot
from planner_service.scene.scene import Scene

__all__ = ["NoPath", "prove_no_path"]

MOST_JOINTS = 4
"""That a proof cuts up together: with each more there are many times as many boxes."""

FIRST = {1: 64, 2: 16, 3: 8, 4: 6}
"""Boxes along each joint to begin with."""

MOST_BOXES = 1 << 24
"""Of the finest size that an array holds."""

ALIKE = 0.6
"""Part of the largest width, in metres that a solid moves by, from which on a joint is cut, too."""

AT_ONCE = 20_000
"""Boxes judged at once."""

UNKNOWN, WALL, OPEN = 0, 1, 2

StateArray = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class NoPath:
    """A proof that no path exists, whatever the other joints do.

    Attributes:
        joints: The joints whose values are cut into boxes.
        pairs: The pairs of links and objects whose overlaps are the walls, each once.
        boxes: How many were judged.
        distances: (box, pair) bounds asked.
        lower, upper: The walls, (w, k) each, in the order of ``joints``; in radians or metres.
        wall_pairs: For each wall the number of its pair in ``pairs``, (w,).
    """

    joints: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    boxes: int
    distances: int
    lower: FloatArray
    upper: FloatArray
    wall_pairs: IntArray

    def __str__(self) -> str:
        names = ", ".join(f"{a} x {b}" for a, b in self.pairs[:3]) + (", ..." if len(self.pairs) > 3 else "")
        return f"no path exists: {names} block every way of {', '.join(self.joints)}, whatever other joints do"


def prove_no_path(
    robot: Robot,
    scene: Scene,
    start: Sequence[float] | FloatArray,
    goals: Sequence[Sequence[float] | FloatArray],
    *,
    allowed: Iterable[tuple[str, str]] = (),
    max_boxes: int = 100_000,
    charge: Callable[[int], None] | None = None,
) -> NoPath | None:
    """A proof that none of the goals can be reached from the start; None if none was found, which says nothing.

    It is the same on every machine: it ends by a number of boxes, not by a clock. Fixed ways out of named poses may
    collide, so the pairs that they except are no walls.

    Args:
        start: Configuration (n,) in radians (metres for joints that slide).
        goals: Configurations (n,): all ends that would do.
        allowed: Pairs of link or object names that may touch.
        max_boxes: Boxes judged at most.
        charge: Told of the (box, pair) bounds before they are asked; may raise to end it.

    Raises:
        InvalidRequest: start or goals are no configurations, or ``max_boxes`` is no positive integer.
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
    pairs = solid_pairs(robot, ProofPairs(robot, scene, pairs_of_names("allowed", allowed)))
    for columns in _choices(robot, [pair.columns for pair in pairs]):
        search = _Cells(robot, Walls(robot, pairs, columns), columns, charge)
        found = search.run(begin, ends, left)
        if found is not None:
            return found
        left -= search.boxes
        if left <= 0:
            break
    return None


def _choices(robot: Robot, needed: Iterable[frozenset[int]]) -> Iterator[tuple[int, ...]]:
    """Sets of joints worth cutting up, small ones first: those of a pair, and all up to one of its own."""
    found = {tuple(range(count)) for count in range(1, min(robot.n, MOST_JOINTS) + 1)}
    sets = set(needed)
    found |= {tuple(sorted(columns)) for columns in sets if len(columns) <= MOST_JOINTS}
    for columns in sorted(found, key=lambda columns: (len(columns), columns)):
        if any(each <= set(columns) for each in sets):
            yield columns


class _Cells:
    """The space of some joints in boxes, all of one size at a time; larger ones are kept as many."""

    def __init__(
        self, robot: Robot, walls: Walls, columns: Sequence[int], charge: Callable[[int], None] | None
    ) -> None:
        self._robot, self._walls, self._columns, self._charge = robot, walls, list(columns), charge
        self._endless = [bool(robot.continuous) and robot.continuous[column] for column in columns]
        self._found: list[tuple[FloatArray, FloatArray, IntArray]] = []
        self.boxes = 0

    def run(self, begin: FloatArray, ends: Sequence[FloatArray], most: int) -> NoPath | None:
        """A proof within so many boxes, or None."""
        lower, upper = (bound[self._columns] for bound in self._robot.bounds)
        lower = np.where(self._endless, begin[self._columns] - math.pi, lower)
        upper = np.where(self._endless, begin[self._columns] + math.pi, upper)
        counts = np.full(len(self._columns), FIRST[len(self._columns)])
        state: StateArray = np.zeros(counts, dtype=np.uint8)
        reaches = np.array(self._walls.reaches())
        chosen: BoolArray = np.ones(state.shape, dtype=np.bool_)
        while True:
            if self.boxes + int(chosen.sum()) > most:
                return None
            self._judge(state, chosen, lower, upper)
            start = self._box(begin, lower, upper, counts)
            goals = [self._box(end, lower, upper, counts) for end in ends]
            if self._joined(state == OPEN, start, goals):
                return None
            reached = self._reached(state != WALL, start)
            if not any(reached[goal] for goal in goals):
                return self._proof()
            widths = reaches * (upper - lower) / counts
            cut = widths >= ALIKE * widths.max()
            if math.prod((counts * np.where(cut, 2, 1)).tolist()) > MOST_BOXES:
                return None
            chosen = (state == UNKNOWN) & reached
            counts = counts * np.where(cut, 2, 1)
            for axis in np.flatnonzero(cut).tolist():
                state, chosen = np.repeat(state, 2, axis=axis), np.repeat(chosen, 2, axis=axis)

    def _judge(self, state: StateArray, chosen: BoolArray, lower: FloatArray, upper: FloatArray) -> None:
        """Judge the chosen boxes."""
        width = (upper - lower) / state.shape
        rows = np.argwhere(chosen)
        for first in range(0, len(rows), AT_ONCE):
            part = rows[first : first + AT_ONCE]
            if self._charge is not None:
                self._charge(len(part) * len(self._walls.pairs))
            found = self._walls.judged(lower + (part + 0.5) * width, 0.5 * width)
            self.boxes += len(part)
            is_wall = found.pair >= 0
            state[tuple(part.T)] = np.where(is_wall, WALL, np.where(found.hopeless, OPEN, UNKNOWN))
            low = lower + part[is_wall] * width
            self._found.append((low, low + width, found.pair[is_wall]))

    def _box(self, q: FloatArray, lower: FloatArray, upper: FloatArray, counts: IntArray) -> tuple[int, ...]:
        """The box that holds a configuration; of a joint without end, in whatever turn it is."""
        values = q[self._columns]
        share = (values - lower) / np.where(self._endless, TURN, upper - lower)
        share = np.where(self._endless, share - np.floor(share), share)
        return tuple(np.clip((share * counts).astype(int), 0, counts - 1).tolist())

    def _reached(self, free: BoolArray, start: tuple[int, ...]) -> BoolArray:
        """The boxes connected with that of the start through free ones, face to face; the start's own counts as one."""
        from scipy.ndimage import label

        free = free.copy()
        free[start] = True
        labels, count = label(free)
        same = np.arange(count + 1)
        for axis, endless in enumerate(self._endless):
            if endless:
                first, last = np.take(labels, 0, axis=axis).ravel(), np.take(labels, -1, axis=axis).ravel()
                for a, b in {(int(a), int(b)) for a, b in zip(first, last, strict=True) if a and b}:
                    low, high = sorted((int(same[a]), int(same[b])))
                    same[same == high] = low
        return np.asarray((same[labels] == same[labels[start]]) & (labels > 0), dtype=np.bool_)

    def _joined(self, free: BoolArray, start: tuple[int, ...], goals: Sequence[tuple[int, ...]]) -> bool:
        """Whether a goal is reached through such boxes alone, its own included."""
        free = free.copy()
        for goal in goals:
            free[goal] = True
        reached = self._reached(free, start)
        return any(reached[goal] for goal in goals)

    def _proof(self) -> NoPath:
        lower, upper, pair = (np.concatenate(parts) for parts in zip(*self._found, strict=True))
        used, numbers = np.unique(pair, return_inverse=True)
        names = [self._walls.pairs[k].names for k in used.tolist()]
        distinct = list(dict.fromkeys(names))
        of = np.array([distinct.index(name) for name in names], dtype=np.intp)
        joints = tuple(self._robot.joint_names[column] for column in self._columns)
        return NoPath(joints, tuple(distinct), self.boxes, self._walls.asked, lower, upper, of[numbers])

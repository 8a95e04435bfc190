"""What arms do by one clock, and the proof that no two of them touch, however late each is within a delay.

What an arm does is a line of pieces from 0 on without a gap: stands, and phases of a chain, in each of which it holds
the same. The last piece stands for ever. An arm that is at most d seconds late, at any time and by itself, is at t
where it was to be at some time in [t - d, t]. So it is with another, and where both are together they were to be at
times no more than d apart.

**Lemma.** If every rectangle, a stretch of a piece of one line times a stretch of a piece of the other's, with times
in both that are no more than d apart, is proven (``certify/native/diagram.hpp`` states for what), the two arms never
touch while each is at most d late.

A rectangle [a, a'] x [b, b'] of pieces that begin at t and u has such times if and only if t + a - (u + b') <= d and
u + b - (t + a') <= d. So if it is not proven, it keeps the first from beginning in
[u + b - a' - d, u + b' - a + d], and of two that begin at given times it is farther than
max(t + a - u - b', u + b - t - a') seconds apart: what is tolerated is less than the least of these.

Fingers fill the room that they need at any width, so that it does not matter when a gripper moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from planner_service.cell import Arm, Cell
from planner_service.cell.clocks import Between, Clock
from planner_service.certify import Certifier
from planner_service.certify.diagram import HALVINGS
from planner_service.geometry.arrays import BoolArray, FloatArray
from planner_service.path.trajectory import Trajectory
from planner_service.planning.task_result import TaskResult
from planner_service.scene.scene import Attached, Scene

__all__ = ["FOREVER", "LONGEST", "Lines", "Motion", "Piece", "Placed", "motions_of", "pieces_of", "stand"]

LEVEL = 7
"""Halvings of both pieces, for the rectangles that are proven."""

FOREVER = 1e6
"""Seconds of a stand that does not end."""

LONGEST = 2.0
"""Seconds of delay at most that are said to be tolerated."""

NUDGE = 1e-9
"""Seconds by which a start is put beyond what stands in its way, and a delay below what it has to be."""

LOAD = "carried_object"


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of what one arm does, in which it holds the same.

    Attributes:
        begin: Seconds after the start of its chain.
        seconds: How long it takes.
        q: Joints at 2**HALVINGS + 1 times, evenly from begin to end; of a stand one row.
        travel: How far each has travelled by then.
        held: What is carried, under a name that is the same for all.
    """

    begin: float
    seconds: float
    q: FloatArray
    travel: FloatArray
    held: Attached | None

    @property
    def moves(self) -> bool:
        """Whether it is no stand."""
        return len(self.q) > 1

    @property
    def end(self) -> float:
        """Seconds after the start of its chain."""
        return self.begin + self.seconds

    def clock(self, columns: Sequence[int]) -> Clock:
        """The same as the diagram takes it."""
        if not self.moves:
            return Clock.standing(self.q[0], columns)
        return Clock(np.array(columns, dtype=np.intp), self.seconds, self.q, self.travel)

    def stretches(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """From when to when some stretches of it are."""
        if not self.moves:
            return np.full(len(rows), self.begin), np.full(len(rows), self.end)
        step = self.seconds / (1 << LEVEL)
        return self.begin + rows * step, self.begin + (rows + 1.0) * step


@dataclass(frozen=True, eq=False)
class Placed:
    """A piece, and when its chain starts."""

    piece: Piece
    start: float

    @property
    def begin(self) -> float:
        """Seconds."""
        return self.start + self.piece.begin

    @property
    def end(self) -> float:
        """Seconds."""
        return self.start + self.piece.end


def stand(q: FloatArray, begin: float, seconds: float, held: Attached | None = None) -> Piece:
    """A piece in which an arm stands."""
    rows = np.array(q, dtype=np.float64)[None]
    return Piece(begin, seconds, rows, np.zeros_like(rows), held)


class Motion(NamedTuple):
    """A motion of a chain, what is carried during it, and for how many seconds the arm stands before it."""

    trajectory: Trajectory
    attached: tuple[Attached, ...]
    still: float


def motions_of(task: TaskResult, gripper_seconds: float) -> list[Motion]:
    """The motions of a chain; the arm stands while the gripper moves."""
    out, world = list[Motion](), task.begin
    for segment in task.segments:
        world = segment.world_after(world)
        still = segment.wait + (0.0 if segment.gripper is None else gripper_seconds)
        out.append(Motion(segment.result.unwrap()[1], world.scene.attached, still))
    return out


def pieces_of(motions: Sequence[Motion]) -> list[Piece]:
    """The phases of a chain, without the stand after it: to the object, with it, and away; then each motion by itself.

    What is taken counts as held while the gripper closes, and is where it was as well; while the gripper opens it is
    where it is left.
    """
    out, phase, held, begin = list[Piece](), list[Motion](), None, 0.0
    for motion in motions:
        now = _load(motion.attached)
        left = held is None and any(piece.held is not None for piece in out)
        if phase and (now != held or left):
            out.append(_phase(phase, begin, held))
            begin, phase = out[-1].end, []
        phase.append(motion)
        held = now
    return [*out, _phase(phase, begin, held)]


def _load(attached: Sequence[Attached]) -> Attached | None:
    """What is carried, under a name that is the same for all; a chain carries one object."""
    if not attached:
        return None
    return replace(attached[0], name=LOAD, touch_links=(), constraints=(), mass=None)


def _phase(motions: Sequence[Motion], begin: float, held: Attached | None) -> Piece:
    """Motions, and the stands before them, as one piece."""
    ends = np.cumsum([seconds for each in motions for seconds in (each.still, each.trajectory.duration)])
    times = np.linspace(0.0, float(ends[-1]), (1 << HALVINGS) + 1)
    n = motions[0].trajectory.path.n
    q, travel = np.empty((len(times), n)), np.empty((len(times), n))
    gone, at = np.zeros(n), motions[0].trajectory.path.waypoints[0]
    for k, motion in enumerate(motions):
        trajectory, path = motion.trajectory, motion.trajectory.path
        gone = gone + np.abs(path.waypoints[0] - at)  # motions join within a millionth
        since = ends[2 * k - 1] if k else -1.0
        rows = times > since
        own = np.clip(times[rows] - ends[2 * k], 0.0, trajectory.duration)
        s = np.clip(np.asarray(trajectory.s(own)), 0.0, path.length)
        q[rows], travel[rows] = path(s), gone + path.travel(s)
        gone, at = gone + path.travel(path.length), path.waypoints[-1]
    return Piece(begin, float(ends[-1]), q, travel, held)


class Lines:
    """What the arms of a cell do, and what is proven between them.

    Args:
        padding: Metres that arms keep from each other.
    """

    def __init__(self, cell: Cell, starts: Mapping[str, FloatArray], delay: float, padding: float) -> None:
        self.delay, self._padding = delay + 4.0 * NUDGE, padding
        self._roomy = {name: Arm(arm.robot.with_finger_room(), arm.base) for name, arm in cell.layout.arms.items()}
        self.lines = {name: [Placed(stand(starts[name], 0.0, FOREVER), 0.0)] for name in cell.arms}
        self._cells: dict[tuple[str, Attached | None, str, Attached | None], tuple[Cell, Certifier]] = {}
        self._known: dict[tuple[int, int], tuple[Piece, Piece, BoolArray]] = {}
        self.rectangles = self.bounds = 0

    def fit(
        self, name: str, wait: Piece | None, pieces: Sequence[Piece], earliest: float, latest: float
    ) -> float | None:
        """When a chain of an arm starts at the earliest so that all of it is proven; None if no start is.

        Args:
            wait: Where the arm stands before, from ``earliest`` on, if that is not proven yet.
            pieces: The chain, and the stand after it.
            latest: No later start is looked at.
        """
        others = [each for other, line in self.lines.items() if other != name for each in line]
        owner = {id(each): other for other, line in self.lines.items() for each in line}
        ways: FloatArray = np.zeros((0, 2))
        looked = set[tuple[int, int]]()
        start = earliest
        while start <= latest:
            found, until = list[FloatArray]([ways]), math.inf
            for theirs in others:
                for piece in pieces:
                    if (id(piece), id(theirs)) in looked or not self._meet(Placed(piece, start), theirs, self.delay):
                        continue
                    looked.add((id(piece), id(theirs)))
                    found.append(self._ways(name, piece, owner[id(theirs)], theirs))
                if wait is not None and start > earliest:
                    standing = Placed(replace(wait, seconds=start - earliest), earliest)
                    if self._meet(standing, theirs, self.delay):
                        until = min(until, self._until(name, wait, owner[id(theirs)], theirs, earliest))
            if until <= start:
                return None
            ways = np.concatenate(found)
            moved = start
            for low, high in ways[np.argsort(ways[:, 0])].tolist():
                if low <= moved <= high:
                    moved = high + NUDGE
            if moved == start:
                return start
            start = moved
        return None

    def commit(self, name: str, pieces: Sequence[Piece], start: float, left_at: float) -> None:
        """Add a chain that ``fit`` has found the start of; what the arm was to do from ``left_at`` on is left out."""
        before = self.lines[name]
        line = [each for each in before if each.begin < left_at]
        if start > left_at:
            q = line[-1].piece.q[-1] if line else before[0].piece.q[0]
            line.append(Placed(stand(q, 0.0, start - left_at), left_at))
        self.lines[name] = [*line, *(Placed(piece, start) for piece in pieces)]

    def end(self) -> float:
        """When all arms stand for ever."""
        return max(line[-1].begin for line in self.lines.values())

    def tolerated(self, a: str, b: str) -> float:
        """Seconds by which each of two arms may be late, at most ``LONGEST``; less than 0 if they are not apart."""
        least = LONGEST
        for one in self.lines[a]:
            for two in self.lines[b]:
                if self._meet(one, two, least):
                    (low, high), (begin, end) = self._open(a, one.piece, b, two.piece)
                    apart = np.maximum(low + one.start - end - two.start, begin + two.start - high - one.start)
                    least = min(least, float(apart.min(initial=math.inf)) - NUDGE)
        return least

    def tolerates(self) -> dict[tuple[str, str], float]:
        """The same of each two arms."""
        return {(a, b): self.tolerated(a, b) for a, b in combinations(self.lines, 2)}

    @staticmethod
    def _meet(one: Placed, two: Placed, delay: float) -> bool:
        return one.begin - two.end <= delay and two.begin - one.end <= delay

    def _ways(self, a: str, piece: Piece, b: str, theirs: Placed) -> FloatArray:
        """Starts of a chain, from when to when, at which a piece of it is not proven apart from another arm's."""
        (low, high), (begin, end) = self._open(a, piece, b, theirs.piece)
        at = theirs.start
        return merged(np.stack([at + begin - high - self.delay, at + end - low + self.delay], axis=1))

    def _until(self, a: str, wait: Piece, b: str, theirs: Placed, since: float) -> float:
        """Until when an arm that stands since a time is proven apart from another's piece."""
        _, (begin, end) = self._open(a, wait, b, theirs.piece)
        met = theirs.start + end + self.delay >= since
        return float((theirs.start + begin - self.delay)[met].min(initial=math.inf))

    def _open(
        self, a: str, one: Piece, b: str, two: Piece
    ) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """The rectangles that are not proven: from when to when of each piece's chain."""
        rows, columns = np.nonzero(~self._proven(a, one, b, two))
        return one.stretches(rows.astype(float)), two.stretches(columns.astype(float))

    def _proven(self, a: str, one: Piece, b: str, two: Piece) -> BoolArray:
        if (b, a) in combinations(self.lines, 2):
            return self._proven(b, two, a, one).T
        known = self._known.get((id(one), id(two)))
        if known is not None:
            return known[2]
        cell, certifier = self._certifier(a, one.held, b, two.held)
        columns = [cell.of_arm(name, np.arange(cell.robot.n)).astype(int).tolist() for name in (a, b)]
        still = cell.joined({a: one.q[0], b: two.q[0]})
        between = Between(certifier, one.clock(columns[0]), two.clock(columns[1]), still, self._padding)
        proven = between.proven(LEVEL)
        self.rectangles, self.bounds = self.rectangles + between.rectangles, self.bounds + between.bounds
        if not one.moves:
            proven = np.asarray(proven.all(axis=0, keepdims=True))
        if not two.moves:
            proven = np.asarray(proven.all(axis=1, keepdims=True))
        self._known[id(one), id(two)] = one, two, proven  # both are kept, so that no other gets their numbers
        return proven

    def _certifier(self, a: str, held: Attached | None, b: str, other: Attached | None) -> tuple[Cell, Certifier]:
        key = (a, held, b, other)
        if key not in self._cells:
            two = Cell({name: self._roomy[name] for name in (a, b)}, Scene())
            cell = two.carrying({name: [item] for name, item in ((a, held), (b, other)) if item is not None})
            self._cells[key] = cell, cell.between(a, b, cell.robot.home)
        return self._cells[key]

    def forget(self) -> None:
        """Let go of what is known of pieces that are in no line."""
        used = {id(each.piece) for line in self.lines.values() for each in line}
        self._known = {key: value for key, value in self._known.items() if used.issuperset(key)}


def merged(ways: FloatArray) -> FloatArray:
    """Spans (k, 2) that overlap made one."""
    if len(ways) < 2:
        return ways
    ways = ways[np.argsort(ways[:, 0])]
    high = np.maximum.accumulate(ways[:, 1])
    first = np.append(True, ways[1:, 0] > high[:-1])
    return np.stack([ways[first, 0], high[np.append(np.flatnonzero(first)[1:] - 1, len(ways) - 1)]], axis=1)

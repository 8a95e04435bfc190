"""Reachability maps: of each voxel a witness that the tool gets there, a proof that it does not, or neither."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import islice, takewhile
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.collision.checker import CollisionChecker
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray, read_only
from planner_service.geometry.validation import finite_numbers, function_or_none, instance, items, number, whole
from planner_service.kinematics.tool_line import require_within_limits
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.workspace.grid import VoxelGrid
from planner_service.workspace.orientation import ToolOrientation
from planner_service.workspace.reachability_map import (
    BLOCK,
    MOST_ORIENTATIONS,
    ReachabilityMap,
    VoxelVerdict,
    block_counts,
)
from planner_service.workspace.solids import obstructed
from planner_service.workspace.tree import Boxes, Settled, VoxelTree

__all__ = ["HALVINGS", "MOST_JOINTS", "Arm", "joined", "prove_again", "reachability"]

HALVINGS = 1
"""How often a voxel in doubt is halved along each axis unless asked otherwise: into 8 parts."""

MOST_JOINTS = 6
"""Joints that move the tool, at most."""

MOST_WORKERS = 64


@dataclass(frozen=True, eq=False)
class Arm:
    """The joints of a robot that move its tool, as a robot of its own; the others stay.

    Attributes:
        robot: Its joints all move the tool.
        columns: Which entries of the whole robot's q they are.
        still: q (n,) of the whole robot, whose other entries hold.
    """

    robot: Robot
    columns: tuple[int, ...]
    still: FloatArray

    @classmethod
    def of(cls, robot: Robot, still: ArrayLike | None) -> Arm:
        """The arm with the other joints at the values of ``still``, or of home.

        Raises:
            InvalidRequest: No joint or more than six move the tool, or ``still`` is no configuration within the limits.
        """
        rest = robot.home if still is None else finite_numbers("still", still, robot.n)
        require_within_limits("still", robot, rest)
        columns = sorted({robot.bodies[body].q_index for body in chain_to_base(robot.bodies, robot.tool_body)})
        if not 1 <= len(columns) <= MOST_JOINTS:
            expected = f"1 to {MOST_JOINTS} joints that move the tool, not {len(columns)}; lock some (robot.locked)"
            raise InvalidRequest("robot", robot.name, expected)
        others = {robot.joint_names[k]: float(rest[k]) for k in range(robot.n) if k not in columns}
        return cls(robot.locked(others) if others else robot, tuple(columns), rest)

    def whole(self, Q: FloatArray) -> FloatArray:
        """Configurations (k, n) of the whole robot for configurations of the arm."""
        out = np.repeat(self.still[np.newaxis], len(Q), axis=0)
        out[:, list(self.columns)] = Q
        return out


def reachability(
    robot: Robot,
    scene: Scene,
    grid: VoxelGrid,
    orientations: Iterable[ToolOrientation],
    *,
    still: ArrayLike | None = None,
    halvings: int = HALVINGS,
    workers: int = 1,
    time_limit: float | None = None,
    progress: Callable[[int, int], Any] | None = None,
    resume: ReachabilityMap | None = None,
) -> ReachabilityMap:
    """Where the tool can be in a scene, for each of some sets of orientations.

    A verdict says what ``VoxelVerdict`` says, about the robot's model in double precision and, for witnesses, the
    collision checker. Every configuration within the joint limits counts, also one that no path leads to. Equal
    arguments give equal maps, whatever ``workers`` is, unless the time limit ends the work.

    Args:
        still: A configuration (n,) whose values the joints keep that do not move the tool; home if None.
        halvings: How often a voxel in doubt is halved along each axis, 0 to 5: more leaves fewer unknown and takes
            longer, about four times for each.
        workers: Threads.
        time_limit: Seconds after which no block is begun; None for none. The rest stays unknown.
        progress: Called with how many blocks are done, and how many there are.
        resume: A map of the same robot, scene, grid and orientations; its blocks are not done again.

    Raises:
        InvalidRequest: Arguments out of range; the robot has no joint or more than six that move the tool, or
            ``resume`` is about something else.
    """
    instance("robot", robot, Robot, "a Robot")
    instance("scene", scene, Scene, "a Scene")
    instance("grid", grid, VoxelGrid, "a VoxelGrid")
    sets = items("orientations", orientations, ToolOrientation, "ToolOrientations", MOST_ORIENTATIONS)
    whole("halvings", halvings, 0, 5)
    whole("workers", workers, 1, MOST_WORKERS)
    limit = math.inf if time_limit is None else number("time_limit", time_limit, "seconds, at least 0", 0.0, 1e9)
    function_or_none("progress", progress, "a function of two numbers")
    arm = Arm.of(robot, still)
    verdicts = np.zeros((len(sets), *grid.counts), dtype=np.uint8)
    done = np.zeros((len(sets), *block_counts(grid)), dtype=np.bool_)
    empty = ReachabilityMap(grid, sets, robot.hash, scene.hash, arm.still, verdicts, np.zeros((0, robot.n)), done)
    begun = empty if resume is None else _same(instance("resume", resume, ReachabilityMap, "a ReachabilityMap"), empty)
    work = _Work(arm, scene, begun, halvings)
    return work.run(begun, workers, time.monotonic() + limit, progress)


def prove_again(found: ReachabilityMap, robot: Robot, scene: Scene, *, workers: int = 1) -> ReachabilityMap:
    """A map all of whose verdicts are made here: witnesses are looked at, and what a file says is proven or unknown.

    It takes about as long as the map took.

    Raises:
        InvalidRequest: The map is about another robot or scene, or a witness is none.
    """
    instance("found", found, ReachabilityMap, "a ReachabilityMap")
    require_witnesses(found, robot, scene)
    again = reachability(robot, scene, found.grid, found.orientations, still=found.still, workers=workers)
    verdicts = again.verdicts.copy()
    verdicts[(verdicts == VoxelVerdict.UNKNOWN) & (found.verdicts == VoxelVerdict.REACHABLE)] = VoxelVerdict.REACHABLE
    contradicted = (again.verdicts >= VoxelVerdict.OUT_OF_REACH) & (found.verdicts == VoxelVerdict.REACHABLE)
    if contradicted.any():
        raise BrokenInvariant("a voxel with a witness is proven to have none")
    return joined(again, verdicts, again, found)


def require_witnesses(found: ReachabilityMap, robot: Robot, scene: Scene) -> None:
    """That a map is about this robot and scene, and that each of its witnesses is one.

    Raises:
        InvalidRequest: It is not; naming the first.
    """
    instance("robot", robot, Robot, "a Robot")
    instance("scene", scene, Scene, "a Scene")
    for name, said, digest in (("robot", found.robot, robot.hash), ("scene", found.scene, scene.hash)):
        if said != digest:
            raise InvalidRequest(name, digest, f"the {name} of the map, whose hash is {said}")
    arm, checker = Arm.of(robot, found.still), CollisionChecker(robot, scene)
    cells = np.argwhere(found.verdicts == VoxelVerdict.REACHABLE)
    Q = np.asarray(found.witnesses)
    kept = np.ones(robot.n, dtype=np.bool_)
    kept[list(arm.columns)] = False
    good = np.all((robot.limits.lower <= Q) & (robot.limits.upper >= Q), axis=1)
    good &= np.all(Q[:, kept] == found.still[kept], axis=1)
    for k, orientation in enumerate(found.orientations):
        rows = np.flatnonzero((cells[:, 0] == k) & good)
        tree = VoxelTree(arm.robot, orientation, None, None)
        there = tree.holds(Q[rows][:, list(arm.columns)], found.grid.centres(cells[rows, 1:]), found.grid.half)
        good[rows[~there]] = False
    good[good] = checker.states_are_free(Q[good])
    if not good.all():
        row = int(np.argmin(good))
        said = "a free configuration with the tool in its voxel"
        raise InvalidRequest(f"witnesses[{row}]", Q[row].tolist(), f"{said} {cells[row].tolist()}")


def joined(
    like: ReachabilityMap, verdicts: NDArray[np.uint8], first: ReachabilityMap, second: ReachabilityMap
) -> ReachabilityMap:
    """A map with these verdicts, whose witnesses are those of the first map, or else of the second."""
    table = np.full((verdicts.size, len(like.still)), np.nan)
    for one in (second, first):
        table[one.verdicts.reshape(-1) == VoxelVerdict.REACHABLE] = one.witnesses
    chosen = table[verdicts.reshape(-1) == VoxelVerdict.REACHABLE]
    return ReachabilityMap(
        like.grid, like.orientations, like.robot, like.scene, like.still, verdicts, read_only(chosen), like.done
    )


def _same(resumed: ReachabilityMap, empty: ReachabilityMap) -> ReachabilityMap:
    for name in ("grid", "orientations", "robot", "scene"):
        if getattr(resumed, name) != getattr(empty, name):
            raise InvalidRequest("resume", getattr(resumed, name), f"a map of the same {name}")
    if not np.array_equal(resumed.still, empty.still):
        raise InvalidRequest("resume", resumed.still.tolist(), "a map with the same still")
    return resumed


class _Work:
    """The blocks of a map, each settled for itself."""

    def __init__(self, arm: Arm, scene: Scene, found: ReachabilityMap, halvings: int) -> None:
        self._arm, self._grid, self._halvings = arm, found.grid, halvings
        solids, checker = obstructed(arm.robot, scene), CollisionChecker(arm.robot, scene)
        self._trees = [VoxelTree(arm.robot, each, solids, checker) for each in found.orientations]

    def run(
        self, found: ReachabilityMap, workers: int, until: float, progress: Callable[[int, int], Any] | None
    ) -> ReachabilityMap:
        verdicts, done = found.verdicts.copy(), found.done.copy()
        witness = np.full((verdicts.size, len(self._arm.still)), np.nan)
        witness[verdicts.reshape(-1) == VoxelVerdict.REACHABLE] = found.witnesses
        numbers = np.arange(verdicts.size).reshape(verdicts.shape)
        for block, cells, settled in self._settled(np.argwhere(~found.done), workers, until):
            at = (block[0], *cells.T)
            reached = ~np.isnan(settled.witness[:, 0])
            proven = np.where(settled.blocked, VoxelVerdict.BLOCKED, VoxelVerdict.OUT_OF_REACH)
            verdicts[at] = np.where(reached, VoxelVerdict.REACHABLE, np.where(settled.doubtful, 0, proven))
            witness[numbers[at][reached]] = self._arm.whole(settled.witness[reached])
            done[tuple(block)] = True
            if progress is not None:
                progress(int(done.sum()), done.size)
        chosen = read_only(witness[verdicts.reshape(-1) == VoxelVerdict.REACHABLE])
        return ReachabilityMap(
            found.grid, found.orientations, found.robot, found.scene, found.still, verdicts, chosen, done
        )

    def _settled(
        self, blocks: IntArray, workers: int, until: float
    ) -> Iterator[tuple[tuple[int, ...], IntArray, Settled]]:
        """Blocks with the voxels (k, 3) that they have, and what is known of those."""
        left = takewhile(lambda _: time.monotonic() < until, (tuple(block) for block in blocks.tolist()))
        if workers == 1:
            for block in left:
                yield self._block(block)
            return
        with ThreadPoolExecutor(workers) as pool:
            running = {pool.submit(self._block, block) for block in islice(left, 2 * workers)}
            try:
                while running:
                    ready, running = wait(running, return_when=FIRST_COMPLETED)
                    for one in ready:
                        yield one.result()
                        running |= {pool.submit(self._block, block) for block in islice(left, 1)}
            finally:
                pool.shutdown(cancel_futures=True)

    def _block(self, block: tuple[int, ...]) -> tuple[tuple[int, ...], IntArray, Settled]:
        """A block, halved down to its voxels as long as something may reach its parts, then these settled."""
        tree, counts = self._trees[block[0]], np.array(self._grid.counts)
        first = BLOCK * np.array(block[1:])
        cells = np.argwhere(np.ones(np.minimum(counts - first, BLOCK), dtype=np.bool_)) + first
        number = np.full((BLOCK,) * 3, -1, dtype=np.intp)
        number[tuple((cells - first).T)] = np.arange(len(cells))
        blocked = np.zeros(len(cells), dtype=np.bool_)
        half, size = self._grid.half, BLOCK
        corners: IntArray = np.zeros((1, 3), dtype=np.intp)  # of each box its first voxel, from that of the block
        boxes = tree.whole(self._grid.centres(first[None]) + (size - 1) * half)
        while True:
            if size > 1:
                boxes, dropped, _, _ = tree.covered(boxes, half * size)
                for corner in corners[dropped].tolist():
                    inside = number[tuple(slice(k, k + size) for k in corner)].reshape(-1)
                    blocked[inside[inside >= 0]] = True
            left = np.flatnonzero(np.diff(boxes.offsets) > 0)
            if size == 1 or not len(left):
                break
            boxes, corners, size = self._halves(boxes.of(np.repeat(left, 8)), corners[left], size)
            there = np.flatnonzero(np.all(first + corners < counts, axis=1))
            boxes, corners = boxes.of(there), corners[there]
        rows = number[tuple(corners[left].T)]
        doubtful, witness = np.zeros(len(cells), dtype=np.bool_), np.full((len(cells), self._arm.robot.n), np.nan)
        if len(rows):
            some = boxes.of(left).moved(np.arange(len(left)), np.zeros((len(left), 3)))
            settled = tree.settle(some, half, self._halvings)
            doubtful[rows], witness[rows] = settled.doubtful, settled.witness
            blocked[rows] |= settled.blocked
        return block, cells, Settled(doubtful, blocked, witness)

    def _halves(self, parts: Boxes, corners: IntArray, size: int) -> tuple[Boxes, IntArray, int]:
        """Eight boxes for each of those with these corners (m, 3); ``parts``: each of them eight times."""
        steps = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        shifts = np.tile((steps - 0.5) * size * self._grid.half, (len(corners), 1))
        half = size // 2
        moved = (corners[:, None] + steps * half).reshape(-1, 3)
        return parts.moved(parts.voxel, shifts), moved, half

"""Where to put a robot so that its tool gets to given poses: bases have witnesses, and that there is none is proven.

Poses and obstacles are in the world; a base stands upright somewhere in a region of it. The region is halved: of each
box of bases the one in the middle is tried, and a box is given up if for one of the poses no configuration is left,
wherever the base is in it. For that a pose seen from all of these bases is a box of positions with a range of
orientations, and compiled covers (tree.py) show that no joint values bring the tool there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from planner_service.collision.checker import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, as_sent
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import copied_in, finite_numbers, instance, items, number, whole
from planner_service.kinematics.inverse import configurations_at, solutions_known
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.workspace.grid import FARTHEST
from planner_service.workspace.mapping import Arm
from planner_service.workspace.orientation import ToolOrientation
from planner_service.workspace.solids import obstructed
from planner_service.workspace.tree import Boxes, VoxelTree

__all__ = ["BasePlacement", "BaseRegion", "PlacedBase", "place_base", "seen_from"]

MOST_POSES, MOST_BASES, MOST_BOXES = 200, 100, 100_000

BOXES = 2000
"""Boxes of bases that are looked at unless asked otherwise."""

CLEARANCE, ROOM = 0.05, 0.2
"""Metres and radians that count alike in ``PlacedBase.margin``."""

LEAST = 1e-3
"""Metres, and radians at half a metre, below which a box of bases is not halved."""

ARM = 0.5
"""Metres that a radian of yaw counts as."""


@dataclass(frozen=True)
class BaseRegion:
    """Where a base may stand: upright, its origin in a box, turned about the world's z axis by a range of angles.

    Attributes:
        lower, upper: Corners (x, y, z) in metres; equal values fix a coordinate.
        yaw: Lowest and highest angle in radians, at most one turn apart.

    Raises:
        InvalidRequest: The corners or angles are not in order, or a corner is beyond 100 m.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    yaw: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        low, high = (finite_numbers(name, getattr(self, name), 3) for name in ("lower", "upper"))
        for name, corner in (("lower", low), ("upper", high)):
            if np.abs(corner).max() > FARTHEST:
                raise InvalidRequest(name, corner.tolist(), f"within {FARTHEST:g} m of the world's origin")
        if not np.all(low <= high):
            raise InvalidRequest("upper", high.tolist(), f"not below lower {low.tolist()}")
        angles = finite_numbers("yaw", self.yaw, 2)
        if not (-10.0 <= angles[0] <= angles[1] <= 10.0 and angles[1] - angles[0] <= 2.0 * math.pi + 1e-9):
            raise InvalidRequest("yaw", angles.tolist(), "two angles in order, in radians, at most one turn apart")
        x, y, z = low.tolist()
        object.__setattr__(self, "lower", (x, y, z))
        x, y, z = high.tolist()
        object.__setattr__(self, "upper", (x, y, z))
        a, b = angles.tolist()
        object.__setattr__(self, "yaw", (a, b))


@dataclass(frozen=True, eq=False)
class PlacedBase:
    """A base from which the tool gets to all poses.

    Attributes:
        pose: Of the base in the world.
        witnesses: For each pose a configuration (n,) within the limits that the checker calls free, (k, n).
        clearances: At least so far from everything, its own other links included, in metres, (k,).
        rooms: Radians, or metres of joints that slide, to the nearest joint limit, (k,).
    """

    pose: Pose
    witnesses: FloatArray
    clearances: FloatArray
    rooms: FloatArray
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        instance("pose", self.pose, Pose, "a Pose")
        for name, dims in (("witnesses", 2), ("clearances", 1), ("rooms", 1)):
            array = getattr(self, name)
            if not isinstance(array, np.ndarray) or array.dtype != np.float64 or array.ndim != dims:
                raise InvalidRequest(name, getattr(array, "shape", type(array).__name__), f"{dims}-dimensional floats")
            if len(array) != len(self.witnesses) or not len(array) or np.isnan(array).any():
                raise InvalidRequest(name, array.shape, "numbers for each pose, at least one")
        copied_in(self, "witnesses", "clearances", "rooms")

    @property
    def margin(self) -> float:
        """The least over all poses of clearance / 0.05 m and room / 0.2 rad: what bases are sorted by."""
        return float(min(self.clearances.min() / CLEARANCE, self.rooms.min() / ROOM))


@dataclass(frozen=True, eq=False)
class BasePlacement:
    """What was found out about a region.

    Attributes:
        bases: The one with the largest margin first.
        ruled_out: Of each pose the share of the region that is proven to have no base because of it, (k,). A part that
            several poses rule out counts for the first of them.
        unsettled: The share of the region of which neither is known, 0 to 1; where bases were found, what was not
            looked at counts as such.
    """

    bases: tuple[PlacedBase, ...]
    ruled_out: FloatArray
    unsettled: float
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        object.__setattr__(self, "bases", items("bases", self.bases, PlacedBase, "PlacedBases", MOST_BASES))
        array = self.ruled_out
        if not isinstance(array, np.ndarray) or array.dtype != np.float64 or array.ndim != 1 or np.isnan(array).any():
            raise InvalidRequest("ruled_out", getattr(array, "shape", type(array).__name__), "a share for each pose")
        object.__setattr__(self, "unsettled", number("unsettled", self.unsettled, "a share in [0, 1]", 0.0, 1.0))
        copied_in(self, "ruled_out")

    @property
    def proven(self) -> bool:
        """Whether it is proven that no base in the region has a configuration within the limits for every pose."""
        return not self.bases and self.unsettled == 0.0

    def __str__(self) -> str:
        if self.bases:
            x, y, z = self.bases[0].pose.position
            best = self.bases[0]
            return (
                f"{len(self.bases)} bases; best at ({x:.3f}, {y:.3f}, {z:.3f}), clearance at least "
                f"{1000 * float(best.clearances.min()):.1f} mm, {float(best.rooms.min()):.3f} rad to the joint limits"
            )
        blame = ", ".join(f"pose {k} {100 * share:.0f} %" for k, share in enumerate(self.ruled_out.tolist()) if share)
        if self.proven:
            return f"no base in the region, proven: ruled out by {blame}"
        return f"none found; {100 * self.unsettled:.0f} % of the region unsettled" + (
            f", ruled out by {blame}" if blame else ""
        )


def place_base(
    robot: Robot,
    poses: Iterable[Pose | PoseGoal],
    region: BaseRegion,
    scene: Scene | None = None,
    *,
    still: ArrayLike | None = None,
    clearance: float = 0.0,
    room: float = 0.0,
    most_bases: int = 5,
    most_boxes: int = BOXES,
) -> BasePlacement:
    """Bases from which the tool gets to all of some poses, or a proof that the region has none.

    Equal arguments give equal bases. Bases are not optimised: the search ends with ``most_bases`` of them, spread over
    the region. Each witness is within the limits and free in the scene as seen from the base; links that do not move
    are not checked against obstacles. A proof is about joint limits and the robot's collisions with itself: where
    obstacles alone rule bases out, that is never proven.

    Args:
        poses: Of the tool in the world. Of a ``PoseGoal`` any of its candidates will do for a base, and a proof is
            about all that its tolerances allow.
        region: Where the base may be.
        scene: Obstacles in the world; none if not given. What is attached is carried by the tool.
        still: A configuration (n,) whose values the joints keep that do not move the tool; home if None.
        clearance: Metres that each witness keeps from everything at least.
        room: Radians, or metres, that it keeps from the joint limits at least.
        most_bases: Bases after which the search ends.
        most_boxes: Boxes of bases likewise.

    Raises:
        InvalidRequest: Arguments out of range, or no joint or more than six move the tool.
    """
    instance("robot", robot, Robot, "a Robot")
    goals = tuple(
        PoseGoal(each) if isinstance(each, Pose) else instance(f"poses[{k}]", each, PoseGoal, "a Pose or a PoseGoal")
        for k, each in enumerate(items("poses", poses, object, "Poses or PoseGoals", MOST_POSES))
    )
    if not goals:
        raise InvalidRequest("poses", (), "at least one")
    instance("region", region, BaseRegion, "a BaseRegion")
    world = Scene() if scene is None else instance("scene", scene, Scene, "a Scene")
    number("clearance", clearance, "metres in [0, 10]", 0.0, 10.0)
    number("room", room, "radians in [0, 10]", 0.0, 10.0)
    whole("most_bases", most_bases, 1, MOST_BASES)
    whole("most_boxes", most_boxes, 1, MOST_BOXES)
    return _Search(robot, goals, world, Arm.of(robot, still), clearance, room).run(region, most_bases, most_boxes)


def seen_from(base: Pose, scene: Scene) -> Scene:
    """A scene of the world in the frame of a base there."""
    back = instance("base", base, Pose, "a Pose").inverse()
    instance("scene", scene, Scene, "a Scene")
    return replace(scene, obstacles=tuple(replace(each, pose=back @ each.pose) for each in scene.obstacles))


@dataclass(frozen=True, eq=False)
class _Box:
    """Bases around ``middle`` (x, y, z, yaw) by up to ``half`` (4,), and all that brings the tool to each pose."""

    middle: FloatArray
    half: FloatArray
    joints: tuple[FloatArray, ...]

    def halves(self) -> tuple[_Box, _Box]:
        """It, halved where it is widest."""
        widest = int((self.half * np.array([1.0, 1.0, 1.0, ARM])).argmax())
        step = np.zeros(4)
        step[widest] = self.half[widest] / 2.0
        low, high = (replace(self, middle=self.middle + sign * step, half=self.half - step) for sign in (-1.0, 1.0))
        return low, high


class _Search:
    def __init__(
        self, robot: Robot, goals: tuple[PoseGoal, ...], scene: Scene, arm: Arm, clearance: float, room: float
    ) -> None:
        self._robot, self._goals, self._scene, self._arm = robot, goals, scene, arm
        self._clearance, self._room = clearance, room
        self._itself = obstructed(arm.robot, Scene())

    def run(self, region: BaseRegion, most_bases: int, most_boxes: int) -> BasePlacement:
        low, high = (
            np.array([*corner, yaw]) for corner, yaw in zip((region.lower, region.upper), region.yaw, strict=True)
        )
        domain = VoxelTree(self._arm.robot, ToolOrientation(), None, None).whole(np.zeros((1, 3))).joints
        waiting = deque([(_Box((low + high) / 2.0, (high - low) / 2.0, (domain,) * len(self._goals)), 1.0)])
        bases = list[PlacedBase]()
        ruled_out, unsettled = np.zeros(len(self._goals)), 0.0
        for _ in range(most_boxes):
            if not waiting or len(bases) >= most_bases:
                break
            box, share = waiting.popleft()
            blame, box = self._narrowed(box)
            if blame is not None:
                ruled_out[blame] += share
                continue
            found = self._base(box.middle)
            if found is not None:
                bases.append(found)
            if float((box.half * np.array([1.0, 1.0, 1.0, ARM])).max()) <= LEAST:
                unsettled += share
            else:
                waiting.extend((half, share / 2.0) for half in box.halves())
        unsettled += math.fsum(share for _, share in waiting)
        order = sorted(range(len(bases)), key=lambda k: -bases[k].margin)
        return BasePlacement(tuple(bases[k] for k in order), ruled_out, min(1.0, unsettled))

    def _narrowed(self, box: _Box) -> tuple[int | None, _Box]:
        """The first pose that no base of the box has a configuration for, if there is one; and the box with less."""
        joints = list(box.joints)
        for k, goal in enumerate(self._goals):
            joints[k] = self._left(goal, box, joints[k])
            if not len(joints[k]):
                return k, box
        return None, replace(box, joints=tuple(joints))

    def _left(self, goal: PoseGoal, box: _Box, joints: FloatArray) -> FloatArray:
        """Boxes of joint values (b, 2, n) with all that bring the tool to a goal, wherever the base is in the box.

        Seen from a base at b + d, turned by a + e, a place p is at R(-a - e) (p - b - d). That is at most
        min(e, 2) |p - b - d|, in x and y, from R(-a) (p - b - d), and this by R(-a) d from R(-a) (p - b).
        """
        base = _base_pose(box.middle)
        seen = base.inverse() @ goal.pose
        hx, hy, hz, spin = (box.half * (1.0 + 1e-9) + 1e-12).tolist()
        c, s = abs(math.cos(float(box.middle[3]))), abs(math.sin(float(box.middle[3])))
        px, py, _ = (np.array(goal.pose.position) - box.middle[:3]).tolist()
        swing = min(spin, 2.0) * (math.hypot(px, py) + math.hypot(hx, hy)) * (1.0 + 1e-9)
        half = np.array([c * hx + s * hy + swing, s * hx + c * hy + swing, hz]) + goal.position_tolerance + 1e-9
        turn = min(math.pi, goal.orientation_tolerance + spin)
        tree = VoxelTree(self._arm.robot, ToolOrientation(seen.quaternion, turn, goal.free_axis), self._itself, None)
        boxes = Boxes(
            np.zeros(1, dtype=np.int64), np.array([seen.position]), np.array([0, len(joints)], dtype=np.int64), joints
        )
        return tree.covered(boxes, half)[0].joints

    def _base(self, at: FloatArray) -> PlacedBase | None:
        """The base there, if it has a witness for every pose."""
        base = _base_pose(at)
        checker = CollisionChecker(self._robot, seen_from(base, self._scene))
        found = list[tuple[FloatArray, float, float]]()
        for goal in self._goals:
            best = self._witness(checker, replace(goal, pose=base.inverse() @ goal.pose))
            if best is None:
                return None
            found.append(best)
        Q, clearances, rooms = (np.array(column) for column in zip(*found, strict=True))
        return PlacedBase(base, Q, clearances, rooms)

    def _witness(self, checker: CollisionChecker, goal: PoseGoal) -> tuple[FloatArray, float, float] | None:
        """The free configuration for a goal with the largest margin, its clearance and room; None if there is none."""
        best, most = None, -math.inf
        limits, columns = self._robot.limits, list(self._arm.columns)
        for q in self._configurations(goal):
            sides = np.minimum(q - limits.lower, limits.upper - q)[columns]
            room = float(sides.min())
            if room < self._room or not checker.state_is_free(q):
                continue
            clear = checker.clearance(q)
            margin = min(clear / CLEARANCE, room / ROOM)
            if clear >= self._clearance and margin > most:
                best, most = (q, clear, room), margin
        return best

    def _configurations(self, goal: PoseGoal) -> FloatArray:
        """Some configurations (k, n) for a goal; all if little effort shows them."""
        still = self._arm.still
        if not goal.position_tolerance and not goal.orientation_tolerance:
            known = solutions_known(self._robot, goal, still=still)
            if known is not None and (len(known) or known.complete):
                return known.q
        for pose in goal.poses():
            found = configurations_at(self._robot, pose, still=still)
            if len(found):
                return found
        return np.zeros((0, self._robot.n))


def _base_pose(at: FloatArray) -> Pose:
    x, y, z, yaw = at.tolist()
    return Pose((x, y, z), (math.cos(yaw / 2.0), 0.0, 0.0, math.sin(yaw / 2.0)))

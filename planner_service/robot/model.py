"""Robots as immutable values: bodies, joint limits, collision shapes, and links that may touch."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from itertools import combinations
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import BrokenInvariant, InvalidRequest, UnknownName
from planner_service.files.package_data import data_folder
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import FloatArray, read_only, set_fields
from planner_service.geometry.shapes import Pose, Shape
from planner_service.geometry.validation import (
    copied_in,
    finite_numbers,
    flag,
    instance,
    items,
    number,
    numbers,
    text,
    whole,
)
from planner_service.presentation.measures import numbers_text
from planner_service.presentation.tables import Block, Table, render_html, render_text
from planner_service.provided import Provided
from planner_service.robot.gripper import Gripper
from planner_service.robot.groups import PlanningGroup
from planner_service.robot.inertia import Dynamics
from planner_service.robot.kinematic_tree import Body, BodyPose, BodyTree, LinkFrame, LinkShape, chain_to_base
from planner_service.robot.reach import reach_bounds

if TYPE_CHECKING:
    from planner_service.robot.urdf_model import Description

__all__ = [
    "AllowedContact",
    "Body",
    "ExemptRetreat",
    "Gripper",
    "JointLimits",
    "LinkFrame",
    "LinkShape",
    "Robot",
    "joint_vector",
    "length_unit",
    "robot_blocks",
    "robot_names",
]

MAX_TURNED = 1000.0
"""Radians from zero, 159 turns, that a continuous joint may be at: numbers there are 1e-13 apart, far below all
tolerances."""

TURN = 2.0 * math.pi

robot_from_urdf: Provided[..., Robot] = Provided()
lock_joints: Provided[[Robot, Mapping[str, float]], Robot] = Provided()
group_of: Provided[[Robot, str], Robot] = Provided()


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of the moving joints, each of shape (n,), in rad, s (m for a prismatic joint)."""

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray

    def __post_init__(self) -> None:
        for item in fields(self):
            array = numbers(item.name, getattr(self, item.name), "finite numbers of shape (n,)")
            if array.ndim != 1 or not np.all(np.isfinite(array)):
                raise InvalidRequest(item.name, array, "finite numbers of shape (n,)")
            object.__setattr__(self, item.name, array)
        if len({len(getattr(self, item.name)) for item in fields(self)}) != 1:
            raise InvalidRequest("limits", [len(getattr(self, item.name)) for item in fields(self)], "equal lengths")
        if np.any(self.lower >= self.upper):
            raise InvalidRequest("lower", self.lower, f"below upper = {self.upper}; lock a joint that does not move")
        for name in ("velocity", "acceleration", "jerk"):
            if np.any(getattr(self, name) <= 0.0):
                raise InvalidRequest(name, getattr(self, name), "positive numbers")


@dataclass(frozen=True)
class AllowedContact:
    """Two links, or two carried objects, that are never checked against each other, and why."""

    links: tuple[str, str]
    reason: str


@dataclass(frozen=True, eq=False)
class ExemptRetreat:
    """A straight motion out of a named pose to ``to`` (n,), during which ``pairs`` of links are not checked."""

    pose: str
    to: FloatArray
    pairs: tuple[tuple[str, str], ...]
    reason: str

    def __post_init__(self) -> None:
        set_fields(self, to=read_only(self.to))


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot with its gripper open by ``gripper_width``; made by ``load_robot`` or ``Robot.from_urdf``.

    Attributes:
        joint_names: The n joints of q, in order.
        named_poses: Name and q (n,) of each named pose, "home" among them.
        base_links: Links that never move; they are not checked against static obstacles.
        tool_frame: The link whose frame is the tool's; it is fixed to body ``tool_body`` at ``tool_placement``,
            4 x 4 T_body_tool.
        bodies: Moving bodies, parents before children; the first is the fixed base.
        shapes: Collision shapes of all links; links fixed to each other share a body.
        gripper_width: Gap between the finger pads in metres; 0 without a gripper.
        inverse: The inverse kinematics to use: "wxai" or "numeric".
        settle_time: Seconds for which the arm vibrates after a stop.
        continuous: Of each joint of q whether it turns without end, (n,); empty if none does. It may be anywhere within
            ``MAX_TURNED`` radians of zero, and planning goes the shortest way round. Its ``limits`` are a window of two
            turns (``around``).
        locked_joints: Name and position (rad or m) of each joint that could move and does not; for information, and
            not part of ``hash``.
        link_frames: Frames of all links but those of the gripper, which move with its width. Not part of ``hash``: only
            constraints use them, and where a robot is given beside a file, they are proven anew with its own frames.
        groups: The planning groups of its SRDF (``group``). Not part of ``hash``, nor of plan files.
        dynamics: Masses and efforts of its URDF; None without masses. Not part of ``hash`` either: only torque limits
            use them, and where a robot is given beside a file, torques are worked out anew with its own.
        description: The URDF that it was read from, for what it looks like; None if there is none. Not in ``hash``.
    """

    name: str
    joint_names: tuple[str, ...]
    limits: JointLimits
    named_poses: tuple[tuple[str, FloatArray], ...]
    base_links: tuple[str, ...]
    tool_frame: str
    tool_body: int
    tool_placement: FloatArray
    bodies: tuple[Body, ...]
    shapes: tuple[LinkShape, ...]
    allowed_contacts: tuple[AllowedContact, ...] = ()
    gripper: Gripper | None = None
    gripper_width: float = 0.0
    retreats: tuple[ExemptRetreat, ...] = ()
    inverse: str = "numeric"
    settle_time: float = 0.0
    link_frames: tuple[LinkFrame, ...] = ()
    continuous: tuple[bool, ...] = ()
    locked_joints: tuple[tuple[str, float], ...] = ()
    dynamics: Dynamics | None = None
    groups: tuple[PlanningGroup, ...] = ()
    description: Description | None = None

    def __post_init__(self) -> None:
        poses = tuple((name, read_only(q)) for name, q in self.named_poses)
        set_fields(self, named_poses=poses, tool_placement=read_only(self.tool_placement))
        copied_in(
            self,
            "joint_names",
            "base_links",
            "bodies",
            "shapes",
            "allowed_contacts",
            "retreats",
            "link_frames",
            "continuous",
            "locked_joints",
            "groups",
        )

    @classmethod
    def from_urdf(
        cls,
        path: Path | str,
        tool_frame: str | None = None,
        srdf: Path | str | None = None,
        package_dirs: Sequence[Path | str] = (),
        locked_joints: Mapping[str, float] | None = None,
        joints: Sequence[str] | None = None,
        decompose: Mapping[str, int] | None = None,
        visual_as_collision: bool = False,
        xacro_args: Mapping[str, str] | None = None,
    ) -> Robot:
        """The robot of any URDF whose collision geometry is made of boxes, cylinders, spheres and meshes.

        A mesh (STL, OBJ, PLY, COLLADA) counts as its solid convex hull, or as the pieces it is cut into.

        A link and the next link above it that has shapes may touch. URDF has no accelerations and jerks: they are
        conventions (``planner_service.robot.loading``). A continuous joint turns without end. Joints that mimic a
        moving one move with it, and its limits are as tight as theirs need. Home is zero where the limits allow it,
        else their middle.

        Args:
            tool_frame: The last link of the longest chain if None.
            srdf: A file whose ``<disable_collisions>`` are allowed contacts, reasons included, and whose
                ``<group_state>`` are named poses; a joint that a state leaves out is as at home. A state may be home.
            package_dirs: Folders besides the URDF's own in which meshes may lie; ``package://name/rest`` is
                ``name/rest`` or ``rest`` in one of them.
            locked_joints: Joints that do not move, with their positions in rad or m; joints that mimic them follow.
            joints: The joints of q, in this order, for a part of a larger robot; every other joint is locked, at zero
                if its limits allow, else at their middle. If None, all joints that are not locked move, in order from
                the base to the tip of each chain; where chains part, in file order.
            decompose: For links whose hulls would fill too much: the maximum number of convex pieces into which each
                mesh is cut.
            visual_as_collision: Links without collision elements are checked as they look, meshes as their hulls;
                else they are never checked.
            xacro_args: Of a xacro file the arguments that do not have their defaults, by name.

        Raises:
            InvalidFile: the URDF or SRDF has problems; all of them are named.
            UnknownName: no such tool frame or joint.
            InvalidRequest: a position outside the limits of its joint, or a joint that is named twice.
        """
        instance("tool_frame", tool_frame, (str, NoneType), "the name of a link, or None")
        for field, given in (("locked_joints", locked_joints), ("decompose", decompose), ("xacro_args", xacro_args)):
            instance(field, given, (Mapping, NoneType), "values by name, or None")
        names = None if joints is None else items("joints", joints, str, "a sequence of names")
        given_folders = items("package_dirs", package_dirs, object, "folders")
        folders = tuple(as_path("package_dirs", folder) for folder in given_folders)
        srdf_path = None if srdf is None else as_path("srdf", srdf)
        return robot_from_urdf(
            as_path("path", path),
            folders,
            tool_frame=tool_frame,
            srdf=srdf_path,
            joints=names,
            locked_joints=dict(locked_joints or {}),
            decompose=dict(decompose or {}),
            visual_as_collision=flag("visual_as_collision", visual_as_collision),
            xacro_args=dict(xacro_args or {}),
        )

    @cached_property
    def n(self) -> int:
        """Number of joints in q."""
        return len(self.joint_names)

    @cached_property
    def sliding(self) -> tuple[bool, ...]:
        """Of each joint of q whether it slides, so that its entry is in metres."""
        moved = self.bodies[1:]
        own = [body for body in moved if body.name == self.joint_names[body.q_index]]  # not those of mimics
        kinds = {body.q_index: body.prismatic for body in (*moved, *own)}
        return tuple(kinds[joint] for joint in range(self.n))

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Where the joints may be, lower and upper, (n,) each: their limits, but of continuous joints all there is."""
        if not any(self.continuous):
            return self.limits.lower, self.limits.upper
        ends = ((self.limits.lower, -MAX_TURNED), (self.limits.upper, MAX_TURNED))
        lower, upper = (read_only(np.where(self.continuous, most, limit)) for limit, most in ends)
        return lower, upper

    def around(self, q: ArrayLike) -> Robot:
        """This robot with the limits of its continuous joints moved by whole turns, q (n,) within half a turn of their
        middles, as far as the bounds go.

        It is the same robot, with the same hash, planned for in another window. Without continuous joints, or where q
        is more than a turn outside the bounds, this robot itself.
        """
        values = numbers("q", q, f"{self.n} joint values")
        lower, upper = self.bounds
        if (
            not any(self.continuous)
            or values.shape != (self.n,)
            or not np.all((values >= lower - TURN) & (values <= upper + TURN))
        ):
            return self
        nearest = np.minimum(np.maximum(values, lower), upper)
        turns = np.where(self.continuous, np.round((nearest - self._middle) / TURN), 0.0)
        return _turned(self, tuple(turns.tolist())) if turns.any() else self

    def nearest_turns(self, waypoints: FloatArray, q: FloatArray) -> FloatArray:
        """Whole turns, in radians, by which continuous joints bring the end of a curve as near to q as the bounds let
        all of it go.

        Args:
            waypoints: Of the curve, shape (m, n).
            q: Shape (n,).

        Returns:
            Shape (n,); zero for joints that are not continuous.
        """
        lower, upper = self.bounds
        least = np.ceil((lower - waypoints.min(axis=0)) / TURN)
        most = np.floor((upper - waypoints.max(axis=0)) / TURN)
        turns = np.clip(np.round((q - waypoints[-1]) / TURN), least, most)
        return TURN * np.where(self.continuous or False, turns, 0.0)

    def unwound(self, q: FloatArray) -> FloatArray:
        """A configuration (n,) within the bounds, its continuous joints moved by whole turns to within half a turn of
        the middles of their limits."""
        unwound: FloatArray = q + self.nearest_turns(q[None], self._middle)
        return unwound

    @cached_property
    def _middle(self) -> FloatArray:
        return read_only((self.limits.lower + self.limits.upper) / 2.0)

    @property
    def poses(self) -> dict[str, FloatArray]:
        """The named poses, each (n,)."""
        return dict(self.named_poses)

    @cached_property
    def home(self) -> FloatArray:
        """The pose called "home", (n,)."""
        return self.pose("home")

    def pose(self, name: str) -> FloatArray:
        """A named pose, (n,).

        Raises:
            UnknownName: no pose of that name.
        """
        poses = self.poses
        if text("name", name) not in poses:
            raise UnknownName("pose", name, poses)
        return poses[name]

    @cached_property
    def _tree(self) -> BodyTree:
        return BodyTree(self.bodies)

    @cached_property
    def body_table(self) -> FloatArray:
        """``BodyTree.table``, (bodies - 1, 31), for compiled code."""
        return self._tree.table

    def body_poses(self, q: Sequence[float] | FloatArray) -> list[BodyPose]:
        """World pose of every body as (r00, r01, r02, r10, ..., r22, x, y, z); q (n,) must be finite."""
        try:
            return self._tree.poses(q)
        except (TypeError, ValueError):  # no check before: this is called all the time
            raise InvalidRequest("q", q, f"{self.n} finite numbers") from None

    def body_poses_batch(self, Q: ArrayLike, *, portable: bool = False) -> tuple[FloatArray, FloatArray]:
        """World rotations (m, bodies, 3, 3) and positions (m, bodies, 3) for Q (m, n), bit for bit as ``body_poses``.

        Args:
            portable: Give the same bits on every processor instead; used to construct paths.
        """
        return self._tree.poses_batch(Q, portable=flag("portable", portable))

    def tool_pose(self, q: Sequence[float] | FloatArray) -> FloatArray:
        """4 x 4 T_world_tool."""
        return np.array([*self.tool_rows(finite_numbers("q", q, self.n)), [0.0, 0.0, 0.0, 1.0]])

    def tool_rows(self, q: Sequence[float] | FloatArray) -> list[list[float]]:
        """The first three rows of ``tool_pose``, by scalar arithmetic."""
        a, b, c, d, e, f, g, h, i, x, y, z = self.body_poses(q)[self.tool_body]
        columns = self._tool_columns
        return [
            [u * k[0] + v * k[1] + w * k[2] + at * k[3] for k in columns]
            for u, v, w, at in ((a, b, c, x), (d, e, f, y), (g, h, i, z))
        ]

    def tool_origins(self, Q: ArrayLike) -> FloatArray:
        """Where the tool frame's origin is at configurations Q (m, n), (m, 3), bit for bit as in ``tool_pose``."""
        R, t = self.body_poses_batch(Q)
        turn, at = R[:, self.tool_body], t[:, self.tool_body]
        x, y, z, one = self._tool_columns[3]
        return np.asarray(turn[:, :, 0] * x + turn[:, :, 1] * y + turn[:, :, 2] * z + at * one)

    @cached_property
    def _tool_columns(self) -> list[list[float]]:
        return [list(column) for column in self.tool_placement.T.tolist()]

    def tool_jacobian(self, q: Sequence[float] | FloatArray) -> FloatArray:
        """6 x n: linear velocity of the tool's origin, then angular, world axes (Pinocchio's LOCAL_WORLD_ALIGNED)."""
        poses = self.body_poses(finite_numbers("q", q, self.n))
        a, b, c, d, e, f, g, h, i, x, y, z = poses[self.tool_body]
        u, v, w = self.tool_placement[:3, 3].tolist()
        x, y, z = x + a * u + b * v + c * w, y + d * u + e * v + f * w, z + g * u + h * v + i * w
        out = np.zeros((6, self.n))
        for index in chain_to_base(self.bodies, self.tool_body):
            body = self.bodies[index]
            a, b, c, d, e, f, g, h, i, px, py, pz = poses[index]
            u, v, w = body.axis.tolist()
            ax, ay, az = a * u + b * v + c * w, d * u + e * v + f * w, g * u + h * v + i * w
            if body.prismatic:
                column = (ax, ay, az, 0.0, 0.0, 0.0)
            else:
                rx, ry, rz = x - px, y - py, z - pz
                column = (ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx, ax, ay, az)
            out[:, body.q_index] += body.multiplier * np.array(column)
        return out

    def reach(self, extra: Sequence[tuple[int, Shape, Pose]] = ()) -> FloatArray:
        """(n,): an upper bound of the metres that any point moves per radian of each joint (1.0 for a prismatic joint).

        Args:
            extra: Further shapes that are carried: body index, shape, T_body_shape.

        Raises:
            InvalidRequest: not such a shape, or no such body.
        """
        riding = items("extra", extra, tuple, "a list of (body index, shape, T_body_shape)")
        for k, item in enumerate(riding):
            if len(item) != 3:
                raise InvalidRequest(f"extra[{k}]", item, "(body index, shape, T_body_shape)")
            body, shape, pose = item
            whole(f"extra[{k}][0]", body, 0, len(self.bodies) - 1)
            instance(f"extra[{k}][1]", shape, Shape, "a convex shape")
            instance(f"extra[{k}][2]", pose, Pose, "a Pose")
        return read_only(np.maximum(self._own_reach, self._reach_of(riding))) if riding else self._own_reach

    @cached_property
    def _own_reach(self) -> FloatArray:
        return read_only(np.maximum(self._reach_without_fingers, self._reach_of(self._shapes_of(fingers=True))))

    @cached_property
    def _reach_without_fingers(self) -> FloatArray:
        return self._reach_of(self._shapes_of(fingers=False))

    def _shapes_of(self, *, fingers: bool) -> list[tuple[int, Shape, Pose]]:
        links = () if self.gripper is None else self.gripper.links
        return [(item.body, item.shape, item.pose) for item in self.shapes if (item.link in links) == fingers]

    def _reach_of(self, shapes: Sequence[tuple[int, Shape, Pose]]) -> FloatArray:
        travel = np.maximum(np.abs(self.limits.lower), np.abs(self.limits.upper)).tolist()
        return read_only(reach_bounds(self.bodies, travel, shapes))

    def with_gripper(self, width: float) -> Robot:
        """This robot with the finger pads ``width`` metres apart.

        Raises:
            InvalidRequest: no gripper, or ``width`` outside its range.
        """
        if self.gripper is None:
            raise InvalidRequest("width", width, f"no width: robot {self.name!r} has no gripper")
        lower, upper = self.gripper.lower, self.gripper.upper
        width = number("width", width, f"a gap between the finger pads in [{lower:g}, {upper:g}] m", lower, upper)
        return _opened(self.unopened, float(width))

    def with_finger_room(self) -> Robot:
        """This robot with fingers that fill the room that they need at any width, and no gripper to open.

        What is free for it is free however the gripper stands and moves meanwhile. Itself without a gripper.
        """
        if self.gripper is None:
            return self
        rooms = iter(self.gripper.room())
        shapes = tuple(next(rooms) if item.link in self.gripper.links else item for item in self.shapes)
        return replace(self, gripper=None, gripper_width=0.0, shapes=shapes)

    @property
    def unopened(self) -> Robot:
        """The robot of which ``with_gripper`` made this one, which is the same for all widths; itself if it did not."""
        made_of: Robot = vars(self).get("_unopened", self)
        return made_of

    def opened_like(self, other: Robot) -> Robot:
        """This robot with its gripper as far open as another's; itself if one has none, or its own does not go there.

        It has the other's hash if that is the same robot, however its gripper stands.
        """
        gripper, width = self.gripper, other.gripper_width
        fits = gripper is not None and other.gripper is not None and gripper.lower <= width <= gripper.upper
        return self.with_gripper(width) if fits and width != self.gripper_width else self

    def locked(self, joints: Mapping[str, float]) -> Robot:
        """This robot with some joints locked: one arm of two, a rail, a wrist.

        Links that only locked joints moved become part of the link that carries them; they are still checked against
        links that move. Joint values, limits and named poses lose the entries of the locked joints. A retreat remains
        if its pairs move against each other as before. Two links that no longer move are not checked against each
        other or against obstacles; check them with the unlocked robot.

        Args:
            joints: Positions in rad or m, by joint name.

        Raises:
            UnknownName: no such joint.
            InvalidRequest: a position outside its limits, or no joint left that moves.
        """
        return lock_joints(self, joints)

    def group(self, name: str) -> Robot:
        """The part of this robot that an SRDF calls so, every other joint locked at home.

        The tool frame is the end of the group's chain, if it has one. Poses, limits and pairs are those of the robot.

        Raises:
            UnknownName: no group of that name; the message names those that there are.
            InvalidRequest: no joint of it moves.
        """
        return group_of(self, name)

    def link_frame(self, name: str) -> tuple[int, FloatArray]:
        """The body that a link belongs to, and its frame in it, 4 x 4 T_body_link.

        Raises:
            UnknownName: no such link.
            InvalidRequest: a link of the gripper, which moves with its width.
        """
        if text("link", name) == self.tool_frame:
            return self.tool_body, self.tool_placement
        if self.gripper is not None and name in self.gripper.links:
            raise InvalidRequest("link", name, f"one that the gripper does not move, such as {self.tool_frame!r}")
        frames = {item.link: item for item in self.link_frames}
        if name not in frames:
            raise UnknownName("link", name, (self.tool_frame, *frames))
        return frames[name].body, frames[name].pose.matrix

    @cached_property
    def links(self) -> frozenset[str]:
        """Links with shapes, at the base, in the gripper or named in pairs, and the tool frame."""
        pairs = [*(contact.links for contact in self.allowed_contacts), *(p for r in self.retreats for p in r.pairs)]
        fingers = () if self.gripper is None else self.gripper.links
        shaped = (item.link for item in self.shapes)
        return frozenset([*shaped, *self.base_links, *fingers, self.tool_frame, *(link for p in pairs for link in p)])

    @cached_property
    def link_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of links to check against each other: with shapes, on different bodies, not allowed to touch."""
        body_of = {item.link: item.body for item in self.shapes}
        allowed = {frozenset(contact.links) for contact in self.allowed_contacts}
        return tuple(
            (a, b) for a, b in combinations(body_of, 2) if body_of[a] != body_of[b] and frozenset((a, b)) not in allowed
        )

    @cached_property
    def hash(self) -> str:
        """SHA-256 of everything that can change a plan, equal in every process."""
        content: dict[str, object] = {
            "name": self.name,
            "joints": self.joint_names,
            "limits": [getattr(self.limits, item.name).tolist() for item in fields(self.limits)],
            "poses": [(name, q.tolist()) for name, q in sorted(self.named_poses, key=lambda pose: pose[0])],
            "base": sorted(self.base_links),
            "tool": (self.tool_frame, self.tool_body, self.tool_placement.tolist()),
            "bodies": [_body_content(body) for body in self.bodies],
            "shapes": [(s.link, s.body, repr(s.shape), repr(s.pose)) for s in self.shapes],
            "allowed": sorted(sorted(contact.links) for contact in self.allowed_contacts),
            "gripper": self.gripper and self.gripper.content(),
            "width": self.gripper_width,
            "retreats": [(r.pose, r.to.tolist(), sorted(map(sorted, r.pairs))) for r in self.retreats],
            "inverse": self.inverse,
            "settle": self.settle_time,
        }
        if any(self.continuous):
            content["continuous"] = self.continuous
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, {self.n} joints, {len(self.shapes)} shapes, gripper_width={self.gripper_width:g})"

    def __str__(self) -> str:
        return render_text(robot_blocks(self))

    def _repr_html_(self) -> str:
        return render_html(robot_blocks(self))


@lru_cache(maxsize=32)
def _opened(robot: Robot, width: float) -> Robot:
    """See ``Robot.with_gripper``. What the fingers do not change is worked out once for all widths."""
    if robot.gripper is None:
        raise BrokenInvariant("a robot without a gripper is opened")
    moved = iter(robot.gripper.shapes(width))
    shapes = tuple(next(moved) if item.link in robot.gripper.links else item for item in robot.shapes)
    other = replace(robot, gripper_width=width, shapes=shapes)
    kept = {name: getattr(robot, name) for name in ("_tree", "_reach_without_fingers")}
    set_fields(other, **kept, _unopened=robot)  # of which the next width is made: one robot for each
    return other


@lru_cache(maxsize=32)
def _turned(robot: Robot, turns: tuple[float, ...]) -> Robot:
    """See ``Robot.around``."""
    shift, limits, (lower, upper) = TURN * np.array(turns), robot.limits, robot.bounds
    lower, upper = np.maximum(limits.lower + shift, lower), np.minimum(limits.upper + shift, upper)
    moved = replace(robot, limits=replace(limits, lower=lower, upper=upper))
    object.__setattr__(moved, "hash", robot.hash)
    return moved


def _body_content(body: Body) -> tuple[object, ...]:
    """Everything about a body that can change a plan."""
    mimics = () if body.multiplier == 1.0 else (body.multiplier,)
    return (body.name, body.parent, body.placement.tolist(), body.axis.tolist(), body.prismatic, body.q_index, *mimics)


def robot_names() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return tuple(sorted(path.parent.name for path in data_folder("robots").glob("*/robot.toml")))


def joint_vector(name: str, values: object, robot: Robot) -> FloatArray:
    """n finite joint values as a read-only array.

    Raises:
        InvalidRequest: not n numbers, or one of them is not finite.
    """
    array = numbers(name, values, f"{robot.n} joint values")
    if array.shape != (robot.n,):
        raise InvalidRequest(name, f"shape {array.shape}", f"{robot.n} joint values, shape ({robot.n},)")
    given = array.tolist()
    if not all(map(math.isfinite, given)):
        joint, value = next(each for each in zip(robot.joint_names, given, strict=True) if not math.isfinite(each[1]))
        raise InvalidRequest(name, value, f"a finite value for {joint}")
    return array


def length_unit(robot: Robot) -> str:
    """Unit of a path's length: rad, or none if some joints are prismatic."""
    return "" if any(body.prismatic for body in robot.bodies) else "rad"


def robot_blocks(robot: Robot) -> list[Block]:
    """A robot as ``planner-service robots NAME`` prints it."""
    gripper = robot.gripper
    opening = "" if gripper is None else f", gripper {gripper.lower:g} to {gripper.upper:g} m wide"
    shapes, joints = len(robot.shapes), len(robot.joint_names)
    title = f"{robot.name}: {joints} joints, {shapes} collision shapes, tool frame {robot.tool_frame}{opening}"
    units = "rad and s" if length_unit(robot) else "rad and s; m for prismatic joints"
    heads = ("lower", "upper", "velocity", "acceleration", "jerk")
    columns = [getattr(robot.limits, head).tolist() for head in heads]
    rows = [(name, *(f"{value:.4f}" for value in row)) for name, *row in zip(robot.joint_names, *columns, strict=True)]
    endless = robot.continuous or [False] * joints
    rows = [(row[0], "turns", "endlessly", *row[3:]) if ends else row for row, ends in zip(rows, endless, strict=True)]
    poses = [(name, numbers_text(q.tolist(), ",")) for name, q in robot.named_poses]
    return [
        title,
        f"Limits in {units}:",
        "",
        Table(("joint", *heads), rows, numeric=heads),
        "",
        Table(("pose", "joint values"), poses),
        *_other_joints(robot),
    ]


def _other_joints(robot: Robot) -> list[Block]:
    """The joints that mimic one of q, and those that are locked."""
    out: list[Block] = []
    mimics = [body for body in robot.bodies[1:] if body.name != robot.joint_names[body.q_index]]
    if mimics:
        rows = [(body.name, f"{body.multiplier:g} x {robot.joint_names[body.q_index]}") for body in mimics]
        out += ["", Table(("mimic", "moves by"), rows)]
    if robot.locked_joints:
        rows = [(name, f"{position:.4f}") for name, position in robot.locked_joints]
        out += ["", Table(("locked joint", "at"), rows, numeric=("at",))]
    return out

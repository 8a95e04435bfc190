"""A second opinion on what is free, built on Coal through Pinocchio.

It shares no code with ``planner_service`` and imports nothing of it: URDF, robot.toml and scene files are read
here once more, forward kinematics and collisions are Pinocchio's and Coal's, the bound on motion is its own. Where
the two checkers agree, a mistake would have to have been made twice.

Broad phase: Pinocchio's naive manager, which agreed with pair-by-pair tests on 53,380 of 53,380 states; its "SaP" and
"DynamicAABBTreeArray" managers miss collisions.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["IndependentChecker", "Touch", "hull_of", "robot_table", "tables_of"]

FloatArray = NDArray[np.float64]
Table = Mapping[str, Any]

LIMIT_SLACK = 1e-9
"""Rounding by which a configuration may lie outside a joint limit, rad or m."""

NEAR = 5e-5
"""Metres. Coal's boolean misses overlaps of up to 11 um, its distance is right to about 1 um: so the boolean asks
whether anything is nearer than this, and where it is, the sign of the distance decides."""


CLIMBS, FEWER, KINK = 60, 4, 9e-7
"""Climbs to the direction that separates two shapes most, fewer where they are apart and every climb leads there, and
metres from contact where no other climb is needed."""

JOINT = " (joint)"
"""Behind the name of a joint that is called as a link is."""


@dataclass(frozen=True)
class Touch:
    """What touches what, and where: ``b`` is "limit" when joint ``a`` is outside its range."""

    a: str
    b: str
    q: tuple[float, ...]


class IndependentChecker:
    """Says whether a robot of a ``robots/`` folder is free among the obstacles of a scene, and who touches whom if not.

    Args:
        robot_dir: Folder with robot.toml and the URDF it names; or what would be in the former, with the latter's whole
            path and the folders of its meshes: ``{"urdf": ..., "package_dirs": [...], "joints": [...], ...}``. With
            ``"surfaces": True`` meshes are their triangles, and what is wholly inside one touches nothing; else hulls.
        scene: A scene file, or its content: ``{"obstacle": [...], "attached": [...]}``.
        gripper_width: Metres between the finger pads; the width in robot.toml if None.
        allowed: Pairs of link or object names that may touch, beside those of robot.toml and the touch links.
        padding: Metres by which every pair must stay apart, each shape being grown by half of it (a box stays a box,
            hulls become round).
    """

    def __init__(
        self,
        robot_dir: Path | Table,
        scene: Path | Table,
        *,
        gripper_width: float | None = None,
        allowed: Iterable[tuple[str, str]] = (),
        padding: float = 0.0,
    ) -> None:
        robot = robot_table(robot_dir) if isinstance(robot_dir, Path) else robot_dir
        content = _read(scene) if isinstance(scene, Path) else scene
        self._meshes = scene.parent if isinstance(scene, Path) else Path()
        text = _declared(Path(robot["urdf"]).read_text("utf-8"))
        mimics = _mimics(text, robot["joints"])
        self.model, self.geometry = _reduced(robot, text, gripper_width, mimics)
        self.owners = [self.model.frames[g.parentFrame].name for g in self.geometry.geometryObjects]
        self._tool = self.model.getFrameId(robot["tool_frame"], pin.FrameType.BODY)
        self._add_bodies(content, self._tool)
        if padding:
            for g in self.geometry.geometryObjects:
                g.geometry = _grown(g.geometry, padding / 2)
        may_touch = [c["links"] for c in robot.get("allowed_contacts", ())] + [list(pair) for pair in allowed]
        may_touch += [[a["name"], link] for a in content.get("attached", ()) for link in a.get("touch_links", ())]
        self._pair_up({frozenset(pair) for pair in may_touch})
        columns = [self.model.joints[self.model.getJointId(name)].idx_q for name in robot["joints"]]
        self.joints: list[str] = list(robot["joints"])
        names = sorted(
            self.model.names.tolist()[1:], key=lambda name: self.model.joints[self.model.getJointId(name)].idx_q
        )
        ways = [mimics.get(name, (name, 1.0, 0.0)) for name in names]  # Pinocchio may number the joints otherwise
        self._leaders = [self.joints.index(leader) for leader, _, _ in ways]
        self._times, self._offsets = (np.array([way[k] for way in ways]) for k in (1, 2))
        position = robot.get("limits", {}).get("position", {})
        self._lower = np.array(position.get("lower", self.model.lowerPositionLimit[columns])) - LIMIT_SLACK
        self._upper = np.array(position.get("upper", self.model.upperPositionLimit[columns])) + LIMIT_SLACK
        velocity = robot.get("limits", {}).get("velocity", {})
        self._speed = np.array(velocity.get("values", self.model.velocityLimit[columns]))
        self.reach = np.zeros(len(columns))
        np.add.at(self.reach, self._leaders, np.abs(self._times) * self._reaches())
        self._data = self.model.createData()
        self._axes = [np.zeros(6), *(self._data.joints[k].S.ravel() for k in range(1, self.model.njoints))]
        self._geometry_data, self._manager = self._within(NEAR)
        self._placed = self.geometry.createData()
        self._nearer: dict[float, tuple[Any, Any]] = {}

    def tool_pose(self, q: ArrayLike) -> FloatArray:
        """Pose of the tool frame in the base frame at q (n,), shape (4, 4)."""
        x = self._whole(q)
        pin.framesForwardKinematics(self.model, self._data, x)
        return np.asarray(self._data.oMf[self._tool].homogeneous)

    def link_poses(self, q: ArrayLike, links: Iterable[str]) -> list[FloatArray]:
        """Poses of links in the base frame at q (n,), shape (4, 4) each.

        Raises:
            LookupError: The URDF has no such link.
        """
        frames = self._numbers(links)
        x = self._whole(q)
        pin.framesForwardKinematics(self.model, self._data, x)
        return [np.array(self._data.oMf[frame].homogeneous) for frame in frames]

    def poses_along(self, samples: ArrayLike, links: Iterable[str]) -> FloatArray:
        """Poses of links in the base frame at configurations (m, n), (m, links, 4, 4): as ``link_poses``, all at once.

        The tree and its frames are Pinocchio's; only the products are taken here.

        Raises:
            LookupError: The URDF has no such link.
        """
        model, Q = self.model, self._whole(samples)
        frames = [model.frames[number] for number in self._numbers(links)]
        placed = {0: np.broadcast_to(np.eye(4), (len(Q), 4, 4))}

        def joint(number: int) -> FloatArray:
            if number not in placed:
                before = joint(model.parents[number]) @ model.jointPlacements[number].homogeneous
                placed[number] = before @ _moved(self._axes[number], Q[:, model.joints[number].idx_q])
            return placed[number]

        return np.stack([joint(frame.parentJoint) @ frame.placement.homogeneous for frame in frames], axis=1)

    def free(self, q: ArrayLike) -> bool:
        """Whether q (n,) is inside the joint limits and touches nothing."""
        values = np.asarray(q, dtype=np.float64)
        if not ((values >= self._lower) & (values <= self._upper)).all():  # NaN is outside, too
            return False
        x = self._whole(values)
        if not pin.computeCollisions(self.model, self._data, self._manager, x, True):
            return True
        return all(distance > 0.0 for distance in self._near(x))

    def nearer(self, q: ArrayLike, margin: float) -> bool:
        """Whether two that are judged are nearer than so many metres at q (n,), to a micrometre or so; limits aside."""
        if margin not in self._nearer:
            self._nearer[margin] = self._within(margin)
        return bool(pin.computeCollisions(self.model, self._data, self._nearer[margin][1], self._whole(q), True))

    def touch(self, q: ArrayLike) -> Touch | None:
        """A pair that touches at q (n,), None when q is free."""
        if self.free(q):
            return None
        values = np.asarray(q, dtype=np.float64)
        outside = np.flatnonzero(~((values >= self._lower) & (values <= self._upper)))
        if len(outside):
            return Touch(self.joints[outside[0]], "limit", tuple(values.tolist()))
        return Touch(*min(self.touching(values)), tuple(values.tolist()))

    def touching(self, q: ArrayLike) -> set[tuple[str, str]]:
        """All pairs of names that touch at q (n,)."""
        return {pair for pair, gap in self.gaps(q).items() if gap <= 0.0}

    def gaps(self, q: ArrayLike) -> dict[tuple[str, str], float]:
        """Coal's signed distance of every judged pair of names at q (n,); right to a few micrometres where positive.

        Where it is negative, about one in four thousand is wrong by millimetres.
        """
        x = self._whole(q)
        found: dict[tuple[str, str], float] = {}
        for pair, distance in zip(self.pairs, self._distances(x), strict=True):
            found[pair] = min(found.get(pair, math.inf), distance)
        return found

    def gaps_at(self, samples: ArrayLike, numbers: Sequence[Iterable[int]]) -> FloatArray:
        """Coal's signed distances at configurations (m, n), of the pairs of these numbers in ``pairs`` at each.

        One after the other, as many as all of them are.
        """
        found, geometry, placed = list[float](), self.geometry, self._placed
        for x, some in zip(self._whole(samples), numbers, strict=True):
            pin.updateGeometryPlacements(self.model, self._data, geometry, placed, x)
            found.extend([pin.computeDistance(geometry, placed, k).min_distance for k in map(int, some)])
        return np.array(found)

    def moved(self, name: str, position: ArrayLike, quaternion_wxyz: ArrayLike) -> IndependentChecker:
        """The same with an obstacle elsewhere, which is one shape."""
        other = copy(self)
        other.geometry = self.geometry.copy()
        pose = _pose({"position": position, "quaternion_wxyz": quaternion_wxyz})
        other.geometry.geometryObjects[self.owners.index(name)].placement = pose
        other._geometry_data, other._manager = other._within(NEAR)
        other._placed, other._nearer = other.geometry.createData(), {}
        return other

    def pair_reaches(self) -> FloatArray:
        """How far a point of a pair can be from the axes that move it against the other one, (pairs, n).

        1 for a joint that slides. As far as each joint moves, times that, the two come no closer than they were.
        """
        shapes, out = self.geometry.geometryObjects, np.zeros((len(self.pairs), self.model.nq))
        reaches = [self._shape_reaches(g) for g in shapes]
        for row, pair in zip(out, self.geometry.collisionPairs, strict=True):
            first, second = reaches[pair.first], reaches[pair.second]
            for own, other in ((first, second), (second, first)):
                for joint, far in own.items():
                    if joint not in other:
                        row[self.model.joints[joint].idx_q] += far
        moved = np.zeros((len(out), len(self.joints)))
        for column, leader in enumerate(self._leaders):
            moved[:, leader] += abs(self._times[column]) * out[:, column]
        return moved

    def _shape_reaches(self, g: Any) -> dict[int, float]:
        """By joint that moves a shape, how far its points can be from that joint's axis, in any configuration."""
        model, joint, out = self.model, g.parentJoint, dict[int, float]()
        far = _length(g.placement.translation) + _radius(g.geometry)
        while joint:
            slide = model.joints[joint].shortname().startswith("JointModelP")
            column = model.joints[joint].idx_q
            out[joint] = 1.0 if slide else far
            far += _length(model.jointPlacements[joint].translation)
            if slide:
                far += max(abs(model.lowerPositionLimit[column]), abs(model.upperPositionLimit[column]))
            joint = model.parents[joint]
        return out

    def exact_gap(self, q: ArrayLike, *, climbs: int = FEWER) -> float:
        """The smallest signed gap at q (n,) where something is nearer than 50 um, infinite where nothing is.

        By support functions, along the direction that separates two shapes most: where these are apart the gap, else at
        most how deep they overlap. Coal only suggests where to begin; its own distances err by a micrometre or more.

        Args:
            climbs: To that direction; with few a gap may be told too small by some micrometres, never too large.
        """
        x = self._whole(q)
        least = math.inf
        for k, distance in enumerate(self._distances(x)):
            if distance < NEAR:
                pair, result = self.geometry.collisionPairs[k], self._geometry_data.distanceResults[k]
                solids = [
                    (self.geometry.geometryObjects[i].geometry, self._geometry_data.oMg[i])
                    for i in (pair.first, pair.second)
                ]
                least = min(least, _separation(solids, np.asarray(result.normal), climbs))
        return least

    def path_touch(self, waypoints: ArrayLike, motion_step: float = 0.001) -> Touch | None:
        """The first touch along a polyline (N, n), sampled so finely that no point moves more than ``motion_step``."""
        points = np.asarray(waypoints, dtype=np.float64)
        for a, b in pairwise(points):
            parts = max(1, math.ceil(float((self.reach * np.abs(b - a)).sum()) / motion_step))
            for k in range(parts):
                q = a + (b - a) * (k / parts)
                if not self.free(q):
                    return self.touch(q)
        return self.touch(points[-1])

    def path_is_free(self, waypoints: ArrayLike, motion_step: float = 0.001) -> bool:
        """Whether a polyline (N, n) is free at every sample; see ``path_touch``."""
        return self.path_touch(waypoints, motion_step) is None

    def trajectory_touch(
        self, q: Callable[[Any], FloatArray], duration: float, motion_step: float = 0.001
    ) -> Touch | None:
        """The first touch along q(t), t in [0, duration], (m,) in and (m, n) out.

        The times are so dense that at the joints' velocity limits no point moves more than ``motion_step``; denser
        still for a motion that is faster than it may be.
        """
        count = 2 + math.ceil(duration * float((self.reach * self._speed).sum()) / motion_step)
        samples = q(np.linspace(0.0, duration, count))
        while float((self.reach * np.abs(np.diff(samples, axis=0))).sum(axis=1).max()) > motion_step:
            count *= 2
            samples = q(np.linspace(0.0, duration, count))
        return next((self.touch(sample) for sample in samples if not self.free(sample)), None)

    def trajectory_is_free(self, q: Callable[[Any], FloatArray], duration: float, motion_step: float = 0.001) -> bool:
        """Whether q(t) is free at every sample; see ``trajectory_touch``."""
        return self.trajectory_touch(q, duration, motion_step) is None

    def curve_touch(self, q: Callable[[Any], FloatArray], length: float, motion_step: float = 0.001) -> Touch | None:
        """The first touch along a curve q(s), s in [0, length], (m,) in and (m, n) out.

        Every sample is judged, and no point moves more than ``motion_step`` from one to the next.
        """
        return next(
            (self.touch(sample) for sample in self.along(q, length, motion_step) if not self.free(sample)), None
        )

    def along(self, q: Callable[[Any], FloatArray], length: float, motion_step: float) -> FloatArray:
        """Configurations (m, n) of a curve q(s) from s = 0 to length, no point moving more than a step between two.

        A joint that turns back between two samples has moved there and back: eight times as many tell how far.
        """
        finest = motion_step / 8.0
        count = 2 + math.ceil(length * _length(self.reach.tolist()) / finest)  # enough if s is joint arc length
        samples = q(np.linspace(0.0, length, count))
        while (moved := (self.reach * np.abs(np.diff(samples, axis=0))).sum(axis=1)).max() > finest:
            count *= 2
            samples = q(np.linspace(0.0, length, count))
        walked = np.concatenate([[0.0], np.cumsum(moved)])
        _, first = np.unique(np.floor(walked / (motion_step - finest)), return_index=True)
        return np.asarray(samples[np.append(first, count - 1)])

    def _whole(self, q: ArrayLike) -> FloatArray:
        """Configurations (..., n) in Pinocchio's order, with the joints that mimic others."""
        return np.ascontiguousarray(np.asarray(q, dtype=np.float64)[..., self._leaders] * self._times + self._offsets)

    def _numbers(self, links: Iterable[str]) -> list[int]:
        names = list(links)
        frames = [self.model.getFrameId(name, pin.FrameType.BODY) for name in names]
        if self.model.nframes in frames:  # what Pinocchio gives for a name that it does not know
            raise LookupError(f"not all of these are links: {names}")
        return frames

    def _add_bodies(self, content: Table, tool: int) -> None:
        for table in content.get("obstacle", ()):
            for shape, placement in _solids(table, self._meshes):
                self._add(table["name"], 0, 0, shape, _pose(table) * placement)
        frame = self.model.frames[tool]
        self._carried = {table["name"] for table in content.get("attached", ())}
        for table in content.get("attached", ()):
            for shape, placement in _solids(table, self._meshes):
                self._add(table["name"], frame.parentJoint, tool, shape, frame.placement * _pose(table) * placement)

    def _add(self, name: str, joint: int, frame: int, shape: Any, placement: Any) -> None:
        number = len(self.owners)
        self.geometry.addGeometryObject(pin.GeometryObject(f"{name}#{number}", joint, frame, placement, shape))
        self.owners.append(name)

    def _pair_up(self, may_touch: set[frozenset[str]]) -> None:
        """Judge every two shapes that can move against each other, and what is carried against the robot's own."""
        self.pairs: list[tuple[str, str]] = []
        shapes = self.geometry.geometryObjects
        for j, second in enumerate(shapes):
            for i, first in enumerate(shapes[:j]):
                names = (self.owners[i], self.owners[j])
                own = first.parentJoint == second.parentJoint and len(self._carried & set(names)) != 1
                if names[0] != names[1] and not own and frozenset(names) not in may_touch:
                    self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        for pair in self.geometry.collisionPairs:
            self.pairs.append((self.owners[pair.first], self.owners[pair.second]))

    def _within(self, margin: float) -> tuple[Any, Any]:
        """What Coal is asked with whether anything is nearer than a margin, and the manager that asks."""
        data = pin.GeometryData(self.geometry)
        for request in data.collisionRequests:
            request.security_margin = margin
        return data, pin.BroadPhaseManager_NaiveCollisionManager(self.model, self.geometry, data)

    def _near(self, x: FloatArray) -> Iterator[float]:
        """Signed distances of the pairs that are nearer than ``NEAR``."""
        pin.updateGeometryPlacements(self.model, self._data, self.geometry, self._geometry_data, x)
        for k in range(len(self.pairs)):
            if pin.computeCollision(self.geometry, self._geometry_data, k):
                yield float(pin.computeDistance(self.geometry, self._geometry_data, k).min_distance)

    def _distances(self, x: FloatArray) -> list[float]:
        pin.computeDistances(self.model, self._data, self.geometry, self._geometry_data, x)
        return [result.min_distance for result in self._geometry_data.distanceResults]

    def _reaches(self) -> FloatArray:
        """For each joint in Pinocchio's order, a length no moved point is farther from its axis than.

        From joint to joint along the chain, all lengths taken in full: coarse, but true of every configuration.
        """
        model = self.model
        out = np.ones(model.nq)
        extent = [0.0] * model.njoints
        for g in (g for g in self.geometry.geometryObjects if g.parentJoint):
            far = _length(g.placement.translation) + _radius(g.geometry)
            extent[g.parentJoint] = max(extent[g.parentJoint], far)
        for k in range(model.njoints - 1, 0, -1):
            slide = model.joints[k].shortname().startswith("JointModelP")
            column = model.joints[k].idx_q
            travel = max(abs(model.lowerPositionLimit[column]), abs(model.upperPositionLimit[column]))
            if not slide:
                out[column] = extent[k]
            hung = extent[k] + _length(model.jointPlacements[k].translation) + (travel if slide else 0.0)
            extent[model.parents[k]] = max(extent[model.parents[k]], hung)
        return out


def _moved(axis: FloatArray, values: FloatArray) -> FloatArray:
    """Motions (m, 4, 4) of a joint along or about an axis, the linear part before the angular one, at values (m,)."""
    out = np.tile(np.eye(4), (len(values), 1, 1))
    out[:, :3, 3] = values[:, None] * axis[:3]
    x, y, z = axis[3:]
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out[:, :3, :3] += np.sin(values)[:, None, None] * K + (1.0 - np.cos(values))[:, None, None] * (K @ K)
    return out


def tables_of(scene: Any) -> dict[str, list[dict[str, Any]]]:
    """What a scene file would hold, read off a scene's public attributes."""
    content: dict[str, list[dict[str, Any]]] = {"obstacle": [], "attached": []}
    for key, bodies in (("obstacle", scene.obstacles), ("attached", scene.attached)):
        for body in bodies:
            kind, shape = _table_of(body.shape)
            table = {"name": body.name, kind: shape, "position": body.pose.position}
            table |= {"quaternion_wxyz": body.pose.quaternion, "touch_links": getattr(body, "touch_links", ())}
            content[key].append(table)
    return content


def _table_of(shape: Any) -> tuple[str, Any]:
    """A shape's key in a scene file, and what is under it."""
    kind, sizes = type(shape).__name__.lower(), dict(vars(shape))
    if kind == "mesh":
        return kind, {"vertices": sizes["vertices"].tolist()}
    if kind == "pointcloud":
        return "cloud", {"points": sizes["points"], "resolution": sizes["resolution"]}
    if kind == "heightfield":
        return "heights", {"values": sizes["heights"], "cell": sizes["cell"], "floor": sizes["floor"]}
    if kind == "compound":
        poses = [{"position": pose.position, "quaternion_wxyz": pose.quaternion} for _, pose in shape.parts]
        return kind, [dict([_table_of(part)]) | pose for (part, _), pose in zip(shape.parts, poses, strict=True)]
    return kind, {"box": sizes.get("size"), "sphere": sizes.get("radius")}.get(kind, sizes)


def robot_table(folder: Path) -> dict[str, Any]:
    """A robot.toml with the whole path of its URDF, which may be in a package that is installed beside Pinocchio.

    What it does not say is as in the robot that it is based on, in the folder beside its own.
    """
    table = _read(folder / "robot.toml")
    if "base" in table:
        above = _read(folder.parent / table["base"] / "robot.toml")
        table = above | table
    beside = [parent / "share" for parent in Path(pin.__file__).parents if (parent / "share").is_dir()]
    scheme, _, rest = table["urdf"].partition("package://")
    found = folder / scheme if scheme else next(share / rest for share in beside if (share / rest).is_file())
    return {**table, "urdf": found, "package_dirs": [folder, *beside]}


def _read(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text("utf-8"))


def _with_tool(urdf: str, tool: Table | None) -> str:
    """The URDF with the link of a robot.toml's ``[tool]``, and the frame at its tip."""
    if tool is None:
        return urdf

    def origin(table: Table, key: str) -> str:
        xyz, rpy = (" ".join(map(str, table.get(name, (0.0, 0.0, 0.0)))) for name in (key, "rpy"))
        return f'<origin xyz="{xyz}" rpy="{rpy if key == "position" else "0 0 0"}"/>'

    def solid(table: Table) -> str:
        if "box" in table:
            return f'<box size="{" ".join(map(str, table["box"]))}"/>'
        if "sphere" in table:
            return f'<sphere radius="{table["sphere"]}"/>'
        return f'<cylinder radius="{table["cylinder"]["radius"]}" length="{table["cylinder"]["length"]}"/>'

    shapes = "".join(
        f"<collision>{origin(table, 'position')}<geometry>{solid(table)}</geometry></collision>"
        for table in tool.get("shape", ())
    )
    joints = ((tool["parent"], tool["link"], "position"), (tool["link"], tool["frame"], "tip"))
    fixed = "".join(
        f'<joint name="to {child}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f"{origin(tool, key)}</joint>"
        for parent, child, key in joints
    )
    added = f'<link name="{tool["link"]}">{shapes}</link><link name="{tool["frame"]}"/>{fixed}'
    head, _, tail = urdf.rpartition("</robot>")
    return f"{head}{added}</robot>{tail}"


def _declared(text: str) -> str:
    """XML in which every prefix of a name is declared, as many a description leaves out."""
    used = set(re.findall(r"<(?:[^<>]*\s)?([A-Za-z_][\w.-]*):[A-Za-z_][\w.-]*\s*[=\s/>]", text))
    missing = sorted(used - {"xml", "xmlns", *re.findall(r"\sxmlns:([\w.-]+)\s*=", text)})
    declared = "".join(f' xmlns:{prefix}="urn:{prefix}"' for prefix in missing)
    return re.sub(r"<[A-Za-z_][\w:.-]*", lambda root: root.group() + declared, text, count=1)


def _mimics(urdf: str, joints: Sequence[str]) -> dict[str, tuple[str, float, float]]:
    """Of each joint that mimics one of ``joints``, itself none of them, that one, the multiplier and the offset."""
    ways = {}
    for joint in ElementTree.fromstring(urdf).findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and joint.attrib["name"] not in joints:
            numbers = float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))
            ways[joint.attrib["name"]] = (mimic.attrib["joint"], *numbers)
    for name in ways:
        while (leader := ways[name][0]) in ways:
            (_, times, offset), (above, by, beside) = ways[name], ways[leader]
            ways[name] = (above, times * by, times * beside + offset)
    return {name: way for name, way in ways.items() if way[0] in joints}


def _read_model(robot: Table, text: str) -> tuple[Any, Any]:
    """Pinocchio's model and collision geometry of a URDF or an MJCF file; planes are no part of a robot.

    A joint without end gets limits here, as Pinocchio would have sine and cosine in q for it.
    """
    root = ElementTree.fromstring(text)
    folders = [str(folder) for folder in robot.get("package_dirs", ())] or None
    if root.tag == "mujoco":
        path = str(robot["urdf"])
        model = pin.buildModelFromMJCF(path)
        geometry = pin.buildGeomFromMJCF(model, path, pin.GeometryType.COLLISION)
        for name in [g.name for g in geometry.geometryObjects if isinstance(g.geometry, (coal.Plane, coal.Halfspace))]:
            geometry.removeGeometryObject(name)
        return model, geometry
    for joint in root.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            for limit in joint.findall("limit"):
                joint.remove(limit)
            ElementTree.SubElement(joint, "limit", lower="-10", upper="10", effort="1", velocity="1")
    urdf = _with_tool(ElementTree.tostring(root, encoding="unicode"), robot.get("tool"))
    model = pin.buildModelFromXML(urdf)
    return model, pin.buildGeomFromUrdfString(model, urdf, pin.GeometryType.COLLISION, package_dirs=folders)


def _reduced(robot: Table, text: str, width: float | None, mimics: Iterable[str]) -> tuple[Any, Any]:
    """The robot's model and collision geometry with every joint that is neither in robot.toml nor a mimic locked.

    Two fingers that slide stand half the gripper's width from where they are closed, in the direction that their range
    allows, turning fingers at its "position", which is 0 where it is not given, other joints as robot.toml locks them,
    or at zero.
    """
    model, geometry = _read_model(robot, text)
    for g in geometry.geometryObjects:
        if isinstance(g.geometry, coal.BVHModelBase) and not robot.get(
            "surfaces"
        ):  # a surface, and what is inside it would touch nothing
            g.geometry.buildConvexHull(True, "Qt")
            g.geometry = g.geometry.convex
    gripper = robot.get("gripper", {})
    opening = gripper.get("width", 0.0) if width is None else width
    q = pin.neutral(model)
    locked_joints = robot.get("locked_joints", {})
    for name, position in locked_joints.items():
        q[model.joints[model.getJointId(name)].idx_q] = position
    closed = gripper.get("closed_at", [0.0] * len(gripper.get("joints", ())))
    fingers = {}
    for name, at in zip(gripper.get("joints", ()), closed, strict=True):
        highest = model.upperPositionLimit[model.joints[model.getJointId(name)].idx_q]
        moved = opening / 2 if at + opening / 2 <= highest + LIMIT_SLACK else -opening / 2
        fingers[name] = gripper.get("position", 0.0) if gripper.get("kind") == "revolute" else at + moved
    ways = _mimics(text, tuple(fingers)).items()
    fingers |= {name: m * fingers[leader] + at for name, (leader, m, at) in ways}
    for name, position in fingers.items():
        q[model.joints[model.getJointId(name)].idx_q] = position
    moving = {*robot["joints"], *mimics} - locked_joints.keys()
    locked = [k for k in range(1, model.njoints) if model.names[k] not in moving]
    if not locked:
        return model, geometry
    _tell_apart(model)
    reduced, (moved,) = pin.buildReducedModel(model, [geometry], locked, q)
    for k, name in enumerate(reduced.names):
        reduced.names[k] = name.removesuffix(JOINT)
    return reduced, moved


def _tell_apart(model: Any) -> None:
    """Give joints that are called as a link is another name: Pinocchio cannot reduce a model with both."""
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type in (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT) and frame.name in links:
            frame.name += JOINT
    for k, name in enumerate(model.names):
        if name in links:
            model.names[k] = name + JOINT


def hull_of(points: ArrayLike) -> Any:
    """Coal's convex hull of points (n, 3)."""
    cloud = coal.StdVec_Vec3s()
    for point in np.asarray(points, dtype=np.float64):
        cloud.append(point)
    return coal.Convex.convexHull(cloud, True, "Qt")


def _mesh(value: Any, folder: Path) -> Any:
    """The hull of a scene file's ``mesh``."""
    table = {"file": value} if isinstance(value, str) else value
    if "vertices" in table:
        return hull_of(table["vertices"])
    loaded = coal.MeshLoader().load(str(folder / table["file"]), np.array(table.get("scale", (1.0, 1.0, 1.0))))
    loaded.buildConvexHull(True, "Qt")
    return loaded.convex


def _solids(table: Table, meshes: Path) -> list[tuple[Any, Any]]:
    """The shapes of a scene file's table and their placements in it: a cloud is Coal's octree, a height field boxes."""
    if "compound" in table:
        return [(_shape(part, meshes), _pose(part)) for part in table["compound"]]
    if "cloud" in table:
        points = np.array(table["cloud"]["points"], dtype=np.float64)
        return [(coal.makeOctree(points, float(table["cloud"]["resolution"])), pin.SE3.Identity())]
    if "heights" not in table:
        return [(_shape(table, meshes), pin.SE3.Identity())]
    cell, floor = table["heights"]["cell"], table["heights"]["floor"]
    out = []
    for (i, j), top in np.ndenumerate(np.array(table["heights"]["values"], dtype=np.float64)):
        if top > floor:
            centre = np.array([(i + 0.5) * cell, (j + 0.5) * cell, 0.5 * (top + floor)])
            out.append((coal.Box(cell, cell, top - floor), pin.SE3(np.eye(3), centre)))
    return out


def _shape(table: Table, meshes: Path) -> Any:
    if "mesh" in table:
        return _mesh(table["mesh"], meshes)
    if "box" in table:
        return coal.Box(*map(float, table["box"]))
    if "sphere" in table:
        return coal.Sphere(float(table["sphere"]))
    kind = "cylinder" if "cylinder" in table else "capsule"
    sizes = table[kind]
    return (coal.Cylinder if kind == "cylinder" else coal.Capsule)(float(sizes["radius"]), float(sizes["length"]))


def _pose(table: Table) -> Any:
    w, x, y, z = table.get("quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
    turn = pin.Quaternion(float(w), float(x), float(y), float(z)).normalized()
    return pin.SE3(turn.toRotationMatrix(), np.array(table["position"], dtype=np.float64))


def _grown(shape: Any, margin: float) -> Any:
    if isinstance(shape, coal.Box):
        return coal.Box(*(2.0 * (shape.halfSide + margin)))
    if isinstance(shape, coal.Sphere):
        return coal.Sphere(shape.radius + margin)
    if isinstance(shape, coal.Cylinder):
        return coal.Cylinder(shape.radius + margin, 2.0 * (shape.halfLength + margin))
    if isinstance(shape, coal.Capsule):
        return coal.Capsule(shape.radius + margin, 2.0 * shape.halfLength)
    shape.setSweptSphereRadius(margin)
    return shape


def _separation(solids: Sequence[tuple[Any, Any]], direction: FloatArray, climbs: int = FEWER) -> float:
    """The largest separation of two shapes with poses along any direction; negative: they overlap.

    A climb may end on a kink, and Coal's normal is now and then a wrong one to begin with. So where it ended far from
    contact, others are tried.
    """
    between = solids[1][1].translation - solids[0][1].translation
    first = direction if 0.5 < _length(direction.tolist()) < 1.5 else between / _length(between)
    best, way = _climbed(solids, first)
    rng = np.random.default_rng(0)
    for k in range(CLIMBS):
        if abs(best) < KINK or (best > 0.0 and k >= climbs):
            break
        other = _climbed(solids, way + 0.1 ** (k % 6) * rng.normal(size=3))
        best, way = max((best, way), other, key=lambda found: found[0])
    return best


def _climbed(solids: Sequence[tuple[Any, Any]], d: FloatArray) -> tuple[float, FloatArray]:
    """The separation at the end of a climb from a direction, and where that ended; concave where two are apart."""
    (a, T_a), (b, T_b) = solids
    best, width, turn = -math.inf, 0.1, 0.0
    while width > 1e-11:
        d = d / _length(d.tolist())
        side = np.cross(d, np.eye(3)[int(np.abs(d).argmin())])
        side, angles = side / _length(side.tolist()), turn + np.arange(24) * (math.pi / 12)
        ways = np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * np.cross(d, side)
        rows = np.concatenate([d[None], d + width * ways])
        rows /= np.sqrt((rows * rows).sum(axis=1))[:, None]
        found = rows @ (T_b.translation - T_a.translation)
        found = found - _support(a, rows @ T_a.rotation) - _support(b, -(rows @ T_b.rotation))
        top = int(found.argmax())
        width *= 1.5 if top else 0.5
        d, best, turn = rows[top], max(best, float(found[top])), turn + 0.7
    return best, d


def _support(shape: Any, rows: FloatArray) -> FloatArray:
    """Support values of a shape along unit directions in its own axes, (k, 3) in, (k,) out."""
    if isinstance(shape, coal.Box):
        return np.asarray(np.abs(rows) @ shape.halfSide)
    if isinstance(shape, coal.Sphere):
        return np.full(len(rows), float(shape.radius))
    if isinstance(shape, coal.Cylinder):
        return np.asarray(shape.radius * np.hypot(rows[:, 0], rows[:, 1]) + shape.halfLength * np.abs(rows[:, 2]))
    if isinstance(shape, coal.Capsule):
        return np.asarray(shape.radius + shape.halfLength * np.abs(rows[:, 2]))
    return np.asarray((rows @ shape.points().T).max(axis=1) + shape.getSweptSphereRadius())


def _radius(shape: Any) -> float:
    if isinstance(shape, coal.Box):
        return _length(shape.halfSide)
    if isinstance(shape, coal.Sphere):
        return float(shape.radius)
    if isinstance(shape, coal.Cylinder):
        return math.hypot(shape.radius, shape.halfLength)
    if isinstance(shape, coal.Capsule):
        return float(shape.radius + shape.halfLength)
    if isinstance(shape, coal.BVHModelBase):
        return float(np.sqrt((shape.vertices() ** 2).sum(axis=-1)).max())
    return float(np.sqrt((shape.points() ** 2).sum(axis=-1)).max() + shape.getSweptSphereRadius())


def _length(vector: Sequence[float]) -> float:
    return math.sqrt(sum(float(v) ** 2 for v in vector))

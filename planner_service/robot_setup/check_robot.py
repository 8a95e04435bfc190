"""What is wrong with a robot's file, or probably not meant: units, limits, links that no check ever looks at, home.

::

    from planner_service.robot_setup.check_robot import check_robot

    for finding in check_robot("my.urdf").findings:
        print(finding)
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_paths import Surface
from planner_service.geometry.validation import flag, instance, items
from planner_service.presentation.measures import numbers_text
from planner_service.robot.end_effector.mounted_tool import with_tool
from planner_service.robot.kinematic_tree import body_matrix, chain_to_base
from planner_service.robot.loading import (
    LARGE,
    Selection,
    is_mjcf,
    motionless,
    require_urdf_alone,
    robot_from_file,
    robot_of,
)
from planner_service.robot.macros.expansion import checked_xacro_args, package_folders, robot_folders
from planner_service.robot.mjcf.mjcf_reader import inspect_mjcf
from planner_service.robot.model import Robot
from planner_service.robot.srdf import Srdf
from planner_service.robot.toml_reader import read_robot_file
from planner_service.robot.urdf_model import Urdf, UrdfJoint, UrdfLink
from planner_service.robot.urdf_reader import inspect_urdf
from planner_service.robot_setup.concave_links import cut_where_hulls_block
from planner_service.robot_setup.end_effectors.arm_ends import fingers_of
from planner_service.robot_setup.end_effectors.equipment import Equipment
from planner_service.robot_setup.end_effectors.finger_overlap import finger_overlap
from planner_service.robot_setup.loading import refuse_for_toml, robot_file
from planner_service.robot_setup.overhang import extent, overhangs
from planner_service.robot_setup.urdf_robot import FoundSrdf, described_robot, free_home, srdf_of
from planner_service.robot_setup.visuals import Visual, visuals_of
from planner_service.scene.scene import Scene

__all__ = ["Finding", "FindingKind", "RobotCheck", "check_robot"]

FAST_TURN, MOST_DEGREES = 4.0 * math.pi, 720.0
"""A joint that turns more than twice either way is rare; the largest limit in degrees that a joint of an arm has."""

SMALL = 0.002
"""Metres: no mesh of a link is smaller."""

OVERHANG = 0.002
"""Metres by which visual meshes may extend beyond the checked shapes without a word."""

FURNITURE = ("bench", "ceiling", "desk", "floor", "ground", "obstacle", "shelf", "table", "wall")
"""What links of a robot are called that belong to its scene."""

DRAWS, LEAST_FREE = 1_000, 0.02
"""Random configurations of a robot, and the share of them that is free of one that can move."""

LOOKED_AT, BLOCKERS = 100, 4
"""Colliding ones whose pairs are counted, and pairs that are named."""

FAR = 0.3
"""Metres between the tool frame and what moves with it that are more than a long tool."""

UNITS_OF = {"velocity": "rad/s or m/s", "effort": "Nm or N"}
TOML = ".toml"

MAX_NAMES = 8
"""Names in one line."""


class FindingKind(Enum):
    """What a finding is about; ``REFUSED`` alone keeps the robot from being loaded."""

    REFUSED = "refused"
    DEGREES = "degrees"
    UNITS = "units"
    VISUAL_ONLY = "visual only"
    OVERHANG = "overhang"
    AXIS = "axis"
    SIMPLIFIED = "simplified"
    HOME = "home"
    VELOCITY = "velocity"
    EFFORT = "effort"
    FURNITURE = "furniture"
    LIMITS = "limits"
    FINGERS = "fingers"
    TOOL = "tool"
    BLOCKED = "almost nothing is free"
    HULLS = "hulls"
    NOT_UNDERSTOOD = "not understood"
    UNREAD_VISUAL = "unread visual"


@dataclass(frozen=True)
class Finding:
    """Something to correct, or to know, about a URDF.

    Attributes:
        text: What is there.
        advice: What would be right; empty if ``text`` says so.
    """

    kind: FindingKind
    text: str
    advice: str = ""
    links: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()

    @property
    def is_error(self) -> bool:
        """Whether the robot cannot be loaded because of it."""
        return self.kind is FindingKind.REFUSED

    def __str__(self) -> str:
        return f"{self.text}; {self.advice}" if self.advice else self.text


@dataclass(frozen=True, eq=False)
class RobotCheck:
    """What ``check_robot`` found.

    Attributes:
        findings: Errors first.
        robot: With stand-ins for what is refused, with the home that the file asks for; None if nothing can be made.
        visuals: What the links look like.
        fingers: Where links of fingers rest, which ``robot.link_frame`` does not know: body and T_body_link (4, 4).
        overhangs: For each link that looks like something, metres from the farthest point of its visual elements to the
            nearest checked shape that moves with it: 0 if none of them extends beyond, infinite if there is no shape.
    """

    path: Path
    findings: tuple[Finding, ...]
    robot: Robot | None
    visuals: Mapping[str, tuple[Visual, ...]]
    overhangs: Mapping[str, float]
    fingers: Mapping[str, tuple[int, FloatArray]] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether the robot can be loaded; there may be warnings."""
        return not any(finding.is_error for finding in self.findings)


def check_robot(
    path: str | os.PathLike[str],
    package_dirs: Sequence[Path | str] = (),
    *,
    visual_as_collision: bool = False,
    xacro_args: Mapping[str, object] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    tool_frame: str | None = None,
    gripper: Sequence[str] | None = None,
) -> RobotCheck:
    """Look for mistakes in a URDF that a robot should not have, and for some that loading it would not find.

    Args:
        path: A URDF, xacro or MJCF file, a robot.toml, or a name that ``load_robot`` knows.
        package_dirs: Folders in which meshes may lie, besides those in which ``load_robot`` looks.
        visual_as_collision: Check the robot that ``Robot.from_urdf`` gives with the same argument.
        xacro_args: As ``load_robot`` takes them, as the others.
    """
    file = as_path("path", path)
    if not file.is_file():
        file = robot_file(path if isinstance(path, str) else file)
    folders = [as_path("package_dirs", folder) for folder in items("package_dirs", package_dirs, object, "folders")]
    as_seen = flag("visual_as_collision", visual_as_collision)
    locked = instance(
        "locked_joints", {} if locked_joints is None else locked_joints, Mapping, "positions by joint name"
    )
    chosen = Selection(
        tool_frame=tool_frame,
        locked_joints=locked,
        visual_as_collision=as_seen,
        xacro_args=checked_xacro_args({} if xacro_args is None else xacro_args),
        gripper=None if gripper is None else items("gripper", gripper, str, "names of joints"),
    )
    is_toml = file.suffix.lower() == TOML
    if is_toml:
        read = _read_toml(file, folders, chosen)
    else:
        read = _read_description(file, (*folders, *package_folders(file)), chosen)
    urdf, robot, free = read.urdf, read.robot, read.free
    visuals = visuals_of(urdf)
    large = {finding.links[0]: finding for finding in _sizes(urdf, visuals)}
    usual = {link: items for link, items in visuals.items() if link not in large}
    beyond = {} if free is None else overhangs(free, usual)
    found = [
        *(_refused(problem, urdf) for problem in read.problems),
        *(finding for joint in urdf.joints for finding in _joint_findings(joint)),
        *large.values(),
        *(finding for link in urdf.links for finding in _link_findings(link, visuals, beyond)),
        *(
            Finding(FindingKind.AXIS, text, "write one of length 1", joints=_named(text, urdf)[1])
            for text in urdf.remarks
        ),
        *(Finding(FindingKind.LIMITS, text, joints=_named(text, urdf)[1]) for text in urdf.unused_limits),
        *_not_understood(urdf, read.srdf),
        *_unstated(urdf, file),
        *_furniture(urdf, robot),
        *_motionless(urdf),
        *read.findings,
        *(() if read.problems or robot is None else _home(robot, is_toml=is_toml)),
        *(() if read.problems or robot is None else _blocked(robot)),
        *(Finding(FindingKind.UNREAD_VISUAL, text, links=_named(text, urdf)[0]) for text in urdf.unread_visuals),
    ]
    fingers = {} if robot is None or free is None or free is robot else _finger_frames(robot, free)
    return RobotCheck(file, tuple(found), robot, visuals, beyond, fingers)


@dataclass(frozen=True, eq=False)
class _Read:
    """What was read of a robot.

    Attributes:
        problems: What keeps it from being loaded, a line each.
        robot: None if nothing can be made of it.
        free: The robot with its fingers as joints like others.
        findings: About what was chosen for it to work with.
    """

    urdf: Urdf
    problems: Sequence[str]
    srdf: FoundSrdf = field(default_factory=FoundSrdf)
    robot: Robot | None = None
    free: Robot | None = None
    findings: tuple[Finding, ...] = ()


def _read_description(file: Path, folders: Sequence[Path], chosen: Selection) -> _Read:
    """A URDF, xacro or MJCF file."""
    urdf, found_srdf, problems = _inspected(file, folders, chosen)
    if not urdf.root:
        return _Read(urdf, problems, found_srdf)
    try:
        robot, equipment = described_robot(file, urdf, found_srdf, chosen)
    except InvalidFile as error:  # perhaps because of a stand-in
        return _Read(urdf, problems or error.problems, found_srdf)
    except InvalidRequest as error:
        if any((chosen.tool_frame, chosen.locked_joints, chosen.gripper)):  # one of these is wrong, and not the file
            raise
        return _Read(urdf, problems or [str(error)], found_srdf)
    free = moving = robot
    if robot.gripper is not None:
        locked = {**equipment.locked, **chosen.locked_joints}
        free = moving = robot_of(file, urdf, Selection(robot.tool_frame, locked_joints=locked), found_srdf.content)
    if equipment.locked and not problems:
        moving = robot_of(file, urdf, replace(chosen, tool_frame=robot.tool_frame), found_srdf.content)
    crossing = () if problems else _crossing(urdf, found_srdf, robot, moving)
    findings = (*_equipment(equipment), *_tool(robot, equipment), *crossing)
    return _Read(urdf, problems, found_srdf, robot, free, findings)


def _read_toml(file: Path, folders: Sequence[Path], chosen: Selection) -> _Read:
    """A robot.toml, which says by itself what a description leaves open."""
    refuse_for_toml(
        package_dirs=list(map(str, folders)) or None,
        xacro_args=chosen.xacro_args or None,
        tool_frame=chosen.tool_frame,
        gripper=chosen.gripper,
        visual_as_collision=chosen.visual_as_collision or None,
    )
    try:
        of = read_robot_file(file)
    except InvalidFile as error:
        return _Read(Urdf("", "", (), ()), error.problems)
    urdf, problems = inspect_urdf(of.urdf, of.package_dirs, of.table.decompose)
    try:
        robot = robot_from_file(file)
    except InvalidFile as error:
        return _Read(urdf, problems or error.problems)
    robot, free = robot.locked(chosen.locked_joints), robot
    if robot.gripper is not None:
        mounted = urdf if of.table.tool is None else with_tool(urdf, of.table.tool)
        selection = Selection(robot.tool_frame, locked_joints=dict(robot.locked_joints))
        free = robot_of(of.urdf, mounted, selection, Srdf())
    blocked = cut_where_hulls_block(urdf, robot)[1]
    hulls, crossing = _hulls(blocked, "name them in its table decompose"), _crossing(urdf, FoundSrdf(), robot, free)
    return _Read(urdf, problems, FoundSrdf(), robot, free, (*hulls, *crossing))


def _finger_frames(robot: Robot, free: Robot) -> dict[str, tuple[int, FloatArray]]:
    """Where the links of fingers rest: the body that carries them, and T_body_link."""
    own = {frame.link for frame in robot.link_frames}
    at_home = dict(zip(robot.joint_names, robot.home.tolist(), strict=True))
    rest = zip(free.joint_names, free.home.tolist(), strict=True)
    bodies = [body_matrix(pose) for pose in free.body_poses(np.array([at_home.get(name, q) for name, q in rest]))]
    palm = np.linalg.inv(body_matrix(robot.body_poses(robot.home)[robot.tool_body]))
    places = {each.link: bodies[each.body] @ each.pose.matrix for each in free.link_frames if each.link not in own}
    return {link: (robot.tool_body, palm @ T) for link, T in places.items()}


def _inspected(file: Path, folders: Sequence[Path], chosen: Selection) -> tuple[Urdf, FoundSrdf, Sequence[str]]:
    """What a file says, and its problems."""
    if not is_mjcf(file):
        seen, arguments = chosen.visual_as_collision, chosen.xacro_args
        urdf, problems = inspect_urdf(file, folders, visual_as_collision=seen, xacro_args=arguments)
        return urdf, srdf_of(file, urdf) if urdf.root else FoundSrdf(), problems
    require_urdf_alone(chosen)
    try:
        urdf, srdf, problems = inspect_mjcf(file, robot_folders(file, folders))
    except InvalidFile as error:
        return Urdf("", "", (), ()), FoundSrdf(), error.problems
    return urdf, FoundSrdf(srdf), problems


def _not_understood(urdf: Urdf, srdf: FoundSrdf) -> Iterator[Finding]:
    for text in urdf.notes:
        links, joints = _named(text, urdf)
        yield Finding(FindingKind.NOT_UNDERSTOOD, text, links=links, joints=joints)
    where = "" if srdf.path is None else f"{srdf.path.name}: "
    for text in srdf.content.notes:
        yield Finding(FindingKind.NOT_UNDERSTOOD, f"{where}{text}")
    if srdf.problems:
        yield Finding(FindingKind.NOT_UNDERSTOOD, f"{where}{srdf.told}")


def _named(text: str, urdf: Urdf) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The link or the joint that a line of the reader begins with."""
    links = tuple(link.name for link in urdf.links if text.startswith(f"link {link.name!r}"))
    return links[:1], tuple(joint.name for joint in urdf.joints if text.startswith(f"joint {joint.name!r}"))[:1]


def _refused(problem: str, urdf: Urdf) -> Finding:
    links, joints = _named(problem, urdf)
    links += tuple(joint.child for joint in urdf.joints if joint.name in joints)
    return Finding(FindingKind.REFUSED, problem, links=links, joints=joints)


def _joint_findings(joint: UrdfJoint) -> Iterator[Finding]:
    where, about = f"joint {joint.name!r}", ((joint.child,), (joint.name,))
    lower, upper = joint.lower, joint.upper
    largest = max(abs(lower), abs(upper))
    round_numbers = all(abs(10.0 * value - round(10.0 * value)) < 1e-6 for value in (lower, upper))
    if joint.kind == "revolute" and FAST_TURN < largest <= MOST_DEGREES and round_numbers:
        text = f"{where}: limits {lower:g} .. {upper:g} rad are {(upper - lower) / (2.0 * math.pi):.1f} turns"
        advice = f"if they are degrees, write {math.radians(lower):.4f} .. {math.radians(upper):.4f}"
        yield Finding(FindingKind.DEGREES, text, advice, *about)
    if (offset := math.hypot(*joint.xyz)) > LARGE:
        text = f"{where}: its origin is {offset:g} m from its parent"
        yield Finding(
            FindingKind.UNITS,
            text,
            f"if that is millimetres, write {numbers_text([v / 1000 for v in joint.xyz], ' ')}",
            *about,
        )


def _sizes(urdf: Urdf, visuals: Mapping[str, tuple[Visual, ...]]) -> Iterator[Finding]:
    """For each link at most one shape or visual element of a size that no link has."""
    for link in urdf.links:
        shapes = [("collision", item.shape) for item in link.collisions]
        for what, item in [*shapes, *(("visual", visual.appearance) for visual in visuals.get(link.name, ()))]:
            size = extent(item)
            text = f"link {link.name!r}: its {what} {type(item).__name__.lower()} measures {_lengths(size)} m"
            if float(size.max()) > LARGE:
                scaled = isinstance(item, Mesh | Surface)
                right = 'write scale="0.001 0.001 0.001"' if scaled else f"write {_lengths(size / 1000.0)}"
                yield Finding(FindingKind.UNITS, text, f"if that is millimetres, {right}", (link.name,))
                break
            if isinstance(item, Mesh) and float(size.max()) < SMALL:
                advice = "if the file is in metres already, leave out its scale of 0.001"
                yield Finding(FindingKind.UNITS, text, advice, (link.name,))
                break


def _lengths(size: FloatArray) -> str:
    return " x ".join(f"{value:.3g}" for value in size.tolist())


def _link_findings(
    link: UrdfLink, visuals: Mapping[str, tuple[Visual, ...]], beyond: Mapping[str, float]
) -> Iterator[Finding]:
    about = (link.name,)
    mm = 1000.0 * beyond.get(link.name, 0.0)
    if link.collisions and mm > 1000.0 * OVERHANG:
        text = f"link {link.name!r}: what it looks like extends {mm:.1f} mm beyond what is checked"
        yield Finding(FindingKind.OVERHANG, text, "enlarge its collision shapes, or plan with that much padding", about)
    if not link.collisions and link.name in visuals and (not beyond or mm > 1000.0 * OVERHANG):
        far = "nothing that moves with it is" if math.isinf(mm) else f"it extends {mm:.1f} mm beyond what is"
        text = f"link {link.name!r}: it has visual elements alone, so it is never checked"
        text += f"; {far}" if beyond else ""
        advice = "give it collision elements, or use visual_as_collision (--visual-as-collision)"
        yield Finding(FindingKind.VISUAL_ONLY, text, advice, about)
    growth = [item.shape.growth for item in link.collisions if isinstance(item.shape, Mesh) and item.shape.growth]
    if growth:
        text = (
            f"link {link.name!r}: the hull of its mesh has more than 5,000 corners; a simpler one around it is checked"
        )
        advice = f"at most {1000.0 * max(growth):.2f} mm larger; use a simpler mesh if that is too much"
        yield Finding(FindingKind.SIMPLIFIED, text, advice, about)


def _unstated(urdf: Urdf, file: Path) -> Iterator[Finding]:
    """Efforts that are 0 or missing, and velocities, which a robot.toml states."""
    movable = [joint for joint in urdf.joints if joint.kind != "fixed" and joint.mimic is None]
    velocity, effort = (f'write <limit {kind}="..."/>, in {unit}' for kind, unit in UNITS_OF.items())
    if is_mjcf(file):
        velocity = "MJCF has none; import-robot writes a robot.toml, in which they can be set"
        effort = 'write actuatorfrcrange="..." of the joint, in Nm or N'
    for kind, meaning, advice in (
        (FindingKind.VELOCITY, "a slow one is assumed", velocity),
        (FindingKind.EFFORT, "what the motors can do is unknown", effort),
    ):
        silent = [joint for joint in movable if getattr(joint, kind.value) == 0.0]
        if silent and (kind is FindingKind.EFFORT or file.suffix.lower() != TOML):
            names = tuple(joint.name for joint in silent)
            text = f"no {kind.value} of {_listed(names)}: {meaning}"
            yield Finding(kind, text, advice, tuple(joint.child for joint in silent), names)


def _furniture(urdf: Urdf, robot: Robot | None) -> Iterator[Finding]:
    """Links at the base that are named like what stands around a robot."""
    fixed = {item.link for item in robot.shapes if item.body == 0} if robot is not None else set()
    for link in urdf.links:
        words = re.split(r"[^a-z]+", link.name.lower())
        if link.name in fixed and len(fixed) > 1 and set(FURNITURE) & set(words):
            text = f"link {link.name!r}: seems to be part of the scene; as part of the robot it may touch obstacles"
            yield Finding(FindingKind.FURNITURE, text, "make it an obstacle of the scene", (link.name,))


def _home(robot: Robot, *, is_toml: bool) -> Iterator[Finding]:
    contacts = CollisionChecker(robot, Scene()).contacts(robot.home)
    if not contacts:
        return
    nearest = free_home(robot)
    advice = "no free configuration was found"
    if nearest is not None:
        values = ", ".join(
            f"{name}={value:.3g}" for name, value in zip(robot.joint_names, nearest.tolist(), strict=True)
        )
        taken = "the nearest free configuration found" if is_toml else "load_robot takes the nearest free one instead"
        advice = f"{taken}: {values}"
    links = tuple(dict.fromkeys(name for contact in contacts for name in (contact.a, contact.b)))
    yield Finding(FindingKind.HOME, f"home collides with itself: {_listed(tuple(map(str, contacts)))}", advice, links)


def _motionless(urdf: Urdf) -> Iterator[Finding]:
    for name, at in motionless(urdf).items():
        text = f"joint {name!r}: lower and upper are both {at:g}, so it is fixed there"
        yield Finding(FindingKind.LIMITS, text, "write type fixed, or its limits", joints=(name,))


def _hulls(links: tuple[str, ...], advice: str) -> Iterator[Finding]:
    if links:
        yield Finding(FindingKind.HULLS, f"hulls of {_listed(links)} touch what their meshes do not", advice, links)


def _equipment(equipment: Equipment) -> Iterator[Finding]:
    """What was said about fingers, tools and meshes when they were chosen."""
    advice = "load_robot cuts these into convex pieces; Robot.from_urdf does so with decompose"
    yield from _hulls(equipment.cut, advice)
    for note in equipment.notes:
        yield Finding(FindingKind.FINGERS if note.startswith("fingers") else FindingKind.TOOL, note)


def _tool(robot: Robot, equipment: Equipment) -> Iterator[Finding]:
    """Whether the tool frame may be another than meant."""
    about = (robot.tool_frame,)
    step = "--tool-frame (tool_frame) names another"
    if not equipment.sure and not any("tool frame" in note for note in equipment.notes):
        text = f"the tool frame {robot.tool_frame} is a guess: {equipment.whence}"
        yield Finding(FindingKind.TOOL, text, step, about)
    if robot.tool_body == 0:
        yield Finding(FindingKind.TOOL, f"the tool frame {robot.tool_frame} does not move", step, about)
        return
    chain = chain_to_base(robot.bodies, robot.tool_body)
    body = next((each for each in chain if any(item.body == each for item in robot.shapes)), None)
    bodies = [body_matrix(pose) for pose in robot.body_poses(robot.home)]
    point = (bodies[robot.tool_body] @ robot.tool_placement)[None, :3, 3]
    away = min(
        (
            float(item.shape.distance(_seen_from(bodies[item.body] @ item.pose.matrix, point))[0])
            for item in robot.shapes
            if item.body == body
        ),
        default=0.0,
    )
    if away > FAR:
        text = f"the tool frame {robot.tool_frame} is {away:.2g} m away from the shapes that move with it"
        yield Finding(FindingKind.TOOL, text, f"see whether its joint has the right units, or {step}", about)


def _seen_from(T: FloatArray, points: FloatArray) -> FloatArray:
    """Points (k, 3) in a frame that is at T."""
    return np.asarray((points - T[:3, 3]) @ T[:3, :3])


def _blocked(robot: Robot) -> Iterator[Finding]:
    """Whether the robot can be almost nowhere."""
    checker, (lower, upper) = CollisionChecker(robot, Scene()), robot.bounds
    Q = np.minimum(lower + (upper - lower) * np.random.default_rng(0).random((DRAWS, robot.n)), upper)
    free = checker.states_are_free(Q)
    if free.mean() >= LEAST_FREE:
        return
    looked_at = Q[~free][:LOOKED_AT]
    pairs = Counter((contact.a, contact.b) for q in looked_at for contact in checker.contacts(q))
    shares = [f"{a} x {b} {count / len(looked_at):.0%}" for (a, b), count in pairs.most_common(BLOCKERS)]
    text = f"only {free.mean():.1%} of {DRAWS:,} random configurations are free; of the others collide "
    advice = "if these never meet, let an SRDF beside the file disable them"
    links = tuple(dict.fromkeys(name for pair, _ in pairs.most_common(BLOCKERS) for name in pair))
    yield Finding(FindingKind.BLOCKED, text + ", ".join(shares), advice, links)


def _crossing(urdf: Urdf, srdf: FoundSrdf, robot: Robot, moving: Robot) -> Iterator[Finding]:
    deepest = finger_overlap(urdf, fingers_of(urdf, srdf.content), moving)
    if deepest is not None:
        contact, where = deepest
        text, advice = (
            f"fingers pass through each other: {contact} with {where}",
            "see the axes and limits of their joints",
        )
        if (hand := robot.gripper) is not None:
            advice += f"; the gripper is only opened {1000 * hand.lower:.1f} to {1000 * hand.upper:.1f} mm"
        yield Finding(FindingKind.FINGERS, text, advice, (contact.a, contact.b))


def _listed(names: Sequence[str]) -> str:
    more = len(names) - MAX_NAMES
    return ", ".join(names[:MAX_NAMES]) + (f" and {more} more" if more > 0 else "")

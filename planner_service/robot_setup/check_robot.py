"""What is wrong with a URDF, or probably not meant: units, limits, links that no check ever looks at, home.

::

    from planner_service.robot_setup.check_robot import check_robot

    for finding in check_robot("my.urdf").findings:
        print(finding)
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_paths import Surface
from planner_service.geometry.validation import flag, items
from planner_service.presentation.measures import numbers_text
from planner_service.robot.loading import LARGE, is_mjcf
from planner_service.robot.macros.expansion import package_folders, robot_folders
from planner_service.robot.mjcf.mjcf_reader import inspect_mjcf
from planner_service.robot.model import Robot
from planner_service.robot.urdf_model import Urdf, UrdfJoint, UrdfLink
from planner_service.robot.urdf_reader import inspect_urdf
from planner_service.robot_setup.overhang import extent, overhangs
from planner_service.robot_setup.urdf_robot import FoundSrdf, described_robot, free_home, srdf_of
from planner_service.robot_setup.visuals import Visual, shape_poses, visuals_of
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
        overhangs: For each link that looks like something, metres from the farthest point of its visual elements to the
            nearest checked shape that moves with it: 0 if none of them extends beyond, infinite if there is no shape.
    """

    path: Path
    findings: tuple[Finding, ...]
    robot: Robot | None
    visuals: Mapping[str, tuple[Visual, ...]]
    overhangs: Mapping[str, float]

    @property
    def ok(self) -> bool:
        """Whether the robot can be loaded; there may be warnings."""
        return not any(finding.is_error for finding in self.findings)


def check_robot(
    path: str | os.PathLike[str], package_dirs: Sequence[Path | str] = (), *, visual_as_collision: bool = False
) -> RobotCheck:
    """Look for mistakes in a URDF that a robot should not have, and for some that loading it would not find.

    Args:
        package_dirs: Folders in which meshes may lie, besides those in which ``load_robot`` looks.
        visual_as_collision: Check the robot that ``Robot.from_urdf`` gives with the same argument.
    """
    file = as_path("path", path)
    folders = [as_path("package_dirs", folder) for folder in items("package_dirs", package_dirs, object, "folders")]
    as_seen = flag("visual_as_collision", visual_as_collision)
    urdf, found_srdf, problems = _inspected(file, (*folders, *package_folders(file)), as_seen=as_seen)
    robot = None
    if urdf.root:
        try:
            robot = described_robot(file, urdf, found_srdf)
        except InvalidFile as error:
            problems = problems or error.problems  # else perhaps because of a stand-in
    visuals = visuals_of(urdf)
    large = {finding.links[0]: finding for finding in _sizes(urdf, visuals)}
    usual = {link: items for link, items in visuals.items() if link not in large}
    beyond = {} if robot is None else overhangs(robot, usual, shape_poses(urdf))
    found = [
        *(_refused(problem, urdf) for problem in problems),
        *(finding for joint in urdf.joints for finding in _joint_findings(joint)),
        *large.values(),
        *(finding for link in urdf.links for finding in _link_findings(link, visuals, beyond)),
        *(
            Finding(FindingKind.AXIS, text, "write one of length 1", joints=_named(text, urdf)[1])
            for text in urdf.remarks
        ),
        *(Finding(FindingKind.LIMITS, text, joints=_named(text, urdf)[1]) for text in urdf.unused_limits),
        *_not_understood(urdf, found_srdf),
        *_unstated(urdf),
        *_furniture(urdf, robot),
        *(() if problems or robot is None else _home(robot)),
        *(Finding(FindingKind.UNREAD_VISUAL, text, links=_named(text, urdf)[0]) for text in urdf.unread_visuals),
    ]
    return RobotCheck(file, tuple(found), robot, visuals, beyond)


def _inspected(file: Path, folders: Sequence[Path], *, as_seen: bool) -> tuple[Urdf, FoundSrdf, Sequence[str]]:
    """What a file says, and its problems."""
    if not is_mjcf(file):
        urdf, problems = inspect_urdf(file, folders, visual_as_collision=as_seen)
        return urdf, srdf_of(file, urdf) if urdf.root else FoundSrdf(), problems
    if as_seen:
        raise InvalidRequest("visual_as_collision", as_seen, "False: an MJCF file says by contype what collides")
    try:
        urdf, srdf, problems = inspect_mjcf(file, robot_folders(file, folders))
    except InvalidFile as error:
        return Urdf("", "", (), ()), FoundSrdf(), error.problems
    return urdf, FoundSrdf(srdf), problems


def _not_understood(urdf: Urdf, srdf: FoundSrdf) -> Iterator[Finding]:
    for text in urdf.notes:
        links, joints = _named(text, urdf)
        yield Finding(FindingKind.NOT_UNDERSTOOD, text, links=links, joints=joints)
    for text in (*srdf.content.notes, *srdf.problems):
        where = "" if srdf.path is None else f"{srdf.path.name}: "
        yield Finding(FindingKind.NOT_UNDERSTOOD, f"{where}{text}")


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


def _unstated(urdf: Urdf) -> Iterator[Finding]:
    """Velocities and efforts that are 0 or missing."""
    movable = [joint for joint in urdf.joints if joint.kind != "fixed" and joint.mimic is None]
    for kind, silent, meaning, unit in (
        (FindingKind.VELOCITY, [j for j in movable if j.velocity == 0.0], "a slow one is assumed", "rad/s or m/s"),
        (
            FindingKind.EFFORT,
            [j for j in movable if j.effort == 0.0],
            "what the motors can do is unknown",
            "Nm or N",
        ),
    ):
        if silent:
            names = tuple(joint.name for joint in silent)
            text = f"no {kind.value} of {_listed(names)}: {meaning}"
            advice = f'write <limit {kind.value}="..."/>, in {unit}'
            yield Finding(kind, text, advice, tuple(joint.child for joint in silent), names)


def _furniture(urdf: Urdf, robot: Robot | None) -> Iterator[Finding]:
    """Links at the base that are named like what stands around a robot."""
    fixed = {item.link for item in robot.shapes if item.body == 0} if robot is not None else set()
    for link in urdf.links:
        words = re.split(r"[^a-z]+", link.name.lower())
        if link.name in fixed and len(fixed) > 1 and set(FURNITURE) & set(words):
            text = f"link {link.name!r}: seems to be part of the scene; as part of the robot it may touch obstacles"
            yield Finding(FindingKind.FURNITURE, text, "make it an obstacle of the scene", (link.name,))


def _home(robot: Robot) -> Iterator[Finding]:
    contacts = CollisionChecker(robot, Scene()).contacts(robot.home)
    if not contacts:
        return
    nearest = free_home(robot)
    advice = "no free configuration was found"
    if nearest is not None:
        values = ", ".join(
            f"{name}={value:.3g}" for name, value in zip(robot.joint_names, nearest.tolist(), strict=True)
        )
        advice = f"load_robot takes the nearest free configuration found instead: {values}"
    links = tuple(dict.fromkeys(name for contact in contacts for name in (contact.a, contact.b)))
    yield Finding(FindingKind.HOME, f"home collides with itself: {_listed(tuple(map(str, contacts)))}", advice, links)


def _listed(names: Sequence[str]) -> str:
    more = len(names) - MAX_NAMES
    return ", ".join(names[:MAX_NAMES]) + (f" and {more} more" if more > 0 else "")

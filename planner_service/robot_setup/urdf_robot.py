"""A robot to plan with from nothing but its URDF, and the SRDF beside it if there is one."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from planner_service.certify.certifier import MARGIN
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile
from planner_service.files.reading import read_bytes, tell_notes
from planner_service.files.xml_reader import MAX_XML_BYTES, read_xml
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.end_effector.finger_loading import GripperProblem
from planner_service.robot.loading import HOME, Selection, motionless, read_description, robot_of, unit_notes
from planner_service.robot.macros.expansion import package_folders
from planner_service.robot.model import Robot
from planner_service.robot.srdf import Srdf, usable_srdf
from planner_service.robot.urdf_model import Urdf
from planner_service.robot_setup.concave_links import cut_where_hulls_block
from planner_service.robot_setup.end_effectors.equipment import Equipment, equipment_of
from planner_service.robot_setup.link_pair import columns_between
from planner_service.robot_setup.self_collision_matrix import always_overlapping
from planner_service.scene.scene import Scene

__all__ = ["FoundSrdf", "described_robot", "free_home", "load_urdf", "srdf_of"]

READY = "ready"
"""What MoveIt's configurations call the pose at rest if they do not call it home."""

SHARES = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Parts of the joint ranges around a colliding home in which a free configuration is looked for, one after another."""
DRAWS = 200
"""Configurations drawn in each."""

USUAL_PADDING = 0.001
"""Metres: that of requests that name none. Whoever plans next has shapes grown by it, and large hulls take long."""

TOLD = 4
"""Problems of an SRDF that nobody named; it may be meant for a larger robot, and have hundreds."""

logger = logging.getLogger(__name__)


def load_urdf(
    path: Path, package_dirs: Sequence[Path] = (), selection: Selection | None = None, *, cut_meshes: bool = True
) -> Robot:
    """The robot of a URDF or an MJCF file, with what it does not say taken from the SRDF beside it or from its shapes.

    The SRDF is the one with the same stem, else the only one that names the same robot, in the URDF's folder,
    ../srdf or ../config. Links may touch that are adjacent, that the SRDF disables, or that overlap wherever they
    were looked at (``always_overlapping``), each with its reason; nothing is kept on disk. Tool frame and
    gripper are those of ``equipment_of``. Home is the SRDF's "home" or "ready",
    else as ``Robot.from_urdf`` says; where the robot would collide with itself, it is the nearest free
    configuration found. What was chosen is logged. MJCF has excluded contacts and keyframes instead of an SRDF
    (``read_mjcf``). Meshes may lie in ``package_dirs``, in the URDF's folder, in its ROS package and its
    repository (``package_folders``).

    Raises:
        InvalidFile: the file has problems; all of them are named. Of the SRDF, what has problems is not used, with a
            warning.
    """
    read_bytes(path, MAX_XML_BYTES)  # refuses what is no path
    selection = selection or Selection()
    urdf, srdf = read_description(path, (*package_dirs, *package_folders(path)), selection)
    tell_notes(path, (*urdf.notes, *unit_notes(urdf)))
    found = srdf_of(path, urdf) if srdf is None else FoundSrdf(srdf)
    tell_notes(found.path or path, found.content.notes)
    if found.problems:
        logger.warning("%s: %s", found.path or path, found.told)
    robot, chosen = described_robot(path, urdf, found, selection, cut_meshes=cut_meshes)
    tell_notes(path, chosen.notes)
    home = free_home(robot)
    if home is robot.home:
        return robot
    if home is None:
        logger.warning("%s: home collides, and no free configuration was found: set another with robot.toml", path)
        return robot
    logger.info("%s: home collides; the nearest free configuration found takes its place", path)
    return _at_home(robot, home)


@dataclass(frozen=True, eq=False)
class FoundSrdf:
    """What an SRDF says, or a file that needs none.

    Attributes:
        path: The SRDF that was found; None if there is none.
        problems: Why parts of it are not used, a line each.
    """

    content: Srdf = field(default_factory=Srdf)
    path: Path | None = None
    problems: tuple[str, ...] = ()

    @property
    def told(self) -> str:
        """The first problems in one line, and how many there are more."""
        more = f" and {len(self.problems) - TOLD} more" if len(self.problems) > TOLD else ""
        return f"{'' if self.path is None else 'not used of it: '}{'; '.join(self.problems[:TOLD])}{more}"


def described_robot(
    path: Path, urdf: Urdf, found: FoundSrdf, selection: Selection, *, cut_meshes: bool = True
) -> tuple[Robot, Equipment]:
    """The robot that was read from ``path``, as ``load_urdf`` gives it, but with a home that may collide.

    And what was chosen for it to work with, of which ``Equipment.notes`` are not logged yet.
    """
    srdf, chosen = found.content, equipment_of(urdf, found.content, selection)
    hand, locked = chosen.gripper, {**chosen.locked, **selection.locked_joints}
    selection = replace(selection, tool_frame=chosen.tool_frame, locked_joints=locked)
    table = None if hand is None else hand.table
    try:
        robot = robot_of(path, urdf, selection, srdf, table)
    except GripperProblem as problem:
        raise InvalidFile(path, [f"{problem}; --gripper none (gripper=()) plans without it"]) from None
    held = "" if hand is None else f"gripper of {', '.join(hand.table.joints)}, {hand.whence}; "
    srdf_text = found.path or "none"
    logger.info("%s: %stool frame %s, %s; SRDF: %s", path, held, robot.tool_frame, chosen.whence, srdf_text)
    for name, at in motionless(urdf).items():
        logger.info("%s: joint %s can only be at %g, so it is fixed there", path, name, at)
    cut, links = cut_where_hulls_block(urdf, robot) if cut_meshes else (urdf, ())
    if links:
        robot = robot_of(path, cut, selection, srdf, table)
        pieces = ", ".join(f"{link} ({sum(item.link == link for item in robot.shapes)})" for link in links)
        logger.info("%s: hulls touch what their meshes do not, so these are cut into convex pieces: %s", path, pieces)
    robot = replace(robot, groups=robot.groups or chosen.groups)
    silent = [joint.name for joint in urdf.joints if joint.name in robot.joint_names and not joint.velocity]
    if silent:
        logger.info("%s: no velocity is stated for %s; a slow one is assumed", path, ", ".join(silent))
    if HOME not in srdf.states and READY in robot.poses:
        robot = _at_home(robot, robot.pose(READY))
    for contact in (always := always_overlapping(robot)):
        logger.info("%s: %s may touch; %s", path, " x ".join(contact.links), contact.reason)
    return replace(robot, allowed_contacts=(*robot.allowed_contacts, *always)), replace(chosen, cut=links)


def srdf_of(path: Path, urdf: Urdf) -> FoundSrdf:
    """The SRDF of the URDF at ``path``, if there is one."""
    own = path.resolve().parent
    folders = (own, own.parent / "srdf", own.parent / "config")
    files = [file for folder in folders for file in sorted(folder.glob("*.srdf"))]
    chosen = [file for file in files if file.stem == path.stem]
    chosen = chosen[:1] or [file for file in files if _robot_name(file) == urdf.name]
    if len(chosen) > 1:
        names = ", ".join(file.name for file in chosen[:TOLD])
        step = f"call the right one {path.stem}.srdf"
        return FoundSrdf(problems=(f"no SRDF is used: {len(chosen)} are of robot {urdf.name!r} ({names}); {step}",))
    if not chosen:
        return FoundSrdf()
    try:
        srdf, problems = usable_srdf(chosen[0], urdf)
    except InvalidFile as error:  # nobody asked for it, and without it more pairs are checked
        return FoundSrdf(problems=(f"{chosen[0]} is not used: {'; '.join(error.problems)}",))
    return FoundSrdf(srdf, chosen[0], tuple(problems))


def _robot_name(file: Path) -> str | None:
    try:
        return read_xml(file, "robot").get("name")
    except InvalidFile:
        return None


def _at_home(robot: Robot, home: FloatArray) -> Robot:
    return replace(robot, named_poses=tuple((name, home if name == HOME else q) for name, q in robot.named_poses))


def free_home(robot: Robot) -> FloatArray | None:
    """Home (n,) if the robot does not collide with itself there, else the nearest free configuration found, if any.

    Free is what can be proven to be: links nearer than ``MARGIN`` collide. First only the joints between links that
    collide at home leave it, then all.
    """
    lower, upper, home = robot.limits.lower, robot.limits.upper, robot.home
    for padding in (USUAL_PADDING, MARGIN):  # free with more is free with less
        checker = CollisionChecker(robot, Scene(), padding=padding)
        if checker.state_is_free(home):
            return home
    rng = np.random.default_rng(0)
    touching = [(contact.a, contact.b) for contact in checker.contacts(home)]
    between = sorted({column for links in touching for column in columns_between(robot, links)})
    for columns in (between, list(range(robot.n))):
        for share in SHARES:
            low, high = (np.clip(home + side * share * (upper - lower), lower, upper) for side in (-1.0, 1.0))
            Q = np.repeat(home[None], DRAWS, axis=0)
            Q[:, columns] = rng.uniform(low[columns], high[columns], (DRAWS, len(columns)))
            free = Q[checker.states_are_free(Q)]
            if len(free):
                away = np.abs((free - home) / (upper - lower)).max(axis=1)
                return np.asarray(free[away.argmin()])
    return None

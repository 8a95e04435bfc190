"""Loading robots from files: a robot.toml with its URDF, or a URDF alone."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.files.reading import tell_notes
from planner_service.geometry.arrays import FloatArray, product
from planner_service.geometry.composite import extent
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import number
from planner_service.presentation.measures import outside_text
from planner_service.robot.end_effector.finger_loading import (
    GripperProblem,
    closed_positions,
    finger_joints,
    gripper_of,
)
from planner_service.robot.end_effector.mounted_tool import with_tool
from planner_service.robot.inertia import Dynamics, LinkInertia
from planner_service.robot.kinematic_tree import LinkFrame
from planner_service.robot.macros.expansion import checked_xacro_args, robot_folders
from planner_service.robot.mjcf.mjcf_reader import read_mjcf
from planner_service.robot.model import AllowedContact, JointLimits, Robot
from planner_service.robot.srdf import Srdf, read_srdf
from planner_service.robot.toml_reader import GripperTable, RobotTable, read_robot_file
from planner_service.robot.urdf_assembly import Assembly, assemble, locked_positions, mimicked, transform
from planner_service.robot.urdf_model import Mimic, Urdf, UrdfJoint
from planner_service.robot.urdf_reader import read_urdf

__all__ = [
    "HOME",
    "LARGE",
    "Selection",
    "at_rest",
    "is_mjcf",
    "motionless",
    "read_description",
    "require_urdf_alone",
    "robot_from_file",
    "robot_from_urdf",
    "robot_of",
    "standing_joints",
    "unit_notes",
    "without_passive",
]

HOME = "home"

MJCF_SUFFIXES = (".xml", ".mjcf")

LARGE = 5.0
"""Metres: no link of an arm is larger."""


logger = logging.getLogger(__name__)

VELOCITY = {"revolute": 1.0, "prismatic": 0.1}
"""rad/s and m/s of a joint for which the URDF states none, or zero: slow enough for any arm."""
ACCELERATION = {"revolute": 3.141596, "prismatic": 0.5}
"""rad/s^2 and m/s^2 where the URDF states none; these are common in MoveIt configurations."""
JERK = {"revolute": 50.0, "prismatic": 10.0}
"""rad/s^3 and m/s^3 where the URDF states none, our convention: full acceleration within about 60 ms."""


def robot_from_file(path: Path) -> Robot:
    """The robot of a robot.toml.

    Raises:
        InvalidFile: with every problem of the file, or of its URDF.
        MissingDependency: its files are in a package that is not installed.
    """
    file = read_robot_file(path)
    table, limits = file.table, file.table.limits
    urdf = read_urdf(file.urdf, file.package_dirs, table.decompose)
    tell_notes(file.urdf, (*urdf.notes, *unit_notes(urdf)))
    if table.tool is not None:
        try:
            urdf = with_tool(urdf, table.tool)
        except InvalidRequest as error:
            raise InvalidFile(path, [str(error)]) from None
    fingers, joints = () if table.gripper is None else finger_joints(table.gripper, urdf), tuple(table.joints)
    closed = {} if table.gripper is None else closed_positions(table.gripper)
    locked = locked_positions(urdf, joints, {**table.locked_joints, **closed})
    problems = _disagreements(table, urdf, fingers, locked)
    if problems:
        raise InvalidFile(path, problems)
    assembly = assemble(urdf, joints, locked)
    moving = [link for link in table.base_links if assembly.frames[link][0] != 0]
    if moving:
        raise InvalidFile(path, [f"base_links: {link} moves; expected a link fixed to the base" for link in moving])
    tool_body, tool_placement = assembly.frames[table.tool_frame]
    gripper = None
    if table.gripper is not None:
        try:
            gripper = gripper_of(table.gripper, urdf, assembly, (tool_body, tool_placement))
        except GripperProblem as problem:
            raise InvalidFile(path, [str(problem)]) from None
    robot = Robot(
        name=table.name,
        joint_names=joints,
        continuous=tuple(name in table.continuous for name in joints) if table.continuous else (),
        limits=JointLimits(
            lower=np.array(limits.position.lower),
            upper=np.array(limits.position.upper),
            velocity=np.array(limits.velocity.values),
            acceleration=np.array(limits.acceleration.values),
            jerk=np.array(limits.jerk.values),
        ),
        named_poses=tuple((name, np.array(q)) for name, q in table.poses.items()),
        base_links=tuple(table.base_links),
        tool_frame=table.tool_frame,
        tool_body=tool_body,
        tool_placement=tool_placement,
        bodies=assembly.bodies,
        shapes=assembly.shapes,
        allowed_contacts=tuple(contact.value for contact in table.allowed_contacts),
        gripper=gripper,
        retreats=tuple(retreat.value for retreat in table.retreat),
        inverse=table.inverse_kinematics,
        settle_time=table.settle_time,
        link_frames=_link_frames(assembly, () if gripper is None else gripper.links),
        locked_joints=tuple((name, at) for name, at in locked.items() if name not in fingers),
        dynamics=_dynamics(urdf, assembly, joints),
        description=urdf.description,
    )
    width = None if table.gripper is None else table.gripper.width
    return robot if gripper is None else robot.with_gripper(gripper.upper if width is None else width)


def _disagreements(table: RobotTable, urdf: Urdf, fingers: Sequence[str], standing: Mapping[str, float]) -> list[str]:
    """Where robot.toml and its URDF disagree."""
    links = {link.name for link in urdf.links}
    movable = {joint.name: joint for joint in urdf.joints if joint.kind != "fixed"}
    problems = []
    locked = list(table.locked_joints)
    for where, names in (("joints", table.joints), ("gripper.joints", fingers), ("locked_joints", locked)):
        problems += [f"{where}: {name!r} is not a movable joint of the URDF" for name in names if name not in movable]
    used = [*table.joints, *fingers, *locked]
    problems += [
        f"joint {name!r} is listed more than once" for name, times in sorted(Counter(used).items()) if times > 1
    ]
    mimics = mimicked(urdf, table.joints, standing)
    problems += _unaccounted(movable.values(), table.joints, [*standing, *mimics])
    movable |= {joint.name: joint for joint in _with_mimics(urdf, table.joints, mimics)}
    named = [("tool_frame", table.tool_frame), *(("base_links", link) for link in table.base_links)]
    named += [(f"allowed_contacts[{i}].links", link) for i, c in enumerate(table.allowed_contacts) for link in c.links]
    named += [(f"retreat[{i}].pairs", link) for i, r in enumerate(table.retreat) for pair in r.pairs for link in pair]
    problems += [f"{where}: {link!r} is no link of the URDF" for where, link in named if link not in links]
    endless = [name for name in table.joints if name in movable and movable[name].continuous]
    problems += [f"continuous: {name!r} is not a continuous joint" for name in table.continuous if name not in endless]
    pairs = Counter(" x ".join(sorted(contact.links)) for contact in table.allowed_contacts)
    problems += [f"allowed_contacts: {pair} is listed twice" for pair in pairs if pairs[pair] > 1]
    problems += _loose_limits(table, movable) + _unjudged(urdf)
    return problems + (_gripper_problems(table.gripper, movable) if table.gripper else [])


def _unjudged(urdf: Urdf) -> list[str]:
    shaped = any(link.collisions for link in urdf.links)
    step = "give links collision elements, or import it with --visual-as-collision"
    return [] if shaped else [f"no link of the URDF has a collision shape, so nothing could ever collide; {step}"]


def _unaccounted(movable: Iterable[UrdfJoint], joints: Sequence[str], others: Sequence[str]) -> list[str]:
    """Problems of joints that are no joints of q and ``others``, which stand or mimic, or are both."""
    problems = []
    for joint in movable:
        moves = joint.name in joints
        if joint.mimic is not None and moves:
            problems.append(
                f"joint {joint.name!r} mimics {joint.mimic.joint!r}: it moves with it; leave it out of joints"
            )
        elif not moves and joint.name not in others:
            problems.append(f"movable joint {joint.name!r} is neither in joints, nor in the gripper, nor locked")
    return problems


def _loose_limits(table: RobotTable, movable: Mapping[str, UrdfJoint]) -> list[str]:
    problems = []
    for index, name in enumerate(table.joints):
        if name in movable:
            joint = movable[name]
            low, high = table.limits.position.lower[index], table.limits.position.upper[index]
            lower, upper = joint.hard or (joint.lower, joint.upper)  # beyond soft limits: the file's author knows
            if low < lower or high > upper:
                problems.append(
                    f"limits.position: {name} [{low:g}, {high:g}] exceeds the URDF's [{lower:g}, {upper:g}]"
                )
            if 0.0 < joint.velocity < table.limits.velocity.values[index]:
                problems.append(f"limits.velocity: {name} exceeds the URDF's {joint.velocity:g}")
    for name, position in table.locked_joints.items():
        if name in movable and not movable[name].lower <= position <= movable[name].upper:
            where = outside_text(position, movable[name].lower, movable[name].upper)
            problems.append(f"locked_joints: {name} = {where}")
    return problems


def _gripper_problems(entry: GripperTable, movable: Mapping[str, UrdfJoint]) -> list[str]:
    problems = []
    for name in entry.joints:
        joint = movable.get(name)
        if joint is None:
            continue
        expected = "revolute" if entry.kind == "revolute" else "prismatic"
        if joint.kind != expected:
            problems.append(f"gripper.joints: {name} is {joint.kind}; expected {expected}")
    return problems


@dataclass(frozen=True, eq=False)
class Selection:
    """Which part of a URDF becomes the robot; see ``Robot.from_urdf`` and, of the gripper, ``load_robot``."""

    tool_frame: str | None = None
    srdf: Path | None = None
    joints: tuple[str, ...] | None = None
    locked_joints: Mapping[str, float] = field(default_factory=dict)
    decompose: Mapping[str, int] = field(default_factory=dict)
    visual_as_collision: bool = False
    xacro_args: Mapping[str, str] = field(default_factory=dict)
    gripper: tuple[str, ...] | None = None


def robot_from_urdf(path: Path, package_dirs: Sequence[Path], selection: Selection) -> Robot:
    """See ``Robot.from_urdf``."""
    urdf, srdf = read_description(path, package_dirs, selection)
    if srdf is not None and selection.srdf is not None:
        raise InvalidRequest("srdf", str(selection.srdf), "none: MJCF has excluded contacts and keyframes of its own")
    tell_notes(path, (*urdf.notes, *unit_notes(urdf)))
    return robot_of(path, urdf, selection, srdf)


def is_mjcf(path: Path) -> bool:
    """Whether a file is MJCF, by its suffix."""
    return path.suffix.lower() in MJCF_SUFFIXES


def read_description(path: Path, package_dirs: Sequence[Path], selection: Selection) -> tuple[Urdf, Srdf | None]:
    """The robot of a URDF, xacro or MJCF file; of MJCF with what an SRDF would say, else None.

    Raises:
        InvalidFile, MissingDependency: as of ``read_urdf`` and ``read_mjcf``.
        InvalidRequest: what is for URDF alone, for an MJCF file.
    """
    decompose, as_seen = selection.decompose, selection.visual_as_collision
    arguments = checked_xacro_args(selection.xacro_args)
    if not is_mjcf(path):
        return read_urdf(path, package_dirs, decompose, visual_as_collision=as_seen, xacro_args=arguments), None
    require_urdf_alone(selection)
    return read_mjcf(path, robot_folders(path, package_dirs))


def require_urdf_alone(selection: Selection) -> None:
    """Refuse what is for URDF alone; call it for an MJCF file.

    Raises:
        InvalidRequest: there is something.
    """
    for name in ("decompose", "visual_as_collision", "xacro_args"):
        if given := getattr(selection, name):
            raise InvalidRequest(name, given, "none: it is for URDF; an MJCF file says by contype what collides")


def unit_notes(urdf: Urdf) -> list[str]:
    """What of a robot is so large that it seems to be in millimetres, a line each."""
    notes = []
    for link in urdf.links:
        for item in link.collisions:
            size = extent(item.shape)
            if float(size.max()) > LARGE:
                right = 'scale="0.001 0.001 0.001"' if isinstance(item.shape, Mesh) else "a thousandth"
                what = f"its {type(item.shape).__name__.lower()} is {float(size.max()):.3g} m long"
                notes.append(f"link {link.name!r}: {what}; if that is millimetres, write {right}")
                break
    return notes


def robot_of(
    path: Path, urdf: Urdf, selection: Selection, srdf: Srdf | None = None, gripper: GripperTable | None = None
) -> Robot:
    """The robot of the URDF that was read from ``path``; see ``Robot.from_urdf``.

    Args:
        srdf: In the place of the file in ``selection``.
        gripper: Its gripper, with which the robot stands open; the joints of its fingers are none of the robot.

    Raises:
        GripperProblem: the gripper is none.
    """
    if srdf is None:
        srdf = Srdf() if selection.srdf is None else read_srdf(selection.srdf, urdf)
        tell_notes(selection.srdf or path, srdf.notes)
    movable = _movable(urdf)
    fingers = () if gripper is None else finger_joints(gripper, urdf)
    selection = without_passive(selection, urdf, srdf, fingers)
    locked = standing_joints(urdf, selection)
    if gripper is not None:
        locked = locked_positions(urdf, (), locked | closed_positions(gripper))
    names = selection.joints
    if names is None:
        names = tuple(name for name in _outwards(urdf) if name not in locked and movable[name].mimic is None)
    mimics = mimicked(urdf, names, locked)
    joints = _with_mimics(urdf, names, mimics)
    problems = _unaccounted(movable.values(), names, [*locked, *mimics])
    problems += [
        f"joint {joint.name!r}: lower and upper are both {joint.lower:g}, it cannot move; leave it out of joints"
        for joint in joints
        if joint.lower >= joint.upper
    ]
    problems += _unjudged(urdf)
    if not joints:
        problems.append("no joint moves")
    if problems:
        raise InvalidFile(path, problems)
    tool = _last_link(urdf) if selection.tool_frame is None else selection.tool_frame
    assembly = assemble(urdf, names, locked)
    if not isinstance(tool, str) or tool not in assembly.frames:
        raise UnknownName("tool frame", tool, assembly.frames)
    hand = None if gripper is None else gripper_of(gripper, urdf, assembly, assembly.frames[tool])
    robot = Robot(
        name=urdf.name,
        joint_names=names,
        limits=_urdf_limits(urdf, joints, mimics),
        named_poses=_poses(joints, srdf.states),
        base_links=tuple(link for link, (body, _) in assembly.frames.items() if body == 0),
        tool_frame=tool,
        tool_body=assembly.frames[tool][0],
        tool_placement=assembly.frames[tool][1],
        bodies=assembly.bodies,
        shapes=assembly.shapes,
        allowed_contacts=(*_adjacent(urdf, assembly), *srdf.contacts),
        gripper=hand,
        link_frames=_link_frames(assembly, () if hand is None else hand.links),
        continuous=tuple(joint.continuous for joint in joints) if any(joint.continuous for joint in joints) else (),
        locked_joints=tuple((name, at) for name, at in locked.items() if name not in fingers),
        groups=srdf.groups,
        dynamics=_dynamics(urdf, assembly, names),
        description=urdf.description,
    )
    return robot if hand is None else robot.with_gripper(hand.upper)


def _link_frames(assembly: Assembly, fingers: Sequence[str]) -> tuple[LinkFrame, ...]:
    frames = ((link, place) for link, place in assembly.frames.items() if link not in fingers)
    return tuple(LinkFrame(link, body, Pose.from_matrix(T)) for link, (body, T) in frames)


def _dynamics(urdf: Urdf, assembly: Assembly, joints: Sequence[str]) -> Dynamics | None:
    """The masses of all links and the efforts of the joints that move."""
    links = []
    for link in urdf.links:
        inertial = link.inertial
        if inertial is not None and inertial.mass > 0.0:
            body, T = assembly.frames[link.name]
            pose = Pose.from_matrix(product(T, transform(inertial.xyz, inertial.rpy)))
            links.append(LinkInertia(link.name, body, inertial.mass, inertial.tensor, pose))
    efforts = {joint.name: joint.effort for joint in urdf.joints}
    return Dynamics(np.array([efforts[name] for name in joints]), tuple(links)) if links else None


def without_passive(selection: Selection, urdf: Urdf, srdf: Srdf, fingers: Sequence[str] = ()) -> Selection:
    """The selection with the passive joints of an SRDF locked where they are at home.

    Those stay as they are that the caller names, that a gripper moves, or that mimic another joint.
    """
    chosen = {*selection.locked_joints, *(selection.joints or ()), *fingers}
    at_home = srdf.states.get(HOME, {})
    standing = {
        joint.name: min(max(at_home.get(joint.name, at_rest(joint)), joint.lower), joint.upper)
        for joint in urdf.joints
        if joint.name in srdf.passive and joint.name not in chosen and joint.mimic is None
    }
    return replace(selection, locked_joints={**standing, **selection.locked_joints})


def standing_joints(urdf: Urdf, selection: Selection) -> dict[str, float]:
    """Positions of the joints that do not move, including those that mimic one of them.

    Raises:
        UnknownName: no such joint.
        InvalidRequest: a joint both moves and is locked, or a position is outside its limits.
    """
    movable = _movable(urdf)
    given = dict(selection.locked_joints)
    for name, position in given.items():
        if not isinstance(name, str) or name not in movable:
            raise UnknownName("joint", name, movable)
        lower, upper = movable[name].lower, movable[name].upper
        expected = f"a position in [{lower:g}, {upper:g}]"
        given[name] = number(f"locked_joints[{name!r}]", position, expected, lower, upper)
    if selection.joints is None:
        return locked_positions(urdf, (), motionless(urdf) | given)
    for name in selection.joints:
        if not isinstance(name, str) or name not in movable:
            raise UnknownName("joint", name, movable)
        if name in given:
            raise InvalidRequest(f"locked_joints[{name!r}]", given[name], "a joint that is not in joints")
    if not selection.joints or len(set(selection.joints)) != len(selection.joints):
        raise InvalidRequest("joints", selection.joints, "at least one joint, and no joint twice")
    others = [joint for name, joint in movable.items() if name not in selection.joints and joint.mimic is None]
    return locked_positions(urdf, selection.joints, {joint.name: at_rest(joint) for joint in others} | given)


def motionless(urdf: Urdf) -> dict[str, float]:
    """The joints whose limits are one position, and that position: they are as good as fixed."""
    moving = (joint for joint in urdf.joints if joint.kind != "fixed" and joint.mimic is None)
    return {joint.name: joint.lower for joint in moving if joint.lower == joint.upper}


def _outwards(urdf: Urdf) -> list[str]:
    """The movable joints along each chain from the base to its tip; where chains part, in file order."""
    out, waiting = [], [*reversed(urdf.below[urdf.root])]
    while waiting:
        joint = waiting.pop()
        out += [joint.name] if joint.kind != "fixed" else []
        waiting += reversed(urdf.below[joint.child])
    return out


def _movable(urdf: Urdf) -> dict[str, UrdfJoint]:
    return {joint.name: joint for joint in urdf.joints if joint.kind != "fixed"}


def _poses(
    joints: Sequence[UrdfJoint], states: Mapping[str, Mapping[str, float]]
) -> tuple[tuple[str, FloatArray], ...]:
    """Home, and the states that mention a moving joint; a joint that a state leaves out is as at home."""
    home = {joint.name: at_rest(joint) for joint in joints}
    moving = {name: {k: v for k, v in values.items() if k in home} for name, values in states.items()}
    home |= moving.pop(HOME, {})
    poses = [(HOME, home), *((name, home | values) for name, values in moving.items() if values)]
    lower, upper = ([getattr(joint, end) for joint in joints] for end in ("lower", "upper"))  # as mimics need them
    return tuple((name, np.clip([values[joint.name] for joint in joints], lower, upper)) for name, values in poses)


def _with_mimics(urdf: Urdf, names: Sequence[str], mimics: Mapping[str, Mimic]) -> list[UrdfJoint]:
    """The joints of these names, their limits as tight as those that mimic them need.

    Limits of a mimic that would leave no room contradict how it moves, and are not used.
    """
    by_name = {joint.name: joint for joint in urdf.joints}
    out = {name: by_name[name] for name in names if name in by_name}
    for name, mimic in mimics.items():
        joint, leader = by_name[name], out.get(mimic.joint)
        if leader is None:
            continue
        speed = min(_velocity(leader), _velocity(joint) / abs(mimic.multiplier))
        leader = replace(leader, velocity=speed)
        if joint.continuous:  # as it was after a turn of its leader only if that turns it a whole number of times
            leader = replace(leader, continuous=leader.continuous and mimic.multiplier.is_integer())
        else:
            ends = sorted((limit - mimic.offset) / mimic.multiplier for limit in (joint.lower, joint.upper))
            lower, upper = max(leader.lower, ends[0]), min(leader.upper, ends[1])
            if lower < upper:
                leader = replace(leader, lower=lower, upper=upper, continuous=False)
            else:
                limits = f"limits {joint.lower:g} .. {joint.upper:g} leave {mimic.joint} no room"
                logger.warning("joint %s mimics %s; its %s: they are not used", name, mimic.joint, limits)
        out[mimic.joint] = leader
    return [out[name] for name in names if name in out]


def _velocity(joint: UrdfJoint) -> float:
    return joint.velocity or VELOCITY[joint.kind]


def _urdf_limits(urdf: Urdf, joints: Sequence[UrdfJoint], mimics: Mapping[str, Mimic]) -> JointLimits:
    by_name = {joint.name: joint for joint in urdf.joints}

    def rates(stated: str, usual: Mapping[str, float]) -> FloatArray:
        own = {joint.name: getattr(joint, stated) or usual[joint.kind] for joint in joints}
        for name, mimic in mimics.items():
            limit = getattr(by_name[name], stated) or usual[by_name[name].kind]
            own[mimic.joint] = min(own[mimic.joint], limit / abs(mimic.multiplier))
        return np.array([own[joint.name] for joint in joints])

    return JointLimits(
        lower=np.array([joint.lower for joint in joints]),
        upper=np.array([joint.upper for joint in joints]),
        velocity=np.array([_velocity(joint) for joint in joints]),
        acceleration=rates("acceleration", ACCELERATION),
        jerk=rates("jerk", JERK),
    )


def at_rest(joint: UrdfJoint) -> float:
    """Where a joint stands that nobody says more of: at zero if its limits allow it, else at their middle."""
    return 0.0 if joint.lower <= 0.0 <= joint.upper else (joint.lower + joint.upper) / 2


def _last_link(urdf: Urdf) -> str:
    """The last link of the longest chain; if there are several, the first in the file."""

    def depth(link: str) -> int:
        count = 0
        while link in urdf.above:
            link, count = urdf.above[link].parent, count + 1
        return count

    return max((link.name for link in urdf.links), key=depth)


def _adjacent(urdf: Urdf, assembly: Assembly) -> tuple[AllowedContact, ...]:
    """Each link with shapes and the nearest link above it with shapes, if one moves against the other."""
    body_of = {item.link: item.body for item in assembly.shapes}
    above = {link: joint.parent for link, joint in urdf.above.items()}
    contacts = []
    for link, body in body_of.items():
        parent = above.get(link)
        while parent is not None and parent not in body_of:
            parent = above.get(parent)
        if parent is not None and body_of[parent] != body:
            contacts.append(AllowedContact((parent, link), "adjacent"))
    return tuple(contacts)

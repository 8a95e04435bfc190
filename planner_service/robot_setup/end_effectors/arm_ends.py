"""Where the arms of a robot end: which frame of a URDF is the tool's, and which joints are fingers."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from planner_service.geometry.composite import extent
from planner_service.robot.groups import PlanningGroup
from planner_service.robot.srdf import Srdf
from planner_service.robot.urdf_model import Urdf, UrdfJoint

__all__ = ["ArmEnd", "arm_ends", "arm_groups", "arms_of", "fingers_of", "named_frame"]

FRAMES = (
    "tcp",
    "grasp|grasping|grasptarget|pinch",
    "tool0|tool 0",
    "ee|eef|eelink|eeflink|end effector|endeffector|effector",
    "tool",
    "tip|tooltip|fingertips",
    "flange",
)
"""What the frame of a tool is called, the surest name first."""
SENSORS = "camera|cam|optical|sensor|imu|lidar|laser|light|marker|mic|display|screw|cable|inertia|inertial|com"
LEGS = "leg|legs|hip|knee|ankle|foot|feet|thigh|calf|shank|shin|toe|sole|haa|hfe|kfe|upleg"
OTHERS = "head|neck|eye|eyes|eyelid|camera|wheel|caster|rotor|propeller|prop|track|gaze|mast|lidar|sonar|laser|velodyne"
ARMS = "arm|shoulder|elbow|wrist|forearm|torso|waist|pelvis"
TURNS = "yaw|roll|pitch|rotate|rotation|wrist|base|mount"
FINGERS = "finger|fingers|jaw|jaws|thumb|claw|knuckle|fingertip|pinky|gripper|pincer"
"""Words that are a leg's, another part's than an arm's, a part of an arm, how a hand turns, and a finger's."""
LONGEST = 0.25
"""Metres from the beginning of a finger to its last joint, several times those of large grippers."""
MOST_JOINTS = 8
"""Joints of a finger, one behind another."""
SHORTER = 0.5
"""Share of the joints of the longest arm that another arm has at least."""


@dataclass(frozen=True)
class ArmEnd:
    """The end of a chain of joints, fingers aside.

    Attributes:
        links: The links that the last joint moves and that are fixed to each other, outwards.
        joints: The joints from the base on that move by themselves.
        fingers: The joints of fingers that these links carry.
        is_arm: Whether it is the end of an arm, rather than of a leg, a head, a wheel or a mimic joint.
    """

    links: tuple[str, ...]
    joints: tuple[str, ...]
    fingers: tuple[UrdfJoint, ...]
    is_arm: bool


def fingers_of(urdf: Urdf, srdf: Srdf) -> tuple[UrdfJoint, ...]:
    """The joints of fingers: those at the end of an arm that are named so, or that several short chains have there.

    None if all that moves would be fingers: it is a hand by itself, and these are its joints.
    """
    moving = {joint.name for joint in _moving(urdf)}
    called = _called_fingers(urdf)
    found: list[UrdfJoint] = []
    for wrist in _moving(urdf):
        if wrist in found or wrist.name in called:
            continue
        roots = [root for root in _next_joints(urdf, wrist.child) if root not in found]
        below = {root.name: _moved_by(urdf, root) for root in roots}
        names = {joint.name for joints in below.values() for joint in joints}
        hands = [set(group) for group in srdf.end_effectors if 0 < len(moving & set(group)) == len(names & set(group))]
        small = [root for root in roots if _is_small(urdf, root)]
        for root in roots:
            plain = root in small and not _has(f"{ARMS}|{LEGS}|{OTHERS}", *_names(below[root.name]))
            of_hand = any(all(_is_of(hand, one) for one in below[root.name]) for hand in hands)
            of_palm = len(small) == len(roots) > 1 or of_hand
            if called.issuperset(one.name for one in below[root.name]) or (plain and of_palm):
                found += below[root.name]
    return tuple(found) if {joint.name for joint in found} < moving else ()


def arm_ends(urdf: Urdf, fingers: Collection[UrdfJoint]) -> list[ArmEnd]:
    """Where chains of joints end, arms first, those that have most joints first; else in file order."""
    ends = []
    for joint in _moving(urdf):
        links = _fixed_to(urdf, joint.child)
        ahead = _next_joints(urdf, joint.child)
        own = [each for each in ahead if each in fingers]
        chain = list(_chain(urdf, joint))
        if joint in fingers or len(own) < len(ahead):
            continue
        names = [name for each in chain[-3:] for name in (each.name, each.child)] + [joint.child]
        moved = tuple(each.name for each in chain if each.mimic is None)
        below = tuple(one for root in own for one in _moved_by(urdf, root))
        ends.append(ArmEnd(tuple(links), moved, below, joint.mimic is None and not _has(f"{LEGS}|{OTHERS}", *names)))
    return sorted(ends, key=lambda end: (not end.is_arm, -len(end.joints), not end.fingers, -_depth(urdf, end)))


def named_frame(urdf: Urdf, end: ArmEnd) -> tuple[str, str]:
    """The link at the end of an arm whose frame is the tool's, and by what it was chosen."""
    plain = [link for link in end.links if not _has(SENSORS, link)] or list(end.links)
    for words in FRAMES:
        if called := [link for link in plain if _has(words, link)]:
            return called[-1], "its name"
    if end.fingers:
        palm = end.fingers[0].parent if end.fingers[0].parent in end.links else end.links[0]
        shaped = {link.name for link in urdf.links if link.collisions}
        beyond = [link for link in plain if link not in shaped and not urdf.below[link] and link != palm]
        ahead = [link for link in beyond if _level(urdf, link) > _level(urdf, palm)]
        return (ahead[-1] if ahead else palm), "the fingers that it carries"
    return max(plain, key=lambda link: _level(urdf, link)), "the last link of the longest chain"


def arm_groups(urdf: Urdf, srdf: Srdf, arms: Sequence[ArmEnd]) -> tuple[PlanningGroup, ...]:
    """A planning group for each of several arms, without the joints that they share; its tip is the arm's tool."""
    shared = set.intersection(*(set(arm.joints) for arm in arms))
    groups = list[PlanningGroup]()
    for number, arm in enumerate(arms, 1):
        own = tuple(name for name in arm.joints if name not in shared)
        side = next(
            (side for side, words in (("left", "left|l|larm"), ("right", "right|r|rarm")) if _has(words, *own)), None
        )
        taken = [group.name for group in groups]
        name = side if side is not None and side not in taken else f"arm_{number}"
        tip = next((tip for tip in srdf.tips if tip in arm.links), named_frame(urdf, arm)[0])
        groups.append(PlanningGroup(name, own, tip))
    return tuple(groups)


def arms_of(ends: Sequence[ArmEnd]) -> list[ArmEnd]:
    """The arms among ends: those about as long as the longest."""
    arms = [end for end in ends if end.is_arm]
    longest = len(arms[0].joints) if arms else 0
    return [arm for arm in arms if len(arm.joints) >= max(2, SHORTER * longest)]


def _moving(urdf: Urdf) -> list[UrdfJoint]:
    return [joint for joint in urdf.joints if _moves(joint)]


def _moves(joint: UrdfJoint) -> bool:
    return joint.kind != "fixed"


def _fixed_to(urdf: Urdf, link: str) -> list[str]:
    links = [link]
    for name in links:  # grows while it is read
        links += [joint.child for joint in urdf.below[name] if not _moves(joint)]
    return links


def _next_joints(urdf: Urdf, link: str) -> list[UrdfJoint]:
    return [joint for name in _fixed_to(urdf, link) for joint in urdf.below[name] if _moves(joint)]


def _moved_by(urdf: Urdf, joint: UrdfJoint) -> list[UrdfJoint]:
    joints = [joint]
    for one in joints:  # grows while it is read
        joints += _next_joints(urdf, one.child)
    return joints


def _chain(urdf: Urdf, joint: UrdfJoint) -> Sequence[UrdfJoint]:
    """The joints that move from the base to this one."""
    chain = [joint]
    while chain[-1].parent in urdf.above:
        chain.append(urdf.above[chain[-1].parent])
    return [each for each in reversed(chain) if _moves(each)]


def _level(urdf: Urdf, link: str) -> int:
    level = 0
    while link in urdf.above:
        link, level = urdf.above[link].parent, level + 1
    return level


def _depth(urdf: Urdf, end: ArmEnd) -> int:
    return max(_level(urdf, link) for link in end.links)


def _is_small(urdf: Urdf, root: UrdfJoint) -> bool:
    """Whether all that a joint moves is no longer than a finger."""

    shapes = {link.name: link.collisions for link in urdf.links}

    def reach(joint: UrdfJoint, far: float, count: int) -> bool:
        ends = [math.hypot(*item.xyz) + 0.5 * float(extent(item.shape).max()) for item in shapes[joint.child]]
        if far + max(ends, default=0.0) > LONGEST or count > MOST_JOINTS:
            return False
        ahead = urdf.below[joint.child]
        return all(reach(below, far + math.hypot(*below.xyz), count + _moves(below)) for below in ahead)

    return reach(root, 0.0, 1)


def _is_of(hand: Collection[str], joint: UrdfJoint) -> bool:
    """Whether a joint is one of a hand's, or follows one."""
    return joint.name in hand or (joint.mimic is not None and joint.mimic.joint in hand)


def _called_fingers(urdf: Urdf) -> set[str]:
    """The joints that are named as a finger's, or that move a link named so.

    Not what turns a hand: a joint named as a wrist, or the only one at its palm, which carries others that move by
    themselves. "Gripper" and "jaw" are what hands are called, too.
    """
    plain = FINGERS.replace("gripper|", "")
    called = {joint.name for joint in _moving(urdf) if _has(plain, joint.name)}
    turning = {joint.name for joint in _moving(urdf) if _has(TURNS, joint.name)}
    likely = {one.name for one in _moving(urdf) if _has("gripper", one.name) or _has(plain, one.child)} - turning
    for palm in (urdf.root, *(joint.child for joint in _moving(urdf))):
        beside = [joint for joint in _next_joints(urdf, palm) if joint.name in called | likely]
        if len(beside) == 1 and any(one.mimic is None for one in _moved_by(urdf, beside[0])[1:]):
            likely.discard(beside[0].name)
    return called | likely


def _names(joints: Sequence[UrdfJoint]) -> list[str]:
    return [name for joint in joints for name in (joint.name, joint.child)]


def _has(words: str, *names: str) -> bool:
    """Whether one of the names has one of the words, perhaps with a side before it or a number behind it."""
    spaced = (
        re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[^A-Za-z0-9]+", " ", name).lower() for name in names
    )
    return any(
        re.search(rf"(?<![a-z0-9])(?:[lr]|[fr][lr]|[lr][fh]|left|right)?(?:{words})\d*(?![a-z0-9])", each)
        for each in spaced
    )

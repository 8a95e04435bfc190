"""What a robot of a URDF alone works with: its tool frame, its gripper, and fingers that stand still."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.robot.groups import PlanningGroup
from planner_service.robot.loading import HOME, Selection, at_rest, motionless
from planner_service.robot.srdf import Srdf
from planner_service.robot.urdf_model import Urdf, UrdfJoint
from planner_service.robot_setup.end_effectors.arm_ends import (
    ArmEnd,
    arm_ends,
    arm_groups,
    arms_of,
    fingers_of,
    named_frame,
)
from planner_service.robot_setup.gripper_detection import FoundGripper, NoGripper, find_gripper

__all__ = ["Equipment", "equipment_of"]


MOST = 6
"""Fingers whose positions a warning names."""


@dataclass(frozen=True)
class Equipment:
    """What was chosen for a robot.

    Attributes:
        gripper: None without one.
        tool_frame: The link whose frame is the tool's.
        whence: By what it was chosen, in words.
        locked: Positions of fingers that are no gripper, and of what stands still beside one.
        groups: The arms of a robot that has several, with a tool each.
        notes: What a user should know about the fingers, and about the tool frame; a line each.
        sure: Whether the tool frame is more than a guess.
        cut: Links whose meshes were cut because their hulls touch what they do not (``cut_where_hulls_block``).
    """

    gripper: FoundGripper | None
    tool_frame: str
    whence: str
    locked: Mapping[str, float]
    groups: tuple[PlanningGroup, ...] = ()
    notes: tuple[str, ...] = ()
    sure: bool = True
    cut: tuple[str, ...] = ()


def equipment_of(urdf: Urdf, srdf: Srdf, selection: Selection) -> Equipment:
    """Tool frame and gripper: those that the caller names, else those of the SRDF, else by name, by gripper, by chain.

    Fingers that leave a doubt whether they are a gripper are locked where they rest, unless the caller names them.

    Raises:
        UnknownName: there is no such link or joint.
        InvalidRequest: the joints that the caller names are no gripper.
    """
    still = {*selection.locked_joints, *motionless(urdf)}
    standing = replace(urdf, joints=tuple(replace(j, kind="fixed") if j.name in still else j for j in urdf.joints))
    known = [link.name for link in urdf.links]
    if selection.tool_frame is not None and selection.tool_frame not in known:
        raise UnknownName("tool frame", selection.tool_frame, known)
    fingers = fingers_of(standing, srdf)
    hand, why = _hand(standing, srdf, selection)
    moved = set() if hand is None else {*hand.table.joints, *hand.standing, *_followers(standing, hand.table.joints)}
    loose = [] if selection.gripper == () else [one for one in fingers if one.name not in moved]
    locked = {one.name: _resting(one, srdf) for one in loose if one.mimic is None}
    locked |= {} if hand is None else dict.fromkeys(hand.standing, 0.0)
    arms = arms_of(ends := arm_ends(standing, fingers))
    end = _main(ends, srdf, hand)
    if selection.tool_frame is not None:
        tool, whence = selection.tool_frame, "as given"
    elif hand is not None:
        tool, whence = hand.tool_frame, "a frame of the gripper's palm"
    elif (tip := _tip(standing, srdf, ends, fingers)) is not None:
        tool, whence = tip, "the tip of a chain in the SRDF"
    elif end is not None:
        tool, whence = named_frame(standing, end)
    else:
        tool, whence = urdf.root, "nothing moves"
    notes = [*_about_fingers(standing, srdf, selection, loose, locked, why)]
    groups = arm_groups(standing, srdf, arms) if len(arms) > 1 and not srdf.groups else ()
    if len(arms) > 1 and selection.tool_frame is None:
        tools = ", ".join(f"{group.name}: {group.tip}" for group in arm_groups(standing, srdf, arms))
        step = f"--tool-frame (tool_frame) names another{', robot.group(...) plans with one arm' if groups else ''}"
        what = "arms" if len(arms) == 2 else "chains of joints"
        notes.append(f"{len(arms)} {what}, each with its tool ({tools}); {tool} is the tool frame; {step}")
    elif end is not None and not end.is_arm and selection.tool_frame is None and hand is None and len(ends) > 1:
        notes.append(f"no arm was found; {tool} is the tool frame; --tool-frame (tool_frame) names another")
    sure = selection.tool_frame is not None or hand is not None or "chain" not in whence or "SRDF" in whence
    return Equipment(hand, tool, whence, locked, groups, tuple(notes), sure)


def _hand(urdf: Urdf, srdf: Srdf, selection: Selection) -> tuple[FoundGripper | None, str]:
    """The gripper, or why there is none."""
    named = selection.gripper
    if named == ():
        return None, ""
    try:
        return find_gripper(urdf, srdf, selection.tool_frame, named), ""
    except NoGripper as problem:
        if named is None:
            return None, str(problem)
        expected = "joints of two fingers that move oppositely, or of one jaw"
        message = f"gripper: {', '.join(named)} are no gripper: {problem}; --gripper none plans for them as for others"
        raise InvalidRequest("gripper", list(named), expected, message=message) from None


def _main(ends: Sequence[ArmEnd], srdf: Srdf, hand: FoundGripper | None) -> ArmEnd | None:
    """The end whose frame is the tool's: of the gripper, of the SRDF's first arm, else the first."""
    for frame in (*([] if hand is None else [hand.tool_frame]), *srdf.tips):
        for end in ends:
            if frame in end.links and (end.is_arm or not any(other.is_arm for other in ends)):
                return end
    return ends[0] if ends else None


def _tip(urdf: Urdf, srdf: Srdf, ends: Sequence[ArmEnd], fingers: Sequence[UrdfJoint]) -> str | None:
    """The first tip of a chain in the SRDF, but none of a leg beside arms, and none of a finger."""
    arms = any(end.is_arm for end in ends)
    others = {link for end in ends if arms and not end.is_arm for link in end.links}
    for tip in srdf.tips:
        above = tip
        while above in urdf.above and urdf.above[above] not in fingers:
            above = urdf.above[above].parent
        if tip not in others and above not in urdf.above:
            return tip
    return None


def _about_fingers(
    urdf: Urdf, srdf: Srdf, selection: Selection, loose: Sequence[UrdfJoint], locked: Mapping[str, float], why: str
) -> Iterator[str]:
    """That fingers stand still, why, and what would make them move: for each palm the way that was tried and works."""
    palms: dict[str, list[str]] = {}
    for one in loose:
        palms.setdefault(_palm(urdf, one, loose), []).append(one.name)
    for names in palms.values():
        leaders = [name for name in names if name in locked]
        tried = [one.name for one in loose if one.name in leaders and not one.continuous] or leaders
        more = f" and {len(leaders) - MOST} more" if len(leaders) > MOST else ""
        where = ", ".join(f"{name}={locked[name]:.4g}" for name in leaders[:MOST]) + more
        reason, ways = why, ["--gripper none (gripper=()) plans for them as for other joints"]
        try:
            find_gripper(urdf, srdf, selection.tool_frame, tried)
        except NoGripper as problem:
            reason = str(problem)
        else:
            joined = ",".join(tried)
            ways.insert(0, f"--gripper {joined} (gripper={tried}) makes them one")
        reason = reason or "another gripper was named"
        yield f"fingers that are no gripper stand still ({where}): {reason}; {', '.join(ways)}"


def _palm(urdf: Urdf, joint: UrdfJoint, fingers: Sequence[UrdfJoint]) -> str:
    """The last link above a finger that no finger moves, and that a joint does."""
    names, link = {one.name for one in fingers}, joint.parent
    while link in urdf.above and (urdf.above[link].kind == "fixed" or urdf.above[link].name in names):
        link = urdf.above[link].parent
    return link


def _followers(urdf: Urdf, joints: Sequence[str]) -> list[str]:
    names = list(joints)
    for name in names:  # grows while it is read
        names += [j.name for j in urdf.joints if j.mimic is not None and j.mimic.joint == name and j.name not in names]
    return names


def _resting(joint: UrdfJoint, srdf: Srdf) -> float:
    at_home = srdf.states.get(HOME, {}).get(joint.name, at_rest(joint))
    return min(max(at_home, joint.lower), joint.upper)

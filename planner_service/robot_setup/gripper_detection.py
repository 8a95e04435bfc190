"""Finding the gripper of a robot that only a URDF describes: two fingers at the end of an arm that move oppositely.

An SRDF says which joints are fingers by its ``<end_effector>``; without one the tree of links has to leave no choice.
What is not sure is not a gripper, and there is a reason; a user can name its joints, which leaves more open.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.errors import UnknownName
from planner_service.geometry.arrays import FloatArray, Vector, vector
from planner_service.robot.end_effector.finger_loading import GripperProblem, finger_turn, gripper_of
from planner_service.robot.gripper import Gripper, reach
from planner_service.robot.kinematic_tree import LinkShape
from planner_service.robot.srdf import Srdf
from planner_service.robot.toml_reader import GripperTable
from planner_service.robot.urdf_assembly import Assembly, assemble, locked_positions
from planner_service.robot.urdf_model import Urdf, UrdfJoint

__all__ = ["FoundGripper", "NoGripper", "find_gripper"]

ALIGNED = 1e-3
"""Sine of the angle up to which axes are taken to be parallel: drawings are rounded."""

LEANING = math.sin(math.radians(10.0))
"""The same of the way from the wrist to the finger tips, which no joint defines; farther off it is not clear."""

ANY_LEANING = math.sin(math.radians(60.0))
"""The same of fingers that somebody named."""

TOUCHING = 1e-4
"""Metres between fingers with their joints at 0 up to which they are taken to touch there."""

LEAST_RANGE = 1e-3
"""Metres by which a gripper opens at least."""

CENTRED = 0.01
"""Metres from the line between the finger tips up to which a frame of the palm is taken to be the tool's."""


class NoGripper(Exception):
    """No gripper is found; the message says why."""


@dataclass(frozen=True)
class FoundGripper:
    """A gripper that was found.

    Attributes:
        table: What a robot.toml would say of it.
        tool_frame: The link whose frame is the tool's; the axes of the table are in it.
        whence: By what it was found, in words.
        standing: Joints of its palm and fingers that do not move with it, and have to be locked.
    """

    table: GripperTable
    tool_frame: str
    whence: str
    standing: tuple[str, ...] = ()


def find_gripper(
    urdf: Urdf, srdf: Srdf, tool_frame: str | None = None, joints: Sequence[str] | None = None
) -> FoundGripper:
    """The only gripper with two fingers at the end of an arm, or the one that moves by ``joints``.

    Args:
        tool_frame: The link whose frame is to be the tool's; None: one that is found.
        joints: All that its fingers move by, but for joints that mimic these; one of them alone moves a jaw against the
            palm. None: what leaves no doubt.

    Raises:
        NoGripper: that is not certain, or no gripper.
        UnknownName: there is no such joint.
    """
    tree = _Tree(urdf)
    named = []
    if joints is not None:
        (hand,) = hands = [tree.hand_of(joints)]
    else:
        hands = list(tree.hands())
        named = [hand for hand in hands if any(hand.joints & set(names) for names in srdf.end_effectors)]
        hands = named or hands
        if not hands:
            raise NoGripper("no two fingers at the end of an arm move by themselves, or one by the other")
        if len(hands) > 1:
            sets = " and ".join(",".join(one.name for one in hand.fingers if one.mimic is None) for hand in hands)
            raise NoGripper(f"there are {len(hands)} grippers ({sets}), and a robot has one")
        (hand,) = hands
    leaders = [joint.name for joint in hand.fingers if joint.mimic is None]
    arm = tuple(j.name for j in urdf.joints if j.kind != "fixed" and j.mimic is None and j.name not in leaders)
    assembly = assemble(urdf, arm, locked_positions(urdf, arm, dict.fromkeys(leaders, 0.0)))
    tilt = LEANING if joints is None else ANY_LEANING
    if all(joint.kind == "prismatic" for joint in hand.fingers):
        hold = _sliding(hand, tree, assembly, tilt)
    else:
        hold = _turning(hand, leaders, tree, assembly, tilt)
    tool = tool_frame or _tool_frame(hand, srdf, hold, assembly)
    if tool not in hand.links:
        raise NoGripper(f"the tool frame {tool} is not fixed to its palm, {hand.palm}")
    whence = f"{'an end effector of the SRDF' if named else 'two opposed fingers'} on {hand.palm}"
    whence = whence if joints is None else f"as named, on {hand.palm}"
    found = FoundGripper(hold.table(assembly.frames[tool][1]), tool, whence, hand.standing)
    closed = dict(zip(found.table.joints, found.table.closed_at or [0.0] * len(found.table.joints), strict=True))
    closing = assemble(urdf, arm, locked_positions(urdf, arm, dict.fromkeys(leaders, 0.0) | closed))
    try:
        gripper = gripper_of(found.table, urdf, closing, closing.frames[tool])
    except GripperProblem as problem:
        raise NoGripper(str(problem)) from None
    if joints is None and not _opposed(gripper):
        raise NoGripper("its fingers go the same way")
    return found


def _opposed(gripper: Gripper) -> bool:
    """Whether the tips of turning fingers go opposite ways, as sliding ones are known to."""
    if not gripper.tips:
        return True
    near, far = (gripper.turned(position) for position in gripper.positions)
    across = np.array(gripper.across)
    ways = []
    for tip in gripper.tips:
        start, end = (_middle([item for item in items if item.link == tip]) for items in (near, far))
        ways.append(float((end - start) @ across))
    return ways[0] * ways[1] < 0.0


@dataclass(frozen=True)
class _Hand:
    """Links that are fixed to each other and carry fingers.

    Attributes:
        links: These links.
        roots: The joints that begin a finger.
        fingers: All joints that move below the links, the roots included.
        standing: The names of joints below the links that do not move with the fingers.
    """

    links: tuple[str, ...]
    roots: tuple[UrdfJoint, ...]
    fingers: tuple[UrdfJoint, ...]
    standing: tuple[str, ...] = ()

    @property
    def palm(self) -> str:
        """The link that carries the first finger."""
        return self.roots[0].parent

    @property
    def joints(self) -> set[str]:
        """The names of the fingers' joints."""
        return {joint.name for joint in self.fingers}


class _Tree:
    """The links of a URDF and what is below each."""

    def __init__(self, urdf: Urdf) -> None:
        self._urdf = urdf

    def fixed_to(self, link: str) -> list[str]:
        """The link and all that is fixed to it, farther from the base."""
        links = [link]
        for name in links:  # grows while it is read
            links += [joint.child for joint in self._urdf.below[name] if joint.kind == "fixed"]
        return links

    def next_joints(self, link: str) -> list[UrdfJoint]:
        """The joints that move what is next to the links fixed to this one."""
        return [joint for name in self.fixed_to(link) for joint in self._urdf.below[name] if joint.kind != "fixed"]

    def moved_by(self, joint: UrdfJoint) -> list[UrdfJoint]:
        """The joint and all that move below it."""
        joints = [joint]
        for one in joints:  # grows while it is read
            joints += self.next_joints(one.child)
        return joints

    def hands(self) -> Iterator[_Hand]:
        """Whatever could be the hand of an arm: all that moves below it are fingers that one or two joints lead."""
        for wrist in self._urdf.joints:
            roots = [] if wrist.kind == "fixed" else self.next_joints(wrist.child)
            spinning = [root for root in roots if root.continuous and len(self.moved_by(root)) == 1]  # a motor's horn
            roots = roots if len(roots) - len(spinning) < 2 else [root for root in roots if root not in spinning]
            fingers = [joint for root in roots for joint in self.moved_by(root)]
            names = {joint.name for joint in fingers}
            leaders = sum(joint.mimic is None for joint in fingers)
            follow = all(joint.mimic is None or joint.mimic.joint in names for joint in fingers)
            if len(roots) > 1 and leaders in (1, 2) and follow and not any(joint.continuous for joint in fingers):
                still = tuple(one.name for one in spinning if one not in roots)
                yield _Hand(tuple(self.fixed_to(wrist.child)), tuple(roots), tuple(fingers), still)

    def hand_of(self, joints: Sequence[str]) -> _Hand:
        """The hand whose fingers these joints move.

        Raises:
            NoGripper: they are not at one palm.
            UnknownName: there is no such joint.
        """
        moving = {joint.name: joint for joint in self._urdf.joints if joint.kind != "fixed"}
        for name in joints:
            if name not in moving:
                raise UnknownName("joint of gripper", name, moving)
        names = set(joints)
        while more := {j.name for j in moving.values() if j.mimic is not None and j.mimic.joint in names} - names:
            names |= more
        wrists: dict[str, list[UrdfJoint]] = {}
        for name in (name for name in moving if name in names):
            way = self._above(moving[name])
            if not names & {above.name for above in way}:
                wrists.setdefault(way[0].child if way else self._urdf.root, []).append(moving[name])
        if len(wrists) != 1:
            raise NoGripper(f"{', '.join(joints)} are not on one palm, but on {' and '.join(sorted(wrists))}")
        ((palm, roots),) = wrists.items()
        below = [one for root in self.next_joints(palm) for one in self.moved_by(root)]
        fingers = tuple(one for root in roots for one in self.moved_by(root) if one.name in names)
        still = tuple(one.name for one in below if one.name not in names and one.mimic is None)
        return _Hand(tuple(self.fixed_to(palm)), tuple(roots), fingers, still)

    def _above(self, joint: UrdfJoint) -> list[UrdfJoint]:
        """The joints between one and the base that move, the nearest first."""
        chain = []
        while joint.parent in self._urdf.above:
            joint = self._urdf.above[joint.parent]
            chain += [joint] if joint.kind != "fixed" else []
        return chain


@dataclass(frozen=True)
class _Hold:
    """How a hand holds things; axes and places are in the body of the palm."""

    kind: str
    joints: tuple[str, ...]
    approach: FloatArray
    closing: FloatArray
    root: FloatArray
    middle: FloatArray
    tips: tuple[str, ...] = ()
    widths: tuple[float, float] | None = None
    closed_at: tuple[float, ...] = ()

    def table(self, tool: FloatArray) -> GripperTable:
        """The table of a robot.toml, for T_body_tool."""
        words: dict[str, object] = {"kind": self.kind, "joints": list(self.joints)}
        words |= {key: _snapped(tool[:3, :3].T @ getattr(self, key)) for key in ("approach", "closing")}
        if self.widths is not None:
            words |= {"lower": self.widths[0], "upper": self.widths[1]}
        words |= {"tips": list(self.tips)} if self.tips else {}
        words |= {"closed_at": list(self.closed_at)} if any(self.closed_at) else {}
        return GripperTable.model_validate(words)


def _sliding(hand: _Hand, tree: _Tree, assembly: Assembly, tilt: float) -> _Hold:
    """Two fingers that slide against each other, as far as each other."""
    first, second = hand.roots[0], hand.roots[-1]
    if len(hand.fingers) != 2:
        raise NoGripper(f"{len(hand.fingers)} joints slide; expected two")
    axes = [_array(finger_turn(joint, assembly).axis) for joint in (first, second)]
    shapes = [_shapes(tree.fixed_to(joint.child), assembly) for joint in (first, second)]
    if np.linalg.norm(np.cross(axes[0], axes[1])) > ALIGNED:
        raise NoGripper(f"{first.name} and {second.name} do not slide along one line")
    if not all(shapes):
        raise NoGripper("a finger has no collision shape")
    middles = [_middle(items) for items in shapes]
    side = math.copysign(1.0, float(axes[0] @ (middles[0] - middles[1])))
    closing = axes[0] * side  # from the second finger to the first
    signs = (side, -math.copysign(1.0, float(axes[1] @ closing)))  # of the ways that open
    gap = -reach(shapes[0], vector((-closing).tolist())) - reach(shapes[1], vector(closing.tolist()))
    closed = tuple(round(-sign * gap / 2.0, 7) if abs(gap) > TOUCHING else 0.0 for sign in signs)
    for joint, other in ((first, second), (second, first)):
        mimic = joint.mimic
        if mimic is not None and (mimic.multiplier != signs[0] * signs[1] or mimic.offset != 0.0 or other.mimic):
            raise NoGripper(f"{joint.name} does not follow {other.name} as far the other way")
    spans = [
        sorted(2.0 * sign * (end - at) for end in (joint.lower, joint.upper))
        for joint, sign, at in zip((first, second), signs, closed, strict=True)
    ]
    widths = max(0.0, *(low for low, _ in spans)), min(high for _, high in spans)
    wrist, middle = np.zeros(3), 0.5 * (middles[0] + middles[1])
    approach = _nearest_axis(middle - wrist, closing, assembly.frames[hand.palm][1], tilt=tilt)
    if widths[1] - widths[0] < LEAST_RANGE:
        raise NoGripper("its shapes overlap, or leave less than a millimetre, wherever its joints are")
    names = (first.name, second.name)
    return _Hold("parallel", names, approach, closing, wrist, middle, widths=_rounded(widths), closed_at=closed)


def _turning(hand: _Hand, leaders: Sequence[str], tree: _Tree, assembly: Assembly, tilt: float) -> _Hold:
    """Two fingers that turn against each other about parallel axes."""
    if any(joint.kind != "revolute" for joint in hand.fingers):
        raise NoGripper("some of its joints slide, and some turn")
    turns = {joint.name: finger_turn(joint, assembly) for joint in hand.fingers}
    axis = _array(turns[hand.roots[0].name].axis)
    tips = list(_tips(hand, tree, assembly))
    forwards: FloatArray | None = None
    if len(tips) == 1 and len(hand.roots) == 1:
        along = _middle(_shapes(tips, assembly)) - _array(turns[hand.roots[0].name].point)
        forwards = _unit(along - (along @ axis) * axis)
        tips += _counterparts(hand, forwards, assembly)
    if len(tips) != 2:
        raise NoGripper(f"{len(tips)} finger tips ({', '.join(tips) or 'none has a collision shape'}); expected two")
    if any(np.linalg.norm(np.cross(axis, _array(turn.axis))) > ALIGNED for turn in turns.values()):
        raise NoGripper("its joints do not turn about parallel axes")
    first, second = (_middle(_shapes([tip], assembly)) for tip in tips)
    middle = 0.5 * (first + second)
    root: FloatArray = sum((_array(turns[joint.name].point) for joint in hand.roots), np.zeros(3)) / len(hand.roots)
    across = first - second
    closing: FloatArray = _unit(across - (across @ axis) * axis)
    if forwards is not None:
        closing = np.asarray(np.cross(axis, forwards), dtype=np.float64)
        closing *= math.copysign(1.0, float(closing @ across))
    sideways = np.asarray(np.cross(axis, closing), dtype=np.float64)
    approach = _nearest_axis(middle - root - ((middle - root) @ axis) * axis, closing, np.eye(4), sideways, tilt=tilt)
    if abs(across @ axis) > tilt * np.linalg.norm(across):
        raise NoGripper("its finger tips are not opposite each other")
    return _Hold("revolute", tuple(leaders), approach, closing, root, middle, tips=tuple(tips))


def _counterparts(hand: _Hand, forwards: FloatArray, assembly: Assembly) -> list[str]:
    """The link of the palm that reaches as far forwards as any, against which the only jaw closes."""
    shaped = _shaped(hand.links, assembly)
    return sorted(shaped, key=lambda link: -reach(_shapes([link], assembly), vector(forwards.tolist())))[:1]


def _tips(hand: _Hand, tree: _Tree, assembly: Assembly) -> Iterator[str]:
    """The last links with shapes that most joints move, one for each last joint."""
    depths = {root.name: 1 for root in hand.roots}
    for joint in hand.fingers:  # from the palm on
        depths |= {below.name: depths[joint.name] + 1 for below in tree.next_joints(joint.child)}
    shaped = {joint.name: _shaped(tree.fixed_to(joint.child), assembly) for joint in hand.fingers}
    deepest = max((depths[name] for name, links in shaped.items() if links), default=0)
    return (links[-1] for name, links in shaped.items() if links and depths[name] == deepest)


def _tool_frame(hand: _Hand, srdf: Srdf, hold: _Hold, assembly: Assembly) -> str:
    """The SRDF's tip if the palm carries it, else the frame nearest to the middle between the tips, else the palm."""
    for tip in srdf.tips:
        if tip in hand.links:
            return tip
    far: dict[str, float] = {}
    for link in hand.links:
        away = assembly.frames[link][1][:3, 3] - hold.middle
        along = float(away @ hold.approach)
        ahead = float((assembly.frames[link][1][:3, 3] - hold.root) @ hold.approach) > 0.0
        if not _shaped([link], assembly) and ahead and np.linalg.norm(away - along * hold.approach) <= CENTRED:
            far[link] = abs(along)
    return min(far, key=far.__getitem__) if far else hand.palm


def _nearest_axis(
    way: FloatArray, closing: FloatArray, frame: FloatArray, *others: FloatArray, tilt: float
) -> FloatArray:
    """The axis of a frame, or one of the others, square to ``closing``, along which ``way`` leads but for a little."""
    square = way - (way @ closing) * closing
    for axis in others or (*frame[:3, :3].T, *np.eye(3)):
        towards = axis * math.copysign(1.0, float(axis @ square))
        towards = towards - (towards @ closing) * closing
        length = float(np.linalg.norm(towards))
        if length > 0.5 and np.linalg.norm(np.cross(square, towards / length)) <= tilt * np.linalg.norm(square):
            return towards / length
    raise NoGripper("which way its fingers point is not clear")


def _shaped(links: Iterable[str], assembly: Assembly) -> list[str]:
    having = {item.link for item in assembly.shapes}
    return [link for link in links if link in having]


def _shapes(links: Iterable[str], assembly: Assembly) -> list[LinkShape]:
    wanted = set(links)
    return [item for item in assembly.shapes if item.link in wanted]


def _middle(items: Sequence[LinkShape]) -> FloatArray:
    """The middle of the box around shapes, square to the axes of their body."""
    rows = np.eye(3).tolist()
    ends = [(reach(items, vector(row)), reach(items, vector([-x for x in row]))) for row in rows]
    return np.array([0.5 * (high - low) for high, low in ends])


def _snapped(direction: FloatArray) -> list[float]:
    """The unit vector, or the axis that it is but for rounding."""
    k = int(np.abs(direction).argmax())
    rest = np.delete(direction, k)
    if np.linalg.norm(rest) > ALIGNED:
        return [float(x) for x in _unit(direction)]
    return [math.copysign(1.0, float(direction[k])) if i == k else 0.0 for i in range(3)]


def _rounded(widths: tuple[float, float]) -> tuple[float, float]:
    """To nanometres, and inwards."""
    return math.ceil(widths[0] * 1e9 - 1e-3) / 1e9, math.floor(widths[1] * 1e9 + 1e-3) / 1e9


def _unit(direction: FloatArray) -> FloatArray:
    """The unit vector of a direction.

    Raises:
        NoGripper: there is none.
    """
    length = float(np.linalg.norm(direction))
    if not length > TOUCHING:
        raise NoGripper("its fingers, or a finger and its joint, are at one place")
    return direction / length


def _array(direction: Vector) -> FloatArray:
    return np.array(direction)

"""From a ``[gripper]`` table and a URDF to a ``Gripper``: which links its fingers move, how, and how wide it opens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from planner_service.geometry.arrays import FloatArray, Vector, product, turned, vector
from planner_service.robot.gripper import FingerTurn, Gripper, reach
from planner_service.robot.toml_reader import GripperTable
from planner_service.robot.urdf_assembly import Assembly, transform
from planner_service.robot.urdf_model import Urdf, UrdfJoint

__all__ = ["GripperProblem", "closed_positions", "finger_joints", "finger_turn", "gripper_of"]

SAMPLES = 33
"""Of the range of a leader, over which the fingers must open more and more."""
ALONG = 1e-6
"""Tolerance of the cosine between two parallel directions: about 1.4 mrad."""


class GripperProblem(Exception):
    """Something about a ``[gripper]`` that its URDF contradicts."""


def finger_joints(entry: GripperTable, urdf: Urdf) -> tuple[str, ...]:
    """The joints of a gripper, those that mimic one of them included."""
    found = list(entry.joints)
    for name in found:  # grows while it is read
        found += [j.name for j in urdf.joints if j.mimic and j.mimic.joint == name and j.name not in found]
    return tuple(found)


def closed_positions(entry: GripperTable) -> dict[str, float]:
    """Where the joints of a gripper stand when it is closed, or, of a revolute one, where its leader is at 0."""
    return dict(zip(entry.joints, entry.closed_at or [0.0] * len(entry.joints), strict=True))


def gripper_of(entry: GripperTable, urdf: Urdf, assembly: Assembly, tool: tuple[int, FloatArray]) -> Gripper:
    """The gripper; its fingers are closed in ``assembly``, or their leader is at 0 if they turn.

    Args:
        tool: The body of the tool frame, and T_body_tool.

    Raises:
        GripperProblem: it is none.
    """
    if entry.kind == "vacuum":
        return _vacuum(entry, assembly)
    if entry.kind == "revolute":
        return _revolute(entry, urdf, assembly, tool)
    return _parallel(entry, urdf, assembly, tool)


def _vacuum(entry: GripperTable, assembly: Assembly) -> Gripper:
    cup = tuple(item for item in assembly.shapes if item.link == entry.cup)
    if not cup or entry.cup is None:
        raise GripperProblem(f"gripper.cup: {entry.cup!r} is not a link with a collision shape")
    approach = vector(entry.approach)
    least = min(range(3), key=lambda k: abs(approach[k]))
    length = (1.0 - approach[least] ** 2) ** 0.5
    x, y, z = (((k == least) - approach[k] * approach[least]) / length for k in range(3))  # any direction square to it
    gripper = Gripper((), (entry.cup,), 0.0, 0.0, cup, (), approach, (x, y, z), "vacuum")
    return replace(gripper, radius=entry.radius or 0.0)


def _parallel(entry: GripperTable, urdf: Urdf, assembly: Assembly, tool: tuple[int, FloatArray]) -> Gripper:
    directions: dict[str, Vector] = {}
    fingers = {j.name: (j, _downstream(urdf, j.child)) for j in urdf.joints if j.name in entry.joints}
    for name, (joint, links) in fingers.items():
        others = [link for other, (_, far) in fingers.items() if other != name for link in far]
        axis = finger_turn(joint, assembly).axis
        sign = _opening(entry, joint, _along(axis, links, assembly) - _along(axis, others, assembly))
        directions |= dict.fromkeys(links, vector([sign * x + 0.0 for x in axis]))
    closed = tuple(item for item in assembly.shapes if item.link in directions)
    along = tuple(directions[item.link] for item in closed)
    names, links = tuple(entry.joints), tuple(directions)
    axes = vector(entry.approach), vector(entry.closing or ())
    gripper = Gripper(names, links, entry.lower or 0.0, entry.upper or 0.0, closed, along, *axes)
    _require_closing(gripper, tool)
    return gripper


def _along(axis: Vector, links: Sequence[str], assembly: Assembly) -> float:
    """Where the middle of the links' shapes is along an axis; 0 without shapes."""
    items = [item for item in assembly.shapes if item.link in links]
    back: Vector = (-axis[0], -axis[1], -axis[2])
    return 0.5 * (reach(items, axis) - reach(items, back)) if items else 0.0


def _opening(entry: GripperTable, joint: UrdfJoint, beyond: float) -> float:
    """The sign of the way in which a finger opens: the one that its range allows, else away from the others.

    Args:
        beyond: How far the finger is beyond the others along its axis, in metres.
    """
    lower, upper = entry.lower or 0.0, entry.upper or 0.0
    at = closed_positions(entry)[joint.name]
    ways = []
    for sign in (1.0, -1.0) if beyond >= 0.0 else (-1.0, 1.0):
        ends = sorted((at + sign * lower / 2.0, at + sign * upper / 2.0))
        if ends[0] >= joint.lower - ALONG and ends[1] <= joint.upper + ALONG:
            ways.append(sign)
    if not ways:
        place = f"[{joint.lower:g}, {joint.upper:g}]"
        raise GripperProblem(f"gripper: [{lower:g}, {upper:g}] needs {joint.name} beyond {place}")
    return ways[0]


def _require_closing(gripper: Gripper, tool: tuple[int, FloatArray]) -> None:
    """Refuse a closing axis along which the fingers do not move."""
    axis = turned(gripper.closing, tool[1])
    for item, (u, v, w) in zip(gripper.closed, gripper.directions, strict=True):
        if item.body == tool[0] and abs(abs(u * axis[0] + v * axis[1] + w * axis[2]) - 1.0) > ALONG:
            columns = tool[1][:3, :3].T.tolist()
            in_tool = ", ".join(f"{a * u + b * v + c * w:.3g}" for a, b, c in columns)
            moves = f"{item.link} moves along [{in_tool}] of the tool frame"
            raise GripperProblem(f"gripper.closing = {list(gripper.closing)}; {moves}")


def _revolute(entry: GripperTable, urdf: Urdf, assembly: Assembly, tool: tuple[int, FloatArray]) -> Gripper:
    turns = dict(_chains(entry, urdf, assembly))
    links = tuple(turns)
    closed = tuple(item for item in assembly.shapes if item.link in turns)
    shaped = {item.link for item in assembly.shapes if item.body == tool[0]}
    missing = [tip for tip in entry.tips if tip not in shaped]
    if missing:
        raise GripperProblem(f"gripper.tips: {missing[0]!r} is not a link with a shape on the body of the tool frame")
    leader = next(joint for joint in urdf.joints if joint.name == entry.joints[0])
    still = [item for item in assembly.shapes if item.link in entry.tips and item.link not in turns]
    gripper = Gripper(
        joints=tuple(entry.joints),
        links=(*links, *dict.fromkeys(item.link for item in still)),
        lower=0.0,
        upper=0.0,
        closed=(*closed, *still),
        directions=(),
        approach=vector(entry.approach),
        closing=vector(entry.closing or ()),
        kind="revolute",
        turns=(*(turns[item.link] for item in closed), *(() for _ in still)),
        tips=tuple(entry.tips),
        across=turned(vector(entry.closing or ()), tool[1]),
    )
    return _ranged(gripper, entry, (leader.lower, leader.upper))


def _ranged(gripper: Gripper, entry: GripperTable, ends: tuple[float, float]) -> Gripper:
    """The gripper with its widths: those of the table, within those that the leader's range gives."""
    x, y, z = gripper.across
    turned = replace(gripper, across=(-x, -y, -z))
    gripper = max(gripper, turned, key=lambda one: max(one.gap(end) for end in ends))
    shut, open_ = sorted(ends, key=gripper.gap)
    gaps = [gripper.gap(shut + (open_ - shut) * k / (SAMPLES - 1)) for k in range(SAMPLES)]
    widest = max(range(SAMPLES), key=gaps.__getitem__)
    if SAMPLES // 4 <= widest < SAMPLES - 1:  # a jaw that turns on comes nearer again, seen along the closing axis
        open_ = shut + (open_ - shut) * widest / (SAMPLES - 1)
        gaps = [gripper.gap(shut + (open_ - shut) * k / (SAMPLES - 1)) for k in range(SAMPLES)]
    if any(b <= a for a, b in pairwise(gaps) if b > 0.0):
        first, second = gripper.tips
        raise GripperProblem(
            f"gripper: the gap between {first} and {second} along closing = {_axis(gripper)} is "
            f"{gaps[0]:.4f} m with {gripper.joints[0]} at {shut:.4g} and {gaps[-1]:.4f} m at {open_:.4g}, and does not "
            "grow all the way; name other tips, or another closing axis"
        )
    least, most = max(gaps[0], 0.0), gaps[-1]
    if most <= 0.0:
        first, second = gripper.tips
        raise GripperProblem(f"gripper: {first} and {second} overlap along closing = {_axis(gripper)} everywhere")
    lower, upper = least if entry.lower is None else entry.lower, most if entry.upper is None else entry.upper
    if not least - ALONG <= lower < upper <= most + ALONG:
        raise GripperProblem(f"gripper: lower {lower:g}, upper {upper:g}; its joints reach {least:.6g} to {most:.6g} m")
    whole = replace(gripper, lower=gaps[0], upper=gaps[-1], positions=(shut, open_))
    return replace(whole, lower=lower, upper=upper, positions=(whole.position(lower), whole.position(upper)))


def _axis(gripper: Gripper) -> str:
    """The closing axis, to four digits."""
    return str([round(x, 4) for x in gripper.closing])


def _chains(entry: GripperTable, urdf: Urdf, assembly: Assembly) -> Iterator[tuple[str, tuple[FingerTurn, ...]]]:
    """The links that fingers move, and the joints between palm and each."""
    ratios = dict(_ratios(entry, urdf))

    def first(joint: UrdfJoint) -> bool:
        link = joint.parent
        while link in urdf.above:
            if urdf.above[link].name in ratios:
                return False
            link = urdf.above[link].parent
        return True

    waiting = [(joint, ()) for joint in urdf.joints if joint.name in ratios and first(joint)]
    chains: list[tuple[UrdfJoint, tuple[FingerTurn, ...]]] = list(waiting)
    for joint, before in chains:  # grows while it is read
        turns = before
        if joint.name in ratios:
            turns = (*before, finger_turn(joint, assembly, ratios[joint.name]))
        yield joint.child, turns
        chains += [(child, turns) for child in urdf.below[joint.child]]


def _ratios(entry: GripperTable, urdf: Urdf) -> Iterator[tuple[str, float]]:
    """How far each finger joint moves per radian of the leader."""
    known = dict.fromkeys(entry.joints, 1.0)
    joints = {joint.name: joint for joint in urdf.joints}
    for name in finger_joints(entry, urdf):
        mimic = joints[name].mimic
        if name not in known and mimic is not None:
            known[name] = mimic.multiplier * known[mimic.joint]
        yield name, known[name]


def finger_turn(joint: UrdfJoint, assembly: Assembly, ratio: float = 1.0) -> FingerTurn:
    """The axis of a finger's joint, and a point on it, in the body of the palm."""
    T = product(assembly.frames[joint.parent][1], transform(joint.xyz, joint.rpy))
    return FingerTurn(turned(joint.axis, T), vector(T[:3, 3].tolist()), ratio)


def _downstream(urdf: Urdf, link: str) -> Sequence[str]:
    links = [link]
    for parent in links:  # grows while it is read
        links += [joint.child for joint in urdf.below[parent]]
    return links

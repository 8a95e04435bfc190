"""What must hold along a whole motion: where a tool is and how it is turned, and ranges of joints.

There is one general value, ``ToolRegion``; the short forms, such as ``KeepUpright(...)``, are functions that make one.
All tolerances are positive: a motion is made of straight lines and blends in joint space, which keep to a curved
surface only nearly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import Vector, cross_of, dot, set_fields, vector
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import MAX_LENGTH, checked_name, finite_tuple, instance, items, number, numbers

__all__ = [
    "MAX_CONSTRAINTS",
    "MAX_JOINT",
    "MIN_ANGLE",
    "MIN_LENGTH",
    "Constraint",
    "InBox",
    "JointRange",
    "KeepOrientation",
    "KeepUpright",
    "OnLine",
    "OnPlane",
    "RelativePose",
    "ToolRegion",
    "checked_constraints",
    "constraint_names",
]

MAX_CONSTRAINTS = 16
"""Of one motion."""

MIN_LENGTH, MIN_ANGLE = 1e-4, 1e-3
"""The least tolerance: metres and radians either way."""

MAX_JOINT = 1e6
"""Radians or metres of a joint either way."""

MAX_TURN_TILT = math.pi / 2
"""Radians: beyond it a turn about the axis means little."""

Z: Vector = (0.0, 0.0, 1.0)
BASE = Pose()
A_LINK = "the name of a link, "


@dataclass(frozen=True)
class ToolRegion:
    """A task space region in which a frame of the robot stays (Berenson, Srinivasa & Kuffner, IJRR 30(12), 2011).

    The constrained frame is measured in ``frame``: its origin by coordinates along the axes of ``frame``; its
    orientation by how far its z axis leans from that of ``frame`` (tilt), and by how far it is turned about that axis
    (turn, the twist of the swing-twist decomposition). With no tilt and no turn the two have the same orientation.

    Attributes:
        frame: Pose of the region, in the base frame or in that of the link ``relative_to``.
        lower: Least coordinates (x, y, z) of the constrained frame's origin in ``frame``, metres; -inf for no bound.
        upper: Largest coordinates; inf for no bound.
        tilt: Radians between the two z axes at most; None for any.
        turn: Radians of turn about the axis at most, either way; None for any. It needs a ``tilt`` up to pi / 2.
        tool: Pose of the constrained frame in the frame of ``link``.
        link: The link that carries the constrained frame; None for the tool frame.
        relative_to: The link that carries ``frame``; None for the base.
        name: What messages call it.

    Raises:
        InvalidRequest: A number is not one, a position is farther than 1 km, bounds are reversed or closer than 0.2 mm,
            an angle is not from 0.001 to pi, nothing is bounded, or a name is not 1 to 64 printable characters.
    """

    frame: Pose = BASE
    lower: Vector = (-math.inf, -math.inf, -math.inf)
    upper: Vector = (math.inf, math.inf, math.inf)
    tilt: float | None = None
    turn: float | None = None
    tool: Pose = BASE
    link: str | None = None
    relative_to: str | None = None
    name: str = "tool region"

    def __post_init__(self) -> None:
        for field in ("frame", "tool"):
            position = instance(field, getattr(self, field), Pose, "a Pose").position
            if max(map(abs, position)) > MAX_LENGTH:
                raise InvalidRequest(
                    f"position of {field}", position, f"metres, at most {MAX_LENGTH:g} along each axis"
                )
        for field in ("link", "relative_to"):
            if getattr(self, field) is not None:
                checked_name(field, getattr(self, field), A_LINK)
        checked_name("name", self.name)
        lower, upper = _coordinates("lower", self.lower), _coordinates("upper", self.upper)
        for k, (low, high) in enumerate(zip(lower, upper, strict=True)):
            if not high - low >= 2.0 * MIN_LENGTH:
                raise InvalidRequest(
                    f"upper[{k}]", high, f"at least lower[{k}] + {2e3 * MIN_LENGTH:g} mm, lower = {low:g}"
                )
        set_fields(self, lower=lower, upper=upper)
        for field in ("tilt", "turn"):
            if getattr(self, field) is not None:
                expected = f"radians in [{MIN_ANGLE:g}, pi], or None"
                set_fields(self, **{field: number(field, getattr(self, field), expected, MIN_ANGLE, math.pi)})
        if self.turn is not None and (self.tilt is None or self.tilt > MAX_TURN_TILT):
            raise InvalidRequest("tilt", self.tilt, "radians up to pi / 2, as there is a bound on the turn")
        if self.tilt is None and not any(map(math.isfinite, (*lower, *upper))):
            raise InvalidRequest("upper", upper, "a bound on a coordinate, or a tilt: nothing is bounded")

    @property
    def meant(self) -> str:
        """The link that carries the constrained frame, in words."""
        return "tool" if self.link is None else self.link


def KeepUpright(
    tool_axis: Sequence[float], tolerance: float, link: str | None = None, up: Sequence[float] = Z
) -> ToolRegion:
    """An axis of the tool points up, within ``tolerance`` radians; any heading.

    Args:
        tool_axis: The axis, in the frame of ``link``; any length.
        tolerance: Radians between it and ``up`` at most.
        link: The link that carries it; None for the tool frame.
        up: Where up is in the base frame; any length.

    Raises:
        InvalidRequest: An axis is not three numbers or has no length, or the tolerance is not from 0.001 to pi.
    """
    frame, tool = (Pose(quaternion=_onto(_unit(k, v))) for k, v in (("up", up), ("tool_axis", tool_axis)))
    return ToolRegion(frame, tilt=_angle("tolerance", tolerance), tool=tool, link=link, name="upright")


def KeepOrientation(orientation: Pose, tolerance: float, link: str | None = None) -> ToolRegion:
    """The orientation stays within ``tolerance``: tilt and turn about z at most that many radians each.

    Args:
        orientation: A pose whose orientation in the base frame is kept; its position does not matter.
        tolerance: Radians.
        link: The link that is meant; None for the tool frame.

    Raises:
        InvalidRequest: Not a Pose, or the tolerance is not from 0.001 to pi / 2.
    """
    frame = Pose(quaternion=instance("orientation", orientation, Pose, "a Pose").quaternion)
    angle = _angle("tolerance", tolerance, MAX_TURN_TILT)
    return ToolRegion(frame, tilt=angle, turn=angle, link=link, name="orientation")


def OnPlane(
    frame: Pose, tolerance: float, point: Sequence[float] = (0.0, 0.0, 0.0), link: str | None = None
) -> ToolRegion:
    """A point stays on the plane z = 0 of ``frame``, within ``tolerance`` metres.

    Args:
        frame: Pose of the plane in the base frame.
        tolerance: Metres.
        point: The point, in the frame of ``link``.
        link: The link that carries the point; None for the tool frame.

    Raises:
        InvalidRequest: Not a Pose, not three numbers, or the tolerance is below 0.1 mm.
    """
    t, tool = _length("tolerance", tolerance), Pose(vector(finite_tuple("point", point, 3)))
    inf = math.inf
    return ToolRegion(frame, (-inf, -inf, -t), (inf, inf, t), tool=tool, link=link, name="plane")


def OnLine(
    start: Sequence[float],
    end: Sequence[float],
    tolerance: float,
    point: Sequence[float] = (0.0, 0.0, 0.0),
    link: str | None = None,
) -> ToolRegion:
    """A point stays on the line between two points, within ``tolerance`` metres along and across each of its axes.

    Args:
        start: Where the line begins, in the base frame.
        end: Where it ends.
        tolerance: Metres.
        point: The point that stays on it, in the frame of ``link``.
        link: The link that carries the point; None for the tool frame.

    Raises:
        InvalidRequest: Not three numbers, two ends that coincide, or a tolerance below 0.1 mm.
    """
    a, b = (vector(finite_tuple(field, given, 3)) for field, given in (("start", start), ("end", end)))
    if not math.dist(a, b) > 0.0:
        raise InvalidRequest("end", end, f"another point than start = {a}")
    t, tool = _length("tolerance", tolerance), Pose(vector(finite_tuple("point", point, 3)))
    along = _unit("end", (b[0] - a[0], b[1] - a[1], b[2] - a[2]))
    upper = (t, t, math.dist(a, b) + t)
    return ToolRegion(Pose(a, _onto(along)), (-t, -t, -t), upper, tool=tool, link=link, name="line")


def InBox(
    frame: Pose, size: Sequence[float], point: Sequence[float] = (0.0, 0.0, 0.0), link: str | None = None
) -> ToolRegion:
    """A point stays in a box.

    Args:
        frame: Pose of the box's centre in the base frame.
        size: Lengths (x, y, z) along the axes of ``frame``, metres; inf for no bound.
        point: The point, in the frame of ``link``.
        link: The link that carries the point; None for the tool frame.

    Raises:
        InvalidRequest: Not a Pose, not three numbers, or a length below 0.2 mm.
    """
    half = [length / 2.0 for length in _coordinates("size", size)]
    for k, h in enumerate(half):
        if h < MIN_LENGTH:
            raise InvalidRequest(f"size[{k}]", 2.0 * h, f"at least {2e3 * MIN_LENGTH:g} mm")
    tool = Pose(vector(finite_tuple("point", point, 3)))
    return ToolRegion(frame, vector([-h for h in half]), vector(half), tool=tool, link=link, name="box")


def RelativePose(
    link: str, relative_to: str, pose: Pose, position_tolerance: float, angle_tolerance: float
) -> ToolRegion:
    """One link keeps its pose in the frame of another: a tray held by both hands.

    Args:
        link: The link that keeps it.
        relative_to: The link in whose frame.
        pose: The pose to keep, of ``link`` in the frame of ``relative_to``.
        position_tolerance: Metres along each axis.
        angle_tolerance: Radians of tilt and of turn about z.

    Raises:
        InvalidRequest: A name is not 1 to 64 printable characters, not a Pose, or a tolerance is below 0.1 mm or 0.001.
    """
    t = _length("position_tolerance", position_tolerance)
    angle = _angle("angle_tolerance", angle_tolerance, MAX_TURN_TILT)
    checked_name("link", link, A_LINK)
    checked_name("relative_to", relative_to, A_LINK)
    lower, upper = (-t, -t, -t), (t, t, t)
    return ToolRegion(pose, lower, upper, angle, angle, link=link, relative_to=relative_to, name="relative pose")


@dataclass(frozen=True)
class JointRange:
    """A joint stays in a range narrower than its limits.

    Attributes:
        joint: Its name.
        lower: Radians, or metres for a prismatic joint.
        upper: Likewise; above ``lower``.

    Raises:
        InvalidRequest: The name is not 1 to 64 printable characters, a bound is not a number up to 1e6, or they
            are reversed.
    """

    joint: str
    lower: float
    upper: float

    def __post_init__(self) -> None:
        checked_name("joint", self.joint, "the name of a joint, ")
        expected = f"radians or metres, up to {MAX_JOINT:g} either way"
        lower, upper = (
            number(field, getattr(self, field), expected, -MAX_JOINT, MAX_JOINT) for field in ("lower", "upper")
        )
        if not lower + MIN_ANGLE <= upper:
            raise InvalidRequest("upper", upper, f"at least {MIN_ANGLE:g} above lower = {lower:g}")
        set_fields(self, lower=lower, upper=upper)


Constraint = ToolRegion | JointRange


def checked_constraints(value: object) -> tuple[Constraint, ...]:
    """What a field called constraints was given, if these are constraints.

    Raises:
        InvalidRequest: It is no sequence of at most 16 of them.
    """
    expected = "constraints such as KeepUpright(...)"
    return items("constraints", value, (ToolRegion, JointRange), expected, MAX_CONSTRAINTS)


def constraint_names(constraints: Sequence[Constraint]) -> str:
    """What they are called, as part of a sentence."""
    names = (c.joint if isinstance(c, JointRange) else c.name for c in constraints)
    return ", ".join(dict.fromkeys(names))


def _coordinates(field: str, values: Sequence[float]) -> Vector:
    """Three numbers, which may be infinite."""
    expected = "three numbers (x, y, z)"
    array = numbers(field, values, expected)
    if array.shape != (3,):
        raise InvalidRequest(field, values, expected)
    listed = enumerate(array.tolist())
    x, y, z = (number(f"{field}[{k}]", value, "metres, or inf", -math.inf, math.inf) for k, value in listed)
    for value in (x, y, z):
        if math.isfinite(value) and abs(value) > MAX_LENGTH:
            raise InvalidRequest(field, values, f"metres up to {MAX_LENGTH:g}, or inf")
    return (x, y, z)


def _angle(field: str, value: float, most: float = math.pi) -> float:
    return number(field, value, f"radians in [{MIN_ANGLE:g}, {most:.4g}]", MIN_ANGLE, most)


def _length(field: str, value: float) -> float:
    return number(field, value, f"metres in [{MIN_LENGTH:g}, {MAX_LENGTH:g}]", MIN_LENGTH, MAX_LENGTH)


def _unit(field: str, values: Sequence[float]) -> Vector:
    v = vector(finite_tuple(field, values, 3))
    length = math.sqrt(dot(v, v))
    if not 1e-9 < length < math.inf:
        raise InvalidRequest(field, values, "three numbers (x, y, z) that are not all 0")
    return (v[0] / length, v[1] / length, v[2] / length)


def _onto(axis: Vector) -> tuple[float, float, float, float]:
    """The shortest rotation that takes z to a unit axis, as a quaternion."""
    if axis[2] < -1.0 + 1e-12:
        return (0.0, 1.0, 0.0, 0.0)
    x, y, z = cross_of(Z, axis)
    w = 1.0 + axis[2]
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return (w / norm, x / norm, y / norm, z / norm)

"""robot.toml: what each of its keys is, and what the keys have to be to each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName, shown
from planner_service.files import schema
from planner_service.files.package_data import data_folder
from planner_service.files.schema import FirstOnly, Record, at_most
from planner_service.files.toml_reader import read_tables
from planner_service.presentation.measures import outside_text
from planner_service.robot.model import AllowedContact, ExemptRetreat
from planner_service.robot.package_files import package_folder

__all__ = ["GripperTable", "RobotFile", "RobotTable", "read_robot_file"]

MAX_BYTES = 1_000_000
"""A robot.toml has a few kilobytes."""

MAX_TABLES = 10_000
"""Allowed contacts, and retreats: a robot of a hundred links has some 5,000 pairs."""

MAX_NUMBER = 1e9
"""Larger numbers than this are no angle, length, velocity, acceleration or jerk."""

MAX_SHOWN = 20
"""Names of poses that a problem lists."""

PACKAGE = "package://"

AXIS_SLACK = 1e-6
"""By which an axis may be longer or shorter than 1, and lean from a right angle."""


# Kinds of values.


def _not_blank(text: str) -> str:
    if not text.strip():
        raise ValueError("a text")
    return text


def _moderate(value: float) -> float:
    if abs(value) > MAX_NUMBER:
        raise ValueError(f"a number from -{MAX_NUMBER:g} to {MAX_NUMBER:g}")
    return value


def _moderate_all(values: list[float]) -> list[float]:
    return [_moderate(value) for value in values]


def _different(names: list[str]) -> list[str]:
    if not names or not all(names) or len(set(names)) != len(names):
        raise ValueError("one or more different names")
    return names


def _two_links(names: list[str]) -> list[str]:
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise ValueError("two different link names")
    return names


def _unit(axis: list[float]) -> list[float]:
    if abs(math.hypot(*axis) - 1.0) > AXIS_SLACK:
        raise ValueError(f"a unit vector in the tool frame; its length is {math.hypot(*axis):g}")
    return axis


def _with_home(poses: dict[str, Any]) -> dict[str, Any]:
    if "home" not in poses:
        raise ValueError("a pose named 'home' among them")
    return poses


PER_JOINT = "a list of one number for each joint"
Sentence = Annotated[str, AfterValidator(_not_blank), Field(description="a text")]
Number = Annotated[float, AfterValidator(_moderate)]
Distance = Annotated[float, Field(ge=0.0, le=MAX_NUMBER, description=f"a number from 0 to {MAX_NUMBER:g}")]
Positions = Annotated[schema.Joints, AfterValidator(_moderate_all), Field(description=PER_JOINT)]
Rate = Annotated[float, Field(gt=0.0, le=MAX_NUMBER)]
Rates = Annotated[list[Rate], schema.ONE_PER_JOINT, at_most(MAX_TABLES), Field(description=PER_JOINT)]
Names = Annotated[list[str], FirstOnly(), AfterValidator(_different), Field(description="one or more different names")]
LinkPair = Annotated[list[str], FirstOnly(), AfterValidator(_two_links), Field(description="two different link names")]
XYZ = schema.of_length(3, "3 finite numbers")
Axis = Annotated[schema.Numbers, XYZ, AfterValidator(_unit), Field(description="[x, y, z]")]


# Tables.


class PositionTable(Record):
    """``[limits.position]``: radians or metres, one number for each joint."""

    lower: Positions
    upper: Positions
    source: Sentence


class RateTable(Record):
    """``[limits.velocity]``, and those of acceleration and jerk."""

    values: Rates
    source: Sentence


class LimitsTable(Record):
    """``[limits]``."""

    position: PositionTable = Field(description="a table")
    velocity: RateTable = Field(description="a table")
    acceleration: RateTable = Field(description="a table")
    jerk: RateTable = Field(description="a table")


WIDTH = Field(None, description=f"a number from 0 to {MAX_NUMBER:g}")


class GripperTable(Record):
    """``[gripper]``: widths in metres, axes as unit vectors in the tool frame; ``width`` is ``upper`` if not given.

    A parallel one has ``joints``, ``lower``, ``upper`` and ``closing``, and ``closed_at``, the positions of the joints
    at width 0, if these are not 0; a revolute one ``joints`` (the leader first), ``tips`` and ``closing``; a vacuum
    gripper ``cup`` and ``radius``.
    """

    kind: Literal["parallel", "revolute", "vacuum"] = "parallel"
    joints: Annotated[Names, Field(default_factory=list)]
    closed_at: Annotated[list[float], Field(default_factory=list, description="one number for each of joints")]
    tips: Annotated[list[str], Field(default_factory=list, description="two different link names")]
    cup: str | None = Field(None, description="a link name")
    radius: Distance | None = WIDTH
    lower: Distance | None = WIDTH
    upper: Distance | None = WIDTH
    width: Distance | None = WIDTH
    approach: Axis
    closing: Axis | None = Field(None, description="[x, y, z]")


class CylinderTable(Record):
    """``cylinder``: a cylinder about z."""

    radius: Distance
    length: Distance


class ToolShapeTable(Record):
    """``[[tool.shape]]``: a box, cylinder or sphere; position and roll, pitch and yaw in the frame of the link."""

    box: Annotated[schema.Numbers, XYZ] | None = Field(None, description="[x, y, z]")
    cylinder: CylinderTable | None = Field(None, description="a table")
    sphere: Distance | None = WIDTH
    position: Annotated[schema.Numbers, XYZ] = Field(default_factory=lambda: [0.0, 0.0, 0.0], description="[x, y, z]")
    rpy: Annotated[schema.Numbers, XYZ] = Field(default_factory=lambda: [0.0, 0.0, 0.0], description="[x, y, z]")


class ToolTable(Record):
    """``[tool]``: a link that the URDF does not have, fixed to one of its links, and the frame of its working point.

    ``position`` and ``rpy`` place the link in its parent, ``tip`` the frame ``frame`` in the link.
    """

    link: Sentence
    parent: Sentence
    frame: Sentence
    tip: Annotated[schema.Numbers, XYZ] = Field(default_factory=lambda: [0.0, 0.0, 0.0], description="[x, y, z]")
    position: Annotated[schema.Numbers, XYZ] = Field(default_factory=lambda: [0.0, 0.0, 0.0], description="[x, y, z]")
    rpy: Annotated[schema.Numbers, XYZ] = Field(default_factory=lambda: [0.0, 0.0, 0.0], description="[x, y, z]")
    shape: Annotated[list[ToolShapeTable], at_most(MAX_TABLES)] = Field([], description="an array of tables")


class ContactTable(Record):
    """``[[allowed_contacts]]``."""

    makes = AllowedContact

    links: LinkPair
    reason: Sentence


class RetreatTable(Record):
    """``[[retreat]]``."""

    makes = ExemptRetreat

    pose: Sentence
    to: Positions
    pairs: Annotated[list[LinkPair], FirstOnly(), Field(min_length=1, description="one or more pairs of link names")]
    reason: Sentence


class RobotTable(Record):
    """A robot.toml. Names of links and joints are not compared with the URDF yet.

    A file may begin with ``base = "NAME"``: what it does not say is as in that robot of this package.

    ``continuous`` names joints that turn without end; their limits in the file are what one search looks at.
    ``decompose`` names links whose meshes are cut into convex pieces, and how many of each at most.
    """

    name: Sentence
    urdf: Sentence
    packages: Names | None = Field(None, description="one or more different names")
    joints: Names
    continuous: Annotated[list[str], Field(default_factory=list, description="a list of names of joints")]
    tool_frame: Sentence
    base_links: Names
    inverse_kinematics: Literal["numeric", "wxai"] = "numeric"
    settle_time: Distance = 0.0
    poses: Annotated[dict[str, Positions], AfterValidator(_with_home), Field(description="a table")]
    limits: LimitsTable = Field(description="a table")
    locked_joints: dict[str, Number] = Field({}, description="a table")
    decompose: dict[str, Annotated[int, Field(ge=1)]] = Field({}, description="a table")
    tool: ToolTable | None = Field(None, description="a table")
    gripper: GripperTable | None = Field(None, description="a table")
    allowed_contacts: Annotated[list[ContactTable], at_most(MAX_TABLES)] = Field([], description="an array of tables")
    retreat: Annotated[list[RetreatTable], at_most(MAX_TABLES)] = Field([], description="an array of tables")


@dataclass(frozen=True)
class RobotFile:
    """A robot.toml and where the files are that it names.

    Attributes:
        package_dirs: Folders of installed packages in which the URDF and meshes may lie, beside the robot's own.
    """

    table: RobotTable
    urdf: Path
    package_dirs: tuple[Path, ...]


def read_robot_file(path: Path) -> RobotFile:
    """The contents of a robot.toml that does not contradict itself.

    Raises:
        InvalidFile: with every problem found; those of single keys first, those between keys once each key is right.
        MissingDependency: its files come with a package that is not installed, but which an extra would bring.
    """
    document, folder = _with_base(path, read_tables(path, MAX_BYTES))
    joints = document.get("joints")
    reading = schema.Reading(joints=len(joints) if isinstance(joints, list) else None)
    table = schema.read_record(RobotTable, document, path, reading)
    problems = list(_contradictions(table))
    packages: dict[str, Path] = {}
    for name in table.packages or ():
        try:
            packages[name] = package_folder(name)
        except LookupError as error:  # unknown, too
            problems.append(f"packages: {error}")
    urdf = path
    try:
        urdf = _urdf_path(table.urdf, folder, packages)
    except InvalidRequest as error:
        problems.append(str(error))
    if problems:
        raise InvalidFile(path, problems)
    return RobotFile(table, urdf, tuple(packages.values()))


def _with_base(path: Path, document: dict[str, Any]) -> tuple[dict[str, Any], Path]:
    """A robot.toml with the keys of the one that it is based on, its own before these, and the folder of its URDF."""
    own = path.resolve().parent
    if "base" not in document:
        return document, own
    known = sorted(file.parent.name for file in data_folder("robots").glob("*/robot.toml"))
    base = document.pop("base")
    if base not in known:
        raise InvalidFile(path, [str(UnknownName("robot of base", base, known))])
    folder = (data_folder("robots") / base).resolve()
    above = read_tables(folder / "robot.toml", MAX_BYTES)
    if "base" in above:
        raise InvalidFile(path, [f"base: {base!r} has a base itself; expected one that has none"])
    return above | document, own if "urdf" in document else folder


def _urdf_path(text: str, own: Path, packages: Mapping[str, Path]) -> Path:
    """The file beside robot.toml, or ``package://name/rest``: ``rest`` in the folder of a package named in it."""
    folder, tail, whose = own, text, "in the robot's folder"
    if text.startswith(PACKAGE):
        name, _, tail = text[len(PACKAGE) :].partition("/")
        if name not in packages:
            raise InvalidRequest("urdf", text, f"a package that is listed in packages, which {name!r} is not")
        folder, whose = packages[name], f"in the folder of package {name!r}"
    try:
        urdf = (folder / tail).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a NUL character, or a circle of links
        raise InvalidRequest("urdf", text, f"a path; {error}") from None
    if not urdf.is_relative_to(folder):
        raise InvalidRequest("urdf", text, f"a path {whose}")
    return urdf


def _contradictions(robot: RobotTable) -> Iterator[str]:
    """What is wrong between keys that are right on their own."""
    lower, upper = robot.limits.position.lower, robot.limits.position.upper
    for joint, low, high in zip(robot.joints, lower, upper, strict=True):
        if low >= high:
            yield f"limits.position: {joint} has lower {low:g}, upper {high:g}; expected lower < upper"
    named = [(f"poses.{name}", q) for name, q in robot.poses.items()]
    named += [(f"retreat[{k}].to", retreat.to) for k, retreat in enumerate(robot.retreat)]
    for where, q in named:
        for joint, value, low, high in zip(robot.joints, q, lower, upper, strict=True):
            if not low <= value <= high:
                yield f"{where}: {joint} = {outside_text(value, low, high)}"
    known = ", ".join([shown(name)[1:-1] for name in list(robot.poses)[:MAX_SHOWN]])
    known += ", ..." if len(robot.poses) > MAX_SHOWN else ""
    for k, retreat in enumerate(robot.retreat):
        if retreat.pose not in robot.poses:
            yield f"retreat[{k}].pose: got {shown(retreat.pose)}; expected one of {known}"
    if robot.gripper is not None:
        yield from _gripper_contradictions(robot.gripper)


NEEDED = {
    "parallel": ("joints", "lower", "upper", "closing"),
    "revolute": ("joints", "tips", "closing"),
    "vacuum": ("cup", "radius"),
}
"""What a gripper of each kind has to have; what another kind needs and it does not, it must not have."""
OPTIONAL = {"parallel": ("width", "closed_at"), "revolute": ("lower", "upper", "width"), "vacuum": ()}


def _gripper_contradictions(gripper: GripperTable) -> Iterator[str]:
    needed, kind = NEEDED[gripper.kind], gripper.kind
    yield from (f"gripper.{key} is missing; a {kind} gripper needs it" for key in needed if not _given(gripper, key))
    others = {key for keys in (*NEEDED.values(), *OPTIONAL.values()) for key in keys} - {*needed, *OPTIONAL[kind]}
    yield from (f"gripper.{key}: a {kind} gripper has none" for key in sorted(others) if _given(gripper, key))
    if gripper.tips and (len(gripper.tips) != 2 or gripper.tips[0] == gripper.tips[1]):
        yield f"gripper.tips: got {shown(gripper.tips)}; expected two different link names"
    if gripper.closed_at and len(gripper.closed_at) != len(gripper.joints):
        yield f"gripper.closed_at: got {shown(gripper.closed_at)}; expected {len(gripper.joints)} numbers, as of joints"
    lower, upper, approach, closing = gripper.lower, gripper.upper, gripper.approach, gripper.closing
    width = upper if gripper.width is None else gripper.width
    stated = lower is not None and upper is not None and width is not None
    if stated and (not lower <= width <= upper or lower >= upper):  # type: ignore[operator]
        yield f"gripper: lower {lower:g}, width {width:g}, upper {upper:g}; expected lower <= width <= upper"
    if closing is not None and abs(math.fsum(a * b for a, b in zip(approach, closing, strict=True))) > AXIS_SLACK:
        yield f"gripper: approach {approach} and closing {closing}; expected a right angle between them"


def _given(gripper: GripperTable, key: str) -> bool:
    return getattr(gripper, key) not in (None, [])

"""robot.toml: a robot as data, read strictly, with every problem named at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planner_service.errors import InvalidFile, shown
from planner_service.files.toml_reader import read_tables
from planner_service.robot.package_files import package_folder

__all__ = ["GripperEntry", "RetreatEntry", "RobotFile", "read_robot_file"]

MAX_BYTES = 1_000_000

MAX_SHOWN = 20
"""Names of poses that a problem lists."""
"""A robot.toml has a few kilobytes."""
PACKAGE = "package://"
AXIS_SLACK = 1e-6
"""By which an axis may be longer or shorter than 1, and lean from a right angle."""
LIMIT_KINDS = ("velocity", "acceleration", "jerk")

Numbers = tuple[float, ...]
Pair = tuple[str, str]


@dataclass(frozen=True)
class GripperEntry:
    """The ``[gripper]`` table; widths in metres, axes as unit vectors in the tool frame."""

    joints: tuple[str, ...]
    lower: float
    upper: float
    width: float
    approach: tuple[float, float, float]
    closing: tuple[float, float, float]


@dataclass(frozen=True)
class RetreatEntry:
    """One ``[[retreat]]`` table."""

    pose: str
    to: Numbers
    pairs: tuple[Pair, ...]
    reason: str


@dataclass(frozen=True)
class RobotFile:
    """What a robot.toml says; names of links and joints of the URDF are not checked yet.

    Attributes:
        decompose: Links whose meshes are cut into convex pieces, and how many of each at most.
        package_dirs: Folders of installed packages in which the URDF and meshes may lie, beside the robot's own.
    """

    path: Path
    name: str
    urdf: Path
    package_dirs: tuple[Path, ...]
    decompose: Mapping[str, int]
    joints: tuple[str, ...]
    tool_frame: str
    base_links: tuple[str, ...]
    inverse: str
    settle_time: float
    poses: Mapping[str, Numbers]
    limits: Mapping[str, Numbers]
    locked: Mapping[str, float]
    gripper: GripperEntry | None
    allowed: tuple[tuple[Pair, str], ...]
    retreats: tuple[RetreatEntry, ...]


def read_robot_file(path: Path) -> RobotFile:
    """The contents of a robot.toml whose shape is right.

    Raises:
        InvalidFile: with every problem found.
        MissingDependency: its files come with a package that is not installed, but which an extra would bring.
    """
    data = read_tables(path, MAX_BYTES)
    problems: list[str] = []
    result = _robot_file(path, _Table(data, "", problems), problems)
    if problems:
        raise InvalidFile(path, problems)
    return result


def _robot_file(path: Path, table: _Table, problems: list[str]) -> RobotFile:
    joints = table.names("joints", 1)
    n = len(joints)
    packages = _packages(table)
    urdf = _urdf_path(path.resolve().parent, packages, table)
    result = RobotFile(
        path=path,
        name=table.text("name"),
        urdf=urdf,
        package_dirs=tuple(packages.values()),
        decompose=_decompose(table),
        joints=joints,
        tool_frame=table.text("tool_frame"),
        base_links=table.names("base_links", 1),
        inverse=table.choice("inverse_kinematics", ("numeric", "wxai"), "numeric"),
        settle_time=table.number("settle_time", 0.0, default=0.0),
        poses=_poses(table, n),
        limits=_limits(table, n),
        locked=_locked(table),
        gripper=_gripper(table),
        allowed=tuple(_allowed(entry) for entry in table.tables("allowed_contacts")),
        retreats=tuple(_retreat(entry, n) for entry in table.tables("retreat")),
    )
    table.close()
    _check_poses(result, problems)
    return result


def _packages(table: _Table) -> dict[str, Path]:
    """The folders of the installed packages that are named."""
    folders = {}
    for name in table.names("packages", 1) if "packages" in table.data else ():
        try:
            folders[name] = package_folder(name)
        except LookupError as error:  # unknown, too
            table.problems.append(f"packages: {error}")
    return folders


def _urdf_path(own: Path, packages: Mapping[str, Path], table: _Table) -> Path:
    """The file beside robot.toml, or ``package://name/rest``: ``rest`` in the folder of a package named in it."""
    text = table.text("urdf")
    folder, tail, whose = own, text, "the robot's folder"
    if text.startswith(PACKAGE):
        name, _, tail = text[len(PACKAGE) :].partition("/")
        if name not in packages:
            table.problems.append(f"urdf = {shown(text)}: {name!r} is none of the packages; list it there")
            return own
        folder, whose = packages[name], f"the folder of package {name!r}"
    try:
        urdf = (folder / tail).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a NUL character, or a circle of links
        table.problems.append(f"urdf = {shown(text)}: {error}")
        return folder
    if not urdf.is_relative_to(folder):
        table.problems.append(f"urdf = {shown(text)} lies outside {whose}")
    return urdf


def _poses(table: _Table, n: int) -> dict[str, Numbers]:
    poses = table.table("poses")
    result = {name: poses.numbers(name, n) for name in poses.data}
    if "home" not in result:
        poses.problems.append("poses.home is missing")
    poses.close()
    return result


def _limits(table: _Table, n: int) -> dict[str, Numbers]:
    limits = table.table("limits")
    position = limits.table("position")
    result = {"lower": position.numbers("lower", n), "upper": position.numbers("upper", n)}
    position.text("source")
    position.close()
    for index, (low, high) in enumerate(zip(result["lower"], result["upper"], strict=False)):
        if low >= high:
            limits.problems.append(
                f"limits.position: joint {index} has lower {low:g}, upper {high:g}; expected lower < upper"
            )
    for kind in LIMIT_KINDS:
        entry = limits.table(kind)
        result[kind] = entry.numbers("values", n)
        limits.problems.extend(
            f"limits.{kind}.values[{i}] = {v:g}; expected more than 0" for i, v in enumerate(result[kind]) if v <= 0.0
        )
        entry.text("source")
        entry.close()
    limits.close()
    return result


def _locked(table: _Table) -> dict[str, float]:
    if "locked_joints" not in table.data:
        return {}
    locked = table.table("locked_joints")
    result = {name: locked.number(name, -math.inf) for name in locked.data}
    locked.close()
    return result


def _decompose(table: _Table) -> dict[str, int]:
    if "decompose" not in table.data:
        return {}
    entry = table.table("decompose")
    result = {link: entry.number(link, 1.0) for link in entry.data}
    for link, count in result.items():
        if count != int(count):
            entry.problems.append(f"decompose.{link}: {count:g}; expected a whole number of pieces")
    entry.close()
    return {link: int(count) for link, count in result.items()}


def _gripper(table: _Table) -> GripperEntry | None:
    if "gripper" not in table.data:
        return None
    entry = table.table("gripper")
    lower, upper = entry.number("lower", 0.0), entry.number("upper", 0.0)
    width = entry.number("width", 0.0, default=upper)
    if not lower <= width <= upper or lower >= upper:
        entry.problems.append(
            f"gripper: lower {lower:g}, width {width:g}, upper {upper:g}; expected lower <= width <= upper"
        )
    approach, closing = _axis(entry, "approach"), _axis(entry, "closing")
    if abs(math.fsum(a * b for a, b in zip(approach, closing, strict=True))) > AXIS_SLACK:
        entry.problems.append(
            f"gripper: approach {approach} and closing {closing}; expected a right angle between them"
        )
    result = GripperEntry(entry.names("joints", 1), lower, upper, width, approach, closing)
    entry.close()
    return result


def _axis(entry: _Table, name: str) -> tuple[float, float, float]:
    values = entry.numbers(name, 3)
    if len(values) == 3:
        x, y, z = values
        if abs(math.hypot(x, y, z) - 1.0) <= AXIS_SLACK:
            return x, y, z
        entry.problems.append(
            f"gripper.{name}: length {math.hypot(x, y, z):g}; expected a unit vector in the tool frame"
        )
    return (1.0, 0.0, 0.0) if name == "approach" else (0.0, 1.0, 0.0)


def _allowed(entry: _Table) -> tuple[Pair, str]:
    result = (entry.pair("links"), entry.text("reason"))
    entry.close()
    return result


def _retreat(entry: _Table, n: int) -> RetreatEntry:
    result = RetreatEntry(entry.text("pose"), entry.numbers("to", n), entry.pairs("pairs"), entry.text("reason"))
    entry.close()
    return result


def _check_poses(robot: RobotFile, problems: list[str]) -> None:
    lower, upper = robot.limits["lower"], robot.limits["upper"]
    named = [(f"poses.{name}", q) for name, q in robot.poses.items()]
    named += [(f"retreat[{i}].to", retreat.to) for i, retreat in enumerate(robot.retreats)]
    for where, q in named:
        for joint, value, low, high in zip(robot.joints, q, lower, upper, strict=False):
            if not low <= value <= high:
                problems.append(f"{where}: {joint} = {value:g} is outside [{low:g}, {high:g}]")
    known = ", ".join([shown(name)[1:-1] for name in list(robot.poses)[:MAX_SHOWN]])
    known += ", ..." if len(robot.poses) > MAX_SHOWN else ""
    for index, retreat in enumerate(robot.retreats):
        if retreat.pose not in robot.poses:
            problems.append(f"retreat[{index}].pose = {shown(retreat.pose)}; expected one of {known}")


class _Table:
    """A TOML table being read: each getter marks its key as known and reports what is wrong with the value."""

    def __init__(self, data: Any, where: str, problems: list[str]) -> None:
        self.problems = problems
        self.where = where
        if not isinstance(data, dict):
            problems.append(f"{where} = {shown(data)}; expected a table")
        self.data: dict[str, Any] = data if isinstance(data, dict) else {}
        self.known: set[str] = set()

    def close(self) -> None:
        """Report the keys nobody asked for."""
        self.problems.extend(f"unknown key {self.path(key)}" for key in self.data if key not in self.known)

    def path(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def value(self, key: str, expected: str, read: Callable[[Any], Any], stand_in: Any) -> Any:
        """The value as ``read`` returns it; a problem and ``stand_in`` when it is missing or ``read`` returns None."""
        self.known.add(key)
        if key not in self.data:
            self.problems.append(f"{self.path(key)} is missing; expected {expected}")
            return stand_in
        result = read(self.data[key])
        if result is None:
            self.problems.append(f"{self.path(key)} = {shown(self.data[key])}; expected {expected}")
            return stand_in
        return result

    def text(self, key: str) -> str:
        return str(self.value(key, "a text", lambda v: v if isinstance(v, str) and v.strip() else None, "?"))

    def choice(self, key: str, choices: tuple[str, ...], default: str) -> str:
        self.known.add(key)
        expected = "one of " + ", ".join(choices)
        return (
            default
            if key not in self.data
            else str(self.value(key, expected, lambda v: v if v in choices else None, default))
        )

    def number(self, key: str, lowest: float, default: float | None = None) -> float:
        self.known.add(key)
        if default is not None and key not in self.data:
            return default
        expected = "a finite number" + ("" if lowest == -math.inf else f" of at least {lowest:g}")
        return float(
            self.value(key, expected, lambda v: v if _is_number(v) and v >= lowest else None, max(lowest, 0.0))
        )

    def numbers(self, key: str, count: int) -> Numbers:
        def read(value: Any) -> Numbers | None:
            fits = isinstance(value, list) and len(value) == count and all(map(_is_number, value))
            return tuple(float(v) for v in value) if fits else None

        return tuple(self.value(key, f"{count} finite numbers", read, ()))

    def names(self, key: str, fewest: int) -> tuple[str, ...]:
        def read(value: Any) -> tuple[str, ...] | None:
            fits = isinstance(value, list) and len(value) >= fewest and all(isinstance(v, str) and v for v in value)
            return tuple(value) if fits and len(set(value)) == len(value) else None

        return tuple(self.value(key, f"at least {fewest} different names", read, ()))

    def pair(self, key: str) -> Pair:
        first, second = self.value(key, "two different link names", _pair, ("?", "?"))
        return (first, second)

    def pairs(self, key: str) -> tuple[Pair, ...]:
        def read(value: Any) -> tuple[Pair, ...] | None:
            found = [_pair(v) for v in value] if isinstance(value, list) else [None]
            pairs = tuple(pair for pair in found if pair is not None)
            return pairs if pairs and len(pairs) == len(found) else None

        return tuple(self.value(key, "a list of pairs of link names", read, ()))

    def table(self, key: str) -> _Table:
        found = self.value(key, "a table", lambda v: v if isinstance(v, dict) else None, None)
        # what a missing table should hold is not listed key by key: one problem is enough
        return _Table({}, self.path(key), []) if found is None else _Table(found, self.path(key), self.problems)

    def tables(self, key: str) -> list[_Table]:
        self.known.add(key)
        if key not in self.data:
            return []
        items = self.value(key, "an array of tables", lambda v: v if isinstance(v, list) else None, [])
        return [_Table(item, f"{self.path(key)}[{index}]", self.problems) for index, item in enumerate(items)]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= 1e9


def _pair(value: Any) -> Pair | None:
    fits = isinstance(value, list) and len(value) == 2 and all(isinstance(v, str) and v for v in value)
    return (value[0], value[1]) if fits and value[0] != value[1] else None

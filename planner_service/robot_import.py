"""A robot.toml worked out from a URDF: limits with sources, allowed contacts with reasons, ready to edit."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

from planner_service.contact_table import ContactKind, ContactTable, PairFinding, contact_table
from planner_service.errors import BrokenInvariant, InvalidFile, InvalidRequest
from planner_service.regular_file import as_path, read_bytes
from planner_service.robot import Robot, load_robot
from planner_service.robot_source import ACCELERATION, JERK
from planner_service.scene_file import require_writable, write_whole
from planner_service.urdf import CONTINUOUS_RANGE, DEFAULT_VELOCITY
from planner_service.xml_file import MAX_XML_BYTES, read_xml

__all__ = ["ImportedRobot", "Source", "import_robot"]

ROBOT_FILE = "robot.toml"


@dataclass(frozen=True)
class Source:
    """Where a robot comes from; as ``Robot.from_urdf`` takes it.

    Raises:
        InvalidRequest: a path is none.
    """

    urdf: Path
    srdf: Path | None = None
    tool_frame: str | None = None
    package_dirs: tuple[Path, ...] = ()
    locked_joints: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "urdf", as_path("urdf", self.urdf))
        if self.srdf is not None:
            object.__setattr__(self, "srdf", as_path("srdf", self.srdf))
        object.__setattr__(self, "package_dirs", tuple(as_path("package_dirs", path) for path in self.package_dirs))

    def robot(self) -> Robot:
        """The robot, adjacent links and what the SRDF lists allowed to touch."""
        return Robot.from_urdf(self.urdf, self.tool_frame, self.srdf, self.package_dirs, self.locked_joints)


@dataclass(frozen=True, eq=False)
class ImportedRobot:
    """What was written, and what was found on the way.

    Attributes:
        robot: As ``load_robot(path)`` gives it.
        path: The robot.toml.
        urdf: The copy of the URDF beside it.
        links: Links of the URDF, with shapes or without.
        seconds: What it took.
    """

    robot: Robot
    path: Path
    urdf: Path
    links: int
    table: ContactTable
    seconds: float


def import_robot(source: Source, out: Path | str, *, force: bool = False) -> ImportedRobot:
    """Write robot.toml, and a copy of the URDF, into the folder ``out``, which is made if only it is missing.

    Nothing is put there before it was loaded from another place and found to be the same robot.

    Args:
        force: Replace files that are there.

    Raises:
        InvalidFile: the URDF or SRDF has problems, or ``out`` cannot be written.
        UnknownName: no such tool frame or locked joint.
        InvalidRequest: a file is there and ``force`` is not given; a joint is locked outside its limits.
    """
    begun = time.perf_counter()
    folder = as_path("out", out)
    toml, urdf = folder / ROBOT_FILE, folder / source.urdf.name
    text = read_bytes(source.urdf, MAX_XML_BYTES).decode("utf-8-sig", "replace")
    root = read_xml(source.urdf, "robot")
    robot = source.robot()
    in_place = urdf.exists() and urdf.samefile(source.urdf)
    _require_place(folder, [toml] if in_place else [toml, urdf], force=force)
    table = contact_table(robot)
    robot = replace(robot, allowed_contacts=table.allowed)
    written = _text(robot, source, root, table)
    _require_same(robot, written, source.urdf.name, text, toml)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InvalidFile(folder, [f"cannot be made: {error.strerror or error}"]) from None
    if not in_place:
        write_whole(urdf, text)
    write_whole(toml, written)
    return ImportedRobot(load_robot(toml), toml, urdf, len(root.findall("link")), table, time.perf_counter() - begun)


def _require_place(folder: Path, files: Sequence[Path], *, force: bool) -> None:
    """Return if the files can be put into the folder: asked before the work whose result would be lost."""
    if len({path.name for path in files}) != len(files):
        raise InvalidRequest("urdf", str(files[-1].name), f"another name than {ROBOT_FILE}, which will lie beside it")
    if not folder.exists():
        require_writable(folder)
        return
    for path in files:
        if not force and path.exists():
            raise InvalidRequest("out", str(path), "a folder without it; --force replaces it")
        require_writable(path)


def _require_same(robot: Robot, written: str, urdf_name: str, urdf_text: str, path: Path) -> None:
    """Raise unless the text, beside its URDF, loads as that robot."""
    with tempfile.TemporaryDirectory() as folder:
        write_whole(Path(folder) / urdf_name, urdf_text)
        write_whole(Path(folder) / ROBOT_FILE, written)
        try:
            loaded = load_robot(Path(folder) / ROBOT_FILE)
        except InvalidFile as error:
            raise InvalidFile(path, error.problems) from None
    if loaded.hash != robot.hash:
        raise BrokenInvariant(f"{path} would not be the robot that {urdf_name} describes")


def _text(robot: Robot, source: Source, root: ElementTree.Element, table: ContactTable) -> str:
    """The whole robot.toml."""
    limits = robot.limits
    lines = [
        f"# {robot.name}, imported from {source.urdf.name}: made to be edited.",
        "# Angles in rad, lengths in m, times in s.",
        f"name = {_quoted(robot.name)}",
        f"urdf = {_quoted(source.urdf.name)}",
        f"joints = {_list(map(_quoted, robot.joint_names))}",
        f"tool_frame = {_quoted(robot.tool_frame)}"
        + ("" if source.tool_frame else "   # the last link of the longest chain: is it the tool?"),
        f"base_links = {_list(map(_quoted, robot.base_links))}   # not judged against obstacles that stand still",
        'inverse_kinematics = "numeric"',
        "settle_time = 0.0   # seconds the arm rings after a stop; no URDF says",
        "",
        "[poses]",
    ]
    at_home = [" x ".join(f.links) for f in table.findings if f.at_home and not f.kind.allowed]
    lines += [f"# home collides: {', '.join(at_home)}. Choose another, free one."] if at_home else []
    lines.append(f"home = {_numbers(robot.home.tolist())}   # zero where the limits allow it, else their middle")
    if source.locked_joints:
        lines += ["", "[locked_joints]   # they stand still; joints that mimic them follow"]
        lines += [f"{_quoted(name)} = {float(at)!r}" for name, at in source.locked_joints.items()]
    position, velocity = _urdf_sources(robot, root)
    lines += ["", "[limits.position]", f"lower = {_numbers(limits.lower.tolist())}"]
    lines += [f"upper = {_numbers(limits.upper.tolist())}", f"source = {_quoted(position)}"]
    for kind, values, words in (
        ("velocity", limits.velocity, velocity),
        ("acceleration", limits.acceleration, _convention(ACCELERATION, "^2", "usual in MoveIt configurations")),
        ("jerk", limits.jerk, _convention(JERK, "^3", "full acceleration within about 60 ms")),
    ):
        lines += ["", f"[limits.{kind}]", f"values = {_numbers(values.tolist())}", f"source = {_quoted(words)}"]
    return "\n".join(map(_printable, [*lines, "", *_contacts(robot, table)])) + "\n"


def _urdf_sources(robot: Robot, root: ElementTree.Element) -> tuple[str, str]:
    """Where position and velocity limits come from."""
    endless = [joint for joint in root.findall("joint") if joint.get("type") == "continuous"]
    turning = [joint.get("name", "") for joint in endless if joint.get("name") in robot.joint_names]
    silent = [joint.get("name", "") for joint in endless if joint.find("limit") is None]
    silent = [name for name in silent if name in turning]
    position = velocity = "URDF <limit>"
    if turning:
        position += f"; convention: {', '.join(turning)} continuous, {CONTINUOUS_RANGE:.4f} rad (a turn) either way"
    if silent:
        velocity += f"; convention: {DEFAULT_VELOCITY:g} rad/s for {', '.join(silent)}, which has none"
    return position, velocity


def _convention(values: Mapping[str, float], power: str, why: str) -> str:
    turning, sliding = values["revolute"], values["prismatic"]
    return f"convention: {turning!r} rad/s{power} ({sliding!r} m/s{power} sliding), {why}; URDF states none"


_HEADS = {
    ContactKind.ADJACENT: "adjacent: the next link with shapes above; in contact by design.",
    ContactKind.GIVEN: "Taken from the SRDF, with its reasons; not worked out here.",
    ContactKind.ALWAYS: "always: the shapes overlap all over a dense sweep of the joints between. Are they meant to?",
    ContactKind.NEVER: "never: proven for the shapes of the URDF over the whole joint box, between samples too.",
}


def _contacts(robot: Robot, table: ContactTable) -> list[str]:
    """The allowed contacts by kind, and as comments the pairs that are judged and collide somewhere."""
    lines = ["# Who may touch whom. Pairs that are not listed are judged in every check."]
    for kind, head in _HEADS.items():
        found = table.of(kind)
        lines += ["", f"# {head}"] if found else []
        for item in found:
            lines += ["[[allowed_contacts]]", f"links = {_list(map(_quoted, item.links))}"]
            lines.append(f"reason = {_quoted(item.reason)}")
    sometimes = sorted(table.of(ContactKind.SOMETIMES), key=lambda item: -item.share)
    if sometimes:
        lines += ["", f"# Judged, for they collide somewhere; with an example of {', '.join(robot.joint_names)}:"]
        lines += [f"#   {_judged(item)}" for item in sometimes]
    unproven = table.of(ContactKind.UNPROVEN)
    lines += ["", "# Judged, for no proof was found:"] if unproven else []
    return lines + [f"#   {' x '.join(item.links)}: {item.reason}" for item in unproven]


def _judged(item: PairFinding) -> str:
    example = "" if item.example is None else f", as at {', '.join(f'{value:.4f}' for value in item.example.tolist())}"
    return f"{' x '.join(item.links)}: {item.reason}{example}{' (home, too)' if item.at_home else ''}"


def _quoted(text: str) -> str:
    """A TOML basic string."""
    out = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08X}" for c in out) + '"'


def _printable(line: str) -> str:
    """A line whose comments cannot end early: names may hold a line break."""
    return "".join(c if c.isprintable() else "?" for c in line)


def _list(items: Iterable[str]) -> str:
    return f"[{', '.join(items)}]"


def _numbers(values: Iterable[float]) -> str:
    return _list(map(repr, values))

"""A robot.toml worked out from a URDF or an MJCF file: limits with sources, allowed contacts with reasons."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.errors import BrokenInvariant, InvalidFile, InvalidRequest
from planner_service.files.reading import as_path, read_bytes
from planner_service.files.toml_reader import toml_value
from planner_service.files.writing import require_writable, write_whole
from planner_service.files.xml_reader import MAX_XML_BYTES, read_xml
from planner_service.geometry.decomposition import MOST
from planner_service.geometry.mesh_formats import MAX_BYTES
from planner_service.geometry.mesh_paths import MeshLoader
from planner_service.geometry.validation import copied_in, flag, instance, items
from planner_service.parallel.engine import Engine
from planner_service.robot.end_effector.finger_loading import finger_joints
from planner_service.robot.loading import (
    ACCELERATION,
    JERK,
    VELOCITY,
    Selection,
    is_mjcf,
    robot_of,
    standing_joints,
    unit_notes,
    without_passive,
)
from planner_service.robot.macros.expansion import checked_xacro_args, expanded_xml, package_folders, robot_folders
from planner_service.robot.mjcf.mjcf_reader import read_mjcf
from planner_service.robot.model import Robot
from planner_service.robot.srdf import Srdf, read_srdf
from planner_service.robot.urdf_model import Urdf
from planner_service.robot.urdf_reader import CONTINUOUS_RANGE, read_urdf
from planner_service.robot_setup.concave_links import cut_where_hulls_block
from planner_service.robot_setup.end_effectors.equipment import Equipment, equipment_of
from planner_service.robot_setup.gripper_detection import FoundGripper
from planner_service.robot_setup.loading import load_robot
from planner_service.robot_setup.second_reader import Agreement, compare_with_yourdfpy
from planner_service.robot_setup.self_collision_matrix import (
    ContactKind,
    ContactTable,
    PairFinding,
    contact_table,
    quick_table,
)
from planner_service.robot_setup.urdf_writer import write_urdf
from planner_service.scene.scene import Scene

__all__ = ["ImportedRobot", "Source", "import_robot"]

ROBOT_FILE = "robot.toml"
MESHES = "meshes"
"""The folder beside it for copies of meshes."""


@dataclass(frozen=True)
class Source:
    """Where a robot comes from; as ``Robot.from_urdf`` takes it.

    With ``visual_as_collision`` the copy of the URDF has collision elements where only visual ones were. ``urdf`` may
    be MJCF, too, which brings what an SRDF says itself: the copy is then a URDF worked out from it.

    Raises:
        InvalidRequest: a path is none.
    """

    urdf: Path
    srdf: Path | None = None
    tool_frame: str | None = None
    package_dirs: tuple[Path, ...] = ()
    locked_joints: Mapping[str, float] = field(default_factory=dict)
    joints: tuple[str, ...] | None = None
    visual_as_collision: bool = False
    xacro_args: Mapping[str, str] = field(default_factory=dict)
    gripper: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "urdf", as_path("urdf", self.urdf))
        if self.urdf.suffix.lower() == ".toml":
            raise InvalidRequest("urdf", str(self.urdf), "a URDF, xacro or MJCF file: a robot.toml is one already")
        flag("visual_as_collision", self.visual_as_collision)
        if self.srdf is not None:
            object.__setattr__(self, "srdf", as_path("srdf", self.srdf))
        folders = items("package_dirs", self.package_dirs, object, "folders")
        object.__setattr__(self, "package_dirs", tuple(as_path("package_dirs", path) for path in folders))
        instance("locked_joints", self.locked_joints, Mapping, "positions by joint name")
        copied_in(self, "locked_joints", "joints", "gripper")
        object.__setattr__(self, "xacro_args", checked_xacro_args(self.xacro_args))

    @property
    def selection(self) -> Selection:
        """What of the URDF becomes the robot."""
        return Selection(self.tool_frame, self.srdf, self.joints, self.locked_joints, gripper=self.gripper)

    @property
    def copy_name(self) -> str:
        """The name of the copy: a xacro file's is a URDF."""
        plain = self.urdf.name.removesuffix(".xacro")
        return self.urdf.name if plain == self.urdf.name else f"{plain.removesuffix('.urdf')}.urdf"

    @property
    def folders(self) -> tuple[Path, ...]:
        """The resolved folders that may be read: the URDF's own, those given, and its ROS package."""
        return robot_folders(self.urdf, (*self.package_dirs, *package_folders(self.urdf)))

    @property
    def meshes(self) -> MeshLoader:
        """Where its meshes are."""
        return MeshLoader(self.folders)


@dataclass(frozen=True, eq=False)
class ImportedRobot:
    """What was written, and what was found on the way.

    Attributes:
        robot: As ``load_robot(path)`` gives it.
        path: The robot.toml.
        urdf: The copy of the URDF beside it.
        meshes: The copies of the meshes; where the URDF was in place already, they are, too.
        links: Links of the URDF, with shapes or without.
        agreement: How closely yourdfpy, which read the URDF as well, agrees.
        proven: Whether each pair of links was looked at; else only those that always overlap were.
        seconds: What it took.
        notes: What was not understood of the files, or is not used, and what to know of the tool; a line each.
        tool_whence: By what the tool frame was chosen.
    """

    robot: Robot
    path: Path
    urdf: Path
    meshes: tuple[Path, ...]
    links: int
    agreement: Agreement
    table: ContactTable
    proven: bool
    seconds: float
    notes: tuple[str, ...] = ()
    tool_whence: str = ""


def import_robot(
    source: Source,
    out: Path | str,
    *,
    force: bool = False,
    prove: bool = False,
    engine: Engine | None = None,
    progress: bool | None = False,
) -> ImportedRobot:
    """Write robot.toml, and copies of the URDF and its meshes, into ``out``, which is made if only it is missing.

    Nothing is put there before a second reader has seen the same robot in the URDF, and before the new files were
    loaded from another place and found to be that robot, too.

    Args:
        force: Replace files that are there.
        prove: Look at every pair of links (``contact_table``), so that pairs which never touch need not be checked:
            seconds for a small arm, minutes for a large robot. Else only at those that always overlap.
        engine: Where pairs are looked at; None: in this process.
        progress: Whether standard error shows how many pairs are done; None: if it is a terminal.

    Raises:
        InvalidFile: the URDF or SRDF has problems, yourdfpy sees another robot in it, or ``out`` cannot be written.
        UnknownName: no such tool frame or joint.
        InvalidRequest: a file is there and ``force`` is not given, the URDF is there already but its meshes lie
            elsewhere, or a joint is locked outside its limits.
    """
    begun = time.perf_counter()
    instance("source", source, Source, "a Source")
    flag("force", force)
    flag("prove", prove)
    folder = as_path("out", out)
    if not is_mjcf(source.urdf):
        return _imported(source, folder, begun, force=force, prove=prove, engine=engine, progress=progress)
    if source.srdf is not None or source.visual_as_collision:
        field = "visual_as_collision" if source.srdf is None else "srdf"
        raise InvalidRequest(field, getattr(source, field), "none: MJCF says itself what collides and what may touch")
    urdf, srdf = read_mjcf(source.urdf, source.folders)
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place, f"{source.urdf.stem}.urdf")
        write_urdf(urdf, copy)
        of_it = replace(source, urdf=copy, package_dirs=())
        described = _Described(source.urdf, srdf, urdf.notes)
        return _imported(of_it, folder, begun, described, force=force, prove=prove, engine=engine, progress=progress)


@dataclass(frozen=True, eq=False)
class _Described:
    """The file that a URDF was worked out from, what it says beyond that, and what is not used of it."""

    path: Path
    srdf: Srdf
    notes: tuple[str, ...]


def _imported(
    source: Source,
    folder: Path,
    begun: float,
    described: _Described | None = None,
    *,
    force: bool,
    prove: bool,
    engine: Engine | None,
    progress: bool | None,
) -> ImportedRobot:
    """As ``import_robot``, of a URDF."""
    original = source.urdf if described is None else described.path
    text = read_bytes(source.urdf, MAX_XML_BYTES).decode("utf-8-sig", "replace")
    root = expanded_xml(source.urdf, source.folders, source.xacro_args)
    if source.visual_as_collision:
        _check_as_seen(root)
    if _serialised(root) != _serialised(read_xml(source.urdf, "robot")):
        text = f"<!-- worked out from {original.name} -->\n{_serialised(root)}\n"
    toml, copy = folder / ROBOT_FILE, folder / source.copy_name
    seen, arguments = source.visual_as_collision, source.xacro_args
    urdf = read_urdf(source.urdf, source.folders, visual_as_collision=seen, xacro_args=arguments)
    srdf = _given_srdf(source, urdf) if described is None else described.srdf
    notes = (*urdf.notes, *(() if described is None else described.notes), *srdf.notes, *unit_notes(urdf))
    chosen = equipment_of(urdf, srdf, source.selection) if source.joints is None else None
    hand = None if chosen is None else chosen.gripper
    notes = notes if chosen is None else (*notes, *chosen.notes)
    fingers = () if hand is None else finger_joints(hand.table, urdf)
    if chosen is not None:
        source = replace(source, locked_joints={**chosen.locked, **source.locked_joints})
    locked = without_passive(source.selection, urdf, srdf, fingers).locked_joints
    source = replace(source, locked_joints=locked)
    selection = source.selection if chosen is None else replace(source.selection, tool_frame=chosen.tool_frame)
    robot = robot_of(source.urdf, urdf, selection, srdf)  # its fingers are joints, so that pairs with them are known
    agreement = compare_with_yourdfpy(robot, original, root, standing_joints(urdf, source.selection))
    in_place = _is_there(copy) and copy.samefile(source.urdf)
    if in_place and source.visual_as_collision:
        raise InvalidRequest("out", str(folder), "another folder than the URDF's own, which is left as it is")
    meshes = _meshes_in_place(source, root, folder) if in_place else _meshes_to_copy(source, root)
    if meshes and not in_place:
        text = f"<!-- {ROBOT_FILE}'s URDF: its collision meshes are copies -->\n{_serialised(root)}\n"
    files = {copy.name: text.encode(), **{name: read_bytes(path, MAX_BYTES) for name, path in meshes.items()}}
    _require_place(folder, [toml] if in_place else [toml, *(folder / name for name in files)], force=force)
    urdf, cut = cut_where_hulls_block(urdf, robot, progress=progress)
    robot = robot_of(source.urdf, urdf, selection, srdf) if cut else robot
    table = contact_table(robot, engine=engine, progress=progress) if prove else quick_table(robot, progress=progress)
    if hand is not None:
        robot = robot_of(source.urdf, urdf, selection, srdf, hand.table)
        table = replace(table, findings=tuple(_standing_open(finding, robot) for finding in table.findings))
    robot = replace(robot, allowed_contacts=table.allowed)
    files[ROBOT_FILE] = _text(robot, source, urdf, original.name, table, chosen, cut).encode()
    _require_same(robot, files, toml)
    _write(folder, {ROBOT_FILE: files[ROBOT_FILE]} if in_place else files)
    copies = tuple(folder / name for name in meshes)
    seconds = time.perf_counter() - begun
    found = (load_robot(toml), toml, copy, copies, len(urdf.links), agreement, table, prove, seconds, notes)
    return ImportedRobot(*found, "" if chosen is None else chosen.whence)


def _given_srdf(source: Source, urdf: Urdf) -> Srdf:
    return Srdf() if source.srdf is None else read_srdf(source.srdf, urdf)


def _standing_open(finding: PairFinding, robot: Robot) -> PairFinding:
    """What holds of a pair when the gripper is open: its fingers meet at a home at which they are closed."""
    links = () if robot.gripper is None else robot.gripper.links
    return replace(finding, at_home=finding.at_home and not set(finding.links) <= set(links))


def _check_as_seen(root: ElementTree.Element) -> None:
    """Give links that have visual elements alone the same as collision elements."""
    for link in root.findall("link"):
        if link.find("collision") is None:
            for visual in link.findall("visual"):
                collision = ElementTree.SubElement(link, "collision")
                collision.extend(deepcopy(child) for child in visual if child.tag in ("origin", "geometry"))


def _mesh_elements(root: ElementTree.Element) -> list[ElementTree.Element]:
    return root.findall("link/collision/geometry/mesh")


def _meshes_in_place(source: Source, root: ElementTree.Element, folder: Path) -> dict[str, Path]:
    """The collision meshes of a URDF that stays where it is, by their paths in its folder."""
    paths = {}
    for element in _mesh_elements(root):
        path = source.meshes.path(element.get("filename", ""))
        if not path.is_relative_to(folder.resolve()):
            raise InvalidRequest("out", str(folder), f"another folder than the URDF's own: {path} has to be copied")
        paths[path.relative_to(folder.resolve()).as_posix()] = path
    return paths


def _meshes_to_copy(source: Source, root: ElementTree.Element) -> dict[str, Path]:
    """The collision meshes by the paths of their copies, which the elements are given as names."""
    names: dict[Path, str] = {}
    for element in _mesh_elements(root):
        path = source.meshes.path(element.get("filename", ""))
        if path not in names:
            plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in path.name)
            taken = {name.lower() for name in names.values()}
            number = next(k for k in count() if _copy_name(plain, k).lower() not in taken)
            names[path] = _copy_name(plain, number)
        element.set("filename", names[path])
    return {name: path for path, name in names.items()}


def _copy_name(plain: str, number: int) -> str:
    return f"{MESHES}/{f'{number}_' if number else ''}{plain}"


def _serialised(root: ElementTree.Element) -> str:
    return ElementTree.tostring(root, encoding="unicode")


def _require_place(folder: Path, files: Sequence[Path], *, force: bool) -> None:
    """Return if the files can be put into the folder; call it before work whose result would be lost."""
    if len({path.name for path in files if path.parent == folder}) != sum(path.parent == folder for path in files):
        raise InvalidRequest("urdf", ROBOT_FILE, f"another name than {ROBOT_FILE}, which will lie beside it")
    if not _is_there(folder):
        require_writable(folder)
        return
    for path in files:
        if not force and _is_there(path):
            raise InvalidRequest("out", str(path), "a folder without it; --force replaces it")
        require_writable(path if _is_there(path.parent) else path.parent)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:  # a name that is too long, a folder that nobody may look into
        raise InvalidFile(path, [f"cannot be written: {error.strerror or error}"]) from None


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    """Put the files into the folder; robot.toml comes last and names nothing that is missing."""
    for name in sorted(files, key=lambda name: name == ROBOT_FILE):
        path = folder / name
        try:
            folder.mkdir(exist_ok=True)
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidFile(path.parent, [f"cannot be made: {error.strerror or error}"]) from None
        write_whole(path, files[name])


def _require_same(robot: Robot, files: Mapping[str, bytes], path: Path) -> None:
    """Raise unless the files, side by side in an empty folder, load as that robot."""
    with tempfile.TemporaryDirectory() as folder:
        _write(Path(folder), files)
        try:
            loaded = load_robot(Path(folder) / ROBOT_FILE)
        except InvalidFile as error:
            raise InvalidFile(path, error.problems) from None
    if loaded.hash != robot.hash:
        raise BrokenInvariant(f"{path} would not be the robot that its URDF describes")


def _text(
    robot: Robot,
    source: Source,
    urdf: Urdf,
    name: str,
    table: ContactTable,
    chosen: Equipment | None,
    cut: Sequence[str],
) -> str:
    """The whole robot.toml."""
    whence = "the last link of the longest chain" if chosen is None else chosen.whence
    limits = robot.limits
    lines = [
        f"# {robot.name}, imported from {name}. Please review and edit.",
        "# Angles in rad, lengths in m, times in s.",
        f"name = {toml_value(robot.name)}",
        f"urdf = {toml_value(source.copy_name)}",
        f"joints = {toml_value(robot.joint_names)}",
        *_continuous(robot),
        f"tool_frame = {toml_value(robot.tool_frame)}"
        + ("" if source.tool_frame else f"   # {whence}: is it the tool?"),
        f"base_links = {toml_value(robot.base_links)}   # not checked against obstacles",
        'inverse_kinematics = "numeric"',
        "settle_time = 0.0   # seconds the arm vibrates after a stop; URDF has none",
        "",
        *_poses(robot, table),
        *_locked(source, urdf),
        *_gripper(None if chosen is None else chosen.gripper),
        *_decompose(cut),
    ]
    position, velocity = _urdf_sources(robot, urdf)
    lines += ["", "[limits.position]", f"lower = {toml_value(limits.lower.tolist())}"]
    lines += [f"upper = {toml_value(limits.upper.tolist())}", f"source = {toml_value(position)}"]
    for kind, values, words in (
        ("velocity", limits.velocity, velocity),
        ("acceleration", limits.acceleration, _rates_source(robot, urdf, "acceleration")),
        ("jerk", limits.jerk, _rates_source(robot, urdf, "jerk")),
    ):
        lines += ["", f"[limits.{kind}]", f"values = {toml_value(values.tolist())}", f"source = {toml_value(words)}"]
    return "\n".join(map(_printable, [*lines, "", *_contacts(robot, table)])) + "\n"


def _continuous(robot: Robot) -> list[str]:
    names = [name for name, endless in zip(robot.joint_names, robot.continuous, strict=False) if endless]
    return [f"continuous = {toml_value(names)}   # these turn without end"] if names else []


def _poses(robot: Robot, table: ContactTable) -> list[str]:
    """The named poses; those in which the robot collides with itself are marked."""
    at_home = [" x ".join(f.links) for f in table.findings if f.at_home and not f.kind.allowed]
    lines = ["[poses]"]
    lines += [f"# home collides: {', '.join(at_home)}. Choose another, free one."] if at_home else []
    checker = CollisionChecker(robot, Scene())
    for name, q in robot.named_poses:
        if name == "home":
            lower, upper = robot.limits.lower, robot.limits.upper
            rest = np.where((lower <= 0.0) & (upper >= 0.0), 0.0, (lower + upper) / 2)
            whence = "zero where the limits allow it, else their middle" if (q == rest).all() else "from the SRDF"
            lines.append(f"home = {toml_value(q.tolist())}   # {whence}")
        else:
            note = "" if checker.state_is_free(q) else ": collides with itself"
            lines.append(f"{toml_value(name)} = {toml_value(q.tolist())}   # from the SRDF{note}")
    return lines


def _locked(source: Source, urdf: Urdf) -> list[str]:
    """The joints that stand still, but for those that follow one of these."""
    standing = standing_joints(urdf, source.selection)
    follow = {joint.name for joint in urdf.joints if joint.mimic and joint.name not in source.locked_joints}
    lines = [f"{toml_value(name)} = {toml_value(float(at))}" for name, at in standing.items() if name not in follow]
    return ["", "[locked_joints]   # these do not move, and neither do joints that mimic them", *lines] if lines else []


def _gripper(hand: FoundGripper | None) -> list[str]:
    if hand is None:
        return []
    stated = hand.table.model_dump(exclude_defaults=True)
    return [
        "",
        f"[gripper]   # {hand.whence}; axes in the tool frame",
        *(f"{key} = {toml_value(value)}" for key, value in stated.items()),
    ]


def _decompose(cut: Sequence[str]) -> list[str]:
    """The links whose meshes are cut into convex pieces, and how many at most."""
    head = "[decompose]   # pieces at most: the hulls of these links touch what their meshes do not"
    return ["", head, *(f"{toml_value(link)} = {MOST}" for link in cut)] if cut else []


def _urdf_sources(robot: Robot, urdf: Urdf) -> tuple[str, str]:
    """Where position and velocity limits come from."""
    joints = [joint for joint in urdf.joints if joint.name in robot.joint_names]
    turning, silent, soft = (
        ", ".join(joint.name for joint in joints if chosen(joint))
        for chosen in (lambda j: j.continuous, lambda j: not j.velocity, lambda j: j.hard is not None)
    )
    position = velocity = "URDF <limit>"
    position += f"; soft limits of <safety_controller> for {soft}" if soft else ""
    if turning:
        position += f"; convention: {turning} continuous, {CONTINUOUS_RANGE:.4f} rad (a turn) either way"
    if silent:
        assumed = f"{VELOCITY['revolute']:g} rad/s ({VELOCITY['prismatic']:g} m/s sliding)"
        velocity += f"; convention: {assumed} for {silent}, which has none"
    return position, velocity


def _rates_source(robot: Robot, urdf: Urdf, kind: str) -> str:
    """Where acceleration or jerk limits come from."""
    silent = [joint.name for joint in urdf.joints if joint.name in robot.joint_names and not getattr(joint, kind)]
    if not silent:
        return "URDF <limit>"
    values, power, why = {
        "acceleration": (ACCELERATION, "^2", "usual in MoveIt configurations"),
        "jerk": (JERK, "^3", "full acceleration within about 60 ms"),
    }[kind]
    turning, sliding = values["revolute"], values["prismatic"]
    convention = f"convention: {turning!r} rad/s{power} ({sliding!r} m/s{power} sliding), {why}"
    if len(silent) == robot.n:
        return f"{convention}; URDF states none"
    return f"URDF <limit>; {convention}, for {', '.join(silent)}, which has none"


_HEADS = {
    ContactKind.ADJACENT: "adjacent: the next link with shapes above; in contact by design.",
    ContactKind.GIVEN: "given: taken from the SRDF, with its reasons, and not verified.",
    ContactKind.ALWAYS: "always: the shapes overlap wherever they were looked at. Intended?",
    ContactKind.NEVER: "never: proven for the shapes of the URDF over the whole range of the joints.",
}


def _contacts(robot: Robot, table: ContactTable) -> list[str]:
    """The allowed contacts by kind, and as comments the pairs that are judged and collide somewhere."""
    lines = ["# Allowed contacts. All pairs that are not listed are checked."]
    for kind, head in _HEADS.items():
        contacts = table.of(kind)
        lines += ["", f"# {head}"] if contacts else []
        for item in contacts:
            lines += ["[[allowed_contacts]]", f"links = {toml_value(item.links)}"]
            lines.append(f"reason = {toml_value(item.reason)}")
    sometimes = sorted(table.of(ContactKind.SOMETIMES), key=lambda item: -item.share)
    if sometimes:
        lines += ["", f"# Checked, because they collide somewhere; with an example of {', '.join(robot.joint_names)}:"]
        lines += [f"#   {_judged(item)}" for item in sometimes]
    unproven = table.of(ContactKind.UNPROVEN)
    lines += ["", "# Checked, without a collision or a proof that there is none:"] if unproven else []
    return lines + [f"#   {' x '.join(item.links)}: {item.reason}" for item in unproven]


def _judged(item: PairFinding) -> str:
    example = "" if item.example is None else f", as at {', '.join(f'{value:.4f}' for value in item.example.tolist())}"
    return f"{' x '.join(item.links)}: {item.reason}{example}{' (home, too)' if item.at_home else ''}"


def _printable(line: str) -> str:
    """A line whose comments cannot end early: names may hold a line break."""
    return "".join(c if c.isprintable() else "?" for c in line)

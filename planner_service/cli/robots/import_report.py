"""The report on an imported robot: what was found, and what a person should check."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from planner_service.cli.listings import robot_record
from planner_service.geometry.mesh import Mesh
from planner_service.presentation.tables import Table
from planner_service.robot_setup.import_robot import ImportedRobot, Source
from planner_service.robot_setup.self_collision_matrix import ContactKind, PairFinding

__all__ = ["import_record", "import_table", "to_check"]

MAX_PAIRS = 6
"""Pairs named on the terminal; the file has them all."""

_VERDICTS = {
    ContactKind.ADJACENT: "allowed, adjacent",
    ContactKind.GIVEN: "allowed, by the SRDF",
    ContactKind.ALWAYS: "allowed, always overlapping",
    ContactKind.NEVER: "allowed, proven never to touch",
    ContactKind.SOMETIMES: "checked, collide somewhere",
    ContactKind.UNPROVEN: "checked, not proven",
}


def import_table(imported: ImportedRobot) -> Table:
    """Counts of links, shapes and joints, and of pairs of links by verdict."""
    robot, table = imported.robot, imported.table
    shaped = len({item.link for item in robot.shapes})
    counts = [
        ("links", imported.links),
        ("links with shapes", shaped),
        ("shapes", len(robot.shapes)),
        ("joints", robot.n),
    ]
    counts += [("mesh files", len(imported.meshes))] if imported.meshes else []
    counts += [(f"pairs {_VERDICTS[kind]}", len(table.of(kind))) for kind in ContactKind]
    rows = [(label, f"{count:,}") for label, count in counts if count or not label.startswith("pairs")]
    return Table(("found", "count"), rows, numeric=("count",))


def to_check(imported: ImportedRobot, source: Source) -> list[str]:
    """What a person should check before the robot moves, a line each."""
    table, robot = imported.table, imported.robot
    home = [f for f in table.findings if f.at_home and not f.kind.allowed]
    lines = [f"home is in collision ({_named(home)}): choose another"] if home else []
    if source.tool_frame is None:
        lines.append(f"tool_frame {robot.tool_frame} is a guess: {imported.tool_whence}")
    if robot.gripper is not None:
        gripper = robot.gripper
        lines.append(
            f"the {gripper.kind} gripper was found by its fingers ({', '.join(gripper.joints)}): it opens"
            f" {1000 * gripper.lower:.1f} to {1000 * gripper.upper:.1f} mm, and its axes are in robot.toml"
        )
    if robot.locked_joints:
        locked = ", ".join(f"{name} = {position:g}" for name, position in robot.locked_joints)
        lines.append(f"locked: {locked}")
    lines.append("acceleration and jerk limits are conventions: URDF has none")
    lines += [f"not understood: {note}" for note in imported.notes]
    given = [f for f in table.of(ContactKind.GIVEN) if f.share > 0.0]
    lines += [f"the SRDF allows pairs that can collide: {_named(given)}"] if given else []
    always = table.of(ContactKind.ALWAYS)
    lines += [f"always overlapping: {_named(always)}"] if always else []
    filled = sorted(
        {item.link for item in robot.shapes if isinstance(item.shape, Mesh)} & {x for f in always for x in f.links}
    )
    if filled:
        lines.append(f"of these, {', '.join(filled)} are solid hulls of meshes: do filled hollows cause the overlap?")
    often = sorted(table.of(ContactKind.SOMETIMES), key=lambda f: -f.share)
    lines += [f"checked, most often colliding: {_named(often)}"] if often else []
    unproven = table.of(ContactKind.UNPROVEN)
    if unproven and not imported.proven:
        lines.append(f"{len(unproven):,} pairs are checked, even if they can never touch: --prove works that out")
    elif unproven:
        lines.append(f"checked, as neither a collision nor a proof was found: {_named(unproven)}")
    return lines


def import_record(imported: ImportedRobot) -> dict[str, Any]:
    """The robot and every pair of links as a JSON object."""
    pairs = [
        {
            "links": list(item.links),
            "kind": item.kind.value,
            "allowed": item.kind.allowed,
            "joints": list(item.joints),
            "reason": item.reason,
            "share": item.share,
            "example": None if item.example is None else item.example.tolist(),
            "at_home": item.at_home,
        }
        for item in imported.table.findings
    ]
    meshes = [str(path) for path in imported.meshes]
    files = {"robot_toml": str(imported.path), "urdf": str(imported.urdf), "meshes": meshes}
    agreement = {"reader": "yourdfpy", **asdict(imported.agreement)}
    robot = robot_record(imported.robot)
    return {**files, "second_reader": agreement, "robot": robot, "samples": imported.table.samples, "pairs": pairs} | {
        "notes": list(imported.notes)
    }


def _named(findings: Iterable[PairFinding]) -> str:
    shown = [" x ".join(item.links) + (f" {100.0 * item.share:.1f} %" if item.share else "") for item in findings]
    more = [f"{len(shown) - MAX_PAIRS} more"] if len(shown) > MAX_PAIRS else []
    return ", ".join([*shown[:MAX_PAIRS], *more])

"""An imported robot in words: what was written, what was found, what is left to a person."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.table import Table

from planner_service.cli.listings import columns, robot_record
from planner_service.errors import InvalidRequest
from planner_service.geometry.mesh import Mesh
from planner_service.robot_setup.import_robot import ImportedRobot, Source
from planner_service.robot_setup.self_collision_matrix import ContactKind, PairFinding

__all__ = ["import_record", "import_table", "locks", "to_check"]

MOST_PAIRS = 6
"""Judged pairs named on the terminal; the file has them all."""

_WORDS = {
    ContactKind.ADJACENT: "allowed, adjacent",
    ContactKind.GIVEN: "allowed, by the SRDF",
    ContactKind.ALWAYS: "allowed, always overlapping",
    ContactKind.NEVER: "allowed, proven never to touch",
    ContactKind.SOMETIMES: "judged, collide somewhere",
    ContactKind.UNPROVEN: "judged, not proven",
}


def locks(texts: Iterable[str]) -> dict[str, float]:
    """Joints and positions given as ``joint=value``.

    Raises:
        InvalidRequest: another text, or a joint given twice.
    """
    out: dict[str, float] = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            position = float(value)
        except ValueError:
            position = None
        if not name or position is None or name in out:
            raise InvalidRequest("--lock", text, "joint=value, in rad or m, each joint once")
        out[name] = position
    return out


def import_table(found: ImportedRobot) -> Table:
    """What the robot has, and its pairs of links by kind."""
    robot, table = found.robot, found.table
    rows = columns(("found", False), ("count", True))
    shaped = len({item.link for item in robot.shapes})
    counts = [("links", found.links), ("links with shapes", shaped), ("shapes", len(robot.shapes)), ("joints", robot.n)]
    counts += [("mesh files", len(found.meshes))] if found.meshes else []
    counts += [(f"pairs {_WORDS[kind]}", len(table.of(kind))) for kind in ContactKind]
    for words, count in counts:
        if count or not words.startswith("pairs"):
            rows.add_row(words, f"{count:,}")
    return rows


def to_check(found: ImportedRobot, source: Source) -> list[str]:
    """What a person should look at before the robot moves, a line each."""
    table, robot = found.table, found.robot
    home = [f for f in table.findings if f.at_home and not f.kind.allowed]
    lines = [f"home collides ({_named(home)}): choose a free one"] if home else []
    if source.tool_frame is None:
        lines.append(f"tool_frame {robot.tool_frame} is a guess: the last link of the longest chain")
    lines.append("accelerations and jerks are conventions: URDF has none")
    given = [f for f in table.of(ContactKind.GIVEN) if f.share > 0.0]
    lines += [f"the SRDF allows pairs that do collide: {_named(given)}"] if given else []
    always = table.of(ContactKind.ALWAYS)
    lines += [f"always overlapping: {_named(always)}"] if always else []
    filled = sorted(
        {item.link for item in robot.shapes if isinstance(item.shape, Mesh)} & {x for f in always for x in f.links}
    )
    if filled:
        lines.append(
            f"of these {', '.join(filled)} judged as solid hulls of meshes, hollows filled: does that overlap?"
        )
    often = sorted(table.of(ContactKind.SOMETIMES), key=lambda f: -f.share)
    lines += [f"judged, most often colliding: {_named(often)}"] if often else []
    unproven = table.of(ContactKind.UNPROVEN)
    lines += [f"judged without a collision found, nor a proof: {_named(unproven)}"] if unproven else []
    return lines


def import_record(found: ImportedRobot) -> dict[str, Any]:
    """The same for machines: the robot, and every pair."""
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
        for item in found.table.findings
    ]
    meshes = [str(path) for path in found.meshes]
    files = {"robot_toml": str(found.path), "urdf": str(found.urdf), "meshes": meshes}
    return {**files, "robot": robot_record(found.robot), "samples": found.table.samples, "pairs": pairs}


def _named(findings: Iterable[PairFinding]) -> str:
    shown = [" x ".join(item.links) + (f" {100.0 * item.share:.1f} %" if item.share else "") for item in findings]
    more = [f"{len(shown) - MOST_PAIRS} more"] if len(shown) > MOST_PAIRS else []
    return ", ".join([*shown[:MOST_PAIRS], *more])

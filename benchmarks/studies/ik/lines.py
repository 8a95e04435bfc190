"""Straight lines of the tool, from every branch and from one.

A line goes 0.1 to 0.3 m from the pose of a random configuration, half of them with a turn besides. The one branch is
followed as others interpolate in Cartesian space: poses every 5 mm, damped least squares from the configuration
before, and no joint may move by more than 0.5 rad between two. It shares no code with ``line_branches``. The same lines
are then asked for with the tool free about an axis.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, spread, table_of
from planner_service import Pose, Robot, load_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics import ToolLine, line_branches
from planner_service.kinematics.tool_line import LINE_METRES, LINE_RADIANS, interpolate, rotation_distance

__all__ = ["run"]

ARMS = {
    "WidowX AI": "wxai",
    "UR5": "ur5",
    "Jaco 2": "kinova",
    "Panda": "panda",
    "SO-101": "example-robot-data:so101",
}

TORCH = (0.6, 0.0, 0.8)
"""The free axis of the second table, in the tool frame: a torch mounted at 37 degrees."""

KINDS = ("fixed", "free")

LINES = 200
"""Of each arm unless asked otherwise."""

MOST_LOOKED_AT = 12
"""Lines of one, in which jumps are looked for."""

STEP, RATE = 0.005, 100.0
"""Metres between poses of the one branch, and radians that a joint may move per metre."""

ARRIVED = 1e-6


def run(queries: int | None = None, seed: int = 0, robot: str | None = None, kept: Kept = NONE) -> Report:
    """``queries`` lines of each arm."""
    names = [name for name in ARMS if robot in (None, name)]
    count = LINES if queries is None else queries
    rows = [
        kept.rows(f"lines {name} {seed} {k}", partial(_rows, name, [seed, k]))[0]
        for name in names
        for k in range(count)
    ]
    lines, free = ([_line(name, [row[of] for row in rows if row["robot"] == name]) for name in names] for of in KINDS)
    caption = (
        "Lines of the tool that are possible to the end; collisions are not looked at. One branch: from the "
        "configuration that the line was made of. Proven: that no motion within the limits keeps the tool within 1 mm "
        "and 5 mrad along it. Lost: possible from one, but not found. Jumps: pieces in which the tool leaves the "
        "line. CPU ms: p50 / p95."
    )
    about = (
        "The same lines with the tool free to turn about an axis at 37 degrees to its z axis, all along and at the "
        "start: with the shortest rotation of this axis, which is to stay within 5 mrad. Without: every branch of the "
        "table before."
    )
    free = [
        {"arm": row["arm"], "without": row["every branch"], **other} for row, other in zip(lines, free, strict=True)
    ]
    tables = (
        table_of("Lines from every branch", lines, caption=caption),
        table_of("Lines with a free axis", free, caption=about),
    )
    return Report("ik lines", tuple(rows), tables, _promises(rows))


def _rows(name: str, seed: list[int]) -> list[Row]:
    rng, robot = np.random.default_rng([*seed, len(name)]), load_robot(ARMS[name])
    low, high = np.maximum(robot.limits.lower, -2 * math.pi), np.minimum(robot.limits.upper, 2 * math.pi)
    q = rng.uniform(low, high)
    way = rng.normal(size=3)
    x, y, z = (way * rng.uniform(0.1, 0.3) / math.sqrt(float(way @ way))).tolist()
    begin = Pose.from_matrix(robot.tool_pose(q))
    turn = rng.normal(size=3) * (0.5 / 3.0) * rng.integers(2)
    px, py, pz = begin.position
    turned = Pose.from_rpy((0.0, 0.0, 0.0), tuple(turn.tolist())) @ Pose((0.0, 0.0, 0.0), begin.quaternion)
    end = Pose((px + x, py + y, pz + z), turned.quaternion)
    return [{"robot": name} | {kind: _found(robot, q, begin, end, kind == "free") for kind in KINDS}]


def _found(robot: Robot, q: FloatArray, begin: Pose, end: Pose, free: bool) -> Row:
    axis = TORCH if free else None
    ms, found = cpu_ms(lambda: line_branches(robot, begin, end, still=q, max_joint_rate=RATE, free_axis=axis))
    one = _one_branch(robot, q, begin, end, free)
    return {
        "branches": len(found.lines),
        "complete": found.complete,
        "whole": found.whole is not None,
        "one": one,
        "proven": found.proven,
        "contradicted": found.ends is not None and one > found.ends + 1e-9,
        "jumps": sum(
            _jumps(robot, line, begin, end, free) for line in found.lines[:MOST_LOOKED_AT] if line.stopped is None
        ),
        "ms": ms,
    }


def _one_branch(robot: Robot, q: FloatArray, begin: Pose, end: Pose, free: bool) -> float:
    """The share of the line that small steps from q have."""
    length = max(math.dist(begin.position, end.position), 0.1 * _apart(begin, end, free))
    steps = math.ceil(length / STEP)
    low, high = robot.limits.lower, robot.limits.upper
    for k in range(1, steps + 1):
        wanted, before = _at(begin, end, k / steps, free), q
        for _ in range(30):
            error, J = _error(robot, q, wanted, free)
            if float(np.abs(error).max()) < ARRIVED:
                break
            damping = 1e-3 * float(error @ error) + 1e-12
            q = np.clip(q + J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), error), low, high)
        off = float(np.abs(_error(robot, q, wanted, free)[0]).max())
        if off > ARRIVED or float(np.abs(q - before).max()) > RATE * length / steps:
            return (k - 1) / steps
    return 1.0


def _apart(a: Pose, b: Pose, free: bool) -> float:
    """Radians between two orientations, or between the free axis in both."""
    if not free:
        return rotation_distance(a, b)
    u, v = a.rotation @ TORCH, b.rotation @ TORCH
    return 2.0 * math.asin(min(1.0, math.sqrt(float((u - v) @ (u - v))) / 2.0))


def _at(begin: Pose, end: Pose, u: float, free: bool) -> Pose:
    """A place of the line; the axis between its directions at the ends, by its angle from the first."""
    pose = interpolate(begin, end, u)
    if not free:
        return pose
    a, b = begin.rotation @ TORCH, end.rotation @ TORCH
    angle = _apart(begin, end, free)
    wanted = a if angle < 1e-9 else (math.sin((1.0 - u) * angle) * a + math.sin(u * angle) * b) / math.sin(angle)
    have = pose.rotation @ TORCH
    half = have + wanted
    half /= math.sqrt(float(half @ half))  # half a turn about it exchanges the two, half a turn about one keeps that
    turn = Pose(quaternion=(0.0, *half.tolist())) @ Pose(quaternion=(0.0, *have.tolist()))
    return Pose(pose.position, (turn @ Pose(quaternion=pose.quaternion)).quaternion)


def _error(robot: Robot, q: FloatArray, wanted: Pose, free: bool) -> tuple[FloatArray, FloatArray]:
    """How far the tool at q is from a place (6,), and the derivative of that (6, n)."""
    T, J = robot.tool_pose(q), robot.tool_jacobian(q)
    if free:
        have, aim = T[:3, :3] @ TORCH, wanted.rotation @ TORCH
        across = np.eye(3) - np.outer(have, have)
        shift = np.array(wanted.position) - T[:3, 3]
        return np.concatenate([shift, np.cross(have, aim)]), np.concatenate([J[:3], across @ J[3:]])
    R = wanted.rotation @ T[:3, :3].T
    spin = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2.0
    return np.concatenate([np.array(wanted.position) - T[:3, 3], spin]), J


def _jumps(robot: Robot, line: ToolLine, begin: Pose, end: Pose, free: bool) -> int:
    """Pieces between waypoints in whose middle the tool is off the line."""
    count = 0
    for k in range(len(line.waypoints) - 1):
        for share in (0.25, 0.5, 0.75):
            q = (1.0 - share) * line.waypoints[k] + share * line.waypoints[k + 1]
            at = float((1.0 - share) * line.fractions[k] + share * line.fractions[k + 1])
            here = Pose.from_matrix(robot.tool_pose(q))
            wanted = _at(begin, end, at, free)
            nearest = _nearest(begin, end, here, at)
            off = math.dist(here.position, nearest.position) > LINE_METRES
            if off or _apart(here, wanted, free) > 2.0 * LINE_RADIANS:
                count += 1
                break
    return count


def _nearest(begin: Pose, end: Pose, here: Pose, at: float) -> Pose:
    """The place of the line that is nearest to a position."""
    a, b = np.array(begin.position), np.array(end.position)
    way = b - a
    square = float(way @ way)
    share = at if square == 0.0 else float((np.array(here.position) - a) @ way) / square
    return interpolate(begin, end, min(1.0, max(0.0, share)))


def _line(name: str, rows: list[Row]) -> Row:
    count = len(rows)
    return {
        "arm": name,
        "lines": count,
        "branches": f"{sum(row['branches'] for row in rows) / count:.1f}",
        "one branch": f"{100 * sum(row['one'] == 1.0 for row in rows) / count:.1f} %",
        "every branch": f"{100 * sum(row['whole'] for row in rows) / count:.1f} %",
        "none, proven": f"{100 * sum(row['proven'] for row in rows) / count:.1f} %",
        "neither": f"{100 * sum(not row['whole'] and not row['proven'] for row in rows) / count:.1f} %",
        "contradictions": sum(row["contradicted"] for row in rows),
        "lost": sum(row["one"] == 1.0 and not row["whole"] for row in rows),
        "jumps": sum(row["jumps"] for row in rows),
        "ms": spread([row["ms"] for row in rows], 0),
    }


def _promises(rows: list[Row]) -> tuple[Promise, ...]:
    both = [row[kind] for row in rows for kind in KINDS]
    every, one = (sum(bool(row["fixed"][key] == 1.0) for row in rows) for key in ("whole", "one"))
    lost = sum(row["fixed"]["whole"] and not row["free"]["whole"] for row in rows)
    jumps, wrong = sum(row["jumps"] for row in both), sum(row["contradicted"] for row in both)
    return (
        Promise("every branch has at least as many lines as one", f"{every}, {one}", every >= one),
        Promise("no line is lost by freeing an axis", str(lost), lost == 0),
        Promise("0 jumps", str(jumps), jumps == 0),
        Promise("nothing goes beyond where a line is proven to end", str(wrong), wrong == 0),
    )

"""Inverse kinematics that is complete, held against a thousand starts of another solver, and against closed forms.

That solver knows the chain of bodies, numpy and nothing else. What it finds within 1e-11 m and rad of a pose and within
the limits must be in a box of the answer, and so must the configuration that a pose was made of, and what ssik finds if
it is installed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, p50, spread, table_of
from benchmarks.studies.ik import closed_forms
from benchmarks.studies.ik.closed_forms import ClosedForm
from planner_service import Pose, PoseGoal, Robot, inverse_kinematics, load_robot
from planner_service.errors import UnknownName
from planner_service.geometry.arrays import BoolArray, FloatArray
from planner_service.kinematics import InverseSolutions
from planner_service.kinematics.inverse import ToolChain
from planner_service.robot.kinematic_tree import chain_to_base, joint_motion

__all__ = ["run", "seeded"]

QUERIES, STARTS, STEPS = 60, 1000, 40

STARTED = 60
"""Poses of each arm, the first ones, that are solved by random starts, too."""

ARMS = {
    "WidowX AI": "wxai",
    "UR5": "ur5",
    "Jaco 2": "kinova",
    "SO-101": "example-robot-data:so101",
    "Panda": "panda",
    "xArm 7": "xarm7",
}
"""Of an arm with seven joints the third is locked, at one of ``LOCKS`` shares of its range."""

LOCKS = (0.2, 0.45, 0.55, 0.9)
ONCE_IN_CLOSED_FORM = ("xArm 7",)
"""ssik is asked at the first of ``LOCKS`` alone: it prepares for minutes for each, once on a machine."""

FREE = "SO-101, tool free about its axis"

SAME = 1e-11
"""Metres and radians: what ``InverseSolutions`` promises."""

FINE = 1e-3
"""Radians or metres to which configurations are to be known: ``InverseSolutions.resolution``."""

TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Case:
    """A pose; the configuration that it was made of, if it was; and how."""

    kind: str
    pose: Pose
    q: FloatArray | None


def run(queries: int | None, seed: int, robot: str | None, kept: Kept = NONE) -> Report:
    """Poses of each arm, or of the one of that name.

    Half are those of a configuration, two in ten near a singularity and one at a limit or near it; the others have a
    reachable place and a random orientation.

    Raises:
        UnknownName: there is no such arm.
    """
    count = QUERIES if queries is None else queries
    names = (*ARMS, FREE)
    if robot is not None and robot not in names:
        raise UnknownName("robot", robot, names)
    rows = [row for name in names if robot in (None, name) for row in _rows(name, count, seed, kept)]
    lines = [_line(name, [row for row in rows if row["robot"] == name]) for name in names if robot in (None, name)]
    caption = (
        "Solutions: those that differ by whole turns are one. Contradictions: configurations that others know, or that "
        f"a pose was made of, in no box. Started: also solved by {STARTS:,} starts of damped least squares; missed: "
        f"those of which they found fewer solutions. Coarser: some configuration may be farther than {FINE:g} rad from "
        "all that are returned. CPU ms of poses with solutions and of those proven to have none, and boxes: p50 / p95."
    )
    if not closed_forms.installed():
        caption += f" Closed forms were not asked: {closed_forms.INSTALL}."
    tables = [table_of("Complete inverse kinematics", lines, caption=caption)]
    if beside := [_beside(name, rows) for name in names if any(_asked(row, name) for row in rows)]:
        caption = (
            "ssik, from the same axes, without generated code. Its solutions: within the limits. Inexact: those from "
            f"which Newton's method leads to no configuration within {SAME:.0e}. Fewer, more: poses of which it found "
            "fewer or more solutions, those in doubt left out. CPU ms: p50 / p95."
        )
        tables.append(table_of("Beside closed forms", beside, caption=caption))
    return Report("ik poses", tuple(rows), tuple(tables), _promises(rows))


def _rows(name: str, queries: int, seed: int, kept: Kept) -> Iterator[Row]:
    whole = load_robot(ARMS["SO-101" if name == FREE else name])
    arm = ToolChain.of(whole, whole.home).robot
    lower, upper = arm.limits.lower, arm.limits.upper
    locked = [arm.locked({arm.joint_names[2]: float(lower[2] + x * (upper - lower)[2])}) for x in LOCKS]
    robots = locked if arm.n > 6 else [arm]
    asked = closed_forms.installed() and all(map(ClosedForm.suits, robots))
    many = 1 if name in ONCE_IN_CLOSED_FORM else len(robots)
    forms = [ClosedForm(robot) if asked and k < many else None for k, robot in enumerate(robots)]
    for k in range(queries):
        which = k % len(robots)
        yield kept.rows(f"poses {name} {seed} {k}", partial(_row, name, robots[which], forms[which], [seed, k]))[0]


def _row(name: str, robot: Robot, form: ClosedForm | None, seed: list[int]) -> list[Row]:
    rng = np.random.default_rng(seed)
    case = _case(robot, seed[-1] % 10, rng)
    goal = PoseGoal(case.pose)
    if name == FREE:
        turned = case.pose @ Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, float(rng.uniform(-3.0, 3.0))))
        goal = PoseGoal(turned, free_axis=(0.0, 0.0, 1.0))
    ms, found = cpu_ms(partial(_all, robot, goal))
    known = [*seeded(robot, goal, rng)] if seed[-1] < STARTED else []
    closed_ms, closed, inexact = (math.nan, list[FloatArray](), 0) if form is None else _closed(form, robot, goal)
    own = [] if case.q is None else [case.q]
    every = (*known, *closed, *own)
    contradictions = [q.tolist() for q in every if _box_of(found, q) is None and not _in_doubt(found, q)]
    row: Row = {
        "robot": name,
        "kind": case.kind,
        "solutions": len(_but_for_turns(found.q, robot)),
        "seeded": _seen(found, known, robot) if seed[-1] < STARTED else None,
        "complete": found.complete,
        "resolution": found.resolution,
        "reachable": found.reachable,
        "contradictions": contradictions,
        "boxes": found.boxes,
        "ms": ms,
    }
    if form is not None:
        beyond = sum(_box_of(found, q) is None for q in closed)
        row["closed"] = {"ms": closed_ms, "all": len(closed), "seen": _seen(found, closed, robot)}
        row["closed"] |= {"inexact": inexact, "beyond": beyond}
    return [row]


def _closed(form: ClosedForm, robot: Robot, goal: PoseGoal) -> tuple[float, list[FloatArray], int]:
    """CPU ms; the configurations within the limits that ssik leads to; and how many of its solutions lead to none."""
    ms, rough = cpu_ms(partial(form.solve, goal.pose))
    if not len(rough):
        return ms, [], 0
    q = _within_a_turn(robot, rough)
    lower, upper = robot.limits.lower, robot.limits.upper
    q = q[np.all((lower - SAME <= q) & (q <= upper + SAME), axis=1)]
    if not len(q):
        return ms, [], 0
    far = ~_arrived(robot, goal, q)
    q[far] = _settled(robot, goal, q[far], 8) if far.any() else q[far]
    arrived = _arrived(robot, goal, q)
    return ms, [each for each in q[arrived] if np.all((lower <= each) & (each <= upper))], int((~arrived).sum())


def _seen(found: InverseSolutions, known: list[FloatArray], robot: Robot) -> int:
    """How many of the solutions, but for whole turns, are known."""
    seen = [found.q[index] for q in known if (index := _box_of(found, q)) is not None]
    return len(_but_for_turns(np.array(seen).reshape(-1, robot.n), robot))


def _all(robot: Robot, goal: PoseGoal) -> InverseSolutions:
    return inverse_kinematics(robot, goal, complete=True)


def _case(robot: Robot, turn: int, rng: np.random.Generator) -> Case:
    lower, upper = robot.limits.lower, robot.limits.upper
    q, kind = rng.uniform(lower, upper), "reachable"
    if turn in (0, 1):
        q, kind = _near_singular(robot, 10.0 ** rng.uniform(-5.0, -1.5), rng), "near a singularity"
    elif turn == 2:
        joint, gap = rng.integers(robot.n), rng.choice((0.0, 10.0 ** rng.uniform(-12.0, -2.0)))
        q[joint] = lower[joint] + gap if rng.random() < 0.5 else upper[joint] - gap
        kind = "near a limit" if gap else "at a limit"
    pose = Pose.from_matrix(robot.tool_pose(q))
    if turn >= 5:
        orientation = rng.normal(size=4)
        pose = Pose(pose.position, tuple((orientation / math.sqrt(float(orientation @ orientation))).tolist()))
        return Case("random orientation", pose, None)
    return Case(kind, pose, q)


def _near_singular(robot: Robot, wanted: float, rng: np.random.Generator) -> FloatArray:
    """A configuration whose Jacobian's smallest singular value is about as wanted, by a random walk downhill."""

    def least(q: FloatArray) -> float:
        return float(np.linalg.svd(robot.tool_jacobian(q), compute_uv=False)[-1])

    lower, upper = robot.limits.lower, robot.limits.upper
    q = min((rng.uniform(lower, upper) for _ in range(10)), key=least)
    for _ in range(300):
        if least(q) <= wanted:
            break
        other = q + min(1.0, 3.0 * least(q)) * rng.normal(size=robot.n)
        if np.all((lower < other) & (other < upper)) and least(other) < least(q):
            q = other
    return q


def _but_for_turns(Q: FloatArray, robot: Robot) -> set[tuple[float, ...]]:
    """Solutions, those that differ by whole turns as one."""
    turned = np.round(TURN * _turns(robot) * np.floor(Q / TURN + 1e-6), 9)
    return {tuple(row) for row in np.round(Q - turned, 6).tolist()}


def _box_of(found: InverseSolutions, q: FloatArray) -> int | None:
    inside = np.all((found.lower <= q) & (q <= found.upper), axis=1)
    return int(inside.argmax()) if inside.any() else None


def _in_doubt(found: InverseSolutions, q: FloatArray) -> bool:
    """Whether an unresolved box has q, up to whole turns."""
    low, high = found.unresolved[:, 0], found.unresolved[:, 1]
    off = q - (low + high) / 2
    off = np.minimum(np.abs(off), np.abs(off - TURN * np.round(off / TURN)))
    return bool(np.any(np.all(off <= (high - low) / 2 + 1e-12, axis=1)))


def seeded(robot: Robot, goal: PoseGoal, rng: np.random.Generator, starts: int = STARTS) -> Iterator[FloatArray]:
    """Where random starts arrive at the goal, within the limits."""
    q = _settled(robot, goal, rng.uniform(robot.limits.lower, robot.limits.upper, (starts, robot.n)))
    for place in q[_arrived(robot, goal, q)]:
        if np.all((robot.limits.lower <= place) & (place <= robot.limits.upper)):
            yield place


def _settled(robot: Robot, goal: PoseGoal, q: FloatArray, steps: int = STEPS) -> FloatArray:
    """Where damped steps lead, the last five of which are Newton's."""
    for step in range(steps):
        error, jacobian = _errors(robot, goal, q)
        damping = 0.0 if step >= steps - 5 else 1e-3 * (error**2).sum(axis=1)[:, None, None] + 1e-12
        square = jacobian.transpose(0, 2, 1) @ jacobian + (damping + 1e-13) * np.eye(robot.n)
        move = np.linalg.solve(square, jacobian.transpose(0, 2, 1) @ error[:, :, None])[:, :, 0]
        q = q - move * np.minimum(1.0, 1.0 / np.maximum(np.abs(move).max(axis=1, keepdims=True), 1e-300))
    return _within_a_turn(robot, q)


def _within_a_turn(robot: Robot, q: FloatArray) -> FloatArray:
    """The same places, angles less than a turn above their lower limits."""
    return np.asarray(q - TURN * np.round((q - robot.limits.lower) / TURN - 0.5) * _turns(robot))


def _arrived(robot: Robot, goal: PoseGoal, q: FloatArray) -> BoolArray:
    """Whether each row brings the tool to the goal."""
    error, _ = _errors(robot, goal, q)
    return np.asarray(np.maximum(_sizes(error[:, :3]), _sizes(error[:, 3:])) < SAME / 2)


def _turns(robot: Robot) -> FloatArray:
    """1 for joints that turn, 0 for those that slide."""
    return 1.0 - np.array(robot.sliding, dtype=np.float64)


def _sizes(rows: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((rows**2).sum(axis=1)))


def _errors(robot: Robot, goal: PoseGoal, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far tools are off, positions then rotations (m, 6), and the derivatives by q (m, 6, n)."""
    T, axes = np.repeat(np.eye(4)[None], len(q), axis=0), []
    for index in reversed(chain_to_base(robot.bodies, robot.tool_body)):
        body = robot.bodies[index]
        T = T @ body.placement
        axes.append((body, (T[:, :3, :3] @ body.axis), T[:, :3, 3]))
        angle = body.multiplier * q[:, body.q_index]
        x, y, z = body.axis.tolist()
        if body.prismatic:
            motion = np.eye(4) + angle[:, None, None] * (joint_motion((x, y, z), 1.0, slides=True) - np.eye(4))
        else:
            quarter, half = (joint_motion((x, y, z), by, slides=False) for by in (math.pi / 2, math.pi))
            straight = (np.eye(4) + half) / 2
            across, turned = np.eye(4) - straight, quarter - straight
            motion = straight + np.cos(angle)[:, None, None] * across + np.sin(angle)[:, None, None] * turned
        T = T @ motion
    T = T @ robot.tool_placement
    shift = T[:, :3, 3] - np.array(goal.pose.position)
    R = T[:, :3, :3]
    if goal.free_axis is None:
        N = R @ goal.pose.rotation.T
        vector = np.stack([N[:, 2, 1] - N[:, 1, 2], N[:, 0, 2] - N[:, 2, 0], N[:, 1, 0] - N[:, 0, 1]], axis=1) / 2
        cosine = (np.trace(N, axis1=1, axis2=2) - 1.0) / 2
    else:
        have, want = R @ np.array(goal.free_axis), goal.pose.rotation @ np.array(goal.free_axis)
        vector, cosine = np.cross(want, have), have @ want
    sine = _sizes(vector)
    turn = vector * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-300))[:, None]
    jacobian = np.zeros((len(q), 6, robot.n))
    for body, axis, origin in axes:
        moves = axis if body.prismatic else np.cross(axis, T[:, :3, 3] - origin)
        jacobian[:, :3, body.q_index] += body.multiplier * moves
        if not body.prismatic:
            jacobian[:, 3:, body.q_index] += body.multiplier * axis
    if goal.free_axis is not None:  # a turn about the axis is no error
        along = have[:, :, None] * have[:, None, :]
        jacobian[:, 3:] -= along @ jacobian[:, 3:]
    if goal.orientation_tolerance >= math.pi:  # nor is any
        turn, jacobian[:, 3:] = np.zeros_like(turn), 0.0
    return np.concatenate([shift, turn], axis=1), jacobian


def _line(name: str, rows: list[Row]) -> Row:
    some = [row["ms"] for row in rows if row["solutions"]] or [math.nan]
    none = [row["ms"] for row in rows if not row["solutions"] and row["complete"]] or [math.nan]
    started = [row for row in rows if row["seeded"] is not None]
    return {
        "arm": name,
        "poses": len(rows),
        "solutions": sum(row["solutions"] for row in rows),
        "contradictions": sum(len(row["contradictions"]) for row in rows),
        "in doubt": sum(not row["complete"] for row in rows),
        "coarser": sum(row["resolution"] > FINE for row in rows),
        "none, proven": sum(not row["solutions"] and row["complete"] for row in rows),
        "started": len(started),
        "missed": sum(row["seeded"] < row["solutions"] for row in started),
        "ms": spread(some, 2),
        "ms of none": spread(none, 2),
        "boxes": spread([row["boxes"] for row in rows]),
    }


def _asked(row: Row, name: str) -> bool:
    return row["robot"] == name and "closed" in row


def _beside(name: str, rows: list[Row]) -> Row:
    asked = [row for row in rows if _asked(row, name)]
    sure = [row for row in asked if row["complete"]]
    return {
        "arm": name,
        "poses": len(asked),
        "its solutions": sum(row["closed"]["all"] for row in asked),
        "inexact": sum(row["closed"]["inexact"] for row in asked),
        "fewer": sum(row["closed"]["seen"] < row["solutions"] for row in sure),
        "more": sum(row["closed"]["beyond"] > 0 for row in sure),
        "its ms": spread([row["closed"]["ms"] for row in asked], 2),
        "ms": spread([row["ms"] for row in asked], 2),
    }


def _promises(rows: list[Row]) -> tuple[Promise, ...]:
    wrong = sum(len(row["contradictions"]) for row in rows)
    coarse = sum(row["resolution"] > FINE for row in rows)
    times = {some: [row["ms"] for row in rows if bool(row["solutions"]) == some] or [0.0] for some in (True, False)}
    half = [p50(times[some]) for some in (True, False)]
    return (
        Promise("0 solutions that other solvers find are missing", f"{wrong}", wrong == 0),
        Promise(
            f"all configurations known to {FINE:g} rad for all but 0.5 % of poses",
            f"{coarse} of {len(rows):,}",
            coarse <= 0.005 * len(rows),
        ),
        Promise(
            "half of the poses with solutions take at most 3 ms of CPU, half of those without at most 10 ms",
            f"{half[0]:.1f}, {half[1]:.1f} ms",
            half[0] <= 3.0 and half[1] <= 10.0,
        ),
    )

"""Where contact is meant, derived anew: which pairs may go unjudged on which stretch of a motion, and why.

There are three rules, and what none of them makes is not exempt:

- the robot's own way out of a named pose, and back into it: its pairs, on that one straight piece;
- fingers and what they take or leave: on the straight line along the approach to where the gripper closes or opens;
- what is carried and what it stood or will stand on: near that place on the same line, no deeper in it than there.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from planner_service.certify import ExemptInterval
from planner_service.collision import CollisionChecker
from planner_service.geometry.shapes import FloatArray
from planner_service.grasping.guards import LONGEST_APPROACH, MEANT_OVERLAP, tool_line
from planner_service.path.joint_path import JointPath
from planner_service.records.task_sequence import Leg, fingers_of
from planner_service.scene.names import Names
from planner_service.tasks.result import MAX_SUPPORT_GAP

__all__ = ["Ruling", "ruled"]

Pair = tuple[str, str]

ROUNDING = 1e-9
"""Of path length, by which a stretch may reach beyond what the rule gives."""


@dataclass(frozen=True)
class Ruling:
    """What the rules say of a pair on a stretch.

    Attributes:
        reason: Why the pair may touch there; empty if it may not.
        objection: Why it may not.
    """

    reason: str = ""
    objection: str = ""


def ruled(before: Leg | None, leg: Leg, stretch: ExemptInterval, pair: Pair) -> Ruling:
    """Whether a pair may go unjudged on a stretch of a motion.

    Args:
        before: The motion before it in its task.
        pair: What the two are called in the motion's scene; see ``Names``.
    """
    path, names, both = leg.trajectory.path, Names(leg.robot, leg.scene), frozenset(pair)
    for retreat in leg.robot.retreats:
        if both in {frozenset(each) for each in names.links(retreat.pairs)}:
            rest = leg.robot.pose(retreat.pose)
            for begin, end in _fixed_pieces(path, rest, retreat.to):
                if begin - ROUNDING <= stretch.s_start and stretch.s_end <= end + ROUNDING:
                    return Ruling(reason=retreat.reason)
            return Ruling(objection=f"only on the straight way between {retreat.pose!r} and where its way out ends")
    fingers = {names.link(link) for link in fingers_of(leg.robot)}
    obstacles = {names.object(obstacle.name) for obstacle in leg.scene.obstacles}
    if leg.taken is not None and _are(both, fingers, thing := names.object(leg.taken.name)):
        return _touching(leg, stretch, pair, f"fingers may touch {thing}, which they take", at_end=True)
    if before is not None and before.left is not None and _are(both, fingers, thing := names.object(before.left.name)):
        return _touching(leg, stretch, pair, f"fingers may touch {thing}, which they leave", at_end=False)
    if (
        before is not None
        and before.taken is not None
        and _are(both, obstacles, thing := names.object(before.taken.name))
    ):
        return _standing(leg, stretch, pair, f"{thing} stood there", at_end=False)
    if leg.left is not None and _are(both, obstacles, thing := names.object(leg.left.name)):
        return _standing(leg, stretch, pair, f"{thing} is to stand there", at_end=True)
    return Ruling(objection="no rule of picking or placing allows that contact there")


def _are(names: frozenset[str], some: Collection[str], other: str) -> bool:
    """Whether two names are one of ``some`` and ``other``."""
    return other in names and all(name in some for name in names - {other})


def _fixed_pieces(path: JointPath, rest: FloatArray, to: FloatArray) -> list[tuple[float, float]]:
    """Where a path begins with the straight piece from a pose to the end of its way out, and where it ends with it."""
    points, found = path.waypoints, []
    if len(points) > 1 and not path.blends[:2].any() and _same(points[0], rest) and _same(points[1], to):
        found.append((0.0, float(path.knots[1])))
    if len(points) > 1 and not path.blends[-2:].any() and _same(points[-1], rest) and _same(points[-2], to):
        found.append((float(path.knots[-2]), path.length))
    return found


def _same(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.abs(a - b).max() <= ROUNDING)


def _touching(leg: Leg, stretch: ExemptInterval, pair: Pair, reason: str, *, at_end: bool) -> Ruling:
    """Of a finger and what it takes or leaves."""
    looks, objection = _line(leg, stretch, LONGEST_APPROACH, at_end=at_end)
    if not objection:
        (depth,) = _depths(leg, looks[:1], pair)
        if depth > MEANT_OVERLAP:
            objection = f"{pair[0]} stands {depth * 1000:.1f} mm inside {pair[1]} where the gripper closes or opens"
    return Ruling(objection=objection) if objection else Ruling(reason)


def _standing(leg: Leg, stretch: ExemptInterval, pair: Pair, reason: str, *, at_end: bool) -> Ruling:
    """Of what is carried and what it stood or is to stand on."""
    looks, objection = _line(leg, stretch, MAX_SUPPORT_GAP, at_end=at_end)
    if not objection:
        depths = _depths(leg, looks, pair)
        deepest = MEANT_OVERLAP if at_end else max(MEANT_OVERLAP, depths[0])  # as deep as it stood it may be lifted
        if max(depths) > deepest + ROUNDING:
            objection = f"{pair[0]} comes {max(depths) * 1000:.1f} mm into {pair[1]}"
    return Ruling(objection=objection) if objection else Ruling(reason)


def _depths(leg: Leg, looks: FloatArray, pair: Pair) -> list[float]:
    """How deep two things overlap at each of some configurations (m, n), in metres."""
    checker = CollisionChecker(leg.robot, leg.scene)
    return [max((c.depth for c in checker.contacts(q) if {c.a, c.b} == set(pair)), default=0.0) for q in looks]


def _line(leg: Leg, stretch: ExemptInterval, longest: float, *, at_end: bool) -> tuple[FloatArray, str]:
    """As ``tool_line`` says, from where the gripper closes or opens to the other end of a stretch."""
    path = leg.trajectory.path
    near, far = (path.length, stretch.s_start) if at_end else (0.0, min(stretch.s_end, path.length))
    return tool_line(leg.robot, path, near, far, longest)

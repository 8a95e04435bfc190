"""Rules that say which pairs may go unchecked on which stretch of a motion, because contact is intended there.

There are four rules; nothing else is exempt:

- The robot's own way out of a named pose, and back into it: the pairs of that retreat, on that one straight piece.
- Fingers and what they take or leave: on the straight approach to where the gripper closes or opens.
- What touches where the first motion begins: until it has come apart, and never deeper than before.
- A carried object and what it stood or will stand on: near that place on a straight line, and no deeper in it than
  there.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planner_service.certify import MAX_OVERLAP, Certifier, ExemptInterval
from planner_service.collision import CollisionChecker
from planner_service.geometry.arrays import FloatArray
from planner_service.grasping.guards import LONGEST_APPROACH, MEANT_OVERLAP, tool_line
from planner_service.path.joint_path import JointPath
from planner_service.planning.collision_recovery import LEAVING
from planner_service.planning.task_result import MAX_SUPPORT_GAP
from planner_service.records.task_sequence import TaskMotion, fingers_of
from planner_service.scene.names import Names

__all__ = ["Ruling", "ruled"]

Pair = tuple[str, str]

ROUNDING = 1e-9
"""Path length by which a stretch may reach beyond what its rule allows."""

LOOKS = 33
"""Places on a way out of a collision at which no depth may have grown."""

SAME_DEPTH = 5e-8
"""Metres: bounds of an overlap are worked out to some nanometres, and a depth in a file has ten of them to spare."""


@dataclass(frozen=True)
class Ruling:
    """What the rules say about a pair on a stretch.

    Attributes:
        reason: Why the pair may touch there; empty if it may not.
        objection: Why it may not; empty if it may.
    """

    reason: str = ""
    objection: str = ""


def ruled(
    before: TaskMotion | None, motion: TaskMotion, stretch: ExemptInterval, pair: Pair, overlap: float = MAX_OVERLAP
) -> Ruling:
    """Whether a pair may go unchecked on a stretch of a motion, or overlap there.

    Args:
        before: The motion before it in its task; None for the first.
        pair: The names of the two in the motion's scene; see ``Names``.
        overlap: Metres by which pairs may overlap where the first motion begins.
    """
    if stretch.depth is not None:
        objection = _stuck(before, motion, stretch, pair, overlap)
        return Ruling(objection=objection) if objection else Ruling(LEAVING)
    path, names, both = motion.trajectory.path, Names(motion.robot, motion.scene), frozenset(pair)
    for retreat in motion.robot.retreats:
        if both in {frozenset(each) for each in names.links(retreat.pairs)}:
            rest = motion.robot.pose(retreat.pose)
            for begin, end in _fixed_pieces(path, rest, retreat.to):
                if begin - ROUNDING <= stretch.s_start and stretch.s_end <= end + ROUNDING:
                    return Ruling(reason=retreat.reason)
            return Ruling(objection=f"only on the straight way between {retreat.pose!r} and where its way out ends")
    fingers, gripper = {names.link(link) for link in fingers_of(motion.robot)}, motion.robot.gripper
    obstacles = {names.object(obstacle.name) for obstacle in motion.scene.obstacles}
    if (
        gripper is not None
        and motion.taken is not None
        and _are(both, fingers, thing := names.object(motion.taken.name))
    ):
        return _touching(motion, stretch, pair, gripper.touching(thing, "take"), at_end=True)
    left = None if before is None else before.left
    if gripper is not None and left is not None and _are(both, fingers, thing := names.object(left.name)):
        return _touching(motion, stretch, pair, gripper.touching(thing, "leave"), at_end=False)
    if (
        before is not None
        and before.taken is not None
        and _are(both, obstacles, thing := names.object(before.taken.name))
    ):
        return _standing(motion, stretch, pair, f"{thing} stood there", at_end=False)
    if motion.left is not None and _are(both, obstacles, thing := names.object(motion.left.name)):
        return _standing(motion, stretch, pair, f"{thing} is to stand there", at_end=True)
    return Ruling(objection="no rule of picking or placing allows that contact there")


def _stuck(before: TaskMotion | None, motion: TaskMotion, stretch: ExemptInterval, pair: Pair, overlap: float) -> str:
    """Why a pair may not leave an overlap on a stretch; empty if it may."""
    if before is not None or stretch.s_start > 0.0 or stretch.depth is None:
        return "only where the first motion begins may a pair overlap"
    path = motion.trajectory.path
    certifier = Certifier(motion.robot, motion.scene)
    found = certifier.overlaps(path(np.linspace(0.0, min(stretch.s_end, path.length), LOOKS)))
    depths = [max((at.get(names, 0.0) for names in (pair, pair[::-1])), default=0.0) for at in found]
    touching = [pair in at or pair[::-1] in at for at in found]
    if not touching[0]:
        return "they do not touch where the motion begins"
    if depths[0] > overlap + ROUNDING:
        return f"they overlap by {depths[0] * 1e3:.4f} mm, and start_overlap allows {overlap * 1e3:g} mm"
    if stretch.depth > depths[0] + SAME_DEPTH:
        return f"they overlap by {depths[0] * 1e3:.4f} mm where it begins, not by {stretch.depth * 1e3:.4f} mm"
    if any(later > sooner + SAME_DEPTH for sooner, later in pairwise(depths)):
        return "they come deeper into each other"
    return "they have not come apart where the stretch ends" if touching[-1] else ""


def _are(names: frozenset[str], group: Collection[str], other: str) -> bool:
    """Whether the names are ``other`` and one of ``group``."""
    return other in names and all(name in group for name in names - {other})


def _fixed_pieces(path: JointPath, rest: FloatArray, to: FloatArray) -> list[tuple[float, float]]:
    """The stretches at the ends of a path that are the straight piece between a pose and the end of its way out."""
    points, pieces = path.waypoints, list[tuple[float, float]]()
    if len(points) == 1 and _same(points[0], rest):  # it stays there
        pieces.append((0.0, 0.0))
    if len(points) > 1 and not path.blends[:2].any() and _same(points[0], rest) and _same(points[1], to):
        pieces.append((0.0, float(path.knots[1])))
    if len(points) > 1 and not path.blends[-2:].any() and _same(points[-1], rest) and _same(points[-2], to):
        pieces.append((float(path.knots[-2]), path.length))
    return pieces


def _same(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.abs(a - b).max() <= ROUNDING)


def _touching(motion: TaskMotion, stretch: ExemptInterval, pair: Pair, reason: str, *, at_end: bool) -> Ruling:
    """The rule for a finger and what it takes or leaves."""
    samples, objection = _line(motion, stretch, LONGEST_APPROACH, at_end=at_end)
    if not objection:
        (depth,) = _depths(motion, samples[:1], pair)
        if depth > MEANT_OVERLAP:
            objection = f"{pair[0]} stands {depth * 1000:.1f} mm inside {pair[1]} where the gripper closes or opens"
    return Ruling(objection=objection) if objection else Ruling(reason)


def _standing(motion: TaskMotion, stretch: ExemptInterval, pair: Pair, reason: str, *, at_end: bool) -> Ruling:
    """The rule for a carried object and what it stood or will stand on."""
    samples, objection = _line(motion, stretch, MAX_SUPPORT_GAP, at_end=at_end, any_direction=True)
    if not objection:
        depths = _depths(motion, samples, pair)
        deepest = MEANT_OVERLAP if at_end else max(MEANT_OVERLAP, depths[0])  # as deep as it stood it may be lifted
        if max(depths) > deepest + ROUNDING:
            objection = f"{pair[0]} comes {max(depths) * 1000:.1f} mm into {pair[1]}"
    return Ruling(objection=objection) if objection else Ruling(reason)


def _depths(motion: TaskMotion, samples: FloatArray, pair: Pair) -> list[float]:
    """How deep two things overlap at each of some configurations (m, n), in metres."""
    checker = CollisionChecker(motion.robot, motion.scene)
    return [max((c.depth for c in checker.contacts(q) if {c.a, c.b} == set(pair)), default=0.0) for q in samples]


def _line(
    motion: TaskMotion, stretch: ExemptInterval, longest: float, *, at_end: bool, any_direction: bool = False
) -> tuple[FloatArray, str]:
    """As ``tool_line`` says, from where the gripper closes or opens to the other end of a stretch."""
    path = motion.trajectory.path
    near, far = (path.length, stretch.s_start) if at_end else (0.0, min(stretch.s_end, path.length))
    return tool_line(motion.robot, path, near, far, longest, any_direction=any_direction)

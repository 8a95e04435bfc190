"""Antipodal grasps: two contacts that face each other, each within the friction cone of the other.

Two fingers hold an object where the line through both contacts lies in both cones of friction (Nguyen, "Constructing
force-closure grasps", IJRR 7(3), 1988). Lines drawn at random meet the surface; from where they do, a line along the
normal finds the surface on the other side, and is turned to halve the angle between both normals.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import BoolArray, FloatArray, along, cosines_and_sines, cross
from planner_service.geometry.composite import Pieces
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance, whole
from planner_service.grasping.covering import COARSER, MAX_GRASPS, MOST, covering
from planner_service.grasping.grasps import tool_rotation
from planner_service.grasping.guards import grasp_objection, hand_objection
from planner_service.grasping.hand import DEPTHS, HandCheck
from planner_service.grasping.held import FRICTION, mass_of, require_fingers, require_friction, slopes, values
from planner_service.grasping.lines import pieces_of, runs_along
from planner_service.grasping.openings import FINGER_ROOMS
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle

__all__ = ["MAX_SEED", "antipodal_grasps"]

MAX_SEED = 2**63 - 1

LINES = 400
"""Drawn at random: on a mug, half of them meet its wall, and twenty its handle."""

TURNS = 3
"""How often a line is turned towards both normals: of two planes 20 degrees apart the first one does."""

MAX_PAIRS = 48
"""Pairs of contacts from which grasps are made at most: each is approached from eight sides, either way round."""

ROLLS = 8

ALIKE_PAIRS, ALIKE_AXES = 0.005, 0.1
"""Metres between the middles of two pairs, and radians between their axes: two pairs are alike if their distance over
the first and their turn over the second are together below 1."""

WHOLE_WIDTHS = 2e-4
"""Metres to which widths are rounded up for fingers that turn."""

MAX_SPANS = 3
"""Stretches of an object on one line that fingers may close on together: the walls of a hollow one, and one between."""

THINNEST = 1e-4
"""Metres between two contacts: fingers close on nothing that is thinner."""


def antipodal_grasps(
    robot: Robot, target: Obstacle, *, friction: float = FRICTION, seed: int = 0, most: int = MOST
) -> tuple[Pose, ...]:
    """Grasps of an object of any shape at contacts that face each other, the best first and no two nearly equal.

    The best has the greatest ``grasp_quality``; of equal ones the approach from above comes first. At each, the open
    hand is free of the object and the closed fingers stop at it, as FCL says. What else is around is not looked at:
    planning refuses what it blocks.

    Args:
        friction: Coefficient of friction between fingers and object; with less, fewer grasps hold.
        seed: Of the lines that are drawn; the same seed gives the same grasps.
        most: Grasps at most, 1 to 1,000. The fewer, the less alike they are.

    Raises:
        InvalidRequest: The robot has no fingers, no such grasp was found, the object has more than 5,000 pieces, or
            a value is out of its range.
    """
    gripper = require_fingers(robot)
    instance("target", target, Obstacle, "an Obstacle, such as service.scene.obstacle(name)")
    limit, most = require_friction(friction), whole("most", most, 1, MAX_GRASPS)
    pairs = _pairs(gripper, target, limit, whole("seed", seed, 0, MAX_SEED))
    poses, widths = _approaches(gripper, target, pairs)
    hand = HandCheck(robot, target.shape)

    depths = DEPTHS if gripper.kind == "revolute" else DEPTHS[:1]
    placed: dict[Pose, Pose] = {}

    def holds(grasp: Pose, width: float) -> bool:
        opening = min(gripper.upper, width + 2.0 * FINGER_ROOMS[-1])
        seen = grasp.inverse() @ target.pose
        if hand.touching(seen, opening) or hand_objection(hand, target, seen, width):
            return False
        return not grasp_objection(target, grasp, robot, hand)

    def fits(number: int) -> bool:
        pose = poses[number]
        for depth in depths:
            x, y, z = (depth * axis for axis in gripper.approach)
            grasp = pose @ Pose((x, y, z)) if depth else pose
            if holds(grasp, widths[number]):
                placed[pose] = grasp
                return True
        return False

    found = tuple(placed[pose] for pose in covering(poses, most, fits))
    if not found:
        expected = (
            f"an object with two sides that face each other, at most {gripper.upper:.3f} m apart and within reach of "
            f"the fingers, for a friction of {limit:g}; {len(pairs)} such pairs were tried"
        )
        raise InvalidRequest("target", target.name, expected)
    return found


@dataclass(frozen=True)
class _Pair:
    """Two contacts in the frame of the object: their middle, the axis from one to the other, and how far apart."""

    middle: FloatArray
    axis: FloatArray
    width: float


def _pairs(gripper: Gripper, target: Obstacle, friction: float, seed: int) -> list[_Pair]:
    """Pairs of contacts that fingers could close on, the best first, and no two of them alike."""
    centre, farthest = mass_of(target)
    pieces = pieces_of(target.shape)
    rng = np.random.default_rng(seed)
    axes = np.eye(3)
    low, high = (target.shape.support(sign * axes).diagonal() for sign in (-1.0, 1.0))
    drawn = rng.random((LINES, 5))
    height, turn = 2.0 * drawn[:, 3] - 1.0, 2.0 * math.pi * drawn[:, 4]
    (c, s), flat = cosines_and_sines(turn), np.sqrt(1.0 - height * height)
    origins = low + drawn[:, :3] * (high - low)
    directions = np.stack([flat * c, flat * s, height], axis=1)
    runs = runs_along(pieces, origins, directions)
    points = [origins[runs.line] + t[:, None] * directions[runs.line] for t in (runs.enter, runs.leave)]
    inward = -np.concatenate([runs.enter_normal, runs.leave_normal])
    middles, axis, width, slope = _opposite(pieces, np.concatenate(points), inward, gripper.upper)
    for _ in range(TURNS):
        middles, axis, width, slope = _turned(pieces, middles, axis, width, slope)
    away = centre - middles
    lever = np.sqrt((cross(away, axis) ** 2).sum(axis=1))
    value = values(slope, 1.0 - width / gripper.upper, lever / farthest, friction)
    good = np.flatnonzero((value > 0.0) & (width >= max(THINNEST, gripper.lower)))
    order = good[np.argsort(-np.round(value[good], 9), kind="stable")].tolist()
    coarseness = 1.0
    while True:
        kept: list[int] = []
        for k in order:
            away = middles[kept] - middles[k]
            chord = np.minimum(*(((axis[kept] - sign * axis[k]) ** 2).sum(axis=1) for sign in (1.0, -1.0)))
            unlike = (np.sqrt((away * away).sum(axis=1)) + np.sqrt(chord) * ALIKE_PAIRS / ALIKE_AXES) / ALIKE_PAIRS
            if not kept or float(unlike.min()) >= coarseness:
                kept.append(k)
        if len(kept) <= MAX_PAIRS:
            break
        order, coarseness = kept, coarseness * COARSER
    # the width of a finger that turns is found by halving, so that few widths are better than many
    widths = np.ceil(width / WHOLE_WIDTHS) * WHOLE_WIDTHS if gripper.kind == "revolute" else width
    return [_Pair(middles[k], axis[k], float(widths[k])) for k in kept]


Contacts = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Middles (k, 3) and axes (k, 3) of pairs of contacts, metres between both (k,), and the larger slope at one (k,)."""


def _opposite(pieces: Pieces, points: FloatArray, inward: FloatArray, widest: float) -> Contacts:
    """Pairs of points (p, 3) of a surface and where lines from there along unit vectors (p, 3) leave the solid."""
    back = 2.0 * widest + 1.0
    runs = runs_along(pieces, points - back * inward, inward)
    enter, leave = runs.enter - back, runs.leave - back
    begins, ends = list[int](), list[int]()
    first = np.searchsorted(runs.line, np.arange(len(points) + 1)).tolist()
    for k in range(len(points)):
        here = [row for row in range(first[k], first[k + 1]) if abs(enter[row]) <= 1e-6]
        for row in here:
            for last in range(row, min(first[k + 1], row + MAX_SPANS)):
                if leave[last] - enter[row] <= widest:
                    begins.append(row)
                    ends.append(last)
    rows, last_rows = np.array(begins, dtype=np.intp), np.array(ends, dtype=np.intp)
    axis = inward[runs.line[rows]]
    width = leave[last_rows] - enter[rows]
    middles = points[runs.line[rows]] + (0.5 * (enter[rows] + leave[last_rows]))[:, None] * axis
    slope = np.maximum(slopes(-runs.enter_normal[rows], axis), slopes(runs.leave_normal[last_rows], axis))
    return middles, axis, width, np.asarray(slope)


def _turned(pieces: Pieces, middles: FloatArray, axis: FloatArray, width: FloatArray, slope: FloatArray) -> Contacts:
    """Pairs with each axis turned to halve the angle between both normals, where that makes the slope smaller."""
    if not len(middles):
        return middles, axis, width, slope
    normals, *_ = _contacts(pieces, middles, axis, width)
    sum_ = normals[1] - normals[0]
    length = np.sqrt((sum_ * sum_).sum(axis=1))
    wanted = np.where(length[:, None] > 1e-3, sum_ / np.maximum(length, 1e-3)[:, None], axis)
    ends, centre, apart, found = _contacts(pieces, middles, wanted, width)
    new = np.maximum(slopes(-ends[0], wanted), slopes(ends[1], wanted))
    better = found & (new < slope - 1e-9) & (apart <= width * 1.5)
    pick = better[:, None]
    return (
        np.where(pick, centre, middles),
        np.where(pick, wanted, axis),
        np.where(better, apart, width),
        np.where(better, new, slope),
    )


def _contacts(
    pieces: Pieces, middles: FloatArray, axis: FloatArray, width: FloatArray
) -> tuple[tuple[FloatArray, FloatArray], FloatArray, FloatArray, BoolArray]:
    """Where lines through middles enter and leave the solid nearest to half a width away, and whether they do: normals
    (2, k, 3), the new middles (k, 3), and metres between both (k,)."""
    runs = runs_along(pieces, middles, axis)
    count = len(middles)
    first = np.searchsorted(runs.line, np.arange(count + 1)).tolist()
    into, out = -axis.copy(), axis.copy()
    centre, apart, found = middles.copy(), width.copy(), np.zeros(count, bool)
    for k in range(count):
        rows = slice(first[k], first[k + 1])
        if first[k] == first[k + 1]:
            continue
        begin = int(np.argmin(np.abs(runs.enter[rows] + 0.5 * width[k]))) + first[k]
        end = int(np.argmin(np.abs(runs.leave[rows] - 0.5 * width[k]))) + first[k]
        if runs.leave[end] <= runs.enter[begin]:
            continue
        into[k], out[k], found[k] = runs.enter_normal[begin], runs.leave_normal[end], True
        centre[k] = middles[k] + 0.5 * (runs.enter[begin] + runs.leave[end]) * axis[k]
        apart[k] = runs.leave[end] - runs.enter[begin]
    return (into, out), centre, apart, found


def _approaches(gripper: Gripper, target: Obstacle, pairs: list[_Pair]) -> tuple[list[Pose], list[float]]:
    """Tool poses in the base frame that take pairs of contacts from several sides, and their widths."""
    poses, widths = list[Pose](), list[float]()
    R, at = target.pose.rotation, np.array(target.pose.position)
    for pair in pairs:
        middle, axis = along(R, pair.middle) + at, along(R, pair.axis)
        for approach, closing in _sides(axis):
            T = np.eye(4)
            T[:3, :3] = tool_rotation(gripper, approach, closing)
            T[:3, 3] = middle
            poses.append(Pose.from_matrix(T))
            widths.append(pair.width)
    return poses, widths


def _sides(axis: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Unit vectors of approach and closing for fingers along an axis: from above first, then from farther down."""
    down = np.array([0.0, 0.0, -1.0]) + float(axis[2]) * axis
    length = math.sqrt(float((down * down).sum()))
    if length < 1e-3:  # the fingers close upright: from any side
        down = np.eye(3)[int(np.argmin(np.abs(axis)))]
        down = down - float((down * axis).sum()) * axis
        length = math.sqrt(float((down * down).sum()))
    down = down / length
    beside = cross(axis, down)
    for turn in (0, 1, -1, 2, -2, 3, -3, 4):
        angle = 2.0 * math.pi * turn / ROLLS
        approach = down * math.cos(angle) + beside * math.sin(angle)
        yield approach, axis
        yield approach, -axis

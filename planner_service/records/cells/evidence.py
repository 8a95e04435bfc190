"""Plans of cells with evidence: a trail of each motion, and of each two arms over both of their clocks.

``auditor/verify_cell.py`` checks it with arithmetic of its own; ``docs/guides/proofs-for-others.md`` has the format.
The trail of two arms is made of rectangles, a stretch of time of each arm's motion. In the middle of both a direction
shows how far two pieces are apart there, and no point moves from there to the ends of the stretches by more than each
joint's travel and its distance from the joint's axis allow. A rectangle that does not show enough is quartered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planner_service.cell import Cell, CellPlan, OwnClock
from planner_service.certify import Certifier, Trail
from planner_service.certify.certifier import NANO
from planner_service.certify.motion_bounds import Motion
from planner_service.errors import NotProven
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.records.cells.cell_file import SavedCellPlan
from planner_service.records.cells.prove import moving_links, pairs_beside, prove_cell, two_that_move
from planner_service.records.evidence import EVIDENCE, UNIT, boxes_of, digest_of, packed, trail_record
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import SceneRecord
from planner_service.robot.model import Robot

__all__ = ["with_cell_evidence"]

VERSION = 1

ENOUGH = 3e-6
"""Metres that every rectangle shows at least: a verifier needs one micrometre, beside its own rounding."""

SHARE = 0.5
"""Of the smallest gap in the middle of any rectangle: rectangles show that much, or are quartered."""

LAST = 13
"""Halvings of both motions: a motion of 2 s is cut into pieces of a quarter of a millisecond at most."""

MAX_ROWS = 2_000_000

AT_ONCE = 400_000
"""Pairs at configurations that are measured in one call."""

FINEST = 0.001
"""Seconds by which a delay is less than what is not shown."""

TRAVEL = 1e-7
"""Radians or metres that each joint is said to travel beyond what it does: rounding, here and where it is checked."""

SLACK = 4e-9
"""Seconds beyond the band that are shown, too."""

QUARTERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


def with_cell_evidence(plan: CellPlan | SavedCellPlan) -> SavedCellPlan:
    """The same plan, proven anew, with the trail of its proof over all clocks as evidence.

    Where bounds that are easily checked show less delay than the plan tolerates, it says so: ``tolerates`` is what is
    shown.

    Raises:
        NotProven: It cannot be proven.
        InvalidRequest: It is no plan but a failure, or does not know its cell.
    """
    saved = SavedCellPlan.of(plan) if isinstance(plan, CellPlan) else plan
    proven = prove_cell(saved).required()
    cell, found = proven.cell, proven.plan
    proofs, clocks = [], []
    for clock in found.clocks:
        certificate, record = _alone(cell, found, clock)
        proofs.append(record)
        clocks.append(replace(clock, plan=replace(clock.plan, certificate=certificate)))
    found, late = replace(found, clocks=tuple(clocks)), found.tolerates
    between = list[dict[str, Any]]()
    while len(between) < len(pairs := list(two_that_move(found, late))):
        (one, a), (two, b) = pairs[len(between)]
        shown = _Rectangles(cell, found, (one, a), (two, b)).shown(late)
        if isinstance(shown, float):  # less delay, all of it anew
            if shown < 0.0:
                raise NotProven(f"{a} x {b}: no delay can be shown by bounds that are easily checked")
            late, between = shown, []
            continue
        between.append({"arms": [a, b], **shown})
    section = {
        "version": VERSION,
        "robots": [digest_of(RobotRecord.of(robot).document()) for robot in saved.robots],
        "scene": digest_of(SceneRecord.of(saved.scene).document()),
        "moved": [_moved(robot) for robot in saved.robots],
        "boxes": boxes_of(saved.scene),
        "proofs": proofs,
        "between": between,
    }
    found = replace(found, tolerates=late)
    return replace(saved, plan=found, sections={**saved.sections, EVIDENCE: section})


def _moved(robot: Robot) -> float:
    """How far the fingers are moved at the gripper's width."""
    return 0.0 if robot.gripper is None else robot.gripper.position(robot.gripper_width)


def _alone(cell: Cell, plan: CellPlan, clock: OwnClock) -> tuple[Any, dict[str, Any]]:
    """The certificate of a motion and of all that stands all the time, and its trail."""
    path, _ = clock.plan.unwrap()
    had = clock.plan.certificate
    if had is None:
        raise AssertionError("a motion that was proven has a certificate")
    if len(clock.arms) == 1:
        points = np.repeat(plan.still[None], len(path.waypoints), axis=0)
        points[:, list(clock.columns[0])] = path.waypoints
        path = JointPath(points, path.blends)
    robot = cell.robot.around(plan.still) if any(cell.robot.continuous) else cell.robot
    trail = Trail()
    found = Certifier(robot, cell.scene, allowed=pairs_beside(cell, plan, clock.arms)).certify(
        path, padding=had.padding, exempt=had.exempt, trail=trail
    )
    if found.refusal is not None:
        raise NotProven(f"{' and '.join(clock.arms)}: {found.refusal}")
    certificate = replace(had, clearance=found.clearance, distances=found.distances)
    return certificate, trail_record(trail, certificate)


@dataclass(frozen=True, eq=False)
class _Side:
    """One arm's motion on a grid of times: path length, and how far each of its joints has travelled by then."""

    columns: list[int]
    trajectory: Trajectory
    own: list[int]
    start: float
    times: FloatArray
    s: FloatArray

    @classmethod
    def of(cls, clock: OwnClock, name: str) -> _Side:
        trajectory = clock.plan.unwrap()[1]
        columns = list(clock.columns[clock.arms.index(name)])
        own = columns if len(clock.arms) > 1 else list(range(len(columns)))
        times = np.linspace(0.0, trajectory.duration, (1 << LAST) + 1, dtype=np.float64)
        s = np.clip(np.asarray(trajectory.s(times)), 0.0, trajectory.path.length)
        return cls(columns, trajectory, own, clock.start, times, s)

    def middle(self, level: int, cells: IntArray) -> tuple[FloatArray, FloatArray]:
        """Joints in the middle of stretches, and how far each travels on the farther half, (k, joints) each."""
        step = 1 << (LAST - level)
        begin, end = self.s[cells * step], self.s[(cells + 1) * step]
        middle, path = (begin + end) / 2, self.trajectory.path.walked
        walked = [np.asarray(path(at))[:, self.own] for at in (begin, middle, end)]
        travel = np.maximum(walked[1] - walked[0], walked[2] - walked[1]) + TRAVEL
        return np.asarray(self.trajectory.path(middle))[:, self.own], travel


class _Rectangles:
    """Rectangles of two arms' motions, on which pairs of their pieces are shown apart."""

    def __init__(self, cell: Cell, plan: CellPlan, one: tuple[OwnClock, str], two: tuple[OwnClock, str]) -> None:
        (first, a), (second, b) = one, two
        self._still = plan.still
        self._certifier = cell.between(a, b, plan.still)
        robot = self._certifier.robot
        self._motion = Motion(robot, self._certifier.listed)
        self._sides = _Side.of(first, a), _Side.of(second, b)
        listed, own = self._certifier.listed, moving_links(cell, a)
        self._pairs: IntArray = np.arange(len(listed.plain))
        pieces = listed.of(self._pairs)
        of_first = np.array([piece.owner[1] in own for piece in listed.riding], dtype=np.bool_)
        self._swapped: BoolArray = ~of_first[pieces[:, 0]]  # its first piece is the second arm's
        self._pieces = np.where(self._swapped[:, None], pieces[:, ::-1], pieces)
        self._levers = [self._levers_of(robot, side, k) for k, side in enumerate(self._sides)]

    def _levers_of(self, robot: Robot, side: _Side, k: int) -> FloatArray:
        """How far pieces of each pair move at most if a joint of the arm moves by 1, (pairs, joints)."""
        tables = self._motion.tables
        out = np.zeros((len(self._motion.listed.riding), robot.n))
        for piece, index, far in tables[3].tolist():
            body = robot.bodies[int(index)]
            if body.q_index >= 0:
                out[int(piece), body.q_index] += abs(body.multiplier) * (1.0 if body.prismatic else far)
        return np.asarray(out[self._pieces[:, k]][:, side.columns])

    def shown(self, late: float) -> dict[str, Any] | float:
        """The trail for a delay; or if it cannot be shown, the delay that may be, below 0 if there is none."""
        first, second = self._sides
        lead = second.start - first.start
        span = lead - late - SLACK, lead + late + SLACK
        rows, least, smallest = list[FloatArray](), math.inf, math.inf
        cells: IntArray = np.zeros((len(self._pairs), 2), dtype=np.intp)
        pair = self._pairs
        for level in range(LAST + 1):
            met = self._met(level, cells, *span)
            pair, cells = pair[met], cells[met]
            if not len(pair):
                break
            gaps, n, moved = self._measured(level, pair, cells)
            inside = self._inside(level, cells, lead, late)
            smallest = min(smallest, float(gaps[inside].min(initial=math.inf)))
            bound = gaps - moved
            good = bound > max(ENOUGH, SHARE * smallest) if level < LAST else bound > ENOUGH
            if good.any():
                least = min(least, float(bound[good].min()))
                step = 1 << (LAST - level)
                ends = np.column_stack([cells, cells + 1])[:, [0, 2, 1, 3]] * step
                rows.append(np.column_stack([pair, ends, n]).astype(np.float64)[good])
            if sum(map(len, rows)) > MAX_ROWS:
                return self._less(level, cells[~good], lead, late)
            if level == LAST and not good.all():
                return self._less(level, cells[~good], lead, late)
            pair, cells = np.repeat(pair[~good], 4), (2 * cells[~good][:, None] + QUARTERS).reshape(-1, 2)
        return self._record(rows, least)

    def _met(self, level: int, cells: IntArray, low: float, high: float) -> BoolArray:
        """Which rectangles have places that occur at one time: leads of the second from low to high."""
        durations = [float(side.times[-1]) for side in self._sides]
        step, last = 1 << (LAST - level), (1 << level) - 1
        (a0, b0), (a1, b1) = (
            [side.times[(cells[:, k] + more) * step] for k, side in enumerate(self._sides)] for more in (0, 1)
        )
        i, j = cells.T
        met = (a1 - b0 >= low) & (a0 - b1 <= high)
        met |= (i == 0) & (b0 <= max(-low, 0.0) + SLACK)
        met |= (j == 0) & (a0 <= max(high, 0.0) + SLACK)
        met |= (i == last) & (b1 >= min(durations[0] - high, durations[1]) - SLACK)
        met |= (j == last) & (a1 >= min(durations[1] + low, durations[0]) - SLACK)
        return np.asarray(met)

    def _inside(self, level: int, cells: IntArray, lead: float, late: float) -> BoolArray:
        """Of which rectangles the middle occurs while both arms move."""
        half = 1 << (LAST - level)
        x, y = (side.times[cells[:, k] * half + half // 2] for k, side in enumerate(self._sides))
        return np.asarray(np.abs(x - y - lead) <= late)

    def _measured(self, level: int, pair: IntArray, cells: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of rectangles gaps in their middles, directions from the second arm's piece, and by how much points move."""
        width = 1 << level
        keys, which = np.unique(cells[:, 0] * width + cells[:, 1], return_inverse=True)
        which = which.reshape(-1)
        middles = [side.middle(level, (keys // width, keys % width)[k]) for k, side in enumerate(self._sides)]
        Q = np.repeat(self._still[None], len(keys), axis=0)
        moved = np.zeros(len(pair))
        for k, (side, (q, travel)) in enumerate(zip(self._sides, middles, strict=True)):
            Q[:, side.columns] = q
            moved += (travel[which] * self._levers[k][pair]).sum(axis=1)
        gaps, n = np.full(len(pair), -math.inf), np.zeros((len(pair), 3))
        used = np.unique(pair)
        order = np.argsort(which, kind="stable")
        starts = np.searchsorted(which[order], np.arange(len(keys) + 1))
        many = max(1, AT_ONCE // len(used))
        for begin in range(0, len(keys), many):
            some = order[starts[begin] : starts[min(begin + many, len(keys))]]
            asked = np.unique(pair[some])
            rows, found, bounds = self._certifier.near(Q[begin : begin + many], math.inf, asked)
            table = np.zeros((len(keys[begin : begin + many]), len(asked), 4))
            column = np.searchsorted(asked, found)
            table[rows, column, 0], table[rows, column, 1:] = bounds.gaps, bounds.n.T
            rotations = self._motion.poses(Q[begin : begin + many])[:, :3].transpose(2, 3, 0, 1)
            own = table[which[some] - begin, np.searchsorted(asked, pair[some])]
            second = self._motion.listed.of(pair[some])[:, 1]
            turned = np.einsum("kij,kj->ki", rotations[which[some] - begin, second], own[:, 1:])
            gaps[some], n[some] = own[:, 0], np.where(self._swapped[pair[some], None], -turned, turned)
        return gaps, n, moved

    def _less(self, level: int, cells: IntArray, lead: float, late: float) -> float:
        """The delay that leaves out what cannot be shown."""
        step = 1 << (LAST - level)
        first, second = self._sides
        low = first.times[cells[:, 0] * step] - second.times[(cells[:, 1] + 1) * step]
        high = first.times[(cells[:, 0] + 1) * step] - second.times[cells[:, 1] * step]
        nearest = float(np.maximum(low - lead, lead - high).min())
        return min(late - FINEST, math.floor(nearest / FINEST - 1.0) * FINEST)

    def _record(self, rows: Sequence[FloatArray], least: float) -> dict[str, Any]:
        """The trail: places of time that are used, pairs, and rows."""
        table = np.concatenate([np.zeros((0, 8)), *rows])
        used, number = np.unique(table[:, 0].astype(np.intp), return_inverse=True)
        spans, times = [number.reshape(-1)], []
        for k, side in enumerate(self._sides):
            places, ends = np.unique(
                np.r_[0, 1 << LAST, table[:, 1 + 2 * k : 3 + 2 * k].astype(np.intp).reshape(-1)], return_inverse=True
            )
            spans += list(ends.reshape(-1)[2:].reshape(-1, 2).T)
            times.append(packed(side.times[places], "<f8"))
        whole = np.rint(table[:, 5:] * UNIT).astype(np.int64)
        return {
            "clearance": math.floor(least * NANO) / NANO if math.isfinite(least) else None,
            "times": times,
            "pairs": packed(self._pieces[used], "<i4"),
            "rows": packed(np.column_stack([*spans, whole]), "<i4"),
        }

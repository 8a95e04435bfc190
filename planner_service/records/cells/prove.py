"""Plans of cells are proven again before they are used, over all clocks.

Of a file only the cell, the paths, the trajectories, the starts and the delay are taken; everything it says about them
is checked:

1. Each motion by itself, beside the arms that stand all the time and the bases of the others: its limits, its
   constraints, its ends, and that it is free, between samples too (``recertify``).
2. Each motion begins where ``still`` has its arms, at rest, and joints of no arm are at home.
3. What never moves stands apart.
4. Each two arms that move are apart wherever they can be at one time when each is late, by itself, by up to the delay
   that is claimed (``planner_service.cell.clocks``).
5. Tools that were to be somewhere in another arm's tool frame are there when all arms are through.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from planner_service.cell import Cell, CellPlan, OwnClock
from planner_service.cell.clocks import Between, Clock
from planner_service.cell.goal_kinds import off
from planner_service.cell.loads import constraints_of
from planner_service.certify import Certifier
from planner_service.constraints import ToolRegion
from planner_service.errors import InvalidRequest, NotProven, UnknownName
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance, number
from planner_service.planning.result import PlanResult
from planner_service.records.cells.cell_file import SavedCellPlan, bound
from planner_service.records.recertify import Recertified, recertify
from planner_service.robot.model import Robot, joint_vector
from planner_service.scene.names import Names

__all__ = ["ProvenCell", "moving_arms", "moving_links", "pairs_beside", "prove_cell", "two_that_move"]

SAME_PLACE = 1e-9
"""Radians or metres between where an arm stands and where its motion begins."""

SAME_TOOL = 1e-5
"""Metres and radians between a tool and where it was to be: inverse kinematics of two arms."""

MAX_DELAY = 1e6
"""Seconds that are the same as no limit: no motion takes so long."""


@dataclass(frozen=True, eq=False)
class ProvenCell:
    """What proving the plan of a cell again has found.

    Attributes:
        cell: The cell.
        plan: The plan, in whose motions the proofs are the new ones.
        motions: Each motion by itself, in the order of ``plan.clocks``.
        tolerates: Seconds by which every arm may be late, as was claimed: proven if there are no problems.
        problems: What does not hold; empty if all of it is proven.
        rectangles: Of two arms' motions, those that were asked for a proof.
        bounds: Bounds that this took.
    """

    cell: Cell
    plan: CellPlan
    motions: tuple[Recertified, ...]
    tolerates: float
    problems: tuple[str, ...]
    rectangles: int
    bounds: int

    @property
    def certified(self) -> bool:
        """Whether all of it is proven."""
        return not self.problems

    @property
    def not_checked(self) -> tuple[str, ...]:
        """Every pair that is not checked, where, and why."""
        return tuple(
            f"{' and '.join(clock.arms)}: {each}"
            for clock, motion in zip(self.plan.clocks, self.motions, strict=True)
            for each in motion.not_checked
        )

    def required(self) -> ProvenCell:
        """The same object, if all of it is proven.

        Raises:
            NotProven: It is not.
        """
        if self.problems:
            raise NotProven(*self.problems)
        return self


def prove_cell(plan: CellPlan | SavedCellPlan, *, padding: float = 0.0) -> ProvenCell:
    """Prove the plan of a cell again, over all clocks; the list at the top of this module says what is checked.

    Args:
        padding: Metres that every checked pair has to keep.

    Raises:
        InvalidRequest: The plan is a failure, or does not know its cell; the padding is out of range.
    """
    saved = SavedCellPlan.of(plan) if isinstance(plan, CellPlan) else plan
    instance("plan", saved, SavedCellPlan, "a CellPlan or a SavedCellPlan")
    if saved.failure is not None:
        raise InvalidRequest("plan", str(saved.failure), "a plan, not a failure")
    cell = saved.cell
    problems = list(_contradictions(cell, saved.plan))
    if problems:
        return ProvenCell(cell, saved.plan, (), saved.plan.tolerates, tuple(problems), 0, 0)
    claimed = bound(saved.plan, cell)
    motions = tuple(recertify(_keeping(cell, clock), padding=padding) for clock in claimed.clocks)
    problems += [problem for clock in claimed.clocks for problem in _not_looked_at(cell, clock)]
    clocks = []
    for clock, motion in zip(claimed.clocks, motions, strict=True):
        problems += [f"{' and '.join(clock.arms)}: {problem}" for problem in motion.problems]
        proofs = [proven.certificate for proven in motion.motions]
        clocks.append(replace(clock, plan=replace(clock.plan, certificate=proofs[0])) if proofs else clock)
    proven = replace(claimed, clocks=tuple(clocks))
    problems += _touching(cell, proven, padding)
    problems += _elsewhere(cell, proven)
    asked = list(_between(cell, proven, padding))
    for a, b, between, lead, late in asked:
        if len(between.in_the_way(lead, late)):
            problems.append(f"{a} x {b}: not proven apart when each may be {late:g} s late")
    rectangles, bounds = (sum(getattr(each[2], what) for each in asked) for what in ("rectangles", "bounds"))
    proven = replace(proven, rectangles=rectangles, distances=bounds)
    return ProvenCell(cell, proven, motions, saved.plan.tolerates, tuple(problems), rectangles, bounds)


def _keeping(cell: Cell, clock: OwnClock) -> PlanResult:
    """A motion that is said to keep, too, what its arms keep because of what they carry."""
    kept = constraints_of([held for name in clock.arms for held in cell.layout.carried.get(name, ())])
    more = tuple(constraint for constraint in kept if constraint not in clock.plan.constraints)
    return replace(clock.plan, constraints=(*clock.plan.constraints, *more)) if more else clock.plan


def _not_looked_at(cell: Cell, clock: OwnClock) -> Iterator[str]:
    """Constraints of what an arm carries at its own tool, which a motion of several arms cannot be proven to keep."""
    for name in clock.arms[1:]:
        for constraint in constraints_of(cell.layout.carried.get(name, ())):
            if isinstance(constraint, ToolRegion) and constraint.link is None:
                yield f"{name}: {constraint.name} of what it carries is not proven where arms share a clock"


def moving_arms(plan: CellPlan) -> tuple[str, ...]:
    """The arms that have a motion."""
    return tuple(name for clock in plan.clocks for name in clock.arms)


def moving_links(cell: Cell, name: str) -> frozenset[str]:
    """The links with shapes that the joints of an arm move."""
    robot, own = cell.robot, {*cell.of_arm(name, np.arange(cell.robot.n)).astype(int).tolist()}
    return frozenset(item.link for item in robot.shapes if own & {*_columns(robot, item.body)})


def pairs_beside(cell: Cell, plan: CellPlan, arms: tuple[str, ...]) -> list[tuple[str, str]]:
    """Pairs by name with links of moving arms that are none of these: what a proof of these arms alone leaves out."""
    names = Names(cell.robot, cell.scene)
    every = [
        *(names.link(link) for link in sorted({item.link for item in cell.robot.shapes})),
        *map(names.object, cell.scene.names),
    ]
    away = {names.link(link) for name in moving_arms(plan) if name not in arms for link in moving_links(cell, name)}
    return [(a, b) for a, b in product(sorted(away), every) if a < b or (a != b and b not in away)]


def _columns(robot: Robot, body: int) -> Iterator[int]:
    """The joints that move a body."""
    while body > 0:
        yield robot.bodies[body].q_index
        body = robot.bodies[body].parent


def _contradictions(cell: Cell, plan: CellPlan) -> Iterator[str]:
    """What cannot be a plan of this cell."""
    try:
        still = joint_vector("still", plan.still, cell.robot)
        number("tolerates", plan.tolerates, "seconds >= 0", 0.0, math.inf)
    except InvalidRequest as error:
        yield str(error)
        return
    moved, every, of_none = moving_arms(plan), np.arange(cell.robot.n), np.ones(cell.robot.n, dtype=bool)
    for name in cell.arms:
        of_none[cell.of_arm(name, every).astype(int)] = False
    if np.abs(still - cell.robot.home)[of_none].max(initial=0.0) > SAME_PLACE:
        yield "still: joints of no arm are not at home"
    for name in sorted({name for name in moved if moved.count(name) > 1}):
        yield f"{name}: more than one motion"
    for clock in plan.clocks:
        yield from _wrong(cell, clock, still)


def _wrong(cell: Cell, clock: OwnClock, still: FloatArray) -> Iterator[str]:
    """What cannot be a motion of this cell."""
    who = " and ".join(clock.arms)
    unknown = [name for name in clock.arms if name not in cell.arms]
    if unknown or not clock.arms:
        yield str(UnknownName("arm", unknown[0] if unknown else "", cell.arms))
        return
    if not 0.0 <= clock.start < MAX_DELAY:
        yield f"{who}: starts at {clock.start:g} s; expected seconds >= 0"
    trajectory, alone = clock.plan.trajectory, len(clock.arms) == 1
    begin = cell.of_arm(clock.arms[0], still) if alone else still
    if trajectory is None or clock.plan.failure is not None:
        yield f"{who}: no motion"
    elif trajectory.path.n != len(begin):
        yield f"{who}: a motion of {trajectory.path.n} joints, not {len(begin)}"
    elif trajectory.part is not None:
        yield f"{who}: a part of a motion"
    elif np.abs(trajectory.path.waypoints[0] - begin).max() > SAME_PLACE:
        yield f"{who}: its motion does not begin where it stands"
    elif not alone and _moves_others(cell, clock):
        yield f"{who}: its motion moves other arms, too"


def _moves_others(cell: Cell, clock: OwnClock) -> bool:
    points = clock.plan.unwrap()[0].waypoints
    moved = (points != points[0]).any(axis=0)
    for name in clock.arms:
        moved[cell.of_arm(name, np.arange(cell.robot.n)).astype(int)] = False
    return bool(moved.any())


def _elsewhere(cell: Cell, plan: CellPlan) -> Iterator[str]:
    """Tools that are not where they were to be in another arm's tool frame."""
    end = plan(plan.duration)
    for name, goal in plan.goals.items():
        if name not in cell.arms or goal.arm not in cell.arms:
            yield f"{name}: at the tool of {goal.arm!r}; expected arms of this cell"
            continue
        own, other = (cell.arm(each).robot.tool_pose(cell.of_arm(each, end)) for each in (name, goal.arm))
        metres, radians = off(goal, own, other)
        if not max(metres, radians) <= SAME_TOOL:
            yield f"{name}: ends {1e3 * metres:.3g} mm and {radians:.3g} rad from where it was to be at {goal.arm}"


def _touching(cell: Cell, plan: CellPlan, padding: float) -> Iterator[str]:
    """What stands all the time and is not apart."""
    if len(moving_arms(plan)) == len(cell.arms):
        return
    robot = cell.robot.around(plan.still) if any(cell.robot.continuous) else cell.robot
    try:
        found = Certifier(robot, cell.scene, allowed=pairs_beside(cell, plan, ())).certify(
            plan.still[None], padding=padding
        )
    except InvalidRequest as error:
        yield f"still: {error}"
        return
    if found.refusal is not None:
        yield f"arms that stand: {found.refusal}"


def two_that_move(plan: CellPlan, late: float) -> Iterator[tuple[tuple[OwnClock, str], tuple[OwnClock, str]]]:
    """Each two arms whose motions are to be proven apart over both clocks, each with its clock."""
    for first, second in combinations([(clock, name) for clock in plan.clocks for name in clock.arms], 2):
        if first[0] is not second[0] or late > 0.0:  # of one clock its own proof has judged them
            yield first, second


def _between(cell: Cell, plan: CellPlan, padding: float) -> Iterator[tuple[str, str, Between, float, float]]:
    """Each two arms that move, what is proven between them, by how much the second starts later, and the delay."""
    every = np.arange(cell.robot.n)
    late = min(plan.tolerates, MAX_DELAY)
    for first, second in two_that_move(plan, late):
        (one, a), (two, b) = first, second
        clocks = []
        for clock, name in (first, second):
            own = cell.of_arm(name, every).astype(int).tolist()
            clocks.append(Clock.of(clock.plan.unwrap()[1], own, own if len(clock.arms) > 1 else None))
        between = Between(cell.between(a, b, plan.still), clocks[0], clocks[1], plan.still, padding)
        yield a, b, between, two.start - one.start, late

"""Schedules of picks are proven again, from their motions alone.

Of a schedule only the cell, the jobs, where arms start, the motions, when their chains start, and the delay are taken.
What is checked:

1. Each job is done once, by an arm that may do it; each arm's chains follow each other in place and in time, from where
   it starts to where it started.
2. Each chain by itself, in what stands there meanwhile: every object of another job where it was and where it goes,
   unless the chain comes after a chain that has it in hand by then for certain, however late both are. It changes
   nothing but that its own object goes to its place, and its motions keep their limits and are free, between samples
   too (``recertify``).
3. Arms are free where they stand at first, with every object where it was and where it goes.
4. Each two arms, with what they carry, are apart wherever they can be at one time when each is late, by itself, by up
   to the delay that is claimed (``lines``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from planner_service.cell import Cell
from planner_service.certify import Certifier
from planner_service.errors import InvalidRequest, NotProven
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import copied_in, instance, number
from planner_service.kinematics.tool_line import rotation_distance
from planner_service.records.recertify import Recertified, recertify
from planner_service.scheduling.lines import FOREVER, Lines, Motion, Piece, pieces_of, stand
from planner_service.scheduling.picks import require_cell
from planner_service.scheduling.result import Chain, Schedule
from planner_service.scheduling.worlds import before, require_jobs
from planner_service.service import PlannerService

__all__ = ["ProvenSchedule", "prove_schedule"]

JOINED = 1e-6
"""Radians or metres between where a chain ends and the next begins, and between where an object is left and its place:
less than the margin of a proof."""

SAME_TIME = 1e-9
"""Seconds by which a chain may start before the one before has ended."""


@dataclass(frozen=True, eq=False)
class ProvenSchedule:
    """What proving a schedule again has found.

    Attributes:
        schedule: The schedule.
        chains: Each chain by itself, in the order of ``schedule.chains``, as far as they could be looked at.
        tolerates: Seconds by which every arm may be late, as was claimed: proven if there are no problems.
        problems: What does not hold; empty if all of it is proven.
        rectangles: Of two arms' motions, those that were asked for a proof.
        bounds: Bounds that this took.
    """

    schedule: Schedule
    chains: tuple[Recertified, ...]
    tolerates: float
    problems: tuple[str, ...]
    rectangles: int = field(default=0)
    bounds: int = field(default=0)

    def __post_init__(self) -> None:
        copied_in(self, "chains", "problems")

    @property
    def certified(self) -> bool:
        """Whether all of it is proven."""
        return not self.problems

    def required(self) -> ProvenSchedule:
        """The same object, if all of it is proven.

        Raises:
            NotProven: It is not.
        """
        if self.problems:
            raise NotProven(*self.problems)
        return self


def prove_schedule(schedule: Schedule) -> ProvenSchedule:
    """Prove a schedule again; the list at the top of this module says what is checked.

    Raises:
        InvalidRequest: The schedule is a failure, or of a cell or jobs that cannot be scheduled.
        UnknownName: A job is of an obstacle or an arm that is not there.
    """
    instance("schedule", schedule, Schedule, "a Schedule")
    if schedule.failure is not None:
        raise InvalidRequest("schedule", str(schedule.failure), "a schedule, not a failure")
    cell = Cell.laid_out(schedule.layout)
    require_cell(cell)
    require_jobs(cell.scene, cell.arms, schedule.jobs)
    problems = list(_contradictions(cell, schedule))
    if problems:
        return ProvenSchedule(schedule, (), schedule.tolerates, tuple(problems))
    return _Proof(cell, schedule).run()


def _contradictions(cell: Cell, schedule: Schedule) -> Iterator[str]:
    """What cannot be a schedule of this cell."""
    for name, value, highest in (("tolerates", schedule.tolerates, math.inf), ("padding", schedule.padding, 1.0)):
        try:
            number(name, value, f"a number in [0, {highest:g}]", 0.0, highest)
        except InvalidRequest as error:
            yield str(error)
    if schedule.starts.keys() != {*cell.arms}:
        yield f"starts of {', '.join(schedule.starts)}; expected those of {', '.join(cell.arms)}"
    for name, q in schedule.starts.items():
        if name in cell.arms and q.shape != (cell.arm(name).robot.n,):
            yield f"{name}: starts at {q.shape[0] if q.ndim == 1 else q.shape} joints"
    done = [chain.job.object for chain in schedule.chains]
    wanted = {job.object: job for job in schedule.jobs}
    if sorted(done) != sorted(wanted):
        yield f"chains of {', '.join(done) or 'nothing'}; expected one of each of {', '.join(wanted)}"
    for chain in schedule.chains:
        what = f"{chain.arm}, {chain.job.object}"
        if chain.job != wanted.get(chain.job.object):
            yield f"{what}: another job than was asked for"
        if chain.arm not in cell.arms or (chain.job.arms and chain.arm not in chain.job.arms):
            yield f"{what}: not an arm that may do this"
        if chain.task.failure is not None or not chain.task.segments:
            yield f"{what}: no motion"
        for value in (chain.start, chain.gripper_seconds, *(segment.wait for segment in chain.task.segments)):
            if not 0.0 <= value < FOREVER / 1e3:
                yield f"{what}: {value:g} s"
        if chain.job.object in chain.gone or not {*chain.gone} <= wanted.keys():
            yield f"{what}: gone are {', '.join(chain.gone)}"


class _Proof:
    """One call."""

    def __init__(self, cell: Cell, schedule: Schedule) -> None:
        self._cell, self._schedule = cell, schedule
        self._problems = list[str]()
        self._taken = dict[str, tuple[str, float, float]]()
        # of an object: its arm, and from when to when it is held
        self._pieces = dict[int, list[Piece]]()
        self._proven = dict[int, Recertified]()

    def run(self) -> ProvenSchedule:
        schedule = self._schedule
        for chain in schedule.chains:
            self._prove(chain)
        if not self._problems:
            for chain in schedule.chains:
                self._problems += self._gone(chain)
            self._problems += self._standing()
        lines = self._lines()
        late = min(lines.tolerates().values(), default=math.inf) if not self._problems else math.inf
        if late < schedule.tolerates:
            self._problems.append(f"arms are proven apart for {late:g} s of delay, not for {schedule.tolerates:g}")
        chains = tuple(self._proven[id(chain)] for chain in schedule.chains if id(chain) in self._proven)
        problems = tuple(self._problems)
        return ProvenSchedule(schedule, chains, schedule.tolerates, problems, lines.rectangles, lines.bounds)

    def _prove(self, chain: Chain) -> None:
        """A chain by itself."""
        what, cell = f"{chain.arm}, {chain.job.object}", self._cell
        scene = before(cell.scene, self._schedule.jobs, chain.job, chain.gone)
        service = PlannerService(cell.arm(chain.arm).robot.opened_like(chain.task.begin.robot), scene)
        try:
            found = recertify(chain.task, service, padding=self._schedule.padding)
        except InvalidRequest as error:
            self._problems.append(f"{what}: {error}")
            return
        self._proven[id(chain)] = found
        problems = list(found.problems)
        if not problems:
            problems += self._strange(chain, found)
        self._problems += [f"{what}: {problem}" for problem in problems]
        if problems:
            return
        motions = [
            Motion(
                each.motion.trajectory,
                each.motion.scene.attached,
                segment.wait + (0.0 if each.gripper is None else chain.gripper_seconds),
            )
            for each, segment in zip(found.motions, chain.task.segments, strict=True)
        ]
        pieces = self._pieces[id(chain)] = pieces_of(motions)
        held = next(piece for piece in pieces if piece.held is not None)
        self._taken[chain.job.object] = chain.arm, chain.start + held.begin, chain.start + held.end

    @staticmethod
    def _strange(chain: Chain, found: Recertified) -> Iterator[str]:
        """What a chain does beside its job, or leaves undone."""
        job, motions = chain.job, found.motions
        moved = [(k, motion.motion.left) for k, motion in enumerate(motions) if motion.motion.left is not None]
        if found.taken != (job.object,) or len(moved) != 1 or motions[0].motion.scene.attached:
            yield f"it takes {', '.join(found.taken) or 'nothing'}; expected {job.object}, and that it leaves it"
            return
        k, left = moved[0]
        if left is None or left.name != job.object:
            yield "it leaves something else than it takes"
            return
        at = Pose.from_matrix(motions[k].motion.robot.tool_pose(motions[k].motion.end)) @ left.pose
        away = max(abs(a - b) for a, b in zip(at.position, job.place.position, strict=True))
        if not (away <= JOINED and rotation_distance(at, job.place) <= JOINED):
            yield f"it leaves {job.object} {away * 1000:g} mm from its place"
        if any((a.gripper is None) != (b.gripper is None) for a, b in zip(motions, chain.task.segments, strict=True)):
            yield "its gripper moves where it has no time for that"

    def _gone(self, chain: Chain) -> Iterator[str]:
        """Objects that are left out where they were although they may be there."""
        for name in chain.gone:
            arm, since, until = self._taken[name]
            late = 0.0 if arm == chain.arm else self._schedule.tolerates
            if chain.start < (until - SAME_TIME if arm == chain.arm else since + late):
                yield f"{chain.arm}, {chain.job.object}: {name} may still be where it was"

    def _standing(self) -> Iterator[str]:
        """What is not free where arms stand at first."""
        scene = before(self._cell.scene, self._schedule.jobs, None, ())
        for name, q in self._schedule.starts.items():
            try:
                found = Certifier(self._cell.arm(name).robot, scene).certify(q[None], padding=self._schedule.padding)
            except InvalidRequest as error:
                yield f"{name}: {error}"
                continue
            if found.refusal is not None:
                yield f"{name}: {found.refusal}"

    def _lines(self) -> Lines:
        """What arms do by one clock."""
        schedule = self._schedule
        lines = Lines(self._cell, schedule.starts, 0.0, schedule.padding)
        for name in schedule.starts if not self._problems else ():
            at, width = schedule.starts[name], self._cell.arm(name).robot.gripper_width
            for chain in schedule.of_arm(name):
                what, motions = f"{name}, {chain.job.object}", self._proven[id(chain)].motions
                until, pieces = lines.lines[name][-1].begin, self._pieces[id(chain)]
                if np.abs(pieces[0].q[0] - at).max() > JOINED:
                    self._problems.append(f"{what}: it does not begin where the arm stands")
                if chain.start < until - SAME_TIME:
                    self._problems.append(f"{what}: it starts before the one before has ended")
                begun = chain.task.begin.robot.gripper_width
                if begun != width:
                    self._problems.append(f"{what}: the gripper is {begun:g} m open, not {width:g}")
                at, width = motions[-1].motion.end, motions[-1].motion.robot.gripper_width
                lines.commit(name, [*pieces, stand(pieces[-1].q[-1], pieces[-1].end, FOREVER)], chain.start, until)
            if np.abs(at - schedule.starts[name]).max() > JOINED:
                self._problems.append(f"{name}: it does not end where it started")
        return lines

"""What a cell's jobs are as tasks of the planner, one after another, and who judges their motions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

import planner_service as ps
from auditor.checker import IndependentChecker, tables_of
from benchmarks.harness.audit import Pair, touch_of_plan
from benchmarks.harness.kept import Kept
from benchmarks.harness.report import Row
from benchmarks.worlds.cells import KINDS, ROBOTS, Cell, Job, cell
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.grasping.grasps import tool_rotation
from planner_service.memory import Memory
from planner_service.planning.task_result import Handling, Segment, TaskResult
from planner_service.tasks import Approach, Connect, Grasp, Release, Retreat, Task, pick_steps, place_steps
from planner_service.tasks.solver import BEAM, SEARCHES
from planner_service.tasks.steps import Step

__all__ = ["LOOK", "Work", "kept_rows", "objections", "solved", "steps"]

LOOK = 0.004
"""Metres that a point of the robot moves, at most, from one configuration that is judged to the next."""

RISE, UP, DOWN = 0.01, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
"""Metres above a board at which a thing goes into a shelf, and out of it."""

LINES = (0.1, 0.08, 0.06, 0.05)
"""Metres of straight lines into a shelf or a pocket and out of it."""

EIGHTHS = tuple(k * math.pi / 4.0 for k in range(8))
TURNS = tuple(math.radians(15.0 * k) for k in range(24))
END = 0.015

WIDTHS = 5
"""Openings at which a gripper that opens or closes is judged."""


@dataclass(frozen=True, eq=False)
class Work:
    """A robot in a cell, as far as it has come: its world, and where it stands (n,)."""

    cell: Cell
    service: ps.PlannerService
    q: FloatArray

    @classmethod
    def begun(cls, cell: Cell) -> Work:
        """Before the first job."""
        robot = ps.load_robot(cell.robot)
        return cls(cell, ps.PlannerService(robot, cell.scene), robot.home)

    def facing(self, job: Job) -> Work:
        """With the object of a job there."""
        return replace(self, service=self.service.with_scene(self.cell.before(self.service.scene, job)))

    def after(self, done: TaskResult) -> Work:
        """After a task."""
        return replace(self, service=ps.PlannerService.of(done.world), q=done.q)


def kept_rows(
    part: str,
    rows: Callable[[Cell, int | None], Iterable[Row]],
    queries: int | None,
    seed: int,
    robot: str | None,
    kept: Kept,
) -> list[Row]:
    """The rows of all cells of a draw: of one robot those that were not kept are made, or of all.

    Args:
        part: What is done in each cell; kept rows are of this part.
        rows: Makes the rows of a cell, of so many of its jobs.
    """
    found = list[Row]()
    for kind, name in product(KINDS, ROBOTS):
        make = partial(_rows_of, rows, kind, name, seed, queries) if robot in (None, name) else None
        found += kept.rows(f"{part} {kind} {name} {seed} {queries or 'all'}", make)
    return found


def _rows_of(
    rows: Callable[[Cell, int | None], Iterable[Row]], kind: str, name: str, seed: int, queries: int | None
) -> Iterable[Row]:
    return rows(cell(kind, name, seed), queries)


def steps(job: Job, opening: float | None = None) -> Task:
    """A job as a task: take the object and set it down, on the station first if it has one.

    Args:
        opening: Metres between the fingers around the object; as usual if None.
    """
    stops = [(job.station, job.via)] if job.station else []
    stops.append((job.places, job.onto))
    found: list[Step] = []
    support, grasps = job.support, None if job.plain else Around(above=not job.side)
    for places, onto in stops:
        grasp = Grasp(job.name, grasps, open_width=opening, support=support)
        if job.side:
            found += [Connect("to pregrasp"), Approach("in"), grasp]
            found += [Retreat("up", (RISE,), UP), Connect("transfer"), Approach("in")]
            found += [Approach("down", (RISE,), direction=DOWN), Release(job.name, places, support=onto)]
            found += [Retreat("out", LINES)]
        elif places is job.places and job.inserted:
            found += [Connect("to pregrasp"), Approach("descend"), grasp]
            found += [Retreat("lift", LINES, UP), Connect("transfer"), Approach("lower", LINES, direction=DOWN)]
            found += [Release(job.name, places, support=onto), Retreat("retreat", LINES)]
        else:
            found += pick_steps(job.name, grasps, Handling(support=support, open_width=opening))
            found += place_steps(job.name, places, Handling(support=onto))
        support = onto
    return Task(found, f"{job.name} onto {job.onto}")


@dataclass(frozen=True)
class Around:
    """Grasps all around a thing: near its ends if it is long, or about its middle.

    Attributes:
        above: Whether those that come most from above are the first.
    """

    above: bool

    def poses(self, robot: ps.Robot, obstacle: ps.Obstacle) -> tuple[ps.Pose, ...]:
        """See ``GraspSource``."""
        gripper, E = robot.gripper, np.eye(3)
        assert gripper is not None
        upper, lower = (obstacle.shape.support(sign * E).diagonal() for sign in (1.0, -1.0))
        middle, size = (upper + lower) / 2.0, upper - lower
        found = []
        for k in range(3):
            u, v = E[(k + 1) % 3], E[(k + 2) % 3]
            if gripper.kind == "vacuum":
                turns = [(sign * E[k], u * math.cos(t) + v * math.sin(t)) for sign in (-1.0, 1.0) for t in EIGHTHS]
                tips = [np.where(E[k] > 0, upper if a[k] < 0 else lower, middle) for a, _ in turns]
                found += list(zip(turns, tips, strict=True))
            elif size[k] <= gripper.upper - 0.004:
                long = max(((k + 1) % 3, (k + 2) % 3), key=lambda axis: float(size[axis]))
                ends = size[long] / 2.0 - min(END, size[long] / 4.6)
                for aside in (ends, 0.0, -ends) if ends else (0.0,):
                    for t in TURNS:
                        a = u * math.cos(t) + v * math.sin(t)
                        found.append(((a, E[k]), middle + aside * E[long]))
        made = []
        for (approach, closing), tip in found:
            T = np.eye(4)
            T[:3, :3] = tool_rotation(gripper, approach, closing)
            T[:3, 3] = tip
            made.append(obstacle.pose @ ps.Pose.from_matrix(T))
        if self.above:
            approach = np.array(gripper.approach)
            made.sort(key=lambda pose: round(float(pose.rotation[2] @ approach), 3))
        return tuple(made)


def solved(
    work: Work,
    job: Job,
    request: ps.PlanRequest,
    memory: Memory | None = None,
    *,
    times: int = 1,
    opening: float | None = None,
) -> TaskResult:
    """A job, solved.

    Args:
        times: The usual budget of ways and searches, and of states of each motion.
        opening: As for ``steps``.
    """
    if request.max_checks is not None:
        request = replace(request, max_checks=times * request.max_checks)
    terms: Any = {"beam": min(times * BEAM, 1_000), "searches": times * SEARCHES}
    return work.service.solve(steps(job, opening), work.q, request=request, memory=memory, **terms)


def objections(robot: str, done: TaskResult) -> list[str]:
    """What the auditor finds touching on the motions of a task, and of its gripper, that is not meant to."""
    found = []
    for segment in done.segments:
        touch = _unproven(segment) or touch_of_plan(_Judges(robot, segment), segment.result, LOOK)
        found += [f"{segment.name}: {touch}"] if touch is not None else []
        if segment.gripper is not None and segment.result.path is not None:
            q, may = segment.result.path.waypoints[0], _pairs(segment)
            for width in np.linspace(segment.gripper.start, segment.gripper.end, WIDTHS).tolist():
                touching = _Judges(robot, segment, width)(may).touch(q)
                found += [] if touching is None else [f"{segment.gripper.name}: {touching.a} x {touching.b}"]
    return found


def _unproven(segment: Segment) -> str | None:
    """What is not proven of a motion."""
    proof = segment.result.certificate
    if segment.result.path is None or proof is None or not proof.certified:
        return "not proven"
    return None


def _pairs(segment: Segment) -> tuple[Pair, ...]:
    return tuple(pair for each in segment.result.exempt for pair in each.pairs)


@dataclass(frozen=True, eq=False)
class _Judges:
    """Gives the auditor's checker of a motion's world, in which some pairs may touch."""

    robot: str
    segment: Segment
    width: float | None = None

    def __call__(self, pairs: tuple[Pair, ...]) -> IndependentChecker:
        width = self.segment.width if self.width is None else self.width
        scene = tables_of(self.segment.scene or ps.Scene())
        return IndependentChecker(data_folder("robots") / self.robot, scene, gripper_width=width, allowed=pairs)

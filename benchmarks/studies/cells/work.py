"""What a cell's jobs are as tasks of the planner, one after another, and who judges their motions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import planner_service as ps
from auditor.checker import IndependentChecker, tables_of
from benchmarks.harness.audit import Pair, touch_of_plan
from benchmarks.worlds.cells import KINDS, ROBOTS, Cell, Job, cell
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.planning.task_result import Segment, TaskResult

__all__ = ["LOOK", "Work", "cells", "objections", "solved"]

LOOK = 0.004
"""Metres that a point of the robot moves, at most, from one configuration that is judged to the next."""

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


def cells(seed: int, robot: str | None) -> Iterator[Cell]:
    """All cells of a draw, of one robot or all."""
    for kind in KINDS:
        for name in ROBOTS:
            if robot in (None, name):
                yield cell(kind, name, seed)


def solved(work: Work, job: Job, request: ps.PlanRequest) -> TaskResult:
    """A job as a task: take the object and set it down, on the station first if it has one."""
    stops = [(job.station, job.via)] if job.station else []
    stops.append((job.places, job.onto))
    segments, support, done = list[Segment](), job.support, None
    for places, onto in stops:
        service = work.service
        grasps = ps.top_grasps(service.robot, service.scene.obstacle(job.name))
        done = ps.pick(service, work.q, job.name, grasps, ps.Handling(support=support, request=request))
        segments += done.segments
        if done.ok:
            work, support = work.after(done), onto
            done = ps.place(work.service, work.q, job.name, places, ps.Handling(support=onto, request=request))
            segments += done.segments
        if not done.ok:
            break
        work = work.after(done)
    assert done is not None
    return replace(done, segments=tuple(segments))


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

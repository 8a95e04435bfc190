"""The proven ways of a contact, without the motion that leads there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import NoneType

from numpy.typing import ArrayLike

from planner_service.collision import CancelToken
from planner_service.collision.budget import Cancelled
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance
from planner_service.planning.request import PlanRequest, require_timing
from planner_service.planning.task_result import Segment
from planner_service.robot.model import joint_vector
from planner_service.service import PlannerService
from planner_service.tasks.inspector import Inspector, Visit
from planner_service.tasks.motions import Ended, Motions, NoMotion
from planner_service.tasks.names import require_names
from planner_service.tasks.steps import Step
from planner_service.tasks.task import ContactStage, Task
from planner_service.tasks.ways import Ways
from planner_service.timing.laws import Timing

__all__ = ["ProvenWay", "proven_ways"]


@dataclass(frozen=True, eq=False)
class ProvenWay:
    """One way to a contact and on, proven, without the motion that leads there.

    Attributes:
        number: Of its grasp or placement, from 1.
        before: What plans the motion there, with the gripper open for it.
        after: What plans on.
        q_in: Where the first approach begins, (n,).
        q_out: Where the last retreat ends, (n,).
        segments: The approaches and the retreats; the first retreat has the gripper's motion.
    """

    number: int
    before: PlannerService
    after: PlannerService
    q_in: FloatArray
    q_out: FloatArray
    segments: tuple[Segment, ...]


def proven_ways(
    service: PlannerService,
    steps: Sequence[Step],
    q: ArrayLike,
    *,
    request: PlanRequest | None = None,
    line_timing: Timing | None = None,
    cancel: CancelToken | None = None,
) -> Iterator[ProvenWay]:
    """The proven ways of ``Connect``, approaches, ``Grasp`` or ``Release``, and retreats, the preferred first.

    There is one for each grasp or placement and each inverse kinematics solution at most; nothing is searched. Grasps
    of another kind follow only where none of the kind before has a way.

    Args:
        q: Near where the robot will come from, shape (n,): continuous joints are turned towards it.
        request: As for ``PlannerService.solve``; so are the others.

    Raises:
        InvalidRequest: The steps are others than these, or a value is of the wrong kind or out of its range.
        Cancelled: by ``cancel``.
    """
    instance("service", service, PlannerService, "a PlannerService")
    instance("request", request, (PlanRequest, NoneType), "a PlanRequest, or None")
    instance("cancel", cancel, (CancelToken, NoneType), "a CancelToken, or None")
    if line_timing is not None:
        require_timing(line_timing)
    task = Task(steps)
    (stage, *more) = task.stages
    if more or not isinstance(stage, ContactStage) or stage.connect is None:
        raise InvalidRequest(
            "steps", [str(step) for step in task.steps], "Connect, Approach, Grasp or Release, Retreat"
        )
    require_names(service, task.stages)
    start = joint_vector("q", q, service.robot)
    template = replace(request or PlanRequest(start, start), start=start, goal=start, time_limit=None)
    motions = Motions(template, line_timing, cancel, turns=1, searches=1_000)
    ways, visit = Ways(motions, stage, motions.begin(service)), Visit(Inspector([stage]), stage, service, start)
    done = set[tuple[int, int]]()
    every = ways(start, visit, enough=lambda: bool(done))
    while True:
        try:
            found = next(every, None)
            if found is None:
                return
            if (found.number, found.solution) in done:
                continue
            way = found.turned(service.robot, start)
            lines = ways.lines(way, visit)
        except NoMotion:
            continue
        except Ended as ended:
            raise Cancelled(ended.failure.detail) from ended
        done.add((way.number, way.solution))
        inward, outward = ways.segments(way, lines)
        contact = way.contact
        yield ProvenWay(way.number, contact.before, contact.after, way.begin, way.end, (*inward, *outward))

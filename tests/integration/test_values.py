"""Values hold copies: what a caller does with its arrays, lists and mappings afterwards changes nothing."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planner_service import (
    Attached,
    Box,
    Capsule,
    Certificate,
    CheckCounts,
    Compound,
    Failure,
    HeightField,
    JointLimits,
    JointPath,
    Mesh,
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    PointCloud,
    Pose,
    PoseGoal,
    Reason,
    Roadmap,
    Scene,
    Stage,
    TaskResult,
    Trajectory,
    Trapezoidal,
    load_robot,
)
from planner_service.certify import ExemptInterval
from planner_service.datasets import EpisodeWorld
from planner_service.execute import ArmLimits, Recording
from planner_service.parallel import Sequential
from planner_service.planning import AllowedStretch, Pace
from planner_service.planning.follow import FollowRequest
from planner_service.planning.request import World
from planner_service.records.problem_set import Problem, ProblemSet
from planner_service.roadmap import Built
from planner_service.search import SearchGraph, Trace

ROW, COLUMN = np.array([1.0]), np.array([[0.0]])
CORNERS = [[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)]
PATH = JointPath(np.array([[0.0, 0.0], [1.0, 1.0]]))
DRIVEN = Trapezoidal().time_path(PATH, JointLimits(*(np.array([v, v]) for v in (-3.0, 3.0, 1.0, 1.0, 10.0))))
BOX = Box((0.1, 0.1, 0.1))
EXEMPT = ExemptInterval(0.0, 1.0, (("a", "b"),), "why")
PAIRS = [["a", "b"]]


def given(value: Any) -> tuple[Any, Callable[[], None]]:
    """A value that can be changed, and what changes all of it."""
    if isinstance(value, np.ndarray):
        mine = value.copy()

        def change() -> None:
            mine[...] = 7

        return mine, change
    if isinstance(value, dict):
        held = dict(value)
        return held, held.clear
    inner = [given(item) if isinstance(item, (list, np.ndarray)) else (item, lambda: None) for item in value]
    rows = [item for item, _ in inner]

    def change_all() -> None:
        for _, each in inner:
            each()
        rows.clear()

    return rows, change_all


def arm_with(**changes: Any) -> Any:
    return replace(load_robot("planar2"), **changes)


VALUES: list[tuple[Callable[[Any], Any], str, Any]] = [
    (lambda v: PlanRequest(v, [0.0, 0.0]), "start", np.array([0.0, 0.5])),
    (lambda v: PlanRequest(v, [0.0, 0.0]), "start", [0.0, 0.5]),
    (lambda v: PlanRequest([0.0, 0.0], v), "goal", np.array([0.0, 0.5])),
    (lambda v: PlanRequest([0.0, 0.0], v), "goal", [0.0, 0.5]),
    (lambda v: PlanRequest([0.0, 0.0], v), "goal", np.array([[0.0, 0.5], [0.1, 0.2]])),
    (lambda v: PlanRequest([0.0, 0.0], v), "goal", [[0.0, 0.5], Pose(), np.array([0.1, 0.2])]),
    (lambda v: FollowRequest(v, (), Pace(Trapezoidal())), "waypoints", [[0.0, 0.5], [0.1, 0.2]]),
    (lambda v: FollowRequest([[0.0, 0.5]], (), Pace(Trapezoidal()), v), "blends", np.array([0.1])),
    (
        lambda v: FollowRequest([[0.0, 0.5]], v, Pace(Trapezoidal())),
        "contacts",
        [AllowedStretch(0, 0, (("a", "b"),), "why")],
    ),
    (lambda v: AllowedStretch(0, 0, v, "why"), "pairs", PAIRS),
    (lambda v: ExemptInterval(0.0, 1.0, v, "why"), "pairs", PAIRS),
    (lambda v: Certificate(0.1, 5, 0.0, v), "exempt", [EXEMPT]),
    (JointPath, "waypoints", np.array([[0.0, 0.5], [0.1, 0.2], [0.5, 0.3]])),
    (lambda v: JointPath(np.array([[0.0, 0.5], [0.1, 0.2], [0.5, 0.3]]), v), "blends", np.array([0.0, 0.01, 0.0])),
    (lambda v: Trajectory(PATH, v, DRIVEN.coefficients), "durations", DRIVEN.durations),
    (lambda v: Trajectory(PATH, DRIVEN.durations, v), "coefficients", DRIVEN.coefficients),
    (lambda v: Trajectory(PATH, DRIVEN.durations, DRIVEN.coefficients, 1.0, v), "part", [0.0, PATH.length]),
    (Mesh, "vertices", np.array(CORNERS)),
    (lambda v: PointCloud(v, 0.1), "points", np.array([[0.05, 0.05, 0.05]])),
    (lambda v: HeightField(v, 0.1), "heights", np.array([[0.5, 0.2]])),
    (lambda v: Compound(v), "parts", [(BOX, Pose()), (Capsule(0.1, 0.2), Pose())]),
    (Box, "size", np.array([0.1, 0.2, 0.3])),
    (Pose, "position", np.array([0.1, 0.2, 0.3])),
    (lambda v: Pose(quaternion=v), "quaternion", [1.0, 0.0, 0.0, 0.0]),
    (lambda v: PoseGoal(Pose(), free_axis=v), "free_axis", [1.0, 0.0, 0.0]),
    (lambda v: Attached("a", BOX, Pose(), v), "touch_links", ["one", "two"]),
    (Scene, "obstacles", [Obstacle("a", BOX)]),
    (lambda v: Scene((), v), "attached", [Attached("a", BOX, Pose())]),
    (lambda v: JointLimits(-ROW, v, ROW, ROW, ROW), "upper", np.array([1.0])),
    (lambda v: ArmLimits(-ROW, v, ROW), "upper", np.array([1.0])),
    (lambda v: Roadmap.of(v, [[0, 1]]), "milestones", np.array([[0.0, 0.5], [0.1, 0.2]])),
    (lambda v: Roadmap.of([[0.0, 0.5], [0.1, 0.2]], v), "edges", np.array([[0, 1]])),
    (lambda v: Built("prm", v, 0, CheckCounts()), "settings", {"milestones": 5}),
    (lambda v: SearchGraph(v, np.zeros((0, 2), dtype=int)), "milestones", np.array([[0.0, 0.5]])),
    (lambda v: SearchGraph(np.array([[0.0], [1.0]]), v), "edges", np.array([[0, 1]])),
    (lambda v: Trace(searched=v), "searched", np.array([[0.0, 0.5]])),
    (lambda v: Failure(Stage.SEARCH, Reason.TIMED_OUT, "", nearest_free=v), "nearest_free", np.array([0.5])),
    (lambda v: Failure(Stage.SEARCH, Reason.TIMED_OUT, "", blocked_by=v), "blocked_by", [("a", "b", 0.5)]),
    (lambda v: PlanResult(None, None, None, (), notes=v), "notes", ["clamped"]),
    (lambda v: Recording(ROW, v, COLUMN, ROW), "commanded", np.array([[0.5]])),
    (lambda v: EpisodeWorld(Scene(), v, "a", "b"), "start", np.array([0.5])),
    (lambda v: Problem("p", ("j",), Scene(), np.array([0.0]), v), "goals", [np.array([0.5])]),
    (lambda v: Problem("p", ("j",), Scene(), v, ()), "start", np.array([0.5])),
    (lambda v: ProblemSet(v, ()), "joint_names", ["j"]),
    (lambda v: TaskResult((), World(load_robot("planar2"), Scene()), v), "q", np.array([0.0, 0.5])),
    (lambda v: arm_with(base_links=v), "base_links", ["stand"]),
]


def arrays(value: Any) -> Iterator[np.ndarray[Any, Any]]:
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from arrays(item)


@pytest.mark.parametrize(("make", "name", "content"), VALUES)
def test_a_value_is_what_it_was_made_of_whatever_becomes_of_that(
    make: Callable[[Any], Any], name: str, content: Any
) -> None:
    mine, change = given(content)
    value = make(mine)
    before = pickle.dumps(getattr(value, name))
    change()
    assert pickle.dumps(getattr(value, name)) == before
    assert not any(array.flags.writeable for array in arrays(getattr(value, name)))
    assert not isinstance(getattr(value, name), list)


def test_a_request_sent_to_another_process_is_still_read_only() -> None:
    sent = pickle.loads(pickle.dumps(PlanRequest([0.0, 0.5], [[0.1, 0.2], [0.3, 0.4]])))
    assert not any(array.flags.writeable for array in arrays((sent.start, sent.goal)))


def test_a_generator_that_uses_its_buffer_again_has_every_start_planned() -> None:
    service = PlannerService(load_robot("planar2"), Scene())

    def requests() -> Iterator[PlanRequest]:
        buffer = np.zeros(2)
        for k in range(4):
            buffer[0] = 0.1 * k
            yield PlanRequest(buffer, [0.5, 0.5])

    results = service.plan_many(requests(), engine=Sequential(), progress=False)
    assert [result.unwrap()[0].waypoints[0, 0] for result in results] == [0.0, 0.1, 0.2, 0.1 * 3]

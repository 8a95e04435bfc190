"""What the parts of a plan take, one by one, on one stored query of the bin scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmarks.studies.agreement import random_states
from benchmarks.studies.states import plan
from benchmarks.worlds import queries
from planner_service import CollisionChecker, JointPath, PlannerService, Pose, RRTConnect, ToppRa
from planner_service.certify import Certifier
from planner_service.collision import Known
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchProblem
from planner_service.smoothing.smoothing import shortcut

Benchmark = Callable[..., Any]
"""The fixture of pytest-benchmark: calls a function again and again, and times it."""

QUERY = queries.load("bin")[0]


@pytest.fixture(scope="module")
def service() -> PlannerService:
    return PlannerService(queries.ROBOT, "bin")


@pytest.fixture(scope="module")
def path(service: PlannerService) -> JointPath:
    return plan(service, QUERY).unwrap()[0]


@pytest.fixture(scope="module")
def searched(service: PlannerService) -> Any:
    return _search(service.checker)


def _search(checker: CollisionChecker) -> Any:
    limits = checker.robot.limits
    oracle = SearchOracle(checker)
    return RRTConnect().search(SearchProblem(QUERY.start, QUERY.goal[None], limits.lower, limits.upper, oracle))


def test_state_check_free(benchmark: Benchmark, service: PlannerService) -> None:
    assert benchmark(service.checker.state_is_free, QUERY.start)


def test_state_check_of_uniform_states(benchmark: Benchmark, service: PlannerService) -> None:
    Q = random_states(service.robot, 200, np.random.default_rng(0))
    assert 0 < sum(benchmark(lambda: [service.checker.state_is_free(q) for q in Q])) < 200


def test_edge_check_free(benchmark: Benchmark, service: PlannerService, path: JointPath) -> None:
    a, b = path.waypoints[0], path.waypoints[1]
    assert benchmark(service.checker.edge_is_free, a, b, known=Known.BOTH)


def test_edge_check_blocked(benchmark: Benchmark, service: PlannerService) -> None:
    assert not benchmark(service.checker.edge_is_free, QUERY.start, QUERY.goal, known=Known.BOTH)


def test_clearance(benchmark: Benchmark, service: PlannerService) -> None:
    assert benchmark(service.checker.clearance, QUERY.start) > 0.0


def test_inverse_kinematics(benchmark: Benchmark, service: PlannerService) -> None:
    tool = service.robot.tool_pose(QUERY.start)
    assert len(benchmark(inverse_kinematics, service.robot, Pose.from_matrix(tool)))


def test_search(benchmark: Benchmark, service: PlannerService) -> None:
    assert benchmark(_search, service.checker).waypoints is not None


def test_shortcut(benchmark: Benchmark, service: PlannerService, searched: Any) -> None:
    def work() -> Any:
        return shortcut(searched.waypoints, SearchOracle(service.checker), np.random.default_rng(0))

    assert len(benchmark(work)) <= len(searched.waypoints)


def test_topp_ra(benchmark: Benchmark, service: PlannerService, path: JointPath) -> None:
    assert benchmark(ToppRa().time_path, path, service.robot.limits).duration > 0.0


def test_certify(benchmark: Benchmark, service: PlannerService, path: JointPath) -> None:
    assert benchmark(Certifier(service.robot, service.scene).certify, path).certified


def test_whole_plan(benchmark: Benchmark, service: PlannerService) -> None:
    assert benchmark(plan, service, QUERY).ok

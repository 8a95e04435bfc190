"""``move_linear`` from a pose: it begins in a configuration that has the whole line, or says why none has."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import CollisionChecker, PlannerService, Pose, move_linear
from planner_service.kinematics import line_branches
from planner_service.planning.result import Reason

Q = [1.1, -1.2, 2.3, -2.2, -2.9, -0.8]
WAY = (0.2, -0.2, 0.0)


@pytest.fixture(scope="module")
def service() -> PlannerService:
    return PlannerService("ur5", "table")


@pytest.fixture(scope="module")
def there(service: PlannerService) -> Pose:
    return Pose.from_matrix(service.robot.tool_pose(Q))


def test_the_line_begins_where_all_of_it_is_possible_and_free(service: PlannerService, there: Pose) -> None:
    own = move_linear(service, Q, WAY)
    assert own.failure is not None
    result = move_linear(service, there, WAY)
    path, _ = result.unwrap()
    assert result.fraction == 1.0
    start, end = (Pose.from_matrix(service.robot.tool_pose(path(s))) for s in (0.0, path.length))
    assert np.allclose(start.position, there.position, atol=1e-9)
    assert np.allclose(np.subtract(end.position, start.position), WAY, atol=1e-6)
    assert CollisionChecker(service.robot, service.scene, backend="fcl").path_is_free(path)
    assert np.abs(np.diff(path.waypoints, axis=0)).max() < 1.0
    assert "branches have the whole line" in result.notes[-1]
    tried = move_linear(service, path(0.0), WAY).counts
    assert result.counts.states >= tried.states  # what other branches cost is counted, too


def test_a_line_that_nothing_follows_is_a_proof(service: PlannerService, there: Pose) -> None:
    result = move_linear(service, there, (0.9, 0.3, 0.0))
    assert result.failure is not None
    assert result.failure.reason is Reason.LINE_BLOCKED
    assert result.failure.proven
    assert "no motion follows the line beyond" in result.failure.detail
    several = move_linear(service, there, [(0.9, 0.3, 0.0), (0.0, 0.0, 0.1)], zone=0.02)
    assert several.failure is not None
    assert not several.failure.proven


def test_a_part_is_the_longest_of_all_branches(service: PlannerService, there: Pose) -> None:
    result = move_linear(service, there, (0.9, 0.3, 0.0), partial=True)
    longest = max(line.fraction for line in line_branches(service.robot, there, (0.9, 0.3, 0.0)).lines)
    assert result.ok
    assert 0.2 < (result.fraction or 0.0) <= longest + 1e-9


def test_a_start_out_of_reach_is_proven(service: PlannerService) -> None:
    result = move_linear(service, Pose((5.0, 0.0, 0.0)), (0.0, 0.0, 0.1))
    assert result.failure is not None
    assert (result.failure.reason, result.failure.proven, result.fraction) == (Reason.NO_IK_SOLUTION, True, 0.0)

"""What compiled queries of a roadmap refuse."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from planner_service import InvalidRequest, PlannerService, Roadmap
from planner_service.search.problem import SearchOracle, SearchProblem

if TYPE_CHECKING:
    pass

DISCS = PlannerService("planar2", "discs")


def test_a_milestone_beyond_the_joint_limits_is_refused() -> None:
    limits = DISCS.robot.limits
    start, goal = np.array([-2.5, 2.0]), np.array([[2.2, -2.2]])
    roadmap = Roadmap.of([start, limits.upper + 1.0, goal[0]], [(0, 1), (1, 2)])
    problem = SearchProblem(start, goal, limits.lower, limits.upper, SearchOracle(DISCS.checker))
    before = DISCS.checker.counts
    with pytest.raises(InvalidRequest, match="expected shoulder in"):
        roadmap.search(problem)
    assert (DISCS.checker.counts - before).states <= 1

"""Out of a collision: a proven way on which nothing gets deeper, or advice where there is none."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from benchmarks.studies.starts import starts_of
from planner_service import (
    Box,
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    Scene,
    inverse_kinematics,
)
from planner_service.certify import Certifier
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.planning.collision_recovery import nearest_to_zero
from tests.support.optional import present

DOWN = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
DISC = math.hypot(1.1, 0.6)
"""How far the middle of the lesson's disc is from the shoulder of the planar arm."""
REACH = 0.15 + 0.01
"""Radii of the disc and the forearm."""


def beside_disc(depth: float) -> FloatArray:
    """The outstretched planar arm, so deep in the lesson's disc."""
    return np.array([math.atan2(0.6, 1.1) - math.asin((REACH - depth) / DISC), 0.0])


def in_table(service: PlannerService, depth: float) -> FloatArray:
    """The arm's fingers, pointing down, about so deep in the table."""
    return np.asarray(inverse_kinematics(service.robot, Pose((0.3, 0.0, -0.001 - depth), DOWN))[0])


@pytest.fixture(scope="module")
def discs() -> PlannerService:
    return PlannerService("planar2", "discs")


@pytest.fixture(scope="module")
def table() -> PlannerService:
    return PlannerService("wxai", "table")


def depths_on(service: PlannerService, result: PlanResult) -> list[dict[tuple[str, str], float]]:
    """By Coal: what overlaps by how much on the way out, 200 times."""
    judge = IndependentChecker(data_folder("robots") / service.robot.name, tables_of(service.scene))
    end = max(stretch.s_end for stretch in result.exempt)
    rows = present(result.path)(np.linspace(0.0, end, 200))
    return [{pair: -gap for pair, gap in judge.gaps(q).items() if gap < 0.0} for q in rows]


def test_a_plan_begins_with_a_proven_way_out_that_says_how_deep_it_begins(discs: PlannerService) -> None:
    start = beside_disc(depth := 1e-3)
    result = discs.plan(PlanRequest(start, (-1.0, 0.5)))
    path, _ = result.unwrap()
    (stretch,) = result.exempt
    assert path.waypoints[0].tolist() == start.tolist()
    assert (stretch.s_start, stretch.pairs) == (0.0, (("forearm", "lesson_disc"),))
    assert stretch.depth == pytest.approx(depth, abs=3e-8)
    assert present(result.certificate).certified
    assert discs.checker.state_is_free(path([stretch.s_end])[0])


def test_on_the_way_out_no_depth_grows_and_nothing_else_touches_by_coal(table: PlannerService) -> None:
    for depth in (0.0003, 0.0028):
        result = table.plan(PlanRequest(in_table(table, depth), table.robot.home))
        found = depths_on(table, result)
        assert {pair for at in found for pair in at} <= {pair for e in result.exempt for pair in e.pairs}
        for before, after in pairwise(found):
            assert all(deep <= before.get(pair, 0.0) + 1e-6 for pair, deep in after.items())
        assert not found[-1]


def test_a_start_deeper_than_asked_is_refused_with_what_would_help(discs: PlannerService) -> None:
    start = beside_disc(0.0021)
    refused = present(discs.plan(PlanRequest(start, (-1.0, 0.5), start_overlap=0.0020)).failure)
    assert refused.reason is Reason.START_IN_COLLISION
    assert "forearm x lesson_disc is 2.1 mm deep, and start_overlap allows 2 mm" in refused.detail
    assert "with start_overlap=0.0022 a plan begins with a way out of it" in refused.detail
    assert discs.plan(PlanRequest(start, (-1.0, 0.5), start_overlap=0.0022)).ok
    assert discs.plan(PlanRequest(present(refused.nearest_free), (-1.0, 0.5), start_overlap=0.0)).ok


@pytest.mark.parametrize(
    ("robot", "scene"), [("wxai", "bin"), ("panda", "shelf"), ("wxai_dual", "table"), ("ur5", "empty")]
)
def test_from_shallow_starts_of_many_kinds_there_is_a_plan(robot: str, scene: str) -> None:
    service = PlannerService(robot, scene)
    certifier, itself = Certifier(service.robot, service.scene), scene == "empty"
    starts = starts_of(service, certifier, np.random.default_rng(4), itself=itself)
    for _, (start, goal) in zip(range(2), starts, strict=False):
        assert service.plan(PlanRequest(start, goal)).ok


def test_wedged_between_walls_there_is_no_way_out_and_that_is_not_called_proven() -> None:
    """What leaves the one wall goes into the other."""
    walls = tuple(
        Obstacle(name, Box((0.6, 0.02, 0.2)), Pose((1.1, y, 0.0))) for name, y in (("left", 0.0199), ("right", -0.0199))
    )
    failure = present(PlannerService("planar2", Scene(walls)).plan(PlanRequest((0.0, 0.0), (1.5, 0.0))).failure)
    assert failure.reason is Reason.START_IN_COLLISION
    assert not failure.proven
    assert "no motion was found on which nothing gets deeper" in failure.detail


def test_the_nearest_free_configuration_is_always_accepted_as_a_start() -> None:
    service = PlannerService("wxai", "bin")
    rng, limits, told = np.random.default_rng(11), service.robot.limits, 0
    while told < 5:
        q = rng.uniform(limits.lower, limits.upper)
        failure = service.plan(PlanRequest(q, service.robot.home, start_overlap=0.0)).failure
        if failure is not None and failure.reason is Reason.START_IN_COLLISION and failure.nearest_free is not None:
            near = failure.nearest_free
            again = service.plan(PlanRequest(near, near, padding=0.02, start_overlap=0.0))
            assert again.ok, again.failure
            told += 1


def test_the_point_nearest_to_zero_has_the_largest_product_with_every_row() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        rows = rng.normal(size=(int(rng.integers(1, 9)), 6)) + 1.5 * rng.normal(size=6)
        best = nearest_to_zero(rows)
        square = float(best @ best)
        if square > 1e-6:
            assert (rows @ best).min() >= 0.98 * square

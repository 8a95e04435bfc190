"""Out of a collision: a proven way on which nothing gets deeper, or advice where there is none."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from benchmarks.studies.starts import starts_of
from planner_service import (
    Attached,
    Box,
    HeightField,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    Scene,
    Sphere,
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


@pytest.mark.parametrize("depth", [1e-5, 1e-3, 2.9e-3])
def test_a_plan_begins_with_a_proven_way_out_that_says_how_deep_it_begins(discs: PlannerService, depth: float) -> None:
    start = beside_disc(depth)
    result = discs.plan(PlanRequest(start, (-1.0, 0.5)))
    path, _ = result.unwrap()
    (stretch,) = result.exempt
    assert path.waypoints[0].tolist() == start.tolist()
    assert (stretch.s_start, stretch.pairs) == (0.0, (("forearm", "lesson_disc"),))
    assert stretch.depth == pytest.approx(depth, abs=3e-8)
    assert present(result.certificate).certified
    assert discs.checker.state_is_free(path([stretch.s_end])[0])


def test_on_the_way_out_no_depth_grows_and_nothing_else_touches_by_coal(table: PlannerService) -> None:
    for depth in (0.0003, 0.0015, 0.0028):
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


def test_without_an_overlap_every_start_in_collision_is_refused(discs: PlannerService) -> None:
    failure = present(discs.plan(PlanRequest(beside_disc(1e-5), (-1.0, 0.5), start_overlap=0.0)).failure)
    assert failure.reason is Reason.START_IN_COLLISION


def test_a_start_that_barely_touches_is_left_too(discs: PlannerService) -> None:
    result = discs.plan(PlanRequest(beside_disc(-1e-6), (-1.0, 0.5)))  # free, but nearer than any proof takes
    assert result.ok
    assert [stretch.pairs for stretch in result.exempt] == [(("forearm", "lesson_disc"),)]


def test_of_a_free_start_the_overlap_changes_nothing(table: PlannerService) -> None:
    goal = table.robot.home + np.array([1.0, 0.3, 0.0, 0.2, 0.0, 0.0])
    one, other = (table.plan(PlanRequest(table.robot.home, goal, start_overlap=most)) for most in (0.0, 0.003))
    assert one.counts == other.counts
    assert present(one.path).waypoints.tolist() == present(other.path).waypoints.tolist()


def test_an_overlap_that_is_no_small_distance_is_refused() -> None:
    for overlap in [-1e-9, 0.11, math.nan, "1"]:
        with pytest.raises(InvalidRequest, match=r"start_overlap: got .*; expected a number in \[0, 0.1\]"):
            PlanRequest((0.0,), (0.0,), start_overlap=overlap)  # type: ignore[arg-type]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_start_a_hair_beyond_a_limit_and_in_collision_is_left_from_the_limit(side: float) -> None:
    """Away from the ball is back into the range of the shoulder, or beyond it: then the elbow bends."""
    angle = math.pi + side * math.asin((0.11 - 0.001) / 1.3)
    ball = Obstacle("ball", Sphere(0.1), Pose((1.3 * math.cos(angle), 1.3 * math.sin(angle), 0.0)))
    service = PlannerService("planar2", Scene((ball,)))
    result = service.plan(PlanRequest((math.pi + 0.002, 0.0), (2.0, 0.5)))
    path, _ = result.unwrap()
    assert path.waypoints[0].tolist() == [math.pi, 0.0]
    assert [stretch.pairs for stretch in result.exempt] == [(("forearm", "ball"),)]
    assert present(result.exempt[0].depth) == pytest.approx(0.001, abs=1e-6)


@pytest.mark.parametrize(
    ("robot", "scene"),
    [("wxai", "shelf"), ("wxai", "bin"), ("panda", "shelf"), ("wxai_dual", "table"), ("ur5", "empty")],
)
def test_from_shallow_starts_of_many_kinds_there_is_a_plan(robot: str, scene: str) -> None:
    service = PlannerService(robot, scene)
    certifier, itself = Certifier(service.robot, service.scene), scene == "empty"
    starts = starts_of(service, certifier, np.random.default_rng(4), itself=itself)
    for _, (start, goal) in zip(range(4), starts, strict=False):
        assert service.plan(PlanRequest(start, goal)).ok


def test_out_of_a_height_field_all_columns_are_left_together() -> None:
    """Of the columns beside each other that a finger stands in, some would part from it sideways, to either side."""
    rows, columns = np.meshgrid(np.arange(60), np.arange(60), indexing="ij")
    ground = HeightField(0.003 + 0.003 * np.sin(rows / 3.0) * np.cos(columns / 4.0), 0.01)
    service = PlannerService("wxai", Scene((Obstacle("ground", ground, Pose((0.3, 0.0, -0.003))),)))
    certifier, rng, left = Certifier(service.robot, service.scene), np.random.default_rng(0), 0
    while left < 4:
        place = (rng.uniform(0.2, 0.4), rng.uniform(-0.15, 0.15), rng.uniform(-0.004, 0.004))
        for q in inverse_kinematics(service.robot, Pose(place, DOWN))[:1]:
            (depths,) = certifier.overlaps(q[None])
            if depths and max(depths.values()) < 0.003:
                assert service.plan(PlanRequest(q, service.robot.home)).ok
                left += 1


def test_a_carried_object_is_lifted_off_what_it_stands_in(table: PlannerService) -> None:
    q = np.asarray(inverse_kinematics(table.robot, Pose((0.3, 0.0, 0.05), DOWN))[0])
    links = frozenset(shape.link for shape in table.robot.shapes)
    block = Attached("block", Box((0.1032, 0.02, 0.02)), Pose((0.0, 0.0, 0.0)), touch_links=tuple(sorted(links)))
    service = table.with_scene(table.scene.with_attached(block))
    result = service.plan(PlanRequest(q, table.robot.home))
    assert result.ok
    assert {name for stretch in result.exempt for pair in stretch.pairs for name in pair} == {"block", "table"}


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
    while told < 15:
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

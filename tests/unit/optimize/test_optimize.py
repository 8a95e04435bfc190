"""Optimised curves: what is minimised, how, and that nothing of it depends on the processor or on what came before."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import planner_service as ps
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Shape
from planner_service.optimize import Chomp, TrajOpt
from planner_service.optimize.chomp import Balls
from planner_service.optimize.curve import course_path, sampled
from planner_service.optimize.distance_field import BAND, field_of
from planner_service.optimize.qp_step import Step, solved
from tests.support.optional import present

ROUTE = np.array([[-0.3, 0.0], [0.4, 1.8], [1.0, 0.3]])
"""Around ``disc(1.4, 0.6)``, which is in the way of the straight line."""

START, GOAL = np.array([0.2, 0.1]), np.array([1.7, -0.9])
METHODS = pytest.mark.parametrize("method", [TrajOpt(), Chomp()], ids=lambda method: method.name)


def planar(*obstacles: ps.Obstacle) -> ps.CollisionChecker:
    return ps.CollisionChecker(ps.load_robot("planar2"), ps.Scene(obstacles=obstacles))


def disc(x: float, y: float, radius: float = 0.1) -> ps.Obstacle:
    return ps.Obstacle("disc", ps.Cylinder(radius, 0.2), ps.Pose((x, y, 0.0)))


def corners_of(seed: int, count: int = 7, n: int = 6) -> FloatArray:
    return np.cumsum(np.random.default_rng(seed).normal(size=(count, n)), axis=0)


def smallest(checker: ps.CollisionChecker, path: Any, count: int = 400) -> float:
    limits = checker.robot.limits
    Q = np.clip(path(np.linspace(0.0, path.length, count)), limits.lower, limits.upper)
    distances: list[float] = checker.near(Q, 0.2).distances.tolist()
    return min([0.2, *distances])


# the curve


def test_samples_lie_on_the_very_path_that_is_timed() -> None:
    for seed in range(5):
        corners = corners_of(seed)
        path, points = course_path(corners), sampled(corners, 61).of(corners)
        dense = path(np.linspace(0.0, path.length, 40_001))
        assert max(np.sqrt(((dense - q) ** 2).sum(axis=1).min()) for q in points) < path.length / 40_000
        assert points[0].tolist() == corners[0].tolist()
        assert points[-1].tolist() == corners[-1].tolist()


# what is minimised


# one convex step


def test_a_step_without_constraints_is_newtons() -> None:
    none = np.zeros((0, 2))
    step = Step(np.diag([2.0, 8.0]), np.array([-2.0, 8.0]), np.full(2, -9.0), np.full(2, 9.0), none, np.zeros(0), 1.0)
    assert solved(step) == pytest.approx([1.0, -1.0], abs=1e-5)


@pytest.mark.parametrize(("price", "expected"), [(10.0, 1.0), (1.0, 0.5), (100.0, 1.0)])
def test_what_is_lacking_is_paid_for_until_that_is_dearer_than_the_cost(price: float, expected: float) -> None:
    # x^2 + price max(0, 1 - x): x = 1 if the price is above 2, else price / 2
    low, high = np.array([-5.0]), np.array([5.0])
    step = Step(np.array([[2.0]]), np.zeros(1), low, high, np.ones((1, 1)), np.ones(1), price)
    assert solved(step) == pytest.approx([expected], abs=1e-4)


# both methods


@METHODS
def test_where_nothing_is_near_a_detour_becomes_the_straight_line(method: Any) -> None:
    checker = planar(disc(-1.5, -1.5, 0.01))
    found = ps.Optimise(method=method, waypoints=20).improved(np.array([START, [1.5, 1.0], GOAL]), checker)
    assert found.after.length == pytest.approx(math.dist(START, GOAL), rel=2e-3)
    assert found.after.cost < found.before.cost
    assert found.corners[[0, -1]].tolist() == [START.tolist(), GOAL.tolist()]


@METHODS
def test_a_curve_keeps_its_distance_between_waypoints_too(method: Any) -> None:
    checker = planar(disc(1.4, 0.6))
    found = ps.Optimise(method=method, clearance=0.03).improved(ROUTE, checker)
    path = found.path
    assert checker.path_is_free(path)
    assert smallest(checker, path, 2000) >= 0.03 - 1e-4
    assert smallest(checker, path) < 0.05  # and no more than it has to
    assert found.after.length < found.before.length


@METHODS
def test_the_curve_stays_within_joint_limits(method: Any) -> None:
    checker = ps.CollisionChecker(ps.load_robot("wxai"), ps.load_scene("clutter"))
    limits = checker.robot.limits
    start = np.array([0.6, 0.02, 0.05, 0.1, 0.0, 0.0])  # joints 1 and 2 begin at their lower ends
    goal = np.array([-0.6, 0.02, 0.05, 0.1, 0.0, 0.0])
    found = ps.Optimise(method=method, waypoints=20).improved(np.array([start, goal]), checker)
    assert found.iterations > 0
    assert ((found.corners >= limits.lower) & (found.corners <= limits.upper)).all()


def test_converged_is_not_collision_free() -> None:
    """Between two walls that leave no room the merit has an optimum, and it collides."""
    checker = planar(disc(1.3, 0.75, 0.3), ps.Obstacle("other", ps.Cylinder(0.3, 0.2), ps.Pose((1.45, 0.3, 0.0))))
    found = ps.Optimise().improved(np.array([[-0.6, 0.0], [1.6, 0.0]]), checker)
    assert found.iterations < TrajOpt().iterations  # it stopped by itself
    assert not checker.path_is_free(found.path)
    assert found.after.shortfall > 0.0


# what is looked up


def field(*obstacles: ps.Obstacle, voxel: float = 0.02) -> Any:
    return present(field_of(planar(*obstacles), voxel))


SHAPES: list[Shape] = [
    ps.Box((0.3, 0.2, 0.1)),
    ps.Sphere(0.12),
    Mesh(np.array([[x, y, z] for x in (-0.1, 0.2) for y in (-0.1, 0.1) for z in (-0.1, 0.15)])),
]


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_outside_the_field_is_the_distance_to_the_nearest_piece(shape: Shape) -> None:
    pose = ps.Pose.from_rpy((0.4, 0.1, 0.05), (0.3, 0.5, 0.7))
    grid = field(ps.Obstacle("one", shape, pose))
    points = np.random.default_rng(0).uniform(-0.35, 0.35, (1500, 3)) + pose.position
    local = (points - pose.matrix[:3, 3]) @ pose.matrix[:3, :3]
    true = shape.distance(local)
    value, _ = grid.at(points)
    clear = (true > 0.03) & (true < BAND - 0.02)
    assert clear.sum() > 200
    assert np.abs(value - true)[clear].max() < 0.003
    assert (value[true == 0.0] < 0.02).all()


def test_the_gradient_is_that_of_what_is_looked_up() -> None:
    grid = field(ps.Obstacle("ball", ps.Sphere(0.1), ps.Pose((0.5, 0.0, 0.0))))
    points = np.random.default_rng(1).uniform(-0.25, 0.25, (300, 3)) + np.array([0.5, 0.0, 0.0])
    value, gradient = grid.at(points)
    for axis in range(3):
        moved = points.copy()
        moved[:, axis] += 1e-7
        slope = (grid.at(moved)[0] - value) / 1e-7
        assert np.median(np.abs(slope - gradient[:, axis])) < 1e-5  # but where a step leaves its cell
        assert (np.abs(slope - gradient[:, axis]) < 1e-4).mean() > 0.99


def test_what_is_surely_farther_than_its_limit_is_left_out_and_nothing_else() -> None:
    grid = field(ps.Obstacle("ball", ps.Sphere(0.1), ps.Pose((0.5, 0.0, 0.0))))
    points = np.random.default_rng(2).uniform(-0.6, 0.6, (3000, 3)) + np.array([0.5, 0.0, 0.0])
    value, _ = grid.at(points)
    maybe = grid.may_be_within(points, np.full(len(points), 0.05))
    assert not (~maybe & (value < 0.05)).any()
    assert 0 < maybe.sum() < 0.2 * len(points)


def test_balls_hold_the_moving_pieces() -> None:
    checker = ps.CollisionChecker(ps.load_robot("wxai"), ps.load_scene("bin"))
    balls, rng = Balls.of(checker), np.random.default_rng(0)
    whole = present(balls.whole)
    moving = [part for part in checker.parts.parts if part.body > 0]
    for number, part in enumerate(moving):
        mine = balls.piece == number
        for one, other in rng.normal(size=(60, 2, 3)):
            share = rng.uniform(0.0, 1.0)
            local = share * part.shape.support(one) + (1.0 - share) * part.shape.support(other)
            x = part.T[:3, :3] @ local + part.T[:3, 3]
            away = np.sqrt(((balls.centre[mine] - x) ** 2).sum(axis=1)) - balls.radius[mine]
            assert away.min() <= 1e-9
            assert math.dist(whole.centre[number], x) <= whole.radius[number] + 1e-9
        between = np.sqrt(((balls.centre[mine] - whole.centre[number]) ** 2).sum(axis=1)) + balls.radius[mine]
        assert between.max() <= whole.radius[number] + 1e-9


# settings


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"waypoints": 3}, "waypoints"),
        ({"smoothness": -1.0}, "smoothness"),
        ({"clearance": 2.0}, "clearance"),
        ({"corners": 60}, "waypoints"),
        ({"method": TrajOpt}, "method"),
    ],
)
def test_settings_that_make_no_sense_are_refused_by_name(given: dict[str, Any], named: str) -> None:
    with pytest.raises(ps.InvalidRequest, match=f"^{named}: "):
        ps.Optimise(**given)


def test_settings_of_methods_are_refused_by_name() -> None:
    for method, name, value in [(TrajOpt, "iterations", 0), (Chomp, "iterations", 1.5), (Chomp, "voxel", 20.0)]:
        with pytest.raises(ps.InvalidRequest, match=f"^{name}: "):
            method(**{name: value})


def test_what_is_no_route_is_refused() -> None:
    route: Any
    held: Any
    for route, held, named in [
        ([START], (1, 1), "route"),
        ([START, [0.0, math.inf]], (1, 1), "route"),
        ([START, GOAL], (5, 5), "held"),
        ([START, GOAL], (1,), "held"),
        ([START, GOAL], None, "held"),
    ]:
        with pytest.raises(ps.InvalidRequest, match=f"^{named}"):
            ps.Optimise().improved(route, planar(), held=held)

"""Optimised curves: what is minimised, how, and that nothing of it depends on the processor or on what came before."""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import (
    Box,
    Capsule,
    CollisionChecker,
    Cylinder,
    InvalidRequest,
    Obstacle,
    Optimise,
    Pose,
    Scene,
    Sphere,
    load_robot,
    load_scene,
)
from planner_service.collision.budget import Cancelled
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Shape
from planner_service.optimize import Chomp, TrajOpt
from planner_service.optimize.chomp import Balls, _Descent
from planner_service.optimize.curve import course_path, evenly, sampled, squares
from planner_service.optimize.distance_field import BAND, field_of
from planner_service.optimize.problem import OWN_SHARE, RAMP, SPARE, CurveObjective, CurveProblem
from planner_service.optimize.qp_step import Step, solved
from tests.support.optional import present

ROUTE = np.array([[-0.3, 0.0], [0.4, 1.8], [1.0, 0.3]])
"""Around ``disc(1.4, 0.6)``, which is in the way of the straight line."""

START, GOAL = np.array([0.2, 0.1]), np.array([1.7, -0.9])
ROOT = Path(__file__).parents[3]
METHODS = pytest.mark.parametrize("method", [TrajOpt(), Chomp()], ids=lambda method: method.name)


def planar(*obstacles: Obstacle) -> CollisionChecker:
    return CollisionChecker(load_robot("planar2"), Scene(obstacles=obstacles))


def disc(x: float, y: float, radius: float = 0.1) -> Obstacle:
    return Obstacle("disc", Cylinder(radius, 0.2), Pose((x, y, 0.0)))


def corners_of(seed: int, count: int = 7, n: int = 6) -> FloatArray:
    return np.cumsum(np.random.default_rng(seed).normal(size=(count, n)), axis=0)


def smallest(checker: CollisionChecker, path: Any, count: int = 400) -> float:
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


def test_samples_are_means_of_corners_so_that_limits_of_corners_are_those_of_the_curve() -> None:
    weights = sampled(corners_of(1), 97).matrix(7)
    assert weights.min() >= 0.0
    assert np.abs(weights.sum(axis=1) - 1.0).max() < 1e-12


def test_a_corner_that_turns_back_is_a_stop() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.1, 0.01], [0.1, 1.0]])
    path = course_path(corners)
    assert path.corners == (1,)
    samples = sampled(corners, 31)
    assert samples.of(corners)[10].tolist() == [1.0, 0.0]


def test_evenly_spaced_points_keep_the_ends_to_the_last_bit() -> None:
    route = corners_of(2, 5)
    points = evenly(route, 50)
    steps = np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1))
    assert (points[0].tolist(), points[-1].tolist()) == (route[0].tolist(), route[-1].tolist())
    assert steps.max() <= steps.max() * (1.0 + 1e-9)
    assert steps.max() == pytest.approx(sum(math.dist(a, b) for a, b in pairwise(route.tolist())) / 49)


# what is minimised


def test_the_cost_is_the_lessons() -> None:
    q = corners_of(3, 20, 3)
    first = sum(math.dist(a, b) ** 2 for a, b in pairwise(q.tolist()))
    second = sum(float(((q[k + 1] - 2 * q[k] + q[k - 1]) ** 2).sum()) for k in range(1, 19))
    assert list(squares(q)) == pytest.approx([first, second])


def test_the_matrix_of_the_cost_is_that_of_the_cost() -> None:
    problem = CurveProblem(planar(), CurveObjective(20, 30.0, 0.02), np.array([START, GOAL]))
    corners = evenly(np.array([START, [1.0, 1.0], GOAL]), 6)
    samples = problem.samples(corners)
    H = problem.curvature(samples, 6)
    assert float((corners * (H @ corners)).sum()) == pytest.approx(problem.cost(samples, corners))
    assert problem.cost(samples, corners) == pytest.approx(problem.figures(corners).cost / problem.unit)


def test_points_are_so_close_that_nothing_thin_is_stepped_over() -> None:
    checker = planar(disc(1.5, 1.5, 0.002))
    problem = CurveProblem(checker, CurveObjective(10, 1.0, 0.05), np.array([[0.0, 0.0], [0.8, -0.3]]))
    points = sampled(evenly(problem.route, 5), problem.points).of(evenly(problem.route, 5))
    moved = np.abs(np.diff(points, axis=0)) @ checker.robot.reach()
    assert moved.max() < 0.05 * 1.01


def test_what_is_near_at_an_end_may_be_as_near_there_and_must_part_from_then_on() -> None:
    checker = planar(disc(0.5, 0.115))  # 5 mm beside the arm at its start
    route = np.array([[0.0, 0.0], [-1.0, -0.5]])
    (gap,) = checker.near(route[:1], 0.02).distances.tolist()
    problem = CurveProblem(checker, CurveObjective(50, 1.0, 0.02), route)
    corners = evenly(route, 5)
    look = problem.look(problem.samples(corners), corners, 0.02)
    expected = gap + RAMP * math.dist(*route.tolist()) * look.near.rows / (problem.points - 1)
    assert 0.0 < gap < 0.02
    assert len(look.targets) > 0
    assert np.abs(look.targets - np.minimum(expected, 0.02 * SPARE)).max() < 1e-12


def test_links_need_a_quarter_of_the_room_from_each_other() -> None:
    checker = CollisionChecker(load_robot("ur5"), Scene(obstacles=()))
    rng = np.random.default_rng(0)
    limits = checker.robot.limits
    Q = rng.uniform(limits.lower, limits.upper, (200, 6))
    near = checker.near(Q, 0.004)
    assert len(near.rows) > 0
    problem = CurveProblem(
        checker, CurveObjective(10, 1.0, 0.02), np.array([checker.robot.home, checker.robot.home + 0.5])
    )
    assert OWN_SHARE == 0.25
    assert problem._targets(near).max() <= 0.005 * SPARE + 1e-12


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


def test_a_step_stays_within_its_bounds_even_if_that_is_too_little() -> None:
    low, high = np.array([-0.1]), np.array([0.25])
    step = Step(np.array([[2.0]]), np.zeros(1), low, high, np.ones((1, 1)), np.ones(1), 1e6)
    assert solved(step).tolist() == [pytest.approx(0.25, abs=1e-6)]
    assert solved(step)[0] <= 0.25


# both methods


@METHODS
def test_where_nothing_is_near_a_detour_becomes_the_straight_line(method: Any) -> None:
    checker = planar(disc(-1.5, -1.5, 0.01))
    found = Optimise(method=method, waypoints=20).improved(np.array([START, [1.5, 1.0], GOAL]), checker)
    assert found.after.length == pytest.approx(math.dist(START, GOAL), rel=2e-3)
    assert found.after.cost < found.before.cost
    assert found.corners[[0, -1]].tolist() == [START.tolist(), GOAL.tolist()]


@METHODS
def test_a_curve_keeps_its_distance_between_waypoints_too(method: Any) -> None:
    checker = planar(disc(1.4, 0.6))
    found = Optimise(method=method, clearance=0.03).improved(ROUTE, checker)
    path = found.path
    assert checker.path_is_free(path)
    assert smallest(checker, path, 2000) >= 0.03 - 1e-4
    assert smallest(checker, path) < 0.05  # and no more than it has to
    assert found.after.length < found.before.length


@METHODS
def test_corners_that_are_held_stay(method: Any) -> None:
    checker = planar(disc(1.4, 0.6))
    route = np.array([[-0.3, 0.0], [0.0, 0.8], [0.4, 1.8], [0.7, 1.0], [1.0, 0.3]])
    found = Optimise(method=method, waypoints=20).improved(route, checker, held=(2, 2), warm=True)
    assert len(found.corners) == 5
    assert found.corners[[0, 1, 3, 4]].tolist() == route[[0, 1, 3, 4]].tolist()
    assert found.corners[2].tolist() != route[2].tolist()


@METHODS
def test_an_optimum_stays_where_it_is(method: Any) -> None:
    checker = planar(disc(1.4, 0.6))
    settings = Optimise(method=method)
    first = settings.improved(ROUTE, checker)
    again = settings.improved(first.corners, checker, warm=True)
    assert again.iterations <= first.iterations
    assert again.after.cost == pytest.approx(first.after.cost, rel=0.05)


@METHODS
def test_the_curve_stays_within_joint_limits(method: Any) -> None:
    checker = CollisionChecker(load_robot("wxai"), load_scene("clutter"))
    limits = checker.robot.limits
    start = np.array([0.6, 0.02, 0.05, 0.1, 0.0, 0.0])  # joints 1 and 2 begin at their lower ends
    goal = np.array([-0.6, 0.02, 0.05, 0.1, 0.0, 0.0])
    found = Optimise(method=method, waypoints=20).improved(np.array([start, goal]), checker)
    assert found.iterations > 0
    assert ((found.corners >= limits.lower) & (found.corners <= limits.upper)).all()


def test_a_straight_line_that_keeps_its_distance_is_left_as_it_is() -> None:
    found = Optimise().improved(np.array([START, GOAL]), planar(disc(-1.5, -1.5)))
    assert (found.iterations, found.gradients) == (0, 0)
    assert found.before == found.after


def test_converged_is_not_collision_free() -> None:
    """Between two walls that leave no room the merit has an optimum, and it collides."""
    checker = planar(disc(1.3, 0.75, 0.3), Obstacle("other", Cylinder(0.3, 0.2), Pose((1.45, 0.3, 0.0))))
    found = Optimise().improved(np.array([[-0.6, 0.0], [1.6, 0.0]]), checker)
    assert found.iterations < TrajOpt().iterations  # it stopped by itself
    assert not checker.path_is_free(found.path)
    assert found.after.shortfall > 0.0


BITS = """
import hashlib, numpy as np
from planner_service import CollisionChecker, Optimise, load_robot, load_scene
from planner_service.optimize import Chomp
from benchmarks.worlds import queries
checker = CollisionChecker(load_robot("wxai"), load_scene("post"))
query = queries.load("post")[0]
told = hashlib.sha256()
for method in (Optimise(), Optimise(method=Chomp(iterations=15), waypoints=20)):
    found = method.improved(np.array([query.start, query.goal]), checker)
    told.update(found.corners.tobytes() + repr((found.after, found.iterations, found.gradients)).encode())
print(told.hexdigest(), checker.counts.distances)
"""


def bits(**environment: str) -> list[str]:
    whole = {**os.environ, **environment}
    done = subprocess.run([sys.executable, "-c", BITS], capture_output=True, text=True, check=True, env=whole, cwd=ROOT)
    return done.stdout.split()


@pytest.mark.slow
def test_bits_and_counts_are_equal_in_other_processes_whatever_libraries_take_the_processor_for() -> None:
    """The C library's sine, too: without AVX2 it has no fused multiply-adds."""
    digest, distances = bits(OPENBLAS_CORETYPE="Prescott", GLIBC_TUNABLES="glibc.cpu.hwcaps=-AVX2,-FMA")
    assert [digest, distances] == bits()
    assert int(distances) == 8_123


# what is looked up


def field(*obstacles: Obstacle, voxel: float = 0.02) -> Any:
    return present(field_of(planar(*obstacles), voxel))


SHAPES: list[Shape] = [
    Box((0.3, 0.2, 0.1)),
    Sphere(0.12),
    Cylinder(0.1, 0.3),
    Capsule(0.08, 0.2),
    Mesh(np.array([[x, y, z] for x in (-0.1, 0.2) for y in (-0.1, 0.1) for z in (-0.1, 0.15)])),
]


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_outside_the_field_is_the_distance_to_the_nearest_piece(shape: Shape) -> None:
    pose = Pose.from_rpy((0.4, 0.1, 0.05), (0.3, 0.5, 0.7))
    grid = field(Obstacle("one", shape, pose))
    points = np.random.default_rng(0).uniform(-0.35, 0.35, (1500, 3)) + pose.position
    local = (points - pose.matrix[:3, 3]) @ pose.matrix[:3, :3]
    true = shape.distance(local)
    value, _ = grid.at(points)
    clear = (true > 0.03) & (true < BAND - 0.02)
    assert clear.sum() > 200
    assert np.abs(value - true)[clear].max() < 0.003
    assert (value[true == 0.0] < 0.02).all()


def test_inside_the_field_is_as_deep_as_the_way_out() -> None:
    grid = field(Obstacle("box", Box((0.4, 0.4, 0.4)), Pose((0.5, 0.0, 0.0))))
    value, gradient = grid.at(np.array([[0.5, 0.0, 0.15], [0.65, 0.01, 0.0]]))
    assert value == pytest.approx([-0.05, -0.05], abs=0.02)
    assert gradient[0].argmax() == 2
    assert gradient[1].argmax() == 0


def test_the_gradient_is_that_of_what_is_looked_up() -> None:
    grid = field(Obstacle("ball", Sphere(0.1), Pose((0.5, 0.0, 0.0))))
    points = np.random.default_rng(1).uniform(-0.25, 0.25, (300, 3)) + np.array([0.5, 0.0, 0.0])
    value, gradient = grid.at(points)
    for axis in range(3):
        moved = points.copy()
        moved[:, axis] += 1e-7
        slope = (grid.at(moved)[0] - value) / 1e-7
        assert np.median(np.abs(slope - gradient[:, axis])) < 1e-5  # but where a step leaves its cell
        assert (np.abs(slope - gradient[:, axis]) < 1e-4).mean() > 0.99


def test_what_is_surely_farther_than_its_limit_is_left_out_and_nothing_else() -> None:
    grid = field(Obstacle("ball", Sphere(0.1), Pose((0.5, 0.0, 0.0))))
    points = np.random.default_rng(2).uniform(-0.6, 0.6, (3000, 3)) + np.array([0.5, 0.0, 0.0])
    value, _ = grid.at(points)
    maybe = grid.may_be_within(points, np.full(len(points), 0.05))
    assert not (~maybe & (value < 0.05)).any()
    assert 0 < maybe.sum() < 0.2 * len(points)


def test_a_field_is_made_once_for_a_scene() -> None:
    one, other = (disc(1.0, 0.5) for _ in range(2))
    assert field_of(planar(one), 0.02) is field_of(planar(other), 0.02)
    assert field_of(planar(one), 0.02) is not field_of(planar(disc(1.0, 0.51)), 0.02)
    assert field_of(planar(), 0.02) is None


@pytest.mark.parametrize("after", [1, 12], ids=["the field is being made", "it is being followed"])
def test_making_a_field_and_following_it_are_held_to_the_limits_of_the_call(
    after: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    checker = planar(disc(1.4, 0.6, 0.1 + after * 1e-3))  # one of which there is no field yet
    problem, looks = CurveProblem(checker, CurveObjective(50, 100.0, 0.02), ROUTE), iter(range(1, 1000))

    def poll() -> None:
        if next(looks) == after:
            raise Cancelled("by the caller")

    monkeypatch.setattr(checker.ledger, "poll", poll)
    with pytest.raises(Cancelled, match="by the caller"):
        Chomp().minimise(problem, evenly(ROUTE, 10), (1, 1))
    assert Chomp().minimise(problem, evenly(ROUTE, 10), (1, 1)).iterations > 10


def test_a_field_that_fills_the_memory_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="voxel"):
        field(Obstacle("hall", Box((9.0, 9.0, 9.0))), voxel=0.002)


@pytest.mark.parametrize("robot", ["wxai", "panda_mbm"])
def test_balls_hold_the_moving_pieces(robot: str) -> None:
    checker = CollisionChecker(load_robot(robot), load_scene("bin"))
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


def test_the_slope_of_the_covariant_descent_is_that_of_its_merit() -> None:
    checker = CollisionChecker(load_robot("wxai"), load_scene("post"))
    home = checker.robot.home
    goal = home + np.array([1.5, 0.2, 0.1, 0.0, 0.3, 0.1])
    problem = CurveProblem(checker, CurveObjective(20, 10.0, 0.05), np.array([home - [0.7, 0, 0, 0, 0, 0], goal]))
    corners = evenly(problem.route, 6)
    descent = _Descent(problem, corners, (1, 1), field_of(checker, 0.02))
    descent.begin(1000.0)
    slope = descent._slope(problem.samples(corners))
    push = descent._lacking(problem.samples(corners), corners)
    assert len(push.row) > 10
    for k, joint in ((1, 0), (2, 1), (3, 2), (4, 3)):
        sides = []
        for by in (1e-6, -1e-6):
            moved = corners.copy()
            moved[k, joint] += by
            # the widths of blends as they were: the slope leaves them alone
            sides.append(descent._worth(problem.samples(corners), moved))
        assert slope[k - 1, joint] == pytest.approx((sides[0] - sides[1]) / 2e-6, rel=2e-3, abs=1e-4)


# settings


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"waypoints": 3}, "waypoints"),
        ({"waypoints": 50.0}, "waypoints"),
        ({"waypoints": True}, "waypoints"),
        ({"smoothness": -1.0}, "smoothness"),
        ({"smoothness": math.nan}, "smoothness"),
        ({"clearance": 2.0}, "clearance"),
        ({"clearance": "2 cm"}, "clearance"),
        ({"corners": 0}, "corners"),
        ({"corners": 60}, "waypoints"),
        ({"starts": 0}, "starts"),
        ({"method": "trajopt"}, "method"),
        ({"method": TrajOpt}, "method"),
    ],
)
def test_settings_that_make_no_sense_are_refused_by_name(given: dict[str, Any], named: str) -> None:
    with pytest.raises(InvalidRequest, match=f"^{named}: "):
        Optimise(**given)


@pytest.mark.parametrize("given", [{"iterations": 0}, {"iterations": 1.5}])
@pytest.mark.parametrize("method", [TrajOpt, Chomp])
def test_settings_of_methods_are_refused_by_name(method: Any, given: dict[str, Any]) -> None:
    with pytest.raises(InvalidRequest, match=r"^iterations: "):
        method(**given)


def test_a_voxel_is_a_length() -> None:
    with pytest.raises(InvalidRequest, match=r"^voxel: "):
        Chomp(voxel=20.0)


def test_what_is_no_route_is_refused() -> None:
    route: Any
    held: Any
    for route, held, named in [
        ([START], (1, 1), "route"),
        ([START, START], (1, 1), "route"),
        ([START, [0.0, math.inf]], (1, 1), "route"),
        ([START, [0.0, 0.0, 0.0]], (1, 1), "route"),
        ([START, GOAL], (5, 5), "held"),
        ([START, GOAL], (0, 1), "held"),
        ([START, GOAL], (1,), "held"),
        ([START, GOAL], (1.5, 1), "held"),
        ([START, GOAL], None, "held"),
    ]:
        with pytest.raises(InvalidRequest, match=f"^{named}"):
            Optimise().improved(route, planar(), held=held)


def test_nothing_is_remembered_from_one_optimisation_to_the_next() -> None:
    checker = planar(disc(1.4, 0.6))
    route = ROUTE
    first, _, again = (Optimise(smoothness=w).improved(route, checker) for w in (100.0, 5.0, 100.0))
    assert hashlib.sha256(first.corners.tobytes()).digest() == hashlib.sha256(again.corners.tobytes()).digest()
    assert (first.iterations, first.gradients) == (again.iterations, again.gradients)

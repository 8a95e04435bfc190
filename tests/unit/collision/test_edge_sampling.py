"""How edges are sampled: how many samples, where, in which order, and which of them are judged."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import strategies as st

from planner_service.collision import CheckCounts, CollisionChecker, JointStep, Known, MotionStep
from planner_service.collision.edge_sampling import (
    EdgeStep,
    FinestStep,
    bisection_order,
    coarse_samples,
    coarse_segments_of,
    interior,
)
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Attached, Obstacle, Scene
from tests.support.optional import present

PLANAR = load_robot("planar2")
WXAI = load_robot("wxai")
OPEN = Scene()
angles = st.floats(-3.1, 3.1, allow_subnormal=False)
joints = st.lists(angles, min_size=6, max_size=6)


def planar(scene: Scene = OPEN, step: EdgeStep | None = None) -> CollisionChecker:
    return CollisionChecker(PLANAR, scene, edge_step=step)


def pin_at(*fractions: float) -> Scene:
    """Thin pins that the forearm meets only when the shoulder stands at these angles and the elbow is straight."""
    pins = tuple(
        Obstacle(f"pin_{k}", Cylinder(0.005, 0.2), Pose((1.4 * math.cos(f), 1.4 * math.sin(f), 0.0)))
        for k, f in enumerate(fractions)
    )
    return Scene(pins)


def spent(checker: CollisionChecker, q1: Any, q2: Any, known: Known = Known.NEITHER) -> tuple[bool, int]:
    """Verdict and states of one edge."""
    before = checker.counts
    verdict = checker.edge_is_free(q1, q2, known=known)
    found = checker.counts - before
    assert (found.edges, found.distances) == (1, 0)
    return verdict, found.states


SIXTEEN = JointStep(1.0 / 16.0)
"""Splits the edge of 1 rad from (0, 0) to (1, 0) into sixteenths, judged 8 4 12 2 6 10 14 1 3 5 ..."""


def test_half_a_radian_at_two_hundredths_has_25_segments() -> None:
    """The lesson says 26 more checks: 25 segments have 26 samples with both ends, of which 25 are new."""
    assert JointStep(0.02).segments([0.5, 0.0], [1.5, 0.5]) == 25
    checker = planar(step=JointStep(0.02))
    assert spent(checker, [0.0, 0.0], [0.5, 0.0]) == (True, 26)
    assert spent(checker, [0.0, 0.0], [0.5, 0.0], Known.START) == (True, 25)
    assert spent(checker, [0.0, 0.0], [0.5, 0.0], Known.END) == (True, 25)
    assert spent(checker, [0.0, 0.0], [0.5, 0.0], Known.BOTH) == (True, 24)


def test_rounding_never_makes_26_segments_of_half_a_radian() -> None:
    rng = np.random.default_rng(1)
    step, naive = JointStep(0.02), 0
    for _ in range(4000):
        q1, way = rng.uniform(-1.0, 1.0, 6), rng.normal(size=6)
        q2 = q1 + way * (0.5 / math.sqrt(float((way * way).sum())))
        assert step.segments((q2 - q1).tolist(), [1.0] * 6) == 25
        naive += math.ceil(math.dist(q1, q2) / 0.02) != 25
    assert naive > 100  # without the slack it would


def test_a_joint_step_counts_in_the_l2_norm() -> None:
    for length, parts in [(0.0, 1), (1e-12, 1), (0.02, 1), (0.0201, 2), (0.04, 2), (1.0, 50), (1.001, 51)]:
        assert JointStep(0.02).segments([0.6 * length, -0.8 * length], [9.0, 9.0]) == parts


def test_a_motion_step_counts_reach_times_angle() -> None:
    assert MotionStep(0.01).segments([0.1, -0.2], [1.5, 0.5]) == 25
    assert MotionStep(0.01).segments([0.1, -0.2001], [1.5, 0.5]) == 26
    assert MotionStep(0.02).segments([0.0, 0.0], [1.5, 0.5]) == 1
    checker = planar()
    assert checker.edge_step == MotionStep(0.010)
    assert checker.segments([0.0, 0.0], [0.1, -0.2]) == 26  # 1.5001 m and 0.5001 m: the links are 10 mm thick


def points_of(shape: Shape) -> FloatArray:
    """Points of a shape that reach farthest: corners of a box, points of a rim, of a sphere or of a cap."""
    turn = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(16)], axis=-1)
    if isinstance(shape, Box):
        corners = [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
        return np.asarray(np.array(corners) * np.array(shape.half))
    if isinstance(shape, Sphere):
        return np.asarray(shape.radius * np.concatenate([ring, ring[:, [2, 0, 1]], ring[:, [1, 2, 0]]]))
    assert isinstance(shape, (Cylinder, Capsule))
    end = np.array([0.0, 0.0, shape.length / 2])
    cap = np.array([0.0, 0.0, shape.radius if isinstance(shape, Capsule) else 0.0])
    return np.concatenate([shape.radius * ring + end, shape.radius * ring - end, [end + cap], [-end - cap]])


def positions(robot: Robot, q: FloatArray, held: tuple[Attached, ...]) -> FloatArray:
    """Where many points of the robot's shapes, and of those it holds, are at q, (points, 3)."""
    bodies = robot.body_poses(q)
    tool = Pose.from_matrix(robot.tool_placement)
    riding = [(s.body, s.shape, s.pose) for s in robot.shapes]
    riding += [(robot.tool_body, a.shape, tool @ a.pose) for a in held if isinstance(a.shape, Shape)]
    found = []
    for body, shape, pose in riding:
        R, t = np.array(bodies[body][:9]).reshape(3, 3), np.array(bodies[body][9:])
        found.append((points_of(shape) @ pose.rotation.T + pose.position) @ R.T + t)
    return np.concatenate(found)


@pytest.mark.slow
@pytest.mark.parametrize("distance", [0.010])
@pytest.mark.parametrize("held", [(), (Attached("rod", Capsule(0.01, 0.5), Pose((0.2, 0.1, 0.0))),)], ids=["", "rod"])
def test_no_point_moves_farther_between_samples_than_a_motion_step(distance: float, held: tuple[Attached, ...]) -> None:
    checker = CollisionChecker(WXAI, Scene((), held), edge_step=MotionStep(distance))
    rng = np.random.default_rng(2)
    farthest = 0.0
    for _ in range(6):
        q1, q2 = rng.uniform(WXAI.limits.lower, WXAI.limits.upper, (2, 6))
        q2 = q1 + (q2 - q1) * 0.2
        parts = checker.segments(q1, q2)
        inner = interior(q1.tolist(), q2.tolist(), parts)
        samples = sorted([q1, q2, *inner], key=lambda q: float(((q - q1) * (q2 - q1)).sum()))
        placed = [positions(WXAI, q, held) for q in samples]
        assert len(samples) == parts + 1
        moved = max(float(np.sqrt(((b - a) ** 2).sum(axis=-1)).max()) for a, b in pairwise(placed))
        assert moved <= distance
        farthest = max(farthest, moved)
    assert farthest > 0.2 * distance  # the bound holds for all postures, so it is not tight in any


def test_bisection_takes_halves_before_quarters_before_eighths() -> None:
    assert (bisection_order(8)[:, 0] * 8).tolist() == [4, 2, 6, 1, 3, 5, 7]
    assert (bisection_order(5)[:, 0] * 5).tolist() == [2, 1, 3, 4]
    assert (bisection_order(2)[:, 0] * 2).tolist() == [1]
    assert bisection_order(1).shape == (0, 1)


def test_bisection_visits_every_interior_sample_once() -> None:
    for parts in range(1, 300):
        assert sorted((bisection_order(parts)[:, 0] * parts).round().tolist()) == list(range(1, parts))


@pytest.mark.parametrize(("sixteenth", "place"), [(8, 1), (12, 3), (2, 4), (5, 10)])
def test_states_count_up_to_and_including_the_first_that_collides(sixteenth: int, place: int) -> None:
    checker = planar(pin_at(sixteenth / 16.0), SIXTEEN)
    assert spent(checker, [0.0, 0.0], [1.0, 0.0]) == (False, place + 2)
    assert spent(checker, [0.0, 0.0], [1.0, 0.0], Known.START) == (False, place + 1)
    assert spent(checker, [0.0, 0.0], [1.0, 0.0], Known.BOTH) == (False, place)


def test_ends_are_judged_before_the_interior_and_the_start_before_the_end() -> None:
    both = planar(pin_at(0.0, 0.5, 1.0), SIXTEEN)
    assert spent(both, [0.0, 0.0], [1.0, 0.0]) == (False, 1)
    assert spent(both, [0.0, 0.0], [1.0, 0.0], Known.START) == (False, 1)
    end = planar(pin_at(0.5, 1.0), SIXTEEN)
    assert spent(end, [0.0, 0.0], [1.0, 0.0]) == (False, 2)
    hit = present(end.edge_hit([0.0, 0.0], [1.0, 0.0]))
    assert hit.fraction == 1.0


def test_the_pieces_of_a_path_are_an_edge_each_and_inner_waypoints_are_judged_once() -> None:
    path = JointPath(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.5, 0.5]]))
    checker = planar(step=SIXTEEN)
    assert checker.path_is_free(path)
    assert checker.counts == CheckCounts(states=1 + 16 + 16 + 12, edges=3)
    for known, saved in ((Known.START, 1), (Known.END, 1), (Known.BOTH, 2)):
        checker = planar(step=SIXTEEN)
        assert checker.path_is_free(path, known=known)
        assert checker.counts == CheckCounts(states=45 - saved, edges=3)


def test_a_step_that_is_none_is_refused() -> None:
    kind: Any
    value: Any
    for kind in [MotionStep, JointStep]:
        for value in [0.0, -0.01, math.nan, math.inf, "wide", None, 10**400, True, "0.01"]:
            with pytest.raises(InvalidRequest, match="expected a positive number of"):
                kind(value)


def test_a_step_that_would_take_for_ever_is_refused() -> None:
    checker = planar(step=MotionStep(1e-9))
    with pytest.raises(InvalidRequest, match="at most 1000000 parts"):
        checker.edge_is_free([0.0, 0.0], [1.0, 0.0])


def test_an_edge_with_an_end_that_is_none_is_refused_and_not_counted() -> None:
    for q1, q2, told in [
        ([0.0, 4.0], [0.0, 0.0], "q1: got 4.0; expected elbow in"),
        ([0.0, 0.0], [math.nan, 0.0], "q2: got nan; expected shoulder in"),
        ([0.0, 0.0], [0.0], "q2: .*2 joint values"),
    ]:
        for known in [Known.NEITHER, Known.BOTH]:
            checker = planar()
            with pytest.raises(InvalidRequest, match=told):
                checker.edge_is_free(q1, q2, known=known)
            assert checker.counts == CheckCounts()


def test_long_edges_are_counted_alike_in_whatever_batches_they_are_judged() -> None:
    """About 200 samples, the pin on one after the other: the count is its place in bisection order."""
    order = (bisection_order(200)[:, 0] * 200).round().astype(int).tolist()
    for place in (1, 7, 8, 9, 63, 64, 65, 71, 72, 73, 136, 199):
        fraction = order[place - 1] / 200.0
        checker = planar(pin_at(fraction * 3.0), JointStep(0.015))
        verdict, states = spent(checker, [0.0, 0.0], [3.0, 0.0], Known.BOTH)
        judged = [order.index(k) + 1 for k in range(1, 200) if abs(k / 200.0 - fraction) * 3.0 * 1.4 < 0.0151]
        assert (verdict, states) == (False, min(judged))


def test_a_first_look_takes_whole_levels_of_the_bisection() -> None:
    assert [coarse_samples(n, 8) for n in (1, 8, 9, 16, 17, 32, 33, 100)] == [0, 0, 1, 1, 3, 3, 7, 15]
    assert [coarse_samples(n, 3) for n in (1, 3, 4, 6, 7, 12, 13, 100)] == [0, 0, 1, 1, 3, 3, 7, 63]
    assert [coarse_samples(n, 1) for n in (1, 2, 3, 5, 100)] == [0, 1, 2, 4, 99]


def test_a_first_look_is_closer_the_coarser_the_step() -> None:
    assert [coarse_segments_of(JointStep(angle)) for angle in (0.01, 0.02, 0.05, 0.1, 0.2)] == [8, 8, 3, 1, 1]
    assert [coarse_segments_of(MotionStep(metres)) for metres in (0.001, 0.010, 0.020, 0.05, 0.2)] == [8, 8, 4, 1, 1]
    assert coarse_segments_of(FinestStep((JointStep(0.05), MotionStep(0.010)))) == 8
    assert coarse_segments_of(Mock()) == 8


def test_a_first_look_overlooks_what_the_rest_finds_at_the_same_place() -> None:
    whole, parts = (planar(pin_at(3 / 16), SIXTEEN) for _ in range(2))
    hit = whole.edge_hit([1.0, 0.0], [0.0, 0.0])
    assert parts.edge_is_free_coarse([1.0, 0.0], [0.0, 0.0])
    assert parts.finish_edge([1.0, 0.0], [0.0, 0.0]) == hit
    assert hit is not None
    assert parts.counts == whole.counts

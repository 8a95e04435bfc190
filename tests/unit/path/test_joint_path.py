"""Polylines through joint space, and trajectories that never leave them."""

from __future__ import annotations

import itertools
import math
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath, polyline_length
from planner_service.path.trajectory import Trajectory
from planner_service.robot.model import JointLimits
from planner_service.timing.laws import ToppRa, Trapezoidal
from tests.reference import joint_path as reference

ELBOW = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 10.0]])
joint_values = st.floats(-3.2, 3.2, allow_subnormal=False)
polylines = st.integers(1, 6).flatmap(
    lambda n: st.lists(st.lists(joint_values, min_size=n, max_size=n), min_size=1, max_size=12)
)


def straight(length: float = 1.0) -> JointPath:
    return JointPath(np.array([[0.0], [length]]))


def triangle(path: JointPath) -> Trajectory:
    """Two seconds along a path of length 1: half of it speeding up at 1, half slowing down."""
    return Trajectory(path, np.array([1.0, 1.0]), np.array([[0.0, 0.0, 0.5, 0.0], [0.5, 1.0, -0.5, 0.0]]))


def test_waypoints_are_a_read_only_copy() -> None:
    points = ELBOW.copy()
    path = JointPath(points)
    points[0, 0] = 9.0
    assert path.waypoints[0, 0] == 0.0
    assert not path.waypoints.flags.writeable


def test_the_tangent_at_a_corner_is_that_of_the_piece_after_it() -> None:
    path = JointPath(ELBOW)
    assert path([0.0, 4.9, 5.0, 11.0], 1).tolist() == [[0.6, 0.8], [0.6, 0.8], [0.0, 1.0], [0.0, 1.0]]


def test_an_overshoot_of_rounding_size_is_the_end() -> None:
    path = JointPath(ELBOW)
    assert path(11.0 + 1e-10).tolist() == [3.0, 10.0]
    assert path(-1e-10).tolist() == [0.0, 0.0]
    assert path(-1e-10, 1).tolist() == [0.6, 0.8]


def test_wrong_waypoints_are_refused() -> None:
    waypoints: Any
    for waypoints in [
        [],
        [[]],
        [1.0, 2.0],
        3.0,
        [[[0.0]]],
        [[0.0, 1.0], [2.0]],
        "abc",
        None,
        [[0.0], [math.nan]],
        [[math.inf]],
    ]:
        with pytest.raises(InvalidRequest, match="waypoints"):
            JointPath(waypoints)


def test_a_path_may_be_a_single_point() -> None:
    path = JointPath(np.array([[0.3, -0.2], [0.3, -0.2]]))
    assert path.length == 0.0
    assert path.corners == ()
    assert path(0.0).tolist() == [0.3, -0.2]
    assert path([0.0, 0.0]).shape == (2, 2)
    assert path(0.0, 1).tolist() == [0.0, 0.0]
    assert path.reversed().waypoints.tolist() == [[0.3, -0.2]]


def test_corners_are_where_the_direction_changes() -> None:
    path = JointPath(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [2.0, 0.5]]))
    assert path.corners == (2, 3)


def blended(rng: np.random.Generator, share: float = 0.4) -> JointPath:
    points = rng.uniform(-2, 2, (5, 3))
    points[:, 0] = np.cumsum(rng.uniform(0.5, 1.0, 5))  # no corner turns back
    path = JointPath(points)
    lengths = np.diff(path.knots)
    widths = share * np.minimum(lengths[1:], lengths[:-1])
    return path.with_blends([0.0, *widths, 0.0])


def test_blends_keep_the_ends_the_length_and_the_straight_rest_of_a_polyline() -> None:
    path = blended(np.random.default_rng(2))
    sharp = path.with_blends(None)
    assert path.corners == ()
    assert sharp.corners == (1, 2, 3)
    assert path.length == sharp.length
    assert path.blended.tolist() == [False, True, False, True, False, True, False]
    ends = path.breaks.tolist()
    straight = np.concatenate([np.linspace(ends[k], ends[k + 1], 9) for k in (0, 2, 4, 6)])
    np.testing.assert_allclose(path(straight), sharp(straight), rtol=0, atol=1e-15)
    assert np.array_equal(path([0.0, path.length]), sharp.waypoints[[0, -1]])


def test_blends_are_continuous_up_to_the_second_derivative() -> None:
    path = blended(np.random.default_rng(3))
    inner = path.breaks[1:-1]
    pieces = path.pieces_at(inner)
    for order in (0, 1, 2):
        before = path.on_pieces(pieces - 1, inner, order)
        np.testing.assert_allclose(path.on_pieces(pieces, inner, order), before, rtol=0, atol=1e-12)


def test_each_derivative_of_a_blend_is_the_slope_of_the_one_before() -> None:
    for order in [1, 2, 3]:
        path = blended(np.random.default_rng(4))
        s = np.linspace(path.breaks[1] + 1e-3, path.breaks[2] - 1e-3, 50)
        h = 1e-5
        slope = (path(s + h, order - 1) - path(s - h, order - 1)) / (2 * h)
        np.testing.assert_allclose(path(s, order), slope, rtol=0, atol=1e-4)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 0.5))
def test_a_blend_stays_in_the_triangle_of_its_corner_and_is_no_longer(seed: int, share: float) -> None:
    path = blended(np.random.default_rng(seed), share)
    for k in (1, 2, 3):
        d, corner = path.blends[k], path.waypoints[k]
        s = np.linspace(path.knots[k] - d, path.knots[k] + d, 60)
        u, v = path(s[0] - 1e-9, 1), path(s[-1] + 1e-9, 1)
        back, on = np.linalg.lstsq(np.stack([-u, v], axis=1), (path(s) - corner).T, rcond=None)[0]
        assert back.min() > -1e-6 * d
        assert on.min() > -1e-6 * d
        assert (back + on).max() < d * (1 + 1e-6)
        assert np.linalg.norm(path(s, 1), axis=1).max() <= 1 + 1e-12


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 0.5))
def test_travel_is_what_each_joint_has_moved(seed: int, share: float) -> None:
    path = blended(np.random.default_rng(seed), share)
    s = np.concatenate([np.linspace(a, b, 500) for a, b in itertools.pairwise(path.breaks.tolist())])
    moved = np.concatenate([np.zeros((1, 3)), np.cumsum(np.abs(np.diff(path(s), axis=0)), axis=0)])
    travel = path.travel(s)
    assert np.all(np.diff(travel, axis=0) >= -1e-15)
    np.testing.assert_allclose(travel, moved, rtol=0, atol=2e-5)  # a joint may turn between two samples
    assert np.all(travel >= moved - 1e-12)
    assert np.all(path.walked(s) >= travel - 1e-12)
    assert path.with_blends(None).walked(s) == pytest.approx(path.with_blends(None).travel(s), abs=1e-12)


def test_a_blend_that_reaches_the_end_ends_there_bit_for_bit() -> None:
    points = np.random.default_rng(5).uniform(-2, 2, (3, 4))
    lengths = np.diff(JointPath(points).knots)
    path = JointPath(points, np.array([0.0, min(lengths), 0.0]))
    assert np.array_equal(path(path.length), points[-1])
    assert np.array_equal(path(0.0), points[0])


def test_a_blend_where_there_is_no_corner_is_none() -> None:
    path = JointPath(np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]), np.array([0.0, 0.2, 0.0]))
    assert path.blends.tolist() == [0.0, 0.0, 0.0]
    assert not path.blended.any()


def test_impossible_blends_are_refused() -> None:
    blends: Any
    for blends, message in [
        ([0.0, 0.1], "3 finite numbers"),
        ([0.1, 0.1, 0.0], "first and the last"),
        ([0.0, 0.1, 0.1], "first and the last"),
        ([0.0, -0.1, 0.0], "0 or at least"),
        ([0.0, 1e-12, 0.0], "0 or at least"),
        ([0.0, math.nan, 0.0], "finite"),
        ([0.0, 5.5, 0.0], "no more together than the piece"),
        ("wide", "finite numbers"),
    ]:
        with pytest.raises(InvalidRequest, match=message):
            JointPath(ELBOW, blends)


@pytest.mark.parametrize("aside", [0.0, 0.05])
def test_a_corner_that_turns_back_cannot_be_blended(aside: float) -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, aside]])
    with pytest.raises(InvalidRequest, match=r"blends\[1\]: .*turns back"):
        JointPath(points, np.array([0.0, 0.1, 0.0]))


def test_a_blended_path_reversed_is_the_same_curve() -> None:
    path = blended(np.random.default_rng(6))
    s = np.linspace(0.0, path.length, 101)
    np.testing.assert_allclose(path.reversed()(path.length - s), path(s), rtol=0, atol=1e-12)


def test_paths_that_do_not_meet_are_not_joined() -> None:
    a, b = JointPath(ELBOW[:2]), JointPath(ELBOW[:2])
    with pytest.raises(InvalidRequest, match=r"expected a path from \[3.0, 4.0\]"):
        a + b


@pytest.mark.slow
@settings(deadline=None, max_examples=60, derandomize=True)
@given(polylines, st.floats(0.0, 1.0))
def test_every_configuration_lies_between_the_waypoints_around_it(points: list[list[float]], share: float) -> None:
    path = JointPath(np.array(points))
    s = share * path.length
    q = path(s)
    k = min(int(np.searchsorted(path.knots, s, side="right")), len(path.waypoints) - 1)
    around = path.waypoints[max(k - 1, 0) : k + 1]
    assert np.all(around.min(axis=0) <= q)
    assert np.all(q <= around.max(axis=0))


# -- trajectories


def test_a_trajectory_moves_along_its_path() -> None:
    path = JointPath(np.array([[0.0, 0.0], [0.6, 0.8]]))
    trajectory = triangle(path)
    assert trajectory.duration == 2.0
    assert trajectory.path is path
    assert np.allclose(trajectory([0.0, 1.0, 2.0]), [[0.0, 0.0], [0.3, 0.4], [0.6, 0.8]], rtol=0, atol=1e-15)
    assert np.allclose(trajectory(1.0, 1), [0.6, 0.8], rtol=0, atol=1e-15)
    assert np.allclose(trajectory([0.5, 1.5], 2), [[0.6, 0.8], [-0.6, -0.8]], rtol=0, atol=1e-15)
    assert not np.any(trajectory(0.5, 3))


def test_a_trajectory_is_exactly_at_rest_at_its_end() -> None:
    trajectory = triangle(JointPath(np.array([[0.1, 0.0], [0.7, 0.8]])))
    assert trajectory(trajectory.duration).tolist() == [0.7, 0.8]
    assert trajectory(trajectory.duration, 1).tolist() == [0.0, 0.0]
    assert trajectory(0.0).tolist() == [0.1, 0.0]
    assert trajectory(0.0, 1).tolist() == [0.0, 0.0]


def test_time_outside_the_trajectory_is_refused() -> None:
    for t in [-0.1, 2.1, math.nan]:
        trajectory = triangle(straight())
        with pytest.raises(InvalidRequest, match=r"t: got .*; expected numbers in \[0, 2\]"):
            trajectory(t)


def test_an_impossible_sampling_step_is_refused() -> None:
    dt: Any
    for dt in [0.0, -1.0, math.nan, math.inf, 1e-9, "x", 10**400, True, None]:
        trajectory = triangle(straight())
        with pytest.raises(InvalidRequest, match="dt: got"):
            trajectory.sample(dt)


def test_dilation_slows_the_same_motion_down() -> None:
    trajectory = triangle(straight())
    slow = trajectory.dilated(2.0)
    t = np.linspace(0.0, 2.0, 9)
    assert slow.duration == 4.0
    assert slow.dilation == 2.0
    assert np.array_equal(slow(2 * t), trajectory(t))
    assert np.array_equal(slow(2 * t, 1), trajectory(t, 1) / 2)
    assert np.array_equal(slow(2 * t, 2), trajectory(t, 2) / 4)


def test_a_law_that_is_no_motion_from_rest_to_rest_is_refused() -> None:
    for durations, coefficients, message in [
        ([1.0], [[0.0, 0.0, 0.5]], "shape"),
        ([1.0, math.nan], [[0, 0, 0.5, 0], [0.5, 1, -0.5, 0]], "finite"),
        ([1.0, -1.0], [[0, 0, 0.5, 0], [0.5, 1, -0.5, 0]], "positive"),
        ([1.0, 0.5], [[0, 0, 0.5, 0], [0.5, 1, -0.5, 0]], "without a jump"),
        ([1.0, 1.0], [[0, 0, 0.5, 0], [0.4, 1, -0.5, 0]], "without a jump"),
        ([1.0], [[0, 1.0, 0, 0]], "0 at both ends"),
        ([1.0], [[0, 0.0, 1.0, 0]], "0 at both ends"),
        ([3.0], [[0, -2.0, 0, 7.0 / 27]], "turns back"),
        ([], [], "pieces for a path with a length"),
    ]:
        path, c = straight(), np.array(coefficients).reshape(len(durations), -1) if durations else np.zeros((0, 4))
        with pytest.raises(InvalidRequest, match=message):
            Trajectory(path, np.array(durations), c)


def test_a_corner_passed_at_speed_is_refused() -> None:
    bent = JointPath(np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.5]]))
    with pytest.raises(InvalidRequest, match=r"a stop at the path's corner at s = 0\.5"):
        triangle(bent)


def test_an_order_that_is_no_whole_number_is_refused() -> None:
    order: Any
    for order in [True, 1.0, "1", None, 10**400, [1]]:
        path = straight()
        with pytest.raises(InvalidRequest, match="order: got"):
            path(0.5, order)


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_dilations_that_add_up_to_the_absurd_are_refused(factor: float) -> None:
    def often(trajectory: Trajectory) -> None:
        for _ in range(45):
            trajectory = trajectory.dilated(factor)

    trajectory = triangle(straight())
    with pytest.raises(InvalidRequest, match="got"):
        often(trajectory)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=300, deadline=None)
def test_a_path_is_laid_out_with_the_bits_of_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = _awkward_points(rng)
    laid = reference.layout(points)
    path = JointPath(points)
    for ours, theirs in zip((path.waypoints, path.knots, path.tangents), laid[:3], strict=True):
        np.testing.assert_array_equal(ours, theirs, strict=True)
    assert path.turns == laid[3]
    assert polyline_length(points) == reference.polyline_length(points)
    for k in range(1, len(path.waypoints) - 1):
        assert path.turns_back(k) == reference.turns_back(laid[2], k)
    room = np.minimum(np.diff(path.knots, append=9.0), np.diff(path.knots, prepend=-9.0))
    widths = np.where(rng.random(len(room)) < 0.3, 0.0, np.maximum(rng.choice([0.3, 0.499, 0.55]) * room, 1e-9))
    widths[[0, -1]] = 0.0
    try:
        allowed = reference.allowed_blends(laid, widths.tolist())
    except ValueError as refused:
        with pytest.raises(InvalidRequest, match=re.escape(str(refused))):
            path.with_blends(widths)
        return
    blended = path.with_blends(widths)
    starts, lines, rows = (
        zip(*reference.pieces(laid[1].tolist(), allowed), strict=True) if len(laid[1]) > 1 else ((),) * 3
    )
    np.testing.assert_array_equal(blended.blends, allowed)
    np.testing.assert_array_equal(blended.breaks, [*starts, laid[1][-1]])
    np.testing.assert_array_equal(blended.tables[4], lines)
    np.testing.assert_array_equal(blended.tables[5], rows)
    on = np.flatnonzero(np.array(allowed) > 0.0)
    columns = [laid[1][on, None], np.array(allowed)[on, None], laid[0][on], laid[2][on - 1], laid[2][on]]
    np.testing.assert_array_equal(blended.tables[6], np.concatenate(columns, axis=1))


def _awkward_points(rng: np.random.Generator) -> FloatArray:
    """Waypoints of which some coincide, lie on lines, turn back, or are very close; or a bend of many short pieces."""
    n, count = int(rng.integers(1, 8)), int(rng.integers(1, 12))
    if n > 1 and rng.random() < 0.25:
        size, bend = 10.0 ** rng.uniform(-10.0, -7.0), rng.uniform(0.0, 1e-5)
        steps = np.stack([np.cos(bend * np.arange(60)), np.sin(bend * np.arange(60)), *np.zeros((n - 2, 60))], axis=1)
        return np.asarray(rng.uniform(-3.0, 3.0, n) + np.cumsum(steps * size * rng.uniform(0.1, 1.0, (60, 1)), axis=0))
    points = [rng.uniform(-3.0, 3.0, n)]
    for _ in range(count - 1):
        step = rng.normal(size=n) * 10.0 ** rng.uniform(-13.0, 0.5)
        kind = rng.integers(6)
        if kind == 0:
            step = np.zeros(n)
        elif kind == 1 and len(points) > 1:
            step = (points[-1] - points[-2]) * rng.choice([-1.0, 1.0, 1e-6])
        elif kind == 2:
            step = rng.normal(size=n)
        points.append(points[-1] + step)
    return np.array(points)


@given(polylines, st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8), st.sampled_from([0.0, 0.1, 0.49, 0.5, 1.0]))
@settings(deadline=None)
def test_a_path_is_the_same_curve_in_both_languages_and_exact_at_its_ends(
    points: list[list[float]], shares: list[float], blend: float
) -> None:
    path = JointPath(np.array(points))
    if not path.length > 0.0:
        return
    lengths = np.diff(path.knots)
    widths = np.zeros(len(path.waypoints))
    for k in range(1, len(widths) - 1):
        width = blend * min(lengths[k - 1], lengths[k])
        if width > 1e-6 and not path.turns_back(k) and (blend <= 0.5 or len(widths) == 3):
            widths[k] = width
    path = path.with_blends(widths)
    s = np.unique([*(np.array(shares) * path.length), *path.breaks])
    for order in (0, 1):
        expected = path.on_pieces(path.pieces_at(s), s, order)
        assert np.array_equal(path(s[1:-1], order), expected[1:-1])
        assert np.array_equal(path(s, order)[[0, -1]], expected[[0, -1]]) or order == 0
    assert path([0.0, path.length]).tolist() == path.waypoints[[0, -1]].tolist()


def test_a_path_with_stops_is_the_same_curve_whose_law_stops_there() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    path = JointPath(points, np.array([0.0, 0.2, 0.0]))
    stopping = path.with_stops([1.6, 0.3])
    one = np.ones(2)
    limits = JointLimits(-9.0 * one, 9.0 * one, one, one, 9.0 * one)
    s = np.linspace(0.0, path.length, 200)
    assert stopping(s) == pytest.approx(path(s), abs=1e-12)
    assert stopping.knots[list(stopping.corners)].tolist() == pytest.approx([0.3, 1.6])
    for law in (ToppRa(), Trapezoidal()):
        timed = law.time_path(stopping, limits)
        stopped = timed.coefficients[timed.coefficients[:, 1] == 0.0, 0]
        assert stopped.tolist() == pytest.approx([0.0, 0.3, 1.6], abs=1e-9)
        assert timed.duration > law.time_path(path, limits).duration


@pytest.mark.parametrize("places", [[0.9], [-0.1], [2.0], [0.0], [2.5], [0.3, 0.3], [math.nan], "a", [[None]]])
def test_a_stop_on_a_blend_or_off_the_path_is_refused(places: object) -> None:
    path = JointPath(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([0.0, 0.2, 0.0]))
    with pytest.raises(InvalidRequest, match="places"):
        path.with_stops(places)  # type: ignore[arg-type]


def test_a_point_has_no_place_for_a_stop() -> None:
    with pytest.raises(InvalidRequest, match="places"):
        JointPath(np.zeros((1, 2))).with_stops([0.0])

"""Laws of poses and convex shapes, and the mistakes they refuse."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.geometry.arrays import FloatArray, cosines_and_sines, read_only, rpy_matrix
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.geometry.validation import number, numbers

laws = settings(max_examples=40, deadline=None, derandomize=True)

ROUNDING = 1e-12
"""Metres; lengths here are below 2 m, so this is thousands of rounding errors and far below a micrometre."""

lengths = st.floats(1e-3, 2.0)
coordinates = st.floats(-2.0, 2.0)
seeds = st.integers(0, 2**32 - 1)

shapes: st.SearchStrategy[Shape] = st.one_of(
    st.builds(lambda x, y, z: Box((x, y, z)), lengths, lengths, lengths),
    st.builds(Sphere, lengths),
    st.builds(Cylinder, lengths, lengths),
    st.builds(Capsule, lengths, lengths),
)


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    rng = np.random.default_rng(draw(seeds))
    w, x, y, z = rng.normal(size=4).tolist()
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return Pose((draw(coordinates), draw(coordinates), draw(coordinates)), (w / norm, x / norm, y / norm, z / norm))


def directions(seed: int, count: int = 50) -> FloatArray:
    d = np.random.default_rng(seed).normal(size=(count, 3))
    d[:6] = np.vstack([np.eye(3), -np.eye(3)])  # along the axes, where the farthest point is not unique
    return d


def points_inside(shape: Shape, seed: int, count: int = 200) -> FloatArray:
    """Points of the solid, its far corners among them, found without asking the shape where it ends."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1.0, 1.0, size=(count, 3))
    u[: count // 2] = np.sign(u[: count // 2])
    if isinstance(shape, Box):
        return np.asarray(u * np.array(shape.size) / 2)
    ball = rng.normal(size=(count, 3))
    ball /= np.sqrt((ball * ball).sum(axis=1, keepdims=True))
    if isinstance(shape, Sphere):
        return ball * shape.radius
    if isinstance(shape, Capsule):
        return ball * shape.radius + np.outer(u[:, 2] * shape.length / 2, [0.0, 0.0, 1.0])
    assert isinstance(shape, Cylinder)
    angle = rng.uniform(0.0, 2 * math.pi, size=count)
    return np.column_stack([shape.radius * np.cos(angle), shape.radius * np.sin(angle), u[:, 2] * shape.length / 2])


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray((a * b).sum(axis=-1))


@laws
@given(shapes, seeds)
def test_no_point_of_a_shape_is_farther_along_a_direction_than_its_support(shape: Shape, seed: int) -> None:
    d = directions(seed)
    inside = points_inside(shape, seed)
    farthest = dot(inside[:, None, :], d[None, :, :]).max(axis=0)
    assert np.all(dot(shape.support(d), d) >= farthest - 10 * ROUNDING)


@laws
@given(shapes, seeds)
def test_the_support_is_a_point_of_the_shape(shape: Shape, seed: int) -> None:
    assert shape.distance(shape.support(directions(seed))).max() <= ROUNDING


@laws
@given(shapes, seeds, st.sampled_from([5e-324, 1e-200, 1e-9, 1e9, 1e200, 1e307]))
def test_the_support_does_not_depend_on_the_length_of_the_direction(shape: Shape, seed: int, scale: float) -> None:
    # powers of two of the axes and signs, so that scaling by 5e-324 loses nothing
    d = np.sign(directions(seed))
    np.testing.assert_allclose(shape.support(d * scale), shape.support(d), rtol=0, atol=ROUNDING)


@laws
@given(shapes, seeds)
def test_points_of_a_shape_have_distance_zero(shape: Shape, seed: int) -> None:
    assert shape.distance(points_inside(shape, seed)).max() <= ROUNDING


@laws
@given(shapes, seeds)
def test_distance_is_the_greatest_separation_over_all_directions(shape: Shape, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-4.0, 4.0, size=(20, 3))
    d = directions(seed, 400)
    d /= np.sqrt(dot(d, d))[:, None]
    distance = shape.distance(points)
    separation = dot(points[:, None, :] - shape.support(d)[None, :, :], d[None, :, :]).max(axis=1)
    assert np.all(separation <= distance + ROUNDING)  # weak duality: no direction separates more
    step = 1e-6
    slope = np.stack([(shape.distance(points + step * e) - distance) / step for e in np.eye(3)], axis=-1)
    far = distance > 0.01  # the gradient there is the direction that attains it
    along = dot(points - shape.support(slope), slope)[far]
    np.testing.assert_allclose(along, distance[far], rtol=0, atol=1e-3)  # one-sided differences of 1e-6 m


@laws
@given(shapes, seeds, st.floats(0.0, 0.5))
def test_a_grown_shape_holds_everything_within_the_margin(shape: Shape, seed: int, margin: float) -> None:
    away = directions(seed, 200)
    near = points_inside(shape, seed) + margin * away / np.sqrt(dot(away, away))[:, None]
    assert shape.grown(margin).distance(near).max() <= ROUNDING


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(0.0), "radius: got 0.0; expected a positive length"),
        (lambda: Sphere(math.nan), "radius: got nan"),
        (lambda: Sphere("0.1"), "radius: got '0.1'; expected a positive length"),  # type: ignore[arg-type]
        (lambda: Box((0.1, -0.2, 0.3)), r"size\[1\]: got -0.2"),
    ],
)
def test_sizes_that_make_no_shape_are_refused(make: Any, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Pose((0.0, 0.0, math.nan)), "position: .*3 finite numbers"),
        (lambda: Pose(quaternion=(1.0, 1.0, 0.0, 0.0)), "its norm is 1.41421"),
        (lambda: Pose.from_matrix(np.eye(3)), "finite 4 x 4 matrix"),
        (lambda: Pose.from_matrix(np.diag([1.0, 1.0, -1.0, 1.0])), "orthonormal"),
        (lambda: Pose.from_matrix(np.diag([1.0, 1.0, 1.0, 2.0])), "last row 0 0 0 1"),
    ],
)
def test_numbers_that_make_no_pose_are_refused(make: Any, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        make()


@laws
@given(poses())
def test_a_pose_survives_its_matrix(pose: Pose) -> None:
    back = Pose.from_matrix(pose.matrix)
    assert back.position == pose.position
    sign = -1.0 if pose.quaternion[0] < 0 else 1.0
    assert back.quaternion == pytest.approx(tuple(sign * v for v in pose.quaternion), abs=1e-14)


@pytest.mark.parametrize(
    "rpy", [(math.pi, 0.0, 0.0), (0.0, math.pi, 0.0), (0.0, 0.0, math.pi), (0.0, math.pi / 2, 1.0)]
)
def test_half_turns_survive_their_matrix(rpy: tuple[float, float, float]) -> None:
    # w is 0 in the first three: the branches of the conversion that small angles never reach
    np.testing.assert_allclose(Pose.from_rpy((0, 0, 0), rpy).rotation, rpy_matrix(*rpy), rtol=0, atol=1e-15)


@laws
@given(poses(), poses())
def test_poses_compose_as_their_matrices_do(first: Pose, second: Pose) -> None:
    np.testing.assert_allclose((first @ second).matrix, first.matrix @ second.matrix, rtol=0, atol=1e-14)


@laws
@given(poses())
def test_a_pose_times_its_inverse_is_no_motion(pose: Pose) -> None:
    np.testing.assert_allclose((pose @ pose.inverse()).matrix, np.eye(4), rtol=0, atol=1e-14)
    np.testing.assert_allclose((pose.inverse() @ pose).matrix, np.eye(4), rtol=0, atol=1e-14)


def test_angles_are_those_of_urdf() -> None:
    # a quarter turn about z after one about x: x goes to y, y goes to z, z goes to x
    expected = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    np.testing.assert_allclose(rpy_matrix(math.pi / 2, 0.0, math.pi / 2), expected, rtol=0, atol=1e-15)


def test_a_read_only_array_is_a_private_copy() -> None:
    mine = np.zeros(3)
    kept = read_only(mine)
    mine[0] = 1.0
    assert kept[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        kept[0] = 2.0


def test_a_long_value_is_shortened_in_the_message_only() -> None:
    error = InvalidRequest("q", [0.0] * 10_000, "six numbers")
    assert len(str(error)) < 400
    assert len(error.value) == 10_000


def test_a_path_that_cannot_be_printed_can_be_reported() -> None:
    assert "\\ud800.toml" in str(InvalidFile("\ud800.toml", ["no such file"])).encode("utf-8").decode()


def test_sines_of_our_own_are_right_to_the_last_bit_but_one() -> None:
    x = np.concatenate([np.linspace(-7.0, 7.0, 20_001), np.arange(-4, 5) * (np.pi / 2)])
    cosines, sines = cosines_and_sines(x)
    assert max(abs(c - math.cos(v)) for c, v in zip(cosines, x, strict=True)) <= 2.0**-52
    assert max(abs(s - math.sin(v)) for s, v in zip(sines, x, strict=True)) <= 2.0**-52
    assert cosines_and_sines(np.array([0.0, math.pi / 2]))[1].tolist() == [0.0, 1.0]


def test_what_is_no_array_of_real_numbers_is_refused_and_the_rest_becomes_a_constant_copy() -> None:
    refused: Any
    masked = np.ma.masked_greater(np.array([1.0, 2.0]), 1.5)  # type: ignore[no-untyped-call]
    for refused in ("1", True, [1.0, True], [1j], masked, [[1.0], [1.0, 2.0]], [0.5, 10**400], None, iter([1.0])):
        with pytest.raises(InvalidRequest, match=r"(?s)^q: got .*; expected six numbers$"):
            numbers("q", refused, "six numbers")
    for value in (True, "1", 10**400, math.nan, -0.1, 2.5):
        with pytest.raises(InvalidRequest, match=r"^u: got .*; expected a number from 0 to 2$"):
            number("u", value, "a number from 0 to 2", 0.0, 2.0)
    mine = np.arange(1, 3, dtype=np.int8)
    read = numbers("q", mine, "two numbers")
    assert read.dtype == np.float64
    assert read.tolist() == [1.0, 2.0]
    assert not read.flags.writeable

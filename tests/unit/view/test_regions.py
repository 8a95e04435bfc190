"""How constraints are drawn: where bounds are, what an axis may point to, and how much of a tolerance is used."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planner_service import Pose, load_robot
from planner_service.constraints import InBox, JointRange, OnPlane, ToolRegion
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.constraint_set import ConstraintSet
from planner_service.view.regions import BEYOND, Kept, cap, frames_at, rectangles
from tests.support.constraints import case
from tests.support.optional import present

inf = math.inf
ROUNDING = 1e-9
"""Of poses by two ways, in metres and radians."""

POINTS = np.array([[0.1, -0.2, 0.0], [0.3, 0.4, 0.05]])
"""Where a motion goes, in the frame of a region."""


def configurations(name: str, count: int) -> tuple[ConstraintSet, FloatArray]:
    robot, constraints, _ = case(name)
    rng, limits = np.random.default_rng(3), robot.limits
    return constraints, limits.lower + (limits.upper - limits.lower) * rng.random((count, robot.n))


# Where regions are, and how the robot is in them.


@pytest.mark.parametrize("name", ["plane", "above a bound", "both hands"])
def test_the_frames_drawn_are_those_that_are_constrained(name: str) -> None:
    constraints, Q = configurations(name, 30)
    for placed in constraints.regions:
        alone = ConstraintSet(constraints.robot, [placed.region])
        frames = frames_at(constraints.robot, placed, Q)
        for k, q in enumerate(Q):
            values = {quantity.what: quantity.value for quantity in alone.quantities(q)}
            region, held, allowed, turned = (T[k] for T in (frames.region, frames.held, frames.allowed, frames.turned))
            coordinates = dict(zip("xyz", (np.linalg.inv(region) @ held)[:3, 3], strict=True))
            seen = {
                **coordinates,
                "tilt": angle(allowed[:3, 2], held[:3, 2]),
                "turn": angle(allowed[:3, 0], turned[:3, 0]),
            }
            assert {what: seen[what] for what in values} == pytest.approx(values, abs=ROUNDING)
            np.testing.assert_allclose(frames.points[k], list(coordinates.values()), atol=ROUNDING)
            np.testing.assert_allclose(allowed[:3, 3], held[:3, 3], atol=ROUNDING)
            np.testing.assert_allclose(turned[:3, :3], swung(held[:3, :3], region[:3, 2]), atol=ROUNDING)


def swung(R: FloatArray, z: FloatArray) -> FloatArray:
    """A rotation (3, 3) turned the shortest way until its z axis is z (Rodrigues' formula)."""
    a, b, c = np.cross(R[:, 2], z)
    K = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
    return np.asarray((np.eye(3) + K + K @ K / (1.0 + R[:, 2] @ z)) @ R)


def angle(a: FloatArray, b: FloatArray) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


# Bounds on coordinates.


def test_a_box_is_drawn_as_its_six_sides() -> None:
    half = np.array([0.2, 0.5, 0.3])
    drawn = rectangles(InBox(Pose(), (2.0 * half).tolist()), POINTS)
    assert drawn.shape == (6, 4, 3)
    assert (np.abs(drawn) == half).all()
    sides = {tuple(np.flatnonzero(np.ptp(corners, axis=0) == 0.0)) for corners in drawn}
    assert sides == {(0,), (1,), (2,)}
    assert len(np.unique(drawn.reshape(6, 12), axis=0)) == 6


def test_a_plane_is_two_sheets_that_reach_beyond_the_motion() -> None:
    drawn = rectangles(OnPlane(Pose(), 0.002), POINTS)
    assert sorted(set(drawn[..., 2].ravel().tolist())) == [-0.002, 0.002]
    for corners in drawn:
        np.testing.assert_allclose(corners.min(axis=0)[:2], POINTS.min(axis=0)[:2] - BEYOND)
        np.testing.assert_allclose(corners.max(axis=0)[:2], POINTS.max(axis=0)[:2] + BEYOND)


# Bounds on an orientation.


@pytest.mark.parametrize("tilt", [0.001, 2.5, math.pi])
def test_a_cap_has_all_directions_up_to_the_tilt(tilt: float) -> None:
    vertices, faces = cap(tilt, 0.2)
    apart = np.linalg.norm(vertices, axis=1)
    rim = vertices[apart > 0.0]
    np.testing.assert_allclose(apart[apart > 0.0], 0.2)
    angles = [angle(point, np.array([0.0, 0.0, 1.0])) for point in rim]
    assert max(angles) == pytest.approx(tilt, abs=ROUNDING)
    assert min(angles) == 0.0
    a, b, c = vertices[faces].transpose(1, 0, 2)
    volume = float(np.einsum("mi,mi->", a, np.cross(b, c))) / 6.0  # positive: triangles face outwards
    ideal = 2.0 * math.pi / 3.0 * 0.2**3 * (1.0 - math.cos(tilt))
    assert 0.98 * ideal <= volume <= ideal


# How much of the tolerances is used.


@pytest.mark.parametrize("name", ["upright", "orientation in a box", "both hands"])
def test_a_bound_is_left_where_more_than_the_tolerance_is_used(name: str) -> None:
    constraints, Q = configurations(name, 100)
    kept = present(Kept.of(constraints.robot, constraints.constraints, Q))
    used = kept.used(Q)
    for q, row in zip(Q, used, strict=True):
        shares = [quantity.share for quantity in constraints.quantities(q)]
        assert [abs(value) > 1.0 for value in row] == [share > 1.0 for share in shares]
        assert any(kept.broken(q)) == (max(shares) > 1.0)


def test_between_two_bounds_the_middle_is_zero_and_with_one_bound_all_that_is_well_inside() -> None:
    robot = load_robot("planar2")
    given = (ToolRegion(lower=(-0.5, -inf, -inf), upper=(1.5, 1.2, inf), name="side"), JointRange("elbow", -1.0, 2.0))
    kept = present(Kept.of(robot, given, np.zeros((1, 2))))
    assert kept.names == ("elbow", "side x", "side y")
    q = np.array([1.0, 0.2])
    x, y = (float(robot.tool_pose(q)[axis, 3]) for axis in range(2))
    assert kept.used(q[None])[0].tolist() == pytest.approx([-0.2, x - 0.5, 1.0 + (y - 1.2) / 0.01])
    assert kept.used(np.array([[-1.0, 0.5]]))[0, [0, 2]].tolist() == [0.0, 0.0]

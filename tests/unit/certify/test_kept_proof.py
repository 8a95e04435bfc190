"""What is proven of constraints and what is refused, where the answer has a closed form."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from planner_service.certify import KeptBound, KeptRefusal, prove_kept
from planner_service.certify.kept_proof import SLACK
from planner_service.constraints import (
    Constraint,
    JointRange,
    KeepOrientation,
    KeepUpright,
    OnPlane,
    ToolRegion,
)
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.shapes import Pose
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from tests.support.small_robots import SLIDER, built

PLANAR = load_robot("planar2")
"""Its tip is at (cos a + cos(a + b) / 2, sin a + sin(a + b) / 2, 0) and turned by a + b about z."""
WXAI = load_robot("wxai")
INF = math.inf
X_UP = (1.0, 0.0, 0.0)
NANO = 1e-9


def line(*points: list[float]) -> JointPath:
    return JointPath(np.array(points))


def below(x: float) -> ToolRegion:
    return ToolRegion(upper=(x, INF, INF))


def proven(robot: Robot, path: JointPath, constraint: Constraint) -> tuple[KeptBound, ...]:
    found = prove_kept(robot, path, [constraint])
    assert not isinstance(found, KeptRefusal), found
    (kept,) = found
    return kept.bounds


def refused(robot: Robot, path: JointPath, *constraints: Constraint) -> KeptRefusal:
    found = prove_kept(robot, path, constraints)
    assert isinstance(found, KeptRefusal)
    return found


def test_a_tilt_is_the_largest_angle_on_the_way() -> None:
    way = line([0.0, 0.0], [0.5, 0.1], [-0.2, -0.1])
    (tilt,) = proven(PLANAR, way, KeepUpright(X_UP, 0.7, up=X_UP))
    assert (tilt.quantity, tilt.tolerance, tilt.unit) == ("tilt", 0.7, "rad")
    assert 0.6 <= tilt.bound <= 0.7


def test_a_turn_is_signed_and_its_bound_counts_both_ways() -> None:
    for sign in (1.0, -1.0):
        tilt, turn = proven(PLANAR, line([0.0, 0.0], [0.4 * sign, 0.2 * sign]), KeepOrientation(Pose(), 0.6 + NANO))
        assert (tilt.quantity, turn.quantity) == ("tilt", "turn")
        assert tilt.bound <= 0.2 * 0.6
        assert 0.6 <= turn.bound <= 0.6 + 2 * NANO


def test_a_turn_that_passes_half_a_turn_is_refused() -> None:
    region = ToolRegion(tilt=0.1, turn=3.1)
    refusal = refused(PLANAR, line([1.5, 1.5], [1.5, 1.8]), region)
    assert refusal.quantity == "turn"
    assert refusal.deviation > 3.1
    assert proven(PLANAR, line([1.5, 1.5], [1.5, 1.8]), ToolRegion(tilt=0.1, turn=math.pi))[1].bound >= math.pi


@pytest.mark.parametrize("tolerance", [1e-4, 0.01])
def test_a_line_that_bulges_out_of_a_plane_between_two_samples_is_refused(tolerance: float) -> None:
    """Both ends are on the plane, and what the arm sweeps in between is an arc."""
    half = math.acos(1.0 - 1.2 * tolerance / 1.5)
    plane = Pose.from_rpy((1.5 * math.cos(half), 0.0, 0.0), (0.0, math.pi / 2, 0.0))
    refusal = refused(PLANAR, line([-half, 0.0], [half, 0.0]), OnPlane(plane, tolerance))
    assert refusal.s_start < half < refusal.s_end
    assert refusal.deviation == pytest.approx(1.2 * tolerance, rel=0.2)
    (z,) = proven(PLANAR, line([0.6 * half, 0.0], [half, 0.0]), OnPlane(plane, tolerance))
    assert z.bound >= 1.5 * math.cos(0.6 * half) - 1.5 * math.cos(half)


def corner() -> JointPath:
    """The tip's y is 1.5 where the arm points along y, between the two legs; on them it is 1.29 at most."""
    up = math.pi / 2
    return line([up, 1.6], [up + 0.8, -0.8], [up, -1.6])


def test_a_curve_outside_only_inside_a_blend_is_refused_there() -> None:
    region, straight = ToolRegion(upper=(INF, 1.305, INF)), corner()
    at = float(straight.knots[1])
    (y,) = proven(PLANAR, straight, region)
    assert 1.29 <= y.bound <= 1.305
    refusal = refused(PLANAR, straight.with_blends([0.0, 1.0, 0.0]), region)
    assert at - 1.0 <= refusal.s_start < refusal.s < refusal.s_end <= at + 1.0
    assert refusal.broken == ((refusal.s_start, refusal.s_end),)
    assert 1.305 < refusal.deviation < 1.5
    assert "y = 13" in str(refusal)


def test_a_bound_holds_where_a_joint_gathers_speed_in_a_blend() -> None:
    """The elbow comes to rest while the shoulder, at rest before, swings the arm past x = 1.49."""
    path = line([-1.0, -2.0], [-1.0, 0.0], [1.0, 0.0]).with_blends([0.0, 2.0, 0.0])
    furthest = max(math.cos(a) + 0.5 * math.cos(a + b) for a, b in path(np.linspace(1.5, 4.0, 2_001)).tolist())
    assert furthest > 1.49
    found = prove_kept(PLANAR, path, [below(9.0)], part=(1.5, 4.0))
    assert isinstance(found, tuple)
    assert found[0].bounds[0].bound >= furthest


def test_ends_on_the_tolerance_are_kept_and_beyond_it_are_not() -> None:
    ends = line([0.5, 0.0], [1.2, 0.4])
    at_start = 1.5 * math.cos(0.5)
    (x,) = proven(PLANAR, ends, below(at_start))
    assert at_start <= x.bound <= at_start + SLACK
    refusal = refused(PLANAR, ends, below(at_start - 2 * SLACK))
    assert not refusal.spent
    assert refusal.s == 0.0
    (tilt,) = proven(PLANAR, line([0.3, 0.2], [0.0, 0.0], [-0.5, 0.0]), KeepUpright(X_UP, 0.5, up=X_UP))
    assert 0.5 <= tilt.bound <= 0.5 + SLACK


def test_a_curve_on_its_tolerance_all_along_is_kept_and_one_just_beyond_it_does_not_hang() -> None:
    """Turned about the vertical, a tilted tool stays tilted."""
    q = WXAI.home + np.array([0.0, 0.0, 0.0, 0.3, 0.0, 0.0])
    R = WXAI.tool_pose(q)[:3, :3]
    angle = math.atan2(math.hypot(R[0, 0], R[1, 0]), R[2, 0])
    way = JointPath(np.array([q, q + np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])]))
    assert proven(WXAI, way, KeepUpright(X_UP, angle))[0].bound <= angle + SLACK
    refusal = refused(WXAI, way, KeepUpright(X_UP, angle - 0.99 * SLACK))
    assert refusal.spent
    assert refusal.broken == ()
    assert "not excluded" in str(refusal)


def test_a_joint_range_is_exact_on_straight_pieces_and_close_on_blends() -> None:
    path = line([0.0, 0.0], [1.0, 0.0], [0.2, 0.8])
    (shoulder,) = proven(PLANAR, path, JointRange("shoulder", -1.0, 1.0))
    assert (shoulder.quantity, shoulder.tolerance, shoulder.unit) == ("shoulder", 1.0, "rad")
    assert shoulder.bound == pytest.approx(1.0, abs=2 * NANO)
    blended = path.with_blends([0.0, 0.5, 0.0])
    furthest = float(blended(np.linspace(0.0, blended.length, 10_001))[:, 0].max())
    assert furthest < 0.95
    (shoulder,) = proven(PLANAR, blended, JointRange("shoulder", -furthest, furthest + NANO))
    assert furthest <= shoulder.bound + 1e-8
    refusal = refused(PLANAR, blended, JointRange("shoulder", -0.8, 0.8))
    assert "shoulder is 0.8" in str(refusal)


def test_a_part_is_judged_alone() -> None:
    way = line([0.0, 0.0], [1.0, 0.0])
    upright = KeepUpright(X_UP, 0.5, up=X_UP)
    assert isinstance(prove_kept(PLANAR, way, [upright]), KeptRefusal)
    found = prove_kept(PLANAR, way, [upright], part=(0.1, 0.4))
    assert isinstance(found, tuple)
    assert 0.4 <= found[0].bounds[0].bound <= 0.5
    assert isinstance(prove_kept(PLANAR, way, [upright], part=(0.45, 0.55)), KeptRefusal)
    assert isinstance(prove_kept(PLANAR, way, [upright], part=(0.3, 0.3)), tuple)
    assert isinstance(prove_kept(PLANAR, way, [upright], part=(0.6, 0.6)), KeptRefusal)


def test_a_refusal_names_the_constraint_the_place_and_the_amount() -> None:
    way = line([0.0, 0.0], [0.31, 0.0])
    refusal = refused(PLANAR, way, below(2.0), KeepUpright(X_UP, 0.1, up=X_UP))
    assert (refusal.index, refusal.name, refusal.quantity, refusal.unit) == (1, "upright", "tilt", "rad")
    assert 0.08 <= refusal.s_start <= 0.1
    assert (refusal.s, refusal.s_end) == (0.31, 0.31)
    assert str(refusal).startswith("upright is not proven kept from s = 0")
    assert str(refusal).endswith(": tilt of 0.31 rad at s = 0.31, at most 0.1 rad")
    low = refused(PLANAR, way, ToolRegion(lower=(1.5 * math.cos(0.2), -INF, -INF)))
    assert "x = 1428" in str(low)
    assert "at least 1470" in str(low)


def test_what_is_not_there_is_named() -> None:
    way = line([0.0, 0.0], [1.0, 0.0])
    with pytest.raises(UnknownName, match="hand"):
        prove_kept(PLANAR, way, [ToolRegion(tilt=1.0, link="hand")])
    with pytest.raises(UnknownName, match="hand"):
        prove_kept(PLANAR, way, [ToolRegion(tilt=1.0, relative_to="hand")])
    with pytest.raises(UnknownName, match="wrist"):
        prove_kept(PLANAR, way, [JointRange("wrist", 0.0, 1.0)])
    with pytest.raises(InvalidRequest, match="2 joints"):
        prove_kept(PLANAR, line([0.0], [1.0]), [below(1.0)])
    with pytest.raises(InvalidRequest, match="constraints"):
        prove_kept(PLANAR, way, ["upright"])  # type: ignore[list-item]
    with pytest.raises(InvalidRequest, match="part"):
        prove_kept(PLANAR, way, [below(1.0)], part=(0.5, 1.5))


def test_a_curve_of_another_class_is_not_taken_for_its_waypoints() -> None:
    class Elsewhere(JointPath):
        pass

    with pytest.raises(InvalidRequest, match="a JointPath"):
        prove_kept(PLANAR, Elsewhere(np.array([[0.0, 0.0], [1.0, 0.0]])), [below(2.0)])


def test_a_curve_of_which_the_sines_are_not_right_is_refused(tmp_path: Path) -> None:
    """At 1e20 rad the remainder of full turns is lost, at 1e160 m squares overflow."""
    flat = ToolRegion(tilt=3.0)
    for path in (line([0.0, 1e20], [0.1, 1e20]), line([1e160, 0.0], [1e160, 0.1])):
        with pytest.raises(InvalidRequest, match="joint values up to"):
            prove_kept(built(tmp_path, SLIDER), path, [flat])

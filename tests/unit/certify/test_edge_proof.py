"""The verdict on a straight edge, and clearances of configurations: true, tight, and refused what makes no sense."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from planner_service.certify import MARGIN, Certifier, EdgeProof, EdgeVerdict
from planner_service.collision import CollisionChecker, JointStep
from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import Box, Pose
from planner_service.path.joint_path import JointPath
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Obstacle, Scene
from tests.support.backends import case, edges_of
from tests.unit.certify.test_certifier import DISCS, PLANAR, SWEEP, WXAI, ball_beyond

ROOT = Path(__file__).parents[3]
MICRON = 1e-6
COAL = 5e-6
"""Metres to which Coal's distance is right where it is positive."""


def verdict(scene: Scene, edge: Any, **options: Any) -> EdgeProof:
    return Certifier(PLANAR, scene).certify_edge(*np.array(edge), **options)


@pytest.mark.parametrize("gap", [-10 * MICRON, -0.02])
def test_an_edge_that_overlaps_by_ten_microns_collides_and_says_where(gap: float) -> None:
    found = verdict(ball_beyond(gap), SWEEP)
    assert (found.verdict, found.free, found.colliding) == (EdgeVerdict.COLLIDING, False, True)
    assert {found.a, found.b} == {"forearm", "ball"}
    assert not CollisionChecker(PLANAR, ball_beyond(gap)).state_is_free(JointPath(SWEEP)(found.s))


@pytest.mark.parametrize("padding", [0.0, 0.02])
def test_padding_is_what_a_free_edge_keeps_and_a_colliding_one_does_not(padding: float) -> None:
    gaps = (padding + 10 * MICRON, padding, padding - 10 * MICRON)
    found = [verdict(ball_beyond(gap), SWEEP, padding=padding).verdict for gap in gaps]
    assert found == [EdgeVerdict.FREE, EdgeVerdict.UNDECIDED, EdgeVerdict.COLLIDING]


def test_boxes_that_overlap_by_less_than_the_margin_do_not_collide() -> None:
    """Flat faces: the edge is one configuration at which the end of the arm is so far inside a block."""

    def block(depth: float) -> Scene:
        return Scene((Obstacle("block", Box((0.2, 0.2, 0.2)), Pose((1.5 - depth + 0.1, 0.0, 0.0))),))

    still = np.zeros((2, 2))
    found = [verdict(block(depth), still).verdict for depth in (-10 * MICRON, 0.5 * MICRON, 0.005)]
    assert found == [EdgeVerdict.FREE, EdgeVerdict.UNDECIDED, EdgeVerdict.COLLIDING]


@pytest.mark.parametrize(("name", "undecided"), [("wxai bin", 0), ("wxai clutter", 0), ("panda shelf", 0)])
def test_verdicts_are_those_of_a_dense_sampling(name: str, undecided: int) -> None:
    robot, scene = case(name)
    certifier, checker = Certifier(robot, scene), CollisionChecker(robot, scene, edge_step=JointStep(0.002))
    told = []
    for a, b in edges_of(checker, 150, seed=21):
        found = certifier.certify_edge(a, b)
        told.append(found.verdict)
        if found.free:
            assert checker.edge_is_free(a, b)
        elif found.colliding:
            assert not checker.state_is_free(JointPath(np.array([a, b]))(found.s))
    assert told.count(EdgeVerdict.UNDECIDED) == undecided
    assert {EdgeVerdict.FREE, EdgeVerdict.COLLIDING} <= set(told)


def test_ends_that_make_no_sense_are_refused_by_name() -> None:
    ends: Any
    for ends, told in [
        (([0.0, 0.0, 0.0], [0.1, 0.0]), r"q1: got \(3,\); expected 2 joint values"),
        (([0.0, 0.0], [[0.1, 0.0]]), r"q2: got \(1, 2\)"),
        (([0.0, 0.0], [0.1, math.nan]), r"q2\[1\]: got nan; expected elbow in"),
        (([3.2, 0.0], [0.1, 0.0]), r"q1\[0\]: got 3\.2; expected shoulder in"),
        ((np.zeros(2), np.array([None, 0.0])), "q2: got"),
        ((np.ma.masked_less([0.5, 0.0], 0.5), np.zeros(2)), "q1: got"),  # type: ignore[no-untyped-call]
    ]:
        certifier = Certifier(PLANAR, DISCS)
        with pytest.raises(InvalidRequest, match=told):
            certifier.certify_edge(*ends)


@pytest.mark.parametrize("padding", [-0.001, math.nan])
def test_a_padding_that_makes_no_sense_is_refused(padding: float) -> None:
    certifier = Certifier(PLANAR, DISCS)
    with pytest.raises(InvalidRequest, match="padding: got"):
        certifier.certify_edge(SWEEP[0], SWEEP[1], padding=padding)


# --- clearances


def test_clearances_are_no_more_than_coal_says_and_close_to_it() -> None:
    certifier, rng = Certifier(WXAI, load_scene("bin")), np.random.default_rng(22)
    second = IndependentChecker(ROOT / "robots" / "wxai", ROOT / "scenes" / "bin.toml")
    Q = rng.uniform(WXAI.limits.lower, WXAI.limits.upper, (60, 6))
    gaps = np.array([min(second.gaps(q).values()) for q in Q])
    found = certifier.clearances(Q)
    free = gaps > 0.0
    assert 5 < free.sum() < 60
    assert (found[free] <= gaps[free] + COAL).all()
    assert np.median(gaps[free] - found[free]) < COAL
    assert (found[gaps < -COAL] < 0.0).all()


def test_configurations_that_make_no_sense_are_refused() -> None:
    Q: Any
    for Q, told in [
        ([0.0, 0.0], r"Q: got \(2,\); expected configurations of shape \(m, 2\)"),
        ([[0.0, 0.0, 0.0]], r"Q: got \(1, 3\)"),
        ([[0.0, 0.0], [0.0, math.inf]], r"Q\[1\]\[1\]: got inf; expected elbow in"),
    ]:
        certifier = Certifier(PLANAR, DISCS)
        with pytest.raises(InvalidRequest, match=told):
            certifier.clearances(Q)


def test_a_clearance_of_more_than_padding_and_margin_is_what_a_still_edge_proves() -> None:
    certifier, rng = Certifier(load_robot("ur5"), load_scene("bin")), np.random.default_rng(23)
    limits = certifier.robot.limits
    Q = rng.uniform(limits.lower, limits.upper, (40, 6))
    for q, gap in zip(Q, certifier.clearances(Q).tolist(), strict=True):
        found = certifier.certify_edge(q, q)
        if gap > MARGIN:
            assert found.free
        if found.colliding:
            assert gap < 0.0

"""The checker's answers where they are known in closed form, what it refuses, and what it keeps away from FCL."""

from __future__ import annotations

import math
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from planner_service.collision import CollisionChecker, MotionStep
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.path.joint_path import JointPath
from planner_service.planning.request import PlanRequest
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Attached, Obstacle, Scene
from planner_service.service import PlannerService
from tests.support.optional import present

NANO = 1.1e-9  # clearances and depths are whole nanometres, rounded to the safe side
ROOT = Path(__file__).parents[3]
LINK_RADIUS = 0.01
LESSON_GOAL = np.array([math.pi / 2, -math.pi / 2])
"""From (0, 0) to here link 2 of the lesson's arm sweeps through the lesson's disc."""
CONTACT = 2e-6
"""Metres: nearer to contact than this FCL's answer is undefined."""

PLANAR = load_robot("planar2")
WXAI = load_robot("wxai")
DISCS = load_scene("discs")
KINDS: tuple[Shape, ...] = (Box((0.02, 0.02, 0.02)), Sphere(0.01), Cylinder(0.01, 0.02), Capsule(0.01, 0.02))


def planar(scene: Scene = DISCS) -> CollisionChecker:
    return CollisionChecker(PLANAR, scene)


def link_gap(q: Any, link: int, disc: tuple[float, float, float], half_width: float = LINK_RADIUS) -> float:
    """Gap between a link of the planar arm (a rectangle in the plane) and a disc (x, y, radius); -radius inside."""
    shoulder, elbow = float(q[0]), float(q[1])
    x, y, angle, length = (0.0, 0.0, shoulder, 1.0)
    if link == 2:
        x, y, angle, length = math.cos(shoulder), math.sin(shoulder), shoulder + elbow, 0.5
    u, v = math.cos(angle), math.sin(angle)
    along = (disc[0] - x) * u + (disc[1] - y) * v
    across = abs((disc[1] - y) * u - (disc[0] - x) * v)
    return math.hypot(max(-along, along - length, 0.0), max(across - half_width, 0.0)) - disc[2]


def discs_of(scene: Scene) -> list[tuple[float, float, float]]:
    return [(*o.pose.position[:2], o.shape.radius) for o in scene.obstacles if isinstance(o.shape, Cylinder)]


def planar_gap(q: Any, scene: Scene = DISCS) -> float:
    return min(link_gap(q, link, disc) for link in (1, 2) for disc in discs_of(scene))


def ball_above_box(gap: float) -> tuple[CollisionChecker, FloatArray]:
    """The arm at home holding a ball 0.1 m ahead of its tool, and a small table ``gap`` below that ball."""
    ball = Attached("ball", Sphere(0.02), Pose((0.1, 0.0, 0.0)))
    x, y, z = (WXAI.tool_pose(WXAI.home) @ np.array([0.1, 0.0, 0.0, 1.0]))[:3].tolist()
    table = Obstacle("small_table", Box((0.04, 0.04, 0.02)), Pose((x, y, z - 0.02 - 0.01 - gap)))
    return CollisionChecker(WXAI, Scene((table,), (ball,))), WXAI.home


def nested(inner: Shape, outer: Shape) -> CollisionChecker:
    """The planar arm holding ``inner`` 0.2 m beyond its tip, at q = 0 in the very middle of ``outer``."""
    held = Attached("held", inner, Pose((0.2, 0.0, 0.0)))
    return planar(Scene((Obstacle("around", outer, Pose((1.7, 0.0, 0.0))),), (held,)))


def test_verdicts_among_discs_are_those_of_plane_geometry() -> None:
    checker, rng, free = planar(), np.random.default_rng(1), 0
    for q in rng.uniform(-math.pi, math.pi, (1500, 2)):
        gap = planar_gap(q)
        if abs(gap) > CONTACT:
            assert checker.state_is_free(q) == (gap > 0.0)
            free += gap > 0.0
    assert 100 < free < 1400


def test_the_lesson_s_midpoint_is_hit_by_link_2_and_not_by_the_tip() -> None:
    disc = discs_of(DISCS)[0]
    middle = LESSON_GOAL / 2
    tip = PLANAR.tool_pose(middle)[:2, 3]
    assert math.dist(tip, disc[:2]) - disc[2] == pytest.approx(0.00147, abs=1e-5)  # the tip alone would pass
    assert link_gap(middle, 2, disc, half_width=0.0) == pytest.approx(-0.0429, abs=5e-5)
    checker = planar()
    (contact,) = checker.contacts(middle)
    assert (contact.a, contact.b) == ("forearm", "lesson_disc")
    assert contact.depth == pytest.approx(0.0429 + LINK_RADIUS, abs=5e-5)  # our links are 10 mm thick to either side
    assert str(contact) == "forearm x lesson_disc (at most 52.9 mm deep)"
    assert checker.clearance(middle) == pytest.approx(-contact.depth, abs=1e-12)


@pytest.mark.parametrize("gap", [1e-5, 0.02])
def test_a_ball_above_a_table_is_free_and_its_clearance_is_the_gap(gap: float) -> None:
    checker, q = ball_above_box(gap)
    assert checker.state_is_free(q)
    assert checker.contacts(q) == ()
    assert checker.clearance(q) == pytest.approx(gap, abs=NANO)


@pytest.mark.parametrize("depth", [1e-5, 0.01])
def test_a_ball_in_a_table_collides_as_deep_as_it_is_lowered(depth: float) -> None:
    checker, q = ball_above_box(-depth)
    assert not checker.state_is_free(q)
    (contact,) = checker.contacts(q)
    assert (contact.a, contact.b) == ("ball", "small_table")
    assert contact.depth == pytest.approx(depth, abs=NANO)
    assert checker.clearance(q) == pytest.approx(-depth, abs=NANO)


def test_padding_is_the_distance_that_must_be_kept() -> None:
    checker, q = ball_above_box(0.005)
    assert checker.variant(padding=0.00499).state_is_free(q)
    assert not checker.variant(padding=0.00501).state_is_free(q)
    assert checker.state_is_free(q)


def test_the_pairs_of_the_bin_are_405() -> None:
    assert CollisionChecker(WXAI, load_scene("bin")).pair_count == 405
    assert planar().pair_count == 8


def test_an_object_held_may_touch_only_its_touch_links() -> None:
    """Folded towards the arm's own shoulder, a long rod in the gripper meets link_2."""
    rod = Attached("rod", Capsule(0.01, 0.5), Pose.from_rpy((0.0, 0.0, 0.0), (0.0, math.pi / 2, 0.0)))
    q = np.array([0.0, 1.6, 2.2, -1.5, 0.0, 0.0])
    checker = CollisionChecker(WXAI, Scene((), (rod,)))
    contacts = checker.contacts(q)
    assert checker.touching(q) == {(contact.a, contact.b) for contact in contacts}
    assert checker.counts.states == 2
    names = {name for c in contacts if "rod" in (c.a, c.b) for name in (c.a, c.b) if name != "rod"}
    assert names
    allowed = Attached("rod", rod.shape, rod.pose, tuple(names))
    touching = CollisionChecker(WXAI, Scene((), (allowed,))).contacts(q)
    assert all("rod" not in (c.a, c.b) for c in touching)


def test_an_allowed_pair_may_touch_in_either_order_and_no_other() -> None:
    middle = LESSON_GOAL / 2
    for pair in (("forearm", "lesson_disc"), ("lesson_disc", "forearm")):
        assert CollisionChecker(PLANAR, DISCS, allowed=[pair]).state_is_free(middle)
    assert not CollisionChecker(PLANAR, DISCS, allowed=[("forearm", "far_disc")]).state_is_free(middle)


def test_a_padding_that_makes_no_sense_is_refused() -> None:
    for padding in [-0.001, math.nan, math.inf, 1.0]:
        with pytest.raises(InvalidRequest, match="padding"):
            CollisionChecker(PLANAR, DISCS, padding=padding)


def test_a_configuration_that_is_none_is_refused_and_not_counted() -> None:
    for ask in ["state_is_free", "contacts", "clearance"]:
        for q, told in [
            ([math.nan, 0.0], "shoulder"),
            ([0.0, 3.2], "elbow"),
            ([-3.2, 0.0], "shoulder"),
            ([0.0], "2 joint values"),
            ([[0.0, 0.0]], "2 joint values"),
            ([[0.0], [0.0, 1.0]], "2 joint values"),
        ]:
            checker = planar()
            with pytest.raises(InvalidRequest, match=f"q: .*{told}"):
                getattr(checker, ask)(q)
            assert checker.counts == planar().counts


def test_a_checker_without_pairs_has_infinite_clearance() -> None:
    checker = planar(Scene())
    assert checker.pair_count == 0
    assert checker.clearance([0.0, 0.0]) == math.inf
    assert checker.state_is_free([0.0, 0.0])
    assert checker.contacts([0.0, 0.0]) == ()


def test_concentric_shapes_collide_and_no_answer_hangs() -> None:
    """FCL's signed distance never returns for concentric spheres, and aborts for some boxes; it is never asked."""
    for inner, outer in list(product(KINDS, repeat=2)):
        checker = nested(inner, outer)
        assert not checker.state_is_free([0.0, 0.0])
        assert checker.clearance([0.0, 0.0]) == pytest.approx(-0.02, abs=1e-12)
        (contact,) = checker.contacts([0.0, 0.0])
        assert (contact.a, contact.b) == ("held", "around")
        assert contact.depth == pytest.approx(0.02, abs=1e-12)


def test_a_shape_wholly_inside_another_collides() -> None:
    """A closed mesh would be a surface to FCL, and its inside free; solids are solid."""
    for inner, outer in list(product(KINDS, repeat=2)):
        checker = nested(inner, outer.grown(0.1))
        assert not checker.state_is_free([0.0, 0.0])
        assert not checker.state_is_free([0.03, 0.01])
        assert checker.contacts([0.03, 0.01])[0].depth >= 0.01


def test_a_free_state_after_a_colliding_one_is_free() -> None:
    """FCL's result object stays "colliding" for ever when it is used again."""
    checker = planar()
    for _ in range(20):
        assert not checker.state_is_free(LESSON_GOAL / 2)
        assert checker.state_is_free(LESSON_GOAL)
        assert len(checker.contacts(LESSON_GOAL / 2)) == 1
        assert checker.contacts([0.0, 0.0]) == ()


@pytest.mark.parametrize("allowed", [(("link_1", "table"),)])
def test_a_variant_says_and_counts_what_a_checker_made_like_it_does(allowed: tuple[tuple[str, str], ...]) -> None:
    scene, rng = load_scene("clutter"), np.random.default_rng(6)
    first, made = CollisionChecker(WXAI, scene), CollisionChecker(WXAI, scene, padding=0.02, allowed=allowed)
    varied = first.variant(padding=0.005).variant(padding=0.02, allowed=allowed)
    Q = rng.uniform(WXAI.limits.lower, WXAI.limits.upper, (60, WXAI.n))
    for a, b in pairwise(Q):
        assert varied.contacts(a) == made.contacts(a)
        assert varied.edge_hit(a, b) == made.edge_hit(a, b)
    assert varied.counts == made.counts
    assert varied.clearance(Q[0]) == made.clearance(Q[0])
    assert any(first.state_is_free(q) and not made.state_is_free(q) for q in Q), "or the padding tests nothing"


def test_a_variant_counts_in_the_same_ledger_and_is_made_once() -> None:
    checker = planar()
    padded = checker.variant(padding=0.01)
    assert checker.variant(padding=0.0) is checker
    assert checker.variant(padding=0.01) is padded
    assert padded.variant(padding=0.0) is checker or padded.variant(padding=0.0).ledger is checker.ledger
    padded.state_is_free([0.0, 0.0])
    assert checker.counts.states == 1
    assert padded.edge_step == checker.edge_step == MotionStep(0.010)


def test_the_robot_given_is_the_robot_judged() -> None:
    """A closed gripper passes where an open one does not."""
    home = WXAI.home
    T = WXAI.tool_pose(home)
    beside = T @ np.array([-0.02, 0.05, 0.0, 1.0])
    post = Scene((Obstacle("post", Sphere(0.008), Pose(tuple(beside[:3].tolist()))),))
    widths = {width: CollisionChecker(WXAI.with_gripper(width), post).state_is_free(home) for width in (0.0, 0.08)}
    assert widths == {0.0: True, 0.08: False}


ELBOW = JointPath(np.array([[-2.0, 1.2], [-1.0, 1.2], [-1.0, 2.2]]), np.array([0.0, 0.4, 0.0]))
"""Of the planar arm: the blend leaves out the corner and bends the elbow sooner."""


def test_a_blend_is_judged_at_samples_that_leave_no_motion_unseen() -> None:
    checker = CollisionChecker(PLANAR, Scene(), edge_step=MotionStep(0.01))
    assert checker.blend_is_free(ELBOW, 1)
    s = np.linspace(0.6, 1.4, checker.counts.states + 2)
    moved = np.abs(np.diff(ELBOW(s), axis=0)) * PLANAR.reach()
    assert moved.sum(axis=1).max() <= 0.01
    assert checker.counts.edges == 0


def test_a_path_with_blends_is_judged_where_it_runs() -> None:
    middle, corner = (PLANAR.tool_pose(q)[:3, 3].tolist() for q in (ELBOW(1.0), ELBOW.waypoints[1]))
    pins = [Obstacle("pin", Sphere(0.005), Pose((x, y, z))) for x, y, z in (middle, corner)]
    on_blend, on_corner = (CollisionChecker(PLANAR, Scene((pin,))) for pin in pins)
    assert not on_blend.path_is_free(ELBOW)
    assert on_corner.path_is_free(ELBOW)
    assert not on_corner.path_is_free(ELBOW.with_blends(None))


@pytest.mark.parametrize(
    ("k", "expected"),
    [(k, "the index of a waypoint with a blend") for k in (0, 2)]
    + [(k, "a whole number from 0 to 2") for k in (3, -2)],
)
def test_a_waypoint_without_a_blend_cannot_be_judged_as_one(k: int, expected: str) -> None:
    checker = planar()
    with pytest.raises(InvalidRequest, match=f"^k: got {k}; expected {expected}$"):
        checker.blend_is_free(ELBOW, k)


def test_the_independent_checker_names_the_joint_that_is_outside_its_range() -> None:
    second = IndependentChecker(ROOT / "robots" / "planar2", ROOT / "scenes" / "discs.toml")
    for q, joint in (
        ((3.2, 0.0), "shoulder"),
        ((-3.2, 0.0), "shoulder"),
        ((0.0, 3.2), "elbow"),
        ((0.0, -3.2), "elbow"),
    ):
        touch = present(second.touch(q))
        assert (touch.a, touch.b, touch.q) == (joint, "limit", q)


@pytest.mark.parametrize("duration", [1.0, 0.01])
def test_the_independent_checker_samples_a_motion_as_densely_as_it_promises(duration: float) -> None:
    second = IndependentChecker(ROOT / "robots" / "wxai", {"obstacle": [], "attached": []})
    times: list[FloatArray] = []

    def q(t: FloatArray) -> FloatArray:
        times.append(t)
        return WXAI.home + np.outer(t / duration, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0])

    assert second.trajectory_is_free(q, duration, motion_step=0.01)
    fastest = np.diff(times[0]).max() * (second.reach * WXAI.limits.velocity).sum()
    assert fastest <= 0.01
    assert fastest > 0.008 or duration < 1.0
    assert (second.reach * np.abs(np.diff(q(times[-1]), axis=0))).sum(axis=1).max() <= 0.01
    assert (times[-1][0], times[-1][-1]) == (0.0, duration)


def test_a_variant_that_allows_more_is_the_checker_that_was_made_so() -> None:
    robot, scene = load_robot("wxai"), load_scene("bin")
    pairs = [("finger_left", "blue_block"), ("link_6", "bin_floor"), ("finger_right", "blue_block")]
    few = CollisionChecker(robot, scene, allowed=pairs[:1])
    more, made = few.variant(allowed=pairs, padding=0.01), CollisionChecker(robot, scene, allowed=pairs, padding=0.01)
    assert more.pair_count == made.pair_count < few.pair_count
    assert [more.pair_names(k) for k in range(more.pair_count)] == [made.pair_names(k) for k in range(made.pair_count)]
    fewer = more.variant(allowed=pairs[1:])
    assert fewer.pair_count == CollisionChecker(robot, scene, allowed=pairs[1:]).pair_count
    with pytest.raises(UnknownName, match="'blue_blok'"):
        few.variant(allowed=[*pairs, ("link_6", "blue_blok")])


def test_a_services_own_checker_counts_nothing_of_its_plans() -> None:
    service = PlannerService("wxai", "bin")
    service.checker.variant(padding=0.01).state_is_free(service.robot.home)
    service.plan(PlanRequest(service.robot.home, service.robot.home))
    assert service.checker.counts.states == 1


def test_the_deepest_pair_is_the_first_of_all_contacts_for_one_state() -> None:
    walls = [Obstacle(f"wall_{k}", Box((0.5, 0.02, 0.5)), Pose((0.25, 0.4 * k - 0.2, 0.2))) for k in range(2)]
    checker = CollisionChecker(WXAI, Scene(tuple(walls)))
    counts = [0, 0, 0]
    for turned in np.random.default_rng(0).uniform(-1.2, 1.2, (60, WXAI.n)):
        q = np.clip(WXAI.home + turned, *WXAI.bounds)
        contacts, before = checker.contacts(q), checker.counts.states
        found = checker.deepest_touching(q)
        assert checker.counts.states == before + 1
        assert found == ((contacts[0].a, contacts[0].b) if contacts else None)
        counts[min(len(contacts), 2)] += 1
    assert min(counts) > 3, "none, one and several pairs"

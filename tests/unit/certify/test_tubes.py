"""The proof of straight edges with room beside them: nothing in it touches, and what is far enough apart is proven."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.certify import MARGIN, Certifier
from planner_service.certify.certifier import TubeProof
from planner_service.collision import CollisionChecker, JointStep
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Pose, Sphere
from planner_service.scene.scene import Obstacle, Scene
from tests.support.backends import case, edges_of
from tests.support.small_robots import CRANE, MIXED, SLIDER, TWINS, built, joint, link, solid, urdf
from tests.unit.certify.test_certifier import PLANAR, RIM, SWEEP, ball_beyond

STILL = np.zeros((1, 2))


def tube(scene: Scene, edges: Any, room: Any, **options: Any) -> TubeProof:
    edges = np.asarray(edges, dtype=np.float64).reshape(-1, 2, 2)
    return Certifier(PLANAR, scene).certify_tubes(
        edges[:, 0], edges[:, 1], np.broadcast_to(room, (len(edges), 2)), **options
    )


def test_without_room_a_tube_is_what_an_edge_is() -> None:
    for name in ("wxai bin", "panda shelf"):
        robot, scene = case(name)
        certifier, checker = Certifier(robot, scene), CollisionChecker(robot, scene, edge_step=JointStep(0.002))
        for a, b in edges_of(checker, 100, seed=5):
            edge, found = certifier.certify_edge(a, b), certifier.certify_tubes([a], [b], np.zeros((1, robot.n)))
            assert (found.free == 1, found.collides) == (edge.free, edge.colliding)


def test_room_that_leads_to_contact_is_refused_and_half_of_it_is_free() -> None:
    """The outstretched arm stands still; at 0.3 rad it would be 2 cm inside the ball."""
    scene = ball_beyond(-0.02, angle=0.3)
    checker, low, high = CollisionChecker(PLANAR, scene), 0.0, 0.3
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if checker.state_is_free([middle, 0.0]) else (low, middle)
    assert 0.1 < low < 0.3
    for side in (1.01, 0.5):
        assert tube(scene, [STILL[0], STILL[0]], [side * low, 0.0]).free == (side < 1.0)


@pytest.mark.parametrize("edges", [1, 2, 16])
def test_the_least_room_that_leads_to_contact_is_refused_wherever_on_the_way(edges: int) -> None:
    """A bent arm sweeps past a ball somewhere on its way, which it touches once its elbow is less bent."""
    rng, free, cases = np.random.default_rng(17), 0, 120
    sweep = np.linspace(-0.5, 0.5, 61)
    for _ in range(cases):
        bent, angle = rng.uniform(0.6, 2.0), rng.uniform(-0.5, 1.0)
        far = rng.uniform(1.2, 2.1)
        scene = Scene((Obstacle("ball", Sphere(0.05), Pose((far * math.cos(angle), far * math.sin(angle), 0.0))),))
        checker = CollisionChecker(PLANAR, scene)
        low, high, beside = 0.0, 0.5, np.array([[0.0, 1.0], [0.3, 0.0], [0.3, 1.0]])[rng.integers(3)]

        def clear(
            room: float, checker: CollisionChecker = checker, bent: float = bent, beside: FloatArray = beside
        ) -> bool:
            return all(
                checker.state_is_free([q + one * room * beside[0], bent + two * room * beside[1]])
                for q in sweep
                for one in (-1.0, 1.0)
                for two in (-1.0, 1.0)
            )

        if clear(high) or not clear(low):
            continue
        for _ in range(7):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if clear(middle) else (low, middle)
        line = np.column_stack([np.linspace(-0.5, 0.5, edges + 1), np.full(edges + 1, bent)])
        line = line[:: rng.choice([-1, 1])]
        ways = np.stack([line[:-1], line[1:]], axis=1)
        assert tube(scene, ways, high * beside).free < edges
        free += tube(scene, ways, 0.5 * low * beside).free == edges
    assert free > 5


@pytest.mark.parametrize("joints", [1, 2])
def test_a_turn_that_leads_to_contact_only_by_its_bend_is_refused(joints: int, tmp_path: Path) -> None:
    """A ball a metre from its axes passes a wall, along which it begins to go: it drops by 1 - cos of the turn."""
    arms = [joint("turn", "revolute base arm -3 3"), joint("more", "revolute arm hand -3 3")][:joints]
    tip = solid("sphere", 'radius="0.01"', "1 0 0")
    links = [link("base"), *([link("arm", tip)] if joints == 1 else [link("arm"), link("hand", tip)])]
    robot = built(tmp_path, urdf("ball", *links, *arms))
    gap, still = 0.03, np.zeros((1, joints))
    turn = math.acos(1.0 - gap) / joints  # of each joint
    wall = Scene((Obstacle("wall", Box((0.02, 1.0, 1.0)), Pose((0.98 - gap, 0.0, 0.0))),))
    certifier, checker = Certifier(robot, wall), CollisionChecker(robot, wall)
    for share, free in ((1.01, 0), (0.7, 1)):
        assert checker.state_is_free(np.full(joints, share * turn)) == bool(free)
        assert certifier.certify_tubes(still, still, np.full((1, joints), share * turn)).free == free


def test_the_rim_of_a_disc_that_turns_about_its_diameter_is_refused_where_it_touches(tmp_path: Path) -> None:
    """Its core, a short line on the axis, stays where it is."""
    rim = link("wheel", solid("cylinder", 'radius="0.3" length="0.02"'))
    robot = built(tmp_path, urdf("disc", link("base"), rim, joint("turn", "revolute base wheel -1 1", axis="1 0 0")))
    floor, still = Scene((Obstacle("floor", Box((1.0, 1.0, 0.02)), Pose((0.0, 0.0, -0.07))),)), np.zeros((1, 1))
    certifier, checker = Certifier(robot, floor), CollisionChecker(robot, floor)
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if checker.state_is_free([middle]) else (low, middle)
    assert 0.1 < low < 0.2
    for share, free in ((1.01, 0), (0.95, 1)):
        assert certifier.certify_tubes(still, still, np.full((1, 1), share * low)).free == free


def test_a_ball_that_turns_about_its_centre_comes_no_closer(tmp_path: Path) -> None:
    ball = link("ball", solid("sphere", 'radius="0.3"'))
    robot = built(tmp_path, urdf("ball", link("base"), ball, joint("turn", "revolute base ball -1 1")))
    wall = Scene((Obstacle("wall", Box((0.02, 1.0, 1.0)), Pose((0.315, 0.0, 0.0))),))
    assert Certifier(robot, wall).certify_tubes([[0.0]], [[0.0]], [[0.3]]).free == 1


@pytest.mark.parametrize("name", ["wxai bin", "wxai clutter", "panda shelf"])
def test_nothing_within_the_room_of_a_free_tube_touches(name: str) -> None:
    robot, scene = case(name)
    certifier, checker = Certifier(robot, scene), CollisionChecker(robot, scene, edge_step=JointStep(0.002))
    rng, free = np.random.default_rng(8), 0
    for a, b in edges_of(checker, 150, seed=9):
        b = a + 0.1 * (b - a)
        room = rng.uniform(0.0, 0.03, robot.n)
        if not certifier.certify_tubes([a], [b], room[None]).free:
            continue
        free += 1
        share, off = rng.uniform(0.0, 1.0, (50, 1)), rng.choice([-1.0, 1.0, 0.5], (50, robot.n))
        Q = np.clip(a + share * (b - a) + off * room, *robot.bounds)
        assert all(checker.state_is_free(q) for q in Q)
    assert free > 20


@pytest.mark.parametrize("text", [SLIDER, CRANE, MIXED, TWINS], ids=["slider", "crane", "mixed", "twins"])
def test_nothing_within_the_room_touches_of_arms_that_slide_branch_and_follow(text: str, tmp_path: Path) -> None:
    robot, rng, free = built(tmp_path, text), np.random.default_rng(2), 0
    for _ in range(8):
        places = rng.uniform([-1.0, -1.0, 0.0], 1.2, (5, 3)).tolist()
        scene = Scene(tuple(Obstacle(f"ball {k}", Sphere(0.08), Pose(tuple(at))) for k, at in enumerate(places)))
        certifier, checker = Certifier(robot, scene), CollisionChecker(robot, scene)
        for _ in range(25):
            a = rng.uniform(*robot.bounds)
            b, room = np.clip(a + rng.uniform(-0.1, 0.1, robot.n), *robot.bounds), rng.uniform(0.0, 0.25, robot.n)
            if certifier.certify_tubes([a], [b], room[None]).free:
                free += 1
                share, off = rng.uniform(0.0, 1.0, (2000, 1)), rng.choice([-1.0, 1.0], (2000, robot.n))
                assert checker.states_are_free(np.clip(a + share * (b - a) + off * room, *robot.bounds)).all()
    assert free > 20


def test_the_first_edge_that_is_not_free_is_named_with_its_pair_place_and_gap() -> None:
    scene = ball_beyond(-0.02)
    edges = [[[-0.5, 0.0], [-0.4, 0.0]], [[-0.4, 0.0], [0.5, 0.0]], [[-0.5, 0.0], [-0.4, 0.0]]]
    found = tube(scene, edges, 0.001)
    assert (found.free, found.collides) == (1, True)
    assert found.pair is not None
    assert set(found.pair) == {"forearm", "ball"}
    assert found.gap < 0.0
    assert not CollisionChecker(PLANAR, scene).state_is_free(found.at)


def test_an_edge_that_is_free_but_for_its_room_does_not_collide() -> None:
    bent = np.array(SWEEP) + np.array([0.0, 0.5])
    found = tube(ball_beyond(-0.02), bent, [0.0, 0.6])
    assert (found.free, found.collides) == (0, False)
    assert 0.0 < found.gap < RIM


def test_room_of_which_only_parts_can_be_proven_is_free() -> None:
    """A bent elbow brings an outstretched arm no nearer, however far it bends."""
    assert tube(ball_beyond(0.02), SWEEP, [0.0, 0.6]).free == 1
    assert tube(ball_beyond(0.02), SWEEP, [0.0, 0.6], parts=0).free == 0
    assert tube(ball_beyond(0.02), SWEEP, [0.0, 0.6], parts_each=0).free == 0
    assert tube(ball_beyond(0.02), SWEEP, [0.0, 0.6], padding=0.021).free == 0


def test_padding_is_kept_beyond_the_room() -> None:
    assert tube(ball_beyond(0.02), SWEEP, 0.0, padding=0.02 - 2 * MARGIN).free == 1
    assert tube(ball_beyond(0.02), SWEEP, 0.0, padding=0.02 + 2 * MARGIN).free == 0


@pytest.mark.parametrize(
    ("starts", "ends", "room", "field"),
    [
        (STILL, STILL, [[0.0]], "room"),
        (STILL, STILL, [[0.0, -0.1]], "room"),
        (STILL, STILL, [[0.0, np.nan]], "room"),
        (STILL, np.zeros((2, 2)), STILL, "ends"),
        (STILL + 9.0, STILL, STILL, "starts"),
        ([["a", "b"]], STILL, STILL, "starts"),
    ],
)
def test_what_makes_no_sense_is_refused(starts: Any, ends: Any, room: Any, field: str) -> None:
    with pytest.raises(InvalidRequest, match=field):
        Certifier(PLANAR, ball_beyond(0.02)).certify_tubes(starts, ends, room)


@pytest.mark.parametrize("name", ["wxai bin", "panda shelf"])
def test_a_tube_is_free_where_its_edge_keeps_all_that_its_room_can_move_anything(name: str) -> None:
    """The plain proof: of an edge with so much more padding, whatever the configuration."""
    robot, scene = case(name)
    certifier, checker = Certifier(robot, scene), CollisionChecker(robot, scene, edge_step=JointStep(0.002))
    rng, free = np.random.default_rng(4), 0
    reached = [float(np.linalg.norm(robot.tool_pose(q)[:3, 3])) for q in rng.uniform(*robot.bounds, (200, robot.n))]
    farthest = 2.0 * max(reached)
    for a, b in edges_of(checker, 150, seed=11):
        b = a + 0.3 * (b - a)
        room = rng.uniform(0.0, 0.002, robot.n)
        if certifier.certify_edge(a, b, padding=min(0.1, farthest * float(room.sum()))).free:
            free += 1
            assert certifier.certify_tubes([a], [b], room[None]).free == 1
    assert free > 20


@pytest.mark.parametrize("name", ["wxai bin", "wxai clutter", "panda shelf"])
def test_of_many_edges_as_many_are_free_as_one_by_one(name: str) -> None:
    robot, scene = case(name)
    certifier, checker = Certifier(robot, scene), CollisionChecker(robot, scene, edge_step=JointStep(0.002))
    rng, cut = np.random.default_rng(6), 0
    for a, b in edges_of(checker, 150, seed=12):
        line = a + np.linspace(0.0, 1.0, 33)[:, None] * (b - a)
        line = np.clip(line + rng.uniform(-0.02, 0.02, line.shape), *robot.bounds)
        room = rng.uniform(0.0, 0.06, (32, robot.n))

        def proven(rows: slice, line: FloatArray = line, room: FloatArray = room) -> int:
            return certifier.certify_tubes(line[:-1][rows], line[1:][rows], room[rows], parts=10_000).free

        alone, found = [proven(slice(k, k + 1)) for k in range(32)], proven(slice(32))
        assert found == (alone.index(0) if 0 in alone else 32)
        cut += 0 < found < 32
    assert cut > 3

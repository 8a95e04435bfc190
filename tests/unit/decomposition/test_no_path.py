"""A proof that no path exists is right: its walls collide, and where a plan is known there is none."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import Box, Cylinder, Obstacle, PlannerService, PlanRequest, Pose, Scene, Sphere
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.infeasibility import NoPath, prove_no_path
from planner_service.robot_setup.loading import load_robot
from tests.support.small_robots import built, joint, link, solid, urdf

ARM = load_robot("planar2")

SPINNER = urdf(
    "spinner",
    link("foot", solid("sphere", 'radius="0.05"')) + link("bar", solid("box", "0.6 0.04 0.04", "0.3 0 0")),
    joint("spin", "continuous foot bar", xyz="0 0 0.2"),
)
"""A bar that turns without end: one post in its way leaves the other way round."""


def disc(name: str, x: float, y: float, radius: float = 0.1) -> Obstacle:
    return Obstacle(name, Cylinder(radius, 0.2), Pose((x, y, 0.0)))


def world(seed: int) -> tuple[Scene, list[float], list[float]]:
    """Random discs around the planar arm, and two free configurations."""
    chance = random.Random(seed)
    scene = Scene(
        tuple(
            disc(f"disc_{k}", chance.uniform(-1.5, 1.5), chance.uniform(-1.5, 1.5), chance.uniform(0.05, 0.25))
            for k in range(chance.randrange(3, 9))
        )
    )
    checker, ends = CollisionChecker(ARM, scene), list[list[float]]()
    while len(ends) < 2:
        q = [chance.uniform(-3.14, 3.14) for _ in range(2)]
        if checker.state_is_free(q):
            ends.append(q)
    return scene, ends[0], ends[1]


def test_discs_before_and_behind_the_arm_enclose_it() -> None:
    scene = Scene((disc("left", 0.5, 0.5), disc("right", 0.5, -0.5)))
    proof = prove_no_path(ARM, scene, [0.0, 0.0], [[3.0, 0.0]])
    assert isinstance(proof, NoPath)
    assert proof.joints == (ARM.joint_names[0],)  # the other one is of no help
    assert "left" in {name for pair in proof.pairs for name in pair}
    assert "no path exists: " in str(proof)
    assert prove_no_path(ARM, scene, [0.0, 0.0], [[3.0, 0.0], [0.2, 0.1]]) is None


@pytest.mark.parametrize("name", ["crate", "link_2"])
def test_an_object_called_like_a_link_closes_no_fixed_way_out(name: str) -> None:
    """Folded, the arm's links touch, which its way out allows."""
    arm, scene = load_robot("wxai"), Scene((Obstacle(name, Box((0.1, 0.1, 0.1)), Pose((2.0, 2.0, 0.1))),))
    assert PlannerService(arm, scene).plan(PlanRequest(arm.pose("sleep"), arm.home)).ok
    assert prove_no_path(arm, scene, arm.pose("sleep"), [arm.home]) is None


def test_it_gives_up_after_so_many_pairs_of_solids(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene((disc("left", 0.5, 0.5), disc("right", 0.5, -0.5)))
    asked = list[int]()
    assert prove_no_path(ARM, scene, [0.0, 0.0], [[3.0, 0.0]], charge=asked.append) is not None
    monkeypatch.setattr("planner_service.decomposition.no_path.MOST_JUDGED", sum(asked) // 4)
    fewer = list[int]()
    assert prove_no_path(ARM, scene, [0.0, 0.0], [[3.0, 0.0]], charge=fewer.append) is None
    assert sum(fewer) < sum(asked)


@pytest.mark.parametrize("seed", range(12))
def test_a_world_is_planned_or_proven_impossible_and_never_both(seed: int) -> None:
    scene, start, goal = world(seed)
    planned = PlannerService(ARM, scene).plan(PlanRequest(start, goal, time_limit=None, max_checks=5_000)).ok
    proof = prove_no_path(ARM, scene, start, [goal])
    assert planned == (proof is None)
    if proof is not None:
        checker, rng = CollisionChecker(ARM, scene), np.random.default_rng(seed)
        rows = rng.integers(len(proof.lower), size=20)
        for row, share in zip(rows.tolist(), rng.random((20, len(proof.joints))), strict=True):
            q = np.array(start)
            columns = [ARM.joint_names.index(name) for name in proof.joints]
            q[columns] = proof.lower[row] + share * (proof.upper[row] - proof.lower[row])
            q[[k for k in range(ARM.n) if k not in columns]] = rng.uniform(-3.0, 3.0)
            assert not checker.state_is_free(q)
            names = [frozenset((contact.a, contact.b)) for contact in checker.contacts(q)]
            assert frozenset(proof.pairs[proof.wall_pairs[row]]) in names


@pytest.mark.parametrize("shape", [Box((0.1, 0.1, 0.3)), Sphere(0.08)])
def test_a_joint_without_end_goes_the_other_way_round(tmp_path: Path, shape: Box | Sphere | Cylinder) -> None:
    robot = built(tmp_path, SPINNER)
    one = Scene((Obstacle("post", shape, Pose((0.0, 0.4, 0.2))),))
    both = Scene((*one.obstacles, Obstacle("other", shape, Pose((0.0, -0.4, 0.2)))))
    for turn in (0.0, 2.0 * np.pi, -4.0 * np.pi):
        assert prove_no_path(robot, one, [0.0], [[3.0 + turn]]) is None
        assert prove_no_path(robot, both, [0.0], [[3.0 + turn]]) is not None
        assert prove_no_path(robot, both, [0.0], [[0.2 + turn]]) is None


def test_a_corner_that_barely_overlaps_is_a_wall() -> None:
    """Where a link of flat boxes turns into the corner of a box by 4 mm, which no ball as thick as they are shows."""
    pose = Pose((-0.0865, 0.2069, 0.1072), (-0.4188, -0.0827, -0.5662, 0.7051))
    scene = Scene((Obstacle("box", Box((0.1725, 0.3444, 0.2878)), pose),))
    start, goal = [0.068, 2.066, 1.526, 0.251, -0.449, 0.586], [-2.483, 1.71, 1.856, 0.876, -1.472, -3.071]
    checker = CollisionChecker(load_robot("wxai"), scene)
    assert checker.state_is_free(start)
    assert checker.state_is_free(goal)
    depths = [
        c.depth for q in ([1.19, *start[1:]], [-0.26, *start[1:]]) for c in checker.contacts(q) if c.a == "link_1"
    ]
    assert 0.0 < min(depths) < max(depths) < 0.006
    proof = prove_no_path(checker.robot, scene, start, [goal])
    assert proof is not None
    assert proof.joints == ("joint_0",)


def test_pairs_that_may_touch_are_no_walls() -> None:
    scene = Scene((disc("left", 0.5, 0.5), disc("right", 0.5, -0.5)))
    links = sorted({item.link for item in ARM.shapes})
    allowed = [(link, "left") for link in links]
    assert prove_no_path(ARM, scene, [0.0, 0.0], [[3.0, 0.0]], allowed=allowed) is None


def test_it_ends_by_boxes_and_tells_what_it_asked_before() -> None:
    scene = Scene((disc("left", 0.5, 0.5), disc("right", 0.5, -0.5)))
    told: list[int] = []
    proof = prove_no_path(ARM, scene, [0.0, 0.0], [[3.0, 0.0]], charge=told.append)
    assert proof is not None
    assert sum(told) == proof.distances
    assert prove_no_path(ARM, scene, [0.0, 0.0], [[3.0, 0.0]], max_boxes=10) is None

    def end(_: int) -> None:
        raise TimeoutError

    with pytest.raises(TimeoutError):
        prove_no_path(ARM, scene, [0.0, 0.0], [[3.0, 0.0]], charge=end)


def test_bad_input_is_refused() -> None:
    scene = Scene()
    with pytest.raises(InvalidRequest, match="start"):
        prove_no_path(ARM, scene, [0.0], [[1.0, 0.0]])
    with pytest.raises(InvalidRequest, match=r"goals\[0\]"):
        prove_no_path(ARM, scene, [0.0, 0.0], [[float("nan"), 0.0]])
    with pytest.raises(InvalidRequest, match="max_boxes"):
        prove_no_path(ARM, scene, [0.0, 0.0], [[1.0, 0.0]], max_boxes=0)
    with pytest.raises(UnknownName):
        prove_no_path(ARM, scene, [0.0, 0.0], [[1.0, 0.0]], allowed=[("forearm", "nothing")])


def covered(proof: NoPath, corners: Any, axis: int, side: int) -> bool:
    """Whether a face of a box is covered by boxes of the region and walls beside it."""
    beside = np.concatenate([proof.region_cells, proof.wall_cells])
    face = corners[side, axis]
    if face == (0, proof.divisions[axis])[side]:
        return True
    rest = [k for k in range(len(proof.joints)) if k != axis]
    low, high = np.maximum(beside[:, 0], corners[0]), np.minimum(beside[:, 1], corners[1])
    shared = np.prod(np.maximum(high - low, 0)[:, rest], axis=1)
    return bool(shared[beside[:, 1 - side, axis] == face].sum() == np.prod((corners[1] - corners[0])[rest]))


@pytest.mark.parametrize("distance", [0.12, 0.13])
def test_a_forearm_between_two_discs_is_enclosed_in_a_closed_region(distance: float) -> None:
    scene, start, goal = Scene((disc("left", 1.25, distance), disc("right", 1.25, -distance))), [0.0, 0.0], [2.0, 0.0]
    proof = prove_no_path(ARM, scene, start, [goal], max_boxes=10_000)
    assert proof is not None
    assert proof.joints == ARM.joint_names
    assert proof.encloses == "start"
    unit = (proof.range_upper - proof.range_lower) / proof.divisions
    places = [(np.array(end) - proof.range_lower) / unit for end in (start, goal)]
    low, high = proof.region_cells[:, 0], proof.region_cells[:, 1]
    assert [((low <= q) & (q <= high)).all(axis=1).any() for q in places] == [True, False]
    for corners in proof.region_cells:
        assert all(covered(proof, corners, axis, side) for axis in range(ARM.n) for side in (0, 1))

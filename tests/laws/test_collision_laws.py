"""Laws of the collision checker: its verdicts against two others, its bounds against the distances they bound.

The first judge asks python-fcl about every pair, one by one, with poses from Pinocchio: no prefilter, no batch, no
kinematics of ours. The second, ``auditor.checker``, reads all files itself and asks Coal.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import fcl
import numpy as np
import pinocchio as pin
import pytest

from auditor.checker import IndependentChecker, tables_of
from planner_service.collision import CollisionChecker, backends
from planner_service.collision.edge_sampling import EdgeStep
from planner_service.collision.native_kernel import build_kernel
from planner_service.collision.pairs import PairRuns, Parts
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Compound, HeightField, PointCloud
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Attached, Obstacle, Scene
from tests.support.hull_arm import HELD, HullSetup

ROOT = Path(__file__).parents[2]
FINGERS = ("finger_left", "finger_right")
CONTACT = 2e-6
"""Metres: closer to contact than this the answer of FCL, and of Coal, is undefined (both miss touching shapes)."""

BLOCK = Attached("block", Box((0.045, 0.045, 0.045)), Pose((0.01, 0.0, 0.0)), FINGERS)
ROD = Attached(
    "rod", Capsule(0.01, 0.16), Pose.from_rpy((0.005, 0.0, 0.02), (0.0, math.pi / 2, 0.0)), (*FINGERS, "link_6")
)
ROUND = (
    Obstacle("ball", Sphere(0.07), Pose((0.25, 0.15, 0.2))),
    Obstacle("bar", Capsule(0.03, 0.3), Pose.from_rpy((0.3, -0.1, 0.25), (0.7, 0.4, 0.1))),
    Obstacle("pipe", Cylinder(0.04, 0.3), Pose.from_rpy((0.2, -0.25, 0.2), (1.2, -0.3, 0.5))),
    Obstacle("crate", Box((0.1, 0.12, 0.2)), Pose.from_rpy((0.1, 0.3, 0.15), (0.3, 0.2, 1.0))),
)


ROUGH = np.random.default_rng(0)
"""Numbers of no meaning."""

CLOUD = Obstacle(  # a bumpy sheet of 400 points that stands askew, in 200 and some boxes
    "cloud",
    PointCloud(ROUGH.uniform([0.0, -0.2, -0.01], [0.02, 0.2, 0.4], (400, 3)), 0.02),
    Pose.from_rpy((0.3, 0.0, 0.05), (0.2, 0.1, 0.3)),
)
FIELD = Obstacle("field", HeightField(ROUGH.uniform(-0.05, 0.15, (14, 14)), 0.03), Pose((0.15, -0.45, 0.0)))
STOOL = Compound(
    (
        (Box((0.2, 0.2, 0.02)), Pose((0.0, 0.0, 0.2))),
        (Cylinder(0.01, 0.2), Pose((0.08, 0.08, 0.1))),
        (Capsule(0.01, 0.2), Pose.from_rpy((-0.08, 0.0, 0.1), (0.1, 0.2, 0.3))),
    )
)
FORK = Attached(
    "fork",
    Compound(
        tuple((Capsule(0.004, 0.06), Pose.from_rpy((0.04, y, 0.0), (0.0, 1.57, 0.0))) for y in (-0.02, 0.0, 0.02))
    ),
    Pose((0.02, 0.0, 0.0)),
    FINGERS,
)


@dataclass(frozen=True, eq=False)
class Setup:
    """A robot in a scene, and how it is to be judged."""

    name: str
    scene: str
    obstacles: tuple[Obstacle, ...] = ()
    attached: tuple[Attached, ...] = ()
    allowed: tuple[tuple[str, str], ...] = ()
    padding: float = 0.0
    width: float = 0.08

    def checker(self, step: EdgeStep | None = None) -> CollisionChecker:
        scene, robot = self.whole_scene(), load_robot("wxai").with_gripper(self.width)
        return CollisionChecker(robot, scene, edge_step=step, padding=self.padding, allowed=self.allowed)

    def whole_scene(self) -> Scene:
        there = load_scene(self.scene)
        return Scene((*there.obstacles, *self.obstacles), self.attached)

    def independent(self) -> IndependentChecker:
        plain = not (self.obstacles or self.attached)
        scene: Any = ROOT / "scenes" / f"{self.scene}.toml" if plain else tables_of(self.whole_scene())
        return IndependentChecker(
            ROOT / "robots" / "wxai", scene, gripper_width=self.width, allowed=self.allowed, padding=self.padding
        )


SETUPS = (
    *(Setup(name, name) for name in ("bin", "shelf", "post", "clutter", "narrow", "window")),
    Setup("round", "table", obstacles=ROUND),
    Setup("padded bin", "bin", padding=0.010),
    Setup("padded round", "table", obstacles=ROUND, padding=0.004),
    Setup("block in bin", "bin", attached=(BLOCK,), width=0.046),
    Setup("rod in shelf", "shelf", attached=(ROD,), width=0.02),
    Setup("padded rod in window", "window", attached=(ROD,), padding=0.002),
    Setup("allowed", "narrow", allowed=(("wall_left", "link_6"), ("link_5", "link_2"), ("finger_left", "wall_left"))),
    Setup("cloud", "table", obstacles=(CLOUD,)),
    Setup("cloud and field around a rod", "table", obstacles=(FIELD, CLOUD), attached=(ROD,), width=0.02),
    Setup("padded stool", "table", obstacles=(Obstacle("stool", STOOL, Pose((0.25, 0.1, 0.0))),), padding=0.004),
    Setup(
        "fork between stools", "table", obstacles=(Obstacle("stool", STOOL, Pose((0.3, 0.2, 0.0))),), attached=(FORK,)
    ),
    Setup("closed gripper", "clutter", width=0.0),
)
HULLS: dict[str, tuple[Attached, ...]] = {"hulls": (), "hulls with a spoon": (HELD,)}


@pytest.fixture(params=[*(setup.name for setup in SETUPS), *HULLS])
def setup(request: pytest.FixtureRequest, folder: Path) -> Setup | HullSetup:
    """Every robot and scene above, and an arm of hulls."""
    if request.param in HULLS:
        return HullSetup(request.param, folder, attached=HULLS[request.param])
    return next(setup for setup in SETUPS if setup.name == request.param)


class PairLoop:
    """Every pair of a checker, asked of python-fcl one by one; poses from Pinocchio."""

    def __init__(self, checker: CollisionChecker, model: Any) -> None:
        parts = checker._parts
        self._model, self._data = model, model.createData()
        self._objects = [fcl.CollisionObject(_geometry(shape)) for shape in parts.shapes]
        self._pairs = list(parts.pairs)
        self._riding = []
        for part, thing in zip(parts.parts, self._objects, strict=True):
            if part.body > 0:
                joint = model.getJointId(checker.robot.bodies[part.body].name)
                self._riding.append((thing, joint, pin.SE3(np.array(part.T))))
            else:
                thing.setTransform(fcl.Transform(part.T[:3, :3], part.T[:3, 3]))
        self._request, self._result = fcl.CollisionRequest(), fcl.CollisionResult()

    def free(self, q: FloatArray) -> bool:
        pin.forwardKinematics(self._model, self._data, q)
        for thing, joint, local in self._riding:
            T = self._data.oMi[joint] * local
            thing.setTransform(fcl.Transform(T.rotation, T.translation))
        for i, j in self._pairs:
            if fcl.collide(self._objects[i], self._objects[j], self._request, self._result):
                self._result = fcl.CollisionResult()
                return False
        return True


def _geometry(shape: Shape) -> Any:
    if isinstance(shape, Box):
        return fcl.Box(*shape.size)
    if isinstance(shape, Sphere):
        return fcl.Sphere(shape.radius)
    if isinstance(shape, Mesh):
        return fcl.Convex(
            shape.vertices, len(shape.faces), np.insert(shape.faces, 0, 3, axis=1).astype(np.int32).ravel()
        )
    assert isinstance(shape, (Cylinder, Capsule))
    return (fcl.Cylinder if isinstance(shape, Cylinder) else fcl.Capsule)(shape.radius, shape.length)


def anywhere(robot: Robot, rng: np.random.Generator, count: int) -> FloatArray:
    return rng.uniform(robot.limits.lower, robot.limits.upper, (count, robot.n))


def planner_like(
    robot: Robot, is_free: Callable[[FloatArray], bool], rng: np.random.Generator, count: int
) -> Iterator[FloatArray]:
    """Samples of short edges of a random walk that only ever leaves from free states, as a growing tree does."""
    q, made = np.array(robot.home), 0
    while made < count:
        target = anywhere(robot, rng, 1)[0]
        step = (target - q) * min(1.0, 0.3 / math.dist(target, q))
        for fraction in np.linspace(0.0, 1.0, 5)[1:]:
            made += 1
            yield q + step * fraction
        if is_free(q + step):
            q = q + step
        if rng.random() < 0.02:  # start over, or a walk may stay in one corner
            q = np.array(robot.home)


def near_contact(
    robot: Robot, is_free: Callable[[FloatArray], bool], rng: np.random.Generator, count: int
) -> Iterator[FloatArray]:
    """States from 10 um to 2 mm of motion to either side of where free turns into colliding."""
    reach = robot.reach()
    made = 0
    while made < count:
        free, hit = anywhere(robot, rng, 2)
        if is_free(free) == is_free(hit):
            continue
        if not is_free(free):
            free, hit = hit, free
        way = (hit - free) / float((reach * np.abs(hit - free)).sum())  # per metre of motion
        low, high = 0.0, float((reach * np.abs(hit - free)).sum())
        while high - low > 1e-6:
            middle = (low + high) / 2
            low, high = (middle, high) if is_free(free + way * middle) else (low, middle)
        for off in 10.0 ** rng.uniform(-5.0, -2.7, 6):
            for side in (low - off, high + off):
                q = free + way * side
                if (q >= robot.limits.lower).all() and (q <= robot.limits.upper).all():
                    made += 1
                    yield q


@dataclass
class Comparison:
    """How often three judges were asked, and where they differed beyond what contact leaves undefined."""

    states: int = 0
    free: int = 0
    unlike_fcl: int = 0
    at_contact: int = 0
    differing: list[tuple[str, FloatArray]] = field(default_factory=list)


def compare(setup: Setup | HullSetup, count: int, seed: int) -> Comparison:
    """Ask all three about ``count`` states of each kind."""
    checker, second = setup.checker(), setup.independent()
    first = PairLoop(checker, second.model)
    rng = np.random.default_rng(seed)
    found = Comparison()
    robot = checker.robot
    for states in (
        anywhere(robot, rng, count),
        planner_like(robot, second.free, rng, count),
        near_contact(robot, second.free, rng, count),
    ):
        for q in states:
            ours, theirs = checker.state_is_free(q), (first.free(q), second.free(q))
            found.states += 1
            found.free += ours
            found.unlike_fcl += ours != theirs[0]
            if theirs == (ours, ours):
                continue
            if abs(min(second.gaps(q).values())) <= CONTACT:
                found.at_contact += 1
            else:
                found.differing.append((f"ours {ours}, fcl pair by pair {theirs[0]}, Coal {theirs[1]}", q))
    return found


def test_a_verdict_is_that_of_fcl_pair_by_pair_and_of_coal(setup: Setup | HullSetup) -> None:
    found = compare(setup, 120, seed=3)
    assert found.differing == []
    assert found.unlike_fcl == 0  # not even at contact: whatever FCL says there is repeated
    assert 0 < found.free < found.states
    assert found.at_contact <= found.states / 100


def test_both_checkers_judge_the_same_pairs(setup: Setup | HullSetup) -> None:
    checker, second = setup.checker(), setup.independent()
    ours = Counter(frozenset(checker.pair_names(k)) for k in range(checker.pair_count))
    obstacles = setup.obstacles
    clouds = {o.name: len(o.shape.pieces.shapes) for o in obstacles if isinstance(o.shape, PointCloud)}
    for name, boxes in clouds.items():  # an octree is one thing to Coal
        for pair in (pair for pair in ours if name in pair):
            each, rest = divmod(ours[pair], boxes)
            ours[pair] = each + rest
    theirs = Counter(frozenset(pair) for pair in second.pairs)
    if not any(isinstance(o.shape, HeightField) for o in obstacles):  # whose columns Coal has one by one
        assert ours == theirs
    assert set(ours) == set(theirs)


def test_the_comparison_notices_a_kernel_that_lets_three_millimetres_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "build_kernel", partial(build_kernel, margin=-0.003))
    assert compare(SETUPS[0], 60, seed=3).differing


def test_the_comparison_notices_a_pair_that_is_not_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Parts._pairs

    def without_one(parts: Parts) -> Any:
        pairs = list(whole(parts))
        names = [{parts.parts[i].owner.name, parts.parts[j].owner.name} for i, j in pairs]
        del pairs[max(k for k, pair in enumerate(names) if pair == {"finger_left", "table"})]
        return PairRuns(np.array([(k, i, j) for k, (i, j) in enumerate(pairs)]), len(pairs))

    monkeypatch.setattr(Parts, "_pairs", without_one)
    assert compare(SETUPS[4], 250, seed=3).differing


def test_the_comparison_notices_a_link_frame_that_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Robot.body_poses

    def displaced(robot: Robot, q: Any) -> Any:
        poses = whole(robot, q)
        poses[6] = (*poses[6][:11], poses[6][11] + 0.001)
        return poses

    monkeypatch.setattr(Robot, "body_poses", displaced)
    assert compare(SETUPS[0], 60, seed=3).differing


def test_clearance_is_a_bound_of_the_distance_and_close_to_it(setup: Setup | HullSetup) -> None:
    checker, second = setup.checker(), setup.independent()
    rng = np.random.default_rng(11)
    missing = []
    for q in planner_like(checker.robot, second.free, rng, 16):
        distance, bound = min(second.gaps(q).values()), checker.clearance(q)
        if distance > 0.0:
            assert bound <= distance + 1e-5  # Coal is right to about a micrometre
            missing.append(distance - bound)
        else:
            assert bound <= CONTACT
    assert len(missing) >= 5
    assert np.median(missing) <= 1e-4
    assert max(missing) <= 0.001


def test_contacts_name_the_pairs_that_coal_finds_and_bound_their_depth(setup: Setup | HullSetup) -> None:
    checker, second = setup.checker(), setup.independent()
    rng = np.random.default_rng(13)
    compared = 0
    for q in anywhere(checker.robot, rng, 30):
        gaps = {frozenset(pair): gap for pair, gap in second.gaps(q).items()}
        if min(abs(gap) for gap in gaps.values()) <= CONTACT:
            continue
        contacts = checker.contacts(q)
        assert {frozenset((c.a, c.b)) for c in contacts} == {pair for pair, gap in gaps.items() if gap < 0.0}
        assert [c.depth for c in contacts] == sorted((c.depth for c in contacts), reverse=True)
        for contact in contacts:
            assert contact.depth >= -gaps[frozenset((contact.a, contact.b))] - 1e-5
            compared += 1
    assert compared >= 10

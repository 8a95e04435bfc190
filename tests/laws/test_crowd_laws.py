"""Laws of obstacles of many pieces: looked at as boxes around some of them, they are what their pieces are one by one.

The second opinion is the same code without any such box, which other laws hold against FCL and Coal.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from planner_service.certify import Certifier, ExemptInterval, Refusal, Trail, pairs
from planner_service.collision import CollisionChecker, MotionStep
from planner_service.collision import pairs as parts
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Composite, Compound, HeightField, PointCloud
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Attached, Obstacle, Scene

REACH = {"wxai": 0.6, "planar2": 1.0, "ur5": 0.8, "panda_mbm": 0.8}
"""Metres."""


@contextmanager
def one_by_one() -> Iterator[None]:
    """No obstacle has so many pieces that they are looked at together."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parts, "MANY", 10**9)
        patch.setattr(pairs, "MANY", 10**9)
        yield


def turned(rng: np.random.Generator, spread: float) -> Pose:
    x, y, z = rng.uniform(-spread, spread, 3).tolist()
    a, b, c = rng.uniform(-3.0, 3.0, 3).tolist()
    return Pose.from_rpy((x, y, z), (a, b, c))


def shape(rng: np.random.Generator, size: float) -> Shape:
    """One of five kinds; a hull has its frame outside of it."""
    kind = int(rng.integers(5))
    a, b = (rng.uniform(0.2, 1.0, 2) * size).tolist()
    if kind == 0:
        return Box((a, b, size))
    if kind == 1:
        return Sphere(a)
    if kind == 2:
        return Cylinder(a, 3.0 * b)
    if kind == 3:
        return Capsule(a, 3.0 * b)
    return Mesh(rng.normal(0.0, 0.6, (12, 3)) * size + rng.uniform(-2.0, 2.0, 3) * size)


def composite(rng: np.random.Generator, kind: int, size: float) -> Composite:
    if kind == 0:
        box = rng.uniform(0.1, 1.0, 3) * size
        return PointCloud(rng.uniform(-box, box, (int(rng.integers(150, 400)), 3)), 0.08 * size)
    if kind == 1:
        return HeightField(rng.uniform(-0.3, 0.6, rng.integers(9, 20, 2)) * size, 0.1 * size, -0.3 * size)
    return Compound(tuple((shape(rng, 0.1 * size), turned(rng, size)) for _ in range(int(rng.integers(66, 90)))))


class Crowded:
    """A robot among one to three crowds and two other obstacles, maybe carrying something, some contacts allowed."""

    def __init__(self, name: str, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.robot: Robot = load_robot(name)
        reach = REACH[name]
        standing = []
        for k in range(3 + seed % 3):
            size = rng.uniform(0.1, 0.25) * reach
            solid = shape(rng, 0.5 * size) if k in (0, 2) else composite(rng, (seed + k) % 3, size)
            way = rng.normal(size=3)
            x, y, z = (way / math.sqrt(float((way * way).sum())) * reach * rng.uniform(0.4, 0.9)).tolist()
            standing.append(Obstacle(f"o{k}", solid, Pose((x, y, z)) @ turned(rng, 0.02)))
        links = sorted({s.link for s in self.robot.shapes})
        hand = tuple(sorted({s.link for s in self.robot.shapes if s.body == self.robot.tool_body}))
        held = Compound(tuple((shape(rng, 0.01), turned(rng, 0.04)) for _ in range(1 if seed % 4 == 1 else 9)))
        carried = [Attached("held", held, turned(rng, 0.05), hand)] if seed % 2 else []
        self.scene = Scene(tuple(standing), tuple(carried))
        names = [*links, *self.scene.names]
        chosen = [rng.choice(names, 2, replace=False).tolist() for _ in range(4)]
        chosen += [(link, "o1") for link in links if rng.random() < 0.3]
        self.allowed = tuple((str(a), str(b)) for a, b in chosen)
        self.padding = (0.0, 0.001, 0.005)[seed % 3]
        self.rng = rng

    def checker(self, padding: float | None = None) -> CollisionChecker:
        return CollisionChecker(
            self.robot,
            self.scene,
            padding=self.padding if padding is None else padding,
            allowed=self.allowed,
            edge_step=MotionStep(0.004),
        )

    def anywhere(self) -> FloatArray:
        return self.rng.uniform(self.robot.limits.lower, self.robot.limits.upper)


SETUPS = [("planar2", 1), ("ur5", 2), ("wxai", 4)]


@pytest.mark.parametrize(("name", "seed"), SETUPS)
def test_a_crowd_is_judged_as_its_pieces_one_by_one(name: str, seed: int) -> None:
    setup = Crowded(name, seed)
    checker = setup.checker()
    with one_by_one():
        plain = setup.checker()
    assert checker._parts.crowds
    assert not plain._parts.crowds
    assert np.array_equal(checker._parts.pairs.every(), plain._parts.pairs.every())
    for turn in range(16):
        q, other = setup.anywhere(), setup.anywhere()
        assert checker.contacts(q) == plain.contacts(q)
        if turn % 4 == 0:
            assert checker.clearance(q) == pytest.approx(plain.clearance(q), abs=2e-9)
        other = q + (other - q) * min(1.0, 0.8 / math.dist(q, other))
        assert checker.edge_hit(q, other) == plain.edge_hit(q, other)
    assert checker.counts == plain.counts


def short_paths(setup: Crowded, checker: CollisionChecker, count: int) -> Iterator[FloatArray]:
    """Short straight ways between free ends, many of them close to what they nearly hit, or hit."""
    while count:
        q, other = setup.anywhere(), setup.anywhere()
        if not checker.state_is_free(q):
            continue
        other = q + (other - q) * min(1.0, 0.5 / math.dist(q, other))
        hit = checker.edge_hit(q, other)
        if hit is not None and count % 4:
            other = q + (other - q) * (0.97 * hit.fraction)
        if checker.state_is_free(other):
            count -= 1
            yield np.array([q, other])


@pytest.mark.parametrize(("name", "seed"), SETUPS)
def test_a_proof_about_bundles_is_one_about_their_pieces(name: str, seed: int) -> None:
    setup = Crowded(name, seed)
    bundled = Certifier(setup.robot, setup.scene, allowed=setup.allowed)
    with one_by_one():
        plain = Certifier(setup.robot, setup.scene, allowed=setup.allowed)
        checker = setup.checker()
        bare = setup.checker(padding=0.0)
    assert len(bundled.listed) > bundled.listed.judged == plain.listed.judged == len(plain.listed)
    mine, theirs = (sorted(each.listed.of(each.listed.leaves()).tolist()) for each in (bundled, plain))
    assert mine == theirs
    for path in short_paths(setup, checker, 8):
        length = math.dist(*path)
        names = setup.rng.choice(sorted(bundled.listed.owners), (2, 2), replace=False).tolist()
        part = ExemptInterval(0.0, 0.6 * length, tuple((a, b) for a, b in names), "")
        for exempt in ((), (part,)):
            one = bundled.certify(path, padding=setup.padding, exempt=exempt)
            two = plain.certify(path, padding=setup.padding, exempt=exempt)
            assert one.certified == two.certified
            if not one.certified:
                assert one.refusal is not None
                continue
            assert min(one.clearance, 0.1) >= 0.8 * min(two.clearance, 0.1)
            if not exempt:
                assert checker.edge_is_free(*path)
                for q in path[0] + setup.rng.random((10, 1)) * (path[1] - path[0]):
                    assert bare.clearance(q) >= one.clearance - 1e-9


def among_many(name: str, seed: int) -> Crowded:
    """The same among 70 to 200 small obstacles of all kinds, some of which may be touched, and a large one."""
    setup = Crowded(name, seed)
    rng, reach = np.random.default_rng(seed), REACH[name]
    small = list[Obstacle]()
    for k in range(int(rng.integers(70, 200))):
        solid = shape(rng, 0.03 * reach)
        parts = ((solid, Pose()), (shape(rng, 0.02 * reach), turned(rng, 0.04 * reach)))
        way = rng.normal(size=3)
        place = way / math.sqrt(float((way * way).sum())) * reach * rng.uniform(0.5, 2.5)
        small.append(Obstacle(f"small {k}", Compound(parts) if k % 9 == 0 else solid, Pose(tuple(place.tolist()))))
    floor = Obstacle("floor", Box((4.0 * reach, 4.0 * reach, 0.1)), Pose((0.0, 0.0, -1.2 * reach)))
    setup.scene = Scene((*setup.scene.obstacles[:1], *small, floor), setup.scene.attached)
    links = sorted({s.link for s in setup.robot.shapes})
    setup.allowed = tuple((str(rng.choice(links)), f"small {k}") for k in rng.choice(60, 5, replace=False))
    return setup


@pytest.mark.parametrize(("name", "seed"), SETUPS)
def test_a_proof_about_many_obstacles_is_one_about_each(name: str, seed: int) -> None:
    setup = among_many(name, seed)
    together = Certifier(setup.robot, setup.scene, allowed=setup.allowed)
    with one_by_one():
        plain = Certifier(setup.robot, setup.scene, allowed=setup.allowed)
        checker = setup.checker()
    assert len(together.listed.crowd) > 60
    judged = [Counter(map(each.listed.names, each.listed.leaves().tolist())) for each in (together, plain)]
    assert judged[0] == judged[1]
    assert np.array_equal(np.sort(together.listed.numbers), plain.listed.numbers)
    for path in short_paths(setup, checker, 8):
        near = sorted(together.overlaps(path[:1] + 0.03 * setup.rng.normal(size=(1, setup.robot.n)))[0])
        names = [*setup.rng.choice(sorted(together.listed.owners), (2, 2), replace=False).tolist(), *near[:3]]
        names += [(link, f"small {k}") for k, link in enumerate({s.link for s in setup.robot.shapes})]
        length = math.dist(*path)
        for part in ((), (ExemptInterval(0.0, 0.6 * length, tuple((a, b) for a, b in names), ""),)):
            one = together.certify(path, padding=setup.padding, exempt=part)
            two = plain.certify(path, padding=setup.padding, exempt=part)
            assert one.certified == two.certified
            if one.certified:
                assert min(one.clearance, 0.1) >= 0.8 * min(two.clearance, 0.1)
            else:
                assert isinstance(one.refusal, Refusal)
                assert (one.refusal.a, one.refusal.b) in judged[0]
        trail = Trail()
        one, two = together.certify(path, trail=trail), plain.certify(path, trail=(other := Trail()))
        assert (one.certified, len(trail.leaves) > 0) == (two.certified, len(other.leaves) > 0)


def test_names_of_one_obstacle_in_a_crowd_open_no_more_than_its_bundles() -> None:
    setup = among_many("wxai", 0)
    listed = Certifier(setup.robot, setup.scene).listed
    leaves = listed.leaves().tolist()
    in_crowd = {k for k in leaves if int(listed.of(np.array([k]))[0, 1]) in listed.crowd}
    pair = min(in_crowd)
    roots = set(listed.opened([frozenset(listed.names(pair))]).tolist())
    assert pair in roots
    assert len(roots) < len(listed.roots) + 4 * 8


def test_the_run_of_a_pair_has_the_pieces_of_all_pairs_that_it_stands_for() -> None:
    setup = among_many("wxai", 0)
    listed = Certifier(setup.robot, setup.scene).listed
    held = Counter[tuple[int, int]]()
    for rider, first, many in listed.runs(listed.roots).tolist():
        held.update((rider, piece) for piece in range(first, first + many))
    assert held == Counter(map(tuple, listed.of(listed.leaves()).tolist()))
    assert listed.runs(listed.leaves())[:, 2].max() == 1


def test_to_exempt_one_obstacle_exempts_none_of_its_bundle() -> None:
    setup = among_many("wxai", 0)
    checker = setup.checker()
    for path in short_paths(setup, checker, 6):
        middle = tuple(setup.robot.tool_pose(0.5 * (path[0] + path[1]))[:3, 3].tolist())
        scene = Scene((*setup.scene.obstacles, Obstacle("hit", Sphere(0.05), Pose(middle))), setup.scene.attached)
        certifier = Certifier(setup.robot, scene)
        listed = certifier.listed
        firsts = {listed.names(k) for k in range(len(listed)) if listed.is_crowd(k)}
        others = tuple((a, b) for a, b in firsts if "hit" not in (a, b))
        exempt = [ExemptInterval(0.0, math.dist(*path), others, "")]
        assert (certifier.certify(path).certified, certifier.certify(path, exempt=exempt).certified) == (False, False)


def cloud(x: float) -> Obstacle:
    points = np.random.default_rng(7).uniform(-0.1, 0.1, (300, 3))
    return Obstacle("cloud", PointCloud(points, 0.02), Pose((x, 0.0, 0.2)))


@pytest.mark.parametrize("lists", [CollisionChecker, Certifier])
def test_more_pairs_than_memory_holds_are_refused(lists: type, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "MAX_PAIRS", 1000)
    monkeypatch.setattr(pairs, "MAX_PAIRS", 1000)
    with pytest.raises(InvalidRequest, match=r"scene: got .*; expected at most 1,000 pairs of pieces"):
        lists(load_robot("wxai"), Scene((cloud(1.0),)))

"""Bounds of the gap between two solids, most of them hulls: no more than Coal's distance, and FCL's word at contact."""

from __future__ import annotations

import math
from typing import Any

import coal
import fcl
import numpy as np
import pytest

from planner_service.certify import hulls, separation
from planner_service.certify.interval_proof import LAST_ROUNDS
from planner_service.collision import fcl as judge
from planner_service.collision.bounds import Solids, centres_of
from planner_service.collision.gjk import gap_of
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from tests.laws.test_certify_laws import COAL
from tests.support.coal_shapes import coal_shape
from tests.support.hull_arm import DRUM, NEEDLE, RAMP, ROCK, SPOON

assert isinstance(NEEDLE.shape, Mesh)
KINDS: tuple[Shape, ...] = (
    ROCK, RAMP, DRUM, SPOON, NEEDLE.shape, Box((0.1, 0.07, 0.05)), Sphere(0.04), Cylinder(0.05, 0.03),
    Capsule(0.03, 0.2),
)  # fmt: skip


def fcl_shape(shape: Shape) -> Any:
    return judge.geometry_of(shape)


class Two:
    """Two solids turned at random, the second some way off the first, which is one of the first so many kinds."""

    def __init__(self, rng: np.random.Generator, first: int = 5) -> None:
        self.shapes = (KINDS[rng.integers(first)], KINDS[rng.integers(len(KINDS))])
        turns = [_turned(rng) for _ in range(2)]
        way = rng.normal(size=3)
        self.way = way / math.sqrt(float((way * way).sum()))
        self.centres = centres_of(self.shapes)
        self.turns = turns
        self.solids = Solids.of(self.shapes)
        self._coal = [coal_shape(shape) for shape in self.shapes]
        self._fcl = [fcl.CollisionObject(fcl_shape(shape)) for shape in self.shapes]
        low, high = 0.0, 2.0
        for _ in range(50):
            middle = (low + high) / 2
            low, high = (middle, high) if self.gap(middle) <= 0.0 else (low, middle)
        self.touching = high

    def frames(self, apart: float) -> list[tuple[FloatArray, FloatArray]]:
        """Rotations and translations of the shapes' own frames, the centres of the boxes around them so far apart."""
        at = (np.zeros(3), self.way * apart)
        return [(R, t - R @ c) for R, t, c in zip(self.turns, at, self.centres, strict=True)]

    def gap(self, apart: float) -> float:
        """By the walk of the collision checker."""
        R, S = self.turns
        return gap_of(self.solids.one(0, R, np.zeros(3)), self.solids.one(1, S, self.way * apart))

    def proven(self, apart: float) -> float:
        """By the walk of the certificate."""
        poses = [
            np.concatenate([R, (t + R @ np.array(separation.centre_of(shape)))[:, None]], axis=1)[:, :, None]
            for (R, t), shape in zip(self.frames(apart), self.shapes, strict=True)
        ]
        own = [separation.Solids.of([shape]) for shape in self.shapes]
        facing = separation.Facing.of(own[0], own[1], poses[0], poses[1])
        rough, n = separation.rough_gaps(facing, np.zeros((0, 3, 1)))
        tight, best = separation.refined_gaps(facing, rough, n, LAST_ROUNDS)
        assert rough[0] <= tight[0]
        assert facing.along(best)[0] == pytest.approx(tight[0], abs=1e-12)
        return float(tight[0])

    def distance(self, apart: float) -> float:
        (R, t), (S, u) = self.frames(apart)
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        placed = (coal.Transform3s(R, t), coal.Transform3s(S, u))
        return float(coal.distance(self._coal[0], placed[0], self._coal[1], placed[1], request, result))

    def collide(self, apart: float) -> bool:
        for thing, (R, t) in zip(self._fcl, self.frames(apart), strict=True):
            thing.setTransform(fcl.Transform(R, t))
        return bool(fcl.collide(*self._fcl))


def _turned(rng: np.random.Generator) -> FloatArray:
    q = rng.normal(size=4) * (1.0 if rng.random() < 0.75 else np.array([1.0, 0.0, 0.0, 0.0]))
    w, x, y, z = (q / math.sqrt(float((q * q).sum()))).tolist()
    return Pose((0.0, 0.0, 0.0), (w, x, y, z)).rotation


def test_both_bounds_of_a_gap_are_no_more_than_coals_distance_and_close_to_it() -> None:
    rng = np.random.default_rng(11)
    missing = []
    for _ in range(100):
        two = Two(rng, len(KINDS))
        apart = two.touching + float(10.0 ** rng.uniform(-5.0, 0.0))
        distance, walked, proven = two.distance(apart), two.gap(apart), two.proven(apart)
        assert max(walked, proven) <= distance + COAL
        missing.append(distance - min(walked, proven * (1.0 + 2 * hulls.SHARE)))
    assert max(missing) < 2e-5
    assert np.median(missing) < 1e-6


def test_fcl_says_of_hulls_what_the_bounds_say_but_for_a_micrometre() -> None:
    """No face keeps its search for the farthest corner: 48-sided caps are flat, and cut into triangles."""
    rng = np.random.default_rng(12)
    for _ in range(80):
        two = Two(rng)
        inside = two.touching * rng.random()
        for apart in (0.0, inside, two.touching - 1e-5, two.touching - 2e-6, two.touching + 2e-6, two.touching * 1.1):
            gap = two.gap(apart)
            assert abs(gap) <= 1e-6 or two.collide(apart) == (gap < 0.0)

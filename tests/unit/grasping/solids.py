"""Objects to grasp, drawn at random, and what a ray through them meets by another way than the package's own."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from planner_service import Box, Capsule, Cylinder, Mesh, Pose, Sphere
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Compound, Solid
from planner_service.geometry.shapes import Shape

KINDS = ("box", "sphere", "cylinder", "capsule", "mesh", "compound")


def solid(kind: str, seed: int, size: float = 0.03) -> Solid:
    """A solid of a kind, about ``size`` metres from its middle to its ends."""
    rng = np.random.default_rng(seed)
    a, b, c = (size * rng.uniform(0.4, 1.6, 3)).tolist()
    if kind == "box":
        return Box((a, b, c))
    if kind == "sphere":
        return Sphere(a)
    if kind == "cylinder":
        return Cylinder(a, 2.0 * b)
    if kind == "capsule":
        return Capsule(a, b)
    if kind == "mesh":
        return Mesh(size * rng.uniform(-1.0, 1.0, (12, 3)))
    turns = rng.uniform(-3.0, 3.0, (3, 3)).tolist()
    places = (size * rng.uniform(-0.6, 0.6, (3, 3))).tolist()
    shapes: tuple[Shape, ...] = (
        Box((a, b, c)),
        Cylinder(0.4 * a, 2.0 * c),
        Mesh(0.6 * size * rng.uniform(-1.0, 1.0, (8, 3))),
    )
    return Compound(
        tuple((shape, Pose.from_rpy(at, rpy)) for shape, at, rpy in zip(shapes, places, turns, strict=True))
    )


def solids() -> st.SearchStrategy[Solid]:
    return st.builds(solid, st.sampled_from(KINDS), st.integers(0, 10_000))


def pose(seed: int, reach: float = 0.4) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose.from_rpy(rng.uniform(-reach, reach, 3).tolist(), rng.uniform(-3.0, 3.0, 3).tolist())


def first_hit(solid: Solid, origin: FloatArray, direction: FloatArray, length: float) -> tuple[FloatArray, FloatArray]:
    """Where a ray from outside first meets a solid, by sphere tracing, and the outward unit normal there.

    Raises:
        AssertionError: It meets nothing within ``length`` metres.
    """
    t = 0.0
    for _ in range(20_000):
        gap = float(solid.distance(origin + t * direction))
        if gap < 1e-9:
            break
        t += gap
        assert t < length
    at = origin + t * direction
    step = 1e-7
    outside = origin + (t - 2e-6) * direction
    slope = np.array(
        [float(solid.distance(outside + step * e) - solid.distance(outside - step * e)) for e in np.eye(3)]
    )
    return at, slope / np.linalg.norm(slope)

"""The hull of a mesh as a value: what it takes and refuses, and what its support, distance and growth promise."""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from auditor.checker import hull_of
from planner_service.collision.bounds import Solids, centres_of
from planner_service.collision.gjk import gap_of
from planner_service.errors import InvalidRequest
from planner_service.geometry import mesh
from planner_service.geometry.arrays import FloatArray, along
from planner_service.geometry.mesh import MAX_HULL, THINNEST, Mesh
from planner_service.geometry.mesh_formats import MAX_VERTICES
from planner_service.geometry.shapes import Box, Sphere

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)])


FLAT = 1e-11
"""Of the largest coordinate: where faces are flat but for rounding, which corner is outermost is rounding's to say.
Of 34,000 such hulls none was off by more than 2e-13."""


def rim(count: int, radius: float, z: float) -> FloatArray:
    angles = [2.0 * math.pi * k / count for k in range(count)]
    return np.array([[radius * math.cos(a), radius * math.sin(a), z] for a in angles])


def turned(rng: np.random.Generator) -> FloatArray:
    """A random rotation matrix."""
    a, b = rng.normal(size=(2, 3))
    a /= math.sqrt(float((a * a).sum()))
    b -= a * float((a * b).sum())
    b /= math.sqrt(float((b * b).sum()))
    return np.stack([a, b, np.cross(a, b)])


def cloud(rng: np.random.Generator) -> FloatArray:
    """Points whose hull is round, flat, a needle, full of coplanar faces, nearly so, small, or far from its origin."""
    kind = int(rng.integers(6))
    if kind == 0:
        points = rng.normal(size=(int(rng.integers(5, 60)), 3))
        points /= np.sqrt((points * points).sum(axis=1))[:, None]
    elif kind == 1:
        points = rng.normal(size=(30, 3)) * [1.0, *10.0 ** rng.uniform(-2.5, 0.0, 2)]
    elif kind == 2:
        count = int(rng.integers(3, 90))
        points = np.concatenate([rim(count, 0.5, -0.3), rim(count, 0.5, 0.8)])
    else:
        t = np.linspace(0.0, 1.0, int(rng.integers(2, 6)))
        points = np.array([[x, y, z] for x in t for y in t for z in t])
    if kind >= 2:  # faces that are flat, or flat but for rounding, or not quite
        points = points + rng.normal(size=points.shape) * rng.choice([0.0, 1e-16, 1e-15, 1e-13, 1e-10, 1e-7, 1e-4])
    points = points * 10.0 ** rng.uniform(-2.0, 0.5)
    if rng.random() < 0.7:
        points = points @ turned(rng).T
    if rng.random() < 0.2:
        points = points.astype(np.float32).astype(np.float64)
    if rng.random() < 0.3:
        points = points + rng.normal(size=3) * rng.choice([1.0, 200.0])
    return np.asarray(points)


seeds = st.integers(0, 2**32 - 1)
some = settings(deadline=None, max_examples=60)


def directions(mesh: Mesh, rng: np.random.Generator) -> FloatArray:
    """Random ones, normals of faces, and these slightly turned."""
    picked = mesh.normals[rng.integers(len(mesh.normals), size=40)]
    found = np.concatenate([rng.normal(size=(40, 3)), picked, picked + rng.normal(size=(40, 3)) * 1e-9, np.eye(3)])
    return np.asarray(found / np.sqrt((found * found).sum(axis=1))[:, None])


# values


def test_faces_are_counter_clockwise_from_outside_and_the_hull_lies_below_each() -> None:
    mesh = Mesh(CUBE)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert ((np.cross(b - a, c - a) * mesh.normals).sum(axis=1) > 0.0).all()
    assert sorted(set(map(tuple, np.round(mesh.normals, 12).tolist()))) == [
        (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
    ]  # fmt: skip
    assert (mesh.vertices @ mesh.normals.T - mesh.offsets).max() == 0.0
    assert sorted(set(np.round(mesh.offsets, 12).tolist())) == [0.0, 1.0, 2.0, 3.0]


def test_meshes_are_equal_when_their_hulls_have_the_same_corners_to_the_last_bit() -> None:
    mesh = Mesh(CUBE)
    assert mesh == Mesh(np.concatenate([CUBE[::-1], CUBE, [[0.5, 0.5, 0.5]]]))
    assert hash(mesh) == hash(Mesh(CUBE[::-1]))
    assert mesh == Mesh(-0.0 * CUBE + CUBE) == Mesh(CUBE.tolist()) == copy.deepcopy(mesh)
    moved = CUBE.copy()
    moved[3, 2] = np.nextafter(3.0, 4.0)
    assert mesh != Mesh(moved)
    assert mesh.digest != Mesh(moved).digest
    assert repr(mesh) != repr(Mesh(moved))
    assert mesh != Box((1.0, 2.0, 3.0))


@some
@given(seeds)
def test_the_corners_of_a_mesh_give_an_equal_mesh(seed: int) -> None:
    mesh = Mesh(cloud(np.random.default_rng(seed)))
    again = Mesh(np.random.default_rng(seed).permutation(mesh.vertices))
    assert again == mesh
    assert np.array_equal(again.faces, mesh.faces)


@some
@given(seeds)
def test_the_faces_close_around_the_corners(seed: int) -> None:
    """Every edge has a face on either side, none is missing and none is there twice: FCL walks along them."""
    mesh = Mesh(cloud(np.random.default_rng(seed)))
    edges = Counter(frozenset((int(f[k]), int(f[(k + 1) % 3]))) for f in mesh.faces for k in range(3))
    assert set(edges.values()) == {2}
    assert all(len(edge) == 2 for edge in edges)
    assert len(mesh.faces) == 2 * len(mesh.vertices) - 4
    assert set(mesh.faces.ravel().tolist()) == set(range(len(mesh.vertices)))


@some
@given(seeds)
def test_a_walk_along_the_edges_ends_at_the_farthest_corner(seed: int) -> None:
    """As FCL looks for it on hulls of more than 32 corners, starting at the first."""
    rng = np.random.default_rng(seed)
    mesh = Mesh(cloud(rng))
    size = float(np.abs(mesh.vertices).max())
    neighbours: list[set[int]] = [set() for _ in mesh.vertices]
    for a, b, c in mesh.faces.tolist():
        neighbours[a] |= {b, c}
        neighbours[b] |= {a, c}
        neighbours[c] |= {a, b}
    for d in directions(mesh, rng):
        heights = (mesh.vertices @ d).tolist()
        at, seen, going = 0, set[int](), True
        while going:
            going = False
            for k in sorted(neighbours[at] - seen):
                seen.add(k)
                if heights[k] >= heights[at]:
                    at, going = k, True
        assert heights[at] >= max(heights) - FLAT * size


@some
@given(seeds)
@example(47712)  # rounding puts a point on one face below that face, and above the one beside it
def test_no_given_point_is_outside_the_hull(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = cloud(rng)
    mesh = Mesh(points)
    size = float(np.abs(points).max())
    d = directions(mesh, rng)
    assert ((points @ d.T).max(axis=0) <= (mesh.vertices @ d.T).max(axis=0) + FLAT * size).all()
    assert mesh.distance(points).max() <= FLAT * size


# refusals


@pytest.mark.parametrize(
    ("points", "problem"),
    [
        (np.zeros((MAX_VERTICES + 1, 3)), r"shape \(500001, 3\)"),
        (np.where(CUBE == 3.0, np.nan, CUBE), r"vertices\[1\]: got \[0.0, 0.0, nan\]"),
        (CUBE * [1.0, 1.0, 0.0], r"vertices: flat, 4 points within \[1.0, 2.0, 0.0\] m; expected points that span"),
    ],
)
def test_what_spans_no_solid_is_refused(points: Any, problem: str) -> None:
    with pytest.raises(InvalidRequest, match=problem):
        Mesh(points)


def test_a_hull_of_too_many_corners_is_refused_and_a_mesh_of_many_points_is_not() -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(size=(MAX_HULL + 1, 3))
    ball = points / np.sqrt((points * points).sum(axis=1))[:, None]
    assert len(Mesh(np.concatenate([ball[:50], 0.4 * ball])).vertices) <= 50
    with pytest.raises(InvalidRequest, match="got a hull of 5,001 corners; expected a hull of at most 5,000 corners"):
        Mesh(ball)


def sphere(rng: np.random.Generator, count: int) -> FloatArray:
    points = rng.normal(size=(count, 3))
    return np.asarray(points / np.sqrt((points * points).sum(axis=1))[:, None])


def drum(rng: np.random.Generator, count: int) -> FloatArray:
    turns = rng.uniform(0.0, 2 * np.pi, count)
    return np.stack([0.1 * np.cos(turns), 0.1 * np.sin(turns), np.where(np.arange(count) % 2, 0.2, 0.0)], axis=1)


LARGE: dict[str, tuple[Callable[[np.random.Generator], FloatArray], float]] = {
    "drum": (lambda rng: drum(rng, 1200), 1e-4),
    "needle": (lambda rng: sphere(rng, 3000) * [1.0, 1e-4, 1e-4] + 500.0, 2e-5),
}
"""Solids of more corners than a hull may have, and metres by which simpler ones may be larger."""


@pytest.mark.parametrize("solid", LARGE)
def test_a_large_hull_of_a_file_is_replaced_by_one_that_holds_it_and_is_little_larger(
    tmp_path: Path, solid: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mesh, "MAX_HULL", 800)  # 5,000 take a while
    monkeypatch.setattr(mesh, "SIMPLE_HULL", 400)
    rng = np.random.default_rng(2)
    make, most = LARGE[solid]
    points = make(rng)
    rows = "\n".join(" ".join(map(repr, row)) for row in points.tolist())
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    (tmp_path / "solid.ply").write_text(
        f"{head}property double x\nproperty double y\nproperty double z\nend_header\n{rows}\n"
    )
    simple = Mesh.from_file(tmp_path / "solid.ply")
    assert len(simple.vertices) <= 800
    directions = sphere(rng, 1000)
    beyond = [float((simple.vertices @ d).max() - (points @ d).max()) for d in directions]
    assert 0.0 < min(beyond) <= max(beyond) <= simple.growth <= most
    assert np.array_equal(simple.distance(points), np.zeros(len(points)))
    assert Mesh.from_file(tmp_path / "solid.ply") == simple


# support and distance


@some
@given(seeds)
def test_support_is_a_corner_that_no_point_of_the_mesh_is_beyond(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = Mesh(cloud(rng))
    d = directions(mesh, rng)
    found = mesh.support(d * 10.0 ** rng.uniform(-200.0, 200.0, (len(d), 1)))
    assert found.shape == d.shape
    reached = (found * d).sum(axis=1)
    assert (reached >= (mesh.vertices @ d.T).max(axis=0) - 1e-13 * np.abs(mesh.vertices).max()).all()
    assert set(map(tuple, found.tolist())) <= set(map(tuple, mesh.vertices.tolist()))


def coal_distance(mesh: Mesh, point: FloatArray) -> float:
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    at = coal.Transform3s(np.eye(3), point)
    return float(coal.distance(hull_of(mesh.vertices), coal.Transform3s(), coal.Sphere(1e-9), at, request, result))


@settings(deadline=None, max_examples=40)
@given(seeds)
def test_the_distance_is_the_length_of_the_gap_that_a_direction_proves(seed: int) -> None:
    """Of a point p: the largest ``d . p - h(d)``, which the walk between nearest points finds, and Coal too."""
    rng = np.random.default_rng(seed)
    mesh = Mesh(cloud(rng))
    size = float((mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)).max())
    points = mesh.vertices.mean(axis=0) + rng.normal(size=(12, 3)) * size
    corners = np.ascontiguousarray((mesh.vertices - mesh.vertices.mean(axis=0)).T)
    solids, still = Solids.of([mesh, Sphere(1e-9)]), np.eye(3)
    found = mesh.distance(points)
    assert corners.shape == solids.corners[0].shape
    for point, distance in zip(points, found, strict=True):
        gap = 1e-9 + gap_of(solids.one(0, still, centres_of([mesh])[0]), solids.one(1, still, point))
        assert max(gap, 0.0) == pytest.approx(distance, abs=2e-9 + 1e-9 * size)
        if distance > 1e-3:
            assert coal_distance(mesh, point) == pytest.approx(distance, abs=2e-5)


# growth


@pytest.mark.slow
@some
@given(seeds, st.floats(-6.0, -1.0))
def test_a_grown_mesh_holds_every_point_within_the_margin_and_none_much_farther(seed: int, power: float) -> None:
    """Support values say which points a convex solid holds: along each direction it has to reach farther by it."""
    rng = np.random.default_rng(seed)
    mesh, margin = Mesh(cloud(rng)), 10.0**power
    grown = mesh.grown(margin)
    d = np.concatenate([directions(mesh, rng), directions(grown, rng)])
    more = (grown.vertices @ d.T).max(axis=0) - (mesh.vertices @ d.T).max(axis=0)
    size = float(np.abs(mesh.vertices).max())
    assert more.min() >= margin - 1e-12 * size
    assert mesh.distance(grown.vertices).max() <= 1.74 * margin + 1e-12 * size


def test_a_hull_of_the_most_corners_may_still_be_grown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh, "MAX_HULL", 200)
    grown = Mesh(np.concatenate([rim(100, 1.0, 0.0), rim(100, 1.0, 1e-3)])).grown(0.001)
    assert len(grown.vertices) > 200
    assert grown.distance(np.array([1.001, 0.0, 0.0005])) == 0.0


STRAY = "".join(f"v {x} {y} {z}\n" for x, y, z in (*CUBE, (9.0, 0.0, 0.0)))
PLY_HEAD = "ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\n"
PLY_FACE = "element face 1\nproperty list uchar int vertex_indices\n"
PLY_ROWS = STRAY.replace("v ", "")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("stray.obj", STRAY + "f 1 2 3 4 5 6 7 8\n"),
        ("stray.ply", f"{PLY_HEAD}{PLY_FACE}end_header\n{PLY_ROWS}8 0 1 2 3 4 5 6 7\n"),
    ],
)
def test_a_vertex_that_no_face_uses_is_no_part_of_a_mesh(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    assert Mesh.from_file(tmp_path / name) == Mesh(CUBE)


def test_a_plate_is_refused_for_its_thickness_whichever_way_it_is_turned() -> None:
    plate = CUBE * [1.0, 1.0, 1e-7]
    with pytest.raises(InvalidRequest, match="flat"):
        Mesh(plate @ turned(np.random.default_rng(4)).T)
    assert len(Mesh(CUBE * [1.0, 1.0, THINNEST]).vertices) == 8


@pytest.mark.parametrize("seed", range(12))
def test_the_offset_of_a_face_is_the_farthest_corner_along_its_normal_to_the_last_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(int(10 ** rng.uniform(1.0, 3.3)), 3)) * 10.0 ** rng.uniform(-2.0, 1.0, 3)
    if seed % 2:
        points /= np.linalg.norm(points, axis=1)[:, None]
    mesh = Mesh(points + rng.normal(size=3))
    for body in (mesh, mesh.grown(0.01)):
        assert np.array_equal(along(body.vertices, body.normals).max(axis=1), body.offsets)

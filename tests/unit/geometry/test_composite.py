"""Compounds, point clouds and height fields: what they stand for, and what they refuse."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Composite, Compound, HeightField, Pieces, PointCloud
from planner_service.geometry.shapes import Box, Cylinder, Pose, Sphere
from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.scene import Attached, Obstacle, Scene

RNG = np.random.default_rng(5)
STEPS = PointCloud.from_cells([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]], 0.01)
GROUND = HeightField(np.array([[0.1, 0.2, 0.0], [0.1, 0.2, -0.5]]), 0.5)
PAIR = Compound(((Box((0.2, 0.4, 0.6)), Pose((1.0, 0.0, 0.0))), (Sphere(0.5), Pose((0.0, 0.0, 2.0)))))
ALL: tuple[Composite, ...] = (STEPS, GROUND, PAIR)


def boxes(pieces: Pieces) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Centre and size of each box, sorted."""
    found = []
    for shape, T in zip(pieces.shapes, pieces.frames, strict=True):
        assert isinstance(shape, Box)
        assert np.array_equal(T[:3, :3], np.eye(3))
        found.append((tuple(T[:3, 3].round(9).tolist()), tuple(np.round(shape.size, 9).tolist())))
    return sorted(found)


def inside(pieces: Pieces, points: FloatArray) -> Any:
    """Whether points (n, 3) are in one of the boxes."""
    size = np.array([shape.size for shape in pieces.shapes if isinstance(shape, Box)])
    off = np.abs(points[:, None] - pieces.frames[None, :, :3, 3]) - size / 2
    return (off <= 0.0).all(axis=-1).any(axis=-1)


@pytest.mark.slow
@given(arrays(np.int64, st.tuples(st.integers(1, 60), st.just(3)), elements=st.integers(-4, 4)))
def test_the_boxes_of_a_cloud_are_its_cells(cells: Any) -> None:
    cloud = PointCloud.from_cells(cells, 0.25)
    grid = np.stack(np.meshgrid(*[np.arange(-6, 7)] * 3), axis=-1).reshape(-1, 3)
    solid = {tuple(cell) for cell in cells.tolist()}
    assert inside(cloud.pieces, (grid + 0.5) * 0.25).tolist() == [tuple(cell) in solid for cell in grid.tolist()]
    volume = sum(
        shape.size[0] * shape.size[1] * shape.size[2] for shape in cloud.pieces.shapes if isinstance(shape, Box)
    )
    assert volume == pytest.approx(len(solid) * 0.25**3)  # so no two overlap
    assert {tuple(cell) for cell in cloud.cells.tolist()} == solid


def test_the_columns_of_a_field_stand_on_its_floor() -> None:
    assert boxes(GROUND.pieces) == [((0.5, 0.25, 0.05), (1.0, 0.5, 0.1)), ((0.5, 0.75, 0.1), (1.0, 0.5, 0.2))]
    deep = HeightField(np.array([[0.1]]), 0.5, floor=-0.3)
    assert boxes(deep.pieces) == [((0.25, 0.25, -0.1), (0.5, 0.5, 0.4))]


@pytest.mark.parametrize("solid", ALL, ids=lambda solid: type(solid).__name__)
def test_support_and_distance_are_those_of_the_pieces(solid: Composite) -> None:
    directions, points = RNG.normal(size=(50, 3)), RNG.normal(0.0, 1.0, (50, 3))
    pieces = solid.pieces
    heights, gaps = [], []
    for shape, T in zip(pieces.shapes, pieces.frames, strict=True):
        local = shape.support(directions @ T[:3, :3]) @ T[:3, :3].T + T[:3, 3]
        heights.append((local * directions).sum(axis=1))
        gaps.append(shape.distance((points - T[:3, 3]) @ T[:3, :3]))
    assert (solid.support(directions) * directions).sum(axis=1) == pytest.approx(np.max(heights, axis=0), abs=1e-12)
    assert solid.distance(points) == pytest.approx(np.min(gaps, axis=0), abs=1e-12)
    assert solid.distance(solid.support(directions[0])) == pytest.approx(0.0, abs=1e-9)


BAD_CLOUDS: list[tuple[Any, Any, str]] = [
    ([["a", "b", "c"]], 0.1, r"points: got .*; expected 1 to 5,000,000 points"),
    ([[0.0, 0.0, 0.0], [0.0, float("nan"), 0.0]], 0.1, r"points\[1\]: got \[0.0, nan, 0.0\]"),
    ([[-999.0, 0.0, 0.0], [999.0, 0.0, 0.0]], 1.0, "points: 1999 m long; expected a cloud no longer than 1000 m"),
]


@pytest.mark.parametrize(("points", "resolution", "message"), BAD_CLOUDS)
def test_a_cloud_that_is_none_is_refused(points: Any, resolution: Any, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        PointCloud(points, resolution)


BAD_FIELDS: list[tuple[Any, Any, Any, str]] = [
    ([0.1, 0.2], 0.1, 0.0, r"heights: got an array of shape \(2,\)"),
    ([[0.1, float("nan")]], 0.1, 0.0, r"heights\[0, 1\]: got nan"),
    ([[0.1, 0.0]], 0.1, 0.1, "floor: got 0.1; expected below the highest column, 0.1"),
    ([[0.1]], 0.1, "low", "floor: got 'low'"),
    (RNG.uniform(0.1, 0.2, (300, 300)), 0.01, 0.0, "cell: 0.01 m makes 90,000 boxes"),
]


@pytest.mark.parametrize(("heights", "cell", "floor", "message"), BAD_FIELDS)
def test_a_field_that_is_none_is_refused(heights: Any, cell: Any, floor: Any, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        HeightField(heights, cell, floor)


BAD_COMPOUNDS: list[tuple[Any, str]] = [
    ((), "parts: got 0; expected 1 to 1,000 pairs"),
    (((Box((1, 1, 1)), (0, 0, 0)),), r"parts\[0\]: got .*expected a convex shape and a Pose"),
    (((Sphere(1), Pose((1e4, 0, 0))),), r"parts\[0\]: got .*expected metres"),
    (((Sphere(1), Pose()),) * 1001, "parts: got 1001"),
]


@pytest.mark.parametrize(("parts", "message"), BAD_COMPOUNDS)
def test_a_compound_that_is_none_is_refused(parts: Any, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        Compound(parts)


def packed(**arrays_of: Any) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays_of)
    return out.getvalue()


def plain(array: Any) -> bytes:
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


POINTS = RNG.uniform(0.0, 1.0, (50, 3))
PLY = "ply\nformat ascii 1.0\nelement vertex 50\nproperty float x\nproperty float y\nproperty float z\nend_header\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.npz", packed(points=POINTS)),
        ("a.npy", plain(POINTS)),
        ("a.PLY", (PLY + "\n".join(" ".join(map(repr, row)) for row in POINTS.tolist()) + "\n").encode()),
    ],
)
def test_a_cloud_is_read_from_a_file(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    assert PointCloud.from_file(tmp_path / name, 0.1) == PointCloud(POINTS, 0.1)


def lying() -> bytes:
    """An NPY file that says it has more numbers than it has."""
    return plain(POINTS).replace(b"(50, 3)", b"(99, 3)")


def bomb() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", bytes(60_000_000))
    return out.getvalue()


BAD_FILES: list[tuple[str, bytes, str]] = [
    ("a.dwg", b"", r"suffix '.dwg'; expected one of .ply, .npz, .npy, .pcd"),
    ("a.npy", b"\x93NUMPY is not this", "not an NPY file|NPY header"),
    ("a.npy", plain(POINTS)[:-9], r"1,191 bytes are not those of an array of shape \(50, 3\)"),
    ("a.npy", lying(), r"1,200 bytes are not those of an array of shape \(99, 3\)"),
    ("a.npy", plain(np.array([{"a": 1}], dtype=object)), "expected real numbers"),
    ("a.npz", bomb(), "unpacks to more than 50,000,000 bytes"),
]


@pytest.mark.parametrize(("name", "content", "message"), BAD_FILES)
def test_a_file_that_holds_no_cloud_is_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidFile, match=message):
        PointCloud.from_file(tmp_path / name, 0.1)


def scene_of_all() -> Scene:
    turned = Pose.from_rpy((0.4, 0.1, 0.2), (0.1, 0.2, 0.3))
    standing = [Obstacle(type(solid).__name__, solid, turned) for solid in ALL]
    return Scene(tuple(standing), (Attached("held", Compound(((Cylinder(0.01, 0.02), Pose()),)), Pose(), ("a",)),))


def test_a_scene_file_keeps_them_to_the_last_bit(tmp_path: Path) -> None:
    scene = scene_of_all()
    save_scene(scene, tmp_path / "s.toml")
    again = load_scene(tmp_path / "s.toml")
    assert again == scene
    assert again.hash == scene.hash
    moved = scene.moved("PointCloud", Pose((0.1, 0.0, 0.0)))
    assert moved.hash != scene.hash


def test_a_scene_file_names_cloud_and_heights_in_its_own_folder(tmp_path: Path) -> None:
    (tmp_path / "scan.npz").write_bytes(packed(points=POINTS))
    (tmp_path / "ground.npy").write_bytes(plain(GROUND.heights))
    (tmp_path / "s.toml").write_text(
        '[[obstacle]]\nname = "a"\ncloud = { file = "scan.npz", resolution = 0.1 }\nposition = [0, 0, 0]\n'
        '[[obstacle]]\nname = "b"\nheights = { file = "ground.npy", cell = 0.5 }\nposition = [0, 0, 0]\n'
    )
    scene = load_scene(tmp_path / "s.toml")
    assert [o.shape for o in scene.obstacles] == [PointCloud(POINTS, 0.1), GROUND]


BAD_ENTRIES: list[tuple[str, str]] = [
    ("cloud = { resolution = 0.1 }", "cloud: got .*; expected { file = ..., resolution = ..., scale = ... }"),
    ("cloud = { cells = [[0, 0, 0]], resolution = 0.1, scale = 2 }", "cloud: got .*; expected { file"),
    (
        "compound = [{ cloud = { cells = [[0, 0, 0]], resolution = 1 }, position = [0, 0, 0] }]",
        r"compound\[0\]: unknown key 'cloud'",
    ),
]


@pytest.mark.parametrize(("text", "message"), BAD_ENTRIES)
def test_a_bad_entry_of_a_scene_file_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "s.toml").write_text(f'[[obstacle]]\nname = "a"\n{text}\nposition = [0, 0, 0]\n')
    with pytest.raises(InvalidFile, match=rf"obstacle\[0\] 'a'.*{message}"):
        load_scene(tmp_path / "s.toml")

"""Triangles of STL, OBJ and PLY files: the same from each format, or a refusal that says why."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from planner_service.errors import InvalidFile
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.mesh_formats import read_triangles, read_vertices

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)], dtype=np.float64)
TRIANGLES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
"""A tetrahedron of volume 1."""

STL = bytes(80) + struct.pack("<I", 4) + b"".join(
    struct.pack("<12fH", 0, 0, 0, *CORNERS[list(f)].ravel(), 0) for f in TRIANGLES
)  # fmt: skip
STL_TEXT = "solid x\n" + "".join(
    "facet normal 0 0 0 outer loop " + " ".join("vertex {} {} {}".format(*CORNERS[k]) for k in f) + " endloop\n"
    for f in TRIANGLES
) + "endsolid x\n"  # fmt: skip
V = "".join("v {} {} {}\n".format(*row) for row in CORNERS)
OBJ = V + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in TRIANGLES)
HEAD = "ply\nformat {}\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\nelement face {}\n"
LIST = "property list uchar int vertex_indices\n"
ROWS = "".join("{} {} {}\n".format(*row) for row in CORNERS)
PLY = HEAD.format("ascii 1.0", 4) + LIST + "end_header\n" + ROWS + "".join("3 {} {} {}\n".format(*f) for f in TRIANGLES)
PLY_MORE = (
    HEAD.format("ascii 1.0", 4)
    + "property uchar red\nproperty list uchar uint vertex_index\nproperty float area\nelement edge 1\n"
    + "property int vertex1\nend_header\n"
    + ROWS
    + "".join("255 3 {} {} {} 0.5\n".format(*f) for f in TRIANGLES)
    + "7\n"
)


def ply_binary(order: str, name: str) -> bytes:
    head = HEAD.format(f"{name} 1.0", 4) + "property uchar red\n" + LIST + "property float area\nend_header\n"
    faces = b"".join(struct.pack(f"{order}BB3if", 255, 3, *f, 0.5) for f in TRIANGLES)
    return head.encode() + CORNERS.astype(f"{order}f8").tobytes() + faces


def written(folder: Path, name: str, data: bytes | str) -> Path:
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def volume(vertices: FloatArray, faces: IntArray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float((np.cross(a, b) * c).sum() / 6.0)


ALIKE = [
    ("binary.stl", STL),
    ("text.STL", STL_TEXT),
    ("plain.obj", OBJ),
    ("plain.ply", PLY),
    ("more.ply", PLY_MORE),
    ("little.ply", ply_binary("<", "binary_little_endian")),
    ("big.ply", ply_binary(">", "binary_big_endian")),
]


@pytest.mark.parametrize(("name", "data"), ALIKE, ids=[name for name, _ in ALIKE])
def test_every_format_gives_the_same_solid_facing_outwards(tmp_path: Path, name: str, data: bytes | str) -> None:
    path = written(tmp_path, name, data)
    vertices, faces = read_triangles(path)
    assert np.array_equal(vertices, read_vertices(path))
    assert vertices.tolist() == sorted(CORNERS.tolist())
    assert [sorted(CORNERS[list(f)].tolist()) for f in TRIANGLES] == [sorted(vertices[f].tolist()) for f in faces]
    assert volume(vertices, faces) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("fan.obj", V + "v 1 2 0\nf 1 2 5 3\n"),
        (
            "fan.ply",
            HEAD.format("ascii 1.0", 1).replace("x 4", "x 5") + LIST + "end_header\n" + ROWS + "1 2 0\n4 0 1 4 2",
        ),
    ],
)
def test_a_polygon_is_a_fan_around_its_first_corner(tmp_path: Path, name: str, data: str) -> None:
    vertices, faces = read_triangles(written(tmp_path, name, data))
    assert vertices[faces].tolist() == [[[0, 0, 0], [1, 0, 0], [1, 2, 0]], [[0, 0, 0], [1, 2, 0], [0, 2, 0]]]


@pytest.mark.parametrize("scale", [(-1.0, 1.0, 2.0), (-1.0, -1.0, 2.0)])
def test_a_scale_keeps_the_outside_outside(tmp_path: Path, scale: tuple[float, float, float]) -> None:
    vertices, faces = read_triangles(written(tmp_path, "plain.obj", OBJ), scale)
    assert volume(vertices, faces) == pytest.approx(2.0, rel=1e-12)


BIG = ply_binary(">", "binary_big_endian")
REFUSED = [
    ("x.txt", OBJ, "suffix '.txt'; expected one of .stl, .obj, .ply, .dae"),
    ("none.obj", V, "an OBJ without a face"),
    ("zero.obj", V + "f 0 1 2\n", "a corner of a triangle is none of the 4 vertices"),
    ("below.ply", PLY.replace("3 1 2 3", "3 1 2 -1"), "a corner of a triangle is none of the 4 vertices"),
    ("two.obj", V + "f 1 2\n", "a face with 2 corners; expected three or more"),
    ("digits.obj", V + "f 1 2 " + "9" * 5000 + "\n", "'99999999999999999999' in a face"),
    ("cut.stl", STL[:-1], "no STL"),
    ("cut.ply", BIG[:-1], "cut short: the PLY header says 4 faces"),
    ("short.ply", PLY.replace("3 1 2 3", "4 1 2 3"), "a PLY face whose number of corners is wrong"),
    ("beyond.ply", PLY.replace("3 1 2 3", "3 1 2 4"), "a corner of a triangle is none of the 4 vertices"),
    (
        "many.ply",
        PLY.replace("element face 4", "element face 1000001"),
        "1,000,001 face rows; expected at most 1,000,000",
    ),
]


@pytest.mark.parametrize(("name", "data", "why"), REFUSED, ids=[name for name, _, _ in REFUSED])
def test_what_is_no_list_of_triangles_is_refused(tmp_path: Path, name: str, data: bytes | str, why: str) -> None:
    path = written(tmp_path, name, data)
    with pytest.raises(InvalidFile, match=why):
        read_triangles(path)


def test_a_triangle_without_three_different_corners_is_left_out(tmp_path: Path) -> None:
    _, faces = read_triangles(written(tmp_path, "thin.obj", OBJ + "f 1 1 2\nv 1 0 0\nf 2 5 3\n"))
    assert len(faces) == 4

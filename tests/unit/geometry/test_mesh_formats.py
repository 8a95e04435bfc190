"""Mesh files: what is read, every refusal, files cut or changed, and the folders that may be read."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.geometry import mesh_paths as mesh_path
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_formats import read_vertices
from planner_service.geometry.mesh_paths import MeshLoader
from tests.support.fuzz import changed

POINTS = np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, -0.75], [0.25, 0.5, 0.125]])
"""Numbers that no format rounds."""
FACES = ((0, 1, 2), (1, 2, 4), (0, 3, 1), (0, 2, 3), (1, 3, 4), (2, 4, 3))


def binary_stl(points: FloatArray = POINTS, name: bytes = b"made by hand") -> bytes:
    facets = [np.concatenate([[0.0, 0.0, 0.0], *(points[k] for k in face)]) for face in FACES]
    body = b"".join(np.asarray(facet, "<f4").tobytes() + b"\0\0" for facet in facets)
    return name.ljust(80, b"\0") + struct.pack("<I", len(FACES)) + body


def text_stl(points: FloatArray = POINTS, name: str = "part") -> bytes:
    lines = [f"solid {name}"]
    for face in FACES:
        lines += [" facet normal 0 0 1", "  outer loop"]
        lines += [f"   vertex {' '.join(map(repr, points[k].tolist()))}" for k in face]
        lines += ["  endloop", " endfacet"]
    return "\n".join([*lines, f"endsolid {name}", ""]).encode()


def obj(points: FloatArray = POINTS) -> bytes:
    lines = ["# a part", "mtllib ../../secret.mtl", "o part"]
    lines += [f"v {' '.join(map(repr, p))}" for p in points.tolist()]
    lines += ["vt 9 9", "vn 9 9 9", "usemtl none", *(f"f {a + 1}/1/1 {b + 1} {c + 1}" for a, b, c in FACES)]
    return "\n".join([*lines, ""]).encode()


def ply_head(kind: str, count: int = len(POINTS), number: str = "double") -> bytes:
    lines = ["ply", f"format {kind} 1.0", "comment end_header", "obj_info made by hand", f"element vertex {count}"]
    lines += ["property uchar red", *(f"property {number} {axis}" for axis in "xzy")]
    lines += [f"element face {len(FACES)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(lines).encode()


def text_ply(points: FloatArray = POINTS) -> bytes:
    lines = [f"255 {x!r} {z!r} {y!r}" for x, y, z in points.tolist()] + [f"3 {a} {b} {c}" for a, b, c in FACES]
    return ply_head("ascii", len(points)) + "\n".join([*lines, ""]).encode()


def binary_ply(points: FloatArray = POINTS, mark: str = "<", number: str = "double") -> bytes:
    code = {"double": "d", "float": "f"}[number]
    rows = b"".join(struct.pack(f"{mark}B3{code}", 255, x, z, y) for x, y, z in points.tolist())
    faces = b"".join(struct.pack(f"{mark}B3i", 3, *face) for face in FACES)
    kind = {"<": "binary_little_endian", ">": "binary_big_endian"}[mark]
    return ply_head(kind, len(points), number) + rows + faces


FORMATS: dict[str, tuple[str, bytes]] = {
    "binary stl": ("a.stl", binary_stl()),
    "text stl": ("a.stl", text_stl()),
    "text stl in capitals": ("a.STL", text_stl().upper().replace(b"E-0", b"e-0")),
    "obj": ("a.obj", obj()),
    "text ply": ("a.ply", text_ply()),
    "little ply": ("a.ply", binary_ply()),
    "big ply": ("a.PLY", binary_ply(mark=">")),
}


def write(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def problems_of(call: Callable[[], Any]) -> tuple[str, ...]:
    with pytest.raises(InvalidFile) as caught:
        call()
    return caught.value.problems


@pytest.mark.parametrize("kind", FORMATS)
def test_the_vertices_of_a_file_are_read_each_once(tmp_path: Path, kind: str) -> None:
    found = read_vertices(write(tmp_path, *FORMATS[kind]))
    assert found.tolist() == sorted(POINTS.tolist())
    assert Mesh.from_file(str(tmp_path / FORMATS[kind][0])) == Mesh(POINTS)


@pytest.mark.parametrize("kind", FORMATS)
def test_a_scale_multiplies_each_axis_and_a_negative_one_mirrors(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path, *FORMATS[kind])
    mesh = Mesh.from_file(path, (0.5, -2.0, 4.0))
    assert mesh == Mesh(POINTS * [0.5, -2.0, 4.0])
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert ((np.cross(b - a, c - a) * mesh.normals).sum(axis=1) > 0.0).all()
    assert (mesh.offsets >= (mesh.normals * mesh.vertices.mean(axis=0)).sum(axis=1)).all()


NAN = struct.pack("<I", 0x7FA00000)
"""A NaN that processors complain about."""

REFUSED: dict[str, tuple[str, bytes, str]] = {
    "other suffix": ("a.dxf", b"", r"suffix '.dxf'; expected one of .stl, .obj, .ply"),
    "empty stl": ("a.stl", b"", "no STL: 0 bytes are not those of 0 triangles, nor is it text"),
    "stl cut": ("a.stl", binary_stl()[:-1], r"no STL: 383 bytes are not those of 6 triangles"),
    "stl that claims four billion": ("a.stl", bytes(80) + b"\xff" * 54, "those of 4,294,967,295 triangles"),
    "stl of nan": ("a.stl", binary_stl()[:96] + NAN + binary_stl()[100:], "a vertex is not finite"),
    "stl text and zeros": ("a.stl", text_stl().replace(b"part", b"p\0\xff"), "neither the binary format of its suffix"),
    "obj of points": ("a.obj", re.sub(rb"(?m)^f .*\n", b"", obj()), "an OBJ without a face: cut short, or no more"),
    "number with underscore": ("a.obj", obj().replace(b"0.75", b"0_75"), "'-0_75' in a vertex; expected a number"),
    "a kilometre": ("a.obj", obj().replace(b"0.75", b"1000.1"), "more than 1000 m from 0; is the scale right"),
    "ply of other format": ("a.ply", text_ply().replace(b"ascii", b"utf"), "PLY format utf; expected one of ascii"),
    "ply of no vertices": ("a.ply", text_ply().replace(b"vertex 5", b"vertex 0"), "no vertices"),
    "ply of many": ("a.ply", text_ply().replace(b"vertex 5", b"vertex 500001"), "500,001 vertex rows; expected"),
    "ply without z": ("a.ply", text_ply().replace(b"double z", b"double w"), "PLY vertices have red, x, w, y;"),
    "text ply cut": ("a.ply", text_ply().split(b"255 0.0 -0.75", 1)[0], "cut short: the PLY header says 5 vertices"),
    "binary ply cut": ("a.ply", binary_ply()[: len(ply_head("binary_little_endian")) + 124], "cut short: the PLY"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_a_file_that_is_no_mesh_is_refused_with_the_reason(tmp_path: Path, what: str) -> None:
    name, content, problem = REFUSED[what]
    path = write(tmp_path, name, content)
    (found,) = problems_of(lambda: read_vertices(path))
    assert re.search(problem, found)


@pytest.mark.slow
def test_a_cut_file_gives_all_vertices_or_none(tmp_path: Path) -> None:
    """What was cut off may be faces; a vertex that is not there would be a hole in the obstacle."""
    whole = sorted(POINTS.tolist())
    for kind, (name, content) in FORMATS.items():
        for length in range(0, len(content), 3):
            path = write(tmp_path, name, content[:length])
            with suppress(InvalidFile):
                assert read_vertices(path).tolist() == whole, (kind, length)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(sorted(FORMATS)).flatmap(
        lambda k: st.tuples(st.just(FORMATS[k][0]), changed(FORMATS[k][1], NAN, b"vertex "))
    )
)
def test_a_changed_file_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, file: tuple[str, bytes]) -> None:
    path = write(tmp_path_factory.getbasetemp(), *file)
    with suppress(InvalidFile):
        found = Mesh.from_file(path)
        assert np.abs(found.vertices).max() <= 1000.0


# where meshes may lie


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder of a robot or scene with meshes inside, beside and outside."""
    for name in ("robot", "robot/meshes", "shared", "shared/arm", "secret"):
        (tmp_path / name).mkdir()
    for k, name in enumerate(("robot/a", "robot/meshes/b", "shared/c", "shared/arm/d", "secret/s", "robot/with space")):
        write(tmp_path, f"{name}.stl", binary_stl(POINTS * (k + 1)))
    (tmp_path / "robot" / "in.stl").symlink_to("meshes/b.stl")
    (tmp_path / "robot" / "out.stl").symlink_to("../secret/s.stl")
    (tmp_path / "robot" / "tunnel").symlink_to("../secret")
    (tmp_path / "robot" / "circle.stl").symlink_to("circle.stl")
    (tmp_path / "robot" / "text.stl").symlink_to("notes.txt")
    (tmp_path / "robot" / "notes.txt").write_bytes(binary_stl())
    return tmp_path


def loader_of(place: Path) -> MeshLoader:
    return MeshLoader((place / "robot", place / "shared"))


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("a.stl", 1),
        ("in.stl", 2),
        ("c.stl", 3),
        ("package://arm/d.stl", 4),
        ("file://{place}/robot/with%20space.stl", 6),
        ("{place}/shared/c.stl", 3),
    ],
)
def test_a_mesh_inside_the_folders_is_found(place: Path, name: str, size: int) -> None:
    assert loader_of(place).mesh(name.format(place=place)) == Mesh(POINTS * size)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("../secret/s.stl", "lies outside the folders that may be read"),
        ("{place}/secret/s.stl", "lies outside the folders that may be read"),
        ("file://{place}/robot/%2e%2e/secret/s.stl", "lies outside the folders that may be read"),
        ("package://../secret/s.stl", "lies outside the folders that may be read"),
        ("package://arm/../../secret/s.stl", "lies outside the folders that may be read"),
        ("http://example.org/a.stl", "lies outside the folders that may be read"),
        ("tunnel/s.stl", "lies outside the folders that may be read"),
        ("text.stl", "suffix '.txt'; expected one of"),
        ("", "mesh filename ''; expected a path"),
    ],
)
def test_a_mesh_elsewhere_is_refused(place: Path, name: str, problem: str) -> None:
    with pytest.raises(InvalidRequest, match=problem):
        MeshLoader((place / "robot",)).mesh(name.format(place=place))


def test_all_meshes_of_a_file_share_one_budget_of_bytes(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_path, "MAX_TOTAL", 2 * len(binary_stl()) + 1)
    shelf = loader_of(place)
    for name in ("a.stl", "meshes/b.stl", "a.stl", "in.stl"):
        shelf.mesh(name)
    with pytest.raises(InvalidRequest, match=r"mesh 'c.stl' is too much: more than 769 bytes of mesh files in all"):
        shelf.mesh("c.stl")

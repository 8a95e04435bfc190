"""Measured points and trees of cells from files, and binary glTF: what each format says, cut, changed and refused."""

from __future__ import annotations

import json
import logging
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.geometry.composite import PointCloud
from planner_service.geometry.mesh_formats import read_triangles
from planner_service.geometry.scans import read_scan
from tests.support.fuzz import changed

POINTS = np.array([(0.125, 0.25, 0.375), (-1.5, 2.0, 0.25), (0.0, -0.5, 1.0), (4.0, 0.5, 0.125)], dtype=np.float32)


def pcd(form: str, body: bytes, fields: str = "x y z", **words: str) -> bytes:
    count = len(fields.split())
    header = {"VERSION": "0.7", "FIELDS": fields, "SIZE": "4 " * count, "TYPE": "F " * count, "COUNT": "1 " * count}
    header |= {"WIDTH": str(len(POINTS)), "HEIGHT": "1", "POINTS": str(len(POINTS))} | words | {"DATA": form}
    return "".join(f"{key} {value}\n" for key, value in header.items()).encode() + body


def lzf(data: bytes) -> bytes:
    """As literal runs, and as a copy of eight bytes that came just before."""
    runs = b"".join(bytes([len(data[k : k + 32]) - 1]) + data[k : k + 32] for k in range(0, len(data), 32))
    return runs + bytes([6 << 5, 7])


PACKED = POINTS.T.astype("<f4").tobytes()[:-8] + POINTS.T.astype("<f4").tobytes()[-16:-8]
"""Columns whose last eight bytes repeat the eight before them."""

TREE = b"# Octomap OcTree binary file\n#\nid OcTree\nsize %d\nres 0.05\ndata\n"
OCCUPIED, FREE, INNER = 2, 1, 3


def branch(**children: int) -> bytes:
    """Two bits for each child, ``c0`` to ``c7``."""
    return sum(state << 2 * int(name[1]) for name, state in children.items()).to_bytes(2, "little")


BT = TREE % 18 + branch(c7=INNER) + b"".join(branch(c0=INNER) for _ in range(14)) + branch(c1=OCCUPIED, c6=FREE)
"""From the root down to the cells beside the origin."""


def glb(described: dict[str, Any], buffer: bytes = b"") -> bytes:
    text = json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype="<f4")
FACES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], dtype="<u2")
SOLID: dict[str, Any] = {
    "asset": {"version": "2.0"},
    "scenes": [{"nodes": [0]}],
    "nodes": [{"children": [1], "translation": [0, 0, 2]}, {"mesh": 0, "scale": [2, 2, 2]}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
    ],
    "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
    "buffers": [{"byteLength": 72}],
}
BUFFER = CORNERS.tobytes() + FACES.tobytes()


def file_of(folder: Path, name: str, content: bytes | str) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


XYZ = "".join(f"{x} {y} {z}\n" for x, y, z in POINTS.tolist())
AMONG = "".join(f"7 {x} {y} 0.5 {z}\n" for x, y, z in POINTS.tolist())


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.xyz", XYZ),
        ("b.xyz", f"{len(POINTS)}\n{XYZ.replace(' ', ', ')}"),
        ("c.xyz", "# scan\n//x y z\n" + XYZ),
        ("d.xyz", "id,x,y,r,z\n" + AMONG),
        ("e.pcd", pcd("ascii", XYZ.encode())),
        ("f.pcd", pcd("ascii", AMONG.encode(), "i x y r z")),
        ("g.pcd", pcd("binary", POINTS.astype("<f4").tobytes())),
        ("h.pcd", pcd("binary", b"".join(b"abcd" + row.tobytes() for row in POINTS), "i x y z", TYPE="U F F F")),
    ],
)
def test_points_are_read_wherever_they_stand_in_a_line(tmp_path: Path, name: str, content: bytes | str) -> None:
    assert np.array_equal(read_scan(file_of(tmp_path, name, content)).points.astype(np.float32), POINTS)


def test_compressed_points_repeat_what_came_before(tmp_path: Path) -> None:
    body = lzf(PACKED[:-8])
    packed = struct.pack("<II", len(body), len(PACKED)) + body
    found = read_scan(file_of(tmp_path, "a.pcd", pcd("binary_compressed", packed))).points
    assert np.array_equal(found.astype("<f4"), np.frombuffer(PACKED, "<f4").reshape(3, -1).T)


def test_points_without_coordinates_are_left_out_and_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    text = XYZ.replace("0.125 0.25 0.375", "nan nan nan").encode()
    path = file_of(tmp_path, "a.pcd", pcd("ascii", text, VIEWPOINT="0 0 1 1 0 0 0"))
    with caplog.at_level(logging.WARNING):
        assert len(PointCloud.from_file(path, 0.1).cells) == 3
    assert [word in caplog.text for word in ("1 of 4 points", "VIEWPOINT")] == [True, True]


def test_cells_of_a_tree_are_those_of_the_cloud(tmp_path: Path) -> None:
    """Child 7 of the root begins at the origin; below it the first child 14 times, then the second along x."""
    tree = file_of(tmp_path, "map.bt", BT)
    assert (read_scan(tree).edge, PointCloud.from_file(tree).cells.tolist()) == (0.05, [[1, 0, 0]])
    assert PointCloud.from_file(tree, 0.2).cells.tolist() == [[0, 0, 0]]
    pruned = file_of(tmp_path, "pruned.bt", TREE % 16 + BT[-32:-4] + branch(c0=OCCUPIED))
    assert len(PointCloud.from_file(pruned).cells) == 8
    values = b"".join(struct.pack("<fB", 0.0, 128 if k == 0 else 1) for k in range(16)) + struct.pack("<fB", -0.1, 0)
    full = TREE.replace(b" binary", b"") % 17
    with pytest.raises(InvalidFile, match="no occupied cell"):
        read_scan(file_of(tmp_path, "free.ot", full + values))
    here = file_of(tmp_path, "full.ot", full + values[:-5] + struct.pack("<fB", 0.0, 0))
    assert PointCloud.from_file(here).cells.tolist() == [[0, 0, 0]]
    with pytest.raises(InvalidFile, match=r"expected a resolution of 0.05, 0.1, 0.2"):
        PointCloud.from_file(tree, 0.07)
    with pytest.raises(InvalidFile, match="a tree of cells is in metres"):
        PointCloud.from_file(tree, scale=0.001)


def test_a_cloud_takes_its_unit_and_says_when_it_seems_to_have_another(tmp_path: Path) -> None:
    path = file_of(tmp_path, "mm.xyz", "".join(f"{1000 * x} {1000 * y} {1000 * z}\n" for x, y, z in POINTS.tolist()))
    metres = PointCloud.from_file(file_of(tmp_path, "m.xyz", XYZ), 0.1)
    assert PointCloud.from_file(path, 0.1, 0.001).cells.tolist() == metres.cells.tolist()
    with pytest.raises(InvalidFile, match="millimetres"):
        PointCloud.from_file(path, 0.1)
    with pytest.raises(InvalidRequest, match="scale"):
        PointCloud.from_file(path, 0.1, 0.0)


def test_points_of_las_files_are_those_that_were_written(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    for suffix in (".las", ".laz"):
        header = laspy.LasHeader(point_format=3, version="1.2")
        header.offsets, header.scales = [0.0] * 3, [0.001] * 3
        data = laspy.LasData(header)
        data.x, data.y, data.z = POINTS.T.astype(np.float64)
        data.write(str(tmp_path / f"scan{suffix}"))
        assert np.allclose(read_scan(tmp_path / f"scan{suffix}").points, POINTS, atol=6e-4)
        content = (tmp_path / f"scan{suffix}").read_bytes()
        with pytest.raises(InvalidFile, match=r"cut short|does not read it"):
            read_scan(file_of(tmp_path, f"cut{suffix}", content[:-20]))


def test_meshes_of_glb_files_stand_where_their_nodes_put_them(tmp_path: Path) -> None:
    vertices, faces = read_triangles(file_of(tmp_path, "a.glb", glb(SOLID, BUFFER)))
    volume = float(np.linalg.det(vertices[faces]).sum() / 6.0)
    assert (vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()) == ([0, 0, 2], [2, 2, 4])
    assert volume == pytest.approx(8.0 / 6.0)
    mirrored = SOLID | {"nodes": [{"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1]}]}
    vertices, faces = read_triangles(file_of(tmp_path, "b.glb", glb(mirrored, BUFFER)))
    assert float(np.linalg.det(vertices[faces]).sum() / 6.0) == pytest.approx(1.0 / 6.0)
    assert vertices.max(axis=0).tolist() == [3, 1, 1]


def _with(**changes: Any) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda described: described | changes


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (_with(extensionsRequired=["KHR_draco_mesh_compression"]), "export it without extensions"),
        (_with(buffers=[{"byteLength": 72, "uri": "a.bin"}]), "export it as one .glb"),
        (_with(nodes=[{"mesh": 0, "skin": 0}]), "export it rigid"),
        (_with(nodes=[{"children": [1], "mesh": 0}, {"children": [0]}]), "in a circle"),
        (_with(nodes=[{"children": [1, 1]}, {"mesh": 0}]), "the child of two"),
        (_with(scene=4), "scene 4"),
        (_with(meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]}]), "expected triangles"),
        (_with(meshes=[{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1}}]}]), "JOINTS_0"),
        (_with(accessors=[SOLID["accessors"][0] | {"count": 5}, SOLID["accessors"][1]]), "not all in the buffer"),
        (_with(nodes=[{"mesh": 0, "rotation": [0, 0, 0, 2]}]), "unit quaternion"),
    ],
)
def test_a_surface_that_would_not_be_whole_is_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], dict[str, Any]], expected: str
) -> None:
    with pytest.raises(InvalidFile, match=expected):
        read_triangles(file_of(tmp_path, "a.glb", glb(change(SOLID), BUFFER)))


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.pcd", pcd("ascii", XYZ.encode()[:-10]), r"lines of points|numbers; the header"),
        ("a.pcd", pcd("binary", b"1234"), "cut short"),
        ("a.pcd", pcd("ascii", XYZ.encode(), "x y w"), "expected x, y and z"),
        ("a.pcd", pcd("ascii", XYZ.encode(), COLOUR="1"), "no word of a PCD header"),
        ("a.pcd", pcd("binary_compressed", struct.pack("<II", 3, 48) + b"\xe0\x01\x09"), "not there"),
        ("a.bt", TREE % 2 + branch(c0=INNER), "cut short"),
        ("a.bt", TREE % 900 + branch(c0=OCCUPIED), "the header says 900"),
        ("a.xyz", "1 2 3\n4 5\n", "line 2"),
        ("a.xyz", "1 2 x\n", "line 1"),
        ("a.las", b"LASF" + b"\0" * 300, "does not read it"),
    ],
)
def test_what_is_no_scan_is_refused(tmp_path: Path, name: str, content: bytes | str, expected: str) -> None:
    with pytest.raises(InvalidFile, match=expected):
        read_scan(file_of(tmp_path, name, content))


GOOD = {
    "a.pcd": pcd("binary", POINTS.astype("<f4").tobytes()),
    "a.bt": BT,
    "a.xyz": XYZ.encode(),
    "a.glb": glb(SOLID, BUFFER),
}


@pytest.mark.parametrize("name", GOOD)
def test_a_broken_file_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    path = tmp_path_factory.getbasetemp() / name

    @settings(max_examples=100)
    @given(content=changed(GOOD[name], b"\xff\xff\xff\x7f", b"1e308"))
    def check(content: bytes) -> None:
        path.write_bytes(content)
        with suppress(InvalidFile):
            if name.endswith(".glb"):
                read_triangles(path)
            else:
                PointCloud.from_file(path)

    check()

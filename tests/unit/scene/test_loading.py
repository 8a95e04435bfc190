"""Which file is read by whom, and what a file of one obstacle becomes."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.errors import InvalidFile, UnknownName
from planner_service.geometry.composite import Compound, PointCloud
from planner_service.scene.loading import READERS, load_scene
from planner_service.scene.scene import Scene

CUBE = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
PLY = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"


def rows(points: np.ndarray[Any, Any]) -> str:
    return "".join(f"{x} {y} {z}\n" for x, y, z in points.tolist())


def test_a_plain_file_name_is_a_file_and_a_name_of_the_package_a_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("post").write_text("no scene")
    assert load_scene("post").name == "post"
    Path("cell.xyz").write_text(rows(CUBE))
    assert load_scene("cell.xyz") == load_scene(tmp_path / "cell.xyz")
    Path("cell.step").write_text("")
    with pytest.raises(InvalidFile) as refused:
        load_scene("cell.step")
    assert [suffix for suffix in READERS if suffix not in str(refused.value)] == []
    with pytest.raises(UnknownName):
        load_scene("cel")
    with pytest.raises(InvalidFile, match="no such file"):
        load_scene("missing.pcd")


def test_a_ply_file_is_a_mesh_if_it_has_faces_and_a_cloud_if_not(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(f"{PLY}end_header\n{rows(CUBE)}")
    (tmp_path / "b.ply").write_text(f"{PLY}{FACES}end_header\n{rows(CUBE)}4 0 3 5 6\n")
    clouds = [isinstance(load_scene(tmp_path / path).obstacles[0].shape, PointCloud) for path in ("a.ply", "b.ply")]
    assert clouds == [True, False]


def ell(path: Path) -> Path:
    """An L of two boxes, 1 m by 1 m by 0.2 m."""
    outline = [(0, 0), (1, 0), (1, 0.2), (0.2, 0.2), (0.2, 1), (0, 1)]
    vertices = [(*corner, z) for z in (0.0, 0.2) for corner in outline]
    low = [(1, 3, 2), (1, 4, 3), (1, 5, 4), (1, 6, 5)]
    high = [(a + 6, c + 6, b + 6) for a, b, c in low]
    sides = [(k, k % 6 + 1, k % 6 + 7) for k in range(1, 7)] + [(k, k % 6 + 7, k + 6) for k in range(1, 7)]
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in [*low, *high, *sides]]
    path.write_text("\n".join(lines))
    return path


def test_a_mesh_is_cut_where_its_hull_fills_much_more(tmp_path: Path) -> None:
    scene = load_scene(ell(tmp_path / "ell.obj"))
    shape = scene.obstacles[0].shape
    assert isinstance(shape, Compound)
    assert float(shape.distance(np.array([(0.7, 0.7, 0.1)]))[0]) > 0.3
    assert float(shape.distance(np.array([(0.9, 0.1, 0.1), (0.1, 0.9, 0.1)])).max()) == 0.0


@pytest.mark.parametrize(("name", "factor"), [("mm.xyz", 25.0), ("mm.obj", 300.0), ("far.xyz", 4000.0)])
def test_a_size_of_another_unit_gets_the_scene_file_that_helps(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str, factor: float
) -> None:
    """The step that the message names is taken, and gives an obstacle of the right size."""
    path = ell(tmp_path / name) if name.endswith(".obj") else tmp_path / name
    corners = CUBE if name.endswith(".xyz") else None
    if corners is not None:
        path.write_text(rows(factor * corners))
    else:
        path.write_text("\n".join(_scaled(line, factor) for line in path.read_text().splitlines()))
    with caplog.at_level(logging.WARNING):
        try:
            load_scene(path)
            told = caplog.text
        except InvalidFile as refused:
            told = str(refused)
    step = told.split("write a scene file beside it: ")[1].splitlines()[0]
    (tmp_path / "cell.toml").write_text(step.replace(" / ", "\n"))
    scene: Scene = load_scene(tmp_path / "cell.toml")
    shape = scene.obstacles[0].shape
    size = (shape.support(np.eye(3)) - shape.support(-np.eye(3))).diagonal()
    assert float(size.max()) == pytest.approx(factor / 1000.0, abs=0.011)


def _scaled(line: str, factor: float) -> str:
    word, *numbers = line.split()
    return line if word == "f" else " ".join([word, *(str(factor * float(number)) for number in numbers)])


ARRAYS: dict[str, tuple[Any, str]] = {
    "points with colours": (np.hstack([CUBE, CUBE]), "points[:, :3]"),
    "points as columns": (CUBE.T, "points.T"),
    "a grid of points": (CUBE.reshape(2, 4, 3), "points.reshape(-1, 3)"),
    "points that were not seen": (np.vstack([CUBE, [[np.nan] * 3]]), "points[~np.isnan(points).any(axis=1)]"),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_that_is_no_list_of_points_gets_the_line_that_makes_it_one(tmp_path: Path, name: str) -> None:
    points, line = ARRAYS[name]
    np.save(tmp_path / "a.npy", points)
    with pytest.raises(InvalidFile) as refused:
        load_scene(tmp_path / "a.npy")
    assert str(refused.value).endswith(f"keep {line}"), "and no word of another scale, which would not help"
    np.save(tmp_path / "a.npy", eval(line, {"points": points, "np": np}))
    np.save(tmp_path / "b.npy", CUBE)
    (one,), (other,) = (load_scene(tmp_path / file).obstacles for file in ("a.npy", "b.npy"))
    assert one.shape == other.shape


@pytest.mark.parametrize(("name", "step"), [("a.gltf", ".glb"), ("a.CSV", "called .xyz"), ("a.step", ".stl or .glb")])
def test_a_suffix_that_is_not_read_gets_the_one_to_write(tmp_path: Path, name: str, step: str) -> None:
    (tmp_path / name).write_text("0;0;0\n1;1;1\n")
    with pytest.raises(InvalidFile, match=f"suffix .* expected a scene, one of .*{step}"):
        load_scene(tmp_path / name)
    if name == "a.CSV":
        (tmp_path / name).rename(tmp_path / "a.xyz")
        assert isinstance(load_scene(tmp_path / "a.xyz").obstacles[0].shape, PointCloud)

"""Meshes in scene files, URDFs and plan files: read, saved and told apart by their corners."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner_service.geometry.mesh import Mesh
from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.scene import Obstacle, Scene
from tests.support.hull_arm import RAMP, ROCK, HullSetup, binary_stl, write_arm


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("hulls")
    write_arm(place)
    return place


def test_a_scene_file_with_meshes_gives_the_same_scene_when_saved_and_loaded(folder: Path, tmp_path: Path) -> None:
    points = np.asarray(ROCK.vertices * 1000.0, dtype=np.float32).astype(np.float64)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "rock.stl").write_bytes(binary_stl(points))
    scaled = Mesh(points * [0.001, -0.001, 0.001])
    tables = "\n".join(
        [
            '[[obstacle]]\nname = "rock"\nposition = [0.4, 0.1, 0.2]',
            'mesh = { file = "parts/rock.stl", scale = [0.001, -0.001, 0.001] }',
            '[[obstacle]]\nname = "far"\nmesh = "parts/../parts/rock.stl"\nposition = [0, 0, -900]',
            '[[attached]]\nname = "ramp"\nposition = [0, 0, 0]\ntouch_links = ["hand"]',
            f"mesh = {{ vertices = {RAMP.vertices.tolist()} }}",
        ]
    )
    (tmp_path / "scene.toml").write_text(tables)
    scene = load_scene(tmp_path / "scene.toml")
    assert [o.shape for o in scene.obstacles] == [scaled, Mesh(points)]
    assert scene.attached[0].shape == RAMP
    save_scene(scene, tmp_path / "elsewhere.toml")
    (tmp_path / "parts" / "rock.stl").unlink()
    again = load_scene(tmp_path / "elsewhere.toml")
    assert again == scene
    assert again.hash == scene.hash
    moved = replace(scene, obstacles=(Obstacle("rock", Mesh(points * 0.001), scene.obstacles[0].pose),))
    nudged = ROCK.vertices.copy()
    nudged[0, 0] = np.nextafter(nudged[0, 0], -1.0)
    assert len({scene.hash, moved.hash, _alone(ROCK).hash, _alone(Mesh(nudged)).hash}) == 4


def _alone(mesh: Mesh) -> Scene:
    return Scene((Obstacle("rock", mesh),))


def test_links_of_a_urdf_are_the_scaled_hulls_of_their_files(folder: Path) -> None:
    robot = HullSetup("read", folder).robot()
    shapes = {item.link: item.shape for item in robot.shapes if isinstance(item.shape, Mesh)}
    fore = Mesh.from_file(folder / "robot" / "meshes" / "fore.stl")
    assert shapes["fore"] == Mesh(fore.vertices * [-0.001, 0.002, 0.001])
    assert shapes["upper"] == Mesh.from_file(folder / "packages" / "arm" / "upper.stl", (0.001, 0.001, 0.001))
    assert shapes["upper"].vertices[:, 0].min() == pytest.approx(5.0)

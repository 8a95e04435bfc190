"""Edits of cells as the viewer's page makes them, with hostile names, numbers, rays and file names."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.attack.harness import Case, Part, Wrong
from planner_service.scene.loading import load_scene
from planner_service.view.cell.edits import MAX_UNDONE, NEW, Cell
from planner_service.view.cell.folder import CellFolder
from planner_service.view.cell.surfaces import Surfaces

__all__ = ["Attack"]

NAMES = (
    *("crate", "bin_floor", "blue_block", "", " x", "x" * 64, "x" * 65, "a\nb", "a\0b", "\ud800", "\u202egnp", "1e999"),
    *("<img src=x onerror=alert(1)>", "</script>", "{process.env}", "[x](javascript:alert(1))", '"]\n[[obstacle]]'),
    *("crate (link)", "\u5ffd\u7565", "e\u0301", "crate_2", "'''", "\\"),
)
FILES = (
    *("mine", "bin.toml", "../mine", "a/b", "/tmp/mine", "..", ".", "", ".hidden", "link", "folder", "x" * 65, "a\0b"),
    *("con", "a b", "a.toml.toml", "~root", "%2e%2e%2fmine", "mesh.stl", "cloud.npy", "broken.stl", "\ud800", "mine "),
)
NUMBERS = (
    *(0.0, -0.0, 0.05, 0.1, 0.3, 1.0, -1.0, 1e-9, 5e-324, 1e-3, 999.0, 1000.0, 1001.0, 1e6, -1e6, 1e308),
    *(float("nan"), float("inf"), -float("inf")),
)
COLOURS = ("#c86432", "#000000", "#fff", "red", "#12345g", "", "#C86432")

NEAR = 1e-5
"""Metres from an obstacle at which a ray has met it."""


class Attack(Part):
    name = "cells"
    what = "edits of a cell with hostile names, sizes, poses and rays; scenes saved under hostile file names"

    def __init__(self) -> None:
        super().__init__()
        self._start = ps.load_scene("bin")

    def draw(self, rng: np.random.Generator) -> Case:
        return {"edits": [self._edit(rng) for _ in range(int(rng.integers(1, 30)))]}

    def _edit(self, rng: np.random.Generator) -> list[Any]:
        def one(values: Any) -> Any:
            return values[int(rng.integers(len(values)))]

        def numbers(count: int) -> list[float]:
            calm = rng.random() < 0.7
            return [float(rng.uniform(-0.6, 0.6)) if calm else float(one(NUMBERS)) for _ in range(count)]

        drawn: dict[str, Callable[[], list[Any]]] = {
            "add": lambda: [one(list(NEW)), numbers(2)],
            "name": lambda: [one(NAMES)],
            "size": lambda: [[abs(value) for value in numbers(int(rng.integers(0, 5)))]],
            "move": lambda: [numbers(3), numbers(4)],
            "drag": lambda: [numbers(3), [1.0, 0.0, 0.0, 0.0]],
            "colour": lambda: [one(COLOURS)],
            "select": lambda: [one(NAMES)],
            "set down": list,
            "copy": list,
            "delete": list,
            "undo": list,
            "ray": lambda: [numbers(3), numbers(3)],
            "save": lambda: [one(FILES), bool(rng.random() < 0.5)],
            "load": lambda: [one(FILES), one(("m", "mm", "inch"))],
        }
        what = one(list(drawn))
        return [what, *drawn[what]()]

    def run(self, case: Case) -> int:
        with tempfile.TemporaryDirectory() as place:
            folder = _filled(Path(place))
            outside = _content(Path(place))
            cell = Cell(self._start)
            for what, *given in case["edits"]:
                try:
                    cell = _done(cell, folder, what, given)
                    self.counted["done"] += 1
                except ps.PlannerServiceError:
                    self.counted["refused"] += 1
                if cell.selected is not None and cell.obstacle is None:
                    raise Wrong("what is selected is there")
                if len(cell.before) > MAX_UNDONE:
                    raise Wrong("edits that can be undone are limited")
                if _content(Path(place)) != outside:
                    raise Wrong("nothing is written outside of the folder")
        return len(case["edits"])


def _done(cell: Cell, folder: CellFolder, what: str, given: list[Any]) -> Cell:
    """The cell after an edit."""
    if what == "ray":
        _look(cell, *(np.array(each) for each in given))
        return cell
    if what == "save":
        name, again = given
        path = folder.save(cell.scene, name, replace=again)
        if path is not None and (path.parent != folder.path or load_scene(path) != cell.scene):
            raise Wrong("what is saved is the scene, in the folder")
        return cell
    if what in ("move", "drag"):
        pose = ps.Pose(tuple(given[0]), tuple(given[1]))
        return cell.moved(pose) if what == "move" else cell.dragged(pose)
    edits: dict[str, Callable[..., Cell]] = {
        "add": lambda kind, place: cell.added(kind, tuple(place)),
        "name": cell.renamed,
        "size": cell.shaped,
        "colour": cell.coloured,
        "select": cell.select,
        "set down": cell.set_down,
        "copy": cell.copied,
        "delete": cell.deleted,
        "undo": cell.undone,
        "load": lambda name, unit: cell.with_obstacles(folder.load(name, unit)),
    }
    return edits[what](*given)


def _look(cell: Cell, origin: Any, direction: Any) -> None:
    """What a ray meets is there."""
    hit = Surfaces(cell.scene).met_by(origin, direction)
    if hit is None:
        return
    obstacle = cell.scene.obstacle(hit.name)
    local = obstacle.pose.rotation.T @ (hit.point - np.array(obstacle.pose.position))
    if not float(obstacle.shape.distance(local[None])[0]) <= NEAR:
        raise Wrong("what a ray meets is there", hit.name)
    if not abs(float(hit.normal @ hit.normal) - 1.0) < 1e-6:
        raise Wrong("a surface has a normal of length 1", hit.name)


def _filled(place: Path) -> CellFolder:
    """A folder with good, broken and misleading files in it, and more beside it."""
    inside = place / "cells"
    (inside / "folder.toml").mkdir(parents=True)
    (place / "mine.toml").write_text('name = "beside"\n')
    (inside / "link.toml").symlink_to(place / "mine.toml")
    (inside / "mesh.stl").write_text(
        "solid a\n"
        + "".join(
            f"facet normal 0 0 0\nouter loop\n{a}{b}{c}endloop\nendfacet\n"
            for a, b, c in (
                ("vertex 0 0 0\n", "vertex 0 100 0\n", "vertex 100 0 0\n"),
                ("vertex 0 0 0\n", "vertex 100 0 0\n", "vertex 0 0 100\n"),
                ("vertex 0 0 0\n", "vertex 0 0 100\n", "vertex 0 100 0\n"),
                ("vertex 100 0 0\n", "vertex 0 100 0\n", "vertex 0 0 100\n"),
            )
        )
        + "endsolid a\n"
    )
    (inside / "broken.stl").write_bytes(b"solid \xff" * 50)
    np.save(inside / "cloud.npy", np.random.default_rng(0).uniform(0.0, 0.2, (200, 3)))
    return CellFolder(inside)


def _content(place: Path) -> dict[str, str | None]:
    """What is beside the folder, by name: its text, or None for what has none."""
    return {path.name: path.read_text() if path.is_file() else None for path in place.iterdir()}

"""Reachability maps on the page: what is drawn of a slice, when, and what is refused."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planner_service import Box, Obstacle, PlannerService, Robot, Scene, load_robot
from planner_service.errors import InvalidRequest
from planner_service.view import open_viewer
from planner_service.view.controls.map_layer import MapLayer
from planner_service.workspace import ReachabilityMap, ToolOrientation, VoxelGrid, VoxelVerdict, reachability

DOWN = ToolOrientation((0.5**0.5, 0.0, 0.5**0.5, 0.0))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("wxai")


@pytest.fixture(scope="module")
def found(robot: Robot) -> ReachabilityMap:
    grid = VoxelGrid((0.0, -0.4, 0.0), (0.8, 0.4, 0.2), (4, 4, 2))
    return reachability(robot, Scene(), grid, [DOWN, ToolOrientation((1.0, 0.0, 0.0, 0.0))])


class Panel:
    """viser's panel and scene, as far as the layer knows them: controls and nodes by name."""

    def __init__(self) -> None:
        self.controls, self.nodes = dict[str, Any](), dict[str, Any]()

    @contextlib.contextmanager
    def add_folder(self, _: str) -> Iterator[None]:
        yield

    def add_dropdown(self, name: str, values: tuple[str, ...], **more: Any) -> Any:
        return self._added(name, more.get("initial_value", values[0]), values=values)

    def add_slider(self, name: str, low: int, high: int, step: int, value: int) -> Any:
        return self._added(name, value, max=high, visible=True)

    def add_html(self, content: str) -> Any:
        return self._added("legend", None, content=content)

    def _added(self, name: str, value: Any, **more: Any) -> Any:
        control = SimpleNamespace(value=value, **more)
        control.on_update = lambda act: setattr(control, "act", act)
        self.controls[name] = control
        return control

    def add_mesh_simple(self, name: str, vertices: Any, faces: Any, **_: Any) -> Any:
        node = SimpleNamespace(vertices=vertices, faces=faces, remove=lambda: self.nodes.pop(name))
        self.nodes[name] = node
        return node

    def choose(self, name: str, value: Any) -> None:
        self.controls[name].value = value
        self.controls[name].act(None)

    def squares(self, kind: VoxelVerdict) -> set[tuple[float, ...]]:
        """Their centres, to millimetres."""
        node = self.nodes.get(f"/map/{int(kind)}")
        middles = [] if node is None else node.vertices.reshape(-1, 4, 3).mean(axis=1)
        return {tuple(np.round(np.asarray(middle, dtype=float), 3).tolist()) for middle in middles}


def handler(act: Callable[[], Any]) -> Callable[[Any], None]:
    return lambda _: act()


def test_a_slice_is_drawn_where_its_voxels_are(found: ReachabilityMap) -> None:
    panel = Panel()
    layer = MapLayer(panel, panel, found, handler)

    def agrees(which: int, axis: int, row: int) -> None:
        cells = np.argwhere(np.ones(found.grid.counts, dtype=bool))
        cells = cells[cells[:, axis] == row]
        for kind in VoxelVerdict:
            of_kind = cells[found.verdicts[which][tuple(cells.T)] == kind]
            wanted = {tuple(np.round(row, 3).tolist()) for row in found.grid.centres(of_kind)}
            assert panel.squares(kind) == wanted

    assert panel.squares(VoxelVerdict.REACHABLE)
    agrees(0, 2, panel.controls["voxel"].value)
    panel.choose("voxel", 1 - panel.controls["voxel"].value)
    agrees(0, 2, panel.controls["voxel"].value)
    panel.choose("slice across", "y")
    agrees(0, 1, 2)
    assert "y from 0.000 to 0.200 m" in panel.controls["legend"].content
    panel.choose("tool", panel.controls["tool"].values[1])
    agrees(1, 1, 2)
    layer.fit(Scene((Obstacle("new", Box((0.1, 0.1, 0.1))),)))
    assert not panel.nodes
    assert "before it was edited" in panel.controls["legend"].content
    layer.fit(Scene())
    agrees(1, 1, 2)
    panel.choose("slice across", "hidden")
    assert not panel.nodes


def test_a_map_of_another_scene_is_refused(robot: Robot, found: ReachabilityMap) -> None:
    with pytest.raises(InvalidRequest, match="the scene of the map"):
        open_viewer(PlannerService(robot, "table"), None, port=0, reach=found)
    with pytest.raises(InvalidRequest, match="ReachabilityMap"):
        open_viewer(PlannerService(robot, Scene()), None, port=0, reach="map.npz")  # type: ignore[arg-type]

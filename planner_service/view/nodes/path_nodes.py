"""The tool's paths, and what a search grew, as lines of a viser scene; and the waypoints of the next plan."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.view import lines
from planner_service.view.state import ViewState
from planner_service.view.still.composition import TOOL_PATH

__all__ = ["LAYERS", "PathNodes", "WaypointNodes"]

GRAPH, SEARCHED, SHORTCUT = (150, 160, 175), (230, 140, 40), (160, 80, 190)
LAYERS = ("tree or roadmap (grey)", "path as searched (orange)", "path cut short (purple)", "path of the plan (blue)")

Lines = dict[str, tuple[FloatArray, tuple[int, int, int], float]]


class PathNodes:
    """The lines of each of ``LAYERS``.

    Args:
        scene: viser's scene.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._nodes: dict[str, Any] = {}

    def show(self, state: ViewState, visible: Callable[[str], bool]) -> None:
        """Draw what there is of each layer."""
        for node in self._nodes.values():
            node.remove()
        self._nodes = {
            name: self._scene.add_line_segments(
                f"/lines/{LAYERS.index(name)}", points.astype(np.float32), colour, thickness=thickness,
                visible=visible(name),
            )
            for name, (points, colour, thickness) in _lines_of(state).items()
        }  # fmt: skip

    def __contains__(self, name: str) -> bool:
        return name in self._nodes

    def choose(self, visible: Callable[[str], bool]) -> None:
        """Show or hide layers."""
        for name, node in self._nodes.items():
            node.visible = visible(name)


def _lines_of(state: ViewState) -> Lines:
    """The lines of each layer that has any, with their colour and thickness."""
    layers: Lines = {}
    robot = state.service.robot
    for segment in state.results:
        result, trace = segment.result, segment.result.trace
        if trace is None:
            continue
        graph = trace.graph
        if graph is None and result.roadmap is not None:
            graph = lines.free_graph(result.roadmap)
        if graph is not None and len(graph.edges):
            layers[LAYERS[0]] = lines.graph_lines(robot, graph), GRAPH, 0.001
        if trace.searched is not None:
            layers[LAYERS[1]] = lines.polyline_lines(robot, trace.searched), SEARCHED, 0.0025
        if trace.shortcut is not None:
            layers[LAYERS[2]] = lines.polyline_lines(robot, trace.shortcut), SHORTCUT, 0.003
    paths = [segment.result.path for segment in state.results if segment.result.path is not None]
    tools = () if state.playback is None else state.playback.tools
    if tools:
        layers[LAYERS[3]] = np.concatenate([lines.point_lines(points) for points in tools]), TOOL_PATH, 0.005
    elif paths:
        curves = np.concatenate([lines.curve_lines(robot, path) for path in paths])
        layers[LAYERS[3]] = curves, TOOL_PATH, 0.005
    return layers


class WaypointNodes:
    """The tool's frames at the waypoints of the next plan: one node.

    Args:
        scene: viser's scene.
        size: Length of their axes in metres.
    """

    def __init__(self, scene: Any, size: float) -> None:
        self._scene, self._size = scene, size
        self._shown: tuple[FloatArray, ...] = ()
        self._node: Any = None

    def show(self, state: ViewState) -> None:
        """Draw them."""
        if state.waypoints is self._shown:
            return
        self._shown = state.waypoints
        if self._node is not None:
            self._node.remove()
            self._node = None
        if state.waypoints:
            poses = [Pose.from_matrix(state.service.robot.tool_pose(q)) for q in state.waypoints]
            turns, places = [pose.quaternion for pose in poses], [pose.position for pose in poses]
            self._node = self._scene.add_batched_axes(
                "/waypoints", np.array(turns), np.array(places), axes_length=self._size, axes_radius=0.04 * self._size
            )

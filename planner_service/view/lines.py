"""Paths and search graphs as lines traced by the tool: segments (k, 2, 3) between points in the world, in metres."""

from __future__ import annotations

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.grasping.guards import tool_frames
from planner_service.path.joint_path import JointPath
from planner_service.roadmap import Roadmap, Verdict
from planner_service.robot.model import Robot
from planner_service.search.trace import SearchGraph

__all__ = ["curve_lines", "free_graph", "graph_lines", "point_lines", "polyline_lines", "tool_points"]

STEP = 0.1
"""Radians of an edge per segment: along a straight edge the tool moves on a curve."""

MAX_EDGES = 5_000
"""Edges drawn of a tree or a roadmap; of a larger one so many, evenly spread."""

MAX_PIECES = 8
CURVE = 300


def tool_points(robot: Robot, Q: FloatArray) -> FloatArray:
    """Positions (m, 3) of the tool frame's origin at configurations Q (m, n)."""
    return tool_frames(robot, Q)[0]


def curve_lines(robot: Robot, path: JointPath) -> FloatArray:
    """The lines of a path, blends included."""
    return point_lines(tool_points(robot, path(np.linspace(0.0, path.length, CURVE))))


def point_lines(points: FloatArray) -> FloatArray:
    """The lines from each point (m, 3) to the next."""
    return np.stack([points[:-1], points[1:]], axis=1)


def polyline_lines(robot: Robot, points: FloatArray) -> FloatArray:
    """The lines of a polyline through configurations (N, n)."""
    return _edges(robot, points[:-1], points[1:])


def graph_lines(robot: Robot, graph: SearchGraph) -> FloatArray:
    """The lines of the edges of a tree or a roadmap, at most ``MAX_EDGES`` of them."""
    edges = graph.edges
    if len(edges) > MAX_EDGES:
        edges = edges[np.linspace(0, len(edges) - 1, MAX_EDGES).astype(np.intp)]
    return _edges(robot, graph.milestones[edges[:, 0]], graph.milestones[edges[:, 1]])


def free_graph(roadmap: Roadmap) -> SearchGraph:
    """The milestones of a roadmap, and its edges that are known to be free."""
    free = np.asarray(roadmap.edge_knowledge.verdicts) == Verdict.FREE
    return SearchGraph(roadmap.milestones, roadmap.edges[free])


def _edges(robot: Robot, first: FloatArray, second: FloatArray) -> FloatArray:
    if not len(first):
        return np.zeros((0, 2, 3))
    length = np.sqrt(((second - first) ** 2).sum(axis=1))
    pieces = np.clip(np.ceil(length / STEP), 1, MAX_PIECES).astype(np.intp)
    row = np.repeat(np.arange(len(first)), pieces)
    k = np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    shares = (k / pieces[row], (k + 1) / pieces[row])
    ends = [tool_points(robot, first[row] + share[:, None] * (second - first)[row]) for share in shares]
    return np.stack(ends, axis=1)

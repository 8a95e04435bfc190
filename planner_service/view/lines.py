"""Paths and search trees as lines that the tool draws: segments (k, 2, 3) between points in the world, in metres."""

from __future__ import annotations

import numpy as np

from planner_service.geometry.shapes import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.roadmap import Roadmap, Verdict
from planner_service.robot.model import Robot
from planner_service.search.trace import SearchGraph

__all__ = ["curve_lines", "free_graph", "graph_lines", "polyline_lines", "tool_points"]

STEP = 0.1
"""Radians of an edge that become one segment: straight edges are curves to the tool."""

MOST_EDGES = 5_000
"""Of a tree or a roadmap; of a larger one as many are drawn, spread over all."""

MOST_PIECES = 8
CURVE = 300


def tool_points(robot: Robot, Q: FloatArray) -> FloatArray:
    """Where the tool is at configurations Q (m, n), shape (m, 3)."""
    turns, places = robot.body_poses_batch(Q)
    offset = robot.tool_placement[:3, 3]
    return np.asarray(turns[:, robot.tool_body] @ offset + places[:, robot.tool_body])


def curve_lines(robot: Robot, path: JointPath) -> FloatArray:
    """A path with its blends."""
    points = tool_points(robot, path(np.linspace(0.0, path.length, CURVE)))
    return np.stack([points[:-1], points[1:]], axis=1)


def polyline_lines(robot: Robot, points: FloatArray) -> FloatArray:
    """A polyline through configurations (N, n)."""
    return _edges(robot, points[:-1], points[1:])


def graph_lines(robot: Robot, graph: SearchGraph) -> FloatArray:
    """The edges of a tree or a roadmap."""
    edges = graph.edges
    if len(edges) > MOST_EDGES:
        edges = edges[np.linspace(0, len(edges) - 1, MOST_EDGES).astype(np.intp)]
    return _edges(robot, graph.milestones[edges[:, 0]], graph.milestones[edges[:, 1]])


def free_graph(roadmap: Roadmap) -> SearchGraph:
    """The milestones of a roadmap, and the edges that are known to be free."""
    free = np.asarray(roadmap.edge_knowledge.verdicts) == Verdict.FREE
    return SearchGraph(roadmap.milestones, roadmap.edges[free])


def _edges(robot: Robot, first: FloatArray, second: FloatArray) -> FloatArray:
    if not len(first):
        return np.zeros((0, 2, 3))
    length = np.sqrt(((second - first) ** 2).sum(axis=1))
    pieces = np.clip(np.ceil(length / STEP), 1, MOST_PIECES).astype(np.intp)
    row = np.repeat(np.arange(len(first)), pieces)
    k = np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    shares = (k / pieces[row], (k + 1) / pieces[row])
    ends = [tool_points(robot, first[row] + share[:, None] * (second - first)[row]) for share in shares]
    return np.stack(ends, axis=1)

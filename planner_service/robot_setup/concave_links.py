"""Links whose hulls block configurations that are free: which of a robot's meshes are worth cutting into pieces."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.decomposition import concave_surface, pieces_of_surface
from planner_service.geometry.mesh import Mesh, MeshFile
from planner_service.geometry.shapes import Shape
from planner_service.presentation.progress import bar
from planner_service.robot.model import Robot
from planner_service.robot.urdf_model import Urdf, UrdfLink
from planner_service.robot_setup.self_collision_matrix import SAMPLES, draws
from planner_service.scene.scene import Scene

__all__ = ["cut_where_hulls_block"]

WORTH = 2
"""Of the 1,000 configurations, how many pieces must free: each of them is looked at in every check."""

Pieces = Mapping[MeshFile | None, tuple[Mesh, ...]]


def cut_where_hulls_block(urdf: Urdf, robot: Robot, *, progress: bool | None = None) -> tuple[Urdf, tuple[str, ...]]:
    """A robot's description with some links cut into convex pieces, and their names.

    They are those with meshes whose hulls touch other links where the pieces do not, in some of 1,000 configurations;
    none if that frees fewer than two of these. A mesh whose file is not known is its hull, as those of MJCF are for
    MuJoCo.

    Args:
        robot: What the description makes, with the contacts that are allowed whatever its shapes.
        progress: Whether a bar on standard error shows how many meshes are cut; None: if it is a terminal.
    """
    if not any(_file(item.shape) for item in robot.shapes):
        return urdf, ()
    touching = _touching(robot, draws(robot, SAMPLES))
    doubtful = {link for pairs in touching.values() for links in pairs for link in links}
    meshes = {_file(item.shape): item.shape for item in robot.shapes if item.link in doubtful}
    pieces = _cut([mesh for mesh in meshes.values() if isinstance(mesh, Mesh)], progress)
    cut = {item.link for item in robot.shapes if len(pieces.get(_file(item.shape), ())) > 1}
    shapes = ((item, piece) for item in robot.shapes for piece in pieces.get(_file(item.shape), (item.shape,)))
    other = replace(robot, shapes=tuple(replace(item, shape=piece) for item, piece in shapes))
    left = _touching(other, np.array(list(touching))) if cut else touching
    if sum(not left.get(q) for q in touching) < WORTH:
        return urdf, ()
    apart = {links for q, pairs in touching.items() for links in pairs - left.get(q, frozenset())}
    worth = cut.intersection(link for links in apart for link in links)
    names = tuple(link.name for link in urdf.links if link.name in worth)
    return _with_pieces(urdf, names, pieces), names


def _touching(robot: Robot, Q: FloatArray) -> dict[tuple[float, ...], frozenset[tuple[str, str]]]:
    """The pairs of links that touch, by those of configurations (m, n) in which some do."""
    checker = CollisionChecker(robot, Scene())
    return {tuple(q.tolist()): checker.touching(q) for q in Q[~checker.states_are_free(Q)]}


def _with_pieces(urdf: Urdf, links: Collection[str], pieces: Pieces) -> Urdf:
    def cut(link: UrdfLink) -> UrdfLink:
        if link.name not in links:
            return link
        solids = ((item, piece) for item in link.collisions for piece in pieces.get(_file(item.shape), (item.shape,)))
        return replace(link, collisions=tuple(replace(item, shape=piece) for item, piece in solids))

    return replace(urdf, links=tuple(map(cut, urdf.links)))


def _file(shape: Shape) -> MeshFile | None:
    return shape.source if isinstance(shape, Mesh) else None


def _cut(meshes: Sequence[Mesh], progress: bool | None) -> Pieces:
    """The pieces of meshes whose files are known and whose hulls fill what may be free, cut side by side."""
    surfaces = {mesh.source: (mesh, *surface) for mesh in meshes if (surface := concave_surface(mesh)) is not None}
    with bar("meshes cut", progress if surfaces else False) as tell, ThreadPoolExecutor(os.cpu_count()) as pool:
        cuts = {file: pool.submit(pieces_of_surface, *surface) for file, surface in surfaces.items()}
        for done, _ in enumerate(as_completed(cuts.values()), 1):
            if tell is not None:
                tell(done, len(cuts))
    return {file: cut.result() for file, cut in cuts.items()}

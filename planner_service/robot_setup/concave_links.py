"""Links whose hulls block configurations that are free: which of a robot's meshes are worth cutting into pieces."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.collision.fcl import FclObjects, surface_geometry
from planner_service.files.disk_cache import DiskCache, cache_folder
from planner_service.files.reading import read_bytes
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.decomposition import VERSION, concave_surface, pieces_of_surface, surface_of
from planner_service.geometry.mesh import Mesh, MeshFile
from planner_service.geometry.mesh_formats import MAX_BYTES
from planner_service.geometry.shapes import Shape
from planner_service.presentation.progress import bar
from planner_service.robot.model import Robot
from planner_service.robot.urdf_model import Urdf, UrdfLink
from planner_service.robot_setup.self_collision_matrix import SAMPLES, draws
from planner_service.scene.scene import Scene

__all__ = ["cut_where_hulls_block"]

WORTH = 2
"""Of the 1,000 configurations, how many pieces must free: each of them is looked at in every check."""

CHOICE = 1
"""Of the way to choose links, in the keys of what is kept on disk: raise it when that changes."""

Pair = tuple[str, str]
Touching = Mapping[tuple[float, ...], frozenset[Pair]]
Pieces = Mapping[MeshFile | None, tuple[Mesh, ...]]


def cut_where_hulls_block(urdf: Urdf, robot: Robot, *, progress: bool | None = None) -> tuple[Urdf, tuple[str, ...]]:
    """A robot's description with some links cut into convex pieces, and their names.

    They are those with meshes whose hulls touch other links where the pieces do not, in some of 1,000 configurations;
    none if that frees fewer than two of these. A mesh whose file is not known is its hull, as those of MJCF are for
    MuJoCo.

    Which links these are is cached on disk. A changed cache has others cut, or none, which makes shapes looser or
    tighter; they contain the meshes all the same.

    Args:
        robot: What the description makes, with the contacts that are allowed whatever its shapes.
        progress: Whether standard error shows how many meshes are cut; None: if it is a terminal.

    Raises:
        InvalidFile: a file with a mesh cannot be read any more.
    """
    files = [item.shape.source for item in robot.shapes if isinstance(item.shape, Mesh) and item.shape.source]
    if not files:
        return urdf, ()
    cache, key = DiskCache(cache_folder()), _key(robot, files)
    links = _kept_links(cache.get(key), robot)
    if links is None:
        links, pieces = _blocking(robot, progress)
        cache.put(key, json.dumps(sorted(links)).encode())
    else:
        pieces = _cut(_meshes(robot, links), progress)
    links &= {item.link for item in robot.shapes if len(pieces.get(_file(item.shape), ())) > 1}
    return _with_pieces(urdf, links, pieces), tuple(link.name for link in urdf.links if link.name in links)


def _key(robot: Robot, files: Collection[MeshFile]) -> str:
    """Of the links to cut, in the cache: they depend on the robot and on what is in its files."""
    content = hashlib.sha256(f"concave links {CHOICE} {VERSION} {robot.hash}".encode())
    for file in dict.fromkeys(files):
        data = hashlib.sha256(read_bytes(file.path, MAX_BYTES)).hexdigest()
        content.update(f" {file.path.suffix} {file.scale} {data}".encode())
    return content.hexdigest()


def _kept_links(data: bytes | None, robot: Robot) -> set[str] | None:
    """The links that ``data`` names, or None if it is no list of links with shapes."""
    try:
        told: Any = json.loads(data or b"")
    except (ValueError, RecursionError):
        return None
    known = {item.link for item in robot.shapes}
    sound = isinstance(told, list) and all(isinstance(name, str) and name in known for name in told)
    return set(told) if sound else None


def _meshes(robot: Robot, links: Collection[str]) -> list[Mesh]:
    """The meshes of links, one for each file."""
    meshes = {_file(item.shape): item.shape for item in robot.shapes if item.link in links}
    return [mesh for mesh in meshes.values() if isinstance(mesh, Mesh)]


def _blocking(robot: Robot, progress: bool | None) -> tuple[set[str], Pieces]:
    """The links whose hulls block what their pieces do not, and the pieces of these and perhaps more."""
    touching = _touching(robot, draws(robot, SAMPLES))
    by_hulls = _with_surfaces_apart(robot, touching)
    if sum(by_hulls[q] == pairs for q, pairs in touching.items()) < WORTH:
        return set(), {}
    doubtful = {link for pairs in by_hulls.values() for links in pairs for link in links}
    pieces = _cut(_meshes(robot, doubtful), progress)
    cut = {item.link for item in robot.shapes if len(pieces.get(_file(item.shape), ())) > 1}
    shapes = ((item, piece) for item in robot.shapes for piece in pieces.get(_file(item.shape), (item.shape,)))
    other = replace(robot, shapes=tuple(replace(item, shape=piece) for item, piece in shapes))
    left = _touching(other, np.array(list(touching))) if cut else touching
    if sum(not left.get(q) for q in touching) < WORTH:
        return set(), pieces
    apart = {links for q, pairs in touching.items() for links in pairs - left.get(q, frozenset())}
    return {link for links in apart for link in links} & cut, pieces


def _with_surfaces_apart(robot: Robot, touching: Touching) -> Touching:
    """Of the pairs of links that touch, those whose triangles do not: pieces contain these, so others touch as well."""
    links = {link for pairs in touching.values() for pair in pairs for link in pair}
    items = [item for item in robot.shapes if item.link in links]
    made = {mesh.source: surface_of(mesh) for mesh in _meshes(robot, links)}
    geometries = {source: surface_geometry(*surface) for source, surface in made.items() if surface is not None}
    known = {k: geometries[file] for k, item in enumerate(items) if (file := _file(item.shape)) in geometries}
    objects = FclObjects([item.shape for item in items], lambda k: items[k].pose.matrix, known)
    rotations, positions = robot.body_poses_batch(np.array(list(touching)).reshape(-1, robot.n))

    def touch(one: str, other: str) -> bool:
        numbers = [[k for k, item in enumerate(items) if item.link == link] for link in (one, other)]
        return any(objects.collide(a, b) for a, b in product(*numbers))

    apart = {}
    for (q, pairs), R, p in zip(touching.items(), rotations, positions, strict=True):
        for k, item in enumerate(items):
            T, body = item.pose.matrix, item.body
            objects.place(k, R[body] @ T[:3, :3], R[body] @ T[:3, 3] + p[body])
        apart[q] = frozenset(pair for pair in pairs if not touch(*pair))
    return apart


def _touching(robot: Robot, Q: FloatArray) -> Touching:
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

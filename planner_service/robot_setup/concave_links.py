"""Links whose hulls block configurations that are free: which of a robot's meshes are worth cutting into pieces."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace

from planner_service.geometry.decomposition import is_concave, pieces_of_mesh
from planner_service.geometry.mesh import Mesh, MeshFile
from planner_service.geometry.shapes import Shape
from planner_service.presentation.progress import bar
from planner_service.robot.model import Robot
from planner_service.robot.urdf_model import Urdf, UrdfLink
from planner_service.robot_setup.link_pair import LinkPair
from planner_service.robot_setup.self_collision_matrix import SAMPLES, draws

__all__ = ["links_worth_cutting", "with_pieces"]


def links_worth_cutting(robot: Robot, *, progress: bool | None = None) -> tuple[str, ...]:
    """The links with meshes whose hulls touch others where their pieces do not, in some of 1,000 configurations.

    A mesh whose file is not known is its hull, as those of MJCF are for MuJoCo.

    Args:
        progress: Whether a bar on standard error shows how many meshes are cut; None: if it is a terminal.
    """
    meshes = {item.shape.source: item.shape for item in robot.shapes if isinstance(item.shape, Mesh)}
    hollow = {file for file, mesh in meshes.items() if is_concave(mesh)}
    concave = {item.link for item in robot.shapes if _file(item.shape) in hollow}
    Q = draws(robot, SAMPLES)
    touching = {}
    for links in robot.link_pairs:
        if not concave.isdisjoint(links):
            hits = ~LinkPair(robot, links).are_free(Q)
            if hits.any():
                touching[links] = Q[hits]
    doubtful = concave.intersection(link for links in touching for link in links)
    files = {_file(item.shape) for item in robot.shapes if item.link in doubtful} & hollow
    pieces = _cut((meshes[file] for file in files), progress)
    cut = {item.link for item in robot.shapes if len(pieces.get(_file(item.shape), ())) > 1}
    worth = set[str]()
    for links, states in touching.items():
        if not worth.issuperset(cut.intersection(links)):
            judge = replace(robot, shapes=tuple(item for item in robot.shapes if item.link in links))
            shapes = tuple(
                replace(item, shape=piece)
                for item in judge.shapes
                for piece in pieces.get(_file(item.shape), (item.shape,))
            )
            if LinkPair(replace(judge, shapes=shapes), links).are_free(states).any():
                worth |= cut.intersection(links)
    return tuple(link for link in dict.fromkeys(item.link for item in robot.shapes) if link in worth)


def with_pieces(urdf: Urdf, links: Collection[str], *, progress: bool | None = None) -> Urdf:
    """A robot's description with the meshes of some links cut into convex pieces."""
    meshes = [item.shape for link in urdf.links if link.name in links for item in link.collisions]
    pieces = _cut((shape for shape in meshes if isinstance(shape, Mesh)), progress)

    def cut(link: UrdfLink) -> UrdfLink:
        if link.name not in links:
            return link
        collisions = (
            (item, piece) for item in link.collisions for piece in pieces.get(_file(item.shape), (item.shape,))
        )
        return replace(link, collisions=tuple(replace(item, shape=piece) for item, piece in collisions))

    return replace(urdf, links=tuple(map(cut, urdf.links)))


def _file(shape: Shape) -> MeshFile | None:
    return shape.source if isinstance(shape, Mesh) else None


def _cut(meshes: Iterable[Mesh], progress: bool | None) -> Mapping[MeshFile | None, tuple[Mesh, ...]]:
    """The pieces of meshes whose files are known, cut side by side."""
    sources = {mesh.source: mesh for mesh in meshes if mesh.source is not None}
    with bar("meshes cut", progress if sources else False) as tell, ThreadPoolExecutor(os.cpu_count()) as pool:
        cuts = {file: pool.submit(pieces_of_mesh, mesh) for file, mesh in sources.items()}
        for done, _ in enumerate(as_completed(cuts.values()), 1):
            if tell is not None:
                tell(done, len(cuts))
    return {file: cut.result() for file, cut in cuts.items()}

"""Contacts of hulls alone: meshes count as their solid hulls, and these may touch where the meshes are apart."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

from planner_service.collision import CollisionChecker, Contact
from planner_service.errors import InvalidFile
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Compound, Solid
from planner_service.geometry.decomposition import MOST, pieces_of_mesh
from planner_service.geometry.mesh import Mesh, MeshFile
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["filled_hulls", "how_to_cut", "only_for_hulls", "touching_by_hulls"]

Pair = tuple[str, str]


def filled_hulls(robot: Robot, scene: Scene, pairs: Iterable[Pair]) -> tuple[str, ...]:
    """The links and objects of some pairs that count as hulls of meshes whose pieces would fill less."""
    cut = _with_pieces(robot, scene, _plain(pairs))
    return () if cut is None else cut[2]


def touching_by_hulls(checker: CollisionChecker, q: FloatArray, contacts: Sequence[Contact]) -> tuple[Pair, ...]:
    """The pairs that touch at q (n,), and would not if their meshes were cut into pieces. Counts one state for these.

    Raises:
        CheckBudgetSpent, TimeBoxSpent: nothing is left for it.
    """
    pairs = [(contact.a, contact.b) for contact in contacts]
    cut = _with_pieces(checker.robot, checker.scene, _plain(pairs))
    if cut is None:
        return ()
    checker.ledger.require_room()
    robot, scene, _ = cut
    other = CollisionChecker(robot, scene, padding=checker.padding, allowed=checker.allowed)
    left = other.touching(q)
    checker.ledger.record_states(1)
    return tuple(pair for pair in pairs if pair not in left)


def only_for_hulls(robot: Robot, scene: Scene, pairs: Iterable[Pair]) -> str:
    """What holds only for the hulls of some pairs, and how to cut them; empty if their hulls are as good as pieces."""
    hulls = filled_hulls(robot, scene, pairs)
    return f"this is so for the hulls of {', '.join(hulls)}: {how_to_cut(robot, hulls)}" if hulls else ""


def how_to_cut(robot: Robot, names: Collection[str]) -> str:
    """What to write so that these links and objects are cut into pieces."""
    links = [name for name in _plain([(name, name) for name in names]) if any(s.link == name for s in robot.shapes)]
    ways = [f"links with decompose = {{{', '.join(f'{link} = {MOST}' for link in links)}}}"] if links else []
    ways += [f"objects with pieces = {MOST}"] if len(links) < len(names) else []
    return f"cut {' and '.join(ways)}"


def _plain(pairs: Iterable[Pair]) -> list[str]:
    """The names of links and objects, without what tells them apart in messages."""
    names = (name.removesuffix(" (link)").removesuffix(" (object)") for pair in pairs for name in pair)
    return list(dict.fromkeys(names))


def _with_pieces(robot: Robot, scene: Scene, names: Collection[str]) -> tuple[Robot, Scene, tuple[str, ...]] | None:
    """The robot and the scene with these links and objects cut, and which could be; None if none could."""
    bodies: list[tuple[str, Solid]] = [(item.link, item.shape) for item in robot.shapes]
    bodies += [(one.name, one.shape) for one in scene.obstacles] + [(one.name, one.shape) for one in scene.attached]
    files = [(name, shape.source) for name, shape in bodies if name in names and isinstance(shape, Mesh)]
    pieces = {(name, file): _pieces(file) for name, file in files if file is not None}
    cut = tuple(dict.fromkeys(name for (name, _), found in pieces.items() if found))
    if not cut:
        return None

    def found(name: str, shape: Solid) -> tuple[Mesh, ...]:
        return pieces.get((name, shape.source), ()) if isinstance(shape, Mesh) and shape.source is not None else ()

    def solid(name: str, shape: Solid) -> Solid:
        return Compound.of_pieces(found(name, shape)) if found(name, shape) else shape

    shapes = ((item, piece) for item in robot.shapes for piece in found(item.link, item.shape) or (item.shape,))
    robot = replace(robot, shapes=tuple(replace(item, shape=piece) for item, piece in shapes))
    obstacles = tuple(replace(one, shape=solid(one.name, one.shape)) for one in scene.obstacles)
    attached = tuple(replace(one, shape=solid(one.name, one.shape)) for one in scene.attached)
    return robot, replace(scene, obstacles=obstacles, attached=attached), cut


@lru_cache(maxsize=256)
def _pieces(file: MeshFile) -> tuple[Mesh, ...]:
    """The pieces of a mesh file; none if its hull is as good, or if it cannot be read any more."""
    try:
        hull = Mesh.from_file(file.path, file.scale)
    except InvalidFile:
        return ()
    pieces = pieces_of_mesh(hull)
    return pieces if len(pieces) > 1 else ()

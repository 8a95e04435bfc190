"""Scenes of one obstacle, from a file of a mesh, of measured points or of a tree of cells."""

from __future__ import annotations

from pathlib import Path

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import tell_notes
from planner_service.geometry.composite import RESOLUTION, Compound, PointCloud, Solid, extent
from planner_service.geometry.decomposition import pieces_of_mesh
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_formats import MESH_SUFFIXES, has_faces
from planner_service.geometry.scans import TREES
from planner_service.geometry.shapes import Pose
from planner_service.scene.scene import Obstacle, Scene

__all__ = ["read_solid_scene"]

MAX_PIECES = 32
"""Convex pieces of a mesh whose hull fills much more than it does."""

LARGE, SMALL = 20.0, 0.005
"""Metres: more, or less, than what stands in the reach of an arm measures if its unit is the metre."""


def read_solid_scene(path: Path, scale: float = 1.0) -> Scene:
    """The scene of the mesh, cloud or tree in a file; the obstacle is called as the file without its suffix.

    A mesh is cut into convex pieces where its hull fills much more than it does. A size that looks like another unit
    gets a warning with the scene file that sets it right, and no cut.

    Args:
        scale: Metres of the file's unit.

    Raises:
        InvalidFile: the file cannot be used.
        MissingDependency: a LAS or LAZ file, and laspy is not installed.
    """
    mesh = path.suffix.lower() in MESH_SUFFIXES and (path.suffix.lower() != ".ply" or has_faces(path))
    notes: list[str] = []
    try:
        solid = _solid(path, mesh, scale)
        size = extent(solid)
        if not SMALL <= float(size.max()) <= LARGE and path.suffix.lower() not in TREES:
            factor = scale * (0.001 if float(size.max()) > LARGE else 1000.0)
            measures = " x ".join(f"{edge:.3g}" for edge in size.tolist())
            notes.append(f"it measures {measures} m; if that is another unit: {_instead(path, mesh, factor)}")
        elif isinstance(solid, Mesh):
            pieces = pieces_of_mesh(solid, MAX_PIECES)
            solid = pieces[0] if len(pieces) == 1 else Compound.of_pieces(pieces)
        scene = Scene((Obstacle(path.stem, solid, Pose()),), name=path.stem)
    except InvalidFile as error:
        try:
            _solid(path, mesh, 0.001)
        except (InvalidFile, InvalidRequest):  # its size is not what is wrong
            raise error from None
        raise InvalidFile(path, [*error.problems, f"if it is in mm: {_instead(path, mesh, 0.001)}"]) from None
    tell_notes(path, notes)
    return scene


def _solid(path: Path, mesh: bool, scale: float = 1.0) -> Solid:
    return Mesh.from_file(path, (scale, scale, scale)) if mesh else PointCloud.from_file(path, scale=scale)


def _instead(path: Path, mesh: bool, factor: float) -> str:
    """A scene file that says what the file alone cannot."""
    scale = (
        f"scale = [{factor:g}, {factor:g}, {factor:g}]" if mesh else f"resolution = {RESOLUTION:g}, scale = {factor:g}"
    )
    kind = "mesh" if mesh else "cloud"
    file = path.name.replace("\\", "\\\\").replace('"', '\\"')
    return (
        f'write a scene file beside it: [[obstacle]] / name = "{path.stem[:40]}" / '
        f'{kind} = {{ file = "{file}", {scale} }} / position = [0, 0, 0]'
    )

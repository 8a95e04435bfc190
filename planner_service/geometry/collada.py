"""Reading COLLADA (.dae) files: the faces of the scene and the vertices that they use, placed by its nodes.

Like other readers of robot descriptions, this one ignores ``<up_axis>``. They differ in whether ``<unit>`` scales the
mesh (RViz and Gazebo apply it, Coal and MoveIt do not), so only metres are accepted. Anything else that would move a
vertex is refused: skins, morphs, animations, and elements that are not known.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from xml.etree.ElementTree import Element

import numpy as np

from planner_service.files.numerals import plain_floats, plain_ints
from planner_service.files.xml_reader import MAX_DEPTH, Malformed, parse_xml
from planner_service.geometry.arrays import FloatArray, IntArray, along, axis_matrix, product

__all__ = ["dae_surface"]

MAX_NODES = 10_000
"""Nodes of the scene, counting each instance: a node may be used many times by nodes that are used many times."""
MAX_PARTS = 50_000
"""Children of these nodes, counted in the same way."""
MAX_PLACED = 2_000_000
"""Vertices of all instances of all geometries."""
MAX_READ = 20_000_000
"""Positions of all geometries, used or not: many may share one source."""

UNIT = 1e-5
"""Error in the length of a unit axis that is written with six digits."""

REFERABLE = ("geometry", "node", "visual_scene", "source", "float_array", "vertices")
IDLE = ("asset", "extra", "instance_camera", "instance_light")
"""Children of a node that move no vertex."""
LINES = ("lines", "linestrips")
STRIPS = ("triangles", "polylist", "polygons", "tristrips", "trifans", *LINES)
SIZES = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3}


def dae_surface(content: bytes) -> tuple[FloatArray, Callable[[], IntArray]]:
    """The vertices (n, 3) that the faces of a COLLADA document use, in metres, as its scene places them.

    Also a function that gives the triangles (t, 3) between them, as rows of vertices. A polygon is a fan around its
    first corner; lines have no triangles; a geometry that its node mirrors still faces outwards.

    Raises:
        Malformed: not COLLADA, too large, not in metres, or with an element that is not understood.
    """
    root = parse_xml(content)
    if _tag(root) != "COLLADA":
        raise Malformed(f"the root element is <{_tag(root)}>; expected <COLLADA>")
    document = _Document(root)
    return document.vertices(), document.triangles


def _tag(element: Element) -> str:
    return element.tag.rpartition(":")[2]


def _all(element: Element, tag: str) -> list[Element]:
    return [child for child in element if _tag(child) == tag]


def _only(element: Element, tag: str) -> Element:
    children = _all(element, tag)
    if len(children) != 1:
        raise Malformed(f"<{_tag(element)}> with {len(children)} <{tag}>; expected one")
    return children[0]


@dataclass(frozen=True, eq=False)
class _Geometry:
    """The vertices (n, 3) that the faces of a mesh use, and these faces.

    Attributes:
        rows: For each position of the mesh its row in ``points``.
    """

    points: FloatArray
    rows: IntArray
    faces: Sequence[tuple[Element, list[IntArray]]]

    @cached_property
    def triangles(self) -> IntArray:
        """Rows of ``points``, (t, 3)."""
        found = [self.rows[_triangles(element, lists)] for element, lists in self.faces]
        return np.concatenate([np.zeros((0, 3), dtype=np.intp), *found])


class _Document:
    """A document with its elements by id, None for an id that several have, and how much of it was placed."""

    def __init__(self, root: Element) -> None:
        self._root = root
        self._by_id: dict[tuple[str, str], Element | None] = {}
        self._geometries: dict[str, _Geometry] = {}
        self._placed: list[tuple[FloatArray, _Geometry]] = []
        self._numbers: dict[str, FloatArray] = {}
        self._nodes = self._parts = self._read = self._count = 0
        for element in root.iter():
            tag, name = _tag(element), element.get("id")
            if tag == "unit":
                _require_metres(element)
            if tag == "channel":
                raise Malformed(f"an animation moves {element.get('target', '')[:80]!r}; expected a rigid mesh")
            if tag in REFERABLE and name is not None:
                self._by_id[tag, name] = None if (tag, name) in self._by_id else element

    def vertices(self) -> FloatArray:
        scene = self._named("visual_scene", _only(_only(self._root, "scene"), "instance_visual_scene").get("url"))
        for node in _all(scene, "node"):
            self._place(node, np.eye(4), 1)
        return np.concatenate([np.zeros((0, 3)), *(_moved(pose, each.points) for pose, each in self._placed)])

    def triangles(self) -> IntArray:
        """Rows of ``vertices()``, (t, 3)."""
        found: list[IntArray] = [np.zeros((0, 3), dtype=np.intp)]
        count = first = 0
        for pose, geometry in self._placed:
            triangles = geometry.triangles + first
            found.append(triangles[:, ::-1] if float(np.linalg.det(pose[:3, :3])) < 0.0 else triangles)
            first += len(geometry.points)
            count += len(triangles)
            if count > MAX_PLACED:
                raise Malformed(f"more than {MAX_PLACED:,} triangles")
        return np.concatenate(found)

    def _place(self, node: Element, above: FloatArray, depth: int) -> None:
        """Add the geometries of a node and its descendants; ``above`` is the pose of its parent."""
        self._nodes += 1
        self._parts += len(node)
        if self._parts > MAX_PARTS:
            raise Malformed(f"nodes with more than {MAX_PARTS:,} children, counting each instance")
        if depth > MAX_DEPTH or self._nodes > MAX_NODES:
            raise Malformed(f"nodes nested deeper than {MAX_DEPTH}, perhaps in a circle, or more than {MAX_NODES:,}")
        pose, held = above, []
        for child in node:
            if _tag(child) in SIZES:
                with np.errstate(over="ignore", invalid="ignore"):  # whatever is not finite in the end is refused
                    pose = product(pose, _motion(child))
            elif _tag(child) not in IDLE:
                held.append(child)
        for child in held:
            if _tag(child) == "node":
                self._place(child, pose, depth + 1)
            elif _tag(child) == "instance_node":
                self._place(self._named("node", child.get("url")), pose, depth + 1)
            elif _tag(child) == "instance_geometry":
                self._placed.append((pose, self._instance(child.get("url"))))
            else:
                raise Malformed(f"<{_tag(child)}> in a node; expected rigid geometries and their placement")

    def _named(self, tag: str, url: str | None) -> Element:
        key = (tag, (url or "")[1:])
        if url is None or not url.startswith("#") or key not in self._by_id:
            raise Malformed(f"{'' if url is None else url[:80]!r} is no <{tag}> of this file")
        element = self._by_id[key]
        if element is None:
            raise Malformed(f"<{tag}> with the id {url[1:81]!r} twice")
        return element

    def _instance(self, url: str | None) -> _Geometry:
        geometry = self._named("geometry", url)
        name = geometry.get("id", "")
        if name not in self._geometries:
            self._geometries[name] = self._used(_only(geometry, "mesh"))
        self._count += len(self._geometries[name].points)
        if self._count > MAX_PLACED:
            raise Malformed(f"more than {MAX_PLACED:,} vertices")
        return self._geometries[name]

    def _used(self, mesh: Element) -> _Geometry:
        """The vertices of a mesh that its faces use, each once."""
        vertices = _only(mesh, "vertices")
        sources = [item.get("source") for item in _all(vertices, "input") if item.get("semantic") == "POSITION"]
        if len(sources) != 1:
            raise Malformed(f"<vertices> with {len(sources)} positions; expected one")
        points = self._points(self._named("source", sources[0]))
        self._read += len(points)
        if self._read > MAX_READ:
            raise Malformed(f"geometries with more than {MAX_READ:,} positions")
        used = np.zeros(len(points), dtype=bool)
        faces = []
        for child in mesh:
            if _tag(child) in STRIPS:
                faces.append((child, list(_indices(child, f"#{vertices.get('id')}"))))
                for indices in faces[-1][1]:
                    if len(indices) and not 0 <= indices.min() <= indices.max() < len(points):
                        raise Malformed(f"<{_tag(child)}> of vertices that do not exist")
                    used[indices] = True
            elif _tag(child) not in ("source", "vertices", "extra"):
                raise Malformed(f"<{_tag(child)}> in a mesh; expected one of {', '.join(STRIPS)}")
        return _Geometry(np.asarray(points[used]), np.cumsum(used) - 1, faces)

    def _points(self, source: Element) -> FloatArray:
        """The points (n, 3) of a source, which may hold more than them."""
        accessor = _only(_only(source, "technique_common"), "accessor")
        array = self._named("float_array", accessor.get("source"))
        name = array.get("id", "")
        if name not in self._numbers:
            self._numbers[name] = _floats(array.text)
        values = self._numbers[name]
        count = _count(accessor, "count")
        stride, start = _count(accessor, "stride", "1"), _count(accessor, "offset", "0")
        names = [param.get("name", "") for param in _all(accessor, "param")]
        if names[:3] != ["X", "Y", "Z"] or stride < 3 or start + count * stride > len(values):
            raise Malformed(f"{count} positions {', '.join(names)[:80]} every {stride} of {len(values)} numbers")
        return np.asarray(values[start : start + count * stride].reshape(count, stride)[:, :3])


def _require_metres(unit: Element) -> None:
    text = unit.get("meter", "1")
    if _floats(text).tolist() != [1.0]:
        raise Malformed(
            f"a unit of {text[:20]} m: readers of robot descriptions differ in whether to scale by it; "
            'write the mesh in metres (<unit meter="1"/>), or as STL with a scale beside its name'
        )


def _motion(element: Element) -> FloatArray:
    """The 4 x 4 matrix of one transformation."""
    tag, values = _tag(element), _floats(element.text)
    if len(values) != SIZES[tag] or not np.all(np.isfinite(values)):
        raise Malformed(f"<{tag}> with {len(values)} numbers; expected {SIZES[tag]} finite ones")
    if tag == "matrix":
        if values[12:].tolist() != [0.0, 0.0, 0.0, 1.0]:
            raise Malformed("a <matrix> whose last row is not 0 0 0 1")
        return values.reshape(4, 4)
    out = np.eye(4)
    if tag == "translate":
        out[:3, 3] = values
    elif tag == "scale":
        out[[0, 1, 2], [0, 1, 2]] = values
    else:
        out[:3, :3] = _turn(*values.tolist())
    return out


def _turn(x: float, y: float, z: float, degrees: float) -> list[list[float]]:
    """Rotation about an axis."""
    norm = math.sqrt(x * x + y * y + z * z)
    if not abs(norm - 1.0) <= UNIT:
        raise Malformed(
            f"a rotation about {x:g} {y:g} {z:g}; expected an axis of length 1, for readers differ on others"
        )
    return axis_matrix((x / norm, y / norm, z / norm), math.radians(degrees))


def _moved(T: FloatArray, points: FloatArray) -> FloatArray:
    with np.errstate(over="ignore", invalid="ignore"):
        return along(T[:3, :3], points) + T[:3, 3]


def _indices(faces: Element, vertices: str) -> Iterator[IntArray]:
    """The vertices of faces or lines, list by list."""
    inputs = [(item.get("semantic"), _count(item, "offset"), item.get("source")) for item in _all(faces, "input")]
    mine = [offset for semantic, offset, source in inputs if semantic == "VERTEX" and source == vertices]
    if len(mine) != 1 or _all(faces, "ph"):
        raise Malformed(f"<{_tag(faces)}> with {len(mine)} vertices a corner, or with holes; expected one, and none")
    stride = 1 + max(offset for _, offset, _ in inputs)
    corners = 0
    for item in _all(faces, "p"):
        indices = _integers(item.text)
        if len(indices) % stride:
            raise Malformed(f"<{_tag(faces)}> with {len(indices)} indices; expected {stride} for each corner")
        corners += len(indices) // stride
        yield indices[mine[0] :: stride]
    if _tag(faces) in ("triangles", "polylist"):
        wanted = int(_sizes(faces).sum()) if _tag(faces) == "polylist" else 3 * _count(faces, "count")
        if corners != wanted:
            raise Malformed(f"<{_tag(faces)}> with {corners} corners; expected {wanted}")


def _sizes(polylist: Element) -> IntArray:
    """How many corners each polygon has."""
    return _integers("".join(item.text or "" for item in _all(polylist, "vcount")))


def _triangles(faces: Element, lists: Sequence[IntArray]) -> IntArray:
    """The triangles (t, 3) of faces, as indices of positions, from their corners as ``_indices`` gives them."""
    kind = _tag(faces)
    if kind in LINES:
        return np.zeros((0, 3), dtype=np.intp)
    corners = np.concatenate([np.zeros(0, dtype=np.int64), *lists])
    if kind == "triangles":
        return corners.reshape(-1, 3)
    sizes = _sizes(faces) if kind == "polylist" else np.array([len(each) for each in lists], dtype=np.int64)
    if sizes.size and int(sizes.min()) < 3:
        raise Malformed(f"<{kind}> with {int(sizes.min())} corners in one; expected three or more")
    many = sizes - 2
    first = np.repeat(np.cumsum(sizes) - sizes, many)
    step = np.arange(int(many.sum())) - np.repeat(np.cumsum(many) - many, many)  # counts the triangles of each
    if kind == "tristrips":
        odd = step % 2
        at = np.stack([first + step + odd, first + step + 1 - odd, first + step + 2], axis=-1)
    else:
        at = np.stack([first, first + step + 1, first + step + 2], axis=-1)
    return np.asarray(corners[at])


def _count(element: Element, key: str, default: str = "") -> int:
    text = element.get(key, default)
    if not re.fullmatch("[0-9]{1,9}", text):
        raise Malformed(f"<{_tag(element)}> {key} = {text[:20]!r}; expected how many")
    return int(text)


def _floats(text: str | None) -> FloatArray:
    try:
        return np.array(plain_floats(text or ""), dtype=np.float64)
    except ValueError as error:
        raise Malformed(f"{error} is not a number") from None


def _integers(text: str | None) -> IntArray:
    try:
        return np.array(plain_ints(text or ""), dtype=np.int64)
    except ValueError as error:
        raise Malformed(f"{error} is not an index") from None

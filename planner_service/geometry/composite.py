"""Solids made of convex pieces: compounds, point clouds and height fields.

Collision checks see only the pieces: a composite is hit where one of its pieces is hit. Pieces of one composite may
touch and overlap each other. Those of a cloud or a height field are boxes, ordered so that neighbours in the list are
neighbours in space: a check of thousands of them can look at runs of them first.
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import (
    FloatArray,
    IntArray,
    along,
    blocks,
    frozen,
    merged_rows,
    read_only,
    set_fields,
    sorted_rows,
    unique_rows,
)
from planner_service.geometry.cell_runs import CellRuns, along_a_curve, extremes, joined
from planner_service.geometry.decomposition import pieces_of_file
from planner_service.geometry.scans import Scan, read_array, read_scan
from planner_service.geometry.shapes import Box, Pose, Shape
from planner_service.geometry.validation import MAX_LENGTH, cloud, in_file, items, number, numbers, points_of, vectors

__all__ = ["Composite", "Compound", "HeightField", "Pieces", "PointCloud", "Solid", "extent"]


MAX_PIECES = 50_000
"""Boxes of a height field, after columns of the same height were joined."""

MAX_COLUMNS = 500_000
"""Columns before they are joined."""

MAX_CELLS = 1_000_000
"""Cells of a cloud: what a depth camera sees of a room at 5 mm."""

LEAST_CELL = 1e-4
"""Metres; a finer resolution than a tenth of a millimetre is a unit mistake."""

MOST_COLUMNS = 16
"""Numbers of a point: its place, colour, normal and a few more; more are an image."""
RESOLUTION = 0.01
"""Metres; of a cloud for which none is given."""

MAX_POINTS = 5_000_000
"""Measured points of a cloud: several for each cell."""

logger = logging.getLogger(__name__)

T = TypeVar("T")

MAX_COMPOUND = 1_000
"""Pieces of a compound, made by hand or by a decomposition."""


class Chosen(Sequence[T]):
    """Things of a few kinds, one after the other, without an object for each.

    Args:
        kinds: The things.
        numbers: Which of them each is, (k,).
    """

    def __init__(self, kinds: Sequence[T], numbers: IntArray) -> None:
        self._kinds, self._numbers = kinds, numbers

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[T]: ...
    def __getitem__(self, index: int | slice) -> T | Sequence[T]:
        if isinstance(index, slice):
            return Chosen(self._kinds, self._numbers[index])
        return self._kinds[int(self._numbers[index])]

    def __iter__(self) -> Iterator[T]:
        return map(self._kinds.__getitem__, self._numbers.tolist())


@dataclass(frozen=True, eq=False)
class Pieces:
    """k convex shapes and where they are.

    Attributes:
        kinds: The shapes, those that occur again and again once.
        numbers: Which of them each piece is, (k,).
        rotations: How each stands in the solid's own frame, (k, 3, 3); (1, 3, 3) if all stand alike.
        positions: Where each is in it, (k, 3).
    """

    kinds: tuple[Shape, ...]
    numbers: IntArray
    rotations: FloatArray
    positions: FloatArray

    @classmethod
    def of(cls, shapes: Sequence[Shape], frames: FloatArray) -> Pieces:
        """From one shape and homogeneous matrix each, (k, 4, 4)."""
        return cls(tuple(shapes), np.arange(len(shapes)), frames[:, :3, :3], frames[:, :3, 3])

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def shapes(self) -> Sequence[Shape]:
        """The k shapes."""
        return Chosen(self.kinds, self.numbers)

    @cached_property
    def frames(self) -> FloatArray:
        """The frame of each, homogeneous matrices (k, 4, 4): 128 bytes each."""
        frames = np.zeros((len(self), 4, 4))
        frames[:, :3, :3], frames[:, :3, 3], frames[:, 3, 3] = self.rotations, self.positions, 1.0
        return frozen(frames)


@dataclass(frozen=True)
class Compound:
    """Convex shapes, each at a pose in the compound's own frame: a table with its legs, a mesh cut into convex pieces.

    Raises:
        InvalidRequest: no piece, more than 1,000, or a piece that is not a convex shape and a ``Pose``.
    """

    parts: tuple[tuple[Shape, Pose], ...]

    def __post_init__(self) -> None:
        expected = f"1 to {MAX_COMPOUND:,} pairs of a convex shape and a Pose"
        pairs = items("parts", self.parts, (tuple, list), expected)
        if not 1 <= len(pairs) <= MAX_COMPOUND:
            raise InvalidRequest("parts", len(pairs), expected)
        parts = []
        for k, pair in enumerate(pairs):
            if len(pair) != 2 or not isinstance(pair[0], Shape) or not isinstance(pair[1], Pose):
                raise InvalidRequest(f"parts[{k}]", pair, "a convex shape and a Pose")
            shape, pose = pair
            parts.append((shape, pose))
            if max(map(abs, pose.position)) > MAX_LENGTH:
                raise InvalidRequest(f"parts[{k}]", pose.position, f"metres, at most {MAX_LENGTH:g} along each axis")
        set_fields(self, parts=tuple(parts))

    @classmethod
    def of_mesh(
        cls, path: str | os.PathLike[str], scale: Sequence[float] = (1.0, 1.0, 1.0), *, most: int = 16
    ) -> Compound:
        """The mesh in an STL, OBJ, PLY or COLLADA file cut into convex pieces: for a hull that fills too much.

        ``decomposition.pieces_of_file`` says what the pieces are sure to contain.

        Args:
            scale: Factors that turn the file's x, y and z into metres; a negative one mirrors.
            most: Pieces at most, 1 to 64.

        Raises:
            InvalidFile: no such file, or one from which pieces cannot be made.
            InvalidRequest: ``scale`` or ``most`` out of range.
        """
        return cls.of_pieces(pieces_of_file(path, scale, most=most))

    @classmethod
    def of_pieces(cls, pieces: Iterable[Shape]) -> Compound:
        """A compound of convex shapes that are all given in its own frame."""
        given: tuple[Any, ...] = items("pieces", pieces, object, "convex shapes", MAX_COMPOUND)
        return cls(tuple((piece, Pose()) for piece in given))

    @cached_property
    def pieces(self) -> Pieces:
        return Pieces.of([shape for shape, _ in self.parts], read_only([pose.matrix for _, pose in self.parts]))

    def support(self, direction: FloatArray) -> FloatArray:
        d = vectors("direction", direction)
        farthest = []
        for shape, pose in self.parts:
            R = pose.rotation
            farthest.append(along(R, shape.support(along(R.T, d))) + np.array(pose.position))
        return _farthest(d, farthest)

    def distance(self, points: FloatArray) -> FloatArray:
        p = points_of(points)
        each = [shape.distance(along(pose.rotation.T, p - np.array(pose.position))) for shape, pose in self.parts]
        return np.asarray(np.min(each, axis=0))


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Boxes along the axes, lows (k, 3) and highs (k, 3)."""

    low: FloatArray
    high: FloatArray

    @cached_property
    def pieces(self) -> Pieces:
        sizes, numbers = unique_rows(self.high - self.low)  # most are one of few
        kinds = tuple(Box((x, y, z)) for x, y, z in sizes.tolist())
        return Pieces(kinds, frozen(numbers), read_only(np.eye(3)[None]), frozen(0.5 * (self.low + self.high)))

    def pieces_again(self, others: _Boxes, origin: IntArray) -> Pieces:
        """The pieces of others, of which some are these: ``origin`` (k,), -1 for those that are not."""
        before, new = self.pieces, origin < 0
        numbers = before.numbers[origin[~new]]
        used = np.flatnonzero(np.bincount(numbers, minlength=len(before.kinds)))
        old = np.array([before.kinds[k].size for k in used.tolist()]).reshape(-1, 3)
        sizes, which = unique_rows(np.concatenate([old, others.high[new] - others.low[new]]))
        kinds: list[Shape | None] = [None] * len(sizes)
        for k, at in zip(used.tolist(), which.tolist(), strict=False):
            kinds[at] = before.kinds[k]
        made = tuple(kind or Box((x, y, z)) for kind, (x, y, z) in zip(kinds, sizes.tolist(), strict=True))
        renumbered = np.zeros(len(before.kinds), dtype=np.intp)
        renumbered[used] = which[: len(used)]
        out: IntArray = np.empty(len(origin), dtype=np.intp)
        out[~new], out[new] = renumbered[numbers], which[len(used) :]
        return Pieces(made, frozen(out), before.rotations, frozen(0.5 * (others.low + others.high)))

    def support(self, direction: FloatArray) -> FloatArray:
        d = vectors("direction", direction)
        flat = d.reshape(-1, 3)
        out = np.empty(flat.shape)
        for rows in blocks(len(flat), 3 * len(self.low)):
            u = flat[rows, None, :]
            corners = np.where(u < 0.0, self.low, self.high)
            best = (u[..., 0] * corners[..., 0] + u[..., 1] * corners[..., 1] + u[..., 2] * corners[..., 2]).argmax(1)
            out[rows] = corners[np.arange(len(best)), best]
        return out.reshape(d.shape)

    def distance(self, points: FloatArray) -> FloatArray:
        p = points_of(points)
        flat = p.reshape(-1, 3)
        out = np.empty(len(flat))
        for rows in blocks(len(flat), 3 * len(self.low)):
            x = flat[rows, None, :]
            off = np.maximum(np.maximum(self.low - x, x - self.high), 0.0)
            out[rows] = np.sqrt((off[..., 0] ** 2 + off[..., 1] ** 2 + off[..., 2] ** 2).min(axis=1))
        return out.reshape(p.shape[:-1])


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Measured points (n, 3) in metres as solid cells: every cube of a grid that holds a point is an obstacle.

    The cubes have edges of ``resolution`` metres, with corners at multiples of it in the cloud's own frame, as in an
    octree of that resolution; a point on a face belongs to the higher cell. Nothing is known between the points: if the
    resolution is finer than the distance between neighbouring points on a surface, the surface has holes.

    Attributes:
        points: The centres of the cells (k, 3); a cloud made of these is equal to this one.
        cells: The cells as whole numbers of edges (k, 3), each once, sorted.

    Raises:
        InvalidRequest: not finite numbers of shape (n, 3), no point or more than 5,000,000, one beyond 1 km, or the
            centre of its cell; a cloud longer than 1 km; a resolution outside [0.0001, 1000] m; more than 1,000,000
            cells: the resolution is too fine.
    """

    points: FloatArray = field(repr=False)
    resolution: float
    cells: IntArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        resolution = _checked_cell("resolution", self.resolution)
        points = _checked_rows("points", self.points)
        self._fill(sorted_rows(np.floor(points / resolution).astype(np.int64)), resolution)

    def _fill(self, cells: IntArray, resolution: float) -> None:
        """Check and keep cells that are sorted, each once."""
        if len(cells) > MAX_CELLS:
            expected = f"a coarser one, with at most {MAX_CELLS:,} cells"
            message = f"resolution: {resolution:g} m makes {len(cells):,} cells; expected {expected}"
            raise InvalidRequest("resolution", resolution, expected, message=message)
        low, high = extremes(cells)
        _checked_rows(
            "points", np.array([(low + 0.5) * resolution, (high + 0.5) * resolution])
        )  # all others are between
        points = frozen((cells + 0.5) * resolution)
        set_fields(self, points=points, resolution=resolution, cells=frozen(cells))
        extent = float(((high + 1) * resolution - low * resolution).max())
        if extent > MAX_LENGTH:
            expected = f"a cloud no longer than {MAX_LENGTH:g} m"
            raise InvalidRequest("points", extent, expected, message=f"points: {extent:g} m long; expected {expected}")

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], resolution: float | None = None, scale: float = 1.0) -> PointCloud:
        """The points in a PLY (its vertices), PCD, XYZ, LAS or LAZ file, or in an NPY or NPZ file: an array (n, 3),
        called ``points`` if the file has several; or the occupied cells of an OctoMap tree, ``.bt`` or ``.ot``.

        What the file says that is not used is logged as a warning.

        Args:
            resolution: Metres, for points 0.01 if not given. For a tree 1, 2, 4, ... times the edge of its smallest
                cells, which it is if not given.
            scale: Factor that turns the numbers of the file into metres; 1 for a tree, which has metres.

        Raises:
            InvalidFile: not such a file, larger than 50 MB, malformed, or with numbers that make no cloud.
            InvalidRequest: a resolution outside [0.0001, 1000] m, or a scale that is not positive.
            MissingDependency: a LAS or LAZ file, and laspy is not installed.
        """
        file = as_path("path", path)
        edge = None if resolution is None else _checked_cell("resolution", resolution)
        factor = number("scale", scale, "a positive factor up to 1,000,000", 1e-9, 1e6)
        scan = read_scan(file, edge)
        for note in scan.notes:
            logger.warning("%s: %s", file, note)
        return in_file(file, lambda: cls._of_scan(scan, RESOLUTION if edge is None else edge, factor))

    @classmethod
    def _of_scan(cls, scan: Scan, resolution: float, scale: float) -> PointCloud:
        if scan.cells is not None and scan.edge is not None:
            if scale != 1.0:
                raise InvalidRequest("scale", scale, "1: a tree of cells is in metres")
            return cls.from_cells(scan.cells, scan.edge)
        expected = f"finite points (n, 3), at most {MAX_LENGTH:g} m from 0 along each axis"
        points = scan.points
        if points.ndim != 2 or points.shape[1:] != (3,) or len(points) == 0:
            message = f"points: got an array of shape {points.shape}; expected {expected}{_as_rows(points.shape)}"
            raise InvalidRequest("points", points, expected, message=message)
        with np.errstate(over="ignore", invalid="ignore"):
            points = points * scale
        bad = np.flatnonzero(~(np.abs(points) <= MAX_LENGTH).all(axis=1))
        if len(bad):
            hint = "; are they in millimetres (scale 0.001), or do they count from an origin far away?"
            if np.isnan(points[bad[0]]).any():
                hint = "; keep points[~np.isnan(points).any(axis=1)]"
            row = scan.points[bad[0]].tolist()
            raise InvalidRequest(
                f"points[{bad[0]}]", row, expected, message=f"points[{bad[0]}]: got {row}; expected {expected}{hint}"
            )
        return cls._of_cells(sorted_rows(np.floor(points / resolution).astype(np.int64)), resolution)

    @classmethod
    def from_cells(cls, cells: ArrayLike, resolution: float) -> PointCloud:
        """The cloud of these cells: whole numbers (k, 3), as ``cells`` has them."""
        resolution = _checked_cell("resolution", resolution)
        whole = _checked_rows("cells", cells)
        if not np.array_equal(whole, np.floor(whole)):
            raise InvalidRequest("cells", cells, "whole numbers")
        return cls._of_cells(sorted_rows(whole.astype(np.int64)), resolution)

    @classmethod
    def _of_cells(cls, cells: IntArray, resolution: float) -> PointCloud:
        """The cloud of cells that are sorted, each once."""
        cloud = object.__new__(cls)
        cloud._fill(cells, resolution)
        return cloud

    def with_points(self, points: ArrayLike, *, instead_of: tuple[ArrayLike, ArrayLike] | None = None) -> PointCloud:
        """This cloud and more measured points, as one made of all of them at once.

        Args:
            points: (n, 3) in metres, in the cloud's own frame; none with ``instead_of`` for what was only taken away.
            instead_of: Lower and upper corner of a box along the cloud's axes, (3,) each, which was looked at anew:
                cells whose centres are in it go first, whatever was in them.

        Raises:
            InvalidRequest: as ``PointCloud``; corners that are not three finite numbers each, the lower one first; or
                nothing would be left.
        """
        new = _checked_rows("points", points, 0 if instead_of is not None else 1)
        came = sorted_rows(np.floor(new / self.resolution).astype(np.int64)) if len(new) else self.cells[:0]
        left, gone = self.cells, self.cells[:0]
        if instead_of is not None:
            low, high = _corners("instead_of", instead_of)
            inside = ((self.points >= low) & (self.points <= high)).all(axis=1)
            left, gone = self.cells[~inside], self.cells[inside]
        cells = merged_rows(left, came)
        if not len(cells):
            raise InvalidRequest("points", len(new), "a cell that is left: leave the obstacle out of the scene instead")
        cloud = self._of_cells(cells, self.resolution)
        if "_boxes" in vars(self):  # those beside what changed are used again
            vars(cloud)["_before"] = self, np.union1d(gone[:, 0], came[:, 0])
        return cloud

    @cached_property
    def _boxes(self) -> _Boxes:
        before: tuple[PointCloud, IntArray] | None = vars(self).pop("_before", None)
        if before is not None:
            cloud, slabs = before
            known, boxes = cloud._runs, cloud._boxes
            found, origin = known.changed(self.cells, slabs)
            if found is not None:
                vars(self)["_runs"] = found
                out = self._scaled(found)
                vars(out)["pieces"] = boxes.pieces_again(out, origin)
                return out
        return self._scaled(self._runs)

    @cached_property
    def _runs(self) -> CellRuns:
        return CellRuns.of(self.cells)

    def _scaled(self, runs: CellRuns) -> _Boxes:
        lows, highs = (np.asarray(ends * self.resolution, dtype=np.float64) for ends in (runs.low, runs.high))
        return _Boxes(lows, highs)

    @property
    def pieces(self) -> Pieces:
        return self._boxes.pieces

    @cached_property
    def digest(self) -> str:
        """SHA-256 of resolution and cells, in hex."""
        content = np.float64(self.resolution).astype("<f8").tobytes() + self.cells.astype("<i8").tobytes()
        return hashlib.sha256(content).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PointCloud) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        return f"PointCloud({len(self.cells):,} cells of {self.resolution:g} m, sha256 {self.digest[:32]})"

    def support(self, direction: FloatArray) -> FloatArray:
        return self._boxes.support(direction)

    def distance(self, points: FloatArray) -> FloatArray:
        return self._boxes.distance(points)


@dataclass(frozen=True, eq=False)
class HeightField:
    """Solid ground made of columns: ``heights[i, j]`` is the top of column i to i + 1 in x, j to j + 1 in y (cells).

    Its frame has the corner of column (0, 0) at x = y = 0. Columns reach down to ``floor``; a column that is no
    higher is empty.

    Args:
        heights: Metres, (rows, columns).
        cell: Metres along x and y.
        floor: Metres; the bottom of all columns.

    Raises:
        InvalidRequest: not finite numbers of two dimensions, beyond 1 km; a cell outside [0.0001, 1000] m; more than
            500,000 columns, no column above ``floor``, or more than 50,000 boxes after joining equal neighbours.
    """

    heights: FloatArray = field(repr=False)
    cell: float
    floor: float = 0.0

    def __post_init__(self) -> None:
        cell = _checked_cell("cell", self.cell)
        floor = number("floor", self.floor, f"metres, at most {MAX_LENGTH:g}", -MAX_LENGTH, MAX_LENGTH)
        expected = f"finite heights (rows, columns) in metres, at most {MAX_COLUMNS:,} of them up to {MAX_LENGTH:g}"
        heights = numbers("heights", self.heights, expected)
        if heights.ndim != 2 or not 1 <= heights.size <= MAX_COLUMNS:
            message = f"heights: got an array of shape {heights.shape}; expected {expected}"
            raise InvalidRequest("heights", heights, expected, message=message)
        bad = np.argwhere(~(np.abs(heights) <= MAX_LENGTH))
        if len(bad):
            row, column = bad[0].tolist()
            raise InvalidRequest(f"heights[{row}, {column}]", float(heights[row, column]), expected)
        if cell * max(heights.shape) > MAX_LENGTH:
            raise InvalidRequest("cell", cell, f"a field no longer than {MAX_LENGTH:g} m")
        top = float(heights.max())
        if not 0.0 < top - floor <= MAX_LENGTH:
            raise InvalidRequest("floor", floor, f"below the highest column, {top:g}, by at most {MAX_LENGTH:g}")
        set_fields(self, heights=read_only(heights + 0.0), cell=cell, floor=floor + 0.0)
        _check_count("cell", cell, len(self._boxes.low))

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], cell: float, floor: float = 0.0) -> HeightField:
        """The heights in an NPY or NPZ file: an array (rows, columns), called ``heights`` if the file has several.

        Raises:
            InvalidFile: not such a file, larger than 50 MB, malformed, or with numbers that make no height field.
            InvalidRequest: a cell outside [0.0001, 1000] m.
        """
        file, edge = as_path("path", path), _checked_cell("cell", cell)
        heights = read_array(file, "heights")
        return in_file(file, lambda: cls(heights, edge, floor))

    @cached_property
    def _boxes(self) -> _Boxes:
        columns = np.argwhere(self.heights > self.floor).astype(np.float64)
        top = self.heights[self.heights > self.floor]
        low = np.concatenate([columns, np.full((len(top), 1), self.floor)], axis=1)
        high = np.concatenate([columns + 1.0, top[:, None]], axis=1)
        for axis in (1, 0):
            others = [k for k in range(3) if k != axis]
            keys = [low[:, axis], *(table[:, k] for k in others for table in (high, low))]
            low, high = joined(low, high, axis, np.lexsort(keys))
        order = along_a_curve((low + high) * np.array([1.0, 1.0, 0.0]))
        scale = np.array([self.cell, self.cell, 1.0])
        return _Boxes(low[order] * scale, high[order] * scale)

    @property
    def pieces(self) -> Pieces:
        return self._boxes.pieces

    @cached_property
    def digest(self) -> str:
        """SHA-256 of cell, floor and heights, in hex."""
        content = np.array([self.cell, self.floor, *self.heights.shape], dtype="<f8").tobytes()
        return hashlib.sha256(content + self.heights.astype("<f8").tobytes()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, HeightField) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        rows, columns = self.heights.shape
        return f"HeightField({rows} x {columns} columns of {self.cell:g} m, sha256 {self.digest[:32]})"

    def support(self, direction: FloatArray) -> FloatArray:
        return self._boxes.support(direction)

    def distance(self, points: FloatArray) -> FloatArray:
        return self._boxes.distance(points)


Composite = Compound | PointCloud | HeightField
"""A solid made of convex pieces."""

Solid = Shape | Composite
"""Any shape of an obstacle or an attached object."""


def extent(solid: Solid) -> FloatArray:
    """Sizes along x, y and z, in metres, of a solid in its own frame, (3,)."""
    axes = np.eye(3)
    return np.diagonal(solid.support(axes) - solid.support(-axes)).copy()


def _as_rows(shape: tuple[int, ...]) -> str:
    """What makes points of an array of another shape that seems to have them; empty if it does not."""
    if len(shape) == 2 and shape[0] == 3:
        return "; keep points.T"
    if len(shape) == 2 and 3 < shape[1] <= MOST_COLUMNS:
        return "; if x, y and z are the first columns, keep points[:, :3]"
    return "; keep points.reshape(-1, 3)" if len(shape) > 2 and shape[-1] == 3 else ""


def _checked_cell(field_name: str, value: object) -> float:
    expected = f"an edge of {LEAST_CELL:g} to {MAX_LENGTH:g} m"
    return number(field_name, value, expected, LEAST_CELL, MAX_LENGTH)


def _checked_rows(field_name: str, values: object, least: int = 1) -> FloatArray:
    """Finite numbers (n, 3)."""
    expected = f"{least} to {MAX_POINTS:,} points (x, y, z) in metres, at most {MAX_LENGTH:g} from 0 along each axis"
    largest = MAX_LENGTH if field_name == "points" else MAX_LENGTH / LEAST_CELL
    return cloud(field_name, values, expected, least, MAX_POINTS, largest)


def _corners(field_name: str, values: object) -> tuple[FloatArray, FloatArray]:
    """The lower and the upper corner of a box, in order."""
    expected = "two corners (x, y, z) in metres, the lower one first"
    corners = numbers(field_name, values, expected)
    if corners.shape != (2, 3) or not (np.isfinite(corners).all() and (corners[0] <= corners[1]).all()):
        raise InvalidRequest(field_name, corners.tolist(), expected)
    return corners[0], corners[1]


def _check_count(field_name: str, cell: float, count: int) -> None:
    if count > MAX_PIECES:
        expected = f"a coarser one, with at most {MAX_PIECES:,} boxes"
        message = f"{field_name}: {cell:g} m makes {count:,} boxes; expected {expected}"
        raise InvalidRequest(field_name, cell, expected, message=message)


def _farthest(d: FloatArray, candidates: Sequence[FloatArray]) -> FloatArray:
    """Of one point (..., 3) from each solid, the one farthest along ``d``."""
    points = np.stack(candidates)
    best = (points[..., 0] * d[..., 0] + points[..., 1] * d[..., 1] + points[..., 2] * d[..., 2]).argmax(axis=0)
    return np.asarray(np.take_along_axis(points, best[None, ..., None], axis=0)[0])

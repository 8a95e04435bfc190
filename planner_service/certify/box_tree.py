"""Boxes around pieces that follow each other, and around those boxes: so that a proof need not look at every piece.

That neighbours in the list are neighbours in space makes them small; that each holds all its pieces is worked out here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner_service.certify.separation import Solids, centre_of
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Pieces
from planner_service.geometry.shapes import Box
from planner_service.geometry.validation import MAX_LENGTH

__all__ = ["MANY", "Bundle", "bundled"]

MANY = 64
"""Pieces from which on an obstacle is bundled."""

FAN = 8
"""Pieces or bundles in a bundle."""

ROUNDING = 1e-9
"""Metres by which a bundle is larger than what it holds: far above rounding."""


@dataclass(frozen=True, eq=False)
class Bundle:
    """A box around some pieces or bundles of one obstacle.

    Attributes:
        number: Its number as a piece.
        box, frame: The box, and where it is in the obstacle, the first three rows of a homogeneous matrix.
        first, count: The pieces in it: the number of the first, and how many follow each other.
    """

    number: int
    box: Box
    frame: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
    first: int
    count: int


def bundled(pieces: Pieces, first: int, number: int) -> list[Bundle]:
    """The bundles of an obstacle, what is in a bundle before it; the last holds everything, or would be beyond 1 km.

    Args:
        first: The number of the obstacle's first piece.
        number: The number of the first bundle.
    """
    low, high = _extents(pieces)
    out: list[Bundle] = []
    while len(low) > 1:
        starts = np.arange(0, len(low), FAN)
        ends = np.minimum(starts + FAN, len(low))
        low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
        if float((high - low).max()) + 2.0 * ROUNDING > MAX_LENGTH:  # no box is so large
            break
        size, centre = (high - low + 2.0 * ROUNDING).tolist(), (0.5 * (low + high)).tolist()
        begin = number + len(out)
        for k, ((x, y, z), (u, v, w)) in enumerate(zip(size, centre, strict=True)):
            frame = ((1.0, 0.0, 0.0, u), (0.0, 1.0, 0.0, v), (0.0, 0.0, 1.0, w))
            out.append(Bundle(begin + k, Box((x, y, z)), frame, first + int(starts[k]), int(ends[k] - starts[k])))
        first = begin
    return out


def _extents(pieces: Pieces) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corners of boxes around pieces along the axes of the obstacle, (k, 3) each."""
    solids = Solids.of(pieces.shapes)
    x, y, z = np.array([centre_of(shape) for shape in pieces.shapes]).T
    R, t = pieces.frames[:, :3, :3], pieces.frames[:, :3, 3]
    centres = R[:, :, 0] * x[:, None] + R[:, :, 1] * y[:, None] + R[:, :, 2] * z[:, None] + t
    axes = R.transpose(1, 2, 0)  # the obstacle's axes in those of each piece, one after the other
    return centres - solids.extent(-axes).T, centres + solids.extent(axes).T

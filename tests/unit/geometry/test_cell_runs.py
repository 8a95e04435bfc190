"""Boxes of cells after an update are those made of all cells at once, to the last bit, and most are used again."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.cell_runs import CellRuns
from planner_service.geometry.composite import PointCloud

EDGE = 0.013


def room(rng: np.random.Generator, count: int) -> FloatArray:
    """Points of a floor, a wall and something in between."""
    points = rng.uniform(-0.5, 0.5, (count, 3))
    points[::3, 2], points[1::3, 0] = -0.5, 0.5
    points[2::3] *= 0.4
    return points


def require_same(one: PointCloud, two: PointCloud) -> None:
    assert one == two
    assert np.array_equal(one.points, two.points)
    first, second = one.pieces, two.pieces
    assert first.kinds == second.kinds
    for name in ("numbers", "positions", "rotations"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name


@pytest.mark.parametrize("seed", range(12))
def test_an_updated_cloud_has_the_pieces_of_one_made_at_once(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cloud = PointCloud(room(rng, 4_000), EDGE)
    for turn in range(12):
        len(cloud.pieces)
        low = rng.uniform(-0.6, 0.5, 3)
        high = low + rng.uniform(0.0, 0.5, 3)
        new = rng.uniform(low, high, (int(rng.integers(0, 60)), 3))
        inside = None if turn % 3 == 0 and len(new) else (low, high)
        if turn == 7:  # beyond all that is there: the curve runs elsewhere
            new = np.concatenate([new, [[0.9, 0.0, 0.0]]])
        if turn == 9:
            new = cloud.points[::50]  # nothing new
        cloud = cloud.with_points(new, instead_of=inside)
        require_same(cloud, PointCloud(cloud.points, EDGE))


def test_whole_slabs_may_go_and_come() -> None:
    rng = np.random.default_rng(3)
    cloud = PointCloud(room(rng, 3_000), EDGE)
    len(cloud.pieces)
    everything = np.full(3, -2.0), np.array([0.1, 2.0, 2.0])
    less = cloud.with_points(np.zeros((0, 3)), instead_of=everything)
    require_same(less, PointCloud(less.points, EDGE))
    require_same(less.with_points(cloud.points), cloud)
    other = cloud.with_points([[7.0, 7.0, 7.0]], instead_of=(np.full(3, -2.0), np.full(3, 2.0)))
    require_same(other, PointCloud(np.full((1, 3), 7.0), EDGE))


def test_boxes_beside_what_changed_are_used_again() -> None:
    cells = PointCloud(room(np.random.default_rng(1), 30_000), EDGE).cells
    known = CellRuns.of(cells)
    slab = int(np.median(cells[:, 0]))
    hole = cells[~((cells[:, 0] == slab) & (cells[:, 1] > 3))]
    found, origin = known.changed(hole, np.array([slab]))
    assert found is not None
    whole = CellRuns.of(hole)
    for each in fields(CellRuns):
        assert np.array_equal(getattr(found, each.name), getattr(whole, each.name))
    kept = origin >= 0
    assert kept.mean() > 0.9
    assert np.array_equal(found.low[kept], known.low[origin[kept]])

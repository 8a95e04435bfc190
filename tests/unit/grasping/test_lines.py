"""Where lines are in a solid: as its distances say, with normals that point out of it."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.geometry.composite import HeightField, PointCloud, Solid
from planner_service.grasping.lines import pieces_of, runs_along
from tests.unit.grasping.solids import solids

CLOUD = PointCloud(np.random.default_rng(0).normal(size=(60, 3)) * 0.03, 0.01)
FIELD = HeightField(np.random.default_rng(1).uniform(0.0, 0.05, (6, 5)), 0.01)


def agree(shape: Solid, seed: int) -> None:
    rng = np.random.default_rng(seed)
    origins, directions = rng.normal(size=(8, 3)) * 0.03, rng.normal(size=(8, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    runs = runs_along(pieces_of(shape), origins, directions)
    t = np.linspace(-0.3, 0.3, 601)
    for k in range(8):
        mine = np.zeros(t.shape, bool)
        ends = [np.inf]
        for row in np.flatnonzero(runs.line == k):
            mine |= (t >= runs.enter[row]) & (t <= runs.leave[row])
            ends += [runs.enter[row], runs.leave[row]]
        inside = shape.distance(origins[k] + t[:, None] * directions[k]) <= 0.0
        clear = np.abs(t[:, None] - np.array(ends)).min(axis=1) > 1e-6
        np.testing.assert_array_equal(mine[clear], inside[clear])
    for at, normals in ((runs.enter, runs.enter_normal), (runs.leave, runs.leave_normal)):
        points = origins[runs.line] + at[:, None] * directions[runs.line]
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-9)
        assert (np.abs(shape.distance(points)) < 1e-9).all()
        out = shape.distance(points + 1e-6 * normals)
        assert (out > 0.99e-6).mean() > 0.95 if len(out) > 20 else True
    into, out = ((normals * directions[runs.line]).sum(axis=1) for normals in (runs.enter_normal, runs.leave_normal))
    assert (into < 0.0).all()
    assert (out > 0.0).all()


@given(solids(), st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_lines_are_in_a_solid_where_its_distance_is_zero(shape: Solid, seed: int) -> None:
    agree(shape, seed)


@given(st.sampled_from([CLOUD, FIELD]), st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_lines_go_through_clouds_and_height_fields_from_cell_to_cell(shape: Solid, seed: int) -> None:
    agree(shape, seed)


def test_a_line_beside_everything_has_no_run() -> None:
    runs = runs_along(pieces_of(CLOUD), np.full((2, 3), 5.0), np.tile([0.0, 0.0, 1.0], (2, 1)))
    assert runs.line.shape == runs.enter.shape == (0,)
    assert runs.enter_normal.shape == (0, 3)

"""Which triangle is seen at each sample: laws of the depth buffer, of cutting at the eye, and of the camera."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from planner_service.geometry.arrays import FloatArray
from planner_service.view.still.camera import Camera
from planner_service.view.still.raster import EMPTY, KeyArray, cover, nearness_of, numbers_of, projected, ribbon

SIZE = (40, 30)


def triangle(*corners: tuple[float, float, float]) -> FloatArray:
    return np.array([corners])


def random_triangles(seed: int, count: int) -> FloatArray:
    """Pixels, beyond the picture too, and nearness."""
    chance = np.random.default_rng(seed)
    where = chance.uniform(-10.0, 50.0, size=(count, 3, 2))
    return np.concatenate([where, chance.uniform(0.1, 1.0, size=(count, 3, 1))], axis=2)


def shown(keys: KeyArray) -> NDArray[np.int64]:
    """The number at each sample, -1 for none."""
    return np.where(keys == EMPTY, -1, numbers_of(keys))


def inside(corners: FloatArray) -> NDArray[np.bool_]:
    """Samples whose middles are in a triangle, by the signs of three areas."""
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] + 0.5
    (ax, ay, _), (bx, by, _), (cx, cy, _) = corners
    sides = [
        (qx - px) * (y - py) - (qy - py) * (x - px)
        for (px, py), (qx, qy) in (((ax, ay), (bx, by)), ((bx, by), (cx, cy)), ((cx, cy), (ax, ay)))
    ]
    return np.asarray(np.all([side > 0 for side in sides], axis=0) | np.all([side < 0 for side in sides], axis=0))


def test_a_triangle_covers_the_samples_whose_middles_are_in_it() -> None:
    flat = triangle((1.0, 1.0, 1.0), (20.0, 20.0, 1.0), (10.5, 10.5, 2.0))
    for one in (flat, *(random_triangles(seed, 1) for seed in range(40))):
        assert np.array_equal(shown(cover(one, np.array([7]), SIZE)) == 7, inside(one[0]))


def test_triangles_that_share_edges_leave_no_gap_and_no_double() -> None:
    """A fan around a middle, corners on middles of samples among them, as in a mesh."""
    rim = [(5.5, 5.5), (20.0, 3.25), (34.5, 5.5), (36.0, 15.5), (30.125, 26.5), (12.5, 27.0), (4.0, 18.5)]
    pairs = zip(rim, [*rim[1:], rim[0]], strict=True)
    fan = np.array([[(20.5, 15.5, 1.0), (*p, 1.0), (*q, 1.0)] for p, q in pairs])
    each = [(cover(one[None], np.array([0]), SIZE) != EMPTY).astype(int) for one in fan]
    together = cover(fan, np.arange(len(fan)), SIZE) != EMPTY
    assert np.array_equal(np.sum(each, axis=0), together.astype(int))
    assert together[8:24, 10:30].all()


@pytest.mark.parametrize("seed", [0, 1])
def test_at_each_sample_the_nearest_is_seen_in_whatever_order_they_come(seed: int) -> None:
    triangles = random_triangles(seed, 12)
    numbers = np.arange(12)
    order = np.random.default_rng(seed).permutation(12)
    keys = cover(triangles, numbers, SIZE)
    assert np.array_equal(keys, cover(triangles[order], order, SIZE))
    alone = np.stack([cover(triangles[k : k + 1], numbers[k : k + 1], SIZE) for k in range(12)])
    assert np.array_equal(keys, alone.min(axis=0))
    depths = np.where(alone == EMPTY, 0.0, nearness_of(alone))
    assert np.array_equal(shown(keys)[keys != EMPTY], depths.argmax(axis=0)[keys != EMPTY])


def test_nearness_is_linear_in_the_picture() -> None:
    keys = cover(triangle((0.0, 0.0, 0.5), (40.0, 0.0, 1.0), (0.0, 30.0, 0.25)), np.array([0]), SIZE)
    y, x = np.nonzero(keys != EMPTY)
    assert nearness_of(keys[y, x]) == pytest.approx(0.5 + (x + 0.5) / 80.0 - (y + 0.5) / 120.0, abs=1e-8)


CAMERA = Camera(np.zeros(3), np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), 30.0, (20.0, 15.0), 0.05)
"""At the origin, looking along x."""


def test_a_triangle_that_faces_away_is_left_out() -> None:
    towards = triangle((2.0, 0.5, 0.0), (2.0, -0.5, 0.0), (2.0, 0.0, -0.5))
    (a, b, c) = towards[0]
    seen = [len(projected(CAMERA, some, np.array([0]))[0]) for some in (towards, np.array([[a, c, b]]))]
    assert sorted(seen) == [0, 1]
    back = np.cross(b - a, c - a)  # the normal of what is seen comes towards the eye
    assert (seen[0] == 1) == (back[0] < 0.0)


@pytest.mark.parametrize("behind", [1, 2])
def test_of_a_triangle_that_reaches_behind_the_eye_what_is_ahead_is_seen(behind: int) -> None:
    """Against the same triangle cut by hand: rays through samples meet its plane at the depth that is told."""
    corners = np.array([[1.0, 0.61, 0.103], [1.0, -0.42, 0.207], [1.0, 0.11, -0.513]])
    for k in range(behind):
        corners[k, 0] = -0.5
    faces = np.array([corners, corners[[0, 2, 1]]])
    keys = cover(*projected(CAMERA, faces, np.array([0, 0])), SIZE)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] + 0.5
    rays = np.stack([np.ones_like(x), -(x - 20.0) / 30.0, -(y - 15.0) / 30.0], axis=-1)
    ahead = (normal @ corners[0]) / (rays @ normal)
    meets = rays * ahead[..., None]
    sides = [np.cross(q - p, meets - p) @ normal for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    expected = np.all([side > 0 for side in sides], axis=0) & (ahead > 0.05)
    assert np.array_equal(keys != EMPTY, expected)
    assert 0.05 / nearness_of(keys[expected]) == pytest.approx(ahead[expected], rel=1e-6)


def test_the_camera_has_all_points_just_in_view_the_right_way_up() -> None:
    points = np.random.default_rng(5).uniform(-1.0, 1.0, size=(50, 3))
    camera = Camera.around(points, (640, 400), -2.0, 0.5)
    x, y, near = camera.pixels(camera.seen(points)).T
    assert (near > 0.0).all()
    ends = np.array([x.min(), 640.0 - x.max(), y.min(), 400.0 - y.max()])
    assert (ends > -1e-9).all()
    assert np.sort(ends)[:2] == pytest.approx([0.0, 0.0], abs=1e-9)  # two opposite borders are touched
    right, down, ahead = camera.axes
    assert np.cross(right, down) == pytest.approx(ahead, abs=1e-15)
    assert right[2] == 0.0 > down[2]


def test_a_line_is_as_wide_as_it_is_said_to_be() -> None:
    strips = ribbon(CAMERA, np.array([[2.0, 0.9, 0.0], [2.0, -0.9, 0.0]]), 6.0, 0.0)
    rows, columns = np.nonzero(cover(strips, np.zeros(len(strips), dtype=np.int64), SIZE) != EMPTY)
    assert (rows.min(), rows.max()) == (12, 17)
    assert (columns.min(), columns.max()) == (4, 35)  # from 6.5 to 33.5, and half the width at its ends, rounded

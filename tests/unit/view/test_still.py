"""Stills: what is drawn where, what hides what, what is red, and files that are there whole or not at all."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import ConvexHull

from planner_service import (
    Box,
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Scene,
    load_robot,
    load_scene,
)
from planner_service.geometry.arrays import FloatArray
from planner_service.tasks.pick_place import plan_pick_place
from planner_service.view.still import pictures as still
from planner_service.view.still.camera import Camera
from planner_service.view.still.lettering import CAPTION, place_of
from planner_service.view.still.paint import Drawing, paint, placed
from planner_service.view.still.pictures import draw_plan, draw_task
from planner_service.view.still.sights import Sights
from planner_service.view.triangles import Solid, placements, robot_solids, scene_solids
from tests.support.command import refused, run

SMALL = (320, 180)
PAGE = (640, 400)
"""Pixels of whole pictures here: a quarter of what users get, and of the time."""

Pixels = NDArray[np.uint8]


@pytest.fixture(autouse=True)
def _smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(still, "SIZE", PAGE)


def solids(*boxes: tuple[str, tuple[float, float, float], tuple[float, float, float]]) -> tuple[Solid, ...]:
    """Boxes by name, size and position."""
    return scene_solids(Scene(tuple(Obstacle(name, Box(size), Pose(at)) for name, size, at in boxes)))


def camera_for(drawn: tuple[Solid, ...], azimuth: float = 0.0, elevation: float = 0.3) -> Camera:
    return Camera.around(np.concatenate([solid.vertices for solid in drawn]), SMALL, azimuth, elevation)


def hull_mask(points: FloatArray, grown: float) -> NDArray[np.bool_]:
    """Pixels whose middles are in the hull of points (k, 2) of the picture, moved outwards by ``grown`` pixels."""
    y, x = np.mgrid[0 : SMALL[1], 0 : SMALL[0]] + 0.5
    sides = ConvexHull(points).equations
    return np.asarray(np.all([a * x + b * y + c <= grown for a, b, c in sides], axis=0))


def read(file: Path) -> Pixels:
    with Image.open(file) as picture:
        return np.asarray(picture)


def red_part(file: Path) -> float:
    """Part of a picture, its caption left out, that is as red as what touches."""
    pixels = read(file).astype(int)[: PAGE[1] - CAPTION]
    r, g, b = pixels.transpose(2, 0, 1)
    return float(np.mean((r > 120) & (g < r // 3) & (b < r // 3)))


# what is drawn where


@pytest.mark.slow
def test_the_silhouette_of_a_link_is_where_its_corners_are_projected_to() -> None:
    robot = load_robot("ur5")
    frames = placements(robot, robot.home + 0.2)
    convex = {item.link for item in robot.shapes if sum(other.link == item.link for other in robot.shapes) == 1}
    for link in [solid for solid in robot_solids(robot) if solid.name in convex]:
        solid = placed(link, frames[link.name])
        camera = camera_for((solid,), azimuth=0.7)
        owners = paint(Drawing((solid,)), camera, SMALL)[1]
        points = camera.pixels(camera.seen(solid.vertices))[:, :2]
        assert not np.any((owners == 0) & ~hull_mask(points, 1.0))
        assert not np.any((owners != 0) & hull_mask(points, -1.0))


def test_what_is_behind_something_is_hidden() -> None:
    drawn = solids(("behind", (0.1, 0.1, 0.1), (-0.5, 0.0, 0.0)), ("ahead", (0.1, 0.6, 0.6), (0.0, 0.0, 0.0)))
    owners = paint(Drawing(drawn), camera_for(drawn, elevation=0.05), SMALL)[1]
    assert set(np.unique(owners)) == {-1, 1}
    owners = paint(Drawing(drawn), camera_for(drawn, azimuth=math.pi, elevation=0.05), SMALL)[1]
    assert set(np.unique(owners)) == {-1, 0, 1}


def test_everything_near_the_robot_is_in_view_and_a_wide_ground_does_not_make_it_small() -> None:
    scene = load_scene("bin")
    robot = load_robot("wxai")
    frames = placements(robot, robot.home)
    arm = [placed(solid, frames[solid.name]) for solid in robot_solids(robot)]
    obstacles = scene_solids(scene)
    camera = Sights(arm, obstacles, ()).camera(SMALL)
    for solid in (*arm, *(o for o in obstacles if o.name != "table")):
        x, y, _ = camera.pixels(camera.seen(solid.vertices)).T
        assert 0.0 <= x.min() <= x.max() <= SMALL[0]
        assert 0.0 <= y.min() <= y.max() <= SMALL[1]
    without = Sights(arm, [o for o in obstacles if o.name != "table"], ()).camera(SMALL)
    assert np.array_equal(camera.eye, without.eye)


# names


def test_a_name_stands_on_what_it_names() -> None:
    owners = np.full((100, 200), -1)
    owners[10:90, 20:180] = 3
    owners[30:90, 40:160] = 5  # a ring is left
    x, y = place_of(owners, 3) or (0.0, 0.0)
    assert owners[int(y), int(x)] == 3
    assert place_of(owners, 5) == pytest.approx((100.0, 60.0), abs=24.0)
    owners[0, :100] = 2  # too little to be seen
    assert place_of(owners, 2) is None


# plans, tasks, configurations


@pytest.fixture(scope="module")
def planned() -> tuple[PlannerService, PlanRequest, PlanResult]:
    service = PlannerService("planar2", "discs")
    poses = service.robot.poses
    request = PlanRequest(poses["lesson_start"], poses["lesson_goal"], time_limit=None)
    return service, request, service.plan(request)


DRAW = """
import sys
from planner_service import PlannerService, PlanRequest
from planner_service.view.still import pictures
pictures.SIZE = (640, 400)
service = PlannerService("planar2", "discs")
poses = service.robot.poses
request = PlanRequest(poses["lesson_start"], poses["lesson_goal"], time_limit=None)
pictures.draw_plan(service, request, service.plan(request), sys.argv[1])
"""


@pytest.mark.slow
def test_a_plan_has_the_same_picture_in_another_process(
    tmp_path: Path, planned: tuple[PlannerService, PlanRequest, PlanResult]
) -> None:
    before = planned[0].checker.counts
    draw_plan(*planned, tmp_path / "here.png")
    assert planned[0].checker.counts == before
    subprocess.run([sys.executable, "-c", DRAW, str(tmp_path / "there.png")], check=True)
    assert (tmp_path / "here.png").read_bytes() == (tmp_path / "there.png").read_bytes()
    picture = read(tmp_path / "here.png")
    assert picture.shape == (PAGE[1], PAGE[0], 3)
    r, g, b = picture[: PAGE[1] - CAPTION].astype(int).transpose(2, 0, 1)
    assert np.count_nonzero((g > r + 25) & (g > b + 15)) > 100  # the robot at its goal
    assert np.count_nonzero((b > r + 20) & (b > g + 5) & (b > 200)) > 100  # and on its way


COLLIDING = [0.0, 2.2, 1.2, -0.4, 0.0, 0.0]


@pytest.mark.slow
def test_of_an_end_in_collision_what_touches_is_red(tmp_path: Path) -> None:
    service = PlannerService("wxai", Scene((Obstacle("bar", Box((0.05, 0.05, 0.05)), Pose((0.35, 0.0, 0.05))),)))
    red = {}
    for name, start, goal in (
        ("free", service.robot.home, [0.8, 1.3, 1.0, -0.8, 0.0, 0.0]),
        ("goal", service.robot.home, COLLIDING),
        ("start", COLLIDING, service.robot.home),
    ):
        request = PlanRequest(start, goal, time_limit=None)
        draw_plan(service, request, service.plan(request), tmp_path / f"{name}.png")
        red[name] = red_part(tmp_path / f"{name}.png")
    assert red["free"] == 0.0
    assert red["goal"] > 0.002
    assert red["start"] > 0.002


@pytest.mark.slow
def test_a_task_is_drawn_whole_or_as_far_as_it_goes(tmp_path: Path) -> None:
    service = PlannerService("wxai", "bin")
    request = PlanRequest(service.robot.home, service.robot.home, time_limit=None)
    task = plan_pick_place(service, "blue_block", "tray", request)
    for name, segments in (("all", task.segments), ("none", ())):
        draw_task(service, replace(task, segments=segments), tmp_path / f"{name}.png")
    paths = [
        np.count_nonzero((read(tmp_path / f"{name}.png") == (20, 84, 190)).all(axis=2)) for name in ("all", "none")
    ]
    assert paths[0] > paths[1] + 200


# the command line


def test_a_command_draws_a_picture_or_refuses_its_place_before_anything_is_planned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good, plot = tmp_path / "a.png", str(tmp_path / "b.png")
    touching = ("check", "--scene", "bin", "--q", "0,2.2,1.2,-0.4,0,0")
    assert run(*touching, "--png", good).exit_code == 1
    assert red_part(good) > 0.01
    monkeypatch.setattr(PlannerService, "plan", lambda *_, **__: pytest.fail("planned"))
    plan = ("plan", "--robot", "planar2", "--scene", "discs", "--start", "lesson_start", "--goal", "lesson_goal")
    for command, file, expected in (
        ((*plan,), "nowhere/a.png", "the folder"),
        (("pick-place",), "nowhere/a.png", "the folder"),
        ((*plan,), "a.jpg", "expected a name that ends in .png"),
        ((*plan, "--plot", plot), "./b.png", "expected a different file from --plot"),
    ):
        assert expected in refused(*command, "--png", f"{tmp_path}/{file}")
    assert [file.name for file in tmp_path.iterdir()] == ["a.png"]

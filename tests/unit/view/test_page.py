"""The page in a real browser: it draws, does what it is told, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import math
import os
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import Box, PlannerService, PlanRequest, Pose
from planner_service.constraints import JointRange, ToolRegion
from planner_service.records.plan_file import load_plan
from planner_service.scene.loading import load_scene
from planner_service.view import Viewer, open_viewer
from planner_service.view.serving import viewer as view_module
from planner_service.view.state import Choice
from tests.support.chromium import executable, headless, new_window, pixels
from tests.support.optional import present

ROOT = Path(__file__).parents[3]
SCENE = slice(0, 400)
"""Columns of the page in which the scene is, the panel being to the right of it."""

NOTICE = slice(0, 190)
"""Rows in which the page may tell that it draws without a graphics card."""

ELBOW = JointRange("elbow", -2.5, 2.5)

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(executable() is None, reason="no Chromium; set PLANNER_SERVICE_CHROMIUM to the path of one"),
]


def until(holds: Callable[[], Any], seconds: float = 90.0) -> Any:
    """What comes to hold, waited for."""
    end = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < end, "it never came"
        time.sleep(0.05)
    return found


def press_until(button: Any, holds: Callable[[], Any]) -> None:
    """Press a button, again every two seconds: a press may miss while the page is still moving."""
    for last in (False, False, False, True):
        button.click()
        try:
            until(holds, 20.0 if last else 2.0)
            return
        except AssertionError:
            if last:
                raise


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with headless() as found:
        yield found


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    service = PlannerService("planar2", "discs")
    robot = service.robot
    request = PlanRequest(robot.pose("lesson_start"), robot.pose("lesson_goal"), time_limit=None)
    with open_viewer(service, service.plan(request, trace=True), port=0, keep=True) as found:
        yield found


@pytest.fixture(scope="module")
def page(browser: Any, viewer: Viewer) -> Any:
    found = new_window(browser, viewport={"width": 800, "height": 500})
    asked: list[str] = []
    found.on("request", lambda request: asked.append(request.url))
    found.goto(viewer.url)
    found.get_by_text("shoulder").first.wait_for()
    until(lambda: len(np.unique(picture(found).reshape(-1, 3), axis=0)) > 50)
    found.asked = asked
    return found


def picture(page: Any) -> Any:
    """The scene as it is drawn, without the notice."""
    return pixels(page)[NOTICE.stop :, SCENE]


def settled(page: Any) -> Any:
    """The scene once it is drawn as it will stay."""
    before = picture(page)
    while True:
        time.sleep(0.3)
        after = picture(page)
        if np.array_equal(before, after):
            return after
        before = after


def slider(page: Any, number: int) -> Any:
    """A slider of the page: the first is the clock's."""
    return page.get_by_role("slider").nth(number)


def test_the_page_asks_nobody_but_its_server(page: Any, viewer: Viewer) -> None:
    elsewhere = [url for url in page.asked if not url.startswith((viewer.url, "data:", "blob:"))]
    assert elsewhere == []


@pytest.mark.slow
def test_a_joints_slider_moves_the_robot(page: Any, viewer: Viewer) -> None:
    before, q = settled(page), viewer.page.state.q
    slider(page, 1).focus()
    for _ in range(30):
        page.keyboard.press("ArrowRight")
    until(lambda: abs(viewer.page.state.q[0] - q[0]) > 0.02)
    assert viewer.page.state.q[1] == q[1]
    assert viewer.page.state.seconds is None
    until(lambda: np.any(picture(page) != before))


@pytest.mark.slow
def test_the_clocks_slider_moves_the_robot_along_the_plan(page: Any, viewer: Viewer) -> None:
    playback = present(viewer.page.state.playback)
    before = settled(page)
    slider(page, 0).focus()
    page.keyboard.press("End")
    until(lambda: viewer.page.state.seconds == playback.duration)
    assert viewer.page.state.q.tolist() == playback.at(playback.duration).q.tolist()
    until(lambda: np.any(picture(page) != before))


@pytest.mark.slow
def test_a_colliding_configuration_shows_its_pair_in_red(page: Any, viewer: Viewer) -> None:
    service = viewer.page.state.service
    start, goal = service.robot.pose("lesson_start"), service.robot.pose("lesson_goal")
    hit = next(q for q in np.linspace(start, goal, 200) if not service.checker.state_is_free(q))
    (contact, *_) = service.checker.contacts(hit)
    viewer.page.pose(start)
    page.get_by_text("free").first.wait_for()
    until(lambda: reds(picture(page)) == 0)
    viewer.page.pose(hit)
    page.get_by_text("in collision").first.wait_for()
    assert f"{contact.a} × {contact.b}" in page.locator("body").inner_text()
    until(lambda: reds(picture(page)) > 20)


def reds(image: Any) -> int:
    red, green, blue = (image[..., k].astype(int) for k in range(3))
    return int(((red > 150) & (green < 80) & (blue < 80)).sum())


@pytest.fixture(scope="module")
def constrained(browser: Any) -> Iterator[tuple[Any, Viewer]]:
    """The page of a plan with constraints, with a name from a file."""
    service = PlannerService("planar2", "discs")
    robot = service.robot
    low = ToolRegion(upper=(math.inf, 1.4, math.inf), tilt=0.5, turn=3.0, name="<img src=x>")
    request = PlanRequest(
        robot.pose("lesson_start"), robot.pose("lesson_goal"), time_limit=None, constraints=[low, ELBOW]
    )
    with open_viewer(service, service.plan(request), port=0, keep=True) as viewer:
        page = new_window(browser, viewport={"width": 800, "height": 500})
        page.goto(viewer.url)
        page.get_by_text("shoulder").first.wait_for()
        page.get_by_role("tab", name="show").click()
        for box in ("handles to drag", "goal (green)"):  # whose green is nearly teal
            page.get_by_text(box).click()
        until(lambda: len(np.unique(picture(page).reshape(-1, 3), axis=0)) > 50)
        yield page, viewer


@pytest.mark.slow
def test_constraints_are_drawn_while_their_box_is_ticked_and_red_where_they_are_left(
    constrained: tuple[Any, Viewer],
) -> None:
    page, viewer = constrained
    page.get_by_role("tab", name="show").click()
    until(lambda: teals(picture(page)) > 200)
    page.get_by_text("constraints (teal)").click()
    until(lambda: teals(picture(page)) == 0)
    page.get_by_text("constraints (teal)").click()
    until(lambda: teals(picture(page)) > 200)
    viewer.page.pose(np.array([math.pi / 2, 0.0]))
    until(lambda: teals(picture(page)) == 0)
    viewer.page.pose(np.zeros(2))
    until(lambda: teals(picture(page)) > 200)


@pytest.fixture(scope="module")
def bin_page(browser: Any) -> Iterator[tuple[Any, Viewer]]:
    """The page of a plan whose goal can be dragged anywhere."""
    service = PlannerService("wxai", "bin")
    robot = service.robot
    result = service.plan(PlanRequest(robot.home, robot.pose("ready"), time_limit=None))
    with open_viewer(service, result, port=0, keep=True) as viewer:
        page = new_window(browser, viewport={"width": 1000, "height": 700})
        page.goto(viewer.url)
        page.get_by_role("tab", name="plan").click()
        until(lambda: len(handle(page)) > 10)
        yield page, viewer


def handle(page: Any) -> Any:
    """Where the handle for the tool's z axis is drawn, (m, 2) rows and columns, the highest first."""
    image = pixels(page)[:, :600]
    red, green, blue = (image[..., k].astype(int) for k in range(3))
    return np.argwhere((blue > 200) & (blue - red > 90) & (red > 60) & (abs(green - 160) < 25))


def test_dragging_a_handle_moves_the_goal(bin_page: tuple[Any, Viewer]) -> None:
    page, viewer = bin_page
    settled(page)
    row, column = handle(page)[5].tolist()
    before, goal = viewer.page.state.tool_of_goal.position, viewer.page.state.goal
    page.mouse.move(column, row + 2)
    page.mouse.down()
    for k in range(1, 9):
        page.mouse.move(column, row + 2 - 5 * k)
        time.sleep(0.05)
    until(lambda: viewer.page.state.aim is not None)
    page.mouse.up()
    until(lambda: viewer.page.state.aim is None)
    after = viewer.page.state.tool_of_goal.position
    assert after[2] > before[2] + 0.01
    assert np.abs(viewer.page.state.goal - goal).max() > 0.01


@pytest.mark.slow
def test_a_plan_is_saved_by_the_browser(bin_page: tuple[Any, Viewer], tmp_path: Path) -> None:
    page, viewer = bin_page
    with page.expect_download() as download:
        page.get_by_role("button", name="save plan").click()
    download.value.save_as(tmp_path / "plan.json")
    assert download.value.suggested_filename == "plan.json"
    saved, shown = load_plan(tmp_path / "plan.json").result, viewer.page.state.results[0].result
    assert present(saved.path).waypoints.tolist() == present(shown.path).waypoints.tolist()


def teals(image: Any) -> int:
    return int(teal(image).sum())


def teal(image: Any) -> Any:
    red, green, blue = (image[..., k].astype(int) for k in range(3))
    return (red < green - 60) & (abs(green - blue) < 30)


@pytest.mark.slow
def test_start_and_goal_are_set_and_the_plan_button_plans_between_them(page: Any, viewer: Viewer) -> None:
    robot = viewer.page.state.service.robot
    page.get_by_role("tab", name="robot").click()
    viewer.page.pose(robot.pose("lesson_goal"))
    start, goal = (page.get_by_role("button", name=name, exact=True).first for name in ("start", "goal"))
    press_until(start, lambda: np.array_equal(viewer.page.state.start, robot.pose("lesson_goal")))
    viewer.page.pose(robot.pose("lesson_start"))
    press_until(goal, lambda: np.array_equal(viewer.page.state.goal, robot.pose("lesson_start")))
    page.get_by_role("tab", name="plan").click()
    page.get_by_role("button", name="plan", exact=True).click()
    until(lambda: viewer.page.state.seconds == 0.0)
    (segment,) = viewer.page.state.results
    path, _ = segment.result.unwrap()
    assert path.waypoints[[0, -1]].tolist() == [robot.pose(p).tolist() for p in ("lesson_goal", "lesson_start")]
    page.get_by_text(f"{segment.result.counts.states:,}").first.wait_for()  # the page before may be certified, too
    assert "certified" in page.locator("body").inner_text()


@pytest.mark.slow
def test_a_window_that_is_closed_ends_the_viewer_and_its_threads(browser: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view_module, "GRACE", 0.5)
    before = set(threading.enumerate())
    viewer = open_viewer(PlannerService("planar2", "discs"), None, port=0)
    window = new_window(browser)
    window.goto(viewer.url)
    window.get_by_text("shoulder").first.wait_for()
    viewer.page.play()
    window.close()
    viewer.wait()
    assert not viewer.open
    until(lambda: set(threading.enumerate()) <= before)
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(viewer.url, timeout=60)


@pytest.fixture
def command() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command ``view`` in a process group of its own, and the address it printed."""
    arguments = [sys.executable, "-c", "from planner_service.cli import main; main()"]
    arguments += ["view", "--robot", "planar2", "--scene", "discs", "--port", "0", "--no-browser"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        arguments, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as process:  # fmt: skip
        try:
            line = present(process.stdout).readline()
            assert line.startswith("view: http://127.0.0.1:"), process.stderr and process.stderr.read()
            yield process, line.split()[1]
        finally:
            process.kill()


@pytest.mark.slow
def test_the_command_ends_when_its_page_is_closed_and_leaves_no_process(
    browser: Any, command: tuple[subprocess.Popen[str], str]
) -> None:
    process, url = command
    window = new_window(browser)
    window.goto(url)
    window.get_by_text("shoulder").first.wait_for()
    window.close()
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out, err) == (0, "", "")
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)


@pytest.mark.slow
def test_playing_ends_at_the_goal(page: Any, viewer: Viewer) -> None:
    playback = present(viewer.page.state.playback)
    viewer.page.scrub(playback.duration - 0.5)
    page.get_by_role("button", name="play").click()
    until(lambda: viewer.page.state.seconds == playback.duration)
    page.get_by_role("button", name="play").wait_for()


def test_a_fault_while_planning_leaves_the_button_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    def fault(*_: Any, **__: Any) -> None:
        raise RuntimeError("a bug")

    service = PlannerService("planar2", "discs")
    with open_viewer(service, None, port=0) as viewer:
        monkeypatch.setattr(service, "plan", fault)
        for _ in range(2):
            with pytest.raises(RuntimeError, match="a bug"):
                viewer.page.plan(Choice("rrtconnect"))


# Building a cell


@pytest.fixture(scope="module")
def cell_page(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Any, Viewer, Path]]:
    """The page of a cell that is built, and its folder."""
    folder = tmp_path_factory.mktemp("cells")
    with open_viewer(PlannerService("wxai", "bin"), None, port=0, keep=True, folder=folder) as viewer:
        page = new_window(browser, viewport={"width": 1000, "height": 700})
        page.goto(viewer.url)
        page.get_by_role("tab", name="cell").click()
        until(lambda: len(np.unique(picture(page).reshape(-1, 3), axis=0)) > 50)
        yield page, viewer, folder


def fill(page: Any, label: str, text: str, number: int = 1) -> None:
    """Type into a field, key by key; ``number`` is that of a vector."""
    field = page.locator(f"xpath=//label[normalize-space(text())='{label}']/following::input[{number}]").first
    field.click()
    field.press("Control+a")
    field.type(text)
    field.press("Tab")


def on_screen(viewer: Viewer, point: Any) -> tuple[float, float]:
    """Where a point of the base frame is seen, in pixels."""
    (client,) = viewer._server.viser.get_clients().values()
    camera = client.camera
    turn = Pose(quaternion=tuple(camera.wxyz)).rotation
    x, y, z = turn.T @ (np.asarray(point) - np.array(camera.position))
    focal = camera.image_height / 2.0 / math.tan(camera.fov / 2.0)
    return camera.image_width / 2.0 + focal * x / z, camera.image_height / 2.0 + focal * y / z


def click_until(page: Any, viewer: Viewer, point: Any, holds: Callable[[], Any]) -> None:
    """Click a point of the scene, again every few seconds: what is under the mouse is found once it is drawn."""
    end = time.monotonic() + 90.0
    while not holds():
        assert time.monotonic() < end, "no click did it"
        x, y = on_screen(viewer, point)
        page.mouse.move(x - 3.0, y)
        time.sleep(0.3)
        page.mouse.move(x, y)
        time.sleep(0.5)
        page.mouse.click(x, y)
        with contextlib.suppress(AssertionError):
            until(holds, 5.0)


@pytest.mark.slow
def test_an_obstacle_is_added_named_sized_coloured_and_saved(cell_page: tuple[Any, Viewer, Path]) -> None:
    page, viewer, folder = cell_page
    page.get_by_role("button", name="box", exact=True).click()
    until(lambda: viewer.page.state.cell.selected == "box")
    fill(page, "name", "crate")
    until(lambda: viewer.page.state.cell.selected == "crate")
    fill(page, "size (m)", "0.06", 1)
    until(lambda: present(viewer.page.state.cell.obstacle).shape == Box((0.06, 0.1, 0.1)))
    fill(page, "turn (deg)", "30", 3)
    until(
        lambda: (
            present(viewer.page.state.cell.obstacle).pose.quaternion[3] == pytest.approx(math.sin(math.radians(15.0)))
        )
    )
    fill(page, "colour", "#c83264")
    until(lambda: present(viewer.page.state.cell.obstacle).colour == "#c83264")
    page.keyboard.press("Escape")
    press_until(page.get_by_role("button", name="save", exact=True), (folder / "bin.toml").exists)
    page.get_by_text("the same scene").wait_for()
    saved = load_scene(folder / "bin.toml")
    assert saved == viewer.page.state.cell.scene
    assert saved.obstacle("crate").colour == "#c83264"


@pytest.mark.slow
def test_the_selected_obstacle_slides_over_what_is_behind_it(cell_page: tuple[Any, Viewer, Path]) -> None:
    page, viewer, _ = cell_page
    viewer.page.edit(lambda cell: cell.added("box", (0.35, -0.35)))
    settled(page)
    before = present(viewer.page.state.cell.obstacle).pose.position
    x, y = on_screen(viewer, np.add(before, (0.03, 0.0, 0.05)))  # beside the arrows, on its top
    page.mouse.move(x - 3.0, y)
    time.sleep(1.0)
    page.mouse.move(x, y)
    time.sleep(1.0)
    page.mouse.down()
    for k in range(1, 11):
        page.mouse.move(x + 4.0 * k, y)
        time.sleep(0.1)
    time.sleep(1.0)
    page.mouse.up()
    until(lambda: present(viewer.page.state.cell.obstacle).pose.position != before)
    after = present(viewer.page.state.cell.obstacle).pose.position
    assert np.abs(np.subtract(after, before)[:2]).max() > 0.01
    assert after[2] == before[2], "it stands on the table as before"


@pytest.mark.slow
def test_what_is_clicked_is_picked_and_placed_where_is_clicked(cell_page: tuple[Any, Viewer, Path]) -> None:
    page, viewer, _ = cell_page
    viewer.page.edit(lambda cell: cell.select(None))
    scene = viewer.page.state.cell.scene
    page.get_by_role("tab", name="plan").click()
    block = np.array(scene.obstacle("blue_block").pose.position)
    click_until(page, viewer, block, lambda: viewer.page.state.cell.selected == "blue_block")
    pick = page.get_by_role("button", name="pick selected")
    press_until(pick, lambda: viewer.page.state.errand is not None)
    spot = np.add(scene.obstacle("tray").pose.position, (0.0, 0.06, 0.005))  # beside the post, as seen from there
    click_until(page, viewer, spot, lambda: present(viewer.page.state.errand).support == "tray")
    press_until(page.get_by_role("button", name="plan pick and place"), lambda: viewer.page.state.playback is not None)
    playback = present(viewer.page.state.playback)
    page.get_by_text("transfer").first.wait_for()
    viewer.page.scrub(playback.duration)
    x, y, _ = viewer.page.state.service.scene.obstacle("blue_block").pose.position
    assert (x, y) == pytest.approx(spot[:2], abs=0.003)

"""The page in a real browser: it draws, does what it is told, and leaves nothing behind."""

from __future__ import annotations

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

from planner_service import PlannerService, PlanRequest
from planner_service.constraints import JointRange, ToolRegion
from planner_service.records.plan_file import load_plan
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

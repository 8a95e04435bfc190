"""The page in the browser: how long until it is drawn, what a step of the clock takes, and what is left behind.

The browser is a headless Chromium that draws without a graphics card, on the processor that the service runs on. What
it takes for a page of viser's with one ball is measured next to ours, by turns: that much is the browser's own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import Promise, Report, Row, p50, p95, spread, table
from benchmarks.worlds import queries
from planner_service import PlannerService, PlanRequest, PlanResult
from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.view import Viewer, open_viewer

__all__ = ["run"]

SCENE = "bin"
STARTS = 3
WAYPOINTS = 1000
DRAWN_SECONDS, STEP_MS = 3.0, 15.0
COLOURS = 50
"""In the picture of something round or of an arm; an empty page has a few."""

TURNS = 20
"""Steps of the clock in the browser whose way to the server and back is timed."""

COMMAND = (sys.executable, "-c", "from planner_service.cli import main; main()")


def run() -> Report:
    """Measure all of it; where there is no browser what needs one is left out."""
    from tests.support import chromium

    if chromium.executable() is None:
        raise InvalidRequest("PLANNER_SERVICE_CHROMIUM", None, "the path of a Chromium, or one that is installed")
    with chromium.headless() as browser:
        _one_ball(browser, chromium.pixels)  # the browser's own first page takes longest
        starts = [(*_started(browser, chromium.pixels), _one_ball(browser, chromium.pixels)) for _ in range(STARTS)]
        steps = _steps(browser)
    served, drawn, left, ball = (np.array([start[k] for start in starts]) for k in range(4))
    ours = float(drawn.min() - ball.min())  # what disturbs only adds
    named = {"command to served page": served, "command to drawn robot": drawn, "a page with one ball": ball}
    rows = [(name, f"{p50(v):.2f}", f"{v.min():.2f}", f"{v.max():.2f}") for name, v in named.items()]
    server, turn = steps["server_ms"], steps["turn_ms"]
    times = [("server: pose, clearance, messages (CPU)", spread(server, 2))]
    times.append(("key press to server (wall)", spread(turn, 1)))
    tables = (
        table(f"planner-service view --scene {SCENE}, {STARTS} starts, s", ("", "p50", "least", "most"), rows),
        table(f"One step along {steps['waypoints']} waypoints, ms", ("", "p50 / p95"), times),
    )
    text = f"a robot is drawn within {DRAWN_SECONDS:g} s, beside what the browser takes for one ball"
    promises = (
        Promise(text, f"{ours:.2f} s, least of each", ours < DRAWN_SECONDS),
        Promise(f"a step takes under {STEP_MS:g} ms", f"p95 {p95(server):.2f} ms", p95(server) < STEP_MS),
        Promise("closing the page leaves no process", f"{int(left.sum())} left", not left.any()),
    )
    seconds = {"served_s": served, "drawn_s": drawn, "ball_s": ball, "left": left}
    row: Row = {key: values.tolist() for key, values in seconds.items()} | steps
    return Report("view", (row,), tables, promises)


def _started(browser: Any, pixels: Callable[[Any], Any]) -> tuple[float, float, int]:
    """Seconds until the command served its page, and until that was drawn; processes left once it was closed."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    arguments = [*COMMAND, "view", "--scene", SCENE, "--port", "0", "--no-browser"]
    began = time.monotonic()
    with subprocess.Popen(
        arguments, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        if process.stdout is None:
            raise BrokenInvariant("a pipe was asked for")
        url = process.stdout.readline().split()[1]
        served = time.monotonic() - began
        window = _drawn(browser, pixels, url)
        drawn = time.monotonic() - began
        window.close()
        process.wait(timeout=60)
    return served, drawn, _group_size(process.pid)


def _drawn(browser: Any, pixels: Callable[[Any], Any], url: str) -> Any:
    """The window of a page, once there is more to be seen in it than ground."""
    window = browser.new_page(viewport={"width": 800, "height": 500})
    window.goto(url)
    while len(np.unique(pixels(window)[190:, :400].reshape(-1, 3), axis=0)) < COLOURS:
        pass
    return window


def _one_ball(browser: Any, pixels: Callable[[Any], Any]) -> float:
    """Seconds until the browser has drawn a page of viser's with a ball."""
    import viser

    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(True, cast_shadow=False)
    server.scene.add_icosphere("/ball", radius=1.0, subdivisions=4)
    began = time.monotonic()
    window = _drawn(browser, pixels, f"http://127.0.0.1:{server.get_port()}")
    seconds = time.monotonic() - began
    window.close()
    server.stop()
    return seconds


def _group_size(group: int) -> int:
    """Processes in a process group."""
    told = subprocess.run(["ps", "-e", "-o", "pgid="], capture_output=True, text=True, check=True)
    return sum(int(line) == group for line in told.stdout.split())


def _steps(browser: Any) -> dict[str, Any]:
    """Milliseconds of steps along a motion of many waypoints, each at another of them."""
    service = PlannerService(queries.ROBOT, SCENE)
    viewer = open_viewer(service, _long_motion(service), port=0, keep=True)
    with viewer:
        window = browser.new_page(viewport={"width": 800, "height": 500})
        window.goto(viewer.url)
        window.get_by_text("joint_0").first.wait_for()
        playback = viewer.page.state.playback
        if playback is None:
            raise BrokenInvariant("there is no motion")
        path = playback.clips[0].trajectory.path
        server = []
        for t in np.linspace(0.0, playback.duration, len(path.waypoints)):
            clock = time.thread_time()
            viewer.page.scrub(float(t))
            server.append(1e3 * (time.thread_time() - clock))
        turn = _turns(window, viewer)
        return {"waypoints": len(path.waypoints), "server_ms": server, "turn_ms": turn}


def _turns(window: Any, viewer: Viewer) -> list[float]:
    """Milliseconds from a key pressed on the clock's slider until the server has moved the robot."""
    viewer.page.scrub(0.0)
    time.sleep(1.0)
    window.get_by_role("slider").first.focus()
    found = []
    for _ in range(TURNS):
        before, clock = viewer.page.state.seconds, time.perf_counter()
        window.keyboard.press("ArrowRight")
        while viewer.page.state.seconds == before:
            time.sleep(0.0005)
            if time.perf_counter() - clock > 30.0:
                raise BrokenInvariant("the slider did not move the robot")
        found.append(1e3 * (time.perf_counter() - clock))
        time.sleep(0.1)
    return found


def _long_motion(service: PlannerService) -> PlanResult:
    """A planned path as a polyline of many waypoints."""
    for query in queries.load(SCENE):
        path = service.plan(PlanRequest(query.start, query.goal, time_limit=None)).path
        if path is not None and path.length > 2.0:
            points = path(np.linspace(0.0, path.length, WAYPOINTS))
            result = service.follow(points, blends=np.full(WAYPOINTS, path.length / (3 * WAYPOINTS)))
            if result.ok:
                return result
    raise BrokenInvariant(f"no plan of {SCENE} is long enough")

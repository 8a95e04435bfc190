"""How many frames a second the viewer's page draws of a cell of 200 obstacles and a cloud of 20,000 points."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.harness.report import Promise, Report, table
from planner_service.view import Viewer, open_viewer
from tests.support.chromium import ANY_GL, headless, new_window

__all__ = ["cell", "run"]

OBSTACLES, POINTS = 200, 20_000

WINDOWS = ((1440, 900), (900, 700), (390, 844))

SECONDS = 6.0
"""Of each measurement."""

LEAST, MOST_MS = 30.0, 1000.0 / 30.0

COUNT = """() => {
  window.frames_drawn = 0
  let drew = false
  for (const name of ['drawElements', 'drawArrays', 'drawElementsInstanced', 'drawArraysInstanced']) {
    const real = WebGL2RenderingContext.prototype[name]
    WebGL2RenderingContext.prototype[name] = function (...given) { drew = true; return real.apply(this, given) }
  }
  const tick = () => { if (drew) { window.frames_drawn++; drew = false } requestAnimationFrame(tick) }
  requestAnimationFrame(tick)
}"""
"""Counts frames in which something was drawn: the page draws none in which nothing moves."""

RENDERER = """() => {
  const gl = document.createElement('canvas').getContext('webgl2')
  return gl.getParameter(gl.getExtension('WEBGL_debug_renderer_info').UNMASKED_RENDERER_WEBGL)
}"""

SOFTWARE = ("SwiftShader", "llvmpipe", "softpipe")


def cell() -> ps.Scene:
    """Boxes, balls, cylinders and capsules around an arm, and a wavy wall as a camera sees it."""
    rng = np.random.default_rng(0)
    things = []
    for k in range(OBSTACLES):
        turn, away, size = rng.uniform(-math.pi, math.pi), rng.uniform(0.45, 1.2), rng.uniform(0.02, 0.06)
        shapes = (
            ps.Box((size, 1.5 * size, size)),
            ps.Sphere(size / 2.0),
            ps.Cylinder(size / 2.0, 2.0 * size),
            ps.Capsule(size / 3.0, 2.0 * size),
        )
        place = (away * math.cos(turn), away * math.sin(turn), rng.uniform(0.05, 0.8))
        things.append(ps.Obstacle(f"thing_{k}", shapes[k % 4], ps.Pose(place)))
    y, z = rng.uniform((-0.8, 0.0), (0.8, 0.5), (POINTS, 2)).T
    wall = ps.PointCloud(np.column_stack([1.3 + 0.03 * np.sin(9.0 * y) + 0.1 * z, y, z]), 0.005)
    return ps.Scene((*things, ps.Obstacle("wall", wall)))


def run() -> Report:
    """The camera goes around, dragged by the mouse; then a motion is played."""
    service = ps.PlannerService("wxai", cell())
    robot = service.robot
    result = service.plan(ps.PlanRequest(robot.home, robot.home + np.eye(robot.n)[0], time_limit=None))
    result.unwrap()
    rows, renderer = list[dict[str, Any]](), ""
    with open_viewer(service, result, port=0, keep=True) as viewer, headless(ANY_GL) as browser:
        for width, height in WINDOWS:
            page = new_window(browser, viewport={"width": width, "height": height})
            page.goto(viewer.url)
            page.get_by_role("tab", name="cell").wait_for()
            time.sleep(3.0)
            renderer = str(page.evaluate(RENDERER))
            page.evaluate(COUNT)
            for what, act in (("camera goes around", _go_around), ("motion is played", _play)):
                rows.append({"window": f"{width} x {height}", "what": what, **_measured(page, viewer, act)})
            page.close()
    software = any(name in renderer for name in SOFTWARE)
    columns = ("window", "what moves", "frames a second", "CPU ms of the page's thread a frame")
    cells = [(row["window"], row["what"], f"{row['rate']:.1f}", f"{row['work_ms']:.1f}") for row in rows]
    kind = f"{'software' if software else 'hardware'} GL: {renderer}"
    rate, work = min(row["rate"] for row in rows), max(row["work_ms"] for row in rows)
    fast = Promise(f"at least {LEAST:.0f} frames a second on hardware GL", f"{rate:.1f}, on {kind}", rate >= LEAST)
    light = Promise(f"the page's thread takes at most {MOST_MS:.0f} ms a frame", f"{work:.1f} ms", work <= MOST_MS)
    title = f"{OBSTACLES} obstacles and a cloud of {POINTS:,} points, {kind}"
    promises = (light,) if software else (light, fast)
    return Report(
        "frames", tuple({**row, "renderer": renderer} for row in rows), (table(title, columns, cells),), promises
    )


def _measured(page: Any, viewer: Viewer, act: Any) -> dict[str, float]:
    """Frames drawn per second, and milliseconds of CPU of the page's main thread for each of them."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def now() -> tuple[float, float, float]:
        found = {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}
        return time.monotonic(), found["TaskDuration"], float(page.evaluate("window.frames_drawn"))

    before = now()
    act(page, viewer)
    seconds, work, frames = (after - value for after, value in zip(now(), before, strict=True))
    return {"rate": frames / seconds, "work_ms": 1e3 * work / max(frames, 1.0)}


def _go_around(page: Any, _: Viewer) -> None:
    width, height = page.viewport_size["width"], page.viewport_size["height"]
    x, y = width * (0.25 if width > 600 else 0.5), height * 0.25
    page.mouse.move(x, y)
    page.mouse.down()
    end = time.monotonic() + SECONDS
    while (left := end - time.monotonic()) > 0.0:
        page.mouse.move(x + 80.0 * math.sin(3.0 * left), y + 20.0 * math.cos(3.0 * left))
        time.sleep(0.01)
    page.mouse.up()


def _play(page: Any, viewer: Viewer) -> None:
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        viewer.page.play()
        page.wait_for_timeout(50)
    viewer.page.pause()

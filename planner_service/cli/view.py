"""The command that opens a page in the browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import typer

from planner_service.cli.arguments import reopened, require_proven
from planner_service.cli.exit_codes import bad_input_exits
from planner_service.cli.options import Allow
from planner_service.cli.tables import emit
from planner_service.errors import InvalidRequest
from planner_service.planning.result import Origin
from planner_service.presentation.page import Showable
from planner_service.records.plan_file import SavedTask, load_plan_or_task
from planner_service.robot.model import load_robot
from planner_service.scene.worlds import load_world
from planner_service.service import PlannerService
from planner_service.view import HOST, PORT, open_viewer

__all__ = ["opened", "view"]


def view(
    file: Annotated[
        str | None, typer.Argument(metavar="FILE", help="A plan or a task written with --out, to show its motion.")
    ] = None,
    scene: Annotated[str | None, typer.Option(help="As for plan; if not given, the one in FILE.")] = None,
    robot: Annotated[str | None, typer.Option(help="As for plan; if not given, the one in FILE.")] = None,
    port: Annotated[int, typer.Option(help="The first port to try; 0 for any.")] = PORT,
    host: Annotated[str, typer.Option(help="The address to serve it at: whoever can reach that can use the page.")] = (
        HOST
    ),
    allow: Allow = None,
    keep: Annotated[bool, typer.Option("--keep", help="Go on when the last window was closed.")] = False,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
) -> None:
    """Show robot, scene and plan on a page in the browser, move joints there and plan; ends when the page is closed."""
    with bad_input_exits():
        service, shown, notes = opened(file, robot, scene, allow)
        viewer = open_viewer(service, shown, host=host, port=port, keep=keep)
    with viewer:
        until = "Ctrl-C ends it" if keep else "it ends when the page is closed, or with Ctrl-C"
        emit("".join(f"note: {note}\n" for note in notes) + f"view: {viewer.url} ({until})\n")
        if not no_browser and _has_display():
            webbrowser.open(viewer.url)
        viewer.wait()


def opened(
    file: str | None, robot: str | None, scene: str | None, allow: Sequence[str] | None = None
) -> tuple[PlannerService, Showable | None, list[str]]:
    """The service, what it is to show, and what is to be said of that.

    Raises:
        NotProven: the file does not hold what it says in the scene that it brings.
    """
    if file is None:
        if scene is None:
            raise InvalidRequest("--scene", None, "a scene", message="give a --scene, or the FILE of a plan or a task")
        return PlannerService(load_robot(robot or "wxai"), load_world(scene)), None, []
    made = load_plan_or_task(file)
    require_proven(made, allow)
    saved, notes = reopened(made, robot, scene)
    service = saved.service()
    if isinstance(saved, SavedTask):
        return service, saved, notes
    # of another robot or scene, or with another edge step, the search is not the same
    same = (saved.robot.hash, saved.scene.hash) == (made.robot.hash, made.scene.hash)
    known = same and saved.made_for.edge_step is not None
    return service, replace(saved.result, origin=Origin(service.world, saved.request) if known else None), notes


def _has_display() -> bool:
    """Whether a browser would have a window: without one, it would be one in the terminal."""
    return sys.platform == "darwin" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))

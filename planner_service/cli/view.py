"""The command ``view``: opens the viewer's page in the browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

from planner_service.cell import CellPlan
from planner_service.cli import options
from planner_service.cli.arguments import reopened, require_proven
from planner_service.cli.exit_codes import bad_input_exits
from planner_service.cli.options import argument, option
from planner_service.cli.output import emit
from planner_service.errors import InvalidRequest
from planner_service.planning.result import Origin
from planner_service.presentation.page import Showable
from planner_service.records.cells import SavedCellPlan, load_saved, prove_cell
from planner_service.records.plan_file import SavedTask
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService
from planner_service.view import HOST, PORT, open_viewer
from planner_service.workspace import ReachabilityMap, load_map

__all__ = ["opened", "view"]


def view(
    file: Annotated[str | None, argument("FILE", "A plan or task, of one arm or several, saved with --out.")] = None,
    scene: Annotated[str | None, option("NAME", "As for plan; default: the one in FILE.")] = None,
    robot: options.OtherRobot = None,
    port: Annotated[int, option("N", "The first port to try; 0 for any.")] = PORT,
    host: Annotated[str, option("Address to serve the page at. Anyone who reaches it can use it.")] = (HOST),
    allow: options.Allow = None,
    keep: Annotated[bool, option("--keep", "Keep serving after the last window is closed.")] = False,
    folder: Annotated[str | None, option("DIR", "Where the page may load meshes and clouds, and save scenes.")] = None,
    reach: Annotated[str | None, option("MAP", "A reachability map (reachability build) of robot and scene.")] = None,
    trust: Annotated[bool, option("--trust", "You made MAP yourself: believe what it calls proven.")] = False,
    no_browser: Annotated[bool, option("--no-browser", "Only print the page's address.")] = False,
) -> None:
    """Show robot, scene and plan on a page in the browser, where you can move joints, plan, and build a cell.

    The command ends when the page is closed.
    """
    with bad_input_exits():
        service, shown, notes = opened(file, robot, scene, allow, empty=folder is not None)
        found = _map(reach, service, trust=trust)
        viewer = open_viewer(service, shown, host=host, port=port, keep=keep, folder=folder, reach=found)
    with viewer:
        until = "Ctrl-C ends it" if keep else "close the page or press Ctrl-C to end"
        emit("".join(f"note: {note}\n" for note in notes) + f"view: {viewer.url} ({until})\n")
        if not no_browser and _has_display():
            webbrowser.open(viewer.url)
        viewer.wait()


def opened(
    file: str | None,
    robot: options.RobotChoice | None,
    scene: str | None,
    allow: Sequence[str] | None = None,
    *,
    empty: bool = False,
) -> tuple[PlannerService, Showable | CellPlan | None, list[str]]:
    """The service, the plan or task to show, and notes on where they differ from the file.

    Args:
        empty: Whether an empty scene is meant if there is neither a file nor a scene.

    Raises:
        NotProven: the motions in the file are not proven in the scene in the file.
    """
    if file is None:
        if scene is None and not empty:
            raise InvalidRequest("--scene", None, "a scene", message="give --scene, or the FILE of a plan or task")
        return PlannerService((robot or options.WXAI).load(), Scene() if scene is None else load_scene(scene)), None, []
    made = load_saved(file)
    if isinstance(made, SavedCellPlan):
        return _cell(made, robot, scene, allow)
    require_proven(made, allow)
    saved, notes = reopened(made, robot, scene)
    service = saved.service()
    if isinstance(saved, SavedTask):
        return service, saved, notes
    same = (saved.robot.hash, saved.scene.hash) == (made.robot.hash, made.scene.hash)
    return service, replace(saved.result, origin=Origin(service.world, saved.request) if same else None), notes


def _cell(
    saved: SavedCellPlan, robot: options.RobotChoice | None, scene: str | None, allow: Sequence[str] | None
) -> tuple[PlannerService, Showable | CellPlan | None, list[str]]:
    """The motions of several arms, proven again, as those of one robot."""
    if robot is not None or allow:
        raise InvalidRequest("FILE", "the plan of a cell", "a plan or a task for another robot, or with --allow")
    made = saved if scene is None else saved.within(load_scene(scene))
    if made.failure is not None:
        return made.cell.service, None, [f"no plan: {made.failure}"]
    proven = prove_cell(made).required()
    notes = ["all arms are shown as one robot; what is planned on the page has one clock"]
    return proven.cell.service, proven.plan, notes


def _map(file: str | None, service: PlannerService, *, trust: bool) -> ReachabilityMap | None:
    if file is None and trust:
        raise InvalidRequest("--trust", trust, "only with --reach")
    return None if file is None else load_map(file, service.robot, service.scene, trusted=trust)


def _has_display() -> bool:
    """Whether a browser can open a window, rather than run inside the terminal."""
    return sys.platform == "darwin" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))

"""The page in the browser: draws a ``ViewState`` and changes it as the user drags, clicks and presses buttons."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from planner_service.collision import CancelToken
from planner_service.errors import PlannerServiceError
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.presentation.tables import markdown_escaped
from planner_service.records.plan_file import SavedTask
from planner_service.scene.loading import scene_text
from planner_service.view.cell.edits import Cell
from planner_service.view.cell.folder import CellFolder
from planner_service.view.cell.surfaces import Surfaces
from planner_service.view.constraint_choices import CONSTRAINTS
from planner_service.view.controls.cell_controls import CellControls, FileControls
from planner_service.view.controls.map_layer import MapLayer
from planner_service.view.controls.obstacle_drag import ObstacleDrag
from planner_service.view.controls.planning_controls import PlanningActs, PlanningControls
from planner_service.view.controls.plots import Plots
from planner_service.view.controls.timeline import Timeline
from planner_service.view.layout import extent, fit_window, set_up
from planner_service.view.markdown import report_markdown, result_markdown, state_markdown
from planner_service.view.nodes.errand_nodes import ContactNodes, ErrandNodes
from planner_service.view.nodes.handles import Handles
from planner_service.view.nodes.looks import BOTH, CHECKED, WAYS, LookNodes
from planner_service.view.nodes.path_nodes import LAYERS, PathNodes, WaypointNodes
from planner_service.view.nodes.region_nodes import RegionNodes
from planner_service.view.nodes.robot_nodes import RobotNodes, colours_of
from planner_service.view.nodes.scene_nodes import SceneNodes
from planner_service.view.state import Choice, ViewState
from planner_service.view.still.composition import GOAL, TOUCHING
from planner_service.view.updates import update
from planner_service.workspace import ReachabilityMap

__all__ = ["Page"]

FRAMES = 30.0
"""Per second while playing."""

ARROW = 0.15
"""Length of the arrows of constraints, and of the handles of the goal, as a share of the size of robot and scene."""

OVERLAY = 0.35
"""Opacity of the shapes that are checked, drawn over what the robot looks like."""

NEAR = 10.0
"""Metres along x and y within which a new obstacle is added, wherever somebody looks."""

STEP = 0.001
"""Step of a joint's slider, in rad or m."""

START = (214, 70, 140)
"""Far from the green of the goal for everybody's eyes, and no colour of a path."""

ENDS = ("start", "goal")

NO_FOLDER = "Start `planner-service view` with `--folder DIR` to load meshes and clouds, and to save scenes."


class Page:
    """A ``ViewState`` drawn on viser's server, with its controls.

    Args:
        server: A new ``viser.ViserServer``.
        state: What to show first.
        folder: The folder that obstacles are loaded from and scenes are saved to; None for none.
        reach: A reachability map of the robot and the scene; None for none.
    """

    def __init__(
        self, server: Any, state: ViewState, folder: CellFolder | None = None, reach: ReachabilityMap | None = None
    ) -> None:
        self._server, self._folder, self._reach = server, folder, reach
        self._lock = threading.RLock()
        self._playing = threading.Event()
        self._closed = threading.Event()
        self._loading = threading.Lock()
        self._planning: CancelToken | None = None
        self._replace: str | None = None
        self.state = state
        with server.atomic():
            set_up(server, state)
            self._draw_scene()
            self._add_controls()
            self._new_motion()
            self._draw()
            self._move_sliders()
        server.on_client_connect(lambda client: fit_window(client, self.state))

    def _draw_scene(self) -> None:
        state, scene = self.state, self._server.scene
        robot, size = state.service.robot, ARROW * extent(state)[1]
        self._robot = RobotNodes(scene, "/robot", robot)
        self._start = RobotNodes(scene, "/start", robot, ghost=START)
        self._goal = RobotNodes(scene, "/goal", robot, ghost=GOAL.colour)
        self._looks = LookNodes(scene, "/looks")
        self._scene_nodes = SceneNodes(scene, self._robot.tool, self.click)
        self._regions = RegionNodes(scene, "/constraints", size)
        self._paths, self._waypoints = PathNodes(scene), WaypointNodes(scene, 0.6 * size)
        self._errand, self._contacts = ErrandNodes(scene), ContactNodes(scene)
        self._handles = Handles(scene, "/aim", size, lambda pose, released: self.aim(pose, released=released))
        self._drag = ObstacleDrag(
            scene, size, self._scene_nodes, lambda: self.state.cell,
            lambda pose: self.edit(lambda cell: cell.dragged(pose)),
        )  # fmt: skip

    def _draw(self) -> None:
        """Draw everything that depends on the configuration."""
        state = self.state
        report = state.report
        robot, colliding, expected = state.service.robot, _pairs(report.contacts), _pairs(report.expected)
        with self._server.atomic():
            self._robot.set_robot(robot)
            self._robot.move(state.q)
            self._looks.move(robot, state.q)
            self._scene_nodes.show(state.service.scene, state.cell)
            self._regions.show(state.drawn, state.q)
            if self._map is not None:
                self._map.fit(state.cell.scene)
            update(self._show_regions, visible=self._regions.any)
            aimed = state.aim is not None
            self._draw_ghost(self._start, state.start, self._show_start, hidden_by=[state.q])
            self._draw_ghost(self._goal, state.goal, self._show_goal, hidden_by=[] if aimed else [state.q, state.start])
            handles, chosen = self._show_handles.value, state.cell.selected is not None
            self._handles.show(state.tool_of_goal, visible=handles and not chosen)
            self._drag.show(handles=handles)
            colours = colours_of(colliding, expected, robot)
            self._robot.paint(colours)
            self._scene_nodes.paint(colours)
            self._contacts.show([(pair, point) for pair, point in report.points if pair in colliding])
            self._waypoints.show(state)
            self._errand.show(state.errand)
            update(self._status, content=report_markdown(report))
            update(self._clock, content=state_markdown(state))

    def _show_wishes(self) -> None:
        """Show what the next plan is to do, say what is known against its goal, and paint that red."""
        objection = self.state.goal_objection
        self._goal.tint(TOUCHING if objection else None)
        self._controls.show(self.state, f"**goal**: {markdown_escaped(objection)}" if objection else "")
        self._cell.show(self.state.cell, self._scene_nodes.colour_of(self.state.cell.selected))

    def _draw_ghost(self, ghost: RobotNodes, q: FloatArray, box: Any, *, hidden_by: list[FloatArray]) -> None:
        """Draw a ghost, unless another robot is drawn at the same configuration."""
        hidden = any(np.allclose(q, other, rtol=0.0, atol=1e-6) for other in hidden_by)
        update(ghost.root, visible=box.value and not hidden)
        if ghost.root.visible:
            ghost.set_robot(self.state.service.robot)
            ghost.move(q)

    def _new_motion(self) -> None:
        """Draw everything that depends on what was planned."""
        playback = self.state.playback
        self.pause()
        with self._server.atomic():
            for handle in (self._time, self._play, self._speed):
                update(handle, visible=playback is not None)
            if playback is not None:
                self._time.max = max(math.ceil(playback.duration * 100.0) / 100.0, 0.01)
            update(self._controls.costs, content=result_markdown(self.state))
            self._show_wishes()
            self._paths.show(self.state, self._chosen_layer)
            for name, box in self._show_layers.items():
                update(box, visible=name in self._paths)
            self._timeline.show(playback, self.state.steps)
            self._plots.show(playback)

    def _add_controls(self) -> None:
        gui = self._server.gui
        self._status = gui.add_markdown("")
        self._clock = gui.add_markdown("")
        self._time = gui.add_slider("time", 0.0, 1.0, 0.01, 0.0)
        self._timeline = Timeline(gui)
        self._play = gui.add_button("play")
        self._speed = gui.add_dropdown("speed", ("1", "0.5", "0.2", "0.1"))
        tabs = gui.add_tab_group()
        with tabs.add_tab("robot"):
            self._add_joints()
        with tabs.add_tab("plan"):
            self._controls = PlanningControls(gui, self._planning_acts())
        with tabs.add_tab("cell"):
            self._add_cell()
        self._plots = Plots(gui, tabs.add_tab("plots"), self.state.service.robot.joint_names)
        with tabs.add_tab("show"):
            self._add_toggles()
        self._time.on_update(self._on_user_update(lambda: self.scrub(self._time.value)))
        self._play.on_click(lambda _: self.pause() if self._playing.is_set() else self.play())

    def _planning_acts(self) -> PlanningActs:
        return PlanningActs(self.plan, self._send_plan, self.set_waypoint, self.constrain, self._suggested, self.pick)

    def _add_cell(self) -> None:
        gui, folder = self._server.gui, self._folder
        self._cell = CellControls(gui, self.edit, self._add_obstacle, self._send_scene)
        if folder is None:
            gui.add_markdown(NO_FOLDER)
            return
        with gui.add_folder("files"):
            name = folder.suggestion(self.state.cell.scene.name)
            self._files = FileControls(gui, folder, name, self.load, self.save)

    def _add_joints(self) -> None:
        gui, robot = self._server.gui, self.state.service.robot
        self._joints = []
        for name, low, high in zip(robot.joint_names, robot.limits.lower, robot.limits.upper, strict=True):
            ends = math.ceil(low / STEP) * STEP, math.floor(high / STEP) * STEP
            self._joints.append(gui.add_slider(name, *(round(end, 3) for end in ends), STEP, round(ends[0], 3)))
        for k, joint in enumerate(self._joints):
            joint.on_update(self._on_user_update(partial(self._move_joint, k)))
        poses = gui.add_dropdown("pose", ("", *robot.poses))
        poses.on_update(self._on_user_update(lambda: self._go_to_named_pose(poses.value)))
        setting, going = gui.add_button_group("set", ENDS), gui.add_button_group("go to", ENDS)
        setting.on_click(self._on_press(self._set_end))
        going.on_click(self._on_press(lambda end: self.pose(self.state.start if end == ENDS[0] else self.state.goal)))

    def _add_toggles(self) -> None:
        gui = self._server.gui
        self._way = gui.add_dropdown("robot", WAYS, hint="what a robot looks like may extend beyond what is checked")
        self._missing = gui.add_markdown("")
        self._way.on_update(self._on_user_update(lambda: self.draw_robot(self._way.value)))
        self._show_start = gui.add_checkbox("start (pink)", True)
        self._show_goal = gui.add_checkbox("goal (green)", True)
        self._show_handles = gui.add_checkbox("handles to drag", True)
        for box in (self._show_start, self._show_goal, self._show_handles):
            box.on_update(self._on_user_update(self._draw))
        self._show_regions = gui.add_checkbox("constraints (teal)", True, visible=False)
        self._show_regions.on_update(self._on_user_update(self._show_chosen_regions))
        make, reach = self._on_user_update, self._reach
        self._map = None if reach is None else MapLayer(gui, self._server.scene, reach, make)
        self._show_layers = {name: gui.add_checkbox(name, True) for name in LAYERS}
        for box in self._show_layers.values():
            box.on_update(self._on_user_update(lambda: self._paths.choose(self._chosen_layer)))

    def _send_plan(self, client: Any) -> None:
        """Give the browser what ``save`` would write: the page writes no file itself."""
        with self._lock:
            saved = self.state.saved
        if saved is not None:
            name = "task.json" if isinstance(saved, SavedTask) else "plan.json"
            self._send(client, name, saved.file_text, self._controls.costs)

    def _send_scene(self, client: Any) -> None:
        with self._lock:
            scene = self.state.cell.scene
        self._send(client, "cell.toml", lambda: scene_text(scene), self._cell.note)

    def _send(self, client: Any, name: str, text: Callable[[], str], note: Any) -> None:
        """Give a browser a file, if its window is still open."""
        try:
            content = text().encode()
        except PlannerServiceError as error:
            note.content = f"**not saved**: {markdown_escaped(str(error))}"
            return
        if client is not None and client.client_id in self._server.get_clients():
            client.send_file_download(name, content, save_immediately=True)

    def draw_robot(self, way: str) -> None:
        """Draw the shapes that are checked, what the robot looks like, or both; ``WAYS`` are the words."""
        with self._lock, self._server.atomic():
            self._looks.show(self.state.service.robot, visible=way != CHECKED)
            shown = self._looks.any and way != CHECKED
            self._robot.fade((OVERLAY if way == BOTH else 0.0) if shown else 1.0)
            update(self._missing, content=self._looks.note if way != CHECKED else "")
            self._looks.move(self.state.service.robot, self.state.q)

    def _show_chosen_regions(self) -> None:
        self._regions.root.visible = self._show_regions.value

    def _chosen_layer(self, name: str) -> bool:
        return bool(self._show_layers[name].value)

    def _on_user_update(self, act: Callable[[], Any]) -> Callable[[Any], None]:
        """A handler that acts only when the user moved the control, not when the page did; one event at a time."""

        def handle(event: Any) -> None:
            if event.client is not None:
                with self._lock:
                    if not self._closed.is_set():
                        act()

        return handle

    def _on_press(self, act: Callable[[str], None]) -> Callable[[Any], None]:
        """A handler for a group of buttons; one event at a time."""

        def handle(event: Any) -> None:
            with self._lock:
                if not self._closed.is_set():
                    act(event.target.value)

        return handle

    # The cell

    def edit(self, change: Callable[[Cell], Cell]) -> None:
        """Change the cell, or say why it cannot be changed; a plan that is being made is given up."""
        with self._lock:
            if self._closed.is_set():
                return
            try:
                cell = change(self.state.cell)
                state = self.state.with_cell(cell)
            except PlannerServiceError as error:
                update(self._cell.note, content=f"**not done**: {markdown_escaped(str(error))}")
                return
            edited = cell.scene is not self.state.cell.scene
            update(self._cell.note, content="")
            self._apply(state, new_motion=edited and self.state.playback is not None)
            if edited and self._planning is not None:
                self._planning.cancel()

    def _apply(self, state: ViewState, *, new_motion: bool = False) -> None:
        """Show another state."""
        self.state, self._replace = state, None
        with self._server.atomic():
            self._draw()
            if new_motion:
                self._new_motion()
            else:
                update(self._controls.costs, content=result_markdown(state))
                self._show_wishes()

    def _add_obstacle(self, kind: str, client: Any) -> None:
        x, y, _ = (0.0, 0.0, 0.0) if client is None else client.camera.look_at
        place = (round(min(max(float(x), -NEAR), NEAR), 2), round(min(max(float(y), -NEAR), NEAR), 2))
        self.edit(lambda cell: cell.added(kind, place))

    def click(self, name: str, origin: FloatArray, direction: FloatArray) -> None:
        """Place what is to be picked where an obstacle was clicked; or select that, or no longer if it is selected."""
        with self._lock:
            if self._closed.is_set():
                return
            errand = self.state.errand
            if errand is None or errand.support is not None:
                self.edit(lambda cell: cell.select(None if cell.selected == name else name))
                return
            hit = Surfaces(self.state.cell.scene).met_by(origin, direction)
            try:
                state = self.state if hit is None else self.state.placing(hit)
            except PlannerServiceError as error:
                update(self._controls.costs, content=f"**not there**: {markdown_escaped(str(error))}")
                return
            self._apply(state)

    def load(self, name: str, unit: str) -> None:
        """Add the obstacles in a file of the folder; one file at a time."""
        if self._folder is None or not name or self._closed.is_set() or not self._loading.acquire(blocking=False):
            return
        try:
            self._files.begin()
            obstacles = self._folder.load(name, unit)
            self.edit(lambda cell: cell.with_obstacles(obstacles))
        except PlannerServiceError as error:
            update(self._cell.note, content=f"**not loaded**: {markdown_escaped(str(error))}")
        finally:
            if not self._closed.is_set():
                self._files.end()
            self._loading.release()

    def save(self, name: str) -> None:
        """Write the scene to a file of the folder; one that is there is replaced when it is asked for again."""
        with self._lock:
            if self._closed.is_set():
                return
            folder, scene, again = self._folder, self.state.cell.scene, self._replace == name
            self._replace = None
            if folder is None:
                return
            try:
                path = folder.save(scene, name, replace=again)
            except PlannerServiceError as error:
                update(self._cell.note, content=f"**not saved**: {markdown_escaped(str(error))}")
                return
            if path is None:
                self._replace = name
                text = f"{markdown_escaped(name)} is there already: press **save** again to replace it"
            else:
                text = f"**saved** as {markdown_escaped(path.name)}, and read again: the same scene"
                self._files.list_files()
            update(self._cell.note, content=text)

    # The next plan

    def pick(self) -> None:
        """Pick what is selected with the next plan; or nothing, if something is to be picked."""
        with self._lock:
            if self._closed.is_set():
                return
            state, selected = self.state, self.state.cell.selected
            if state.errand is not None:
                self._apply(replace(state, errand=None))
            elif selected is not None:
                self._apply(state.with_cell(state.cell.select(None)).picking(selected))

    def set_waypoint(self, add: bool) -> None:
        """Add the configuration shown to the waypoints, or remove them all."""
        self._wish(lambda state: state.with_waypoint() if add else replace(state, waypoints=()))

    def constrain(self, kind: str | None, number: float) -> None:
        """Add one of ``CONSTRAINTS`` to what the next plan keeps; None to remove all."""

        def change(state: ViewState) -> ViewState:
            if kind is None:
                return state.with_constraints(())
            return state.with_constraints((*state.keeping, CONSTRAINTS[kind].of(state.tool_of_start, number)))

        self._wish(change)

    def _suggested(self, kind: str) -> float:
        return CONSTRAINTS[kind].default(self.state.tool_of_start)

    def _wish(self, change: Callable[[ViewState], ViewState]) -> None:
        """Change what the next plan does, or say why it cannot."""
        with self._lock:
            if self._closed.is_set():
                return
            try:
                state = change(self.state)
            except PlannerServiceError as error:
                update(self._controls.costs, content=f"**not done**: {markdown_escaped(str(error))}")
                return
            self._apply(state)

    def _set_end(self, end: str) -> None:
        self._apply(self.state.with_start() if end == ENDS[0] else self.state.with_goal())

    def aim(self, pose: Pose, *, released: bool) -> None:
        """Drag the tool of the goal to a pose in the base frame; when released, the handles go back to the tool."""
        with self._lock:
            if self._closed.is_set():
                return
            self.state = self.state.aimed(pose)
            self._show_wishes()
            if released:
                self.state = self.state.released()
                self._show_wishes()
            self._draw()

    def _move_joint(self, joint: int) -> None:
        self.pause()
        q = self.state.q.copy()
        q[joint] = self._joints[joint].value
        self.state = self.state.posed(q)
        self._draw()

    def pose(self, q: FloatArray) -> None:
        """Move the robot and the sliders to q (n,)."""
        with self._lock:
            self.pause()
            self.state = self.state.posed(q)
            self._draw()
            self._move_sliders()

    def _go_to_named_pose(self, name: str) -> None:
        if name:
            self.pose(self.state.service.robot.pose(name))

    def _move_sliders(self) -> None:
        for joint, value in zip(self._joints, self.state.service.robot.unwound(self.state.q).tolist(), strict=True):
            joint.value = min(max(round(value / STEP) * STEP, joint.min), joint.max)

    # The clock

    def scrub(self, seconds: float) -> None:
        """Show the robot at a time on the playback's clock, as the time slider does."""
        with self._lock:
            if self._closed.is_set():
                return
            self.state = self.state.at(seconds)
            self._draw()
            self._time.value = round(self.state.seconds or 0.0, 2)
            self._timeline.mark(self.state.seconds)
            if not self._playing.is_set():
                self._move_sliders()
                self._plots.mark(seconds)

    def play(self) -> None:
        """Play from the current time; from the beginning if it is at the end."""
        with self._lock:
            if self.state.playback is None or self._playing.is_set():
                return
            if self.state.seconds is None or self.state.seconds >= self.state.playback.duration:
                self.scrub(0.0)
            self._playing.set()
            self._play.label = "pause"
            threading.Thread(target=self._run, name="planner-service view: clock", daemon=True).start()

    def pause(self) -> None:
        """Stop playing."""
        with self._lock:
            if self._playing.is_set():
                self._playing.clear()
                self._play.label = "play"
                self._move_sliders()
                self._plots.mark(self.state.seconds or 0.0)

    def _run(self) -> None:
        before = time.monotonic()
        while self._playing.is_set() and not self._closed.is_set():
            time.sleep(1.0 / FRAMES)
            with self._lock:
                state, now = self.state, time.monotonic()
                if not self._playing.is_set() or state.playback is None or state.seconds is None:
                    return
                seconds = min(state.seconds + (now - before) * float(self._speed.value), state.playback.duration)
                before = now
                self.scrub(seconds)
                if seconds >= state.playback.duration:
                    self.pause()

    def plan(self, choice: Choice) -> None:
        """Plan what is asked for and show the result; if a plan is under way, cancel it instead."""
        with self._lock:
            if self._planning is not None:
                self._planning.cancel()
                return
            self.pause()
            token = self._planning = CancelToken()
            before = state = self.state
            self._controls.begin()
        try:
            task = state.errand is not None and state.errand.support is not None
            state = state.performed(choice, token) if task else state.planned(choice, token)
            error_text = ""
        except PlannerServiceError as error:
            error_text = f"**no plan**: {markdown_escaped(str(error))}"
        except BaseException:  # our own bug: its traceback goes to the terminal, and the button can be used again
            with self._lock:
                self._planning, self._controls.costs.content = None, "**no plan**: internal error"
                self._controls.end()
                self._show_wishes()
            raise
        with self._lock:
            self._planning = None
            if self._closed.is_set():
                return
            self._controls.end()
            if self.state.cell.scene is not before.cell.scene:
                error_text = "**no plan**: the cell was changed meanwhile"
            else:
                self.state = replace(state, cell=self.state.cell)  # whatever is selected by now
            self._draw()
            self._new_motion()
            self._move_sliders()
            if error_text:
                self._controls.costs.content = error_text

    def close(self) -> None:
        """Stop playing and planning, and finish what is being drawn."""
        self._closed.set()
        with self._lock:
            pass
        self._playing.clear()
        planning = self._planning
        if planning is not None:
            planning.cancel()


def _pairs(contacts: Any) -> list[tuple[str, str]]:
    return [(contact.a, contact.b) for contact in contacts]

"""The page in the browser: draws a ``ViewState`` and changes it as the user moves sliders and presses buttons."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from planner_service.collision import CancelToken
from planner_service.errors import PlannerServiceError
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.presentation.tables import markdown_escaped
from planner_service.records.plan_file import SavedTask
from planner_service.view import lines
from planner_service.view.goal_handles import GoalHandles
from planner_service.view.looks import BOTH, CHECKED, WAYS, LookNodes
from planner_service.view.markdown import report_markdown, result_markdown, state_markdown
from planner_service.view.planning_controls import PlanningControls
from planner_service.view.plots import Plots
from planner_service.view.scene_nodes import RegionNodes, RobotNodes, SceneNodes, colours_of
from planner_service.view.state import Choice, ViewState
from planner_service.view.still.composition import GOAL, TOOL_PATH, TOUCHING
from planner_service.view.triangles import GROUND, placements, robot_solids, scene_solids

__all__ = ["Page"]

FRAMES = 30.0
"""Per second while playing."""

PLOT_SECONDS = 0.25
"""Between two updates of the time mark in the plots while playing."""

ARROW = 0.15
"""Length of the arrows of constraints, and of the handles of the goal, as a share of the size of robot and scene."""

OVERLAY = 0.35
"""Opacity of the shapes that are checked, drawn over what the robot looks like."""

STEP = 0.001
"""Step of a joint's slider, in rad or m."""

START = (120, 135, 160)
GRAPH, SEARCHED, SHORTCUT = (150, 160, 175), (230, 140, 40), (160, 80, 190)
LAYERS = ("tree or roadmap (grey)", "path as searched (orange)", "path cut short (purple)", "path of the plan (blue)")
ENDS = ("start", "goal")
CONTACT_ANCHORS = ("bottom-left", "top-left", "bottom-right", "top-right")

Lines = dict[str, tuple[FloatArray, tuple[int, int, int], float]]


class Page:
    """A ``ViewState`` drawn on viser's server, with its controls.

    Args:
        server: A new ``viser.ViserServer``.
        state: What to show first.
    """

    def __init__(self, server: Any, state: ViewState) -> None:
        self._server = server
        self._lock = threading.RLock()
        self._playing = threading.Event()
        self._closed = threading.Event()
        self._planning: CancelToken | None = None
        self._layers: dict[str, Any] = {}
        self._contacts: list[Any] = []
        self.state = state
        with server.atomic():
            self._set_up()
            self._draw_scene()
            self._add_controls()
            self._new_motion()
            self._draw()
            self._move_sliders()

    def _set_up(self) -> None:
        gui = self._server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        scene = self._server.scene
        scene.configure_environment_map(None)  # the default is fetched from another server
        scene.configure_default_lights(True, cast_shadow=False)
        scene.add_light_hemisphere("/light", sky_color=(255, 255, 255), ground_color=(170, 170, 175), intensity=2.6)
        middle, size = _extent(self.state)
        camera = self._server.initial_camera
        camera.up, camera.fov = (0.0, 0.0, 1.0), 0.75
        camera.position = tuple(middle + size * np.array([1.1, -1.0, 0.7]))
        camera.look_at = tuple(middle)

    def _draw_scene(self) -> None:
        state, scene = self.state, self._server.scene
        robot = state.service.robot
        self._robot = RobotNodes(scene, "/robot", robot)
        self._start = RobotNodes(scene, "/start", robot, ghost=START)
        self._goal = RobotNodes(scene, "/goal", robot, ghost=GOAL.colour)
        self._looks = LookNodes(scene, "/looks")
        self._scene_nodes = SceneNodes(scene, self._robot.tool)
        size = ARROW * _extent(state)[1]
        self._regions = RegionNodes(scene, "/constraints", size)
        self._handles = GoalHandles(scene, size, lambda pose, released: self.aim(pose, released=released))

    def _draw(self) -> None:
        """Draw everything that depends on the configuration."""
        state = self.state
        report = state.report
        robot, colliding, expected = state.service.robot, _pairs(report.contacts), _pairs(report.expected)
        with self._server.atomic():
            self._robot.set_robot(robot)
            self._robot.move(state.q)
            self._looks.move(robot, state.q)
            self._scene_nodes.show(state.service.scene)
            self._regions.show(state.kept, state.q)
            self._set(self._show_regions, "visible", self._regions.any)
            self._draw_ghost(self._start, state.start, hidden_by=[state.q])
            aimed = state.aim is not None
            self._draw_ghost(self._goal, state.goal, hidden_by=[] if aimed else [state.q, state.start])
            self._handles.show(state.tool_of_goal, visible=self._show_handles.value)
            colours = colours_of(colliding, expected, robot)
            self._robot.paint(colours)
            self._scene_nodes.paint(colours)
            self._scene_nodes.label(self._show_names.value and report.free)
            self._draw_contacts([(pair, point) for pair, point in report.points if pair in colliding])
            self._set(self._status, "content", report_markdown(report))
            self._set(self._clock, "content", state_markdown(state))

    def _judge_goal(self) -> None:
        """Say what is known against the goal, and paint it red."""
        objection = self.state.goal_objection
        self._goal.tint(TOUCHING if objection else None)
        text = f"**goal**: {markdown_escaped(objection)}" if objection else ""
        self._controls.say(objection=text, savable=self.state.saved is not None)

    def _draw_ghost(self, ghost: RobotNodes, q: FloatArray, *, hidden_by: list[FloatArray]) -> None:
        """Draw a ghost, unless another robot is drawn at the same configuration."""
        hidden = any(np.allclose(q, other, rtol=0.0, atol=1e-6) for other in hidden_by)
        self._set(ghost.root, "visible", self._show_ends.value and not hidden)
        if ghost.root.visible:
            ghost.set_robot(self.state.service.robot)
            ghost.move(q)

    def _draw_contacts(self, contacts: list[tuple[tuple[str, str], tuple[float, float, float]]]) -> None:
        for node in self._contacts:
            node.remove()
        self._contacts = []
        scene = self._server.scene
        for k, ((a, b), position) in enumerate(contacts):
            point = scene.add_icosphere(f"/contact/{k}", radius=0.008, color=(255, 230, 0), position=position)
            anchor = CONTACT_ANCHORS[k % len(CONTACT_ANCHORS)]
            scene.add_label(f"{point.name}/names", f"{a} × {b}", anchor=anchor, font_screen_scale=0.9)
            self._contacts.append(point)

    @staticmethod
    def _set(handle: Any, name: str, value: Any) -> None:
        if getattr(handle, name) != value:
            setattr(handle, name, value)

    def _draw_layers(self) -> None:
        """Draw the tool's paths and the search tree or roadmap."""
        for node in self._layers.values():
            node.remove()
        self._layers = {}
        layers = _lines_of(self.state)
        for k, name in enumerate(LAYERS):
            self._set(self._show_layers[name], "visible", name in layers)
            if name in layers:
                points, colour, thickness = layers[name]
                self._layers[name] = self._server.scene.add_line_segments(
                    f"/lines/{k}", points.astype(np.float32), colour, thickness=thickness,
                    visible=self._show_layers[name].value,
                )  # fmt: skip

    def _new_motion(self) -> None:
        """Draw everything that depends on what was planned."""
        playback = self.state.playback
        self.pause()
        with self._server.atomic():
            self._time.visible = self._play.visible = self._speed.visible = playback is not None
            if playback is not None:
                self._time.max = max(math.ceil(playback.duration * 100.0) / 100.0, 0.01)
            self._set(self._controls.costs, "content", result_markdown(self.state))
            self._judge_goal()
            self._draw_layers()
            self._plots.show(playback)

    def _add_controls(self) -> None:
        gui = self._server.gui
        self._status = gui.add_markdown("")
        self._clock = gui.add_markdown("")
        self._time = gui.add_slider("time", 0.0, 1.0, 0.01, 0.0)
        self._play = gui.add_button("play")
        self._speed = gui.add_dropdown("speed", ("1", "0.5", "0.2", "0.1"))
        tabs = gui.add_tab_group()
        with tabs.add_tab("robot"):
            self._add_joints()
        with tabs.add_tab("plan"):
            self._controls = PlanningControls(gui, self.plan, self._send_file)
        self._plots = Plots(gui, tabs.add_tab("plots"), self.state.service.robot.joint_names)
        with tabs.add_tab("show"):
            self._add_toggles()
        self._time.on_update(self._on_user_update(lambda: self.scrub(self._time.value)))
        self._play.on_click(lambda _: self.pause() if self._playing.is_set() else self.play())

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

    def _send_file(self, client: Any) -> None:
        """Give the browser what ``save`` would write: the page writes no file itself."""
        with self._lock:
            saved = self.state.saved
        if saved is None or client is None:
            return
        name = "task.json" if isinstance(saved, SavedTask) else "plan.json"
        try:
            client.send_file_download(name, saved.file_text().encode("ascii"), save_immediately=True)
        except PlannerServiceError as error:
            self._controls.costs.content = f"**not saved**: {markdown_escaped(str(error))}"

    def _add_toggles(self) -> None:
        gui = self._server.gui
        self._way = gui.add_dropdown("robot", WAYS, hint="what a robot looks like may extend beyond what is checked")
        self._missing = gui.add_markdown("")
        self._way.on_update(self._on_user_update(lambda: self.draw_robot(self._way.value)))
        self._show_ends = gui.add_checkbox("start (grey) and goal (green)", True)
        self._show_ends.on_update(self._on_user_update(self._draw))
        self._show_handles = gui.add_checkbox("handles to drag the goal", True)
        self._show_handles.on_update(self._on_user_update(self._draw))
        self._show_names = gui.add_checkbox("names of obstacles", True, hint="hidden while contacts are named")
        self._show_names.on_update(self._on_user_update(self._draw))
        self._show_regions = gui.add_checkbox("constraints (teal)", True, visible=False)
        self._show_regions.on_update(self._on_user_update(self._show_chosen_regions))
        self._show_layers = {name: gui.add_checkbox(name, True) for name in LAYERS}
        for box in self._show_layers.values():
            box.on_update(self._on_user_update(self._show_chosen_layers))

    def draw_robot(self, way: str) -> None:
        """Draw the shapes that are checked, what the robot looks like, or both; ``WAYS`` are the words."""
        with self._lock, self._server.atomic():
            self._looks.show(self.state.service.robot, visible=way != CHECKED)
            shown = self._looks.any and way != CHECKED
            self._robot.fade((OVERLAY if way == BOTH else 0.0) if shown else 1.0)
            self._set(self._missing, "content", self._looks.note if way != CHECKED else "")
            self._looks.move(self.state.service.robot, self.state.q)

    def _show_chosen_regions(self) -> None:
        self._regions.root.visible = self._show_regions.value

    def _show_chosen_layers(self) -> None:
        for name, node in self._layers.items():
            node.visible = self._show_layers[name].value

    def _on_user_update(self, act: Callable[[], Any]) -> Callable[[Any], None]:
        """A handler that acts only when the user moved the control, not when the page did; one event at a time."""

        def handle(event: Any) -> None:
            if event.client is not None:
                with self._lock:
                    act()

        return handle

    def _on_press(self, act: Callable[[str], None]) -> Callable[[Any], None]:
        """A handler for a group of buttons; one event at a time."""

        def handle(event: Any) -> None:
            with self._lock:
                act(event.target.value)

        return handle

    def _set_end(self, end: str) -> None:
        self.state = self.state.with_start() if end == ENDS[0] else self.state.with_goal()
        self._draw()
        self._judge_goal()

    def aim(self, pose: Pose, *, released: bool) -> None:
        """Drag the tool of the goal to a pose in the base frame; when released, the handles go back to the tool."""
        with self._lock:
            self.state = self.state.aimed(pose)
            self._judge_goal()
            if released:
                self.state = self.state.released()
                self._judge_goal()
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

    def scrub(self, seconds: float) -> None:
        """Show the robot at a time on the playback's clock, as the time slider does."""
        with self._lock:
            self.state = self.state.at(seconds)
            self._draw()
            self._time.value = round(self.state.seconds or 0.0, 2)
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

    def _run(self) -> None:
        marked = before = time.monotonic()
        while self._playing.is_set() and not self._closed.is_set():
            time.sleep(1.0 / FRAMES)
            with self._lock:
                state, now = self.state, time.monotonic()
                if not self._playing.is_set() or state.playback is None or state.seconds is None:
                    return
                seconds = min(state.seconds + (now - before) * float(self._speed.value), state.playback.duration)
                before = now
                self.scrub(seconds)
                if now - marked > PLOT_SECONDS:
                    marked = now
                    self._plots.mark(seconds)
                if seconds >= state.playback.duration:
                    self.pause()
                    self._plots.mark(seconds)

    def plan(self, choice: Choice) -> None:
        """Plan from start to goal and show the result; if a plan is under way, cancel it instead."""
        with self._lock:
            if self._planning is not None:
                self._planning.cancel()
                return
            self.pause()
            token = self._planning = CancelToken()
            state = self.state
            self._controls.begin()
        try:
            state = state.planned(choice, token)
            error_text = ""
        except PlannerServiceError as error:
            error_text = f"**no plan**: {markdown_escaped(str(error))}"
        except BaseException:  # our own bug: its traceback goes to the terminal, and the button can be used again
            with self._lock:
                self._planning, self._controls.costs.content = None, "**no plan**: internal error"
                self._controls.end()
            raise
        with self._lock:
            self._planning = None
            self._controls.end()
            self.state = state
            self._new_motion()
            self._draw()
            self._move_sliders()
            if error_text:
                self._controls.costs.content = error_text

    def close(self) -> None:
        """Stop playing and planning."""
        self._closed.set()
        self._playing.clear()
        planning = self._planning
        if planning is not None:
            planning.cancel()


def _pairs(contacts: Any) -> list[tuple[str, str]]:
    return [(contact.a, contact.b) for contact in contacts]


def _lines_of(state: ViewState) -> Lines:
    """The lines of each layer that has any, with their colour and thickness."""
    layers: Lines = {}
    robot = state.service.robot
    for segment in state.results:
        result, trace = segment.result, segment.result.trace
        if trace is None:
            continue
        graph = trace.graph
        if graph is None and result.roadmap is not None:
            graph = lines.free_graph(result.roadmap)
        if graph is not None and len(graph.edges):
            layers[LAYERS[0]] = lines.graph_lines(robot, graph), GRAPH, 0.001
        if trace.searched is not None:
            layers[LAYERS[1]] = lines.polyline_lines(robot, trace.searched), SEARCHED, 0.0025
        if trace.shortcut is not None:
            layers[LAYERS[2]] = lines.polyline_lines(robot, trace.shortcut), SHORTCUT, 0.003
    paths = [segment.result.path for segment in state.results if segment.result.path is not None]
    if paths:
        curves = np.concatenate([lines.curve_lines(robot, path) for path in paths])
        layers[LAYERS[3]] = curves, TOOL_PATH, 0.005
    return layers


def _extent(state: ViewState) -> tuple[FloatArray, float]:
    """The centre of robot and obstacles, the ground left out, and their size (the diagonal), in metres."""
    robot = state.service.robot
    frames = placements(robot, state.q)
    corners = [
        solid.vertices @ frames[solid.frame][:3, :3].T + frames[solid.frame][:3, 3]
        for solid in robot_solids(robot)
        if solid.frame is not None
    ]
    standing = [solid for solid in scene_solids(state.service.scene) if solid.frame is None]
    corners += [solid.vertices for solid in standing if solid.colour != GROUND]
    low = np.min([points.min(axis=0) for points in corners], axis=0)
    high = np.max([points.max(axis=0) for points in corners], axis=0)
    return np.asarray((low + high) / 2.0), max(float(np.sqrt(((high - low) ** 2).sum())), 0.3)

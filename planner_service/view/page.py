"""The page in the browser: what of a ``ViewState`` is drawn where, and what a user may do to it."""

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
from planner_service.geometry.shapes import FloatArray
from planner_service.planners import PLANNERS
from planner_service.view import lines
from planner_service.view.markdown import look_words, plain, result_words, state_words
from planner_service.view.plots import Plots
from planner_service.view.scene_nodes import Figure, Props, colours_of
from planner_service.view.state import ViewState
from planner_service.view.still.composition import GOAL, TOOL_PATH
from planner_service.view.triangles import GROUND, placements, robot_solids, scene_solids

__all__ = ["Page"]

FRAMES = 30.0
"""Per second of playing."""

PLOT_SECONDS = 0.25
"""Between two looks of the plots at the clock while it runs."""

STEP = 0.001
"""Of a joint's slider, in rad or m."""

START = (120, 135, 160)
GRAPH, SEARCHED, SHORTCUT = (150, 160, 175), (230, 140, 40), (160, 80, 190)
LAYERS = ("tree or roadmap (grey)", "path as searched (orange)", "path cut short (purple)", "path of the plan (blue)")
ENDS = ("start", "goal")
CONTACT_ANCHORS = ("bottom-left", "top-left", "bottom-right", "top-right")

Lines = dict[str, tuple[FloatArray, tuple[int, int, int], float]]


class Page:
    """A state on viser's server, and what moves it.

    Args:
        server: A ``viser.ViserServer``, not yet looked at.
        state: What is to be seen first.
    """

    def __init__(self, server: Any, state: ViewState) -> None:
        self._server = server
        self._lock = threading.RLock()
        self._playing = threading.Event()
        self._closed = threading.Event()
        self._planning: CancelToken | None = None
        self._layers: dict[str, Any] = {}
        self._places: list[Any] = []
        self.state = state
        with server.atomic():
            self._set_up()
            self._draw_scene()
            self._add_controls()
            self._new_motion()
            self._draw()
            self._move_sliders()

    # What is drawn.

    def _set_up(self) -> None:
        gui = self._server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        scene = self._server.scene
        scene.configure_environment_map(None)  # else the page asks another server for a picture to be lit by
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
        self._figure = Figure(scene, "/robot", robot)
        self._start = Figure(scene, "/start", robot, ghost=START)
        self._goal = Figure(scene, "/goal", robot, ghost=GOAL.colour)
        self._props = Props(scene, self._figure.tool)

    def _draw(self) -> None:
        """Everything that follows from where the robot stands."""
        state = self.state
        look = state.look
        robot, bad, meant = state.service.robot, _pairs(look.contacts), _pairs(look.meant)
        with self._server.atomic():
            self._figure.wear(robot)
            self._figure.stand(state.q)
            self._props.show(state.service.scene)
            self._ghost(self._start, state.start, hidden_by=[state.q])
            self._ghost(self._goal, state.goal, hidden_by=[state.q, state.start])
            colours = colours_of(bad, meant, robot)
            self._figure.paint(colours)
            self._props.paint(colours)
            self._props.label(self._show_names.value and look.free)
            self._draw_places([(pair, place) for pair, place in look.places if pair in bad])
            self._set(self._status, "content", look_words(look))
            self._set(self._clock, "content", state_words(state))

    def _ghost(self, figure: Figure, q: FloatArray, *, hidden_by: list[FloatArray]) -> None:
        """A ghost, unless what stands there is drawn already."""
        there = any(np.allclose(q, other, rtol=0.0, atol=1e-6) for other in hidden_by)
        figure.visible = self._show_ends.value and not there
        if figure.visible:
            figure.wear(self.state.service.robot)
            figure.stand(q)

    def _draw_places(self, places: list[tuple[tuple[str, str], tuple[float, float, float]]]) -> None:
        for node in self._places:
            node.remove()
        self._places = []
        scene = self._server.scene
        for k, ((a, b), place) in enumerate(places):
            point = scene.add_icosphere(f"/contact/{k}", radius=0.008, color=(255, 230, 0), position=place)
            anchor = CONTACT_ANCHORS[k % len(CONTACT_ANCHORS)]
            scene.add_label(f"{point.name}/names", f"{a} × {b}", anchor=anchor, font_screen_scale=0.9)
            self._places.append(point)

    @staticmethod
    def _set(handle: Any, name: str, value: Any) -> None:
        if getattr(handle, name) != value:
            setattr(handle, name, value)

    def _draw_layers(self) -> None:
        """The paths of the tool, and what the search grew."""
        for node in self._layers.values():
            node.remove()
        self._layers = {}
        shown = _lines_of(self.state)
        for k, name in enumerate(LAYERS):
            self._set(self._show_layers[name], "visible", name in shown)
            if name in shown:
                points, colour, thickness = shown[name]
                self._layers[name] = self._server.scene.add_line_segments(
                    f"/lines/{k}", points.astype(np.float32), colour, thickness=thickness,
                    visible=self._show_layers[name].value,
                )  # fmt: skip

    def _new_motion(self) -> None:
        """Everything that follows from what was planned."""
        reel = self.state.reel
        self.pause()
        with self._server.atomic():
            self._time.visible = self._play.visible = self._speed.visible = reel is not None
            if reel is not None:
                self._time.max = max(math.ceil(reel.duration * 100.0) / 100.0, 0.01)
            self._set(self._told, "content", result_words(self.state))
            self._draw_layers()
            self._plots.show(reel)

    # What a user may do.

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
            self._add_planning()
        with tabs.add_tab("plots"):
            self._plots = Plots(gui, self.state.service.robot.joint_names)
        with tabs.add_tab("show"):
            self._add_toggles()
        self._time.on_update(self._by_hand(lambda: self.scrub(self._time.value)))
        self._play.on_click(lambda _: self.pause() if self._playing.is_set() else self.play())

    def _add_joints(self) -> None:
        gui, robot = self._server.gui, self.state.service.robot
        self._joints = []
        for name, low, high in zip(robot.joint_names, robot.limits.lower, robot.limits.upper, strict=True):
            ends = math.ceil(low / STEP) * STEP, math.floor(high / STEP) * STEP
            self._joints.append(gui.add_slider(name, *(round(end, 3) for end in ends), STEP, round(ends[0], 3)))
        for k, joint in enumerate(self._joints):
            joint.on_update(self._by_hand(partial(self._turn, k)))
        poses = gui.add_dropdown("pose", ("", *robot.poses))
        poses.on_update(self._by_hand(lambda: self._named(poses.value)))
        setting, going = gui.add_button_group("set", ENDS), gui.add_button_group("go to", ENDS)
        setting.on_click(self._pressed(self._set_end))
        going.on_click(self._pressed(lambda end: self.pose(self.state.start if end == ENDS[0] else self.state.goal)))

    def _add_planning(self) -> None:
        gui = self._server.gui
        self._planner = gui.add_dropdown("planner", tuple(PLANNERS), initial_value="rrtconnect")
        self._seed = gui.add_number("seed", 0, min=0, step=1)
        self._plan = gui.add_button("plan")
        self._plan.on_click(lambda _: self.plan(self._planner.value, int(self._seed.value)))
        self._told = gui.add_markdown("")

    def _add_toggles(self) -> None:
        gui = self._server.gui
        self._show_ends = gui.add_checkbox("start (grey) and goal (green)", True)
        self._show_ends.on_update(self._by_hand(self._draw))
        self._show_names = gui.add_checkbox("names of obstacles", True, hint="not while those of contacts are there")
        self._show_names.on_update(self._by_hand(self._draw))
        self._show_layers = {name: gui.add_checkbox(name, True) for name in LAYERS}
        for box in self._show_layers.values():
            box.on_update(self._by_hand(self._show_chosen_layers))

    def _show_chosen_layers(self) -> None:
        for name, node in self._layers.items():
            node.visible = self._show_layers[name].value

    def _by_hand(self, act: Callable[[], Any]) -> Callable[[Any], None]:
        """What to do when a user moves something, and not when the page itself does; one thing at a time."""

        def told(event: Any) -> None:
            if event.client is not None:
                with self._lock:
                    act()

        return told

    def _pressed(self, act: Callable[[str], None]) -> Callable[[Any], None]:
        """What to do when a user presses one of several buttons."""

        def told(event: Any) -> None:
            with self._lock:
                act(event.target.value)

        return told

    def _set_end(self, end: str) -> None:
        self.state = self.state.with_start() if end == ENDS[0] else self.state.with_goal()
        self._draw()

    def _turn(self, joint: int) -> None:
        self.pause()
        q = self.state.q.copy()
        q[joint] = self._joints[joint].value
        self.state = self.state.posed(q)
        self._draw()

    def pose(self, q: FloatArray) -> None:
        """Move the robot to q (n,), sliders included."""
        with self._lock:
            self.pause()
            self.state = self.state.posed(q)
            self._draw()
            self._move_sliders()

    def _named(self, name: str) -> None:
        if name:
            self.pose(self.state.service.robot.pose(name))

    def _move_sliders(self) -> None:
        for joint, value in zip(self._joints, self.state.q.tolist(), strict=True):
            joint.value = min(max(round(value / STEP) * STEP, joint.min), joint.max)

    def scrub(self, seconds: float) -> None:
        """Show the robot where it is after so many seconds, as when the time slider is moved."""
        with self._lock:
            self.state = self.state.at(seconds)
            self._draw()
            self._time.value = round(self.state.seconds or 0.0, 2)
            if not self._playing.is_set():
                self._move_sliders()
                self._plots.mark(seconds)

    def play(self) -> None:
        """Let the clock run, from where it is; from the beginning if it is at the end."""
        with self._lock:
            if self.state.reel is None or self._playing.is_set():
                return
            if self.state.seconds is None or self.state.seconds >= self.state.reel.duration:
                self.scrub(0.0)
            self._playing.set()
            self._play.label = "pause"
            threading.Thread(target=self._run, name="planner-service view: clock", daemon=True).start()

    def pause(self) -> None:
        """Stop the clock."""
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
                if not self._playing.is_set() or state.reel is None or state.seconds is None:
                    return
                seconds = min(state.seconds + (now - before) * float(self._speed.value), state.reel.duration)
                before = now
                self.scrub(seconds)
                if now - marked > PLOT_SECONDS:
                    marked = now
                    self._plots.mark(seconds)
                if seconds >= state.reel.duration:
                    self.pause()
                    self._plots.mark(seconds)

    def plan(self, planner: str, seed: int) -> None:
        """Plan from start to goal and show what comes of it; while that is under way, stop it."""
        with self._lock:
            if self._planning is not None:
                self._planning.cancel()
                return
            self.pause()
            token = self._planning = CancelToken()
            state = self.state
            self._plan.label, self._told.content = "stop", "planning ..."
        try:
            state = state.planned(planner, seed, token)
            trouble = ""
        except PlannerServiceError as error:
            trouble = f"**no plan**: {plain(str(error))}"
        except BaseException:  # a fault of the planner's: it is told in the terminal, and the button stays one
            with self._lock:
                self._planning, self._plan.label, self._told.content = None, "plan", "**no plan**: a fault"
            raise
        with self._lock:
            self._planning, self._plan.label = None, "plan"
            self.state = state
            self._new_motion()
            self._draw()
            self._move_sliders()
            if trouble:
                self._told.content = trouble

    def close(self) -> None:
        """Stop what runs by itself."""
        self._closed.set()
        self._playing.clear()
        planning = self._planning
        if planning is not None:
            planning.cancel()


def _pairs(contacts: Any) -> list[tuple[str, str]]:
    return [(contact.a, contact.b) for contact in contacts]


def _lines_of(state: ViewState) -> Lines:
    """The lines that there are, by layer: with their colours, and how thick they are."""
    found: Lines = {}
    robot = state.service.robot
    for segment in state.results:
        result, trace = segment.result, segment.result.trace
        if trace is None:
            continue
        graph = trace.graph
        if graph is None and result.roadmap is not None:
            graph = lines.free_graph(result.roadmap)
        if graph is not None and len(graph.edges):
            found[LAYERS[0]] = lines.graph_lines(robot, graph), GRAPH, 0.001
        if trace.searched is not None:
            found[LAYERS[1]] = lines.polyline_lines(robot, trace.searched), SEARCHED, 0.0025
        if trace.shortcut is not None:
            found[LAYERS[2]] = lines.polyline_lines(robot, trace.shortcut), SHORTCUT, 0.003
    paths = [segment.result.path for segment in state.results if segment.result.path is not None]
    if paths:
        curves = np.concatenate([lines.curve_lines(robot, path) for path in paths])
        found[LAYERS[3]] = curves, TOOL_PATH, 0.005
    return found


def _extent(state: ViewState) -> tuple[FloatArray, float]:
    """The middle of what is to be seen, wide ground apart, and how far a camera should stand from it, in metres."""
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

"""The page of a gate: the arm as it is measured, the tube of what has passed, its stop, and what was refused last."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from planner_service.gate import ActionGate, Decision, Refused
from planner_service.presentation.tables import markdown_escaped
from planner_service.scene.names import Owner, owner_of
from planner_service.view.cell.edits import Cell
from planner_service.view.gate.margin_plot import MarginPlot
from planner_service.view.gate.tube import WIDEST, Part, Tube, margin_of, tube_of
from planner_service.view.layout import fit_window, set_up
from planner_service.view.nodes.meshes import add_mesh
from planner_service.view.nodes.robot_nodes import RobotNodes
from planner_service.view.nodes.scene_nodes import SceneNodes
from planner_service.view.state import ViewState
from planner_service.view.still.composition import GOAL, TOUCHING
from planner_service.view.triangles import Colour
from planner_service.view.updates import update

__all__ = ["GatePage"]

FRAMES = 8.0
"""A second: each takes some milliseconds of the lock that the gate's own thread needs, too."""

SHOWN = 3.0
"""Seconds for which a refusal is drawn after the last of its kind."""

PASSING: Colour = (40, 110, 220)
OPACITY, MIN_OPACITY = 0.4, 0.05
"""Of the tube, shared among the places at which the arm is drawn in it."""

WAITING = "no check yet"


class GatePage:
    """What a gate decides, drawn on viser's server while it does.

    The gate's own thread is asked for nothing: what it decided last is looked at.

    Args:
        server: A new ``viser.ViserServer``.
        gate: Of the arm.

    Attributes:
        shown: The decision that is drawn; None before the first.
        refusal: The last refusal that was seen; None likewise.
        margin: Of the decision that is drawn, in metres; 0 if it is not proven.
    """

    def __init__(self, server: Any, gate: ActionGate) -> None:
        self._server, self._gate = server, gate
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self.shown: Decision | None = None
        self.refusal: Refused | None = None
        self.margin = 0.0
        self._seen = -SHOWN
        self._tube: dict[str, Any] = {}
        service = gate.service
        state = ViewState.of(service)
        with server.atomic():
            set_up(server, state)
            scene, robot = server.scene, service.robot
            self._robot = RobotNodes(scene, "/robot", robot)
            self._rest = RobotNodes(scene, "/rest", robot, ghost=GOAL.colour)
            self._refused = RobotNodes(scene, "/refused", robot, ghost=TOUCHING)
            self._scene_nodes = SceneNodes(scene, self._robot.tool, lambda *_: None)
            self._scene_nodes.show(service.scene, Cell(service.scene))
            self._robot.move(state.q)
            for ghost in (self._rest, self._refused):
                ghost.root.visible = False
            self._add_controls()
        server.on_client_connect(lambda client: fit_window(client, state))
        self._thread = threading.Thread(target=self._run, name="planner-service view: gate", daemon=True)
        self._thread.start()

    def _add_controls(self) -> None:
        gui = self._server.gui
        self._status = gui.add_markdown(WAITING)
        self._plot = MarginPlot(gui)
        self._said = gui.add_markdown("")
        self._show_tube = gui.add_checkbox("tube (blue, green)", True)
        self._show_rest = gui.add_checkbox("comes to rest (green)", True)
        self._show_refused = gui.add_checkbox("last refusal (red)", True)

    def _run(self) -> None:
        while not self._closed.wait(1.0 / FRAMES):
            self.draw()

    def draw(self) -> None:
        """Draw what the gate decided last."""
        with self._lock:
            decision, now = self._gate.decision, time.monotonic()
            if self._closed.is_set():
                return
            if decision is not None and decision is not self.shown:
                self._take(decision, now)
            self.shown = decision
            with self._server.atomic():
                if decision is None:
                    update(self._status, content=WAITING)
                self._show_refusal(now)
                for node in self._tube.values():
                    update(node, visible=self._show_tube.value and decision is not None)
                update(self._rest.root, visible=self._show_rest.value and decision is not None)

    def _take(self, decision: Decision, now: float) -> None:
        """Draw a decision that is new."""
        verdict, self.margin = decision.verdict, margin_of(decision)
        if verdict.refused is not None:
            self.refusal, self._seen = verdict.refused, now
        self._plot.add(now, self.margin, refused=verdict.refused is not None)
        tube = tube_of(decision)
        scene = decision.certifier.scene
        with self._server.atomic():
            if decision.q is not None and np.isfinite(decision.q).all():
                self._robot.move(decision.q)
            self._scene_nodes.show(scene, Cell(scene))
            self._rest.move(verdict.rows[-1])
            self._draw_tube(tube, proven=verdict.proven)
            self._plot.draw()
            update(self._status, content=status_markdown(decision, self.margin))
            update(self._said, content=self._counted())

    def _draw_tube(self, tube: Tube, *, proven: bool) -> None:
        colours = (PASSING, GOAL.colour) if proven else (TOUCHING, TOUCHING)
        for name, part, colour in zip(Tube._fields, tube, colours, strict=True):
            self._draw_part(name, part, colour)

    def _draw_part(self, name: str, part: Part, colour: Colour) -> None:
        """A node is used again as long as it has as many triangles."""
        node, (vertices, faces) = self._tube.get(name), part.triangles
        if node is not None and (len(node.vertices), len(node.faces)) == (len(vertices), len(faces)):
            node.vertices = vertices.astype(np.float32)
            update(node, color=colour)
            return
        if node is not None:
            node.remove()
            del self._tube[name]
        if part.places:
            opacity = max(OPACITY / part.places, MIN_OPACITY)
            self._tube[name] = add_mesh(self._server.scene, f"/tube/{name}", part.triangles, colour, opacity)

    def _show_refusal(self, now: float) -> None:
        refused, colours = self.refusal, dict[Owner, Colour]()
        if refused is not None and refused.at and now - self._seen < SHOWN and self._show_refused.value:
            colours = {owner_of(name, self._gate.robot): TOUCHING for name in refused.pair or ()}
            self._refused.move(np.array(refused.at))
        update(self._refused.root, visible=bool(colours))
        self._scene_nodes.paint(colours)

    def _counted(self) -> str:
        counts = self._gate.counts
        kinds = ", ".join(f"{count} {kind}" for kind, count in counts.refused.items()) or "none"
        lines = [f"{counts.chunks:,} chunks, {counts.accepted:,} targets passed", f"refused: {kinds}"]
        if counts.slowed or counts.repaired:
            lines.append(f"{counts.slowed:,} slowed down, {counts.repaired:,} repaired")
        if self.refusal is not None:
            told = f"{self.refusal.kind.value}: {self.refusal.detail}"
            lines.insert(0, f"**last refusal**: {markdown_escaped(told)}")
        return "\n\n".join(lines)

    def close(self) -> None:
        """Draw no more."""
        self._closed.set()
        self._thread.join(timeout=5.0)


def status_markdown(decision: Decision, margin: float) -> str:
    """What a decision is, and the margin of its tube."""
    verdict = decision.verdict
    if not verdict.proven:
        return "**told to stay, without a proof**"
    slower = f" at {verdict.speed:.2f} of the speed" if verdict.speed < 1.0 else ""
    counted = f"{verdict.accepted} target{'' if verdict.accepted == 1 else 's'}{slower}"
    passing = f"**passes**: {counted}, then" if verdict.accepted else "**brakes**:"
    room = f"more than {1000.0 * WIDEST:.0f}" if margin >= WIDEST else f"{1000.0 * margin:.1f}"
    return f"{passing} {len(verdict.stop)} that brake\n\n**margin of the tube**: {room} mm"

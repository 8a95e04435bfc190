"""The controls with which a plan is asked for on the page, what is known against its goal, and what it cost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from planner_service.planners import PLANNERS
from planner_service.timing.laws import TIMINGS
from planner_service.view.state import Choice

__all__ = ["PlanningControls"]


class PlanningControls:
    """How to plan, a button that plans or stops, one that saves, and texts.

    Args:
        gui: viser's controls.
        plan: Called with what was chosen; while it plans, it is called to stop.
        save: Called with the client that is to get the file.

    Attributes:
        costs: The text about what was planned.
    """

    def __init__(self, gui: Any, plan: Callable[[Choice], None], save: Callable[[Any], None]) -> None:
        default = Choice()
        self._planner = gui.add_dropdown("planner", tuple(PLANNERS), initial_value=default.planner)
        self._seed = gui.add_number("seed", default.seed, min=0, step=1)
        self._timing = gui.add_dropdown("timing law", tuple(TIMINGS), initial_value=default.timing)
        self._velocity = gui.add_slider("velocity (share)", 0.05, 1.0, 0.05, 1.0, hint="of the robot's limits")
        self._acceleration = gui.add_slider("acceleration (share)", 0.05, 1.0, 0.05, 1.0, hint="of its limits")
        self._objection = gui.add_markdown("")
        self._plan = gui.add_button("plan")
        self._plan.on_click(lambda _: plan(self.choice))
        self._save = gui.add_button("save plan", visible=False)
        self._save.on_click(lambda event: save(event.client))
        self.costs = gui.add_markdown("")

    @property
    def choice(self) -> Choice:
        """What is chosen now."""
        scales = float(self._velocity.value), float(self._acceleration.value)
        return Choice(self._planner.value, self._timing.value, int(self._seed.value), *scales)

    def begin(self) -> None:
        """A plan is being made."""
        self._plan.label, self.costs.content = "stop", "planning ..."

    def end(self) -> None:
        """It was made, or not."""
        self._plan.label = "plan"

    def say(self, *, objection: str, savable: bool) -> None:
        """What is known against the goal, as Markdown, and whether there is something to save."""
        if self._objection.content != objection:
            self._objection.content = objection
        if self._save.visible != savable:
            self._save.visible = savable

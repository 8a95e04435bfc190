"""The controls with which a plan is asked for on the page, what is known against its goal, and what it cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from planner_service.constraints.values import constraint_names
from planner_service.planners import PLANNERS
from planner_service.presentation.tables import markdown_escaped
from planner_service.timing.laws import TIMINGS
from planner_service.view.constraint_choices import CONSTRAINTS
from planner_service.view.state import Choice, ViewState
from planner_service.view.updates import update

__all__ = ["PlanningActs", "PlanningControls"]

PICK, NO_PICK = "pick selected", "do not pick"


@dataclass(frozen=True)
class PlanningActs:
    """What the controls call.

    Attributes:
        plan: With what was chosen; while it plans, to stop.
        save: With the client that is to get the file.
        waypoint: To add the configuration shown, or with False to remove all waypoints.
        constrain: With one of ``CONSTRAINTS`` and its number, or with None to remove all constraints.
        suggest: With one of ``CONSTRAINTS``, for its number.
        pick: To pick what is selected, or not to pick anything.
    """

    plan: Callable[[Choice], None]
    save: Callable[[Any], None]
    waypoint: Callable[[bool], None]
    constrain: Callable[[str | None, float], None]
    suggest: Callable[[str], float]
    pick: Callable[[], None]


class PlanningControls:
    """What to plan and how, a button that plans or stops, one that saves, and texts.

    Args:
        gui: viser's controls.
        acts: What they do.

    Attributes:
        costs: The text about what was planned.
    """

    def __init__(self, gui: Any, acts: PlanningActs) -> None:
        self._acts = acts
        self._objection = gui.add_markdown("")
        self._plan = gui.add_button("plan")
        self._plan.on_click(lambda _: acts.plan(self.choice))
        self._save = gui.add_button("save plan", visible=False)
        self._save.on_click(lambda event: acts.save(event.client))
        self.costs = gui.add_markdown("")
        with gui.add_folder("pick and place"):
            self._errand = gui.add_markdown("")
            self._pick = gui.add_button(PICK)
            self._pick.on_click(lambda _: acts.pick())
        with gui.add_folder("by waypoints", expand_by_default=False):
            self._waypoints = gui.add_markdown("")
            group = gui.add_button_group("waypoint", ("add this", "remove all"))
            group.on_click(lambda event: acts.waypoint(event.target.value == "add this"))
        with gui.add_folder("constraints", expand_by_default=False):
            self._add_constraints(gui)
        with gui.add_folder("settings", expand_by_default=False):
            self._add_settings(gui)
        self._planning = False

    def _add_constraints(self, gui: Any) -> None:
        acts, first = self._acts, next(iter(CONSTRAINTS))
        self._kept = gui.add_markdown("")
        self._kind = gui.add_dropdown("the tool shall", tuple(CONSTRAINTS))
        self._number = gui.add_number("number", acts.suggest(first), step=0.001)
        group = gui.add_button_group("constraint", ("add this", "remove all"))
        self._kind.on_update(lambda event: self._suggest() if event.client is not None else None)
        group.on_click(
            lambda event: acts.constrain(
                self._kind.value if event.target.value == "add this" else None, float(self._number.value)
            )
        )

    def _suggest(self) -> None:
        self._number.value = self._acts.suggest(self._kind.value)

    def _add_settings(self, gui: Any) -> None:
        default = Choice()
        self._planner = gui.add_dropdown("planner", tuple(PLANNERS), initial_value=default.planner)
        self._seed = gui.add_number("seed", default.seed, min=0, step=1)
        self._timing = gui.add_dropdown("timing law", tuple(TIMINGS), initial_value=default.timing)
        self._velocity = gui.add_slider("velocity (share)", 0.05, 1.0, 0.05, 1.0, hint="of the robot's limits")
        self._acceleration = gui.add_slider("acceleration (share)", 0.05, 1.0, 0.05, 1.0, hint="of its limits")

    @property
    def choice(self) -> Choice:
        """What is chosen now."""
        scales = float(self._velocity.value), float(self._acceleration.value)
        return Choice(self._planner.value, self._timing.value, int(self._seed.value), *scales)

    def begin(self) -> None:
        """A plan is being made."""
        self._planning = True
        self._plan.label, self.costs.content = "stop", "planning ..."

    def end(self) -> None:
        """It was made, or not."""
        self._planning = False

    def show(self, state: ViewState, objection: str) -> None:
        """Show what will be planned, and what is known against its goal, as Markdown."""
        errand = state.errand
        pick = "Select an obstacle to pick it and place it elsewhere."
        if errand is not None:
            place = f"place it on {markdown_escaped(errand.support or '')}" if errand.support else "**click its place**"
            pick = f"pick {markdown_escaped(errand.target.name)}, {place}"
        elif state.cell.selected is not None:
            pick = f"selected: {markdown_escaped(state.cell.selected)}"
        stops = len(state.waypoints)
        by = "from start to goal without a stop" if not stops else f"by {stops} waypoint{'s' * (stops > 1)}"
        names = [markdown_escaped(constraint_names([constraint])) for constraint in state.keeping]
        ready = errand is not None and errand.support is not None
        update(self._objection, content="" if ready else objection)
        update(self._errand, content=pick)
        update(self._pick, label=PICK if errand is None else NO_PICK)
        update(self._pick, visible=errand is not None or state.cell.selected is not None)
        update(self._waypoints, content=by)
        update(self._kept, content="\n".join(f"- {name}" for name in names) if names else "none")
        update(self._save, visible=state.saved is not None)
        if not self._planning:
            update(self._plan, label="plan pick and place" if ready else "plan")

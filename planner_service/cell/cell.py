"""A cell: several arms in one scene, each planned alone and on its own clock, proven against each other.

::

    cell = Cell({"left": Arm(robot, Pose((0, 0.25, 0))), "right": Arm(robot, Pose((0, -0.25, 0)))}, "table")
    both = cell.plan({"left": PlanRequest(...), "right": PlanRequest(...)}, delay=0.1)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import NoneType

import numpy as np
from numpy.typing import ArrayLike

from planner_service.cell.arms import Arm, parts_at_places, parts_of
from planner_service.cell.goal_kinds import Anywhere, AtTool, checked_goals
from planner_service.cell.layout import Layout
from planner_service.cell.loads import constraints_of, loaded
from planner_service.cell.planning import plan_arms
from planner_service.cell.relative import plan_goals
from planner_service.cell.result import CellPlan
from planner_service.cell.services import Services
from planner_service.certify import Certifier
from planner_service.collision import CancelToken
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import checked_name, instance, items, number, numbers
from planner_service.planning.request import PlanRequest
from planner_service.robot.model import Robot, joint_vector
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Attached, Scene
from planner_service.service import PlannerService

__all__ = ["Cell"]

MAX_ARMS = 4
"""Of a cell: orders in which they may start are all tried."""

MAX_DELAY = 10.0
"""Seconds; more is a mistake in the unit."""


class Cell:
    """Arms in one scene.

    Args:
        arms: Robots by the names of the arms, each a robot or the name of one, at the cell's origin, or an ``Arm`` with
            its place.
        scene: What stands there, in the cell's frame; what arms hold is not in it, see ``carrying``.

    Attributes:
        robot: All arms as one robot, with joints such as ``left_joint_0`` in the order of the arms.
        scene: The scene.
        layout: What it is made of.

    Raises:
        InvalidRequest: There are not one to four arms, or their names do not keep their parts apart.
    """

    def __init__(self, arms: Mapping[str, Arm | Robot | str], scene: Scene | str | Path) -> None:
        instance("arms", arms, Mapping, "robots by the names of the arms")
        if not 1 <= len(arms) <= MAX_ARMS:
            raise InvalidRequest("arms", len(arms), f"1 to {MAX_ARMS} arms")
        placed = {}
        for name, given in arms.items():
            checked_name("arms", name)
            found = load_robot(given) if isinstance(given, str) else given
            instance(f"arms[{name!r}]", found, (Arm, Robot), "an Arm, a Robot, or the name of one")
            placed[name] = found if isinstance(found, Arm) else Arm(found)
        self._set(Layout(_loaded(scene), placed))

    @classmethod
    def of(
        cls,
        robot: Robot | str,
        groups: Mapping[str, Sequence[str]],
        scene: Scene | str | Path,
        *,
        tools: Mapping[str, str] | None = None,
    ) -> Cell:
        """A cell of one robot with several arms.

        Args:
            groups: The joints of each arm, by its name. A joint of none stays at home.
            tools: The link that is the tool, for arms whose tool is not the robot's.

        Raises:
            InvalidRequest: There are not one to four arms, a joint is in two, or one arm carries another.
            UnknownName: No such joint, link or arm.
        """
        whole = load_robot(robot) if isinstance(robot, str) else instance("robot", robot, Robot, "a Robot")
        instance("groups", groups, Mapping, "names of joints by the names of the arms")
        instance("tools", tools, (Mapping, NoneType), "names of links by the names of the arms, or None")
        if not 1 <= len(groups) <= MAX_ARMS:
            raise InvalidRequest("groups", len(groups), f"1 to {MAX_ARMS} arms")
        for name in groups:
            checked_name("groups", name)
        named = {name: items(f"groups[{name!r}]", joints, str, "names of joints") for name, joints in groups.items()}
        cell = object.__new__(cls)
        cell._set(Layout(_loaded(scene), whole=whole, groups=named, tools=tools or {}))
        return cell

    @classmethod
    def laid_out(cls, layout: Layout) -> Cell:
        """The cell that is made of this.

        Raises:
            InvalidRequest: As ``Cell`` and ``Cell.of``.
            UnknownName: As ``Cell.of``.
        """
        instance("layout", layout, Layout, "a Layout")
        if layout.whole is None:
            cell = cls(layout.arms, layout.scene)
        else:
            cell = cls.of(layout.whole, layout.groups, layout.scene, tools=layout.tools)
        return cell.carrying(layout.carried) if layout.carried else cell

    def carrying(self, carried: Mapping[str, Sequence[Attached]]) -> Cell:
        """The same cell where arms hold objects, and nothing else, by the names of the arms.

        An object is at its pose in the arm's tool frame, and is a link of that arm, ``left_box``; its touch links are
        links of the arm's own robot. What it keeps (``Attached.constraints``), that arm keeps in what ``plan`` plans.

        Raises:
            UnknownName: No such arm, or no such link.
            InvalidRequest: Two things would get one name, or a shape is none of convex pieces.
        """
        instance("carried", carried, Mapping, "attached objects by the names of the arms")
        held = {
            name: items(f"carried[{name!r}]", each, Attached, "a sequence of Attached")
            for name, each in carried.items()
        }
        cell = object.__new__(type(self))
        cell._set(replace(self.layout, carried=held))
        return cell

    def _set(self, layout: Layout) -> None:
        self.layout, self.scene = layout, layout.scene
        layout = loaded(layout)
        if self.scene.attached:
            carried = [item.name for item in self.scene.attached]
            raise InvalidRequest(
                "scene", carried, "a scene in which nothing is carried; ``carrying`` says what arms hold"
            )
        if layout.whole is None:
            self.robot, parts = parts_at_places(layout.arms)
        else:
            self.robot, parts = layout.whole, parts_of(layout.whole, layout.groups, layout.tools)
        held = {f"{name}_{item.name}" for name, carried in self.layout.carried.items() for item in carried}
        taken = sorted(held & {*self.scene.names})
        if taken:
            raise InvalidRequest("carried", taken[0], "names that nothing in the scene has")
        self._services = Services(self.robot, self.scene, parts)

    def __repr__(self) -> str:
        return f"<Cell: {', '.join(self.arms)} in {self.scene.name or 'a scene'}>"

    @property
    def arms(self) -> tuple[str, ...]:
        """Their names, in order."""
        return tuple(self._services.parts)

    @property
    def service(self) -> PlannerService:
        """Plans for all arms as one robot, with one clock."""
        return self._services.whole

    def arm(self, name: str, standing: Mapping[str, ArrayLike] | None = None) -> PlannerService:
        """A service of one arm, with its own joints, tool and gripper, in the cell's frame.

        Args:
            standing: Where other arms stand, by their names, the joints of each; those that are not named are away,
                but for their fixed bases.

        Raises:
            UnknownName: No such arm.
            InvalidRequest: An arm stands beside itself, or at no configuration of it.
        """
        self._services.part(name)
        others = self._joints("standing", {} if standing is None else standing)
        if name in others:
            raise InvalidRequest("standing", name, "other arms than this one")
        return self._services.alone(name, others)

    def between(self, a: str, b: str, q: ArrayLike) -> Certifier:
        """A certifier that judges what moves with one arm against what moves with the other, and nothing else.

        Args:
            q: Of the whole: joints without an end have turned as there, joints of other arms stand.

        Raises:
            UnknownName: No such arm.
            InvalidRequest: ``q`` is not of the whole, or the two are one.
        """
        if self._services.part(a) is self._services.part(b):
            raise InvalidRequest("b", b, "another arm than a")
        return self._services.between(a, b, joint_vector("q", q, self.robot))

    def joined(self, values: Mapping[str, ArrayLike]) -> FloatArray:
        """q of the whole (n,), arms and joints that are not named at home.

        Raises:
            UnknownName: No such arm.
            InvalidRequest: Values do not fit an arm.
        """
        return self._services.joined(self._joints("values", values))

    def of_arm(self, name: str, q: ArrayLike) -> FloatArray:
        """The joints of one arm from q of the whole, shape (..., n).

        Raises:
            UnknownName: No such arm.
            InvalidRequest: ``q`` is not of the whole.
        """
        columns = list(self._services.part(name).columns)
        expected = f"joint values of shape (..., {self.robot.n})"
        values = numbers("q", q, expected)
        if values.ndim == 0 or values.shape[-1] != self.robot.n:
            raise InvalidRequest("q", values.shape, expected)
        return np.asarray(values[..., columns])

    def plan(
        self,
        requests: Mapping[str, PlanRequest],
        *,
        goals: Mapping[str, AtTool | Anywhere] | None = None,
        standing: Mapping[str, ArrayLike] | None = None,
        delay: float = 0.0,
        cancel: CancelToken | None = None,
    ) -> CellPlan:
        """Motions of several arms, each on its own clock, that start as early as their proofs allow.

        Each arm is planned alone. If there is no order of starts in which the motions are proven apart, each is planned
        around those that are through or wait; if that does not do either, all arms as one robot, with one clock.

        Args:
            requests: What each arm is to do, by its name, joints and poses as of ``arm(name)``.
            goals: Goals that depend on other arms, in place of those of the arms' requests: a ``AtTool`` to
                another arm's tool, or ``Anywhere``, of an arm that only gets out of the way.
            standing: Where the other arms stand, by their names; at home if not named.
            delay: Seconds by which any arm may be late at any time, each for itself, without touching another.
            cancel: Ends the call before its next check.

        Raises:
            UnknownName: No such arm.
            InvalidRequest: There is no request, an arm that moves is said to stand, values do not fit an arm, goals
                depend on each other, or none of the arms is to go anywhere.
        """
        number("delay", delay, f"seconds in [0, {MAX_DELAY:g}]", 0.0, MAX_DELAY)
        instance("requests", requests, Mapping, "requests by the names of arms")
        if not requests:
            raise InvalidRequest("requests", {}, "at least one")
        for name, request in requests.items():
            instance(f"requests[{name!r}]", request, PlanRequest, "a PlanRequest")
            joint_vector(f"requests[{name!r}].start", request.start, self._services.part(name).robot)
        still = self._joints("standing", {} if standing is None else standing)
        both = sorted(still.keys() & requests.keys())
        if both:
            raise InvalidRequest("standing", both[0], "an arm without a request")
        depending = checked_goals({} if goals is None else goals, requests, self.arms)
        asked = {name: self._keeping(name, request) for name, request in requests.items()}
        if depending:
            plan = plan_goals(self._services, asked, depending, still, delay, cancel)
        else:
            plan = plan_arms(self._services, asked, still, delay, cancel)
        return replace(plan, layout=self.layout)

    def _keeping(self, name: str, request: PlanRequest) -> PlanRequest:
        """A request with what the arm keeps for what it carries."""
        kept = constraints_of(self.layout.carried.get(name, ()))
        more = [constraint for constraint in kept if constraint not in request.constraints]
        return replace(request, constraints=(*request.constraints, *more)) if more else request

    def _joints(self, field: str, values: object) -> dict[str, FloatArray]:
        """Joints by the names of arms, checked."""
        given = instance(field, values, Mapping, "joints by the names of arms")
        return {
            name: joint_vector(f"{field}[{name!r}]", q, self._services.part(name).robot) for name, q in given.items()
        }


def _loaded(scene: Scene | str | Path) -> Scene:
    return scene if isinstance(scene, Scene) else load_scene(scene)

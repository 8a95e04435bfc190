"""The services of a cell's arms, alone and together, made when first asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from planner_service.cell.arms import Part
from planner_service.cell.clocks import between_arms
from planner_service.certify import Certifier
from planner_service.errors import UnknownName
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService

__all__ = ["Services"]


class Services:
    """What plans and proves for the arms of one robot in one scene."""

    def __init__(self, robot: Robot, scene: Scene, parts: Sequence[Part]) -> None:
        self.robot, self.scene = robot, scene
        self.parts = {part.name: part for part in parts}
        self._alone: dict[str, PlannerService] = {}
        self._between: dict[tuple[str, str], tuple[Robot, Certifier]] = {}

    @cached_property
    def whole(self) -> PlannerService:
        """Of all arms, with one clock."""
        return PlannerService(self.robot, self.scene)

    def part(self, name: str) -> Part:
        """An arm.

        Raises:
            UnknownName: There is no such arm.
        """
        if not isinstance(name, str) or name not in self.parts:
            raise UnknownName("arm", name, self.parts)
        return self.parts[name]

    def alone(self, name: str, standing: Mapping[str, FloatArray]) -> PlannerService:
        """Of one arm, beside others that stand; the rest is away."""
        part = self.part(name)
        if standing:
            return PlannerService(part.beside((self.part(other), q) for other, q in standing.items()), self.scene)
        if name not in self._alone:
            self._alone[name] = PlannerService(part.robot, self.scene)
        return self._alone[name]

    def joined(self, values: Mapping[str, FloatArray]) -> FloatArray:
        """q of the whole, the joints of arms that are not named at home."""
        q = np.array(self.robot.home)
        for name, given in values.items():
            q[list(self.part(name).columns)] = given
        return q

    def between(self, a: str, b: str, q: FloatArray) -> Certifier:
        """What judges two arms against each other alone, where joints without an end have turned as in q."""
        robot = self.robot.around(q) if any(self.robot.continuous) else self.robot
        known = self._between.get((a, b))
        if known is None or known[0] is not robot:
            one, two = self.part(a), self.part(b)
            moving = {*one.columns, *two.columns}
            still = [joint for k, joint in enumerate(robot.joint_names) if k not in moving]
            known = self._between[a, b] = robot, between_arms(robot, one.moving, two.moving, still)
        return known[1]

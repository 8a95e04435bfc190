"""A scene while it is edited, as a value: every edit is another one, and can be undone."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Solid
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.geometry.validation import MAX_NAME
from planner_service.scene.scene import Obstacle, Scene
from planner_service.view.cell.surfaces import Surfaces, drop, resting
from planner_service.view.triangles import extremes

__all__ = ["NEW", "Cell"]

NEW: Mapping[str, Solid] = MappingProxyType(
    {
        "box": Box((0.1, 0.1, 0.1)),
        "sphere": Sphere(0.05),
        "cylinder": Cylinder(0.04, 0.15),
        "capsule": Capsule(0.03, 0.12),
    }
)
"""Obstacles as they are added, by their kind, in metres."""

MAX_UNDONE = 100
"""Edits that can be undone; the oldest are forgotten."""

ROUNDED = 5
"""Decimals of a metre of a place that somebody pointed at."""

ABOVE = 100.0
"""Metres above the base frame from which a new obstacle falls."""


@dataclass(frozen=True, eq=False)
class Cell:
    """A scene, the obstacle that is selected, and the scenes before the last edits.

    Attributes:
        selected: The name of an obstacle of ``scene``; None if none is selected.
        before: Scenes to which ``undone`` goes back, the last one last.
        last: The obstacle's place in order and what of it was edited last: to go on with that is one edit.
    """

    scene: Scene
    selected: str | None = None
    before: tuple[Scene, ...] = ()
    last: tuple[int, str] | None = None

    @property
    def obstacle(self) -> Obstacle | None:
        """The obstacle that is selected."""
        return None if self.selected is None else self.scene.obstacle(self.selected)

    @cached_property
    def surfaces(self) -> Surfaces:
        """All obstacles but the selected one: what it can stand on."""
        return Surfaces(self.scene, without=self.selected)

    def select(self, name: str | None) -> Cell:
        """The obstacle of that name selected; none if there is none of that name."""
        known = name if any(obstacle.name == name for obstacle in self.scene.obstacles) else None
        return self if known == self.selected else replace(self, selected=known, last=None)

    def added(self, kind: str, place: tuple[float, float]) -> Cell:
        """A new obstacle of a kind of ``NEW``, on top of what is at x, y of the base frame, or on its plane z = 0."""
        hit = Surfaces(self.scene).met_by(np.array([*place, ABOVE]), np.array([0.0, 0.0, -1.0]))
        ground = np.array([*place, 0.0]) if hit is None else hit.point
        obstacle = Obstacle(self._free_name(kind), NEW[kind])
        return self.with_obstacles([self._placed(obstacle, ground, np.array([0.0, 0.0, 1.0]))])

    def with_obstacles(self, obstacles: Iterable[Obstacle]) -> Cell:
        """More obstacles, under free names, the last one selected; at least one."""
        cell = self
        for obstacle in obstacles:
            named = replace(obstacle, name=cell._free_name(obstacle.name))
            cell = replace(cell, scene=cell.scene.with_obstacle(named), selected=named.name)
        return self._edited(cell.scene, cell.selected)

    def renamed(self, name: str) -> Cell:
        """The selected obstacle under another name.

        Raises:
            InvalidRequest: it cannot have that name, or another has it.
        """
        return self._changed("name", name=name)

    def shaped(self, sizes: Iterable[float]) -> Cell:
        """The selected obstacle, a primitive, with other sizes: edges, or a radius and a length.

        Raises:
            InvalidRequest: it cannot have those sizes, or is no primitive.
        """
        shape, numbers = self._chosen.shape, tuple(sizes)
        if isinstance(shape, Box) and len(numbers) == 3:
            x, y, z = numbers
            return self._changed("size", shape=Box((x, y, z)))
        if isinstance(shape, Sphere | Cylinder | Capsule) and len(numbers) == (1 if isinstance(shape, Sphere) else 2):
            return self._changed("size", shape=type(shape)(*numbers))
        raise InvalidRequest("size", numbers, "a box, sphere, cylinder or capsule with as many sizes")

    def moved(self, pose: Pose) -> Cell:
        """The selected obstacle at another pose.

        Raises:
            InvalidRequest: it is too far away.
        """
        return self._changed("pose", pose=pose)

    def dragged(self, pose: Pose) -> Cell:
        """The selected obstacle where somebody let go of it: an edit of its own, rounded to 0.01 mm.

        Raises:
            InvalidRequest: it is too far away.
        """
        return replace(replace(self, last=None).moved(_rounded(pose)), last=None)

    def set_down(self) -> Cell:
        """The selected obstacle on what is below it.

        Raises:
            InvalidRequest: nothing is.
        """
        pose = drop(self._chosen, self.surfaces)
        if pose is None:
            raise InvalidRequest("set down", self.selected, "an obstacle above another one")
        return self.dragged(pose)

    def coloured(self, colour: str) -> Cell:
        """The selected obstacle in another colour, ``"#rrggbb"``."""
        return self._changed("colour", colour=colour)

    def copied(self) -> Cell:
        """Another one like the selected obstacle, beside it along x."""
        x, y, z = self._chosen.pose.position
        low, high = extremes(self._chosen)
        pose = Pose((x + 1.2 * float(high[0] - low[0]), y, z), self._chosen.pose.quaternion)
        return self.with_obstacles([replace(self._chosen, pose=_rounded(pose))])

    def deleted(self) -> Cell:
        """Without the selected obstacle."""
        return self._edited(self.scene.without(self._chosen.name), None)

    def undone(self) -> Cell:
        """As before the last edit; itself if there is nothing to undo."""
        if not self.before:
            return self
        cell = replace(self, scene=self.before[-1], before=self.before[:-1], last=None, selected=None)
        return cell.select(self.selected)

    @property
    def _chosen(self) -> Obstacle:
        obstacle = self.obstacle
        if obstacle is None:
            raise InvalidRequest("obstacle", None, "one that is selected")
        return obstacle

    def _changed(self, what: str, **fields: object) -> Cell:
        """The selected obstacle with other fields, in its place in order."""
        chosen = self._chosen
        k = self.scene.obstacles.index(chosen)
        changed = replace(chosen, **fields)  # type: ignore[arg-type]
        if changed == chosen and changed.colour == chosen.colour:
            return self
        scene = replace(self.scene, obstacles=(*self.scene.obstacles[:k], changed, *self.scene.obstacles[k + 1 :]))
        return self._edited(scene, changed.name, (k, what))

    def _edited(self, scene: Scene, selected: str | None, last: tuple[int, str] | None = None) -> Cell:
        again = last is not None and last == self.last
        before = self.before if again else (*self.before, self.scene)[-MAX_UNDONE:]
        return Cell(scene, selected, before, last)

    def _free_name(self, wish: str) -> str:
        """The name, or it with the first number that makes it free."""
        taken, number = set(self.scene.names), 2
        stem = re.sub(r"_\d+\Z", "", wish)
        name = wish
        while name in taken:
            name = f"{stem[: MAX_NAME - len(str(number)) - 1].rstrip()}_{number}"
            number += 1
        return name

    @staticmethod
    def _placed(obstacle: Obstacle, point: FloatArray, normal: FloatArray) -> Obstacle:
        return replace(obstacle, pose=_rounded(resting(obstacle, point, normal)))


def _rounded(pose: Pose) -> Pose:
    x, y, z = (round(value, ROUNDED) for value in pose.position)
    return Pose((x, y, z), pose.quaternion)

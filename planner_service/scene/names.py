"""What links and scene objects are called: by their names, and by their kind too where one name stands for both."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from planner_service.robot.model import Robot
from planner_service.scene.scene import KIND_SUFFIXES, Scene

__all__ = ["Kind", "Names", "Owner", "owner_of"]


class Kind(Enum):
    """What a name stands for; the value distinguishes it in print."""

    LINK, OBJECT = KIND_SUFFIXES
    __hash__ = object.__hash__  # compiled, unlike that of Enum: owners are looked up all the time


class Owner(NamedTuple):
    """A link of the robot, or an obstacle or attached object of the scene."""

    kind: Kind
    name: str


class Names:
    """The labels of one robot's links and one scene's objects; no two have the same.

    A label is the name. Of a link and an object of one name, and of a link whose name looks like a label, it is the
    name with the kind: ``"flange (link)"``, ``"flange (object)"``.

    Attributes:
        twice: The names that both a link and an object have.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self.twice = robot.links.intersection(scene.names)

    def link(self, name: str) -> str:
        """The label of a link."""
        return self.of(Owner(Kind.LINK, name))

    def object(self, name: str) -> str:
        """The label of an obstacle or attached object."""
        return self.of(Owner(Kind.OBJECT, name))

    def of(self, owner: Owner) -> str:
        """The label of either."""
        kind, name = owner
        return name + kind.value if name in self.twice or name.endswith(KIND_SUFFIXES) else name

    def links(self, pairs: tuple[tuple[str, str], ...]) -> tuple[tuple[str, str], ...]:
        """The labels of pairs of links."""
        return tuple((self.link(a), self.link(b)) for a, b in pairs)


def owner_of(label: str, robot: Robot) -> Owner:
    """Whose label it is, in any scene of that robot."""
    for kind in Kind:
        if label.endswith(kind.value):
            return Owner(kind, label.removesuffix(kind.value))
    return Owner(Kind.LINK if label in robot.links else Kind.OBJECT, label)

"""What a certificate must prove apart: the pieces of a robot in a scene and their pairs, listed for the proof alone.

The collision checker has a list of its own, made elsewhere; that the two agree is for tests to say.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry import FloatArray, Shape
from planner_service.robot import Robot
from planner_service.scene import Scene

__all__ = ["FIXED", "Frame", "Piece", "ProofPairs", "pairs_of_names"]

Frame = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]

FIXED = -1
"""The body of what stands in the world."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One convex solid of ``owner``; ``frame`` is its pose in its body, or in the world: rows of a 3 x 4 matrix."""

    owner: str
    body: int
    shape: Shape
    frame: Frame
    held: bool = False


class ProofPairs:
    """Pieces and the pairs of them that must stay apart.

    An obstacle is judged against everything that a joint moves; two pieces of the robot if they are on different
    bodies; a held object also against the body that holds it. Not judged: pieces of one owner, contacts that the robot
    allows, a held object and its touch links, and ``allowed``.

    Attributes:
        riding: Pieces of the robot and what it holds.
        standing: Obstacles, numbered after these.
        pairs: (p, 2) numbers of pieces, the first of each riding.

    Raises:
        UnknownName: a pair or a touch link names nothing that is there.
        InvalidRequest: an object is called like a link.
    """

    def __init__(self, robot: Robot, scene: Scene, allowed: Iterable[tuple[str, str]]) -> None:
        tool = _frame(robot.tool_placement)
        riding = [Piece(s.link, s.body, s.shape, _frame(s.pose.matrix)) for s in robot.shapes]
        riding += [
            Piece(a.name, robot.tool_body, a.shape, _times(tool, _frame(a.pose.matrix)), held=True)
            for a in scene.attached
        ]
        self.riding = tuple(riding)
        self.standing = tuple(Piece(o.name, FIXED, o.shape, _frame(o.pose.matrix)) for o in scene.obstacles)
        self._pieces = self.riding + self.standing
        self.owners = frozenset(piece.owner for piece in self._pieces)
        links = {shape.link for shape in robot.shapes}
        for name in scene.names:
            if name in links:
                raise InvalidRequest("scene", name, f"an object name that is not a link of {robot.name}")
        self._may_touch = self._contacts(robot, scene, allowed)
        self.pairs = self._listed()

    def check_name(self, kind: str, name: str) -> None:
        """Raise ``UnknownName`` unless a link or object of that name has a piece here."""
        if name not in self.owners:
            raise UnknownName(kind, name, self.owners)

    def names(self, pair: int) -> tuple[str, str]:
        """The owners of a pair."""
        first, second = self.pairs[pair].tolist()
        return self._pieces[first].owner, self._pieces[second].owner

    def _contacts(self, robot: Robot, scene: Scene, allowed: Iterable[tuple[str, str]]) -> set[frozenset[str]]:
        found = {frozenset(contact.links) for contact in robot.allowed_contacts}
        for attached in scene.attached:
            for link in attached.touch_links:
                self.check_name("touch link", link)
                found.add(frozenset((attached.name, link)))
        for a, b in pairs_of_names("allowed", allowed):
            self.check_name("link or object", a)
            self.check_name("link or object", b)
            found.add(frozenset((a, b)))
        return found

    def _listed(self) -> NDArray[np.intp]:
        pieces, count = self._pieces, len(self.riding)
        rows = [
            (i, j) for i in range(count) for j in range(i + 1, len(pieces)) if self._must_part(pieces[i], pieces[j])
        ]
        return np.array(rows, dtype=np.intp).reshape(-1, 2)

    def _must_part(self, a: Piece, b: Piece) -> bool:
        if a.owner == b.owner or frozenset((a.owner, b.owner)) in self._may_touch:
            return False
        if b.body == FIXED:
            return a.body > 0
        return a.body != b.body or a.held or b.held


def pairs_of_names(field: str, pairs: object) -> tuple[tuple[str, str], ...]:
    """Pairs of two different names that a caller gave.

    Raises:
        InvalidRequest: naming ``field``: something else.
    """
    expected = "pairs of two different link or object names"
    if not isinstance(pairs, (list, tuple, set, frozenset)):
        raise InvalidRequest(field, pairs, expected)
    for pair in pairs:
        good = isinstance(pair, (list, tuple)) and len(pair) == 2 and all(isinstance(name, str) for name in pair)
        if not good or pair[0] == pair[1]:
            raise InvalidRequest(field, pair, expected)
    return tuple((a, b) for a, b in pairs)


def _frame(T: FloatArray) -> Frame:
    """The first three rows of a homogeneous matrix."""
    a, b, c = T[:3].tolist()
    return (tuple(a), tuple(b), tuple(c))


def _times(a: Frame, b: Frame) -> Frame:
    """The frame b, given in a, in what a is given in."""
    rows = [[r[0] * u + r[1] * v + r[2] * w for u, v, w in zip(*b, strict=True)] for r in a]
    one, two, three = ((*row[:3], row[3] + r[3]) for row, r in zip(rows, a, strict=True))
    return (one, two, three)

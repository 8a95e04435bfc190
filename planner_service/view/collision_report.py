"""What the page says about a configuration: which pairs touch, where they touch, and how much clearance is left."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from planner_service.certify import Certifier
from planner_service.collision import Contact
from planner_service.geometry.arrays import FloatArray
from planner_service.service import PlannerService

__all__ = ["CollisionReport", "CollisionReporter"]

TOUCH_DISTANCE = 1e-3
"""Metres within which contact points are searched: FCL may report a touch of shapes that rounding keeps apart."""

Pair = tuple[str, str]


@dataclass(frozen=True)
class CollisionReport:
    """Contacts and clearance of one configuration.

    Attributes:
        clearance: Proven lower bound in metres of the smallest gap between pairs that must not touch; infinite if there
            are no such pairs, and not positive if some may overlap.
        contacts: Contacts that must not be, deepest first.
        expected: Contacts that may be, as between fingers and the object they hold.
        points: Where pairs touch, in the world frame, as far as that is known.
    """

    clearance: float
    contacts: tuple[Contact, ...]
    expected: tuple[Contact, ...]
    points: tuple[tuple[Pair, tuple[float, float, float]], ...]

    @property
    def free(self) -> bool:
        """Whether the configuration is collision-free."""
        return not self.contacts


class CollisionReporter:
    """Reports collisions for one service, with checkers of its own: the service's counts do not change."""

    def __init__(self, service: PlannerService) -> None:
        self._robot, self._scene = service.robot, service.scene
        self._allowed = service.checker.allowed
        self._checker = service.changed().checker
        self._certifiers: dict[frozenset[Pair], Certifier] = {}

    def clearances(self, Q: FloatArray, expected: Iterable[Pair] = ()) -> FloatArray:
        """Proven lower bounds (metres) of the clearance at Q (m, n), without the pairs that may touch."""
        pairs = frozenset(expected)
        if pairs not in self._certifiers:
            self._certifiers[pairs] = Certifier(self._robot, self._scene, allowed=(*self._allowed, *pairs))
        return self._certifiers[pairs].clearances(Q)

    def report(self, q: FloatArray, expected: Collection[Pair] = ()) -> CollisionReport:
        """The report for q (n,), which must be within the limits; FCL is asked only where the proof finds no gap.

        Args:
            expected: Pairs that may touch.
        """
        pairs = {frozenset(pair) for pair in expected}
        clearance = float(self.clearances(q[None], expected)[0])
        if clearance > 0.0 and not pairs:
            return CollisionReport(clearance, (), (), ())
        touching = self._checker.contacts(q)
        contacts = tuple(contact for contact in touching if frozenset((contact.a, contact.b)) not in pairs)
        may_be = tuple(contact for contact in touching if contact not in contacts)
        return CollisionReport(clearance, contacts, may_be, self._contact_points(q, touching))

    def _contact_points(
        self, q: FloatArray, contacts: tuple[Contact, ...]
    ) -> tuple[tuple[Pair, tuple[float, float, float]], ...]:
        """For each contact, the middle between the nearest points of the pieces that overlap most."""
        if not contacts:
            return ()
        near = self._checker.near(q[None], TOUCH_DISTANCE)
        wanted = {(contact.a, contact.b) for contact in contacts}
        deepest: dict[Pair, tuple[float, FloatArray]] = {}
        for pair, distance, points in zip(near.pairs.tolist(), near.distances.tolist(), near.points, strict=True):
            names = self._checker.pair_names(pair)
            if names in wanted and distance < deepest.get(names, (math.inf, points))[0]:
                deepest[names] = distance, np.asarray((points[0] + points[1]) / 2.0)
        return tuple((names, tuple(point.tolist())) for names, (_, point) in deepest.items())

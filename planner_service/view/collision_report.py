"""What is to be said of a configuration: what touches, where, and how much room is left; nobody's counts change."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from planner_service.certify import Certifier
from planner_service.collision import Contact
from planner_service.collision.native_kernel import instruction_sets
from planner_service.geometry.shapes import FloatArray
from planner_service.service import PlannerService

__all__ = ["Eye", "Look"]

NEAR = 1e-3
"""Metres within which the places of contacts are looked for: what FCL calls a touch may be apart by rounding."""

Pair = tuple[str, str]


@dataclass(frozen=True)
class Look:
    """What is to be said of a configuration.

    Attributes:
        clearance: Proven lower bound in metres of the smallest gap of what must not touch; infinite where nothing is
            judged, not above 0 where something may overlap.
        contacts: What touches and must not, deepest first.
        meant: What touches and may, as fingers do what they take.
        places: Where pairs of names touch, in the world, as far as that is known.
    """

    clearance: float
    contacts: tuple[Contact, ...]
    meant: tuple[Contact, ...]
    places: tuple[tuple[Pair, tuple[float, float, float]], ...]

    @property
    def free(self) -> bool:
        """Whether nothing touches that must not."""
        return not self.contacts


class Eye:
    """Judges configurations for one service, with checkers of its own."""

    def __init__(self, service: PlannerService) -> None:
        self._robot, self._scene = service.robot, service.scene
        self._allowed = service.checker.allowed
        self._checker = service.changed().checker
        self._certifiers: dict[frozenset[Pair], Certifier] = {}

    def clearances(self, Q: FloatArray, meant: Iterable[Pair] = ()) -> FloatArray:
        """Proven lower bounds (metres) of the smallest gaps at configurations Q (m, n), pairs that may touch apart."""
        pairs = frozenset(meant)
        if pairs not in self._certifiers:
            self._certifiers[pairs] = Certifier(self._robot, self._scene, allowed=(*self._allowed, *pairs))
        return self._certifiers[pairs].clearances(Q)

    def look(self, q: FloatArray, meant: Iterable[Pair] = ()) -> Look:
        """What is to be said of q (n,), which lies within the limits; FCL is asked where nothing is proven."""
        pairs = {frozenset(pair) for pair in meant}
        clearance = float(self.clearances(q[None], meant)[0])
        if clearance > 0.0 and not pairs:
            return Look(clearance, (), (), ())
        found = self._checker.contacts(q)
        contacts = tuple(contact for contact in found if frozenset((contact.a, contact.b)) not in pairs)
        expected = tuple(contact for contact in found if contact not in contacts)
        return Look(clearance, contacts, expected, self._places(q, found))

    def _places(
        self, q: FloatArray, contacts: tuple[Contact, ...]
    ) -> tuple[tuple[Pair, tuple[float, float, float]], ...]:
        """Where contacts are: between the nearest points of the pieces that overlap most."""
        if not contacts or not instruction_sets():
            return ()
        near = self._checker.near(q[None], NEAR)
        wanted = {(contact.a, contact.b) for contact in contacts}
        deepest: dict[Pair, tuple[float, FloatArray]] = {}
        for pair, distance, points in zip(near.pairs.tolist(), near.distances.tolist(), near.points, strict=True):
            names = self._checker.pair_names(pair)
            if names in wanted and distance < deepest.get(names, (math.inf, points))[0]:
                deepest[names] = distance, np.asarray((points[0] + points[1]) / 2.0)
        return tuple((names, tuple(place.tolist())) for names, (_, place) in deepest.items())

"""The compiled kernel: which pairs are not proven apart, for a state, a list of states or a whole edge in one call.

It proves what ``prefilter`` proves, by the same margin and with more separating directions, so that FCL is asked about
fewer pairs and says the same; nor is FCL asked about a pair that is proven to overlap by a hundred times the micrometre
in which its answer is undefined. Without the extension the prefilter does alone.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import lru_cache
from types import ModuleType
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.collision.bounds import Solids, centres_of, doubt_of
from planner_service.collision.edge_sampling import EdgeStep, FinestStep, JointStep, MotionStep
from planner_service.collision.pairs import Parts
from planner_service.geometry.shapes import FloatArray
from planner_service.robot.model import Robot

__all__ = ["Asked", "Doubt", "Found", "IntArray", "Kernel", "Nearby", "build_kernel", "instruction_sets", "rules_of"]

IntArray = NDArray[np.int64]

Found = tuple[int, float, int]
"""The row that collides, where on the edge it is (0 to 1; 0 for a row of no edge), and the number of the first pair
that touches there: if the kernel says so, one that is proven to overlap by more than 0.1 mm."""

Doubt = tuple[int, float, list[float], list[int]]
"""A row in doubt, where on the edge it is, its configuration, and the numbers of its pairs in doubt: the first of them
and some more."""

Asked = tuple[int, int, int, int, int]
"""An edge that is not finished: the ends to judge, the segments, the rows, the row to go on with, and how many rows
before it were found free."""

Nearby = tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray, int]
"""Rows, pairs, distances, points, gradients, and how many pairs were looked at closely."""

SLIDES = 1.0


class Kernel(Protocol):
    """Judges configurations of one robot in one scene; built from data, holds nothing that changes."""

    @property
    def variant(self) -> str:
        """The instruction set it uses."""

    def candidates(self, Q: FloatArray, /) -> tuple[list[int], list[int]]:
        """Rows of Q (m, n) and the numbers of their pairs not proven apart, sorted by row, then pair."""

    def first(self, Q: FloatArray, start: int, stop: int, /) -> Found | Doubt | None:
        """The first row of Q (m, n) in [start, stop) with such a pair; None if there is none."""

    def edge(
        self, a: Sequence[float], b: Sequence[float], ends: int, segments: int, start: int, stop: int, /
    ) -> Found | Doubt | None:
        """The same for the edge from a to b: its rows are its ends (``ends``: 1 for a, 2 for b), then the interior."""

    def agree(
        self, lower: Sequence[float], upper: Sequence[float], reach: Sequence[float], rules: list[tuple[bool, float]], /
    ) -> None:
        """Take the terms of ``state`` and ``ask``: limits, and the rules by which edges are sampled."""

    def state(self, q: ArrayLike, /) -> Literal[True] | Found | Doubt | None:
        """True if no pair is in doubt at q; None unless q is a tuple or an array of n floats within the limits."""

    def ask(self, q1: ArrayLike, q2: ArrayLike, known: int, glance: int, many: int, /) -> int | Found | Asked | None:
        """The edge from q1 to q2, ``known`` being the ends not to be judged, looked at as far as ``many`` rows.

        Args:
            glance: Segments between the samples that come first, which are all there are then; 0: every sample;
                below 0: those that such a look leaves out.

        Returns:
            How many rows there are if all of them are free, and what is found if the first that is not is sure to
            collide, its row being the number of those before it; None unless both ends are tuples or arrays of n
            floats within the limits, and there are not too many segments.
        """

    def samples(self, a: Sequence[float], b: Sequence[float], segments: int, /) -> list[list[float]]:
        """The interior of an edge in the order in which it is judged."""

    def near(self, Q: FloatArray, within: float, /) -> Nearby:
        """All pairs nearer than ``within`` metres at rows of Q (m, n), by row: what ``NearPairs`` is made of.

        Equal bits with every instruction set.
        """


@lru_cache(maxsize=1)
def _extension() -> ModuleType | None:
    """The compiled module; None where it was not built, which is said once."""
    try:
        from planner_service.collision import _kernel
    except ImportError as error:
        logging.getLogger("planner_service").info("collision checks without the compiled kernel: %s", error)
        return None
    return _kernel


def instruction_sets() -> tuple[str, ...]:
    """Those the kernel can use on this processor, the fastest last; none where it was not built."""
    module = _extension()
    return () if module is None else tuple(module.instruction_sets())


def build_kernel(robot: Robot, parts: Parts, margin: float, variant: str = "") -> Kernel | None:
    """The kernel for a robot and the numbered list of its parts and the scene's; None where it was not built.

    Args:
        margin: Metres by which a pair must be proven apart, ``doubt_of`` small solids apart.
        variant: One of ``instruction_sets()``; the fastest if empty.
    """
    module = _extension()
    if module is None:
        return None
    solids = Solids.of(parts.shapes)
    runs = np.array(parts.runs, dtype=np.int64).reshape(-1, 2) - parts.riding
    rows = np.column_stack([solids.half, solids.ball, solids.disc, solids.hulls])
    hulls = [np.ascontiguousarray(corners.T) for corners in solids.corners]
    pairs = np.ascontiguousarray(parts.pairs, dtype=np.int64)
    kernel: Kernel = module.Kernel(
        _joints(robot), _places(parts), rows, runs, pairs, hulls, margin + doubt_of(solids), variant
    )
    return kernel


def rules_of(step: EdgeStep) -> list[tuple[bool, float]] | None:
    """The rules the kernel knows: whether each weighs joints by their reach, and its step; None if one is a user's."""
    if type(step) is JointStep:
        return [(False, step.angle)]
    if type(step) is MotionStep:
        return [(True, step.distance)]
    if type(step) is not FinestStep:
        return None
    found: list[tuple[bool, float]] = []
    for rule in step.rules:
        known = rules_of(rule)
        if known is None:
            return None
        found += known
    return found or None


def _joints(robot: Robot) -> FloatArray:
    """Each body but the base: parent, entry of q, whether it slides, axis, rotation and position of its placement."""
    rows = [
        [
            float(body.parent),
            float(body.q_index),
            SLIDES if body.prismatic else 0.0,
            *body.axis.tolist(),
            *body.placement[:3, :3].ravel().tolist(),
            *body.placement[:3, 3].tolist(),
        ]
        for body in robot.bodies[1:]
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 18)


def _places(parts: Parts) -> FloatArray:
    """Of each part its body, -1 for the world, then rotation and centre in it."""
    T = np.array([part.T for part in parts.parts]).reshape(-1, 4, 4)
    R, centre = T[:, :3, :3], centres_of(parts.shapes)
    t = T[:, :3, 3] + (R @ centre[..., None])[..., 0]
    bodies = np.array([float(part.body) for part in parts.parts])
    return np.column_stack([bodies, R.reshape(-1, 9), t])

"""The compiled proof (native/): it takes the tables and constants of the modules of this folder."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from planner_service.certify import hulls, separation
from planner_service.certify import interval_proof as tree
from planner_service.certify import motion_bounds as motion_terms
from planner_service.certify.interval_proof import EdgeVerdict, Judged, Obstruction, Roots, Span
from planner_service.certify.motion_bounds import Motion
from planner_service.certify.native.loading import load_proof
from planner_service.certify.separation import Bounds
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.path.joint_path import JointPath

__all__ = ["LIMIT_SLACK", "Charge", "Proof", "Prover", "Tubes", "instruction_sets", "proof_terms"]

Charge = Callable[[int], None]

LIMIT_SLACK = 1e-9
"""How far a waypoint may lie outside a joint limit by rounding, in rad or m."""

FREE, NOT_TAKEN = Judged(EdgeVerdict.FREE), Judged(None)

PROVEN, CLOSE, SPENT = range(3)
"""How a compiled proof ends; any other number means that a stretch was too short to be halved."""


class Proof(NamedTuple):
    """The outcome of a proof: bounds computed, the smallest gap proven for any stretch, and where it failed, if so.

    ``leaves`` is what was proven, if that was asked for: rows of nine float64, the pair, from where to where in s,
    and unit directions at both ends from the second piece towards the first, in the second's axes; zero at an end where
    none was needed.
    """

    bounds: int
    proven: float
    obstruction: Obstruction | None
    leaves: bytes = b""


class Tubes(NamedTuple):
    """How many edges are free, the bounds that were asked, and of the edge after them a pair, where, and whether the
    edge itself collides, rather than what is within its room; the pair is -1 where all are free.
    """

    free: int
    bounds: float
    pair: int
    s: float
    collides: bool


class Prover:
    """Proves motions of one robot in one scene.

    Args:
        variant: One of ``instruction_sets()``; the fastest if empty.
    """

    def __init__(self, motion: Motion, variant: str = "") -> None:
        self._prover = load_proof().Prover(proof_terms(), *motion.tables, variant)

    def prove(
        self, path: JointPath, enough: float, roots: Roots, charge: Charge | None, *, tracing: bool = False
    ) -> Proof:
        """Prove that the pairs of ``roots`` are more than ``enough`` metres apart on their spans.

        If ``enough`` is negative, that they overlap by less.

        Args:
            path: The curve; no subclass, whose curve may be another one.
            charge: Called with the number of bounds before each batch; what it raises comes out unchanged.
            tracing: Keep what is proven as ``leaves``, and prove it by plain bounds of motions: those that are checked
                with the least effort.
        """
        spans = np.array(roots.spans, dtype=np.float64).reshape(-1, 2)
        walked = path.walked.tables if tracing else None
        outcome = self._prover.prove(*path.tables, spans, roots.rows, enough, charge, walked)
        bounds, most, proven, end, pair, start, stop, s, gap, leaves = outcome
        if end == PROVEN:
            return Proof(bounds, proven, None, leaves)
        detail = tree.too_close(s, gap, enough) if end == CLOSE else tree.no_end(most if end == SPENT else None)
        return Proof(bounds, proven, Obstruction(pair, (start, stop), s, detail, end == SPENT))

    def edge(self, q1: object, q2: object, enough: float, nearer: float) -> Judged:
        """The verdict on a straight edge; none if an end is not n float64 within the limits.

        Args:
            enough: Metres by which every pair must be proven apart, and more.
            nearer: Metres; a pair that is proven nearer collides.
        """
        if type(q1) is not np.ndarray or type(q2) is not np.ndarray:  # others may hide entries
            return NOT_TAKEN
        answer = self._prover.edge(q1, q2, enough, nearer, LIMIT_SLACK)
        if not answer.taken:
            return NOT_TAKEN
        return FREE if answer.free else Judged(EdgeVerdict(answer.verdict), answer.pair, answer.s)

    def tubes(
        self, starts: FloatArray, ends: FloatArray, room: FloatArray, enough: float, nearer: float, parts: int
    ) -> Tubes:
        """How many edges from ``starts`` to ``ends`` are free with ``room``, (k, n) each, before the first that is not.

        Every pair is proven more than ``enough`` metres apart at whatever is off the edge by no more than its room in
        each joint. An edge itself on which a pair is nearer than ``nearer`` collides. ``parts`` of rooms may be looked
        at, for all edges together, where the whole of one is too much.
        """
        return Tubes(*self._prover.tubes(starts, ends, room, enough, nearer, parts))

    def each(
        self, starts: FloatArray, ends: FloatArray, room: FloatArray, enough: float, nearer: float
    ) -> tuple[BoolArray, float]:
        """Of each edge whether it is free, as in ``tubes``, (k,), and the bounds that were asked."""
        free = np.zeros(len(starts), dtype=np.bool_)
        return free, self._prover.each(starts, ends, room, enough, nearer, free)

    def boxes(self, starts: FloatArray, ends: FloatArray, room: FloatArray, out: FloatArray) -> None:
        """Boxes that riding pieces do not leave on edges with room, low and high corner, into ``out`` (riding, 6)."""
        self._prover.boxes(starts, ends, room, out)

    def clearances(self, Q: FloatArray) -> FloatArray:
        """Lower bounds (metres) of the smallest gap at configurations Q (m, n), (m,); infinite if there are no pairs.

        Of a row that is not finite, and wherever a gap is no number, it is -infinity.
        """
        out = np.zeros(len(Q))
        self._prover.clearances(Q, out)
        return out

    def near(self, Q: FloatArray, pairs: IntArray, within: float) -> tuple[IntArray, IntArray, Bounds]:
        """Pairs less than ``within`` metres apart at configurations Q (m, n): rows of Q, pairs and signed gaps.

        A gap below 0 is an overlap of no more than that. Pairs with bundles are opened. Sorted by rows and pairs.
        """
        found = self._prover.near(np.ascontiguousarray(Q), np.ascontiguousarray(pairs, dtype=np.int64), within)
        table = np.frombuffer(found).reshape(-1, 6)
        table = table[np.lexsort((table[:, 1], table[:, 0]))]
        rows, near = table[:, :2].astype(np.intp).T
        return rows, near, Bounds(table[:, 2].copy(), table[:, 3:].T.copy())

    def stretch(self, path: JointPath, ends: Span, pairs: IntArray, directions: FloatArray) -> FloatArray:
        """What a proof knows of plain pairs (k,) between two places of a curve, metres, (k, 3).

        How far their pieces move against each other at most; how far points of both leave the straight lines between
        where they are at the two places, together, seen from the last body that carries both, infinite if that is not
        known; and a lower bound of their gap all along, by a direction that stays as it is for that body.

        Args:
            directions: At the first place, in the axes of the second pieces, (k, 3).
        """
        found = self._prover.stretch(*path.tables, *ends, np.ascontiguousarray(pairs, dtype=np.int64), directions)
        return np.frombuffer(found).reshape(-1, 3)


def instruction_sets() -> tuple[str, ...]:
    """Instruction sets of the compiled prover on this processor, the fastest last."""
    return tuple(load_proof().instruction_sets())


def proof_terms() -> list[float]:
    """The constants, in the order of ``Terms`` in native/model.hpp."""
    return [
        *(motion_terms.ROUNDING, separation.TINY, separation.SHIFT, separation.STEPS_PER_ROUND, separation.DRAWS),
        *(hulls.GAIN, hulls.SHARE, hulls.THIN, hulls.TINY),
        *(tree.FRACTION, tree.MAX_BOUNDS, tree.FAR, tree.BATCH, tree.NEAR, tree.CLOSE, tree.ROUNDS, tree.LAST_ROUNDS),
        *(tree.MAX_EDGE_BOUNDS, tree.OVERLAP_STEPS, tree.CERTAIN, motion_terms.CLEARANCE_ROUNDS),
    ]

"""The two provers: the compiled code in native/ and the reference in numpy. Their answers are equal to the last bit.

The compiled code repeats the modules of this folder operation by operation and takes their tables and constants. It
shares no code with the search or its kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple, Protocol

import numpy as np

from planner_service.certify import clearance, hulls, overlap, separation
from planner_service.certify import edge_proof as edge
from planner_service.certify import interval_proof as tree
from planner_service.certify import motion_bounds as motion
from planner_service.certify.clearance import near_gaps, smallest_gaps
from planner_service.certify.edge_proof import EdgeTree, EdgeVerdict, Judged
from planner_service.certify.interval_proof import Obstruction, ProofTree, Roots
from planner_service.certify.motion_bounds import Motion
from planner_service.certify.native.loading import load_proof
from planner_service.certify.separation import Bounds
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.path.joint_path import JointPath

__all__ = ["LIMIT_SLACK", "Charge", "NumpyProver", "Proof", "Prover", "instruction_sets", "native_prover"]

Charge = Callable[[int], None]

LIMIT_SLACK = 1e-9
"""How far a waypoint may lie outside a joint limit by rounding, in rad or m."""

FREE, NOT_TAKEN = Judged(EdgeVerdict.FREE), Judged(None)


class Proof(NamedTuple):
    """The outcome of a proof: bounds computed, the smallest gap proven for any stretch, and where it failed, if so.

    ``leaves`` is what was proven, if that was asked for: float64 numbers of ``ProofTree``.
    """

    bounds: int
    proven: float
    obstruction: Obstruction | None
    leaves: bytes = b""


class Prover(Protocol):
    """Proves motions of one robot in one scene."""

    def prove(
        self, path: JointPath, enough: float, roots: Roots, charge: Charge | None, *, tracing: bool = False
    ) -> Proof:
        """Prove that the pairs of ``roots`` are more than ``enough`` metres apart on their spans; see ``ProofTree``."""

    def edge(self, q1: object, q2: object, enough: float, nearer: float) -> Judged:
        """The verdict of ``EdgeTree`` on a straight edge; none if an end is not n float64 within the limits."""

    def clearances(self, Q: FloatArray) -> FloatArray:
        """``smallest_gaps`` of all pairs at Q (m, n), (m,)."""

    def near(self, Q: FloatArray, pairs: IntArray, within: float) -> tuple[IntArray, IntArray, Bounds]:
        """As ``near_gaps``."""


class NumpyProver:
    """The reference."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion

    def prove(
        self, path: JointPath, enough: float, roots: Roots, charge: Charge | None, *, tracing: bool = False
    ) -> Proof:
        proof = ProofTree(self._motion, path, enough, charge or (lambda bounds: None), tracing=tracing)
        obstruction = proof.run(roots)
        return Proof(proof.bounds, proof.proven, obstruction, proof.leaves.tobytes())

    def edge(self, q1: object, q2: object, enough: float, nearer: float) -> Judged:
        lower, upper = self._motion.limits
        ends: list[FloatArray] = []
        for q in (q1, q2):
            if type(q) is not np.ndarray or q.dtype != np.float64 or q.shape != lower.shape:
                return NOT_TAKEN
            if not np.all((q >= lower - LIMIT_SLACK) & (q <= upper + LIMIT_SLACK)):
                return NOT_TAKEN
            ends.append(q)
        return EdgeTree(self._motion, JointPath(np.stack(ends)), enough, nearer).run(self._motion.roots)

    def clearances(self, Q: FloatArray) -> FloatArray:
        return smallest_gaps(self._motion, Q, self._motion.roots)

    def near(self, Q: FloatArray, pairs: IntArray, within: float) -> tuple[IntArray, IntArray, Bounds]:
        return near_gaps(self._motion, Q, pairs, within)


class _Native:
    """The compiled code."""

    def __init__(self, module: ModuleType, motion: Motion, variant: str) -> None:
        self._reference = NumpyProver(motion)
        self._prover = module.Prover(_terms(), *motion.tables, variant)

    def prove(
        self, path: JointPath, enough: float, roots: Roots, charge: Charge | None, *, tracing: bool = False
    ) -> Proof:
        if type(path) is not JointPath:  # its curve may be another one
            return self._reference.prove(path, enough, roots, charge, tracing=tracing)
        spans = np.array(roots.spans, dtype=np.float64).reshape(-1, 2)
        walked = path.walked.tables if tracing else None
        outcome = self._prover.prove(*path.tables, spans, roots.rows, enough, charge, walked)
        bounds, most, proven, end, pair, start, stop, s, gap, leaves = outcome
        if end == PROVEN:
            return Proof(bounds, proven, None, leaves)
        detail = tree.too_close(s, gap, enough) if end == CLOSE else tree.no_end(most if end == SPENT else None)
        return Proof(bounds, proven, Obstruction(pair, (start, stop), s, detail, end == SPENT))

    def edge(self, q1: object, q2: object, enough: float, nearer: float) -> Judged:
        if type(q1) is not np.ndarray or type(q2) is not np.ndarray:  # others may hide entries
            return NOT_TAKEN
        answer = self._prover.edge(q1, q2, enough, nearer, LIMIT_SLACK)
        if not answer.taken:
            return NOT_TAKEN
        return FREE if answer.free else Judged(EdgeVerdict(answer.verdict), answer.pair, answer.s)

    def clearances(self, Q: FloatArray) -> FloatArray:
        out = np.zeros(len(Q))
        self._prover.clearances(Q, out)
        return out

    def near(self, Q: FloatArray, pairs: IntArray, within: float) -> tuple[IntArray, IntArray, Bounds]:
        found = self._prover.near(np.ascontiguousarray(Q), np.ascontiguousarray(pairs, dtype=np.int64), within)
        table = np.frombuffer(found).reshape(-1, 6)
        table = table[np.lexsort((table[:, 1], table[:, 0]))]
        rows, near = table[:, :2].astype(np.intp).T
        return rows, near, Bounds(table[:, 2].copy(), table[:, 3:].T.copy())


def native_prover(motion: Motion, variant: str = "") -> Prover | None:
    """The compiled prover; None where it was not built.

    Args:
        variant: One of ``instruction_sets()``; the fastest if empty.
    """
    module = load_proof()
    return None if module is None else _Native(module, motion, variant)


def instruction_sets() -> tuple[str, ...]:
    """Instruction sets of the compiled prover on this processor, the fastest last; none where it was not built."""
    module = load_proof()
    return () if module is None else tuple(module.instruction_sets())


def _terms() -> list[float]:
    """The constants, in the order of ``Terms`` in native/model.hpp."""
    return [
        *(motion.ROUNDING, separation.TINY, separation.SHIFT, separation.STEPS_PER_ROUND, separation.DRAWS),
        *(hulls.GAIN, hulls.SHARE, hulls.THIN, hulls.TINY),
        *(tree.FRACTION, tree.MAX_BOUNDS, tree.FAR, tree.BATCH, tree.NEAR, tree.CLOSE, tree.ROUNDS, tree.LAST_ROUNDS),
        *(edge.MAX_EDGE_BOUNDS, overlap.STEPS, overlap.CERTAIN, clearance.CLEARANCE_ROUNDS),
    ]


PROVEN, CLOSE, SPENT = range(3)
"""How a compiled proof ends; any other number means that a stretch was too short to be halved."""

"""Who proves: the compiled code of native/, or the reference in numpy; the last bit of what they say is the same.

The compiled code repeats ``tree``, ``motion``, ``separation`` and ``hulls`` operation by operation and is built from
their tables and constants. It shares no code with the search or its kernel.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import ModuleType
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from planner_service.certify import hulls, motion, separation, tree
from planner_service.certify.motion import Motion
from planner_service.certify.tree import Obstruction, ProofTree, Span
from planner_service.path import JointPath

__all__ = ["Charge", "Proof", "Prover", "instruction_sets", "native_prover", "numpy_prover"]

IntArray = NDArray[np.intp]
Charge = Callable[[int], None]


class Proof(NamedTuple):
    """What became of one: bounds asked, the smallest gap proven for any stretch, and where it ended."""

    asked: int
    proven: float
    obstruction: Obstruction | None


class Prover(Protocol):
    """Proves curves of one robot in one scene."""

    def prove(
        self, path: JointPath, enough: float, roots: tuple[Sequence[Span], IntArray], charge: Charge | None
    ) -> Proof:
        """That the pairs of ``roots`` are more than ``enough`` metres apart on their spans, as ``ProofTree`` does."""


class _Numpy:
    """The reference."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion

    def prove(
        self, path: JointPath, enough: float, roots: tuple[Sequence[Span], IntArray], charge: Charge | None
    ) -> Proof:
        proof = ProofTree(self._motion, path, enough, charge or (lambda bounds: None))
        obstruction = proof.run(*roots)
        return Proof(proof.asked, proof.proven, obstruction)


class _Native:
    """The compiled code."""

    def __init__(self, module: ModuleType, motion: Motion, variant: str) -> None:
        self._reference = _Numpy(motion)
        self._prover = module.Prover(_terms(), *motion.tables, variant)

    def prove(
        self, path: JointPath, enough: float, roots: tuple[Sequence[Span], IntArray], charge: Charge | None
    ) -> Proof:
        if type(path) is not JointPath:  # its curve may be another one
            return self._reference.prove(path, enough, roots, charge)
        spans, rows = roots
        table = np.array(spans, dtype=np.float64).reshape(-1, 2)
        found = self._prover.prove(*path.tables, table, rows, enough, charge)
        asked, most, proven, end, pair, start, stop, s, gap = found
        return Proof(asked, proven, _obstruction(end, pair, (start, stop), s, (gap, enough, most)))


def numpy_prover(motion: Motion) -> Prover:
    """The reference."""
    return _Numpy(motion)


def native_prover(motion: Motion, variant: str = "") -> Prover | None:
    """The compiled prover; None where it was not built.

    Args:
        variant: One of ``instruction_sets()``; the fastest if empty.
    """
    module = _extension()
    return None if module is None else _Native(module, motion, variant)


@lru_cache(maxsize=1)
def _extension() -> ModuleType | None:
    """The compiled module; None where it was not built, which is said once."""
    try:
        from planner_service.certify import _proof
    except ImportError as error:
        logging.getLogger("planner_service").info("proofs without compiled code: %s", error)
        return None
    return _proof


def instruction_sets() -> tuple[str, ...]:
    """Those that compiled proofs can use on this processor, the fastest last; none where they were not built."""
    module = _extension()
    return () if module is None else tuple(module.instruction_sets())


def _terms() -> list[float]:
    """The constants, in the order of ``Terms`` in native/model.hpp."""
    return [
        *(motion.ROUNDING, separation.TINY, separation.SHIFT, separation.STEPS_PER_ROUND),
        *(hulls.GAIN, hulls.SHARE, hulls.THIN, hulls.TINY),
        *(tree.FRACTION, tree.MAX_BOUNDS, tree.FAR, tree.BATCH, tree.NEAR, tree.CLOSE, tree.ROUNDS, tree.LAST_ROUNDS),
        *(4096, 60, 1e-9),
    ]


PROVEN, CLOSE, SPENT = range(3)
"""How a compiled proof ends; else no shorter stretch has numbers of its own."""


def _obstruction(
    end: int, pair: int, span: Span, s: float, known: tuple[float, float, int]
) -> Obstruction | None:
    """In words; ``known`` are the gap found, the one needed, and how many bounds may be asked."""
    gap, enough, most = known
    if end == PROVEN:
        return None
    if end == CLOSE:
        return Obstruction(pair, span, s, tree.too_close(s, gap, enough))
    return Obstruction(pair, span, s, tree.no_end(most if end == SPENT else None), end == SPENT)

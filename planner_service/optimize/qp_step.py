"""One convex step: a quadratic cost with bounds, and an l1 penalty on linearised distances.

It is solved by PIQP (Schwan, Jiang, Kuhn & Jones, CDC 2023), an interior point method: the costs of smooth curves are
so ill-conditioned that first-order methods (OSQP, ProxQP) took 25 to 60 times as long. PIQP's build without SIMD is
used, so that bits do not depend on the processor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planner_service.concurrency.library_import import loaded
from planner_service.geometry.arrays import FloatArray

__all__ = ["Step", "load_solver", "solved"]

ACCURACY = 1e-5


@dataclass(frozen=True, eq=False)
class Step:
    """Minimise x^T H x / 2 + g^T x + price sum(max(0, short - G x)) over x in [low, high].

    Attributes:
        H: (v, v), symmetric.
        gradient, low, high: (v,).
        G: (k, v).
        short: (k,).
        price: The penalty per unit of shortfall.
    """

    H: FloatArray
    gradient: FloatArray
    low: FloatArray
    high: FloatArray
    G: FloatArray
    short: FloatArray
    price: float


def _piqp() -> Any:
    import piqp.piqp_python as piqp

    return piqp


def solved(step: Step) -> FloatArray:
    """The minimising x (v,), within the bounds; the last iterate if rounding stops the solver."""
    piqp = loaded(_piqp)
    v, k = len(step.gradient), len(step.short)
    solver = piqp.SparseSolver()
    settings = solver.settings
    settings.eps_abs = settings.eps_rel = settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = ACCURACY
    settings.max_iter = 60
    infinite = np.full(k, np.inf)
    solver.setup(
        _padded(step.H, k),
        np.concatenate([step.gradient, np.full(k, step.price)]),
        None,
        None,
        _with_slack(step.G) if k else None,
        step.short if k else None,
        infinite if k else None,
        np.concatenate([step.low, np.zeros(k)]),
        np.concatenate([step.high, infinite]),
    )
    solver.solve()
    x: FloatArray = np.asarray(solver.result.x, dtype=np.float64)[:v]
    return np.asarray(np.minimum(np.maximum(np.where(np.isfinite(x), x, 0.0), step.low), step.high))


def load_solver() -> None:
    """Load the libraries now instead of with the first step."""
    zero = np.zeros((1, 1))
    solved(Step(np.eye(1), zero[0], zero[0], zero[0], zero, zero[0], 1.0))


def _padded(H: FloatArray, more: int) -> Any:
    """A symmetric matrix with ``more`` empty rows and columns."""
    from scipy.sparse import csc_matrix

    full = csc_matrix(H)
    pointers = np.concatenate([full.indptr, np.full(more, full.indptr[-1])])
    size = len(H) + more
    return csc_matrix((full.data, full.indices, pointers), shape=(size, size))


def _with_slack(G: FloatArray) -> Any:
    """The matrix [G, 1]."""
    from scipy.sparse import csc_matrix

    full, k = csc_matrix(G), len(G)
    data = np.concatenate([full.data, np.ones(k)])
    indices = np.concatenate([full.indices, np.arange(k)])
    pointers = np.concatenate([full.indptr, full.indptr[-1] + 1 + np.arange(k)])
    return csc_matrix((data, indices, pointers), shape=(k, G.shape[1] + k))

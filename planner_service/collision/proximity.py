"""How far apart near pairs are, and which motion parts them: what trajectory optimisation asks of the checker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner_service.collision.backends import CollisionBackend, NativeBackend
from planner_service.collision.native_kernel import build_kernel
from planner_service.collision.pairs import Parts
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["NearPairs", "measuring_kernel"]


@dataclass(frozen=True, eq=False)
class NearPairs:
    """Pairs that are near at some configurations Q (m, n), by row, k of them.

    Attributes:
        rows: Of Q, (k,).
        pairs: Their numbers, (k,).
        distances: Signed metres, (k,): of an overlap the least way out of it. The separation of both pieces along the
            direction that was found: never above the true distance but for rounding, and below it by a few nanometres
            where pieces are apart.
        points: Where it is measured, on the first piece and on the second, world frame, (k, 2, 3).
        gradients: Of the distances, metres per radian (or per metre of a prismatic joint), (k, n): the direction from
            piece to piece times the difference of both points' Jacobians. Where nearest points are not unique the
            distance has a kink, and this is the derivative to one side, or between both.
    """

    rows: NDArray[np.int64]
    pairs: NDArray[np.int64]
    distances: FloatArray
    points: FloatArray
    gradients: FloatArray


def measuring_kernel(backend: CollisionBackend, robot: Robot, parts: Parts) -> _core.CollisionKernel:
    """The compiled kernel, whichever backend judges."""
    return backend.kernel if isinstance(backend, NativeBackend) else build_kernel(robot, parts)

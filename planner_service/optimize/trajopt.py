"""The TrajOpt family: sequential convex programmes in a trust region (Schulman et al., IJRR 33(9), 2014)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner_service.geometry.shapes import FloatArray, whole
from planner_service.optimize.curve import Samples
from planner_service.optimize.method import Found
from planner_service.optimize.problem import Look, Task
from planner_service.optimize.qp_step import Step, solved

__all__ = ["TrajOpt"]

FIRST_PRICE, PRICE_RISE, PRICES = 10.0, 10.0, 4
"""Cost of a metre that is lacking at a waypoint, in units of a straight curve; and how it rises, so many times in all,
as long as anything is lacking: a price that is high enough makes the penalty exact."""

LACKING = 1e-3
"""Metres, summed over points, from which on something is lacking."""

FIRST_TRUST, LEAST_TRUST, MOST_TRUST, TRUST_AGAIN = 0.1, 1e-4, 0.5, 0.02
"""Radians that a corner's joint may move in a step: at first, at least, at most, and at least after the price rose."""

WORSE, GOOD = 0.2, 0.75
"""Parts of the gain that a step promised: below the one it is not taken, above the other the next may be longer."""

SHRINK, GROW = 0.3, 2.0

SMALL_GAIN, NO_GAIN = 1e-3, 1e-4
"""Part of the merit that a step must gain, or promise, for another one to be worth taking."""


@dataclass(frozen=True)
class TrajOpt:
    """Distances and their gradients are taken from the pieces themselves: exact, and few iterations.

    Attributes:
        iterations: Convexifications at most; eight or so suffice from a path that is free.
    """

    iterations: int = 40

    def __post_init__(self) -> None:
        whole("iterations", self.iterations, 1, 10_000)

    @property
    def name(self) -> str:
        """Lower case, as on the command line."""
        return "trajopt"

    def minimise(self, task: Task, corners: FloatArray, held: tuple[int, int]) -> Found:
        """See ``Method``."""
        descent = _Descent(task, corners, held)
        for done in range(1, self.iterations + 1):
            if descent.advance():
                return Found(descent.corners, done)
        return Found(descent.corners, self.iterations)


@dataclass(frozen=True, eq=False)
class _Convex:
    """A convex model around corners: cost matrix, gradient; of each near pair its slope (k, v) and what is lacking."""

    samples: Samples
    H: FloatArray
    gradient: FloatArray
    slopes: FloatArray
    short: FloatArray


class _Descent:
    """Where the corners stand, what that is worth, and how far the next step may go."""

    def __init__(self, task: Task, corners: FloatArray, held: tuple[int, int]) -> None:
        self._task, self.corners = task, corners
        self._free = slice(held[0], len(corners) - held[1])
        self._price, self._risen = FIRST_PRICE, 1
        self._trust = FIRST_TRUST
        self._look = self._seen(corners)
        self._merit, self._lacking = self._worth(self._look, corners)

    def advance(self) -> bool:
        """One convexification, and steps on it until one is taken; whether it was the last."""
        model = self._model()
        done = True
        for x, promised in self._steps(model):
            moved = self.corners.copy()
            moved[self._free] = np.clip(moved[self._free] + x, self._task.lower, self._task.upper)
            look = self._seen(moved)
            merit, lacking = self._worth(look, moved)
            gained = self._merit - merit
            if gained > 0.0 and gained >= WORSE * promised:
                if gained >= GOOD * promised:
                    self._trust = min(GROW * self._trust, MOST_TRUST)
                done = gained < SMALL_GAIN * self._merit
                self.corners, self._look, self._merit, self._lacking = moved, look, merit, lacking
                break
            self._trust *= SHRINK
        return done and not self._dearer()

    def _dearer(self) -> bool:
        """Raise the price if something is still lacking; False if not, or if it has risen enough."""
        if self._lacking < LACKING or self._risen == PRICES:
            return False
        self._merit += self._price * (PRICE_RISE - 1.0) * self._lacking
        self._price *= PRICE_RISE
        self._risen += 1
        self._trust = max(self._trust, TRUST_AGAIN)
        return True

    def _seen(self, corners: FloatArray) -> Look:
        return self._task.look(self._task.samples(corners), corners, self._task.reach)

    def _worth(self, look: Look, corners: FloatArray) -> tuple[float, float]:
        """The merit of corners, and what is lacking there."""
        lacking = self._task.shortfall(look)
        return self._task.cost(look.samples, corners) + self._price * lacking, lacking

    def _model(self) -> _Convex:
        task, corners, look = self._task, self.corners, self._look
        samples = look.samples
        H = 2.0 * task.curvature(samples, len(corners))
        gradient = np.add.accumulate(H[:, :, None] * corners[None], axis=1)[:, -1][self._free]
        task.gradients += len(look.near.rows)
        short = look.targets - look.near.distances
        return _Convex(samples, H[self._free, self._free], gradient, self._slopes(look), short)

    def _slopes(self, look: Look) -> FloatArray:
        """How the distance of each near pair changes with each joint of each free corner, (k, v)."""
        weights = look.samples.matrix(len(self.corners))[look.near.rows, self._free]
        slopes = weights[:, :, None] * look.near.gradients[:, None, :]
        return slopes.reshape(len(weights), weights.shape[1] * self.corners.shape[1])

    def _steps(self, model: _Convex) -> Iterator[tuple[FloatArray, float]]:
        """Moves of the free corners, ever shorter, each with what it promises to gain; until that is not worth it."""
        task, here = self._task, self.corners[self._free]
        n = here.shape[1]
        H = np.asarray(np.kron(model.H, np.eye(n)), dtype=np.float64)
        sizes = np.add.accumulate(np.abs(model.slopes), axis=1)[:, -1] if model.slopes.size else np.zeros(0)
        while self._trust >= LEAST_TRUST:
            low = np.maximum(task.lower - here, -self._trust).ravel()
            high = np.minimum(task.upper - here, self._trust).ravel()
            active = model.short > -sizes * self._trust  # the others keep their distance whatever the step
            slopes, short = model.slopes[active], model.short[active]
            x = solved(Step(H, model.gradient.ravel(), low, high, slopes, short, self._price / task.between))
            moved = self.corners.copy()
            moved[self._free] += x.reshape(here.shape)
            left = short - _times(slopes, x)
            lacking = float(np.add.accumulate(np.maximum(left, 0.0))[-1]) / task.between if len(left) else 0.0
            promised = self._merit - task.cost(model.samples, moved) - self._price * lacking
            if promised <= NO_GAIN * self._merit:
                return
            yield x.reshape(here.shape), promised


def _times(matrix: FloatArray, x: FloatArray) -> FloatArray:
    """A product, summed in order."""
    return np.asarray(np.add.accumulate(matrix * x, axis=1)[:, -1]) if matrix.size else np.zeros(len(matrix))

"""TrajOpt: sequential convex programmes in a trust region (Schulman et al., IJRR 33(9), 2014)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import whole
from planner_service.optimize.curve import Samples
from planner_service.optimize.problem import CurveProblem, MethodResult, PairDistances
from planner_service.optimize.qp_step import Step, solved

__all__ = ["TrajOpt"]

FIRST_PRICE, PRICE_RISE, PRICES = 10.0, 10.0, 4
"""The first penalty for each metre of shortfall at a waypoint, in units of a straight curve; the factor by which it
rises while there is shortfall; and how many penalties there are. One that is high enough makes the result exact."""

MIN_SHORTFALL = 1e-3
"""Metres, summed over points; less counts as none."""

FIRST_TRUST, MIN_TRUST, MAX_TRUST, TRUST_AGAIN = 0.1, 1e-4, 0.5, 0.02
"""Radians that a corner's joint may move in a step: at first, at least, at most, and at least after the price rises."""

WORSE, GOOD = 0.2, 0.75
"""Shares of a step's predicted gain: below the first it is rejected, above the second the next may be longer."""

SHRINK, GROW = 0.3, 2.0

SMALL_GAIN, NO_GAIN = 1e-3, 1e-4
"""Shares of the merit that a step must gain, or be predicted to gain, to continue."""


@dataclass(frozen=True)
class TrajOpt:
    """Computes distances and gradients from the pieces themselves: exact, with few iterations.

    Attributes:
        iterations: The most convexifications; about eight suffice from a free path.
    """

    name: ClassVar[str] = "trajopt"

    iterations: int = 40

    def __post_init__(self) -> None:
        whole("iterations", self.iterations, 1, 10_000)

    def minimise(self, problem: CurveProblem, corners: FloatArray, held: tuple[int, int]) -> MethodResult:
        """See ``Method``."""
        descent = _Descent(problem, corners, held)
        for done in range(1, self.iterations + 1):
            if descent.advance():
                return MethodResult(descent.corners, done)
        return MethodResult(descent.corners, self.iterations)


@dataclass(frozen=True, eq=False)
class _Convex:
    """A convex model around corners: cost matrix, gradient, and for each near pair its slope (k, v) and shortfall."""

    samples: Samples
    H: FloatArray
    gradient: FloatArray
    slopes: FloatArray
    short: FloatArray


class _Descent:
    """The current corners, their merit, and the trust region of the next step."""

    def __init__(self, problem: CurveProblem, corners: FloatArray, held: tuple[int, int]) -> None:
        self._problem, self.corners = problem, corners
        self._free = slice(held[0], len(corners) - held[1])
        self._price, self._risen = FIRST_PRICE, 1
        self._trust = FIRST_TRUST
        self._look = self._seen(corners)
        self._merit, self._lacking = self._worth(self._look, corners)

    def advance(self) -> bool:
        """One convexification, with steps on it until one is accepted; returns whether it was the last."""
        model = self._model()
        done = True
        for x, promised in self._steps(model):
            moved = self.corners.copy()
            moved[self._free] = np.clip(moved[self._free] + x, self._problem.lower, self._problem.upper)
            look = self._seen(moved)
            merit, lacking = self._worth(look, moved)
            gained = self._merit - merit
            if gained > 0.0 and gained >= WORSE * promised:
                if gained >= GOOD * promised:
                    self._trust = min(GROW * self._trust, MAX_TRUST)
                done = gained < SMALL_GAIN * self._merit
                self.corners, self._look, self._merit, self._lacking = moved, look, merit, lacking
                break
            self._trust *= SHRINK
        return done and not self._dearer()

    def _dearer(self) -> bool:
        """Raise the price if there is shortfall; False if there is none, or the price is at its highest."""
        if self._lacking < MIN_SHORTFALL or self._risen == PRICES:
            return False
        self._merit += self._price * (PRICE_RISE - 1.0) * self._lacking
        self._price *= PRICE_RISE
        self._risen += 1
        self._trust = max(self._trust, TRUST_AGAIN)
        return True

    def _seen(self, corners: FloatArray) -> PairDistances:
        return self._problem.look(self._problem.samples(corners), corners, self._problem.reach)

    def _worth(self, look: PairDistances, corners: FloatArray) -> tuple[float, float]:
        """The merit of corners, and their shortfall."""
        lacking = self._problem.shortfall(look)
        return self._problem.cost(look.samples, corners) + self._price * lacking, lacking

    def _model(self) -> _Convex:
        problem, corners, look = self._problem, self.corners, self._look
        samples = look.samples
        H = 2.0 * problem.curvature(samples, len(corners))
        gradient = np.add.accumulate(H[:, :, None] * corners[None], axis=1)[:, -1][self._free]
        problem.gradients += len(look.near.rows)
        short = look.targets - look.near.distances
        return _Convex(samples, H[self._free, self._free], gradient, self._slopes(look), short)

    def _slopes(self, look: PairDistances) -> FloatArray:
        """The derivatives of each near pair's distance by each joint of each free corner, (k, v)."""
        weights = look.samples.matrix(len(self.corners))[look.near.rows, self._free]
        slopes = weights[:, :, None] * look.near.gradients[:, None, :]
        return slopes.reshape(len(weights), weights.shape[1] * self.corners.shape[1])

    def _steps(self, model: _Convex) -> Iterator[tuple[FloatArray, float]]:
        """Ever shorter moves of the free corners, each with its predicted gain, until that is too small."""
        problem, free = self._problem, self.corners[self._free]
        n = free.shape[1]
        H = np.asarray(np.kron(model.H, np.eye(n)), dtype=np.float64)
        sizes = np.add.accumulate(np.abs(model.slopes), axis=1)[:, -1] if model.slopes.size else np.zeros(0)
        while self._trust >= MIN_TRUST:
            low = np.maximum(problem.lower - free, -self._trust).ravel()
            high = np.minimum(problem.upper - free, self._trust).ravel()
            active = model.short > -sizes * self._trust  # the others keep their distance with any step
            slopes, short = model.slopes[active], model.short[active]
            x = solved(Step(H, model.gradient.ravel(), low, high, slopes, short, self._price / problem.between))
            moved = self.corners.copy()
            moved[self._free] += x.reshape(free.shape)
            left = short - _times(slopes, x)
            lacking = float(np.add.accumulate(np.maximum(left, 0.0))[-1]) / problem.between if len(left) else 0.0
            promised = self._merit - problem.cost(model.samples, moved) - self._price * lacking
            if promised <= NO_GAIN * self._merit:
                return
            yield x.reshape(free.shape), promised


def _times(matrix: FloatArray, x: FloatArray) -> FloatArray:
    """The product of a matrix and a vector, summed in order."""
    return np.asarray(np.add.accumulate(matrix * x, axis=1)[:, -1]) if matrix.size else np.zeros(len(matrix))

"""Is the compiled kernel there, and is what is used what FCL says of every pair? Asked on the same random states."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass

import numpy as np

from planner_service.collision.checker import CollisionChecker
from planner_service.collision.kernel import instruction_sets
from planner_service.errors import InvalidRequest
from planner_service.geometry import FloatArray
from planner_service.robot import Robot
from planner_service.scene import Scene

__all__ = ["MAX_STATES", "Health", "examine"]

MAX_STATES = 1_000_000


@dataclass(frozen=True)
class Health:
    """What an examination found.

    Attributes:
        instruction_set: What the kernel uses; None where it was not built and numpy stands in for it.
        available: What it could use on this processor.
        states: Configurations judged by both.
        colliding: How many of them collide, as the reference says.
        differences: How many of them the two judge differently, by verdict or by what touches.
        kernel_us, reference_us: Microseconds per configuration, asked one by one.
    """

    instruction_set: str | None
    available: tuple[str, ...]
    states: int
    colliding: int
    differences: int
    kernel_us: float
    reference_us: float

    @property
    def agrees(self) -> bool:
        """Whether both said the same of every configuration."""
        return self.differences == 0


def examine(robot: Robot, scene: Scene, *, states: int = 1000, seed: int = 0) -> Health:
    """Judge random configurations within the joint limits with the kernel, if it is there, and by FCL pair by pair.

    Raises:
        InvalidRequest: ``states`` is no integer from 1 to 1,000,000.
    """
    if isinstance(states, bool) or not isinstance(states, int) or not 1 <= states <= MAX_STATES:
        raise InvalidRequest("states", states, f"an integer from 1 to {MAX_STATES:,}")
    chance = random.Random(seed)
    ranges = list(zip(robot.limits.lower.tolist(), robot.limits.upper.tolist(), strict=True))
    Q = np.array([[chance.uniform(*range_) for range_ in ranges] for _ in range(states)])
    kernel, reference = CollisionChecker(robot, scene), CollisionChecker(robot, scene, backend="fcl")
    told, kernel_us = _judged(kernel, Q)
    expected, reference_us = _judged(reference, Q)
    differences = sum(a != b for a, b in zip(told, expected, strict=True))
    colliding = sum(pair is not None for pair in expected)
    return Health(kernel.instruction_set, instruction_sets(), states, colliding, differences, kernel_us, reference_us)


def _judged(checker: CollisionChecker, Q: FloatArray) -> tuple[list[tuple[str, str] | None], float]:
    """What touches first at each configuration, None where it is free, and microseconds per configuration."""
    clock = time.perf_counter()
    hits = [checker.edge_hit(q, q) for q in Q]
    seconds = time.perf_counter() - clock
    return [None if hit is None else (hit.a, hit.b) for hit in hits], seconds / len(Q) * 1e6

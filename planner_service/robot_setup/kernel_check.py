"""Is the compiled code there, and does it say what the references say? Asked of random states and of edges there."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from planner_service.certify import Certifier
from planner_service.certify.prover import instruction_sets as proof_instruction_sets
from planner_service.collision import CollisionChecker
from planner_service.collision.native_kernel import instruction_sets
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import whole
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["MAX_STATES", "Health", "Opinions", "examine"]

MAX_STATES = 1_000_000

STATES_PER_EDGE = 20
"""One edge is proven for so many states judged: a proof by the reference takes milliseconds."""

Judge = Callable[[FloatArray], tuple[bool, Any]]
"""Whether what is asked is refused, and all that is told of it."""

SHARE = 0.1
"""Part of the way to the next state that an edge goes."""


@dataclass(frozen=True)
class Opinions:
    """What compiled code and its reference say of the same questions.

    Attributes:
        instruction_set: What the compiled code uses; None where it was not built and numpy stands in for it.
        available: What it could use on this processor.
        asked: Questions put to both.
        refused: To how many the reference says that it collides, or is not proven.
        differences: To how many they say something else.
        us, reference_us: Microseconds per question, asked one by one.
    """

    instruction_set: str | None
    available: tuple[str, ...]
    asked: int
    refused: int
    differences: int
    us: float
    reference_us: float


@dataclass(frozen=True)
class Health:
    """What an examination found.

    Attributes:
        checks: Of states: what the kernel says touches first, and what FCL says that is asked of every pair.
        proofs: Of short edges: certificates, to the last bit.
    """

    checks: Opinions
    proofs: Opinions

    @property
    def agrees(self) -> bool:
        """Whether all of it is the same."""
        return self.checks.differences == self.proofs.differences == 0


def examine(robot: Robot, scene: Scene, *, states: int = 1000, seed: int = 0) -> Health:
    """Judge random configurations within the joint limits, and prove one short edge for twenty of them, both ways.

    Raises:
        InvalidRequest: ``states`` is no integer from 1 to 1,000,000.
    """
    whole("states", states, 1, MAX_STATES)
    chance = random.Random(seed)
    ranges = list(zip(robot.limits.lower.tolist(), robot.limits.upper.tolist(), strict=True))
    Q = np.array([[chance.uniform(*range_) for range_ in ranges] for _ in range(states)])
    kernel, reference = CollisionChecker(robot, scene), CollisionChecker(robot, scene, backend="fcl")
    checks = _compared(kernel.instruction_set, instruction_sets(), Q, (_touching(kernel), _touching(reference)))
    chosen = Q[::STATES_PER_EDGE]
    edges = [np.array([a, a + SHARE * (b - a)]) for a, b in pairwise([*chosen, Q[0]])]
    provers = (_proven(Certifier(robot, scene)), _proven(Certifier(robot, scene, backend="numpy")))
    available = proof_instruction_sets()
    return Health(checks, _compared(available[-1] if available else None, available, edges, provers))


def _touching(checker: CollisionChecker) -> Judge:
    """What touches first at a configuration."""

    def judge(q: FloatArray) -> tuple[bool, Any]:
        hit = checker.edge_hit(q, q)
        return hit is not None, hit and (hit.a, hit.b)

    return judge


def _proven(certifier: Certifier) -> Judge:
    """The certificate of an edge."""

    def judge(edge: FloatArray) -> tuple[bool, Any]:
        certificate = certifier.certify(edge)
        return not certificate.certified, certificate

    return judge


def _compared(
    used: str | None,
    available: tuple[str, ...],
    questions: Sequence[FloatArray] | FloatArray,
    judges: tuple[Judge, Judge],
) -> Opinions:
    """Ask compiled code and reference the same."""
    said, took = [], []
    for judge in judges:
        clock = time.perf_counter()
        said.append([judge(question) for question in questions])
        took.append((time.perf_counter() - clock) / len(questions) * 1e6)
    differences = sum(a != b for a, b in zip(*said, strict=True))
    refused = sum(verdict[0] for verdict in said[1])
    return Opinions(used, available, len(questions), refused, differences, *took)

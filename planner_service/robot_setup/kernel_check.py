"""Whether the compiled code was built and gives the answers of its references, at random states and on short edges."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
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

__all__ = ["MAX_STATES", "Comparison", "Health", "examine"]

MAX_STATES = 1_000_000

STATES_PER_EDGE = 20
"""One edge is proven for so many states judged: a proof by the reference takes milliseconds."""

Backend = Callable[[FloatArray], tuple[bool, Any]]
"""Answers a question: whether it is refused, and the whole answer."""

SHARE = 0.1
"""Part of the way to the next state that an edge goes."""


@dataclass(frozen=True)
class Comparison:
    """The answers of compiled code and of its reference to the same questions.

    Attributes:
        instruction_set: What the compiled code uses; None where it was not built and numpy stands in for it.
        available: What it could use on this processor.
        asked: Questions put to both.
        refused: How many of these collide, or are not proven, according to the reference.
        differences: How many have different answers.
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
        checks: Of states: which pair touches first, by the kernel and by FCL asked about every pair.
        proofs: Of short edges: their certificates, to the last bit.
    """

    checks: Comparison
    proofs: Comparison

    @property
    def agrees(self) -> bool:
        """Whether all answers are the same."""
        return self.checks.differences == self.proofs.differences == 0


def examine(robot: Robot, scene: Scene, *, states: int = 1000, seed: int = 0) -> Health:
    """Check random configurations within the joint limits, and prove a short edge at every twentieth, both ways.

    Raises:
        InvalidRequest: ``states`` is no integer from 1 to 1,000,000.
    """
    whole("states", states, 1, MAX_STATES)
    chance = random.Random(seed)
    ranges = list(zip(robot.limits.lower.tolist(), robot.limits.upper.tolist(), strict=True))
    Q = np.array([[chance.uniform(*range_) for range_ in ranges] for _ in range(states)])
    kernel, reference = CollisionChecker(robot, scene), CollisionChecker(robot, scene, backend="fcl")
    checkers = (partial(_first_contact, kernel), partial(_first_contact, reference))
    checks = _compared(kernel.instruction_set, instruction_sets(), Q, checkers)
    chosen = Q[::STATES_PER_EDGE]
    edges = [np.array([a, a + SHARE * (b - a)]) for a, b in pairwise([*chosen, Q[0]])]
    certifiers = Certifier(robot, scene), Certifier(robot, scene, backend="numpy")
    provers = (partial(_certificate, certifiers[0]), partial(_certificate, certifiers[1]))
    available = proof_instruction_sets()
    return Health(checks, _compared(available[-1] if available else None, available, edges, provers))


def _first_contact(checker: CollisionChecker, q: FloatArray) -> tuple[bool, Any]:
    hit = checker.edge_hit(q, q)
    return hit is not None, hit and (hit.a, hit.b)


def _certificate(certifier: Certifier, edge: FloatArray) -> tuple[bool, Any]:
    certificate = certifier.certify(edge)
    return not certificate.certified, certificate


def _compared(
    used: str | None,
    available: tuple[str, ...],
    questions: Sequence[FloatArray] | FloatArray,
    backends: tuple[Backend, Backend],
) -> Comparison:
    """The answers of compiled code and of its reference."""
    answers, took = [], []
    for backend in backends:
        clock = time.perf_counter()
        answers.append([backend(question) for question in questions])
        took.append((time.perf_counter() - clock) / len(questions) * 1e6)
    differences = sum(a != b for a, b in zip(*answers, strict=True))
    refused = sum(answer[0] for answer in answers[1])
    return Comparison(used, available, len(questions), refused, differences, *took)

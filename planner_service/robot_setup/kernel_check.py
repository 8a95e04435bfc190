"""Whether compiled code gives the answers of its judges on this machine: states, searches, proofs, timed paths."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from planner_service.certify import Certifier
from planner_service.certify.certifier import Prover
from planner_service.certify.certifier import instruction_sets as proof_instruction_sets
from planner_service.collision import CollisionChecker
from planner_service.collision.budget import CheckBudgetSpent
from planner_service.collision.native_kernel import instruction_sets
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import whole
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.search.planners import BalancedRRTConnect
from planner_service.search.problem import SearchOracle, SearchProblem
from planner_service.smoothing.smoothing import pulled_in, shortcut
from planner_service.timing.laws import ToppRa

__all__ = ["MAX_STATES", "Comparison", "Health", "examine"]

MAX_STATES = 1_000_000

STATES_PER_EDGE = 20
"""One edge is proven for so many states judged."""

Question = TypeVar("Question", FloatArray, JointPath)

STATES_PER_PATH = 100
"""One path is searched, and one timed, for so many states judged: by their judges that takes tens of milliseconds."""

MAX_SEARCH = 10_000
"""States after which a search is given up."""

SAME_DURATION = 1e-9
"""Relative: toppra's own tolerance is larger than what is found, 5e-11."""

BLEND = 0.3
"""Share of a line that the blend at its end takes."""

SHARE = 0.1
"""Part of the way to the next state that an edge goes."""


@dataclass(frozen=True)
class Comparison:
    """The answers of compiled code and of its judge to the same questions.

    Attributes:
        instruction_set: What the compiled code uses.
        available: What it could use on this processor.
        asked: Questions put to both.
        refused: How many of these collide, or are not proven, according to the judge.
        differences: How many have different answers.
        us, reference_us: Microseconds per question, asked one by one.
    """

    instruction_set: str
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
        searches: Of free states: the shortened path from one to the next to the last bit, and what it cost.
        proofs: Of short edges: their certificates to the last bit, by the fastest instructions and by plain ones.
        timing: Of blended paths: their durations by TOPP-RA, compared with the toppra library to 1e-9.
    """

    checks: Comparison
    searches: Comparison
    proofs: Comparison
    timing: Comparison

    @property
    def agrees(self) -> bool:
        """Whether all answers are the same."""
        return not any(part.differences for part in (self.checks, self.searches, self.proofs, self.timing))


def examine(robot: Robot, scene: Scene, *, states: int = 1000, seed: int = 0) -> Health:
    """Check random configurations within the joint limits, prove a short edge at every twentieth, and search and time a
    path through some of them for every hundredth, both ways.

    Raises:
        InvalidRequest: ``states`` is no integer from 1 to 1,000,000.
    """
    whole("states", states, 1, MAX_STATES)
    chance = random.Random(seed)
    ranges = list(zip(robot.limits.lower.tolist(), robot.limits.upper.tolist(), strict=True))
    Q = np.array([[chance.uniform(*range_) for range_ in ranges] for _ in range(states)])
    kernel, reference = CollisionChecker(robot, scene), CollisionChecker(robot, scene, backend="fcl")
    checkers = (partial(_first_contact, kernel), partial(_first_contact, reference))
    checks = _compared(instruction_sets()[-1], instruction_sets(), Q, checkers)
    free = [q for q in Q if kernel.state_is_free(q)][: 1 + states // STATES_PER_PATH]
    ends = [np.array(pair) for pair in pairwise([*free, *free[:1]])]
    searchers = partial(_searched, kernel), partial(_searched, reference)
    searches = _compared(instruction_sets()[-1], instruction_sets(), ends, searchers)
    chosen = Q[::STATES_PER_EDGE]
    edges = [np.array([a, a + SHARE * (b - a)]) for a, b in pairwise([*chosen, Q[0]])]
    available, plain = proof_instruction_sets(), Certifier(robot, scene)
    plain.prover = Prover(plain.motion, available[0])
    provers = (partial(_certificate, Certifier(robot, scene)), partial(_certificate, plain))
    proofs = _compared(available[-1], available, edges, provers)
    paths = [_path(Q[k : k + 4]) for k in range(0, max(1, states - 3), STATES_PER_PATH)]
    timers = partial(_timed, ToppRa(), robot), partial(_timed, ToppRa(backend="toppra"), robot)
    timers[1](paths[0])  # loads the toppra library
    return Health(checks, searches, proofs, _compared("baseline", ("baseline",), paths, timers))


def _searched(checker: CollisionChecker, ends: FloatArray) -> tuple[bool, Any]:
    limits, before = checker.robot.limits, checker.counts
    oracle = SearchOracle(checker, ends[:1], ends[1:])
    problem = SearchProblem(ends[0], ends[1:], limits.lower, limits.upper, oracle)
    try:
        with checker.limited(states=MAX_SEARCH):
            found = BalancedRRTConnect().search(problem).waypoints
    except CheckBudgetSpent:
        found = None
    if found is not None:
        found = pulled_in(shortcut(found, oracle, np.random.default_rng(0)), oracle)
    return found is None, (None if found is None else found.tolist(), checker.counts - before)


def _path(points: FloatArray) -> JointPath:
    """Through the points, with blends where it does not turn back."""
    sharp = JointPath(points)
    room = np.minimum(np.diff(sharp.knots)[:-1], np.diff(sharp.knots)[1:])
    inner = [0.0 if sharp.turns_back(k) else BLEND * float(room[k - 1]) for k in range(1, len(points) - 1)]
    return sharp.with_blends([0.0, *inner, 0.0][: len(points)])


@dataclass(frozen=True)
class _Seconds:
    """A duration."""

    value: float

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Seconds) and math.isclose(self.value, other.value, rel_tol=SAME_DURATION)


def _timed(law: ToppRa, robot: Robot, path: JointPath) -> tuple[bool, Any]:
    return False, _Seconds(law.time_path(path, robot.limits).duration)


def _first_contact(checker: CollisionChecker, q: FloatArray) -> tuple[bool, Any]:
    hit = checker.edge_hit(q, q)
    return hit is not None, hit and (hit.a, hit.b)


def _certificate(certifier: Certifier, edge: FloatArray) -> tuple[bool, Any]:
    certificate = certifier.certify(edge)
    return not certificate.certified, certificate


def _compared(
    used: str,
    available: tuple[str, ...],
    questions: Sequence[Question] | FloatArray,
    backends: tuple[Callable[[Question], tuple[bool, Any]], Callable[[Question], tuple[bool, Any]]],
) -> Comparison:
    """The answers of compiled code and of its judge."""
    answers, took = [], []
    for backend in backends:
        clock = time.perf_counter()
        answers.append([backend(question) for question in questions])
        took.append((time.perf_counter() - clock) / max(1, len(questions)) * 1e6)
    differences = sum(a != b for a, b in zip(*answers, strict=True))
    refused = sum(answer[0] for answer in answers[1])
    return Comparison(used, available, len(questions), refused, differences, *took)

"""Calls from several threads run at the same time, and each gets what it would get alone: bits, counts and names."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np
import pytest

import planner_service as ps
from planner_service.collision.checker import BackendName
from planner_service.geometry.arrays import FloatArray

Work = Callable[[], object]


@pytest.fixture(autouse=True)
def _often_another_thread() -> Iterator[None]:
    """Let the interpreter go from one thread to another as often as it can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def in_threads(works: Sequence[Sequence[Work]]) -> list[list[object]]:
    """What some works return, one after the other, of each thread; all threads start at once."""
    found: list[list[object]] = [[] for _ in works]
    together = threading.Barrier(len(works))

    def run(k: int) -> None:
        together.wait(20.0)
        found[k] += [work() for work in works[k]]

    threads = [threading.Thread(target=run, args=(k,), daemon=True) for k in range(len(works))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    return found


class Meeting:
    """An edge step that waits, at the first edge of each of two threads, for the other."""

    def __init__(self) -> None:
        self._met, self._own = threading.Barrier(2), threading.local()

    def segments(self, dq: Sequence[float], reach: Sequence[float]) -> int:
        """See ``EdgeStep``."""
        if not hasattr(self._own, "met"):
            self._own.met = True
            self._met.wait(20.0)
        return ps.MotionStep().segments(dq, reach)


def test_two_calls_of_one_service_are_under_way_at_the_same_time() -> None:
    service = ps.PlannerService("planar2", "discs", edge_step=Meeting())
    line = ps.PlanRequest((0.0, 0.0), (0.3, -0.3), time_limit=None)
    found = in_threads([[lambda: service.plan(line).ok], [lambda: service.follow(((0.0, 0.0), (0.2, 0.1))).ok]])
    assert found == [[True], [True]]


def told(result: ps.PlanResult) -> tuple[object, ...]:
    """All of a plan but the clock's part."""
    path = None if result.path is None else (result.path.waypoints.tobytes(), result.path.blends.tobytes())
    times = None if result.trajectory is None else result.trajectory.coefficients.tobytes()
    stages = [(report.stage, report.counts, report.note) for report in result.stages]
    return path, times, stages, result.attempts, result.notes, str(result.failure), str(result.certificate)


def works(service: ps.PlannerService) -> list[Work]:
    """Plans that search, that fail, and whose line is free, a pick, proofs, and checks with their counts and names."""
    robot, home, checker = service.robot, service.robot.home, service.checker
    rng = np.random.default_rng(4)
    Q = rng.uniform(robot.limits.lower, robot.limits.upper, (80, robot.n))
    free = Q[checker.states_are_free(Q)]

    def planned(k: int) -> Work:
        request = ps.PlanRequest(home, free[k], seed=k, time_limit=None, max_checks=3_000)
        return lambda: told(service.plan(request))

    def proven(k: int) -> Work:
        return lambda: str(service.certify(np.stack([home, free[k]])))

    def picked() -> object:
        grasps = ps.top_grasps(robot, service.scene.obstacle("blue_block"))
        unhurried = ps.PlanRequest(home, home, time_limit=None)
        task = ps.pick(service, home, "blue_block", grasps, ps.Handling(support="bin_floor", request=unhurried))
        return [(segment.name, told(segment.result)) for segment in task.segments], task.counts, str(task.failure)

    return [*map(planned, range(6)), *map(proven, range(3)), *(judged(checker, free[k:]) for k in (0, 3)), picked]


def judged(checker: ps.CollisionChecker, Q: FloatArray) -> Work:
    """The edges between configurations (m, n): verdicts, counts and hits."""

    def edges() -> object:
        tally = checker.ledger.own
        before, hits = tally.counts, tally.hits.copy()
        verdicts = [str(checker.edge_hit(a, b)) for a, b in pairwise(Q)]
        return verdicts, str(checker.last_hit), tally.counts - before, tally.hits - hits

    return edges


def require_same(asked: list[Work]) -> None:
    """In 2 and 8 threads, each of which begins elsewhere, all is as alone."""
    alone = [work() for work in asked]
    for threads in (2, 8):
        starts = [k % len(asked) for k in range(threads)]
        found = in_threads([asked[k:] + asked[:k] for k in starts])
        back = [answers[len(asked) - k :] + answers[: len(asked) - k] for k, answers in zip(starts, found, strict=True)]
        assert back == [alone] * threads


def test_mixed_calls_of_one_service_are_the_same_in_2_and_8_threads() -> None:
    require_same(works(ps.PlannerService("wxai", "bin")))


@pytest.mark.parametrize("backend", ["native", "fcl"])
def test_checks_of_one_checker_are_the_same_in_2_and_8_threads(backend: BackendName) -> None:
    checker = ps.CollisionChecker(ps.load_robot("planar2"), ps.load_scene("discs"), backend=backend)
    Q = np.random.default_rng(2).uniform(-2.6, 2.6, (12, 2))
    require_same([judged(checker, Q[k : k + 6]) for k in range(4)])

"""Threads: plans, checks, limits and cancels of one service at once, with the counts and bits that each has alone."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.attack.harness import Case, Part, Wrong
from benchmarks.worlds.contacts import random_states

__all__ = ["Attack", "Reference", "digest"]

THREADS = 4
SCENES = ("table", "post", "bin")
WHAT = ("plan", "check", "certify", "limit", "cancel")


def requests(service: ps.PlannerService, count: int = 8) -> list[ps.PlanRequest]:
    """Requests whose answers the clock has no say in."""
    rng, robot = np.random.default_rng(5), service.robot
    Q = random_states(robot, 400, rng)
    goals = Q[service.checker.states_are_free(Q)][:count]
    return [ps.PlanRequest(robot.home, goal, seed=k, time_limit=None, max_checks=6_000) for k, goal in enumerate(goals)]


@dataclass(frozen=True, eq=False)
class Reference:
    """A service, requests, and the digests of their plans made one after another."""

    service: ps.PlannerService
    requests: list[ps.PlanRequest]
    digests: list[tuple[Any, ...]]

    @classmethod
    def of(cls, scene: str) -> Reference:
        """In a scene of the WidowX AI."""
        service = ps.PlannerService("wxai", scene)
        asked = requests(service)
        return cls(service, asked, [digest(service.plan(request)) for request in asked])

    def require_same(self, number: int, law: str) -> None:
        """Break a law if a plan is another now."""
        if digest(self.service.plan(self.requests[number])) != self.digests[number]:
            raise Wrong(law)


def digest(result: ps.PlanResult) -> tuple[Any, ...]:
    """What of a plan has to be the same whenever it is made."""
    path = b"" if result.path is None else result.path.waypoints.tobytes() + result.path.blends.tobytes()
    times = b"" if result.trajectory is None else result.trajectory.coefficients.tobytes()
    return path, times, tuple((report.stage, report.counts) for report in result.stages)


class Attack(Part):
    name = "threads"
    what = "plans, checks, limits and cancels of one service in several threads, compared with each alone"
    limit = 20.0

    def __init__(self) -> None:
        super().__init__()
        self._known: dict[str, Reference] = {}

    def draw(self, rng: np.random.Generator) -> Case:
        works = [[[str(w), int(rng.integers(8))] for w in rng.choice(WHAT, 5)] for _ in range(THREADS)]
        return {"scene": str(rng.choice(SCENES)), "work": works}

    def run(self, case: Case) -> int:
        name = case["scene"]
        known = self._known[name] = self._known.get(name) or Reference.of(name)
        wrong: list[BaseException] = []

        def work(items: list[Any]) -> None:
            try:
                for what, number in items:
                    self._one(what, known, number % len(known.requests))
            except BaseException as error:
                wrong.append(error)

        threads = [threading.Thread(target=work, args=(items,), daemon=True) for items in case["work"]]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if wrong:
            raise wrong[0]
        known.require_same(0, "after threads a plan is the same")
        return max(1, sum(map(len, case["work"])))

    def _one(self, what: str, known: Reference, number: int) -> None:
        service, request = known.service, known.requests[number]
        self.counted[what] += 1
        if what == "plan":
            known.require_same(number, "among threads a plan is the same")
        elif what == "cancel":
            token = ps.CancelToken()
            timer = threading.Timer(0.005, token.cancel)
            timer.start()
            found = service.plan(request, cancel=token)
            timer.cancel()
            if found.deterministic and digest(found) != known.digests[number]:
                raise Wrong("a plan that was not cancelled is the same")
        elif what == "certify":
            service.certify(np.stack([request.start, request.start]))
        elif what == "limit":
            checker = service.checker.variant()
            with checker.limited(states=10**6):
                checker.states_are_free(np.stack([request.start]))
        elif not service.checker.state_is_free(request.start):
            raise Wrong("a state is judged the same among threads")

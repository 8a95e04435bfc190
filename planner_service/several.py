"""The best of several plans: each way round has an optimum of its own, and a seed finds one way."""

from __future__ import annotations

import json
import math
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.json_file import Node
from planner_service.outcome import PlanResult
from planner_service.request import PlanRequest
from planner_service.result_record import read_result, result_record
from planner_service.service import PlannerService

__all__ = ["best_of_seeds", "plan_seeds"]

LACKING = 1e-3
"""Metres of distance, summed over a curve, by which two that lack some are not told apart."""


def best_of_seeds(
    service: PlannerService, request: PlanRequest, seeds: Sequence[int], *, processes: int = 1
) -> PlanResult:
    """The best plan of a request with any of some seeds: that lacks least distance, and of such the fastest.

    Without a plan it is the first failure. Ties go to the seed that comes first, however many processes there are.

    Raises:
        InvalidRequest: no seeds, one that is none, or no positive number of processes.
    """
    found = plan_seeds(service, request, seeds, processes=processes)
    return min(found, key=_worth)


def plan_seeds(
    service: PlannerService, request: PlanRequest, seeds: Sequence[int], *, processes: int = 1
) -> tuple[PlanResult, ...]:
    """The plans of a request with some seeds, in their order.

    Args:
        processes: With more than one, so many are started, build the service anew and share the seeds; their clocks
            are their own and ``result.roadmap`` stays behind, all else is as in one process, to the last bit. They
            import the calling script: what starts them there belongs under ``if __name__ == "__main__"``.

    Raises:
        InvalidRequest: no seeds, one that is none, or no positive number of processes.
    """
    if isinstance(processes, bool) or not isinstance(processes, int) or processes < 1:
        raise InvalidRequest("processes", processes, "a whole number of at least 1")
    if isinstance(seeds, str) or not hasattr(seeds, "__len__") or not len(seeds):
        raise InvalidRequest("seeds", seeds, "at least one, in a list")
    requests = [replace(request, seed=seed) for seed in seeds]
    many = min(processes, len(requests))
    if many == 1:
        return tuple(map(service.plan, requests))
    with ProcessPoolExecutor(many, mp_context=multiprocessing.get_context("spawn")) as pool:
        shares = pool.map(_planned, [service] * many, [requests[k::many] for k in range(many)])
        texts = [iter(share) for share in shares]
    return tuple(_read(next(texts[k % many]), service.robot.n) for k in range(len(requests)))


def _planned(service: PlannerService, requests: Sequence[PlanRequest]) -> list[str]:
    """Results as records, which lose no bit on their way."""
    return [json.dumps(result_record(service.plan(request))) for request in requests]


def _read(text: str, n: int) -> PlanResult:
    node = Node("", json.loads(text), [])
    result = read_result(node, n)
    if node.problems:
        raise BrokenInvariant(f"a result does not come back: {node.problems}")
    return result


def _worth(result: PlanResult) -> tuple[float, ...]:
    """Smaller is better."""
    if result.motion is None:
        return (1.0,)
    report = result.polish
    lacking = 0.0 if report is None else (report.after if report.kept else report.before).shortfall
    return 0.0, math.floor(lacking / LACKING), result.motion.duration

"""Several seeds: the best of their plans, the same from one process and from many."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from benchmarks.worlds import queries
from planner_service import InvalidRequest, JointStep, Optimise, PlannerService, PlanRequest, PlanResult
from planner_service.parallel import Processes
from planner_service.tasks import best_of_seeds, plan_seeds
from planner_service.tasks.seeds import _worth
from tests.support.optional import present

SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def service() -> PlannerService:
    return PlannerService("wxai", "post", edge_step=JointStep(0.02))


def request() -> PlanRequest:
    found = queries.load("post")[1]
    return PlanRequest(found.start, found.goal, time_limit=None, polish=Optimise(waypoints=30))


def told(result: PlanResult) -> tuple[Any, ...]:
    path, trajectory = result.unwrap()
    return path.waypoints.tobytes(), trajectory.coefficients.tobytes(), result.counts, result.polish, result.notes


@pytest.mark.slow
def test_each_plan_is_that_of_its_seed_whatever_the_processes(service: PlannerService) -> None:
    alone = [service.plan(replace(request(), seed=seed)) for seed in SEEDS]
    here = plan_seeds(service, request(), SEEDS)
    elsewhere = plan_seeds(service, request(), SEEDS, engine=Processes(2))
    assert [told(one) for one in alone] == [told(one) for one in here] == [told(one) for one in elsewhere]
    assert len({told(one)[0] for one in alone}) > 1
    path, _ = elsewhere[1].unwrap()
    assert not path.waypoints.flags.writeable


@pytest.mark.slow
def test_the_best_is_the_fastest_of_those_that_keep_their_distance(service: PlannerService) -> None:
    plans = plan_seeds(service, request(), SEEDS)
    best = best_of_seeds(service, request(), SEEDS)
    assert told(best) in [told(one) for one in plans]
    assert present(best.motion).duration == min(one.motion.duration for one in plans if one.motion is not None)
    near = replace(best, polish=replace(present(best.polish), after=replace(present(best.polish).after, shortfall=1.0)))
    slow = replace(best, motion=replace(present(best.motion), duration=9.0))
    assert _worth(best) < _worth(slow) < _worth(near)
    assert _worth(near) < _worth(replace(best, motion=None))


@pytest.mark.parametrize(("seeds", "named"), [((), "seeds"), (None, "seeds"), ("12", "seeds"), ((-1,), "seed")])
def test_what_makes_no_sense_is_refused(service: PlannerService, seeds: Any, named: str) -> None:
    with pytest.raises(InvalidRequest, match=f"^{named}: "):
        plan_seeds(service, request(), seeds)

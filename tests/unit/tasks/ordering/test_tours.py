"""Orders of small sets of jobs, against all orders and all branches."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

from planner_service.geometry.arrays import BoolArray, FloatArray
from planner_service.tasks.ordering.relaxation import Relaxation
from planner_service.tasks.ordering.tours import IMPOSSIBLE, Costs, best_branches, improved, tour_of


def drawn(seed: int, jobs: int, *, chains: bool = False, precedences: int = 0) -> Costs:
    """Random costs of jobs with one to four branches, or of jobs with different entries and exits."""
    rng = np.random.default_rng(seed)
    entries = [1, *rng.integers(1, 5, jobs)]
    exits = [1, *(rng.integers(1, 5, jobs) if chains else entries[1:])]
    inner: list[FloatArray] = [np.zeros((1, 1))]
    for a, b in zip(entries[1:], exits[1:], strict=True):
        own = rng.uniform(0.0, 1.0, (a, b))
        inner.append(own if chains else np.where(np.eye(a, dtype=bool), own, IMPOSSIBLE))
    legs = rng.uniform(0.5, 3.0, (sum(exits), sum(entries)))
    legs[rng.random(legs.shape) < 0.1] = IMPOSSIBLE
    before: BoolArray = np.zeros((jobs + 1, jobs + 1), dtype=bool)
    for _ in range(precedences):
        i, j = sorted(rng.choice(np.arange(1, jobs + 1), 2, replace=False).tolist())
        before[i, j] = True
    for k in range(jobs + 1):
        before |= before[:, k, None] & before[None, k]
    numbers = [np.cumsum([0, *counts]) for counts in (entries, exits)]
    return Costs(numbers[0], numbers[1], legs, tuple(inner), before)


def every_choice(costs: Costs, order: tuple[int, ...]) -> float:
    """The least cost of an order over all entries and exits."""
    ranges = [
        product(range(costs.entries[job], costs.entries[job + 1]), range(costs.exits[job], costs.exits[job + 1]))
        for job in order
    ]
    return min(
        tour_of(costs, np.array(order), np.array([a for a, _ in choice]), np.array([b for _, b in choice])).cost
        for choice in product(*ranges)
    )


@pytest.mark.parametrize("chains", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_the_branches_of_an_order_are_the_best_of_all(seed: int, chains: bool) -> None:
    costs = drawn(seed, 3, chains=chains)
    order = tuple((1 + np.random.default_rng(seed).permutation(3)).tolist())
    found = best_branches(costs, order)
    assert found.cost == pytest.approx(every_choice(costs, order), rel=1e-12)
    assert tour_of(costs, found.order, found.entries, found.exits).cost == pytest.approx(found.cost, rel=1e-12)


@pytest.mark.parametrize("chains", [False, True])
@pytest.mark.parametrize("precedences", [0, 3])
@pytest.mark.parametrize("seed", range(12))
def test_up_to_six_jobs_are_in_the_best_order_of_all_and_no_bound_is_above_it(
    seed: int, precedences: int, chains: bool
) -> None:
    costs = drawn(seed, 1 + seed % 6, chains=chains, precedences=precedences if seed % 6 else 0)
    orders = [order for order in permutations(range(1, costs.jobs)) if costs.allows(np.array(order))]
    least = min(best_branches(costs, order).cost for order in orders)
    found = improved(costs, np.random.default_rng(seed), 60)
    assert costs.allows(found.order)
    assert sorted(found.order.tolist()) == list(range(1, costs.jobs))
    assert found.cost == pytest.approx(least, rel=1e-12)
    bound = Relaxation.of(costs, found).raised(costs, 40)
    assert bound <= least * (1.0 + 1e-12)
    if least < IMPOSSIBLE and not precedences:
        assert bound > 0.75 * least


def test_the_bound_holds_for_any_prices_also_of_a_program_that_lacks_legs() -> None:
    costs = drawn(3, 6)
    best = improved(costs, np.random.default_rng(0), 60)
    few = Relaxation.of(costs, best)
    few.columns[:] = False
    few.columns[np.append(0, best.exits), np.append(best.entries, 0)] = True
    for _ in range(6):
        assert few.raised(costs, 1) <= best.cost * (1.0 + 1e-12)


def test_costs_that_change_keep_what_was_learned_and_the_bound_true() -> None:
    costs = drawn(4, 6, chains=True)
    best = improved(costs, np.random.default_rng(0), 60)
    relaxation = Relaxation.of(costs, best)
    relaxation.raised(costs, 20)
    dearer = costs.with_legs(costs.legs * 1.3, costs.inner)
    least = min(best_branches(dearer, order).cost for order in permutations(range(1, 7)))
    assert relaxation.raised(dearer, 20) <= least * (1.0 + 1e-12)


def test_more_rounds_are_never_worse_and_equal_seeds_give_equal_orders() -> None:
    costs = drawn(7, 40, precedences=10)
    first = improved(costs, np.random.default_rng(0), 40)
    again = improved(costs, np.random.default_rng(0), 40)
    more = improved(costs, np.random.default_rng(1), 40, first)
    assert first.order.tolist() == again.order.tolist()
    assert costs.allows(more.order)
    assert more.cost <= first.cost

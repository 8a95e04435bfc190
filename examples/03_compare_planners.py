"""Compare planners: one query in the shelf, several planners with ten seeds each, their cost and path lengths.

Run: python examples/03_compare_planners.py
"""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

from planner_service import (
    RRT,
    BalancedRRTConnect,
    Optimise,
    PlannerService,
    PlanRequest,
    PlanResult,
    RRTConnect,
    Stage,
)
from planner_service.planners import AORRTC, LBKPIECE1, BITstar, Planner

START = (-0.36, 1.93, 0.25, 1.56, -0.27, 0.27)
GOAL = (0.16, 1.55, 1.00, 0.64, -0.10, -0.43)  # a shelf board is between them
SEEDS = range(10)
PLANNERS: Mapping[str, Planner | Optimise] = {
    "BalancedRRTConnect": BalancedRRTConnect(),  # the default
    "RRTConnect": RRTConnect(),
    "RRT": RRT(),
    "LBKPIECE1": LBKPIECE1(),
    "BITstar": BITstar(checks=4000),  # these two look for shorter paths until they have checked so many states
    "AORRTC": AORRTC(checks=4000),
    "Optimise": Optimise(starts=4),  # no search: improves straight and bent lines
}


def main() -> None:
    """Print one row per planner: medians over the seeds, failures included."""
    service = PlannerService("wxai", "shelf")
    print("planner             solved  search  states  distances   found -> final")
    for name, planner in PLANNERS.items():
        requests = [PlanRequest(START, GOAL, planner=planner, seed=seed, time_limit=None) for seed in SEEDS]
        show(name, [service.plan(request) for request in requests])


def show(name: str, results: list[PlanResult]) -> None:
    """Print a row of the table."""
    search = median(result.stage(Stage.SEARCH).counts.states for result in results)
    states = median(result.counts.states for result in results)
    distances = median(result.counts.distances for result in results)
    found = [result.stage(Stage.SEARCH).length or 0.0 for result in results if result.ok]
    final = [result.path.length for result in results if result.path is not None]
    lengths = f"{median(found):5.2f} -> {median(final):.2f} rad" if final else "no path"
    print(f"{name:<20}{len(final):>3}/{len(results)}{search:>8,.0f}{states:>8,.0f}{distances:>11,.0f}   {lengths}")


if __name__ == "__main__":
    main()

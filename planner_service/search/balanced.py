"""RRT-Connect with balanced trees and dynamic domains, compiled (native/search/balanced.cpp).

Two trees grow, one from the start and one from all goals. The smaller one takes a step towards a random configuration,
and the other then grows towards that step as far as it is free; that the smaller one grows is what keeps hard searches
short (Kuffner & LaValle, CMU-RI-TR-05-34, 2005). A node that could not be extended is from then on extended only
towards samples near it (Yershova, Jaillet, Simeon & LaValle, ICRA 2005; Jaillet et al., IROS 2005).

Most edges never become part of a path. So each is judged coarsely first, and in full only when the trees have met over
it; one that collides then is cut off with all that grew from it.
"""

from __future__ import annotations

from functools import partial
from typing import cast

import numpy as np

from planner_service.native.loading import load_core
from planner_service.search.compiled_oracle import CompiledOracle, compiled
from planner_service.search.problem import SearchProblem, SearchResult

__all__ = ["search"]

_WORD = 2**64 - 1


def search(problem: SearchProblem, longest: float) -> SearchResult:
    """Search until there is a path.

    Args:
        longest: Length of an edge at most.
    """
    start, goals = tuple(problem.start.tolist()), list(map(tuple, problem.goals.tolist()))
    seed = (problem.seed ^ problem.seed >> 64) & _WORD
    asked, bounds = problem.oracle, (problem.lower.tolist(), problem.upper.tolist())
    oracle = cast(CompiledOracle, asked) if hasattr(asked, "core") else compiled(asked, problem.poll)
    run = load_core().BalancedSearch(oracle.core, *bounds, longest, seed, problem.projector)
    try:
        path = oracle.counted(partial(run.run, start, goals))
    finally:
        if problem.grown is not None:
            milestones, edges = run.grown()
            problem.grown(np.array(milestones), edges)
    if not path:
        return SearchResult(waypoints=None)
    return SearchResult(waypoints=np.array(path), goal_index=goals.index(tuple(path[-1])))

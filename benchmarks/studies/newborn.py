"""What ``cold`` starts: a process that plans once as soon as it can, then again and again, and tells when it did what.

Prints the moments of its first plan, the seconds of further ones, and the most memory it had. Until the first moment
nothing is imported that a user's own program would not import.
"""

from __future__ import annotations

import time

moments = [time.monotonic()]

import json  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402


def main(scene: str, plans: int) -> None:
    """Plan the stored queries of a scene."""
    from planner_service import PlannerService, PlanRequest

    moments.append(time.monotonic())
    stored = json.loads((Path(__file__).parents[1] / "queries" / f"{scene}.json").read_text("utf-8"))
    asked = [(query["start"], query["goal"]) for query in stored["queries"]]
    service = PlannerService(stored["robot"], scene)
    moments.append(time.monotonic())
    service.plan(PlanRequest(*asked[0], time_limit=None)).unwrap()
    moments.append(time.monotonic())
    seconds = []
    for k in range(plans):
        clock = time.perf_counter()
        service.plan(PlanRequest(*asked[k % len(asked)], seed=k, time_limit=None))
        seconds.append(time.perf_counter() - clock)
    print(json.dumps({"moments": moments, "seconds": seconds, "peak_mb": _peak_mb()}))


def _peak_mb() -> float | None:
    """Most memory this process ever had, None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    unit = 1e6 if sys.platform == "darwin" else 1e3  # bytes there, kilobytes elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))

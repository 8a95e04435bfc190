"""Certify a path from another program: free at every sample it checked, but through a post between two of them.

The refusal says where and with what it collides. Only that piece is planned again; then the whole is proven and timed.

Run: python examples/06_certify_someone_elses_path.py
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from planner_service import JointPath, PlannerService, PlanRequest, ToppRa
from planner_service.geometry.arrays import FloatArray
from planner_service.planning import Pace

GIVEN = np.array(
    [
        [1.02, 1.51, 1.35, -0.65, 0.06, -0.31],
        [0.87, 1.38, 1.50, -0.60, 0.15, 0.10],
        [0.72, 1.26, 1.66, -0.54, 0.25, 0.51],
        [0.38, 1.09, 1.79, -0.51, 0.26, 0.72],
        [-0.06, 1.08, 1.75, -0.51, 0.17, 0.57],
        [-0.45, 1.21, 1.63, -0.49, 0.08, 0.34],
        [-0.74, 1.36, 1.49, -0.56, 0.06, 0.03],
        [-1.02, 1.51, 1.35, -0.65, 0.06, -0.31],
    ]
)
THEIR_STEP = 0.1
"""Radians between the configurations that the other program checked."""


def main() -> None:
    """Sample as they did, certify, repair what is refused, certify again."""
    service = PlannerService("wxai", "post")
    sampled = samples(GIVEN, THEIR_STEP)
    free = service.checker.states_are_free(sampled)
    print(f"at {len(sampled)} samples, {THEIR_STEP} rad apart: {int(free.sum())} free")

    waypoints, planned = GIVEN, 0
    while (refusal := service.certify(waypoints).refusal) is not None:
        print(refusal)
        piece = int(np.searchsorted(JointPath(waypoints).knots, refusal.s)) - 1
        request = PlanRequest(waypoints[piece], waypoints[piece + 1], seed=1, blend=0.0)  # a polyline
        detour = service.plan(request)
        planned += detour.counts.states
        around, _ = detour.unwrap()
        print(f"piece {piece} planned again: {len(around.waypoints) - 2} more waypoints, {detour.counts.states} states")
        waypoints = np.concatenate([waypoints[:piece], around.waypoints, waypoints[piece + 2 :]])

    proof = service.certify(waypoints)
    print(f"proven: at least {proof.clearance * 1000:.2f} mm from everything ({proof.distances:,} bounds)")
    stops = service.follow(waypoints)  # checked, proven and timed unchanged, with a stop at each waypoint
    blends = np.full(len(waypoints), 0.3)  # or blended, up to 0.3 rad before and after each corner, where that is free
    smooth = service.follow(waypoints, blends=blends, pace=Pace(ToppRa()))
    print(f"{stops.unwrap()[1].duration:.2f} s with stops, {smooth.unwrap()[1].duration:.2f} s with blends")
    print(f"states: {planned:,} for the repair, {smooth.counts.states:,} to check and blend the whole")


def samples(waypoints: FloatArray, step: float) -> FloatArray:
    """Configurations along a polyline, at most ``step`` apart."""
    pieces = [waypoints[:1]]
    for a, b in pairwise(waypoints):
        parts = int(np.ceil(np.sqrt(((b - a) ** 2).sum()) / step))
        pieces.append(a + (b - a) * (np.arange(1, parts + 1) / parts)[:, None])
    return np.concatenate(pieces)


if __name__ == "__main__":
    main()

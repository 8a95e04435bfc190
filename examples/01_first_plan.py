"""A first plan: from home, out of a bin and round a post, to above a tray, with the cost of every stage.

Run: python examples/01_first_plan.py
"""

from __future__ import annotations

from planner_service import PlannerService, PlanRequest, Pose

ABOVE_TRAY = Pose((0.20, 0.28, 0.15), (0.5**0.5, 0.0, 0.5**0.5, 0.0))  # metres; wxyz: the tool points down


def main() -> None:
    """Plan once, and print the stages, the proof and the first samples of the motion."""
    service = PlannerService("wxai", "bin")
    result = service.plan(PlanRequest(start=service.robot.home, goal=ABOVE_TRAY, seed=7))
    for report in result.stages:
        counts = report.counts
        print(f"{report.stage.value:<14}{counts.states:>6,} states{counts.edges:>4} edges  {report.note}")
    if result.failure is not None:  # "no plan" is a result, not an exception
        print(result.failure)
        return
    path, trajectory = result.unwrap()
    print(f"in total {result.counts.states:,} states for {path.length:.2f} rad of path, {trajectory.duration:.2f} s")
    if result.certificate is not None:
        print(f"proven free along the whole curve, by {result.certificate.distances:,} bounds")

    t, q, qd, _ = trajectory.sample(0.01)  # 100 samples a second, for a driver
    for k in range(0, 40, 10):
        print(f"t = {t[k]:.2f} s  q = {q[k].round(3).tolist()}  fastest joint {abs(qd[k]).max():.2f} rad/s")


if __name__ == "__main__":
    main()

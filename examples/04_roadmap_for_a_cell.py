"""Pay for collision checks once: a cell that picks from one bin for the same three drop zones.

Builds a roadmap of the bin scene, moves from above the block to each zone and back, several rounds, and prints how many
states each search checked. Then the post moves, the roadmap is updated, and the work continues.
"""

from __future__ import annotations

from dataclasses import replace

from planner_service import PRM, BalancedRRTConnect, PlannerService, PlanRequest, PlanResult, Pose, Roadmap, Stage
from planner_service.geometry.arrays import FloatArray
from planner_service.planners import Planner

DOWN = (0.5**0.5, 0.0, 0.5**0.5, 0.0)  # wxyz: the tool points down
PICK = Pose((0.33, 0.0, 0.16), DOWN)
ZONES = (Pose((0.20, 0.28, 0.15), DOWN), Pose((0.05, 0.35, 0.15), DOWN), Pose((0.12, 0.31, 0.10), DOWN))
ROUNDS = 3

Ends = tuple[FloatArray, FloatArray]


def main() -> None:
    """Build the roadmap and use it; then move the post, update the roadmap, and use it again."""
    service = PlannerService("wxai", "bin")
    roadmap = service.build_roadmap(PRM(milestones=500, neighbours=10), seed=0)
    built = roadmap.built
    print(f"built once: {len(roadmap.milestones)} milestones, {built.counts.states if built else 0:,} states")

    above = joints(service, PICK)
    zones = [joints(service, pose) for pose in ZONES]
    trips = [trip for zone in zones for trip in ((above, zone), (zone, above))]
    print("states of each search, to a zone and back:")
    show("searched", [planned(service, trip, BalancedRRTConnect()) for trip in trips])
    roadmap = replace(roadmap, remember=True)  # paths that were found become part of it
    for turn in range(ROUNDS):
        roadmap = work(service, f"round {turn + 1}", trips, roadmap)

    elsewhere = service.with_scene(service.scene.moved("demo_post", Pose((0.28, 0.22, 0.175))))
    update = elsewhere.update_roadmap(roadmap)
    print(update)
    roadmap = update.roadmap
    for turn in range(ROUNDS):
        roadmap = work(elsewhere, f"moved {turn + 1}", trips, roadmap)


def joints(service: PlannerService, pose: Pose) -> FloatArray:
    """A configuration for a tool pose: the one in which a plan to it ends."""
    path, _ = service.plan(PlanRequest(service.robot.home, pose, time_limit=None)).unwrap()
    q: FloatArray = path.waypoints[-1]
    return q


def planned(service: PlannerService, ends: Ends, planner: Planner) -> PlanResult:
    """A plan; its proof does not depend on the roadmap."""
    start, goal = ends
    result = service.plan(PlanRequest(start, goal, planner=planner, seed=1, time_limit=None))
    result.unwrap()
    return result


def work(service: PlannerService, name: str, trips: list[Ends], roadmap: Roadmap) -> Roadmap:
    """Plan one round, and return the roadmap with what was learned."""
    results = []
    for trip in trips:
        result = planned(service, trip, roadmap)
        roadmap = result.roadmap or roadmap  # a new value: nothing is learned behind your back
        results.append(result)
    show(name, results)
    return roadmap


def show(name: str, results: list[PlanResult]) -> None:
    """Print a row of the table."""
    costs = [result.stage(Stage.SEARCH).counts.states for result in results]
    print(f"{name:<12}" + "".join(f"{cost:>7,}" for cost in costs) + f"{sum(costs):>9,} in total")


if __name__ == "__main__":
    main()

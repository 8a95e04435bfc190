"""Move a block from a bin to a tray: straight tool lines where they are free, the planner where they are not.

Run: python examples/02_pick_and_place.py
"""

from __future__ import annotations

from planner_service import (
    CheckCounts,
    Handling,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Stage,
    pick,
    place,
    top_grasps,
)

ON_TRAY = Pose((0.20, 0.28, 0.0335))  # a 45 mm cube, 1 mm above the tray, whose top is at z = 10 mm


def main() -> None:
    """Pick, place, go home, and print each motion with its cost."""
    service = PlannerService("wxai", "bin")
    home, block = service.robot.home, service.scene.obstacle("blue_block")

    picked = pick(service, home, "blue_block", top_grasps(service.robot, block), Handling(support="bin_floor"))
    show("pick", [(segment.name, segment.result) for segment in picked.segments])
    if picked.failure is not None:
        print(picked.failure)
        return
    # picked.world has the gripper closed and the block attached to the arm.
    placed = place(PlannerService.of(picked.world), picked.q, "blue_block", [ON_TRAY], Handling(support="tray"))
    show("place", [(segment.name, segment.result) for segment in placed.segments])
    if placed.failure is not None:
        print(placed.failure)
        return
    back = PlannerService.of(placed.world).plan(PlanRequest(placed.q, home))
    show("return", [("to home", back)])
    motions = [segment.result for segment in (*picked.segments, *placed.segments)] + [back]

    spent = sum((motion.counts for motion in motions), CheckCounts())
    choosing = picked.choosing + placed.choosing
    seconds = sum(motion.trajectory.duration for motion in motions if motion.trajectory is not None)
    print(f"{spent.states:,} states for {seconds:.1f} s of motion; {choosing.states} more to choose grasp and place")
    print(f"the block now stands at {placed.world.scene.obstacle('blue_block').pose.position}")


def show(title: str, motions: list[tuple[str, PlanResult]]) -> None:
    """Print a line for each motion: straight or searched, its cost, and the proven clearance."""
    print(title)
    for name, result in motions:
        how = "searched" if result.stage(Stage.SEARCH).counts.states else "straight"
        proof = result.certificate
        room = "" if proof is None else f"{proof.clearance * 1000:6.2f} mm clear"
        print(f"  {name:<14}{how}{result.counts.states:>7,} states  {room}")
        for stretch in result.exempt:  # the only places where contact is allowed
            print(f"    {stretch}")


if __name__ == "__main__":
    main()

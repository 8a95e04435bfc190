"""Your own arm: import a URDF, see why each pair of links is allowed or checked, and plan round a post.

Run: python examples/05_your_own_robot.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from planner_service import Box, Cylinder, Obstacle, PlannerService, PlanRequest, Pose, Robot, Scene
from planner_service.robot_setup.import_robot import Source, import_robot
from planner_service.robot_setup.self_collision_matrix import ContactKind

URDF = Path(__file__).with_name("desk_arm.urdf")
DESK = Scene(
    (
        Obstacle("desk", Box((1.0, 1.0, 0.04)), Pose((0.0, 0.0, -0.021))),  # its top is 1 mm below the foot
        Obstacle("post", Cylinder(radius=0.02, length=0.5), Pose((0.28, 0.0, 0.25))),
    )
)


def main() -> None:
    """Import the arm, print its contact table, and plan from one side of the post to the other."""
    quick = Robot.from_urdf(URDF, tool_frame="tip")  # enough to plan: only neighbours may touch
    print(f"{quick.name}: {quick.n} joints ({', '.join(quick.joint_names)}), {len(quick.shapes)} collision shapes")

    with tempfile.TemporaryDirectory() as folder:  # use a folder that you keep, review and edit
        imported = import_robot(Source(URDF, tool_frame="tip"), Path(folder) / "desk_arm", prove=True)
    for finding in imported.table.findings:
        verdict = "allowed" if finding.kind.allowed else "checked"
        print(f"  {verdict:<8} {' x '.join(finding.links):<20} {finding.reason}")
    robot = imported.robot  # the same as load_robot(imported.path)

    service = PlannerService(robot, DESK)
    left, right = [0.7, 0.3, -0.4, 0.0], [-0.7, 0.3, -0.4, 0.0]
    result = service.plan(PlanRequest(left, right, seed=1))
    print(result.stages[1].note)
    path, trajectory = result.unwrap()
    print(f"planned: {path.length:.2f} rad, {trajectory.duration:.2f} s, {result.counts.states:,} states")
    # The import leaves fewer pairs to check; the plan is the same.
    for name, one in {"imported": service, "from_urdf": PlannerService(quick, DESK)}.items():
        states = one.plan(PlanRequest(left, right, seed=1)).counts.states
        print(f"{name:<10} {one.checker.pair_count} pairs checked in each of {states:,} states")
    sometimes = imported.table.of(ContactKind.SOMETIMES)[0]  # where such a pair collides
    if sometimes.example is not None:
        print(f"at {sometimes.example.round(2).tolist()}: {service.checker.contacts(sometimes.example)[0]}")


if __name__ == "__main__":
    main()

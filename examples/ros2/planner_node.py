"""A ROS 2 node that answers MoveIt's GetMotionPlan, by a server that plans.

Run: planner-service serve --robot wxai --scene bin --port 8080
     python examples/ros2/planner_node.py --ros-args -p url:=http://127.0.0.1:8080 -p scene:=bin

The scene is the server's. What cannot be kept is refused; group, planner, workspace and tolerances are not used.
"""

from __future__ import annotations

from typing import Any

import rclpy
from builtin_interfaces.msg import Duration
from moveit_msgs.msg import MoveItErrorCodes
from moveit_msgs.srv import GetMotionPlan
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from planner_service import InvalidRequest, PlannerServiceError, PlanRequest, PlanResult, Pose, Robot
from planner_service.client import Remote
from planner_service.records import joint_trajectory

CODES = {"START_IN_COLLISION": "START_STATE_IN_COLLISION"}  # where MoveIt calls a reason otherwise


def plan_request(asked: Any, robot: Robot) -> PlanRequest:
    """A MotionPlanRequest as ours; raises InvalidRequest for what cannot be kept."""
    path, start = asked.path_constraints, asked.start_state
    unkept = [path.joint_constraints, path.position_constraints, path.orientation_constraints]
    unkept += [path.visibility_constraints, asked.trajectory_constraints.constraints, start.attached_collision_objects]
    if any(unkept) or asked.cartesian_speed_limited_link not in ("", robot.tool_frame):
        expected = f"no constraints but goals, nothing attached, and no speed limit of a link but {robot.tool_frame}"
        raise InvalidRequest("motion_plan_request", asked.group_name, expected)
    limits = {"time_limit": asked.allowed_planning_time, "max_tool_speed": asked.max_cartesian_speed}
    limits["velocity_scale"] = asked.max_velocity_scaling_factor
    limits["acceleration_scale"] = asked.max_acceleration_scaling_factor
    given: dict[str, Any] = {name: value for name, value in limits.items() if value != 0.0}  # MoveIt's default
    goals = [_goal(goal, robot) for goal in asked.goal_constraints]
    joints = dict(zip(start.joint_state.name, start.joint_state.position, strict=True))
    return PlanRequest(_ordered("start_state", joints, robot), goals, **given)


def _goal(goal: Any, robot: Robot) -> Any:
    if goal.joint_constraints:
        named = {joint.joint_name: joint.position for joint in goal.joint_constraints}
        return _ordered("goal_constraints", named, robot)
    for place, turn in zip(goal.position_constraints, goal.orientation_constraints, strict=True):
        links = {place.link_name, turn.link_name} == {robot.tool_frame}
        frames = {place.header.frame_id, turn.header.frame_id} <= {"", *robot.base_links}
        offset, poses = place.target_point_offset, place.constraint_region.primitive_poses
        if links and frames and len(poses) == 1 and (offset.x, offset.y, offset.z) == (0.0, 0.0, 0.0):
            at, q = poses[0].position, turn.orientation
            return Pose((at.x, at.y, at.z), (q.w, q.x, q.y, q.z))
    raise InvalidRequest("goal_constraints", goal.name, f"all joints, or a pose of {robot.tool_frame} in its base")


def _ordered(field: str, values: dict[str, float], robot: Robot) -> list[float]:
    if not values.keys() >= set(robot.joint_names):
        raise InvalidRequest(field, sorted(values), f"a position of each of {', '.join(robot.joint_names)}")
    return [values[name] for name in robot.joint_names]


def fill(answer: Any, result: PlanResult, robot: Robot) -> None:
    """Write a plan, or why there is none, into a MotionPlanResponse."""
    if result.failure is not None:
        name = CODES.get(result.failure.reason.value, result.failure.reason.value)
        answer.error_code.val = getattr(MoveItErrorCodes, name, MoveItErrorCodes.PLANNING_FAILED)
        return
    message = joint_trajectory(result, robot.joint_names, 0.01)
    answer.trajectory.joint_trajectory = trajectory = JointTrajectory(joint_names=message["joint_names"])
    trajectory.header.frame_id = robot.base_links[0]
    for point in message["points"]:
        values = {**point, "time_from_start": Duration(**point["time_from_start"])}
        trajectory.points.append(JointTrajectoryPoint(**values))
    answer.error_code.val = MoveItErrorCodes.SUCCESS


def main() -> None:
    """Answer requests until ROS shuts down."""
    rclpy.init()
    node = rclpy.create_node("planner_service")
    url = node.declare_parameter("url", "http://127.0.0.1:8080").value
    remote = Remote(url, node.declare_parameter("scene", "empty").value)

    def answer(request: Any, response: Any) -> Any:
        asked, told = request.motion_plan_request, response.motion_plan_response
        told.trajectory_start, told.group_name = asked.start_state, asked.group_name
        told.error_code.val = MoveItErrorCodes.INVALID_MOTION_PLAN
        try:
            fill(told, remote.plan(plan_request(asked, remote.robot)), remote.robot)
        except (PlannerServiceError, ValueError) as error:
            node.get_logger().error(str(error))
        return response

    node.create_service(GetMotionPlan, "plan_kinematic_path", answer)
    rclpy.spin(node)


if __name__ == "__main__":
    main()

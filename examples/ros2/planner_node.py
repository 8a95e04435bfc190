"""A ROS 2 node that answers MoveIt's GetMotionPlan, by a server that plans; its scene and gripper are the server's.

What cannot be kept is refused; group, planner, workspace, tolerances and joints that are not the arm's are not used.
Run: planner-service serve --robot wxai --scene bin --port 8080
     python examples/ros2/planner_node.py --ros-args -p url:=http://127.0.0.1:8080 -p scene:=bin
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


def plan_request(asked: Any, robot: Robot) -> PlanRequest:
    """A MotionPlanRequest as ours; raises InvalidRequest for what cannot be kept."""
    path, start = asked.path_constraints, asked.start_state
    unkept = [path.joint_constraints, path.position_constraints, path.orientation_constraints]
    unkept += [path.visibility_constraints, asked.trajectory_constraints.constraints, start.attached_collision_objects]
    if any(unkept) or asked.cartesian_speed_limited_link not in ("", robot.tool_frame):
        expected = f"no constraints but goals, nothing attached, and no speed limit of a link but {robot.tool_frame}"
        raise InvalidRequest("motion_plan_request", asked.group_name, expected)
    pace = {"velocity_scale": asked.max_velocity_scaling_factor, "max_tool_speed": asked.max_cartesian_speed}
    pace |= {"acceleration_scale": asked.max_acceleration_scaling_factor, "time_limit": asked.allowed_planning_time}
    given: dict[str, Any] = {name: value for name, value in pace.items() if value != 0.0}  # MoveIt's default
    state = zip(start.joint_state.name, start.joint_state.position, strict=False)
    begin = _ordered("start_state", [row for row in state if row[0] in robot.joint_names], robot)
    return PlanRequest(begin, [_goal(goal, robot) for goal in asked.goal_constraints], **given)


def _goal(goal: Any, robot: Robot) -> Any:
    joints, places, turns = goal.joint_constraints, goal.position_constraints, goal.orientation_constraints
    if joints and not (places or turns or goal.visibility_constraints):
        return _ordered("goal_constraints", [(joint.joint_name, joint.position) for joint in joints], robot)
    if len(places) == len(turns) == 1 and not (joints or goal.visibility_constraints):
        (place,), (turn,), frame = places, turns, places[0].header.frame_id
        known = place.link_name == turn.link_name == robot.tool_frame and frame in ("", *robot.base_links)
        offset, poses = place.target_point_offset, place.constraint_region.primitive_poses
        if known and frame == turn.header.frame_id and len(poses) == 1 and not (offset.x or offset.y or offset.z):
            at, q = poses[0].position, turn.orientation
            base = Pose.from_matrix(robot.link_frame(frame)[1]) if frame else Pose()
            return base @ Pose((at.x, at.y, at.z), (q.w, q.x, q.y, q.z))
    given = [f"{part.link_name} in {part.header.frame_id!r}" for part in (*places, *turns)]
    raise InvalidRequest("goal_constraints", given, f"all joints, or a pose of {robot.tool_frame} in its base")


def _ordered(field: str, joints: list[tuple[str, float]], robot: Robot) -> list[float]:
    if sorted(name for name, _ in joints) != sorted(robot.joint_names):
        raise InvalidRequest(field, joints, f"a position of each of {', '.join(robot.joint_names)}, once")
    return [dict(joints)[name] for name in robot.joint_names]


def fill(answer: Any, result: PlanResult, robot: Robot) -> str:
    """Write a plan, or why there is none, into a MotionPlanResponse; returns it in words."""
    if result.failure is not None:
        name = result.failure.reason.value.replace("START_IN_", "START_STATE_IN_")  # as MoveIt calls it
        answer.error_code.val = getattr(MoveItErrorCodes, name, MoveItErrorCodes.PLANNING_FAILED)
        return str(result.failure)
    message = joint_trajectory(result, robot.joint_names, 0.01)
    answer.trajectory.joint_trajectory = trajectory = JointTrajectory(joint_names=message["joint_names"])
    trajectory.header.frame_id = robot.base_links[0]
    for point in message["points"]:
        point["time_from_start"] = Duration(**point["time_from_start"])
        trajectory.points.append(JointTrajectoryPoint(**point))
    answer.error_code.val = MoveItErrorCodes.SUCCESS
    return f"planned {len(message['points'])} points"


def main() -> None:
    """Answer requests until ROS shuts down."""
    rclpy.init()
    node = rclpy.create_node("planner_service")
    url = node.declare_parameter("url", "http://127.0.0.1:8080").value
    remote = Remote(url, node.declare_parameter("scene", "empty").value)

    def answer(request: Any, response: Any) -> Any:
        asked, told = request.motion_plan_request, response.motion_plan_response
        told.trajectory_start, told.group_name = asked.start_state, asked.group_name
        try:
            node.get_logger().info(fill(told, remote.plan(plan_request(asked, remote.robot)), remote.robot))
        except PlannerServiceError as error:
            code = "INVALID_MOTION_PLAN" if isinstance(error, InvalidRequest) else "FAILURE"
            told.error_code.val = getattr(MoveItErrorCodes, code)
            node.get_logger().error(str(error))
        return response

    node.create_service(GetMotionPlan, "plan_kinematic_path", answer)
    rclpy.spin(node)


if __name__ == "__main__":
    main()

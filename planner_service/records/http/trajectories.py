"""Motions ready to run, as servers give them as JSON: points in time, messages of ROS, actions of LeRobot."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from planner_service.files.schema import Count, GrownRecord, Record, Text

__all__ = ["TRAJECTORIES"]


class MotionSamples(Record):
    """A motion in time: seconds from its own beginning, and rows of one number for each joint.

    Attributes:
        name: The name of the motion.
        begin: Seconds of motion before it.
        duration: Seconds that it takes.
        t: Times in seconds since it began, the first 0, the last its duration.
        positions: For each time the positions of all joints, in rad (m of joints that slide).
        velocities: For each time the velocities of all joints, in rad/s (m/s).
        accelerations: For each time the accelerations of all joints, in rad/s^2 (m/s^2).
    """

    name: Text
    begin: float
    duration: float
    t: list[float]
    positions: list[list[float]]
    velocities: list[list[float]]
    accelerations: list[list[float]]


class GripperEvent(GrownRecord):
    """What the gripper does while the arm stands before a motion.

    Attributes:
        at: Seconds of motion before it.
        before: The name of the motion that follows.
        width: Metres between the finger pads from now on; not there for a gripper that sucks.
        suction: Whether it sucks from now on; not there for a gripper with fingers.
    """

    at: float
    before: str
    width: float | None = None
    suction: bool | None = None


class DeviationReply(Record):
    """Bounds of how far a joint can be from the proven curve, in rad (or m), by what is drawn between points.

    Attributes:
        linear: If straight lines are drawn between the points.
        cubic: If cubics are, which have the velocities of the points.
        quintic: If quintics are, which have the velocities and the accelerations of the points.
    """

    linear: float
    cubic: float
    quintic: float


class SampledReply(Record):
    """Motions ready to run, format json.

    Attributes:
        robot: The name of the robot.
        joint_names: The order of all joint values.
        units: Of each joint's position; velocities and accelerations have these by s and s^2.
        dt: Seconds between points; the exact end is always one.
        deviation: How far a joint can be from the proven curve between the points, in rad (m).
        motions: The motions in order; the arm stands between them.
        events: What the gripper does between motions.
    """

    robot: Text
    joint_names: list[str]
    units: list[Literal["rad", "m"]]
    dt: float
    deviation: DeviationReply
    motions: list[MotionSamples]
    events: list[GripperEvent]


# Messages of ROS 2.


class RosTime(Record):
    """A time or a duration of ROS.

    Attributes:
        sec: Whole seconds.
        nanosec: Nanoseconds beyond these.
    """

    sec: Count
    nanosec: Count


class RosHeader(Record):
    """A std_msgs/Header.

    Attributes:
        stamp: 0: start when received.
        frame_id: Empty.
    """

    stamp: RosTime
    frame_id: str


class RosPoint(Record):
    """A trajectory_msgs/JointTrajectoryPoint.

    Attributes:
        positions: Of all joints, in rad (m of joints that slide).
        velocities: Of all joints, in rad/s (m/s).
        accelerations: Of all joints, in rad/s^2 (m/s^2).
        effort: Empty.
        time_from_start: Since the motion began.
    """

    positions: list[float]
    velocities: list[float]
    accelerations: list[float]
    effort: list[float]
    time_from_start: RosTime


class JointTrajectory(Record):
    """A trajectory_msgs/JointTrajectory: format joint-trajectory of a plan.

    Attributes:
        header: When it starts.
        joint_names: The order of all joint values.
        points: The motion in time.
    """

    header: RosHeader
    joint_names: list[str]
    points: list[RosPoint]


class NoJoints(Record):
    """A trajectory or a state of joints with several degrees of freedom, of which there are none.

    Attributes:
        header: When it starts.
        joint_names: Empty.
        points: Empty.
    """

    header: RosHeader
    joint_names: Annotated[list[str], Field(max_length=0)]
    points: Annotated[list[str], Field(max_length=0)]


class RobotTrajectory(Record):
    """A moveit_msgs/RobotTrajectory: format robot-trajectory of a plan.

    Attributes:
        joint_trajectory: The motion.
        multi_dof_joint_trajectory: That of no joints.
    """

    joint_trajectory: JointTrajectory
    multi_dof_joint_trajectory: NoJoints


class FollowJointTrajectoryGoal(Record):
    """A control_msgs/action/FollowJointTrajectory goal: format follow-joint-trajectory of a plan.

    Attributes:
        trajectory: The motion.
        multi_dof_trajectory: That of no joints.
        path_tolerance: Empty: as the controller has it.
        component_path_tolerance: Empty: as the controller has it.
        goal_tolerance: Empty: as the controller has it.
        component_goal_tolerance: Empty: as the controller has it.
        goal_time_tolerance: 0: as the controller has it.
    """

    trajectory: JointTrajectory
    multi_dof_trajectory: NoJoints
    path_tolerance: Annotated[list[str], Field(max_length=0)]
    component_path_tolerance: Annotated[list[str], Field(max_length=0)]
    goal_tolerance: Annotated[list[str], Field(max_length=0)]
    component_goal_tolerance: Annotated[list[str], Field(max_length=0)]
    goal_time_tolerance: RosTime


class NamedMessage(Record):
    """A motion of a task, as a message.

    Attributes:
        name: The name of the motion.
        begin: Seconds of motion before it.
        gripper_width: Metres between the finger pads during it; null or 0 without fingers.
        trajectory: The motion; it has its own time 0.
    """

    name: str
    begin: float
    gripper_width: float | None
    trajectory: JointTrajectory | RobotTrajectory | FollowJointTrajectoryGoal


class TaskMessages(Record):
    """The motions of a task: formats joint-trajectory, robot-trajectory and follow-joint-trajectory of a task.

    Attributes:
        motions: In order; the arm stands between them, and a gripper whose width changes is to be waited for.
    """

    motions: list[NamedMessage]


class RosJointState(Record):
    """A sensor_msgs/JointState.

    Attributes:
        header: Its time.
        name: The joints.
        position: Their positions, in rad (m of joints that slide).
        velocity: Empty.
        effort: Empty.
    """

    header: RosHeader
    name: list[str]
    position: list[float]
    velocity: list[float]
    effort: list[float]


class NoJointState(Record):
    """A sensor_msgs/MultiDOFJointState of no joints.

    Attributes:
        header: Its time.
        joint_names: Empty.
        transforms: Empty.
        twist: Empty.
        wrench: Empty.
    """

    header: RosHeader
    joint_names: Annotated[list[str], Field(max_length=0)]
    transforms: Annotated[list[str], Field(max_length=0)]
    twist: Annotated[list[str], Field(max_length=0)]
    wrench: Annotated[list[str], Field(max_length=0)]


class RobotState(Record):
    """A moveit_msgs/RobotState.

    Attributes:
        joint_state: Where the joints are.
        multi_dof_joint_state: That of no joints.
        attached_collision_objects: Empty.
        is_diff: false
    """

    joint_state: RosJointState
    multi_dof_joint_state: NoJointState
    attached_collision_objects: Annotated[list[str], Field(max_length=0)]
    is_diff: bool


class DisplayTrajectory(Record):
    """A moveit_msgs/DisplayTrajectory: format display-trajectory.

    Attributes:
        model_id: The name of the robot.
        trajectory: The motions in order, each with its own time 0.
        trajectory_start: Where the robot starts.
    """

    model_id: str
    trajectory: list[RobotTrajectory]
    trajectory_start: RobotState


# LeRobot.


class FirstAction(Record):
    """Where a motion begins among actions.

    Attributes:
        name: The name of the motion.
        first: The number of its first action, from 0.
    """

    name: str
    first: Count


class LeRobotActions(Record):
    """Actions of LeRobot: format lerobot.

    Attributes:
        fps: Actions in a second.
        motions: Where each motion begins.
        actions: For each instant the position of each joint by its name and `.pos`, in rad (m of joints that slide).
    """

    fps: float
    motions: list[FirstAction]
    actions: list[dict[str, float]]


TRAJECTORIES: tuple[type[Record], ...] = (
    *(SampledReply, JointTrajectory, RobotTrajectory, FollowJointTrajectoryGoal),
    *(TaskMessages, DisplayTrajectory, LeRobotActions),
)
"""What ``GET /plans/{plan}/trajectory`` answers, by its format."""

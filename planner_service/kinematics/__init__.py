"""Where the tool is and how to bring it somewhere: inverse kinematics, tool poses as goals, straight tool lines."""

from planner_service.kinematics.inverse import (
    LineStop,
    LineStopReason,
    ToolLine,
    inverse_kinematics,
    straight_tool_line,
)
from planner_service.kinematics.pose_goal import PoseGoal

__all__ = ["LineStop", "LineStopReason", "PoseGoal", "ToolLine", "inverse_kinematics", "straight_tool_line"]

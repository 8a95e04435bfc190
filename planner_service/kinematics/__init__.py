"""Where the tool is and how to bring it somewhere: inverse kinematics, tool poses as goals, straight tool lines."""

from planner_service.kinematics.complete_inverse import InverseArcs, InverseSolutions
from planner_service.kinematics.inverse import inverse_arcs, inverse_kinematics
from planner_service.kinematics.line_branches import LineBranches, line_branches
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.kinematics.reachability import Cause, LimitExcess, Slip, Suggestion, Unreachable, why_unreachable
from planner_service.kinematics.tool_line import LineStop, LineStopReason, ToolLine, straight_tool_line

__all__ = [
    "Cause",
    "InverseArcs",
    "InverseSolutions",
    "LimitExcess",
    "LineBranches",
    "LineStop",
    "LineStopReason",
    "PoseGoal",
    "Slip",
    "Suggestion",
    "ToolLine",
    "Unreachable",
    "inverse_arcs",
    "inverse_kinematics",
    "line_branches",
    "straight_tool_line",
    "why_unreachable",
]

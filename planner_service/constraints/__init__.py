"""Constraints that hold along a whole motion: a cup stays upright, a pen on its board, a tray in both hands."""

from planner_service.constraints.toml_reader import load_constraints
from planner_service.constraints.values import (
    Constraint,
    InBox,
    JointRange,
    KeepOrientation,
    KeepUpright,
    OnLine,
    OnPlane,
    RelativePose,
    ToolRegion,
)

__all__ = [
    "Constraint",
    "InBox",
    "JointRange",
    "KeepOrientation",
    "KeepUpright",
    "OnLine",
    "OnPlane",
    "RelativePose",
    "ToolRegion",
    "load_constraints",
]

"""Constraints that hold along a whole motion: a cup stays upright, a pen on its board, a tray in both hands."""

from __future__ import annotations

import os

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


def load_constraints(path: str | os.PathLike[str]) -> tuple[Constraint, ...]:
    """The constraints of a TOML file, whose tables are those of ``planner_service.constraints.toml_reader``.

    Raises:
        InvalidFile: The file cannot be used; all problems found are listed.
    """
    from planner_service.constraints.toml_reader import read_constraints  # pydantic takes 0.1 s

    return read_constraints(path)

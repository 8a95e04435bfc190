"""The options that commands share."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from planner_service.planners import PLANNERS
from planner_service.planning.request import PlanRequest

__all__ = [
    "DEFAULT",
    "SECONDS",
    "Allow",
    "AsJson",
    "Blend",
    "Clearance",
    "Goals",
    "MaxChecks",
    "Out",
    "Padding",
    "Picture",
    "PlannerName",
    "Plot",
    "Polish",
    "RobotName",
    "SceneName",
    "Seed",
    "Start",
    "TimeLimit",
    "TimingName",
    "ToolSpeed",
]

Start = Annotated[str, typer.Option("--start", help="A named pose, or joint values separated by commas.")]
Goals = Annotated[
    list[str],
    typer.Option("--goal", help="As --start, or pose:x,y,z,qw,qx,qy,qz of the tool; given several times, any will do."),
]
RobotName = Annotated[str, typer.Option("--robot", help="Name, or path of a robot.toml.")]
SceneName = Annotated[str, typer.Option("--scene", help="Name, or path of a TOML, MoveIt .scene or URDF file.")]
PlannerName = Annotated[str, typer.Option("--planner", help=f"One of {', '.join(PLANNERS)}, optimise.")]
TimingName = Annotated[str, typer.Option("--timing", help="toppra, trapezoidal or s-curve.")]
Seed = Annotated[int, typer.Option(help="Decides every random choice.")]
MaxChecks = Annotated[int, typer.Option(help="States that a plan may judge.")]
TimeLimit = Annotated[float, typer.Option(help="Wall seconds of a plan; inf for none.")]
Padding = Annotated[float, typer.Option(help="Metres that the search keeps from everything.")]
ToolSpeed = Annotated[float | None, typer.Option(help="Metres per second that the tool may move at most.")]
Blend = Annotated[
    float, typer.Option(help="Radians of path that a blended corner may replace on each side; 0 for stops.")
]
Polish = Annotated[bool, typer.Option("--polish", help="Optimise the path: short, smooth, and clear of everything.")]
Clearance = Annotated[
    float | None,
    typer.Option(help="Metres that an optimised path keeps where there is room.  [default: 0.02]"),
]
Plot = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="Draw the clearance along the path as SVG, with --polish before and after."),
]
Picture = Annotated[str | None, typer.Option("--png", metavar="FILE", help="Draw a picture of it.")]
Out = Annotated[str | None, typer.Option(metavar="FILE", help="Write the plan, or why there is none, to a JSON file.")]
Allow = Annotated[
    list[str] | None,
    typer.Option(metavar="A:B", help="Let a pair touch that FILE exempts without a rule; may be repeated."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]

DEFAULT = PlanRequest((), ())
"""What is asked where nothing else is said."""

SECONDS = math.inf if DEFAULT.time_limit is None else DEFAULT.time_limit
"""Its time limit, as ``--time-limit`` has it."""

"""The options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Annotated

import typer

from planner_service.optimize import Optimise
from planner_service.planners import PLANNERS
from planner_service.planning.request import PlanRequest
from planner_service.records.plan_file import TIMINGS
from planner_service.robot.model import robot_names
from planner_service.scene.scene import scene_names


def _completing(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """A shell completion that offers the names that begin with what is typed."""
    return lambda incomplete: [name for name in names() if name.startswith(incomplete)]


Start = Annotated[str, typer.Option("--start", metavar="Q", help="A named pose, or comma-separated joint values.")]
Goals = Annotated[
    list[str],
    typer.Option(
        "--goal",
        metavar="Q",
        help="Like --start, or a tool pose as pose:x,y,z,qw,qx,qy,qz. Repeat it to accept any of several goals.",
    ),
]
RobotName = Annotated[
    str,
    typer.Option(
        "--robot",
        metavar="NAME",
        help="A robot's name, or a robot.toml or URDF file.",
        autocompletion=_completing(robot_names),
    ),
]
SceneName = Annotated[
    str,
    typer.Option(
        "--scene",
        metavar="NAME",
        help="A scene's name, or a file: TOML, MoveIt .scene, URDF, SDF, a mesh, points or an OctoMap.",
        autocompletion=_completing(scene_names),
    ),
]
PlannerName = Annotated[
    str,
    typer.Option(
        "--planner",
        metavar="NAME",
        help=f"One of {', '.join(PLANNERS)}, {Optimise.name}.",
        autocompletion=_completing(lambda: [*PLANNERS, Optimise.name]),
    ),
]
TimingName = Annotated[
    str,
    typer.Option(
        "--timing", metavar="LAW", help=f"One of {', '.join(TIMINGS)}.", autocompletion=_completing(lambda: TIMINGS)
    ),
]
Seed = Annotated[int, typer.Option(metavar="N", help="Seed of every random choice.")]
MaxChecks = Annotated[int, typer.Option(metavar="N", help="States that may be checked for collision in one plan.")]
TimeLimit = Annotated[float, typer.Option(metavar="SECONDS", help="Wall time of one plan; inf for no limit.")]
Padding = Annotated[float, typer.Option(metavar="METRES", help="Distance to keep from everything.")]
StartOverlap = Annotated[
    float,
    typer.Option(
        metavar="METRES",
        help="Overlap at the start up to which the plan begins with a way out of it; 0 to refuse such a start.",
    ),
]
ToolSpeed = Annotated[float | None, typer.Option(metavar="M/S", help="Maximum speed of the tool.")]
Torque = Annotated[bool, typer.Option("--torque", help="Keep the joints within the efforts of the robot's URDF.")]
PayloadText = Annotated[
    str | None,
    typer.Option(
        "--payload",
        metavar="KG[,X,Y,Z]",
        help="Mass at the tool, and its centre in the tool frame in metres; implies --torque.",
    ),
]
Blend = Annotated[
    float,
    typer.Option(metavar="RAD", help="Length of path on each side of a corner that may be rounded; 0 to stop there."),
]
Polish = Annotated[bool, typer.Option("--polish", help="Optimise the path: shorter, smoother, with more clearance.")]
Clearance = Annotated[
    float | None,
    typer.Option(metavar="METRES", help="Clearance an optimised path keeps where there is room.  [default: 0.02]"),
]
Upright = Annotated[
    float | None,
    typer.Option(
        metavar="RAD",
        help="Keep upright, within so many radians, the axis of the tool that points up most at the start.",
    ),
]
UprightObject = Annotated[
    float | None,
    typer.Option("--upright", metavar="RAD", help="How far the object may lean while it is carried; any if not given."),
]
Region = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="Keep the constraints in this TOML file: tool regions and joint ranges."),
]
OtherRobot = Annotated[str | None, typer.Option("--robot", metavar="NAME", help="Use this robot, not the one in FILE.")]
OtherScene = Annotated[str | None, typer.Option("--scene", metavar="NAME", help="Use this scene, not the one in FILE.")]
Target = Annotated[str, typer.Option("--object", metavar="NAME", help="The obstacle to pick up.")]
Onto = Annotated[str, typer.Option(metavar="NAME", help="The obstacle to place it on, in the middle.")]
Plot = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="Plot the clearance along the path as SVG; with --polish, before and after."),
]
Picture = Annotated[str | None, typer.Option("--png", metavar="FILE", help="Draw a PNG picture.")]
PlanFile = Annotated[str, typer.Argument(metavar="FILE", help="A plan or task saved with --out.")]
Out = Annotated[str | None, typer.Option(metavar="FILE", help="Save the plan, or the failure, as a JSON file.")]
Allow = Annotated[
    list[str] | None,
    typer.Option(metavar="A:B", help="Confirm a pair that FILE lets touch without a rule of its own. May be repeated."),
]
PackageDirs = Annotated[
    list[str] | None,
    typer.Option("--package-dir", metavar="DIR", help="A folder to search for meshes. May be repeated."),
]
VisualAsCollision = Annotated[
    bool, typer.Option("--visual-as-collision", help="Check links without collision elements as they look.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]

DEFAULT = PlanRequest((), ())
"""The defaults of a request."""

SECONDS = math.inf if DEFAULT.time_limit is None else DEFAULT.time_limit
"""The default of ``--time-limit``."""
Workers = Annotated[int | None, typer.Option(metavar="N", help="Worker processes; default: one per core.")]

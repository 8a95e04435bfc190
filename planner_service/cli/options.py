"""The options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Annotated, Any

import typer

from planner_service.optimize import Optimise
from planner_service.planners import PLANNERS
from planner_service.planning.request import PlanRequest
from planner_service.records.plan_file import TIMINGS
from planner_service.robot.model import robot_names
from planner_service.scene.scene import scene_names


def option(*texts: str, **more: Any) -> Any:
    """An option: its names unless its parameter's is the only one, its value's if it has one, and its help."""
    names, words = [text for text in texts if text.startswith("-")], [text for text in texts if text[0] != "-"]
    return typer.Option(*names, metavar=words[0] if len(words) > 1 else None, help=words[-1], **more)


def argument(metavar: str, help: str) -> Any:
    """An argument by what it is called, and help."""
    return typer.Argument(metavar=metavar, help=help)


def example(command: str) -> str:
    """What stands below a command's help."""
    return f"\b\nExample:\n  planner-service {command}"


def _completing(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """A shell completion that offers the names that begin with what is typed."""
    return lambda incomplete: [name for name in names() if name.startswith(incomplete)]


Start = Annotated[str, option("--start", "Q", "A named pose, or comma-separated joint values.")]
Goals = Annotated[
    list[str],
    option(
        "--goal",
        "Q",
        "Like --start, or a tool pose as pose:x,y,z,qw,qx,qy,qz. Repeat it to accept any of several goals.",
    ),
]
RobotName = Annotated[
    str,
    option("--robot", "NAME", "A robot's name, or a robot.toml or URDF file.", autocompletion=_completing(robot_names)),
]
SceneName = Annotated[
    str,
    option(
        "--scene",
        "NAME",
        "A scene's name, or a file: TOML, MoveIt .scene, URDF, SDF, a mesh, points or an OctoMap.",
        autocompletion=_completing(scene_names),
    ),
]
PlannerName = Annotated[
    str,
    option(
        "--planner",
        "NAME",
        f"One of {', '.join(PLANNERS)}, {Optimise.name}.",
        autocompletion=_completing(lambda: [*PLANNERS, Optimise.name]),
    ),
]
TimingName = Annotated[
    str, option("--timing", "LAW", f"One of {', '.join(TIMINGS)}.", autocompletion=_completing(lambda: TIMINGS))
]
Seed = Annotated[int, option("N", "Seed of every random choice.")]
MaxChecks = Annotated[int, option("N", "States that may be checked for collision in one plan.")]
TimeLimit = Annotated[float, option("SECONDS", "Wall time of one plan; inf for no limit.")]
Padding = Annotated[float, option("METRES", "Distance to keep from everything.")]
StartOverlap = Annotated[
    float,
    option(
        "METRES", "Overlap at the start up to which the plan begins with a way out of it; 0 to refuse such a start."
    ),
]
ToolSpeed = Annotated[float | None, option("M/S", "Maximum speed of the tool.")]
Torque = Annotated[bool, option("--torque", "Keep the joints within the efforts of the robot's URDF.")]
PayloadText = Annotated[
    str | None,
    option(
        "--payload", "KG[,X,Y,Z]", "Mass at the tool, and its centre in the tool frame in metres; implies --torque."
    ),
]
Blend = Annotated[float, option("RAD", "Length of path on each side of a corner that may be rounded; 0 to stop there.")]
Polish = Annotated[bool, option("--polish", "Optimise the path: shorter, smoother, with more clearance.")]
Clearance = Annotated[
    float | None, option("METRES", "Clearance an optimised path keeps where there is room.  [default: 0.02]")
]
Upright = Annotated[
    float | None,
    option("RAD", "Keep upright, within so many radians, the axis of the tool that points up most at the start."),
]
UprightObject = Annotated[
    float | None, option("--upright", "RAD", "How far the object may lean while it is carried; any if not given.")
]
Region = Annotated[str | None, option("FILE", "Keep the constraints in this TOML file: tool regions and joint ranges.")]
OtherRobot = Annotated[str | None, option("--robot", "NAME", "Use this robot, not the one in FILE.")]
OtherScene = Annotated[str | None, option("--scene", "NAME", "Use this scene, not the one in FILE.")]
Target = Annotated[str, option("--object", "NAME", "The obstacle to pick up.")]
Onto = Annotated[str, option("NAME", "The obstacle to place it on, in the middle.")]
Plot = Annotated[
    str | None, option("FILE", "Plot the clearance along the path as SVG; with --polish, before and after.")
]
Picture = Annotated[str | None, option("--png", "FILE", "Draw a PNG picture.")]
PlanFile = Annotated[str, argument("FILE", "A plan or task saved with --out.")]
Out = Annotated[str | None, option("FILE", "Save the plan, or the failure, as a JSON file.")]
Allow = Annotated[
    list[str] | None, option("A:B", "Confirm a pair that FILE lets touch without a rule of its own. May be repeated.")
]
PackageDirs = Annotated[
    list[str] | None, option("--package-dir", "DIR", "A folder to search for meshes. May be repeated.")
]
VisualAsCollision = Annotated[
    bool, option("--visual-as-collision", "Check links without collision elements as they look.")
]
AsJson = Annotated[bool, option("--json", "Print one JSON document instead of tables.")]

DEFAULT = PlanRequest((), ())
"""The defaults of a request."""

SECONDS = math.inf if DEFAULT.time_limit is None else DEFAULT.time_limit
"""The default of ``--time-limit``."""
Workers = Annotated[int | None, option("N", "Worker processes; default: one per core.")]

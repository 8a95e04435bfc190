"""The options that several commands share."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Any, get_type_hints

import typer

from planner_service.cli.exit_codes import bad_input_exits
from planner_service.errors import InvalidRequest
from planner_service.optimize import Optimise
from planner_service.planners import PLANNERS
from planner_service.planning.request import PlanRequest
from planner_service.robot.model import Robot, robot_names
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import scene_names
from planner_service.timing.laws import TIMINGS


def option(*texts: str, **more: Any) -> Any:
    """An option: its names unless its parameter's is the only one, its value's if it has one, and its help."""
    names, words = [text for text in texts if text.startswith("-")], [text for text in texts if text[0] != "-"]
    return typer.Option(*names, metavar=words[0] if len(words) > 1 else None, help=words[-1], **more)


def argument(metavar: str, help: str, **more: Any) -> Any:
    """An argument by what it is called, and help."""
    return typer.Argument(metavar=metavar, help=help, **more)


def example(command: str) -> str:
    """What stands below a command's help."""
    return f"\b\nExample:\n  planner-service {command}"


def _completing(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """A shell completion that offers the names that begin with what is typed."""
    return lambda incomplete: [name for name in names() if name.startswith(incomplete)]


@dataclass(frozen=True)
class RobotChoice:
    """A robot's name or file, and what the other options say of it; see ``load_robot``."""

    name: str
    package_dirs: tuple[str, ...] = ()
    xacro_args: tuple[str, ...] = ()
    locks: tuple[str, ...] = ()
    tool_frame: str | None = None
    gripper: str | None = None

    def __str__(self) -> str:
        return self.name

    def load(self) -> Robot:
        """The robot.

        Raises:
            InvalidRequest: There is no such robot, or an option is wrong.
        """
        return load_robot(
            self.name,
            package_dirs=self.package_dirs,
            xacro_args=xacro_args(self.xacro_args),
            locked_joints=locks(self.locks),
            tool_frame=self.tool_frame,
            gripper=gripper(self.gripper),
        )


WXAI = RobotChoice("wxai")
"""The robot of commands that are given none."""


def locks(texts: Iterable[str]) -> dict[str, float]:
    """Joint positions given as ``joint=value``.

    Raises:
        InvalidRequest: a text is not of this form, or a joint is given twice.
    """
    positions: dict[str, float] = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            position = float(value)
        except ValueError:
            position = None
        if not name or position is None or name in positions:
            raise InvalidRequest("--lock", text, "joint=value, in rad or m, each joint once")
        positions[name] = position
    return positions


def gripper(text: str | None) -> tuple[str, ...] | None:
    """The joints of a gripper, given as ``joint,joint``, or ``none`` for no joint; None if nothing is given."""
    return None if text is None else () if text == "none" else tuple(text.split(","))


def xacro_args(texts: Iterable[str]) -> dict[str, str]:
    """Arguments of a xacro file given as ``name:=value``.

    Raises:
        InvalidRequest: a text is not of this form, or an argument is given twice.
    """
    given: dict[str, str] = {}
    for text in texts:
        name, mark, value = text.partition(":=")
        if not name or not mark or name in given:
            raise InvalidRequest("--xacro-arg", text, "name:=value, each argument once")
        given[name] = value
    return given


def chosen(robot: str | RobotChoice) -> RobotChoice:
    """The robot of a text on the command line."""
    return robot if isinstance(robot, RobotChoice) else RobotChoice(robot)


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
    RobotChoice,
    option(
        "--robot",
        "NAME",
        "A robot's name, or a robot.toml, URDF, xacro or MJCF file.",
        parser=chosen,
        autocompletion=_completing(robot_names),
    ),
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
Improve = Annotated[int, option("N", "Further searches for a shorter path; they end early where none can be.")]
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
Region = Annotated[
    str | None,
    option("FILE", "Keep the constraints in this TOML file: tool regions and joint ranges."),
]
OtherRobot = Annotated[
    RobotChoice | None,
    option("--robot", "NAME", "Use this robot, not the one in FILE.", parser=chosen),
]
OtherScene = Annotated[str | None, option("--scene", "NAME", "Use this scene, not the one in FILE.")]
Target = Annotated[str, option("--object", "NAME", "The obstacle to pick up.")]
Onto = Annotated[str, option("NAME", "The obstacle to place it on, in the middle.")]
Plot = Annotated[
    str | None, option("FILE", "Plot the clearance along the path as SVG; with --polish, before and after.")
]
Picture = Annotated[str | None, option("--png", "FILE", "Draw a PNG picture.")]
PlanFile = Annotated[str, argument("FILE", "A plan or task saved with --out.")]
Out = Annotated[str | None, option("FILE", "Save the plan, or the failure, as a JSON file.")]
MemoryFile = Annotated[
    str | None,
    option("FILE", "What this cell has learned: read if the file is there, and written anew with these motions."),
]
Allow = Annotated[
    list[str] | None, option("A:B", "Confirm a pair that FILE lets touch without a rule of its own. May be repeated.")
]
PackageDirs = Annotated[
    list[str] | None,
    option("--package-dir", "DIR", "A folder to search for meshes and ROS packages. May be repeated."),
]
XacroArgs = Annotated[
    list[str] | None,
    option("--xacro-arg", "NAME:=VALUE", "An argument of a xacro file. May be repeated."),
]
Locks = Annotated[
    list[str] | None,
    option("--lock", "JOINT=VALUE", "A joint that stands still, in rad or m. May be repeated."),
]
VisualAsCollision = Annotated[
    bool, option("--visual-as-collision", "Check links without collision elements as they look.")
]
ToolFrame = Annotated[
    str | None,
    option("--tool-frame", "LINK", "The link whose frame is the tool's; else what its name makes likely."),
]
GripperJoints = Annotated[
    str | None,
    option("--gripper", "JOINT,JOINT", "The joints of its gripper's fingers; none: they move like others."),
]
OF_ROBOT = {
    "package_dirs": PackageDirs,
    "xacro_args": XacroArgs,
    "locks": Locks,
    "tool_frame": ToolFrame,
    "gripper": GripperJoints,
}
NAMES = dict(zip(OF_ROBOT, ("--package-dir", "--xacro-arg", "--lock", "--tool-frame", "--gripper"), strict=True))
"""The options of commands that take a robot, and their names, by what they are of a ``RobotChoice``."""
AsJson = Annotated[bool, option("--json", "Print one JSON document instead of tables.")]

DEFAULT = PlanRequest((), ())
"""The defaults of a request."""

SECONDS = math.inf if DEFAULT.time_limit is None else DEFAULT.time_limit
"""The default of ``--time-limit``."""
Workers = Annotated[int | None, option("N", "Worker processes; default: one per core.")]


def taking_robot(command: Callable[..., None], parameter: str = "robot") -> Callable[..., None]:
    """The command with the options that say more of the robot of its ``parameter``, which has them as it is called."""
    hints, plain = get_type_hints(command, include_extras=True), inspect.signature(command).parameters

    @functools.wraps(command)
    def whole(**given: Any) -> None:
        said = {key: value for key in OF_ROBOT if (value := given.pop(key)) is not None}
        for key, value in said.items():
            with bad_input_exits():
                if given[parameter] is None:
                    raise InvalidRequest(NAMES[key], value, "an option together with the robot that it is about")
        if said:
            lists = {key: tuple(value) if isinstance(value, list) else value for key, value in said.items()}
            given[parameter] = replace(given[parameter], **lists)
        command(**given)

    added = [inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=None) for key in OF_ROBOT]
    every = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in (*plain.values(), *added)]
    hints |= OF_ROBOT
    whole.__annotations__ = hints
    whole.__dict__["__signature__"] = inspect.Signature([one.replace(annotation=hints[one.name]) for one in every])
    return whole

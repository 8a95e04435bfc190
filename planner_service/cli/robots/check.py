"""The command ``robot check``: what is wrong with a robot's file, in words, as JSON and as a picture."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from planner_service.cli import options
from planner_service.cli.exit_codes import NO_PLAN, bad_input_exits, report_error
from planner_service.cli.options import argument
from planner_service.cli.output import show, wrapped
from planner_service.files.writing import require_writable
from planner_service.robot_setup.check_robot import RobotCheck, check_robot
from planner_service.view.still.pictures import draw_robot_check

__all__ = ["robot_commands"]

robot_commands = typer.Typer(help="Look at robots of one's own.", no_args_is_help=True, rich_markup_mode=None)


@robot_commands.callback()
def _of_its_own() -> None:
    """Keep ``check`` a command below ``robot``, which it would not be by itself."""


@robot_commands.command(
    "check",
    short_help="Look for mistakes in a URDF.",
    epilog=options.example("robot check arm.urdf --png arm.png"),
)
def check(
    urdf: Annotated[str, argument("ROBOT", "A robot's name, or a robot.toml, URDF, xacro or MJCF file.")],
    package_dir: options.PackageDirs = None,
    xacro_arg: options.XacroArgs = None,
    lock: options.Locks = None,
    tool_frame: options.ToolFrame = None,
    gripper: options.GripperJoints = None,
    visual_as_collision: options.VisualAsCollision = False,
    png: options.Picture = None,
    as_json: options.AsJson = False,
) -> None:
    """Look for mistakes in a URDF: units, limits, links that are never checked, a home in collision.

    Exit codes: 0 the robot can be loaded, perhaps with warnings; 1 it cannot.
    """
    with bad_input_exits():
        if png is not None:
            require_writable(Path(png))
        found = check_robot(
            urdf,
            package_dir or (),
            visual_as_collision=visual_as_collision,
            xacro_args=options.xacro_args(xacro_arg or ()),
            locked_joints=options.locks(lock or ()),
            tool_frame=tool_frame,
            gripper=options.gripper(gripper),
        )
        if png is not None:
            if found.robot is None:
                report_error("note: no picture: nothing can be made of this URDF")
            else:
                draw_robot_check(found, png)
    show(_record(found), *_lines(found), as_json=as_json)
    raise typer.Exit(0 if found.ok else NO_PLAN)


def _lines(check: RobotCheck) -> list[str]:
    errors = sum(finding.is_error for finding in check.findings)
    warnings = len(check.findings) - errors
    title = f"{check.path}: {_counted(errors, 'error')}, {_counted(warnings, 'warning')}"
    lines = [f"{'error' if finding.is_error else 'warning'}: {finding}" for finding in check.findings]
    return [title, *_gripper(check), *([""] if lines else []), *wrapped(lines)]


def _gripper(check: RobotCheck) -> list[str]:
    gripper = None if check.robot is None else check.robot.gripper
    if gripper is None:
        return []
    width = f"opens {1000 * gripper.lower:.1f} to {1000 * gripper.upper:.1f} mm"
    return [f"gripper: {gripper.kind}, {', '.join(gripper.joints)}, {width}"]


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _record(check: RobotCheck) -> dict[str, Any]:
    findings = [
        {
            "kind": finding.kind.value,
            "error": finding.is_error,
            "links": list(finding.links),
            "joints": list(finding.joints),
            "text": finding.text,
            "advice": finding.advice,
        }
        for finding in check.findings
    ]
    overhangs = {link: None if math.isinf(metres) else metres for link, metres in check.overhangs.items()}
    robot = check.robot
    gripper = None if robot is None else robot.gripper
    home = {} if robot is None else dict(zip(robot.joint_names, robot.home.tolist(), strict=True))
    return {
        "urdf": str(check.path),
        "ok": check.ok,
        "tool_frame": None if robot is None else robot.tool_frame,
        "home": home,
        "locked_joints": {} if robot is None else dict(robot.locked_joints),
        "findings": findings,
        "overhangs": overhangs,
        "gripper": None if gripper is None else {"kind": gripper.kind, "joints": list(gripper.joints)},
    }

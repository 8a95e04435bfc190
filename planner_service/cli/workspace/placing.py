"""The command ``planner-service reachability place``: where to put the robot so that its tool gets to given poses."""

from __future__ import annotations

import math
import time
from typing import Annotated, Any

import typer

from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import NO_PLAN, bad_input_exits, report_error
from planner_service.cli.options import option
from planner_service.cli.output import labelled, show, wrapped
from planner_service.cli.workspace.commands import maps, vector
from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.scene.loading import load_scene
from planner_service.workspace import BasePlacement, BaseRegion, PlacedBase, place_base
from planner_service.workspace.placement import BOXES

__all__ = ["place"]


@maps.command(
    short_help="Find where to put the robot.",
    epilog=options.example(
        "reachability place --scene bin --pose 0.33,0,0.15,0.70711,0,0.70711,0 --lower=-0.2,-0.2,0 --upper 0.1,0.2,0"
    ),
)
@options.taking_robot
def place(
    scene: options.SceneName,
    pose: Annotated[
        list[str], option("X,Y,Z,W,X,Y,Z", "A pose that the tool is to reach, in the world. May be repeated.")
    ],
    lower: Annotated[str, option("X,Y,Z", "Corner of where the base may be, in metres.")],
    upper: Annotated[str, option("X,Y,Z", "The opposite corner; equal values fix a coordinate.")],
    robot: options.RobotName = options.WXAI,
    yaw: Annotated[str, option("FROM,TO", "Angles about the world's z axis by which it may be turned (rad).")] = "0,0",
    free_axis: Annotated[str | None, option("X,Y,Z", "Axis of the tool about which any turn will do.")] = None,
    clearance: Annotated[float, option("METRES", "To keep from everything, at each pose.")] = 0.0,
    room: Annotated[float, option("RAD", "To keep from the joint limits, at each pose.")] = 0.0,
    bases: Annotated[int, option("N", "Bases after which the search ends.")] = 5,
    boxes: Annotated[int, option("N", "Parts of the region after which it gives up.")] = BOXES,
    png: options.Picture = None,
    as_json: options.AsJson = False,
) -> None:
    """Find bases from which the tool gets to all poses, with joint values that are free, or prove that there is none.

    Ends with 1 if none is found. A proof is about joint limits and the robot's collisions with itself.
    """
    with bad_input_exits():
        arguments.require_outputs({"--png": png})
        arm, world = robot.load(), load_scene(scene)
        axis = None if free_axis is None else vector("--free-axis", free_axis, 3)
        goals = [_goal(text, axis) for text in pose]
        low, high, angles = vector("--lower", lower, 3), vector("--upper", upper, 3), vector("--yaw", yaw, 2)
        region = BaseRegion((low[0], low[1], low[2]), (high[0], high[1], high[2]), (angles[0], angles[1]))
        began = time.monotonic()
        found = place_base(
            arm, goals, region, world, clearance=clearance, room=room, most_bases=bases, most_boxes=boxes
        )
        seconds = time.monotonic() - began
        if png is not None and found.bases:
            from planner_service.view.still.maps import draw_base

            draw_base(arm, world, found.bases[0], png)
    count = "1 pose" if len(goals) == 1 else f"{len(goals)} poses"
    title = f"{'placed' if found.bases else 'no base'}: {robot} in {scene}, {count}"
    rows = [("base", _said(base)) for base in found.bases]
    rows += [] if found.bases else [("region", str(found))]
    rows += [("time", f"{seconds:.1f} s")]
    rows += [("picture", png)] if png is not None and found.bases else []
    show({"seconds": seconds, **_record(found)}, *wrapped([title]), *labelled(rows), as_json=as_json)
    if not found.bases:
        report_error(f"no base: {found}")
        raise typer.Exit(NO_PLAN)


def _goal(text: str, axis: tuple[float, ...] | None) -> PoseGoal:
    x, y, z, qw, qx, qy, qz = vector("--pose", text, 7)
    try:
        at = Pose((x, y, z), (qw, qx, qy, qz))
    except InvalidRequest as error:
        raise InvalidRequest("--pose", text, f"a pose: {error}") from None
    return PoseGoal(at, free_axis=None if axis is None else (axis[0], axis[1], axis[2]))


def _said(base: PlacedBase) -> str:
    x, y, z = base.pose.position
    yaw = 2.0 * math.atan2(base.pose.quaternion[3], base.pose.quaternion[0])
    clear, room = 1000.0 * float(base.clearances.min()), float(base.rooms.min())
    return f"{x:.4f}, {y:.4f}, {z:.4f}, yaw {yaw:.4f}: clearance at least {clear:.1f} mm, {room:.3f} rad to the limits"


def _record(found: BasePlacement) -> dict[str, Any]:
    return {
        "proven": found.proven,
        "unsettled": found.unsettled,
        "ruled_out": found.ruled_out.tolist(),
        "bases": [
            {
                "position": list(base.pose.position),
                "quaternion_wxyz": list(base.pose.quaternion),
                "witnesses": base.witnesses.tolist(),
                "clearances": [None if clear == float("inf") else clear for clear in base.clearances.tolist()],
                "rooms": base.rooms.tolist(),
            }
            for base in found.bases
        ],
    }

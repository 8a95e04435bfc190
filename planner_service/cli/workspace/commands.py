"""The commands of ``planner-service reachability``: make a map of where the tool can be, and look at one."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import bad_input_exits
from planner_service.cli.options import argument, option
from planner_service.cli.output import labelled, show, wrapped
from planner_service.errors import InvalidRequest
from planner_service.files.writing import require_writable
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.complete_inverse import closed_loop
from planner_service.presentation.progress import bar
from planner_service.robot.model import Robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene
from planner_service.workspace import (
    ReachabilityMap,
    ToolOrientation,
    VoxelGrid,
    VoxelVerdict,
    load_map,
    prove_again,
    reachability,
    save_map,
)
from planner_service.workspace.map_file import OURS, SUFFIX
from planner_service.workspace.mapping import HALVINGS, Arm

__all__ = ["maps", "vector"]

EVERY = 30.0
"""Seconds after which a map is saved while it is made: so much is lost at most."""

VOXEL = 0.05
"""Metres, unless asked otherwise."""

NAMES = {
    VoxelVerdict.REACHABLE: "reachable",
    VoxelVerdict.OUT_OF_REACH: "out of reach",
    VoxelVerdict.BLOCKED: "blocked",
    VoxelVerdict.SAID_UNREACHABLE: "said to be unreachable",
    VoxelVerdict.UNKNOWN: "unknown",
}

maps = typer.Typer(
    help="Map where the tool can be in a scene: reachable with a witness, proven unreachable, or unknown.",
    short_help="Map where the tool can be, with proofs.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Slice = Annotated[
    str | None,
    option("--slice", "AXIS=METRES", "The voxels to draw, such as z=0.1; default: the level with most to reach."),
]


@maps.command(
    short_help="Make a map and save it.",
    epilog=options.example("reachability build --scene bin --voxel 0.05 --out bin_map.npz --png bin_map.png"),
)
@options.taking_robot
def build(
    out: Annotated[str, option("FILE", "The map's file, an .npz file.")],
    scene: options.SceneName,
    robot: options.RobotName = options.WXAI,
    lower: Annotated[
        str | None, option("X,Y,Z", "Corner of the grid in metres, in the base frame; default: as far as the arm goes.")
    ] = None,
    upper: Annotated[str | None, option("X,Y,Z", "The opposite corner.")] = None,
    voxel: Annotated[float, option("METRES", "Sides of a voxel, at most.")] = VOXEL,
    orientation: Annotated[
        list[str] | None,
        option("W,X,Y,Z", "How the tool is turned, in the base frame; any way if not given. May be repeated."),
    ] = None,
    tolerance: Annotated[float, option("RAD", "By which it may be turned from there.")] = 0.0,
    free_axis: Annotated[str | None, option("X,Y,Z", "Axis of the tool about which any turn will do.")] = None,
    still: Annotated[
        str | None, option("Q", "Where joints stay that do not move the tool: a pose or joint values.")
    ] = None,
    halvings: Annotated[int, option("N", "How often a voxel in doubt is halved; more leaves fewer so.")] = HALVINGS,
    workers: Annotated[int | None, option("N", "Threads; default: one per core.")] = None,
    time_limit: Annotated[
        float, option("SECONDS", "After which the rest stays unknown, for --resume; inf for no limit.")
    ] = math.inf,
    resume: Annotated[bool, option("--resume", "Go on with the map in --out, made here: its proofs count.")] = False,
    png: options.Picture = None,
    across: Slice = None,
    as_json: options.AsJson = False,
) -> None:
    """Map where the tool can be: each voxel has a witness, a proof that no configuration gets there, or neither.

    The map is saved every half minute, and goes on with --resume after it was interrupted. A voxel is blocked if all
    configurations with the tool in it are proven to collide.
    """
    with bad_input_exits():
        _require_map_path(out)
        arguments.require_outputs({"--png": png})
        arm, world = robot.load(), load_scene(scene)
        grid = _grid(arm, lower, upper, voxel)
        sets = _orientations(orientation, tolerance, free_axis)
        rest = None if still is None else arguments.configuration("--still", still, arm)
        row = None if across is None else _slice(across, grid)
        if not time_limit >= 0.0:
            raise InvalidRequest("--time-limit", time_limit, "seconds, at least 0")
        began, made = time.monotonic(), (os.cpu_count() or 1) if workers is None else workers
        found = load_map(out, arm, world, trusted=True) if resume and Path(out).exists() else None
        with bar("blocks", True) as tell:
            while True:
                left = began + time_limit - time.monotonic()
                found = reachability(
                    arm,
                    world,
                    grid,
                    sets,
                    still=rest,
                    halvings=halvings,
                    workers=made,
                    time_limit=max(0.0, min(EVERY, left)),
                    progress=tell,
                    resume=found,
                )
                save_map(found, out)
                if found.complete or left <= EVERY:
                    break
        seconds = time.monotonic() - began
        if png is not None:
            _draw(arm, world, found, png, row)
    notes = [] if found.complete else [f"note: {_undone(found)}; --resume goes on"]
    rows = [*_rows(found), ("time", f"{seconds:.1f} s"), *_picture(png)]
    document = {"file": out, "seconds": seconds, **_record(found), "png": png}
    title = f"mapped: {robot} in {scene}, written to {out}"
    show(document, *wrapped([title]), *labelled(rows), *wrapped(notes), as_json=as_json)


@maps.command(
    "show",
    short_help="Show what is in a saved map.",
    epilog=options.example("reachability show bin_map.npz --scene bin --at 0.3,0,0.1"),
)
@options.taking_robot
def show_map(
    file: Annotated[str, argument("FILE", "A map saved by build.")],
    scene: options.SceneName,
    robot: options.RobotName = options.WXAI,
    at: Annotated[str | None, option("X,Y,Z", "Say what is known of the voxel with this position.")] = None,
    prove: Annotated[bool, option("--prove", "Prove here what the file calls proven; as long as making it.")] = False,
    trust: Annotated[bool, option("--trust", "Take over the proofs of the file: you made it yourself.")] = False,
    workers: Annotated[int | None, option("N", "Threads of --prove; default: one per core.")] = None,
    png: options.Picture = None,
    across: Slice = None,
    as_json: options.AsJson = False,
) -> None:
    """Show a map for the robot and scene that it was made for.

    Each witness is looked at again. What the file calls proven is said to be unreachable, unless you prove it here.
    """
    with bad_input_exits():
        arguments.require_outputs({"--png": png})
        if prove and trust:
            raise InvalidRequest("--trust", True, "not with --prove, which believes nothing")
        arm, world = robot.load(), load_scene(scene)
        found = load_map(file, arm, world, trusted=trust)
        if prove:
            found = prove_again(found, arm, world, workers=(os.cpu_count() or 1) if workers is None else workers)
        row = None if across is None else _slice(across, found.grid)
        asked = [] if at is None else _asked(found, vector("--at", at, 3))
        if png is not None:
            _draw(arm, world, found, png, row)
    rows = [*_rows(found), *(("there", _said(each)) for each in asked), *_picture(png)]
    document = {"file": file, **_record(found), "at": asked, "png": png}
    show(document, *wrapped([f"map: {file}"]), *labelled(rows), as_json=as_json)


def vector(name: str, text: str, size: int) -> tuple[float, ...]:
    """So many finite numbers of a text; the option is named if it has others."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != size or not np.isfinite(values).all():
        raise InvalidRequest(name, text, f"{size} finite numbers, separated by commas")
    return values


def _grid(robot: Robot, lower: str | None, upper: str | None, voxel: float) -> VoxelGrid:
    """The grid between two corners, whose voxels have at most these sides."""
    if not 1e-6 <= voxel <= 100.0:
        raise InvalidRequest("--voxel", voxel, "metres, from 1e-6 to 100")
    far = math.ceil(100.0 * closed_loop(Arm.of(robot, None).robot)[2]) / 100.0
    low, high = (
        (sign * far,) * 3 if text is None else vector(name, text, 3)
        for name, text, sign in (("--lower", lower, -1.0), ("--upper", upper, 1.0))
    )
    counts = tuple(max(1, math.ceil((b - a) / voxel - 1e-9)) for a, b in zip(low, high, strict=True))
    return VoxelGrid((low[0], low[1], low[2]), (high[0], high[1], high[2]), (counts[0], counts[1], counts[2]))


def _orientations(texts: list[str] | None, tolerance: float, free_axis: str | None) -> list[ToolOrientation]:
    axis = None if free_axis is None else vector("--free-axis", free_axis, 3)
    about = None if axis is None else (axis[0], axis[1], axis[2])
    if not texts:
        if about is not None or tolerance:
            name = "--tolerance" if about is None else "--free-axis"
            raise InvalidRequest(
                name, tolerance if about is None else free_axis, "an option together with --orientation"
            )
        return [ToolOrientation(tolerance=math.pi)]
    sets = []
    for text in texts:
        w, x, y, z = vector("--orientation", text, 4)
        sets.append(ToolOrientation((w, x, y, z), tolerance, about))
    return sets


def _slice(text: str, grid: VoxelGrid) -> tuple[int, int]:
    """The axis, and which of the voxels along it, from a text such as ``z=0.1``."""
    axis, _, value = text.partition("=")
    try:
        at = float(value)
    except ValueError:
        at = math.nan
    if axis not in ("x", "y", "z") or not math.isfinite(at):
        raise InvalidRequest("--slice", text, "x, y or z, and metres, such as z=0.1")
    k = "xyz".index(axis)
    low, high = grid.lower[k], grid.upper[k]
    if not low <= at <= high:
        raise InvalidRequest("--slice", text, f"{axis} from {low:g} to {high:g}")
    return k, min(int((at - low) / (2.0 * float(grid.half[k]))), grid.counts[k] - 1)


def _require_map_path(path: str) -> None:
    """Refuse a file that cannot be written before the work whose result would be lost."""
    if Path(path).suffix.lower() != SUFFIX:
        raise InvalidRequest("--out", path, f"a file whose name ends in {SUFFIX}")
    require_writable(path, OURS)


def _draw(robot: Robot, scene: Scene, found: ReachabilityMap, png: str, across: tuple[int, int] | None) -> None:
    from planner_service.view.still.maps import draw_map

    draw_map(robot, scene, found, png, across=across)


def _picture(png: str | None) -> list[tuple[str, str]]:
    return [] if png is None else [("picture", png)]


def _undone(found: ReachabilityMap) -> str:
    return f"{int(found.done.sum()):,} of {found.done.size:,} blocks are done, the rest is unknown"


def _shares(verdicts: FloatArray) -> dict[VoxelVerdict, float]:
    return {kind: float((verdicts == kind).mean()) for kind in NAMES}


def _rows(found: ReachabilityMap) -> list[tuple[str, str]]:
    x, y, z = found.grid.counts
    sides = " x ".join(f"{2000.0 * side:.4g}" for side in found.grid.half.tolist())
    rows = [("voxels", f"{x} x {y} x {z} of {sides} mm")]
    for orientation, verdicts in zip(found.orientations, found.verdicts, strict=True):
        parts = [f"{NAMES[kind]} {100.0 * share:.2f} %" for kind, share in _shares(verdicts).items() if share]
        rows.append(("verdicts", f"{_turned(orientation)}: {', '.join(parts)}"))
    return rows


def _turned(orientation: ToolOrientation) -> str:
    if orientation.tolerance >= math.pi:
        return "any orientation"
    return f"tool {','.join(f'{entry:.4g}' for entry in orientation.quaternion)}"


def _asked(found: ReachabilityMap, position: tuple[float, ...]) -> list[dict[str, Any]]:
    """What is known of a position, for each set of orientations."""
    out = []
    for k, orientation in enumerate(found.orientations):
        q = found.witness(position, k)
        out.append(
            {
                "orientation": _turned(orientation),
                "verdict": NAMES[found.verdict(position, k)],
                "witness": None if q is None else q.tolist(),
            }
        )
    return out


def _said(asked: dict[str, Any]) -> str:
    if asked["witness"] is None:
        return f"{asked['orientation']}: {asked['verdict']}"
    values = ",".join(f"{value:.4f}" for value in asked["witness"])
    return f"{asked['orientation']}: {asked['verdict']}, such as by {values}"


def _record(found: ReachabilityMap) -> dict[str, Any]:
    return {
        "robot": found.robot,
        "scene": found.scene,
        "lower": list(found.grid.lower),
        "upper": list(found.grid.upper),
        "counts": list(found.grid.counts),
        "complete": found.complete,
        "orientations": [
            {
                "quaternion_wxyz": list(orientation.quaternion),
                "tolerance": orientation.tolerance,
                "free_axis": None if orientation.free_axis is None else list(orientation.free_axis),
                "voxels": {NAMES[kind]: int((verdicts == kind).sum()) for kind in NAMES},
            }
            for orientation, verdicts in zip(found.orientations, found.verdicts, strict=True)
        ],
    }

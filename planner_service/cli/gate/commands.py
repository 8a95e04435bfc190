"""The commands of ``planner-service gate``: what it would have refused, and how a driver tracks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import NO_PLAN, bad_input_exits
from planner_service.cli.options import argument, option
from planner_service.cli.output import labelled, show
from planner_service.datasets.recorded import RecordedEpisode, RecordedSet
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import parse_json
from planner_service.files.reading import as_path, read_bytes
from planner_service.gate import ActionGate, Tracking
from planner_service.gate.log import Logged
from planner_service.gate.log_reader import read_log
from planner_service.gate.measuring import Log, Measured, measured_tracking
from planner_service.gate.replay import Replayed, replayed
from planner_service.gate.verdict import Refused
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.scene.loading import load_scene
from planner_service.service import PlannerService

__all__ = ["gates"]

SHOWN = 12
"""Refused episodes of which is said where."""

MAX_LOG = 200_000_000
"""Bytes; an hour at 200 Hz takes about half of it."""

ERROR, JITTER = 0.02, 0.002
"""What is assumed of a driver of which only the goal time is given, in radians (or metres) and seconds."""

ROUNDED = 1.01
"""Times the acceleration limits: what was planned at the limits and stored as float32 is a little beyond."""

gates = typer.Typer(
    help="Replay recorded motions through the gate that proves targets, and measure how a driver tracks.",
    short_help="Replay recordings through the gate; measure a driver.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Pictures = tuple[str | None, str | None]
"""The files of a still picture and of one that moves."""

GoalTime = Annotated[float | None, option("SECONDS", "After which the driver is at a target; default: as measured.")]
Error = Annotated[float, option("RAD", "Between arm and setpoint at most, with --goal-time.")]


@gates.command(
    short_help="What a gate refused, or would have refused of recorded episodes.",
    epilog=options.example("gate replay my_dataset --scene my_cell.toml --png refused.png"),
)
@options.taking_robot
def replay(
    recording: Annotated[str, argument("RECORDING", "A data set's folder in LeRobot's layout, or the log of a gate.")],
    scene: options.SceneName,
    robot: options.RobotName = options.WXAI,
    goal_time: GoalTime = None,
    error: Error = ERROR,
    jitter: Annotated[float, option("SECONDS", "Of the time between targets, with --goal-time.")] = JITTER,
    lag: Annotated[float, option("SECONDS", "By which the arm may be late, with --goal-time.")] = 0.0,
    padding: options.Padding = options.DEFAULT.padding,
    acceleration_scale: Annotated[float, option("X", "Times the acceleration limits that targets may use.")] = ROUNDED,
    allow: options.Allow = None,
    png: options.Picture = None,
    webp: Annotated[str | None, option("FILE", "Draw what was refused as a picture that moves.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Check every target of a recorded data set as the gate would have: how many episodes pass, and where others end.

    What is assumed of the driver is measured from the data set itself unless you give --goal-time. An episode ends at
    its first refused target. Fingers count as all the room that they need at any width. The picture is of the first
    target that is refused for what it would or could touch.

    Of the log of a gate: what it refused or changed, by kind; nothing is checked anew. The picture is of the last
    refusal, and one that moves has a frame for each line.
    """
    with bad_input_exits():
        arguments.require_outputs({"--png": png, "--webp": webp})
        pairs = arguments.pairs_of_texts("--allow", allow or ())
        service = PlannerService(robot.load().with_finger_room(), load_scene(scene), allowed=pairs)
        if not Path(recording).is_dir():
            usual = {"--goal-time": goal_time is None, "--error": error == ERROR, "--jitter": jitter == JITTER}
            usual |= {"--lag": lag == 0.0, "--padding": padding == options.DEFAULT.padding}
            usual |= {"--acceleration-scale": acceleration_scale == ROUNDED}
            _replay_log(recording, service, [name for name, left in usual.items() if not left], (png, webp), as_json)
            return
        recorded = RecordedSet(recording, service.robot.joint_names)
        tracking = Tracking(goal_time, error, jitter, lag) if goal_time else _measured(recorded).tracking()
        gate = ActionGate(
            service,
            rate=recorded.fps,
            tracking=tracking,
            padding=padding,
            acceleration_scale=acceleration_scale,
        )
        done = [(each, replayed(gate, each.states, each.actions)) for each in recorded]
        refused = [(each.number, result) for each, result in done if result.refused is not None]
        places = [r.logged for _, r in refused if r.logged is not None]
        first = next((place for place in places if place.refused is not None and place.refused.at), None)
        drawn = _draw(service, first or next(iter(places), None), places, (png, webp))
    targets, passed = sum(r.targets for _, r in done), sum(r.passed for _, r in done)
    kinds = Counter(r.refused.kind.value for _, r in refused if r.refused is not None)
    document = {
        "dataset": recording,
        "episodes": len(done),
        "refused": len(refused),
        "kinds": dict(kinds),
        "targets": targets,
        "passed": passed,
        "tracking": _assumed(tracking, service.robot),
        "places": [_place(number, result) for number, result in refused],
    }
    lines = [
        f"{len(refused)} of {len(done)} episodes would have been refused in {service.scene.name or 'the scene'}",
        "",
        *labelled(
            [
                ("driver", _words(tracking)),
                ("refused for", _kinds(kinds)),
                ("targets", f"{targets:,}, of which {passed:,} before the first refusal of their episode"),
                *_pictures(drawn, "the first of these places"),
            ]
        ),
        *(_line(number, result) for number, result in refused[:SHOWN]),
        *([f"and {len(refused) - SHOWN} more; --json lists all"] if len(refused) > SHOWN else []),
    ]
    show(document, *lines, as_json=as_json)
    raise typer.Exit(NO_PLAN if refused else 0)


def _replay_log(file: str, service: PlannerService, others: Sequence[str], pictures: Pictures, as_json: bool) -> None:
    """Say what is in the log of a gate.

    Args:
        others: Options that were given and are about data sets.
    """
    if others:
        raise InvalidRequest(others[0], file, "the folder of a data set: a log says what was decided")
    logged = read_log(file, service.robot.n)
    refused = [(line, line.refused) for line in logged if line.refused is not None]
    kinds = Counter(why.kind.value for _, why in refused)
    slowed, repaired = sum(line.speed < 1.0 for line in logged), sum(line.repaired for line in logged)
    unproven = sum(not line.proven for line in logged)
    last = next((line for line, why in reversed(refused) if line.q or why.at), None)
    drawn = _draw(service, last, logged, pictures)
    document = {
        "log": file,
        "lines": len(logged),
        "refused": len(refused),
        "kinds": dict(kinds),
        "slowed": slowed,
        "repaired": repaired,
        "unproven": unproven,
        "places": [{"chunk": line.chunk, "clock": line.time, **_refused(why)} for line, why in refused],
    }
    lines = [
        f"{len(refused)} refusals in {len(logged)} lines of {file}",
        "",
        *labelled(
            [
                ("refused for", _kinds(kinds)),
                ("changed", f"{slowed} slowed down, {repaired} repaired"),
                ("without proof", f"told to stay {unproven} times"),
                *_pictures(drawn, "the last refusal"),
            ]
        ),
        *(f"chunk {line.chunk}, {why.kind.value}: {why.detail}" for line, why in refused[-SHOWN:]),
    ]
    show(document, *lines, as_json=as_json)
    raise typer.Exit(NO_PLAN if refused else 0)


def _draw(service: PlannerService, still: Logged | None, moving: Sequence[Logged], pictures: Pictures) -> Pictures:
    """Draw what is asked for, and say which of it there is."""
    png, webp = pictures
    known = [line for line in moving if line.q or line.rest or (line.refused is not None and line.refused.at)]
    if png is not None and still is not None:
        from planner_service.view.still.pictures import draw_refusal

        draw_refusal(service, still, png)
    if webp is not None and known:
        from planner_service.view.still.moving import draw_refusals

        draw_refusals(service, known, webp)
    return png if still is not None else None, webp if known else None


@gates.command(
    short_help="How a driver tracks, from a log or a data set.",
    epilog=options.example("gate measure my_dataset --robot wxai"),
)
@options.taking_robot
def measure(
    log: Annotated[str, argument("LOG", "A data set's folder, or a file with a JSON object a line.")],
    robot: options.RobotName = options.WXAI,
    spare: Annotated[float, option("X", "Times what was measured that may be assumed.")] = 1.5,
    as_json: options.AsJson = False,
) -> None:
    """Measure what a gate may assume of a driver: goal time, lag, jitter and error.

    The log is a LeRobot data set, or lines {"t": SECONDS, "target": [...]} and {"t": SECONDS, "q": [...]} in the order
    of the robot's joints, of an arm that stands still at first. Move as fast and as loaded as you are going to: what
    was not seen was not measured.
    """
    with bad_input_exits():
        loaded = robot.load()
        if Path(log).is_dir():
            found = _measured(RecordedSet(log, loaded.joint_names))
        else:
            found = measured_tracking([_log_of(as_path("LOG", log), loaded)])
        tracking = found.tracking(_at_least_one(spare))
    errors = dict(zip(loaded.joint_names, found.errors, strict=True))
    document = {
        "rate": found.rate,
        "goal_time": found.goal_time,
        "lag": found.lag,
        "jitter": found.jitter,
        "errors": errors,
        "measurements": found.measurements,
        "tracking": _assumed(tracking, loaded),
    }
    worst = max(errors, key=lambda name: errors[name])
    rows = [
        ("rate", f"{found.rate:.4g} targets a second, give or take {found.jitter * 1e3:.2g} ms"),
        ("goal time", f"{found.goal_time:.3f} s"),
        ("lag", f"{found.lag:.3f} s"),
        ("error", f"at most {errors[worst]:.4g} rad (or m), of {worst}"),
        ("assume", f"with {spare:g} times that: {_words(tracking)}"),
    ]
    title = f"{log}: {found.measurements:,} measurements of {loaded.name}"
    show(document, title, "", *labelled(rows), as_json=as_json)


def _at_least_one(spare: float) -> float:
    if not 1.0 <= spare <= 10.0:
        raise InvalidRequest("--spare", spare, "a number in [1, 10]")
    return spare


def _measured(recorded: RecordedSet) -> Measured:
    """How the driver of a data set tracked; frames are sent and measured at their times."""
    return measured_tracking([_log_of_episode(each, recorded.fps) for each in recorded if len(each.times) > 1])


def _log_of_episode(each: RecordedEpisode, fps: float) -> Log:
    times = np.arange(len(each.times)) / fps  # stored ones are float32
    return Log(times, each.actions, times, each.states)


def _log_of(path: Path, robot: Robot) -> Log:
    """The log in a file of JSON lines.

    Raises:
        InvalidFile: something else is in it.
    """
    rows: dict[str, list[tuple[float, list[float]]]] = {"target": [], "q": []}
    for number, line in enumerate(_lines(path), 1):
        content = parse_json(path, line)
        known = isinstance(content, dict) and isinstance(content.get("t"), int | float) and rows.keys() & content.keys()
        if not known:
            raise InvalidFile(path, [f'line {number} is no object with "t" and "target" or "q"'])
        for key in rows.keys() & content.keys():
            values = content[key]
            right = isinstance(values, list) and len(values) == robot.n
            if not right or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
                raise InvalidFile(path, [f"line {number}: {key} is no list of {robot.n} numbers"])
            rows[key].append((float(content["t"]), [float(v) for v in values]))
    (sent, targets), (times, measured) = (_columns(rows[key], robot.n) for key in ("target", "q"))
    try:
        return Log(sent, targets, times, measured)
    except InvalidRequest as error:
        raise InvalidFile(path, [str(error)]) from None


def _lines(path: Path) -> Iterator[bytes]:
    return (line for line in read_bytes(path, MAX_LOG).splitlines() if line.strip())


def _columns(rows: list[tuple[float, list[float]]], n: int) -> tuple[FloatArray, FloatArray]:
    return np.array([t for t, _ in rows], dtype=np.float64), np.array([q for _, q in rows]).reshape(len(rows), n)


def _assumed(tracking: Tracking, robot: Robot) -> dict[str, Any]:
    errors = dict(zip(robot.joint_names, tracking.of(robot.n).tolist(), strict=True))
    return {"goal_time": tracking.goal_time, "error": errors, "jitter": tracking.jitter, "lag": tracking.lag}


def _words(tracking: Tracking) -> str:
    errors = ", ".join(f"{each:.3g}" for each in np.atleast_1d(tracking.error))
    return (
        f"Tracking(goal_time={tracking.goal_time:.3f}, error=[{errors}], jitter={tracking.jitter:.4f},"
        f" lag={tracking.lag:.3f})"
    )


def _pictures(drawn: Pictures, still: str) -> list[tuple[str, str]]:
    """Lines that say what is in which picture."""
    png, webp = drawn
    return [
        *([] if png is None else [("picture", f"{png}: {still}")]),
        *([] if webp is None else [("moving picture", f"{webp}: one after the other")]),
    ]


def _kinds(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in counts.items()) or "nothing"


def _place(number: int, result: Replayed) -> dict[str, Any]:
    refused = result.refused
    assert refused is not None
    return {"episode": number, "frame": refused.index, "seconds": refused.time, **_refused(refused)}


def _refused(refused: Refused) -> dict[str, Any]:
    return {
        "kind": refused.kind.value,
        "detail": refused.detail,
        "joint": refused.joint,
        "pair": refused.pair,
        "at": list(refused.at),
    }


def _line(number: int, result: Replayed) -> str:
    refused = result.refused
    assert refused is not None
    return f"episode {number}, frame {refused.index} ({refused.time:.2f} s): {refused.kind.value}: {refused.detail}"

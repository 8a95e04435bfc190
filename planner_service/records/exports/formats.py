"""Every format in which a saved plan or task can be had, for the command ``export`` and for servers.

The first table says how each is written and what it keeps: a format of points keeps the proven curve only at its
points, and ``kept`` works out how far what is drawn between them can be from it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.planning.task_result import Segment
from planner_service.presentation.page import recording_bytes
from planner_service.records.exports import mujoco_keyframes
from planner_service.records.exports.deviation import Between
from planner_service.records.exports.mujoco_keyframes import keyframes_text
from planner_service.records.exports.robot_programs import PROGRAMS, program_text
from planner_service.records.exports.samples import array_bytes, lerobot_actions, sampled_motions, worst_deviation
from planner_service.records.exports.trajectory_export import (
    CSV_BEGINNING,
    MESSAGE_BEGINNING,
    csv_text,
    display_trajectory,
    follow_goal,
    joint_trajectory,
    robot_trajectory,
    task_csv_text,
    task_messages,
    yaml_text,
)
from planner_service.records.plan_file import SavedPlan, SavedTask

__all__ = ["FORMATS", "Format", "How", "Saved", "exported", "kept", "one_motion"]

Saved = SavedPlan | SavedTask


@dataclass(frozen=True)
class How:
    """What a format is written with.

    Attributes:
        dt: Seconds between points; the exact end is always one.
        tolerance: Radians between the proven curve and the joint moves of a program.
        yaml: Write messages as YAML instead of JSON.
        model: The MJCF file that keyframes are for.
    """

    dt: float = 0.01
    tolerance: float = 1e-4
    yaml: bool = False
    model: str | None = None


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        media: Its media type.
        beginning: How its files begin; no other file is replaced by one.
        write: From the motions and how.
        between: What its readers draw between points, as far as that is known.
    """

    media: str
    beginning: re.Pattern[bytes]
    write: Callable[[Saved, How], str | bytes]
    between: Between | None = "linear"

    @property
    def is_message(self) -> bool:
        """Whether it can be YAML as well."""
        return self.beginning is MESSAGE_BEGINNING


def exported(saved: Saved, form: str, how: How) -> str | bytes:
    """The motions of a saved plan or task in a format: bytes of a recording or an array, else text.

    Raises:
        UnknownName: There is no such format.
        InvalidRequest: There is no motion in it, or what ``how`` says does not go with the format.
        MissingDependency: What the format needs is not installed.
    """
    if form not in FORMATS:
        raise UnknownName("format", form, tuple(FORMATS))
    if saved.failure is not None:
        raise InvalidRequest("plan", "a failure", "one with a motion")
    if how.yaml and not FORMATS[form].is_message:
        messages = [name for name, each in FORMATS.items() if each.is_message]
        raise InvalidRequest("yaml", form, f"a format of {', '.join(messages)}")
    if (how.model is None) == (form == MUJOCO):
        raise InvalidRequest("model", how.model, f"an MJCF file with format {MUJOCO}, and none with another format")
    return FORMATS[form].write(saved, how)


def kept(saved: Saved, form: str, how: How) -> str:
    """What a format keeps of the proven curve, in a sentence."""
    between, unit = FORMATS[form].between, "rad or m" if any(saved.robot.sliding) else "rad"
    if between is None:
        return f"joint moves, which stop at points of the proven curves and are within {how.tolerance:g} rad of them"
    far = worst_deviation(_motions(saved), saved.robot, how.dt, between)
    drawn = {"linear": "straight lines", "cubic": "cubics", "quintic": "quintics"}[between]
    return f"points of the proven curves; {drawn} between them are within {far:.2g} {unit} of these"


def one_motion(saved: Saved, name: str) -> Saved:
    """One motion of a task, as a task that begins where the motions before it end.

    Args:
        name: Its number from 0, or its name if that is not of several.

    Raises:
        UnknownName: There is none, or there are several.
    """
    names = [segment.name for segment in saved.segments]
    if name in names and names.count(name) == 1:
        number = names.index(name)
    elif name.isdecimal() and int(name) < len(names):
        number = int(name)
    else:
        raise UnknownName("segment", name, [each if names.count(each) == 1 else str(k) for k, each in enumerate(names)])
    if isinstance(saved, SavedPlan):
        return saved
    world = saved.begin
    for segment in saved.segments[:number]:
        world = segment.world_after(world)
    segment = saved.segments[number]
    return replace(saved, begin=segment.world_before(world), segments=(segment,), sections={})


def _motions(saved: Saved) -> Sequence[Segment]:
    if isinstance(saved, SavedTask):
        return saved.segments
    return (Segment("plan", saved.result, saved.robot.gripper_width),)


def _json(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _message(make: Callable[[Saved, How], dict[str, Any]]) -> Callable[[Saved, How], str]:
    return lambda saved, how: (yaml_text if how.yaml else _json)(make(saved, how))


def _trajectories(message: Callable[..., dict[str, Any]], saved: Saved, how: How) -> dict[str, Any]:
    """A message, or for a task a list of them."""
    names = saved.robot.joint_names
    if isinstance(saved, SavedTask):
        return task_messages(saved.segments, names, how.dt, message)
    return message(saved.result, names, how.dt)


def _display(saved: Saved, how: How) -> dict[str, Any]:
    return display_trajectory(_motions(saved), saved.robot.joint_names, how.dt, model_id=saved.robot.name)


def _csv(saved: Saved, how: How) -> str:
    names = saved.robot.joint_names
    if isinstance(saved, SavedTask):
        return task_csv_text(saved.segments, names, how.dt)
    return csv_text(saved.result, names, how.dt)


def _program(form: str) -> Format:
    def write(saved: Saved, how: How) -> str:
        return program_text(form, _motions(saved), saved.robot, dt=how.dt, tolerance=how.tolerance)

    streams = form == "urscript-servoj"
    return Format("text/plain", PROGRAMS[form], write, "linear" if streams else None)


def _recorded(form: str, beginning: bytes, media: str) -> Format:
    def write(saved: Saved, how: How) -> bytes:
        shown = saved.result if isinstance(saved, SavedPlan) else saved
        return recording_bytes(form, saved.service(), shown, dt=how.dt)

    return Format(media, re.compile(beginning), write)


MUJOCO = "mujoco"

JSON = "application/json"


def _messages(message: Callable[..., dict[str, Any]]) -> Format:
    return Format(JSON, MESSAGE_BEGINNING, _message(partial(_trajectories, message)), "quintic")


FORMATS: dict[str, Format] = {
    "joint-trajectory": _messages(joint_trajectory),
    "robot-trajectory": _messages(robot_trajectory),
    "display-trajectory": Format(JSON, MESSAGE_BEGINNING, _message(_display), "quintic"),
    "follow-joint-trajectory": _messages(follow_goal),
    "json": Format(
        JSON,
        re.compile(rb'\s*\{\s*"robot":[^\n]*\s*"joint_names":'),
        lambda saved, how: _json(sampled_motions(_motions(saved), saved.begin, how.dt)),
        "quintic",
    ),
    "csv": Format("text/csv", CSV_BEGINNING, _csv, "quintic"),
    "npy": Format(
        "application/x-npy",
        re.compile(rb"\x93NUMPY"),
        lambda saved, how: array_bytes(_motions(saved), saved.robot, how.dt),
        "quintic",
    ),
    "lerobot": Format(
        JSON,
        re.compile(rb'\s*\{\s*"fps":'),
        lambda saved, how: _json(lerobot_actions(_motions(saved), saved.robot, how.dt)),
    ),
    **{form: _program(form) for form in PROGRAMS},
    MUJOCO: Format(
        "application/xml",
        mujoco_keyframes.BEGINNING,
        lambda saved, how: keyframes_text(
            _motions(saved), saved.robot.joint_names, how.dt, model=how.model if how.model is not None else ""
        ),
        "cubic",
    ),
    "rrd": _recorded("rrd", rb"RRF\d", "application/x-rerun"),
    "mcap": _recorded("mcap", rb"\x89MCAP0\r\n", "application/x-mcap"),
}
"""By name."""

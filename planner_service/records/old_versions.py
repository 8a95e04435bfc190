"""How to plan again what a file of version 1 or 2 holds: it has only the names of its robot and its scene."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["command_of"]


def command_of(content: Mapping[str, Any]) -> str:
    """The command that plans an old file again, as far as it can be worked out."""
    robot, scene, request = (_object(content.get(key)) for key in ("robot", "scene", "request"))
    options = [("--robot", robot.get("name")), ("--scene", scene.get("name"))]
    if content.get("format") == "planner-service/task":
        words = re.fullmatch(r"pick (\S{1,64}) from .{1,64}, place on (\S{1,64})", str(content.get("task"))[:300])
        if words is None:
            return "planner-service pick-place, or the program that made it"
        return _line("pick-place", [*options, ("--object", words[1]), ("--onto", words[2])])
    goals = request.get("goals")
    options += [("--start", _values(request.get("start")))]
    options += [("--goal", _goal(goal)) for goal in (goals if isinstance(goals, list) else [None])[:10]]
    options += [(f"--{key}", _object(request.get(key)).get("name")) for key in ("planner", "timing")]
    return _line("plan", [*options, ("--seed", request.get("seed"))])


def _object(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _line(command: str, options: Sequence[tuple[str, Any]]) -> str:
    """A command line; options whose value is no short plain text are left out."""
    given = [(key, str(value)) for key, value in options if isinstance(value, str | int)]
    parts = [f"{key}={shlex.quote(text)}" for key, text in given if len(text) <= 500 and text.isprintable()]
    return " ".join(["planner-service", command, *parts, "--out=FILE"])


def _values(numbers: Any) -> str | None:
    good = isinstance(numbers, list) and 0 < len(numbers) <= 20 and all(isinstance(v, float | int) for v in numbers)
    return ",".join(repr(float(v)) for v in numbers) if good and all(abs(v) < 1e6 for v in numbers) else None


def _goal(goal: Any) -> str | None:
    pose = _object(goal).get("pose")
    if not isinstance(pose, dict):
        return _values(_object(goal).get("joints"))
    position, turn = _values(pose.get("position")), _values(pose.get("quaternion_wxyz"))
    return None if position is None or turn is None else f"pose:{position},{turn}"

"""Names and texts on their way to an agent: data, which must not read like an instruction.

What stands in a scene may have been named by anybody. An object whose name is more than a plain word is therefore
called ``object_1`` and so on wherever an agent reads of it, in the sentences of planner and proof too; its own name is
said once, quoted and cut, by ``describe_scene``.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Mapping
from dataclasses import replace

from planner_service.errors import InvalidRequest
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["MAX_LABEL", "cut", "plainly_named", "printable", "quoted", "require_plain_names"]

PLAIN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.:/+-]{0,39}", re.ASCII)
"""A word, and too short for a sentence."""

MAX_LABEL = 64
"""Characters of a name that is no plain word."""

MAX_SENTENCE = 600
"""Characters of what planner, proof or driver say; more is cut in the middle."""


def plainly_named(scene: Scene) -> tuple[Scene, Mapping[str, str]]:
    """The scene with plain names and no description, and for each name that was given instead of another, the other."""
    taken, numbers = set(scene.names), itertools.count(1)
    instead: dict[str, str] = {}
    for name in scene.names:
        if not PLAIN.fullmatch(name):
            alias = next(alias for k in numbers if (alias := f"object_{k}") not in taken)
            instead[name] = alias
    obstacles = tuple(replace(body, name=instead.get(body.name, body.name)) for body in scene.obstacles)
    attached = tuple(replace(body, name=instead.get(body.name, body.name)) for body in scene.attached)
    return Scene(obstacles, attached), {alias: name for name, alias in instead.items()}


def require_plain_names(robot: Robot) -> None:
    """Refuse a robot whose links or joints have other names than plain words: they are part of many sentences.

    Raises:
        InvalidRequest: one has.
    """
    for kind, names in (("joint", robot.joint_names), ("link", sorted(robot.links)), ("robot", (robot.name,))):
        for name in names:
            if not PLAIN.fullmatch(name):
                raise InvalidRequest(f"name of a {kind}", name, "at most 40 letters, digits and any of _.:/+-")


def quoted(name: str) -> str:
    """A name as data: in quotes, in ASCII, with escapes for whatever is not printable there, and cut."""
    return json.dumps(name if len(name) <= MAX_LABEL else name[: MAX_LABEL - 3] + "...", ensure_ascii=True)


def printable(text: str) -> str:
    """A text on one line, with escapes for what is not printable."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def cut(text: str) -> str:
    """A sentence of the planner, printable, and shortened in its middle."""
    text = printable(text)
    half = MAX_SENTENCE // 2
    return text if len(text) <= MAX_SENTENCE else f"{text[:half]}...{text[-half:]}"

"""Robot files with a word put somewhere: known and meant, known elsewhere, misspelt or made up. None may be dropped in
silence.

The words, and what they do, are those of the tables that the readers themselves and the documentation use
(``robot/elements``); what the tables say is then compared with the robot that comes out.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from benchmarks.attack.harness import Case, Wrong
from planner_service import Robot
from planner_service.robot.elements.table import Effect, Rule, words_of

__all__ = ["TABLES", "draw_word", "require_told"]

TABLES = {kind: words_of(kind) for kind in ("urdf", "srdf", "mjcf")}

VALUES = ("0", "1", "0.5", "-1", "0.1 0.2 0.3", "1 0 0 0", "true", "j1", "l0", "l1", "revolute", "x")


class _Told(logging.Handler):
    """What is logged."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def _rules(rule: Rule, seen: set[int]) -> Iterator[Rule]:
    if id(rule) not in seen:
        seen.add(id(rule))
        yield rule
        for below in rule.children.values():
            yield from _rules(below, seen)


def _words(kind: str) -> tuple[list[str], list[str]]:
    """All attributes and all elements of a format."""
    rules = list(_rules(TABLES[kind], set()))
    return (
        sorted({name for rule in rules for name in rule.attributes}),
        sorted({tag for rule in rules for tag in rule.children}),
    )


def draw_word(kind: str, text: str, rng: np.random.Generator) -> Case:
    """Where in a file a word is put, as which part of it, and which."""
    count = sum(1 for _ in ElementTree.fromstring(text).iter())
    attributes, tags = _words(kind)
    what = str(rng.choice(("attribute", "attribute", "element", "text")))
    word = str(rng.choice(tags if what == "element" else attributes))
    how = rng.random()
    if how < 0.25 and len(word) > 2:  # misspelt
        at = int(rng.integers(1, len(word)))
        word = word[:at] + word[at - 1] + word[at:]
    elif how < 0.4:
        word = f"w{int(rng.integers(10**6))}"
    elif how < 0.45:
        word = word.upper()
    value = str(rng.choice(VALUES))
    return {"words": kind, "at": int(rng.integers(count)), "what": what, "word": word, "value": value}


def require_told(case: Case, text: str, path: Path, read: Callable[[Path], Robot]) -> str:
    """Read a file with its word and without: it is refused, warned about or listed; what has no effect changes nothing.

    Returns:
        How the word was treated.
    """
    kind, word = case["words"], case["word"]
    plain = _read(text, path, read)[0]
    root = ElementTree.fromstring(text)
    elements = list(_with_rules(root, TABLES[kind], inside=True))
    element, rule = elements[case["at"] % len(elements)]
    effect: Effect | None
    if case["what"] == "attribute":
        if word in element.attrib:
            return "there already"
        element.set(word, case["value"])
        listed = None if rule is None else rule.attributes.get(word, (None, ""))[0]
        effect = _effect(rule, Effect.NONE if word == "xmlns" else listed)  # which only declares names
    elif case["what"] == "element":
        ElementTree.SubElement(element, word)
        below = None if rule is None else rule.children.get(word)
        effect = _effect(rule, None if below is None else below.effect)
    else:
        if (element.text or "").strip():
            return "there already"
        element.text = word
        effect = _effect(rule, None)
    robot, lines = _read(ElementTree.tostring(root, "unicode"), path, read)
    if effect is Effect.READ:
        return "read"
    told = any(word in line for line in lines)
    place = f"{case['what']} {word!r} in <{element.tag}>"
    if effect is not Effect.NONE and not told:
        raise Wrong("a word that no table lists is reported", f"{kind}: {place}")
    if effect is Effect.REFUSED:
        raise Wrong("a word that the table refuses is refused", f"{kind}: {place}")
    if _same(robot) != _same(plain):
        raise Wrong("a word without an effect has none", f"{kind}: {place}")
    return "told" if told else "without effect"


def _effect(rule: Rule | None, listed: Effect | None) -> Effect | None:
    """What the table says of a word; whatever is in an element for another program has no effect."""
    return Effect.NONE if rule is None or not rule.closed else listed


def _with_rules(element: Element, rule: Rule | None, *, inside: bool) -> Iterator[tuple[Element, Rule | None]]:
    """Each element with its rule; None where nothing is looked at."""
    yield element, rule if inside else None
    for child in element:
        below = None if rule is None else rule.children.get(str(child.tag))
        yield from _with_rules(child, below, inside=inside and below is not None and below.closed)


def _read(text: str, path: Path, read: Callable[[Path], Robot]) -> tuple[Robot, list[str]]:
    told, logger = _Told(), logging.getLogger("planner_service")
    path.write_text(text, encoding="utf-8")
    logger.addHandler(told)
    try:
        return read(path), told.lines
    finally:
        logger.removeHandler(told)
        path.unlink()


def _same(robot: Robot) -> Any:
    """What planning uses of a robot."""
    poses = [(name, q.tobytes()) for name, q in robot.named_poses]
    return robot.hash, robot.joint_names, poses, robot.link_frames, robot.continuous, robot.tool_frame

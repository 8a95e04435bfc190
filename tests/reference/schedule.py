"""What touches while a schedule of picks is carried out, by sampling: where everything is follows from the motions.

Nothing of the proof is used. Each arm has its own clock; it holds an object from when its gripper begins to close on
it to when it begins to open. FCL judges all arms, with their grippers as they are, in one world with all objects.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from planner_service import Attached, CollisionChecker, Scene
from planner_service.cell import Arm, Cell
from planner_service.geometry.arrays import FloatArray
from planner_service.scheduling import Chain, Schedule


class Doing(NamedTuple):
    """What an arm does at one moment: its joints, how far its gripper is open, what it holds, and what it has left."""

    q: FloatArray
    width: float
    held: tuple[Attached, ...]
    left: frozenset[str]


class Sampler:
    """Judges a schedule as it is carried out."""

    def __init__(self, schedule: Schedule) -> None:
        self._schedule = schedule
        self._known: dict[object, tuple[Cell, CollisionChecker]] = {}

    def contacts(self, times: FloatArray, late: Mapping[str, FloatArray]) -> Iterator[tuple[float, str]]:
        """When what touches, of times (k,) by the clock of the whole, where arms are late by so much, (k,) each."""
        schedule = self._schedule
        for k, t in enumerate(times.tolist()):
            doing = {name: _doing(schedule, name, t - float(late[name][k])) for name in schedule.starts}
            key = tuple((name, each.width, each.held, each.left) for name, each in doing.items())
            if key not in self._known:
                self._known[key] = _world(schedule, doing)
            cell, checker = self._known[key]
            q = cell.joined({name: each.q for name, each in doing.items()})
            if not checker.state_is_free(q):
                yield t, "; ".join(f"{a} x {b}" for a, b in sorted(checker.touching(q)))


def _doing(schedule: Schedule, name: str, t: float) -> Doing:
    """What an arm does by its own clock."""
    robot = schedule.layout.arms[name].robot
    at = Doing(schedule.starts[name], robot.gripper_width, (), frozenset())
    for chain in sorted(schedule.chains, key=lambda each: each.start):
        if chain.arm == name and chain.start <= t:
            at = _along(chain, t, at)
    return at


def _along(chain: Chain, t: float, at: Doing) -> Doing:
    """The same in a chain, or after it."""
    _, width, held, left = at
    begin, along, world = chain.start, None, chain.task.begin
    for segment in chain.task.segments:
        if t < begin:
            break
        world = segment.world_after(world)
        attached = world.scene.attached
        if held and not attached:
            left = left | {item.name for item in held}
        held = attached
        still = segment.wait
        if segment.gripper is not None:
            still += chain.gripper_seconds
        # while a gripper moves it is as open as before or after, whichever is more
        width = max(width, segment.width) if t < begin + still and not held else segment.width
        begin += still
        along = segment.result.unwrap()[1], t - begin
        begin += along[0].duration
    if along is None:
        return at
    trajectory, since = along
    return Doing(trajectory(min(max(since, 0.0), trajectory.duration)), width, held, left)


def _world(schedule: Schedule, doing: Mapping[str, Doing]) -> tuple[Cell, CollisionChecker]:
    places = {job.object: job.place for job in schedule.jobs}
    held = {item.name for each in doing.values() for item in each.held}
    left = {name for each in doing.values() for name in each.left}
    obstacles = [
        replace(item, pose=places[item.name]) if item.name in left else item
        for item in schedule.layout.scene.obstacles
        if item.name not in held
    ]
    arms = {
        name: Arm(arm.robot.with_gripper(doing[name].width), arm.base) for name, arm in schedule.layout.arms.items()
    }
    fingers = {name: arms[name].robot.gripper for name in arms}
    carried = {
        name: [
            replace(item, touch_links=() if (hand := fingers[name]) is None else _shaped(arms[name], hand.links))
            for item in each.held
        ]
        for name, each in doing.items()
        if each.held
    }
    cell = Cell(arms, Scene(tuple(obstacles)))
    cell = cell.carrying(carried) if carried else cell
    return cell, cell.service.checker


def _shaped(arm: Arm, links: tuple[str, ...]) -> tuple[str, ...]:
    shaped = {item.link for item in arm.robot.shapes}
    return tuple(link for link in links if link in shaped)


def lateness(schedule: Schedule, times: FloatArray, rng: np.random.Generator, most: float) -> dict[str, FloatArray]:
    """Seconds by which arms are late, each by the same all along, or by another amount at every moment."""
    size = 1 if rng.integers(2) else len(times)
    return {name: np.broadcast_to(rng.uniform(0.0, most, size), times.shape) for name in schedule.starts}


__all__ = ["Doing", "Sampler", "lateness"]

"""Values hold copies: what a caller does with its arrays, lists and mappings afterwards changes nothing."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import planner_service as ps
from planner_service.planning.request import World
from planner_service.roadmap import Built

CORNERS = [[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)]
PATH = ps.JointPath(np.array([[0.0, 0.0], [1.0, 1.0]]))
DRIVEN = ps.Trapezoidal().time_path(PATH, ps.JointLimits(*(np.array([v, v]) for v in (-3.0, 3.0, 1.0, 1.0, 10.0))))
BOX = ps.Box((0.1, 0.1, 0.1))


def given(value: Any) -> tuple[Any, Callable[[], None]]:
    """A value that can be changed, and what changes all of it."""
    if isinstance(value, np.ndarray):
        mine = value.copy()

        def change() -> None:
            mine[...] = 7

        return mine, change
    if isinstance(value, dict):
        held = dict(value)
        return held, held.clear
    inner = [given(item) if isinstance(item, (list, np.ndarray)) else (item, lambda: None) for item in value]
    rows = [item for item, _ in inner]

    def change_all() -> None:
        for _, each in inner:
            each()
        rows.clear()

    return rows, change_all


def arm_with(**changes: Any) -> Any:
    return replace(ps.load_robot("planar2"), **changes)


VALUES: list[tuple[Callable[[Any], Any], str, Any]] = [
    (lambda v: ps.PlanRequest(v, [0.0, 0.0]), "start", np.array([0.0, 0.5])),
    (lambda v: ps.PlanRequest([0.0, 0.0], v), "goal", [0.0, 0.5]),
    (lambda v: ps.PlanRequest([0.0, 0.0], v), "goal", [[0.0, 0.5], ps.Pose(), np.array([0.1, 0.2])]),
    (ps.JointPath, "waypoints", np.array([[0.0, 0.5], [0.1, 0.2], [0.5, 0.3]])),
    (lambda v: ps.Trajectory(PATH, v, DRIVEN.coefficients), "durations", DRIVEN.durations),
    (ps.Mesh, "vertices", np.array(CORNERS)),
    (lambda v: ps.Compound(v), "parts", [(BOX, ps.Pose()), (ps.Capsule(0.1, 0.2), ps.Pose())]),
    (ps.Pose, "position", np.array([0.1, 0.2, 0.3])),
    (ps.Scene, "obstacles", [ps.Obstacle("a", BOX)]),
    (lambda v: Built("prm", v, 0, ps.CheckCounts()), "settings", {"milestones": 5}),
    (lambda v: ps.PlanResult(None, None, None, (), notes=v), "notes", ["clamped"]),
    (lambda v: ps.TaskResult((), World(ps.load_robot("planar2"), ps.Scene()), v), "q", np.array([0.0, 0.5])),
    (lambda v: arm_with(base_links=v), "base_links", ["stand"]),
]


def arrays(value: Any) -> Iterator[np.ndarray[Any, Any]]:
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from arrays(item)


@pytest.mark.parametrize(("make", "name", "content"), VALUES)
def test_a_value_is_what_it_was_made_of_whatever_becomes_of_that(
    make: Callable[[Any], Any], name: str, content: Any
) -> None:
    mine, change = given(content)
    value = make(mine)
    before = pickle.dumps(getattr(value, name))
    change()
    assert pickle.dumps(getattr(value, name)) == before
    assert not any(array.flags.writeable for array in arrays(getattr(value, name)))
    assert not isinstance(getattr(value, name), list)

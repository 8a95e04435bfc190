"""Suites: which problems, by which planners, with which seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.worlds import queries
from planner_service.geometry.arrays import FloatArray
from planner_service.planners import AORRTC, BKPIECE1, LBKPIECE1, BITstar, Planner
from planner_service.records import read_problems

__all__ = ["SUITES", "Motion", "Suite", "published", "stored", "suite_named"]

PUBLIC = Path(__file__).parents[1] / "problems" / "mbm_panda.json"


@dataclass(frozen=True, eq=False)
class Motion:
    """From a configuration to one of several, in a scene.

    Attributes:
        id: Once in a suite, such as ``bin/3``.
        kind: What it is one of, such as ``bin``.
        robot: The name of a robot.
        start: Shape (n,).
        goals: Shape (n,) each, or a pose of the tool; any of them will do.
    """

    id: str
    kind: str
    robot: str
    scene: ps.Scene
    start: FloatArray
    goals: tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Suite:
    """Problems, and by which planners and with which seeds they are planned when nobody says otherwise.

    Attributes:
        max_checks: States a plan may judge.
        ceilings: By planner, the most that p95 of its states may be.
    """

    name: str
    about: str
    planners: Mapping[str, Planner]
    seeds: range
    sources: tuple[Callable[[], Iterator[Motion]], ...]
    ceilings: Mapping[str, int] = field(default_factory=dict)
    max_checks: int = 50_000

    @cached_property
    def problems(self) -> tuple[Motion, ...]:
        """The problems of all sources."""
        return tuple(problem for source in self.sources for problem in source())


def stored(scenes: Sequence[str], numbers: Sequence[int] = range(queries.PER_SCENE)) -> Iterator[Motion]:
    """The stored queries of the WidowX AI."""
    for name in scenes:
        scene, asked = ps.load_scene(name), queries.load(name)
        for query in (asked[k] for k in numbers):
            yield Motion(f"{name}/{query.number}", name, queries.ROBOT, scene, query.start, (query.goal,))


def public(ids: Sequence[str] = ()) -> Iterator[Motion]:
    """The public Panda problems, or some of them."""
    for problem in read_problems(PUBLIC).problems:
        if not ids or problem.id in ids:
            kind = problem.id.partition("/")[0]
            yield Motion(problem.id, kind, "panda_mbm", problem.scene, problem.start, problem.goals)


def published(path: str | Path, name: str) -> Suite:
    """The problems of a published set, for a robot that comes with the package.

    Raises:
        InvalidFile: they cannot be read.
        UnknownName, InvalidRequest: there is no such robot, or the problems are for another one.
    """
    robot = ps.load_robot(name)
    asked = [(problem, problem.request(robot)) for problem in read_problems(path).problems]

    def motions() -> Iterator[Motion]:
        for problem, request in asked:
            goals = tuple(problem.goals) if len(problem.goals) > 1 else (request.goal,)
            yield Motion(
                problem.id, problem.id.partition("/")[0], name, problem.scene, np.asarray(request.start), goals
            )

    return Suite(Path(path).stem, f"{path}, {name}", TREES, range(1), (motions,))


TABLETOP, NARROW = ("bin", "shelf", "post", "clutter"), ("narrow", "window")
TREES: Mapping[str, Planner] = {planner.name: planner for planner in (ps.BalancedRRTConnect(), ps.RRTConnect())}
WIDELY: Mapping[str, Planner] = {
    **TREES,
    **{planner.name: planner for planner in (ps.RRT(), LBKPIECE1())},
    **{f"{planner.name}:checks=4000": planner for planner in (BITstar(checks=4000), AORRTC(checks=4000))},
    "prm:milestones=200": ps.PRM(milestones=200),
}
INTO: Mapping[str, Planner] = {**TREES, "lbkpiece1": LBKPIECE1(), "bkpiece1": BKPIECE1()}
SMOKE: Mapping[str, Planner] = {**TREES, "lbkpiece1": LBKPIECE1(), "prm:milestones=100": ps.PRM(milestones=100)}
SMOKE_PUBLIC = ("bookshelf_thin/0087", "cage/0057", "table_under_pick/0037")

_ALL = (
    Suite(
        "smoke",
        "A few queries of each kind: what CI plans at every change",
        SMOKE,
        range(2),
        (partial(stored, (*TABLETOP, *NARROW), (0, 1)), partial(public, SMOKE_PUBLIC)),
        dict(zip(SMOKE, (8_000, 8_000, 14_000, 500_000), strict=True)),
    ),
    Suite("tabletop", "The WidowX AI in its four table-top scenes", WIDELY, range(5), (partial(stored, TABLETOP),)),
    Suite("seeds", "One query of each with many seeds", WIDELY, range(20), (partial(stored, TABLETOP, (0,)),)),
    Suite("narrow", "The WidowX AI in narrow passages", INTO, range(5), (partial(stored, NARROW),)),
    Suite("panda", "The 70 public problems of MotionBenchMaker for the Panda", TREES, range(3), (public,)),
)

SUITES: Mapping[str, Suite] = {suite.name: suite for suite in _ALL}


def suite_named(name: str) -> Suite:
    """A suite by its name.

    Raises:
        UnknownName: no such suite.
    """
    if name not in SUITES:
        raise ps.UnknownName("suite", name, tuple(SUITES))
    return SUITES[name]

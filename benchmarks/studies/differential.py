"""Whether the kernel says what FCL says pair by pair: every verdict, count and name, with every instruction set.

States and edges of three kinds: at random; as RRTConnect asks for them; and near contact, no point of the robot being
farther than 2 mm from where something touches first. A million states of each robot take minutes: they are asked in
parts, on every core, and runs with different seeds ask different ones.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import planner_service as ps
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.arms import arms_in
from benchmarks.worlds.contacts import around_contacts, random_states
from planner_service.collision import Known
from planner_service.collision.backends import NativeBackend
from planner_service.collision.budget import SearchStopped
from planner_service.collision.native_kernel import MARGIN, build_kernel, instruction_sets
from planner_service.geometry.arrays import FloatArray
from planner_service.parallel import Lost, Processes, Sequential
from planner_service.records import read_problems
from planner_service.search.problem import SearchOracle, SearchProblem

__all__ = [
    "CASES",
    "EDGES",
    "KINDS",
    "STATES",
    "STEP",
    "Asked",
    "Tally",
    "case",
    "compare",
    "kernels",
    "questions",
    "run",
]

CASES = (
    "wxai bin",
    "panda_mbm shelf",
    "ur5 bin",
    "planar2 pins",
    "example-robot-data:panda shelf",
    "example-robot-data:kinova bin",
)
"""Primitives, hulls, hulls of another arm, an arm in the plane, a finger that mimics another, continuous joints."""

PUBLIC = "problems"
"""The scene of an arm's first public problem."""

KINDS = ("random", "as planned", "near contact")
STATES, EDGES = 1_000_000, 20_000

JITTERS, EACH = (2e-6, 2e-5, 2e-4, 2e-3), 2
"""Metres that any point of the robot may be moved from a contact, and configurations for every one of these."""

STEP, LONGEST = 0.02, 0.8
"""Radians: of the sampling along an edge, and of an edge at random."""

HALVINGS = 45
"""Between a free and a colliding edge: its two ends are one but for rounding, then."""

ON_AN_EDGE = 5
"""States taken from an edge that a search asked for."""

SEARCH_STATES = 5_000
"""After which a search for questions is over."""

BLOCK = 3_000
"""States that are made, and judged, before the next are made."""

PART = 25_000
"""States of a part, at most: a core has some ten seconds to do with it."""

SHOWN = 5
"""Differences that are printed in full."""

Told = tuple[Any, int, int]
"""What was said, and the states and edges counted."""


class Asked(NamedTuple):
    """An edge, which of its ends are known, and whether it is checked coarsely before the rest."""

    q1: FloatArray
    q2: FloatArray
    known: Known
    coarse: bool


@dataclass
class Tally:
    """What was compared of one kind, and every difference."""

    number: int = 0
    colliding: int = 0
    differences: int = 0
    words: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def add(self, told: dict[str, list[Told]], questions: Sequence[object]) -> None:
        """Count what all contestants said of the same questions, the reference being the last."""
        *others, reference = told
        self.number += len(questions)
        self.colliding += sum(said[0] is not None for said in told[reference])
        for name in others:
            for question, said, expected in zip(questions, told[name], told[reference], strict=True):
                if said != expected:
                    self.differences += 1
                    self.words.append(f"{name}, {question}: {said} instead of {expected}")
        del self.words[SHOWN:]

    def merge(self, other: Tally) -> None:
        """Count what was compared elsewhere, too."""
        self.number += other.number
        self.colliding += other.colliding
        self.differences += other.differences
        self.words = [*self.words, *other.words][:SHOWN]
        for name, seconds in other.seconds.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds


def case(name: str, folder: Path | None = None) -> tuple[ps.Robot, ps.Scene]:
    """A robot and a scene by their names, of which ``pins`` and ``cloud`` are made here.

    Args:
        folder: Of the arms of ``arms`` and their problems, where the scene is ``PUBLIC``.
    """
    robot, scene = name.split()
    if scene == PUBLIC:
        (arm,) = arms_in(folder, robot)
        return ps.load_robot(arm.source), read_problems(arm.problems).problems[0].scene
    if scene == "cloud":
        return ps.load_robot(robot), _cloud(ps.load_scene("shelf"))
    if scene == "pins":
        places = ((0.9, 0.5), (-0.7, 0.8), (0.3, -1.2), (-1.1, -0.4))
        pins = [ps.Obstacle(f"pin{k}", ps.Cylinder(0.05, 0.4), ps.Pose((x, y, 0.0))) for k, (x, y) in enumerate(places)]
        return ps.load_robot(robot), ps.Scene(tuple(pins))
    return ps.load_robot(robot), ps.load_scene(scene)


def _cloud(scene: ps.Scene) -> ps.Scene:
    """A scene with a wavy wall of points in front of the robot."""
    steps = np.linspace(-0.35, 0.35, 60)
    y, z = (axis.ravel() for axis in np.meshgrid(steps, steps + 0.35))
    x = 0.42 + 0.04 * np.sin(9.0 * y) * np.cos(7.0 * z)
    wall = ps.PointCloud(np.stack([x, y, z], axis=1), resolution=0.012)
    return scene.with_obstacle(ps.Obstacle("wall", wall))


def kernels(robot: ps.Robot, scene: ps.Scene, margin: float = MARGIN) -> dict[str, ps.CollisionChecker]:
    """A checker for every instruction set the kernel can use here, by its name.

    Args:
        margin: Metres by which the kernel proves pairs apart; another than its own is a mistake to be found.
    """
    found = {}
    for name in instruction_sets():
        checker = ps.CollisionChecker(robot, scene, edge_step=ps.JointStep(STEP), backend="native")
        kernel = build_kernel(robot, checker._parts, name, margin=margin)
        if not isinstance(checker._backend, NativeBackend) or kernel is None:
            raise AssertionError(f"{name}: the kernel is there and is not used")
        checker._backend.kernel = kernel
        vars(checker)["_kernel"] = kernel if checker._configure(kernel) else None
        found[name] = checker
    return found


class _Recorder:
    """An oracle that judges each edge in full when it is asked, and keeps what it was asked about."""

    def __init__(self, checker: ps.CollisionChecker) -> None:
        self._oracle = SearchOracle(checker)
        self.edges: list[Asked] = []

    @property
    def states(self) -> int:
        """States judged so far."""
        return self._oracle.states

    def state_is_free(self, q: FloatArray) -> bool:
        """Whether one configuration is free."""
        return self._oracle.state_is_free(q)

    def edge_is_free(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> bool:
        """Whether an edge is free, which is asked for, and kept."""
        self.edges.append(Asked(q1, q2, known, False))
        return self._oracle.edge_is_free(q1, q2, known=known)


class _Searches:
    """Edges that RRTConnect asks for between configurations drawn at random."""

    def __init__(self, checker: ps.CollisionChecker, rng: np.random.Generator) -> None:
        self._checker, self._rng = checker, rng
        self._edges: list[Asked] = []

    def take(self, count: int) -> list[Asked]:
        """The next so many."""
        while len(self._edges) < count:
            self._edges += self._search()
        taken, self._edges = self._edges[:count], self._edges[count:]
        return taken

    def _search(self) -> list[Asked]:
        checker, limits = self._checker, self._checker.robot.limits
        ends = [q for q in random_states(checker.robot, 40, self._rng) if checker.state_is_free(q)][:2]
        recorder, seed = _Recorder(checker), int(self._rng.integers(2**31))
        if len(ends) == 2:
            problem = SearchProblem(ends[0], ends[1][None], limits.lower, limits.upper, recorder, seed)
            try:
                with checker.limited(states=SEARCH_STATES):
                    ps.RRTConnect().search(problem)
            except SearchStopped:
                pass  # what it asked for so far will do
        return recorder.edges


def questions(
    robot: ps.Robot, scene: ps.Scene, states: int, edges: int, seed: int, part: int = 0
) -> Iterator[tuple[str, FloatArray, list[Asked]]]:
    """Kinds, states (m, n) and edges, in blocks; as many of each kind."""
    rng = np.random.default_rng([seed, robot.n, part])
    checker = ps.CollisionChecker(robot, scene, edge_step=ps.JointStep(STEP))
    searches = _Searches(checker, rng)
    blocks = max(1, -(-states // BLOCK))
    for block in range(blocks):
        for k, kind in enumerate(KINDS):
            m, e = (_share(_share(total, block, blocks), k, len(KINDS)) for total in (states, edges))
            yield kind, _states(kind, checker, m, rng, searches), list(_edges(kind, checker, e, rng, searches))


def _share(total: int, k: int, parts: int) -> int:
    """The k-th of so many nearly equal parts."""
    return total * (k + 1) // parts - total * k // parts


def _states(
    kind: str, checker: ps.CollisionChecker, count: int, rng: np.random.Generator, searches: _Searches
) -> FloatArray:
    if kind == "random":
        return random_states(checker.robot, count, rng)
    if kind == "near contact":
        return around_contacts(checker, count, rng, JITTERS, EACH)[0]
    edges = searches.take(-(-count // ON_AN_EDGE))
    shares = rng.random((len(edges), ON_AN_EDGE)).tolist()
    Q = [a.q1 + (a.q2 - a.q1) * u for a, some in zip(edges, shares, strict=True) for u in some]
    return np.array(Q[:count]).reshape(-1, checker.robot.n)


def _edges(
    kind: str, checker: ps.CollisionChecker, count: int, rng: np.random.Generator, searches: _Searches
) -> Iterator[Asked]:
    if kind == "as planned":
        for k, edge in enumerate(searches.take(count)):
            yield edge._replace(coarse=k % 2 == 1)
        return
    drawn = _drawn_edges(checker, rng)
    for k in range(count):
        ends = next(drawn) if kind == "random" else _grazing(checker, drawn, rng)
        yield Asked(ends[0], ends[1], Known.NEITHER, k % 2 == 1)


def _drawn_edges(checker: ps.CollisionChecker, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Ends (2, n) of edges at random."""
    robot = checker.robot
    while True:
        Q, ways = random_states(robot, BLOCK, rng), rng.normal(size=(BLOCK, robot.n))
        ways *= LONGEST * rng.random((BLOCK, 1)) / np.sqrt((ways * ways).sum(axis=1))[:, None]
        yield from np.stack([Q, np.clip(Q + ways, robot.limits.lower, robot.limits.upper)], axis=1)


def _grazing(checker: ps.CollisionChecker, drawn: Iterator[FloatArray], rng: np.random.Generator) -> FloatArray:
    """Ends (2, n) of an edge next to where edges change from free to colliding."""
    robot, kept = checker.robot, dict[bool, FloatArray]()
    while len(kept) < 2:
        ends = next(drawn)
        kept[checker.edge_is_free(*ends)] = ends
    free, hit = kept[True], kept[False]
    for _ in range(HALVINGS):
        middle = 0.5 * (free + hit)
        if checker.edge_is_free(*middle):
            free = middle
        else:
            hit = middle
    ways = rng.normal(size=free.shape)
    ways *= rng.choice(JITTERS) * rng.random() / (np.abs(ways) * robot.reach()).sum(axis=1)[:, None]
    return np.clip(hit + ways, robot.limits.lower, robot.limits.upper)


def _states_told(checker: ps.CollisionChecker, Q: FloatArray, *, every_way: bool) -> list[Told]:
    """What touches first at each configuration and what was counted; None where it is free.

    Args:
        every_way: Also ask for the verdict alone, and for those of all at once, and tell where they are others.
    """
    told: list[Told] = []
    for q in Q:
        before = checker.counts
        hit = checker.edge_hit(q, q)
        spent = checker.counts - before
        told.append((hit, spent.states, spent.edges))
    if every_way:
        alone, together = [checker.state_is_free(q) for q in Q], checker.states_are_free(Q).tolist()
        for k, (said, *_) in enumerate(told):
            if not alone[k] == together[k] == (said is None):
                told[k] = (f"{said}, alone {alone[k]}, with others {together[k]}", 0, 0)
    return told


def _edge_told(checker: ps.CollisionChecker, edge: Asked) -> Told:
    """Where an edge collides and what was counted; of one that is checked coarsely first, both verdicts."""
    before = checker.counts
    said: Any
    if edge.coarse:
        free = checker.edge_is_free_coarse(edge.q1, edge.q2, known=edge.known)
        said = (free, checker.finish_edge(edge.q1, edge.q2)) if free else False
        said = None if said == (True, None) else said
    else:
        said = checker.edge_hit(edge.q1, edge.q2, known=edge.known)
    spent = checker.counts - before
    return said, spent.states, spent.edges


def compare(
    made: dict[str, ps.CollisionChecker], blocks: Iterator[tuple[str, FloatArray, list[Asked]]]
) -> dict[tuple[str, str], Tally]:
    """Ask all checkers the same, the reference being the last of them: tallies by kind, of states and of edges."""
    found = {(kind, what): Tally() for kind in KINDS for what in ("states", "edges")}
    reference = list(made)[-1]
    for kind, Q, edges in blocks:
        told: dict[str, dict[str, list[Told]]] = {"states": {}, "edges": {}}
        for name, checker in made.items():
            clock = time.process_time()
            told["states"][name] = _states_told(checker, Q, every_way=name != reference)
            middle = time.process_time()
            told["edges"][name] = [_edge_told(checker, edge) for edge in edges]
            for what, spent in (("states", middle - clock), ("edges", time.process_time() - middle)):
                seconds = found[kind, what].seconds
                seconds[name] = seconds.get(name, 0.0) + spent
        found[kind, "states"].add(told["states"], list(Q))
        found[kind, "edges"].add(told["edges"], edges)
    return found


@dataclass(frozen=True)
class _Case:
    """The work of a process: parts of a case, each a number with the states and edges it has."""

    name: str
    seed: int
    folder: Path | None

    def prepare(self) -> None:
        """Nothing."""

    def __call__(self, part: tuple[int, int, int]) -> dict[tuple[str, str], Tally]:
        number, states, edges = part
        robot, scene = case(self.name, self.folder)
        made = kernels(robot, scene)
        made["fcl"] = ps.CollisionChecker(robot, scene, edge_step=ps.JointStep(STEP), backend="fcl")
        return compare(made, questions(robot, scene, states, edges, self.seed, number))


def _case_rows(name: str, folder: Path | None, states: int, edges: int, seed: int) -> Iterator[Row]:
    count = max(1, -(-states // PART))
    parts = [(k, _share(states, k, count), _share(edges, k, count)) for k in range(count)]
    console, total = Console(stderr=True), dict[tuple[str, str], Tally]()
    with closing((Processes() if count > 1 else Sequential()).run(_Case(name, seed, folder), parts)) as answers:
        for _, found in track(answers, name, count, console=console, disable=not console.is_terminal):
            if isinstance(found, Lost):
                raise AssertionError(f"{name}: {found.detail}")
            for key, tally in found.items():
                total.setdefault(key, Tally()).merge(tally)
    for (kind, what), tally in total.items():
        each = {name: seconds / max(tally.number, 1) * 1e6 for name, seconds in tally.seconds.items()}
        row: Row = {"case": name, "kind": kind, "what": what, "number": tally.number, "colliding": tally.colliding}
        yield row | {"differences": tally.differences, "words": tally.words, "us": each, "sets": instruction_sets()}


def run(
    robot: str | None = None,
    states: int = STATES,
    edges: int = EDGES,
    seed: int = 0,
    problems: Path | None = None,
) -> Report:
    """Compare on all of these robots, or on one; some minutes for each.

    Args:
        problems: A folder of arms and their public problems, as of ``arms``: these are compared instead.

    Raises:
        UnknownName: none of them is called so.
        InvalidRequest: The folder has not got it.
    """
    cases = CASES if problems is None else [f"{arm.name} {PUBLIC}" for arm in arms_in(problems, robot)]
    robots = [name.split()[0] for name in cases]
    if robot is not None and robot not in robots:
        raise ps.UnknownName("robot", robot, robots)
    names = [name for name in cases if robot in (None, name.split()[0])]
    rows = [row for name in names for row in _case_rows(name, problems, states, edges, seed)]
    return Report("differential", tuple(rows), (_table(rows, seed),), tuple(_promise(name, rows) for name in names))


def _promise(name: str, rows: Sequence[Row]) -> Promise:
    here = [row for row in rows if row["case"] == name]
    counts = [sum(row["number"] for row in here if row["what"] == what) for what in ("states", "edges")]
    sets = ", ".join(here[0]["sets"])
    text = f"{name}: verdicts, counts and names of {counts[0]:,} states and {counts[1]:,} edges are FCL's ({sets})"
    differ = sum(row["differences"] for row in here)
    words = [words for row in here for words in row["words"]][:SHOWN]
    measured = "; ".join([f"{differ} differ", *words]) if sets else "the kernel was not built"
    return Promise(text, measured, bool(sets) and differ == 0)


def _table(rows: Sequence[Row], seed: int) -> Table:
    sets = rows[0]["sets"]
    lines = (
        {
            "": f"{row['case']}, {row['what']}",
            "kind": row["kind"],
            **{key: f"{row[key]:,}" for key in ("number", "colliding", "differences")},
            **{f"{name} us": f"{row['us'][name]:,.1f}" for name in (*sets, "fcl")},
        }
        for row in rows
    )
    caption = (
        f"Seed {seed}. Verdict, count and name of each state and edge, by the kernel with every instruction set and by "
        "FCL asked pair by pair; states by the kernel also alone and in batches, half of the edges coarsely first, "
        "then the rest. CPU microseconds of a question with what it takes to ask; the kernel's states are asked thrice."
    )
    return table_of("The kernel next to FCL pair by pair", lines, caption=caption)

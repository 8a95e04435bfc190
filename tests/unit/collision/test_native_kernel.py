"""The compiled kernel changes no answer: not a verdict, not a count, not a name; nor does its absence."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args
from unittest.mock import Mock

import numpy as np
import pytest

from planner_service.collision import CollisionChecker, Known
from planner_service.collision.backends import BackendName, NarrowPhase, NativeBackend
from planner_service.collision.budget import CheckBudgetSpent
from planner_service.collision.checker import EdgeHit
from planner_service.collision.edge_sampling import interior
from planner_service.collision.fcl import FclObjects
from planner_service.collision.native_kernel import build_kernel, instruction_sets
from planner_service.errors import InvalidRequest
from planner_service.native.loading import load_core
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene
from planner_service.search.problem import SearchOracle
from tests.support.backends import CASES, case, checkers, compare, edges_of, states_of

if TYPE_CHECKING:
    from planner_service.native import _core

STATES, EDGES = 300, 30


def built_kernels(checker: CollisionChecker) -> list[_core.CollisionKernel]:
    """The kernel of a checker in every instruction set there is."""
    return [build_kernel(checker.robot, checker._parts, name) for name in instruction_sets()]


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_both_backends_agree_on_states_and_edges_at_random_as_planned_and_next_to_contact(name: str) -> None:
    pair = checkers(*case(name))
    assert [checker.instruction_set is not None for checker in pair] == [True, False]
    few = 10 if pair[1].pair_count > 1000 else 1  # FCL needs milliseconds for as many
    found = compare(pair, STATES // few, EDGES // few, seed=11)
    assert found.differences == []
    assert 0 < found.colliding < found.states + found.edges


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_every_instruction_set_leaves_every_pair_that_touches_and_hardly_another(name: str) -> None:
    checker = checkers(*case(name))[1]
    few = 6 if checker.pair_count > 1000 else 1  # FCL needs milliseconds for as many
    Q = np.array(list(states_of(checker, 120 // few, seed=5)))
    touching = {(row, pair) for row, q in enumerate(Q) for pair in touching_pairs(checker, q)}
    for kernel in built_kernels(checker):
        left = set(zip(*kernel.candidates(Q), strict=True))
        assert touching <= left
        assert len(left) <= len(touching) + len(Q) / 2


def touching_pairs(checker: CollisionChecker, q: Any) -> list[int]:
    return checker._backend.touching(np.array(q))


def fields(check: _core.RowCheck) -> tuple[Any, ...]:
    return check.free, check.colliding, check.row, check.fraction, check.pair, check.q, check.pairs


def test_every_instruction_set_says_the_same_of_an_edge() -> None:
    checker = checkers(*case("wxai clutter"))[0]
    for a, b in edges_of(checker, 60, seed=6):
        segments = checker.segments(a, b)
        checks = [
            fields(kernel.check_edge_rows(a.tolist(), b.tolist(), 3, segments, 0, segments + 1))
            for kernel in built_kernels(checker)
        ]
        assert checks[1:] == checks[:-1]


@pytest.mark.slow
def test_a_check_says_which_sample_is_not_free_and_where() -> None:
    checker, reference = checkers(*case("wxai bin"))
    for a, b in edges_of(checker, 60, seed=8):
        segments, rows = checker.segments(a, b), interior(a.tolist(), b.tolist(), checker.segments(a, b))
        every = [a, b, *rows]
        for kernel in built_kernels(checker):
            check = kernel.check_edge_rows(a.tolist(), b.tolist(), 3, segments, 0, segments + 1)
            while not check.free:
                assert check.q == every[check.row].tolist()
                assert np.allclose(a + check.fraction * (b - a), every[check.row], atol=1e-12)
                touching = touching_pairs(reference, every[check.row])
                if check.colliding:
                    assert touching[0] == check.pair
                else:
                    assert check.pairs == sorted(check.pairs)
                    assert touching[:1] == [pair for pair in touching if pair in check.pairs][:1]
                check = kernel.check_edge_rows(a.tolist(), b.tolist(), 3, segments, check.row + 1, segments + 1)


@pytest.mark.parametrize("known", list(Known))
def test_a_coarse_check_and_the_rest_are_judged_and_counted_alike(known: Known) -> None:
    pair = checkers(*case("wxai clutter"))
    for a, b in edges_of(pair[0], 40, seed=14):
        before = [checker.counts for checker in pair]
        hits = [(checker.edge_is_free_coarse(a, b, known=known), checker.finish_edge(a, b)) for checker in pair]
        lists = [checker.edge_is_free_coarse(a.tolist(), b.tolist(), known=known) for checker in pair]
        spent = [checker.counts - counts for checker, counts in zip(pair, before, strict=True)]
        assert hits[0] == hits[1]
        assert lists == [seems for seems, _ in hits]
        assert spent[0] == spent[1]


@pytest.mark.parametrize("budget", [0, 3, 9, 74])
def test_a_budget_ends_both_at_the_same_count(budget: int) -> None:
    pair = checkers(*case("planar2 pins"))
    edges = list(edges_of(pair[0], 4, seed=10))
    told = []
    for checker in pair:
        before, said = checker.counts, list[bool | None]()
        with checker.limited(states=budget):
            for a, b in edges:
                try:
                    said.append(checker.edge_is_free(a, b))
                except CheckBudgetSpent:
                    said.append(None)
        told.append((said, checker.counts - before))
    assert told[0] == told[1]


def narrow_phase(checker: CollisionChecker) -> NarrowPhase:
    backend: Any = checker._backend
    phase: NarrowPhase = backend.narrow_phase
    return phase


class OtherOpinion:
    """FCL with another opinion of some pairs."""

    def __init__(self, fcl: FclObjects, free: Any) -> None:
        self.fcl, self._free = fcl, free
        self.asked: list[tuple[int, int]] = []

    def place(self, *where: Any) -> None:
        self.fcl.place(*where)

    def collide(self, i: int, j: int) -> bool:
        self.asked.append((i, j))
        return not self._free(i, j) and self.fcl.collide(i, j)


class Unsure:
    """A kernel that is never sure that a pair overlaps."""

    def __init__(self, kernel: _core.CollisionKernel) -> None:
        self.candidates = kernel.candidates
        self._kernel = kernel

    def check_rows(self, Q: Any, *where: Any) -> Any:
        return self._undecided(self._kernel.check_rows(Q, *where))

    def check_edge_rows(self, *edge: Any) -> Any:
        return self._undecided(self._kernel.check_edge_rows(*edge))

    def _undecided(self, check: _core.RowCheck) -> Any:
        if check.free:
            return check
        pairs = self.candidates(np.array([check.q]))[1]
        return Mock(undecided=True, row=check.row, fraction=check.fraction, q=check.q, pairs=pairs)


@pytest.mark.parametrize("free", [lambda i, j: True, lambda i, j: (i + j) % 2 == 0])
def test_what_fcl_finds_free_although_in_doubt_is_free_and_the_rest_is_still_judged(free: Any) -> None:
    pair = checkers(*case("wxai clutter"))
    edges = list(edges_of(checkers(*case("wxai clutter"))[1], 40, seed=4))
    for checker in pair:
        narrow_phase(checker).fcl = OtherOpinion(narrow_phase(checker).fcl, free)  # type: ignore[assignment]
        if isinstance(checker._backend, NativeBackend):
            checker._backend.kernel = Unsure(checker._backend.kernel)  # type: ignore[assignment]
            checker._kernel = None
    for a, b in edges:
        hits: list[EdgeHit | None] = [checker.edge_hit(a, b) for checker in pair]
        assert hits[0] == hits[1]
    assert pair[0].counts.states == pair[1].counts.states


@pytest.fixture
def absent(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As if the kernel had not been built."""
    load_core.cache_clear()
    monkeypatch.setitem(sys.modules, "planner_service.native._core", None)
    monkeypatch.delattr("planner_service.native._core", raising=False)
    yield
    load_core.cache_clear()


@pytest.mark.usefixtures("absent")
def test_without_compiled_code_it_is_said_what_to_install() -> None:
    with pytest.raises(ImportError, match=r"install it anew, from a wheel or with a C\+\+17 compiler"):
        load_robot("wxai").body_poses([0.0] * 6)


def test_a_backend_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="backend"):
        CollisionChecker(load_robot("wxai"), load_scene("bin"), backend="gpu")  # type: ignore[arg-type]


class Halves:
    """A user's own rule."""

    def segments(self, dq: Any, reach: Any) -> int:
        return 2


def test_a_rule_of_a_users_own_is_asked() -> None:
    robot, scene = case("wxai shelf")
    for checker in (CollisionChecker(robot, scene, edge_step=Halves(), backend=b) for b in get_args(BackendName)):
        assert checker.edge_is_free(robot.home, robot.home + 0.01)
        assert checker.counts.states == 3


@pytest.mark.parametrize("parts", [0, 2.5, 10**7])
def test_a_rule_that_splits_an_edge_into_no_parts_is_refused_and_nothing_is_called_free(parts: Any) -> None:
    class Odd:
        def segments(self, dq: Any, reach: Any) -> Any:
            return parts

    robot, scene = case("wxai shelf")
    checker = CollisionChecker(robot, scene, edge_step=Odd())
    for ask in (checker.edge_is_free, SearchOracle(checker).edge_is_free):
        with pytest.raises(InvalidRequest, match=r"edge_step\.segments: got"):
            ask(robot.home, robot.home + 0.1)


def test_a_piece_that_is_turned_on_its_link_is_held_against_links_of_several_pieces(tmp_path: Path) -> None:
    def link(name: str, *shapes: str) -> str:
        return f'<link name="{name}">{"".join(f"<collision>{shape}</collision>" for shape in shapes)}</link>'

    def joint(k: int, axis: str) -> str:
        ends = f'<parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0.1 0.03 0.1"/><axis xyz="{axis}"/>'
        limit = '<limit lower="-3" upper="3" velocity="1" effort="1"/>'
        return f'<joint name="j{k}" type="revolute">{ends}{limit}</joint>'

    turned = '<origin xyz="0 0 0.05" rpy="0.5 0.9 0.4"/><geometry><box size="0.5 0.04 0.02"/></geometry>'
    pieces = [f'<origin xyz="{x} 0 0.05"/><geometry><box size="0.06 0.04 0.2"/></geometry>' for x in (0.0, 0.15)]
    small = '<geometry><sphere radius="0.01"/></geometry>'
    links = [link("l0", turned), link("l1", small), link("l2", small), link("l3", *pieces)]
    path = tmp_path / "turned.urdf"
    path.write_text(
        f'<robot name="r">{"".join([*links, joint(0, "0 0 1"), joint(1, "0 1 0"), joint(2, "1 0 0")])}</robot>'
    )
    found = compare(checkers(load_robot(path), Scene()), 300, 30, seed=3)
    assert found.differences == []
    assert 0 < found.colliding < found.states + found.edges

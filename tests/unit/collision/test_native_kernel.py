"""The compiled kernel changes no answer: not a verdict, not a count, not a name; nor does its absence."""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, get_args
from unittest.mock import Mock

import numpy as np
import pytest

from planner_service.collision import CheckCounts, CollisionChecker, EdgeStep, JointStep, Known, MotionStep
from planner_service.collision import native_kernel as kernels
from planner_service.collision.backends import BackendName, NarrowPhase, NativeBackend
from planner_service.collision.bounds import Solids
from planner_service.collision.budget import CheckBudgetSpent, TimeBoxSpent
from planner_service.collision.checker import EdgeHit
from planner_service.collision.edge_sampling import FinestStep, interior
from planner_service.collision.fcl import FclObjects
from planner_service.collision.native_kernel import MARGIN, build_kernel, instruction_sets
from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import Box, Pose, Sphere
from planner_service.native.loading import load_core
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Attached, Scene
from planner_service.search.edge_cache import SearchOracle
from tests.support.backends import CASES, case, checkers, compare, edges_of, states_of

if TYPE_CHECKING:
    from planner_service.native import _core

STATES, EDGES = 300, 30


def built_kernels(checker: CollisionChecker) -> list[_core.CollisionKernel]:
    """The kernel of a checker in every instruction set there is."""
    return [build_kernel(checker.robot, checker._parts, name) for name in instruction_sets()]


def carrying() -> tuple[CollisionChecker, CollisionChecker]:
    """Checkers of an arm that carries a block with a rod through it, every pair padded by 5 mm."""
    robot, scene = case("wxai bin")
    for name, shape in (("held", Box((0.04, 0.05, 0.06))), ("knob", Sphere(0.03))):
        touching = ("finger_left", "finger_right", "link_6")
        scene = scene.with_attached(Attached(name, shape, Pose((0.03, 0.0, 0.0)), touching))
    return checkers(robot, scene, padding=0.005, allowed=[("held", "knob")])


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_both_backends_agree_on_states_and_edges_at_random_as_planned_and_next_to_contact(name: str) -> None:
    pair = checkers(*case(name))
    assert [checker.instruction_set is not None for checker in pair] == [True, False]
    few = 10 if pair[1].pair_count > 1000 else 1  # FCL needs milliseconds for as many
    found = compare(pair, STATES // few, EDGES // few, seed=11)
    assert found.differences == []
    assert 0 < found.colliding < found.states + found.edges


@pytest.mark.parametrize("name", ["wxai bin", "panda shelf"])
def test_the_reference_puts_every_pair_to_fcl_in_its_order_up_to_the_first_that_touches(name: str) -> None:
    checker = CollisionChecker(*case(name), backend="fcl")
    opinion = narrow_phase(checker).fcl = OtherOpinion(narrow_phase(checker).fcl, lambda i, j: False)  # type: ignore[assignment]
    every = [(i, j) for i, j in checker._parts.pairs.tolist()]
    free = []
    for q in states_of(checkers(*case(name))[0], 40, seed=21):
        opinion.asked.clear()
        free.append(checker.state_is_free(q))
        assert opinion.asked == every[: len(opinion.asked)]
        assert free[-1] == (not opinion.fcl.collide(*opinion.asked[-1]))
        assert len(opinion.asked) == len(every) or not free[-1]
    assert 0 < sum(free) < len(free)


@pytest.mark.slow
def test_both_backends_agree_with_carried_objects_and_padding() -> None:
    assert compare(carrying(), STATES, EDGES, seed=12).differences == []


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [-0.003, -0.0003])
def test_the_comparison_notices_a_kernel_with_a_wrong_margin(wrong: float) -> None:
    first, second = checkers(*case("wxai bin"))
    if isinstance(first._backend, NativeBackend):
        first._backend.kernel = build_kernel(first.robot, first._parts, margin=wrong)
        first._kernel = first._configured_kernel()
    assert compare((first, second), STATES, EDGES, seed=11).differences


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_every_instruction_set_leaves_every_pair_that_touches_and_hardly_another(name: str) -> None:
    checker = checkers(*case(name))[1]
    Q = np.array(list(states_of(checker, 120, seed=5)))
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


@pytest.mark.parametrize("segments", [1, 2, 3, 8, 33, 1000])
def test_the_kernel_samples_an_edge_to_the_last_bit_as_numpy_does(segments: int) -> None:
    checker = checkers(*case("wxai bin"))[0]
    chance = random.Random(segments)
    for kernel in built_kernels(checker):
        for _ in range(20):
            a, b = ([chance.uniform(-3.0, 3.0) for _ in range(6)] for _ in range(2))
            b[0] = chance.choice([b[0], a[0]])
            for first, last in ((a, b), (b, a), (a, a)):
                assert kernel.samples(first, last, segments) == interior(first, last, segments).tolist()


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
def test_known_ends_are_counted_alike(known: Known) -> None:
    pair = checkers(*case("wxai bin"))
    home = pair[0].robot.home
    for a, b in [(home, home), *edges_of(pair[0], 15, seed=9)]:
        before = [checker.counts for checker in pair]
        hits = [checker.edge_hit(a, b, known=known) for checker in pair]
        spent = [checker.counts - counts for checker, counts in zip(pair, before, strict=True)]
        assert hits[0] == hits[1]
        assert spent[0] == spent[1]


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


def test_many_states_are_judged_alike_in_one_call() -> None:
    pair = checkers(*case("wxai clutter"))
    Q = np.array(list(states_of(checkers(*case("wxai clutter"))[0], 400, seed=16)))
    free = [checker.states_are_free(Q).tolist() for checker in pair]
    assert free[0] == free[1]
    assert 0 < sum(free[0]) < len(Q)
    assert [checker.counts for checker in pair] == [CheckCounts(states=len(Q))] * 2


@pytest.mark.parametrize("budget", [0, 1, 2, 3, 9, 10, 40, 73, 74, 200])
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


@pytest.mark.parametrize("free", [lambda i, j: True, lambda i, j: i < 3, lambda i, j: (i + j) % 2 == 0])
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


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_what_the_kernel_is_sure_of_overlaps_for_fcl_too(name: str) -> None:
    checker = checkers(*case(name))[1]
    sure = 0
    for q in states_of(checker, 300, seed=13):
        for kernel in built_kernels(checker):
            check = kernel.check_rows(q[None], 0, 1)
            if check.colliding:
                sure += 1
                assert touching_pairs(checker, q)[0] == check.pair
    assert sure


def test_threads_get_the_answers_they_would_get_alone() -> None:
    checker = checkers(*case("wxai clutter"))[0]
    Q = np.array(list(states_of(checker, 200, seed=3)))
    for kernel in built_kernels(checker):
        alone = kernel.candidates(Q)
        with ThreadPoolExecutor(4) as pool:
            assert all(told == alone for told in pool.map(kernel.candidates, [Q] * 8))


@pytest.mark.parametrize("turns", [1, 1_000, 100_000_000])
def test_angles_far_from_zero_are_turned_into_the_same_poses(turns: int) -> None:
    checker = checkers(*case("planar2 pins"))[1]
    Q = np.array(list(states_of(checker, 60, seed=2)))
    far = Q + 2.0 * math.pi * turns
    near = np.arctan2(np.sin(far), np.cos(far))  # what rounding left of the angles
    for kernel in built_kernels(checker):
        apart = set(zip(*kernel.candidates(near), strict=True)) ^ set(zip(*kernel.candidates(far), strict=True))
        assert apart == set()


def native_data(checker: CollisionChecker) -> list[Any]:
    parts = checker._parts
    runs = np.array(parts.runs, dtype=np.int64).reshape(-1, 2) - parts.riding
    solids = Solids.of(parts.shapes)
    rows = np.column_stack([solids.half, solids.ball, solids.disc, solids.hulls])
    return [
        kernels._joints(checker.robot),
        kernels._places(parts),
        rows,
        runs,
        parts.pairs.astype(np.int64),
        [],
        MARGIN,
    ]


def spoilt(data: list[Any], which: int, change: Any) -> list[Any]:
    array = data[which].copy()
    changed = change(array)
    return [*data[:which], array if changed is None else changed, *data[which + 1 :]]


def _put(where: Any, value: float) -> Any:
    def change(array: Any) -> None:
        array[where] = value

    return change


@pytest.mark.parametrize(
    ("which", "change", "message"),
    [
        (0, _put((1, 0), 5.0), "parent"),
        (0, _put((0, 1), 6.0), "entry of q"),
        (0, _put((0, 6), 1.5), "orthonormal"),
        (1, _put((0, 0), 7.0), "body"),
        (1, _put((0, 1), 0.5), "orthonormal"),
        (1, lambda rows: rows[::-1].copy(), "rides comes first"),
        (2, lambda rows: rows[1:].copy(), "a solid for each part"),
        (2, _put((0, 5), 0.0), "hull"),
        (3, lambda rows: rows[1:].copy(), "no obstacle"),
        (4, lambda rows: rows[::-1].copy(), "pairs"),
        (4, lambda rows: np.concatenate([rows, rows[-1:]]), "pairs|none"),
        (4, _put((0, 0), -1), "rides"),
    ],
)
def test_the_kernel_refuses_what_makes_no_sense(which: int, change: Any, message: str) -> None:
    checker = checkers(*case("wxai bin"))[0]
    core = load_core()
    data = native_data(checker)
    core.CollisionKernel(*data)
    with pytest.raises(ValueError, match=message):
        core.CollisionKernel(*spoilt(data, which, change))


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


def test_variants_keep_the_backend() -> None:
    for checker in checkers(*case("wxai bin")):
        assert checker.variant(padding=0.01).instruction_set == checker.instruction_set


@pytest.mark.slow
def test_contacts_are_the_same_with_the_same_depths() -> None:
    pair = checkers(*case("wxai clutter"))
    for q in states_of(pair[0], 60, seed=1):
        assert pair[0].contacts(q) == pair[1].contacts(q)


@pytest.mark.parametrize(
    "step", [JointStep(0.013), MotionStep(0.0071), FinestStep((JointStep(0.05), MotionStep(0.01)))]
)
def test_an_edge_has_as_many_segments_as_its_rule_says_whoever_counts(step: EdgeStep) -> None:
    robot, scene = load_robot("wxai"), Scene()
    checker = CollisionChecker(robot, scene, edge_step=step)
    for a, b in edges_of(checker, 200, seed=15):
        before = checker.counts.states
        checker.edge_hit(a, b)
        whole = checker.counts.states - before
        assert whole == checker.segments(a, b) + 1 or checker.edge_hit(a, b) is not None


class Halves:
    """A user's own rule."""

    def segments(self, dq: Any, reach: Any) -> int:
        return 2


def test_a_rule_of_a_users_own_is_asked() -> None:
    robot, scene = case("wxai shelf")
    for checker in (CollisionChecker(robot, scene, edge_step=Halves(), backend=b) for b in get_args(BackendName)):
        assert checker.edge_is_free(robot.home, robot.home + 0.01)
        assert checker.counts.states == 3


@pytest.mark.parametrize("parts", [0, -3, 2.5, None, True, 10**7])
def test_a_rule_that_splits_an_edge_into_no_parts_is_refused_and_nothing_is_called_free(parts: Any) -> None:
    class Odd:
        def segments(self, dq: Any, reach: Any) -> Any:
            return parts

    robot, scene = case("wxai shelf")
    checker = CollisionChecker(robot, scene, edge_step=Odd())
    for ask in (checker.edge_is_free, SearchOracle(checker).edge_is_free):
        with pytest.raises(InvalidRequest, match=r"edge_step\.segments: got"):
            ask(robot.home, robot.home + 0.1)


ODD: list[Any] = [
    [math.nan] * 6,
    [9.0] * 6,
    np.zeros(5),
    np.zeros((6, 1)),
    np.full(6, math.inf),
    np.array([None] * 6),
    np.ma.masked_greater([0.5, 1.0, 0.5, 0.0, 0.0, 0.0], 0.5),  # type: ignore[no-untyped-call]
    "home",
    np.array(0.0),
]


@pytest.mark.parametrize("q", ODD, ids=str)
def test_what_is_no_configuration_is_refused_alike_and_not_counted(q: Any) -> None:
    told = []
    for checker in checkers(*case("wxai shelf")):
        home, errors = checker.robot.home, []
        for ask in (checker.state_is_free, lambda x: checker.edge_hit(x, home), lambda x: checker.edge_hit(home, x)):  # noqa: B023
            with pytest.raises(InvalidRequest) as error:
                ask(q)
            errors.append(str(error.value))
        told.append(errors)
        assert checker.counts == CheckCounts()
    assert told[0] == told[1]


def test_configurations_of_any_kind_are_judged_alike() -> None:
    for checker in checkers(*case("wxai shelf")):
        home, other = checker.robot.home, checker.robot.home + 0.125
        strided = np.repeat(other, 3)[::3]
        kinds = (other, other.tolist(), tuple(other.tolist()), strided, other.astype(np.float32))
        assert {checker.state_is_free(q) for q in kinds} == {True}
        assert {checker.edge_is_free(home, q) for q in kinds} == {True}


def test_too_many_segments_are_refused_alike() -> None:
    for checker in checkers(*case("wxai shelf")):
        other = CollisionChecker(checker.robot, checker.scene, edge_step=JointStep(1e-9), backend=checker.backend)
        with pytest.raises(InvalidRequest, match="at most 1000000 parts"):
            other.edge_is_free(checker.robot.home, checker.robot.home + 0.1)
        assert other.counts == CheckCounts()


@pytest.mark.parametrize("judged", [True, False])
def test_a_time_box_that_is_over_is_noticed_alike(judged: bool) -> None:
    told: list[Any] = []
    for checker in checkers(*case("wxai shelf")):
        home = checker.robot.home
        with checker.limited(deadline=0.0):
            for known in Known:
                try:
                    told.append(checker.edge_is_free(home, home + 0.1 * judged, known=known))
                except TimeBoxSpent:
                    told.append(False)
        told.append(checker.counts)
    assert told[: len(told) // 2] == told[len(told) // 2 :]

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.planners import RRTConnect
from planner_service.search.problem import compiled
from planner_service.smoothing.smoothing import SeededDraws, blended, pulled_in, shortcut
from tests.support.discs import DiscWorld, GlancingWorld, across, length
from tests.support.optional import present

NOTHING: tuple[tuple[float, float, float], ...] = ()


def found(world: DiscWorld, *, n: int = 2, seed: int = 0) -> FloatArray:
    return present(RRTConnect(range=0.3).search(across(world, n=n, seed=seed)).waypoints)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), n=st.sampled_from([2, 3, 6]), step=st.sampled_from([0.02, 0.05, 0.3]))
def test_the_laws_of_shortcutting(seed: int, n: int, step: float) -> None:
    world = DiscWorld(step=step)
    path = found(world, n=n, seed=seed)
    before = len(world.edges)
    short = shortcut(path, world, np.random.default_rng(seed))
    assert short[0].tolist() == path[0].tolist()
    assert short[-1].tolist() == path[-1].tolist()
    assert length(short) <= length(path) * (1 + 1e-12), "rounding of sums only"
    assert world.found_free(short)
    asked = [frozenset(edge) for edge in world.edges[before:]]
    assert len(set(asked)) == len(asked)


@pytest.mark.parametrize("waypoints", [np.zeros((0, 2)), [1.0, 2.0], [[float("nan"), 0.0]]])
def test_waypoints_that_are_no_path_are_refused(waypoints: FloatArray) -> None:
    with pytest.raises(InvalidRequest, match="waypoints"):
        shortcut(waypoints, DiscWorld(NOTHING), np.random.default_rng(0))


ZIGZAG = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [3.0, 0.5]])


@pytest.mark.parametrize(("size", "width"), [(0.2, 0.2), (9.0, 0.2495)])
def test_a_free_corner_is_blended_as_widely_as_asked_and_its_pieces_allow(size: float, width: float) -> None:
    path = blended(JointPath(ZIGZAG), compiled(DiscWorld(NOTHING)), np.full(4, size))
    assert path.blends.tolist() == [0.0, width, width, 0.0]


def test_a_blend_that_is_not_free_is_halved_until_it_is() -> None:
    beside = DiscWorld([(0.97, 0.03, 0.02)])  # inside the first corner
    path = blended(JointPath(ZIGZAG), compiled(beside), np.full(4, 0.2))
    assert path.blends.tolist() == [0.0, 0.05, 0.2, 0.0]
    assert blended(JointPath(ZIGZAG), compiled(beside), np.full(4, 0.2), corners=[2]).corners == (1,)


@pytest.mark.slow
@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_blended_paths_around_discs_are_free_and_keep_their_ends(seed: int) -> None:
    world = DiscWorld(step=0.02)
    short = shortcut(found(world, seed=seed), world, np.random.default_rng(seed))
    path = blended(JointPath(short), compiled(world), np.full(len(short), 0.4))
    assert all(world.state_is_free(q) for q in path(np.linspace(0.0, path.length, 800)))
    assert path([0.0, path.length]).tolist() == [short[0].tolist(), short[-1].tolist()]


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), n=st.sampled_from([2, 3, 6]), step=st.sampled_from([0.02, 0.05, 0.3]))
def test_the_laws_of_pulling_corners_in(seed: int, n: int, step: float) -> None:
    world = GlancingWorld(step=step)
    path = shortcut(found(world, n=n, seed=seed), world, np.random.default_rng(seed))
    short = pulled_in(path, world)
    assert short.shape == path.shape
    assert short[0].tolist() == path[0].tolist()
    assert short[-1].tolist() == path[-1].tolist()
    assert length(short) <= length(path) * (1 + 1e-12), "rounding of sums only"
    assert world.found_free(short)


@pytest.mark.parametrize(
    ("seed", "n", "cut", "pulled", "glances"),
    [
        (0, 3, (4.795398907, 129), (4.729281695, 92), 11),
        (1, 2, (4.514989383, 182), (4.514989383, 3), 3),
        (1, 6, (5.186583761, 248), (4.704539249, 218), 26),
        (4, 3, (4.820823163, 227), (4.680716808, 59), 5),
        (5, 6, (5.192555935, 162), (5.146914944, 71), 10),
    ],
)
def test_smoothing_takes_these_states_and_leaves_this_length(
    seed: int, n: int, cut: tuple[float, int], pulled: tuple[float, int], glances: int
) -> None:
    world = GlancingWorld(step=0.05)
    path = found(world, n=n, seed=seed)
    before, seen = world.states, world.glances
    short = shortcut(path, world, np.random.default_rng(seed))
    assert length(short) == pytest.approx(cut[0], abs=1e-8)
    assert world.states - before == cut[1]
    before = world.states
    shorter = pulled_in(short, world)
    assert length(shorter) == pytest.approx(pulled[0], abs=1e-8)
    assert world.states - before == pulled[1]
    assert world.glances - seen == glances


@pytest.mark.parametrize(("height", "asked"), [(0.099, False), (0.102, True)])
def test_a_pull_that_gains_less_than_half_a_percent_is_not_asked_about(height: float, asked: bool) -> None:
    world = GlancingWorld(NOTHING)  # of a path of 2 rad the whole pull gains 0.0098 and 0.0104
    short = pulled_in([[0.0, 0.0], [1.0, height], [2.0, 0.0]], world)
    assert (world.glances > 0) == asked
    assert (short[1][1] == 0.0) == asked


@pytest.mark.parametrize("sizes", [(120, 120), (7, 300, 5), (241,)])
def test_kept_draws_are_those_of_a_generator(sizes: tuple[int, ...]) -> None:
    kept, generator = SeededDraws(2**70, 1), np.random.default_rng([2**70, 1])
    for size in sizes:
        assert kept.random(size).tolist() == generator.random(size).tolist()

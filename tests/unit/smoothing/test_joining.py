"""The best parts of several paths, joined."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.smoothing.joining import JoinedPaths
from tests.support.discs import DiscWorld, across, length
from tests.unit.smoothing.test_smoothing import found

FIRST = np.array([[0.0, 0.0], [1.0, 0.6], [3.0, 1.5], [4.0, 0.0]])
LAST = np.array([[0.0, 0.0], [1.0, 1.6], [3.0, 0.6], [4.0, 0.0]])
BETWEEN = ((1.0, 0.0, 0.5), (3.0, 0.0, 0.5))
"""Discs of which each path passes one closely, and the other at a distance."""


def test_parts_of_two_paths_are_joined_by_edges_that_are_judged() -> None:
    world = DiscWorld(BETWEEN, step=0.01)
    paths = JoinedPaths(world, 4)
    for points in (FIRST, LAST):
        assert all(world.edge_is_free(a, b) for a, b in pairwise(points))
        paths.add(points)
    assert paths.shortest is FIRST
    joined = paths.joined(50)
    assert length(joined) < length(FIRST) < length(LAST)
    assert joined[[0, -1]].tolist() == FIRST[[0, -1]].tolist()
    assert world.found_free(joined)


def test_no_edge_is_judged_twice_and_none_beyond_those_allowed() -> None:
    world = DiscWorld(BETWEEN, step=0.01)
    paths = JoinedPaths(world, 4)
    paths.add(FIRST)
    paths.add(LAST)
    assert paths.joined(0) is FIRST
    assert not world.edges
    assert paths.joined(1) is FIRST
    assert len(world.edges) == 1
    paths.joined(50)
    paths.joined(50)
    edges = [frozenset(edge) for edge in world.edges]
    assert len(set(edges)) == len(edges)


def test_only_the_shortest_paths_are_kept() -> None:
    paths = JoinedPaths(DiscWorld(()), 1)
    paths.add(LAST)
    paths.add(FIRST)
    assert paths.shortest is FIRST
    paths.add(LAST)
    assert paths.shortest is FIRST


@pytest.mark.slow
@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), n=st.sampled_from([2, 3, 6]))
def test_joining_never_makes_longer_and_what_it_gives_is_free(seed: int, n: int) -> None:
    world = DiscWorld(step=0.05)
    paths = JoinedPaths(world, 4)
    lengths = []
    for k in range(3):
        path = found(world, n=n, seed=seed + k)
        lengths.append(length(path))
        paths.add(path)
    joined = paths.joined(24)
    assert length(joined) <= min(lengths) * (1 + 1e-12)
    assert joined[0].tolist() == across(world, n=n).start.tolist()
    assert world.found_free(joined)

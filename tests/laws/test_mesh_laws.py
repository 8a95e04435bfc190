"""Verdicts on hulls as links, obstacles and held objects: those of two other judges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.collision import backends as backends
from planner_service.collision import fcl as judge
from planner_service.collision import native_kernel
from planner_service.collision.bounds import Solids
from planner_service.collision.native_kernel import build_kernel
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Shape
from tests.laws.test_certify_laws import COAL
from tests.laws.test_collision_laws import compare, near_contact
from tests.support.hull_arm import HELD, HullSetup


def test_padded_hulls_are_free_only_where_all_keep_the_padding_and_always_where_they_keep_1_74_of_it(
    folder: Path,
) -> None:
    setup, padding = HullSetup("padded", folder, attached=(HELD,)), 0.01
    checker, second = setup.checker(), setup.independent()
    padded = checker.variant(padding=padding)
    verdicts = []
    for q in near_contact(checker.robot, padded.state_is_free, np.random.default_rng(10), 300):
        gap = min(second.gaps(q).values())
        verdicts.append(padded.state_is_free(q))
        if verdicts[-1]:
            assert gap >= padding - COAL
        else:
            assert gap <= 1.74 * padding + COAL
    assert 100 <= sum(verdicts) <= 200


def shrunk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boxes around hulls, of 85 % of their length."""
    whole = Solids.of

    def smaller(shapes: Any) -> Solids:
        solids = whole(shapes)
        hull = (solids.hulls >= 0)[:, None]
        return replace(solids, half=np.where(hull, 0.85 * solids.half, solids.half))

    monkeypatch.setattr(Solids, "of", staticmethod(smaller))


def uncentred(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hull's frame is taken for its centre."""
    monkeypatch.setattr(native_kernel, "centres_of", lambda shapes: np.zeros((len(shapes), 3)))


def loose(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hulls that overlap by 3 mm are parted."""
    monkeypatch.setattr(backends, "build_kernel", partial(build_kernel, margin=-0.003))


def blunt(monkeypatch: pytest.MonkeyPatch) -> None:
    """FCL gets a hull without the corner that is farthest out."""
    whole = judge.geometry_of

    def cut(shape: Shape) -> Any:
        if not isinstance(shape, Mesh):
            return whole(shape)
        return whole(Mesh(np.delete(shape.vertices, shape.vertices[:, 0].argmax(), axis=0)))

    monkeypatch.setattr(judge, "geometry_of", cut)


@pytest.mark.parametrize("fault", [shrunk, uncentred, loose, blunt])
def test_the_comparison_notices_a_fault_with_hulls(
    folder: Path, fault: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    setup: Any = HullSetup("faulty", folder, attached=(HELD,))
    assert compare(setup, 60, seed=5).differing == []
    fault(monkeypatch)
    assert compare(setup, 250, seed=5).differing

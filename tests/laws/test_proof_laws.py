"""The proof says the same to the last bit with every instruction set: proofs, verdicts on edges, clearances."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.certify import MARGIN, Certifier, EdgeVerdict, ExemptInterval, hulls, separation
from planner_service.certify import interval_proof as tree
from planner_service.certify import motion_bounds as motions
from planner_service.certify.certifier import Proof, Prover, instruction_sets, proof_terms
from planner_service.certify.native.loading import load_proof
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import PointCloud
from planner_service.geometry.shapes import Box, Pose
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Obstacle, Scene
from tests.laws.test_certify_laws import anywhere
from tests.laws.test_crowd_laws import Crowded
from tests.support.hull_arm import NEEDLE, HullSetup
from tests.support.optional import present
from tests.support.small_robots import built
from tests.unit.certify.test_certifier import RIM, ball_beyond

WXAI, PLANAR = load_robot("wxai"), load_robot("planar2")
CROWDS = [("wxai", 0), ("planar2", 1)]
SWEEP = np.array([[-0.5, 0.0], [0.5, 0.0]])

Told = tuple[Proof, int]


def provers(certifier: Certifier) -> list[Prover]:
    """One for each instruction set there is, plain ones first."""
    return [Prover(certifier.motion, name) for name in instruction_sets()]


def told(
    prover: Prover, certifier: Certifier, path: JointPath, padding: float, exempt: Sequence[ExemptInterval]
) -> Told:
    """The proof, and what it charged in all."""
    charged: list[int] = []
    return prover.prove(path, padding + MARGIN, certifier.roots(path.length, exempt), charged.append), sum(charged)


def agreed(certifier: Certifier, path: JointPath, padding: float = 0.0, exempt: Sequence[ExemptInterval] = ()) -> Proof:
    """What all provers say, which is the same."""
    first, *others = [told(prover, certifier, path, padding, exempt) for prover in provers(certifier)]
    assert others == [first] * len(others)
    return first[0]


def exempted(certifier: Certifier, path: JointPath, rng: np.random.Generator) -> list[ExemptInterval]:
    """One or two stretches, of pairs drawn at random and maybe of a pair that is judged."""
    owners = sorted(certifier.listed.owners)
    pairs = [certifier.listed.names(int(rng.integers(len(certifier.listed))))]
    pairs += [tuple(map(str, rng.choice(owners, 2, replace=False))) for _ in range(3)]  # type: ignore[misc]
    ends = np.sort(rng.uniform(0.0, path.length, (2, 2)), axis=1).tolist()
    return [ExemptInterval(start, end, tuple(pairs), "") for start, end in ends[: 1 + int(rng.integers(2))]]


def made(tmp_path_factory: pytest.TempPathFactory, urdf: str) -> Robot:
    return built(tmp_path_factory.mktemp("urdf"), urdf)


# --- curves


@pytest.mark.parametrize(("name", "seed"), CROWDS)
def test_proofs_among_every_kind_of_shape_bundled_and_carried_are_the_same(name: str, seed: int) -> None:
    setup = Crowded(name, seed)
    certifier = Certifier(setup.robot, setup.scene, allowed=setup.allowed)
    assert len(certifier.listed) > certifier.listed.judged
    for turn in range(8):
        q = setup.anywhere()
        far = setup.anywhere()
        path = JointPath(np.array([q, q + (far - q) * min(1.0, (0.1 + 0.2 * turn) / math.dist(q, far)), q]))
        exempt = exempted(certifier, path, setup.rng) if turn % 2 else []
        agreed(certifier, path, setup.padding, exempt)


def test_a_proof_without_an_end_is_refused_in_the_same_words(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(tree, "MAX_BOUNDS", 40)
        found = agreed(Certifier(PLANAR, ball_beyond(10e-6)), JointPath(SWEEP))
    assert present(found.obstruction).spent
    monkeypatch.setattr(tree, "FRACTION", 1.5)  # no stretch proves as much
    monkeypatch.setattr(tree, "FAR", 1.0)
    certifier, path = Certifier(PLANAR, ball_beyond(0.01)), JointPath(SWEEP)
    pairs = tuple(map(certifier.listed.names, range(len(certifier.listed))))
    cut = [ExemptInterval(0.0, 0.3, pairs, ""), ExemptInterval(math.nextafter(0.3, 1.0), 1.0, pairs, "")]
    pointlike = present(agreed(certifier, path, exempt=cut).obstruction)
    assert pointlike.detail == "no shorter stretch has numbers of its own"


def test_a_path_of_another_class_is_refused() -> None:
    class Elsewhere(JointPath):
        pass

    with pytest.raises(InvalidRequest, match="a subclass may be another curve"):
        Certifier(PLANAR, ball_beyond(-0.01, 1.0)).certify(Elsewhere(SWEEP))


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        (motions, "ROUNDING", 1e-3),
        (separation, "SHIFT", 0.061),
        (hulls, "GAIN", 1e-4),
        (tree, "FRACTION", 0.74),
        (tree, "NEAR", 0.01),
    ],
)
def test_compiled_code_takes_its_constants_from_here(
    folder: Path, module: Any, name: str, value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup, rng = HullSetup("other", folder, attached=(NEEDLE,)), np.random.default_rng(15)
    certifiers = [Certifier(WXAI, load_scene("clutter")), Certifier(setup.robot(), setup.whole_scene())]
    with monkeypatch.context() as patch:
        patch.setattr(module, name, value)
        others = [Prover(certifier.motion) for certifier in certifiers]
    assert _unlike(certifiers, others, rng)


def _unlike(certifiers: Sequence[Certifier], others: Sequence[Prover], rng: np.random.Generator) -> bool:
    """Whether some short path is proven with another result, or other charges, than usual."""
    for _ in range(40):
        for certifier, other in zip(certifiers, others, strict=True):
            q = anywhere(certifier.robot, rng, 2)
            path = JointPath(q[0] + 0.1 * (q - q[0]))
            if told(other, certifier, path, 0.0, ()) != told(certifier.prover, certifier, path, 0.0, ()):
                return True
    return False


# --- charge, threads


def test_what_charge_raises_comes_out_unchanged() -> None:
    class Enough(Exception):
        pass

    certifier, path = Certifier(WXAI, load_scene("bin")), JointPath(np.array([WXAI.home, WXAI.home + 0.3]))
    for prover in provers(certifier):
        enough = Enough("so")

        def stop(bounds: int, enough: Enough = enough) -> None:
            raise enough

        with pytest.raises(Enough, match="so") as caught:
            prover.prove(path, MARGIN, certifier.roots(path.length), stop)
        assert caught.value is enough


# --- edges and clearances


def judged(
    certifier: Certifier, edges: Sequence[tuple[FloatArray, FloatArray]], padding: float = 0.0
) -> list[EdgeVerdict]:
    """The verdicts of all provers on some edges, which are the same, and so are pairs and places."""
    found = []
    for a, b in edges:
        first, *others = [prover.edge(a, b, padding + MARGIN, padding - MARGIN) for prover in provers(certifier)]
        assert first.verdict is not None
        assert others == [first] * len(others)
        found.append(first.verdict)
    return found


@pytest.mark.parametrize(("name", "seed"), CROWDS)
def test_verdicts_on_edges_among_every_kind_of_shape_are_the_same(name: str, seed: int) -> None:
    setup = Crowded(name, seed)
    certifier = Certifier(setup.robot, setup.scene, allowed=setup.allowed)
    edges = []
    for turn in range(24):
        q, far = setup.anywhere(), setup.anywhere()
        edges.append((q, q + (far - q) * min(1.0, (0.02, 0.2, 0.8)[turn % 3] / math.dist(q, far))))
    assert EdgeVerdict.FREE in judged(certifier, edges, setup.padding)


def test_verdicts_next_to_contact_are_the_same() -> None:
    """At the border both run out of bounds, or cannot tell whether pieces overlap."""
    found = []
    for gap in (0.0, 1e-6, -1e-6, 1.9e-6, 2.1e-6, -3e-6, 1e-5, -1e-5):
        found += judged(Certifier(PLANAR, ball_beyond(gap)), [(SWEEP[0], SWEEP[1]), (SWEEP[1], SWEEP[0])])
        found += judged(Certifier(PLANAR, block_beyond(gap)), [(SWEEP[0], SWEEP[1]), (SWEEP[1], SWEEP[0])])
    assert set(found) == set(EdgeVerdict)


def block_beyond(gap: float) -> Scene:
    """A block whose face the end of the outstretched planar arm passes at about ``gap``, without a round edge in it."""
    return Scene((Obstacle("block", Box((0.2, 0.2, 0.2)), Pose((RIM + gap + 0.1, 0.0, 0.0))),))


@pytest.mark.parametrize(("name", "seed"), CROWDS)
def test_clearances_are_the_same(name: str, seed: int) -> None:
    setup = Crowded(name, seed)
    certifier = Certifier(setup.robot, setup.scene, allowed=setup.allowed)
    Q = np.array([setup.anywhere() for _ in range(40)])
    first, *others = [prover.clearances(Q) for prover in provers(certifier)]
    assert all(np.array_equal(first, other) for other in others)
    assert np.isfinite(first).all()


# --- what makes no sense


def _put(where: Any, value: float) -> Callable[[Any], None]:
    def change(array: Any) -> None:
        array[where] = value

    return change


@pytest.mark.parametrize(
    ("which", "change", "message"),
    [
        (0, lambda terms: terms[1:], "other terms"),
        (2, _put((2, 0), 5.0), "a parent comes first"),
        (3, _put((0, 0), 99.0), "no such body"),
        (4, lambda rows: rows[::-1].copy(), "no such piece"),
        (6, _put((0, 6), 99.0), "no such hull"),
        (7, _put(0, 10**6), "no such solid"),
        (9, _put(0, 10**6), "no such rotation"),
        (11, _put((0, 0), -1), "rides"),
        (11, _put((0, 1), 10**6), "no such piece"),
        (12, _put((0, 1), 10**6), "no such piece"),
        (12, _put((0, 3), 10**6), "no such bundle"),
        (13, _put((0, 0), 10**6), "a bundle comes after what is in it"),
        (13, lambda rows: rows[1:], "children of each bundle"),
        (14, _put((0, 0), 10**6), "rides"),
        (14, _put((0, 1), 10**6), "no such tree"),
        (14, _put((0, 2), 10**6), "no such joint"),
    ],
)
def test_compiled_code_refuses_what_makes_no_sense(which: int, change: Any, message: str) -> None:
    module = load_proof()
    many = PointCloud(np.random.default_rng(1).uniform(-0.1, 0.1, (200, 3)), 0.01)
    scene = Scene((*load_scene("bin").obstacles, Obstacle("cloud", many, Pose((0.6, 0.0, 0.2)))))
    data: list[Any] = [np.array(proof_terms()), *Certifier(WXAI, scene).motion.tables]
    module.Prover(*data)
    spoilt = data[which].copy()
    changed = change(spoilt)
    data[which] = spoilt if changed is None else changed
    with pytest.raises(ValueError, match=message):
        module.Prover(*data)

"""Laws of the certificate: against a second checker sampling densely, and its bounds against what they bound."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from auditor.checker import IndependentChecker, tables_of
from planner_service.certify import MARGIN, Certifier, interval_proof
from planner_service.certify.motion_bounds import Motion
from planner_service.certify.pairs import ProofPairs
from planner_service.collision import CollisionChecker, backends, native_kernel
from planner_service.collision.bounds import Solids
from planner_service.collision.native_kernel import build_kernel
from planner_service.collision.pairs import PairRuns, Parts
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Attached, Obstacle, Scene
from tests.reference.pair_proof import nearest
from tests.support.small_robots import CRANE, SLIDER, TWINS, built
from tests.unit.collision.test_edge_sampling import points_of

ROOT = Path(__file__).parents[2]
WXAI = load_robot("wxai")
PLANAR = load_robot("planar2")
COAL = 5e-6
"""Metres to which Coal's distance is right where it is positive."""
NEEDLE = Attached("needle", Capsule(0.002, 0.3), Pose.from_rpy((0.15, 0.0, 0.0), (0.0, math.pi / 2, 0.0)), ("link_6",))
FINGERS = ("finger_left", "finger_right")

sizes = st.floats(0.002, 0.3)
shapes = st.one_of(
    st.builds(lambda x, y, z: Box((x, y, z)), sizes, sizes, sizes),
    st.builds(Sphere, sizes),
    st.builds(Cylinder, sizes, sizes),
    st.builds(Capsule, sizes, sizes),
)
seeds = st.integers(0, 2**32 - 1)


def turned(rng: np.random.Generator) -> Pose:
    """A random orientation, one in four upright."""
    q = rng.normal(size=4) * (1.0 if rng.random() < 0.75 else [1.0, 0.0, 0.0, 0.0])
    w, x, y, z = (q / np.sqrt((q * q).sum())).tolist()
    return Pose((0.0, 0.0, 0.0), (w, x, y, z))


def motion_of(robot: Robot) -> Motion:
    return Motion(robot, ProofPairs(robot, Scene(), ()))


@pytest.fixture(scope="module", params=["wxai", "planar2", "slider", "twins", "crane"])
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Arms that turn, slide and branch."""
    urdf = {"slider": SLIDER, "twins": TWINS, "crane": CRANE}.get(request.param)
    return load_robot(request.param) if urdf is None else built(tmp_path_factory.mktemp("urdf"), urdf)


def anywhere(robot: Robot, rng: np.random.Generator, count: int) -> FloatArray:
    return rng.uniform(robot.limits.lower, robot.limits.upper, (count, robot.n))


def curve(robot: Robot, rng: np.random.Generator) -> JointPath:
    """Four random waypoints, near or far, with blended corners in half of the cases."""
    points = anywhere(robot, rng, 1) + np.zeros((4, robot.n))
    points[1:] = points[0] + (anywhere(robot, rng, 3) - points[0]) * rng.choice([0.02, 0.2, 1.0])
    path = JointPath(points)
    return rounded(path) if rng.random() < 0.5 else path


def rounded(path: JointPath) -> JointPath:
    """With blends as long as fit, except where it turns back."""
    d = 0.45 * float(np.diff(path.knots).min())
    inner = range(1, len(path.waypoints) - 1)
    return path.with_blends([0.0, *(0.0 if path.turns_back(k) else d for k in inner), 0.0])


HELD = (
    Attached("rod", Capsule(0.02, 0.3), Pose.from_rpy((0.1, 0.05, 0.0), (0.3, 1.0, 0.0))),
    Attached("ball", Sphere(0.05), Pose((0.0, 0.1, 0.1))),
    Attached("can", Cylinder(0.04, 0.1), Pose.from_rpy((0.0, -0.1, 0.1), (0.5, 0.2, 0.1))),
)


@settings(deadline=None, max_examples=30)
@given(seed=seeds)
def test_no_way_of_a_point_is_longer_than_its_bound(robot: Robot, seed: int) -> None:
    """The bound is for the length of the way, seen from every body further in, and not only for how far it leads."""
    rng = np.random.default_rng(seed)
    listed = ProofPairs(robot, Scene((), HELD), ())
    motion, path = Motion(robot, listed), curve(robot, rng)
    ends = np.sort(rng.uniform(0.0, path.length, 2)) if rng.random() < 0.7 else np.array([0.0, path.length])
    _, radii = motion.nodes(path(ends))
    travel = path.travel(ends)
    bounds = motion.motions(radii[:1], radii[1:], travel[1:] - travel[:1])[:, 0]
    R, t = robot.body_poses_batch(path(np.linspace(ends[0], ends[1], 200)))
    for k, piece in enumerate(listed.riding):
        frame = np.array(piece.frame)
        points = points_of(piece.shape) @ frame[:, :3].T + frame[:, 3]
        world = np.einsum("mij,pj->mpi", R[:, piece.body], points) + t[:, piece.body, None]
        body, step = piece.body, 0
        while body > 0:
            body, step = robot.bodies[body].parent, step + 1
            seen = np.einsum("mji,mpj->mpi", R[:, body], world - t[:, body, None])
            way = np.sqrt((np.diff(seen, axis=0) ** 2).sum(axis=-1)).sum(axis=0)
            assert way.max() <= bounds[step, k] + 1e-12


def test_a_bound_knows_that_the_arm_unfolds_on_the_way() -> None:
    """The shoulder turns while the arm is stretched out; at both ends the forearm is folded back."""
    motion = motion_of(PLANAR)
    path = JointPath(np.array([[0.0, -3.0], [0.0, 0.0], [1.0, 0.0], [1.0, 3.0]]))
    _, radii = motion.nodes(path([0.0, path.length]))
    assert radii[:, 1, 1].max() < 1.01
    bound = motion.motions(radii[:1], radii[1:], path.travel([path.length]))[2, 0, 1]
    assert bound >= 3 * 0.5 + 1 * 1.5 + 3 * 0.5


@settings(deadline=None, max_examples=60)
@given(seed=seeds)
@example(seed=47213)  # a bound of a rim is 50 um too low
def test_what_is_proven_of_a_curve_is_kept_between_its_samples_too(robot: Robot, seed: int) -> None:
    """Among random boxes, carrying things, on straight pieces and around corners, of the robot against itself, too."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-0.7, 0.7, (12, 3)).tolist()
    boxes = [Box(tuple(size)) for size in rng.uniform(0.01, 0.2, (12, 3)).tolist()]
    boxed = tuple(Obstacle(f"box {k}", box, Pose(tuple(places[k]))) for k, box in enumerate(boxes))
    allowed = [(held.name, f"box {k}") for held in HELD for k in range(4)]
    scene = Scene(boxed, HELD)
    certifier = Certifier(robot, scene, allowed=allowed)
    for _ in range(6):
        path = curve(robot, rng)
        found = certifier.certify(path)
        if found.certified:
            near = path(np.linspace(0.0, path.length, 1500))
            near = near[certifier.clearances(near) < found.clearance - 1e-6]  # bounds, which may be too low
            if len(near) > 0:
                checker = CollisionChecker(robot, scene, allowed=allowed)
                assert checker.near(near, found.clearance).distances.min(initial=1.0) >= found.clearance - 1e-6


def test_what_is_proven_of_two_arms_on_a_body_that_turns_is_kept_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Directions stay as they are for that body, not for the world."""
    monkeypatch.setattr(interval_proof, "FRACTION", 0.99)  # bounds that are a little too large are noticed
    certifier, rng = Certifier(built(tmp_path, TWINS), Scene()), np.random.default_rng(3)
    proven = 0
    for _ in range(600):
        path = JointPath(rng.uniform([-1.0, -0.5, -3.0], 2.9, (2, 3)))
        found = certifier.certify(path)
        if found.certified:
            proven += 1
            assert found.clearance <= certifier.clearances(path(np.linspace(0.0, path.length, 300))).min() + 1e-6
    assert proven > 100


BLOCK = Attached("block", Box((0.045, 0.045, 0.045)), Pose((0.01, 0.0, 0.0)), FINGERS)


@pytest.mark.parametrize(
    ("name", "held", "allowed"),
    [
        ("narrow", (BLOCK,), (("wall_left", "block"), ("link_5", "link_2"))),
        ("clutter", (NEEDLE,), ()),
    ],
)
def test_the_proof_judges_the_pairs_that_the_checkers_judge(
    name: str, held: tuple[Attached, ...], allowed: tuple[tuple[str, str], ...]
) -> None:
    scene = Scene(load_scene(name).obstacles, held)
    listed = ProofPairs(WXAI, scene, allowed)
    checker = CollisionChecker(WXAI, scene, allowed=allowed)
    second = IndependentChecker(ROOT / "robots" / "wxai", tables_of(scene), allowed=allowed)
    ours = sorted(sorted(listed.names(k)) for k in range(len(listed)))
    assert ours == sorted(sorted(checker.pair_names(k)) for k in range(checker.pair_count))
    assert ours == sorted(sorted(pair) for pair in second.pairs)


def samples(path: JointPath, reach: FloatArray, step: float) -> FloatArray:
    """Configurations so dense that no point moves more than ``step`` between two."""
    count = 2 + math.ceil(float((reach * path.travel(path.length)).sum()) / step)
    return path(np.linspace(0.0, path.length, count))


def walks(robot: Robot, second: IndependentChecker, rng: np.random.Generator, count: int) -> Iterator[JointPath]:
    """Short paths of three pieces from free states, that may or may not hit something; half with blended corners."""
    made = 0
    while made < count:
        q = anywhere(robot, rng, 1)[0]
        if not second.free(q):
            continue
        points = q + np.cumsum(np.concatenate([np.zeros((1, robot.n)), rng.normal(size=(3, robot.n)) * 0.3]), axis=0)
        points = np.clip(points, robot.limits.lower, robot.limits.upper)
        path, made = JointPath(points), made + 1
        yield rounded(path) if made % 2 else path


@pytest.mark.parametrize("name", ["bin", "shelf", "clutter"])
def test_a_curve_is_certified_where_the_reference_proves_it_apart_and_nowhere_else(name: str) -> None:
    scene = load_scene(name)
    second = IndependentChecker(ROOT / "robots" / "wxai", ROOT / "scenes" / f"{name}.toml")
    certifier, rng = Certifier(WXAI, scene), np.random.default_rng(7)
    certified = 0
    for path in walks(WXAI, second, rng, 8):
        found = certifier.certify(path)
        low, high = nearest(second, path)
        assert found.certified == (low > MARGIN)
        if found.certified:
            certified += 1
            assert 0.25 * low <= found.clearance <= high + COAL
    assert 2 <= certified <= 6


def shrunk(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Parts.__init__

    def smaller(parts: Parts, *arguments: Any, **options: Any) -> None:
        whole(parts, *arguments, **options)
        tips = [part.owner.name in FINGERS for part in parts.parts[: parts.riding]]
        kinds = zip(parts.kinds, [*tips, *[False] * (len(parts.kinds) - len(tips))], strict=True)
        parts.kinds = tuple(Sphere(0.001) if tip else kind for kind, tip in kinds)
        parts.solids = Solids.of(parts.kinds)

    monkeypatch.setattr(Parts, "__init__", smaller)


def displaced(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = native_kernel._joints

    def lifted(robot: Robot) -> FloatArray:
        joints = whole(robot).copy()
        joints[5, 17] += 0.03  # where the sixth joint is along the link before it
        return joints

    monkeypatch.setattr(native_kernel, "_joints", lifted)


def unpaired(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Parts._pairs

    def fewer(parts: Parts) -> Any:
        left = [pair for pair in whole(parts) if parts.parts[pair[0]].owner.name not in (*FINGERS, "link_6")]
        return PairRuns(np.array([(k, i, j) for k, (i, j) in enumerate(left)]), len(left))

    monkeypatch.setattr(Parts, "_pairs", fewer)


def blind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "build_kernel", partial(build_kernel, margin=-0.05))


@pytest.mark.parametrize("fault", [shrunk, displaced, unpaired, blind])
def test_a_fault_of_the_search_does_not_reach_the_proof(fault: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, rng = load_scene("bin"), np.random.default_rng(12)
    second = IndependentChecker(ROOT / "robots" / "wxai", ROOT / "scenes" / "bin.toml")
    sound = CollisionChecker(WXAI, scene)
    edges: list[FloatArray] = []
    while len(edges) < 60:
        q = anywhere(WXAI, rng, 1)[0]
        q = WXAI.home + (q - WXAI.home) * 0.5
        edge = np.clip([q, q + rng.normal(size=6) * 0.15], WXAI.limits.lower, WXAI.limits.upper)
        if not sound.edge_is_free(*edge) and not second.path_is_free(edge, 0.002):
            edges.append(edge)
    fault(monkeypatch)
    faulty = CollisionChecker(WXAI, scene)
    fooled = [edge for edge in edges if faulty.edge_is_free(*edge)]
    assert len(fooled) >= 3
    certifier = Certifier(WXAI, scene)
    assert [certifier.certify(JointPath(edge)).certified for edge in fooled] == [False] * len(fooled)
    assert [certifier.certify_edge(*edge).free for edge in fooled] == [False] * len(fooled)

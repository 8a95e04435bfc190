"""Laws of the proof that constraints are kept, against the auditor's kinematics at dense samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auditor.checker import IndependentChecker
from auditor.constraints import Deviation, deviations, violations
from benchmarks.harness.audit import audited
from planner_service.certify import KeptRefusal, prove_kept
from planner_service.certify.relative_motion import RelativeMotion
from planner_service.constraints import KeepUpright, OnPlane, RelativePose, ToolRegion
from planner_service.geometry.arrays import FloatArray, vector
from planner_service.geometry.shapes import Pose
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from tests.support.constrained_paths import Walker, rounded
from tests.support.small_robots import joint, link, solid, urdf

ROOT = Path(__file__).parents[2]
SAMPLES = 800
INF = math.inf
SEEDS = st.integers(0, 2**32 - 1)

WXAI = load_robot("wxai")
DUAL = load_robot("wxai_dual")


@dataclass(frozen=True)
class Arm:
    """A random arm, and the auditor's reading of its file."""

    robot: Robot
    second: IndependentChecker


def random_arm(rng: np.random.Generator, folder: Path) -> Arm:
    """Up to six joints that turn or slide about oblique axes; one link in four branches off further in."""
    names, parts, joints = ["l0"], [link("l0")], list[str]()
    for k in range(1, 2 + int(rng.integers(6))):
        parent = names[-1] if rng.random() < 0.75 else names[int(rng.integers(len(names)))]
        kind = str(rng.choice(["revolute", "revolute", "continuous", "prismatic"]))
        axis = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0]) if rng.random() < 0.5 else rng.normal(size=3)
        limits = {"revolute": " -2.5 2.5", "prismatic": " -0.4 0.5", "continuous": " -9 9"}[kind]
        xyz, rpy = rng.uniform(-0.3, 0.3, 3), rng.uniform(-3.0, 3.0, 3)
        names.append(f"l{k}")
        joints.append(f"j{k}")
        where = {"axis": _numbers(axis), "xyz": _numbers(xyz), "rpy": _numbers(rpy)}
        sphere = solid("sphere", 'radius="0.01"')
        parts += [
            link(f"l{k}", sphere),
            joint(f"j{k}", f"{kind} {parent} l{k}{limits}", **where),
        ]
    file = folder / f"{rng.integers(2**40)}.urdf"
    file.write_text(urdf("random", *parts), "utf-8")
    robot = Robot.from_urdf(file, tool_frame=names[-1])
    table = {"urdf": file, "joints": list(robot.joint_names), "tool_frame": names[-1]}
    return Arm(robot, IndependentChecker(table, {}))


def _numbers(values: FloatArray) -> str:
    return " ".join(repr(value) for value in values.tolist())


def random_path(robot: Robot, rng: np.random.Generator) -> JointPath:
    """Up to five waypoints, near or far, blended or not."""
    lower, upper = np.maximum(robot.limits.lower, -3.0), np.minimum(robot.limits.upper, 3.0)
    points = rng.uniform(lower, upper, (int(rng.integers(2, 6)), robot.n))
    points[1:] = points[0] + (points[1:] - points[0]) * rng.choice([0.01, 0.1, 0.4, 1.0])
    path = JointPath(points)
    return rounded(path, float(rng.uniform(0.05, 0.499))) if rng.random() < 0.6 else path


def random_pose(rng: np.random.Generator, turned: float = math.pi) -> Pose:
    x, y, z = rng.uniform(-0.3, 0.3, 3).tolist()
    return Pose.from_rpy((x, y, z), rng.uniform(-turned, turned, 3).tolist())


def largest(second: IndependentChecker, robot: Robot, region: ToolRegion, samples: FloatArray) -> list[Deviation]:
    return deviations(second, samples, [audited(robot, region)])


def fitted(arm: Arm, rng: np.random.Generator, samples: FloatArray) -> ToolRegion:
    """A region that the curve keeps, exactly or with room; some of its bounds are missing or on one side."""
    links = [None, *(frame.link for frame in arm.robot.link_frames)]
    region = ToolRegion(
        tilt=math.pi,
        tool=random_pose(rng),
        link=links[rng.integers(len(links))],
        relative_to=None if rng.random() < 0.4 else links[rng.integers(1, len(links))],
    )
    link = arm.robot.tool_frame if region.link is None else region.link
    middle = arm.second.link_poses(samples[len(samples) // 2], [link, region.relative_to or "l0"])
    seen = np.linalg.inv(middle[1]) if region.relative_to else np.eye(4)
    near = Pose.from_matrix(seen @ middle[0] @ region.tool.matrix) @ random_pose(
        rng, float(rng.choice([0.0, 0.05, 0.5, 3.0]))
    )
    region = replace(region, frame=near)
    ends: list[tuple[float, float]] = []
    for axis in range(3):
        bounds = np.full((2, 3), [[-INF], [INF]])
        bounds[1, axis] = 0.0
        high = largest(arm.second, arm.robot, replace(region, upper=tuple(bounds[1])), samples)[0].amount
        bounds[:, axis] = 0.0, INF
        low = -largest(arm.second, arm.robot, replace(region, lower=tuple(bounds[0])), samples)[0].amount
        room = max((high - low) * float(rng.choice([1e-6, 0.05, 0.5, 5.0])), 2e-4)
        low, high = low - room * float(rng.random()), high + room
        ends.append(((low, high), (-INF, high), (low, INF), (-INF, INF))[rng.choice(4, p=[0.5, 0.1, 0.1, 0.3])])
    turned = largest(arm.second, arm.robot, replace(region, tilt=1.5, turn=math.pi), samples)
    tilt, turn = (min(math.pi, item.amount * float(rng.choice([1.001, 1.1, 2.0, 8.0])) + 1e-3) for item in turned)
    lower, upper = (vector([end[k] for end in ends]) for k in (0, 1))
    bounded = replace(region, lower=lower, upper=upper, tilt=tilt)
    return replace(bounded, turn=turn) if tilt <= math.pi / 2 else bounded


@settings(deadline=None, max_examples=40)
@given(seed=SEEDS)
def test_a_bound_is_no_less_than_any_sample_and_close_to_the_largest(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, tmp_path_factory.getbasetemp())
    path = random_path(arm.robot, rng)
    samples = path(np.linspace(0.0, path.length, SAMPLES))
    region = fitted(arm, rng, samples)
    found = prove_kept(arm.robot, path, [region])
    sampled = largest(arm.second, arm.robot, region, samples)
    if isinstance(found, KeptRefusal):  # broken between the samples
        there = {item.quantity: item for item in largest(arm.second, arm.robot, region, path([found.s]))}[
            found.quantity
        ]
        assert found.spent or there.amount > there.tolerance
        return
    for item, bound in zip(sampled, found[0].bounds, strict=True):
        assert (bound.quantity, bound.unit) == (item.quantity, "rad" if item.quantity in ("tilt", "turn") else "m")
        assert bound.tolerance == pytest.approx(item.tolerance, abs=1e-12)
        assert item.amount <= bound.bound + 1e-12
        if not item.quantity.startswith(("+", "-")):
            assert bound.bound <= max(1.3 * item.amount, 0.2 * item.tolerance) + 1e-6


@settings(deadline=None, max_examples=25)
@given(seed=SEEDS)
def test_what_the_auditor_finds_broken_is_refused_and_where(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """One bound is made smaller than the largest sample."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, tmp_path_factory.getbasetemp())
    path = random_path(arm.robot, rng)
    s = np.linspace(0.0, path.length, SAMPLES)
    samples = path(s)
    region = fitted(arm, rng, samples)
    tilts = largest(arm.second, arm.robot, replace(region, turn=None), samples)
    worst = tilts[-1].amount
    less = worst * float(rng.choice([0.3, 0.9, 0.999]))
    if less < 1e-3:
        return
    refusal = prove_kept(arm.robot, path, [replace(region, tilt=less, turn=None)])
    assert isinstance(refusal, KeptRefusal)
    assert not refusal.spent
    if refusal.quantity == "tilt":
        assert less < refusal.deviation <= worst * 1.01 + 1e-4
        there = largest(arm.second, arm.robot, replace(region, turn=None), path([refusal.s]))
        assert there[-1].amount == pytest.approx(refusal.deviation, abs=1e-7)
        assert any(start <= refusal.s <= end for start, end in refusal.broken)


@settings(deadline=None, max_examples=60)
@given(seed=SEEDS)
def test_no_frame_curves_more_than_its_rates(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    """By second differences of the auditor's kinematics, of the position and of the angles between axes."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, tmp_path_factory.getbasetemp())
    robot, h = arm.robot, 1e-3
    inner, outer = (robot.link_frames[rng.integers(len(robot.link_frames))] for _ in range(2))
    moving = RelativeMotion(robot, (inner.body, inner.pose), (outer.body, outer.pose))
    lower, upper = np.maximum(robot.limits.lower, -3.0), np.minimum(robot.limits.upper, 3.0)
    q, v, a = rng.uniform(lower, upper), rng.normal(size=robot.n), rng.normal(size=robot.n) * rng.choice([0.0, 1.0])
    v *= rng.choice([0.0, 0.1, 1.0, 10.0], robot.n)
    curve = np.array([q + v * s + a * s * s / 2.0 for s in (-h, 0.0, h)])
    poses = [
        np.linalg.inv(one) @ two for one, two in (arm.second.link_poses(x, [inner.link, outer.link]) for x in curve)
    ]
    assert np.abs(np.array([pose[:3, 3] for pose in poses]) - moving.positions(curve).T).max() < 1e-12
    speeds = np.abs(v) + np.abs(a) * h
    rates = moving.rates(speeds[None], np.abs(a)[None], np.abs(curve).max(axis=0))
    second = (poses[0] - 2.0 * poses[1] + poses[2]) / (h * h)
    assert math.sqrt(float((second[:3, 3] ** 2).sum())) <= rates.position[0] + 1e-5
    Q = moving.orientations(curve)
    assert math.sqrt(float((((Q[:, 0] - 2.0 * Q[:, 1] + Q[:, 2]) / (h * h)) ** 2).sum())) <= rates.orientation[0] + 1e-5
    between = poses[0][:3, :3].T @ poses[2][:3, :3]
    assert math.acos(min(1.0, (float(np.trace(between)) - 1.0) / 2.0)) <= 2.0 * h * rates.turning[0] + 1e-6


def lifted(pose: FloatArray) -> FloatArray:
    """The tool is taken to be 20 mm further out."""
    return np.asarray(pose @ Pose((0.02, 0.0, 0.0)).matrix)


def swapped(pose: FloatArray) -> FloatArray:
    """Another axis of the tool is taken to be the one that is meant."""
    return np.asarray(pose @ np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]))


def from_the_wrong_side(pose: FloatArray) -> FloatArray:
    """The pose of the region in the tool instead of that of the tool in the region."""
    return np.asarray(np.linalg.inv(pose))


UPRIGHT = KeepUpright((1.0, 0.0, 0.0), 0.1, up=(1.0, 0.0, 0.2))
BOARD = OnPlane(Pose.from_rpy((0.35, 0.0, 0.15), (0.2, 0.3, 0.0)), 0.001)


@pytest.mark.parametrize(
    ("region", "planted"),
    [
        (UPRIGHT, Walker(WXAI, UPRIGHT, 0.2, swapped)),
        (UPRIGHT, Walker(WXAI, KeepUpright((1.0, 0.0, 0.0), 0.1), 0.2)),
        (UPRIGHT, Walker(WXAI, KeepUpright((1.0, 0.0, 0.0), math.degrees(0.03), up=(1.0, 0.0, 0.2)), 0.2)),
        (BOARD, Walker(WXAI, BOARD, 0.04, lifted)),
        (BOARD, Walker(WXAI, BOARD, 0.04, from_the_wrong_side)),
    ],
    ids=["swapped axis", "wrong frame", "degrees for radians", "wrong tool", "inverse"],
)
def test_a_fault_of_the_search_is_refused(region: ToolRegion, planted: Walker) -> None:
    rng, second = np.random.default_rng(3), IndependentChecker(ROOT / "robots" / "wxai", {})
    for _ in range(3):
        path = planted.path(rng, 1.0)
        assert violations(second, path, path.length, [audited(WXAI, region)], 0.005)
        refusal = prove_kept(WXAI, path, [region])
        assert isinstance(refusal, KeptRefusal)
        assert not refusal.spent


TRAY = Pose((0.05, -0.4, 0.1))


@pytest.mark.parametrize(
    ("robot", "region", "step"),
    [
        (WXAI, UPRIGHT, 0.2),
        (WXAI, BOARD, 0.04),
        (DUAL, RelativePose("right_ee_gripper_link", "left_ee_gripper_link", TRAY, 0.002, 0.01), 0.04),
    ],
    ids=["upright", "plane", "tray"],
)
def test_a_path_that_keeps_a_constraint_is_proven_and_audited(robot: Robot, region: ToolRegion, step: float) -> None:
    rng, second = np.random.default_rng(5), IndependentChecker(ROOT / "robots" / robot.name, {})
    shares = []
    for _ in range(3):
        path = Walker(robot, region, step).path(rng, 0.6)
        found = prove_kept(robot, path, [region])
        assert not isinstance(found, KeptRefusal)
        assert not violations(second, path, path.length, [audited(robot, region)], 0.002)
        samples = second.along(path, path.length, 0.002)
        for item, bound in zip(deviations(second, samples, [audited(robot, region)]), found[0].bounds, strict=True):
            assert item.amount <= bound.bound
            shares.append(bound.bound / max(1.3 * item.amount, 0.2 * item.tolerance))
    assert max(shares) <= 1.001

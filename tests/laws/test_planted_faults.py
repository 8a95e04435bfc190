"""What the robot, the scene or the proof gets wrong, the second checker notices: it reads the files on its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from planner_service.certify import Certifier
from planner_service.certify.pairs import ProofPairs
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Body, Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene

ROOT = Path(__file__).parents[2]
WXAI = load_robot("wxai")
SECOND = IndependentChecker(ROOT / "robots" / "wxai", ROOT / "scenes" / "bin.toml")
Patch = pytest.MonkeyPatch
Fault = Callable[[Patch, Robot, Scene], tuple[Robot, Scene]]


def body_of(robot: Robot, k: int, change: Callable[[Body], Body]) -> Robot:
    return replace(robot, bodies=(*robot.bodies[:k], change(robot.bodies[k]), *robot.bodies[k + 1 :]))


def shrunk_shape(patch: Patch, robot: Robot, scene: Scene) -> tuple[Robot, Scene]:
    """The largest shape of each finger is half as large."""
    shapes = [replace(s, shape=_halved(s.shape)) if s.link.startswith("finger") else s for s in robot.shapes]
    return replace(robot, shapes=tuple(shapes)), scene


def _halved(shape: Any) -> Any:
    return replace(shape, **{name: _half(getattr(shape, name)) for name in shape.__dataclass_fields__})


def _half(value: Any) -> Any:
    return tuple(v / 2 for v in value) if isinstance(value, tuple) else value / 2


def displaced_link(patch: Patch, robot: Robot, scene: Scene) -> tuple[Robot, Scene]:
    """One link's frame is 5 mm off."""

    def moved(body: Body) -> Body:
        placement = body.placement.copy()
        placement[2, 3] += 0.005
        return replace(body, placement=placement)

    return body_of(robot, 4, moved), scene


def other_axis(patch: Patch, robot: Robot, scene: Scene) -> tuple[Robot, Scene]:
    """A joint turns about another axis."""
    return body_of(robot, 4, lambda body: replace(body, axis=np.roll(body.axis, 1))), scene


def other_way(patch: Patch, robot: Robot, scene: Scene) -> tuple[Robot, Scene]:
    """A joint turns the other way."""
    return body_of(robot, 5, lambda body: replace(body, axis=-body.axis)), scene


def swapped_joints(patch: Patch, robot: Robot, scene: Scene) -> tuple[Robot, Scene]:
    """Two joints are taken for each other."""
    first, second = robot.bodies[2].q_index, robot.bodies[3].q_index
    robot = body_of(robot, 2, lambda body: replace(body, q_index=second))
    return body_of(robot, 3, lambda body: replace(body, q_index=first)), scene


def closed_gripper(patch: Patch, robot: Robot, scene: Scene) -> tuple[Robot, Scene]:
    return robot.with_gripper(0.0), scene


def displaced_obstacle(patch: Patch, robot: Robot, scene: Scene) -> tuple[Robot, Scene]:
    lifted = [replace(o, pose=Pose((0.0, 0.0, -0.01)) @ o.pose) for o in scene.obstacles]
    return robot, Scene(tuple(lifted), scene.attached)


def missing_obstacle(patch: Patch, robot: Robot, scene: Scene) -> tuple[Robot, Scene]:
    return robot, scene.without("table")


def missing_pairs(patch: Patch, robot: Robot, scene: Scene) -> tuple[Robot, Scene]:
    """The list forgets what the hand meets of the arm and of the table."""
    allowed = [
        (a, b) for a in ("link_1", "link_2", "table") for b in ("link_5", "link_6", "finger_left", "finger_right")
    ]
    whole = ProofPairs.__init__

    def fewer(self: ProofPairs, robot: Robot, scene: Scene, told: Any = (), *more: Any, **named: Any) -> None:
        whole(self, robot, scene, [*told, *allowed], *more, **named)

    patch.setattr(ProofPairs, "__init__", fewer)
    return robot, scene


@cache
def edges(count: int, seed: int) -> list[FloatArray]:
    """Edges whose ends are free, and on which something touches in between, as the second checker says."""
    rng, out = np.random.default_rng(seed), list[FloatArray]()
    while len(out) < count:
        a = rng.uniform(WXAI.limits.lower, WXAI.limits.upper)
        b = np.clip(a + rng.normal(size=WXAI.n) * 0.3, WXAI.limits.lower, WXAI.limits.upper)
        if SECOND.free(a) and SECOND.free(b) and not SECOND.path_is_free([a, b], 0.03):
            out.append(np.array([a, b]))
    return out


def noticed(robot: Robot, scene: Scene) -> bool:
    """Whether a proof says free of an edge on which the second checker finds a contact."""
    certifier = Certifier(robot, scene)
    return any(certifier.certify(JointPath(edge)).certified for edge in edges(60, 3))


OF_THE_MODEL: list[Fault] = [
    shrunk_shape,
    displaced_link,
    other_axis,
    other_way,
    swapped_joints,
    closed_gripper,
    displaced_obstacle,
    missing_obstacle,
    missing_pairs,
]


def test_a_proof_without_a_fault_is_right_about_every_edge() -> None:
    assert not noticed(WXAI, load_scene("bin"))


@pytest.mark.parametrize("fault", OF_THE_MODEL)
def test_a_fault_of_robot_scene_or_pairs_shows(fault: Fault, monkeypatch: Patch) -> None:
    robot, scene = fault(monkeypatch, WXAI, load_scene("bin"))
    assert noticed(robot, scene)

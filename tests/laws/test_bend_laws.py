"""Laws of what two pieces do between two places of a curve, seen from the last body that carries both.

The second opinion is the robot's forward kinematics, which shares no code with the proof's, at points of both pieces.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service.certify import Certifier
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Pose, Shape, Sphere
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Obstacle, Scene
from tests.laws.test_certify_laws import HELD, rounded
from tests.support.small_robots import CRANE, MIXED, TWINS, built, joint, link, solid, urdf
from tests.unit.collision.test_edge_sampling import points_of

WAGON = urdf(
    "wagon",
    *(link(name) for name in ("ground", "rail", "bogie")),
    link("wagon", solid("box", "0.6 0.5 0.2")) + link("mast", solid("cylinder", 'radius="0.05" length="0.8"')),
    joint("x", "prismatic ground rail -2 2", axis="1 0 0"),
    joint("y", "prismatic rail bogie -2 2", axis="0 1 0"),
    joint("yaw", "revolute bogie wagon -3 3", xyz="0 0 0.2", rpy="0.02 -0.03 0.4"),
    joint("lift", "prismatic wagon mast 0 0.4", axis="0.1 0 1", xyz="0.1 0 0.5", rpy="0 0.2 1.1"),
    *(
        link(f"{side}_{part}", solid("box", "0.4 0.06 0.06", "0.2 0 0"))
        for side in ("left", "right")
        for part in ("arm", "hand")
    ),
    joint("left_shoulder", "revolute mast left_arm -3 3", axis="0 1 0", xyz="0 0.2 0.3", rpy="0.3 0 1.2"),
    joint("left_elbow", "revolute left_arm left_hand -3 3", axis="0 0.6 0.8", xyz="0.4 0 0", rpy="0.5 0 0"),
    joint("right_shoulder", "revolute mast right_arm -3 3", axis="0 1 0", xyz="0 -0.2 0.3", rpy="-0.3 0 -1.2"),
    joint("right_elbow", "revolute right_arm right_hand -3 3", axis="1 0 1", xyz="0.4 0 0", rpy="0 0.7 0"),
)
"""Two arms of two joints on a mast that lifts, on a base that drives."""

URDFS = {"wagon": WAGON, "twins": TWINS, "crane": CRANE, "mixed": MIXED}
ROBOTS = (*URDFS, "wxai_dual", "wxai", "ur5")
PLACES = 12
"""Places between two at which pieces are looked at."""

ROUNDED = 1e-9
"""Metres: rounding of both forward kinematics."""

LITTLE = 1e-6
"""Metres; of a smaller bound no part is told."""

STANDING = (
    Obstacle("post", Capsule(0.05, 0.6), Pose.from_rpy((0.4, 0.3, 0.3), (0.3, 0.4, 0.0))),
    Obstacle("crate", Box((0.3, 0.2, 0.1)), Pose.from_rpy((-0.4, 0.2, 0.4), (0.5, 0.1, 1.0))),
    Obstacle("globe", Sphere(0.1), Pose((0.2, -0.5, 0.2))),
)


def corners_of(shape: Shape) -> FloatArray:
    return shape.vertices if isinstance(shape, Mesh) else points_of(shape)


@dataclass
class Judged:
    """How often a bound is wrong, the largest part of each that is needed, and points at places that were looked at."""

    wrong: Counter[str] = field(default_factory=Counter)
    needed: dict[str, float] = field(default_factory=dict)
    looked: int = 0

    def add(self, found: dict[str, float], most: dict[str, float], points: int) -> None:
        self.looked += points
        for law, bound in most.items():
            self.wrong[law] += not found[law] <= bound + ROUNDED
            if bound > LITTLE:
                self.needed[law] = max(self.needed.get(law, 0.0), found[law] / bound)


class Stretches:
    """Random stretches of random curves of a robot that holds something, and what is known of its pairs on them."""

    def __init__(self, robot: Robot, seed: int) -> None:
        self.robot, self.rng = robot, np.random.default_rng(seed)
        certifier = Certifier(robot, Scene(STANDING, HELD))
        self.certifier, self.listed = certifier, certifier.listed
        self.pieces = [*self.listed.riding, *self.listed.standing]
        self.chains = [self._chain(max(piece.body, 0)) for piece in self.pieces]
        self.prover = certifier.prover

    def _chain(self, body: int) -> list[int]:
        """The body and all that carry it, the base last."""
        out = [body]
        while out[-1] > 0:
            out.append(self.robot.bodies[out[-1]].parent)
        return out

    def carrier(self, first: int, second: int) -> int:
        """The last body that carries both pieces."""
        return next(body for body in self.chains[first] if body in self.chains[second])

    def drawn(self) -> tuple[JointPath, tuple[float, float]]:
        """A curve of two lines, its corner blended or not, and two places on it."""
        robot, rng = self.robot, self.rng
        lower, upper = (np.clip(limit, -3.0, 3.0) for limit in robot.bounds)
        points = rng.uniform(lower, upper, (3, robot.n))
        points[1:] = points[0] + (points[1:] - points[0]) * 10.0 ** rng.uniform(-2.0, 0.0)
        still = rng.random(robot.n) < 0.3
        points[:, still] = points[0, still]
        if not (points[2] - points[0]).any():
            points[1:, 0] += [0.1, 0.3]
        path = rounded(JointPath(points)) if rng.random() < 0.5 else JointPath(points)
        begin, end = np.sort(rng.uniform(0.0, path.length, 2)).tolist()
        if rng.random() < 0.6:  # on one line
            begin, end = 0.0, path.breaks[1]
        return path, (begin, end)

    def judged(self, count: int, most_pairs: int = 40) -> Judged:
        """What was found of so many stretches."""
        out = Judged()
        for _ in range(count):
            path, ends = self.drawn()
            pairs = self.rng.permutation(len(self.listed.plain))[:most_pairs]
            for found in self._looked(path, ends, pairs):
                out.add(*found)
        return out

    def _looked(
        self, path: JointPath, ends: tuple[float, float], pairs: Any
    ) -> Iterator[tuple[dict[str, float], dict[str, float], int]]:
        """Of each pair what is found at its points, what may be at most, and how many points at places that were."""
        s = np.linspace(*ends, PLACES)
        R, t = self.robot.body_poses_batch(path(s))
        R[:, 0], t[:, 0] = np.eye(3), 0.0
        seen, directions = [], []
        for first, second in self.listed.plain[pairs].tolist():
            carrier = self.carrier(first, second)
            frames = [self._frame(piece, carrier, R, t) for piece in (first, second)]
            n = self.rng.normal(size=3)
            if self.rng.random() < 0.7:  # as a proof's: about from the one to the other
                n = 0.3 * n + (frames[0][1][0] - frames[1][1][0]) / 0.1
            n /= math.sqrt(float(n @ n))
            seen.append((first, second, frames, n))
            directions.append(frames[1][0][0].T @ n)
        known = self.prover.stretch(path, ends, pairs, np.array(directions))
        for (first, second, frames, n), (motion, bend, gap) in zip(seen, known.tolist(), strict=True):
            ways, off, nearness, points = 0.0, 0.0, np.zeros(PLACES), 0
            for piece, (S, x), sign in ((first, frames[0], -1.0), (second, frames[1], 1.0)):
                own = corners_of(self.pieces[piece].shape)
                at = np.einsum("mij,pj->mpi", S, own) + x[:, None]
                ways += np.sqrt((np.diff(at, axis=0) ** 2).sum(axis=2)).sum(axis=0).max()
                share = np.linspace(0.0, 1.0, PLACES)[:, None, None]
                line = at[0] + (at[-1] - at[0]) * share
                off += np.sqrt(((at - line) ** 2).sum(axis=2)).max()
                along = np.einsum("mij,i->mj", S, sign * n)
                height = (self.pieces[piece].shape.support(along) * along).sum(axis=1) + sign * x @ n
                nearness += height
                points += len(own)
            found = {"motion": ways, "bend": off, "nearness": float(nearness.max())}
            yield found, {"motion": motion, "bend": bend, "nearness": -gap}, points * PLACES

    def _frame(self, piece: int, carrier: int, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations and positions of a piece, seen from a body, at all places."""
        body, frame = max(self.pieces[piece].body, 0), np.array(self.pieces[piece].frame)
        S = R[:, body] @ frame[:, :3]
        x = np.einsum("mij,j->mi", R[:, body], frame[:, 3]) + t[:, body]
        back = R[:, carrier].transpose(0, 2, 1)
        return back @ S, np.einsum("mij,mj->mi", back, x - t[:, carrier])


def made(name: str, folder: Path) -> Robot:
    return built(folder, URDFS[name]) if name in URDFS else load_robot(name)


@pytest.mark.parametrize("name", ROBOTS)
def test_pieces_stay_within_what_is_known_of_them_seen_from_the_body_that_carries_both(
    name: str, tmp_path: Path
) -> None:
    """They move no farther, leave their lines by no more, and along the direction come no nearer."""
    judged = Stretches(made(name, tmp_path), 1).judged(80)
    assert judged.wrong.total() == 0, judged.wrong
    assert judged.looked > 1_000_000
    assert judged.needed["motion"] > 0.9
    assert judged.needed["bend"] > 0.9

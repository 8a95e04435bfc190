"""A name is not an identity: objects called like links are judged as if they were called anything else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from planner_service.certify import Certifier, ExemptInterval
from planner_service.collision import CollisionChecker
from planner_service.collision.backends import BackendName
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.robot.model import Robot
from planner_service.scene.scene import Attached, Obstacle, Scene
from tests.support.refusals import refused_pair

JUDGES: list[BackendName] = ["native", "fcl"]
WORLDS = 8

Pair = tuple[str, str]


@dataclass(frozen=True)
class World:
    """One scene twice, its objects called like links of the robot and by names of their own."""

    robot: Robot
    clashing: Scene
    plain: Scene
    pairs: tuple[Pair, ...]
    plain_name: dict[str, str]

    def plainly(self, pairs: tuple[Pair, ...]) -> tuple[Pair, ...]:
        """The same pairs in the scene without clashes."""
        return tuple((self.plain_name[a], self.plain_name[b]) for a, b in pairs)


def random_robot(rng: np.random.Generator, folder: Path) -> Robot:
    """A tree of up to eight links, one in three without shapes, some fixed to another, some allowed to touch."""
    names = ["world", *rng.permutation(["wrist", "arm", "flange", "base", "a (link)", "tool", "@tool"]).tolist()]
    names = names[: int(rng.integers(5, 9))]
    links, joints = [], []
    for k, name in enumerate(names):
        box = f'<box size="{rng.uniform(0.05, 0.3):.3f} 0.06 0.05"/>'
        shape = box if rng.random() < 0.5 else '<sphere radius="0.05"/>'
        place = f'<origin xyz="{rng.uniform(0.0, 0.15):.3f} 0 0"/>'
        solid = f"<collision>{place}<geometry>{shape}</geometry></collision>" if k == 1 or rng.random() < 0.67 else ""
        links.append(f'<link name="{name}">{solid}</link>')
        if k:
            parent = names[int(rng.integers(max(0, k - 2), k))]
            fixed = k > 2 and rng.random() < 0.3
            limits = "" if fixed else '<axis xyz="0 0.6 0.8"/><limit lower="-3" upper="3" velocity="1"/>'
            x, y, z = rng.uniform(-0.2, 0.3, 3)
            joints.append(
                f'<joint name="j{k}" type="{"fixed" if fixed else "revolute"}"><parent link="{parent}"/>'
                f'<child link="{name}"/><origin xyz="{x:.3f} {y:.3f} {z:.3f}" rpy="0.3 {y:.2f} 0.5"/>{limits}</joint>'
            )
    chosen = {tuple(sorted(rng.choice(names, 2, replace=False).tolist())) for _ in range(4)}
    allowed = [f'<disable_collisions link1="{a}" link2="{b}" reason="drawn"/>' for a, b in sorted(chosen)]
    urdf, srdf = folder / "r.urdf", folder / "r.srdf"
    urdf.write_text(f'<robot name="r">{"".join(links + joints)}</robot>', "utf-8")
    srdf.write_text(f'<robot name="r">{"".join(allowed)}</robot>', "utf-8")
    return Robot.from_urdf(urdf, tool_frame=names[-1], srdf=srdf)


def random_shape(rng: np.random.Generator) -> Shape:
    size = rng.uniform(0.02, 0.12, 3).tolist()
    kinds: tuple[Callable[[], Shape], ...] = (
        lambda: Box((size[0], size[1], size[2])),
        lambda: Sphere(size[0]),
        lambda: Cylinder(size[0], size[1]),
        lambda: Capsule(size[0], size[1]),
    )
    return kinds[int(rng.integers(4))]()


def random_world(rng: np.random.Generator, folder: Path) -> World:
    robot = random_robot(rng, folder)
    shaped = sorted({item.link for item in robot.shapes})
    likely = sorted(link for link in robot.links if not link.endswith(" (link)"))
    names = rng.permutation([*likely, "wall", "universe"])[: int(rng.integers(2, 6))].tolist()
    own = {name: f"object {k}" for k, name in enumerate(names)}
    obstacles, attached = [], []
    for name in names:
        x, y, z, *turn = rng.uniform(-0.6, 0.6, 6).tolist()
        if rng.random() < 0.7:
            obstacles.append(Obstacle(name, random_shape(rng), Pose.from_rpy((x, y, z), turn)))
        else:
            count = int(rng.integers(0, len(shaped) + 1))
            touching = tuple(rng.choice(shaped, count, replace=False).tolist()) if shaped else ()
            attached.append(Attached(name, random_shape(rng), Pose.from_rpy((x / 3, y / 3, z / 3), turn), touching))
    clashing = Scene(tuple(obstacles), tuple(attached))
    plain = Scene(
        tuple(replace(item, name=own[item.name]) for item in obstacles),
        tuple(replace(item, name=own[item.name]) for item in attached),
    )
    both = robot.links & set(names)
    labels = {f"{link} (link)" if link in both or link.endswith(" (link)") else link: link for link in shaped}
    labels = {label: f"{link} (link)" if link.endswith(" (link)") else link for label, link in labels.items()}
    labels |= {f"{name} (object)" if name in both else name: own[name] for name in names}
    drawn = [tuple(rng.choice(sorted(labels), 2, replace=False).tolist()) for _ in range(2)]
    return World(robot, clashing, plain, tuple((a, b) for a, b in drawn), labels)


def states(rng: np.random.Generator, robot: Robot, count: int) -> FloatArray:
    return np.asarray(rng.uniform(-1.5, 1.5, (count, robot.n)))


@pytest.mark.parametrize("backend", JUDGES)
def test_verdicts_and_contacts_do_not_depend_on_what_objects_are_called(backend: BackendName, tmp_path: Path) -> None:
    rng = np.random.default_rng(18)
    free = clashes = 0
    for _ in range(WORLDS):
        world = random_world(rng, tmp_path)
        for pairs in ((), world.pairs):
            checker = CollisionChecker(world.robot, world.clashing, allowed=pairs)
            usual = CollisionChecker(world.robot, world.plain, allowed=world.plainly(pairs))
            assert checker.pair_count == usual.pair_count
            Q = states(rng, world.robot, 12)
            for q, other in zip(Q, Q[::-1], strict=True):
                found = {(world.plain_name[c.a], world.plain_name[c.b], c.depth) for c in checker.contacts(q)}
                assert found == {(c.a, c.b, c.depth) for c in usual.contacts(q)}
                assert checker.state_is_free(q) == usual.state_is_free(q) == (not found)
                hits = checker.edge_hit(q, other), usual.edge_hit(q, other)
                assert (hits[0] is None) == (hits[1] is None)
                if hits[0] is not None and hits[1] is not None:
                    named = (world.plain_name[hits[0].a], world.plain_name[hits[0].b])
                    assert (hits[0].fraction, *named) == (hits[1].fraction, hits[1].a, hits[1].b)
                free += not found
            assert checker.counts == usual.counts
        clashes += len(world.robot.links & set(world.clashing.names))
    assert clashes > WORLDS
    assert WORLDS < free < 23 * WORLDS


def test_proofs_do_not_depend_on_what_objects_are_called(tmp_path: Path) -> None:
    rng = np.random.default_rng(19)
    certified = 0
    for _ in range(WORLDS):
        world = random_world(rng, tmp_path)
        prover = Certifier(world.robot, world.clashing)
        usual = Certifier(world.robot, world.plain)
        for q in states(rng, world.robot, 5):
            ends = np.array([q, q + rng.uniform(-0.2, 0.2, world.robot.n)])
            for pairs in ((), world.pairs):
                length = float(np.sqrt(((ends[1] - ends[0]) ** 2).sum()))
                exempt = (ExemptInterval(0.0, 0.5 * length, pairs, "drawn"),)
                found = prover.certify(ends, exempt=exempt)
                expected = usual.certify(ends, exempt=[replace(exempt[0], pairs=world.plainly(pairs))])
                assert (found.clearance, found.distances) == (expected.clearance, expected.distances)
                if found.refusal is not None and expected.refusal is not None:
                    refusal = refused_pair(found)
                    a, b = world.plain_name[refusal.a], world.plain_name[refusal.b]
                    assert replace(refusal, a=a, b=b) == expected.refusal
                else:
                    assert found.refusal is expected.refusal is None
                    certified += 1
    assert WORLDS < certified < 9 * WORLDS

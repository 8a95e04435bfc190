"""Queries that have no path by construction: a link of few joints stands in a collar of four plates, the goal outside.

That the start is enclosed is decided by a flood fill, not by a proof of the product: plates are taken thinner by what
any point of the link moves by between a configuration and the nearest node of a grid. What cannot be left in the steps
of the grid, diagonals included, then cannot be left at all with the whole plates.

``python -m benchmarks.worlds.pockets`` draws and stores them.
"""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner_service import Box, CollisionChecker, Cylinder, Mesh, Obstacle, Pose, Robot, Scene
from planner_service.certify.pairs import Piece, ProofPairs
from planner_service.geometry.arrays import FloatArray, IntArray, read_only
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot_setup.loading import load_robot

__all__ = ["COUNTS", "FILE", "Pocket", "draw", "load", "text_of"]

FILE = Path(__file__).parents[1] / "queries" / "pockets.json"

COUNTS = {("planar2", 2): 10, ("wxai", 2): 10, ("wxai", 3): 5, ("panda_mbm", 2): 10, ("ur5", 2): 10, ("ur5", 3): 5}
COUNTS |= {("scara", 3): 5}
"""Pockets by robot and number of joints."""

SEED, DECIMALS = 2026, 6
GAP, THICK = (0.004, 0.02), (0.04, 0.08)
"""Metres between a link and its plates, and of these."""

COVERED, AT = (0.3, 0.9), (0.4, 0.9)
"""Parts of the link's length that the plates cover, and where along it their middle is."""

THINNER = 0.3
"""Of the thickness, that is taken away on each side for the flood fill."""

NODES = 20_000
"""A pocket of more is not used."""

GOALS = 100


@dataclass(frozen=True, eq=False)
class Pocket:
    """No path leads from ``start`` to ``goal``; the link that is enclosed is moved by the first ``joints`` joints."""

    robot: str
    joints: int
    plates: tuple[Obstacle, ...]
    start: FloatArray
    goal: FloatArray

    @property
    def scene(self) -> Scene:
        return Scene(self.plates)


def draw(name: str, joints: int, count: int) -> list[Pocket]:
    """So many pockets of a robot."""
    robot = load_robot(name)
    return list(itertools.islice(_pockets(robot, name, joints), count))


def _pockets(robot: Robot, name: str, joints: int) -> Iterator[Pocket]:
    links = _links(robot, joints)
    alone = CollisionChecker(robot, Scene())
    for number in itertools.count():
        chance = random.Random(f"{SEED} pocket {name} {joints} {number}")
        start = _random(robot, chance)
        if not alone.state_is_free(start):
            continue
        pieces = links[chance.randrange(len(links))]
        plates, thinner = _collar(robot, pieces, start, chance)
        checker = CollisionChecker(robot, Scene(plates))
        if not checker.state_is_free(start):
            continue
        inside = _flooded(robot, pieces, joints, thinner, start)
        if inside is None:
            continue
        goals = (_random(robot, chance) for _ in range(GOALS))
        goal = next((q for q in goals if not inside.holds(q) and checker.state_is_free(q)), None)
        if goal is not None:
            yield Pocket(name, joints, plates, start, goal)


def _random(robot: Robot, chance: random.Random) -> FloatArray:
    limits = zip(robot.limits.lower.tolist(), robot.limits.upper.tolist(), strict=True)
    return read_only([round(chance.uniform(low, high) * 0.999, DECIMALS) for low, high in limits])


def _links(robot: Robot, joints: int) -> list[list[Piece]]:
    """The pieces of each link that is moved by exactly these joints."""
    owned: dict[str, list[Piece]] = {}
    for piece in ProofPairs(robot, Scene(), ()).riding:
        moved = {robot.bodies[k].q_index for k in chain_to_base(robot.bodies, piece.body) if k > 0}
        if moved == set(range(joints)):
            owned.setdefault(piece.owner[1], []).append(piece)
    return list(owned.values())


def _points(piece: Piece) -> FloatArray:
    """Corners of a piece, or of a box around it, in the frame of its body."""
    frame, shape = np.array(piece.frame), piece.shape
    if isinstance(shape, Mesh):
        corners = shape.vertices
    else:
        assert isinstance(shape, Box | Cylinder)
        sides = shape.half if isinstance(shape, Box) else (shape.radius, shape.radius, 0.5 * shape.length)
        corners = np.array(list(itertools.product(*((-side, side) for side in sides))))
    return np.asarray(corners @ frame[:, :3].T + frame[:, 3])


def _collar(
    robot: Robot, pieces: Sequence[Piece], start: FloatArray, chance: random.Random
) -> tuple[tuple[Obstacle, ...], tuple[Obstacle, ...]]:
    """Four plates around a link, and the same ones thinner."""
    points = np.concatenate([_points(piece) for piece in pieces])
    low, high = points.min(axis=0), points.max(axis=0)
    gap, thick = chance.uniform(*GAP), chance.uniform(*THICK)
    along = int((high - low).argmax())
    half = 0.5 * (high - low) + gap + thick
    covered = chance.uniform(*COVERED) * (high - low)[along]
    half[along] = 0.5 * covered
    middle = 0.5 * (low + high)
    far = 1.0 if abs(high[along]) >= abs(low[along]) else -1.0
    middle[along] += far * (chance.uniform(*AT) - 0.5) * (high - low)[along]
    R, p = robot.body_poses_batch(start[None], portable=True)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R[0, pieces[0].body], p[0, pieces[0].body]
    plates, thinner = list[Obstacle](), list[Obstacle]()
    for axis in (k for k in range(3) if k != along):
        for sign in (-1.0, 1.0):
            at, sides = np.eye(4), half.copy()
            at[:3, 3], sides[axis] = middle, 0.5 * thick
            at[axis, 3] += sign * (half[axis] - 0.5 * thick)
            pose, name = Pose.from_matrix(T @ at), f"plate_{len(plates)}"
            x, y, z = (round(2.0 * side, DECIMALS) for side in sides.tolist())
            less = 2.0 * THINNER * thick
            plates.append(Obstacle(name, Box((x, y, z)), pose))
            thinner.append(Obstacle(name, Box((x - less, y - less, z - less)), pose))
    return tuple(plates), tuple(thinner)


@dataclass(frozen=True)
class _Inside:
    """Nodes of a grid about ``start``."""

    start: FloatArray
    steps: FloatArray
    nodes: set[tuple[int, ...]]

    def holds(self, q: FloatArray) -> bool:
        joints = len(self.steps)
        return tuple(np.rint((q - self.start)[:joints] / self.steps).astype(int).tolist()) in self.nodes


def _flooded(
    robot: Robot, pieces: Sequence[Piece], joints: int, plates: tuple[Obstacle, ...], start: FloatArray
) -> _Inside | None:
    """What is reached from the start by a link alone; None if that is too much."""
    thinnest = min(min(_size(plate)) for plate in plates)
    moved = THINNER * thinnest / (1.0 - 2.0 * THINNER)
    steps = 2.0 * moved / (joints * _reaches(robot, pieces, joints))
    link = pieces[0].owner[1]
    names = sorted({piece.owner[1] for piece in ProofPairs(robot, Scene(), ()).riding})
    allowed = list(itertools.combinations(names, 2))
    allowed += [(name, plate.name) for name in names for plate in plates if name != link]
    checker = CollisionChecker(robot, Scene(plates), allowed=allowed)
    around = np.array(list(itertools.product((-1, 0, 1), repeat=joints)))
    low, high = robot.limits.lower[:joints], robot.limits.upper[:joints]
    first = (0,) * joints
    seen, inside = {first}, {first}
    front: IntArray = np.zeros((1, joints), dtype=np.intp)
    while len(front):
        beside = {tuple(node) for node in (front[:, None] + around).reshape(-1, joints).tolist()} - seen
        seen |= beside
        nodes: IntArray = np.array(sorted(beside), dtype=np.intp).reshape(-1, joints)
        values = start[:joints] + nodes * steps
        kept = ((values > low - steps) & (values < high + steps)).all(axis=1)
        nodes, Q = nodes[kept], np.repeat(start[None], int(kept.sum()), axis=0)
        Q[:, :joints] = np.clip(values[kept], low, high)
        front = nodes[checker.states_are_free(Q)] if len(Q) else nodes
        inside |= {tuple(node) for node in front.tolist()}
        if len(inside) > NODES:
            return None
    return _Inside(start, steps, inside)


def _size(plate: Obstacle) -> tuple[float, float, float]:
    assert isinstance(plate.shape, Box)
    return plate.shape.size


def _reaches(robot: Robot, pieces: Sequence[Piece], joints: int) -> FloatArray:
    """How far points of pieces can be from the axes of joints at most."""
    far, length = np.zeros(joints), max(float(np.linalg.norm(_points(piece), axis=1).max()) for piece in pieces)
    for body in (robot.bodies[k] for k in chain_to_base(robot.bodies, pieces[0].body) if k > 0):
        far[body.q_index] = 1.0 if body.prismatic else length
        length += float(np.linalg.norm(body.placement[:3, 3]))
    return far


def text_of(pockets: Sequence[Pocket]) -> str:
    """The content of the stored file: one query a line."""
    rows = [
        json.dumps(
            {
                "robot": pocket.robot,
                "joints": pocket.joints,
                "plates": [[*_size(p), *p.pose.position, *p.pose.quaternion] for p in pocket.plates],
                "start": pocket.start.tolist(),
                "goal": pocket.goal.tolist(),
            }
        )
        for pocket in pockets
    ]
    body = ",\n    ".join(rows)
    return f'{{\n  "seed": {SEED},\n  "pockets": [\n    {body}\n  ]\n}}\n'


def load() -> tuple[Pocket, ...]:
    """The stored pockets."""
    return tuple(
        Pocket(
            row["robot"],
            row["joints"],
            tuple(
                Obstacle(f"plate_{k}", Box(plate[:3]), Pose(plate[3:6], plate[6:]))
                for k, plate in enumerate(row["plates"])
            ),
            read_only(row["start"]),
            read_only(row["goal"]),
        )
        for row in json.loads(FILE.read_text("utf-8"))["pockets"]
    )


if __name__ == "__main__":
    FILE.write_text(text_of([pocket for key, count in COUNTS.items() for pocket in draw(*key, count)]), "utf-8")

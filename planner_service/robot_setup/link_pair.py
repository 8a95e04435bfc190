"""Two links of a robot alone: what moves one against the other, and a proof that they never touch, if there is one.

A pair that is not checked is never looked at again, so "never" has to be proven. Over a box of joint values with centre
c the gap of two solids is at least their gap at c less what they move against each other from c to anywhere in the box.
The path from c to a point of the box and back travels no more than the widths of the box, and what moves on the way out
moves as far on the way back: half of the certificate's bound for a stretch that begins and ends in c bounds the motion.
Boxes that this leaves open are cut in half until all are proven, a centre collides, or the budget is spent.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from planner_service.certify.motion_bounds import Motion
from planner_service.certify.pairs import ProofPairs
from planner_service.certify.separation import refined_gaps, rough_gaps
from planner_service.collision import CollisionChecker
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, read_only
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["ContactKind", "LinkPair", "PairFinding", "columns_between", "listed", "names_between", "never_touches"]


MARGIN = 2e-6
"""Metres by which "never" is proven at least; below 1 um FCL's answer is undefined."""
FRACTION = 0.5
"""A box stays open while it proves less than this share of the smallest gap so far: else the reported gap is poor."""
FAR = 0.010
"""Metres: a pair that far apart needs no better figure."""
NEAR = 0.05
"""Metres: nearer pairs get a tight bound where a quick one leaves a box open."""
BOXES = 1024
"""Boxes placed at once: memory."""
ROUNDS, LAST_ROUNDS = 4, 200
"""Steps of the search for the best direction: usually, and before a centre is taken to touch."""
ROUNDING = 1e-9
"""Relative, above the rounding of centres and widths of boxes."""


class ContactKind(Enum):
    """What a pair of links does."""

    ADJACENT = "adjacent"
    """One is the next link with shapes above the other: in contact by design; allowed."""
    GIVEN = "given"
    """Allowed before the shapes were looked at, by an SRDF."""
    ALWAYS = "always"
    """The shapes overlap all over a dense sweep: the robot would never be free; allowed."""
    NEVER = "never"
    """Proven apart in all configurations: checking it is a waste; allowed."""
    SOMETIMES = "sometimes"
    """Collides in a configuration that was found; checked."""
    UNPROVEN = "unproven"
    """No collision was found, and no proof that there is none; checked."""

    @property
    def allowed(self) -> bool:
        """Whether such pairs are not checked."""
        return self not in (ContactKind.SOMETIMES, ContactKind.UNPROVEN)


@dataclass(frozen=True, eq=False)
class PairFinding:
    """What was found out about two links.

    Attributes:
        joints: The joints that move one against the other, from the first link to the second.
        reason: Why the pair is allowed or checked.
        share: Share of the sampled configurations in which it collides; 0 for an adjacent pair, which is not checked.
        example: A configuration (n,) that collides, None if none was found.
        at_home: Whether it collides in the pose "home".
        gap: Metres that a "never" pair keeps, a lower bound in whole micrometres; nan for other kinds.
        bounds: (box, pair of shapes) bounds computed for a proof.
    """

    links: tuple[str, str]
    kind: ContactKind
    joints: tuple[str, ...]
    reason: str
    share: float = 0.0
    example: FloatArray | None = None
    at_home: bool = False
    gap: float = math.nan
    bounds: int = 0

    def __post_init__(self) -> None:
        if self.example is not None:
            object.__setattr__(self, "example", read_only(self.example))


def columns_between(robot: Robot, links: tuple[str, str]) -> list[int]:
    """The entries of q that move one link against the other, from the first to the second."""
    body_of = {item.link: item.body for item in robot.shapes}
    first, second = (chain_to_base(robot.bodies, body_of[link]) for link in links)
    between = [body for body in first if body not in second]
    between += [body for body in reversed(second) if body not in first]
    return list(dict.fromkeys(robot.bodies[body].q_index for body in between))


def names_between(robot: Robot, links: tuple[str, str]) -> tuple[str, ...]:
    return tuple(robot.joint_names[column] for column in columns_between(robot, links))


class LinkPair:
    """Two links alone: the robot without its other shapes, and the entries of q that move one against the other."""

    def __init__(self, robot: Robot, links: tuple[str, str]) -> None:
        self.robot = replace(robot, shapes=tuple(item for item in robot.shapes if item.link in links))
        self.links = links
        self.columns = columns_between(robot, links)
        self.names = names_between(robot, links)

    @cached_property
    def listed(self) -> ProofPairs:
        return ProofPairs(self.robot, Scene(), ())

    @cached_property
    def motion(self) -> Motion:
        return Motion(self.robot, self.listed)

    @cached_property
    def checker(self) -> CollisionChecker:
        """Of the robot whose other joints stand at home: it checks a configuration several times as fast."""
        names, home = self.robot.joint_names, self.robot.home.tolist()
        others = {name: at for k, (name, at) in enumerate(zip(names, home, strict=True)) if k not in self.columns}
        return CollisionChecker(self.robot.locked(others), Scene())

    def are_free(self, Q: FloatArray) -> BoolArray:
        """Which configurations (m, n) do not collide, (m,)."""
        return self.checker.states_are_free(Q[:, sorted(set(self.columns))])

    def configurations(self, values: FloatArray) -> FloatArray:
        """Home, but for the joints between, which stand at ``values`` (m, k); (m, n)."""
        out = np.repeat(self.robot.home[None], len(values), axis=0)
        out[:, self.columns] = values
        return out

    def collides(self, Q: FloatArray) -> BoolArray:
        """Which configurations (m, n) collide; FCL decides only where a quick bound proves nothing."""
        out = np.zeros(len(Q), dtype=bool)
        count = len(self.listed)
        for start in range(0, len(Q), BOXES):
            part = Q[start : start + BOXES]
            node, shapes = np.repeat(np.arange(len(part)), count), np.tile(np.arange(count), len(part))
            facing = self.motion.facing(self.motion.nodes(part)[0], shapes, node)
            gaps, _ = rough_gaps(facing, np.zeros((0, 3, len(node))))
            for k in np.flatnonzero(gaps.reshape(len(part), count).min(axis=1) <= MARGIN).tolist():
                out[start + k] = not self.are_free(part[k : k + 1])[0]
        return out


def never_touches(pair: LinkPair, max_bounds: int) -> PairFinding:
    """The finding on a pair that no sample saw collide: never, sometimes or unproven.

    Args:
        max_bounds: (box, pair of shapes) bounds computed before it is left unproven.
    """
    return _Proof(pair, max_bounds).run()


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Boxes of joint values (m, k), and the rows still open: which box, which pair of shapes."""

    lower: FloatArray
    upper: FloatArray
    box: IntArray
    pair: IntArray


class _Proof:
    """The search for a proof that a pair never collides."""

    def __init__(self, pair: LinkPair, max_bounds: int) -> None:
        self._pair, self._max_bounds = pair, max_bounds
        self._motion = pair.motion
        self._columns = pair.columns
        self._bounds = 0
        self._smallest = self._proven = math.inf

    def run(self) -> PairFinding:
        """The finding: never, sometimes or unproven."""
        limits, columns = self._pair.robot.limits, self._columns
        rows = np.arange(len(self._pair.listed))
        level = _Boxes(limits.lower[None, columns], limits.upper[None, columns], 0 * rows, rows)
        while len(level.box):
            if self._bounds + len(level.box) > self._max_bounds:
                return self._unproven(f"{self._max_bounds:,} bounds did not suffice for a proof that it never collides")
            rest: list[_Boxes] = []
            for boxes in _batches(level):
                touching, halves = self._halves(boxes)
                if touching is not None:
                    if self._pair.are_free(touching[None])[0]:
                        return self._unproven("somewhere the shapes all but touch")
                    reason = "collides in no sample, but in a configuration the proof found"
                    return replace(self._finding(ContactKind.SOMETIMES, reason), example=touching)
                rest += halves
            level = _merged(rest, len(columns))
        gap = math.floor(self._proven * 1e6) / 1e6
        whatever = f"whatever {listed(self._pair.names)} {'is' if len(columns) == 1 else 'are'}"
        reason = f"never: proven at least {gap * 1e3:.3g} mm apart {whatever} ({self._bounds:,} bounds)"
        return replace(self._finding(ContactKind.NEVER, reason), gap=gap)

    def _finding(self, kind: ContactKind, reason: str) -> PairFinding:
        return PairFinding(self._pair.links, kind, self._pair.names, reason, bounds=self._bounds)

    def _unproven(self, why: str) -> PairFinding:
        return self._finding(ContactKind.UNPROVEN, f"no collision was found, but {why}")

    def _halves(self, boxes: _Boxes) -> tuple[FloatArray | None, list[_Boxes]]:
        """A centre (n,) that seems to collide if there is one, and the halves of the boxes that are not proven."""
        q = self._pair.configurations(0.5 * (boxes.lower + boxes.upper))
        poses, radii = self._motion.nodes(q)
        moved = self._moved(radii, boxes)
        gaps = self._gaps(poses, boxes, moved)
        self._bounds += len(gaps)
        worst = int(gaps.argmin())
        if not gaps[worst] > MARGIN:
            return q[boxes.box[worst]], []
        self._smallest = min(self._smallest, float(gaps[worst]))
        bound = gaps - moved
        proven = bound >= self._wanted
        self._proven = min(self._proven, float(bound[proven].min(initial=math.inf)))
        return None, self._split(boxes, radii, ~proven)

    @property
    def _wanted(self) -> float:
        """The gap that a box has to prove to be done."""
        return max(MARGIN, min(FAR, FRACTION * self._smallest))

    def _gaps(self, poses: FloatArray, boxes: _Boxes, moved: FloatArray) -> FloatArray:
        """Lower bounds of the gaps at the centres, tight where that may decide."""
        facing = self._motion.facing(poses, boxes.pair, boxes.box)
        gaps, n = rough_gaps(facing, np.zeros((0, 3, len(boxes.pair))))
        for rounds, doubtful in ((ROUNDS, gaps - moved < self._wanted), (LAST_ROUNDS, None)):
            rows = np.flatnonzero(gaps <= MARGIN if doubtful is None else doubtful & (gaps < NEAR))
            if len(rows):
                gaps[rows], n[:, rows] = refined_gaps(facing.take(rows), gaps[rows], n[:, rows], rounds)
        return gaps

    def _moved(self, radii: FloatArray, boxes: _Boxes, joint: int | None = None) -> FloatArray:
        """How far the rows' shapes move against each other from the centre to anywhere in their box, at most.

        Args:
            joint: Only this one of the joints between moves.
        """
        travel = np.zeros((len(boxes.lower), self._pair.robot.n))
        columns = slice(None) if joint is None else slice(joint, joint + 1)
        travel[:, self._columns[columns]] = ((boxes.upper - boxes.lower) * (1.0 + ROUNDING))[:, columns]
        motions = self._motion.motions(radii, radii, travel)
        return 0.5 * (1.0 + ROUNDING) * self._motion.pair_motions(motions, boxes.pair, boxes.box)

    def _split(self, boxes: _Boxes, radii: FloatArray, rows: BoolArray) -> list[_Boxes]:
        """Both halves of each box that has one of ``rows``, cut across the joint that moves these most."""
        used = np.flatnonzero(np.bincount(boxes.box[rows], minlength=len(boxes.lower)))
        if not len(used):
            return []
        effect = np.zeros((len(boxes.lower), len(self._columns)))
        for joint in range(len(self._columns)):
            np.maximum.at(effect[:, joint], boxes.box[rows], self._moved(radii, boxes, joint)[rows])
        across = effect[used].argmax(axis=1)
        lower, upper = boxes.lower[used], boxes.upper[used]
        each = np.arange(len(used))
        middle = 0.5 * (lower[each, across] + upper[each, across])
        upper_of_first, lower_of_second = upper.copy(), lower.copy()
        upper_of_first[each, across] = lower_of_second[each, across] = middle
        number = np.zeros(len(boxes.lower), dtype=np.intp)
        number[used] = each
        box, pair = number[boxes.box[rows]], boxes.pair[rows]
        return [_Boxes(lower, upper_of_first, box, pair), _Boxes(lower_of_second, upper, box, pair)]


def _merged(parts: Sequence[_Boxes], joints: int) -> _Boxes:
    """All boxes in one list."""
    offsets = np.cumsum([0, *(len(part.lower) for part in parts)])
    none = np.zeros(0, dtype=np.intp)
    return _Boxes(
        np.concatenate([np.zeros((0, joints)), *(part.lower for part in parts)]),
        np.concatenate([np.zeros((0, joints)), *(part.upper for part in parts)]),
        np.concatenate([none, *(part.box + offset for part, offset in zip(parts, offsets.tolist(), strict=False))]),
        np.concatenate([none, *(part.pair for part in parts)]),
    )


def _batches(boxes: _Boxes) -> Iterator[_Boxes]:
    for start in range(0, len(boxes.lower), BOXES):
        few = slice(start, start + BOXES)
        rows = (boxes.box >= start) & (boxes.box < start + BOXES)
        yield _Boxes(boxes.lower[few], boxes.upper[few], boxes.box[rows] - start, boxes.pair[rows])


def listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"

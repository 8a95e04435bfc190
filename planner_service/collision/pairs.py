"""What can collide with what: the robot's shapes, what it carries and the scene as one numbered list."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Hashable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from operator import itemgetter
from typing import cast, overload

import numpy as np

from planner_service.collision.bounds import Solids
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray, IntArray, frozen, product, read_only
from planner_service.geometry.composite import Chosen, Composite, Pieces, Solid
from planner_service.geometry.shapes import Pose, Shape
from planner_service.geometry.validation import number
from planner_service.robot.model import Robot
from planner_service.scene.names import Kind, Names, Owner
from planner_service.scene.scene import Attached, Scene

__all__ = ["PairRuns", "Part", "Parts", "require_padding", "sorted_pairs"]

MANY = 64
"""Pieces from which on an obstacle is a crowd."""

MAX_PADDING = 0.1
"""Metres; more padding than this is a unit mistake."""

MAX_PAIRS = 100_000_000
"""Two and a half million boxes around an arm of 40 pieces: more take more memory than most have."""


FEW_STANDING = 1_000
"""Pieces up to which the pairs of a scene are kept for the next."""

MAX_ALLOWED = 1_000_000
"""Pairs that a caller may allow: more than any scene has, and an end to a sequence without one."""


@dataclass(frozen=True, eq=False)
class Part:
    """One convex piece: ``owner`` is the link or object it belongs to, maybe with other pieces.

    ``body`` numbers the robot body it rides on, or is -1 for an obstacle; ``T`` is its pose in
    that body, or in the world. What is ``carried`` must not be inside the link that carries it
    either, though no motion changes that.
    """

    owner: Owner
    body: int
    shape: Shape
    T: FloatArray
    carried: bool = False

    @property
    def moves(self) -> bool:
        """Whether it rides on a body that a joint moves."""
        return self.body > 0


@dataclass(frozen=True, eq=False)
class PairRuns:
    """Numbered pairs of pieces, told in runs: of one riding piece with pieces that follow each other.

    Attributes:
        table: Of each run its first pair, the riding piece, and the first of the others, (r, 3).
        count: How many pairs there are.
    """

    table: IntArray
    count: int

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[tuple[int, int]]:
        runs = self.table.tolist()
        ends = [*(start for start, _, _ in runs[1:]), self.count]
        for (start, first, second), end in zip(runs, ends[: len(runs)], strict=True):  # without pairs there are none
            for k in range(end - start):
                yield first, second + k

    def of(self, pairs: IntArray) -> IntArray:
        """The two pieces of pairs by their numbers, (k,) in, (k, 2) out."""
        run = self.table[np.searchsorted(self.table[:, 0], pairs, side="right") - 1]
        pieces: IntArray = np.stack([run[:, 1], run[:, 2] + (pairs - run[:, 0])], axis=-1)
        return pieces

    def every(self) -> IntArray:
        """The two pieces of all pairs, (p, 2)."""
        return self.of(np.arange(self.count))

    def between(self, first: int, end: int) -> IntArray:
        """The runs as far as their others are of pieces ``first`` to ``end - 1``: as ``table``, and their lengths."""
        begins = self.table[:, 0]
        lengths = np.diff(begins, append=self.count)
        skipped = np.maximum(first - self.table[:, 2], 0)
        left = np.minimum(lengths, end - self.table[:, 2]) - skipped
        moved = self.table + skipped[:, None] * np.array([1, 0, 1])
        return np.asarray(np.column_stack([moved, left])[left > 0], dtype=np.intp)


class Parts:
    """The numbered pieces of a robot in a scene, and the pairs of them that must stay apart.

    The robot's pieces come first, outermost bodies first (the wrist hits things more often than
    the shoulder, so a colliding state is found out sooner), then the obstacles in scene order.

    Args:
        allowed: Pairs of owners that may touch, beside those the robot and the carried objects allow.
        padding: Metres. Every pair must stay apart by at least this: each piece is grown by half of it.

    Attributes:
        labels: What links and objects are called.
        carried: The pieces of carried objects as ``Robot.reach`` takes them: body, shape, pose in the body.
        riding: How many pieces ride.
        parts: All pieces.
        kinds: The shapes that occur, as they are with the padding.
        numbers: Which of them each piece is, (parts,).
        shapes: That of each piece.
        bodies: The body of each that rides, (riding,).
        standing: How obstacles stand, and where the pieces of obstacles are.
        runs: Numbers from and to which the pieces of each obstacle go, those of one being neighbours in space.
        crowds: Those of many.
        names: The labels of a pair's owners by its number: the link or carried object, then what it meets.
        pairs: Pairs to judge, in the order in which they are judged; the first of each rides on the robot.

    Raises:
        UnknownName: a pair names nothing that is there, or a touch link no link that has shapes.
        InvalidRequest: a pair names a link and an object at once; more than 100,000,000 pairs.
    """

    def __init__(self, robot: Robot, scene: Scene, *, padding: float, allowed: Collection[tuple[str, str]]) -> None:
        self.labels = Names(robot, scene)
        self._riders = riders = _riders_of(robot, scene.attached)
        self.carried = riders.carried
        self.riding = len(riders.parts)
        self.bodies = riders.bodies
        self.standing = _Standing.of(scene)
        own = tuple(part.shape for part in riders.parts)
        self._plain_kinds = (*own, *self.standing.kinds)
        self.numbers = frozen(np.concatenate([np.arange(self.riding), self.standing.numbers + self.riding]))
        self.runs = tuple((self.riding + first, self.riding + end) for first, end in self.standing.runs)
        self.crowds = tuple(run for run in self.runs if run[1] - run[0] >= MANY)
        self._owners = tuple(dict.fromkeys((*(part.owner for part in riders.parts), *self.standing.owners)))
        self._padding, self.kinds = padding, self._grown(padding)
        self._allowed = self._allowed_pairs(robot, scene, allowed)
        self.pairs = self._pairs()
        self.names = _PairNames(self)

    def padded(self, padding: float) -> Parts:
        """The same pieces and pairs with another padding."""
        other = copy(self)
        vars(other).pop("solids", None)
        other._padding, other.kinds = padding, other._grown(padding)
        return other

    def allowing(self, robot: Robot, scene: Scene, allowed: Collection[tuple[str, str]]) -> Parts:
        """The same pieces where more pairs of owners may touch: ``allowed``, those before among them.

        Raises:
            UnknownName: as ``Parts``; so is InvalidRequest.
        """
        other = copy(self)
        other._allowed = self._allowed_pairs(robot, scene, allowed)
        other.pairs = other._pairs()
        other.names = _PairNames(other)
        return other

    @property
    def parts(self) -> _Numbered:
        """All pieces, as they are without the padding."""
        return _Numbered(self._riders.parts, self.standing)

    @property
    def shapes(self) -> Sequence[Shape]:
        """The shape of each piece, as it is with the padding."""
        return Chosen(self.kinds, self.numbers)

    @cached_property
    def solids(self) -> Solids:
        """The kinds of shapes, as they are with the padding."""
        return _grown_riders(self._riders, self._padding)[1].joined(Solids.of(self.kinds[self.riding :]))

    def _grown(self, padding: float) -> tuple[Shape, ...]:
        standing = (_grown_by(shape, padding) for shape in self._plain_kinds[self.riding :])
        return (*_grown_riders(self._riders, padding)[0], *standing)

    def _allowed_pairs(
        self, robot: Robot, scene: Scene, allowed: Collection[tuple[str, str]]
    ) -> frozenset[frozenset[Owner]]:
        pairs = list[frozenset[Owner]]()
        links = {item.link for item in robot.shapes}
        for attached in scene.attached:
            for link in attached.touch_links:
                if link not in links:
                    raise UnknownName("touch link", link, links)
                pairs.append(frozenset((Owner(Kind.OBJECT, attached.name), Owner(Kind.LINK, link))))
        known = {self.labels.of(owner): owner for owner in self._owners} if allowed else {}
        for pair in allowed:
            for name in pair:
                if name in self.labels.twice:
                    expected = " or ".join(repr(name + kind.value) for kind in Kind)
                    raise InvalidRequest("link or object", name, f"{expected}: the name stands for both")
                if name not in known:
                    raise UnknownName("link or object", name, known)
            pairs.append(frozenset(known[name] for name in pair))
        return _contacts_of(robot).union(pairs)

    def _pairs(self) -> PairRuns:
        """The pairs: those of scenes before where the same pieces ride and as many stand, wherever these are."""
        counts = (last - first for first, last in self.runs)
        standing = tuple(zip(self.standing.owners, counts, strict=True))
        few = len(self.numbers) - self.riding <= FEW_STANDING
        return _pairs_of(self._riders, standing, self._allowed, few=few)


@dataclass(frozen=True, eq=False)
class _Standing:
    """The pieces of obstacles, one after the other, and where they are in the world.

    Attributes:
        owners: The obstacles.
        runs: Numbers from and to which their pieces go.
        kinds: The shapes that occur.
        numbers: Which of them each piece is, (k,).
        rotations: How pieces stand, (r, 3, 3).
        turns: Which of these each does, (k,).
        positions: Where each is, (k, 3).
    """

    owners: tuple[Owner, ...]
    runs: tuple[tuple[int, int], ...]
    kinds: tuple[Shape, ...]
    numbers: IntArray
    rotations: FloatArray
    turns: IntArray
    positions: FloatArray

    @classmethod
    def of(cls, scene: Scene) -> _Standing:
        """All obstacles of a scene in their order."""
        kinds, ends = list[Shape](), [0]
        numbers, turns = list[IntArray](), list[IntArray]()
        rotations, positions = list[FloatArray](), list[FloatArray]()
        stands = 0
        for o in scene.obstacles:
            if isinstance(o.shape, Composite):
                pieces = o.shape.pieces
                numbers.append(pieces.numbers + len(kinds))
                kinds += pieces.kinds
                rotation, position = _placed(pieces, o.pose)
            else:
                numbers.append(np.array([len(kinds)]))
                kinds.append(o.shape)
                T = o.pose.matrix[None]
                rotation, position = T[:, :3, :3], T[:, :3, 3]
            stand = np.arange(stands, stands + len(rotation))
            turns.append(stand if len(stand) == len(position) else np.broadcast_to(stand, len(position)))
            stands += len(rotation)
            rotations.append(rotation)
            positions.append(position)
            ends.append(ends[-1] + len(position))
        none: IntArray = np.zeros(0, dtype=np.intp)
        return cls(
            tuple(Owner(Kind.OBJECT, o.name) for o in scene.obstacles),
            tuple(pairwise(ends)),
            tuple(kinds),
            frozen(np.concatenate([none, *numbers])),
            frozen(np.concatenate([np.zeros((0, 3, 3)), *rotations])),
            frozen(np.concatenate([none, *turns])),
            frozen(np.concatenate([np.zeros((0, 3)), *positions])),
        )

    def __len__(self) -> int:
        return len(self.numbers)

    def part(self, number: int) -> Part:
        """One of the pieces."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.rotations[self.turns[number]], self.positions[number]
        return Part(self.owner(number), -1, self.kinds[self.numbers[number]], frozen(T))

    def owner(self, number: int) -> Owner:
        """Whose one of the pieces is."""
        return self.owners[bisect_right(self.runs, number, key=itemgetter(0)) - 1]


class _Numbered(Sequence[Part]):
    """The pieces that ride and those that stand; objects of these are made as they are looked at."""

    def __init__(self, riding: tuple[Part, ...], standing: _Standing) -> None:
        self._riding, self._standing = riding, standing

    def __len__(self) -> int:
        return len(self._riding) + len(self._standing)

    @overload
    def __getitem__(self, index: int) -> Part: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Part]: ...
    def __getitem__(self, index: int | slice) -> Part | Sequence[Part]:
        numbers = range(len(self))[index]
        return self._at(numbers) if isinstance(numbers, int) else tuple(map(self._at, numbers))

    def owner(self, number: int) -> Owner:
        """Whose a piece is, without an object of it."""
        riding = len(self._riding)
        return self._riding[number].owner if number < riding else self._standing.owner(number - riding)

    def _at(self, number: int) -> Part:
        riding = len(self._riding)
        return self._riding[number] if number < riding else self._standing.part(number - riding)


class _PairNames(dict[int, tuple[str, str]]):
    """The names of these pairs."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts

    def __missing__(self, pair: int) -> tuple[str, str]:
        labels, parts = self._parts.labels, self._parts.parts
        a, b = (labels.of(parts.owner(k)) for k in self._parts.pairs.of(np.array([pair]))[0].tolist())
        self[pair] = a, b
        return a, b


@lru_cache(maxsize=16)
def _links_of(robot: Robot) -> tuple[Part, ...]:
    """The pieces of a robot's own links: they are the same in every scene."""
    return tuple(Part(Owner(Kind.LINK, s.link), s.body, s.shape, read_only(s.pose.matrix)) for s in robot.shapes)


@dataclass(frozen=True, eq=False)
class _Riders:
    """The pieces that ride on a robot in the order in which they are numbered, with what ``Parts`` says of them."""

    parts: tuple[Part, ...]
    carried: tuple[tuple[int, Shape, Pose], ...]
    frames: FloatArray
    bodies: FloatArray

    def runs(self) -> list[tuple[int, int]]:
        """Numbers from and to which pieces of one owner that ride on one body go."""
        kinds = [(part.owner, part.body, part.carried) for part in self.parts]
        starts = [k for k, kind in enumerate(kinds) if k == 0 or kind != kinds[k - 1]]
        return list(zip(starts, [*starts[1:], len(kinds)], strict=False))


@lru_cache(maxsize=32)
def _riders_of(robot: Robot, attached: tuple[Attached, ...]) -> _Riders:
    """What rides is the same in every scene in which the robot carries the same."""
    tool = Pose.from_matrix(robot.tool_placement)
    held = [(a, tool @ a.pose) for a in attached]
    riding = list(_links_of(robot))
    riding += [
        Part(Owner(Kind.OBJECT, a.name), robot.tool_body, shape, T, carried=True)
        for a, pose in held
        for shape, T in _frames(a.shape, pose)
    ]
    riding.sort(key=lambda part: -part.body)
    frames = read_only(np.array([part.T for part in riding]).reshape(-1, 4, 4))
    bodies = read_only([float(part.body) for part in riding])
    carried = tuple((robot.tool_body, *piece) for a, pose in held for piece in _posed(a.shape, pose))
    return _Riders(tuple(riding), carried, frames, bodies)


def _pairs_of(
    riders: _Riders,
    standing: tuple[tuple[Owner, int], ...],
    allowed: frozenset[frozenset[Owner]],
    *,
    few: bool,
) -> PairRuns:
    """See ``Parts.pairs``.

    Args:
        standing: Of each obstacle its owner and how many pieces it has.
        few: Whether they are kept for other scenes, in which these have other names and stand elsewhere.
    """
    heads = [(riders.parts[first], end - first) for first, end in riders.runs()]
    owners: dict[Owner, int] = {}  # by number: owners themselves take long to look up
    kinds = tuple(
        (owners.setdefault(part.owner, len(owners)), count, part.body, part.carried, part.moves)
        for part, count in heads
    )
    others = tuple((owners.setdefault(owner, len(owners)), count) for owner, count in standing)
    touching = frozenset(tuple(sorted(owners[one] for one in pair)) for pair in allowed if pair <= owners.keys())
    return (_numbered_pairs if few else _numbered_pairs.__wrapped__)(kinds, others, touching)


@lru_cache(maxsize=256)
def _numbered_pairs(
    heads: tuple[tuple[int, int, int, bool, bool], ...],
    standing: tuple[tuple[int, int], ...],
    touching: frozenset[tuple[int, ...]],
) -> PairRuns:
    """See ``Parts.pairs``.

    Args:
        heads: Of each run of pieces that ride its owner by number, how many they are, their body, and whether they are
            carried and move.
        standing: Of each obstacle its owner by number, and how many pieces it has.
        touching: Owners that may touch, the lesser number first.
    """
    runs = list[tuple[int, int]]()
    for count in (*(head[1] for head in heads), *(count for _, count in standing)):
        runs.append((runs[-1][1] if runs else 0, (runs[-1][1] if runs else 0) + count))
    riding, owner = len(heads), [*(head[0] for head in heads), *(number for number, _ in standing)]
    tables, count = list[IntArray]([np.zeros((0, 3), dtype=np.intp)]), 0
    for k, (mine, _, body, carried, moves) in enumerate(heads):
        others = [
            *(range(riding, len(runs)) if moves else ()),
            # two that are carried cannot move against each other
            *(j for j in range(k + 1, riding) if body != heads[j][2] or carried != heads[j][3]),
        ]
        judged = list[tuple[int, int]]()  # runs of others, those that follow each other as one
        for other in others:
            if owner[other] != mine and (min(mine, owner[other]), max(mine, owner[other])) not in touching:
                first, end = runs[other]
                if judged and judged[-1][1] == first:
                    judged[-1] = judged[-1][0], end
                else:
                    judged.append((first, end))
        lengths = [end - first for first, end in judged]
        first, end = runs[k]
        each = sum(lengths)
        if count + (end - first) * each > MAX_PAIRS:
            total = count + (end - first) * each
            raise InvalidRequest("scene", total, f"at most {MAX_PAIRS:,} pairs of pieces that must stay apart")
        mine_first = np.repeat(np.arange(first, end), len(judged))
        begins = count + each * (mine_first - first) + np.tile(np.cumsum([0, *lengths])[:-1], end - first)
        seconds = np.tile(np.array([start for start, _ in judged], dtype=np.intp), end - first)
        tables.append(np.stack([begins, mine_first, seconds], axis=1).astype(np.intp))
        count += (end - first) * each
    return PairRuns(frozen(np.concatenate(tables)), count)


@lru_cache(maxsize=128)
def _grown_riders(riders: _Riders, padding: float) -> tuple[tuple[Shape, ...], Solids]:
    """Their shapes with a padding, and these as solids."""
    shapes = tuple(_grown_by(part.shape, padding) for part in riders.parts)
    return shapes, Solids.of(shapes)


@lru_cache(maxsize=16)
def _contacts_of(robot: Robot) -> frozenset[frozenset[Owner]]:
    """The links that may touch, likewise."""
    return frozenset(frozenset(Owner(Kind.LINK, link) for link in c.links) for c in robot.allowed_contacts)


def _grown_by(shape: Shape, padding: float) -> Shape:
    """A shape with half of a padding."""
    return _grown(cast(Hashable, shape), padding / 2) if padding else shape


@lru_cache(maxsize=1024)
def _grown(shape: Hashable, margin: float) -> Shape:
    """Most shapes of a new scene are those of the scene before."""
    return cast(Shape, shape).grown(margin)


def require_padding(padding: object) -> None:
    """Refuse what is no distance in metres up to 0.1."""
    number("padding", padding, f"metres in [0, {MAX_PADDING}]", 0.0, MAX_PADDING)


def sorted_pairs(allowed: Iterable[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Pairs of names as given by a user, each once and in order."""
    pairs = set()
    if isinstance(allowed, (str, bytes, np.ndarray)) or not isinstance(allowed, Iterable):
        raise InvalidRequest("allowed", allowed, "pairs of link or object names")
    for count, pair in enumerate(allowed):
        if count == MAX_ALLOWED:
            raise InvalidRequest("allowed", allowed, f"at most {MAX_ALLOWED:,} pairs of link or object names")
        if not isinstance(pair, tuple | list) or len(pair) != 2 or not all(isinstance(name, str) for name in pair):
            raise InvalidRequest("allowed", pair, "pairs of link or object names")
        pairs.add((min(pair), max(pair)))
    return tuple(sorted(pairs))


def _posed(solid: Solid, pose: Pose) -> Iterator[tuple[Shape, Pose]]:
    """The convex pieces of a solid at a pose, each with its own."""
    if not isinstance(solid, Composite):
        yield solid, pose
    else:
        for shape, T in _frames(solid, pose):
            yield shape, Pose.from_matrix(T)


def _frames(solid: Solid, pose: Pose) -> Iterator[tuple[Shape, FloatArray]]:
    """The convex pieces of a solid at a pose, and where they are in what the pose is given in, 4 x 4."""
    if not isinstance(solid, Composite):
        return iter([(solid, read_only(pose.matrix))])
    return zip(solid.pieces.shapes, read_only(product(pose.matrix, solid.pieces.frames)), strict=True)


def _placed(pieces: Pieces, pose: Pose) -> tuple[FloatArray, FloatArray]:
    """How pieces at a pose stand, as ``Pieces.rotations``, and where they are, (k, 3): the numbers of ``_frames``."""
    turns, places = np.zeros((len(pieces.rotations), 4, 3)), np.ones((len(pieces), 4, 1))
    turns[:, :3], places[:, :3, 0] = pieces.rotations, pieces.positions
    return product(pose.matrix, turns)[:, :3], product(pose.matrix, places)[:, :3, 0]

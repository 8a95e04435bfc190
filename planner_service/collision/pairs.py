"""What can collide with what: the robot's shapes, what it carries and the scene as one numbered list."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Iterator
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import cast

import numpy as np

from planner_service.collision.bounds import Solids
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray, IntArray, frozen, product, read_only
from planner_service.geometry.composite import Composite, Solid
from planner_service.geometry.shapes import Pose, Shape
from planner_service.geometry.validation import number
from planner_service.robot.model import Robot
from planner_service.scene.names import Kind, Names, Owner
from planner_service.scene.scene import Attached, Scene

__all__ = ["Part", "Parts", "require_padding", "sorted_pairs"]

MANY = 64
"""Pieces from which on an obstacle is a crowd."""

MAX_PADDING = 0.1
"""Metres; more padding than this is a unit mistake."""

MAX_PAIRS = 20_000_000
"""Ten clouds of 50,000 boxes around an arm of 40 pieces; more take more memory than most have."""


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
        frames: The pose of each piece in its body, or in the world, (parts, 4, 4).
        bodies: The body of each, (parts,).
        runs: Numbers from and to which the pieces of each obstacle go, those of one being neighbours in space.
        crowds: Those of many.
        names: The labels of a pair's owners by its number: the link or carried object, then what it meets.
        pairs: Pairs to judge, (p, 2), in the order in which they are judged; the first of each rides on the robot.

    Raises:
        UnknownName: a pair names nothing that is there, or a touch link no link that has shapes.
        InvalidRequest: a pair names a link and an object at once; more than 20,000,000 pairs.
    """

    def __init__(self, robot: Robot, scene: Scene, *, padding: float, allowed: Collection[tuple[str, str]]) -> None:
        self.labels = Names(robot, scene)
        self._riders = riders = _riders_of(robot, scene.attached)
        self.carried = riders.carried
        standing: list[Part] = []
        runs = []
        for o in scene.obstacles:
            first = len(riders.parts) + len(standing)
            standing += [Part(Owner(Kind.OBJECT, o.name), -1, shape, T) for shape, T in _placed(o.shape, o.pose)]
            runs.append((first, len(riders.parts) + len(standing)))
        self.parts = (*riders.parts, *standing)
        standing_frames = np.array([part.T for part in standing]).reshape(-1, 4, 4)
        self.frames = read_only(np.concatenate([riders.frames, standing_frames]))
        self.bodies = read_only(np.concatenate([riders.bodies, np.full(len(standing), -1.0)]))
        self.riding = len(riders.parts)
        self.runs = tuple(runs)
        self.crowds = tuple(run for run in runs if run[1] - run[0] >= MANY)
        self._padding, self.shapes = padding, self._grown(padding)
        self._allowed = self._allowed_pairs(robot, scene, allowed)
        self.pairs = self._pairs()
        self.names = _PairNames(self)

    def padded(self, padding: float) -> Parts:
        """The same pieces and pairs with another padding."""
        other = copy(self)
        vars(other).pop("solids", None)
        other._padding, other.shapes = padding, other._grown(padding)
        return other

    def allowing(self, robot: Robot, scene: Scene, allowed: Collection[tuple[str, str]]) -> Parts:
        """The same pieces where more pairs of owners may touch: ``allowed``, those before among them.

        Raises:
            UnknownName: as ``Parts``; so is InvalidRequest.
        """
        other = copy(self)
        other._allowed = self._allowed_pairs(robot, scene, allowed)
        numbers = {owner: number for number, owner in enumerate({part.owner: None for part in self.parts})}
        more = [sorted(map(numbers.__getitem__, pair)) for pair in other._allowed - self._allowed if len(pair) == 2]
        owners = np.array([numbers[part.owner] for part in self.parts], dtype=np.intp)
        both = np.sort(owners[self.pairs], axis=1)
        touching = [(both == pair).all(axis=1) for pair in more]
        other.pairs = self.pairs[~np.any(touching, axis=0)] if touching else self.pairs
        other.names = _PairNames(other)
        return other

    @cached_property
    def solids(self) -> Solids:
        """The shapes, as they are with the padding."""
        return _grown_riders(self._riders, self._padding)[1].joined(Solids.of(self.shapes[self.riding :]))

    def _grown(self, padding: float) -> tuple[Shape, ...]:
        standing = (part.shape for part in self.parts[self.riding :])
        return (*_grown_riders(self._riders, padding)[0], *(_grown_by(shape, padding) for shape in standing))

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
        known = {self.labels.of(part.owner): part.owner for part in self.parts} if allowed else {}
        for pair in allowed:
            for name in pair:
                if name in self.labels.twice:
                    expected = " or ".join(repr(name + kind.value) for kind in Kind)
                    raise InvalidRequest("link or object", name, f"{expected}: the name stands for both")
                if name not in known:
                    raise UnknownName("link or object", name, known)
            pairs.append(frozenset(known[name] for name in pair))
        return _contacts_of(robot).union(pairs)

    def _pairs(self) -> IntArray:
        """The pairs: those of scenes before where the same pieces ride and as many stand, wherever these are."""
        standing = tuple((self.parts[first].owner, last - first) for first, last in self.runs)
        few = len(self.parts) - self.riding <= FEW_STANDING
        return (_pairs_of if few else _pairs_of.__wrapped__)(self._riders, standing, self._allowed)


class _PairNames(dict[int, tuple[str, str]]):
    """The names of these pairs."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts

    def __missing__(self, pair: int) -> tuple[str, str]:
        labels, parts = self._parts.labels, self._parts.parts
        a, b = (labels.of(parts[k].owner) for k in self._parts.pairs[pair])
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
        for shape, T in _placed(a.shape, pose)
    ]
    riding.sort(key=lambda part: -part.body)
    frames = read_only(np.array([part.T for part in riding]).reshape(-1, 4, 4))
    bodies = read_only([float(part.body) for part in riding])
    carried = tuple((robot.tool_body, *piece) for a, pose in held for piece in _posed(a.shape, pose))
    return _Riders(tuple(riding), carried, frames, bodies)


@lru_cache(maxsize=32)
def _pairs_of(
    riders: _Riders, standing: tuple[tuple[Owner, int], ...], allowed: frozenset[frozenset[Owner]]
) -> IntArray:
    """See ``Parts.pairs``.

    Args:
        standing: Of each obstacle its owner and how many pieces it has.
    """
    runs = riders.runs()
    riding, heads = len(runs), [riders.parts[first] for first, _ in runs]
    for _, count in standing:
        runs.append((runs[-1][1] if runs else 0, (runs[-1][1] if runs else 0) + count))
    numbers = [np.arange(*run) for run in runs]
    owners: dict[Owner, int] = {}  # by number: owners themselves take long to look up
    every = (*(head.owner for head in heads), *(owner for owner, _ in standing))
    owner = [owners.setdefault(each, len(owners)) for each in every]
    touching = {tuple(sorted(owners[one] for one in pair)) for pair in allowed if pair <= owners.keys()}
    none: IntArray = np.zeros(0, dtype=np.intp)
    firsts, seconds = list[IntArray]((none,)), list[IntArray]((none,))
    count = 0
    for k, part in enumerate(heads):
        mine = owner[k]
        others = [
            *(range(riding, len(runs)) if part.moves else ()),
            # two that are carried cannot move against each other
            *(j for j in range(k + 1, riding) if part.body != heads[j].body or part.carried != heads[j].carried),
        ]
        judged = [
            numbers[other]
            for other in others
            if owner[other] != mine and (min(mine, owner[other]), max(mine, owner[other])) not in touching
        ]
        count += len(numbers[k]) * sum(map(len, judged))
        if count > MAX_PAIRS:
            raise InvalidRequest("scene", count, f"at most {MAX_PAIRS:,} pairs of pieces that must stay apart")
        partners = np.concatenate([none, *judged])
        firsts.append(numbers[k].repeat(len(partners)))
        seconds += [partners] * len(numbers[k])
    return frozen(np.stack([np.concatenate(firsts), np.concatenate(seconds)], axis=1))


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
        for shape, T in _placed(solid, pose):
            yield shape, Pose.from_matrix(T)


def _placed(solid: Solid, pose: Pose) -> Iterator[tuple[Shape, FloatArray]]:
    """The convex pieces of a solid at a pose, and where they are in what the pose is given in, 4 x 4."""
    if not isinstance(solid, Composite):
        return iter([(solid, read_only(pose.matrix))])
    return zip(solid.pieces.shapes, read_only(product(pose.matrix, solid.pieces.frames)), strict=True)
